//! `<link>` elements: visual and collision parts and their materials.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree::Node;

use super::resolve::resolve;
use super::xml::{Context, child, children, line_of, tag};
use super::{inertia, xml};
use crate::load::AssetSearch;
use crate::mesh_io::MeshCache;
use crate::{Link, Material, ModelError, Part, Shape, TriMesh};

/// Largest and smallest extent of a part that can be meant, metres.
const PLAUSIBLE_EXTENT_M: std::ops::RangeInclusive<f64> = 1e-5..=1000.0;
const SHAPES: [&str; 4] = ["box", "cylinder", "sphere", "mesh"];

/// Reads `<link>` elements of one file.
pub struct LinkReader<'a> {
    pub context: Context<'a>,
    pub search: &'a AssetSearch,
    pub cache: &'a mut MeshCache,
    /// Materials that the file defines for all links, by name.
    pub materials: HashMap<String, Material>,
    /// Resolved mesh files by the names that the URDF gives them.
    pub mesh_files: BTreeMap<String, PathBuf>,
    pub notes: Vec<String>,
}

impl LinkReader<'_> {
    fn folder(&self) -> &Path {
        self.context.path.parent().unwrap_or(Path::new(""))
    }

    /// Remembers the materials that stand directly under `<robot>`.
    pub fn global_materials(&mut self, robot: Node) -> Result<(), ModelError> {
        for node in children(robot, "material") {
            if let (Some(name), Some(material)) =
                (node.attribute("name"), self.defined_material(node)?)
            {
                self.materials.insert(name.to_owned(), material);
            }
        }
        Ok(())
    }

    /// Reads a `<link>`.
    pub fn link(&mut self, node: Node) -> Result<Link, ModelError> {
        let name = self.context.attribute(node, "name")?.to_owned();
        let parts = |reader: &mut Self, element: &'static str| {
            children(node, element).map(|part| reader.part(&name, part)).collect::<Result<_, _>>()
        };
        Ok(Link {
            visuals: parts(self, "visual")?,
            collisions: parts(self, "collision")?,
            inertial: inertia::read(self.context, node, &mut self.notes)?,
            name,
        })
    }

    fn part(&mut self, link: &str, node: Node) -> Result<Part, ModelError> {
        let geometry = self.context.child(node, "geometry")?;
        let Some(element) = geometry.children().find(Node::is_element) else {
            return Err(self.context.error(
                geometry,
                format!("<geometry> is empty; valid choices: {}", SHAPES.join(", ")),
            ));
        };
        let shape = self.shape(link, element)?;
        let extent = extent(&shape);
        if !PLAUSIBLE_EXTENT_M.contains(&extent) {
            return Err(self.context.error(
                element,
                format!(
                    "link \"{link}\": {} is {extent:.3e} m large; expected {:e} to {} m: is its scale wrong?",
                    describe(&shape),
                    PLAUSIBLE_EXTENT_M.start(),
                    PLAUSIBLE_EXTENT_M.end()
                ),
            ));
        }
        let name = node.attribute("name").filter(|n| !n.is_empty()).map(str::to_owned);
        Ok(Part {
            name: name.unwrap_or_else(|| default_name(&shape)),
            link_from_part: self.context.origin(node)?,
            shape,
            material: match child(node, "material") {
                Some(material) => self.material(material)?,
                None => None,
            },
        })
    }

    fn shape(&mut self, link: &str, node: Node) -> Result<Shape, ModelError> {
        let context = self.context;
        let positive = |name: &str| -> Result<f64, ModelError> {
            let value = context.required_number(node, name)?;
            if value > 0.0 {
                return Ok(value);
            }
            Err(context.error(
                node,
                format!("{} {name}: expected a length above 0, got {value}", tag(node)),
            ))
        };
        match node.tag_name().name() {
            "box" => {
                context.attribute(node, "size")?;
                let size: [f64; 3] = context.numbers(node, "size")?.unwrap_or_default();
                if size.iter().any(|&s| s <= 0.0) {
                    return Err(context.error(
                        node,
                        format!("<box size>: expected lengths above 0, got {size:?}"),
                    ));
                }
                Ok(Shape::Box { size })
            }
            "cylinder" => {
                Ok(Shape::Cylinder { radius: positive("radius")?, length: positive("length")? })
            }
            "sphere" => Ok(Shape::Sphere { radius: positive("radius")? }),
            "mesh" => self.mesh(link, node),
            other => Err(context.error(
                node,
                format!("unknown shape <{other}>; valid choices: {}", SHAPES.join(", ")),
            )),
        }
    }

    fn mesh(&mut self, link: &str, node: Node) -> Result<Shape, ModelError> {
        let source = self.context.attribute(node, "filename")?.to_owned();
        let path = resolve(&source, self.folder(), self.search).map_err(|tried| {
            let tried: Vec<String> = tried.iter().map(|p| p.display().to_string()).collect();
            self.context.error(
                node,
                format!(
                    "link \"{link}\": mesh \"{source}\" not found; tried: {}",
                    tried.join(", ")
                ),
            )
        })?;
        let scale = self.scale(link, node)?;
        let meshes =
            self.cache.get(&path, scale).map_err(|error| self.in_link(link, node, error))?;
        self.mesh_files.insert(source.clone(), path);
        Ok(Shape::Mesh { source, meshes })
    }

    fn scale(&self, link: &str, node: Node) -> Result<[f64; 3], ModelError> {
        let Some(text) = node.attribute("scale") else { return Ok([1.0; 3]) };
        let scale = if text.split_whitespace().count() == 1 {
            self.context.numbers::<1>(node, "scale")?.map(|[s]| [s; 3])
        } else {
            self.context.numbers::<3>(node, "scale")?
        };
        let scale = scale.unwrap_or([1.0; 3]);
        if scale.contains(&0.0) {
            return Err(self.context.error(
                node,
                format!("link \"{link}\": a mesh scale must not be zero, got \"{text}\""),
            ));
        }
        Ok(scale)
    }

    /// Says which link needed a mesh that is not whole.
    fn in_link(&self, link: &str, node: Node, error: ModelError) -> ModelError {
        let user = format!(
            "(mesh of link \"{link}\", line {} of {})",
            xml::line_of(node),
            self.context.path.display()
        );
        match error {
            ModelError::Invalid { path, message } => {
                ModelError::Invalid { path, message: format!("{message} {user}") }
            }
            other => other,
        }
    }

    /// The material that a part names or defines; one that is only named and unknown is noted.
    fn material(&mut self, node: Node) -> Result<Option<Material>, ModelError> {
        let name = node.attribute("name").unwrap_or("");
        if let Some(material) = self.defined_material(node)? {
            if !name.is_empty() {
                self.materials.entry(name.to_owned()).or_insert_with(|| material.clone());
            }
            return Ok(Some(material));
        }
        let known = self.materials.get(name).cloned();
        if known.is_none() && !name.is_empty() {
            let note = format!("line {}: material \"{name}\" is not defined", line_of(node));
            self.notes.push(note);
        }
        Ok(known)
    }

    /// The material that an element itself describes.
    fn defined_material(&mut self, node: Node) -> Result<Option<Material>, ModelError> {
        let rgba = match child(node, "color") {
            Some(color) => self.context.numbers::<4>(color, "rgba")?,
            None => None,
        };
        let texture = child(node, "texture").and_then(|t| t.attribute("filename"));
        let texture = texture.and_then(|filename| self.texture(filename));
        if rgba.is_none() && texture.is_none() {
            return Ok(None);
        }
        let [r, g, b, alpha] = rgba.unwrap_or([1.0; 4]);
        Ok(Some(Material {
            name: node.attribute("name").unwrap_or("inline").to_owned(),
            base_color: [linear(r), linear(g), linear(b), alpha.clamp(0.0, 1.0) as f32],
            base_color_texture: texture,
            ..Material::default()
        }))
    }

    fn texture(&mut self, filename: &str) -> Option<Arc<image::RgbaImage>> {
        let decoded = resolve(filename, self.folder(), self.search)
            .map_err(|_| "not found".to_owned())
            .and_then(|path| image::open(path).map_err(|e| e.to_string()));
        match decoded {
            Ok(image) => Some(Arc::new(image.into_rgba8())),
            Err(reason) => {
                self.notes.push(format!("texture \"{filename}\": {reason}: left out"));
                None
            }
        }
    }
}

/// URDF colours are meant as shown on a screen; materials are linear (IEC 61966-2-1).
fn linear(srgb: f64) -> f32 {
    let c = srgb.clamp(0.0, 1.0);
    (if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
}

fn default_name(shape: &Shape) -> String {
    match shape {
        Shape::Box { .. } => "box".into(),
        Shape::Cylinder { .. } => "cylinder".into(),
        Shape::Sphere { .. } => "sphere".into(),
        Shape::Mesh { source, .. } => {
            let stem = Path::new(source).file_stem().and_then(|s| s.to_str());
            stem.unwrap_or("mesh").to_owned()
        }
    }
}

fn describe(shape: &Shape) -> String {
    match shape {
        Shape::Mesh { source, .. } => format!("mesh \"{source}\""),
        other => default_name(other),
    }
}

/// Largest edge of a shape's bounding box, metres.
fn extent(shape: &Shape) -> f64 {
    match shape {
        Shape::Box { size } => size.iter().copied().fold(0.0, f64::max),
        Shape::Cylinder { radius, length } => length.max(2.0 * radius),
        Shape::Sphere { radius } => 2.0 * radius,
        Shape::Mesh { meshes, .. } => mesh_extent(meshes),
    }
}

fn mesh_extent(meshes: &[TriMesh]) -> f64 {
    let bounds = meshes.iter().filter_map(TriMesh::bounds).reduce(|(low, high), (l, h)| {
        (std::array::from_fn(|i| low[i].min(l[i])), std::array::from_fn(|i| high[i].max(h[i])))
    });
    bounds.map_or(0.0, |(low, high)| {
        (0..3).map(|i| f64::from(high[i]) - f64::from(low[i])).fold(0.0, f64::max)
    })
}
