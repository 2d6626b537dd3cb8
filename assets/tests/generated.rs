//! What the generators write: closed meshes, URDFs that load, doors that swing freely.

#![allow(clippy::unwrap_used, reason = "a test that panics is a test that fails")]

mod common;

use std::collections::HashMap;

use akrobat_assets::appliances::{
    Appliance, Cabinet, Dishwasher, DrawerUnit, HingeSide, Microwave, Oven, Refrigerator,
};
use akrobat_assets::description::{CollisionBox, Description};
use akrobat_assets::handle::{HandleStyle, Orientation, handle_link};
use akrobat_assets::kitchen::Kitchen;
use akrobat_assets::{Palette, demo};
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::{Pose, Shape, urdf};
use common::contents;
use nalgebra::Point3;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

const STYLES: [HandleStyle; 3] = [HandleStyle::BAR, HandleStyle::ARCH, HandleStyle::KNOB];

fn palette() -> Palette {
    Palette::sample(&mut ChaCha8Rng::seed_from_u64(5))
}

/// Every appliance, with every handle and both hinge sides.
fn appliances() -> Vec<Appliance> {
    let palette = palette();
    let mut all = Vec::new();
    for handle in STYLES {
        for hinge_side in [HingeSide::Left, HingeSide::Right] {
            let cabinet = Cabinet { handle, hinge_side, ..Cabinet::default() };
            let refrigerator = Refrigerator { handle, hinge_side, ..Refrigerator::default() };
            all.push(cabinet.build("base_cabinet", &palette));
            all.push(refrigerator.build("refrigerator", &palette));
        }
        all.push(Microwave { handle, ..Microwave::default() }.build("microwave", &palette));
        all.push(DrawerUnit { handle, ..DrawerUnit::default() }.build("drawer_unit", &palette));
        all.push(Oven { handle, ..Oven::default() }.build("oven", &palette));
        all.push(Dishwasher { handle, ..Dishwasher::default() }.build("dishwasher", &palette));
    }
    all.into_iter().collect::<Result<_, _>>().unwrap()
}

/// Edges of an OBJ text that are not shared by exactly two opposite faces.
fn open_edges(obj: &str) -> usize {
    let mut edges: HashMap<(usize, usize), usize> = HashMap::new();
    for face in obj.lines().filter_map(|line| line.strip_prefix("f ")) {
        let corners: Vec<usize> = face
            .split(' ')
            .map(|corner| corner.split('/').next().unwrap().parse().unwrap())
            .collect();
        for k in 0..3 {
            *edges.entry((corners[k], corners[(k + 1) % 3])).or_default() += 1;
        }
    }
    edges.iter().filter(|&(&(a, b), &n)| n != 1 || edges.get(&(b, a)) != Some(&1)).count()
}

#[test]
fn written_meshes_are_closed_and_urdfs_load_without_repairs() {
    for appliance in appliances() {
        let folder = tempfile::tempdir().unwrap();
        appliance.description.write(folder.path()).unwrap();
        for (name, bytes) in contents(folder.path()) {
            if name.ends_with(".obj") {
                let text = String::from_utf8(bytes).unwrap();
                assert_eq!(open_edges(&text), 0, "{name}");
                let without_last_face = text.trim_end().rsplit_once('\n').unwrap().0;
                assert_eq!(open_edges(without_last_face), 3, "{name}");
            }
        }
        let name = &appliance.description.name;
        let path = folder.path().join(format!("{name}.urdf"));
        let (tree, notes) = urdf::read(&path, &AssetSearch::default()).unwrap();
        assert!(notes.is_empty(), "{name}: {notes:?}");
        let joint = &tree.joints()[tree.joint_index(&appliance.joint).unwrap()];
        for &goal in &appliance.goals {
            assert!((joint.limits[0]..=joint.limits[1]).contains(&goal), "{name}: {goal}");
        }
        let handle = &tree.links()[tree.link_index(&appliance.handle_link).unwrap()];
        assert!(handle.visuals.iter().all(|part| !part.triangulate().is_empty()), "{name}");
        let body = &tree.links()[tree.root()];
        let inertia = body.inertial.as_ref().unwrap().inertia;
        assert!(inertia[0] > 0.0 && inertia[0] + inertia[3] > inertia[5], "{name}: {inertia:?}");
    }
}

#[test]
fn triangles_of_textured_faces_carry_texture_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let oven = Oven::default().build("oven", &palette()).unwrap();
    oven.description.write(folder.path()).unwrap();
    let (tree, _) = urdf::read(&folder.path().join("oven.urdf"), &AssetSearch::default()).unwrap();
    let Shape::Mesh { meshes, .. } = &tree.links()[tree.root()].visuals[0].shape else {
        panic!("the housing is a mesh")
    };
    assert!(meshes[0].material.base_color_texture.is_some());
    assert_eq!(meshes[0].uvs.len(), meshes[0].positions.len());
}

/// Points of a box in its link's frame: a grid of at most 2 cm on its surface.
fn surface_points(shape: &CollisionBox) -> Vec<Point3<f64>> {
    let counts = shape.size.map(|edge| (edge / 0.02).ceil() as usize);
    let mut points = Vec::new();
    for i in 0..=counts[0] {
        for j in 0..=counts[1] {
            for k in 0..=counts[2] {
                let index = [i, j, k];
                if (0..3).any(|axis| index[axis] == 0 || index[axis] == counts[axis]) {
                    let local = Point3::from(std::array::from_fn::<f64, 3, _>(|axis| {
                        shape.size[axis] * (index[axis] as f64 / counts[axis] as f64 - 0.5)
                    }));
                    points.push(shape.link_from_box * local);
                }
            }
        }
    }
    points
}

/// How deep a point lies in a box, metres; negative outside.
fn depth(point: &Point3<f64>, world_from_box: &Pose, size: &[f64; 3]) -> f64 {
    let local = world_from_box.inverse_transform_point(point);
    (0..3).map(|axis| size[axis] / 2.0 - local[axis].abs()).fold(f64::INFINITY, f64::min)
}

/// Deepest penetration over the sweep of one joint between what it moves and the rest, metres.
fn deepest_penetration(description: &Description, joint: &str) -> f64 {
    let tree = description.tree().unwrap();
    let joint = tree.joint_index(joint).unwrap();
    let column = tree.column(joint).unwrap();
    let moved = |link: usize| tree.chain_to(link).contains(&joint);
    let mut deepest = f64::NEG_INFINITY;
    for step in 0..=24 {
        let mut q = tree.neutral();
        q[column] = tree.joints()[joint].limits[1] * f64::from(step) / 24.0;
        let poses = tree.link_poses(&Pose::identity(), &q);
        for mover in (0..tree.links().len()).filter(|&l| moved(l)) {
            for shape in &description.links[mover].collisions {
                for point in surface_points(shape) {
                    let world = poses[mover] * point;
                    for other in (0..tree.links().len()).filter(|&l| !moved(l)) {
                        for fixed in &description.links[other].collisions {
                            let pose = poses[other] * fixed.link_from_box;
                            deepest = deepest.max(depth(&world, &pose, &fixed.size));
                        }
                    }
                }
            }
        }
    }
    deepest
}

#[test]
fn joints_sweep_without_self_intersection() {
    for appliance in appliances() {
        let deepest = deepest_penetration(&appliance.description, &appliance.joint);
        assert!(deepest < 0.002, "{}: {deepest} m", appliance.description.name);
    }
}

#[test]
fn a_hinge_in_the_wrong_place_is_noticed() {
    let mut cabinet = Cabinet::default().build("base_cabinet", &palette()).unwrap();
    cabinet.description.joints[0].origin[0] -= 0.05;
    assert!(deepest_penetration(&cabinet.description, &cabinet.joint) > 0.005);
}

#[test]
fn closed_fronts_are_flush() {
    for appliance in appliances() {
        let description = &appliance.description;
        let tree = description.tree().unwrap();
        let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
        for (link, pose) in description.links.iter().zip(&poses) {
            let is_front = link.name == "door" || link.name.starts_with("drawer_");
            for shape in link.collisions.iter().filter(|_| is_front) {
                let front = (pose * shape.link_from_box).translation.x + shape.size[0] / 2.0;
                let is_face = shape.name == "panel" || shape.name == "front";
                assert_eq!(
                    (front - appliance.size[0]).abs() < 0.001,
                    is_face,
                    "{}: {} of {} ends at {front} m",
                    description.name,
                    shape.name,
                    link.name
                );
            }
        }
    }
}

#[test]
fn handles_fit_between_the_pads_and_leave_room_for_them() {
    for style in STYLES {
        for orientation in [Orientation::Horizontal, Orientation::Vertical] {
            let link = handle_link("handle", style, orientation, &palette().handle);
            let across = if orientation == Orientation::Horizontal { 2 } else { 1 };
            let (low, high) = link.visuals[0].solids.iter().map(|s| s.bounds()).fold(
                ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]),
                |(low, high), (l, h)| {
                    (
                        std::array::from_fn(|i| low[i].min(l[i])),
                        std::array::from_fn(|i| high[i].max(h[i])),
                    )
                },
            );
            let width = high[across] - low[across];
            assert!(width < 0.08 && width > 0.004, "{style:?}: {width} m across");
            assert!((width - style.grip_width_m()).abs() < 0.001, "{style:?}: {width} m");
            assert!((high[0] - style.depth_m()).abs() < 0.001, "{style:?}: {} m", high[0]);
            assert!(high[0] >= 0.03, "{style:?}: fingers need 3 cm of depth");
        }
    }
}

#[test]
fn collision_boxes_cover_the_handles_without_swelling_them() {
    for style in STYLES {
        let link = handle_link("handle", style, Orientation::Horizontal, &palette().handle);
        for solid in &link.visuals[0].solids {
            for position in solid.positions.iter().filter(|p| p.x > 0.0) {
                let deepest = link
                    .collisions
                    .iter()
                    .map(|b| depth(position, &b.link_from_box, &b.size))
                    .fold(f64::NEG_INFINITY, f64::max);
                assert!(deepest > -0.005, "{style:?}: {position} is {} m outside", -deepest);
            }
        }
    }
}

#[test]
fn impossible_dimensions_are_refused_in_words() {
    let flat = Cabinet { height_m: 0.2, ..Cabinet::default() };
    let error = flat.build("flat", &palette()).unwrap_err().to_string();
    assert_eq!(error, "cabinet height: expected plinth + 0.3 to 2.4 m, got 0.2");
    let nan = Oven { width_m: f64::NAN, ..Oven::default() };
    assert!(nan.build("nan", &palette()).is_err());
}

#[test]
fn the_seed_decides_every_byte() {
    let folders: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
    for (folder, seed) in folders.iter().zip([3, 3, 4]) {
        demo::write(folder.path(), seed, None).unwrap();
    }
    let written: Vec<_> = folders.iter().map(|f| contents(f.path())).collect();
    assert_eq!(written[0], written[1]);
    assert_ne!(written[0], written[2]);
}

#[test]
fn the_demonstration_loads_and_leaves_room_for_the_robot() {
    for seed in 0..4 {
        let folder = tempfile::tempdir().unwrap();
        let paths = demo::write(folder.path(), seed, None).unwrap();
        assert_eq!(paths.tasks.len(), 3);
        for path in &paths.tasks {
            let task = load::task(path, &AssetSearch::default()).unwrap();
            let twin = task.file.scene.remove.first().unwrap();
            assert!(task.scene.bodies.iter().all(|body| body.name != *twin), "{twin} is left out");
            assert!(task.scene.bodies.len() > 20);
            assert!(task.object.notes.is_empty() && task.scene.notes.is_empty());
            let poses =
                task.object.tree.link_poses(&task.object.world_from_root, &task.object.start);
            let handle = poses[task.object.handle_link].translation.vector;
            assert!((0.5..1.2).contains(&handle.z), "{}: {handle}", path.display());
            for body in &task.scene.bodies {
                for part in body.collision_parts() {
                    let Shape::Box { size } = part.shape else { panic!("{} has boxes", body.name) };
                    let centre = (body.world_from_body * part.link_from_part).translation.vector;
                    // A floor of 1.5 x 1.2 m in front of the handle, up to 1.5 m.
                    let low = [handle.x + 0.1, handle.y - 0.6, 0.01];
                    let high = [handle.x + 1.6, handle.y + 0.6, 1.5];
                    let apart = (0..3).any(|i| {
                        centre[i] + size[i] / 2.0 < low[i] || centre[i] - size[i] / 2.0 > high[i]
                    });
                    assert!(apart, "{}: {} stands in the way", path.display(), body.name);
                }
            }
        }
    }
}

#[test]
fn the_kitchen_of_a_seed_keeps_its_openables_among_its_bodies() {
    let kitchen = Kitchen::generate(9).unwrap();
    for openable in &kitchen.openables {
        assert!(kitchen.scene.links.iter().any(|link| link.name == openable.body));
    }
}
