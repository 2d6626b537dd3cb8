//! Meshes by file and scale, loaded once.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::MeshFile;
use crate::{ModelError, TriMesh};

/// Loads every mesh file once, however many parts use it.
#[derive(Default)]
pub struct MeshCache {
    files: BTreeMap<PathBuf, Arc<Vec<TriMesh>>>,
    scaled: HashMap<(PathBuf, [u64; 3]), Arc<Vec<TriMesh>>>,
    /// Notes of all loaded files, in the user's words.
    pub notes: Vec<String>,
}

impl MeshCache {
    /// The meshes of a file at a scale.
    ///
    /// # Errors
    /// As [`super::load`].
    pub fn get(&mut self, path: &Path, scale: [f64; 3]) -> Result<Arc<Vec<TriMesh>>, ModelError> {
        let meshes = match self.files.get(path) {
            Some(meshes) => meshes.clone(),
            None => {
                let MeshFile { meshes, notes } = super::load_with_notes(path)?;
                self.notes.extend(notes);
                let meshes = Arc::new(meshes);
                self.files.insert(path.to_path_buf(), meshes.clone());
                meshes
            }
        };
        if scale == [1.0; 3] {
            return Ok(meshes);
        }
        let key = (path.to_path_buf(), scale.map(f64::to_bits));
        let entry = self.scaled.entry(key);
        Ok(entry.or_insert_with(|| Arc::new(super::scaled(&meshes, scale))).clone())
    }

    /// The files loaded so far, sorted.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.keys().map(PathBuf::as_path)
    }
}
