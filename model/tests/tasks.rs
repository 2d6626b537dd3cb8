//! What whole tasks turn into: placing, fitting, grasp frames, package paths, textures.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

mod common;

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::{Pose, SceneBody, mesh_io, urdf};
use common::Files;
use nalgebra::{Point3, Vector3};

const POSE: &str = "pose = [1.0, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0]";

/// World corners of the box around the closed object.
fn object_bounds(task: &akrobat_model::task::Task) -> (Vector3<f64>, Vector3<f64>) {
    let object = &task.object;
    let poses = object.tree.link_poses(&object.world_from_root, &object.start);
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = -low;
    for (link, pose) in object.tree.links().iter().zip(poses) {
        for p in link.visuals.iter().flat_map(|p| p.triangulate()).flat_map(|m| m.positions) {
            let p = (pose * Point3::from(p.map(f64::from))).coords;
            (low, high) = (low.inf(&p), high.sup(&p));
        }
    }
    (low, high)
}

#[test]
fn an_object_takes_a_bodys_place() {
    let files = Files::new();
    files.edit("task.toml", POSE, "replaces = { body = \"fri*\", yaw = 0.0 }");
    let task = files.task().unwrap_or_else(|e| panic!("{e}"));
    assert!(!task.scene.bodies.iter().any(|b: &SceneBody| b.name == "fridge"));
    // The fridge is 0.8 x 0.6 x 1.6 around (2, 1, 0.8).
    let (low, high) = object_bounds(&task);
    assert!(low.z.abs() < 1e-6 && (low.x - 1.6).abs() < 1e-6, "{low}");
    assert!(((low.y + high.y) / 2.0 - 1.0).abs() < 1e-6, "{low} {high}");
    assert!((high.z - 0.8).abs() < 1e-6, "not scaled: {high}");
}

#[test]
fn a_fitted_object_fills_the_place_when_turned() {
    let files = Files::new();
    let replaces = "replaces = { body = \"fridge\", yaw = 1.5707963267948966, fit = true }";
    files.edit("task.toml", POSE, replaces);
    let task = files.task().unwrap_or_else(|e| panic!("{e}"));
    let (low, high) = object_bounds(&task);
    // Turned by 90 degrees, the back is at the body's smallest y.
    assert!((low.y - 0.7).abs() < 1e-5 && low.z.abs() < 1e-6, "{low}");
    let (size, place) = (high - low, Vector3::new(0.8, 0.6, 1.6));
    let ratios = place.component_div(&size);
    assert!(ratios.min() > 1.0 - 1e-5 && ratios.min() < 1.0 + 1e-5, "{ratios}");
    assert!(((low.x + high.x) / 2.0 - 2.0).abs() < 1e-5, "{low} {high}");
}

#[test]
fn grasps_of_either_frame_are_the_same_grasp() {
    let files = Files::new();
    // The held link lies at (0.21, -0.3, 0) of the object at the start.
    files.write("object.txt", "0.3 0.2 0.0 1 0 0 0\n");
    files.write("link.txt", "0.09 0.5 0.0 1 0 0 0\n");
    let grasp = |section: &str| {
        let text = std::fs::read_to_string(files.path("task.toml")).unwrap();
        let text = text.replace("[goal]", &format!("[grasps]\n{section}\n[goal]"));
        let search = AssetSearch::default();
        load::task_from_text(text, &files.path("task.toml"), &search).unwrap().grasp_poses[0]
    };
    let (a, b) = (grasp("file = \"object.txt\""), grasp("file = \"link.txt\"\nframe = \"link\""));
    assert!((a.translation.vector - b.translation.vector).norm() < 1e-9, "{a} {b}");
}

#[test]
fn a_fixed_robot_stands_where_the_task_says() {
    let files = Files::new();
    files.edit("bot.toml", "holonomic", "fixed");
    files.edit(
        "task.toml",
        "\"bot.toml\"",
        "\"bot.toml\"\npose = [1.0, 2.0, 0.0, 1.0, 0.0, 0.0, 0.0]",
    );
    let robot = files.task().unwrap().robot;
    assert!(robot.base_joints.is_empty());
    assert_eq!(robot.world_from_root, Pose::translation(1.0, 2.0, 0.0));
}

#[test]
fn a_task_narrows_the_robots_limits() {
    let files = Files::new();
    let limits_of = |files: &Files, joint: &str| {
        let tree = files.task().unwrap().robot.tree;
        tree.joints()[tree.joint_index(joint).unwrap()].limits
    };
    assert_eq!(limits_of(&files, "elbow"), [-1.0, 1.0]);
    files.edit("task.toml", "\"bot.toml\"", "\"bot.toml\"\nlimits = { elbow = [0.2, 0.9] }");
    assert_eq!(limits_of(&files, "elbow"), [0.2, 0.9]);
    assert_eq!(limits_of(&files, "lift"), [0.0, 0.5]);
}

#[test]
fn packages_are_found_by_manifest_and_by_search_folder() {
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let urdf_text = r#"<robot name="r"><link name="l"><visual><geometry><mesh filename="package://my_pack/meshes/a.obj"/></geometry></visual></link></robot>"#;
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("renamed");
    std::fs::create_dir_all(root.join("meshes")).unwrap();
    std::fs::create_dir_all(root.join("urdf")).unwrap();
    std::fs::write(root.join("package.xml"), "<package><name>my_pack</name></package>").unwrap();
    std::fs::write(root.join("meshes/a.obj"), triangle).unwrap();
    std::fs::write(root.join("urdf/r.urdf"), urdf_text).unwrap();
    urdf::read(&root.join("urdf/r.urdf"), &AssetSearch::default()).unwrap();

    let elsewhere = tempfile::tempdir().unwrap();
    let alone = elsewhere.path().join("r.urdf");
    std::fs::write(&alone, urdf_text).unwrap();
    assert!(urdf::read(&alone, &AssetSearch::default()).is_err());
    let search = AssetSearch { folders: vec![folder.path().to_path_buf()] };
    urdf::read(&alone, &search).unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn obj_materials_and_textures_with_spaces() {
    let files = Files::new();
    image::RgbaImage::from_pixel(2, 2, image::Rgba([9, 8, 7, 255]))
        .save(files.path("my tex.png"))
        .unwrap();
    files.write(
        "m.mtl",
        "newmtl red\nKd 0.5 0 0\nd 0.25\nnewmtl tex\nKd 0 0 0\nmap_Kd -s 1 1 1 my tex.png\n",
    );
    files.write(
        "m.obj",
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\nusemtl tex\nf 3 2 1\n",
    );
    let meshes = mesh_io::load(&files.path("m.obj")).unwrap();
    assert_eq!(meshes[0].material.base_color, [0.5, 0.0, 0.0, 0.25]);
    let texture = meshes[1].material.base_color_texture.as_ref().unwrap();
    assert_eq!(texture.get_pixel(0, 0).0, [9, 8, 7, 255]);
    assert_eq!(meshes[1].material.base_color, [1.0; 4]);

    // A library that is not there is mentioned, and the mesh is still loaded.
    files.write("n.obj", "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let file = mesh_io::load_with_notes(&files.path("n.obj")).unwrap();
    assert!(file.notes[0].contains("gone.mtl"), "{:?}", file.notes);
}

#[test]
fn collada_units_transforms_and_colours() {
    let files = Files::new();
    files.write(
        "a.dae",
        r##"<COLLADA><asset><unit meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique><lambert><diffuse><color>0.1 0.2 0.3 1</color></diffuse></lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="12">0 0 0 100 0 0 100 100 0 0 100 0</float_array>
<technique_common><accessor source="#f" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<polylist count="1" material="sym"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4</vcount><p>0 1 2 3</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="vs"><node><translate>0 0 50</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>
<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="sym" target="#m"/></technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"##,
    );
    let mesh = &mesh_io::load(&files.path("a.dae")).unwrap()[0];
    assert_eq!(mesh.triangles.len(), 2);
    assert_eq!(mesh.material.base_color, [0.1, 0.2, 0.3, 1.0]);
    // (100, 0, 0) units: scaled to 200, turned onto y, lifted by 50; the up axis does not matter.
    let near = |p: &[f32; 3]| (0..3).all(|k| (p[k] - [0.0, 2.0, 0.5][k]).abs() < 1e-6);
    assert!(mesh.positions.iter().any(near), "{:?}", mesh.positions);
}
