//! A small robot, object and task in a temporary folder, to load whole or broken.

// Every test binary uses a part of this.
#![allow(dead_code)]

use std::path::PathBuf;

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_model::{KinematicTree, ModelError, urdf};

pub const ROBOT_URDF: &str = r#"<robot name="bot">
  <link name="body"><visual><geometry><box size="0.4 0.4 0.2"/></geometry></visual></link>
  <link name="upper"/>
  <link name="hand"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="finger"/>
  <joint name="lift" type="prismatic"><parent link="body"/><child link="upper"/><axis xyz="0 0 1"/>
    <origin xyz="0 0 0.2"/><limit lower="0" upper="0.5" velocity="0.3" effort="10"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="0 1 0"/>
    <origin xyz="0.3 0 0"/><limit lower="-1" upper="1"/></joint>
  <joint name="grip" type="prismatic"><parent link="hand"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04"/></joint>
</robot>"#;

pub const ROBOT_TOML: &str = r#"name = "bot"
urdf = "bot.urdf"
[base]
kind = "holonomic"
[arm]
joints = ["lift", "elbow"]
retract = [0.1, 0.5]
[gripper]
joints = ["grip"]
closed = [0.0]
open = [0.04]
open_width_m = 0.08
finger_links = ["finger"]
tool_link = "hand"
link_from_tool = [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]
"#;

pub const OBJECT_URDF: &str = r#"<robot name="box">
  <link name="case"><visual><geometry><box size="0.4 0.6 0.8"/></geometry></visual></link>
  <link name="door">
    <visual name="panel"><origin xyz="0 0.3 0"/><geometry><box size="0.02 0.6 0.8"/></geometry></visual>
    <visual name="knob"><origin xyz="0.05 0.5 0"/><geometry><box size="0.05 0.05 0.05"/></geometry></visual>
  </link>
  <joint name="door hinge" type="revolute"><parent link="case"/><child link="door"/><axis xyz="0 0 1"/>
    <origin xyz="0.21 -0.3 0"/><limit lower="0" upper="1.57"/></joint>
</robot>"#;

pub const TASK_TOML: &str = r#"name = "open the box"
[robot]
file = "bot.toml"
[object]
urdf = "box.urdf"
pose = [1.0, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0]
joint = "door hinge"
[object.handle]
link = "door"
parts = ["knob"]
[scene]
room = [6.0, 6.0, 3.0]
[[scene.box]]
name = "fridge"
size = [0.8, 0.6, 1.6]
pose = [2.0, 1.0, 0.8, 1.0, 0.0, 0.0, 0.0]
[goal]
positions = [1.0, 1.5]
"#;

/// A folder with the files of one task.
pub struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    /// The whole, valid set.
    pub fn new() -> Self {
        let files = Self { folder: tempfile::tempdir().unwrap() };
        files.write("bot.urdf", ROBOT_URDF);
        files.write("bot.toml", ROBOT_TOML);
        files.write("box.urdf", OBJECT_URDF);
        files.write("task.toml", TASK_TOML);
        files
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), content).unwrap();
    }

    /// Replaces text in a file; the text must be there.
    pub fn edit(&self, name: &str, from: &str, to: &str) {
        let text = std::fs::read_to_string(self.path(name)).unwrap();
        assert!(text.contains(from), "{name} has no \"{from}\"");
        self.write(name, text.replacen(from, to, 1));
    }

    pub fn task(&self) -> Result<Task, ModelError> {
        load::task(&self.path("task.toml"), &AssetSearch::default())
    }

    pub fn urdf(&self, name: &str) -> Result<(KinematicTree, Vec<String>), ModelError> {
        urdf::read(&self.path(name), &AssetSearch::default())
    }
}
