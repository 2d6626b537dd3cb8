//! Our layout on disk: `<name>.urdf`, `meshes/`, `object.json` or `scene.json`.
//!
//! A folder appears under its final name only when it is whole. In a scene, bodies that stand still
//! are the links of `scene.urdf`, and what has joints is a folder of its own under `objects/`, with a
//! static twin in `furnished.urdf`.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use akrobat_model::load::AssetSearch;
use akrobat_model::pose::to_xyz_wxyz;
use akrobat_model::{
    Joint, JointKind, KinematicTree, Link, Material, ModelError, Part, Pose, SceneBody, Shape,
    TriMesh, urdf,
};
use nalgebra::Vector3;
use serde_json::{Value, json};

use super::obj::ObjWriter;
use super::twin::write_furnished;
use super::{ImportedObject, ImportedScene, PlacedObject};
use crate::error::{AssetError, make_folder, write_file};

/// Version of the manifests.
const FORMAT: u32 = 1;

/// Writes a folder that appears under its name only once `fill` has filled it.
///
/// # Errors
/// Where `folder` holds files already, where it cannot be written, and the errors of `fill`.
pub fn write_folder<E: From<AssetError>>(
    folder: &Path,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let is_empty = |folder: &Path| std::fs::read_dir(folder).is_ok_and(|mut e| e.next().is_none());
    if folder.exists() && !is_empty(folder) {
        return Err(AssetError::Occupied { folder: folder.to_path_buf() }.into());
    }
    let parent = match folder.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    make_folder(parent)?;
    let fresh = tempfile::Builder::new()
        .prefix(".akrobat-import-")
        .tempdir_in(parent)
        .map_err(|e| AssetError::write(folder, e))?;
    fill(fresh.path())?;
    if folder.exists() {
        std::fs::remove_dir(folder).map_err(|e| AssetError::write(folder, e))?;
    }
    share(fresh.path());
    std::fs::rename(fresh.path(), folder).map_err(|e| AssetError::write(folder, e))?;
    // It has its final name now, so there is nothing left to clean up.
    let _ = fresh.keep();
    Ok(())
}

/// Temporary folders are private; what is left for others to read is not.
#[cfg(unix)]
fn share(folder: &Path) {
    use std::os::unix::fs::PermissionsExt;
    // Best effort: the owner can read it in any case.
    let _ = std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755));
}

#[cfg(not(unix))]
fn share(_: &Path) {}

/// Writes an object; gives its manifest.
///
/// # Errors
/// [`AssetError`] where a file cannot be written or the result does not load.
pub fn write_object(folder: &Path, object: &ImportedObject) -> Result<Value, AssetError> {
    let manifest = object_manifest(object);
    write_folder(folder, |fresh| fill_object(fresh, object, &manifest))?;
    Ok(manifest)
}

fn fill_object(folder: &Path, object: &ImportedObject, manifest: &Value) -> Result<(), AssetError> {
    write_tree(folder, &object.name, &object.tree)?;
    write_file(&folder.join("object.json"), format!("{manifest:#}\n"))
}

/// Writes a scene; gives its manifest.
///
/// # Errors
/// [`AssetError`] where a file cannot be written or the result does not load.
pub fn write_scene(folder: &Path, scene: &ImportedScene) -> Result<Value, AssetError> {
    let manifest = scene_manifest(scene);
    write_folder(folder, |fresh| {
        write_tree(fresh, "scene", &scene_tree(scene)?)?;
        for placed in &scene.objects {
            let folder = fresh.join("objects").join(&placed.object.name);
            make_folder(&folder)?;
            fill_object(&folder, &placed.object, &object_manifest(&placed.object))?;
        }
        if !scene.objects.is_empty() {
            write_furnished(fresh, scene)?;
        }
        write_file(&fresh.join("scene.json"), format!("{manifest:#}\n"))
    })?;
    Ok(manifest)
}

/// Writes `<name>.urdf` and `meshes/`, and loads them again to be sure that they are right.
///
/// # Errors
/// [`AssetError`] where a file cannot be written or what was written does not load.
pub fn write_tree(folder: &Path, name: &str, tree: &KinematicTree) -> Result<(), AssetError> {
    let meshes = folder.join("meshes");
    let mut files =
        MeshFiles { writer: ObjWriter::new(&meshes), by_mesh: HashMap::new(), made: false };
    let mut links = Vec::new();
    for link in tree.links() {
        let mut written = link.clone();
        for part in written.visuals.iter_mut().chain(&mut written.collisions) {
            files.place(&meshes, &link.name, part)?;
        }
        links.push(written);
    }
    let with_files = KinematicTree::new(tree.name.clone(), links, tree.joints().to_vec())?;
    let path = folder.join(format!("{name}.urdf"));
    write_file(&path, urdf::to_string(&with_files))?;
    urdf::read(&path, &AssetSearch::default())?;
    Ok(())
}

/// What identifies the content of a mesh file: the shared meshes and the appearance laid over them.
type MeshKey = (usize, Option<String>);

struct MeshFiles {
    writer: ObjWriter,
    by_mesh: HashMap<MeshKey, (String, Arc<Vec<TriMesh>>)>,
    made: bool,
}

impl MeshFiles {
    /// Writes the mesh of a part, where it is one, and makes the part name that file. Appearances are
    /// written into the mesh file, which can hold textures.
    fn place(&mut self, folder: &Path, link: &str, part: &mut Part) -> Result<(), AssetError> {
        let textured = part.material.as_ref().is_some_and(|m| m.base_color_texture.is_some());
        let meshes = match &part.shape {
            Shape::Mesh { meshes, .. } => meshes.clone(),
            _ if textured => {
                let lone = Part { link_from_part: Pose::identity(), ..part.clone() };
                Arc::new(lone.triangulate())
            }
            _ => return Ok(()),
        };
        let appearance = part.material.take();
        let key = (Arc::as_ptr(&meshes) as usize, appearance.as_ref().map(appearance_key));
        let name = match self.by_mesh.get(&key) {
            Some((name, _)) => name.clone(),
            None => {
                if !self.made {
                    make_folder(folder)?;
                    self.made = true;
                }
                let name = self.free_mesh_name(&file_name(&format!("{link}_{}", part.name)));
                let shown = meshes.iter().map(|mesh| match &appearance {
                    Some(material) => TriMesh { material: material.clone(), ..mesh.clone() },
                    None => mesh.clone(),
                });
                self.writer.write(&name, &shown.collect::<Vec<_>>())?;
                self.by_mesh.insert(key, (name.clone(), meshes.clone()));
                name
            }
        };
        part.shape = Shape::Mesh { source: format!("meshes/{name}.obj"), meshes };
        Ok(())
    }

    fn free_mesh_name(&self, wanted: &str) -> String {
        super::free_name(wanted, |name| {
            self.by_mesh.values().any(|(n, _)| n.eq_ignore_ascii_case(name))
        })
    }
}

/// What tells materials apart, without the pixels of their textures.
fn appearance_key(material: &Material) -> String {
    let texture = material.base_color_texture.as_ref().map(Arc::as_ptr);
    format!("{:?} {texture:?} {} {}", material.base_color, material.metallic, material.roughness)
}

/// A name that is a file name everywhere.
pub fn file_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_".contains(c) { c } else { '_' };
    let name: String = name.chars().map(plain).take(80).collect();
    if name.is_empty() { "part".into() } else { name }
}

/// Static bodies as the links of a tree, all fixed to its root.
fn scene_tree(scene: &ImportedScene) -> Result<KinematicTree, AssetError> {
    let root = "world";
    if let Some(body) = scene.bodies.iter().find(|b| b.name == root) {
        let message = format!("a body of a scene cannot be called \"{}\"", body.name);
        return Err(ModelError::bad_value(&scene.name, message).into());
    }
    let mut links = vec![Link { name: root.into(), ..Link::default() }];
    let mut joints = Vec::new();
    for body in &scene.bodies {
        links.push(Link {
            name: body.name.clone(),
            visuals: body.visuals.clone(),
            collisions: body.collisions.clone(),
            inertial: None,
        });
        joints.push(fixed(
            &format!("{}_place", body.name),
            0,
            links.len() - 1,
            body.world_from_body,
        ));
    }
    Ok(KinematicTree::new(scene.name.clone(), links, joints)?)
}

/// A fixed joint between two links.
pub(crate) fn fixed(name: &str, parent: usize, child: usize, parent_from_joint: Pose) -> Joint {
    Joint {
        name: name.into(),
        kind: JointKind::Fixed,
        parent,
        child,
        parent_from_joint,
        axis: Vector3::x_axis(),
        limits: [0.0; 2],
        velocity_limit: None,
        effort_limit: None,
        damping: 0.0,
        friction: 0.0,
        mimic: None,
    }
}

fn object_manifest(object: &ImportedObject) -> Value {
    let joints = object.tree.joints().iter().filter(|j| j.kind != JointKind::Fixed);
    let joints: Vec<Value> = joints.map(|joint| joint_entry(&object.tree, joint)).collect();
    let bounds = tree_bounds(&object.tree);
    json!({
        "format": FORMAT,
        "kind": "object",
        "name": object.name,
        "class": object.class,
        "urdf": format!("{}.urdf", object.name),
        "source": object.origin.source,
        "license": object.origin.license,
        "size_m": bounds.map(|(low, high)| <[f64; 3]>::from(high - low)),
        "bounds_m": bounds.map(|(low, high)| [<[f64; 3]>::from(low), high.into()]),
        "links": object.tree.links().len(),
        "joints": joints,
        "semantics": object.semantics,
        "repairs": object.ledger.repairs,
        "lost": object.ledger.lost,
    })
}

fn joint_entry(tree: &KinematicTree, joint: &Joint) -> Value {
    let limits = joint.limits.map(|limit| limit.is_finite().then_some(limit));
    json!({
        "name": joint.name,
        "kind": format!("{:?}", joint.kind).to_lowercase(),
        "limits": limits,
        "link": tree.links()[joint.child].name,
        "mimics": joint.mimic.as_ref().map(|m| tree.joints()[m.joint].name.clone()),
    })
}

fn scene_manifest(scene: &ImportedScene) -> Value {
    let bodies: Vec<Value> = scene.bodies.iter().map(body_entry).collect();
    let objects: Vec<Value> = scene.objects.iter().map(placed_entry).collect();
    json!({
        "format": FORMAT,
        "kind": "scene",
        "name": scene.name,
        "file": "scene.urdf",
        "source": scene.origin.source,
        "license": scene.origin.license,
        "bodies": bodies,
        "objects": objects,
        "repairs": scene.ledger.repairs,
        "lost": scene.ledger.lost,
    })
}

fn body_entry(body: &SceneBody) -> Value {
    let parts = if body.visuals.is_empty() { &body.collisions } else { &body.visuals };
    let bounds = parts_bounds(parts.iter().map(|part| (body.world_from_body, part)));
    json!({
        "name": body.name,
        "class": body.class,
        "pose": to_xyz_wxyz(&body.world_from_body),
        "bounds_m": bounds.map(|(low, high)| [<[f64; 3]>::from(low), high.into()]),
    })
}

fn placed_entry(placed: &PlacedObject) -> Value {
    let object = &placed.object;
    let joints = object.tree.joints().iter().filter(|j| j.kind != JointKind::Fixed);
    json!({
        "name": object.name,
        "class": object.class,
        "asset": format!("objects/{0}/{0}.urdf", object.name),
        "pose": to_xyz_wxyz(&placed.world_from_root),
        "replaces": placed.replaces,
        "joints": joints.map(|joint| joint_entry(&object.tree, joint)).collect::<Vec<_>>(),
    })
}

/// Corners of the box around a tree in its root's frame, at its neutral configuration.
pub fn tree_bounds(tree: &KinematicTree) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let links = tree.links().iter().zip(poses);
    parts_bounds(links.flat_map(|(link, pose)| {
        let parts = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
        parts.iter().map(move |part| (pose, part))
    }))
}

/// Corners of the box around parts, each with the pose of its link in the box's frame.
pub fn parts_bounds<'a>(
    parts: impl Iterator<Item = (Pose, &'a Part)>,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let mut bounds: Option<(Vector3<f64>, Vector3<f64>)> = None;
    for (frame_from_link, part) in parts {
        for position in part.triangulate().iter().flat_map(|mesh| &mesh.positions) {
            let point = (frame_from_link * nalgebra::Point3::from(position.map(f64::from))).coords;
            let (low, high) = bounds.unwrap_or((point, point));
            bounds = Some((low.inf(&point), high.sup(&point)));
        }
    }
    bounds
}
