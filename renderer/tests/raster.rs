//! The `wgpu` backend against the image model. A missing adapter is a failure, not a skip.

#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests do")]

mod common;

use std::sync::LazyLock;

use akrobat_cameras::CameraFrame;
use akrobat_gpu::AdapterChoice;
use akrobat_model::{Pose, Shape, TriMesh};
use akrobat_renderer::compare::{Comparison, Tolerance, violation};
use akrobat_renderer::lighting::Environment;
use akrobat_renderer::raster::WgpuBackend;
use akrobat_renderer::{Backend, FrameState, Lighting, PlacedCamera, RenderScene};
use common::ray_tracer::ray_traced;
use common::{World, at, camera, primitive, textured_square, turned};

fn backend() -> WgpuBackend {
    WgpuBackend::open(&AdapterChoice::Any).unwrap_or_else(|error| panic!("{error}"))
}

fn render(scene: &RenderScene, frame: &FrameState, cameras: &[PlacedCamera]) -> Vec<CameraFrame> {
    backend().render(scene, frame, cameras).unwrap()
}

/// Boxes with sharp, spheres with smooth normals, a textured floor that reaches behind the camera, and
/// bodies that cut one another.
fn primitives() -> (RenderScene, FrameState) {
    let sphere = primitive(Shape::Sphere { radius: 0.3 }, [0.8, 0.2, 0.1]);
    let cylinder = primitive(Shape::Cylinder { radius: 0.1, length: 1.2 }, [0.1, 0.3, 0.8]);
    let block = primitive(Shape::Box { size: [0.5, 0.3, 0.4] }, [0.2, 0.7, 0.2]);
    let mut flat_sphere = sphere.clone();
    flat_sphere.iter_mut().for_each(|mesh| mesh.normals.clear());
    let floor = textured_square(6.0, 9.5, common::patterned_texture());
    World::default()
        .body("floor", vec![floor], Pose::identity())
        .body("sphere", sphere, at(0.2, 0.3, 0.5))
        .body("flat sphere", flat_sphere, turned(at(-0.5, -0.4, 0.4), 0.3, 0.2, 0.1))
        .body("cylinder", cylinder, turned(at(0.1, 0.2, 0.5), 0.9, 0.4, 0.0))
        .body("block", block, turned(at(-0.3, 0.5, 0.2), 0.0, 0.0, 0.7))
        .build()
}

fn cameras() -> Vec<PlacedCamera> {
    vec![
        camera("across", [2.0, -1.5, 1.2], [0.0, 0.1, 0.3], 24.0),
        camera("down", [0.05, 0.0, 2.2], [0.0, 0.0, 0.0], 20.0),
        camera("low", [-1.6, 1.4, 0.3], [0.0, 0.0, 0.4], 15.0),
    ]
}

/// What the cameras should see of the primitives.
static EXPECTED: LazyLock<Vec<CameraFrame>> = LazyLock::new(|| {
    let (scene, frame) = primitives();
    cameras().iter().map(|camera| ray_traced(&scene, &frame, camera)).collect()
});

#[test]
fn primitives_match_the_ray_tracer_in_depth_segments_and_colour() {
    let (scene, frame) = primitives();
    for (image, expected) in render(&scene, &frame, &cameras()).iter().zip(EXPECTED.iter()) {
        let comparison = Comparison::new(expected, image, &Tolerance::default());
        let comparisons = std::slice::from_ref(&comparison);
        assert_eq!(violation(comparisons, &Tolerance::default()), None);
        assert!(comparison.depth_p99_m < 1e-4, "{comparison}");
        assert!(comparison.color_p99 <= 1, "{comparison}");
    }
}

#[test]
fn a_camera_moved_by_one_centimetre_does_not_match() {
    let (scene, frame) = primitives();
    let mut moved = cameras();
    moved.iter_mut().for_each(|camera| camera.world_from_camera *= at(0.0, 0.0, 0.01));
    for (image, expected) in render(&scene, &frame, &moved).iter().zip(EXPECTED.iter()) {
        let comparison = Comparison::new(expected, image, &Tolerance::default());
        assert!(comparison.violation(&Tolerance::default()).is_some(), "{comparison}");
    }
}

#[test]
fn nothing_is_seen_outside_near_and_far() {
    let wall = |size: f64| primitive(Shape::Box { size: [0.001, size, size] }, [0.5; 3]);
    let (scene, frame) = World::default()
        .body("too near", wall(0.1), at(0.1, 0.0, 0.0))
        .body("visible", wall(0.5), at(1.0, 0.0, 0.0))
        .body("too far", wall(50.0), at(4.0, 0.0, 0.0))
        .build();
    let mut camera = camera("ahead", [0.0; 3], [1.0, 0.0, 0.0], 20.0);
    (camera.near_m, camera.far_m) = (0.2, 3.0);
    let image = &render(&scene, &frame, &[camera])[0];
    let center = 120 * 320 + 160;
    assert_eq!(image.segmentation[center], 2);
    assert!((image.depth_m[center] - 0.9995).abs() < 1e-5, "{}", image.depth_m[center]);
    assert_eq!((image.segmentation[0], image.depth_m[0]), (0, 0.0));
    assert_eq!(image.rgb[..3], Lighting::default().background_rgb);
}

#[test]
fn image_sizes_poses_light_and_scenes_may_change_between_calls() {
    let mut backend = backend();
    let block = || primitive(Shape::Box { size: [1.0; 3] }, [0.5; 3]);
    let (mut scene, frame) = World::default().body("block", block(), at(3.0, 0.0, 0.0)).build();
    let mut camera = camera("ahead", [0.0; 3], [1.0, 0.0, 0.0], 20.0);
    let mut render = |scene: &RenderScene, frame: &FrameState, camera: &PlacedCamera| {
        let image = backend.render(scene, frame, std::slice::from_ref(camera)).unwrap().remove(0);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let center = ((height / 2) * width + width / 2) as usize;
        assert_eq!(image.depth_m.len(), (width * height) as usize);
        (image.depth_m[center], image.segmentation[center], image.rgb[3 * center])
    };
    let (depth, segment, level) = render(&scene, &frame, &camera);
    assert!((depth - 2.5).abs() < 1e-5 && segment == 1, "{depth} {segment}");

    scene.lighting.lights.clear();
    scene.lighting.environment = Environment::Constant { rgb: [0.1; 3] };
    assert!(render(&scene, &frame, &camera).2 < level);

    // A width whose rows are not a multiple of the copy alignment.
    (camera.intrinsics.width, camera.intrinsics.height) = (101, 67);
    (camera.intrinsics.cx, camera.intrinsics.cy) = (50.5, 33.5);
    let moved = FrameState::of_bodies(vec![at(4.0, 0.0, 0.0)]);
    assert!((render(&scene, &moved, &camera).0 - 3.5).abs() < 1e-5);

    let (two, frame) = World::default()
        .body("block", block(), at(9.0, 0.0, 0.0))
        .body("nearer block", block(), at(2.0, 0.0, 0.0))
        .build();
    assert_eq!(render(&two, &frame, &camera).1, 2);
}

#[test]
fn empty_scenes_and_meshes_show_the_background() {
    let camera = camera("ahead", [0.0; 3], [1.0, 0.0, 0.0], 20.0);
    for world in [
        World::default(),
        World::default().body("empty", vec![TriMesh::default()], at(1.0, 0.0, 0.0)),
    ] {
        let (scene, frame) = world.build();
        let image = &render(&scene, &frame, std::slice::from_ref(&camera))[0];
        assert!(image.depth_m.iter().all(|&depth| depth == 0.0));
        assert!(image.rgb.chunks(3).all(|rgb| rgb == Lighting::default().background_rgb));
    }
}

#[test]
fn poses_that_do_not_fit_the_scene_are_an_error() {
    let (scene, _) = primitives();
    let frame = FrameState::of_bodies(vec![Pose::identity()]);
    let error = backend().render(&scene, &frame, &cameras()).unwrap_err().to_string();
    assert!(error.contains("5 bodies, got 1"), "{error}");
}
