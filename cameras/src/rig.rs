//! Rigs: which cameras there are and where they are mounted.

use std::path::Path;

use akrobat_model::pose::from_xyz_wxyz;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Intrinsics, RigError, intrinsics::ISAAC_HORIZONTAL_APERTURE_MM};

/// A set of cameras (TOML).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Name for reports and manifests.
    pub name: String,
    /// The cameras, in the order of the outputs.
    pub cameras: Vec<CameraSpec>,
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Name in the outputs (`ego_topdown`, `ego_wrist`, `fixed`, …): letters, digits and `_`.
    pub name: String,
    /// Image width, pixels.
    #[serde(default = "default_width")]
    pub width: u32,
    /// Image height, pixels.
    #[serde(default = "default_height")]
    pub height: u32,
    /// Focal length over a 20.955 mm horizontal aperture, millimetres.
    pub focal_mm: f64,
    /// Nearest depth seen, metres.
    #[serde(default = "default_near")]
    pub near_m: f64,
    /// Farthest depth seen, metres.
    #[serde(default = "default_far")]
    pub far_m: f64,
    /// Where the camera is.
    pub mount: CameraMount,
}

fn default_width() -> u32 {
    320
}
fn default_height() -> u32 {
    240
}
fn default_near() -> f64 {
    0.01
}
fn default_far() -> f64 {
    20.0
}

/// Where a camera is mounted. Poses are of the OpenCV camera frame (x right, y down, z forward).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "on")]
pub enum CameraMount {
    /// Rigidly on a robot link.
    Link {
        /// Link name; `tool`, `base` and `mount` stand for the tool frame, the base link and the link
        /// that carries the first arm joint.
        link: String,
        /// Camera pose in that frame, `[x y z qw qx qy qz]`.
        link_from_camera: [f64; 7],
    },
    /// On a robot link, turned at every frame so that it looks at the tool, its image upright: a camera
    /// on a pan-tilt head.
    LookAtTool {
        /// Link name or alias, as for a rigid mount.
        link: String,
        /// Camera position in that link's frame, metres.
        position: [f64; 3],
    },
    /// At rest in the world.
    World {
        /// Camera pose, `[x y z qw qx qy qz]`.
        world_from_camera: [f64; 7],
    },
    /// At rest in the world, looking at the middle of the way that the object's handle takes. The position is
    /// given in a frame there whose z axis points up and whose x axis points horizontally out of the object,
    /// against the direction in which the handle is approached. Where the line of sight is blocked or the
    /// place is inside something, the nearest of several places around it serves (to the other side,
    /// nearer, higher).
    LookAtHandle {
        /// Camera position relative to the middle of the handle's way, metres.
        offset: [f64; 3],
    },
}

/// Names that a link mount may use besides the robot's own links.
pub const LINK_ALIASES: [&str; 3] = ["tool", "base", "mount"];

/// Largest image edge that a rig may ask for, pixels.
pub const LARGEST_EDGE: u32 = 4096;

/// Built-in rigs by name, as TOML.
const PRESETS: [(&str, &str); 1] = [("paper", include_str!("../presets/paper.toml"))];

impl Rig {
    /// Reads and checks a rig file.
    ///
    /// # Errors
    /// Any [`RigError`] but those about names of presets and links.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| RigError::Read { path: path.to_path_buf(), source })?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Parses and checks a rig; `context` names the text in errors.
    ///
    /// # Errors
    /// [`RigError::Syntax`] and [`RigError::BadValue`].
    pub fn from_toml(text: &str, context: &str) -> Result<Self, RigError> {
        let rig: Self = toml::from_str(text).map_err(|error| RigError::Syntax {
            context: context.to_owned(),
            message: error.to_string(),
        })?;
        rig.validate(context)?;
        Ok(rig)
    }

    /// A built-in rig: `paper` has a top-down, a wrist and a fixed camera.
    ///
    /// # Errors
    /// [`RigError::UnknownPreset`], which lists the presets.
    pub fn preset(name: &str) -> Result<Self, RigError> {
        match PRESETS.iter().find(|(preset, _)| *preset == name) {
            Some((_, text)) => Self::from_toml(text, name),
            None => Err(RigError::UnknownPreset {
                name: name.to_owned(),
                choices: Self::preset_names().map(str::to_owned).collect(),
            }),
        }
    }

    /// Names of the built-in rigs.
    pub fn preset_names() -> impl Iterator<Item = &'static str> {
        PRESETS.iter().map(|(name, _)| *name)
    }

    /// Checks all values; `context` names the rig in errors.
    ///
    /// # Errors
    /// [`RigError::BadValue`] at the first value out of its range.
    pub fn validate(&self, context: &str) -> Result<(), RigError> {
        let fail = |camera: &str, message: String| {
            Err(RigError::BadValue {
                context: context.to_owned(),
                camera: camera.to_owned(),
                message,
            })
        };
        if self.cameras.is_empty() {
            return fail("", "a rig needs at least one camera".into());
        }
        for (index, camera) in self.cameras.iter().enumerate() {
            if self.cameras[..index].iter().any(|other| other.name == camera.name) {
                return fail(&camera.name, "the name is used twice".into());
            }
            if let Err(message) = camera.check() {
                return fail(&camera.name, message);
            }
        }
        Ok(())
    }

    /// Checks that every link mount names one of `links` or an alias.
    ///
    /// # Errors
    /// [`RigError::UnknownLink`], which lists the aliases and links.
    pub fn validate_links<'a>(
        &self,
        links: impl Iterator<Item = &'a str> + Clone,
    ) -> Result<(), RigError> {
        for camera in &self.cameras {
            let (CameraMount::Link { link, .. } | CameraMount::LookAtTool { link, .. }) =
                &camera.mount
            else {
                continue;
            };
            let mut valid = LINK_ALIASES.into_iter().chain(links.clone());
            if !valid.any(|name| name == link) {
                return Err(RigError::UnknownLink {
                    rig: self.name.clone(),
                    camera: camera.name.clone(),
                    link: link.clone(),
                    choices: LINK_ALIASES.into_iter().chain(links).map(str::to_owned).collect(),
                });
            }
        }
        Ok(())
    }
}

impl CameraSpec {
    /// Square pixels and a centred principal point.
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics::from_focal_length(
            self.width,
            self.height,
            self.focal_mm,
            ISAAC_HORIZONTAL_APERTURE_MM,
        )
    }

    fn check(&self) -> Result<(), String> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if self.name.is_empty() || !self.name.chars().all(is_plain) {
            return Err("a camera's name consists of letters, digits and `_`".into());
        }
        for (what, edge) in [("width", self.width), ("height", self.height)] {
            if !(1..=LARGEST_EDGE).contains(&edge) {
                return Err(format!("{what} must be 1 to {LARGEST_EDGE} pixels, got {edge}"));
            }
        }
        if !(self.focal_mm.is_finite() && self.focal_mm > 0.0) {
            return Err(format!("focal_mm must be above 0, got {}", self.focal_mm));
        }
        let (near, far) = (self.near_m, self.far_m);
        if !(near > 0.0 && near < far && far.is_finite()) {
            return Err(format!("expected 0 < near_m < far_m, got near_m {near} and far_m {far}"));
        }
        match &self.mount {
            CameraMount::Link { link_from_camera: pose, .. }
            | CameraMount::World { world_from_camera: pose } => match from_xyz_wxyz(*pose) {
                Some(_) => Ok(()),
                None => Err(format!(
                    "expected a pose `[x y z qw qx qy qz]` of finite numbers with a quaternion \
                     that is not zero, got {pose:?}"
                )),
            },
            CameraMount::LookAtTool { position, .. } => {
                if position.iter().all(|v| v.is_finite()) {
                    return Ok(());
                }
                Err(format!("position must be three finite numbers, got {position:?}"))
            }
            CameraMount::LookAtHandle { offset } => {
                let distance = offset.iter().map(|v| v * v).sum::<f64>().sqrt();
                if distance.is_finite() && distance >= 0.05 {
                    return Ok(());
                }
                Err(format!("offset must be at least 0.05 m long, got {offset:?}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(change: impl Fn(&mut CameraSpec)) -> Result<(), RigError> {
        let mut rig = Rig::preset("paper").unwrap();
        change(&mut rig.cameras[1]);
        rig.validate("test rig")
    }

    #[test]
    fn presets_are_valid() {
        for name in Rig::preset_names() {
            assert_eq!(Rig::preset(name).unwrap().name, name);
        }
        let message = Rig::preset("papre").unwrap_err().to_string();
        assert!(message.contains("papre") && message.contains("paper"), "{message}");
    }

    #[test]
    fn bad_values_are_refused_with_what_was_expected() {
        assert!(with(|_| ()).is_ok());
        type Change<'a> = &'a dyn Fn(&mut CameraSpec);
        let cases: [(Change<'_>, &str); 10] = [
            (&|c| c.focal_mm = 0.0, "focal_mm"),
            (&|c| c.focal_mm = -15.0, "focal_mm"),
            (&|c| c.focal_mm = f64::NAN, "focal_mm"),
            (&|c| c.near_m = 30.0, "near_m"),
            (&|c| c.near_m = 0.0, "near_m"),
            (&|c| c.far_m = f64::INFINITY, "far_m"),
            (&|c| c.width = 0, "width"),
            (&|c| c.name = "ego_topdown".into(), "twice"),
            (&|c| c.name = "a/b".into(), "letters"),
            (&|c| c.mount = CameraMount::World { world_from_camera: [0.0; 7] }, "quaternion"),
        ];
        for (change, word) in cases {
            let message = with(change).unwrap_err().to_string();
            assert!(message.contains("test rig") && message.contains(word), "{message}");
        }
    }

    #[test]
    fn unknown_links_list_the_choices() {
        let mut rig = Rig::preset("paper").unwrap();
        rig.validate_links(["elbow"].into_iter()).unwrap();
        rig.cameras[0].mount =
            CameraMount::Link { link: "elbwo".into(), link_from_camera: [0.0; 7] };
        let message = rig.validate_links(["elbow"].into_iter()).unwrap_err().to_string();
        assert!(message.contains("elbwo") && message.contains("tool") && message.contains("elbow"));
    }

    #[test]
    fn unknown_keys_are_errors() {
        let text = include_str!("../presets/paper.toml").replacen("focal_mm", "focal", 1);
        assert!(matches!(Rig::from_toml(&text, "x"), Err(RigError::Syntax { .. })));
    }
}
