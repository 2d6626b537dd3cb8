//! One hash for many files.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::{ModelError, hash};

/// SHA-256 over the names and contents of files, independent of where they lie.
pub fn of_files(files: &BTreeMap<String, PathBuf>) -> Result<String, ModelError> {
    let mut lines = String::new();
    for (name, path) in files {
        lines += &format!("{} {name}\n", hash::of_file(path)?);
    }
    Ok(hash::of_bytes(lines.as_bytes()))
}
