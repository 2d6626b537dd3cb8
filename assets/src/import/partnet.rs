//! PartNet-Mobility folders as they are downloaded.
//!
//! A folder holds `mobility.urdf`, `textured_objs/`, and mostly `semantics.txt`, `meta.json` and
//! `mobility_v2.json`. Objects are scaled to a unit bounding volume, some joints lack limits, doors may
//! turn without end, and a link can be hundreds of OBJ files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use akrobat_model::load::AssetSearch;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, ModelError, Part, Pose, Shape, urdf};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::Value;

use super::layout::{fixed, tree_bounds};
use super::xml::{child, children, error, numbers, parse};
use super::{ImportedObject, Ledger, LinkSemantics, Origin, classes, read_text};

/// How far a hinge or a slide without any stated limit is let go, rad and fraction of the object's size.
const DEFAULT_HINGE: f64 = std::f64::consts::FRAC_PI_2;
const DEFAULT_SLIDE: f64 = 0.3;

/// How large an object is to be.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Size {
    /// As usual for its class.
    #[default]
    OfClass,
    /// This factor of what the file says.
    Scale(f64),
    /// This height, metres.
    Height(f64),
}

/// Reads a folder. `class` overrides what `meta.json` says.
///
/// # Errors
/// [`ModelError`] where the folder is not of that kind, the URDF is broken beyond the known quirks, or no
/// size is known for the class.
pub fn read(folder: &Path, class: Option<&str>, size: Size) -> Result<ImportedObject, ModelError> {
    let path = folder.join("mobility.urdf");
    let mut ledger = Ledger::default();
    let labels = semantics(folder)?;
    let stated = mobility_limits(folder);
    let text = read_text(&path)?;
    let repaired = repaired_text(&path, &text, &labels, &stated, &mut ledger)?;
    let tree = load_text(folder, &repaired, &mut ledger)?;
    let class =
        classes::canonical(&class.map(str::to_owned).or_else(|| category(folder)).ok_or_else(
            || ModelError::invalid(folder, "meta.json names no class: give one with --class"),
        )?);
    let identity = folder.file_name().and_then(|n| n.to_str()).unwrap_or("object").to_owned();
    let tree = upright(tree, &mut ledger);
    let tree = without_empty_ranges(tree, &mut ledger)?;
    let tree = sized(folder, tree, &class, size, &mut ledger)?;
    let tree = merged(tree, &mut ledger)?;
    let tree = grounded(tree, &mut ledger)?;
    let semantics = tree.links().iter().filter_map(|link| {
        let label = labels.get(&link.name)?.1.clone();
        let parts = link.visuals.iter().map(|part| part.name.clone());
        let handle_parts = parts.filter(|name| name.contains("handle")).collect();
        Some(LinkSemantics { link: link.name.clone(), label, handle_parts })
    });
    Ok(ImportedObject {
        name: format!("{class}_{identity}"),
        class,
        semantics: semantics.collect(),
        origin: Origin {
            source: format!("PartNet-Mobility {identity}"),
            license: "LicenseRef-PartNet-Mobility-NonCommercial".into(),
        },
        tree,
        ledger,
    })
}

/// Joint type and label of each link, from `semantics.txt`: `link_0 hinge door`.
fn semantics(folder: &Path) -> Result<BTreeMap<String, (String, String)>, ModelError> {
    let path = folder.join("semantics.txt");
    if !path.is_file() {
        return Ok(BTreeMap::new());
    }
    let text = read_text(&path)?;
    let entry = |line: &str| {
        let mut words = line.split_whitespace().map(str::to_owned);
        Some((words.next()?, (words.next()?, words.next()?)))
    };
    Ok(text.lines().filter_map(entry).collect())
}

/// `model_cat` of `meta.json`.
fn category(folder: &Path) -> Option<String> {
    let meta: Value = serde_json::from_str(&read_text(&folder.join("meta.json")).ok()?).ok()?;
    Some(meta["model_cat"].as_str()?.to_owned())
}

/// Limits that `mobility_v2.json` states, by link: hinges in degrees there, slides as they are.
fn mobility_limits(folder: &Path) -> BTreeMap<String, [f64; 2]> {
    let text = read_text(&folder.join("mobility_v2.json")).unwrap_or_default();
    let Ok(Value::Array(entries)) = serde_json::from_str(&text) else { return BTreeMap::new() };
    let limits = |entry: &Value| {
        let limit = &entry["jointData"]["limit"];
        if limit["noLimit"].as_bool() == Some(true) {
            return None;
        }
        let (a, b) = (limit["a"].as_f64()?, limit["b"].as_f64()?);
        let unit = if entry["joint"] == "hinge" { std::f64::consts::PI / 180.0 } else { 1.0 };
        Some((format!("link_{}", entry["id"].as_i64()?), [a.min(b) * unit, a.max(b) * unit]))
    };
    entries.iter().filter_map(limits).collect()
}

/// A change of a text: a byte range and what stands there instead.
type Edit = (std::ops::Range<usize>, String);

/// The URDF's text with limits where there were none, in their order, and without missing meshes.
fn repaired_text(
    path: &Path,
    text: &str,
    labels: &BTreeMap<String, (String, String)>,
    stated: &BTreeMap<String, [f64; 2]>,
    ledger: &mut Ledger,
) -> Result<String, ModelError> {
    let document = parse(path, text)?;
    let robot = document.root_element();
    let mut edits: Vec<Edit> = Vec::new();
    for joint in children(robot, "joint") {
        edits.extend(joint_edits(path, joint, labels, stated, ledger)?);
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    for link in children(robot, "link") {
        let name = link.attribute("name").unwrap_or("");
        for part in
            link.children().filter(|n| n.has_tag_name("visual") || n.has_tag_name("collision"))
        {
            let mesh = part.descendants().find(|n| n.has_tag_name("mesh"));
            let Some(file) = mesh.and_then(|m| m.attribute("filename")) else { continue };
            if !folder.join(file).is_file() {
                ledger.lost(format!(
                    "link \"{name}\": {} \"{file}\" is not in the folder",
                    part.tag_name().name()
                ));
                edits.push((part.range(), String::new()));
            }
        }
    }
    edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
    let mut repaired = text.to_owned();
    for (range, replacement) in edits {
        repaired.replace_range(range, &replacement);
    }
    Ok(repaired)
}

/// What has to change about a joint.
fn joint_edits(
    path: &Path,
    joint: roxmltree::Node,
    labels: &BTreeMap<String, (String, String)>,
    stated: &BTreeMap<String, [f64; 2]>,
    ledger: &mut Ledger,
) -> Result<Vec<Edit>, ModelError> {
    let name = joint.attribute("name").unwrap_or("");
    let kind = joint.attribute("type").unwrap_or("");
    let child_link = child(joint, "child").and_then(|c| c.attribute("link")).unwrap_or("");
    let limit = child(joint, "limit");
    let value = |attribute: &str| -> Result<Option<f64>, ModelError> {
        let Some(limit) = limit else { return Ok(None) };
        let Some(text) = limit.attribute(attribute) else { return Ok(None) };
        match numbers(text).map_err(|e| error(path, limit, e))?[..] {
            [value] => Ok(Some(value)),
            _ => {
                Err(error(path, limit, format!("{attribute}: expected one number, got \"{text}\"")))
            }
        }
    };
    let is_door = labels.get(child_link).is_some_and(|(_, label)| label.contains("door"));
    let turns_without_end = kind == "continuous" && is_door;
    if !matches!(kind, "revolute" | "prismatic") && !turns_without_end {
        return Ok(Vec::new());
    }
    let mut edits = Vec::new();
    if turns_without_end {
        let tag = &joint.document().input_text()[joint.range()];
        let start = joint.range().start;
        let at = tag.find("continuous").map(|offset| start + offset).unwrap_or(start);
        edits.push((at..at + "continuous".len(), "revolute".to_owned()));
        ledger.repaired(format!("joint \"{name}\": a door that turned without end has limits"));
    }
    let found = if turns_without_end { (None, None) } else { (value("lower")?, value("upper")?) };
    let limits = match found {
        (Some(lower), Some(upper)) if lower <= upper => return Ok(edits),
        (Some(lower), Some(upper)) => {
            ledger.repaired(format!("joint \"{name}\": limits {lower} to {upper} put in order"));
            [upper, lower]
        }
        _ => match stated.get(child_link) {
            Some(limits) => {
                ledger.repaired(format!("joint \"{name}\": limits taken from mobility_v2.json"));
                *limits
            }
            None => {
                let upper = if kind == "prismatic" { DEFAULT_SLIDE } else { DEFAULT_HINGE };
                ledger
                    .repaired(format!("joint \"{name}\": states no limits; 0 to {upper} assumed"));
                [0.0, upper]
            }
        },
    };
    let text = format!("<limit lower=\"{}\" upper=\"{}\"/>", limits[0], limits[1]);
    match limit {
        Some(limit) => edits.push((limit.range(), text)),
        None => {
            let end = joint.range().end - "</joint>".len();
            edits.push((end..end, text));
        }
    }
    Ok(edits)
}

/// Loads a URDF text whose meshes lie in `folder`.
fn load_text(folder: &Path, text: &str, ledger: &mut Ledger) -> Result<KinematicTree, ModelError> {
    let scratch = tempfile::tempdir().map_err(|e| ModelError::read(folder, e))?;
    let path = scratch.path().join("mobility.urdf");
    std::fs::write(&path, text).map_err(|e| ModelError::read(&path, e))?;
    let absolute: PathBuf = std::path::absolute(folder).map_err(|e| ModelError::read(folder, e))?;
    let (tree, notes) = urdf::read(&path, &AssetSearch { folders: vec![absolute] })?;
    notes.into_iter().for_each(|note| ledger.repaired(note));
    Ok(tree)
}

/// The tree turned so that its front, which the collection has along -x, is along +x.
fn upright(tree: KinematicTree, ledger: &mut Ledger) -> KinematicTree {
    ledger.repaired("turned by half a turn: its front faces +x".to_owned());
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    on_root(tree, Pose::from_parts(Vector3::zeros().into(), turn))
}

/// The tree with its root moved: what hangs from the root, and the root's own parts, lie elsewhere in it.
fn on_root(tree: KinematicTree, root_from_old: Pose) -> KinematicTree {
    let (mut links, mut joints) = (tree.links().to_vec(), tree.joints().to_vec());
    let root = tree.root();
    let link = &mut links[root];
    for part in link.visuals.iter_mut().chain(&mut link.collisions) {
        part.link_from_part = root_from_old * part.link_from_part;
    }
    if let Some(inertial) = &mut link.inertial {
        inertial.link_from_inertia = root_from_old * inertial.link_from_inertia;
    }
    for joint in joints.iter_mut().filter(|j| j.parent == root) {
        joint.parent_from_joint = root_from_old * joint.parent_from_joint;
    }
    KinematicTree::new(tree.name.clone(), links, joints)
        .expect("moving a root changes no link or joint names")
}

/// The tree without joints that cannot move: those whose range is empty become fixed.
fn without_empty_ranges(
    tree: KinematicTree,
    ledger: &mut Ledger,
) -> Result<KinematicTree, ModelError> {
    let still = |joint: &Joint| {
        matches!(joint.kind, JointKind::Revolute | JointKind::Prismatic)
            && joint.limits[1] - joint.limits[0] < 1e-6
    };
    let mut joints = tree.joints().to_vec();
    for joint in joints.iter_mut().filter(|j| still(j)) {
        ledger.repaired(format!("joint \"{}\": its range is empty, so it is fixed", joint.name));
        joint.kind = JointKind::Fixed;
    }
    KinematicTree::new(tree.name.clone(), tree.links().to_vec(), joints)
}

/// The tree in its true size.
fn sized(
    folder: &Path,
    tree: KinematicTree,
    class: &str,
    size: Size,
    ledger: &mut Ledger,
) -> Result<KinematicTree, ModelError> {
    let bounds = tree_bounds(&tree);
    let height = bounds.map_or(0.0, |(low, high)| high.z - low.z);
    let wanted = match size {
        Size::Scale(scale) => scale * height,
        Size::Height(height_m) => height_m,
        Size::OfClass => classes::height_m(class).ok_or_else(|| {
            ModelError::invalid(
                folder,
                format!("no usual size is known for class \"{class}\": give --height or --scale"),
            )
        })?,
    };
    let scale = wanted / height;
    if !(scale.is_finite() && scale > 0.0) {
        let message = format!("the object is {height} m high and cannot be scaled to {wanted} m");
        return Err(ModelError::invalid(folder, message));
    }
    ledger.repaired(format!("scaled by {scale:.4}: {wanted:.3} m high"));
    Ok(tree.scaled(scale))
}

/// The tree with the parts of one name in a link as one mesh.
fn merged(tree: KinematicTree, ledger: &mut Ledger) -> Result<KinematicTree, ModelError> {
    let count = |links: &[Link]| links.iter().map(|l| l.visuals.len()).sum::<usize>();
    let links: Vec<Link> = tree
        .links()
        .iter()
        .map(|link| Link { visuals: merged_parts(&link.visuals), ..link.clone() })
        .collect();
    let (before, after) = (count(tree.links()), count(&links));
    if after < before {
        ledger.repaired(format!("{before} visual parts merged into {after}, by their names"));
    }
    KinematicTree::new(tree.name.clone(), links, tree.joints().to_vec())
}

/// `handle-12` and `handle-13` are parts of one `handle`.
fn merged_parts(parts: &[Part]) -> Vec<Part> {
    let mut groups: Vec<(String, Vec<&Part>)> = Vec::new();
    for part in parts {
        let name = part.name.trim_end_matches(|c: char| c.is_ascii_digit() || c == '-' || c == '_');
        let name = if name.is_empty() { &part.name } else { name };
        match groups.iter_mut().find(|(group, _)| group == name) {
            Some((_, members)) => members.push(part),
            None => groups.push((name.to_owned(), vec![part])),
        }
    }
    let one = |(name, members): (String, Vec<&Part>)| match members[..] {
        [only] => Part { name, ..only.clone() },
        _ => Part {
            link_from_part: Pose::identity(),
            shape: Shape::Mesh {
                source: format!("{name}.obj"),
                meshes: Arc::new(members.iter().flat_map(|part| part.triangulate()).collect()),
            },
            material: None,
            name,
        },
    };
    groups.into_iter().map(one).collect()
}

/// The tree under a root on the floor, below the middle of the object.
fn grounded(tree: KinematicTree, ledger: &mut Ledger) -> Result<KinematicTree, ModelError> {
    let Some((low, high)) = tree_bounds(&tree) else { return Ok(tree) };
    let offset = Vector3::new(-(low.x + high.x) / 2.0, -(low.y + high.y) / 2.0, -low.z);
    if offset.norm() < 1e-3 {
        return Ok(tree);
    }
    ledger.repaired(format!(
        "moved by ({:.3}, {:.3}, {:.3}) m: it stands on z = 0, centred",
        offset.x, offset.y, offset.z
    ));
    let root = tree.root();
    let (mut links, mut joints) = (tree.links().to_vec(), tree.joints().to_vec());
    let taken = |name: &str| links.iter().any(|l| l.name == name);
    let name = if taken("object_base") { "object_ground" } else { "object_base" };
    links.push(Link { name: name.into(), ..Link::default() });
    joints.push(fixed(
        "object_base_joint",
        links.len() - 1,
        root,
        Pose::from_parts(offset.into(), UnitQuaternion::identity()),
    ));
    KinematicTree::new(tree.name.clone(), links, joints)
}
