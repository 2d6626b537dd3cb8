//! URDF in.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use roxmltree::Document;

use super::joint;
use super::link::LinkReader;
use super::xml::{Context, children};
use crate::load::AssetSearch;
use crate::mesh_io::MeshCache;
use crate::{KinematicTree, ModelError, Pose};

/// A URDF file, loaded with its meshes.
#[derive(Debug, Clone)]
pub struct UrdfFile {
    /// Links and joints.
    pub tree: KinematicTree,
    /// Repairs and oddities, in the user's words.
    pub notes: Vec<String>,
    /// Mesh files by the names that the URDF gives them.
    pub mesh_files: BTreeMap<String, PathBuf>,
}

/// Reads a URDF file and its meshes; gives the tree and what was repaired, in the user's words.
///
/// # Errors
/// As [`load`].
pub fn read(path: &Path, search: &AssetSearch) -> Result<(KinematicTree, Vec<String>), ModelError> {
    load(path, search, &mut MeshCache::default()).map(|file| (file.tree, file.notes))
}

/// Reads a URDF file; meshes come from `cache` where they are in it.
///
/// # Errors
/// [`ModelError`] naming the file and the line: malformed XML, unknown links or joints, a cycle or
/// disconnected links, an axis without direction, inverted or missing limits, unsupported joint or shape
/// kinds, missing or broken meshes, implausible sizes.
pub fn load(
    path: &Path,
    search: &AssetSearch,
    cache: &mut MeshCache,
) -> Result<UrdfFile, ModelError> {
    let bytes = std::fs::read(path).map_err(|e| ModelError::read(path, e))?;
    let text = String::from_utf8_lossy(&bytes);
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let document = Document::parse_with_options(&text, options).map_err(|e| {
        ModelError::invalid(path, format!("line {}: malformed XML: {e}", e.pos().row))
    })?;
    let robot = document.root_element();
    let context = Context { path };
    if robot.tag_name().name() != "robot" {
        return Err(context.error(
            robot,
            format!(
                "expected a URDF with a <robot> root element, got <{}>",
                robot.tag_name().name()
            ),
        ));
    }
    let cache_notes_before = cache.notes.len();
    let mut reader = LinkReader {
        context,
        search,
        cache,
        materials: HashMap::new(),
        mesh_files: BTreeMap::new(),
        notes: Vec::new(),
    };
    reader.global_materials(robot)?;
    let links = children(robot, "link").map(|n| reader.link(n)).collect::<Result<Vec<_>, _>>()?;
    let LinkReader { mut notes, mesh_files, cache, .. } = reader;
    let link_names: Vec<String> = links.iter().map(|l| l.name.clone()).collect();
    let joints = children(robot, "joint")
        .map(|node| joint::read(context, node, &link_names, &mut notes))
        .collect::<Result<Vec<_>, _>>()?;
    let joints = joint::resolve_mimics(context, joints)?;
    let name = robot.attribute("name").unwrap_or("unnamed").to_owned();
    let tree = KinematicTree::new(name, links, joints).map_err(|error| match error {
        ModelError::BadValue { context, message } => {
            ModelError::invalid(path, format!("{context}: {message}"))
        }
        other => other,
    })?;
    check_reach(path, &tree)?;
    notes.extend(cache.notes[cache_notes_before..].iter().cloned());
    Ok(UrdfFile { tree, notes, mesh_files })
}

/// Largest distance of a link from the root that can be meant, metres.
const MAX_REACH_M: f64 = 1000.0;

fn check_reach(path: &Path, tree: &KinematicTree) -> Result<(), ModelError> {
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let distances = poses.iter().map(|pose| pose.translation.vector.norm());
    match distances.zip(tree.links()).find(|(distance, _)| *distance > MAX_REACH_M) {
        None => Ok(()),
        Some((distance, link)) => Err(ModelError::invalid(
            path,
            format!(
                "link \"{}\" is {distance:.3e} m away from the root; expected at most {MAX_REACH_M} m: are the joint origins in metres?",
                link.name
            ),
        )),
    }
}
