//! Scene sections of task files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{AssetSearch, place};
use crate::mesh_io::{self, MeshCache, gltf};
use crate::pose::from_xyz_wxyz;
use crate::task::{BoxSection, SceneSection, UpAxis, matches_pattern};
use crate::{Material, ModelError, Part, Pose, Scene, SceneBody, Shape, hash, urdf};

const EXTENSIONS: [&str; 6] = ["gltf", "glb", "urdf", "obj", "stl", "dae"];
/// Thickness of the floor and the walls of an added room, metres.
const ROOM_THICKNESS_M: f64 = 0.1;

/// A scene and what its identity rests on.
pub struct LoadedScene {
    pub scene: Scene,
    file: Option<PathBuf>,
    mesh_files: BTreeMap<String, PathBuf>,
}

impl LoadedScene {
    /// Adds the hashes of the scene's files.
    pub fn add_hashes(&self, hashes: &mut BTreeMap<String, String>) -> Result<(), ModelError> {
        if let Some(file) = &self.file {
            hashes.insert("scene".into(), hash::of_file(file)?);
        }
        if !self.mesh_files.is_empty() {
            hashes.insert("scene.meshes".into(), super::hashes::of_files(&self.mesh_files)?);
        }
        Ok(())
    }
}

/// Loads what a `[scene]` section of the task file at `task_path` describes.
pub fn load(
    task_path: &Path,
    section: &SceneSection,
    search: &AssetSearch,
) -> Result<LoadedScene, ModelError> {
    let file = section.file.as_ref().map(|f| search.find(f, task_path)).transpose()?;
    let mut loaded = match &file {
        Some(file) => read_file(task_path, file, section.up, search)?,
        None => LoadedScene { scene: Scene::default(), file: None, mesh_files: BTreeMap::new() },
    };
    let scene = &mut loaded.scene;
    let stem = file.as_deref().and_then(Path::file_stem).and_then(|s| s.to_str());
    scene.name = section.name.clone().unwrap_or_else(|| stem.unwrap_or("empty_room").to_owned());
    make_names_unique(&mut scene.bodies);
    if let Some(pattern) = &section.floor {
        drop_to_floor(task_path, &mut scene.bodies, pattern)?;
    }
    let [dx, dy] = section.offset;
    if !(dx.is_finite() && dy.is_finite()) {
        let message = format!("expected finite numbers, got {:?}", section.offset);
        return Err(ModelError::bad_value(place(task_path, "scene.offset"), message));
    }
    shift(&mut scene.bodies, Vector3::new(dx, dy, 0.0));
    for pattern in &section.remove {
        matching(task_path, "scene.remove", &scene.bodies, pattern)?;
        scene.bodies.retain(|body| !matches_pattern(pattern, &body.name));
    }
    for section in &section.boxes {
        let body = box_body(task_path, section)?;
        add(task_path, scene, body)?;
    }
    if let Some(size) = section.room {
        for body in room_bodies(task_path, size)? {
            add(task_path, scene, body)?;
        }
    }
    Ok(loaded)
}

fn read_file(
    task_path: &Path,
    file: &Path,
    up: Option<UpAxis>,
    search: &AssetSearch,
) -> Result<LoadedScene, ModelError> {
    let extension = file.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let mut scene = Scene::default();
    let mut mesh_files = BTreeMap::new();
    match extension.as_str() {
        "gltf" | "glb" => {
            if up == Some(UpAxis::Z) {
                return Err(ModelError::bad_value(
                    place(task_path, "scene.up"),
                    "glTF files are Y up by definition; leave it out",
                ));
            }
            let gltf::GltfScene { nodes, notes } = gltf::load_scene(file)?;
            scene.bodies = nodes.into_iter().map(|node| gltf_body(file, node)).collect();
            scene.notes = notes;
        }
        "urdf" => {
            let loaded = urdf::load(file, search, &mut MeshCache::default())?;
            scene.bodies = urdf_bodies(&loaded.tree);
            scene.notes = loaded.notes;
            mesh_files = loaded.mesh_files;
        }
        "obj" | "stl" | "dae" => {
            let mesh_io::MeshFile { meshes, notes } = mesh_io::load_with_notes(file)?;
            let name = file.file_stem().and_then(|s| s.to_str()).unwrap_or("scene").to_owned();
            let source = file.display().to_string();
            let shape = Shape::Mesh { source, meshes: Arc::new(meshes) };
            scene.bodies = vec![visual_body(name, Pose::identity(), shape, None)];
            scene.notes = notes;
        }
        _ => {
            return Err(ModelError::invalid(
                file,
                format!(
                    "unknown scene format \"{extension}\"; valid choices: {}",
                    EXTENSIONS.join(", ")
                ),
            ));
        }
    }
    if scene.bodies.is_empty() {
        return Err(ModelError::invalid(file, "the scene has no bodies with geometry"));
    }
    if up == Some(UpAxis::Y) && !matches!(extension.as_str(), "gltf" | "glb") {
        let z_up_from_y_up =
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
        for body in &mut scene.bodies {
            body.world_from_body = z_up_from_y_up * body.world_from_body;
        }
    }
    Ok(LoadedScene { scene, file: Some(file.to_path_buf()), mesh_files })
}

fn gltf_body(file: &Path, node: gltf::MeshNode) -> SceneBody {
    let gltf::MeshNode { name, world_from_node, meshes } = node;
    let file_name = file.file_name().and_then(|n| n.to_str()).unwrap_or("scene");
    let source = format!("{file_name}#{name}");
    let shape = Shape::Mesh { source, meshes: Arc::new(meshes) };
    visual_body(name, world_from_node, shape, None)
}

/// The links of a URDF that have parts, at the neutral configuration.
fn urdf_bodies(tree: &crate::KinematicTree) -> Vec<SceneBody> {
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let links = tree.links().iter().zip(poses);
    let with_parts = links.filter(|(l, _)| !l.visuals.is_empty() || !l.collisions.is_empty());
    let to_body = |(link, world_from_body): (&crate::Link, Pose)| SceneBody {
        name: link.name.clone(),
        class: class_of(&link.name),
        world_from_body,
        visuals: link.visuals.clone(),
        collisions: link.collisions.clone(),
    };
    with_parts.map(to_body).collect()
}

fn visual_body(
    name: String,
    world_from_body: Pose,
    shape: Shape,
    material: Option<Material>,
) -> SceneBody {
    let part = Part { name: name.clone(), link_from_part: Pose::identity(), shape, material };
    SceneBody {
        class: class_of(&name),
        name,
        world_from_body,
        visuals: vec![part],
        collisions: Vec::new(),
    }
}

/// A semantic class from a body's name: `OvenFactory(12).spawn_asset(3)` is an `oven`,
/// `kitchen_0/0.wall` a `wall`, `Chair_02.001` a `chair`.
pub fn class_of(name: &str) -> String {
    let factory = name.split_once("Factory").map(|(class, _)| class);
    let dotted = name.rsplit_once('.').filter(|(_, tail)| tail.starts_with(char::is_alphabetic));
    let stem = match (factory, dotted) {
        (Some(class), _) => class,
        (None, Some((_, tail))) => tail,
        (None, None) => name,
    };
    let stem = stem.trim_end_matches(|c: char| !c.is_alphabetic());
    let mut class = String::new();
    for (index, c) in stem.char_indices() {
        if c.is_uppercase() && index > 0 && !class.ends_with('_') {
            class.push('_');
        }
        class.extend(c.to_lowercase());
    }
    if class.is_empty() { "body".into() } else { class }
}

fn make_names_unique(bodies: &mut [SceneBody]) {
    let mut seen = std::collections::HashSet::new();
    for body in bodies {
        let base = body.name.clone();
        let mut number = 2;
        while !seen.insert(body.name.clone()) {
            body.name = format!("{base}_{number}");
            number += 1;
        }
    }
}

/// The bodies that `pattern` matches: at least one.
pub fn matching<'a>(
    task_path: &Path,
    section: &str,
    bodies: &'a [SceneBody],
    pattern: &str,
) -> Result<Vec<&'a SceneBody>, ModelError> {
    let found: Vec<&SceneBody> =
        bodies.iter().filter(|b| matches_pattern(pattern, &b.name)).collect();
    if found.is_empty() {
        let names = bodies.iter().map(|b| b.name.clone());
        return Err(ModelError::unknown(place(task_path, section), "body", pattern, names));
    }
    Ok(found)
}

/// Moves everything so that the highest top of the matching floors is at z = 0.
fn drop_to_floor(
    task_path: &Path,
    bodies: &mut [SceneBody],
    pattern: &str,
) -> Result<(), ModelError> {
    let floors = matching(task_path, "scene.floor", bodies, pattern)?;
    let top = floors
        .into_iter()
        .filter_map(|body| bounds(body, &Pose::identity()))
        .map(|(_, high)| high.z)
        .fold(f64::NEG_INFINITY, f64::max);
    shift(bodies, Vector3::new(0.0, 0.0, -top));
    Ok(())
}

fn shift(bodies: &mut [SceneBody], by: Vector3<f64>) {
    for body in bodies {
        body.world_from_body = Translation3::from(by) * body.world_from_body;
    }
}

/// Corners of the smallest box around a body's visuals (or collisions, where it has no visuals), with
/// edges along the axes of `frame`.
pub fn bounds(body: &SceneBody, frame_from_world: &Pose) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let parts = if body.visuals.is_empty() { &body.collisions } else { &body.visuals };
    parts_bounds(parts.iter().map(|part| (frame_from_world * body.world_from_body, part)))
}

/// Corners of the smallest box around parts, each with the pose of its link in the box's frame.
pub fn parts_bounds<'a>(
    parts: impl Iterator<Item = (Pose, &'a Part)>,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let points = parts.flat_map(|(frame_from_link, part)| {
        let meshes = part.triangulate();
        let points: Vec<Vector3<f64>> = meshes
            .iter()
            .flat_map(|mesh| &mesh.positions)
            .map(|p| (frame_from_link * nalgebra::Point3::from(p.map(f64::from))).coords)
            .collect();
        points
    });
    points.fold(None, |bounds, p| match bounds {
        None => Some((p, p)),
        Some((low, high)) => Some((low.inf(&p), high.sup(&p))),
    })
}

fn box_body(task_path: &Path, section: &BoxSection) -> Result<SceneBody, ModelError> {
    let place = place(task_path, &format!("scene.box \"{}\"", section.name));
    if !section.size.iter().all(|s| s.is_finite() && *s > 0.0) {
        let message = format!("size: expected lengths above 0, got {:?}", section.size);
        return Err(ModelError::bad_value(place, message));
    }
    let world_from_body = from_xyz_wxyz(section.pose).ok_or_else(|| {
        let message = format!("pose: expected [x y z qw qx qy qz], got {:?}", section.pose);
        ModelError::bad_value(place.clone(), message)
    })?;
    let [r, g, b] = section.color;
    if ![r, g, b].iter().all(|c| (0.0..=1.0).contains(c)) {
        let message = format!("color: expected numbers in 0..1, got {:?}", section.color);
        return Err(ModelError::bad_value(place, message));
    }
    Ok(colored_box(&section.name, section.size, world_from_body, [r, g, b]))
}

fn colored_box(
    name: &str,
    size: [f64; 3],
    world_from_body: Pose,
    [r, g, b]: [f32; 3],
) -> SceneBody {
    let material =
        Material { name: name.to_owned(), base_color: [r, g, b, 1.0], ..Material::default() };
    visual_body(name.to_owned(), world_from_body, Shape::Box { size }, Some(material))
}

fn add(task_path: &Path, scene: &mut Scene, body: SceneBody) -> Result<(), ModelError> {
    if scene.bodies.iter().any(|b| b.name == body.name) {
        let message = format!("there is already a body named \"{}\"", body.name);
        return Err(ModelError::bad_value(place(task_path, "scene"), message));
    }
    scene.bodies.push(body);
    Ok(())
}

/// A floor with its top at z = 0 and four walls around it.
fn room_bodies(task_path: &Path, [x, y, z]: [f64; 3]) -> Result<Vec<SceneBody>, ModelError> {
    if ![x, y, z].iter().all(|s| s.is_finite() && *s > 0.0) {
        let message = format!("expected lengths above 0, got {:?}", [x, y, z]);
        return Err(ModelError::bad_value(place(task_path, "scene.room"), message));
    }
    let t = ROOM_THICKNESS_M;
    let (floor_color, wall_color) = ([0.42, 0.36, 0.30], [0.75, 0.74, 0.70]);
    let wall =
        |name, size, x, y| colored_box(name, size, Pose::translation(x, y, z / 2.0), wall_color);
    let (along_x, along_y) = ([x + 2.0 * t, t, z], [t, y, z]);
    Ok(vec![
        colored_box("floor", [x, y, t], Pose::translation(0.0, 0.0, -t / 2.0), floor_color),
        wall("wall_x_min", along_y, -(x + t) / 2.0, 0.0),
        wall("wall_x_max", along_y, (x + t) / 2.0, 0.0),
        wall("wall_y_min", along_x, 0.0, -(y + t) / 2.0),
        wall("wall_y_max", along_x, 0.0, (y + t) / 2.0),
    ])
}

#[cfg(test)]
mod tests {
    use super::class_of;

    #[test]
    fn classes_come_from_names() {
        assert_eq!(class_of("OvenFactory(12).spawn_asset(3)"), "oven");
        assert_eq!(class_of("BeverageFridgeFactory(1)"), "beverage_fridge");
        assert_eq!(class_of("kitchen_0/0.wall"), "wall");
        assert_eq!(class_of("Chair_02.001"), "chair");
        assert_eq!(class_of("42"), "body");
    }
}
