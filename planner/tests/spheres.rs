//! Collision spheres: the report of the fit measured again, and cuRobo's YAML.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use std::fs;
use std::path::PathBuf;

use akrobat_model::{ModelError, Robot, load};
use akrobat_planner::spheres::{self, SphereModel, link_triangles};
use common::{distance_to_soup, numbers, random_points};
use nalgebra::Vector3;

const YAML: &str = "robots/summit_xl_franka/automoma_summit_franka_curobo_MIT.yml";

/// Fraction of random points of a link's surface inside its spheres.
fn coverage(robot: &Robot, model: &SphereModel, link: usize) -> f64 {
    let soup = link_triangles(&robot.tree.links()[link]);
    let points = random_points(&soup, 4000, &mut numbers(link as u64));
    let own: Vec<_> = model.spheres.iter().filter(|s| s.link == link).collect();
    let inside =
        |p: &&Vector3<f64>| own.iter().any(|s| (*p - Vector3::from(s.center)).norm() <= s.radius);
    points.iter().filter(inside).count() as f64 / points.len() as f64
}

#[test]
fn the_report_of_the_fit_is_true() {
    let Some(robot) = common::summit() else { return };
    let model = spheres::of_robot(&robot, None).unwrap();
    let with_geometry: Vec<usize> = (0..robot.tree.links().len())
        .filter(|&l| !link_triangles(&robot.tree.links()[l]).is_empty())
        .collect();
    assert_eq!(model.fits.len(), with_geometry.len());
    for (fit, &link) in model.fits.iter().zip(&with_geometry) {
        assert_eq!(fit.link, robot.tree.links()[link].name);
        let own: Vec<_> = model.spheres.iter().filter(|s| s.link == link).collect();
        assert_eq!(fit.count, own.len());
        assert!(own.len() >= 5 && own.iter().all(|s| s.radius > 0.0), "{}", fit.link);
        let covered = coverage(&robot, &model, link);
        assert!((covered - fit.coverage).abs() < 0.05, "{}: {covered} {}", fit.link, fit.coverage);
        // A sphere whose centre is inside reaches radius - depth beyond the surface.
        let soup = link_triangles(&robot.tree.links()[link]);
        let beyond = |s: &&&spheres::Sphere| s.radius - distance_to_soup(&s.center.into(), &soup);
        let protrusion = own.iter().map(|s| beyond(&s)).fold(0.0, f64::max);
        let gap = fit.protrusion_m - protrusion;
        assert!(gap.abs() < 0.012, "{}: {protrusion} {}", fit.link, fit.protrusion_m);
        assert!(fit.protrusion_m < 0.06, "{}: {}", fit.link, fit.protrusion_m);
    }
    let arm = model.fits.iter().filter(|f| f.link.starts_with("panda"));
    assert!(arm.clone().count() == 11 && arm.clone().all(|f| f.coverage > 0.95));
    // Negative control: with half the spheres, the measurement finds less covered.
    let thinned = SphereModel {
        spheres: model.spheres.iter().copied().step_by(2).collect(),
        fits: Vec::new(),
    };
    for &link in &with_geometry {
        assert!(coverage(&robot, &thinned, link) < coverage(&robot, &model, link) - 0.03);
    }
}

/// Summit-Franka with `yaml` as its spheres.
fn robot_with(yaml: &str, rename: &str) -> Option<(tempfile::TempDir, Robot)> {
    let search = common::search()?;
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("spheres.yml"), yaml).unwrap();
    let text = fs::read_to_string(common::config("robots/summit_franka.toml")).unwrap()
        + "\n[spheres]\nfile = \"spheres.yml\"\n"
        + rename;
    let file: PathBuf = folder.path().join("robot.toml");
    fs::write(&file, text).unwrap();
    let robot = load::robot(&file, &search).unwrap();
    Some((folder, robot))
}

fn import(robot: &Robot) -> Result<SphereModel, ModelError> {
    spheres::of_robot(robot, Some(robot.spheres_path.as_deref().unwrap()))
}

const RENAME: &str = "[spheres.rename]\nsummit_base = \"base_footprint\"\n";

#[test]
fn curobo_spheres_are_taken_as_they_are() {
    let Some(search) = common::search() else { return };
    let yaml = fs::read_to_string(search.folders[0].join(YAML)).unwrap();
    let Some((_folder, robot)) = robot_with(&yaml, RENAME) else { return };
    let model = import(&robot).unwrap();
    let radii: Vec<f64> = yaml
        .lines()
        .filter_map(|line| line.trim().strip_prefix("radius:")?.trim().parse().ok())
        .collect();
    assert_eq!(model.spheres.len(), radii.iter().filter(|r| **r > 0.0).count());
    assert!(model.spheres.len() > 50);
    let total: f64 = model.spheres.iter().map(|s| s.radius).sum();
    assert!((total - radii.iter().filter(|r| **r > 0.0).sum::<f64>()).abs() < 1e-9);
    let footprint = robot.tree.link_index("base_footprint").unwrap();
    let base = robot.tree.link_index("summit_base").unwrap();
    let of = |link: usize| model.spheres.iter().filter(move |s| s.link == link);
    assert_eq!((of(footprint).count(), of(base).count()), (8, 0));
    assert_eq!(of(footprint).next().unwrap().center, [0.28, 0.0, 0.25]);
    // Without the new name they hang from the base's own frame.
    let (_folder, plain) = robot_with(&yaml, "").unwrap();
    let plain = import(&plain).unwrap();
    assert_eq!(plain.spheres.iter().filter(|s| s.link == base).count(), 8);
}

#[test]
fn wrong_sphere_files_are_refused_by_name() {
    let sphere = "[{center: [0, 0, 0], radius: 0.1}]";
    for (yaml, expected) in [
        (format!("collision_spheres: {{no_such_link: {sphere}}}"), "no_such_link"),
        ("collision_spheres: {panda_hand: [1, 2".into(), "spheres.yml"),
        ("spheres: {}".into(), "expected a `collision_spheres` mapping"),
        ("collision_spheres: {panda_hand: 3}".into(), "expected link: [{center, radius}]"),
        (
            "collision_spheres: {panda_hand: [{center: [0, 0], radius: 1}]}".into(),
            "expected link: [{center, radius}]",
        ),
        ("\tx".into(), "spheres.yml"),
    ] {
        let Some((_folder, robot)) = robot_with(&yaml, "") else { return };
        let error = import(&robot).unwrap_err().to_string();
        assert!(error.contains(expected), "{yaml}: {error}");
    }
    let good = format!("a: {{b: {{collision_spheres: {{panda_hand: {sphere}}}}}}}");
    let Some((_folder, robot)) = robot_with(&good, "") else { return };
    assert_eq!(import(&robot).unwrap().spheres.len(), 1);
}

#[test]
fn an_absent_sphere_file_is_refused_by_name() {
    let Some(robot) = common::summit() else { return };
    let error = spheres::import_curobo(&robot, "absent.yml".as_ref()).unwrap_err();
    assert!(matches!(error, ModelError::Read { .. }), "{error}");
}
