//! Infinigen exports: a glTF or OBJ of a furnished home, and the layout solver's `solve_state.json`.
//!
//! Appliances in it are static placeholders. Each is replaced by an articulated object of its class, as the
//! paper does: scaled uniformly to the placeholder's box, backs flush, bottoms level, and turned as the
//! solver's wall constraint says. The floor is brought to z = 0.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use akrobat_model::load::AssetSearch;
use akrobat_model::mesh_io::{self, gltf};
use akrobat_model::{JointKind, KinematicTree, ModelError, Part, Pose, SceneBody, Shape, urdf};
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::layout::{parts_bounds, tree_bounds};
use super::{
    ImportedObject, ImportedScene, Ledger, Origin, PlacedObject, classes, read_text, stem,
};

/// Articulated objects to replace placeholders with.
#[derive(Debug, Clone, Default)]
pub struct Catalog {
    objects: Vec<(String, PathBuf)>,
}

impl Catalog {
    /// All URDFs in the folders of `folder`; a folder's class is that of its `object.json`, else of its name.
    ///
    /// # Errors
    /// Where the folder cannot be read.
    pub fn of_folder(folder: &Path) -> Result<Self, ModelError> {
        let entries = std::fs::read_dir(folder).map_err(|e| ModelError::read(folder, e))?;
        let mut folders: Vec<PathBuf> =
            entries.flatten().map(|e| e.path()).filter(|p| p.is_dir()).collect();
        folders.sort();
        let objects = folders.into_iter().filter_map(|folder| {
            let name = folder.file_name()?.to_str()?.to_owned();
            let urdf = first_urdf(&folder).or_else(|| first_urdf(&folder.join("urdf")))?;
            let manifest = read_text(&folder.join("object.json")).ok();
            let manifest: Option<Value> =
                manifest.and_then(|text| serde_json::from_str(&text).ok());
            let stated = manifest.and_then(|m| Some(m["class"].as_str()?.to_owned()));
            Some((stated.unwrap_or_else(|| classes::of_file_name(&name)), urdf))
        });
        Ok(Self { objects: objects.collect() })
    }

    fn of_class(&self, class: &str) -> Option<&Path> {
        self.objects.iter().find(|(c, _)| c == class).map(|(_, path)| path.as_path())
    }
}

fn first_urdf(folder: &Path) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    files.sort();
    files.into_iter().find(|p| p.extension().is_some_and(|e| e == "urdf"))
}

/// Reads a scene. `state` is `solve_state.json`; without it, placeholders are known by their names and face
/// the room's middle.
///
/// # Errors
/// [`ModelError`] where a file is broken, the scene has no floor, or a catalogue's object does not load.
pub fn read(
    scene: &Path,
    state: Option<&Path>,
    catalog: &Catalog,
    search: &AssetSearch,
) -> Result<ImportedScene, ModelError> {
    let mut ledger = Ledger::default();
    let bodies = load_bodies(scene, &mut ledger)?;
    of_bodies(scene, bodies, state, catalog, search, ledger)
}

/// A scene whose bodies were read from `scene` by other means, under Infinigen's names.
///
/// # Errors
/// As for [`read`].
pub fn of_bodies(
    scene: &Path,
    mut bodies: Vec<SceneBody>,
    state: Option<&Path>,
    catalog: &Catalog,
    search: &AssetSearch,
    mut ledger: Ledger,
) -> Result<ImportedScene, ModelError> {
    for body in &mut bodies {
        body.class = class_of(&body.name);
    }
    let state: Value = match state {
        None => Value::Null,
        Some(path) => serde_json::from_str(&read_text(path)?)
            .map_err(|e| ModelError::invalid(path, format!("malformed JSON: {e}")))?,
    };
    drop_to_floor(scene, &mut bodies, &mut ledger)?;
    let mut objects = Vec::new();
    for (name, class) in placeholders(&bodies, &state) {
        let Some(urdf_path) = catalog.of_class(&class) else {
            ledger.repaired(format!(
                "\"{name}\" stays a static body: no articulated {class} was given"
            ));
            continue;
        };
        let Some(position) = bodies.iter().position(|b| b.name == name) else { continue };
        let yaw = yaw_of(&bodies[position], &state, &bodies);
        let (tree, notes) = urdf::read(urdf_path, search)?;
        let placed = replacement(&bodies[position], &class, tree, notes, yaw, urdf_path)?;
        let scale = placed.1;
        ledger.repaired(format!(
            "\"{name}\" replaced by \"{}\", scaled by {scale:.3}",
            placed.0.object.name
        ));
        bodies.remove(position);
        objects.push(placed.0);
    }
    make_unique(&mut objects);
    Ok(ImportedScene {
        name: scene
            .parent()
            .and_then(Path::file_name)
            .and_then(|n| n.to_str())
            .map_or_else(|| stem(scene, "scene"), str::to_owned),
        bodies,
        objects,
        origin: Origin { source: "Infinigen".into(), license: String::new() },
        ledger,
    })
}

fn load_bodies(scene: &Path, ledger: &mut Ledger) -> Result<Vec<SceneBody>, ModelError> {
    let is_gltf = scene.extension().is_some_and(|e| e == "glb" || e == "gltf");
    let bodies: Vec<SceneBody> = if is_gltf {
        let loaded = gltf::load_scene(scene)?;
        loaded.notes.into_iter().for_each(|note| ledger.repaired(note));
        loaded.nodes.into_iter().map(|n| body(n.name, n.world_from_node, n.meshes)).collect()
    } else {
        let loaded = mesh_io::load_with_notes(scene)?;
        loaded.notes.into_iter().for_each(|note| ledger.repaired(note));
        vec![body(stem(scene, "scene"), Pose::identity(), loaded.meshes)]
    };
    Ok(super::unique_names(bodies, ledger))
}

/// A body of meshes.
pub(super) fn body(
    name: String,
    world_from_body: Pose,
    meshes: Vec<akrobat_model::TriMesh>,
) -> SceneBody {
    let shape = Shape::Mesh { source: format!("{name}.obj"), meshes: Arc::new(meshes) };
    let part = Part { name: name.clone(), link_from_part: Pose::identity(), shape, material: None };
    let class = class_of(&name);
    SceneBody { name, class, world_from_body, visuals: vec![part], collisions: Vec::new() }
}

/// `OvenFactory(12).spawn_asset(3)` is an `oven`, `kitchen_0/0.wall` a `wall`, as is `kitchen_0_0_wall`, what USD makes
/// of that name.
fn class_of(name: &str) -> String {
    const STRUCTURE: [&str; 4] = ["floor", "wall", "ceiling", "exterior"];
    let factory = name.split_once("Factory").map(|(class, _)| class);
    let dotted = name.rsplit_once('.').filter(|(_, tail)| tail.starts_with(char::is_alphabetic));
    let structure = name.rsplit_once('_').filter(|(_, tail)| STRUCTURE.contains(tail));
    let plain = factory.or(dotted.or(structure).map(|(_, tail)| tail)).unwrap_or(name);
    classes::canonical(plain.trim_end_matches(|c: char| !c.is_alphabetic()))
}

/// Bodies that stand for something articulated, with its class: those that the solver generated as
/// appliances or furniture of a class in the catalogue's terms, or that are named like one.
fn placeholders(bodies: &[SceneBody], state: &Value) -> Vec<(String, String)> {
    const ARTICULATED: [&str; 8] = [
        "oven",
        "dishwasher",
        "refrigerator",
        "microwave",
        "cabinet",
        "drawer",
        "trash_can",
        "washing_machine",
    ];
    let solved: Vec<&str> = state["objs"]
        .as_object()
        .map(|objs| objs.values().filter_map(|o| o["obj"].as_str()).collect())
        .unwrap_or_default();
    let is_generated = |body: &SceneBody| {
        body.name.contains("Factory")
            && (solved.is_empty() || solved.iter().any(|s| same_object(s, &body.name)))
    };
    let found = bodies.iter().filter(|b| is_generated(b) && ARTICULATED.contains(&&*b.class));
    found.map(|b| (b.name.clone(), b.class.clone())).collect()
}

/// Exporters drop or change punctuation of names.
fn same_object(solved: &str, body: &str) -> bool {
    let plain = |s: &str| s.chars().filter(|c| c.is_alphanumeric()).collect::<String>();
    let (solved, body) = (plain(solved), plain(body));
    solved == body || body.starts_with(&solved) || solved.starts_with(&body)
}

/// Moves everything so that the kitchen's floor, or else the highest one, lies at z = 0.
fn drop_to_floor(
    scene: &Path,
    bodies: &mut [SceneBody],
    ledger: &mut Ledger,
) -> Result<(), ModelError> {
    let is_floor = |b: &&SceneBody| b.class == "floor" || b.name.to_lowercase().ends_with("floor");
    let mut floors: Vec<&SceneBody> = bodies.iter().filter(is_floor).collect();
    if floors.iter().any(|b| b.name.contains("kitchen")) {
        floors.retain(|b| b.name.contains("kitchen"));
    }
    let top = floors
        .iter()
        .filter_map(|b| bounds(b, &Pose::identity()))
        .map(|(_, high)| high.z)
        .reduce(f64::max)
        .ok_or_else(|| {
            let names: Vec<&str> = bodies.iter().map(|b| b.name.as_str()).collect();
            let message = format!("found no floor; the bodies are: {}", names.join(", "));
            ModelError::invalid(scene, message)
        })?;
    if top.abs() > 1e-6 {
        ledger.repaired(format!("moved by {:.4} m along z: the floor lies at z = 0", -top));
    }
    for body in bodies {
        body.world_from_body = Translation3::new(0.0, 0.0, -top) * body.world_from_body;
    }
    Ok(())
}

fn bounds(body: &SceneBody, frame_from_world: &Pose) -> Option<(Vector3<f64>, Vector3<f64>)> {
    parts_bounds(
        body.collision_parts().iter().map(|p| (frame_from_world * body.world_from_body, p)),
    )
}

/// The way that a placeholder faces: along the solver's wall normal, on the side of the middle of its room.
fn yaw_of(body: &SceneBody, state: &Value, bodies: &[SceneBody]) -> f64 {
    let Some((low, high)) = bounds(body, &Pose::identity()) else { return 0.0 };
    let centre = (low + high) / 2.0;
    let inward = room_middle(&centre, bodies).map_or_else(Vector3::zeros, |m| m - centre);
    let normals = match wall_normal(body, state) {
        Some(normal) => vec![normal, -normal],
        None => [0.0f64, 0.5, 1.0, 1.5]
            .map(|half_turns| {
                let angle = half_turns * std::f64::consts::PI;
                Vector3::new(angle.cos(), angle.sin(), 0.0)
            })
            .to_vec(),
    };
    let facing = normals
        .into_iter()
        .max_by(|a, b| a.dot(&inward).total_cmp(&b.dot(&inward)))
        .unwrap_or_else(Vector3::x);
    facing.y.atan2(facing.x)
}

/// The level direction in which the solver's translation constraint lets an object not move: the wall's.
fn wall_normal(body: &SceneBody, state: &Value) -> Option<Vector3<f64>> {
    let objects = state["objs"].as_object()?;
    let object =
        objects.values().find(|o| o["obj"].as_str().is_some_and(|s| same_object(s, &body.name)))?;
    let rows = object["dof_matrix_translation"].as_array()?;
    let entry = |r: usize, c: usize| rows.get(r)?.get(c)?.as_f64();
    let mut free = Matrix3::zeros();
    for r in 0..3 {
        for c in 0..3 {
            free[(r, c)] = entry(r, c)?;
        }
    }
    // The matrix projects on the free directions: a level one is left over, and the wall is across it.
    let along = [Vector3::x(), Vector3::y()]
        .map(|axis| free * axis)
        .into_iter()
        .max_by(|a, b| a.xy().norm().total_cmp(&b.xy().norm()))?;
    if (free.trace() - 1.0).abs() > 0.1 || along.xy().norm() < 0.1 {
        return None;
    }
    let along = Vector3::new(along.x, along.y, 0.0).normalize();
    Some(Vector3::new(-along.y, along.x, 0.0))
}

/// The middle of the floor that a point stands on.
fn room_middle(point: &Vector3<f64>, bodies: &[SceneBody]) -> Option<Vector3<f64>> {
    let floors =
        bodies.iter().filter(|b| b.class == "floor").filter_map(|b| bounds(b, &Pose::identity()));
    let holds = |(low, high): &(Vector3<f64>, Vector3<f64>)| {
        (0..2).all(|i| (low[i] - 0.1..=high[i] + 0.1).contains(&point[i]))
    };
    // The smallest of those that hold the point: rooms' boxes may overlap.
    let area = |(low, high): &(Vector3<f64>, Vector3<f64>)| (high - low).x * (high - low).y;
    let room = floors.filter(holds).min_by(|a, b| area(a).total_cmp(&area(b)))?;
    Some((room.0 + room.1) / 2.0)
}

/// The object in the placeholder's box, and its scale.
fn replacement(
    body: &SceneBody,
    class: &str,
    tree: KinematicTree,
    notes: Vec<String>,
    yaw: f64,
    urdf_path: &Path,
) -> Result<(PlacedObject, f64), ModelError> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    let world_from_turned = Pose::from_parts(Vector3::zeros().into(), turn);
    let flat = || ModelError::invalid(urdf_path, format!("cannot be fitted to \"{}\"", body.name));
    let (body_low, body_high) = bounds(body, &world_from_turned.inverse()).ok_or_else(flat)?;
    let (low, high) = tree_bounds(&tree).ok_or_else(flat)?;
    let scale = (body_high - body_low).component_div(&(high - low)).min();
    if !(scale.is_finite() && scale > 0.0) {
        return Err(flat());
    }
    let tree = tree.scaled(scale);
    let (low, high) = (low * scale, high * scale);
    let turned_from_root = Pose::translation(
        body_low.x - low.x,
        (body_low.y + body_high.y - low.y - high.y) / 2.0,
        body_low.z - low.z,
    );
    let movable = tree.joints().iter().any(|j| j.kind != JointKind::Fixed);
    let mut ledger = Ledger::default();
    notes.into_iter().for_each(|note| ledger.repaired(note));
    if !movable {
        ledger.lost("the object has no joints");
    }
    ledger.repaired(format!("scaled by {scale:.4} to the box of \"{}\"", body.name));
    let object = ImportedObject {
        name: format!("{class}_{}", stem(urdf_path, "object")),
        class: class.to_owned(),
        tree,
        origin: Origin { source: stem(urdf_path, "object"), license: String::new() },
        semantics: Vec::new(),
        ledger,
    };
    let world_from_root = world_from_turned * turned_from_root;
    Ok((PlacedObject { object, world_from_root, replaces: Some(body.name.clone()) }, scale))
}

fn make_unique(objects: &mut [PlacedObject]) {
    let mut seen = std::collections::HashSet::new();
    for placed in objects {
        placed.object.name = super::free_name(&placed.object.name, |name| seen.contains(name));
        seen.insert(placed.object.name.clone());
    }
}
