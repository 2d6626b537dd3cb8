//! Clouds, camera placement and episodes.

#![allow(clippy::unwrap_used)] // Test helpers fail by panicking.

mod common;

use std::path::Path;

use akrobat_cameras::{CameraFrame, Rig};
use akrobat_model::fixtures::shared_assets;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::trajectory::{DensePath, Grasp};
use akrobat_model::{JointPath, Phase, Pose, Shape, Trajectory};
use akrobat_renderer::handle::{HandleVisibility, handle_visibility};
use akrobat_renderer::pointcloud::{
    CloudConfig, CloudFrame, CloudPlace, CloudSampling, farthest_indices, fuse,
};
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{
    Backend, EpisodeConfig, EpisodeRenderer, FrameState, PlacedCamera, RenderError, RenderScene,
    SoftBackend,
};
use common::{World, at, camera, primitive};
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// A ball of radius 0.5 m at `(2, 0, 0)`, seen by two cameras from its front and its side.
fn ball() -> Vec<CameraFrame> {
    let meshes = primitive(Shape::Sphere { radius: 0.5 }, [0.8, 0.1, 0.1]);
    let (scene, frame) = World::default().body("ball", meshes, at(2.0, 0.0, 0.0)).build();
    let cameras = [
        camera("front", [0.0; 3], [2.0, 0.0, 0.0], 20.0),
        camera("side", [2.0, -2.0, 0.0], [2.0, 0.0, 0.0], 20.0),
    ];
    SoftBackend::new().render(&scene, &frame, &cameras).unwrap()
}

/// A handle here, and a base that stands a metre to the side of the origin and is turned.
fn place(handle: Point3<f64>) -> CloudPlace {
    let world_from_base = common::turned(at(0.0, 1.0, 0.0), 0.0, 0.0, 0.5);
    CloudPlace { handle, world_from_base }
}

fn distance(p: &[f32; 6], q: [f32; 3]) -> f32 {
    (0..3).map(|i| (p[i] - q[i]) * (p[i] - q[i])).sum::<f32>().sqrt()
}

#[test]
fn fused_points_lie_on_the_surface_and_cover_it() {
    let images = ball();
    let cloud = fuse(&images, &place(Point3::origin()), &CloudConfig::default()).points;
    assert_eq!(cloud.len(), 4096);
    for point in &cloud {
        // The 32 x 16 facets lie up to 1 cm inside the sphere.
        let radius = distance(point, [2.0, 0.0, 0.0]);
        assert!((0.489..0.5001).contains(&radius), "{point:?}");
        assert!(point[3] > 2.0 * point[4], "red: {point:?}");
    }
    // Every pixel's point has a point of the cloud nearby, also for a small head of the cloud.
    for (head, reach_m) in [(4096, 0.03), (256, 0.1)] {
        for image in &images {
            for v in (0..240).step_by(7) {
                for u in (0..320).step_by(7) {
                    let depth_m = f64::from(image.depth_m[(v * 320 + u) as usize]);
                    if depth_m == 0.0 {
                        continue;
                    }
                    let p = image.world_from_camera
                        * Point3::from(image.intrinsics.unproject(u, v, depth_m));
                    let p = [p.x as f32, p.y as f32, p.z as f32];
                    let nearest =
                        cloud[..head].iter().map(|c| distance(c, p)).fold(f32::INFINITY, f32::min);
                    assert!(nearest < reach_m, "{nearest} from {p:?} among {head}");
                }
            }
        }
    }
}

#[test]
fn clouds_are_cropped_and_filled_up() {
    let images = ball();
    let config = CloudConfig { points: 500, radius_m: Some(0.2), ..CloudConfig::default() };
    let cloud = fuse(&images, &place(Point3::new(1.5, 0.0, 0.0)), &config).points;
    assert_eq!(cloud.len(), 500);
    assert!(cloud.iter().all(|p| distance(p, [1.5, 0.0, 0.0]) <= 0.2));

    let region = Some([1.5, -0.01, -0.01, 2.0, 0.01, 0.01]);
    let few = CloudConfig { points: 4096, region, ..CloudConfig::default() };
    let origin = place(Point3::origin());
    let cloud = fuse(&images, &origin, &few).points;
    let distinct: std::collections::HashSet<_> =
        cloud.iter().map(|p| p.map(f32::to_bits)).collect();
    assert!(distinct.len() > 3 && distinct.len() < 400, "{}", distinct.len());
    assert_eq!(cloud.len(), 4096);
    assert_eq!(cloud[0], cloud[distinct.len()]);

    let nothing = CloudConfig { region: Some([9.0; 6]), ..CloudConfig::default() };
    assert_eq!(fuse(&images, &origin, &nothing).points, vec![[0.0; 6]; 4096]);
    let none = CloudConfig { points: 0, ..CloudConfig::default() };
    assert!(fuse(&images, &origin, &none).points.is_empty());
}

#[test]
fn clouds_come_in_the_frame_asked_for_with_colours_and_normals() {
    let mut images = ball();
    for image in &mut images {
        let rays = akrobat_renderer::layers::rays(&image.model());
        image.normals = akrobat_renderer::layers::normals_from_depth(image, &rays);
    }
    let place = place(Point3::origin());
    let world = fuse(&images, &place, &CloudConfig { normals: true, ..CloudConfig::default() });
    for (point, normal) in world.points.iter().zip(&world.normals) {
        let outward: Vec<f32> = (0..3).map(|i| (point[i] - [2.0, 0.0, 0.0][i]) / 0.5).collect();
        let cosine: f32 = (0..3).map(|i| outward[i] * normal[i]).sum();
        assert!(cosine > 0.8, "{point:?} {normal:?}");
    }
    for (frame, world_from_frame) in [
        (CloudFrame::Base, place.world_from_base),
        (CloudFrame::Camera, images[0].world_from_camera),
    ] {
        let config = CloudConfig { frame, color: false, normals: true, ..CloudConfig::default() };
        let cloud = fuse(&images, &place, &config);
        let from_world = |p: &[f32; 6]| {
            let p = world_from_frame.cast::<f32>() * Point3::new(p[0], p[1], p[2]);
            world.points.iter().map(|q| distance(q, p.into())).fold(f32::INFINITY, f32::min)
        };
        assert!(cloud.points.iter().step_by(100).all(|p| from_world(p) < 0.03), "{frame:?}");
        assert!(cloud.points.iter().all(|p| p[3..] == [0.0; 3]));
        assert_eq!(cloud.normals.len(), 4096);
    }
}

#[test]
fn voxel_sampling_spreads_points_evenly_too() {
    let images = ball();
    let config =
        CloudConfig { sampling: CloudSampling::Voxel, points: 500, ..CloudConfig::default() };
    let cloud = fuse(&images, &place(Point3::origin()), &config).points;
    let distinct: std::collections::HashSet<_> =
        cloud.iter().map(|p| p.map(f32::to_bits)).collect();
    assert!(distinct.len() > 490, "{}", distinct.len());
    let nearest = |i: usize| {
        let p = cloud[i];
        let others = (0..cloud.len()).filter(|&j| j != i);
        others.map(|j| distance(&cloud[j], [p[0], p[1], p[2]])).fold(f32::INFINITY, f32::min)
    };
    let mut gaps: Vec<f32> = (0..cloud.len()).map(nearest).collect();
    gaps.sort_by(f32::total_cmp);
    // Half a ball of 0.5 m and more, in 500 voxels: edges of some 6 cm.
    assert!((0.02..0.09).contains(&gaps[250]), "{}", gaps[250]);
}

/// Distance of the point that is farthest from all chosen ones.
fn coverage_radius(points: &[[f32; 3]], chosen: &[usize]) -> f32 {
    let square =
        |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum::<f32>();
    let nearest =
        |&p: &[f32; 3]| chosen.iter().map(|&c| square(p, points[c])).fold(f32::INFINITY, f32::min);
    points.iter().map(nearest).fold(0.0, f32::max).sqrt()
}

#[test]
fn farthest_points_cover_better_than_any_even_choice() {
    let images = ball();
    let config =
        CloudConfig { points: 20_000, sampling: CloudSampling::Voxel, ..CloudConfig::default() };
    let points: Vec<[f32; 3]> = fuse(&images, &place(Point3::origin()), &config)
        .points
        .iter()
        .map(|p| [p[0], p[1], p[2]])
        .collect();
    let farthest = coverage_radius(&points, &farthest_indices(&points, 300));
    let even: Vec<usize> = (0..300).map(|i| i * points.len() / 300).collect();
    assert!(farthest < 0.75 * coverage_radius(&points, &even), "{farthest}");
}

#[test]
fn a_handle_is_visible_occluded_or_out_of_view() {
    let images = ball();
    let seen = |x: f64, y: f64| handle_visibility(&images, &Point3::new(x, y, 0.0));
    use HandleVisibility::{Occluded, OutOfView, Visible};
    assert_eq!(seen(1.47, 0.0), [Visible, Visible]);
    // 4 cm inside the front: within the tolerance there, but deep within seen from the side.
    assert_eq!(seen(1.54, 0.0), [Visible, Occluded]);
    assert_eq!(seen(2.6, 0.0), [Occluded, Visible]);
    assert_eq!(seen(-1.0, 0.0), [OutOfView, OutOfView]);
    assert_eq!(seen(2.0, -3.0), [OutOfView, OutOfView]);
}

/// The drawer pulled out while the robot stands still, in two samples a second apart.
fn pulled_drawer(task: &akrobat_model::task::Task, robot: &[f64]) -> Trajectory {
    let object = &task.object;
    let world_from_link =
        object.tree.link_poses(&object.world_from_root, &object.start)[object.handle_link];
    let knob: Vec<Point3<f64>> = object.tree.links()[object.handle_link]
        .visuals
        .iter()
        .filter(|part| object.handle_parts.contains(&part.name))
        .flat_map(|part| part.triangulate())
        .flat_map(|mesh| mesh.positions)
        .map(|p| world_from_link * Point3::from(p).cast::<f64>())
        .collect();
    let middle = knob.iter().map(|p| p.coords).sum::<Vector3<f64>>() / knob.len() as f64;
    let joint = &object.tree.joints()[object.active_joint];
    let out = (object.tree.link_poses(&object.world_from_root, &object.start)[joint.parent]
        * joint.parent_from_joint)
        .rotation
        * joint.axis.into_inner();
    let approach = UnitQuaternion::rotation_between(&Vector3::z(), &-out).unwrap();
    let world_from_tool = Pose::from_parts(middle.into(), approach);
    let mut dense = DensePath {
        robot: JointPath::new(robot.len()),
        object: JointPath::new(object.tree.dof()),
        ..DensePath::default()
    };
    let goal = task.file.goal.positions[0];
    dense.push(0.0, robot.to_vec(), object.start.clone(), Phase::Manipulate);
    dense.push(1.0, robot.to_vec(), object.configuration(goal), Phase::Manipulate);
    let waypoints_robot = dense.robot.clone();
    let waypoints_object = dense.object.clone();
    Trajectory {
        id: "pulled".into(),
        seed: 0,
        grasp: Grasp {
            id: 0,
            link: object.tree.links()[object.handle_link].name.clone(),
            link_from_tool: world_from_link.inverse() * world_from_tool,
            width_m: 0.02,
        },
        start: task.file.goal.start,
        goal,
        waypoints_robot,
        waypoints_object,
        waypoint_interval_s: 1.0,
        manipulation_start: 0,
        substeps: 1,
        regrasps: Vec::new(),
        dense,
        verdict: None,
    }
}

/// Draws everything a metre lower than it is.
struct Stale(SoftBackend);

impl Backend for Stale {
    fn name(&self) -> &str {
        "stale"
    }

    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError> {
        let mut wrong = frame.clone();
        for pose in &mut wrong.world_from_body {
            pose.translation.z -= 1.0;
        }
        self.0.render(scene, &wrong, cameras)
    }
}

/// Draws without any light.
struct Dark(SoftBackend);

impl Backend for Dark {
    fn name(&self) -> &str {
        "dark"
    }

    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError> {
        let mut images = self.0.render(scene, frame, cameras)?;
        images.iter_mut().for_each(|image| image.rgb.fill(0));
        Ok(images)
    }
}

#[test]
fn an_episode_in_the_kitchen_keeps_the_handle_in_view() {
    let Some(shared) = shared_assets() else { return };
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/tasks/summit_drawer_kitchen.toml");
    let task = load::task(&path, &AssetSearch { folders: vec![shared] }).unwrap();
    let scene = RenderScene::from_task(&task).unwrap();
    let rest = Replay::new(&task, &scene).at_rest();
    let trajectory = pulled_drawer(&task, &rest.robot);
    let rig = Rig::preset("paper").unwrap();
    let renderer = EpisodeRenderer::new(&task, &scene, &rig, EpisodeConfig::default());
    let episode = renderer.episode(&trajectory).unwrap();
    assert_eq!(episode.frame_count(), 31);
    let mut backend = SoftBackend::new();
    let mut travelled = Vec::new();
    for observation in episode.observations(&mut backend) {
        let observation = observation.unwrap();
        let frame = episode.state(observation.frame as usize);
        let handle = episode.handle().position(&frame);
        let seen = handle_visibility(&observation.cameras, &handle);
        assert_eq!(seen[2], HandleVisibility::Visible, "frame {}", observation.frame);
        assert_eq!(observation.cloud.len(), 4096);
        travelled.push(handle);
    }
    let way = (travelled[30] - travelled[0]).norm();
    assert!((way - task.file.goal.positions[0]).abs() < 1e-6, "{way}");

    // Robot and drawer are where the trajectory has them; a picture of another frame is refused.
    let checked = EpisodeConfig { check_frames: true, ..EpisodeConfig::default() };
    let renderer = EpisodeRenderer::new(&task, &scene, &rig, checked);
    let episode = renderer.episode(&trajectory).unwrap();
    episode.observe(30, &mut backend).unwrap();
    let message = episode.observe(30, &mut Stale(SoftBackend::new())).unwrap_err().to_string();
    assert!(message.contains("pose_differs") && message.contains("frame 30"), "{message}");
    let message = episode.observe(3, &mut Dark(SoftBackend::new())).unwrap_err().to_string();
    assert!(message.contains("black_frame") && message.contains("ego_topdown"), "{message}");

    let mut broken = trajectory.clone();
    broken.dense.robot.values_mut()[4] = f32::NAN;
    let message = renderer.episode(&broken).unwrap_err().to_string();
    assert!(message.contains("pulled") && message.contains("sample 0"), "{message}");
    let mut short = trajectory.clone();
    short.dense.object = JointPath::new(1);
    assert!(renderer.episode(&short).unwrap_err().to_string().contains("expected 2 x"));
}
