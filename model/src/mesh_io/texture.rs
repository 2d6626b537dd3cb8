//! Colour textures of mesh files, decoded once per file.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::RgbaImage;

/// Decoded textures by path; a texture that cannot be read is noted once and left out.
#[derive(Default)]
pub struct TextureCache {
    textures: HashMap<PathBuf, Option<Arc<RgbaImage>>>,
    /// What could not be read, in the user's words.
    pub notes: Vec<String>,
}

impl TextureCache {
    /// The texture `name` of the file in `folder`. Separators of either kind are understood.
    pub fn get(&mut self, folder: &Path, name: &str) -> Option<Arc<RgbaImage>> {
        let path = folder.join(name.replace('\\', "/"));
        if let Some(known) = self.textures.get(&path) {
            return known.clone();
        }
        let texture = match decode_file(&path) {
            Ok(image) => Some(Arc::new(image)),
            Err(reason) => {
                self.notes.push(format!("texture {}: {reason}: left out", path.display()));
                None
            }
        };
        self.textures.insert(path, texture.clone());
        texture
    }
}

fn decode_file(path: &Path) -> Result<RgbaImage, String> {
    decode(&std::fs::read(path).map_err(|e| e.to_string())?)
}

/// Decodes an image of any supported format.
pub fn decode(bytes: &[u8]) -> Result<RgbaImage, String> {
    image::load_from_memory(bytes).map(|image| image.into_rgba8()).map_err(|e| e.to_string())
}
