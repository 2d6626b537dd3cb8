//! One writer, or one job of many workers, at a time in a dataset folder.

use std::fs::File;
use std::path::Path;

use crate::error::{PackError, Result};

/// A lock on a folder, held until it is dropped or the process ends, however it ends.
#[derive(Debug)]
pub struct FolderLock {
    folder: Option<File>,
}

impl FolderLock {
    /// Locks out everybody else.
    ///
    /// # Errors
    /// [`PackError::Unwritable`] where another process writes into the folder.
    pub fn exclusive(folder: &Path) -> Result<Self> {
        Self::lock(folder, File::try_lock)
    }

    /// Locks out those who want the folder for themselves.
    ///
    /// # Errors
    /// [`PackError::Unwritable`] where such a process writes into the folder.
    pub fn shared(folder: &Path) -> Result<Self> {
        Self::lock(folder, File::try_lock_shared)
    }

    fn lock(
        folder: &Path,
        lock: fn(&File) -> std::result::Result<(), std::fs::TryLockError>,
    ) -> Result<Self> {
        // Elsewhere folders cannot be opened, and a lock file would become part of the dataset.
        if !cfg!(unix) {
            return Ok(Self { folder: None });
        }
        let file = File::open(folder).map_err(|e| PackError::create(folder, e))?;
        match lock(&file) {
            Ok(()) => Ok(Self { folder: Some(file) }),
            Err(std::fs::TryLockError::WouldBlock) => {
                let message = "another process is writing into this folder";
                let source = std::io::Error::new(std::io::ErrorKind::ResourceBusy, message);
                Err(PackError::Unwritable { path: folder.to_path_buf(), source })
            }
            // A file system without locks is no reason not to write.
            Err(std::fs::TryLockError::Error(_)) => Ok(Self { folder: None }),
        }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // Closing is not enough: a process that is being started holds a copy of the descriptor for a moment.
        if let Some(folder) = &self.folder {
            let _ = folder.unlock();
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn one_writer_or_many_workers() {
        let folder = tempfile::tempdir().unwrap();
        let worker = FolderLock::shared(folder.path()).unwrap();
        let _another = FolderLock::shared(folder.path()).unwrap();
        let error = FolderLock::exclusive(folder.path()).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        drop((worker, _another));
        let _writer = FolderLock::exclusive(folder.path()).unwrap();
        assert!(
            FolderLock::shared(folder.path()).unwrap_err().to_string().contains("another process")
        );
    }
}
