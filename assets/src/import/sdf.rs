//! SDF worlds and models, and Drake's model directives (`.dmd.yaml`) that place them.
//!
//! Poses are read as SDF 1.7 and later mean them: a link's in its model, a joint's in its child link,
//! unless `relative_to` says otherwise.

use std::path::{Path, PathBuf};

use akrobat_model::load::AssetSearch;
use akrobat_model::mesh_io::MeshCache;
use akrobat_model::pose::from_xyz_rpy;
use akrobat_model::{
    Joint, JointKind, KinematicTree, Link, Material, ModelError, Part, Pose, Shape,
};
use nalgebra::{Unit, Vector3};
use roxmltree::Node;

use super::layout::fixed;
use super::xml::{child, children, error, numbers, parse};
use super::{ImportedScene, Ledger, Origin, free_name, read_text, stem};

/// Deepest nesting of included models.
const DEEPEST_INCLUDE: usize = 16;

/// Reads a `.sdf`, `.world` or `.dmd.yaml` file as a scene.
///
/// # Errors
/// [`ModelError`] naming the file and the line.
pub fn read_scene(path: &Path, search: &AssetSearch) -> Result<ImportedScene, ModelError> {
    let mut reader = Reader {
        search,
        cache: MeshCache::default(),
        links: vec![Link { name: "world".into(), ..Link::default() }],
        joints: Vec::new(),
        ledger: Ledger::default(),
    };
    let is_directives = path.extension().is_some_and(|e| e == "yaml" || e == "yml");
    if is_directives {
        reader.directives(path)?;
    } else {
        reader.file(path, "", &Pose::identity(), DEEPEST_INCLUDE)?;
    }
    let Reader { links, joints, mut ledger, cache, .. } = reader;
    cache.notes.into_iter().for_each(|note| ledger.repaired(note));
    let name = stem(path, "scene").trim_end_matches(".dmd").to_owned();
    let tree = KinematicTree::new(name.clone(), links, joints)?;
    let origin = Origin { source: format!("SDF {name}"), license: String::new() };
    let (bodies, objects) = super::split::scene_of(&tree, &origin)?;
    Ok(ImportedScene { name, bodies, objects, origin, ledger })
}

struct Reader<'a> {
    search: &'a AssetSearch,
    cache: MeshCache,
    links: Vec<Link>,
    joints: Vec<Joint>,
    ledger: Ledger,
}

impl Reader<'_> {
    /// A file's world or models, at a pose in the world; `name` replaces its only model's where given.
    fn file(
        &mut self,
        path: &Path,
        name: &str,
        world_from_file: &Pose,
        depth: usize,
    ) -> Result<(), ModelError> {
        let text = read_text(path)?;
        let document = parse(path, &text)?;
        let sdf = document.root_element();
        if !sdf.has_tag_name("sdf") {
            let got = sdf.tag_name().name();
            return Err(ModelError::invalid(
                path,
                format!("expected an <sdf> root element, got <{got}>"),
            ));
        }
        for world in children(sdf, "world") {
            self.container(path, world, world_from_file, depth)?;
        }
        for model in children(sdf, "model") {
            self.model(path, model, name, world_from_file, depth)?;
        }
        Ok(())
    }

    /// The models and includes of a world, or those nested in a model.
    fn container(
        &mut self,
        path: &Path,
        node: Node,
        pose: &Pose,
        depth: usize,
    ) -> Result<(), ModelError> {
        for model in children(node, "model") {
            self.model(path, model, "", pose, depth)?;
        }
        for include in children(node, "include") {
            let uri = text_of(include, "uri");
            if depth == 0 {
                return Err(error(path, include, format!("\"{uri}\" includes itself")));
            }
            let Some(found) = self.find(path, uri).and_then(|p| model_file(&p)) else {
                self.ledger.lost(format!("included model \"{uri}\" was not found"));
                continue;
            };
            let placed = pose * pose_of(path, include)?;
            self.file(&found, text_of(include, "name"), &placed, depth - 1)?;
        }
        Ok(())
    }

    fn model(
        &mut self,
        path: &Path,
        node: Node,
        name: &str,
        world_from_parent: &Pose,
        depth: usize,
    ) -> Result<(), ModelError> {
        let own_name = node.attribute("name").unwrap_or("model");
        let name = if name.is_empty() { own_name } else { name };
        let world_from_model = world_from_parent * pose_of(path, node)?;
        let first = self.links.len();
        let mut placed: Vec<(String, usize, Pose)> = Vec::new();
        for link in children(node, "link") {
            let link_name = link.attribute("name").unwrap_or("link");
            let model_from_link = self.relative(path, link, &placed)?;
            let full_name =
                if link_name == name { name.to_owned() } else { format!("{name}_{link_name}") };
            let full_name = self.free_link_name(&full_name);
            let parts = Parts { path, link: &full_name };
            let visuals = self.parts(&parts, link, "visual")?;
            let collisions = self.parts(&parts, link, "collision")?;
            self.links.push(Link { name: full_name, visuals, collisions, inertial: None });
            placed.push((link_name.to_owned(), self.links.len() - 1, model_from_link));
        }
        let mut has_parent = vec![false; placed.len()];
        for joint in children(node, "joint") {
            if let Some(child) = self.joint(path, joint, name, &placed, &world_from_model)? {
                has_parent[child - first] = true;
            }
        }
        for ((_, link, model_from_link), _) in
            placed.iter().zip(has_parent).filter(|(_, has_parent)| !has_parent)
        {
            let joint = format!("{}_place", self.links[*link].name);
            self.joints.push(fixed(&joint, 0, *link, world_from_model * model_from_link));
        }
        self.container(path, node, &world_from_model, depth)
    }

    /// Pose of a link in its model.
    fn relative(
        &self,
        path: &Path,
        link: Node,
        placed: &[(String, usize, Pose)],
    ) -> Result<Pose, ModelError> {
        let own = pose_of(path, link)?;
        let frame = child(link, "pose").and_then(|p| p.attribute("relative_to")).unwrap_or("");
        if frame.is_empty() || frame == "__model__" {
            return Ok(own);
        }
        let found = placed.iter().find(|(name, ..)| name == frame);
        found.map(|(.., model_from_frame)| model_from_frame * own).ok_or_else(|| {
            let choices = placed.iter().map(|(name, ..)| name.clone());
            ModelError::unknown(path.display().to_string(), "frame", frame, choices)
        })
    }

    /// Adds a joint; gives the index of its child link, or none where the joint was lost.
    fn joint(
        &mut self,
        path: &Path,
        node: Node,
        model: &str,
        placed: &[(String, usize, Pose)],
        world_from_model: &Pose,
    ) -> Result<Option<usize>, ModelError> {
        let name = format!("{model}_{}", node.attribute("name").unwrap_or("joint"));
        let [parent, child_name] = ["parent", "child"].map(|tag| text_of(node, tag));
        let link = |name: &str| placed.iter().find(|(n, ..)| n == name);
        let Some(&(_, child_link, model_from_child)) = link(child_name) else {
            self.ledger.lost(format!(
                "joint \"{name}\": its child \"{child_name}\" is not a link of its model"
            ));
            return Ok(None);
        };
        let (parent_link, model_from_parent) = match link(parent) {
            Some(&(_, index, pose)) => (index, pose),
            None if parent == "world" => (0, world_from_model.inverse()),
            None => {
                self.ledger.lost(format!(
                    "joint \"{name}\": its parent \"{parent}\" is not a link of its model"
                ));
                return Ok(None);
            }
        };
        let kind = match node.attribute("type").unwrap_or("fixed") {
            "fixed" => JointKind::Fixed,
            "revolute" => JointKind::Revolute,
            "continuous" => JointKind::Continuous,
            "prismatic" => JointKind::Prismatic,
            other => {
                self.ledger.lost(format!("joint \"{name}\": type \"{other}\" is held still"));
                JointKind::Fixed
            }
        };
        let child_from_joint = pose_of(path, node)?;
        if child_from_joint.translation.vector.norm() > 1e-9 && kind != JointKind::Fixed {
            return self.anchored(
                path,
                node,
                name,
                kind,
                (parent_link, model_from_parent),
                (child_link, model_from_child),
                child_from_joint,
            );
        }
        let mut joint =
            fixed(&name, parent_link, child_link, model_from_parent.inverse() * model_from_child);
        self.motion(path, node, kind, &mut joint)?;
        self.joints.push(joint);
        Ok(Some(child_link))
    }

    /// A joint that does not pass through its child's origin gets a link of its own where it does.
    #[allow(
        clippy::too_many_arguments,
        reason = "two links with their poses, and a joint between them"
    )]
    fn anchored(
        &mut self,
        path: &Path,
        node: Node,
        name: String,
        kind: JointKind,
        (parent, model_from_parent): (usize, Pose),
        (child_link, model_from_child): (usize, Pose),
        child_from_joint: Pose,
    ) -> Result<Option<usize>, ModelError> {
        let anchor_name = self.free_link_name(&format!("{name}_anchor"));
        // The child's index must stay where the caller expects it, so the anchor goes last.
        self.links.push(Link { name: anchor_name, ..Link::default() });
        let anchor = self.links.len() - 1;
        let model_from_anchor = model_from_child * child_from_joint;
        let mut joint =
            fixed(&name, parent, anchor, model_from_parent.inverse() * model_from_anchor);
        self.motion(path, node, kind, &mut joint)?;
        self.joints.push(joint);
        let back = fixed(&format!("{name}_child"), anchor, child_link, child_from_joint.inverse());
        self.joints.push(back);
        Ok(Some(child_link))
    }

    /// Axis, limits and friction of a joint.
    fn motion(
        &mut self,
        path: &Path,
        node: Node,
        kind: JointKind,
        joint: &mut Joint,
    ) -> Result<(), ModelError> {
        joint.kind = kind;
        if kind == JointKind::Fixed {
            return Ok(());
        }
        let Some(axis) = child(node, "axis") else {
            return Err(error(path, node, "a joint that moves needs an <axis>"));
        };
        let xyz = numbers(text_or(axis, "xyz", "0 0 1")).map_err(|e| error(path, axis, e))?;
        let xyz =
            <[f64; 3]>::try_from(xyz).map_err(|_| error(path, axis, "xyz: expected 3 numbers"))?;
        joint.axis = Unit::try_new(Vector3::from(xyz), 1e-9)
            .ok_or_else(|| error(path, axis, "the axis has no direction"))?;
        let limit = child(axis, "limit");
        let bound = |tag: &str, fallback: f64| {
            limit
                .and_then(|l| text_of(l, tag).parse::<f64>().ok())
                .filter(|v| v.abs() < 1e15)
                .unwrap_or(fallback)
        };
        joint.limits = [bound("lower", f64::NEG_INFINITY), bound("upper", f64::INFINITY)];
        if joint.limits.iter().any(|l| l.is_infinite()) {
            if kind == JointKind::Prismatic {
                joint.limits = [-1.0, 1.0];
                self.ledger.repaired(format!(
                    "slide joint \"{}\" states no limits: 1 m either way assumed",
                    joint.name
                ));
            } else {
                joint.kind = JointKind::Continuous;
                joint.limits = [f64::NEG_INFINITY, f64::INFINITY];
            }
        }
        if let Some(dynamics) = child(axis, "dynamics") {
            joint.damping = text_or(dynamics, "damping", "0").parse().unwrap_or(0.0);
            joint.friction = text_or(dynamics, "friction", "0").parse().unwrap_or(0.0);
        }
        Ok(())
    }

    fn parts(&mut self, of: &Parts, link: Node, tag: &str) -> Result<Vec<Part>, ModelError> {
        let mut parts = Vec::new();
        for node in children(link, tag) {
            let name = node.attribute("name").unwrap_or(tag).to_owned();
            let Some(geometry) = child(node, "geometry") else { continue };
            let Some(element) = geometry.children().find(Node::is_element) else { continue };
            let Some((offset, shape)) = self.shape(of, element)? else { continue };
            parts.push(Part {
                name,
                link_from_part: pose_of(of.path, node)? * offset,
                material: child(node, "material").and_then(material),
                shape,
            });
        }
        Ok(parts)
    }

    fn shape(&mut self, of: &Parts, node: Node) -> Result<Option<(Pose, Shape)>, ModelError> {
        let number = |tag: &str| text_of(node, tag).parse::<f64>().ok().filter(|v| *v > 0.0);
        let needs = |tag: &str| {
            number(tag)
                .ok_or_else(|| error(of.path, node, format!("{tag}: expected a length above 0")))
        };
        let shape = match node.tag_name().name() {
            "box" => {
                let size = numbers(text_of(node, "size")).map_err(|e| error(of.path, node, e))?;
                let size = <[f64; 3]>::try_from(size)
                    .map_err(|_| error(of.path, node, "size: expected 3 numbers"))?;
                Shape::Box { size }
            }
            "sphere" => Shape::Sphere { radius: needs("radius")? },
            "cylinder" => Shape::Cylinder { radius: needs("radius")?, length: needs("length")? },
            "plane" => {
                let size = numbers(text_or(node, "size", "20 20")).unwrap_or_default();
                let edge = |i: usize| size.get(i).copied().filter(|s| *s > 0.0).unwrap_or(20.0);
                let shape = Shape::Box { size: [edge(0), edge(1), 0.02] };
                return Ok(Some((Pose::translation(0.0, 0.0, -0.01), shape)));
            }
            "mesh" => {
                let uri = text_of(node, "uri");
                let Some(path) = self.find(of.path, uri) else {
                    self.ledger.lost(format!("link \"{}\": mesh \"{uri}\" was not found", of.link));
                    return Ok(None);
                };
                let scale = numbers(text_or(node, "scale", "1 1 1"))
                    .map_err(|e| error(of.path, node, e))?;
                let scale = <[f64; 3]>::try_from(scale)
                    .map_err(|_| error(of.path, node, "scale: expected 3 numbers"))?;
                Shape::Mesh { source: uri.to_owned(), meshes: self.cache.get(&path, scale)? }
            }
            other => {
                self.ledger
                    .lost(format!("link \"{}\": shape <{other}> is not taken over", of.link));
                return Ok(None);
            }
        };
        Ok(Some((Pose::identity(), shape)))
    }

    /// The file that a URI means: a path, or one below a package or model whose folder is above the file, beside
    /// it, or in the search folders.
    fn find(&self, referrer: &Path, uri: &str) -> Option<PathBuf> {
        let rest = ["package://", "model://", "file://"]
            .iter()
            .find_map(|s| uri.strip_prefix(s))
            .unwrap_or(uri);
        let folder = std::path::absolute(referrer).ok()?.parent()?.to_path_buf();
        let roots: Vec<PathBuf> = folder
            .ancestors()
            .map(Path::to_path_buf)
            .chain(self.search.folders.iter().cloned())
            .collect();
        // Packages are often unpacked without their outer folders: leading ones may be missing.
        let parts: Vec<&str> = rest.split('/').collect();
        let tails = (0..parts.len()).map(|skip| parts[skip..].join("/"));
        let mut candidates = tails.flat_map(|tail| roots.iter().map(move |root| root.join(&tail)));
        candidates.find(|path| path.exists())
    }

    fn free_link_name(&self, wanted: &str) -> String {
        free_name(wanted, |name| self.links.iter().any(|l| l.name == name))
    }

    /// Drake's `add_model` and `add_weld`: models are welded to the world at `X_PC`.
    fn directives(&mut self, path: &Path) -> Result<(), ModelError> {
        let document: serde_yaml_ng::Value = serde_yaml_ng::from_str(&read_text(path)?)
            .map_err(|e| ModelError::invalid(path, format!("malformed YAML: {e}")))?;
        let Some(list) = document.get("directives").and_then(|d| d.as_sequence()) else {
            return Err(ModelError::invalid(path, "expected a list of `directives`"));
        };
        let text = |value: Option<&serde_yaml_ng::Value>| {
            value.and_then(|v| v.as_str()).unwrap_or("").to_owned()
        };
        let weld_of = |name: &str| {
            let welds = list.iter().filter_map(|d| d.get("add_weld"));
            let mut of_model =
                welds.filter(|w| text(w.get("child")).split("::").next() == Some(name));
            of_model.next()
        };
        for directive in list {
            let Some(model) = directive.get("add_model") else {
                if directive.get("add_weld").is_none() {
                    self.ledger.lost("a directive that neither adds nor welds a model");
                }
                continue;
            };
            let (name, file) = (text(model.get("name")), text(model.get("file")));
            let Some(found) = self.find(path, &file) else {
                self.ledger.lost(format!("model \"{name}\": file \"{file}\" was not found"));
                continue;
            };
            let pose =
                weld_of(&name).and_then(|w| w.get("X_PC")).map_or_else(Pose::identity, weld_pose);
            self.file(&found, &name, &pose, DEEPEST_INCLUDE)?;
        }
        Ok(())
    }
}

/// Whose parts are read.
struct Parts<'a> {
    path: &'a Path,
    link: &'a str,
}

/// A model's file: itself, or `model.sdf` in its folder.
fn model_file(path: &Path) -> Option<PathBuf> {
    let file = if path.is_dir() { path.join("model.sdf") } else { path.to_path_buf() };
    file.is_file().then_some(file)
}

fn text_of<'a>(node: Node<'a, '_>, tag: &str) -> &'a str {
    let found = node.children().find(|c| c.has_tag_name(tag));
    found.and_then(|n| n.text()).unwrap_or("").trim()
}

fn text_or<'a>(node: Node<'a, '_>, tag: &str, fallback: &'a str) -> &'a str {
    let text = text_of(node, tag);
    if text.is_empty() { fallback } else { text }
}

/// `<pose>`: x y z and roll, pitch, yaw, in radians or degrees.
fn pose_of(path: &Path, node: Node) -> Result<Pose, ModelError> {
    let Some(pose) = child(node, "pose") else { return Ok(Pose::identity()) };
    let text = pose.text().unwrap_or("").trim();
    if text.is_empty() {
        return Ok(Pose::identity());
    }
    let values = numbers(text).map_err(|e| error(path, pose, e))?;
    let [x, y, z, roll, pitch, yaw] = <[f64; 6]>::try_from(values)
        .map_err(|_| error(path, pose, format!("expected 6 numbers, got \"{text}\"")))?;
    let unit =
        if pose.attribute("degrees") == Some("true") { std::f64::consts::PI / 180.0 } else { 1.0 };
    Ok(from_xyz_rpy([x, y, z], [roll, pitch, yaw].map(|a| a * unit)))
}

/// `X_PC`: `translation` and `rotation: !Rpy { deg: [..] }`.
fn weld_pose(value: &serde_yaml_ng::Value) -> Pose {
    let triple = |value: Option<&serde_yaml_ng::Value>| -> [f64; 3] {
        let list = value.and_then(|v| v.as_sequence());
        std::array::from_fn(|i| list.and_then(|l| l.get(i)?.as_f64()).unwrap_or(0.0))
    };
    let rotation = match value.get("rotation") {
        Some(serde_yaml_ng::Value::Tagged(tagged)) => Some(&tagged.value),
        other => other,
    };
    let degrees = triple(rotation.and_then(|r| r.get("deg")));
    from_xyz_rpy(triple(value.get("translation")), degrees.map(f64::to_radians))
}

fn material(node: Node) -> Option<Material> {
    let text = text_of(node, "diffuse");
    let rgba = numbers(text).ok()?;
    let [r, g, b] = [rgba.first()?, rgba.get(1)?, rgba.get(2)?].map(|c| *c as f32);
    let alpha = rgba.get(3).copied().unwrap_or(1.0) as f32;
    Some(Material { name: "diffuse".into(), base_color: [r, g, b, alpha], ..Material::default() })
}
