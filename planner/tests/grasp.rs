//! Grasps on real handles, checked again with exact distances.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use std::fs;
use std::sync::OnceLock;

use akrobat_model::task::Task;
use akrobat_model::trajectory::Grasp;
use akrobat_model::{Pose, load, pose};
use akrobat_planner::Preparation;
use akrobat_planner::esdf::{Triangles, collect_triangles};
use akrobat_planner::grasp::grasps;
use akrobat_planner::spheres::link_triangles;
use akrobat_planner::world::{handle_parts, handle_triangles, is_handle_part};
use common::{apart, distance_to_soup, distance_to_triangle, numbers, random_points};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// Half angle of the friction cone for a coefficient of 0.5, rounded up.
const FRICTION_ANGLE: f64 = 0.47;
/// Where, beyond the middle of the pads, the handle is held, metres.
const DEPTHS_M: [f64; 3] = [0.0, -0.006, 0.006];

struct Sampled {
    task: Task,
    preparation: Preparation,
    grasps: Vec<Grasp>,
}

fn sampled() -> Option<&'static [Sampled]> {
    static SAMPLED: OnceLock<Option<Vec<Sampled>>> = OnceLock::new();
    let sample = || {
        let tasks = ["summit_drawer_empty", "summit_microwave_empty"];
        let sample = |name: &&str| {
            let task = common::task(name)?;
            let preparation = Preparation::new(&task).unwrap();
            let (grasps, tried) = grasps(&task, &preparation.spheres, 7, 12);
            assert!(tried > 1000 && grasps.len() >= 6, "{name}: {} of {tried}", grasps.len());
            Some(Sampled { task, preparation, grasps })
        };
        tasks.iter().map(sample).collect()
    };
    SAMPLED.get_or_init(sample).as_deref()
}

/// True where both pads meet the handle's surface within the friction cone.
fn is_antipodal(handle: &Triangles, link_from_tool: &Pose, width_m: f64) -> bool {
    let closing = link_from_tool.rotation * Vector3::y();
    let approach = link_from_tool.rotation * Vector3::z();
    let touches = |at: Vector3<f64>| {
        handle.iter().any(|corners| {
            let [a, b, c] = corners;
            let normal = (b - a).cross(&(c - a)).normalize();
            distance_to_triangle(&at, corners) < 1e-6
                && normal.dot(&closing).abs() >= FRICTION_ANGLE.cos()
        })
    };
    DEPTHS_M.iter().any(|&depth| {
        let middle = link_from_tool.translation.vector + approach * depth;
        touches(middle + closing * (width_m / 2.0)) && touches(middle - closing * (width_m / 2.0))
    })
}

#[test]
fn sampled_grasps_oppose_the_surface() {
    let Some(sampled) = sampled() else { return };
    for Sampled { task, grasps, .. } in sampled {
        let handle = handle_triangles(&task.object);
        let open = task.robot.file.gripper.open_width_m;
        for (index, grasp) in grasps.iter().enumerate() {
            assert_eq!(grasp.id as usize, index);
            assert_eq!(grasp.link, task.object.tree.links()[task.object.handle_link].name);
            assert!(grasp.width_m > 0.001 && grasp.width_m <= open, "{}", grasp.width_m);
            assert!(is_antipodal(&handle, &grasp.link_from_tool, grasp.width_m));
            // Negative controls: closing elsewhere, or by another width, is no such grasp.
            let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.8);
            assert!(!is_antipodal(&handle, &(grasp.link_from_tool * turned), grasp.width_m));
            assert!(!is_antipodal(&handle, &grasp.link_from_tool, grasp.width_m + 0.002));
        }
    }
}

/// The handle, and everything else near it, in the held link's frame.
fn surroundings(task: &Task) -> (Triangles, Triangles) {
    let object = &task.object;
    let poses = object.tree.link_poses(&object.world_from_root, &object.start);
    let link_from_world = poses[object.handle_link].inverse();
    let (mut handle, mut others) = (Triangles::new(), Triangles::new());
    for part in handle_parts(object) {
        collect_triangles(&part.triangulate(), &Pose::identity(), &mut handle);
    }
    for (index, link) in object.tree.links().iter().enumerate() {
        let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
        for part in parts {
            if index != object.handle_link || !is_handle_part(object, &part.name) {
                let frame = link_from_world * poses[index];
                collect_triangles(&part.triangulate(), &frame, &mut others);
            }
        }
    }
    for body in &task.scene.bodies {
        for part in body.collision_parts() {
            let frame = link_from_world * body.world_from_body;
            collect_triangles(&part.triangulate(), &frame, &mut others);
        }
    }
    (handle, others)
}

/// Random surface points of links with the fingers at a width, in the tool frame.
fn link_points(task: &Task, links: &[usize], width_m: f64) -> Vec<Vector3<f64>> {
    let robot = &task.robot;
    let mut q = robot.rest.clone();
    for (&joint, position) in robot.gripper_joints.iter().zip(robot.finger_positions(width_m)) {
        q[robot.tree.column(joint).unwrap()] = position;
    }
    let poses = robot.tree.link_poses(&Pose::identity(), &q);
    let tool_from_world = (poses[robot.tool_link] * robot.link_from_tool).inverse();
    let mut rng = numbers(3);
    let points = |&link: &usize| {
        let points = random_points(&link_triangles(&robot.tree.links()[link]), 1500, &mut rng);
        let tool_from_link = tool_from_world * poses[link];
        points.into_iter().map(move |p| (tool_from_link * Point3::from(p)).coords).collect()
    };
    links.iter().map(points).collect::<Vec<Vec<_>>>().concat()
}

/// Smallest distance of points of the tool frame to a surface.
fn clearance(points: &[Vector3<f64>], link_from_tool: &Pose, soup: &Triangles) -> f64 {
    let at = |p: &Vector3<f64>| distance_to_soup(&(link_from_tool * Point3::from(*p)).coords, soup);
    points.iter().map(at).fold(f64::INFINITY, f64::min)
}

#[test]
fn hand_and_open_fingers_are_clear_of_everything() {
    let Some(sampled) = sampled() else { return };
    for Sampled { task, grasps, .. } in sampled {
        let (handle, others) = surroundings(task);
        let robot = &task.robot;
        let hand = link_points(task, &[robot.tool_link], 0.0);
        let open = robot.file.gripper.open_width_m;
        let fingers = link_points(task, &robot.finger_links, open);
        for grasp in grasps {
            let pose = grasp.link_from_tool;
            for back in [0.0, 0.02, 0.05] {
                let pose = pose * Translation3::new(0.0, 0.0, -back);
                let name = format!("{} grasp {} back {back}", task.file.name, grasp.id);
                for (what, points, soup, least) in [
                    ("hand to handle", &hand, &handle, 0.002),
                    ("hand to others", &hand, &others, 0.002),
                    ("fingers to handle", &fingers, &handle, 0.0003),
                    ("fingers to others", &fingers, &others, 0.001),
                ] {
                    let gap = clearance(points, &pose, soup);
                    assert!(gap > least, "{name}: {what} {gap}");
                }
            }
            // Negative control: a hand pushed in by 6 cm is in something's way.
            let pushed = pose * Translation3::new(0.0, 0.0, 0.06);
            let nearest =
                clearance(&hand, &pushed, &handle).min(clearance(&hand, &pushed, &others));
            assert!(nearest < 0.002, "{} grasp {}: {nearest}", task.file.name, grasp.id);
        }
    }
}

#[test]
fn closed_pads_hold_the_handle_between_them() {
    let Some(sampled) = sampled() else { return };
    for Sampled { task, grasps, .. } in sampled {
        let (handle, others) = surroundings(task);
        for grasp in grasps {
            let fingers = link_points(task, &task.robot.finger_links, grasp.width_m);
            let touch = clearance(&fingers, &grasp.link_from_tool, &handle);
            assert!(touch < 0.003, "{} grasp {}: {touch}", task.file.name, grasp.id);
            let gap = clearance(&fingers, &grasp.link_from_tool, &others);
            assert!(gap > 0.0005, "{} grasp {}: {gap}", task.file.name, grasp.id);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_grasps_on_any_number_of_threads() {
    let Some(sampled) = sampled() else { return };
    let Sampled { task, preparation, grasps: ours } = &sampled[0];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(&pool.install(|| grasps(task, &preparation.spheres, 7, 12)).0, ours);
}

#[test]
fn poses_of_a_file_are_used_as_given() {
    let Some(sampled) = sampled() else { return };
    let folder = tempfile::tempdir().unwrap();
    for Sampled { task, preparation, grasps: ours } in sampled {
        let row = |g: &Grasp| {
            pose::to_xyz_wxyz(&g.link_from_tool).map(|v| format!("{v:?}")).join(" ") + "\n"
        };
        // The first row stands far inside the object, where no hand fits.
        let inside = "-0.1 0.0 0.1 1 0 0 0\n".to_owned();
        let rows: String = std::iter::once(inside).chain(ours.iter().map(row)).collect();
        let file = folder.path().join("grasps.txt");
        fs::write(&file, rows).unwrap();
        let path = common::config(&format!("tasks/{}.toml", task.file.name));
        let text = task.toml.clone() + &format!("\n[grasps]\nfile = {file:?}\nframe = \"link\"\n");
        let given = load::task_from_text(text, &path, &common::search().unwrap()).unwrap();
        assert_eq!(given.grasp_poses.len(), ours.len() + 1);
        let (used, tried) = grasps(&given, &preparation.spheres, 7, 100);
        assert_eq!(tried, ours.len() + 1);
        assert_eq!(used.len(), ours.len(), "{}", task.file.name);
        // The rank in the file decides which comes first.
        assert!(apart(&used[0].link_from_tool, &ours[0].link_from_tool) < 1e-9);
        for grasp in &used {
            let same = |g: &&Grasp| apart(&g.link_from_tool, &grasp.link_from_tool) < 1e-9;
            let original = ours.iter().find(same).expect("every pose is one of the file's");
            // Sampling measures the width at one point, closing stops at the widest place along the pads.
            let widths = original.width_m - 0.001..=task.robot.file.gripper.open_width_m;
            assert!(widths.contains(&grasp.width_m), "{}: {grasp:?}", task.file.name);
        }
    }
}
