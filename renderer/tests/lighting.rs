//! Lights, shadows and reflection: the rasterisers against the ray tracer that spells the image model out.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests do")]

mod common;

use akrobat_cameras::CameraFrame;
use akrobat_model::{Material, Pose, Shape, TriMesh};
use akrobat_renderer::compare::{Comparison, Tolerance, inner_pixels};
use akrobat_renderer::lighting::{Light, Shadow};
use akrobat_renderer::{Backend, FrameState, Lighting, PlacedCamera, RenderScene, SoftBackend};
use common::ray_tracer::ray_traced;
use common::{World, at, camera, primitive, textured_square, turned};

/// What casts shadows on a floor with a wall: metal and plastic, smooth and flat normals, a texture.
fn still_life() -> (RenderScene, FrameState) {
    let with = |mut meshes: Vec<TriMesh>, metallic: f32, roughness: f32| {
        meshes.iter_mut().for_each(|mesh| {
            mesh.material = Material { metallic, roughness, ..mesh.material.clone() };
        });
        meshes
    };
    let sphere = primitive(Shape::Sphere { radius: 0.25 }, [0.9, 0.6, 0.3]);
    let block = primitive(Shape::Box { size: [0.3, 0.2, 0.5] }, [0.2, 0.5, 0.8]);
    let cylinder = primitive(Shape::Cylinder { radius: 0.06, length: 0.9 }, [0.7, 0.7, 0.7]);
    let wall = primitive(Shape::Box { size: [0.05, 3.0, 1.6] }, [0.8, 0.8, 0.75]);
    let floor = textured_square(2.0, 4.0, common::patterned_texture());
    World::default()
        .body("floor", vec![floor], Pose::identity())
        .body("wall", wall, at(-0.9, 0.0, 0.8))
        .moving_body("sphere", with(sphere, 1.0, 0.3), at(0.1, 0.4, 0.3))
        .moving_body("block", with(block, 0.0, 0.2), turned(at(-0.2, -0.4, 0.25), 0.0, 0.0, 0.5))
        .moving_body("cylinder", with(cylinder, 0.5, 0.6), turned(at(0.4, 0.0, 0.5), 0.9, 0.4, 0.0))
        .build()
}

fn view() -> PlacedCamera {
    let mut camera = camera("across", [2.3, -1.4, 1.5], [0.0, 0.0, 0.25], 22.0);
    camera.intrinsics.width = 240;
    camera.intrinsics.height = 180;
    camera.intrinsics.fx *= 0.75;
    camera.intrinsics.fy *= 0.75;
    camera.intrinsics.cx = 120.0;
    camera.intrinsics.cy = 90.0;
    camera.normals = true;
    camera
}

/// One colour level more than rounding explains is a difference; shadow maps may differ from rays along the shadows'
/// outlines alone.
fn agrees(expected: &CameraFrame, image: &CameraFrame) -> Result<(), String> {
    let comparison = Comparison::new(expected, image, &Tolerance::default());
    if let Some(violation) = comparison.violation(&Tolerance::default()) {
        return Err(violation);
    }
    let inner = inner_pixels(expected);
    let differs = |pixel: &usize| {
        (0..3).any(|c| expected.rgb[3 * pixel + c].abs_diff(image.rgb[3 * pixel + c]) > 2)
    };
    let compared = inner.iter().filter(|is_inner| **is_inner).count();
    let wrong = (0..inner.len()).filter(|&p| inner[p]).filter(differs).count();
    if wrong * 50 > compared {
        return Err(format!("{wrong} of {compared} pixels have another colour; {comparison}"));
    }
    if comparison.ssim < 0.98 || comparison.normal_agreement < 0.999 {
        return Err(comparison.to_string());
    }
    Ok(())
}

fn lightings() -> impl Iterator<Item = Lighting> {
    Lighting::preset_names().map(|name| Lighting::preset(name).unwrap())
}

/// The same lights without what keeps them back.
fn without_shadows(lighting: &Lighting) -> Lighting {
    let mut lighting = lighting.clone();
    for light in &mut lighting.lights {
        let (Light::Directional { shadow, .. }
        | Light::Point { shadow, .. }
        | Light::Spot { shadow, .. }) = light;
        *shadow = Shadow::None;
    }
    lighting
}

fn check(backend: &mut dyn Backend) {
    let (scene, frame) = still_life();
    let camera = view();
    for lighting in lightings() {
        let lit = scene.lit_by(&lighting);
        let expected = ray_traced(&lit, &frame, &camera);
        let mut render = |scene: &RenderScene, camera: &PlacedCamera| {
            backend.render(scene, &frame, std::slice::from_ref(camera)).unwrap().remove(0)
        };
        let image = render(&lit, &camera);
        common::keep_images(&format!("lighting_{}", lighting.name), &expected, &image);
        if let Err(message) = agrees(&expected, &image) {
            panic!("{}: {message}", lighting.name);
        }
        // What must be noticed: missing shadows, another reflection, a light that has moved.
        let open = without_shadows(&lighting);
        if open != lighting {
            let image = render(&scene.lit_by(&open), &camera);
            assert!(agrees(&expected, &image).is_err(), "{}: no shadows", lighting.name);
        }
        let mut moved = lighting.clone();
        let light = moved.lights.first_mut().unwrap();
        let (Light::Directional { direction: place, .. }
        | Light::Point { position: place, .. }
        | Light::Spot { position: place, .. }) = light;
        place[1] += 0.15;
        let image = render(&scene.lit_by(&moved), &camera);
        assert!(agrees(&expected, &image).is_err(), "{}: a moved light", lighting.name);
    }
}

#[test]
fn soft_draws_every_preset_as_the_ray_tracer_does() {
    check(&mut SoftBackend::new());
}

#[cfg(feature = "wgpu")]
#[test]
fn wgpu_draws_every_preset_as_the_ray_tracer_does() {
    use akrobat_gpu::AdapterChoice;
    use akrobat_renderer::raster::WgpuBackend;
    check(&mut WgpuBackend::open(&AdapterChoice::Any).unwrap_or_else(|error| panic!("{error}")));
}

#[test]
fn bodies_of_the_scene_cast_no_shadow_where_only_moving_ones_do() {
    let (scene, frame) = still_life();
    let sun = |shadow: &str| {
        let text = format!(
            "name = \"sun\"\n[[lights]]\nkind = \"directional\"\ndirection = [-1, 0.1, 0.6]\nrgb = [1, 1, 1]\nshadow = \"{shadow}\""
        );
        let lit = scene.lit_by(&Lighting::from_toml(&text, "sun").unwrap());
        SoftBackend::new().render(&lit, &frame, &[view()]).unwrap().remove(0)
    };
    let dark = |image: &CameraFrame, id: u16| {
        let pixels = (0..image.segmentation.len()).filter(|&p| image.segmentation[p] == id);
        pixels.filter(|&p| image.rgb[3 * p..3 * p + 3].iter().all(|&c| c < 150)).count()
    };
    let [none, moving, all] = ["none", "moving", "all"].map(|shadow| dark(&sun(shadow), 1));
    assert!(none + 200 < moving && moving + 2000 < all, "{none} {moving} {all}");
}

/// What a backend that has drawn the frames before gives is what a new one gives, to the byte.
#[test]
fn what_is_kept_from_frame_to_frame_does_not_show() {
    let (scene, frame) = still_life();
    let moved = |frame: &FrameState, body: usize| {
        let mut frame = frame.clone();
        frame.world_from_body[body] = at(0.1, -0.05, 0.0) * frame.world_from_body[body];
        frame
    };
    // The camera rests over the first three frames, in which bodies 2 to 4 move; then the wall moves, and then the camera.
    let mut frames = vec![frame.clone(), moved(&frame, 2), moved(&moved(&frame, 3), 4)];
    frames.extend([moved(&frame, 1), moved(&frame, 1), moved(&frame, 1), frame.clone()]);
    let mut cameras = vec![view(); frames.len()];
    cameras[5].world_from_camera *= at(0.02, 0.0, 0.0);
    cameras[6].normals = false;
    for lighting in ["even", "sun"] {
        let scene = scene.lit_by(&Lighting::preset(lighting).unwrap());
        let mut kept = SoftBackend::new();
        let mut different = 0;
        let mut last: Option<CameraFrame> = None;
        for (frame, camera) in frames.iter().zip(&cameras) {
            let camera = std::slice::from_ref(camera);
            let image = kept.render(&scene, frame, camera).unwrap().remove(0);
            let anew = SoftBackend::new().render(&scene, frame, camera).unwrap().remove(0);
            assert_eq!(image.rgb, anew.rgb, "{lighting}");
            assert_eq!(image.depth_m, anew.depth_m, "{lighting}");
            assert_eq!(image.segmentation, anew.segmentation, "{lighting}");
            assert_eq!(image.normals, anew.normals, "{lighting}");
            different += usize::from(last.is_some_and(|last| last.rgb != image.rgb));
            last = Some(image);
        }
        // All but the fifth differ from the one before.
        assert_eq!(different, frames.len() - 2, "{lighting}");
    }
    // Another light on the same scene, seen from the same place.
    let mut kept = SoftBackend::new();
    let camera = [view()];
    for lighting in ["even", "even", "even", "evening"] {
        let scene = scene.lit_by(&Lighting::preset(lighting).unwrap());
        let image = kept.render(&scene, &frame, &camera).unwrap().remove(0);
        let anew = SoftBackend::new().render(&scene, &frame, &camera).unwrap().remove(0);
        assert_eq!(image.rgb, anew.rgb, "{lighting}");
    }
}
