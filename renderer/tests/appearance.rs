//! Randomised appearance: the same seed draws the same, and what was drawn makes the same pictures again.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests do")]

mod common;

use akrobat_cameras::CameraFrame;
use akrobat_model::{Pose, Shape};
use akrobat_renderer::{Appearance, Backend, FrameState, RenderScene, SoftBackend, Variation};
use common::{World, at, camera, primitive, textured_square};

fn room() -> (RenderScene, FrameState) {
    World::default()
        .body(
            "floor",
            vec![textured_square(4.0, 8.0, common::patterned_texture())],
            Pose::identity(),
        )
        .body(
            "table",
            primitive(Shape::Box { size: [0.8, 0.8, 0.7] }, [0.5; 3]),
            at(1.2, 0.5, 0.35),
        )
        .moving_body(
            "door",
            primitive(Shape::Box { size: [0.1, 0.5, 0.8] }, [0.6; 3]),
            at(0.0, 0.0, 0.4),
        )
        .build()
}

/// The scene as it looks, with the clutter's poses added to the frame.
fn picture(appearance: &Appearance) -> CameraFrame {
    let (scene, mut frame) = room();
    let varied = appearance.apply(&scene).unwrap();
    frame.world_from_body.extend(varied.world_from_clutter.iter());
    let camera = camera("room", [4.0, -2.5, 2.4], [0.3, 0.1, 0.3], 18.0);
    SoftBackend::new().render(&varied, &frame, &[camera]).unwrap().remove(0)
}

fn draw(seed: u64, episode: &str) -> Appearance {
    let (scene, frame) = room();
    Variation::named("wild").unwrap().draw(&scene, &[frame], seed, episode)
}

#[test]
fn what_was_drawn_is_drawn_again_and_makes_the_same_pictures() {
    let drawn = draw(7, "a");
    assert_eq!(draw(7, "a"), drawn);
    for other in [draw(8, "a"), draw(7, "b")] {
        assert_ne!(other, drawn);
        assert_ne!(picture(&other).rgb, picture(&drawn).rgb);
    }
    // Through the text that an episode's provenance keeps.
    let file = std::env::temp_dir().join(format!("akrobat-look-{}.json", std::process::id()));
    std::fs::write(&file, serde_json::to_string(&drawn).unwrap()).unwrap();
    let recorded = Appearance::load(&file);
    std::fs::remove_file(&file).unwrap();
    let recorded = recorded.unwrap();
    assert_eq!(recorded, drawn);
    let (first, again) = (picture(&drawn), picture(&recorded));
    assert_eq!((first.rgb, first.depth_m), (again.rgb, again.depth_m));
}

#[test]
fn clutter_is_seen_labelled_and_out_of_the_way() {
    let (scene, frame) = room();
    let drawn = draw(3, "episode");
    assert!(!drawn.clutter.is_empty());
    let varied = drawn.apply(&scene).unwrap();
    let labels = varied.segment_labels();
    assert_eq!(labels.len(), scene.bodies.len() + drawn.clutter.len());
    assert!(labels[scene.bodies.len()..].iter().all(|label| label.group == "clutter"));
    let image = picture(&drawn);
    assert!(image.segmentation.iter().any(|&id| usize::from(id) > scene.bodies.len()));
    for clutter in &drawn.clutter {
        let [x, y, z, ..] = clutter.world_from_clutter;
        // On the floor or on the table.
        let below = z - clutter.size_m[2] / 2.0;
        assert!(
            below.abs() < 1e-6 || (below - 0.7).abs() < 1e-5 || (below - 0.8).abs() < 1e-5,
            "{below}"
        );
        assert!(x.abs() < 4.0 && y.abs() < 4.0);
    }
    assert_eq!(frame.world_from_body.len(), scene.bodies.len());
}

#[test]
fn appearances_of_other_scenes_are_refused() {
    let drawn = draw(1, "x");
    let (other, _) = World::default().build();
    let message = drawn.apply(&other).unwrap_err().to_string();
    assert!(message.contains("there is no mesh"), "{message}");
}
