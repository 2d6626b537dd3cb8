//! Lenses, normals, positions and motion in images, from primitive scenes.

#![allow(clippy::unwrap_used)] // Test helpers fail by panicking.

mod common;

use akrobat_cameras::{BrownConrady, CameraFrame, CameraModel, Distortion, KannalaBrandt};
use akrobat_model::{Pose, Shape};
use akrobat_renderer::enclosure::Enclosures;
use akrobat_renderer::layers::{self, Motion};
use akrobat_renderer::lens::LensMap;
use akrobat_renderer::{Backend, FrameState, PlacedCamera, RenderScene, SoftBackend};
use common::{World, at, camera, primitive, turned};
use nalgebra::{Point3, Vector3};

/// A ball before a tilted board.
fn world() -> (RenderScene, FrameState) {
    let ball = primitive(Shape::Sphere { radius: 0.4 }, [0.8, 0.1, 0.1]);
    let board = primitive(Shape::Box { size: [0.1, 4.0, 3.0] }, [0.2, 0.5, 0.9]);
    World::default()
        .body("ball", ball, at(2.0, 0.1, 0.0))
        .body("board", board, turned(at(3.0, 0.0, 0.0), 0.0, 0.2, 0.3))
        .build()
}

fn eye() -> PlacedCamera {
    PlacedCamera { normals: true, ..camera("eye", [0.0; 3], [2.0, 0.0, 0.0], 16.0) }
}

fn render(scene: &RenderScene, frame: &FrameState, camera: &PlacedCamera) -> CameraFrame {
    let cameras = std::slice::from_ref(camera);
    SoftBackend::new().render(scene, frame, cameras).unwrap().remove(0)
}

fn lenses() -> [Distortion; 2] {
    [
        Distortion::BrownConrady(BrownConrady {
            k1: -0.28,
            k2: 0.07,
            p1: 0.002,
            p2: -0.001,
            ..BrownConrady::default()
        }),
        Distortion::KannalaBrandt(KannalaBrandt { k1: 0.05, k2: -0.01, ..Default::default() }),
    ]
}

/// The depth that a lens sees along each of its rays, straight from the scene: one pinhole of a single pixel
/// for each.
fn depth_along(
    scene: &RenderScene,
    frame: &FrameState,
    model: &CameraModel,
    pixel: [u32; 2],
) -> (f64, u16) {
    let eye = eye();
    let [x, y] = model.ray(pixel.map(|p| f64::from(p) + 0.5)).unwrap();
    let mut single = eye.clone();
    single.intrinsics.width = 1;
    single.intrinsics.height = 1;
    single.intrinsics.cx = 0.5 - x * single.intrinsics.fx;
    single.intrinsics.cy = 0.5 - y * single.intrinsics.fy;
    let image = render(scene, frame, &single);
    (f64::from(image.depth_m[0]), image.segmentation[0])
}

#[test]
fn a_lens_shows_what_lies_on_its_own_rays() {
    let (scene, frame) = world();
    for distortion in lenses() {
        let model = CameraModel { intrinsics: eye().intrinsics, distortion };
        let lens = LensMap::new(model).unwrap();
        let pinhole = PlacedCamera { intrinsics: lens.pinhole(), ..eye() };
        let image = lens.resample(&render(&scene, &frame, &pinhole));
        let undistorted = render(&scene, &frame, &eye());
        let (mut exact, mut exact_without_lens, mut segments, mut count) = (0, 0, 0, 0);
        for v in (3..240).step_by(12) {
            for u in (3..320).step_by(13) {
                let (depth, segment) = depth_along(&scene, &frame, &model, [u, v]);
                let pixel = (v * 320 + u) as usize;
                count += 1;
                let agrees =
                    |image: &CameraFrame| (f64::from(image.depth_m[pixel]) - depth).abs() < 1e-3;
                exact += usize::from(agrees(&image));
                exact_without_lens += usize::from(agrees(&undistorted));
                segments += usize::from(image.segmentation[pixel] == segment);
            }
        }
        assert!(exact * 100 >= count * 98, "{distortion:?}: {exact} of {count}");
        assert!(segments * 100 >= count * 99, "{distortion:?}: {segments} of {count}");
        assert!(exact_without_lens * 2 < count, "the control agrees: {exact_without_lens}");
    }
}

#[test]
fn positions_project_to_their_own_pixels() {
    let (scene, frame) = world();
    for distortion in lenses() {
        let model = CameraModel { intrinsics: eye().intrinsics, distortion };
        let lens = LensMap::new(model).unwrap();
        let pinhole = PlacedCamera { intrinsics: lens.pinhole(), ..eye() };
        let image = lens.resample(&render(&scene, &frame, &pinhole));
        let rays = layers::rays(&model);
        let positions = layers::positions(&image.depth_m, &rays, &image.world_from_camera);
        let mut farthest = 0.0f64;
        for (pixel, &p) in positions.iter().enumerate().filter(|(_, p)| **p != [0.0; 3]) {
            let in_camera = image.world_from_camera.inverse() * Point3::from(p).cast::<f64>();
            let [u, v] = model.project(in_camera.coords.into()).unwrap();
            let own = [(pixel % 320) as f64 + 0.5, (pixel / 320) as f64 + 0.5];
            farthest = farthest.max((u - own[0]).hypot(v - own[1]));
        }
        assert!(farthest < 0.01, "{distortion:?}: {farthest} pixels");
    }
}

#[test]
fn normals_of_the_renderer_and_of_depth_are_those_of_the_shapes() {
    let (scene, frame) = world();
    let image = render(&scene, &frame, &eye());
    let rays = layers::rays(&image.model());
    let from_depth = layers::normals_from_depth(&image, &rays);
    let board = frame.world_from_body[1].rotation * -Vector3::x();
    let points = layers::positions(&image.depth_m, &rays, &image.world_from_camera);
    let mut on_board = 0;
    for pixel in (0..points.len()).step_by(11) {
        let expected = match image.segmentation[pixel] {
            1 => {
                (Point3::from(points[pixel]).cast::<f64>() - Point3::new(2.0, 0.1, 0.0)).normalize()
            }
            2 => board,
            _ => continue,
        };
        // Where a ball's edge is seen, vertex normals point away, and the image model turns them round.
        if expected.dot(&Point3::from(points[pixel]).coords.cast::<f64>().normalize()) > -0.2 {
            continue;
        }
        let cosine = |normal: [f32; 3]| Vector3::from(normal).cast::<f64>().dot(&expected);
        let rendered = cosine(image.normals[pixel]);
        let segment = image.segmentation[pixel];
        assert!(rendered > 0.98, "{pixel} of {segment}: {rendered}, {:?}", image.normals[pixel]);
        if image.segmentation[pixel] == 2 {
            on_board += 1;
            let found = cosine(from_depth[pixel]);
            assert!(found > 0.999, "{pixel}: {found}");
        }
    }
    assert!(on_board > 1000);
}

#[test]
fn flow_leads_to_the_same_points_in_the_next_image() {
    let (scene, now) = world();
    let (_, rest) = world();
    let mut next = rest;
    next.world_from_body[0] = turned(at(2.05, 0.02, 0.03), 0.1, 0.0, 0.2);
    let camera = eye();
    let moved = PlacedCamera {
        world_from_camera: camera.world_from_camera * turned(at(0.02, 0.01, 0.03), 0.01, 0.02, 0.0),
        ..eye()
    };
    let (image, later) = (render(&scene, &now, &camera), render(&scene, &next, &moved));
    let rays = layers::rays(&image.model());
    let motion = Motion { now: &now, next: &next, world_from_next_camera: moved.world_from_camera };
    let body = |segment: u16| usize::from(segment).checked_sub(1);
    let (in_world, in_image) = motion.flows(&image, &rays, body);
    let (mut same, mut same_without_flow, mut count) = (0, 0, 0);
    for pixel in 0..rays.len() {
        if image.segmentation[pixel] != 1 {
            continue;
        }
        let [u, v] = [(pixel % 320) as f32 + 0.5, (pixel / 320) as f32 + 0.5];
        let point = image.world_from_camera
            * Point3::from(image.intrinsics.unproject(
                u as u32,
                v as u32,
                image.depth_m[pixel].into(),
            ));
        let point = point + Vector3::from(in_world[pixel]).cast::<f64>();
        let depth = (moved.world_from_camera.inverse() * point).z as f32;
        let shows = |[du, dv]: [f32; 2]| {
            let (x, y) = ((u + du) as usize, (v + dv) as usize);
            let at = y.min(239) * 320 + x.min(319);
            later.segmentation[at] == 1 && (later.depth_m[at] - depth).abs() < 0.008
        };
        count += 1;
        same += usize::from(shows(in_image[pixel]));
        same_without_flow += usize::from(shows([0.0; 2]));
    }
    assert!(count > 1000 && same * 100 > count * 90, "{same} of {count}");
    assert!(
        same_without_flow * 100 < count * 70,
        "the control agrees: {same_without_flow} of {count}"
    );
}

#[test]
fn nothing_moves_in_a_scene_at_rest() {
    let (scene, now) = world();
    let camera = eye();
    let image = render(&scene, &now, &camera);
    let rays = layers::rays(&image.model());
    let motion = Motion { now: &now, next: &now, world_from_next_camera: camera.world_from_camera };
    let (in_world, in_image) =
        motion.flows(&image, &rays, |segment| usize::from(segment).checked_sub(1));
    assert!(in_world.as_flattened().iter().all(|v| v.abs() < 1e-6));
    assert!(in_image.as_flattened().iter().all(|v| v.abs() < 1e-3));
}

#[test]
fn a_place_in_a_body_is_told_from_one_in_a_room() {
    let wall = primitive(Shape::Box { size: [6.0, 6.0, 3.0] }, [0.5; 3]);
    let crate_ = primitive(Shape::Box { size: [0.5; 3] }, [0.5; 3]);
    let (scene, _) = World::default()
        .body("room", wall, at(0.0, 0.0, 1.5))
        .body("crate", crate_, at(1.0, 1.0, 0.25))
        .build();
    let mut frame = FrameState::of_bodies(vec![at(0.0, 0.0, 1.5), at(1.0, 1.0, 0.25)]);
    frame.world_from_base = Pose::translation(-1.0, 0.0, 0.1);
    let enclosures = Enclosures::new(&scene);
    let around = |x: f64, y: f64, z: f64| {
        enclosures.body_around(&frame, &Point3::new(x, y, z)).map(|body| body.name.as_str())
    };
    assert_eq!(around(1.1, 0.9, 0.3), Some("crate"));
    assert_eq!(around(1.1, 0.9, 0.6), None, "above the crate, in the room with the robot");
    assert_eq!(around(9.0, 0.0, 1.0), None);
    let mut outside = frame.clone();
    outside.world_from_base = Pose::translation(9.0, 0.0, 0.1);
    outside.world_from_tool = Pose::translation(9.0, 0.0, 1.0);
    let found = enclosures.body_around(&outside, &Point3::new(0.0, 0.0, 1.0));
    assert_eq!(found.map(|body| body.name.as_str()), Some("room"), "the robot is elsewhere");
}
