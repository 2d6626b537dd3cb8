//! Finds the nearest triangle of every pixel.

use super::clip::{Corner, clip};
use super::occlusion::TileDepths;
use super::raster::{
    GridTriangle, InverseDepth, LANES, SMALL, Target, draw, draw_small, first_pixel, last_pixel,
};
use super::view::{GUARD, SUBPIXELS, Transform, View};
use crate::clusters::{
    CLUSTER_TRIANGLES, Cluster, ClusterTriangle, ClusteredMesh, ClusteredScene, Sphere,
};

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
#[derive(Debug, Clone, Default)]
pub(super) struct Visibility {
    /// 1 / z per pixel, per metre; rows of [`View::stride`], the view's first row first, and a few more.
    pub inverse_depth: Vec<f32>,
    /// 0, or one more than the id of the nearest triangle; see [`Visibility::lookup`].
    pub triangle: Vec<u32>,
    pub drawn: Vec<DrawnCluster>,
    /// Camera-frame x, y, z of the drawn clusters' vertices, metres.
    pub position: [Vec<f32>; 3],
    candidates: Vec<Candidate>,
    projected: Projected,
    boxes: PixelBoxes,
    tiles: TileDepths,
}

/// The vertices of the cluster at hand in the image.
#[derive(Debug, Clone, Default)]
struct Projected {
    inverse_z: Vec<f32>,
    /// Place on the fixed-point grid; meaningless for vertices that do not pass [`is_safe`].
    grid: Vec<[i32; 2]>,
}

impl Projected {
    /// Pixels `[x0, y0, x1, y1]` (inclusive) within the view that the first vertices span, and their largest inverse depth.
    #[inline(always)]
    fn extent(&self, count: usize, view: &View) -> (Option<[usize; 4]>, f32) {
        let (mut low, mut high) = ([[i32::MAX; 2]; LANES], [[i32::MIN; 2]; LANES]);
        let mut nearest = [0.0f32; LANES];
        // Vertices come in whole lanes.
        let vertices = self.grid[..count].as_chunks::<LANES>().0;
        for (places, depths) in vertices.iter().zip(self.inverse_z[..count].as_chunks::<LANES>().0)
        {
            for i in 0..LANES {
                for axis in 0..2 {
                    low[i][axis] = low[i][axis].min(places[i][axis]);
                    high[i][axis] = high[i][axis].max(places[i][axis]);
                }
                nearest[i] = if depths[i] > nearest[i] { depths[i] } else { nearest[i] };
            }
        }
        let low = low.into_iter().reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1])]).unwrap_or([0; 2]);
        let high =
            high.into_iter().reduce(|a, b| [a[0].max(b[0]), a[1].max(b[1])]).unwrap_or([0; 2]);
        let pixels = |axis: usize, from: usize, end: usize| {
            let first = first_pixel(low[axis]).max(from as i32);
            let last = last_pixel(high[axis]).min(end as i32 - 1);
            (first <= last).then_some((first as usize, last as usize))
        };
        let covered = pixels(0, 0, view.width).zip(pixels(1, view.rows.start, view.rows.end));
        let covered = covered.map(|((x0, x1), (y0, y1))| [x0, y0, x1, y1]);
        (covered, nearest.into_iter().fold(0.0, f32::max))
    }
}

/// Which triangles of a cluster have pixel centres in their bounding boxes: most are too small for any.
#[derive(Debug, Clone)]
struct PixelBoxes {
    /// x0, y0, x1, y1 (inclusive) of each triangle.
    pixels: [[i32; CLUSTER_TRIANGLES]; 4],
    /// Not zero for triangles within [`SMALL`].
    is_small: [i32; CLUSTER_TRIANGLES],
    /// Triangles with pixels, the first [`Self::count`].
    kept: [u8; CLUSTER_TRIANGLES],
    count: usize,
    /// Corners on the grid, axis by axis.
    corners: [[[i32; CLUSTER_TRIANGLES]; 2]; 3],
}

const _: () = assert!(CLUSTER_TRIANGLES <= 256, "a triangle's place must fit a byte");

impl Default for PixelBoxes {
    fn default() -> Self {
        Self {
            pixels: [[0; CLUSTER_TRIANGLES]; 4],
            is_small: [0; CLUSTER_TRIANGLES],
            kept: [0; CLUSTER_TRIANGLES],
            count: 0,
            corners: [[[0; CLUSTER_TRIANGLES]; 2]; 3],
        }
    }
}

impl PixelBoxes {
    #[inline(always)]
    fn find(&mut self, triangles: &[ClusterTriangle], grid: &[[i32; 2]], view: &View) {
        let Self { pixels, is_small, kept, count, corners } = self;
        for (place, triangle) in triangles.iter().enumerate() {
            for (corner, &vertex) in corners.iter_mut().zip(&triangle.corners) {
                let [x, y] = grid[usize::from(vertex)];
                corner[0][place] = x;
                corner[1][place] = y;
            }
        }
        let limits = [[0, view.width as i32], [view.rows.start as i32, view.rows.end as i32]];
        let whole = triangles.len().next_multiple_of(LANES).min(CLUSTER_TRIANGLES);
        is_small[..whole].fill(-1);
        let [a, b, c] = &*corners;
        let (first, last) = pixels.split_at_mut(2);
        for axis in 0..2 {
            let [from, end] = limits[axis];
            let (a, b, c) = (&a[axis][..whole], &b[axis][..whole], &c[axis][..whole]);
            let (first, last) = (&mut first[axis][..whole], &mut last[axis][..whole]);
            let is_small = &mut is_small[..whole];
            for i in 0..whole {
                let low = a[i].min(b[i]).min(c[i]);
                let high = a[i].max(b[i]).max(c[i]);
                first[i] = first_pixel(low).max(from);
                last[i] = last_pixel(high).min(end - 1);
                is_small[i] &= -i32::from(high - low <= SMALL[axis]);
            }
        }
        *count = 0;
        for i in 0..triangles.len() {
            kept[*count % CLUSTER_TRIANGLES] = i as u8;
            let is_kept = (first[0][i] <= last[0][i]) & (first[1][i] <= last[1][i]);
            *count += usize::from(is_kept);
        }
    }
}

/// The buffers as a place to draw.
#[inline(always)]
fn target<'a>(view: &View, inverse_depth: &'a mut [f32], triangle: &'a mut [u32]) -> Target<'a> {
    Target {
        width: view.width as i32,
        rows: [view.rows.start as i32, view.rows.end as i32],
        stride: view.stride,
        inverse_depth,
        triangle,
    }
}

impl Visibility {
    /// The cluster drawn and the triangle in it that a value of [`Visibility::triangle`] stands for.
    #[inline(always)]
    pub fn lookup(&self, value: u32) -> (DrawnCluster, usize) {
        let id = (value - 1) as usize;
        (self.drawn[id / CLUSTER_TRIANGLES], id % CLUSTER_TRIANGLES)
    }

    /// The largest value that [`Visibility::triangle`] can have so far.
    pub fn last_value(&self) -> u32 {
        (self.drawn.len() * CLUSTER_TRIANGLES) as u32
    }

    /// Takes over what another has drawn.
    pub fn copy_from(&mut self, other: &Self) {
        self.inverse_depth.clone_from(&other.inverse_depth);
        self.triangle.clone_from(&other.triangle);
        self.drawn.clone_from(&other.drawn);
        for (axis, other) in self.position.iter_mut().zip(&other.position) {
            axis.clone_from(other);
        }
        self.tiles.clone_from(&other.tiles);
    }

    /// Empties the buffers for a view.
    pub fn reset(&mut self, view: &View) {
        let pixels = view.stride * view.rows.len() + LANES;
        self.inverse_depth.clear();
        self.inverse_depth.resize(pixels, 1.0 / view.far);
        self.triangle.clear();
        self.triangle.resize(pixels, 0);
        self.drawn.clear();
        self.position.iter_mut().for_each(Vec::clear);
        self.tiles.reset(view);
    }

    /// Draws the bodies (by place) that are `shown` over what has been drawn since the last reset.
    pub fn draw(&mut self, view: &View, scene: &ClusteredScene, shown: &[bool]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { self.draw_avx2(view, scene, shown) };
            return;
        }
        self.draw_inline(view, scene, shown);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn draw_avx2(&mut self, view: &View, scene: &ClusteredScene, shown: &[bool]) {
        self.draw_inline(view, scene, shown);
    }

    #[inline(always)]
    fn draw_inline(&mut self, view: &View, scene: &ClusteredScene, shown: &[bool]) {
        self.collect(view, scene, shown);
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
        }
    }

    /// Gathers the clusters that may be in the image, nearest first.
    #[inline(always)]
    fn collect(&mut self, view: &View, scene: &ClusteredScene, shown: &[bool]) {
        self.candidates.clear();
        for (instance, placed) in scene.instances.iter().enumerate() {
            let mesh_sphere = view.sphere(placed.body, &placed.mesh.sphere);
            if !shown[placed.body] || !view.may_see(&mesh_sphere) {
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
        let mut touched = [0, view.rows.start, view.width - 1, view.rows.end - 1];
        if all_safe {
            // The vertices tell more closely than the sphere what the cluster can cover.
            let (covered, nearest) = self.projected.extent(cluster.vertices.len(), view);
            let seen = covered
                .filter(|&covered| !self.tiles.hides(covered, nearest, &self.inverse_depth, view));
            let Some(covered) = seen else {
                self.position.iter_mut().for_each(|axis| axis.truncate(first_vertex));
                return;
            };
            touched = covered;
        }
        let first_id = (self.drawn.len() * CLUSTER_TRIANGLES) as u32 + 1;
        self.drawn.push(DrawnCluster {
            instance: candidate.instance,
            cluster: candidate.cluster,
            first_vertex: first_vertex as u32,
        });
        let triangles = &placed.mesh.triangles[cluster.triangles.clone()];
        if all_safe {
            self.draw_triangles(view, triangles, first_vertex, first_id);
        } else {
            self.draw_with_clipping(view, triangles, first_vertex, first_id);
        }
        self.tiles.touch(touched);
    }

    /// Draws triangles whose corners are all on the grid.
    #[inline(always)]
    fn draw_triangles(
        &mut self,
        view: &View,
        triangles: &[ClusterTriangle],
        first_vertex: usize,
        first_id: u32,
    ) {
        let Self { inverse_depth, triangle, position, projected, boxes, tiles, .. } = self;
        let mut target = target(view, inverse_depth, triangle);
        let [x, y, z] = position.each_ref().map(|axis| &axis[first_vertex..]);
        let at = |corner: u16| [x, y, z].map(|axis| axis[usize::from(corner)]);
        boxes.find(triangles, &projected.grid, view);
        for &place in &boxes.kept[..boxes.count] {
            let place = usize::from(place);
            let corners = triangles[place].corners;
            let inverse_z = corners.map(|corner| projected.inverse_z[usize::from(corner)]);
            let largest = inverse_z[0].max(inverse_z[1]).max(inverse_z[2]);
            let grid = corners.map(|corner| projected.grid[usize::from(corner)]);
            let bounds = boxes.pixels.each_ref().map(|side| side[place]);
            let depth = || plane(view, corners.map(at), inverse_z);
            let id = first_id + place as u32;
            if boxes.is_small[place] != 0 {
                draw_small(&mut target, &grid, bounds, id, largest, depth);
            } else if !tiles.hides(bounds.map(|v| v as usize), largest, target.inverse_depth, view)
            {
                draw(&mut target, &grid, bounds, id, largest, depth);
            }
        }
    }

    /// Draws triangles some of which reach beyond the grid.
    #[inline(always)]
    fn draw_with_clipping(
        &mut self,
        view: &View,
        triangles: &[ClusterTriangle],
        first_vertex: usize,
        first_id: u32,
    ) {
        let Self { inverse_depth, triangle, position, projected, .. } = self;
        let mut target = target(view, inverse_depth, triangle);
        let [x, y, z] = position.each_ref().map(|axis| &axis[first_vertex..]);
        let at = |corner: u16| [x, y, z].map(|axis| axis[usize::from(corner)]);
        let grid_at = |c: u16| projected.grid[usize::from(c)];
        for (id, triangle) in (first_id..).zip(triangles) {
            let corners = triangle.corners;
            if corners.iter().all(|&corner| is_safe(view, at(corner))) {
                let grid = corners.map(grid_at);
                if let Some(bounds) = target.pixel_box(&grid) {
                    let inverse_z = corners.map(|corner| projected.inverse_z[usize::from(corner)]);
                    let largest = inverse_z[0].max(inverse_z[1]).max(inverse_z[2]);
                    let depth = || plane(view, corners.map(at), inverse_z);
                    draw(&mut target, &grid, bounds, id, largest, depth);
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
        if let Some(bounds) = target.pixel_box(grid) {
            let largest = inverse_z[0].max(inverse_z[1]).max(inverse_z[2]);
            draw(target, grid, bounds, id, largest, || plane(view, p, inverse_z));
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
