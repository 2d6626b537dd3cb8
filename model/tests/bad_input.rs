//! Bad input is refused with a message that names the file and what would have been valid.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

mod common;

use akrobat_model::{ModelError, mesh_io};
use common::Files;

/// Asserts that the result is an error whose message holds all of `expected`.
fn refused<T>(result: Result<T, ModelError>, expected: &[&str]) {
    let Err(error) = result else { panic!("accepted; expected an error with {expected:?}") };
    let message = error.to_string();
    for part in expected {
        assert!(message.contains(part), "\"{message}\" does not say \"{part}\"");
    }
}

/// The object's URDF with one edit.
fn bad_urdf(from: &str, to: &str, expected: &[&str]) {
    let files = Files::new();
    files.edit("box.urdf", from, to);
    refused(files.urdf("box.urdf"), &[&["box.urdf"], expected].concat());
}

fn bad_file(name: &str, from: &str, to: &str, expected: &[&str]) {
    let files = Files::new();
    files.edit(name, from, to);
    refused(files.task(), &[&[name], expected].concat());
}

fn bad_mesh(name: &str, content: impl AsRef<[u8]>, expected: &[&str]) {
    let files = Files::new();
    files.write(name, content);
    refused(mesh_io::load(&files.path(name)), &[&[name], expected].concat());
}

#[test]
fn the_unedited_files_are_accepted() {
    let task = Files::new().task().unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(
        task.robot.trajectory_joint_names(),
        ["base_x", "base_y", "base_theta", "lift", "elbow", "grip"]
    );
    assert_eq!(task.object.tree.links()[task.object.handle_link].name, "door");
    assert_eq!(task.scene.bodies.len(), 6);
}

#[test]
fn missing_files() {
    let files = Files::new();
    refused(files.urdf("absent.urdf"), &["absent.urdf", "cannot read"]);
    bad_file("task.toml", "bot.toml", "gone.toml", &["gone.toml\" not found", "tried"]);
    bad_file("bot.toml", "bot.urdf", "gone.urdf", &["gone.urdf\" not found", "tried"]);
}

#[test]
fn missing_mesh() {
    let mesh = r#"<mesh filename="package://pack/door.obj"/>"#;
    bad_urdf(
        r#"<box size="0.02 0.6 0.8"/>"#,
        mesh,
        &["line 4", "link \"door\"", "package://pack/door.obj", "tried", "door.obj"],
    );
}

#[test]
fn broken_mesh_names_link_and_urdf() {
    let files = Files::new();
    files.write("door.obj", "v 0 0 0\nf 1 2 3\n");
    files.edit("box.urdf", r#"<box size="0.02 0.6 0.8"/>"#, r#"<mesh filename="door.obj"/>"#);
    refused(files.urdf("box.urdf"), &["door.obj", "line 2", "link \"door\"", "box.urdf"]);
}

#[test]
fn cyclic_urdf() {
    bad_urdf(
        "</robot>",
        r#"<joint name="back" type="fixed"><parent link="door"/><child link="case"/></joint></robot>"#,
        &["cycle"],
    );
}

#[test]
fn two_parents() {
    bad_urdf(
        "</robot>",
        r#"<joint name="two" type="fixed"><parent link="case"/><child link="door"/></joint></robot>"#,
        &["two parent joints", "door hinge"],
    );
}

#[test]
fn disconnected_urdf() {
    bad_urdf("</robot>", r#"<link name="stray"/></robot>"#, &["disconnected", "stray", "case"]);
}

#[test]
fn repeated_name() {
    bad_urdf("</robot>", r#"<link name="door"/></robot>"#, &["\"door\" is used twice"]);
}

#[test]
fn zero_axis() {
    bad_urdf(
        "<axis xyz=\"0 0 1\"/>",
        "<axis xyz=\"0 0 0\"/>",
        &["line 7", "door hinge", "no direction"],
    );
}

#[test]
fn nan_axis() {
    bad_urdf(
        "<axis xyz=\"0 0 1\"/>",
        "<axis xyz=\"0 nan 1\"/>",
        &["line 7", "3 finite numbers", "nan"],
    );
}

#[test]
fn nan_origin() {
    bad_urdf("xyz=\"0.21 -0.3 0\"", "xyz=\"0.21 inf 0\"", &["line 8", "finite", "inf"]);
}

#[test]
fn inverted_limits() {
    bad_urdf(
        "lower=\"0\" upper=\"1.57\"",
        "lower=\"1.57\" upper=\"0\"",
        &["line 8", "inverted limits", "1.57"],
    );
}

#[test]
fn absent_limits() {
    bad_urdf(
        "<limit lower=\"0\" upper=\"1.57\"/>",
        "",
        &["door hinge", "lacks <limit", "continuous"],
    );
}

#[test]
fn unknown_joint_kind() {
    bad_urdf(
        "type=\"revolute\"",
        "type=\"floating\"",
        &["floating", "revolute, continuous, prismatic, fixed"],
    );
}

#[test]
fn unknown_shape() {
    bad_urdf(
        "<box size=\"0.4 0.6 0.8\"/>",
        "<cone/>",
        &["line 2", "cone", "box, cylinder, sphere, mesh"],
    );
}

#[test]
fn unknown_parent_link() {
    bad_urdf(
        "<parent link=\"case\"/>",
        "<parent link=\"crate\"/>",
        &["line 7", "door hinge", "unknown link \"crate\"", "case, door"],
    );
}

#[test]
fn mimic_of_nothing_and_of_itself() {
    bad_urdf(
        "</joint>",
        "<mimic joint=\"ghost\"/></joint>",
        &["unknown joint \"ghost\"", "door hinge"],
    );
    bad_urdf("</joint>", "<mimic joint=\"door hinge\"/></joint>", &["door hinge", "mimics itself"]);
}

#[test]
fn absurd_scales() {
    let with_scale = |scale: &str, expected: &[&str]| {
        let files = Files::new();
        files.write("door.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
        let mesh = format!(r#"<mesh filename="door.obj" scale="{scale}"/>"#);
        files.edit("box.urdf", r#"<box size="0.02 0.6 0.8"/>"#, &mesh);
        match expected {
            [] => drop(files.urdf("box.urdf").unwrap()),
            _ => refused(files.urdf("box.urdf"), &[&["box.urdf", "line 4"], expected].concat()),
        }
    };
    with_scale("0 1 1", &["must not be zero"]);
    with_scale("nan 1 1", &["3 finite numbers"]);
    with_scale("1e6 1e6 1e6", &["door.obj", "1000 m", "scale"]);
    with_scale("1e-7 1e-7 1e-7", &["door.obj", "1e-5", "scale"]);
    with_scale("1 1", &["3 finite numbers"]);
    with_scale("-1 1 1", &[]);
    with_scale("0.5", &[]);
}

#[test]
fn flat_and_negative_primitives() {
    bad_urdf("0.4 0.6 0.8", "0.4 0 0.8", &["line 2", "above 0"]);
    bad_urdf("<box size=\"0.4 0.6 0.8\"/>", "<sphere radius=\"-1\"/>", &["line 2", "above 0"]);
    bad_urdf("<box size=\"0.4 0.6 0.8\"/>", "<sphere/>", &["line 2", "radius"]);
}

#[test]
fn malformed_xml() {
    bad_urdf("</link>", "</lnk>", &["line 2", "malformed XML"]);
    let files = Files::new();
    files.write("box.urdf", "<sdf/>");
    refused(files.urdf("box.urdf"), &["box.urdf", "<robot>", "<sdf>"]);
}

#[test]
fn negative_mass() {
    bad_urdf(
        "<link name=\"case\">",
        "<link name=\"case\"><inertial><mass value=\"-1\"/></inertial>",
        &["line 2", "at least 0 kg"],
    );
}

#[test]
fn malformed_toml_and_unknown_keys() {
    bad_file("task.toml", "name = \"open the box\"", "name = ", &["line 1"]);
    bad_file(
        "task.toml",
        "positions",
        "postions",
        &["unknown field `postions`", "`start`", "`positions`"],
    );
    bad_file("bot.toml", "retract", "rest", &["unknown field `rest`", "`joints`", "`retract`"]);
    bad_file(
        "bot.toml",
        "holonomic",
        "flying",
        &["flying", "`holonomic`", "`fixed`", "`differential`"],
    );
}

#[test]
fn unknown_object_names() {
    bad_file(
        "task.toml",
        "joint = \"door hinge\"",
        "joint = \"hinge\"",
        &["object.joint", "unknown joint \"hinge\"", "door hinge"],
    );
    bad_file(
        "task.toml",
        "link = \"door\"",
        "link = \"dor\"",
        &["object.handle.link", "unknown link \"dor\"", "case, door"],
    );
    bad_file(
        "task.toml",
        "link = \"door\"",
        "link = \"case\"",
        &["object.handle.link", "moved by joint", "door"],
    );
    bad_file(
        "task.toml",
        "parts = [\"knob\"]",
        "parts = [\"handle*\"]",
        &["unknown part \"handle*\"", "panel, knob"],
    );
}

#[test]
fn unknown_robot_names() {
    bad_file(
        "bot.toml",
        "\"lift\", \"elbow\"",
        "\"lift\", \"wrist\"",
        &["arm.joints", "unknown joint \"wrist\"", "elbow"],
    );
    bad_file(
        "bot.toml",
        "\"lift\", \"elbow\"",
        "\"elbow\", \"lift\"",
        &["arm.joints", "out of order"],
    );
    bad_file(
        "bot.toml",
        "\"lift\", \"elbow\"",
        "\"lift\", \"grip\"",
        &["arm.joints", "not on the chain", "lift, elbow"],
    );
    bad_file(
        "bot.toml",
        "tool_link = \"hand\"",
        "tool_link = \"palm\"",
        &["gripper.tool_link", "unknown link \"palm\"", "hand"],
    );
    bad_file(
        "bot.toml",
        "[\"finger\"]",
        "[\"thumb\"]",
        &["gripper.finger_links", "unknown link \"thumb\"", "finger"],
    );
}

#[test]
fn robot_values_out_of_range() {
    bad_file("bot.toml", "[0.1, 0.5]", "[0.1, 5.0]", &["arm.retract", "elbow", "-1 to 1"]);
    bad_file("bot.toml", "[0.1, 0.5]", "[0.1]", &["arm.retract", "expected 2 values"]);
    bad_file(
        "bot.toml",
        "open = [0.04]",
        "open = [0.04, 0.04]",
        &["gripper.open", "expected 1 values", "got 2"],
    );
    bad_file(
        "bot.toml",
        "open_width_m = 0.08",
        "open_width_m = -0.08",
        &["gripper.open_width_m", "above 0"],
    );
    bad_file(
        "bot.toml",
        "0.1, 1.0, 0.0, 0.0, 0.0]",
        "0.1, 0.0, 0.0, 0.0, 0.0]",
        &["gripper.link_from_tool", "quaternion"],
    );
    bad_file(
        "bot.toml",
        "[arm]",
        "joints = [\"lift\", \"elbow\", \"grip\"]\n[arm]",
        &["base.joints", "elbow", "prismatic"],
    );
}

#[test]
fn goals_out_of_limits() {
    bad_file(
        "task.toml",
        "[1.0, 1.5]",
        "[1.0, 2.5]",
        &["goal.positions", "2.5", "door hinge", "0 to 1.57"],
    );
    bad_file("task.toml", "[1.0, 1.5]", "[]", &["goal.positions", "at least one"]);
    bad_file("task.toml", "[1.0, 1.5]", "[nan]", &["goal.positions", "NaN"]);
    bad_file("task.toml", "[goal]", "[goal]\nstart = -0.5", &["goal.start", "-0.5", "0 to 1.57"]);
}

#[test]
fn placing() {
    let replaces = "replaces = { body = \"fridge\", yaw = 0.0 }\njoint";
    bad_file("task.toml", "joint", replaces, &["exactly one of", "both"]);
    bad_file("task.toml", "pose = [1.0", "scale = 2.0 #", &["exactly one of", "neither"]);
    bad_file("task.toml", "[1.0, 0.0, 0.4, 1.0,", "[1.0, 0.0, 0.4, 0.0,", &["object.pose"]);
    bad_file("task.toml", "joint", "scale = 0.0\njoint", &["object.scale", "from 0.0001 to 10000"]);
    let pose = "pose = [1.0, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0]";
    bad_file(
        "task.toml",
        pose,
        "replaces = { body = \"oven*\", yaw = 0.0 }",
        &["unknown body \"oven*\"", "fridge"],
    );
    bad_file(
        "task.toml",
        pose,
        "replaces = { body = \"wall*\", yaw = 0.0 }",
        &["matches 4 bodies", "wall_x_min"],
    );
    bad_file(
        "task.toml",
        "file = \"bot.toml\"",
        "file = \"bot.toml\"\npose = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]",
        &["robot.pose", "fixed base"],
    );
    for (limits, expected) in [
        ("juggle = [0.0, 1.0]", ["unknown", "juggle"]),
        ("grip = [0.0, 0.02]", ["unknown planned joint \"grip\"", "elbow"]),
        ("elbow = [0.4, 1.5]", ["within [-1, 1]", "[0.4, 1.5]"]),
        ("elbow = [0.6, 0.9]", ["rest position 0.5", "[0.6, 0.9]"]),
        ("elbow = [0.9, 0.4]", ["elbow", "[0.9, 0.4]"]),
    ] {
        let robot = format!("file = \"bot.toml\"\nlimits = {{ {limits} }}");
        bad_file(
            "task.toml",
            "file = \"bot.toml\"",
            &robot,
            &["robot.limits", expected[0], expected[1]],
        );
    }
}

#[test]
fn scenes() {
    bad_file("task.toml", "room = ", "remove = [\"oven*\"]\nroom = ", &["scene.remove", "oven*"]);
    bad_file("task.toml", "[6.0, 6.0, 3.0]", "[6.0, 0.0, 3.0]", &["scene.room", "above 0"]);
    bad_file("task.toml", "\"fridge\"", "\"floor\"", &["already a body named \"floor\""]);
    let files = Files::new();
    files.write("scene.ply", "ply");
    files.edit("task.toml", "room = ", "file = \"scene.ply\"\nroom = ");
    refused(files.task(), &["scene.ply", "gltf, glb, urdf, obj, stl, dae"]);
}

#[test]
fn grasp_files() {
    let with_grasps = |content: &[u8], expected: &[&str]| {
        let files = Files::new();
        files.write("grasps.npy", content);
        files.edit("task.toml", "[goal]", "[grasps]\nfile = \"grasps.npy\"\n[goal]");
        refused(files.task(), &[&["grasps.npy"], expected].concat());
    };
    with_grasps(b"1 2 3\n", &["line 1", "7 numbers"]);
    with_grasps(b"0 0 0 0 0 0 0\n", &["row 1", "qw"]);
    with_grasps(b"", &["no grasps"]);
    with_grasps(b"\x93NUMPY\x01\x00", &["truncated"]);
}

#[test]
fn obj_files() {
    bad_mesh("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", &["line 4", "index 4", "3 defined"]);
    bad_mesh("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", &["line 4", "index 0"]);
    bad_mesh("a.obj", "v 0 nan 0\n", &["line 1", "finite"]);
    bad_mesh("a.obj", "v 0 0\n", &["line 1", "3 numbers"]);
    bad_mesh("a.obj", "v 0 0 0\n", &["no triangles"]);
    bad_mesh("a.ply", "ply", &["unknown mesh format \"ply\"", "obj, stl, dae, gltf, glb"]);
}

#[test]
fn stl_files() {
    let mut stl = vec![0u8; 84];
    stl[80] = 2;
    stl.extend([0u8; 50]);
    bad_mesh("a.stl", &stl, &["truncated", "184 bytes", "134"]);
    bad_mesh("a.stl", [0u8; 10], &["truncated", "84 bytes"]);
    bad_mesh("a.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", &["truncated"]);
    bad_mesh("a.stl", "solid a\nfacet normal 0 0 1\nvertex 0 x 0\nendsolid", &["line 3", "vertex"]);
    let mut stl = vec![0u8; 134];
    stl[80] = 1;
    stl[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    bad_mesh("a.stl", &stl, &["not finite"]);
}

#[test]
fn dae_files() {
    bad_mesh("a.dae", "<COLLADA>", &["malformed XML"]);
    bad_mesh("a.dae", "<robot/>", &["<COLLADA>", "<robot>"]);
    let geometry = |p: &str| {
        format!(
            r##"<COLLADA><library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="9">0 0 0 1 0 0 0 1 0</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>{p}</p></triangles>
</mesh></geometry></library_geometries></COLLADA>"##
        )
    };
    bad_mesh("a.dae", geometry("0 1 7"), &["line 4", "position index 7", "0..3"]);
    bad_mesh("a.dae", geometry("0 1"), &["line 4", "multiple of 3"]);
    bad_mesh("a.dae", geometry("0 1 a"), &["line 4", "not a number"]);
    bad_mesh("a.dae", geometry("0 1 2").replace("#v", "#w"), &["#w", "refers to nothing"]);
    let files = Files::new();
    files.write("a.dae", geometry("0 1 2"));
    assert_eq!(mesh_io::load(&files.path("a.dae")).unwrap()[0].triangles.len(), 1);
}

/// A GLB of one triangle, with the given index bytes and a cut at the end.
fn glb(indices: [u16; 3], cut: usize) -> Vec<u8> {
    glb_of(indices, 3, cut)
}

/// As [`glb`], with the number of vertices that the file claims to have.
fn glb_of(indices: [u16; 3], vertices: usize, cut: usize) -> Vec<u8> {
    let mut binary = Vec::new();
    for v in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        binary.extend(v.to_le_bytes());
    }
    indices.iter().for_each(|i| binary.extend(i.to_le_bytes()));
    binary.extend([0, 0]);
    let mut json = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"scene":0,"nodes":[{"mesh":0,"name":"tri"}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],"buffers":[{"byteLength":44}],
"bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]},
{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}]}"#
        .replacen("\"count\":3", &format!("\"count\":{vertices}"), 1)
        .into_bytes();
    while !json.len().is_multiple_of(4) {
        json.push(b' ');
    }
    let mut bytes = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + binary.len();
    bytes.extend(2u32.to_le_bytes());
    bytes.extend((total as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(&json);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(&binary);
    bytes.truncate(total - cut);
    bytes
}

#[test]
fn gltf_files() {
    let files = Files::new();
    files.write("a.glb", glb([0, 1, 2], 0));
    // Y up becomes Z up: (0, 1, 0) is turned to (0, 0, 1).
    let meshes = mesh_io::load(&files.path("a.glb")).unwrap();
    let top = meshes[0].positions[2];
    assert!((top[2] - 1.0).abs() < 1e-6 && top[1].abs() < 1e-6, "{top:?}");

    bad_mesh("a.glb", glb([0, 1, 9], 0), &["index 9", "0..3"]);
    bad_mesh("a.glb", glb([0, 1, 2], 20), &["whole glTF"]);
    bad_mesh("a.glb", glb([0, 1, 2], 100), &["whole glTF"]);
    bad_mesh("a.glb", b"glTF", &["whole glTF"]);
    bad_mesh("a.glb", glb_of([0, 1, 2], 9, 0), &["truncated", "9 elements"]);
}

#[test]
fn absurd_joint_origins() {
    bad_urdf(
        "xyz=\"0.21 -0.3 0\"",
        "xyz=\"21000 -300 0\"",
        &["link \"door\"", "away from the root", "1000 m"],
    );
}

#[test]
fn attached_grippers() {
    let attach = |link: &str, urdf: &str, expected: &[&str]| {
        let files = Files::new();
        files.write("palm.urdf", urdf);
        let robot = std::fs::read_to_string(files.path("bot.toml")).unwrap();
        let section = format!(
            "[gripper.attach]\nurdf = \"palm.urdf\"\nlink = \"{link}\"\nlink_from_gripper = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]\n"
        );
        files.write("bot.toml", robot + &section);
        match expected {
            [] => assert!(files.task().unwrap().robot.tree.link_index("palm").is_ok()),
            _ => refused(files.task(), &[&["bot.toml", "gripper.attach"], expected].concat()),
        }
    };
    let palm = r#"<robot name="palm"><link name="palm"/></robot>"#;
    attach("hand", palm, &[]);
    attach("wrist", palm, &["unknown link \"wrist\"", "hand"]);
    attach(
        "hand",
        &palm.replace("link name=\"palm", "link name=\"hand"),
        &["\"hand\" is used twice"],
    );
}
