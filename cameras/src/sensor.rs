//! What a real sensor makes of an ideal image: specifications. `akrobat-renderer` applies them.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::RigError;

/// A sensor (TOML): how depth is measured and how colours are taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Name for reports and manifests.
    pub name: String,
    /// How depth is measured.
    #[serde(default)]
    pub depth: DepthSensor,
    /// How colours are taken.
    #[serde(default)]
    pub color: ColorSensor,
}

/// How depth is measured.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "model", deny_unknown_fields)]
pub enum DepthSensor {
    /// Exactly.
    #[default]
    Ideal,
    /// Structured light.
    Kinect(Kinect),
    /// Structured light with a distortion that changes with depth.
    Redwood(Redwood),
    /// Two infrared cameras and a projected pattern.
    Stereo(Stereo),
}

/// Structured light: Handa, Whelan, McDonald and Davison, *A Benchmark for RGB-D Visual Odometry, 3D
/// Reconstruction and SLAM* (ICRA 2014), section III: pixels are shifted by noise, and the disparity of
/// what is found there is disturbed and rounded. What the projector does not reach and what is seen
/// at a grazing angle (Nguyen, Izadi and Lovell, *Modeling Kinect Sensor Noise for Improved 3D Reconstruction and
/// Tracking*, 3DIMPVT 2012) is not measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Kinect {
    /// Focal length times baseline, pixels x metres: disparity is this over depth.
    pub focal_baseline_px_m: f64,
    /// Step of the disparity, pixels.
    pub quantum_px: f64,
    /// Standard deviation of the disparity, in steps.
    pub disparity_noise: f64,
    /// Standard deviation of the shift along each image axis, pixels: ragged edges.
    pub edge_shift_px: f64,
    /// Distance of the projector from the camera along the image's x axis, metres; what it does not
    /// reach is invalid. 0 for no shadow.
    pub projector_baseline_m: f64,
    /// Surfaces whose normal is farther than this from the line of sight are not measured, radians.
    pub grazing_rad: f64,
    /// Nearest depth measured, metres.
    pub min_m: f64,
    /// Farthest depth measured, metres.
    pub max_m: f64,
}

impl Default for Kinect {
    fn default() -> Self {
        Self {
            focal_baseline_px_m: 351.3 / 8.0,
            quantum_px: 0.125,
            disparity_noise: 1.0 / 6.0,
            edge_shift_px: 0.5,
            projector_baseline_m: 0.075,
            grazing_rad: 80f64.to_radians(),
            min_m: 0.4,
            max_m: 8.0,
        }
    }
}

/// Structured light after Choi, Zhou and Koltun, *Robust Reconstruction of Indoor Scenes* (CVPR 2015), section 6,
/// with the depth distortion of Teichman, Miller and Thrun, *Unsupervised Intrinsic Calibration of Depth
/// Sensors via SLAM* (RSS 2013): pixels are shifted, pairs of pixels share a measurement, depth is divided
/// by a smooth factor that depends on pixel and depth, and disparity is disturbed and rounded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Redwood {
    /// Disparity times depth, pixels x metres.
    pub focal_baseline_px_m: f64,
    /// Step of the disparity, pixels.
    pub quantum_px: f64,
    /// Standard deviation of the disparity, pixels.
    pub disparity_noise_px: f64,
    /// Standard deviation of the shift along each image axis, pixels.
    pub edge_shift_px: f64,
    /// Standard deviation of the distortion factor at depths of 1, 3, 5, 7 and 9 m. The factor itself is a
    /// smooth field over the image, drawn once for each camera and episode.
    pub distortion: [f64; 5],
    /// Farthest depth measured, metres.
    pub max_m: f64,
}

impl Default for Redwood {
    fn default() -> Self {
        Self {
            focal_baseline_px_m: 35.13,
            quantum_px: 0.125,
            disparity_noise_px: 1.0 / 36.0,
            edge_shift_px: 0.25,
            distortion: [0.002, 0.006, 0.012, 0.018, 0.024],
            max_m: 10.0,
        }
    }
}

/// Active stereo: the camera itself and a second one to its right see the scene and a projected
/// pattern of dots in infrared; census transforms (Zabih and Woodfill, ECCV 1994) are matched semi-globally
/// (Hirschmüller, *Stereo Processing by Semiglobal Matching and Mutual Information*, PAMI 30(2), 2008), with
/// sub-pixel refinement, left-right check and uniqueness. Depth is in the frame of the camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Stereo {
    /// Distance between the two cameras, metres.
    pub baseline_m: f64,
    /// Largest disparity searched, pixels; nearer things are not measured.
    pub max_disparity_px: u32,
    /// Half the edge of the census window, pixels: 1 to 3.
    pub census_radius: u32,
    /// Cost of a disparity that differs by one from a neighbour's, in differing census bits.
    pub small_step_cost: u32,
    /// Cost of a larger difference.
    pub large_step_cost: u32,
    /// The second best disparity must cost this much more, percent.
    pub uniqueness_percent: u32,
    /// Largest difference between the disparities of left and right image, pixels.
    pub left_right_px: f64,
    /// Dots of the projected pattern per radian of its field.
    pub dots_per_rad: f64,
    /// Infrared light of a dot at 1 m on a white surface that faces it, relative to the ambient light's full scale.
    pub dot_intensity: f64,
    /// Standard deviation of the infrared images' noise, relative to full scale.
    pub infrared_noise: f64,
    /// Farthest depth measured, metres.
    pub max_m: f64,
}

impl Default for Stereo {
    fn default() -> Self {
        Self {
            baseline_m: 0.05,
            max_disparity_px: 96,
            census_radius: 2,
            small_step_cost: 3,
            large_step_cost: 20,
            uniqueness_percent: 5,
            left_right_px: 1.0,
            dots_per_rad: 90.0,
            dot_intensity: 2.0,
            infrared_noise: 0.01,
            max_m: 10.0,
        }
    }
}

/// How colours are taken. Exposure, blur and noise work on linear light.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ColorSensor {
    /// Exposure, stops: each doubles the light.
    pub exposure_ev: f64,
    /// Standard deviation of the exposure from episode to episode, stops.
    pub exposure_jitter_ev: f64,
    /// Noise of the pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<PixelNoise>,
    /// Motion during the exposure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_blur: Option<MotionBlur>,
    /// The image is compressed as JPEG at this quality, 1 to 100, and decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jpeg_quality: Option<u8>,
}

/// Shot and read noise: the variance of a pixel is affine in its light (EMVA Standard 1288, section 2).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PixelNoise {
    /// Electrons of a pixel at full scale: fewer make more shot noise.
    pub full_well_electrons: f64,
    /// Standard deviation in the dark, electrons.
    pub read_electrons: f64,
}

/// Motion blur: the mean of several images during the exposure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionBlur {
    /// How long the shutter is open, seconds, centred on the frame's time.
    pub exposure_s: f64,
    /// Images that are averaged, 2 to 32.
    pub samples: u32,
}

/// Built-in sensors by name, as TOML.
const PRESETS: [(&str, &str); 5] = [
    ("ideal", include_str!("../presets/sensors/ideal.toml")),
    ("kinect", include_str!("../presets/sensors/kinect.toml")),
    ("redwood", include_str!("../presets/sensors/redwood.toml")),
    ("stereo", include_str!("../presets/sensors/stereo.toml")),
    ("color", include_str!("../presets/sensors/color.toml")),
];

impl Default for Sensor {
    fn default() -> Self {
        let (depth, color) = (DepthSensor::Ideal, ColorSensor::default());
        Self { name: "ideal".into(), depth, color }
    }
}

impl Sensor {
    /// Reads and checks a sensor file.
    ///
    /// # Errors
    /// [`RigError::Read`], [`RigError::Syntax`] and [`RigError::BadSensor`].
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| RigError::Read { path: path.to_path_buf(), source })?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Parses and checks a sensor; `context` names the text in errors.
    ///
    /// # Errors
    /// [`RigError::Syntax`] and [`RigError::BadSensor`].
    pub fn from_toml(text: &str, context: &str) -> Result<Self, RigError> {
        let sensor: Self = toml::from_str(text).map_err(|error| RigError::Syntax {
            context: context.to_owned(),
            message: error.to_string(),
        })?;
        match sensor.check() {
            Ok(()) => Ok(sensor),
            Err(message) => Err(RigError::BadSensor { context: context.to_owned(), message }),
        }
    }

    /// A built-in sensor.
    ///
    /// # Errors
    /// [`RigError::UnknownSensor`], which lists the presets.
    pub fn preset(name: &str) -> Result<Self, RigError> {
        match PRESETS.iter().find(|(preset, _)| *preset == name) {
            Some((_, text)) => Self::from_toml(text, name),
            None => Err(RigError::UnknownSensor {
                name: name.to_owned(),
                choices: Self::preset_names().map(str::to_owned).collect(),
            }),
        }
    }

    /// Names of the built-in sensors.
    pub fn preset_names() -> impl Iterator<Item = &'static str> {
        PRESETS.iter().map(|(name, _)| *name)
    }

    /// True where images stay as they are rendered.
    pub fn is_ideal(&self) -> bool {
        self.depth == DepthSensor::Ideal && self.color == ColorSensor::default()
    }

    fn check(&self) -> Result<(), String> {
        self.depth.check().and_then(|()| self.color.check())
    }
}

impl DepthSensor {
    fn check(&self) -> Result<(), String> {
        match self {
            Self::Ideal => Ok(()),
            Self::Kinect(k) => {
                positive("depth.focal_baseline_px_m", k.focal_baseline_px_m)?;
                positive("depth.quantum_px", k.quantum_px)?;
                not_negative("depth.disparity_noise", k.disparity_noise)?;
                not_negative("depth.edge_shift_px", k.edge_shift_px)?;
                finite("depth.projector_baseline_m", k.projector_baseline_m)?;
                positive("depth.grazing_rad", k.grazing_rad)?;
                not_negative("depth.min_m", k.min_m)?;
                above("depth.max_m", k.max_m, k.min_m)
            }
            Self::Redwood(r) => {
                positive("depth.focal_baseline_px_m", r.focal_baseline_px_m)?;
                positive("depth.quantum_px", r.quantum_px)?;
                not_negative("depth.disparity_noise_px", r.disparity_noise_px)?;
                not_negative("depth.edge_shift_px", r.edge_shift_px)?;
                for value in r.distortion {
                    not_negative("depth.distortion", value)?;
                }
                positive("depth.max_m", r.max_m)
            }
            Self::Stereo(s) => {
                positive("depth.baseline_m", s.baseline_m)?;
                within("depth.max_disparity_px", s.max_disparity_px, 8, 512)?;
                within("depth.census_radius", s.census_radius, 1, 3)?;
                within("depth.small_step_cost", s.small_step_cost, 0, 1000)?;
                within("depth.large_step_cost", s.large_step_cost, s.small_step_cost, 1000)?;
                within("depth.uniqueness_percent", s.uniqueness_percent, 0, 100)?;
                not_negative("depth.left_right_px", s.left_right_px)?;
                not_negative("depth.dots_per_rad", s.dots_per_rad)?;
                not_negative("depth.dot_intensity", s.dot_intensity)?;
                not_negative("depth.infrared_noise", s.infrared_noise)?;
                positive("depth.max_m", s.max_m)
            }
        }
    }
}

impl ColorSensor {
    fn check(&self) -> Result<(), String> {
        finite("color.exposure_ev", self.exposure_ev)?;
        not_negative("color.exposure_jitter_ev", self.exposure_jitter_ev)?;
        if let Some(noise) = &self.noise {
            positive("color.noise.full_well_electrons", noise.full_well_electrons)?;
            not_negative("color.noise.read_electrons", noise.read_electrons)?;
        }
        if let Some(blur) = &self.motion_blur {
            positive("color.motion_blur.exposure_s", blur.exposure_s)?;
            within("color.motion_blur.samples", blur.samples, 2, 32)?;
        }
        match self.jpeg_quality {
            Some(quality) => within("color.jpeg_quality", quality.into(), 1, 100),
            None => Ok(()),
        }
    }
}

fn finite(what: &str, value: f64) -> Result<(), String> {
    if value.is_finite() { Ok(()) } else { Err(format!("{what} must be finite, got {value}")) }
}

fn not_negative(what: &str, value: f64) -> Result<(), String> {
    let valid = value.is_finite() && value >= 0.0;
    if valid { Ok(()) } else { Err(format!("{what} must be 0 or more, got {value}")) }
}

fn positive(what: &str, value: f64) -> Result<(), String> {
    above(what, value, 0.0)
}

fn above(what: &str, value: f64, low: f64) -> Result<(), String> {
    let valid = value.is_finite() && value > low;
    if valid { Ok(()) } else { Err(format!("{what} must be above {low}, got {value}")) }
}

fn within(what: &str, value: u32, low: u32, high: u32) -> Result<(), String> {
    let valid = (low..=high).contains(&value);
    if valid { Ok(()) } else { Err(format!("{what} must be {low} to {high}, got {value}")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid() {
        for name in Sensor::preset_names() {
            assert_eq!(Sensor::preset(name).unwrap().name, name);
        }
        assert!(Sensor::preset("ideal").unwrap().is_ideal());
        assert!(!Sensor::preset("kinect").unwrap().is_ideal());
        let message = Sensor::preset("kinetc").unwrap_err().to_string();
        assert!(message.contains("kinetc") && message.contains("redwood"), "{message}");
    }

    #[test]
    fn bad_values_are_refused_with_what_was_expected() {
        let cases = [
            ("[depth]\nmodel = \"kinect\"\nquantum_px = 0.0", "depth.quantum_px"),
            ("[depth]\nmodel = \"kinect\"\nmin_m = 9.0", "depth.max_m"),
            ("[depth]\nmodel = \"stereo\"\nbaseline_m = -1.0", "depth.baseline_m"),
            ("[depth]\nmodel = \"lidar\"", "kinect"),
            ("[depth]\nmodel = \"kinect\"\nnoise = 1.0", "noise"),
            ("[color]\njpeg_quality = 0", "color.jpeg_quality"),
            ("[color.motion_blur]\nexposure_s = 0.01\nsamples = 1", "samples"),
        ];
        for (text, word) in cases {
            let text = format!("name = \"x\"\n{text}");
            let message = Sensor::from_toml(&text, "my.toml").unwrap_err().to_string();
            assert!(message.contains("my.toml") && message.contains(word), "{message}");
        }
    }
}
