//! What can be recorded of every camera.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One kind of image.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Modality {
    /// sRGB colours, u8 `[H, W, 3]`.
    Rgb,
    /// z-depth `[H, W, 1]`; 0 is invalid.
    Depth,
    /// Segment ids, u16 `[H, W, 1]`: one per link and scene body.
    Segmentation,
    /// Instance ids, u16 `[H, W, 1]`: the whole robot, the whole object, every scene body.
    Instance,
    /// Class ids, u16 `[H, W, 1]`.
    Semantic,
    /// Unit surface normals that face the camera, world frame, f32 `[H, W, 3]`; 0 is invalid.
    Normals,
    /// World-frame position of every pixel, metres, f32 `[H, W, 3]`; 0 where nothing is seen.
    Xyz,
    /// Optical flow to the next frame, pixels, f32 `[H, W, 2]`; 0 where nothing is seen.
    Flow,
    /// Motion of every pixel's point to the next frame, metres in the world frame, f32 `[H, W, 3]`.
    SceneFlow,
}

impl Modality {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Rgb,
        Self::Depth,
        Self::Segmentation,
        Self::Instance,
        Self::Semantic,
        Self::Normals,
        Self::Xyz,
        Self::Flow,
        Self::SceneFlow,
    ];

    /// What is recorded where nothing else is asked for.
    pub const DEFAULT: [Self; 3] = [Self::Rgb, Self::Depth, Self::Segmentation];

    /// Name in files and on the command line; datasets are called `<camera>_<name>`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Depth => "depth",
            Self::Segmentation => "segmentation",
            Self::Instance => "instance",
            Self::Semantic => "semantic",
            Self::Normals => "normals",
            Self::Xyz => "xyz",
            Self::Flow => "flow",
            Self::SceneFlow => "scene_flow",
        }
    }

    /// The modality of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|modality| modality.name() == name)
    }

    /// Values per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Normals | Self::Xyz | Self::SceneFlow => 3,
            Self::Flow => 2,
            Self::Depth | Self::Segmentation | Self::Instance | Self::Semantic => 1,
        }
    }
}
