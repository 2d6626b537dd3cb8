//! Houses of ProcTHOR and AI2-THOR as JSON: rooms, walls with holes, doors, windows and objects.
//!
//! Unity's frame is left-handed with Y up; x, y, z there are x, z, y here. Assets live inside Unity, so
//! objects become boxes of their asset's size, where a database states it, or of their kind's.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_model::{
    Joint, JointKind, KinematicTree, Link, Material, ModelError, Part, Pose, SceneBody, Shape,
    TriMesh,
};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use serde_json::Value;

use super::layout::{file_name, fixed};
use super::{
    ImportedObject, ImportedScene, Ledger, Origin, PlacedObject, classes, infinigen, read_text,
    stem,
};

/// Walls of neighbouring rooms stand back to back, this thick each, metres.
const WALL_THICKNESS_M: f64 = 0.05;
const DOOR_THICKNESS_M: f64 = 0.04;
/// How far doors open, radians.
const DOOR_OPENING: f64 = 1.6;
/// Room that a door's leaf leaves to its frame, metres.
const DOOR_GAP_M: f64 = 0.005;

/// Reads a house. `database` maps asset ids to `{"boundingBox": {"x", "y", "z"}}`, as ProcTHOR's own does.
///
/// # Errors
/// [`ModelError`] where a file is not of that kind.
pub fn read(path: &Path, database: Option<&Path>) -> Result<ImportedScene, ModelError> {
    let house = json(path)?;
    if !house["rooms"].is_array() || !house["walls"].is_array() {
        return Err(ModelError::invalid(
            path,
            "expected a house with the lists \"rooms\" and \"walls\"",
        ));
    }
    let database = database.map(json).transpose()?.unwrap_or(Value::Null);
    let mut ledger = Ledger::default();
    let mut bodies = Vec::new();
    for room in list(&house["rooms"]) {
        bodies.push(floor(path, room)?);
    }
    let holes: Vec<Hole> =
        ["doors", "windows"].iter().flat_map(|kind| holes_of(&house[kind])).collect();
    for wall in list(&house["walls"]) {
        if wall["empty"].as_bool() == Some(true) {
            continue;
        }
        bodies.extend(wall_body(path, wall, &holes)?);
    }
    let mut objects = Vec::new();
    for door in list(&house["doors"]) {
        match door_object(&house, door) {
            Some(object) => objects.push(object),
            None => ledger.lost(format!("door \"{}\" has no wall or hole", id(door))),
        }
    }
    for window in list(&house["windows"]) {
        match window_body(&house, window) {
            Some(body) => bodies.push(body),
            None => ledger.lost(format!("window \"{}\" has no wall or hole", id(window))),
        }
    }
    for object in list(&house["objects"]) {
        add_object(object, &database, &mut bodies, &mut ledger);
    }
    let bodies = super::unique_names(bodies, &mut ledger);
    let origin = Origin { source: "ProcTHOR/AI2-THOR house".into(), license: String::new() };
    Ok(ImportedScene { name: stem(path, "house"), bodies, objects, origin, ledger })
}

fn json(path: &Path) -> Result<Value, ModelError> {
    serde_json::from_str(&read_text(path)?)
        .map_err(|e| ModelError::invalid(path, format!("malformed JSON: {e}")))
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn id(value: &Value) -> &str {
    value["id"].as_str().unwrap_or("unnamed")
}

/// A point of Unity's frame in ours.
fn point(value: &Value) -> Option<Vector3<f64>> {
    Some(Vector3::new(value["x"].as_f64()?, value["z"].as_f64()?, value["y"].as_f64()?))
}

fn polygon(path: &Path, owner: &Value, key: &str) -> Result<Vec<Vector3<f64>>, ModelError> {
    let points: Option<Vec<_>> = list(&owner[key]).iter().map(point).collect();
    points.filter(|p| p.len() >= 3).ok_or_else(|| {
        ModelError::invalid(
            path,
            format!("\"{}\": {key}: expected at least 3 points {{x, y, z}}", id(owner)),
        )
    })
}

/// A room's floor.
fn floor(path: &Path, room: &Value) -> Result<SceneBody, ModelError> {
    let corners = polygon(path, room, "floorPolygon")?;
    let flat: Vec<Vector2<f64>> = corners.iter().map(|c| c.xy()).collect();
    let triangles = triangulated(&flat).ok_or_else(|| {
        ModelError::invalid(path, format!("\"{}\": floorPolygon crosses itself", id(room)))
    })?;
    let positions = corners.iter().map(|c| [c.x as f32, c.y as f32, c.z as f32]).collect();
    let kind = room["roomType"].as_str().unwrap_or("room").to_lowercase();
    let mesh = TriMesh {
        positions,
        triangles,
        material: colored("floor", [0.42, 0.34, 0.26]),
        ..TriMesh::default()
    };
    let name = format!("{kind}_{}.floor", file_name(id(room)));
    Ok(SceneBody { class: "floor".into(), ..infinigen::body(name, Pose::identity(), vec![mesh]) })
}

/// Ears of a simple polygon, cut one after the other (Meisters 1975), counter-clockwise.
fn triangulated(polygon: &[Vector2<f64>]) -> Option<Vec<[u32; 3]>> {
    let cross =
        |a: usize, b: usize, c: usize| (polygon[b] - polygon[a]).perp(&(polygon[c] - polygon[a]));
    let area: f64 =
        (0..polygon.len()).map(|i| polygon[i].perp(&polygon[(i + 1) % polygon.len()])).sum();
    let mut left: Vec<usize> = (0..polygon.len()).collect();
    if area < 0.0 {
        left.reverse();
    }
    let mut triangles = Vec::new();
    while left.len() > 2 {
        let count = left.len();
        let ear = (0..count).find(|&i| {
            let [a, b, c] = [left[(i + count - 1) % count], left[i], left[(i + 1) % count]];
            let holds = |&&p: &&usize| {
                ![a, b, c].contains(&p)
                    && cross(a, b, p) > 0.0
                    && cross(b, c, p) > 0.0
                    && cross(c, a, p) > 0.0
            };
            cross(a, b, c) >= 0.0 && !left.iter().any(|p| holds(&p))
        })?;
        let [a, b, c] = [left[(ear + count - 1) % count], left[ear], left[(ear + 1) % count]];
        if cross(a, b, c) > 1e-12 {
            triangles.push([a as u32, b as u32, c as u32]);
        }
        left.remove(ear);
    }
    Some(triangles)
}

/// A hole in a wall: from the wall's left end and its foot, metres.
struct Hole {
    walls: [String; 2],
    low: [f64; 2],
    high: [f64; 2],
}

fn holes_of(openings: &Value) -> Vec<Hole> {
    let hole = |opening: &Value| {
        let walls = ["wall0", "wall1"].map(|w| opening[w].as_str().unwrap_or("").to_owned());
        let corners: Option<Vec<_>> = list(&opening["holePolygon"]).iter().map(point).collect();
        let corners = corners.filter(|c| c.len() >= 2)?;
        // In a hole's own frame x runs along the wall and Unity's y up.
        let (a, b) = (corners[0], corners[1]);
        Some(Hole { walls, low: [a.x.min(b.x), a.z.min(b.z)], high: [a.x.max(b.x), a.z.max(b.z)] })
    };
    list(openings).iter().filter_map(hole).collect()
}

/// Where a wall runs: its left foot, the direction along it, its length and height.
struct Run {
    foot: Vector3<f64>,
    along: Vector3<f64>,
    length: f64,
    height: f64,
}

impl Run {
    fn of(corners: &[Vector3<f64>]) -> Option<Self> {
        let foot_z = corners.iter().map(|c| c.z).fold(f64::INFINITY, f64::min);
        let height = corners.iter().map(|c| c.z).fold(f64::NEG_INFINITY, f64::max) - foot_z;
        let mut feet: Vec<Vector3<f64>> = Vec::new();
        for corner in corners {
            let foot = Vector3::new(corner.x, corner.y, foot_z);
            if feet.iter().all(|f| (f - foot).norm() > 1e-6) {
                feet.push(foot);
            }
        }
        let [from, to] = feet[..] else { return None };
        let length = (to - from).norm();
        Some(Self { foot: from, along: (to - from) / length, length, height })
    }

    /// Pose of the middle of a patch of the wall; x along it, z up.
    fn patch(&self, low: [f64; 2], high: [f64; 2]) -> Pose {
        let middle = self.foot
            + self.along * ((low[0] + high[0]) / 2.0)
            + Vector3::z() * ((low[1] + high[1]) / 2.0);
        let yaw = self.along.y.atan2(self.along.x);
        Pose::from_parts(middle.into(), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw))
    }
}

/// A wall as boxes around its holes.
fn wall_body(path: &Path, wall: &Value, holes: &[Hole]) -> Result<Option<SceneBody>, ModelError> {
    let corners = polygon(path, wall, "polygon")?;
    let Some(run) = Run::of(&corners) else {
        return Err(ModelError::invalid(path, format!("wall \"{}\" is not upright", id(wall))));
    };
    if run.height < 1e-3 {
        return Ok(None);
    }
    let own = holes.iter().filter(|h| h.walls.iter().any(|w| w == id(wall)));
    let mut patches = vec![([0.0, 0.0], [run.length, run.height])];
    for hole in own {
        patches = patches.into_iter().flat_map(|patch| around(patch, hole)).collect();
    }
    let boxes: Vec<Part> = patches
        .into_iter()
        .enumerate()
        .map(|(index, (low, high))| Part {
            name: format!("wall_{index}"),
            link_from_part: run.patch(low, high),
            shape: Shape::Box { size: [high[0] - low[0], WALL_THICKNESS_M, high[1] - low[1]] },
            material: Some(colored("wall", [0.78, 0.76, 0.72])),
        })
        .collect();
    Ok((!boxes.is_empty()).then(|| SceneBody {
        name: format!("{}.wall", file_name(id(wall))),
        class: "wall".into(),
        world_from_body: Pose::identity(),
        visuals: boxes,
        collisions: Vec::new(),
    }))
}

/// What is left of a rectangle around a hole.
fn around((low, high): ([f64; 2], [f64; 2]), hole: &Hole) -> Vec<([f64; 2], [f64; 2])> {
    let inner_low = [low[0].max(hole.low[0]), low[1].max(hole.low[1])];
    let inner_high = [high[0].min(hole.high[0]), high[1].min(hole.high[1])];
    if inner_low[0] >= inner_high[0] || inner_low[1] >= inner_high[1] {
        return vec![(low, high)];
    }
    let pieces = [
        (low, [inner_low[0], high[1]]),
        ([inner_high[0], low[1]], high),
        ([inner_low[0], low[1]], [inner_high[0], inner_low[1]]),
        ([inner_low[0], inner_high[1]], [inner_high[0], high[1]]),
    ];
    let is_solid = |(low, high): &([f64; 2], [f64; 2])| (0..2).all(|i| high[i] - low[i] > 1e-6);
    pieces.into_iter().filter(is_solid).collect()
}

/// The wall that an opening is in, and the hole.
fn opening(house: &Value, opening: &Value) -> Option<(Run, Hole)> {
    let hole = holes_of(&Value::Array(vec![opening.clone()])).into_iter().next()?;
    let wall = list(&house["walls"]).iter().find(|w| id(w) == hole.walls[0])?;
    let corners: Option<Vec<_>> = list(&wall["polygon"]).iter().map(point).collect();
    Some((Run::of(&corners?)?, hole))
}

/// A leaf on a hinge, in the hole of a door; its root is the hinge's foot.
fn door_object(house: &Value, door: &Value) -> Option<PlacedObject> {
    let (run, hole) = opening(house, door)?;
    let width = hole.high[0] - hole.low[0] - 2.0 * DOOR_GAP_M;
    let height = hole.high[1] - hole.low[1] - 2.0 * DOOR_GAP_M;
    let name = file_name(&format!("door_{}", id(door)));
    let leaf = |name: &str, centre: [f64; 3], size: [f64; 3]| Part {
        name: name.into(),
        link_from_part: Pose::translation(centre[0], centre[1], centre[2]),
        shape: Shape::Box { size },
        material: Some(colored(name, [0.45, 0.30, 0.18])),
    };
    let bar_y = DOOR_THICKNESS_M / 2.0 + 0.04;
    let parts = vec![
        leaf("leaf", [width / 2.0, 0.0, height / 2.0], [width, DOOR_THICKNESS_M, height]),
        leaf("handle", [width - 0.08, -bar_y, 1.0], [0.02, 0.02, 0.16]),
        leaf("handle_post", [width - 0.08, -bar_y / 2.0 - 0.01, 1.0], [0.015, bar_y - 0.02, 0.02]),
    ];
    let frame = Link { name: "frame".into(), ..Link::default() };
    let leaf =
        Link { name: "leaf".into(), visuals: parts.clone(), collisions: parts, inertial: None };
    let hinge = Joint {
        kind: JointKind::Revolute,
        axis: Vector3::z_axis(),
        limits: [0.0, DOOR_OPENING],
        ..fixed("hinge", 0, 1, Pose::identity())
    };
    let tree = KinematicTree::new(name.clone(), vec![frame, leaf], vec![hinge]).ok()?;
    let foot = [hole.low[0] + DOOR_GAP_M, hole.low[1] + DOOR_GAP_M];
    let object = ImportedObject {
        class: "door".into(),
        origin: Origin {
            source: "ProcTHOR/AI2-THOR door, as a box".into(),
            license: String::new(),
        },
        semantics: Vec::new(),
        ledger: Ledger::default(),
        name,
        tree,
    };
    Some(PlacedObject { object, world_from_root: run.patch(foot, foot), replaces: None })
}

fn window_body(house: &Value, window: &Value) -> Option<SceneBody> {
    let (run, hole) = opening(house, window)?;
    let size = [hole.high[0] - hole.low[0], 0.02, hole.high[1] - hole.low[1]];
    let glass =
        Material { base_color: [0.7, 0.8, 0.85, 0.4], ..colored("glass", [0.7, 0.8, 0.85]) };
    Some(box_body(
        format!("{}.window", file_name(id(window))),
        "window",
        run.patch(hole.low, hole.high),
        size,
        glass,
    ))
}

/// Usual sizes of things that stand in houses where no database states them: width, depth, height, metres.
fn usual_size(kind: &str) -> Option<[f64; 3]> {
    let table: BTreeMap<&str, [f64; 3]> = BTreeMap::from([
        ("armchair", [0.85, 0.85, 0.85]),
        ("bed", [1.5, 2.0, 0.6]),
        ("bowl", [0.16, 0.16, 0.07]),
        ("chair", [0.45, 0.5, 0.9]),
        ("coffeetable", [1.0, 0.6, 0.42]),
        ("countertop", [1.8, 0.62, 0.92]),
        ("cup", [0.08, 0.08, 0.1]),
        ("desk", [1.3, 0.65, 0.75]),
        ("diningtable", [1.5, 0.9, 0.75]),
        ("dresser", [1.0, 0.5, 0.9]),
        ("fridge", [0.75, 0.75, 1.75]),
        ("garbagecan", [0.35, 0.35, 0.55]),
        ("microwave", [0.5, 0.38, 0.3]),
        ("mug", [0.09, 0.09, 0.1]),
        ("plate", [0.25, 0.25, 0.03]),
        ("shelvingunit", [0.9, 0.4, 1.6]),
        ("sidetable", [0.5, 0.45, 0.6]),
        ("sofa", [1.9, 0.9, 0.85]),
        ("stool", [0.4, 0.4, 0.65]),
        ("television", [1.1, 0.1, 0.65]),
        ("toilet", [0.45, 0.65, 0.75]),
        ("tvstand", [1.4, 0.45, 0.55]),
    ]);
    let plain: String =
        kind.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect();
    table.get(&*plain).copied()
}

/// An object and what stands on it, as boxes.
fn add_object(object: &Value, database: &Value, bodies: &mut Vec<SceneBody>, ledger: &mut Ledger) {
    let kind = id(object).split('|').next().unwrap_or("object");
    let asset = object["assetId"].as_str().unwrap_or("");
    let stated = |value: &Value| {
        let size = point(value)?;
        (size.min() > 0.0).then_some(<[f64; 3]>::from(size))
    };
    let size = stated(&database[asset]["boundingBox"])
        .or_else(|| stated(&object["boundingBox"]))
        .or_else(|| stated(&object["axisAlignedBoundingBox"]["size"]));
    let from_kind = || {
        let size = usual_size(kind)?;
        Some((size, true))
    };
    match (point(&object["position"]), size.map(|s| (s, false)).or_else(from_kind)) {
        (Some(position), Some((size, is_usual))) => {
            if is_usual {
                ledger.repaired(format!("\"{}\": a box of a usual {kind}'s size", id(object)));
            }
            // Unity turns clockwise seen from above.
            let yaw = -object["rotation"]["y"].as_f64().unwrap_or(0.0).to_radians();
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            bodies.push(box_body(
                file_name(id(object)),
                &classes::canonical(kind),
                Pose::from_parts(position.into(), turn),
                size,
                colored(kind, [0.55, 0.47, 0.40]),
            ));
        }
        (None, _) => ledger.lost(format!("\"{}\" has no position", id(object))),
        (_, None) => ledger.lost(format!(
            "\"{}\": neither the size of asset \"{asset}\" nor that of a {kind} is known",
            id(object)
        )),
    }
    for child in list(&object["children"]) {
        add_object(child, database, bodies, ledger);
    }
}

fn box_body(
    name: String,
    class: &str,
    pose: Pose,
    size: [f64; 3],
    material: Material,
) -> SceneBody {
    let part = Part {
        name: "box".into(),
        link_from_part: Pose::identity(),
        shape: Shape::Box { size },
        material: Some(material),
    };
    SceneBody {
        name,
        class: class.into(),
        world_from_body: pose,
        visuals: vec![part],
        collisions: Vec::new(),
    }
}

fn colored(name: &str, [r, g, b]: [f32; 3]) -> Material {
    Material { name: name.into(), base_color: [r, g, b, 1.0], ..Material::default() }
}
