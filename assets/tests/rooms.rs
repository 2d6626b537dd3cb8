//! Generated kitchens: what every one of them must be.

#![allow(clippy::unwrap_used, reason = "a test that panics is a test that fails")]

use akrobat_assets::overlap::WorldBox;
use akrobat_assets::room::{self, GeneratedScene, TaskRobot};
use akrobat_model::Shape;
use akrobat_model::load::{self, AssetSearch};

fn scenes() -> Vec<GeneratedScene> {
    (0..20).map(|seed| room::generate(seed, seed as f64 / 19.0).unwrap()).collect()
}

/// Deepest intersection of two different bodies, metres, by all pairs of boxes.
fn deepest(scene: &GeneratedScene) -> f64 {
    let mut deepest = f64::NEG_INFINITY;
    for (index, first) in scene.bodies.iter().enumerate() {
        for second in &scene.bodies[index + 1..] {
            for a in &first.link.collisions {
                for b in &second.link.collisions {
                    let a = WorldBox::new(&first.world_from_body, a);
                    let b = WorldBox::new(&second.world_from_body, b);
                    deepest = deepest.max(a.penetration(&b));
                }
            }
        }
    }
    deepest
}

#[test]
fn bodies_do_not_intersect_and_targets_are_reached() {
    for scene in scenes() {
        assert!(deepest(&scene) <= 0.001, "scene of seed {}", scene.seed);
        assert!(scene.objects.len() >= 4, "scene of seed {}", scene.seed);
        for placed in &scene.objects {
            assert!(!placed.reached_by.is_empty());
            let twin = &placed.object.description.name;
            assert_eq!(scene.bodies.iter().filter(|body| body.name == *twin).count(), 1);
        }
    }
}

#[test]
fn a_body_out_of_place_is_noticed() {
    let mut scene = room::generate(1, 0.5).unwrap();
    let table = scene.bodies.iter().position(|body| body.class == "oven").unwrap();
    scene.bodies[table].world_from_body.translation.vector.z += 0.02;
    assert!(deepest(&scene) > 0.01);
}

#[test]
fn confinement_narrows_the_free_floor() {
    let mean = |confinement: f64| {
        let shares: Vec<f64> =
            (0..12).map(|seed| room::generate(seed, confinement).unwrap().free_floor).collect();
        shares.iter().sum::<f64>() / shares.len() as f64
    };
    assert!(mean(0.0) > mean(1.0) + 0.1, "{} {}", mean(0.0), mean(1.0));
}

#[test]
fn the_seed_decides_every_byte_and_seeds_differ() {
    let files = |seed: u64| {
        let folder = tempfile::tempdir().unwrap();
        room::generate(seed, 0.3).unwrap().write(folder.path(), "scene", &[]).unwrap();
        ["scene.glb", "scene.urdf", "scene.usda", "scene.json"]
            .map(|name| std::fs::read(folder.path().join(name)).unwrap())
    };
    assert_eq!(files(5), files(5));
    assert_ne!(files(5), files(6));
}

#[test]
fn tasks_load_from_gltf_and_the_urdf_has_the_same_bodies() {
    let folder = tempfile::tempdir().unwrap();
    let robot = akrobat_assets::robot::DemoRobot::Pillar.write(folder.path()).unwrap();
    let scene = room::generate(4, 0.4).unwrap();
    let robots = [TaskRobot { name: "pillar".into(), file: robot.display().to_string() }];
    let tasks = scene.write(folder.path(), "kitchen", &robots).unwrap();
    assert!(tasks.len() >= 4);
    for (file, ..) in &tasks {
        let task = load::task(&folder.path().join(file), &AssetSearch::default()).unwrap();
        let notes = [&task.object.notes[..], &task.scene.notes[..]].concat();
        assert!(notes.is_empty(), "{file}: {notes:?}");
        assert_eq!(task.scene.bodies.len(), scene.bodies.len() - 1);
        for body in &task.scene.bodies {
            let source = scene.bodies.iter().find(|b| b.name == body.name).unwrap();
            let apart =
                body.world_from_body.translation.vector - source.world_from_body.translation.vector;
            assert!(apart.norm() < 1e-5 && matches!(body.visuals[0].shape, Shape::Mesh { .. }));
            let turn = body.world_from_body.rotation.angle_to(&source.world_from_body.rotation);
            assert!(turn < 1e-5, "{}", body.name);
        }
    }
    let urdf =
        akrobat_model::urdf::read(&folder.path().join("scene.urdf"), &AssetSearch::default());
    let (tree, notes) = urdf.unwrap();
    assert!(notes.is_empty());
    assert_eq!(tree.links().len(), scene.bodies.len() + 1);
}
