//! Meshes out: Wavefront OBJ with MTL and PNG, which every other tool reads as well.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use akrobat_model::{Material, TriMesh};

use crate::error::{AssetError, write_file};

/// Writes meshes into one folder; textures that several meshes share are written once.
pub struct ObjWriter {
    folder: PathBuf,
    /// File names of textures by their address in memory; the images are kept so that addresses stay theirs.
    textures: HashMap<usize, (String, Arc<image::RgbaImage>)>,
}

impl ObjWriter {
    /// A writer into `folder`, which exists.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_path_buf(), textures: HashMap::new() }
    }

    /// Writes `<stem>.obj`, `<stem>.mtl` and the textures that no mesh before them had.
    pub fn write(&mut self, stem: &str, meshes: &[TriMesh]) -> Result<(), AssetError> {
        // Writing to a String cannot fail, here and below.
        let mut text = format!("mtllib {stem}.mtl\n");
        let mut library = String::new();
        let mut first = [1; 3];
        for (index, mesh) in meshes.iter().enumerate() {
            let material = format!("material_{index}");
            let texture = match &mesh.material.base_color_texture {
                Some(image) => Some(self.texture(image)?),
                None => None,
            };
            push_material(&mut library, &material, &mesh.material, texture.as_deref());
            let _ = writeln!(text, "usemtl {material}");
            push_mesh(&mut text, mesh, &mut first);
        }
        write_file(&self.folder.join(format!("{stem}.mtl")), library)?;
        write_file(&self.folder.join(format!("{stem}.obj")), text)
    }

    fn texture(&mut self, image: &Arc<image::RgbaImage>) -> Result<String, AssetError> {
        let address = Arc::as_ptr(image) as usize;
        if let Some((name, _)) = self.textures.get(&address) {
            return Ok(name.clone());
        }
        let name = format!("texture_{}.png", self.textures.len());
        let path = self.folder.join(&name);
        image.save(&path).map_err(|source| AssetError::Texture { path, source })?;
        self.textures.insert(address, (name.clone(), image.clone()));
        Ok(name)
    }
}

fn push_material(library: &mut String, name: &str, material: &Material, texture: Option<&str>) {
    let [r, g, b, alpha] = material.base_color;
    let _ = writeln!(
        library,
        "newmtl {name}\nKd {r} {g} {b}\nd {alpha}\nPm {}\nPr {}",
        material.metallic, material.roughness
    );
    if let Some(texture) = texture {
        let _ = writeln!(library, "map_Kd {texture}");
    }
}

/// Appends a mesh; `first` are the numbers of its first position, texture coordinate and normal.
fn push_mesh(text: &mut String, mesh: &TriMesh, first: &mut [usize; 3]) {
    for [x, y, z] in &mesh.positions {
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    // OBJ counts v from the bottom row.
    for [u, v] in &mesh.uvs {
        let _ = writeln!(text, "vt {u} {}", 1.0 - v);
    }
    for [x, y, z] in &mesh.normals {
        let _ = writeln!(text, "vn {x} {y} {z}");
    }
    let (has_uvs, has_normals) = (!mesh.uvs.is_empty(), !mesh.normals.is_empty());
    for triangle in &mesh.triangles {
        text.push('f');
        for &vertex in triangle {
            let [position, uv, normal] = first.map(|number| number + vertex as usize);
            let _ = match (has_uvs, has_normals) {
                (true, true) => write!(text, " {position}/{uv}/{normal}"),
                (true, false) => write!(text, " {position}/{uv}"),
                (false, true) => write!(text, " {position}//{normal}"),
                (false, false) => write!(text, " {position}"),
            };
        }
        text.push('\n');
    }
    first[0] += mesh.positions.len();
    first[1] += mesh.uvs.len();
    first[2] += mesh.normals.len();
}
