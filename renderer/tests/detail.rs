//! Level of detail on a furnished kitchen.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests do")]

use std::path::Path;

use akrobat_cameras::{CameraFrame, Rig};
use akrobat_model::Pose;
use akrobat_model::fixtures::shared_assets;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::trajectory::Grasp;
use akrobat_renderer::detail::{AUTO_DEVIATION_M, simplified_scene};
use akrobat_renderer::handle::Handle;
use akrobat_renderer::placement::PlacedRig;
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{Backend, RenderScene, SoftBackend};

/// Share of the pixels whose depths differ by at most 2 mm.
fn agreement(expected: &[CameraFrame], found: &[CameraFrame]) -> f64 {
    let depths = |frames: &[CameraFrame]| -> Vec<f32> {
        frames.iter().flat_map(|frame| frame.depth_m.clone()).collect()
    };
    let (expected, found) = (depths(expected), depths(found));
    let pairs = expected.iter().zip(&found);
    pairs.filter(|(a, b)| (*a - *b).abs() <= 0.002).count() as f64 / expected.len() as f64
}

#[test]
fn fewer_triangles_show_the_same_kitchen() {
    let Some(shared) = shared_assets() else { return };
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../configs/tasks/summit_microwave_kitchen.toml");
    let task = load::task(&path, &AssetSearch { folders: vec![shared] }).unwrap();
    let scene = RenderScene::from_task(&task).unwrap();
    let frame = Replay::new(&task, &scene).at_rest();
    let link = task.object.tree.links()[task.object.handle_link].name.clone();
    let grasp = Grasp { id: 0, link, link_from_tool: Pose::identity(), width_m: 0.02 };
    let handle = Handle::new(&task, &grasp).unwrap();
    let rig = Rig::preset("paper").unwrap();
    let frames = std::slice::from_ref(&frame);
    let cameras = PlacedRig::new(&rig, &task, &scene, &handle, frames).unwrap().at(&frame);
    let render = |scene: &RenderScene| SoftBackend::new().render(scene, &frame, &cameras).unwrap();
    let full = render(&scene);

    let simple = simplified_scene(&scene, AUTO_DEVIATION_M);
    let again = simplified_scene(&scene, AUTO_DEVIATION_M);
    let meshes = |scene: &RenderScene| -> Vec<_> {
        let meshes = scene.bodies.iter().flat_map(|body| &body.meshes);
        meshes.map(|mesh| (mesh.positions.clone(), mesh.triangles.clone())).collect()
    };
    assert_eq!(meshes(&simple), meshes(&again));
    let (before, after) = (scene.triangle_count(), simple.triangle_count());
    let share = agreement(&full, &render(&simple));
    eprintln!("{before} -> {after} triangles, {:.3} % within 2 mm", 100.0 * share);
    assert!(after < before / 2, "{before} -> {after}");
    assert!(share >= 0.995, "{share}");

    let coarse = agreement(&full, &render(&simplified_scene(&scene, 0.03)));
    assert!(coarse < 0.995, "three centimetres were not noticed: {coarse}");
}
