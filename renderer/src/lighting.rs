//! Light: what a scene is lit by, as files and presets say it.
//!
//! Colours are linear RGB. The `rgb` of a light is what a white, perfectly diffuse surface that faces it reflects
//! (irradiance over pi): of a directional light everywhere, of point and spot lights at a distance of 1 m.

use std::path::Path;

use akrobat_model::Pose;
use nalgebra::{Point3, UnitVector3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Most lights of a scene: what fits a uniform block on every device.
pub const MOST_LIGHTS: usize = 8;

/// Light and background of a scene (TOML).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lighting {
    /// Name for reports and manifests.
    pub name: String,
    /// sRGB colour (0..255) where nothing is seen.
    #[serde(default = "default_background")]
    pub background_rgb: [u8; 3],
    /// How surfaces reflect.
    #[serde(default)]
    pub reflection: Reflection,
    /// Light from everywhere.
    #[serde(default)]
    pub environment: Environment,
    /// The lights, at most 8.
    #[serde(default)]
    pub lights: Vec<Light>,
    /// Edge of each shadow map, pixels.
    #[serde(default = "default_shadow_map")]
    pub shadow_map_pixels: u32,
}

fn default_background() -> [u8; 3] {
    [168, 184, 200]
}
fn default_shadow_map() -> u32 {
    1024
}

/// How surfaces reflect light.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reflection {
    /// Diffuse, by the base colour alone.
    #[default]
    Lambert,
    /// Metallic-roughness, as glTF 2.0 defines it: diffuse and GGX.
    Pbr,
}

/// Light from everywhere, without shadows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "kind")]
pub enum Environment {
    /// The same from all sides.
    Constant {
        /// Ambient light on every surface.
        rgb: [f32; 3],
    },
    /// From sky to ground.
    Gradient {
        /// Ambient light on a surface that faces up.
        sky_rgb: [f32; 3],
        /// Ambient light on a surface that faces down.
        ground_rgb: [f32; 3],
    },
}

impl Default for Environment {
    fn default() -> Self {
        Self::Constant { rgb: [0.3; 3] }
    }
}

impl Environment {
    /// Ambient light on surfaces that face up and down.
    pub fn sky_and_ground(&self) -> [[f32; 3]; 2] {
        match *self {
            Self::Constant { rgb } => [rgb; 2],
            Self::Gradient { sky_rgb, ground_rgb } => [sky_rgb, ground_rgb],
        }
    }
}

/// The frame in which a light's position and direction are given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightFrame {
    /// On the floor below the manipulated object: z up, x horizontally out of its front.
    #[default]
    Front,
    /// The world.
    World,
}

/// What keeps a light from reaching what lies behind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shadow {
    /// Nothing.
    #[default]
    None,
    /// The robot, the object and clutter: light from outside reaches into closed rooms.
    Moving,
    /// Everything.
    All,
}

/// A light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "kind")]
pub enum Light {
    /// From infinitely far away.
    Directional {
        /// Frame of the direction.
        #[serde(default)]
        frame: LightFrame,
        /// Direction to the light; need not be of unit length.
        direction: [f32; 3],
        /// Light on a surface that faces it.
        rgb: [f32; 3],
        /// What casts shadows.
        #[serde(default)]
        shadow: Shadow,
    },
    /// From a point to all sides.
    Point {
        /// Frame of the position.
        #[serde(default)]
        frame: LightFrame,
        /// Position, metres.
        position: [f32; 3],
        /// Light on a surface that faces it at 1 m; it falls with the square of the distance.
        rgb: [f32; 3],
        /// What casts shadows.
        #[serde(default)]
        shadow: Shadow,
    },
    /// From a point into a cone.
    Spot {
        /// Frame of position and target.
        #[serde(default)]
        frame: LightFrame,
        /// Position, metres.
        position: [f32; 3],
        /// The point that it is aimed at, metres.
        target: [f32; 3],
        /// Light on a surface that faces it at 1 m on the axis; it falls with the square of the distance.
        rgb: [f32; 3],
        /// Angle from the axis at which the light begins to fade, degrees.
        inner_deg: f32,
        /// Angle from the axis at which it ends, degrees.
        outer_deg: f32,
        /// What casts shadows.
        #[serde(default)]
        shadow: Shadow,
    },
}

impl Light {
    /// Light on a surface that faces it.
    pub fn rgb_mut(&mut self) -> &mut [f32; 3] {
        match self {
            Self::Directional { rgb, .. } | Self::Point { rgb, .. } | Self::Spot { rgb, .. } => rgb,
        }
    }

    /// What casts its shadows.
    pub fn shadow(&self) -> Shadow {
        match self {
            Self::Directional { shadow, .. }
            | Self::Point { shadow, .. }
            | Self::Spot { shadow, .. } => *shadow,
        }
    }

    fn values(&self) -> Vec<f32> {
        match self {
            Self::Directional { direction, rgb, .. } => [*direction, *rgb].concat(),
            Self::Point { position, rgb, .. } => [*position, *rgb].concat(),
            Self::Spot { position, target, rgb, inner_deg, outer_deg, .. } => {
                [&position[..], target, rgb, &[*inner_deg, *outer_deg]].concat()
            }
        }
    }

    fn check(&self) -> Result<(), String> {
        if let Some(value) = self.values().iter().find(|value| !value.is_finite()) {
            return Err(format!("expected finite numbers, got {value}"));
        }
        let (Self::Directional { rgb, .. } | Self::Point { rgb, .. } | Self::Spot { rgb, .. }) =
            self;
        check_color("rgb", rgb)?;
        match self {
            Self::Directional { direction, .. } if norm(*direction) < 1e-6 => {
                Err(format!("direction must have a length, got {direction:?}"))
            }
            Self::Spot { position, target, .. }
                if norm(std::array::from_fn(|i| target[i] - position[i])) < 1e-6 =>
            {
                Err(format!("target must differ from position, got {target:?} for both"))
            }
            Self::Spot { inner_deg, outer_deg, .. }
                if !(0.0 <= *inner_deg && inner_deg < outer_deg && *outer_deg <= 80.0) =>
            {
                Err(format!(
                    "expected 0 <= inner_deg < outer_deg <= 80, got {inner_deg} and {outer_deg}"
                ))
            }
            _ => Ok(()),
        }
    }
}

fn norm(v: [f32; 3]) -> f32 {
    v.iter().map(|c| c * c).sum::<f32>().sqrt()
}

/// Brightest channel that a file may ask for: beyond it numbers are more likely a mistake of units.
const BRIGHTEST: f32 = 1000.0;

fn check_color(what: &str, rgb: &[f32; 3]) -> Result<(), String> {
    if rgb.iter().all(|c| (0.0..=BRIGHTEST).contains(c)) {
        return Ok(());
    }
    Err(format!("{what} must be three numbers of 0 to {BRIGHTEST} (linear light), got {rgb:?}"))
}

/// Why a lighting or a variation cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LightingError {
    /// The file cannot be read.
    #[error("{path}: cannot read: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not such a file.
    #[error("{context}: {message}; schema: `akrobat schema {what}`")]
    Syntax {
        /// `lighting` or `variation`.
        what: &'static str,
        /// File or preset.
        context: String,
        /// What the parser says.
        message: String,
    },
    /// A value is out of its range.
    #[error("{context}: {place}: {message}")]
    BadValue {
        /// File or preset.
        context: String,
        /// `lights[2]`, `environment`, …
        place: String,
        /// What was expected and what was got.
        message: String,
    },
    /// There is no such preset.
    #[error("no {what} preset \"{name}\"; valid choices: {}, or a file that ends in .toml", choices.join(", "))]
    UnknownPreset {
        /// `lighting` or `variation`.
        what: &'static str,
        /// What was asked for.
        name: String,
        /// The presets.
        choices: Vec<String>,
    },
}

/// Built-in lightings by name, as TOML.
const PRESETS: [(&str, &str); 6] = [
    ("even", include_str!("../lighting/even.toml")),
    ("ceiling", include_str!("../lighting/ceiling.toml")),
    ("sun", include_str!("../lighting/sun.toml")),
    ("studio", include_str!("../lighting/studio.toml")),
    ("evening", include_str!("../lighting/evening.toml")),
    ("flat", include_str!("../lighting/flat.toml")),
];

impl Default for Lighting {
    fn default() -> Self {
        Self::preset("even").expect("the presets are valid, which a test shows")
    }
}

impl Lighting {
    /// The preset of this name, or the file where the name ends in `.toml` or holds a path.
    ///
    /// # Errors
    /// Any [`LightingError`].
    pub fn named(name: &str) -> Result<Self, LightingError> {
        let path = Path::new(name);
        if name.ends_with(".toml") || path.components().count() > 1 {
            let text = std::fs::read_to_string(path)
                .map_err(|source| LightingError::Read { path: name.to_owned(), source })?;
            return Self::from_toml(&text, name);
        }
        Self::preset(name)
    }

    /// A built-in lighting.
    ///
    /// # Errors
    /// [`LightingError::UnknownPreset`], which lists the presets.
    pub fn preset(name: &str) -> Result<Self, LightingError> {
        match PRESETS.iter().find(|(preset, _)| *preset == name) {
            Some((_, text)) => Self::from_toml(text, name),
            None => Err(LightingError::UnknownPreset {
                what: "lighting",
                name: name.to_owned(),
                choices: Self::preset_names().map(str::to_owned).collect(),
            }),
        }
    }

    /// Names of the built-in lightings.
    pub fn preset_names() -> impl Iterator<Item = &'static str> {
        PRESETS.iter().map(|(name, _)| *name)
    }

    /// Parses and checks a lighting; `context` names the text in errors.
    ///
    /// # Errors
    /// [`LightingError::Syntax`] and [`LightingError::BadValue`].
    pub fn from_toml(text: &str, context: &str) -> Result<Self, LightingError> {
        let lighting: Self = toml::from_str(text).map_err(|error| LightingError::Syntax {
            what: "lighting",
            context: context.to_owned(),
            message: error.to_string().trim_end().to_owned(),
        })?;
        lighting.validate(context)?;
        Ok(lighting)
    }

    /// Checks all values; `context` names the lighting in errors.
    ///
    /// # Errors
    /// [`LightingError::BadValue`] at the first value out of its range.
    pub fn validate(&self, context: &str) -> Result<(), LightingError> {
        let fail = |place: String, message: String| {
            Err(LightingError::BadValue { context: context.to_owned(), place, message })
        };
        if self.lights.len() > MOST_LIGHTS {
            let message = format!("at most {MOST_LIGHTS} lights, got {}", self.lights.len());
            return fail("lights".into(), message);
        }
        for rgb in self.environment.sky_and_ground() {
            if let Err(message) = check_color("colours", &rgb) {
                return fail("environment".into(), message);
            }
        }
        for (index, light) in self.lights.iter().enumerate() {
            if let Err(message) = light.check() {
                return fail(format!("lights[{index}]"), message);
            }
        }
        if !(64..=4096).contains(&self.shadow_map_pixels) {
            let message = format!("expected 64 to 4096, got {}", self.shadow_map_pixels);
            return fail("shadow_map_pixels".into(), message);
        }
        Ok(())
    }

    /// The same with all lights in the world's frame.
    pub fn in_world(&self, world_from_front: &Pose) -> Self {
        let mut placed = self.clone();
        for light in &mut placed.lights {
            let point = |p: &mut [f32; 3]| {
                *p = (world_from_front * Point3::from(*p).cast::<f64>()).cast::<f32>().into();
            };
            match light {
                Light::Directional { frame, direction, .. } if *frame == LightFrame::Front => {
                    let turned = world_from_front.rotation * Vector3::from(*direction).cast();
                    *direction = turned.cast::<f32>().into();
                    *frame = LightFrame::World;
                }
                Light::Point { frame, position, .. } if *frame == LightFrame::Front => {
                    point(position);
                    *frame = LightFrame::World;
                }
                Light::Spot { frame, position, target, .. } if *frame == LightFrame::Front => {
                    point(position);
                    point(target);
                    *frame = LightFrame::World;
                }
                _ => {}
            }
        }
        placed
    }
}

/// A light's geometry in the world frame, ready for arithmetic.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WorldLight {
    pub source: Source,
    pub rgb: [f32; 3],
    pub shadow: Shadow,
}

/// Where light comes from.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source {
    /// Unit vector to the light.
    Directional(Vector3<f64>),
    Point(Point3<f64>),
    /// Position, unit axis, and the cosines of the inner and outer angle.
    Spot(Point3<f64>, Vector3<f64>, [f64; 2]),
}

impl WorldLight {
    /// All lights of a lighting whose lights are in the world's frame.
    pub fn all(lighting: &Lighting) -> Vec<Self> {
        lighting.lights.iter().map(Self::new).collect()
    }

    fn new(light: &Light) -> Self {
        let unit = |v: Vector3<f64>| UnitVector3::try_new(v, 1e-12).map_or(Vector3::z(), |u| *u);
        let vector = |v: [f32; 3]| Vector3::from(v).cast::<f64>();
        match *light {
            Light::Directional { direction, rgb, shadow, .. } => {
                Self { source: Source::Directional(unit(vector(direction))), rgb, shadow }
            }
            Light::Point { position, rgb, shadow, .. } => {
                Self { source: Source::Point(Point3::from(vector(position))), rgb, shadow }
            }
            Light::Spot { position, target, rgb, inner_deg, outer_deg, shadow, .. } => {
                let eye = vector(position);
                let axis = unit(vector(target) - eye);
                let cosines = [inner_deg, outer_deg].map(|a| f64::from(a).to_radians().cos());
                Self { source: Source::Spot(Point3::from(eye), axis, cosines), rgb, shadow }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_named_after_themselves() {
        for name in Lighting::preset_names() {
            assert_eq!(Lighting::preset(name).unwrap().name, name);
        }
        let message = Lighting::preset("evne").unwrap_err().to_string();
        assert!(message.contains("evne") && message.contains("evening"), "{message}");
    }

    #[test]
    fn bad_values_are_refused_with_what_was_expected() {
        let spot = |text: &str| {
            let text = format!(
                "name = \"x\"\n[[lights]]\nkind = \"spot\"\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\nrgb = [1, 1, 1]\n{text}"
            );
            Lighting::from_toml(&text, "file.toml").map(|_| ())
        };
        assert!(spot("inner_deg = 10\nouter_deg = 20").is_ok());
        for (text, word) in [
            ("inner_deg = 30\nouter_deg = 20", "inner_deg < outer_deg"),
            ("inner_deg = 30", "outer_deg"),
            ("inner_deg = nan\nouter_deg = 20", "finite"),
            ("inner_deg = 1\nouter_deg = 20\nangle = 3", "angle"),
            ("inner_deg = 1\nouter_deg = 20\nshadow = \"soft\"", "moving"),
        ] {
            let message = spot(text).unwrap_err().to_string();
            assert!(message.contains("file.toml") && message.contains(word), "{message}");
        }
        for (text, word) in [
            ("kind = \"sun\"", "directional"),
            ("kind = \"directional\"\ndirection = [0, 0, 0]\nrgb = [1, 1, 1]", "length"),
            ("kind = \"point\"\nposition = [0, 0, 0]\nrgb = [1, -1, 1]", "rgb"),
        ] {
            let text = format!("name = \"x\"\n[[lights]]\n{text}");
            let message = Lighting::from_toml(&text, "file.toml").unwrap_err().to_string();
            assert!(message.contains("file.toml") && message.contains(word), "{message}");
        }
        let many = format!(
            "name = \"x\"\n{}",
            "[[lights]]\nkind = \"point\"\nposition = [0, 0, 0]\nrgb = [1, 1, 1]\n".repeat(9)
        );
        assert!(Lighting::from_toml(&many, "x").unwrap_err().to_string().contains("at most 8"));
        assert!(
            Lighting::named("nowhere/at_all.toml").unwrap_err().to_string().contains("nowhere")
        );
    }

    #[test]
    fn lights_are_placed_once() {
        let mut lighting = Lighting::preset("evening").unwrap();
        let front =
            Pose::new(Vector3::new(1.0, 2.0, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        lighting.lights = vec![Light::Point {
            frame: LightFrame::Front,
            position: [1.0, 0.0, 2.0],
            rgb: [1.0; 3],
            shadow: Shadow::None,
        }];
        let placed = lighting.in_world(&front);
        let Light::Point { position, .. } = placed.lights[0] else { panic!("another kind") };
        assert!(norm([position[0] - 1.0, position[1] - 3.0, position[2] - 2.0]) < 1e-5);
        assert_eq!(placed.in_world(&front), placed);
    }
}
