//! Triangles ready to be evaluated at pixels.

use akrobat_model::{Material, TriMesh};

use super::light::CameraLights;
use super::shade::{LANES, Lanes, Shading, unit_normals};
use crate::srgb::SrgbTables;

/// A triangle that is seen somewhere.
pub(super) struct Surface<'a> {
    pub segment: u16,
    pub look: Look<'a>,
}

/// What a surface looks like.
pub(super) enum Look<'a> {
    /// Everywhere the same: sRGB, and a unit normal that faces the eye (camera frame).
    Uniform {
        rgb: [u8; 3],
        normal: [f32; 3],
    },
    Varying(Varying<'a>),
}

/// What is interpolated between a surface's corners.
pub(super) struct Varying<'a> {
    pub material: &'a Material,
    /// Where the mesh has texture coordinates.
    pub texture: Option<&'a image::RgbaImage>,
    /// `dot(p, gradient[i]) - offset[i]` is the weight of corner i + 1 at a point p of the plane, camera frame.
    gradient: [[f32; 3]; 2],
    offset: [f32; 2],
    /// Whether the normal is the same on the whole triangle.
    is_flat: bool,
    /// Normals of the corners, camera frame, of any length and side.
    normals: [[f32; 3]; 3],
    /// Texture coordinates of the corners.
    uvs: [[f32; 2]; 3],
}

impl<'a> Surface<'a> {
    /// The triangle that a value of [`super::visibility::Visibility::triangle`] stands for.
    #[inline(always)]
    fn new(shading: &Shading<'a>, value: u32) -> Self {
        let Shading { view, scene, clusters, visibility, lights, .. } = shading;
        let (drawn, index) = visibility.lookup(value);
        let instance = &clusters.instances[drawn.instance as usize];
        let cluster = &instance.mesh.clusters[drawn.cluster as usize];
        let triangle = instance.mesh.triangles[cluster.triangles.start + index];
        let mesh: &TriMesh = &instance.mesh.mesh;
        let body = &scene.bodies[instance.body];
        let material = &body.materials[instance.part];
        let camera_from_body = &view.camera_from_body[instance.body];
        let corners = mesh.triangles[triangle.source as usize].map(|vertex| vertex as usize);
        let p = triangle.corners.map(|corner| {
            let vertex = drawn.first_vertex as usize + usize::from(corner);
            visibility.position.each_ref().map(|axis| axis[vertex])
        });
        let exact = p.map(|p| p.map(f64::from));
        let (e1, e2) = (subtract(exact[1], exact[0]), subtract(exact[2], exact[0]));
        let normal = cross(e1, e2);
        let square = dot64(normal, normal);
        let inverse_square = if square > 0.0 { 1.0 / square } else { 0.0 };
        let (is_flat, normals) = if mesh.normals.len() == mesh.positions.len() {
            let [a, b, c] = corners.map(|vertex| mesh.normals[vertex]);
            (a == b && a == c, [a, b, c].map(|n| camera_from_body.rotate(n)))
        } else {
            let scale = inverse_square.sqrt();
            (true, [normal.map(|c| (c * scale) as f32); 3])
        };
        let has_uvs = mesh.uvs.len() == mesh.positions.len();
        let texture = material.base_color_texture.as_deref().filter(|t| has_uvs && !t.is_empty());
        let uniform = match texture {
            None if is_flat => uniform(shading.srgb, lights, material, normals[0], &p),
            _ => None,
        };
        let varying = || {
            let gradient =
                [cross(e2, normal), cross(normal, e1)].map(|g| g.map(|c| c * inverse_square));
            Varying {
                material,
                texture,
                gradient: gradient.map(|g| g.map(|c| c as f32)),
                offset: gradient.map(|g| dot64(g, exact[0]) as f32),
                is_flat,
                normals,
                uvs: if texture.is_some() { corners.map(|v| mesh.uvs[v]) } else { [[0.0; 2]; 3] },
            }
        };
        Self { segment: body.segment_id, look: uniform.unwrap_or_else(|| Look::Varying(varying())) }
    }
}

/// The look of a triangle without texture whose normal is the same all over, where light depends on nothing else and all of
/// it is seen from the same side of that normal.
#[inline(always)]
fn uniform<'a>(
    srgb: &SrgbTables,
    lights: &CameraLights<'_>,
    material: &Material,
    normal: [f32; 3],
    corners: &[[f32; 3]; 3],
) -> Option<Look<'a>> {
    let directions = lights.directions.as_ref()?;
    let is_behind = corners.map(|p| normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] > 0.0);
    if is_behind[0] != is_behind[1] || is_behind[0] != is_behind[2] {
        return None;
    }
    let normal = unit_normals(normal.map(|c| [c]), [is_behind[0]]);
    let [red, green, blue, _] = material.base_color.map(|c| [c]);
    let color = lights.diffused(&[red, green, blue], &normal, directions);
    let rgb = color.map(|channel| srgb.encode(channel[0]));
    Some(Look::Uniform { rgb, normal: normal.map(|[c]| c) })
}

impl Varying<'_> {
    /// Weights of the corners at points of the plane, kept within the triangle.
    #[inline(always)]
    pub fn weights(&self, ray_x: &Lanes, ray_y: f32, depth: &Lanes) -> [Lanes; 3] {
        let mut weights = [[0.0; LANES]; 3];
        let [g, h] = self.gradient;
        // The rays of a row differ in x alone.
        let [g_yz, h_yz] = [g, h].map(|gradient| gradient[1] * ray_y + gradient[2]);
        let [g_0, h_0] = self.offset;
        for i in 0..LANES {
            let second = within((ray_x[i] * g[0] + g_yz) * depth[i] - g_0, 1.0);
            let third = within((ray_x[i] * h[0] + h_yz) * depth[i] - h_0, 1.0 - second);
            weights[0][i] = 1.0 - second - third;
            weights[1][i] = second;
            weights[2][i] = third;
        }
        weights
    }

    /// Normals, camera frame, of any length and side.
    #[inline(always)]
    pub fn normal(&self, weights: &[Lanes; 3]) -> [Lanes; 3] {
        if self.is_flat {
            return self.normals[0].map(|c| [c; LANES]);
        }
        std::array::from_fn(|axis| mix(self.normals.map(|normal| normal[axis]), weights))
    }

    /// Texture coordinates.
    #[inline(always)]
    pub fn uv(&self, weights: &[Lanes; 3]) -> [Lanes; 2] {
        std::array::from_fn(|axis| mix(self.uvs.map(|uv| uv[axis]), weights))
    }
}

/// Surfaces that were looked up last: neighbouring rows mostly show the same.
pub(super) struct Surfaces<'a> {
    kept: Vec<(u32, Option<Surface<'a>>)>,
}

impl<'a> Surfaces<'a> {
    /// A power of two.
    const COUNT: u32 = 256;

    pub fn new() -> Self {
        Self { kept: (0..Self::COUNT).map(|_| (0, None)).collect() }
    }

    /// The triangle that a value of [`super::visibility::Visibility::triangle`] stands for.
    #[inline(always)]
    pub fn get(&mut self, shading: &Shading<'a>, value: u32) -> &Surface<'a> {
        let place = value.wrapping_mul(0x9E37_79B1) >> (u32::BITS - Self::COUNT.ilog2());
        let (kept, surface) = &mut self.kept[place as usize];
        if *kept != value {
            *kept = value;
            *surface = None;
        }
        match surface {
            Some(surface) => surface,
            None => surface.insert(Surface::new(shading, value)),
        }
    }
}

/// A value kept from 0 to `most`; 0 for what is not a number.
#[inline(always)]
fn within(value: f32, most: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < most { value } else { most }
}

/// Values of three corners, weighted.
#[inline(always)]
fn mix(values: [f32; 3], weights: &[Lanes; 3]) -> Lanes {
    let mut mixed = [0.0; LANES];
    for i in 0..LANES {
        mixed[i] =
            values[0] * weights[0][i] + values[1] * weights[1][i] + values[2] * weights[2][i];
    }
    mixed
}

#[inline(always)]
fn dot64(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
