//! Rigs: which cameras there are and where they are mounted.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::intrinsics::ISAAC_HORIZONTAL_APERTURE_MM;
use crate::mount::LINK_ALIASES;
use crate::{CameraModel, CameraMount, Distortion, Intrinsics, RigError};

/// A set of cameras (TOML).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Name for reports and manifests.
    pub name: String,
    /// The cameras, in the order of the outputs.
    pub cameras: Vec<CameraSpec>,
}

/// One camera. Its focal lengths are given in one of three ways: `focal_mm`, `fov_rad` or `k`.
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
    /// Focal length, millimetres: square pixels, centred principal point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_mm: Option<f64>,
    /// Horizontal aperture that `focal_mm` refers to, millimetres; 20.955 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aperture_mm: Option<f64>,
    /// Horizontal field of view, radians: square pixels, centred principal point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov_rad: Option<f64>,
    /// The matrix K, pixels, row by row. Pixel centres lie at integer + 0.5: add 0.5 to the principal point of
    /// calibrations by OpenCV or ROS, where they lie at integers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k: Option<[[f64; 3]; 3]>,
    /// The lens; a pinhole where absent.
    #[serde(default, skip_serializing_if = "is_default")]
    pub distortion: Distortion,
    /// Images per second; every frame of the episode where absent. Between its images, a slower camera's last
    /// one stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// Nearest depth seen, metres.
    #[serde(default = "default_near")]
    pub near_m: f64,
    /// Farthest depth seen, metres.
    #[serde(default = "default_far")]
    pub far_m: f64,
    /// Random error of the mounting, drawn once for each episode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jitter: Option<Jitter>,
    /// Where the camera is.
    pub mount: CameraMount,
}

/// Random error of a camera's mounting: normal along and about each of its axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Jitter {
    /// Standard deviation of the position along each axis, metres.
    #[serde(default)]
    pub position_m: f64,
    /// Standard deviation of the rotation about each axis, radians.
    #[serde(default)]
    pub rotation_rad: f64,
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
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Largest image edge that a rig may ask for, pixels.
pub const LARGEST_EDGE: u32 = 4096;

/// Built-in rigs by name, as TOML.
const PRESETS: [(&str, &str); 5] = [
    ("paper", include_str!("../presets/rigs/paper.toml")),
    ("realsense_d435", include_str!("../presets/rigs/realsense_d435.toml")),
    ("realsense_d455", include_str!("../presets/rigs/realsense_d455.toml")),
    ("azure_kinect", include_str!("../presets/rigs/azure_kinect.toml")),
    ("ring", include_str!("../presets/rigs/ring.toml")),
];

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
            let Some(link) = camera.mount.link() else { continue };
            let mut valid = LINK_ALIASES.into_iter().chain(links.clone());
            if !valid.any(|name| name == link) {
                return Err(RigError::UnknownLink {
                    rig: self.name.clone(),
                    camera: camera.name.clone(),
                    link: link.to_owned(),
                    choices: LINK_ALIASES.into_iter().chain(links).map(str::to_owned).collect(),
                });
            }
        }
        Ok(())
    }
}

impl CameraSpec {
    /// A pinhole camera of 320 x 240 pixels with a focal length over Isaac's aperture.
    pub fn new(name: impl Into<String>, focal_mm: f64, mount: CameraMount) -> Self {
        Self {
            name: name.into(),
            width: default_width(),
            height: default_height(),
            focal_mm: Some(focal_mm),
            aperture_mm: None,
            fov_rad: None,
            k: None,
            distortion: Distortion::Pinhole,
            rate_hz: None,
            near_m: default_near(),
            far_m: default_far(),
            jitter: None,
            mount,
        }
    }

    /// Size, focal lengths and principal point of a valid camera.
    pub fn intrinsics(&self) -> Intrinsics {
        let (width, height) = (self.width, self.height);
        match (&self.k, self.fov_rad, self.focal_mm) {
            (Some(k), ..) => Intrinsics::from_matrix(width, height, k),
            (None, Some(fov_rad), _) => Intrinsics::from_horizontal_fov(width, height, fov_rad),
            (None, None, focal_mm) => {
                let aperture_mm = self.aperture_mm.unwrap_or(ISAAC_HORIZONTAL_APERTURE_MM);
                Intrinsics::from_focal_length(width, height, focal_mm.unwrap_or(0.0), aperture_mm)
            }
        }
    }

    /// Lens and intrinsics of a valid camera.
    pub fn model(&self) -> CameraModel {
        CameraModel { intrinsics: self.intrinsics(), distortion: self.distortion }
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
        self.check_focal_lengths()?;
        self.distortion.check()?;
        let (near, far) = (self.near_m, self.far_m);
        if !(near > 0.0 && near < far && far.is_finite()) {
            return Err(format!("expected 0 < near_m < far_m, got near_m {near} and far_m {far}"));
        }
        if let Some(rate) = self.rate_hz
            && !(rate.is_finite() && rate > 0.0)
        {
            return Err(format!("rate_hz must be above 0, got {rate}"));
        }
        if let Some(Jitter { position_m, rotation_rad }) = self.jitter {
            for (what, value) in [("position_m", position_m), ("rotation_rad", rotation_rad)] {
                if !(value.is_finite() && (0.0..1.0).contains(&value)) {
                    return Err(format!("jitter.{what} must be 0 to 1, got {value}"));
                }
            }
        }
        self.mount.check()
    }

    fn check_focal_lengths(&self) -> Result<(), String> {
        let given = [
            ("focal_mm", self.focal_mm.is_some()),
            ("fov_rad", self.fov_rad.is_some()),
            ("k", self.k.is_some()),
        ];
        let given: Vec<&str> =
            given.iter().filter(|(_, is_given)| *is_given).map(|g| g.0).collect();
        if given.len() != 1 {
            let got = if given.is_empty() { "none".into() } else { given.join(" and ") };
            return Err(format!("expected one of focal_mm, fov_rad and k, got {got}"));
        }
        for (what, value) in [("focal_mm", self.focal_mm), ("aperture_mm", self.aperture_mm)] {
            if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(format!("{what} must be above 0, got {value}"));
            }
        }
        if self.aperture_mm.is_some() && self.focal_mm.is_none() {
            return Err("aperture_mm needs focal_mm".into());
        }
        match (self.fov_rad, &self.k) {
            (Some(fov), _) if !(fov > 0.0 && fov < 3.1) => {
                Err(format!("fov_rad must be above 0 and below 3.1 radians, got {fov}"))
            }
            (_, Some(k)) => check_matrix(k),
            _ => Ok(()),
        }
    }
}

fn check_matrix(k: &[[f64; 3]; 3]) -> Result<(), String> {
    let [[fx, skew, cx], [zero, fy, cy], last] = *k;
    let is_valid = fx > 0.0
        && fy > 0.0
        && [fx, fy, cx, cy].iter().all(|v| v.is_finite())
        && [skew, zero] == [0.0; 2]
        && last == [0.0, 0.0, 1.0];
    if is_valid {
        return Ok(());
    }
    Err(format!(
        "k must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy above 0, got {k:?}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BrownConrady, Reference};

    const SKEWED: [[f64; 3]; 3] = [[300.0, 1.0, 160.0], [0.0, 300.0, 120.0], [0.0, 0.0, 1.0]];

    fn nan_lens() -> Distortion {
        Distortion::BrownConrady(BrownConrady { k1: f64::NAN, ..BrownConrady::default() })
    }

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
        let pose = |values: [f64; 7]| CameraMount::World { world_from_camera: values.into() };
        let cases: [(Change<'_>, &str); 21] = [
            (&|c| c.focal_mm = Some(0.0), "focal_mm"),
            (&|c| c.focal_mm = Some(-15.0), "focal_mm"),
            (&|c| c.focal_mm = Some(f64::NAN), "focal_mm"),
            (&|c| c.focal_mm = None, "expected one of focal_mm, fov_rad and k"),
            (&|c| c.fov_rad = Some(1.0), "focal_mm and fov_rad"),
            (&|c| (c.focal_mm, c.fov_rad) = (None, Some(3.2)), "fov_rad"),
            (&|c| (c.focal_mm, c.k) = (None, Some([[0.0; 3]; 3])), "k must be"),
            (&|c| (c.focal_mm, c.k) = (None, Some(SKEWED)), "k must be"),
            (&|c| c.aperture_mm = Some(0.0), "aperture_mm"),
            (&|c| c.near_m = 30.0, "near_m"),
            (&|c| c.near_m = 0.0, "near_m"),
            (&|c| c.far_m = f64::INFINITY, "far_m"),
            (&|c| c.rate_hz = Some(0.0), "rate_hz"),
            (&|c| c.jitter = Some(Jitter { position_m: -0.1, rotation_rad: 0.0 }), "position_m"),
            (&|c| c.distortion = nan_lens(), "distortion"),
            (&|c| c.width = 0, "width"),
            (&|c| c.name = "ego_topdown".into(), "twice"),
            (&|c| c.name = "a/b".into(), "letters"),
            (&|c| c.mount = pose([0.0; 7]), "quaternion"),
            (&|c| c.mount = pose([0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), "quaternion"),
            (&|c| c.mount = CameraMount::LookAtHandle { offset: [0.0; 3] }, "offset"),
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
            CameraMount::Link { link: "elbwo".into(), link_from_camera: [0.0; 7].into() };
        let message = rig.validate_links(["elbow"].into_iter()).unwrap_err().to_string();
        assert!(message.contains("elbwo") && message.contains("tool") && message.contains("elbow"));
    }

    #[test]
    fn three_ways_to_give_the_focal_length_agree() {
        let camera = CameraSpec::new("c", 15.0, CameraMount::LookAtHandle { offset: [1.0; 3] });
        let intrinsics = camera.intrinsics();
        let [fov_rad, _] = intrinsics.field_of_view_rad();
        let by_fov = CameraSpec { focal_mm: None, fov_rad: Some(fov_rad), ..camera.clone() };
        let k = Some(intrinsics.matrix());
        let by_matrix = CameraSpec { focal_mm: None, k, ..camera.clone() };
        assert_eq!(by_matrix.intrinsics(), intrinsics);
        assert!((by_fov.intrinsics().fx - intrinsics.fx).abs() < 1e-9);
        let wide = CameraSpec { aperture_mm: Some(2.0 * 20.955), ..camera };
        assert!((2.0 * wide.intrinsics().fx - intrinsics.fx).abs() < 1e-9);
    }

    #[test]
    fn rigs_survive_their_own_toml() {
        for name in Rig::preset_names() {
            let rig = Rig::preset(name).unwrap();
            assert_eq!(Rig::from_toml(&toml::to_string(&rig).unwrap(), name).unwrap(), rig);
        }
    }

    #[test]
    fn poses_may_be_matrices_and_targets_may_be_relative() {
        let text = r#"
            name = "two"
            [[cameras]]
            name = "a"
            fov_rad = 1.2
            rate_hz = 15.0
            jitter = { position_m = 0.01, rotation_rad = 0.02 }
            distortion = { model = "kannala_brandt", k1 = 0.1 }
            [cameras.mount]
            on = "world"
            world_from_camera = [[1, 0, 0, 2], [0, 0, 1, 0], [0, -1, 0, 1], [0, 0, 0, 1]]
            [[cameras]]
            name = "b"
            k = [[300, 0, 160], [0, 301, 120], [0, 0, 1]]
            mount = { on = "look_at", relative_to = "object", position = [1, 0, 1], target = [0, 0, 0] }
        "#;
        let rig = Rig::from_toml(text, "two.toml").unwrap();
        assert_eq!(rig.cameras[0].distortion.name(), "kannala_brandt");
        let CameraMount::LookAt { relative_to, .. } = rig.cameras[1].mount else { panic!() };
        assert_eq!(relative_to, Reference::Object);
        let sheared = text.replace("[0, 0, 1, 0]", "[0, 0.1, 1, 0]");
        let message = Rig::from_toml(&sheared, "two.toml").unwrap_err().to_string();
        assert!(message.contains("orthonormal") && message.contains("\"a\""), "{message}");
        let unknown = text.replace("kannala_brandt", "kanala");
        let message = Rig::from_toml(&unknown, "two.toml").unwrap_err().to_string();
        assert!(message.contains("brown_conrady"), "{message}");
    }

    #[test]
    fn unknown_keys_are_errors() {
        let text = include_str!("../presets/rigs/paper.toml").replacen("focal_mm", "focal", 1);
        assert!(matches!(Rig::from_toml(&text, "x"), Err(RigError::Syntax { .. })));
    }
}
