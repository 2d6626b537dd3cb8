//! Trees taken apart: what stands still becomes scene bodies, what has joints objects of their own.

use akrobat_model::tree::Mimic;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, ModelError, Pose, SceneBody};

use super::layout::file_name;
use super::{ImportedObject, Ledger, Origin, PlacedObject, classes};

/// The bodies and objects of a tree: what hangs from its root by one joint is an object where anything in
/// it moves, else bodies.
///
/// # Errors
/// Where a branch is not a tree of its own, which a tree's branches are.
pub fn scene_of(
    tree: &KinematicTree,
    origin: &Origin,
) -> Result<(Vec<SceneBody>, Vec<PlacedObject>), ModelError> {
    let root = tree.root();
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let mut bodies: Vec<SceneBody> = body(&tree.links()[root], poses[root]).into_iter().collect();
    let mut objects = Vec::new();
    for (index, joint) in tree.joints().iter().enumerate().filter(|(_, j)| j.parent == root) {
        let links = links_below(tree, joint.child);
        let moves = |l: &usize| {
            tree.parent_joint(*l).is_some_and(|j| tree.joints()[j].kind != JointKind::Fixed)
        };
        if !links.iter().any(moves) {
            bodies.extend(links.iter().filter_map(|&l| body(&tree.links()[l], poses[l])));
            continue;
        }
        let name = file_name(&tree.links()[joint.child].name);
        let object = ImportedObject {
            class: classes::of_file_name(&name),
            tree: branch(tree, index, &links, &name)?,
            name,
            origin: origin.clone(),
            semantics: Vec::new(),
            ledger: Ledger::default(),
        };
        objects.push(PlacedObject { object, world_from_root: poses[root], replaces: None });
    }
    Ok((bodies, objects))
}

fn body(link: &Link, world_from_body: Pose) -> Option<SceneBody> {
    if link.visuals.is_empty() && link.collisions.is_empty() {
        return None;
    }
    // `world` is what a written scene calls its root.
    let name = if link.name == "world" { "world_body" } else { &link.name };
    Some(SceneBody {
        name: name.to_owned(),
        class: classes::of_file_name(name),
        world_from_body,
        visuals: link.visuals.clone(),
        collisions: link.collisions.clone(),
    })
}

/// A link and all below it.
fn links_below(tree: &KinematicTree, top: usize) -> Vec<usize> {
    let is_below =
        |&l: &usize| l == top || tree.chain_to(l).iter().any(|&j| tree.joints()[j].parent == top);
    (0..tree.links().len()).filter(is_below).collect()
}

/// What hangs from a joint of the root, under a root of its own.
fn branch(
    tree: &KinematicTree,
    top: usize,
    kept: &[usize],
    name: &str,
) -> Result<KinematicTree, ModelError> {
    let base_name = format!("{name}_base");
    let base = Link { name: base_name, ..Link::default() };
    let links = std::iter::once(base).chain(kept.iter().map(|&l| tree.links()[l].clone()));
    // The base comes first, so a link's new index is one more than its place among those kept.
    let link_at = |old: usize| kept.iter().position(|&l| l == old).map(|at| at + 1);
    let joint_indices: Vec<usize> =
        (0..tree.joints().len()).filter(|&j| link_at(tree.joints()[j].child).is_some()).collect();
    let joints = joint_indices.iter().filter_map(|&index| {
        let joint = &tree.joints()[index];
        let mimic = joint.mimic.as_ref().and_then(|mimic| {
            let joint = joint_indices.iter().position(|&j| j == mimic.joint)?;
            Some(Mimic { joint, ..mimic.clone() })
        });
        let parent = if index == top { 0 } else { link_at(joint.parent)? };
        Some(Joint { parent, child: link_at(joint.child)?, mimic, ..joint.clone() })
    });
    KinematicTree::new(name.to_owned(), links.collect(), joints.collect())
}
