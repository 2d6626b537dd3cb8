//! Generated objects: a thousand draws of their parameters.

#![allow(clippy::unwrap_used, reason = "a test that panics is a test that fails")]

mod common;

use akrobat_assets::appliances::HingeSide;
use akrobat_assets::description::{CollisionBox, Description};
use akrobat_assets::grasp::OPENING_M;
use akrobat_assets::object::{
    self, GeneratedObject, HandleKind, ObjectClass, ObjectRequest, palette_of,
};
use akrobat_assets::overlap::WorldBox;
use akrobat_assets::solid::Solid;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::{Pose, urdf};
use common::contents;
use nalgebra::{Point3, Vector3};

/// Draws of each class: 1,000 and a few in all.
const DRAWS: u64 = 77;
const TOLERANCE_M: f64 = 0.002;

fn drawn(class: ObjectClass, seed: u64) -> GeneratedObject {
    let request = ObjectRequest { seed, ..ObjectRequest::default() };
    object::generate(class, class.name(), &request, &palette_of(seed)).unwrap()
}

fn thousand() -> impl Iterator<Item = GeneratedObject> {
    ObjectClass::ALL.into_iter().flat_map(|class| (0..DRAWS).map(move |seed| drawn(class, seed)))
}

#[test]
fn every_surface_is_closed_and_faces_outwards() {
    let mut count = 0;
    for object in thousand() {
        count += 1;
        for link in &object.description.links {
            for solid in link.visuals.iter().flat_map(|visual| &visual.solids) {
                assert!(solid.is_closed() && solid.volume() > 0.0, "{}", name(&object));
            }
        }
    }
    assert!(count >= 1000, "{count} draws");
}

fn name(object: &GeneratedObject) -> String {
    format!("{} of seed {}", object.class.name(), object.seed)
}

/// Boxes of every link with the articulated joint at `position`.
fn placed(description: &Description, joint: &str, position: f64) -> (Vec<WorldBox>, Vec<WorldBox>) {
    let tree = description.tree().unwrap();
    let index = tree.joint_index(joint).unwrap();
    let mut q = tree.neutral();
    q[tree.column(index).unwrap()] = position;
    let poses = tree.link_poses(&Pose::identity(), &q);
    let (mut moved, mut rest) = (Vec::new(), Vec::new());
    for (link, (body, pose)) in description.links.iter().zip(&poses).enumerate() {
        let boxes = body.collisions.iter().map(|shape| WorldBox::new(pose, shape));
        if tree.chain_to(link).contains(&index) { moved.extend(boxes) } else { rest.extend(boxes) }
    }
    (moved, rest)
}

fn deepest(description: &Description, joint: &str, upper: f64) -> f64 {
    let at = |step: usize| {
        let (moved, rest) = placed(description, joint, upper * step as f64 / 16.0);
        let depths = moved.iter().flat_map(|a| rest.iter().map(|b| a.penetration(b)));
        depths.fold(f64::NEG_INFINITY, f64::max)
    };
    (0..=16).map(at).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn joints_sweep_without_self_intersection() {
    for object in thousand() {
        if let Some(articulation) = &object.articulation {
            let [lower, upper] = articulation.limits;
            assert_eq!(lower, 0.0);
            let depth = deepest(&object.description, &articulation.joint, upper);
            assert!(depth < TOLERANCE_M, "{}: {depth} m", name(&object));
        }
    }
}

#[test]
fn a_hinge_out_of_place_intersects() {
    let mut object = drawn(ObjectClass::Oven, 3);
    let articulation = object.articulation.unwrap();
    object.description.joints[0].origin[0] -= 0.01;
    assert!(
        deepest(&object.description, &articulation.joint, articulation.limits[1]) > TOLERANCE_M
    );
}

/// Distances from `from` along `direction` at which a ray meets the triangles (Moeller and Trumbore, *Fast,
/// minimum storage ray/triangle intersection*, JGT 1997), metres.
fn hits(solids: &[Solid], from: &Point3<f64>, direction: &Vector3<f64>) -> Vec<f64> {
    let mut found = Vec::new();
    for solid in solids {
        for triangle in &solid.triangles {
            let [a, b, c] = triangle.map(|corner| solid.positions[corner.position]);
            let (ab, ac) = (b - a, c - a);
            let across = direction.cross(&ac);
            let determinant = ab.dot(&across);
            if determinant.abs() < 1e-15 {
                continue;
            }
            let offset = from - a;
            let u = offset.dot(&across) / determinant;
            let along = offset.cross(&ab);
            let v = direction.dot(&along) / determinant;
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                found.push(ac.dot(&along) / determinant);
            }
        }
    }
    found
}

/// Width of what is between the open pads at a grasp, metres, by rays through the triangles of the held parts;
/// `None` where nothing is, or where it reaches a pad.
fn width_between_pads(object: &GeneratedObject, grasp: &Pose) -> Option<f64> {
    let held =
        object.description.links.iter().find(|link| link.name == object.handle_link).unwrap();
    let is_held =
        |part: &str| object.held_parts.is_empty() || object.held_parts.iter().any(|p| p == part);
    let solids: Vec<Solid> = held
        .visuals
        .iter()
        .filter(|visual| is_held(&visual.name))
        .flat_map(|visual| visual.solids.clone())
        .collect();
    let closing = grasp.rotation * Vector3::y();
    // Off the planes of symmetry, where rays would meet the edges of triangles.
    let aside = grasp.rotation * Vector3::new(1.3e-4, 0.0, 0.7e-4);
    let middle = Point3::from(grasp.translation.vector + aside);
    let reach = |side: f64| {
        let from = middle + closing * (side * OPENING_M / 2.0);
        let found = hits(&solids, &from, &(closing * -side));
        let nearest = found.into_iter().filter(|t| *t > 0.0 && *t < OPENING_M);
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        nearest.is_finite().then_some(nearest)
    };
    let width = OPENING_M - reach(1.0)? - reach(-1.0)?;
    (width > 0.003 && width < OPENING_M - 0.006).then_some(width)
}

#[test]
fn a_parallel_gripper_of_8_cm_can_hold_every_object() {
    for object in thousand() {
        assert!(object.grasps.len() >= 4, "{}: {} grasps", name(&object), object.grasps.len());
        for grasp in &object.grasps {
            let width = width_between_pads(&object, grasp);
            assert!(width.is_some(), "{}: nothing to hold at {grasp}", name(&object));
        }
    }
}

#[test]
fn a_grasp_beside_the_handle_holds_nothing() {
    let object = drawn(ObjectClass::Microwave, 1);
    let aside = Pose::translation(0.0, 0.0, 0.5) * object.grasps[0];
    assert_eq!(width_between_pads(&object, &aside), None);
}

#[test]
fn a_gripper_inside_the_door_does_not_fit() {
    let object = drawn(ObjectClass::Refrigerator, 1);
    let pushed = Pose::translation(-0.06, 0.0, 0.0) * object.grasps[0];
    let fitting =
        akrobat_assets::grasp::fitting(&object.description, &object.handle_link, &[pushed]);
    assert!(fitting.unwrap().is_empty());
}

#[test]
fn every_handle_style_fits_every_appliance() {
    use HandleKind::{Arch, Bar, Knob, Lever, Recess};
    for class in ObjectClass::ALL.into_iter().filter(|class| class.is_articulated()) {
        for handle in [Bar, Arch, Knob, Recess, Lever] {
            let request =
                ObjectRequest { handle: Some(handle), seed: 5, ..ObjectRequest::default() };
            let object = object::generate(class, "object", &request, &palette_of(5));
            if handle == Lever && class != ObjectClass::Door {
                let refusal = object.unwrap_err().to_string();
                assert!(refusal.contains("valid handles: bar, arch, knob, recess"), "{refusal}");
            } else if handle == Recess && class == ObjectClass::TrashCan {
                let refusal = object.unwrap_err().to_string();
                assert!(refusal.contains("valid handles: bar, arch, knob"), "{refusal}");
            } else {
                let grasps = object.unwrap().grasps.len();
                assert!(grasps >= 4, "{} with {handle:?}: {grasps}", class.name());
            }
        }
    }
}

#[test]
fn names_of_collision_shapes_differ_in_the_whole_model() {
    for object in ObjectClass::ALL.map(|class| drawn(class, 2)) {
        let tree = object.description.tree().unwrap();
        let names: Vec<&str> = tree
            .links()
            .iter()
            .flat_map(|l| &l.collisions)
            .map(|part| part.name.as_str())
            .collect();
        let different: std::collections::HashSet<_> = names.iter().collect();
        assert_eq!(different.len(), names.len(), "{}: {names:?}", name(&object));
    }
}

#[test]
fn doors_are_hinged_on_either_side() {
    for class in ObjectClass::ALL.into_iter().filter(|class| class.has_hinge_side()) {
        let side = |hinge_side| {
            let request = ObjectRequest { hinge_side: Some(hinge_side), ..Default::default() };
            let object = object::generate(class, "door", &request, &palette_of(1)).unwrap();
            let joint = object.articulation.unwrap().joint;
            let hinge = object.description.joints.into_iter().find(|j| j.name == joint).unwrap();
            (hinge.origin[1], hinge.motion.unwrap().axis.z)
        };
        let (left, right) = (side(HingeSide::Left), side(HingeSide::Right));
        assert!(left.0 < 0.0 && right.0 > 0.0, "{}: {left:?} {right:?}", class.name());
        assert_eq!(left.1, -right.1, "{}", class.name());
    }
}

#[test]
fn given_dimensions_are_kept_and_leave_the_others_alone() {
    let request = ObjectRequest { seed: 9, width_m: Some(0.55), ..ObjectRequest::default() };
    let wide = object::generate(ObjectClass::Refrigerator, "r", &request, &palette_of(9)).unwrap();
    let drawn = drawn(ObjectClass::Refrigerator, 9);
    assert_eq!(wide.size_m[1], 0.55);
    assert_eq!((wide.size_m[0], wide.size_m[2]), (drawn.size_m[0], drawn.size_m[2]));
}

#[test]
fn the_seed_decides_every_byte() {
    for class in ObjectClass::ALL {
        let written: Vec<_> = [3, 3, 4]
            .map(|seed| {
                let folder = tempfile::tempdir().unwrap();
                drawn(class, seed).write(folder.path()).unwrap();
                contents(folder.path())
            })
            .into();
        assert_eq!(written[0], written[1]);
        assert_ne!(written[0], written[2]);
    }
}

#[test]
fn folders_load_as_tasks_without_repairs() {
    let robots = tempfile::tempdir().unwrap();
    let robot = akrobat_assets::robot::DemoRobot::Pillar.write(robots.path()).unwrap();
    for class in ObjectClass::ALL {
        let object = drawn(class, 2);
        let folder = tempfile::tempdir().unwrap();
        object.write(folder.path()).unwrap();
        let path = folder.path().join("task.toml");
        std::fs::write(&path, object::task_text(&object, &robot.display().to_string())).unwrap();
        let task = load::task(&path, &AssetSearch::default()).unwrap();
        assert!(task.object.notes.is_empty(), "{}: {:?}", name(&object), task.object.notes);
        assert_eq!(task.grasp_poses.len(), object.grasps.len());
        let urdf_path = folder.path().join(format!("{}.urdf", class.name()));
        let (tree, _) = urdf::read(&urdf_path, &AssetSearch::default()).unwrap();
        for link in tree.links().iter().filter(|link| !link.collisions.is_empty()) {
            let [ixx, _, _, iyy, _, izz] = link.inertial.as_ref().unwrap().inertia;
            assert!(ixx > 0.0 && ixx + iyy > izz && iyy + izz > ixx && izz + ixx > iyy);
        }
    }
}

#[test]
fn boxes_of_collision_stand_for_what_is_seen() {
    for object in ObjectClass::ALL.map(|class| drawn(class, 6)) {
        for link in &object.description.links {
            let inside = |point: &Point3<f64>, shape: &CollisionBox| {
                let local = shape.link_from_box.inverse_transform_point(point);
                (0..3).all(|axis| local[axis].abs() < shape.size[axis] / 2.0 + 0.012)
            };
            for solid in link.visuals.iter().flat_map(|visual| &visual.solids) {
                for point in &solid.positions {
                    let covered = link.collisions.iter().any(|shape| inside(point, shape));
                    assert!(covered, "{}: {} at {point}", name(&object), link.name);
                }
            }
        }
    }
}
