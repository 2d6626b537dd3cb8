//! Static twins: what opens in a scene, closed and rigid, for the tasks that open something else in it.

use std::path::Path;

use akrobat_model::load::AssetSearch;
use akrobat_model::{KinematicTree, Link, Part, Pose, Shape, urdf};

use super::layout::fixed;
use super::{ImportedScene, PlacedObject, free_name};
use crate::error::{AssetError, write_file};

/// The scene with its twins, beside `scene.urdf`, which has the bodies alone.
pub const FURNISHED_FILE: &str = "furnished.urdf";

/// The name of the body that stands for an object of a scene in [`FURNISHED_FILE`].
pub fn twin_name(scene: &ImportedScene, object: &str) -> String {
    let is_other = |placed: &PlacedObject, name: &str| {
        placed.object.name != object && placed.object.name == name
    };
    free_name(object, |name| {
        name == "world"
            || scene.bodies.iter().any(|body| body.name == name)
            || scene.objects.iter().any(|placed| is_other(placed, name))
    })
}

/// Writes [`FURNISHED_FILE`] into a folder that has the scene's other files already.
///
/// # Errors
/// Where a file cannot be read or written.
pub(crate) fn write_furnished(folder: &Path, scene: &ImportedScene) -> Result<(), AssetError> {
    let (still, _) = urdf::read(&folder.join("scene.urdf"), &AssetSearch::default())?;
    let (mut links, mut joints) = (still.links().to_vec(), still.joints().to_vec());
    for placed in &scene.objects {
        let name = twin_name(scene, &placed.object.name);
        let place = format!("{name}_place");
        joints.push(fixed(&place, still.root(), links.len(), placed.world_from_root));
        links.push(Link { name, ..static_twin(folder, &placed.object.name)? });
    }
    let tree = KinematicTree::new(still.name.clone(), links, joints)?;
    write_file(&folder.join(FURNISHED_FILE), urdf::to_string(&tree))
}

/// A closed object as one rigid link, of the files that were written for it.
///
/// # Errors
/// Where these files cannot be read.
pub(crate) fn static_twin(folder: &Path, name: &str) -> Result<Link, AssetError> {
    let place = format!("objects/{name}");
    let path = folder.join(&place).join(format!("{name}.urdf"));
    let (tree, _) = urdf::read(&path, &AssetSearch::default())?;
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let mut twin = Link { name: name.into(), ..Link::default() };
    for (link, root_from_link) in tree.links().iter().zip(poses) {
        let moved = |part: &Part| {
            let mut part = part.clone();
            part.link_from_part = root_from_link * part.link_from_part;
            if let Shape::Mesh { source, .. } = &mut part.shape {
                *source = format!("{place}/{source}");
            }
            part.name = format!("{}_{}", link.name, part.name);
            part
        };
        twin.visuals.extend(link.visuals.iter().map(moved));
        twin.collisions.extend(link.collisions.iter().map(moved));
    }
    Ok(twin)
}
