//! Output folders that appear under their final name only when they are whole.

use std::path::{Component, Path, PathBuf};

use tempfile::TempDir;

use crate::error::{PackError, Result};

/// A folder that is filled under a temporary name beside its final one. Dropped without
/// [`StagingFolder::commit`], it is deleted.
#[derive(Debug)]
pub struct StagingFolder {
    final_path: PathBuf,
    folder: TempDir,
}

impl StagingFolder {
    /// Starts the folder that will be `final_path`, which must be new or an empty folder.
    ///
    /// # Errors
    /// [`PackError::Unwritable`] where something stands there (a symbolic link counts: what it points at is
    /// not this command's to fill), or the place cannot be written.
    pub fn create(final_path: &Path) -> Result<Self> {
        check_free(final_path)?;
        let parent = match final_path.parent() {
            Some(parent) if parent != Path::new("") => parent,
            _ => Path::new("."),
        };
        let name = final_path.file_name().unwrap_or_default().to_string_lossy();
        let folder = tempfile::Builder::new()
            .prefix(&format!(".{name}.partial-"))
            .tempdir_in(parent)
            .map_err(|e| PackError::create(final_path, e))?;
        Ok(Self { final_path: final_path.to_path_buf(), folder })
    }

    /// Where to write.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// The name the folder will have.
    pub fn final_path(&self) -> &Path {
        &self.final_path
    }

    /// Syncs every file, gives the folder its final name and readable permissions.
    ///
    /// # Errors
    /// [`PackError::Io`], and [`PackError::Unwritable`] where something has come to stand there meanwhile.
    pub fn commit(self) -> Result<()> {
        sync_below(self.folder.path())?;
        check_free(&self.final_path)?;
        make_readable(self.folder.path())?;
        let staged = self.folder.keep();
        std::fs::rename(&staged, &self.final_path).map_err(|e| {
            // Nothing more can be done about a folder that resists deletion; its name marks it as partial.
            let _ = std::fs::remove_dir_all(&staged);
            PackError::io(&self.final_path, e)
        })
    }
}

/// Refuses a place where something stands already.
fn check_free(path: &Path) -> Result<()> {
    let taken = |why: &str| {
        let source = std::io::Error::new(std::io::ErrorKind::AlreadyExists, why.to_owned());
        Err(PackError::create(path, source))
    };
    match std::fs::symlink_metadata(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(PackError::create(path, e)),
        Ok(found) if found.is_symlink() => taken("it is a symbolic link"),
        Ok(found) if !found.is_dir() => taken("a file of that name exists"),
        Ok(_) => {
            let mut entries = path.read_dir().map_err(|e| PackError::create(path, e))?;
            if entries.next().is_some() { taken("the folder is not empty") } else { Ok(()) }
        }
    }
}

fn sync_below(folder: &Path) -> Result<()> {
    let error = |e| PackError::io(folder, e);
    for entry in folder.read_dir().map_err(error)? {
        let entry = entry.map_err(error)?;
        let kind = entry.file_type().map_err(error)?;
        if kind.is_dir() {
            sync_below(&entry.path())?;
        } else if kind.is_file() {
            let path = entry.path();
            std::fs::File::open(&path)
                .and_then(|file| file.sync_all())
                .map_err(|e| PackError::io(&path, e))?;
        }
    }
    if cfg!(unix) {
        std::fs::File::open(folder).and_then(|file| file.sync_all()).map_err(error)?;
    }
    Ok(())
}

/// Temporary folders are closed to others; finished ones are like any that `mkdir` makes.
fn make_readable(folder: &Path) -> Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let permissions = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(folder, permissions).map_err(|e| PackError::io(folder, e))?;
    }
    Ok(())
}

/// The file `named` below `folder`, where it stays there: relative, without `..`, and not by way of a
/// symbolic link that leads elsewhere.
///
/// # Errors
/// [`PackError::Content`] about `list`, which named it.
pub(crate) fn confined(folder: &Path, named: &str, list: &Path) -> Result<PathBuf> {
    let refuse = |got: String| {
        let expected = "a file below the dataset's folder";
        Err(PackError::content(list, format!("file {named:?}"), expected, got))
    };
    let relative = Path::new(named);
    let plain = relative.components().all(|part| matches!(part, Component::Normal(_)));
    if !plain || named.is_empty() {
        return refuse("a path that leads elsewhere".into());
    }
    let path = folder.join(relative);
    let real = |path: &Path| path.canonicalize().map_err(|e| PackError::read(path, e));
    let (real_folder, real_path) = (real(folder)?, real(&path)?);
    if real_path.starts_with(&real_folder) {
        Ok(path)
    } else {
        refuse(format!("a link to {}", real_path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_appears_only_when_it_is_committed() {
        let place = tempfile::tempdir().unwrap();
        let output = place.path().join("out");
        let staging = StagingFolder::create(&output).unwrap();
        std::fs::write(staging.path().join("a"), "1").unwrap();
        assert!(!output.exists());
        staging.commit().unwrap();
        assert_eq!(std::fs::read_to_string(output.join("a")).unwrap(), "1");
        drop(StagingFolder::create(&place.path().join("other")).unwrap());
        assert_eq!(place.path().read_dir().unwrap().count(), 1);
    }

    #[test]
    fn places_that_are_taken_are_refused() {
        let place = tempfile::tempdir().unwrap();
        let (file, full) = (place.path().join("file"), place.path().join("full"));
        std::fs::write(&file, "").unwrap();
        std::fs::create_dir(&full).unwrap();
        std::fs::write(full.join("a"), "").unwrap();
        for taken in [&file, &full] {
            assert!(matches!(StagingFolder::create(taken), Err(PackError::Unwritable { .. })));
        }
        #[cfg(unix)]
        {
            let link = place.path().join("link");
            let empty = place.path().join("empty");
            std::fs::create_dir(&empty).unwrap();
            std::os::unix::fs::symlink(&empty, &link).unwrap();
            assert!(matches!(StagingFolder::create(&link), Err(PackError::Unwritable { .. })));
            StagingFolder::create(&empty).unwrap();
        }
    }

    #[test]
    fn files_elsewhere_are_refused() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("dataset");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(place.path().join("secret"), "").unwrap();
        std::fs::write(folder.join("shard"), "").unwrap();
        let list = folder.join("manifest.jsonl");
        confined(&folder, "shard", &list).unwrap();
        for named in ["../secret", "/etc/passwd", "./shard", ""] {
            assert!(confined(&folder, named, &list).is_err(), "{named}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(place.path().join("secret"), folder.join("link")).unwrap();
            assert!(confined(&folder, "link", &list).is_err());
        }
    }
}
