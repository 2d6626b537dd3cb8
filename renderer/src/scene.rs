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
//! the top row, coordinates interpolated perspective-correctly. Alpha has no effect.
//!
//! **Normal** `n` (unit, world frame): the interpolated and renormalised vertex normal where the mesh
//! has normals, else that of the triangle's plane; negated where it points away from the camera
//! (`n . (eye - point) < 0`).
//!
//! **Light** comes from the [`Lighting`]: ambient `A(n) = ground + (sky - ground) * (1 + n.z) / 2`, and from each light
//! `L = rgb * fall * visible` from the direction `l`. `fall` is 1 for directional lights and `1 / distance^2` for the
//! others; for spots it is also times the smoothstep of the cosine from the outer to the inner angle. `visible` is 0 where a caster
//! of the light's lies between point and light, else 1; backends find it by shadow maps of
//! [`Lighting::shadow_map_pixels`], sampled bilinearly 2 texels off the surface, and treat directional
//! lights as 2 km away for it. There is neither reflected nor refracted light between surfaces.
//!
//! **Colour** (linear) is, with Lambert reflection, `albedo * (A(n) + sum of L * max(0, n . l))` per channel. With PBR
//! it is `diffuse * A(n) + specular * A(m) + sum of pi * f(l) * L * max(0, n . l)`, with glTF 2.0's metallic-roughness
//! reflectance `f` (roughness at least 0.05), `diffuse = albedo * (1 - metallic)`, Karis' approximation of the environment's
//! `specular` share, and `m` the eye's mirror direction blended with `n` by the roughness. It is clamped to 0..1,
//! encoded with the sRGB transfer function (IEC 61966-2-1) and rounded to the nearest of 256 levels.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use akrobat_cameras::SegmentLabel;
use akrobat_model::task::Task;
use akrobat_model::{Material, Part, Pose, Shape, TriMesh};
use nalgebra::Point3;

use crate::clusters::ClusteredScene;
use crate::front;
use crate::{Lighting, RenderError};

/// Which part of the world a body belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BodyGroup {
    /// A link of the robot.
    Robot,
    /// A link of the manipulated object.
    Object,
    /// A static body of the scene.
    Scene,
    /// A thing that was added to be in the way of the eye alone.
    Clutter,
}

impl BodyGroup {
    /// The name used in segment tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Object => "object",
            Self::Scene => "scene",
            Self::Clutter => "clutter",
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
    /// What each mesh is drawn with: its own material, or another.
    pub materials: Vec<Material>,
}

/// Everything that can be seen: robot links, object links and scene bodies that have geometry.
#[derive(Debug, Clone)]
pub struct RenderScene {
    /// Name for reports.
    pub name: String,
    /// The bodies, robot first, then object, then scene. Backends keep what they derive from them for as
    /// long as they are handed the same allocation ([`Arc::ptr_eq`]).
    pub bodies: Arc<[RenderBody]>,
    /// Light and background, all lights in the world's frame; free to change between frames.
    pub lighting: Lighting,
    /// The frame on the floor below the manipulated object, x out of its front: what lightings refer to.
    pub world_from_front: Pose,
    /// Poses of the clutter in the world, by [`RenderBody::index`].
    pub world_from_clutter: Arc<[Pose]>,
    /// The bodies' meshes in clusters, made when they are first needed and shared by clones.
    clusters: Arc<OnceLock<ClusteredScene>>,
    /// Clusters of the scene that this one was made from.
    base: Option<Arc<OnceLock<ClusteredScene>>>,
    /// A sphere around each body in its own frame, likewise.
    body_spheres: Arc<OnceLock<Vec<BodySphere>>>,
}

/// Centre and radius (metres); `None` for a body without vertices.
pub(crate) type BodySphere = Option<(Point3<f64>, f64)>;

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
        let mut scene = Self::new(name, bodies)?;
        scene.world_from_front = front::world_from_front(task);
        Ok(scene)
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
                let materials = meshes.iter().map(|mesh| mesh.material.clone()).collect();
                Some(RenderBody { group, name, class, segment_id, index, meshes, materials })
            });
        match numbered.collect::<Option<Arc<[RenderBody]>>>() {
            Some(bodies) => Ok(Self {
                name,
                bodies,
                lighting: Lighting::default(),
                world_from_front: Pose::identity(),
                world_from_clutter: Arc::default(),
                clusters: Arc::default(),
                base: None,
                body_spheres: Arc::default(),
            }),
            None => Err(RenderError::Scene {
                scene: name,
                message: format!("{count} bodies, but segment ids reach only to {}", u16::MAX),
            }),
        }
    }

    /// The same scene in another light, whose lights are placed at the object's front.
    pub fn lit_by(&self, lighting: &Lighting) -> Self {
        Self { lighting: lighting.in_world(&self.world_from_front), ..self.clone() }
    }

    /// The same scene with other shapes of the same bodies.
    pub(crate) fn with_bodies(&self, bodies: Arc<[RenderBody]>) -> Self {
        Self {
            bodies,
            clusters: Arc::default(),
            base: None,
            body_spheres: Arc::default(),
            ..self.clone()
        }
    }

    /// The same scene with more bodies, whose places are given by their indices; meshes that it has already are not
    /// prepared again.
    ///
    /// # Errors
    /// As [`RenderScene::from_task`].
    pub(crate) fn with_clutter(
        &self,
        clutter: Vec<UnnumberedBody>,
        world_from_clutter: Vec<Pose>,
    ) -> Result<Self, RenderError> {
        let own = self.bodies.iter().map(|body| {
            let RenderBody { group, name, class, index, meshes, .. } = body.clone();
            (group, name, class, index, meshes)
        });
        let mut scene = Self::new(self.name.clone(), own.chain(clutter).collect())?;
        scene.lighting = self.lighting.clone();
        scene.world_from_front = self.world_from_front;
        scene.world_from_clutter = world_from_clutter.into();
        // Made once here rather than for every scene that is derived.
        self.clusters();
        scene.base = Some(self.clusters.clone());
        Ok(scene)
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
        let known = self.base.as_ref().and_then(|clusters| clusters.get());
        self.clusters.get_or_init(|| ClusteredScene::new(&self.bodies, known))
    }

    /// A sphere around each body, in its own frame.
    pub(crate) fn body_spheres(&self) -> &[BodySphere] {
        self.body_spheres.get_or_init(|| self.bodies.iter().map(sphere_around).collect())
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.bodies.iter().flat_map(|body| &body.meshes).map(|mesh| mesh.triangles.len()).sum()
    }
}

/// The sphere around a body's bounding box.
fn sphere_around(body: &RenderBody) -> BodySphere {
    let corners = body
        .meshes
        .iter()
        .filter_map(|mesh| mesh.bounds())
        .filter(|(low, high)| low.iter().chain(high).all(|value| value.is_finite()));
    let (low, high) = corners
        .map(|(low, high)| (Point3::from(low).cast::<f64>(), Point3::from(high).cast::<f64>()))
        .reduce(|(low, high), (l, h)| (low.inf(&l), high.sup(&h)))?;
    Some((nalgebra::center(&low, &high), (high - low).norm() / 2.0))
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
