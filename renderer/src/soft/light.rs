//! Light on a point, in the camera's frame.

use akrobat_model::Pose;
use nalgebra::Point3;
use rayon::prelude::*;

use super::drawing::Drawing;
use super::view::{Transform, View};
use crate::clusters::ClusteredScene;
use crate::lighting::{Reflection, Source, WorldLight};
use crate::shadow::{self, BIAS_M, NORMAL_OFFSET_TEXELS};
use crate::{FrameState, Lighting, PlacedCamera, RenderScene};

/// A scene's lights with their shadow maps, for all cameras of a frame.
pub(super) struct SceneLights<'a> {
    lights: Vec<(WorldLight, Vec<ShadowMap<'a>>)>,
}

impl<'a> SceneLights<'a> {
    /// Draws the shadow maps. `drawings` are their buffers, in which what stays where it was is found again.
    pub fn new(
        scene: &RenderScene,
        clusters: &ClusteredScene,
        frame: &FrameState,
        drawings: &'a mut Vec<Drawing>,
    ) -> Self {
        let lights = WorldLight::all(&scene.lighting);
        let maps = shadow::light_maps(scene, frame, &lights);
        let count = maps.iter().flatten().map(|maps| maps.cameras.len()).sum();
        drawings.resize_with(count, Drawing::default);
        let all =
            maps.iter().flatten().flat_map(|maps| maps.cameras.iter().map(|c| (c, &maps.casters)));
        let all: Vec<_> = all.zip(drawings).collect();
        let draw =
            |((camera, casters), drawing): ((&PlacedCamera, &Vec<bool>), &'a mut Drawing)| {
                let rows = 0..camera.intrinsics.height as usize;
                let view = View::new(camera, &frame.world_from_body, rows);
                drawing.draw(&view, camera, scene, clusters, frame, casters);
                ShadowMap {
                    size: view.width,
                    stride: view.stride,
                    inverse_depth: &drawing.visibility().inverse_depth,
                    focal: view.focal[0] as f32,
                    world_from_light: camera.world_from_camera,
                }
            };
        let drawn: Vec<_> = all.into_par_iter().with_max_len(1).map(draw).collect();
        let mut drawn = drawn.into_iter();
        let of_light = |(light, maps): (WorldLight, Option<shadow::LightMaps>)| {
            let count = maps.map_or(0, |maps| maps.cameras.len());
            (light, drawn.by_ref().take(count).collect())
        };
        Self { lights: lights.into_iter().zip(maps).map(of_light).collect() }
    }
}

/// What a light sees.
struct ShadowMap<'a> {
    size: usize,
    stride: usize,
    inverse_depth: &'a [f32],
    /// Pixels.
    focal: f32,
    world_from_light: Pose,
}

/// Light in a camera's frame.
pub(super) struct CameraLights<'a> {
    reflection: Reflection,
    up: [f32; 3],
    middle_rgb: [f32; 3],
    half_difference_rgb: [f32; 3],
    lights: Vec<CameraLight<'a>>,
    /// Directions and colours of the lights where light depends on the normal alone.
    pub directions: Option<Vec<([f32; 3], [f32; 3])>>,
}

struct CameraLight<'a> {
    source: CameraSource,
    rgb: [f32; 3],
    maps: Vec<(&'a ShadowMap<'a>, Transform)>,
}

enum CameraSource {
    /// Unit vector to the light.
    Directional([f32; 3]),
    Point([f32; 3]),
    /// Position, axis, cosine of the outer angle, and the inverse of what it lacks to the inner one's.
    Spot([f32; 3], [f32; 3], f32, f32),
}

/// What reflects: linear RGB albedo, metallic, roughness.
#[derive(Clone, Copy)]
pub(super) struct Reflector {
    pub albedo: [f32; 3],
    pub metallic: f32,
    pub roughness: f32,
}

impl<'a> CameraLights<'a> {
    pub fn new(lighting: &Lighting, lights: &'a SceneLights<'a>, world_from_camera: &Pose) -> Self {
        let camera_from_world = world_from_camera.inverse();
        let rotate = |v: nalgebra::Vector3<f64>| -> [f32; 3] {
            (camera_from_world.rotation * v).cast::<f32>().into()
        };
        let place = |p: Point3<f64>| -> [f32; 3] { (camera_from_world * p).cast::<f32>().into() };
        let to_camera = |(light, maps): &'a (WorldLight, Vec<ShadowMap<'a>>)| CameraLight {
            source: match light.source {
                Source::Directional(to_light) => CameraSource::Directional(rotate(to_light)),
                Source::Point(position) => CameraSource::Point(place(position)),
                Source::Spot(position, axis, [inner, outer]) => CameraSource::Spot(
                    place(position),
                    rotate(axis),
                    outer as f32,
                    (1.0 / (inner - outer)) as f32,
                ),
            },
            rgb: light.rgb,
            maps: maps
                .iter()
                .map(|map| {
                    let light_from_camera = map.world_from_light.inverse() * world_from_camera;
                    (map, Transform::new(&light_from_camera))
                })
                .collect(),
        };
        let [sky, ground] = lighting.environment.sky_and_ground();
        let lights: Vec<CameraLight<'a>> = lights.lights.iter().map(to_camera).collect();
        let direction = |light: &CameraLight<'_>| match light.source {
            CameraSource::Directional(to_light) if light.maps.is_empty() => {
                Some((to_light, light.rgb))
            }
            _ => None,
        };
        let directions = lights.iter().map(direction).collect::<Option<Vec<_>>>();
        Self {
            reflection: lighting.reflection,
            up: rotate(nalgebra::Vector3::z()),
            middle_rgb: std::array::from_fn(|i| 0.5 * (ground[i] + sky[i])),
            half_difference_rgb: std::array::from_fn(|i| 0.5 * (sky[i] - ground[i])),
            directions: directions.filter(|_| lighting.reflection == Reflection::Lambert),
            lights,
        }
    }

    /// Ambient light on a surface whose unit normal has this cosine with the vertical.
    #[inline(always)]
    fn ambient(&self, upward: f32) -> [f32; 3] {
        std::array::from_fn(|i| self.middle_rgb[i] + self.half_difference_rgb[i] * upward)
    }

    /// Linear RGB that surfaces of this albedo with unit normals `n` send anywhere, where light depends on nothing else.
    #[inline(always)]
    pub fn diffused<const N: usize>(
        &self,
        albedo: &[[f32; N]; 3],
        n: &[[f32; N]; 3],
        directions: &[([f32; 3], [f32; 3])],
    ) -> [[f32; N]; 3] {
        let along = |to: &[f32; 3]| {
            let mut cosine = [0.0; N];
            for i in 0..N {
                cosine[i] = n[0][i] * to[0] + n[1][i] * to[1] + n[2][i] * to[2];
            }
            cosine
        };
        let upward = along(&self.up);
        let mut light = [[0.0; N]; 3];
        for channel in 0..3 {
            let (middle, half) = (self.middle_rgb[channel], self.half_difference_rgb[channel]);
            (0..N).for_each(|i| light[channel][i] = middle + half * upward[i]);
        }
        for (to_light, rgb) in directions {
            let facing = along(to_light).map(|cosine| if cosine > 0.0 { cosine } else { 0.0 });
            for channel in 0..3 {
                (0..N).for_each(|i| light[channel][i] += rgb[channel] * facing[i]);
            }
        }
        for channel in 0..3 {
            (0..N).for_each(|i| light[channel][i] *= albedo[channel][i]);
        }
        light
    }

    /// Whether light depends on what is elsewhere.
    pub fn has_shadows(&self) -> bool {
        self.lights.iter().any(|light| !light.maps.is_empty())
    }

    /// Linear RGB that a point `p` with unit normal `n`, which faces the eye, sends there.
    pub fn reflected(&self, surface: &Reflector, p: [f32; 3], n: [f32; 3]) -> [f32; 3] {
        let to_eye = normalized(p.map(|c| -c));
        let pbr = self.reflection == Reflection::Pbr;
        let optics = Optics::new(surface, dot(n, to_eye).max(1e-4));
        let upward = dot(n, self.up);
        let ambient = self.ambient(upward);
        let mut sum: [f32; 3] = if pbr {
            let mirrored = 2.0 * optics.cos_eye * upward - dot(to_eye, self.up);
            let seen = self.ambient(mirrored + (upward - mirrored) * surface.roughness);
            let share = optics.environment_share(surface.roughness);
            std::array::from_fn(|i| optics.diffuse[i] * ambient[i] + share[i] * seen[i])
        } else {
            std::array::from_fn(|i| surface.albedo[i] * ambient[i])
        };
        for light in &self.lights {
            let Some((to_light, strength)) = light.source.at(p) else { continue };
            let facing = dot(n, to_light);
            if facing <= 0.0 {
                continue;
            }
            let reaching = strength * facing * light.lit(p, n);
            if reaching <= 0.0 {
                continue;
            }
            let reflectance =
                if pbr { optics.reflectance(n, to_light, to_eye, facing) } else { surface.albedo };
            (0..3).for_each(|i| sum[i] += reflectance[i] * light.rgb[i] * reaching);
        }
        sum
    }
}

impl CameraSource {
    /// Unit vector to the light, and its strength; `None` where it does not shine.
    #[inline(always)]
    fn at(&self, p: [f32; 3]) -> Option<([f32; 3], f32)> {
        match self {
            Self::Directional(to_light) => Some((*to_light, 1.0)),
            Self::Point(position) | Self::Spot(position, ..) => {
                let way: [f32; 3] = std::array::from_fn(|i| position[i] - p[i]);
                let square = dot(way, way).max(1e-6);
                let to_light = way.map(|c| c / square.sqrt());
                let cone = match self {
                    Self::Spot(_, axis, outer, inverse_width) => {
                        let x = ((-dot(to_light, *axis) - outer) * inverse_width).clamp(0.0, 1.0);
                        x * x * (3.0 - 2.0 * x)
                    }
                    _ => 1.0,
                };
                (cone > 0.0).then_some((to_light, cone / square))
            }
        }
    }
}

impl CameraLight<'_> {
    /// How much of the light reaches a point: 1 all, 0 nothing.
    #[inline(always)]
    fn lit(&self, p: [f32; 3], n: [f32; 3]) -> f32 {
        for (map, light_from_camera) in &self.maps {
            let q = light_from_camera.apply(p);
            let half = 0.5 * map.size as f32;
            if q[2] <= 0.0 || q[0].abs().max(q[1].abs()) * map.focal > half * q[2] {
                continue;
            }
            let lift = NORMAL_OFFSET_TEXELS * q[2] / map.focal;
            let lifted = light_from_camera.rotate(n);
            let q: [f32; 3] = std::array::from_fn(|i| q[i] + lift * lifted[i]);
            return map.lit(q);
        }
        1.0
    }
}

impl ShadowMap<'_> {
    /// Share of the four texels around a point of the light's frame that do not hide it, weighted bilinearly (Reeves,
    /// Salesin and Cook, *Rendering Antialiased Shadows with Depth Maps*, SIGGRAPH 1987).
    #[inline(always)]
    fn lit(&self, q: [f32; 3]) -> f32 {
        let nearest = 1.0 / (q[2] - BIAS_M).max(1e-3);
        let half = 0.5 * self.size as f32;
        let last = self.size as f32 - 1.0;
        let place = |axis: usize| {
            let at = (q[axis] / q[2] * self.focal + half - 0.5).clamp(0.0, last);
            let low = at.floor();
            (low as usize, (low as usize + 1).min(self.size - 1), at - low)
        };
        let ((x0, x1, fx), (y0, y1, fy)) = (place(0), place(1));
        let open = |x: usize, y: usize| {
            f32::from(u8::from(self.inverse_depth[y * self.stride + x] <= nearest))
        };
        let top = open(x0, y0) + (open(x1, y0) - open(x0, y0)) * fx;
        let bottom = open(x0, y1) + (open(x1, y1) - open(x0, y1)) * fx;
        top + (bottom - top) * fy
    }
}

/// Metallic-roughness reflection (glTF 2.0, appendix B): Lambert and GGX (Walter et al., *Microfacet Models for
/// Refraction through Rough Surfaces*, EGSR 2007) with height-correlated masking (Heitz, *Understanding the
/// Masking-Shadowing Function*, JCGT 2014) and Schlick's Fresnel term.
struct Optics {
    diffuse: [f32; 3],
    /// Reflectance at normal incidence.
    f0: [f32; 3],
    square_alpha: f32,
    cos_eye: f32,
}

impl Optics {
    #[inline(always)]
    fn new(surface: &Reflector, cos_eye: f32) -> Self {
        let alpha = surface.roughness.max(0.05) * surface.roughness.max(0.05);
        let Reflector { albedo, metallic, .. } = surface;
        Self {
            diffuse: albedo.map(|c| c * (1.0 - metallic)),
            f0: albedo.map(|c| 0.04 + (c - 0.04) * metallic),
            square_alpha: alpha * alpha,
            cos_eye,
        }
    }

    /// Reflected share of light from the environment (Karis, *Physically Based Shading on Mobile*, 2014).
    #[inline(always)]
    fn environment_share(&self, roughness: f32) -> [f32; 3] {
        let x = 1.0 - roughness;
        let y = 0.0425 - 0.0275 * roughness;
        let z = 1.04 - 0.572 * roughness;
        let w = 0.022 * roughness - 0.04;
        let a004 = (x * x).min((-9.28 * self.cos_eye).exp2()) * x + y;
        let (scale, offset) = (z - 1.04 * a004, w + 1.04 * a004);
        self.f0.map(|f0| f0 * scale + offset)
    }

    /// pi times the reflectance for light from a unit vector.
    #[inline(always)]
    fn reflectance(
        &self,
        n: [f32; 3],
        to_light: [f32; 3],
        to_eye: [f32; 3],
        facing: f32,
    ) -> [f32; 3] {
        let half = normalized(std::array::from_fn(|i| to_light[i] + to_eye[i]));
        let (cos_half, cos_between) = (dot(n, half).max(0.0), dot(to_eye, half).max(0.0));
        let a2 = self.square_alpha;
        let spread = cos_half * cos_half * (a2 - 1.0) + 1.0;
        let masked = |cos_a: f32, cos_b: f32| cos_a * (cos_b * cos_b * (1.0 - a2) + a2).sqrt();
        let visible = 0.5 / (masked(facing, self.cos_eye) + masked(self.cos_eye, facing)).max(1e-6);
        let specular = a2 / (spread * spread) * visible;
        let grazing = (1.0 - cos_between).powi(5);
        std::array::from_fn(|i| {
            let fresnel = self.f0[i] + (1.0 - self.f0[i]) * grazing;
            self.diffuse[i] * (1.0 - fresnel) + fresnel * specular
        })
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn normalized(v: [f32; 3]) -> [f32; 3] {
    let square = dot(v, v);
    let scale = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
    v.map(|c| c * scale)
}
