//! MuJoCo's MJCF: bodies, hinge and slide joints, geometry, defaults, includes and compiler settings.
//!
//! Every body becomes a link whose frame is MuJoCo's body frame, and joint positions are MuJoCo's `qpos`,
//! so poses can be compared number by number. A joint that is not anchored in its body's origin gets a
//! link of its own at the anchor.

use std::path::{Path, PathBuf};

use akrobat_model::tree::Mimic;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, ModelError, Pose};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use roxmltree::Node;

use super::layout::fixed;
use super::xml::{children, error, numbers, parse};
use super::{ImportedObject, ImportedScene, Ledger, Origin, classes, free_name, read_text, stem};

mod asset;
mod defaults;
mod geom;
mod orientation;

use asset::Assets;
use defaults::Defaults;

/// How far an unlimited slide may go either way, metres.
const UNLIMITED_SLIDE_M: f64 = 1.0;
/// Deepest nesting of included files.
const DEEPEST_INCLUDE: usize = 16;
/// Elements of the world that hold no bodies, joints or shapes.
const HARMLESS: [&str; 6] = ["site", "camera", "light", "inertial", "plugin", "key"];

/// `<compiler>`.
#[derive(Debug, Clone)]
pub(super) struct Compiler {
    /// Factor from the file's angles to radians.
    pub(super) angle: f64,
    pub(super) mesh_folder: PathBuf,
    pub(super) texture_folder: PathBuf,
    pub(super) euler_sequence: String,
    auto_limits: bool,
}

impl Compiler {
    /// Settings of all `<compiler>` elements; the last one that states something counts.
    fn read(folder: &Path, mujoco: Node) -> Self {
        let value =
            |name: &str| children(mujoco, "compiler").filter_map(|c| c.attribute(name)).last();
        let assets = value("assetdir").unwrap_or("");
        let below = |name: &str| folder.join(value(name).unwrap_or(assets));
        Self {
            angle: if value("angle") == Some("radian") {
                1.0
            } else {
                std::f64::consts::PI / 180.0
            },
            mesh_folder: below("meshdir"),
            texture_folder: below("texturedir"),
            euler_sequence: value("eulerseq").unwrap_or("xyz").to_owned(),
            auto_limits: value("autolimits") != Some("false"),
        }
    }
}

/// Reads a model as one tree: links are the bodies, the root is `world`.
///
/// # Errors
/// [`ModelError`] naming the file and the line.
pub fn read_tree(path: &Path) -> Result<(KinematicTree, Ledger), ModelError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let text = with_includes(path, folder, DEEPEST_INCLUDE)?;
    let document = parse(path, &text)?;
    let mujoco = document.root_element();
    if !mujoco.has_tag_name("mujoco") {
        let got = mujoco.tag_name().name();
        return Err(ModelError::invalid(
            path,
            format!("expected a <mujoco> root element, got <{got}>"),
        ));
    }
    let compiler = Compiler::read(folder, mujoco);
    let defaults = Defaults::read(mujoco);
    let mut ledger = Ledger::default();
    let assets = Assets::read(path, mujoco, &compiler, &defaults, &mut ledger)?;
    let mut reader = Reader {
        path,
        compiler,
        defaults,
        assets,
        links: vec![Link { name: "world".into(), ..Link::default() }],
        joints: Vec::new(),
        ledger,
    };
    for world in children(mujoco, "worldbody") {
        reader.content(world, 0, &Pose::identity(), None)?;
    }
    for section in children(mujoco, "equality") {
        reader.equalities(section);
    }
    for (section, what) in [("tendon", "tendons"), ("deformable", "deformable bodies")] {
        if children(mujoco, section).any(|s| s.has_children()) {
            reader.ledger.lost(format!("{what} are not taken over"));
        }
    }
    let name = mujoco.attribute("model").map_or_else(|| stem(path, "model"), str::to_owned);
    let Reader { links, joints, ledger, .. } = reader;
    Ok((KinematicTree::new(name, links, joints)?, ledger))
}

/// Reads a model as an object.
///
/// # Errors
/// As [`read_tree`].
pub fn read_object(path: &Path, class: Option<&str>) -> Result<ImportedObject, ModelError> {
    let (tree, ledger) = read_tree(path)?;
    let name = stem(path, "object");
    let class = class.map_or_else(|| classes::of_file_name(&name), classes::canonical);
    let origin = origin(path);
    Ok(ImportedObject { name, class, tree, origin, semantics: Vec::new(), ledger })
}

/// Reads a model as a scene: bodies below the world that have joints are objects of their own.
///
/// # Errors
/// As [`read_tree`].
pub fn read_scene(path: &Path) -> Result<ImportedScene, ModelError> {
    let (tree, ledger) = read_tree(path)?;
    let (bodies, objects) = super::split::scene_of(&tree, &origin(path))?;
    Ok(ImportedScene { name: stem(path, "scene"), bodies, objects, origin: origin(path), ledger })
}

/// True where a model is a room rather than a thing: it has more than one body below its world.
///
/// # Errors
/// As [`read_tree`].
pub fn is_scene(path: &Path) -> Result<bool, ModelError> {
    let (tree, _) = read_tree(path)?;
    let root = tree.root();
    Ok(tree.joints().iter().filter(|j| j.parent == root).count() > 1)
}

fn origin(path: &Path) -> Origin {
    Origin { source: format!("MJCF {}", stem(path, "model")), license: String::new() }
}

/// The text of a model with its includes in place.
fn with_includes(path: &Path, folder: &Path, depth: usize) -> Result<String, ModelError> {
    let text = read_text(path)?;
    let mut edits = Vec::new();
    {
        let document = parse(path, &text)?;
        for include in document.descendants().filter(|n| n.has_tag_name("include")) {
            let Some(file) = include.attribute("file") else {
                return Err(error(path, include, "lacks the attribute \"file\""));
            };
            if depth == 0 {
                return Err(error(path, include, format!("\"{file}\" includes itself")));
            }
            let included = [folder, path.parent().unwrap_or(folder)]
                .map(|f| f.join(file))
                .into_iter()
                .find(|f| f.is_file())
                .ok_or_else(|| error(path, include, format!("file \"{file}\" not found")))?;
            let inner = with_includes(&included, folder, depth - 1)?;
            edits.push((include.range(), inner_xml(&included, &inner)?));
        }
    }
    let mut text = text;
    for (range, replacement) in edits.into_iter().rev() {
        text.replace_range(range, &replacement);
    }
    Ok(text)
}

/// What stands between the root element's tags.
fn inner_xml(path: &Path, text: &str) -> Result<String, ModelError> {
    let document = parse(path, text)?;
    let root = document.root_element();
    let (first, last) = (root.first_child(), root.last_child());
    Ok(match (first, last) {
        (Some(first), Some(last)) => text[first.range().start..last.range().end].to_owned(),
        _ => String::new(),
    })
}

struct Reader<'a> {
    path: &'a Path,
    compiler: Compiler,
    defaults: Defaults,
    assets: Assets,
    links: Vec<Link>,
    joints: Vec<Joint>,
    ledger: Ledger,
}

impl Reader<'_> {
    /// What a body, the world or a `<frame>` holds. `link_from_frame` is the frame's pose in the link.
    fn content(
        &mut self,
        node: Node,
        link: usize,
        link_from_frame: &Pose,
        class: Option<&str>,
    ) -> Result<(), ModelError> {
        let mut geoms = Vec::new();
        for child in node.children().filter(Node::is_element) {
            match child.tag_name().name() {
                "geom" => geoms.extend(self.geom(child, link_from_frame, class)?),
                "body" => self.body(child, link, link_from_frame, class)?,
                "frame" => {
                    let pose =
                        link_from_frame * orientation::pose(self.path, child, &self.compiler)?;
                    let class = child.attribute("childclass").or(class);
                    self.content(child, link, &pose, class)?;
                }
                "joint" | "freejoint" => {}
                name if HARMLESS.contains(&name) => {}
                name => {
                    let of = node.attribute("name").unwrap_or("world");
                    self.ledger.lost(format!("<{name}> of \"{of}\" is not taken over"));
                }
            }
        }
        geom::share_out(geoms, &mut self.links[link]);
        Ok(())
    }

    fn geom(
        &mut self,
        node: Node,
        link_from_frame: &Pose,
        class: Option<&str>,
    ) -> Result<Vec<geom::Geom>, ModelError> {
        let attributes = self.defaults.of(node, class);
        let mut found = geom::read(
            self.path,
            node,
            &attributes,
            &self.compiler,
            &self.assets,
            &mut self.ledger,
        )?;
        for geom in &mut found {
            geom.part.link_from_part = link_from_frame * geom.part.link_from_part;
        }
        Ok(found)
    }

    fn body(
        &mut self,
        node: Node,
        parent: usize,
        parent_from_frame: &Pose,
        class: Option<&str>,
    ) -> Result<(), ModelError> {
        let class = node.attribute("childclass").or(class);
        let unnamed = format!("body_{}", self.links.len());
        let name = self.free_link_name(node.attribute("name").unwrap_or(&unnamed));
        let parent_from_body =
            parent_from_frame * orientation::pose(self.path, node, &self.compiler)?;
        let free = children(node, "freejoint").next().is_some();
        let mut joints = Vec::new();
        for joint in children(node, "joint") {
            joints.extend(self.joint(joint, class, &name)?);
        }
        if free {
            self.ledger.repaired(format!("body \"{name}\": stands still instead of flying freely"));
        }
        // Each joint takes its anchor's frame to the next one's; the last fixed step leads to the body.
        let mut at = parent;
        let mut at_from_body = parent_from_body;
        let count = joints.len();
        for (index, (mut joint, anchor)) in joints.into_iter().enumerate() {
            let body_from_anchor = Pose::translation(anchor.x, anchor.y, anchor.z);
            let is_last = index + 1 == count && anchor.norm() < 1e-12;
            let link_name = if is_last {
                name.clone()
            } else {
                self.free_link_name(&format!("{}_anchor", joint.name))
            };
            self.links.push(Link { name: link_name, ..Link::default() });
            joint.parent = at;
            joint.child = self.links.len() - 1;
            joint.parent_from_joint = at_from_body * body_from_anchor * joint.parent_from_joint;
            at = joint.child;
            at_from_body = body_from_anchor.inverse();
            self.joints.push(joint);
            if is_last {
                return self.content(node, at, &Pose::identity(), class);
            }
        }
        self.links.push(Link { name: name.clone(), ..Link::default() });
        let link = self.links.len() - 1;
        self.joints.push(fixed(&format!("{name}_fixed"), at, link, at_from_body));
        self.content(node, link, &Pose::identity(), class)
    }

    /// A joint and its anchor in the body's frame; its `parent_from_joint` turns or moves back by `ref`.
    fn joint(
        &mut self,
        node: Node,
        class: Option<&str>,
        body: &str,
    ) -> Result<Option<(Joint, Vector3<f64>)>, ModelError> {
        let attributes = self.defaults.of(node, class);
        let get = |name: &str| attributes.get(name).map(String::as_str);
        let list = |name: &str, fallback: &[f64]| match get(name) {
            Some(text) => numbers(text).map_err(|e| error(self.path, node, format!("{name}: {e}"))),
            None => Ok(fallback.to_vec()),
        };
        let name = node
            .attribute("name")
            .map_or_else(|| format!("{body}_joint_{}", self.joints.len()), str::to_owned);
        let slides = match get("type").unwrap_or("hinge") {
            "hinge" => false,
            "slide" => true,
            "free" => {
                self.ledger
                    .repaired(format!("body \"{body}\": stands still instead of flying freely"));
                return Ok(None);
            }
            other => {
                self.ledger.lost(format!("joint \"{name}\": type \"{other}\" is held still"));
                return Ok(None);
            }
        };
        let unit = if slides { 1.0 } else { self.compiler.angle };
        let triple = |values: Vec<f64>| <[f64; 3]>::try_from(values).map(Vector3::from).ok();
        let wrong = |what: &str| error(self.path, node, format!("{what}: expected 3 numbers"));
        let axis = triple(list("axis", &[0.0, 0.0, 1.0])?).ok_or_else(|| wrong("axis"))?;
        let anchor = triple(list("pos", &[0.0; 3])?).ok_or_else(|| wrong("pos"))?;
        let axis = Unit::try_new(axis, 1e-9)
            .ok_or_else(|| error(self.path, node, "the axis has no direction"))?;
        let range = list("range", &[])?;
        let limited = match get("limited").unwrap_or("auto") {
            "true" => true,
            "false" => false,
            _ => self.compiler.auto_limits && range.len() == 2,
        };
        let (kind, limits) = match (slides, limited, &range[..]) {
            (_, true, &[lower, upper]) if lower <= upper => {
                let kind = if slides { JointKind::Prismatic } else { JointKind::Revolute };
                (kind, [lower * unit, upper * unit])
            }
            (_, true, _) => {
                return Err(error(
                    self.path,
                    node,
                    format!("range: expected lower and upper, got {range:?}"),
                ));
            }
            (false, false, _) => (JointKind::Continuous, [f64::NEG_INFINITY, f64::INFINITY]),
            (true, false, _) => {
                self.ledger.repaired(format!(
                    "slide joint \"{name}\" states no range: {UNLIMITED_SLIDE_M} m either way assumed"
                ));
                (JointKind::Prismatic, [-UNLIMITED_SLIDE_M, UNLIMITED_SLIDE_M])
            }
        };
        let one =
            |name: &str| Ok::<f64, ModelError>(list(name, &[0.0])?.first().copied().unwrap_or(0.0));
        let reference = one("ref")? * unit;
        let back = if slides {
            let shift = axis.into_inner() * -reference;
            Pose::translation(shift.x, shift.y, shift.z)
        } else {
            let turn = UnitQuaternion::from_axis_angle(&axis, -reference);
            Pose::from_parts(Vector3::zeros().into(), turn)
        };
        let joint = Joint {
            kind,
            limits,
            axis,
            parent_from_joint: back,
            damping: one("damping")?,
            friction: one("frictionloss")?,
            ..fixed(&name, 0, 0, Pose::identity())
        };
        Ok(Some((joint, anchor)))
    }

    /// Couplings of two joints that are straight lines become mimics; others are lost.
    fn equalities(&mut self, section: Node) {
        for node in section.children().filter(Node::is_element) {
            let [name, other] = ["joint1", "joint2"].map(|a| node.attribute(a).unwrap_or(""));
            let index = |name: &str| self.joints.iter().position(|j| j.name == name);
            let coefficients = node.attribute("polycoef").map_or(Ok(vec![0.0, 1.0]), numbers);
            let coupling =
                match (node.has_tag_name("joint"), index(name), index(other), coefficients) {
                    (true, Some(joint), Some(followed), Ok(c))
                        if c.iter().skip(2).all(|&v| v == 0.0) =>
                    {
                        let at = |i: usize| c.get(i).copied().unwrap_or(0.0);
                        Some((joint, Mimic { joint: followed, multiplier: at(1), offset: at(0) }))
                    }
                    _ => None,
                };
            match coupling {
                Some((joint, mimic)) => self.joints[joint].mimic = Some(mimic),
                None => {
                    let what = node.tag_name().name();
                    self.ledger.lost(format!("equality <{what}> \"{name}\" is not taken over"));
                }
            }
        }
    }

    fn free_link_name(&self, wanted: &str) -> String {
        free_name(wanted, |name| self.links.iter().any(|l| l.name == name))
    }
}
