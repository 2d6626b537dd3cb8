//! Every shared real input loads, with plausible content.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

use std::path::{Path, PathBuf};

use akrobat_model::load::AssetSearch;
use akrobat_model::{KinematicTree, Pose, fixtures, load, mesh_io, pose, urdf};
use nalgebra::Vector3;

fn read(path: &Path) -> (KinematicTree, Vec<String>) {
    urdf::read(path, &AssetSearch::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn visual_triangles(tree: &KinematicTree) -> usize {
    let parts = tree.links().iter().flat_map(|l| &l.visuals);
    parts.flat_map(|p| p.triangulate()).map(|m| m.triangles.len()).sum()
}

/// Corners of the box around all visuals at a configuration.
fn visual_bounds(tree: &KinematicTree, q: &[f64]) -> (Vector3<f64>, Vector3<f64>) {
    let poses = tree.link_poses(&Pose::identity(), q);
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = -low;
    for (link, pose) in tree.links().iter().zip(poses) {
        for mesh in link.visuals.iter().flat_map(|p| p.triangulate()) {
            for p in &mesh.positions {
                let p = (pose * nalgebra::Point3::from(p.map(f64::from))).coords;
                (low, high) = (low.inf(&p), high.sup(&p));
            }
        }
    }
    (low, high)
}

fn summit(assets: &Path) -> PathBuf {
    assets.join("robots/summit_xl_franka/summit_xl_franka.urdf")
}

#[test]
fn summit_franka_loads() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let (tree, notes) = read(&summit(&assets));
    assert_eq!(tree.dof(), 3 + 7 + 2);
    assert_eq!(tree.links()[tree.root()].name, "world");
    let triangles = visual_triangles(&tree);
    assert!((190_000..200_000).contains(&triangles), "{triangles}");
    assert!(notes.iter().any(|n| n.contains("panda_link0") && n.contains("inertia")), "{notes:?}");
    // finger.dae is used twice and loaded once.
    let finger = |name: &str| {
        let link = &tree.links()[tree.link_index(name).unwrap()];
        match &link.visuals[0].shape {
            akrobat_model::Shape::Mesh { meshes, .. } => meshes.clone(),
            other => panic!("{other:?}"),
        }
    };
    let (left, right) = (finger("panda_leftfinger"), finger("panda_rightfinger"));
    assert!(std::sync::Arc::ptr_eq(&left, &right));
}

/// The chassis' collision mesh says Y up and is Z up, like its visual mesh: COLLADA's up axis must be
/// ignored for the two to agree.
#[test]
fn collada_meshes_of_one_link_agree() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let folder = assets.join("robots/summit_xl_franka/meshes/summit_xl");
    let height = |name: &str| {
        let meshes = mesh_io::load(&folder.join(name)).unwrap();
        let bounds = meshes.iter().filter_map(|m| m.bounds());
        bounds.map(|(_, high)| high[2]).fold(f32::NEG_INFINITY, f32::max)
    };
    let (visual, collision) =
        (height("summit_xl_chassis.dae"), height("summit_xl_chassis_collision.dae"));
    assert!((visual - collision).abs() < 0.005, "{visual} {collision}");
}

#[test]
fn every_object_loads() {
    let Some(assets) = fixtures::shared_assets() else { return };
    for (name, movable, frictional) in [
        ("microwave_1001/microwave.urdf", 5, true),
        ("dishwasher_1001/dishwasher.urdf", 4, true),
        ("cabinet_1001/cabinet.urdf", 2, true),
        ("drawer_1001/drawer.urdf", 3, true),
        ("oven_1001/oven.urdf", 4, false),
        ("refrigerator_1001/refrigerator.urdf", 3, false),
        ("trash_1001/trash.urdf", 1, false),
        ("sektion_cabinet/urdf/sektion_cabinet.urdf", 4, false),
        ("sektion_cabinet/urdf/sektion_cabinet_2.urdf", 4, false),
    ] {
        let (tree, notes) = read(&assets.join("objects").join(name));
        let has = |word: &str| notes.iter().any(|note| note.contains(word));
        assert_eq!(has("merged into one"), !name.starts_with("sektion"), "{name}: {notes:?}");
        assert_eq!(has("large friction"), frictional, "{name}: {notes:?}");
        let (low, high) = visual_bounds(&tree, &tree.neutral());
        let size = high - low;
        assert_eq!(tree.dof(), movable, "{name}");
        assert!(visual_triangles(&tree) > 500, "{name}");
        assert!(tree.links().iter().any(|l| !l.collisions.is_empty()), "{name}");
        assert!(size.max() > 0.2 && size.max() < 20.0, "{name}: {size:?}");
    }
}

#[test]
fn textures_of_objects_are_there() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let (tree, notes) = read(&assets.join("objects/drawer_1001/drawer.urdf"));
    let parts = tree.links().iter().flat_map(|l| &l.visuals).flat_map(|p| p.triangulate());
    let with_texture =
        parts.filter(|m| m.material.base_color_texture.is_some() && !m.uvs.is_empty());
    assert!(with_texture.count() > 3);
    assert!(!notes.iter().any(|n| n.contains("texture")), "{notes:?}");
}

#[test]
fn every_scene_loads() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let kitchen = assets.join("scenes/infinigen_kitchen_1/scene.glb");
    let scene = mesh_io::gltf::load_scene(&kitchen).unwrap();
    assert_eq!(scene.nodes.len(), 47);
    let triangles: usize =
        scene.nodes.iter().flat_map(|n| &n.meshes).map(|m| m.triangles.len()).sum();
    assert!((430_000..440_000).contains(&triangles), "{triangles}");
    let living = assets.join("scenes/drake_living_room/models/assets");
    for entry in std::fs::read_dir(living).unwrap().flatten() {
        if entry.path().extension().is_some_and(|e| e == "gltf") {
            let file = mesh_io::load_with_notes(&entry.path()).unwrap_or_else(|e| panic!("{e}"));
            assert!(file.notes.is_empty(), "{:?}", file.notes);
            let textured = file.meshes.iter().any(|m| m.material.base_color_texture.is_some());
            let name = entry.file_name();
            let plain = ["sphere.gltf", "living_room.gltf", "curtain_open.gltf"];
            assert!(textured || plain.iter().any(|p| name == *p), "{name:?} lost its textures");
        }
    }
}

/// The tasks that the project ships for these inputs, with the robots that can be had without a download.
#[test]
fn every_shipped_task_loads() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/tasks");
    let search = AssetSearch { folders: vec![assets] };
    let mut loaded = 0;
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(configs).unwrap().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if !name.starts_with("summit_") {
            continue;
        }
        let task = load::task(&path, &search).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(task.robot.trajectory_joints().len(), 12, "{name}");
        assert!(task.object.tree.joint_index(&task.file.object.joint).is_ok());
        for key in ["task", "robot", "robot.urdf", "robot.meshes", "object.urdf", "object.meshes"] {
            assert_eq!(task.content_hashes[key].len(), 64, "{name}: {key}");
        }
        loaded += 1;
    }
    assert!(loaded >= 10, "{loaded} tasks");
}

#[test]
fn the_kitchen_stands_on_its_floor() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/tasks");
    let search = AssetSearch { folders: vec![assets] };
    let task = load::task(&configs.join("summit_oven_kitchen.toml"), &search).unwrap();
    let height = |name: &str| {
        let body = task.scene.bodies.iter().find(|b| b.name.starts_with(name)).unwrap();
        let meshes = body.visuals.iter().flat_map(|p| p.triangulate());
        let z = |p: &[f32; 3]| (body.world_from_body * nalgebra::Point3::from(p.map(f64::from))).z;
        meshes
            .flat_map(|m| m.positions)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
                (low.min(z(&p)), high.max(z(&p)))
            })
    };
    assert!(height("kitchen_0/0.floor").1.abs() < 1e-6);
    let (bottom, top) = height("kitchen_0/0.wall");
    assert!(bottom.abs() < 0.3 && (2.0..4.0).contains(&top), "{bottom} {top}");
    let (bottom, _) = height("DishwasherFactory");
    assert!(bottom.abs() < 0.02, "{bottom}");
}

/// Pinocchio 4 on the same URDF: `framesForwardKinematics` at this configuration, `oMf["panda_hand"]`
/// times the tool frame's offset of 0.1034 m along z.
#[test]
fn forward_kinematics_agree_with_pinocchio() {
    let Some(assets) = fixtures::shared_assets() else { return };
    let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/robots/summit_franka.toml");
    let robot = load::robot(&robot, &AssetSearch { folders: vec![assets] }).unwrap();
    let q =
        robot.configuration(&[0.5, -0.25, 0.75, 0.0, -1.3, 0.0, -2.5, 0.0, 1.0, 0.0, 0.04, 0.04]);
    let world_from_link = robot.tree.link_poses(&robot.world_from_root, &q);
    let world_from_tool = world_from_link[robot.tool_link] * robot.link_from_tool;
    let expected = pose::from_xyz_wxyz([
        0.46437449,
        -0.26655748,
        0.95455647,
        -0.00176687,
        0.71591596,
        0.69101203,
        -0.09981778,
    ])
    .unwrap();
    let position = world_from_tool.translation.vector - expected.translation.vector;
    assert!(position.norm() < 1e-7, "{world_from_tool} {expected}");
    assert!(world_from_tool.rotation.angle_to(&expected.rotation) < 1e-6);
    assert_eq!(robot.finger_positions(0.04), [0.02, 0.02]);
}

/// Triangles, surface area and bounding box as trimesh 5 has them: `len(m.faces)`, `m.area`, `m.bounds`
/// of `trimesh.load(file, process=False)`, its scene dumped into one mesh.
#[test]
fn meshes_agree_with_trimesh() {
    let Some(assets) = fixtures::shared_assets() else { return };
    for line in include_str!("golden/meshes.txt").lines() {
        let (file, numbers) = line.split_once(' ').unwrap();
        let golden: Vec<f64> = numbers.split(' ').map(|n| n.parse().unwrap()).collect();
        let meshes = mesh_io::load(&assets.join(file)).unwrap_or_else(|e| panic!("{e}"));
        let triangles: Vec<[Vector3<f64>; 3]> = meshes
            .iter()
            .flat_map(|m| (0..m.triangles.len()).map(|t| m.corners(t)))
            .map(|corners| corners.map(|p| Vector3::from(p.map(f64::from))))
            .collect();
        assert_eq!(triangles.len() as f64, golden[0], "{file}");
        let area: f64 =
            triangles.iter().map(|[a, b, c]| (b - a).cross(&(c - a)).norm() / 2.0).sum();
        assert!((area / golden[1] - 1.0).abs() < 1e-4, "{file}: {area}");
        let first = triangles[0][0];
        let (low, high) = triangles
            .iter()
            .flatten()
            .fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
        let bounds = low.iter().chain(high.iter());
        for (ours, theirs) in bounds.zip(&golden[2..]) {
            assert!((ours - theirs).abs() < 1e-5, "{file}: {low} {high}");
        }
    }
}
