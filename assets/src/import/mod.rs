//! What other tools and collections made, in our layout: a URDF, its meshes and a manifest.
//!
//! Every importer reads into a [`KinematicTree`] (objects, robots) or [`SceneBody`]s (rooms), says in a
//! [`Ledger`] what it repaired and what it could not take over, and leaves the writing to [`layout`].

use std::path::Path;

use akrobat_model::{KinematicTree, ModelError, Pose, SceneBody};
use serde::Serialize;

pub mod classes;
pub mod floor;
pub mod grasps;
mod ground;
pub mod infinigen;
pub mod layout;
pub mod mjcf;
mod obj;
pub mod partnet;
pub mod procthor;
pub mod robot;
pub mod sdf;
mod split;
pub mod twin;
pub mod variant;
mod xml;

/// What an import changed and what it could not take over, in the user's words.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Ledger {
    /// Repairs: the result is what the source means.
    pub repairs: Vec<String>,
    /// Parts of the source that are not in the result.
    pub lost: Vec<String>,
}

impl Ledger {
    /// Records a repair, once.
    pub fn repaired(&mut self, what: impl Into<String>) {
        push_new(&mut self.repairs, what.into());
    }

    /// Records something that is not in the result, once.
    pub fn lost(&mut self, what: impl Into<String>) {
        push_new(&mut self.lost, what.into());
    }

    /// Takes over another ledger's entries.
    pub fn extend(&mut self, other: Self) {
        other.repairs.into_iter().for_each(|entry| self.repaired(entry));
        other.lost.into_iter().for_each(|entry| self.lost(entry));
    }
}

fn push_new(list: &mut Vec<String>, entry: String) {
    if !list.contains(&entry) {
        list.push(entry);
    }
}

/// Where something came from.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Origin {
    /// The collection or tool, and the identity of the thing in it.
    pub source: String,
    /// SPDX expression; empty where the source does not say.
    pub license: String,
}

/// An articulated or rigid thing, imported.
#[derive(Debug, Clone)]
pub struct ImportedObject {
    /// Name for identities; also that of its files.
    pub name: String,
    /// Semantic class, lower case (`microwave`).
    pub class: String,
    /// Links and joints, Z up, metres.
    pub tree: KinematicTree,
    /// Where it came from.
    pub origin: Origin,
    /// What each link is, where the source says (`door`, `handle`).
    pub semantics: Vec<LinkSemantics>,
    /// What was repaired and lost.
    pub ledger: Ledger,
}

/// The meaning of a link.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LinkSemantics {
    /// The link.
    pub link: String,
    /// What it is, lower case.
    pub label: String,
    /// Parts of the link that are handles.
    pub handle_parts: Vec<String>,
}

/// An articulated object that stands in a scene.
#[derive(Debug, Clone)]
pub struct PlacedObject {
    /// The object.
    pub object: ImportedObject,
    /// Pose of its root in the world.
    pub world_from_root: Pose,
    /// Name of the static body that it took the place of, where it did.
    pub replaces: Option<String>,
}

/// Surroundings, imported.
#[derive(Debug, Clone)]
pub struct ImportedScene {
    /// Name for identities; also that of its files.
    pub name: String,
    /// What stands still. Z up, metres.
    pub bodies: Vec<SceneBody>,
    /// What has joints.
    pub objects: Vec<PlacedObject>,
    /// Where it came from.
    pub origin: Origin,
    /// What was repaired and lost.
    pub ledger: Ledger,
}

/// A file name's stem, or `fallback`.
pub(crate) fn stem(path: &Path, fallback: &str) -> String {
    path.file_stem().and_then(|s| s.to_str()).unwrap_or(fallback).to_owned()
}

/// The text of a file.
pub(crate) fn read_text(path: &Path) -> Result<String, ModelError> {
    let bytes = std::fs::read(path).map_err(|e| ModelError::read(path, e))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// `wanted`, numbered from 2 where that is taken.
pub(crate) fn free_name(wanted: &str, taken: impl Fn(&str) -> bool) -> String {
    let mut name = wanted.to_owned();
    let mut number = 2;
    while taken(&name) {
        name = format!("{wanted}_{number}");
        number += 1;
    }
    name
}

/// Bodies with names that differ, which a written scene needs.
pub(crate) fn unique_names(mut bodies: Vec<SceneBody>, ledger: &mut Ledger) -> Vec<SceneBody> {
    let mut seen = std::collections::HashSet::from(["world".to_owned()]);
    for body in &mut bodies {
        let name = free_name(&body.name, |name| seen.contains(name));
        if body.name != name {
            ledger.repaired(format!("a second \"{}\" is called \"{name}\"", body.name));
        }
        seen.insert(name.clone());
        body.name = name;
    }
    bodies
}

/// A tree as surroundings: branches with joints are objects, everything else stands still.
///
/// # Errors
/// Where a branch of the tree is no tree, which does not happen to a tree.
pub fn static_scene(
    name: String,
    tree: &KinematicTree,
    origin: Origin,
    mut ledger: Ledger,
) -> Result<ImportedScene, ModelError> {
    let (bodies, objects) = split::scene_of(tree, &origin)?;
    let bodies = unique_names(bodies, &mut ledger);
    Ok(ImportedScene { name, bodies, objects, origin, ledger })
}
