//! What can be seen, and the image model that every backend follows.
//!
//! # The image model
//!
//! **Geometry.** Every triangle is opaque and visible from both sides. Pixel `(u, v)` shows what the
//! ray through its centre `(u + 0.5, v + 0.5)` meets first at a z-depth within
//! `[near_m, far_m]`; anything nearer than `near_m` is cut away. There is no anti-aliasing, so depth and
//! segmentation are exact at pixel centres. Depth is the z-depth in metres. Where nothing is met, depth
//! and segmentation are 0 and the colour is [`Lighting::background_rgb`].
//!
//! **Albedo** (linear RGB) is the material's `base_color`, times its texture where it has one and the
//! mesh has texture coordinates. Textures are sRGB, decoded per texel *before* filtering; filtering is
//! bilinear on the full-size image with repeat wrapping, texel centres at half-integer positions, `v = 0` on
//! the top row, coordinates interpolated perspective-correctly. Alpha, metallic and roughness have no effect.
//!
//! **Normal** `n` (unit, world frame): the interpolated and renormalised vertex normal where the mesh
//! has normals, else that of the triangle's plane; negated where it points away from the camera
//! (`n . (eye - point) < 0`).
//!
//! **Colour** (linear) is `albedo * (ground + (sky - ground) * (1 + n.z) / 2 + sun * max(0, n . l))`
//! per channel, with `l` the direction to the sun: Lambert reflection of one directional light and a
//! hemispherical ambient term, without shadows. It is clamped to 0..1, encoded with the sRGB transfer
//! function (IEC 61966-2-1) and rounded to the nearest of 256 levels.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use akrobat_cameras::SegmentLabel;
use akrobat_model::task::Task;
use akrobat_model::{Part, Shape, TriMesh};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::RenderError;
use crate::clusters::ClusteredScene;

/// Which part of the world a body belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BodyGroup {
    /// A link of the robot.
    Robot,
    /// A link of the manipulated object.
    Object,
    /// A static body of the scene.
    Scene,
}

impl BodyGroup {
    /// The name used in segment tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Object => "object",
            Self::Scene => "scene",
        }
    }
}

/// A rigid body with its geometry.
#[derive(Debug, Clone)]
pub struct RenderBody {
    /// What it belongs to.
    pub group: BodyGroup,
    /// Link's or scene body's name.
    pub name: String,
    /// Semantic class.
    pub class: String,
    /// Id in the segmentation images, from 1; the body's place in [`RenderScene::bodies`] plus one.
    pub segment_id: u16,
    /// Index of the link in its kinematic tree, or of the body in the scene.
    pub index: usize,
    /// Triangles in the frame of the link or scene body, metres; shared where the same file is used
    /// again in the same place.
    pub meshes: Vec<Arc<TriMesh>>,
}

/// Light and background. Colours are linear RGB.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Lighting {
    /// Direction from the ground to the sun in the world frame; need not be of unit length.
    pub sun_direction: [f32; 3],
    /// Light of the sun on a surface that faces it.
    pub sun_rgb: [f32; 3],
    /// Ambient light on a surface that faces up.
    pub sky_rgb: [f32; 3],
    /// Ambient light on a surface that faces down.
    pub ground_rgb: [f32; 3],
    /// sRGB colour (0..255) where nothing is seen.
    pub background_rgb: [u8; 3],
}

impl Default for Lighting {
    fn default() -> Self {
        Self {
            sun_direction: [0.35, 0.25, 0.9],
            sun_rgb: [0.55, 0.53, 0.5],
            sky_rgb: [0.5, 0.52, 0.55],
            ground_rgb: [0.28, 0.26, 0.24],
            background_rgb: [168, 184, 200],
        }
    }
}

impl Lighting {
    /// Unit direction to the sun; straight up where the direction given has no length.
    pub fn sun_unit(&self) -> [f32; 3] {
        let [x, y, z] = self.sun_direction;
        let norm = (x * x + y * y + z * z).sqrt();
        if norm > 0.0 && norm.is_finite() {
            [x / norm, y / norm, z / norm]
        } else {
            [0.0, 0.0, 1.0]
        }
    }
}

/// Everything that can be seen: robot links, object links and scene bodies that have geometry.
#[derive(Debug, Clone)]
pub struct RenderScene {
    /// Name for reports.
    pub name: String,
    /// The bodies, robot first, then object, then scene. Backends keep what they derive from them for as
    /// long as they are handed the same allocation ([`Arc::ptr_eq`]).
    pub bodies: Arc<[RenderBody]>,
    /// Light and background; free to change between frames.
    pub lighting: Lighting,
    /// The bodies' meshes in clusters, made when they are first needed and shared by clones.
    clusters: Arc<OnceLock<ClusteredScene>>,
}

/// Group, name, class, index in its tree or scene, and meshes in its own frame: a body without a segment id.
pub type UnnumberedBody = (BodyGroup, String, String, usize, Vec<Arc<TriMesh>>);

impl RenderScene {
    /// Collects and triangulates the visual geometry of a task. Links and bodies without any are left out.
    ///
    /// # Errors
    /// [`RenderError::Scene`] where there are more bodies than segment ids (65,535).
    pub fn from_task(task: &Task) -> Result<Self, RenderError> {
        let mut cache = MeshCache::default();
        let mut bodies = Vec::new();
        for (group, tree) in
            [(BodyGroup::Robot, &task.robot.tree), (BodyGroup::Object, &task.object.tree)]
        {
            for (index, link) in tree.links().iter().enumerate() {
                let class = match group {
                    BodyGroup::Robot => "robot".to_owned(),
                    _ => task.object.name.clone(),
                };
                let meshes = cache.meshes(&link.visuals);
                bodies.push((group, link.name.clone(), class, index, meshes));
            }
        }
        for (index, body) in task.scene.bodies.iter().enumerate() {
            let meshes = cache.meshes(&body.visuals);
            bodies.push((BodyGroup::Scene, body.name.clone(), body.class.clone(), index, meshes));
        }
        bodies.retain(|(.., meshes)| !meshes.is_empty());
        let name = format!("{} with {}", task.scene.name, task.object.name);
        Self::new(name, bodies)
    }

    /// A scene from bodies without segment ids, which are given in this order.
    ///
    /// # Errors
    /// As [`RenderScene::from_task`].
    pub fn new(name: String, bodies: Vec<UnnumberedBody>) -> Result<Self, RenderError> {
        let count = bodies.len();
        let numbered =
            bodies.into_iter().enumerate().map(|(place, (group, name, class, index, meshes))| {
                let segment_id = u16::try_from(place + 1).ok()?;
                Some(RenderBody { group, name, class, segment_id, index, meshes })
            });
        match numbered.collect::<Option<Arc<[RenderBody]>>>() {
            Some(bodies) => {
                Ok(Self { name, bodies, lighting: Lighting::default(), clusters: Arc::default() })
            }
            None => Err(RenderError::Scene {
                scene: name,
                message: format!("{count} bodies, but segment ids reach only to {}", u16::MAX),
            }),
        }
    }

    /// What the segment ids stand for.
    pub fn segment_labels(&self) -> Vec<SegmentLabel> {
        let label = |body: &RenderBody| SegmentLabel {
            id: body.segment_id,
            group: body.group.name().to_owned(),
            name: body.name.clone(),
            class: body.class.clone(),
        };
        self.bodies.iter().map(label).collect()
    }

    /// The meshes in clusters.
    pub(crate) fn clusters(&self) -> &ClusteredScene {
        self.clusters.get_or_init(|| ClusteredScene::new(&self.bodies))
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.bodies.iter().flat_map(|body| &body.meshes).map(|mesh| mesh.triangles.len()).sum()
    }
}

/// Triangulated parts, each kept once: a link's meshes that several parts share in the same place are
/// the same allocation.
#[derive(Default)]
struct MeshCache {
    by_file_and_place: HashMap<(usize, [u64; 7]), Vec<Arc<TriMesh>>>,
}

impl MeshCache {
    fn meshes(&mut self, parts: &[Part]) -> Vec<Arc<TriMesh>> {
        parts.iter().flat_map(|part| self.part(part)).collect()
    }

    fn part(&mut self, part: &Part) -> Vec<Arc<TriMesh>> {
        let triangulate = || {
            let meshes = part.triangulate().into_iter().filter(|mesh| !mesh.triangles.is_empty());
            meshes.map(Arc::new).collect()
        };
        match (&part.shape, &part.material) {
            (Shape::Mesh { meshes, .. }, None) => {
                let place = akrobat_model::pose::to_xyz_wxyz(&part.link_from_part);
                let key = (Arc::as_ptr(meshes) as usize, place.map(f64::to_bits));
                self.by_file_and_place.entry(key).or_insert_with(triangulate).clone()
            }
            _ => triangulate(),
        }
    }
}
