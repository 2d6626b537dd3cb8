//! Euclidean signed distance fields on a regular grid.
//!
//! Distances are exact (to the triangles) within [`EXACT_BAND`] voxels of a surface. Beyond,
//! they are exact to the triangle that is nearest to the nearest voxel on a surface, which the Euclidean
//! transform of Felzenszwalb and Huttenlocher (*Distance Transforms of Sampled Functions*, Theory of
//! Computing 8, 2012) finds; and beyond [`NEAR_VOXELS`], where nothing is decided by them, they are those between
//! voxels, less than one voxel off. Scenes are triangle soups, seldom closed: *inside* is therefore
//! every voxel that cannot be reached from a free seed point without crossing a surface.

use akrobat_model::TriMesh;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Width of the exact band around surfaces, in voxels.
const EXACT_BAND: f64 = 2.0;
/// Distance in voxels beyond which distances are those of the transform alone.
pub(crate) const NEAR_VOXELS: f32 = 12.0;
/// Half of a voxel's diagonal, and a tenth more for what interpolation adds, in voxels.
pub(crate) const HALF_DIAGONAL: f64 = 0.953;
/// Label of a voxel whose nearest triangle is not known.
const UNKNOWN: u32 = u32::MAX;

/// A grid of distances, metres; positive outside, negative inside.
#[derive(Debug, Clone)]
pub struct Esdf {
    /// Centre of voxel (0, 0, 0), metres.
    origin: Vector3<f64>,
    voxel_m: f64,
    /// Number of voxels along x, y, z.
    size: [usize; 3],
    /// x fastest.
    values: Vec<f32>,
}

/// Triangles in the frame of the field.
pub type Triangles = Vec<[Vector3<f64>; 3]>;

/// All triangles of `meshes`, transformed by `field_from_mesh`.
pub fn collect_triangles(
    meshes: &[TriMesh],
    field_from_mesh: &akrobat_model::Pose,
    out: &mut Triangles,
) {
    for mesh in meshes {
        let point = |p: [f32; 3]| {
            (field_from_mesh * nalgebra::Point3::from(Vector3::from(p).cast::<f64>())).coords
        };
        out.extend((0..mesh.triangles.len()).map(|t| mesh.corners(t).map(point)));
    }
}

impl Esdf {
    /// Builds the field of `triangles` on a grid that covers the box from `low` to `high`.
    ///
    /// With `free_seeds`, voxels that no seed reaches become negative; without, the field is unsigned.
    pub fn build(
        triangles: &[[Vector3<f64>; 3]],
        low: Vector3<f64>,
        high: Vector3<f64>,
        voxel_m: f64,
        free_seeds: &[Vector3<f64>],
    ) -> Self {
        let size =
            std::array::from_fn(|i| ((high[i] - low[i]) / voxel_m).ceil().max(1.0) as usize + 1);
        let mut field =
            Self { origin: low, voxel_m, size, values: vec![f32::INFINITY; size.iter().product()] };
        let nearest = field.rasterise(triangles);
        let (outside, columns) = rayon::join(
            || (!free_seeds.is_empty()).then(|| field.reachable(free_seeds)),
            || field.propagate(nearest),
        );
        field.fill(triangles, &columns);
        if let Some(outside) = outside {
            field.negate_unreachable(&outside);
        }
        field
    }

    /// A field without surfaces: `distance` everywhere.
    pub fn empty(distance: f64) -> Self {
        let values = vec![distance as f32; 8];
        Self { origin: Vector3::zeros(), voxel_m: 1.0, size: [2; 3], values }
    }

    /// Edge of a voxel, metres.
    pub fn voxel_m(&self) -> f64 {
        self.voxel_m
    }

    /// Number of voxels along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Lowest corner that is covered, metres.
    pub fn low(&self) -> Vector3<f64> {
        self.origin
    }

    /// Distances at the voxel centres, x fastest, then y, metres.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Writes unsigned squared-root-free exact distances into the band around every triangle. Gives
    /// the nearest triangle of each voxel of the band.
    fn rasterise(&mut self, triangles: &[[Vector3<f64>; 3]]) -> Vec<u32> {
        let mut nearest = vec![UNKNOWN; self.values.len()];
        let (origin, voxel, size) = (self.origin, self.voxel_m, self.size);
        let slab = size[0] * size[1];
        let band = EXACT_BAND * voxel;
        // Slabs of z are independent, so the result does not depend on the number of threads.
        let slabs_per_task = size[2].div_ceil(64).max(1);
        let tasks = self.by_slab(triangles, slabs_per_task, band);
        let chunks = self.values.par_chunks_mut(slab * slabs_per_task);
        let labels = nearest.par_chunks_mut(slab * slabs_per_task);
        chunks.zip(labels).zip(tasks).enumerate().for_each(|(task, ((chunk, labels), own))| {
            let first = task * slabs_per_task;
            let last = first + chunk.len() / slab - 1;
            for index in own {
                let triangle = &triangles[index as usize];
                let Some((from, to)) = self::voxels(triangle, band, origin, voxel, size) else {
                    continue;
                };
                let plane = TrianglePlane::new(triangle);
                for z in from[2].max(first)..=to[2].min(last) {
                    for y in from[1]..=to[1] {
                        let row = ((z - first) * size[1] + y) * size[0];
                        for x in from[0]..=to[0] {
                            let p = origin + Vector3::new(x as f64, y as f64, z as f64) * voxel;
                            let cell = &mut chunk[row + x];
                            // The plane is never farther than the triangle in it.
                            if plane.distance(&p) >= f64::from(*cell).min(band) {
                                continue;
                            }
                            let d = point_triangle_distance(&p, triangle) as f32;
                            if d < *cell && f64::from(d) <= band {
                                *cell = d;
                                labels[row + x] = index;
                            }
                        }
                    }
                }
            }
        });
        nearest
    }

    /// For each task of so many slabs of z, the triangles whose band reaches into it, in order.
    fn by_slab(
        &self,
        triangles: &[[Vector3<f64>; 3]],
        slabs_per_task: usize,
        band: f64,
    ) -> Vec<Vec<u32>> {
        let mut tasks = vec![Vec::new(); self.size[2].div_ceil(slabs_per_task)];
        for (triangle, index) in triangles.iter().zip(0u32..) {
            if let Some((from, to)) = voxels(triangle, band, self.origin, self.voxel_m, self.size) {
                for task in &mut tasks[from[2] / slabs_per_task..=to[2] / slabs_per_task] {
                    task.push(index);
                }
            }
        }
        tasks
    }

    /// Marks the voxels that can be reached from the seeds by face steps between voxels whose centres are
    /// at least 0.6 voxels from any surface (so that no wall is leapt over).
    fn reachable(&self, seeds: &[Vector3<f64>]) -> Vec<bool> {
        let [nx, ny, nz] = self.size;
        let wall = (0.6 * self.voxel_m) as f32;
        let mut open: Vec<bool> = self.values.par_iter().map(|&v| v > wall).collect();
        let mut seen = vec![false; self.values.len()];
        let mut stack: Vec<usize> = seeds.iter().filter_map(|s| self.nearest_voxel(s)).collect();
        // Whole runs along x at once: neighbouring rows get one seed for each of theirs.
        while let Some(index) = stack.pop() {
            if !open[index] {
                continue;
            }
            let row = index - index % nx;
            let first = (row..index).rev().take_while(|&i| open[i]).last().unwrap_or(index);
            let last = (index..row + nx).take_while(|&i| open[i]).last().unwrap_or(index);
            open[first..=last].fill(false);
            seen[first..=last].fill(true);
            let (y, z) = (row / nx % ny, row / (nx * ny));
            let rows = [
                (y > 0).then(|| row - nx),
                (y + 1 < ny).then(|| row + nx),
                (z > 0).then(|| row - nx * ny),
                (z + 1 < nz).then(|| row + nx * ny),
            ];
            for beside in rows.into_iter().flatten() {
                let mut inside = false;
                for i in beside + first - row..=beside + last - row {
                    if open[i] && !inside {
                        stack.push(i);
                    }
                    inside = open[i];
                }
            }
        }
        seen
    }

    fn nearest_voxel(&self, point: &Vector3<f64>) -> Option<usize> {
        let mut index = 0;
        for axis in (0..3).rev() {
            let coordinate = ((point[axis] - self.origin[axis]) / self.voxel_m).round();
            if coordinate < 0.0 || coordinate >= self.size[axis] as f64 {
                return None;
            }
            index = index * self.size[axis] + coordinate as usize;
        }
        Some(index)
    }

    /// Carries the nearest triangle of each voxel on a surface to all voxels that have no nearer one. Gives
    /// what is nearest to each voxel, z fastest, then x.
    fn propagate(&self, mut labels: Vec<u32>) -> Vec<Nearest> {
        let [nx, ny, nz] = self.size;
        let scale = 1.0 / self.voxel_m as f32;
        // Every point of a surface is this near to a voxel's centre.
        let on_surface = 3f32.sqrt() / 2.0;
        let seed = |&v: &f32| if v * scale <= on_surface { (v * scale).powi(2) } else { FAR };
        let mut squared: Vec<f32> = self.values.par_iter().map(seed).collect();
        squared.par_chunks_mut(nx).zip(labels.par_chunks_mut(nx)).for_each_init(
            || Envelope::new(nx),
            |envelope, (row, labels)| envelope.transform(row, labels),
        );
        squared.par_chunks_mut(nx * ny).zip(labels.par_chunks_mut(nx * ny)).for_each_init(
            || (Envelope::new(ny), vec![0.0; ny], vec![UNKNOWN; ny]),
            |(envelope, line, line_labels), (plane, labels)| {
                for x in 0..nx {
                    gather(plane, x, nx, line);
                    gather(labels, x, nx, line_labels);
                    envelope.transform(line, line_labels);
                    scatter(line, plane, x, nx);
                    scatter(line_labels, labels, x, nx);
                }
            },
        );
        // Lines along z are strided over the whole array: transposed plane by plane.
        let mut columns = vec![Nearest::UNKNOWN; labels.len()];
        columns.par_chunks_mut(nz * nx).enumerate().for_each_init(
            || (Envelope::new(nz), vec![0.0f32; nz], vec![UNKNOWN; nz]),
            |(envelope, line, line_labels), (y, plane)| {
                for (x, column) in plane.chunks_mut(nz).enumerate() {
                    for z in 0..nz {
                        let at = (z * ny + y) * nx + x;
                        (line[z], line_labels[z]) = (squared[at], labels[at]);
                    }
                    envelope.transform(line, line_labels);
                    for (z, nearest) in column.iter_mut().enumerate() {
                        *nearest = Nearest::new(line[z], line_labels[z]);
                    }
                }
            },
        );
        columns
    }

    /// Fills everything beyond the exact band with the distance to what is nearest.
    fn fill(&mut self, triangles: &[[Vector3<f64>; 3]], columns: &[Nearest]) {
        let [nx, ny, nz] = self.size;
        let (origin, voxel) = (self.origin, self.voxel_m);
        self.values.par_chunks_mut(nx * ny).enumerate().for_each(|(z, plane)| {
            for (y, row) in plane.chunks_mut(nx).enumerate() {
                for (x, value) in row.iter_mut().enumerate().filter(|(_, v)| !v.is_finite()) {
                    *value = match columns[(y * nx + x) * nz + z].get() {
                        Ok(distance) => distance * voxel as f32,
                        Err(label) => {
                            let p = origin + Vector3::new(x as f64, y as f64, z as f64) * voxel;
                            let triangle = triangles.get(label as usize);
                            triangle.map_or(FAR, |t| point_triangle_distance(&p, t) as f32)
                        }
                    };
                }
            }
        });
    }

    /// Makes unreachable voxels negative: the distance to the nearest reachable region, estimated by the
    /// distance to the nearest surface.
    fn negate_unreachable(&mut self, outside: &[bool]) {
        let wall = (0.6 * self.voxel_m) as f32;
        self.values.par_iter_mut().zip(outside).for_each(|(value, &outside)| {
            // Voxels on a surface are reached by no flood; they keep their small positive distance.
            if !outside && *value > wall {
                *value = -*value;
            }
        });
    }

    /// Trilinear distance at `point`, metres; outside the grid, the value at the nearest covered point.
    #[inline]
    pub fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.interpolate(point).0
    }

    /// True where the distance at `point` is surely at least `least`: one look at the nearest voxel, whose distance
    /// differs by no more than half a voxel's diagonal. False may mean either. Points outside the grid are looked up.
    #[inline]
    pub fn is_beyond(&self, point: &Vector3<f64>, least: f64) -> bool {
        let mut at = 0;
        for axis in (0..3).rev() {
            let coordinate = ((point[axis] - self.origin[axis]) / self.voxel_m + 0.5).max(0.0);
            let last = self.size[axis] - 1;
            at = at * self.size[axis] + (coordinate as usize).min(last);
        }
        let value = f64::from(self.values[at]);
        // Far values are up to a voxel too large.
        let far = if value > f64::from(NEAR_VOXELS) * self.voxel_m { 1.0 } else { 0.0 };
        // Of positive distances only: inside, they are estimates.
        value > least.max(0.0) + (HALF_DIAGONAL + far) * self.voxel_m
    }

    /// True where the distance at `point` is more than `least`.
    #[inline]
    pub fn exceeds(&self, point: &Vector3<f64>, least: f64) -> bool {
        self.is_beyond(point, least) || self.distance(point) > least
    }

    /// Trilinear distance and its gradient.
    #[inline]
    pub fn distance_and_gradient(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        self.interpolate(point)
    }

    #[inline]
    fn interpolate(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let inverse = 1.0 / self.voxel_m;
        let mut base = [0usize; 3];
        let mut f = [0.0; 3];
        let mut slope = Vector3::zeros();
        for axis in 0..3 {
            let top = (self.size[axis] - 1) as f64;
            let free = (point[axis] - self.origin[axis]) * inverse;
            let u = free.clamp(0.0, top - 1e-9);
            // Beyond the grid the value no longer changes along this axis.
            slope[axis] = if free == u { inverse } else { 0.0 };
            base[axis] = u as usize;
            f[axis] = u - base[axis] as f64;
        }
        let [nx, ny, _] = self.size;
        let at = (base[2] * ny + base[1]) * nx + base[0];
        let v = |offset: usize| f64::from(self.values[at + offset]);
        let (sy, sz) = (nx, nx * ny);
        let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let (c000, c100, c010, c110) = (v(0), v(1), v(sy), v(sy + 1));
        let (c001, c101, c011, c111) = (v(sz), v(sz + 1), v(sz + sy), v(sz + sy + 1));
        let (x00, x10) = (lerp(c000, c100, f[0]), lerp(c010, c110, f[0]));
        let (x01, x11) = (lerp(c001, c101, f[0]), lerp(c011, c111, f[0]));
        let (y0, y1) = (lerp(x00, x10, f[1]), lerp(x01, x11, f[1]));
        let dx =
            lerp(lerp(c100 - c000, c110 - c010, f[1]), lerp(c101 - c001, c111 - c011, f[1]), f[2]);
        let dy = lerp(x10 - x00, x11 - x01, f[2]);
        (lerp(y0, y1, f[2]), Vector3::new(dx, dy, y1 - y0).component_mul(&slope))
    }
}

/// First and last voxel along each axis within `band` of a triangle's box; `None` outside the grid.
fn voxels(
    triangle: &[Vector3<f64>; 3],
    band: f64,
    origin: Vector3<f64>,
    voxel_m: f64,
    size: [usize; 3],
) -> Option<([usize; 3], [usize; 3])> {
    let [a, b, c] = triangle;
    let (low, high) = (a.inf(b).inf(c), a.sup(b).sup(c));
    let (mut from, mut to) = ([0; 3], [0; 3]);
    for i in 0..3 {
        let first = ((low[i] - band - origin[i]) / voxel_m).ceil().max(0.0);
        let last = ((high[i] + band - origin[i]) / voxel_m).floor().min((size[i] - 1) as f64);
        if first > last {
            return None;
        }
        (from[i], to[i]) = (first as usize, last as usize);
    }
    Some((from, to))
}

/// The plane of a triangle; of a degenerate one, nothing.
struct TrianglePlane {
    normal: Vector3<f64>,
    offset: f64,
}

impl TrianglePlane {
    fn new([a, b, c]: &[Vector3<f64>; 3]) -> Self {
        let normal = (b - a).cross(&(c - a)).try_normalize(1e-12).unwrap_or_default();
        Self { offset: normal.dot(a), normal }
    }

    /// A lower bound of the distance to the triangle, metres.
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        (self.normal.dot(point) - self.offset).abs()
    }
}

/// Larger than any distance and any squared distance in voxels; finite, so that parabola intersections
/// stay numbers.
const FAR: f32 = 1e12;

fn gather<T: Copy>(plane: &[T], x: usize, stride: usize, line: &mut [T]) {
    for (y, value) in line.iter_mut().enumerate() {
        *value = plane[y * stride + x];
    }
}

fn scatter<T: Copy>(line: &[T], plane: &mut [T], x: usize, stride: usize) {
    for (y, value) in line.iter().enumerate() {
        plane[y * stride + x] = *value;
    }
}

/// What is known of a voxel after the transform, in the memory of one number: the distance where it is far,
/// the triangle where it is near.
#[derive(Debug, Clone, Copy)]
struct Nearest(u32);

impl Nearest {
    const UNKNOWN: Self = Self(UNKNOWN & !Self::DISTANCE);
    /// Set where the other bits are a distance in voxels; the sign bit of a number that is never negative.
    const DISTANCE: u32 = 1 << 31;

    fn new(squared: f32, label: u32) -> Self {
        if squared > NEAR_VOXELS * NEAR_VOXELS && squared < FAR {
            Self(squared.sqrt().to_bits() | Self::DISTANCE)
        } else {
            Self(label & !Self::DISTANCE)
        }
    }

    /// The distance in voxels, or else the triangle's label.
    fn get(self) -> Result<f32, u32> {
        if self.0 & Self::DISTANCE == 0 {
            Err(self.0)
        } else {
            Ok(f32::from_bits(self.0 & !Self::DISTANCE))
        }
    }
}

/// The lower envelope of parabolas of one line.
struct Envelope {
    vertex: Vec<u32>,
    boundary: Vec<f32>,
    copy: Vec<f32>,
    labels: Vec<u32>,
}

impl Envelope {
    fn new(length: usize) -> Self {
        Self {
            vertex: vec![0; length],
            boundary: vec![0.0; length + 1],
            copy: vec![0.0; length],
            labels: vec![UNKNOWN; length],
        }
    }

    /// Replaces samples f(p) by min over p of (q - p)^2 + f(p), and labels by those of the minimum.
    fn transform(&mut self, line: &mut [f32], labels: &mut [u32]) {
        if line.iter().all(|&v| v >= FAR) {
            return;
        }
        self.copy.copy_from_slice(line);
        self.labels.copy_from_slice(labels);
        let f = &self.copy;
        let mut count = 0usize;
        for q in (0..line.len()).filter(|&q| f[q] < FAR) {
            let mut start = f32::NEG_INFINITY;
            while count > 0 {
                let p = self.vertex[count - 1] as usize;
                let (qf, pf) = (q as f32, p as f32);
                start = ((f[q] + qf * qf) - (f[p] + pf * pf)) / (2.0 * (qf - pf));
                if start > self.boundary[count - 1] {
                    break;
                }
                count -= 1;
                start = f32::NEG_INFINITY;
            }
            self.vertex[count] = q as u32;
            self.boundary[count] = start;
            count += 1;
        }
        self.boundary[count] = f32::INFINITY;
        let mut k = 0;
        for (q, (value, label)) in line.iter_mut().zip(labels).enumerate() {
            while self.boundary[k + 1] < q as f32 {
                k += 1;
            }
            let p = self.vertex[k] as usize;
            *value = (q as f32 - p as f32).powi(2) + f[p];
            *label = self.labels[p];
        }
    }
}

/// Distance from a point to a triangle (Ericson, *Real-Time Collision Detection*, 2005, section 5.1.5).
pub fn point_triangle_distance(p: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> f64 {
    (p - closest_point_on_triangle(p, a, b, c)).norm()
}

/// Closest point of a triangle (Ericson 2005, section 5.1.5).
pub fn closest_point_on_triangle(
    p: &Vector3<f64>,
    a: &Vector3<f64>,
    b: &Vector3<f64>,
    c: &Vector3<f64>,
) -> Vector3<f64> {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 - d3 > 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 - d6 > 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 && (d4 - d3) + (d5 - d6) > 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum.abs() < 1e-300 {
        return *a;
    }
    a + ab * (vb / sum) + ac * (vc / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn random_triangles(count: usize, seed: u64) -> Triangles {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut point = move |around: Vector3<f64>, spread: f64| {
            around + Vector3::from_fn(|_, _| rng.random_range(-spread..spread))
        };
        (0..count)
            .map(|_| {
                let a = point(Vector3::repeat(0.5), 0.4);
                [a, point(a, 0.2), point(a, 0.2)]
            })
            .collect()
    }

    fn brute_force(p: &Vector3<f64>, triangles: &Triangles) -> f64 {
        triangles.iter().map(|t| point_triangle_distance(p, t)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn agrees_with_brute_force_at_voxel_centres() {
        let triangles = random_triangles(12, 1);
        let voxel = 0.04;
        let field = Esdf::build(&triangles, Vector3::zeros(), Vector3::repeat(1.0), voxel, &[]);
        let mut worst_near = 0.0f64;
        let mut worst_far = 0.0f64;
        for z in 0..field.size[2] {
            for y in 0..field.size[1] {
                for x in 0..field.size[0] {
                    let p = Vector3::new(x as f64, y as f64, z as f64) * voxel;
                    let exact = brute_force(&p, &triangles);
                    let error = (field.distance(&p) - exact).abs();
                    if exact < EXACT_BAND * voxel * 0.99 {
                        worst_near = worst_near.max(error);
                    } else {
                        worst_far = worst_far.max(error);
                    }
                }
            }
        }
        assert!(worst_near < 1e-5, "exact band: {worst_near}");
        assert!(worst_far < voxel, "beyond the band: {worst_far}");
    }

    #[test]
    fn gradient_agrees_with_finite_differences() {
        let triangles = random_triangles(5, 2);
        let field = Esdf::build(&triangles, Vector3::zeros(), Vector3::repeat(1.0), 0.05, &[]);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for _ in 0..200 {
            let p = Vector3::from_fn(|_, _| rng.random_range(0.1..0.9));
            let (_, gradient) = field.distance_and_gradient(&p);
            for axis in 0..3 {
                // Inside one voxel the interpolant is smooth; steps that leave it are skipped.
                let h = 1e-6;
                let mut q = p;
                q[axis] += h;
                let numeric = (field.distance(&q) - field.distance(&p)) / h;
                let near_face = ((p[axis] / 0.05).fract() - 0.5).abs() > 0.4999;
                assert!(near_face || (numeric - gradient[axis]).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn what_is_said_to_be_beyond_is_beyond() {
        let triangles = random_triangles(9, 4);
        let field = Esdf::build(&triangles, Vector3::zeros(), Vector3::repeat(1.0), 0.03, &[]);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut told = 0;
        for _ in 0..20_000 {
            let p = Vector3::from_fn(|_, _| rng.random_range(-0.2..1.2));
            let least = rng.random_range(0.0..0.2);
            if field.is_beyond(&p, least) {
                told += 1;
                assert!(field.distance(&p) >= least, "{p} {least}");
            } else {
                // And it is told wherever there is room for it.
                assert!(field.distance(&p) < least + 3.1 * 0.03);
            }
        }
        assert!(told > 1000);
    }

    #[test]
    fn unreachable_space_is_inside() {
        // A closed tetrahedron-like box of 12 triangles around the centre.
        let corner = |i: usize| {
            Vector3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64) * 0.4
                + Vector3::repeat(0.3)
        };
        let faces =
            [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        let mut triangles = Triangles::new();
        for [a, b, c, d] in faces {
            triangles.push([corner(a), corner(b), corner(c)]);
            triangles.push([corner(a), corner(c), corner(d)]);
        }
        let seed = [Vector3::repeat(0.05)];
        let field = Esdf::build(&triangles, Vector3::zeros(), Vector3::repeat(1.0), 0.02, &seed);
        assert!((field.distance(&Vector3::repeat(0.5)) + 0.2).abs() < 0.01);
        assert!((field.distance(&Vector3::new(0.1, 0.5, 0.5)) - 0.2).abs() < 0.01);
    }
}
