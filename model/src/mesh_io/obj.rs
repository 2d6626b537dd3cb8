//! Wavefront OBJ, with materials from MTL.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use super::MeshFile;
use super::assemble::{Assembler, Attributes, Corner};
use super::texture::TextureCache;
use crate::{Material, ModelError};

/// Reads an OBJ file's content; its material libraries and textures are looked up beside it. One mesh
/// per material. A missing library or texture is noted, not an error: collision meshes name libraries
/// that were never shipped all the time.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<MeshFile, ModelError> {
    let text = joined_lines(bytes);
    let mut reader = Reader::default();
    for (index, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or("").trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        reader
            .line(keyword, rest.trim())
            .map_err(|reason| ModelError::invalid(path, format!("line {}: {reason}", index + 1)))?;
    }
    Ok(reader.finish(path))
}

/// The text with continued lines joined; comments may be in any encoding.
fn joined_lines(bytes: &[u8]) -> Cow<'_, str> {
    let text = String::from_utf8_lossy(bytes);
    if text.contains("\\\n") || text.contains("\\\r\n") {
        return Cow::Owned(text.replace("\\\r\n", " ").replace("\\\n", " "));
    }
    text
}

#[derive(Default)]
struct Reader {
    positions: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    libraries: Vec<String>,
    /// Polygons by material, in order of first use.
    groups: Vec<(Option<String>, Assembler)>,
    group_of: HashMap<Option<String>, usize>,
    material: Option<String>,
}

impl Reader {
    fn line(&mut self, keyword: &str, rest: &str) -> Result<(), String> {
        match keyword {
            "v" => self.positions.push(numbers(rest, 3)?),
            "vt" => self.uvs.push(texture_coordinate(rest)?),
            "vn" => self.normals.push(numbers(rest, 3)?),
            "f" => self.face(rest)?,
            "usemtl" => self.material = Some(rest.to_owned()),
            "mtllib" => self.libraries.push(rest.to_owned()),
            _ => {}
        }
        Ok(())
    }

    fn face(&mut self, rest: &str) -> Result<(), String> {
        let corners: Vec<Corner> =
            rest.split_whitespace().map(|word| self.corner(word)).collect::<Result<_, _>>()?;
        if corners.len() < 3 {
            return Err(format!("a face needs at least 3 corners, got \"{rest}\""));
        }
        let group = *self.group_of.entry(self.material.clone()).or_insert_with(|| {
            self.groups.push((self.material.clone(), Assembler::default()));
            self.groups.len() - 1
        });
        let attributes =
            Attributes { positions: &self.positions, uvs: &self.uvs, normals: &self.normals };
        self.groups[group].1.polygon(&corners, &attributes);
        Ok(())
    }

    /// One of `v`, `v/vt`, `v//vn`, `v/vt/vn`.
    fn corner(&self, word: &str) -> Result<Corner, String> {
        let mut fields = word.split('/');
        let index = |field: Option<&str>, what, count| match field {
            None | Some("") => Ok(None),
            Some(field) => array_index(field, what, count).map(Some),
        };
        Ok(Corner {
            position: index(fields.next(), "vertex", self.positions.len())?
                .ok_or_else(|| format!("expected a corner such as 1/2/3, got \"{word}\""))?,
            uv: index(fields.next(), "texture coordinate", self.uvs.len())?,
            normal: index(fields.next(), "normal", self.normals.len())?,
        })
    }

    fn finish(self, path: &Path) -> MeshFile {
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut textures = TextureCache::default();
        let mut notes = Vec::new();
        let mut materials = HashMap::new();
        for library in &self.libraries {
            match std::fs::read(folder.join(library.replace('\\', "/"))) {
                Ok(bytes) => {
                    materials.extend(parse_mtl(&bytes, folder, library, &mut textures));
                }
                Err(e) => notes.push(format!(
                    "{}: material library \"{library}\" cannot be read ({e}): plain grey instead",
                    path.display()
                )),
            }
        }
        let meshes = self.groups.into_iter().filter_map(|(name, assembler)| {
            let mut mesh = assembler.finish()?;
            if let Some(name) = name {
                mesh.material = match materials.get(&name) {
                    Some(material) => material.clone(),
                    None => Material { name, ..Material::default() },
                };
            }
            Some(mesh)
        });
        let meshes = meshes.collect();
        notes.append(&mut textures.notes);
        MeshFile { meshes, notes }
    }
}

/// Exactly the first `N` numbers of a line; more may follow (weights, vertex colours).
fn numbers<const N: usize>(rest: &str, expected: usize) -> Result<[f32; N], String> {
    let values: Vec<f32> = rest.split_whitespace().take(N).map_while(|w| w.parse().ok()).collect();
    let values: [f32; N] =
        values.try_into().map_err(|_| format!("expected {expected} numbers, got \"{rest}\""))?;
    if values.iter().all(|v| v.is_finite()) {
        Ok(values)
    } else {
        Err(format!("expected {expected} finite numbers, got \"{rest}\""))
    }
}

/// `u [v [w]]`.
fn texture_coordinate(rest: &str) -> Result<[f32; 2], String> {
    let count = rest.split_whitespace().count();
    if count == 1 { numbers::<1>(rest, 1).map(|[u]| [u, 0.0]) } else { numbers(rest, 2) }
}

/// OBJ indices count from 1, or backwards from the latest element where negative.
fn array_index(field: &str, what: &str, count: usize) -> Result<usize, String> {
    let index: i64 = field.parse().map_err(|_| format!("expected an index, got \"{field}\""))?;
    let resolved = if index < 0 { count as i64 + index } else { index - 1 };
    if index == 0 || resolved < 0 || resolved >= count as i64 {
        return Err(format!("{what} index {index} is out of range: {count} defined so far"));
    }
    Ok(resolved as usize)
}

/// Materials of an MTL file by name.
fn parse_mtl(
    bytes: &[u8],
    folder: &Path,
    library: &str,
    textures: &mut TextureCache,
) -> HashMap<String, Material> {
    let library_folder = folder.join(library.replace('\\', "/"));
    let library_folder = library_folder.parent().unwrap_or(folder);
    let mut materials: HashMap<String, Material> = HashMap::new();
    let mut current = String::new();
    for line in String::from_utf8_lossy(bytes).lines() {
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            current = rest.to_owned();
            let base_color = [1.0; 4];
            let fresh = Material { name: current.clone(), base_color, ..Material::default() };
            materials.insert(current.clone(), fresh);
            continue;
        }
        let Some(material) = materials.get_mut(&current) else { continue };
        match keyword {
            "Kd" => {
                if let Ok([r, g, b]) = numbers(rest, 3) {
                    material.base_color = [r, g, b, material.base_color[3]];
                }
            }
            "d" => {
                if let Ok([alpha]) = numbers(rest, 1) {
                    material.base_color[3] = alpha;
                }
            }
            "Tr" => {
                if let Ok([transparency]) = numbers(rest, 1) {
                    material.base_color[3] = 1.0 - transparency;
                }
            }
            // Roughness of the Blinn-Phong exponent, as Blender and Karis 2013 relate them.
            "Ns" => {
                if let Ok([exponent]) = numbers(rest, 1) {
                    material.roughness = (2.0 / (exponent.max(0.0) + 2.0)).sqrt();
                }
            }
            "Pr" => {
                if let Ok([roughness]) = numbers(rest, 1) {
                    material.roughness = roughness.clamp(0.0, 1.0);
                }
            }
            "Pm" => {
                if let Ok([metallic]) = numbers(rest, 1) {
                    material.metallic = metallic.clamp(0.0, 1.0);
                }
            }
            "map_Kd" => material.base_color_texture = textures.get(library_folder, file_name(rest)),
            _ => {}
        }
    }
    // Exporters write a black Kd beside a texture that is meant to be seen as it is.
    for material in materials.values_mut() {
        if material.base_color_texture.is_some() && material.base_color[..3] == [0.0; 3] {
            material.base_color[..3].fill(1.0);
        }
    }
    materials
}

/// The file name behind a map's options (`-bm 1.0`, `-s 1 1 1`, `-clamp on`); it may hold spaces.
fn file_name(rest: &str) -> &str {
    let mut left = rest;
    while left.starts_with('-') {
        let Some((_, after)) = left.split_once(char::is_whitespace) else { return left };
        left = after.trim_start();
        while let Some((argument, after)) = left.split_once(char::is_whitespace) {
            if argument.parse::<f32>().is_err() && !matches!(argument, "on" | "off") {
                break;
            }
            left = after.trim_start();
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<MeshFile, ModelError> {
        parse(Path::new("test.obj"), text.as_bytes())
    }

    #[test]
    fn negative_indices_and_polygons() {
        let file = read("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n").unwrap();
        assert_eq!(file.meshes[0].triangles.len(), 2);
        assert_eq!(file.meshes[0].positions.len(), 4);
        assert!(file.meshes[0].normals.is_empty() && file.meshes[0].uvs.is_empty());
    }

    #[test]
    fn v_is_flipped_to_the_top_row() {
        let file = read("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt 0 0\nf 1/1 2/2 3/2\n").unwrap();
        assert_eq!(file.meshes[0].uvs, [[0.0, 0.0], [0.0, 1.0], [0.0, 1.0]]);
    }

    #[test]
    fn each_material_is_a_mesh() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a b\nf 1 2 3\nusemtl c\nf 3 2 1\nusemtl a b\nf 1 3 2\n";
        let file = read(text).unwrap();
        let names: Vec<&str> = file.meshes.iter().map(|m| m.material.name.as_str()).collect();
        assert_eq!(names, ["a b", "c"]);
        assert_eq!(file.meshes[0].triangles.len(), 2);
    }

    #[test]
    fn errors_name_file_and_line() {
        let message = read("v 0 0 0\nf 1 2 3\n").unwrap_err().to_string();
        assert!(message.contains("test.obj: line 2") && message.contains("index 2"), "{message}");
        let message = read("v 0 nan 0\n").unwrap_err().to_string();
        assert!(message.contains("line 1") && message.contains("finite"), "{message}");
    }

    #[test]
    fn map_options_are_skipped() {
        assert_eq!(file_name("-bm 1.000000 my textures/a.png"), "my textures/a.png");
        assert_eq!(file_name("-s 1 1 1 -clamp on a b.png"), "a b.png");
        assert_eq!(file_name("a.png"), "a.png");
    }
}
