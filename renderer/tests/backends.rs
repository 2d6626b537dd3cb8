//! The backends against each other on the same frames. Neither shares code with the other, so each is the
//! other's reference. A missing adapter is a failure, not a skip.

#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests do")]

mod common;

use std::path::Path;

use akrobat_cameras::{CameraFrame, Rig};
use akrobat_gpu::AdapterChoice;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::{Task, matches_pattern};
use akrobat_model::trajectory::{Grasp, PathSample};
use akrobat_model::{Phase, Pose, fixtures::shared_assets, mesh_io};
use akrobat_renderer::compare::{Comparison, Tolerance, violation};
use akrobat_renderer::handle::Handle;
use akrobat_renderer::lighting::Shadow;
use akrobat_renderer::placement::PlacedRig;
use akrobat_renderer::raster::WgpuBackend;
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{Backend, FrameState, Lighting, PlacedCamera, RenderScene, SoftBackend};
use common::{World, at, camera, turned};
use nalgebra::{Isometry3, Point3, Vector3};

/// Renders frames with both backends and compares them image by image.
fn compare(
    scene: &RenderScene,
    frames: &[(FrameState, Vec<PlacedCamera>)],
    wgpu_camera_from_camera: Pose,
) -> Vec<Comparison> {
    let mut gpu = WgpuBackend::open(&AdapterChoice::Any).unwrap_or_else(|error| panic!("{error}"));
    let moved: Vec<_> = frames
        .iter()
        .map(|(frame, cameras)| {
            let mut cameras = cameras.clone();
            for camera in &mut cameras {
                camera.world_from_camera *= wgpu_camera_from_camera;
                camera.normals = true;
            }
            (frame.clone(), cameras)
        })
        .collect();
    let asked: Vec<_> = frames
        .iter()
        .map(|(frame, cameras)| {
            let with_normals =
                |camera: &PlacedCamera| PlacedCamera { normals: true, ..camera.clone() };
            (frame.clone(), cameras.iter().map(with_normals).collect())
        })
        .collect();
    let expected = SoftBackend::new().render_batch(scene, &asked).unwrap();
    let rendered = gpu.render_batch(scene, &moved).unwrap();
    let pairs = expected.iter().flatten().zip(rendered.iter().flatten());
    let compare = |(index, (soft, wgpu)): (usize, (&CameraFrame, &CameraFrame))| {
        let what = format!("{}_{index:02}_{}", scene.name, soft.name);
        if wgpu_camera_from_camera == Pose::identity() {
            common::keep_images(&what, soft, wgpu);
        }
        Comparison::new(soft, wgpu, &Tolerance::default())
    };
    pairs.enumerate().map(compare).collect()
}

fn assert_agree(scene: &RenderScene, frames: &[(FrameState, Vec<PlacedCamera>)]) {
    let comparisons = compare(scene, frames, Pose::identity());
    for comparison in &comparisons {
        eprintln!("{comparison}");
        assert!(comparison.ssim >= 0.98 && comparison.normal_agreement >= 0.99, "{comparison}");
        // Along the outlines of shadows, a rounding decides between light and dark.
        let has_shadows = scene.lighting.lights.iter().any(|light| light.shadow() != Shadow::None);
        assert!(has_shadows || comparison.color_p99 <= 2, "{comparison}");
    }
    assert_eq!(violation(&comparisons, &Tolerance::default()), None);
    let one_centimetre_ahead = at(0.0, 0.0, 0.01);
    let other = scene.lit_by(&Lighting::preset("evening").unwrap());
    let (frame, cameras) = &frames[0];
    let dim = SoftBackend::new().render(&other, frame, cameras).unwrap();
    let lit = SoftBackend::new().render(scene, frame, cameras).unwrap();
    for (dim, lit) in dim.iter().zip(&lit) {
        let similarity = Comparison::new(lit, dim, &Tolerance::default()).ssim;
        assert!(similarity < 0.9, "another light was not noticed: {similarity}");
    }
    for comparison in compare(scene, frames, one_centimetre_ahead) {
        let noticed = comparison.violation(&Tolerance::default()).is_some();
        assert!(noticed, "a moved camera was not noticed: {comparison}");
    }
}

#[test]
fn backends_agree_on_textured_furniture() {
    let Some(shared) = shared_assets() else { return };
    let models = shared.join("scenes/drake_living_room/models/assets");
    let model = |name: &str| mesh_io::load(&models.join(name)).unwrap();
    let (scene, frame) = World::default()
        .body("table", model("wooden_table_02_1k.gltf"), at(0.0, 0.0, 0.0))
        .body(
            "stool",
            model("painted_wooden_stool_1k.gltf"),
            turned(at(1.2, 0.5, 0.0), 0.0, 0.0, 0.4),
        )
        .body("sofa", model("sofa_03_1k.gltf"), at(0.0, 2.0, 0.0))
        .body(
            "floor",
            vec![common::textured_square(5.0, 20.0, common::patterned_texture())],
            Pose::identity(),
        )
        .build();
    let cameras = vec![
        camera("room", [3.0, -2.5, 2.0], [0.3, 0.6, 0.3], 18.0),
        camera("table", [0.6, -1.2, 1.4], [0.0, 0.0, 0.7], 24.0),
        camera("sofa", [0.3, 0.2, 1.6], [0.0, 2.0, 0.4], 15.0),
    ];
    assert_agree(&scene.lit_by(&Lighting::preset("ceiling").unwrap()), &[(frame, cameras)]);
}

#[test]
fn backends_agree_on_an_oven_in_the_kitchen() {
    agree_on_config("summit_oven_kitchen.toml", "even");
}

#[test]
fn backends_agree_on_a_drawer_in_the_kitchen() {
    agree_on_config("summit_sektion_drawer_top_kitchen.toml", "sun");
}

#[test]
fn backends_agree_on_a_robot_of_primitives_in_the_built_in_kitchen() {
    let folder = tempfile::tempdir().unwrap();
    let paths = akrobat_assets::demo::write(folder.path(), 1, None).unwrap();
    let path = paths.tasks.iter().find(|path| path.ends_with("microwave_pillar.toml")).unwrap();
    agree_on_task(&load::task(path, &AssetSearch::default()).unwrap(), "ceiling");
}

fn agree_on_config(file: &str, lighting: &str) {
    let Some(shared) = shared_assets() else { return };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/tasks").join(file);
    agree_on_task(&load::task(&path, &AssetSearch { folders: vec![shared] }).unwrap(), lighting);
}

/// The `paper` rig on frames from the resting pose to the object's first goal.
fn agree_on_task(task: &Task, lighting: &str) {
    let lighting = Lighting::preset(lighting).unwrap();
    let scene = RenderScene::from_task(task).unwrap().lit_by(&lighting);
    let replay = Replay::new(task, &scene);
    let handle = Handle::new(task, &grasp(task)).unwrap();
    let states: Vec<_> =
        (0..3).map(|step| state(task, &replay, &handle, f64::from(step) / 2.0)).collect();
    let rig = Rig::preset("paper").unwrap();
    let rig = PlacedRig::new(&rig, task, &scene, &handle, &states).unwrap();
    let frames: Vec<_> = states
        .into_iter()
        .map(|state| {
            let cameras = rig.at(&state);
            (state, cameras)
        })
        .collect();
    assert_agree(&scene, &frames);
}

/// A horizontal grasp at the middle of the handle, from the side on which it stands out.
fn grasp(task: &Task) -> Grasp {
    let object = &task.object;
    let link = &object.tree.links()[object.handle_link];
    let world_from_link =
        object.tree.link_poses(&object.world_from_root, &object.start)[object.handle_link];
    let is_handle = |name: &str| {
        object.handle_parts.is_empty()
            || object.handle_parts.iter().any(|p| matches_pattern(p, name))
    };
    let points: Vec<Point3<f64>> = link
        .visuals
        .iter()
        .filter(|part| is_handle(&part.name))
        .flat_map(|part| part.triangulate())
        .flat_map(|mesh| mesh.positions)
        .map(|p| world_from_link * Point3::from(p).cast::<f64>())
        .collect();
    let middle =
        Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64);
    let out = (middle - object.world_from_root * Point3::origin()).xy().push(0.0);
    let world_from_tool = Isometry3::face_towards(&middle, &(middle - out), &Vector3::z());
    Grasp {
        id: 0,
        link: link.name.clone(),
        link_from_tool: world_from_link.inverse() * world_from_tool,
        width_m: 0.02,
    }
}

/// The robot in front of the handle, its arm `progress` (0..1) of a way out of the resting pose, the object as
/// far open.
fn state(task: &Task, replay: &Replay<'_>, handle: &Handle, progress: f64) -> FrameState {
    let rest = replay.at_rest();
    let world_from_grasp = handle.world_from_grasp(&rest);
    let forward = world_from_grasp * Vector3::z();
    let stand = world_from_grasp.translation.vector - forward * (1.0 + 0.2 * progress);
    let mut robot = rest.robot;
    robot[..3].copy_from_slice(&[stand.x, stand.y, forward.y.atan2(forward.x) + 0.2 * progress]);
    robot[4] += 0.8 * progress;
    robot[6] += 0.5 * progress;
    robot[8] += 0.7 * progress;
    let object = task.object.configuration(progress * task.file.goal.positions[0]);
    replay.at_sample(0, 0.0, PathSample { robot, object, phase: Phase::Manipulate })
}
