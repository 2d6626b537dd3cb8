//! Imports of other collections' formats, on fixtures with their quirks and on the shared real inputs.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};

use akrobat_assets::import::grasps::{self, Convention};
use akrobat_assets::import::infinigen::{self, Catalog};
use akrobat_assets::import::partnet::{self, Size};
use akrobat_assets::import::{ImportedScene, layout, mjcf, procthor, robot, sdf};
use akrobat_model::fixtures::shared_assets;
use akrobat_model::load::AssetSearch;
use akrobat_model::{JointKind, KinematicTree, Pose, urdf};
use nalgebra::{Point3, Vector3};

const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
    f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    path
}

/// A folder with every quirk of the collection: Y-up root, a joint without limits, an endless door, swapped
/// limits, several OBJ files of one part, and a mesh that is missing.
fn partnet_folder(folder: &Path) {
    for name in ["body", "door-1", "door-2", "handle-3", "drawer"] {
        write(folder, &format!("textured_objs/{name}.obj"), CUBE);
    }
    let part = |name: &str, file: &str| {
        format!(
            "<visual name=\"{name}\"><geometry><mesh filename=\"textured_objs/{file}.obj\"/></geometry></visual>"
        )
    };
    let joint = |name: &str, kind: &str, child: &str, limit: &str| {
        format!(
            "<joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"0 0 1\"/><axis xyz=\"0 1 0\"/>{limit}\
             <parent link=\"link_0\"/><child link=\"{child}\"/></joint>"
        )
    };
    let urdf = [
        "<robot name=\"partnet_7\"><link name=\"base\"/><link name=\"link_0\">".to_owned(),
        part("body-0", "body"),
        part("gone-9", "gone"),
        "</link><link name=\"link_1\">".into(),
        part("door-1", "door-1"),
        part("door-2", "door-2"),
        part("handle-3", "handle-3"),
        "</link><link name=\"link_2\">".into(),
        part("drawer-4", "drawer"),
        "</link><link name=\"link_3\">".into(),
        part("drawer-5", "drawer"),
        "</link>".into(),
        "<joint name=\"root\" type=\"fixed\"><origin rpy=\"1.5707963 0 -1.5707963\"/>\
         <parent link=\"base\"/><child link=\"link_0\"/></joint>"
            .into(),
        joint("joint_1", "continuous", "link_1", ""),
        joint("joint_2", "prismatic", "link_2", ""),
        joint("joint_3", "prismatic", "link_3", "<limit lower=\"0.5\" upper=\"0.1\"/>"),
        "</robot>".into(),
    ];
    write(folder, "mobility.urdf", &urdf.concat());
    write(folder, "semantics.txt", "link_1 hinge rotation_door\nlink_2 slider drawer\n");
    write(folder, "meta.json", "{\"model_cat\": \"StorageFurniture\"}");
    write(
        folder,
        "mobility_v2.json",
        "[{\"id\": 1, \"joint\": \"hinge\", \"jointData\": {\"limit\": {\"a\": 90, \"b\": 0, \"noLimit\": false}}}]",
    );
}

#[test]
fn partnet_quirks_are_repaired_and_told() {
    let folder = tempfile::tempdir().unwrap();
    partnet_folder(folder.path());
    let object = partnet::read(folder.path(), None, Size::OfClass).unwrap();
    assert_eq!(object.class, "cabinet");
    let joint = |name: &str| &object.tree.joints()[object.tree.joint_index(name).unwrap()];
    assert_eq!(joint("joint_1").kind, JointKind::Revolute);
    assert!((joint("joint_1").limits[1] - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    assert!(joint("joint_2").limits[1] > 0.0);
    assert!(joint("joint_3").limits[0] < joint("joint_3").limits[1]);
    let door = &object.tree.links()[object.tree.link_index("link_1").unwrap()];
    let names: Vec<&str> = door.visuals.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["door", "handle"]);
    assert_eq!(object.semantics[0].handle_parts, ["handle"]);
    assert_eq!(object.ledger.lost.len(), 1, "{:?}", object.ledger.lost);
    assert!(object.ledger.lost[0].contains("gone.obj"));
    let (low, high) = layout::tree_bounds(&object.tree).unwrap();
    assert!(low.z.abs() < 1e-6 && (high.z - 0.85).abs() < 1e-6, "{low} {high}");
    for word in ["joint_1", "joint_2", "joint_3", "scaled by", "merged"] {
        assert!(
            object.ledger.repairs.iter().any(|r| r.contains(word)),
            "{word}: {:?}",
            object.ledger
        );
    }
    let output = folder.path().join("out");
    let manifest = layout::write_object(&output, &object).unwrap();
    assert_eq!(manifest["lost"].as_array().unwrap().len(), 1);
    let path = output.join(format!("{}.urdf", object.name));
    let (again, _) = urdf::read(&path, &AssetSearch::default()).unwrap();
    same_kinematics(&object.tree, &again);
    let again = layout::tree_bounds(&again).unwrap();
    assert!((again.0 - low).norm() < 1e-5 && (again.1 - high).norm() < 1e-5);
    let error = layout::write_object(&output, &object).unwrap_err().to_string();
    assert!(error.contains("not empty"), "{error}");
}

#[test]
fn a_class_without_a_usual_size_needs_one() {
    let folder = tempfile::tempdir().unwrap();
    partnet_folder(folder.path());
    let error = partnet::read(folder.path(), Some("gizmo"), Size::OfClass).unwrap_err().to_string();
    assert!(error.contains("--height"), "{error}");
    let object = partnet::read(folder.path(), Some("gizmo"), Size::Height(0.4)).unwrap();
    let (low, high) = layout::tree_bounds(&object.tree).unwrap();
    assert!((high.z - low.z - 0.4).abs() < 1e-6);
}

/// Joint positions in the middle of their ranges give the same link poses.
fn same_kinematics(a: &KinematicTree, b: &KinematicTree) {
    let middle = |tree: &KinematicTree| -> Vec<f64> {
        let joints = tree.dof_joints().iter().map(|&j| tree.joints()[j].limits);
        joints.map(|[l, u]| if l.is_finite() { (l + u) / 2.0 } else { 0.7 }).collect()
    };
    let poses = |tree: &KinematicTree| tree.link_poses(&Pose::identity(), &middle(tree));
    for (link, pose) in a.links().iter().zip(poses(a)) {
        let other = poses(b)[b.link_index(&link.name).unwrap()];
        assert!((pose.inverse() * other).translation.vector.norm() < 1e-6, "{}", link.name);
        assert!(pose.rotation.angle_to(&other.rotation) < 1e-6, "{}", link.name);
    }
}

const MJCF: &str = r#"<mujoco model="cabinet">
  <compiler angle="degree" eulerseq="xyz" autolimits="true"/>
  <include file="defaults.xml"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="cabinet" pos="1 2 0.5" euler="0 0 90">
      <geom type="box" size="0.3 0.3 0.5"/>
      <body name="door" pos="0.3 -0.3 0" childclass="panel">
        <joint name="hinge" axis="0 0 1" pos="0 0.02 0" range="-90 0" ref="-10"/>
        <geom size="0.01 0.3 0.5" pos="0 0.3 0"/>
        <geom class="handle" fromto="0.05 0.5 -0.1 0.05 0.5 0.1"/>
      </body>
      <body name="drawer"><joint name="slide" type="slide" axis="2 0 0" range="0 0.3"/>
        <geom class="panel" size="0.2 0.2 0.1"/></body>
    </body>
  </worldbody>
</mujoco>"#;

const MJCF_DEFAULTS: &str = r#"<mujocoinclude><default>
  <default class="panel"><geom type="box" rgba="0.5 0.4 0.3 1"/>
    <default class="handle"><geom type="capsule" size="0.01"/></default></default>
</default></mujocoinclude>"#;

#[test]
fn mjcf_reads_includes_defaults_and_anchored_joints() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "defaults.xml", MJCF_DEFAULTS);
    let path = write(folder.path(), "cabinet.xml", MJCF);
    let (tree, ledger) = mjcf::read_tree(&path).unwrap();
    assert!(ledger.lost.is_empty(), "{ledger:?}");
    let hinge = &tree.joints()[tree.joint_index("hinge").unwrap()];
    assert!((hinge.limits[0] + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    let door = tree.link_index("door").unwrap();
    // Box, and a capsule as a cylinder with two spheres.
    assert_eq!(tree.links()[door].visuals.len(), 4);
    // At qpos = ref the door is where the file puts its body: at (1, 2, 0.5) + Rz(90 deg) (0.3, -0.3, 0).
    let mut q = tree.neutral();
    q[tree.column(tree.joint_index("hinge").unwrap()).unwrap()] = -10f64.to_radians();
    let at_reference = tree.link_poses(&Pose::identity(), &q)[door];
    let expected = Vector3::new(1.3, 2.3, 0.5);
    assert!((at_reference.translation.vector - expected).norm() < 1e-9, "{at_reference}");
    // Turned away from it, the anchor stays and the origin does not.
    q[tree.column(tree.joint_index("hinge").unwrap()).unwrap()] = -60f64.to_radians();
    let turned = tree.link_poses(&Pose::identity(), &q)[door];
    let anchor = Point3::new(0.0, 0.02, 0.0);
    assert!((turned * anchor - at_reference * anchor).norm() < 1e-9);
    assert!((turned.translation.vector - expected).norm() > 1e-3);

    let scene = mjcf::read_scene(&path).unwrap();
    assert_eq!(scene.bodies.len(), 1);
    assert_eq!(scene.objects.len(), 1);
    written(&scene, folder.path());
}

#[test]
fn mjcf_tells_what_it_leaves_out() {
    let folder = tempfile::tempdir().unwrap();
    let text = "<mujoco><worldbody><body name=\"b\"><joint type=\"ball\"/><geom type=\"hfield\"/>\
        <geom size=\"0.1\"/><composite/></body></worldbody></mujoco>";
    let path = write(folder.path(), "b.xml", text);
    let (_, ledger) = mjcf::read_tree(&path).unwrap();
    for word in ["ball", "hfield", "composite"] {
        assert!(ledger.lost.iter().any(|l| l.contains(word)), "{word}: {ledger:?}");
    }
    let path = write(folder.path(), "loop.xml", "<mujoco><include file=\"loop.xml\"/></mujoco>");
    assert!(mjcf::read_tree(&path).unwrap_err().to_string().contains("includes itself"));
}

const HOUSE: &str = r#"{
  "rooms": [{"id": "room|2", "roomType": "Kitchen", "floorPolygon": [
    {"x": 0, "y": 0, "z": 0}, {"x": 0, "y": 0, "z": 4}, {"x": 2, "y": 0, "z": 4},
    {"x": 2, "y": 0, "z": 2}, {"x": 5, "y": 0, "z": 2}, {"x": 5, "y": 0, "z": 0}]}],
  "walls": [
    {"id": "wall|2|0", "polygon": [{"x": 0, "y": 0, "z": 0}, {"x": 5, "y": 0, "z": 0},
      {"x": 0, "y": 2.5, "z": 0}, {"x": 5, "y": 2.5, "z": 0}]},
    {"id": "wall|exterior", "empty": true, "polygon": []}],
  "doors": [{"id": "door|1|2", "wall0": "wall|2|0", "wall1": "wall|exterior",
    "holePolygon": [{"x": 1, "y": 0, "z": 0}, {"x": 2, "y": 2.1, "z": 0}]}],
  "windows": [],
  "objects": [
    {"id": "Fridge|2|1", "assetId": "Fridge_3", "position": {"x": 4, "y": 0.9, "z": 1},
      "rotation": {"x": 0, "y": 90, "z": 0},
      "children": [{"id": "Bowl|surface|1", "assetId": "Bowl_1", "position": {"x": 4, "y": 1.9, "z": 1}}]},
    {"id": "Gadget|1", "assetId": "G", "position": {"x": 1, "y": 1, "z": 1}}]
}"#;

#[test]
fn a_procthor_house_has_walls_with_holes_doors_and_boxes() {
    let folder = tempfile::tempdir().unwrap();
    let house = write(folder.path(), "house.json", HOUSE);
    let database = "{\"Fridge_3\": {\"boundingBox\": {\"x\": 0.8, \"y\": 1.8, \"z\": 0.7}}}";
    let database = write(folder.path(), "assets.json", database);
    let scene = procthor::read(&house, Some(&database)).unwrap();
    let body = |class: &str| scene.bodies.iter().find(|b| b.class == class).unwrap();
    // The floor is L-shaped: 4 x 2 + 3 x 2 square metres.
    let floor = body("floor").visuals[0].triangulate().remove(0);
    let area: f32 = (0..floor.triangles.len())
        .map(|t| {
            let [a, b, c] = floor.corners(t).map(nalgebra::Vector3::from);
            (b - a).cross(&(c - a)).z / 2.0
        })
        .sum();
    assert!((area - 14.0).abs() < 1e-4, "{area}");
    assert_eq!(body("wall").visuals.len(), 3, "left of the door, right of it, above it");
    let fridge = body("refrigerator");
    assert!(
        (fridge.world_from_body.translation.vector - Vector3::new(4.0, 1.0, 0.9)).norm() < 1e-9
    );
    let (low, high) =
        layout::parts_bounds(fridge.visuals.iter().map(|part| (fridge.world_from_body, part)))
            .unwrap();
    assert!((high - low - Vector3::new(0.7, 0.8, 1.8)).norm() < 1e-5, "turned by a quarter");
    let door = &scene.objects[0];
    assert_eq!(door.object.tree.dof(), 1);
    assert!((door.world_from_root.translation.x - 1.005).abs() < 1e-9);
    assert!(scene.ledger.lost.iter().any(|l| l.contains("Gadget")), "{:?}", scene.ledger);
    assert!(scene.ledger.repairs.iter().any(|r| r.contains("Bowl")), "{:?}", scene.ledger);
    written(&scene, folder.path());
}

/// Writes a scene and reads it again: nothing is lost on the way.
fn written(scene: &ImportedScene, folder: &Path) {
    let output = folder.join("written");
    let manifest = layout::write_scene(&output, scene).unwrap();
    assert_eq!(manifest["bodies"].as_array().unwrap().len(), scene.bodies.len());
    let (tree, _) = urdf::read(&output.join("scene.urdf"), &AssetSearch::default()).unwrap();
    assert_eq!(tree.links().len(), scene.bodies.len() + 1);
    for placed in manifest["objects"].as_array().unwrap() {
        let path = output.join(placed["asset"].as_str().unwrap());
        urdf::read(&path, &AssetSearch::default()).unwrap();
    }
}

#[test]
fn sdf_models_keep_their_poses_and_joints() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"<sdf version="1.9"><world name="w"><model name="box"><pose>1 0 0 0 0 0</pose>
        <link name="body"><visual name="v"><geometry><box><size>1 1 1</size></box></geometry></visual></link>
        <link name="lid"><pose>0 0 0.5 0 0 0</pose><collision name="c"><pose>0 0 0.1 0 0 0</pose>
          <geometry><box><size>1 1 0.1</size></box></geometry></collision></link>
        <joint name="hinge" type="revolute"><pose>-0.5 0 0 0 0 0</pose><parent>body</parent><child>lid</child>
          <axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>0</upper></limit></axis></joint></model>
        <model name="rock"><pose>0 3 0 0 0 0</pose><link name="rock"><visual name="v"><geometry>
          <sphere><radius>0.2</radius></sphere></geometry></visual><visual name="h"><geometry><heightmap/></geometry>
          </visual></link></model></world></sdf>"#;
    let path = write(folder.path(), "w.sdf", text);
    let scene = sdf::read_scene(&path, &AssetSearch::default()).unwrap();
    assert_eq!(scene.bodies.len(), 1);
    assert_eq!(scene.bodies[0].world_from_body.translation.y, 3.0);
    let tree = &scene.objects[0].object.tree;
    assert_eq!(tree.dof(), 1);
    let lid = tree.link_index("box_lid").unwrap();
    let closed = tree.link_poses(&Pose::identity(), &[0.0])[lid];
    assert!((closed.translation.vector - Vector3::new(1.0, 0.0, 0.5)).norm() < 1e-9, "{closed}");
    let open = tree.link_poses(&Pose::identity(), &[-1.0])[lid];
    let hinge = Point3::new(-0.5, 0.0, 0.0);
    assert!((open * hinge - closed * hinge).norm() < 1e-9, "turns about the hinge");
    assert!(scene.ledger.lost.iter().any(|l| l.contains("heightmap")), "{:?}", scene.ledger);
    written(&scene, folder.path());
}

#[test]
fn grasps_of_both_formats_become_tool_poses() {
    let folder = tempfile::tempdir().unwrap();
    let json = r#"{"pos_wf": [[1, 2, 3], [0, 0, 1]], "quat_wf": [[0, 0, 0, 1], [1, 0, 0, 0]], "scores": [0.2, 0.9]}"#;
    let path = write(folder.path(), "a.json", json);
    let found = grasps::read(&path, Convention::panda_hand()).unwrap();
    // The better one first; half a turn about x points the hand down.
    let first = found.poses[0].0.translation.vector;
    assert!((first - Vector3::new(0.0, 0.0, 1.0 - 0.1034)).norm() < 1e-9, "{first}");

    let matrix = |scale: f64| -> Vec<u8> {
        let rows =
            [0.0, -1.0, 0.0, 4.0, scale, 0.0, 0.0, 5.0, 0.0, 0.0, 1.0, 6.0, 0.0, 0.0, 0.0, 1.0];
        rows.iter().flat_map(|v| v.to_le_bytes()).collect()
    };
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 4, 4), }\n";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(matrix(1.0));
    bytes.extend(matrix(2.0));
    let path = folder.path().join("b.npy");
    std::fs::write(&path, bytes).unwrap();
    let found = grasps::read(&path, Convention::tool()).unwrap();
    assert_eq!(found.poses.len(), 1);
    assert_eq!(found.ledger.lost, ["grasp 1 is not a pose"]);
    assert_eq!(found.poses[0].0.translation.vector, Vector3::new(4.0, 5.0, 6.0));
    let text = grasps::to_text(&found, "b.npy");
    assert!(
        text.lines().nth(1).unwrap().starts_with("4.000000000 5.000000000 6.000000000"),
        "{text}"
    );
}

#[test]
fn every_shared_object_and_scene_imports() {
    let Some(shared) = shared_assets() else { return };
    let search = AssetSearch { folders: vec![shared.clone()] };
    let objects = shared.join("objects");
    let scratch = tempfile::tempdir().unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(&objects).unwrap().flatten().filter(|e| e.path().is_dir()) {
        let folder = entry.path();
        let below = [folder.clone(), folder.join("urdf")];
        let files = below.iter().filter_map(|f| std::fs::read_dir(f).ok()).flatten().flatten();
        let path = files.map(|e| e.path()).find(|p| p.extension().is_some_and(|e| e == "urdf"));
        let (tree, _) = urdf::read(&path.unwrap(), &search).unwrap();
        let output = scratch.path().join(entry.file_name());
        std::fs::create_dir(&output).unwrap();
        layout::write_tree(&output, "object", &tree).unwrap();
        let (again, _) = urdf::read(&output.join("object.urdf"), &AssetSearch::default()).unwrap();
        same_kinematics(&tree, &again);
        assert!(tree.dof() > 0);
        count += 1;
    }
    assert_eq!(count, 8);

    let kitchen = shared.join("scenes/infinigen_kitchen_1");
    let catalog = Catalog::of_folder(&objects).unwrap();
    let state = kitchen.join("solve_state.json");
    let scene =
        infinigen::read(&kitchen.join("scene.glb"), Some(&state), &catalog, &search).unwrap();
    let mut classes: Vec<&str> = scene.objects.iter().map(|o| o.object.class.as_str()).collect();
    classes.sort_unstable();
    assert_eq!(classes, ["dishwasher", "oven", "refrigerator"], "{:?}", scene.ledger);
    let floor =
        scene.bodies.iter().find(|b| b.name.contains("kitchen") && b.class == "floor").unwrap();
    let parts = floor.visuals.iter().map(|p| (floor.world_from_body, p));
    assert!(layout::parts_bounds(parts).unwrap().1.z.abs() < 1e-5);
    written(&scene, scratch.path());

    let room = shared.join("scenes/drake_living_room/models/furnished_living_room.dmd.yaml");
    let scene = sdf::read_scene(&room, &search).unwrap();
    assert!(scene.ledger.lost.is_empty(), "{:?}", scene.ledger.lost);
    assert_eq!(scene.bodies.len() + scene.objects.len(), 7);
}

#[test]
fn the_shared_robot_is_understood() {
    let Some(shared) = shared_assets() else { return };
    let path = shared.join("robots/summit_xl_franka/summit_xl_franka.urdf");
    let options = robot::RobotOptions::default();
    let imported = robot::read(&path, &[], None, &options, &AssetSearch::default()).unwrap();
    let file = imported.file;
    assert_eq!(file.base.joints.unwrap(), ["base_x", "base_y", "base_z"]);
    assert_eq!(file.arm.joints.len(), 7);
    assert!(file.arm.joints.iter().all(|j| j.starts_with("panda_joint")));
    assert_eq!(file.gripper.tool_link, "panda_hand");
    assert!((file.gripper.open_width_m - 0.08).abs() < 1e-3);
    let [x, y, z, ..] = file.gripper.link_from_tool;
    assert!(x.abs() < 2e-3 && y.abs() < 1e-3 && (z - 0.1034).abs() < 2e-3, "{x} {y} {z}");
}
