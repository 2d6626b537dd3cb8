//! The task and robot files in `configs/` load, and ask for what is possible.

#![allow(clippy::unwrap_used, reason = "a test that panics is a test that fails")]

use std::path::{Path, PathBuf};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::{ObjectKind, Task, matches_pattern};
use akrobat_model::{JointKind, fixtures};
use nalgebra::{Point3, Vector3};

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn task_files(robot: &str) -> Vec<PathBuf> {
    let folder = std::fs::read_dir(workspace().join("configs/tasks")).unwrap();
    let mut files: Vec<PathBuf> = folder
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with(robot))
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .collect();
    files.sort();
    files
}

/// The folder of an `example-robot-data` installation: `$AKROBAT_EXAMPLE_ROBOT_DATA`, or that of the
/// workspace's `.venv`.
fn example_robot_data() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os("AKROBAT_EXAMPLE_ROBOT_DATA") {
        return Some(folder.into());
    }
    let pythons = std::fs::read_dir(workspace().join(".venv/lib")).into_iter().flatten().flatten();
    let inside = "site-packages/cmeel.prefix/share/example-robot-data";
    let found = pythons.map(|python| python.path().join(inside)).find(|path| path.is_dir());
    if found.is_none() {
        assert!(
            std::env::var_os("AKROBAT_REQUIRE_ROBOT_DATA").is_none(),
            "example-robot-data is required but not installed in .venv"
        );
        eprintln!("skipped: example-robot-data is not installed in .venv");
    }
    found
}

/// Corners of the handle's triangles in the world, with the object closed.
fn handle_points(task: &Task) -> Vec<Point3<f64>> {
    let object = &task.object;
    let world_from_handle =
        object.tree.link_poses(&object.world_from_root, &object.start)[object.handle_link];
    let link = &object.tree.links()[object.handle_link];
    let is_handle =
        |name: &str| object.handle_parts.iter().any(|pattern| matches_pattern(pattern, name));
    let meshes = link.visuals.iter().filter(|p| is_handle(&p.name)).flat_map(|p| p.triangulate());
    let points = meshes.flat_map(|mesh| mesh.positions).map(|p| Point3::from(p.map(f64::from)));
    let in_region = |p: &Point3<f64>| {
        object.handle_region.is_none_or(|r| (0..3).all(|i| (r[i]..=r[i + 3]).contains(&p[i])))
    };
    points.filter(in_region).map(|p| world_from_handle * p).collect()
}

fn bounds(points: &[Point3<f64>]) -> (Point3<f64>, Point3<f64>) {
    points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)))
}

/// A handle exists where it is said to be, thin enough to hold and at a height that an arm reaches.
fn check_handle(task: &Task) -> Point3<f64> {
    let name = &task.file.name;
    let points = handle_points(task);
    assert!(points.len() >= 8, "{name}: {} points on the handle", points.len());
    let (low, high) = bounds(&points);
    let extent = high - low;
    assert!(extent.min() < 0.08, "{name}: handle of {extent} m");
    assert!(extent.max() < 0.4, "{name}: handle of {extent} m");
    let middle = nalgebra::center(&low, &high);
    assert!((0.3..1.2).contains(&middle.z), "{name}: handle at {middle}");
    middle
}

/// Doors open by at least 60 degrees, drawers by 70% of their travel.
fn check_goals(task: &Task) {
    let joint = &task.object.tree.joints()[task.object.active_joint];
    for &goal in &task.file.goal.positions {
        let opening = (goal - task.file.goal.start).abs();
        let enough = match joint.kind {
            JointKind::Prismatic => 0.7 * (joint.limits[1] - joint.limits[0]),
            _ => 60f64.to_radians(),
        };
        assert!(opening >= enough, "{}: opens by {opening}, expected {enough}", task.file.name);
    }
}

/// Bodies of the scene with a triangle whose box meets the given one.
fn bodies_in(task: &Task, low: Vector3<f64>, high: Vector3<f64>) -> Vec<&str> {
    let meets = |corners: [Point3<f64>; 3]| {
        let (l, h) = bounds(&corners);
        (0..3).all(|i| l[i] <= high[i] && h[i] >= low[i])
    };
    let is_in = |body: &&akrobat_model::SceneBody| {
        body.collision_parts().iter().flat_map(|part| part.triangulate()).any(|mesh| {
            (0..mesh.triangles.len()).any(|t| {
                let corners = mesh.corners(t);
                meets(corners.map(|p| body.world_from_body * Point3::from(p.map(f64::from))))
            })
        })
    };
    task.scene.bodies.iter().filter(is_in).map(|body| body.name.as_str()).collect()
}

/// A robot's floor space, 0.8 x 0.8 m, is free in front of the handle.
fn check_room(task: &Task, handle: Point3<f64>) {
    let out = task.object.world_from_root * Vector3::x();
    let middle = handle + out * 0.85;
    let half = Vector3::new(0.4, 0.4, 0.0);
    let low = Vector3::new(middle.x, middle.y, 0.03) - half;
    let high = Vector3::new(middle.x, middle.y, 1.0) + half;
    let inside = bodies_in(task, low, high);
    assert!(inside.is_empty(), "{}: {inside:?} stand where the robot must", task.file.name);
    let behind = handle.coords - out * 1.2;
    let wall = bodies_in(task, behind.add_scalar(-0.8), behind.add_scalar(0.8));
    assert!(!wall.is_empty(), "{}: there is no wall behind the object", task.file.name);
}

fn check_all(robot: &str, search: &AssetSearch, count: usize) {
    let files = task_files(robot);
    assert!(files.len() >= count, "{} task files of {robot}", files.len());
    for path in files {
        let task = load::task(&path, search).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(path.file_stem().unwrap().to_str(), Some(task.file.name.as_str()));
        if task.file.object.kind != ObjectKind::Articulated {
            continue;
        }
        check_goals(&task);
        let handle = check_handle(&task);
        check_room(&task, handle);
    }
}

#[test]
fn tasks_of_summit_franka_load_and_are_possible() {
    let Some(shared) = fixtures::shared_assets() else { return };
    check_all("summit", &AssetSearch { folders: vec![shared] }, 18);
}

#[test]
fn tasks_of_tiago_load_and_are_possible() {
    let Some(shared) = fixtures::shared_assets() else { return };
    let Some(robot_data) = example_robot_data() else { return };
    check_all("tiago", &AssetSearch { folders: vec![shared, robot_data] }, 8);
}

#[test]
fn arms_from_other_descriptions_load_on_what_carries_them() {
    let Some(shared) = fixtures::shared_assets() else { return };
    let Some(robot_data) = example_robot_data() else { return };
    let search = AssetSearch { folders: vec![shared, robot_data] };
    for (robot, count, base_joints, carrier) in
        [("panda", 4, 0, "pedestal"), ("ur5", 1, 3, "platform_chassis")]
    {
        let files = task_files(robot);
        assert!(files.len() >= count, "{} task files of {robot}", files.len());
        for path in files {
            let task = load::task(&path, &search).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(path.file_stem().unwrap().to_str(), Some(task.file.name.as_str()));
            assert_eq!(task.robot.base_joints.len(), base_joints, "{robot}");
            let tree = &task.robot.tree;
            let carrier = tree.link_index(carrier).unwrap();
            let under_tool: Vec<usize> = tree
                .chain_to(task.robot.tool_link)
                .iter()
                .map(|&joint| tree.joints()[joint].parent)
                .collect();
            assert!(under_tool.contains(&carrier), "{robot} does not stand on its platform");
        }
    }
}
