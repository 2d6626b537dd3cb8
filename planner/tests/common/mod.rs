//! Shared inputs and random numbers of the planner's tests.
#![allow(dead_code)] // every test binary uses a part of these

use std::path::{Path, PathBuf};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::{ManipulatedObject, Task};
use akrobat_model::trajectory::Grasp;
use akrobat_model::{KinematicTree, Pose, Robot, fixtures, pose, urdf};
use akrobat_planner::kinematics::{Frame, Kinematics, rotation_log};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A triangle's corners.
pub type Corners = [Vector3<f64>; 3];

/// Where the shared inputs are found; `None` where they are absent.
pub fn search() -> Option<AssetSearch> {
    fixtures::shared_assets().map(|folder| AssetSearch { folders: vec![folder] })
}

/// A file of the `configs` folder.
pub fn config(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs").join(path)
}

/// Summit XL with a Panda.
pub fn summit() -> Option<Robot> {
    Some(load::robot(&config("robots/summit_franka.toml"), &search()?).unwrap())
}

/// A task of `configs/tasks`.
pub fn task(name: &str) -> Option<Task> {
    Some(load::task(&config(&format!("tasks/{name}.toml")), &search()?).unwrap())
}

/// Every shared articulated object.
pub fn objects() -> Option<Vec<KinematicTree>> {
    let search = search()?;
    let files = [
        "cabinet_1001/cabinet.urdf",
        "dishwasher_1001/dishwasher.urdf",
        "drawer_1001/drawer.urdf",
        "microwave_1001/microwave.urdf",
        "oven_1001/oven.urdf",
        "refrigerator_1001/refrigerator.urdf",
        "trash_1001/trash.urdf",
        "sektion_cabinet/urdf/sektion_cabinet.urdf",
    ];
    let read = |file: &&str| {
        let path = search.folders[0].join("objects").join(file);
        urdf::read(&path, &search).unwrap().0
    };
    Some(files.iter().map(read).collect())
}

/// An object held by the child of its joint `active`, placed in the world.
pub fn manipulated(tree: &KinematicTree, active: usize, place: Pose) -> ManipulatedObject {
    ManipulatedObject {
        name: tree.name.clone(),
        tree: tree.clone(),
        world_from_root: place,
        active_joint: active,
        handle_link: tree.joints()[active].child,
        handle_parts: vec!["*".into()],
        handle_region: None,
        start: tree.neutral(),
        notes: Vec::new(),
    }
}

/// A grasp at `link_from_tool` on the held link.
pub fn grasp_at(object: &ManipulatedObject, link_from_tool: Pose) -> Grasp {
    let link = object.tree.links()[object.handle_link].name.clone();
    Grasp { id: 0, link, link_from_tool, width_m: 0.03 }
}

/// A fixed stream of random numbers.
pub fn numbers(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A configuration of the tree within its limits, and within +-3.
pub fn random_configuration(tree: &KinematicTree, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let limits = tree.dof_joints().iter().map(|&j| tree.joints()[j].limits);
    limits.map(|[low, high]| rng.random_range(low.max(-3.0)..=high.min(3.0))).collect()
}

/// A value of a variable within its limits, and within +-3.
pub fn number_within(kinematics: &Kinematics, variable: usize, rng: &mut ChaCha8Rng) -> f64 {
    let (low, high) = (kinematics.lower()[variable], kinematics.upper()[variable]);
    rng.random_range(low.max(-3.0)..=high.min(3.0))
}

/// A pose within a metre of the origin.
pub fn random_pose(rng: &mut ChaCha8Rng) -> Pose {
    let mut triple = || std::array::from_fn(|_| rng.random_range(-1.0..=1.0));
    pose::from_xyz_rpy(triple(), triple())
}

/// The larger of the distance (m) and the angle (rad) between two poses.
pub fn apart(a: &Pose, b: &Pose) -> f64 {
    let rotation = a.rotation.to_rotation_matrix() * b.rotation.to_rotation_matrix().inverse();
    let angle = rotation_log(rotation.matrix()).norm();
    (a.translation.vector - b.translation.vector).norm().max(angle)
}

/// As [`apart`], for a compiled frame.
pub fn frame_apart(a: &Frame, b: &Pose) -> f64 {
    let b = Frame::from(b);
    let angle = rotation_log(&(a.rotation * b.rotation.transpose())).norm();
    (a.translation - b.translation).norm().max(angle)
}

/// Distance from a point to a triangle: the plane's where the foot is inside, else the nearest edge's.
pub fn distance_to_triangle(p: &Vector3<f64>, [a, b, c]: &Corners) -> f64 {
    let normal = (b - a).cross(&(c - a));
    let edges = [(a, b), (b, c), (c, a)];
    let inside = edges.iter().all(|(u, v)| normal.cross(&(*v - *u)).dot(&(p - *u)) >= 0.0);
    if normal.norm() > 1e-14 && inside {
        return normal.normalize().dot(&(p - a)).abs();
    }
    let to_edge = |(u, v): &(&Vector3<f64>, &Vector3<f64>)| {
        let along = *v - *u;
        let t = (along.dot(&(p - *u)) / along.norm_squared().max(1e-30)).clamp(0.0, 1.0);
        (*u + along * t - p).norm()
    };
    edges.iter().map(to_edge).fold(f64::INFINITY, f64::min)
}

/// Distance from a point to the nearest of many triangles, metres.
pub fn distance_to_soup(p: &Vector3<f64>, soup: &[Corners]) -> f64 {
    let mut nearest = f64::INFINITY;
    for corners in soup {
        let far = (0..3).any(|i| {
            let low = corners.iter().map(|c| c[i]).fold(f64::INFINITY, f64::min);
            let high = corners.iter().map(|c| c[i]).fold(f64::NEG_INFINITY, f64::max);
            p[i] < low - nearest || p[i] > high + nearest
        });
        if !far {
            nearest = nearest.min(distance_to_triangle(p, corners));
        }
    }
    nearest
}

/// Points drawn evenly from a surface.
pub fn random_points(soup: &[Corners], count: usize, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let mut total = 0.0;
    let sums: Vec<f64> = soup
        .iter()
        .map(|[a, b, c]| {
            total += (b - a).cross(&(c - a)).norm();
            total
        })
        .collect();
    (0..count)
        .map(|_| {
            let pick = rng.random_range(0.0..total);
            let [a, b, c] = &soup[sums.partition_point(|&s| s <= pick).min(soup.len() - 1)];
            let (u, v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            a + (b - a) * u + (c - a) * v
        })
        .collect()
}
