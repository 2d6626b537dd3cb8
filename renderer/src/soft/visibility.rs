//! Finds the nearest triangle of every pixel.

use super::clip::{Corner, clip};
use super::occlusion::TileDepths;
use super::raster::{GridTriangle, InverseDepth, LANES, Target, draw, pixel_box};
use super::view::{GUARD, SUBPIXELS, Transform, View};
use crate::clusters::{CLUSTER_TRIANGLES, Cluster, ClusteredMesh, ClusteredScene, Sphere};

/// A cluster that was drawn: where ids and vertices lead.
#[derive(Debug, Clone, Copy)]
pub(super) struct DrawnCluster {
    pub instance: u32,
    pub cluster: u32,
    /// Its first vertex in [`Visibility::position`].
    pub first_vertex: u32,
}

/// A cluster that may be in the image.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    instance: u32,
    cluster: u32,
    sphere: Sphere,
}

impl Candidate {
    /// Nearest first; equal ones in the order of the scene.
    fn key(&self) -> (u32, u32, u32) {
        let nearest = (self.sphere.center[2] - self.sphere.radius).max(0.0);
        (nearest.to_bits(), self.instance, self.cluster)
    }
}

/// What the visibility pass finds, with its buffers.
#[derive(Debug, Default)]
pub(super) struct Visibility {
    /// 1 / z per pixel, per metre; rows of [`View::stride`], and a few more.
    pub inverse_depth: Vec<f32>,
    /// 0, or one more than the id of the nearest triangle; see [`Visibility::lookup`].
    pub triangle: Vec<u32>,
    pub drawn: Vec<DrawnCluster>,
    /// Camera-frame x, y, z of the drawn clusters' vertices, metres.
    pub position: [Vec<f32>; 3],
    candidates: Vec<Candidate>,
    projected: Projected,
    tiles: TileDepths,
}

/// The vertices of the cluster at hand in the image.
#[derive(Debug, Default)]
struct Projected {
    inverse_z: Vec<f32>,
    /// Place on the fixed-point grid; meaningless for vertices that do not pass [`is_safe`].
    grid: Vec<[i32; 2]>,
}

impl Visibility {
    /// The cluster drawn and the triangle in it that a value of [`Visibility::triangle`] stands for.
    #[inline(always)]
    pub fn lookup(&self, value: u32) -> (DrawnCluster, usize) {
        let id = (value - 1) as usize;
        (self.drawn[id / CLUSTER_TRIANGLES], id % CLUSTER_TRIANGLES)
    }

    /// Fills the buffers for a view of a scene.
    pub fn find(&mut self, view: &View, scene: &ClusteredScene) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { self.find_avx2(view, scene) };
            return;
        }
        self.find_inline(view, scene);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn find_avx2(&mut self, view: &View, scene: &ClusteredScene) {
        self.find_inline(view, scene);
    }

    #[inline(always)]
    fn find_inline(&mut self, view: &View, scene: &ClusteredScene) {
        self.reset(view);
        self.collect(view, scene);
        for index in 0..self.candidates.len() {
            let candidate = self.candidates[index];
            let covered = view.pixel_box(&candidate.sphere);
            if let Some(covered) = covered {
                // Slightly nearer than the sphere, so that rounding cannot hide anything.
                let nearest = 1.0001 / (candidate.sphere.center[2] - candidate.sphere.radius);
                if self.tiles.hides(covered, nearest, &self.inverse_depth, view) {
                    continue;
                }
            }
            self.draw_cluster(view, scene, candidate);
            let everything = [0, 0, view.width - 1, view.height - 1];
            self.tiles.touch(covered.unwrap_or(everything));
        }
    }

    fn reset(&mut self, view: &View) {
        let pixels = view.stride * view.height + LANES;
        self.inverse_depth.clear();
        self.inverse_depth.resize(pixels, 1.0 / view.far);
        self.triangle.clear();
        self.triangle.resize(pixels, 0);
        self.drawn.clear();
        self.position.iter_mut().for_each(Vec::clear);
        self.tiles.reset(view);
    }

    /// Gathers the clusters that may be in the image, nearest first.
    #[inline(always)]
    fn collect(&mut self, view: &View, scene: &ClusteredScene) {
        self.candidates.clear();
        for (instance, placed) in scene.instances.iter().enumerate() {
            let mesh_sphere = view.sphere(placed.body, &placed.mesh.sphere);
            if !view.shown[placed.body] || !view.may_see(&mesh_sphere) {
                continue;
            }
            for (index, cluster) in placed.mesh.clusters.iter().enumerate() {
                let sphere = view.sphere(placed.body, &cluster.sphere);
                if view.may_see(&sphere) {
                    let (instance, cluster) = (instance as u32, index as u32);
                    self.candidates.push(Candidate { instance, cluster, sphere });
                }
            }
        }
        self.candidates.sort_unstable_by_key(Candidate::key);
    }

    #[inline(always)]
    fn draw_cluster(&mut self, view: &View, scene: &ClusteredScene, candidate: Candidate) {
        let placed = &scene.instances[candidate.instance as usize];
        let cluster = &placed.mesh.clusters[candidate.cluster as usize];
        let first_vertex = self.position[0].len();
        let transform = &view.camera_from_body[placed.body];
        let all_safe = self.transform(view, transform, &placed.mesh, cluster);

        let first_id = (self.drawn.len() * CLUSTER_TRIANGLES) as u32 + 1;
        self.drawn.push(DrawnCluster {
            instance: candidate.instance,
            cluster: candidate.cluster,
            first_vertex: first_vertex as u32,
        });
        let Self { inverse_depth, triangle, position, projected, .. } = self;
        let mut target = Target {
            width: view.width as i32,
            height: view.height as i32,
            stride: view.stride,
            inverse_depth,
            triangle,
        };
        let [x, y, z] = position.each_ref().map(|axis| &axis[first_vertex..]);
        let at = |corner: u16| [x, y, z].map(|axis| axis[usize::from(corner)]);
        let grid_at = |c: u16| projected.grid[usize::from(c)];
        let triangles = &placed.mesh.triangles[cluster.triangles.clone()];
        for (id, triangle) in (first_id..).zip(triangles) {
            let corners = triangle.corners;
            let inverse_z = || corners.map(|corner| projected.inverse_z[usize::from(corner)]);
            if all_safe || corners.iter().all(|&corner| is_safe(view, at(corner))) {
                let grid = corners.map(grid_at);
                if let Some(bounds) = pixel_box(&grid, target.width, target.height) {
                    let depth = || plane(view, corners.map(at), inverse_z());
                    draw(&mut target, &grid, bounds, id, depth);
                }
            } else {
                let clipped = corners.map(|corner| {
                    let position = at(corner);
                    let grid = is_safe(view, position).then(|| grid_at(corner));
                    Corner { position: position.map(f64::from), grid }
                });
                draw_clipped(&mut target, view, clipped, id, corners.map(at));
            }
        }
    }

    /// Places the cluster's vertices in the camera frame and on the grid. True where all may be used
    /// without clipping.
    #[inline(always)]
    fn transform(
        &mut self,
        view: &View,
        transform: &Transform,
        mesh: &ClusteredMesh,
        cluster: &Cluster,
    ) -> bool {
        let count = cluster.vertices.len();
        let first = self.position[0].len();
        let [px, py, pz] = mesh.positions.each_ref().map(|axis| &axis[cluster.vertices.clone()]);
        let [x, y, z] = self.position.each_mut().map(|axis| {
            axis.resize(first + count, 0.0);
            &mut axis[first..]
        });
        if self.projected.grid.len() < count {
            self.projected.inverse_z.resize(count, 0.0);
            self.projected.grid.resize(count, [0; 2]);
        }
        let inverse_z = &mut self.projected.inverse_z[..count];
        let places = &mut self.projected.grid[..count];
        let ([px, py, pz], [x, y, z]) = (
            [&px[..count], &py[..count], &pz[..count]],
            [&mut x[..count], &mut y[..count], &mut z[..count]],
        );
        let grid = GridScale::new(view);
        let mut unsafe_vertices = 0u32;
        for i in 0..count {
            let p = transform.apply([px[i], py[i], pz[i]]);
            let (u, v) = grid.place(p);
            x[i] = p[0];
            y[i] = p[1];
            z[i] = p[2];
            inverse_z[i] = 1.0 / p[2];
            places[i] = [snap(u), snap(v)];
            unsafe_vertices |= u32::from(!within(view, p[2], u, v));
        }
        unsafe_vertices == 0
    }
}

/// From camera-frame points to the fixed-point grid.
#[derive(Clone, Copy)]
struct GridScale {
    focal: [f32; 2],
    center: [f32; 2],
}

impl GridScale {
    #[inline(always)]
    fn new(view: &View) -> Self {
        let scale = f64::from(SUBPIXELS);
        Self {
            focal: view.focal.map(|f| (f * scale) as f32),
            center: view.center.map(|c| (c * scale) as f32),
        }
    }

    #[inline(always)]
    fn place(&self, p: [f32; 3]) -> (f32, f32) {
        let inverse_z = 1.0 / p[2];
        (
            p[0] * inverse_z * self.focal[0] + self.center[0],
            p[1] * inverse_z * self.focal[1] + self.center[1],
        )
    }
}

/// Nearest integer of a value within ±2^22, by the rounding of an addition: unlike a cast it is one
/// instruction per lane on every processor.
#[inline(always)]
fn snap(value: f32) -> i32 {
    const SHIFT: f32 = 12_582_912.0; // 1.5 * 2^23: numbers from here on are spaced by one
    (value + SHIFT).to_bits().wrapping_sub(SHIFT.to_bits()) as i32
}

#[inline(always)]
fn within(view: &View, z: f32, u: f32, v: f32) -> bool {
    (z >= view.near) & (u.abs() < GUARD) & (v.abs() < GUARD)
}

/// True for camera-frame points that the grid can hold.
#[inline(always)]
fn is_safe(view: &View, p: [f32; 3]) -> bool {
    let (u, v) = GridScale::new(view).place(p);
    within(view, p[2], u, v)
}

/// Inverse depth over the image of the plane through three camera-frame points; `None` where the plane goes
/// through the eye. With normal n and offset d = n . p, the ray r = ((u - cx) / fx, (v - cy) / fy, 1)
/// meets the plane at 1 / z = n . r / d, which is linear in u and v.
#[inline(always)]
fn plane(view: &View, p: [[f32; 3]; 3], inverse_z: [f32; 3]) -> Option<InverseDepth> {
    let normal = cross(subtract(p[1], p[0]), subtract(p[2], p[0])).map(f64::from);
    let d = (0..3).map(|i| normal[i] * f64::from(p[0][i])).sum::<f64>();
    if d == 0.0 {
        return None;
    }
    let inverse_d = 1.0 / d;
    let a = normal[0] * inverse_d / view.focal[0];
    let b = normal[1] * inverse_d / view.focal[1];
    let c = normal[2] * inverse_d - a * (view.center[0] - 0.5) - b * (view.center[1] - 0.5);
    let [i, j, k] = inverse_z;
    Some(InverseDepth { a, b, c, smallest: i.min(j).min(k), largest: i.max(j).max(k) })
}

#[cold]
#[inline(never)]
fn draw_clipped(
    target: &mut Target<'_>,
    view: &View,
    corners: [Corner; 3],
    id: u32,
    p: [[f32; 3]; 3],
) {
    // A corner before the near plane leaves no corner nearer than the plane itself.
    let inverse_z = p.map(|p| 1.0 / p[2].max(view.near));
    clip(view, corners, |grid: &GridTriangle| {
        if let Some(bounds) = pixel_box(grid, target.width, target.height) {
            draw(target, grid, bounds, id, || plane(view, p, inverse_z));
        }
    });
}

#[inline(always)]
pub(super) fn subtract(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

#[inline(always)]
pub(super) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
