//! What cameras yield for one frame.

use akrobat_model::Phase;
use akrobat_model::Pose;

use crate::{CameraModel, Distortion, Intrinsics};

/// One camera's images at one frame. Images that were not asked for are empty.
#[derive(Debug, Clone)]
pub struct CameraFrame {
    /// Camera name, from the rig.
    pub name: String,
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// The lens.
    pub distortion: Distortion,
    /// Pose of the camera (x right, y down, z forward).
    pub world_from_camera: Pose,
    /// Frame at which the images were taken: an earlier one than the observation's for cameras that are
    /// slower than the episode.
    pub captured_frame: u32,
    /// sRGB colours `[height, width, 3]`.
    pub rgb: Vec<u8>,
    /// z-depth in metres `[height, width]`; 0 where nothing is seen between near and far.
    pub depth_m: Vec<f32>,
    /// Segment ids `[height, width]`; 0 is background. See [`SegmentLabel`].
    pub segmentation: Vec<u16>,
    /// Instance ids `[height, width]`; 0 is background. See [`SegmentTable`].
    pub instance: Vec<u16>,
    /// Class ids `[height, width]`; 0 is background. See [`SegmentTable`].
    pub semantic: Vec<u16>,
    /// Unit normals that face the camera, world frame `[height, width]`; 0 where nothing is seen.
    pub normals: Vec<[f32; 3]>,
    /// World-frame positions, metres `[height, width]`; 0 where nothing is seen.
    pub xyz: Vec<[f32; 3]>,
    /// Where each pixel's point moves in the image until the next frame, pixels `[height, width]`.
    pub flow: Vec<[f32; 2]>,
    /// Where it moves in the world until the next frame, metres `[height, width]`.
    pub scene_flow: Vec<[f32; 3]>,
}

impl CameraFrame {
    /// A pinhole camera without images.
    pub fn new(name: impl Into<String>, intrinsics: Intrinsics, world_from_camera: Pose) -> Self {
        Self {
            name: name.into(),
            intrinsics,
            distortion: Distortion::Pinhole,
            world_from_camera,
            captured_frame: 0,
            rgb: Vec::new(),
            depth_m: Vec::new(),
            segmentation: Vec::new(),
            instance: Vec::new(),
            semantic: Vec::new(),
            normals: Vec::new(),
            xyz: Vec::new(),
            flow: Vec::new(),
            scene_flow: Vec::new(),
        }
    }

    /// Its projection.
    pub fn model(&self) -> CameraModel {
        CameraModel { intrinsics: self.intrinsics, distortion: self.distortion }
    }
}

/// What a segment id stands for: one robot link, object link or scene body.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SegmentLabel {
    /// Id in the segmentation images, from 1.
    pub id: u16,
    /// `robot`, `object` or `scene`.
    pub group: String,
    /// Link's or body's name.
    pub name: String,
    /// Semantic class.
    pub class: String,
}

/// Which instance and which class every segment belongs to.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SegmentTable {
    /// Names of the instances; ids count from 1 in this order.
    pub instances: Vec<String>,
    /// Names of the classes; ids count from 1 in this order.
    pub classes: Vec<String>,
    /// Instance and class by segment id; ids that no label has are background.
    of_segment: Vec<[u16; 2]>,
}

impl SegmentTable {
    /// The robot is one instance, the object is one, and so is every scene body.
    pub fn new(labels: &[SegmentLabel]) -> Self {
        let mut table = Self::default();
        for label in labels {
            let instance = match label.group.as_str() {
                group @ ("robot" | "object") => group,
                _ => label.name.as_str(),
            };
            let ids =
                [number(&mut table.instances, instance), number(&mut table.classes, &label.class)];
            let place = usize::from(label.id);
            if table.of_segment.len() <= place {
                table.of_segment.resize(place + 1, [0; 2]);
            }
            table.of_segment[place] = ids;
        }
        table
    }

    /// Instance of a segment; 0 for the background.
    pub fn instance(&self, segment: u16) -> u16 {
        self.of_segment.get(usize::from(segment)).map_or(0, |ids| ids[0])
    }

    /// Class of a segment; 0 for the background.
    pub fn class(&self, segment: u16) -> u16 {
        self.of_segment.get(usize::from(segment)).map_or(0, |ids| ids[1])
    }
}

/// Place of a name, from 1; new names are appended. There are no more names than segment ids.
fn number(names: &mut Vec<String>, name: &str) -> u16 {
    let place = names.iter().position(|known| known == name).unwrap_or_else(|| {
        names.push(name.to_owned());
        names.len() - 1
    });
    (place + 1) as u16
}

/// A point of a fused cloud: position in metres and sRGB colour in 0..255, as f32 `[x y z r g b]`.
pub type CloudPoint = [f32; 6];

/// Everything seen at one frame.
#[derive(Debug, Clone)]
pub struct Observation {
    /// Frame number within the episode, from 0.
    pub frame: u32,
    /// Time on the trajectory's dense path, seconds.
    pub time_s: f64,
    /// Phase of the trajectory.
    pub phase: Phase,
    /// Images, in the rig's order.
    pub cameras: Vec<CameraFrame>,
    /// Fused cloud; always the configured number of points, or empty where none is asked for.
    pub cloud: Vec<CloudPoint>,
    /// Unit normals of the cloud's points, in its frame; empty where not asked for.
    pub cloud_normals: Vec<[f32; 3]>,
    /// Robot joint positions in the trajectory's columns (rad, m).
    pub robot: Vec<f64>,
    /// Positions of all object joints (rad, m).
    pub object: Vec<f64>,
    /// Pose of the tool frame.
    pub world_from_tool: Pose,
    /// Pose of the robot's base link: the child of the yaw joint, or the root of a fixed-base robot.
    pub world_from_base: Pose,
    /// Pose of the object's root.
    pub world_from_object: Pose,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_of_the_robot_are_one_instance() {
        let label = |id, group: &str, name: &str, class: &str| SegmentLabel {
            id,
            group: group.into(),
            name: name.into(),
            class: class.into(),
        };
        let table = SegmentTable::new(&[
            label(1, "robot", "arm", "robot"),
            label(2, "robot", "hand", "robot"),
            label(4, "scene", "chair 1", "chair"),
            label(5, "scene", "chair 2", "chair"),
        ]);
        assert_eq!([1, 2, 3, 4, 5].map(|id| table.instance(id)), [1, 1, 0, 2, 3]);
        assert_eq!([0, 1, 2, 4, 5, 9].map(|id| table.class(id)), [0, 1, 1, 2, 2, 0]);
        assert_eq!(table.instances, ["robot", "chair 1", "chair 2"]);
    }
}
