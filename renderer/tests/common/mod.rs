//! Small scenes for the backends' tests.

#![allow(dead_code, reason = "each test binary uses its own part")]

pub mod ray_tracer;

use std::sync::Arc;

use akrobat_cameras::{CameraFrame, Intrinsics};
use akrobat_model::{Material, Part, Pose, Shape, TriMesh};
use akrobat_renderer::{BodyGroup, FrameState, PlacedCamera, RenderScene};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Group, name, class, index and meshes.
type Body = (BodyGroup, String, String, usize, Vec<Arc<TriMesh>>);

/// Bodies and their poses.
#[derive(Default)]
pub struct World {
    bodies: Vec<Body>,
    poses: Vec<Pose>,
}

impl World {
    pub fn body(mut self, name: &str, meshes: Vec<TriMesh>, world_from_body: Pose) -> Self {
        let meshes = meshes.into_iter().map(Arc::new).collect();
        let index = self.bodies.len();
        self.bodies.push((BodyGroup::Scene, name.into(), "thing".into(), index, meshes));
        self.poses.push(world_from_body);
        self
    }

    /// A body of the manipulated object, which shadows tell from the scene.
    pub fn moving_body(mut self, name: &str, meshes: Vec<TriMesh>, world_from_body: Pose) -> Self {
        self = self.body(name, meshes, world_from_body);
        if let Some(body) = self.bodies.last_mut() {
            body.0 = BodyGroup::Object;
        }
        self
    }

    pub fn build(self) -> (RenderScene, FrameState) {
        let scene = RenderScene::new("test".into(), self.bodies).unwrap();
        (scene, FrameState::of_bodies(self.poses))
    }
}

pub fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::translation(x, y, z)
}

pub fn turned(pose: Pose, roll: f64, pitch: f64, yaw: f64) -> Pose {
    pose * UnitQuaternion::from_euler_angles(roll, pitch, yaw)
}

/// A tessellated primitive of one colour.
pub fn primitive(shape: Shape, rgb: [f32; 3]) -> Vec<TriMesh> {
    let [r, g, b] = rgb;
    let material = Material { base_color: [r, g, b, 1.0], ..Material::default() };
    let link_from_part = Pose::identity();
    let name = "part".to_owned();
    Part { name, link_from_part, shape, material: Some(material) }.triangulate()
}

/// A square of edge `2 * half` in the plane z = 0, with `repeats` of a texture along each edge.
pub fn textured_square(half: f32, repeats: f32, texture: image::RgbaImage) -> TriMesh {
    TriMesh {
        positions: [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|[x, y]| [half * x, half * y, 0.0])
            .into(),
        normals: vec![[0.0, 0.0, 1.0]; 4],
        uvs: [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
            .map(|uv| uv.map(|c| repeats * c))
            .into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material: Material {
            base_color: [1.0, 0.9, 0.8, 1.0],
            base_color_texture: Some(Arc::new(texture)),
            ..Material::default()
        },
    }
}

/// A texture without symmetries.
pub fn patterned_texture() -> image::RgbaImage {
    image::RgbaImage::from_fn(12, 8, |u, v| {
        let bright = if (u + v) % 2 == 0 { 255 } else { 40 };
        image::Rgba([bright, (20 * u) as u8, (30 * v) as u8, 255])
    })
}

/// A 320 x 240 camera at `eye` that looks at `target`, upright.
pub fn camera(name: &str, eye: [f64; 3], target: [f64; 3], focal_mm: f64) -> PlacedCamera {
    let [eye, target] = [eye, target].map(Point3::from);
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let rotation = Rotation3::from_basis_unchecked(&[right, down, forward]);
    PlacedCamera {
        name: name.into(),
        intrinsics: Intrinsics::from_focal_length(320, 240, focal_mm, 20.955),
        near_m: 0.01,
        far_m: 20.0,
        world_from_camera: Isometry3::from_parts(
            Translation3::from(eye.coords),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ),
        normals: false,
    }
}

/// Writes two images and the first one's silhouettes side by side into the folder
/// `$AKROBAT_TEST_IMAGES`, where it is set: to look at what was compared.
pub fn keep_images(name: &str, left: &CameraFrame, right: &CameraFrame) {
    let Some(folder) = std::env::var_os("AKROBAT_TEST_IMAGES") else { return };
    let (width, height) = (left.intrinsics.width, left.intrinsics.height);
    let inner = akrobat_renderer::compare::inner_pixels(left);
    let picture = image::RgbImage::from_fn(3 * width, height, |u, v| {
        let pixel = (v * width + u % width) as usize;
        let rgb = |frame: &CameraFrame| std::array::from_fn(|i| frame.rgb[3 * pixel + i]);
        image::Rgb(match u / width {
            0 => rgb(left),
            1 => rgb(right),
            _ => [if inner[pixel] { 255 } else { 0 }; 3],
        })
    });
    std::fs::create_dir_all(&folder).unwrap();
    picture.save(std::path::Path::new(&folder).join(format!("{name}.png"))).unwrap();
}
