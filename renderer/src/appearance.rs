//! How an episode looks: lighting, surfaces and clutter, drawn at random from a [`Variation`] and kept as an
//! [`Appearance`], from which the same pictures can be made again.

use std::path::Path;
use std::sync::Arc;

use akrobat_model::pose::{from_xyz_wxyz, to_xyz_wxyz};
use akrobat_model::{Material, Part, Pose, Shape};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::lighting::{Environment, Light, LightingError};
use crate::raycast::first_hit;
use crate::scene::UnnumberedBody;
use crate::{BodyGroup, FrameState, Lighting, RenderError, RenderScene};

/// What is drawn at random for every episode (TOML). Whatever is left out stays as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Variation {
    /// Name for reports.
    pub name: String,
    /// Each light's strength, and that of the environment, are multiplied by a number from this range.
    #[serde(default = "unchanged")]
    pub light_strength: [f32; 2],
    /// Each channel of each light is multiplied by a number within this of 1.
    #[serde(default)]
    pub light_tint: f32,
    /// Positions of lights move by up to this along each axis, metres; directions turn by up to as many radians.
    #[serde(default)]
    pub light_shift: f32,
    /// Share of the scene's and the object's surfaces that get another colour.
    #[serde(default)]
    pub recolored: f32,
    /// Share of the textured or texturable ones (with texture coordinates) that get another texture.
    #[serde(default)]
    pub retextured: f32,
    /// Whether the background's colour is drawn.
    #[serde(default)]
    pub background: bool,
    /// Least and most things that are put where nothing happens.
    #[serde(default)]
    pub clutter: [u32; 2],
}

fn unchanged() -> [f32; 2] {
    [1.0; 2]
}

/// Built-in variations by name, as TOML.
const PRESETS: [(&str, &str); 2] = [
    ("mild", include_str!("../variations/mild.toml")),
    ("wild", include_str!("../variations/wild.toml")),
];

/// Most clutter of an episode.
const MOST_CLUTTER: u32 = 50;

/// Everything that makes an episode look as it does, besides its cameras.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearance {
    /// The light, in the world's frame.
    pub lighting: Lighting,
    /// Surfaces that do not look as their files say.
    #[serde(default)]
    pub surfaces: Vec<SurfaceChange>,
    /// Things that were put into the scene.
    #[serde(default)]
    pub clutter: Vec<Clutter>,
}

/// Another look of one mesh of a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceChange {
    /// `object` or `scene`.
    pub group: String,
    /// The body.
    pub body: String,
    /// Number of the mesh in it.
    pub mesh: usize,
    /// Linear RGB, times the texture where there is one.
    pub base_color: [f32; 3],
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// 0 mirror .. 1 matt.
    pub roughness: f32,
    /// A texture instead of the file's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<Pattern>,
}

/// A generated texture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pattern {
    /// What it shows.
    pub kind: PatternKind,
    /// Number of cells along each edge; even, where the colours are to alternate without a seam.
    pub cells: u32,
    /// The two sRGB colours between which it varies.
    pub colors: [[u8; 3]; 2],
    /// Seed of what is random in it.
    pub seed: u64,
}

/// Kinds of generated textures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PatternKind {
    /// Squares of two colours.
    Checker,
    /// Stripes of two colours.
    Stripes,
    /// Smooth random values.
    Noise,
}

/// Something that is only there to be seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clutter {
    /// What it is.
    pub shape: ClutterShape,
    /// Edge lengths of the box around it, metres; of a cylinder and a sphere the first and the last count.
    pub size_m: [f64; 3],
    /// Pose of its middle, `[x y z qw qx qy qz]`.
    pub world_from_clutter: [f64; 7],
    /// Linear RGB.
    pub base_color: [f32; 3],
    /// 0 mirror .. 1 matt.
    pub roughness: f32,
}

/// Shapes of clutter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClutterShape {
    /// A box.
    Box,
    /// An upright cylinder.
    Cylinder,
    /// A ball.
    Sphere,
}

impl Variation {
    /// The preset of this name, or the file where the name ends in `.toml` or holds a path.
    ///
    /// # Errors
    /// Any [`LightingError`]: variations are read like lightings.
    pub fn named(name: &str) -> Result<Self, LightingError> {
        let path = Path::new(name);
        if name.ends_with(".toml") || path.components().count() > 1 {
            let text = std::fs::read_to_string(path)
                .map_err(|source| LightingError::Read { path: name.to_owned(), source })?;
            return Self::from_toml(&text, name);
        }
        match PRESETS.iter().find(|(preset, _)| *preset == name) {
            Some((_, text)) => Self::from_toml(text, name),
            None => Err(LightingError::UnknownPreset {
                what: "variation",
                name: name.to_owned(),
                choices: PRESETS.iter().map(|(preset, _)| (*preset).to_owned()).collect(),
            }),
        }
    }

    /// Parses and checks a variation; `context` names the text in errors.
    ///
    /// # Errors
    /// [`LightingError::Syntax`] and [`LightingError::BadValue`].
    pub fn from_toml(text: &str, context: &str) -> Result<Self, LightingError> {
        let variation: Self = toml::from_str(text).map_err(|error| LightingError::Syntax {
            what: "variation",
            context: context.to_owned(),
            message: error.to_string().trim_end().to_owned(),
        })?;
        match variation.check() {
            Ok(()) => Ok(variation),
            Err((place, message)) => Err(LightingError::BadValue {
                context: context.to_owned(),
                place: place.to_owned(),
                message,
            }),
        }
    }

    fn check(&self) -> Result<(), (&'static str, String)> {
        let [low, high] = self.light_strength;
        if !(0.0 <= low && low <= high && high <= 100.0) {
            return Err((
                "light_strength",
                format!("expected 0 <= low <= high <= 100, got {low}, {high}"),
            ));
        }
        for (what, value) in [
            ("light_tint", self.light_tint),
            ("recolored", self.recolored),
            ("retextured", self.retextured),
        ] {
            if !(0.0..=1.0).contains(&value) {
                return Err((what, format!("expected 0 to 1, got {value}")));
            }
        }
        if !(0.0..=5.0).contains(&self.light_shift) {
            return Err(("light_shift", format!("expected 0 to 5, got {}", self.light_shift)));
        }
        let [least, most] = self.clutter;
        if least > most || most > MOST_CLUTTER {
            let message = format!("expected least <= most <= {MOST_CLUTTER}, got {least}, {most}");
            return Err(("clutter", message));
        }
        Ok(())
    }

    /// Draws an episode's appearance. It depends on the seed, the episode's identity and the scene alone.
    ///
    /// `keyframes` are some frames of the episode: clutter keeps away from where the robot and the object are then.
    pub fn draw(
        &self,
        scene: &RenderScene,
        keyframes: &[FrameState],
        seed: u64,
        episode: &str,
    ) -> Appearance {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ fnv1a(episode.as_bytes()));
        Appearance {
            lighting: self.draw_lighting(&scene.lighting, &mut rng),
            surfaces: self.draw_surfaces(scene, &mut rng),
            clutter: self.draw_clutter(scene, keyframes, &mut rng),
        }
    }

    fn draw_lighting(&self, lighting: &Lighting, rng: &mut ChaCha8Rng) -> Lighting {
        let mut lighting = lighting.clone();
        let vary = |rgb: &mut [f32; 3], rng: &mut ChaCha8Rng| {
            let strength = between(rng, self.light_strength);
            for channel in rgb {
                *channel *= strength * between(rng, [1.0 - self.light_tint, 1.0 + self.light_tint]);
            }
        };
        for light in &mut lighting.lights {
            vary(light.rgb_mut(), rng);
            let shift = self.light_shift;
            let moved: [f32; 3] = std::array::from_fn(|_| between(rng, [-shift, shift]));
            match light {
                Light::Point { position, .. } | Light::Spot { position, .. } => {
                    (0..3).for_each(|i| position[i] += moved[i]);
                }
                Light::Directional { direction, .. } => {
                    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(moved));
                    *direction = (turn * Vector3::from(*direction)).into();
                }
            }
        }
        match &mut lighting.environment {
            Environment::Constant { rgb } => vary(rgb, rng),
            Environment::Gradient { sky_rgb, ground_rgb } => {
                vary(sky_rgb, rng);
                vary(ground_rgb, rng);
            }
        }
        if self.background {
            lighting.background_rgb = std::array::from_fn(|_| rng.random_range(20..=235));
        }
        lighting
    }

    fn draw_surfaces(&self, scene: &RenderScene, rng: &mut ChaCha8Rng) -> Vec<SurfaceChange> {
        let mut changes = Vec::new();
        let varied = |group| matches!(group, BodyGroup::Object | BodyGroup::Scene);
        for body in scene.bodies.iter().filter(|body| varied(body.group)) {
            for (mesh, material) in body.materials.iter().enumerate() {
                let recolored = rng.random::<f32>() < self.recolored;
                let has_uvs = !body.meshes[mesh].uvs.is_empty();
                let retextured = rng.random::<f32>() < self.retextured && has_uvs;
                if !recolored && !retextured {
                    continue;
                }
                let [r, g, b, _] = material.base_color;
                let texture = retextured.then(|| Pattern {
                    kind: [PatternKind::Checker, PatternKind::Stripes, PatternKind::Noise]
                        [rng.random_range(0..3)],
                    cells: 2 * rng.random_range(1..=8),
                    colors: std::array::from_fn(|_| std::array::from_fn(|_| rng.random())),
                    seed: rng.random(),
                });
                changes.push(SurfaceChange {
                    group: body.group.name().to_owned(),
                    body: body.name.clone(),
                    mesh,
                    base_color: if recolored { color(rng) } else { [r, g, b] },
                    metallic: material.metallic,
                    roughness: if recolored {
                        between(rng, [0.2, 0.95])
                    } else {
                        material.roughness
                    },
                    texture,
                });
            }
        }
        changes
    }

    fn draw_clutter(
        &self,
        scene: &RenderScene,
        keyframes: &[FrameState],
        rng: &mut ChaCha8Rng,
    ) -> Vec<Clutter> {
        let wanted = rng.random_range(self.clutter[0]..=self.clutter[1]) as usize;
        let mut clutter = Vec::new();
        let Some(frame) = keyframes.first() else { return clutter };
        let busy: Vec<Point3<f64>> = keyframes
            .iter()
            .flat_map(|frame| {
                frame.world_from_robot_link.iter().chain(&frame.world_from_object_link)
            })
            .map(|pose| pose.translation.vector.into())
            .collect();
        for _ in 0..20 * wanted {
            if clutter.len() == wanted {
                break;
            }
            let shape = [ClutterShape::Box, ClutterShape::Cylinder, ClutterShape::Sphere]
                [rng.random_range(0..3)];
            let size_m: [f64; 3] = match shape {
                ClutterShape::Box => std::array::from_fn(|_| rng.random_range(0.05..0.3)),
                ClutterShape::Cylinder => {
                    let width = rng.random_range(0.05..0.2);
                    [width, width, rng.random_range(0.06..0.35)]
                }
                ClutterShape::Sphere => [rng.random_range(0.06..0.2); 3],
            };
            let place = Vector3::new(rng.random_range(-1.5..2.5), rng.random_range(-2.0..2.0), 0.0);
            let yaw = rng.random_range(0.0..std::f64::consts::TAU);
            let (base_color, roughness) = (color(rng), between(rng, [0.2, 0.95]));
            let under = scene.world_from_front * Point3::from(place);
            let Some(height) = support(scene, frame, &under) else { continue };
            let middle = Point3::new(under.x, under.y, height + 0.5 * size_m[2]);
            let is_free = |p: &Point3<f64>| (p - middle).norm() > CLEARANCE_M + 0.5 * size_m[2];
            if !busy.iter().all(is_free) {
                continue;
            }
            let pose = Pose::new(middle.coords, Vector3::z() * yaw);
            let world_from_clutter = to_xyz_wxyz(&pose).map(micro);
            let size_m = size_m.map(micro);
            clutter.push(Clutter { shape, size_m, world_from_clutter, base_color, roughness });
        }
        clutter
    }
}

/// Least distance of clutter from the origins of links, metres.
const CLEARANCE_M: f64 = 0.45;

/// Where things are let fall from, and the highest place they may come to rest on, metres.
const DROP_M: [f64; 2] = [2.2, 1.3];

/// Height on which a thing comes to rest above a point of the floor.
fn support(scene: &RenderScene, frame: &FrameState, under: &Point3<f64>) -> Option<f64> {
    let from = Point3::new(under.x, under.y, DROP_M[0]);
    let to = Point3::new(under.x, under.y, -0.1);
    let hit = first_hit(scene, &frame.world_from_body, &from, &to)?;
    let height = DROP_M[0] - hit;
    (height <= DROP_M[1]).then_some(height)
}

/// Rounds to six decimals, which every reader of the record takes for the same number.
fn micro(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn between(rng: &mut ChaCha8Rng, [low, high]: [f32; 2]) -> f32 {
    low + (high - low) * rng.random::<f32>()
}

fn color(rng: &mut ChaCha8Rng) -> [f32; 3] {
    std::array::from_fn(|_| between(rng, [0.03, 0.85]))
}

/// The FNV-1a hash (Fowler, Noll and Vo).
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

impl Appearance {
    /// Reads what an earlier run has recorded (JSON).
    ///
    /// # Errors
    /// Any [`LightingError`] but that about presets.
    pub fn load(path: &Path) -> Result<Self, LightingError> {
        let context = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| LightingError::Read { path: context.clone(), source })?;
        let appearance: Self = serde_json::from_str(&text).map_err(|e| LightingError::Syntax {
            what: "lighting",
            context: context.clone(),
            message: e.to_string(),
        })?;
        appearance.lighting.validate(&context)?;
        Ok(appearance)
    }

    /// The scene as it looks then. Meshes are shared with `scene`, and so is what backends derive from them.
    ///
    /// # Errors
    /// [`RenderError::Scene`] where a surface or a pose does not fit the scene.
    pub fn apply(&self, scene: &RenderScene) -> Result<RenderScene, RenderError> {
        let fail = |message: String| Err(RenderError::Scene { scene: scene.name.clone(), message });
        let mut added: Vec<UnnumberedBody> = Vec::new();
        let mut poses = Vec::new();
        for (index, clutter) in self.clutter.iter().enumerate() {
            let Some(pose) = from_xyz_wxyz(clutter.world_from_clutter) else {
                return fail(format!("clutter {index} has no valid pose"));
            };
            poses.push(pose);
            let name = format!("clutter_{index}");
            added.push((BodyGroup::Clutter, name, "clutter".into(), index, clutter.meshes()));
        }
        let mut varied = scene.with_clutter(added, poses)?;
        varied.lighting = self.lighting.clone();
        let mut bodies = varied.bodies.to_vec();
        for change in &self.surfaces {
            let body = bodies
                .iter_mut()
                .find(|body| body.group.name() == change.group && body.name == change.body);
            let Some(material) = body.and_then(|body| body.materials.get_mut(change.mesh)) else {
                let SurfaceChange { group, body, mesh, .. } = change;
                return fail(format!("there is no mesh {mesh} of {group} \"{body}\""));
            };
            let [r, g, b] = change.base_color;
            material.base_color = [r, g, b, 1.0];
            (material.metallic, material.roughness) = (change.metallic, change.roughness);
            if let Some(pattern) = &change.texture {
                material.base_color_texture = Some(Arc::new(pattern.image()));
            }
        }
        varied.bodies = bodies.into();
        Ok(varied)
    }
}

impl Clutter {
    fn meshes(&self) -> Vec<Arc<akrobat_model::TriMesh>> {
        let [x, y, z] = self.size_m;
        let shape = match self.shape {
            ClutterShape::Box => Shape::Box { size: [x, y, z] },
            ClutterShape::Cylinder => Shape::Cylinder { radius: 0.5 * x, length: z },
            ClutterShape::Sphere => Shape::Sphere { radius: 0.5 * x },
        };
        let [r, g, b] = self.base_color;
        let material = Material {
            name: "clutter".into(),
            base_color: [r, g, b, 1.0],
            roughness: self.roughness,
            ..Material::default()
        };
        let link_from_part = Pose::identity();
        let part = Part { name: "clutter".into(), link_from_part, shape, material: Some(material) };
        part.triangulate().into_iter().map(Arc::new).collect()
    }
}

/// Edge of generated textures, pixels.
const PATTERN_PIXELS: u32 = 128;

impl Pattern {
    /// The texture; it repeats without seams.
    pub fn image(&self) -> image::RgbaImage {
        let cells = self.cells.clamp(1, PATTERN_PIXELS);
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let lattice: Vec<f32> = (0..cells * cells).map(|_| rng.random()).collect();
        let value = |x: u32, y: u32| lattice[(y % cells * cells + x % cells) as usize];
        image::RgbaImage::from_fn(PATTERN_PIXELS, PATTERN_PIXELS, |u, v| {
            let [x, y] = [u, v].map(|p| (p * cells) as f32 / PATTERN_PIXELS as f32);
            let (column, row) = (x as u32, y as u32);
            let weight = match self.kind {
                PatternKind::Checker => ((column + row) % 2) as f32,
                PatternKind::Stripes => (column % 2) as f32,
                PatternKind::Noise => {
                    let [fx, fy] = [x.fract(), y.fract()].map(|t| t * t * (3.0 - 2.0 * t));
                    let along = |row| value(column, row) * (1.0 - fx) + value(column + 1, row) * fx;
                    along(row) * (1.0 - fy) + along(row + 1) * fy
                }
            };
            let [a, b] = self.colors;
            let mix = |i: usize| {
                (f32::from(a[i]) + (f32::from(b[i]) - f32::from(a[i])) * weight).round() as u8
            };
            image::Rgba([mix(0), mix(1), mix(2), 255])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_bad_values_are_refused() {
        for (name, _) in PRESETS {
            assert_eq!(Variation::named(name).unwrap().name, name);
        }
        let message = Variation::named("tame").unwrap_err().to_string();
        assert!(message.contains("tame") && message.contains("mild, wild"), "{message}");
        for (text, word) in [
            ("light_strength = [2, 1]", "light_strength"),
            ("recolored = 1.5", "recolored"),
            ("clutter = [0, 500]", "clutter"),
            ("colours = 1", "colours"),
        ] {
            let message = Variation::from_toml(&format!("name = \"x\"\n{text}"), "v.toml");
            let message = message.unwrap_err().to_string();
            assert!(message.contains("v.toml") && message.contains(word), "{message}");
        }
    }

    #[test]
    fn patterns_repeat_without_seams() {
        let pattern = |kind| Pattern { kind, cells: 4, colors: [[0; 3], [255; 3]], seed: 3 };
        let noise = pattern(PatternKind::Noise).image();
        let jump = |a: u32, b: u32| noise.get_pixel(a, 9)[0].abs_diff(noise.get_pixel(b, 9)[0]);
        assert!(jump(PATTERN_PIXELS - 1, 0) < 16);
        let checker = pattern(PatternKind::Checker).image();
        assert_ne!(checker.get_pixel(0, 0), checker.get_pixel(33, 0));
    }
}
