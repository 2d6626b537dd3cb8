//! The CPU rasteriser against closed forms and against the ray tracer that spells the image model out.

#![allow(clippy::unwrap_used)] // Test helpers fail by panicking.

mod common;

use akrobat_cameras::CameraFrame;
use akrobat_model::{Material, Pose, Shape, TriMesh};
use akrobat_renderer::compare::{Comparison, Tolerance, inner_pixels};
use akrobat_renderer::{Backend, FrameState, Lighting, PlacedCamera, RenderScene, SoftBackend};
use common::ray_tracer::ray_traced;
use common::{World, at, camera, patterned_texture, primitive, textured_square, turned};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn render(scene: &RenderScene, frame: &FrameState, camera: &PlacedCamera) -> CameraFrame {
    let cameras = std::slice::from_ref(camera);
    SoftBackend::new().render(scene, frame, cameras).unwrap().remove(0)
}

/// Looks along the world's x axis from the origin.
fn ahead() -> PlacedCamera {
    camera("ahead", [0.0; 3], [1.0, 0.0, 0.0], 20.0)
}

#[test]
fn depth_of_a_tilted_plane_is_that_of_the_closed_form() {
    // The plane x + 0.8 y - 0.3 z = 2 as one huge triangle.
    let place = |y: f32, z: f32| [2.0 - 0.8 * y + 0.3 * z, y, z];
    let mesh = TriMesh {
        positions: vec![place(-50.0, -50.0), place(100.0, -50.0), place(-50.0, 100.0)],
        triangles: vec![[0, 1, 2]],
        ..TriMesh::default()
    };
    let (scene, frame) = World::default().body("plane", vec![mesh], Pose::identity()).build();
    let camera = ahead();
    let image = render(&scene, &frame, &camera);
    for v in 0..240 {
        for u in 0..320 {
            let ray = camera.world_from_camera.rotation
                * nalgebra::Vector3::from(camera.intrinsics.unproject(u, v, 1.0));
            let expected = 2.0 / (ray.x + 0.8 * ray.y - 0.3 * ray.z);
            let found = f64::from(image.depth_m[(v * 320 + u) as usize]);
            assert!((found / expected - 1.0).abs() < 1e-6, "({u}, {v}): {found} for {expected}");
        }
    }
}

#[test]
fn a_plane_from_under_the_camera_to_the_horizon_is_cut_at_near_and_far() {
    let (scene, frame) = World::default()
        .body("floor", vec![textured_square(500.0, 1.0, patterned_texture())], at(0.0, 0.0, -0.02))
        .build();
    // 2 cm above the floor: it reaches from before the near plane to beyond the far one.
    let mut camera = ahead();
    (camera.near_m, camera.far_m) = (0.1, 5.0);
    let image = render(&scene, &frame, &camera);
    for v in 0..240u32 {
        let slope = (f64::from(v) + 0.5 - camera.intrinsics.cy) / camera.intrinsics.fy;
        let expected = 0.02 / slope;
        let is_seen = slope > 0.0 && expected > camera.near_m && expected < camera.far_m;
        for u in (0..320).step_by(13) {
            let found = f64::from(image.depth_m[(v * 320 + u) as usize]);
            let expected = if is_seen { expected } else { 0.0 };
            assert!((found - expected).abs() <= 1e-5 * expected, "({u}, {v}): {found} {expected}");
        }
    }
}

#[test]
fn textures_are_interpolated_in_perspective() {
    // A floor of 1 m squares seen at a grazing angle; interpolation in the image would bend the squares.
    let board = image::RgbaImage::from_fn(64, 64, |u, v| {
        image::Rgba(if (u / 32 + v / 32) % 2 == 0 { [255; 4] } else { [0, 0, 0, 255] })
    });
    let mut floor = textured_square(8.0, 8.0, board);
    floor.material.base_color = [1.0; 4];
    let (scene, frame) = World::default().body("floor", vec![floor], Pose::identity()).build();
    let camera = camera("low", [-7.3, 0.4, 0.9], [0.0, 0.0, 0.0], 20.0);
    let image = render(&scene, &frame, &camera);
    let mut checked = 0;
    for v in 0..240 {
        for u in 0..320 {
            let pixel = (v * 320 + u) as usize;
            let depth_m = f64::from(image.depth_m[pixel]);
            let point = camera.world_from_camera
                * nalgebra::Point3::from(camera.intrinsics.unproject(u, v, depth_m));
            // Two metres hold two squares; stay clear of their borders, which filtering blurs.
            let (x, y) = ((point.x + 8.0).rem_euclid(2.0), (8.0 - point.y).rem_euclid(2.0));
            let clear = |along: f64| (along.fract() - 0.5).abs() < 0.45;
            if depth_m == 0.0 || !clear(x) || !clear(y) {
                continue;
            }
            checked += 1;
            let is_white = (x >= 1.0) == (y >= 1.0);
            assert_eq!(image.rgb[3 * pixel] > 128, is_white, "({u}, {v}) at {point}");
        }
    }
    assert!(checked > 20_000, "{checked}");
}

/// Triangles of every size and direction, some through the camera, in bodies with and without normals.
fn soup(seed: u64) -> (RenderScene, FrameState) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut world = World::default();
    for body in 0..12 {
        let edge: f32 = [0.02, 0.2, 1.0, 6.0][body % 4];
        let mut mesh = TriMesh {
            material: Material {
                base_color: std::array::from_fn(|_| random.random_range(0.05..0.9)),
                ..Material::default()
            },
            ..TriMesh::default()
        };
        for triangle in 0..(300 / (body % 4 * 4 + 1)) as u32 {
            let center: [f32; 3] = std::array::from_fn(|_| random.random_range(-2.0..2.0));
            for _ in 0..3 {
                mesh.positions.push(center.map(|c| c + random.random_range(-edge..edge)));
                let normal: [f32; 3] = std::array::from_fn(|_| random.random_range(-1.0..1.0f32));
                mesh.normals.push(nalgebra::Vector3::from(normal).normalize().into());
            }
            mesh.triangles.push([0, 1, 2].map(|corner| 3 * triangle + corner));
        }
        if body % 2 == 0 {
            mesh.normals.clear();
        }
        let angles: [f64; 3] = std::array::from_fn(|_| random.random_range(-3.0..3.0));
        let pose = turned(at(0.0, 0.0, 0.0), angles[0], angles[1], angles[2]);
        world = world.body(&format!("body {body}"), vec![mesh], pose);
    }
    world.build()
}

/// Tighter than between backends: both compute at the same pixel centres.
fn soup_tolerance() -> Tolerance {
    Tolerance { depth_m: 1e-4, depth_agreement: 0.9999, ..Tolerance::default() }
}

#[test]
fn triangle_soups_match_the_ray_tracer() {
    for seed in 0..3 {
        let (scene, frame) = soup(seed);
        // From outside, and from the middle, where triangles pass through the near plane on all sides.
        for camera in [
            camera("outside", [4.0, 1.0, 1.5], [0.0; 3], 30.0),
            camera("inside", [0.1, 0.2, 0.1], [1.0, 0.3, 0.0], 12.0),
        ] {
            let expected = ray_traced(&scene, &frame, &camera);
            let image = render(&scene, &frame, &camera);
            let comparison = Comparison::new(&expected, &image, &soup_tolerance());
            assert_eq!(comparison.violation(&soup_tolerance()), None, "{comparison}");
            assert!(comparison.color_p99 <= 1, "{comparison}");
            let inner = inner_pixels(&expected);
            let wrong = (0..inner.len())
                .filter(|&p| inner[p] && expected.segmentation[p] != image.segmentation[p])
                .count();
            assert!(wrong * 10_000 <= inner.len(), "{wrong} inner pixels of another body");

            let mut moved = camera.clone();
            moved.world_from_camera *= at(0.0, 0.0, 0.01);
            let image = render(&scene, &frame, &moved);
            let comparison = Comparison::new(&expected, &image, &soup_tolerance());
            assert!(comparison.violation(&soup_tolerance()).is_some(), "{comparison}");
        }
    }
}

#[test]
fn textured_primitives_match_the_ray_tracer() {
    let sphere = primitive(Shape::Sphere { radius: 0.3 }, [0.8, 0.2, 0.1]);
    let cylinder = primitive(Shape::Cylinder { radius: 0.1, length: 1.2 }, [0.1, 0.3, 0.8]);
    let (scene, frame) = World::default()
        .body("floor", vec![textured_square(6.0, 9.5, patterned_texture())], Pose::identity())
        .body("sphere", sphere, at(0.2, 0.3, 0.5))
        .body("cylinder", cylinder, turned(at(0.1, 0.2, 0.5), 0.9, 0.4, 0.0))
        .build();
    for camera in [
        camera("across", [2.0, -1.5, 1.2], [0.0, 0.1, 0.3], 24.0),
        camera("low", [-1.6, 1.4, 0.3], [0.0, 0.0, 0.4], 15.0),
    ] {
        let image = render(&scene, &frame, &camera);
        let comparison =
            Comparison::new(&ray_traced(&scene, &frame, &camera), &image, &Tolerance::default());
        assert_eq!(comparison.violation(&Tolerance::default()), None, "{comparison}");
        assert!(comparison.depth_p99_m < 1e-5 && comparison.color_p99 <= 1, "{comparison}");
    }
}

#[test]
fn images_do_not_depend_on_the_number_of_threads_or_on_earlier_frames() {
    let (scene, frame) = soup(9);
    let cameras = [
        camera("a", [4.0, 1.0, 1.5], [0.0; 3], 30.0),
        camera("b", [0.1, 0.2, 0.1], [1.0, 0.3, 0.0], 12.0),
        camera("c", [-3.0, 1.0, 0.5], [0.0; 3], 20.0),
    ];
    let mut backend = SoftBackend::new();
    let mut images_with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| backend.render(&scene, &frame, &cameras).unwrap())
    };
    // With more threads, images are divided into more bands.
    let (one, two, seven) = (images_with(1), images_with(2), images_with(7));
    for (((one, two), seven), camera) in one.iter().zip(&two).zip(&seven).zip(&cameras) {
        let alone = render(&scene, &frame, camera);
        for other in [two, seven, &alone] {
            assert_eq!(one.rgb, other.rgb);
            assert_eq!(one.depth_m, other.depth_m);
            assert_eq!(one.segmentation, other.segmentation);
        }
    }
    assert_ne!(one[0].depth_m, one[1].depth_m);
}

#[test]
fn what_cannot_be_drawn_shows_the_background() {
    let broken = TriMesh {
        positions: vec![[f32::NAN, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 1.0], [2.0, 0.0, 0.0]],
        // Not a number, out of range, without area.
        triangles: vec![[0, 1, 2], [1, 2, 9], [1, 1, 2]],
        ..TriMesh::default()
    };
    for meshes in [vec![], vec![TriMesh::default()], vec![broken]] {
        let (scene, frame) = World::default().body("body", meshes, Pose::identity()).build();
        let image = render(&scene, &frame, &ahead());
        assert!(image.depth_m.iter().all(|&depth| depth == 0.0));
        assert!(image.segmentation.iter().all(|&id| id == 0));
        assert!(image.rgb.chunks(3).all(|rgb| rgb == Lighting::default().background_rgb));
    }
}

#[test]
fn frames_and_sizes_that_do_not_fit_are_errors() {
    let (scene, frame) = soup(1);
    let mut backend = SoftBackend::new();
    let short = FrameState::of_bodies(vec![Pose::identity()]);
    let message = backend.render(&scene, &short, &[ahead()]).unwrap_err().to_string();
    assert!(message.contains("12 bodies"), "{message}");
    let mut huge = ahead();
    huge.intrinsics.width = 5000;
    let message = backend.render(&scene, &frame, &[huge]).unwrap_err().to_string();
    assert!(message.contains("5000") && message.contains("4096"), "{message}");
}

#[test]
fn supersampling_smooths_colour_and_leaves_depth_and_segments_as_they_are() {
    let (scene, frame) = soup(5);
    let mut camera = camera("outside", [4.0, 1.0, 1.5], [0.0; 3], 30.0);
    camera.normals = true;
    let cameras = std::slice::from_ref(&camera);
    let plain = SoftBackend::new().render(&scene, &frame, cameras).unwrap().remove(0);
    let samples: akrobat_renderer::Supersampling = "3".parse().unwrap();
    let mut smooth = samples.over(Box::new(SoftBackend::new()));
    let image = smooth.render(&scene, &frame, cameras).unwrap().remove(0);
    let agree = |same: &dyn Fn(usize) -> bool| {
        (0..plain.depth_m.len()).filter(|&p| same(p)).count() * 1000 >= plain.depth_m.len() * 999
    };
    assert!(agree(&|p| (plain.depth_m[p] - image.depth_m[p]).abs() <= 1e-4));
    assert!(agree(&|p| plain.segmentation[p] == image.segmentation[p]));
    assert_eq!(image.normals.len(), plain.normals.len());
    // Where bodies meet, a pixel's colour is a mixture that neither has.
    assert!(!agree(&|p| plain.rgb[3 * p] == image.rgb[3 * p]));
    for wrong in ["2", "0", "x"] {
        let message = wrong.parse::<akrobat_renderer::Supersampling>().unwrap_err();
        assert!(message.contains("1, 3, 5"), "{message}");
    }
}
