//! Files that appear under their final name only when they are whole.

use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};

use crate::error::{PackError, Result};

/// Suffix of files that are still being written.
pub(crate) const PARTIAL_SUFFIX: &str = ".partial";

/// A file under its temporary name. Dropped without [`PartialFile::commit`], it is deleted.
#[derive(Debug)]
pub(crate) struct PartialFile {
    final_path: PathBuf,
    partial_path: PathBuf,
    committed: bool,
}

impl PartialFile {
    /// Creates the empty temporary file beside `final_path`, over any that a killed run left.
    pub fn create(final_path: &Path) -> Result<Self> {
        let mut name = final_path.file_name().map_or_else(OsString::new, OsString::from);
        name.push(PARTIAL_SUFFIX);
        let partial_path = final_path.with_file_name(name);
        File::create(&partial_path).map_err(|e| PackError::create(final_path, e))?;
        Ok(Self { final_path: final_path.to_path_buf(), partial_path, committed: false })
    }

    /// Where to write.
    pub fn path(&self) -> &Path {
        &self.partial_path
    }

    /// The name the file will have.
    pub fn final_path(&self) -> &Path {
        &self.final_path
    }

    /// Syncs the content, gives the file its final name and syncs the folder.
    pub fn commit(mut self) -> Result<()> {
        let error = |e| PackError::io(&self.final_path, e);
        File::open(&self.partial_path).and_then(|f| f.sync_all()).map_err(error)?;
        std::fs::rename(&self.partial_path, &self.final_path).map_err(error)?;
        sync_folder_of(&self.final_path)?;
        self.committed = true;
        Ok(())
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.committed {
            // Nothing can be done about a file that resists deletion; its name marks it as partial.
            let _ = std::fs::remove_file(&self.partial_path);
        }
    }
}

/// Writes `bytes` to `path`, whole or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let partial = PartialFile::create(path)?;
    std::fs::write(partial.path(), bytes).map_err(|e| PackError::io(path, e))?;
    partial.commit()
}

/// Copies a file, whole or not at all.
pub(crate) fn copy(from: &Path, to: &Path) -> Result<()> {
    let partial = PartialFile::create(to)?;
    let mut source = File::open(from).map_err(|e| PackError::read(from, e))?;
    let mut target = File::create(partial.path()).map_err(|e| PackError::create(to, e))?;
    std::io::copy(&mut source, &mut target).map_err(|e| PackError::io(to, e))?;
    drop(target);
    partial.commit()
}

/// Makes a rename in the folder of `path` durable.
pub(crate) fn sync_folder_of(path: &Path) -> Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // Folders cannot be opened for syncing on every system; where they can, a failure counts.
    if cfg!(unix) {
        File::open(folder).and_then(|f| f.sync_all()).map_err(|e| PackError::io(folder, e))?;
    }
    Ok(())
}
