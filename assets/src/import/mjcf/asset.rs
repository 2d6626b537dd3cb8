//! `<asset>`: meshes and materials.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use akrobat_model::mesh_io::{self, MeshCache};
use akrobat_model::{Material, ModelError, Pose, TriMesh};
use roxmltree::Node;

use super::orientation::{list, pose_of};
use super::{Compiler, Defaults};
use crate::import::xml::{children, error, numbers};
use crate::import::{Ledger, stem};

/// Meshes and materials by name.
#[derive(Debug, Clone, Default)]
pub struct Assets {
    /// Meshes, scaled.
    pub meshes: HashMap<String, (String, Arc<Vec<TriMesh>>)>,
    /// Materials.
    pub materials: HashMap<String, Material>,
}

impl Assets {
    /// Reads all `<asset>` sections.
    pub fn read(
        path: &Path,
        mujoco: Node,
        compiler: &Compiler,
        defaults: &Defaults,
        ledger: &mut Ledger,
    ) -> Result<Self, ModelError> {
        let mut assets = Self::default();
        let mut cache = MeshCache::default();
        let mut textures = HashMap::new();
        let elements =
            || children(mujoco, "asset").flat_map(|s| s.children()).filter(Node::is_element);
        for node in elements().filter(|n| n.has_tag_name("texture")) {
            let attributes = defaults.of(node, None);
            if let Some((name, image)) = texture(&attributes, compiler, ledger) {
                textures.insert(name, image);
            }
        }
        for node in elements() {
            let attributes = defaults.of(node, None);
            match node.tag_name().name() {
                "mesh" => assets.mesh(path, node, &attributes, compiler, &mut cache, ledger)?,
                "material" => {
                    let name = attributes.get("name").cloned().unwrap_or_default();
                    let material = material(&name, &attributes, &textures)
                        .map_err(|e| error(path, node, e))?;
                    assets.materials.insert(name, material);
                }
                "hfield" => ledger.lost(format!(
                    "height field \"{}\" is not taken over",
                    node.attribute("name").unwrap_or("")
                )),
                _ => {}
            }
        }
        cache.notes.into_iter().for_each(|note| ledger.repaired(note));
        Ok(assets)
    }

    fn mesh(
        &mut self,
        path: &Path,
        node: Node,
        attributes: &BTreeMap<String, String>,
        compiler: &Compiler,
        cache: &mut MeshCache,
        ledger: &mut Ledger,
    ) -> Result<(), ModelError> {
        let fail = |message: String| error(path, node, message);
        let scale = list::<3>(attributes, "scale").map_err(fail)?.unwrap_or([1.0; 3]);
        let Some(file) = attributes.get("file") else {
            let name = attributes.get("name").cloned().unwrap_or_default();
            match inline_mesh(attributes, scale).map_err(fail)? {
                Some(mesh) => {
                    self.meshes.insert(name.clone(), (name, Arc::new(vec![mesh])));
                }
                None => {
                    ledger.lost(format!("mesh \"{name}\" has no triangles: its hull is not made"))
                }
            }
            return Ok(());
        };
        let name = attributes.get("name").cloned().unwrap_or_else(|| stem(Path::new(file), "mesh"));
        let mesh_path = compiler.mesh_folder.join(file);
        if mesh_path.extension().is_some_and(|e| e.eq_ignore_ascii_case("msh")) {
            ledger.lost(format!("mesh \"{name}\": MuJoCo's binary format (.msh) is not read"));
            return Ok(());
        }
        let meshes = cache.get(&mesh_path, scale)?;
        let reference = BTreeMap::from_iter(
            [("refpos", "pos"), ("refquat", "quat")]
                .into_iter()
                .filter_map(|(from, to)| Some((to.to_owned(), attributes.get(from)?.clone()))),
        );
        let meshes = if reference.is_empty() {
            meshes
        } else {
            let back: Pose = pose_of(&reference, compiler).map_err(fail)?.inverse();
            Arc::new(mesh_io::placed(&meshes, &back))
        };
        self.meshes.insert(name, (file.clone(), meshes));
        Ok(())
    }
}

/// A mesh whose vertices and faces stand in the model.
fn inline_mesh(
    attributes: &BTreeMap<String, String>,
    scale: [f64; 3],
) -> Result<Option<TriMesh>, String> {
    let get = |name: &str| attributes.get(name).map(|text| numbers(text)).transpose();
    let (Some(vertices), Some(faces)) = (get("vertex")?, get("face")?) else { return Ok(None) };
    let positions: Vec<[f32; 3]> = vertices
        .chunks_exact(3)
        .map(|v| std::array::from_fn(|i| (v[i] * scale[i]) as f32))
        .collect();
    let triangles: Vec<[u32; 3]> =
        faces.chunks_exact(3).map(|f| std::array::from_fn(|i| f[i] as u32)).collect();
    match triangles.iter().flatten().find(|&&index| index as usize >= positions.len()) {
        Some(index) => Err(format!("face: vertex {index} is out of range")),
        None => Ok(Some(TriMesh { positions, triangles, ..TriMesh::default() })),
    }
}

/// A flat texture, or the colour of one that MuJoCo would draw itself.
enum Texture {
    Image(Arc<image::RgbaImage>),
    Color([f64; 3]),
}

fn texture(
    attributes: &BTreeMap<String, String>,
    compiler: &Compiler,
    ledger: &mut Ledger,
) -> Option<(String, Texture)> {
    if attributes.get("type").is_some_and(|kind| kind == "skybox") {
        return None;
    }
    let file = attributes.get("file");
    let name =
        attributes.get("name").cloned().or_else(|| file.map(|f| stem(Path::new(f), "texture")))?;
    if let Some(file) = file {
        let path: PathBuf = compiler.texture_folder.join(file);
        return match image::open(&path) {
            Ok(image) => Some((name, Texture::Image(Arc::new(image.into_rgba8())))),
            Err(e) => {
                ledger.lost(format!("texture \"{file}\": {e}"));
                None
            }
        };
    }
    let color = list::<3>(attributes, "rgb1").ok()?.unwrap_or([0.8; 3]);
    Some((name, Texture::Color(color)))
}

fn material(
    name: &str,
    attributes: &BTreeMap<String, String>,
    textures: &HashMap<String, Texture>,
) -> Result<Material, String> {
    let rgba = list::<4>(attributes, "rgba")?.unwrap_or([1.0; 4]);
    let mut material =
        Material { name: name.to_owned(), base_color: linear(rgba), ..Material::default() };
    match attributes.get("texture").and_then(|t| textures.get(t)) {
        Some(Texture::Image(image)) => material.base_color_texture = Some(image.clone()),
        Some(Texture::Color([r, g, b])) => {
            let [tr, tg, tb, alpha] = rgba;
            material.base_color = linear([r * tr, g * tg, b * tb, alpha]);
        }
        None => {}
    }
    if let Some([roughness]) = list(attributes, "roughness")? {
        material.roughness = if roughness >= 0.0 { roughness as f32 } else { material.roughness };
    }
    if let Some([metallic]) = list(attributes, "metallic")? {
        material.metallic = metallic.max(0.0) as f32;
    }
    Ok(material)
}

/// Colours as shown on a screen (IEC 61966-2-1) to linear ones.
pub fn linear(rgba: [f64; 4]) -> [f32; 4] {
    let channel = |c: f64| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    let [r, g, b, alpha] = rgba.map(|v| v.clamp(0.0, 1.0));
    [channel(r) as f32, channel(g) as f32, channel(b) as f32, alpha as f32]
}
