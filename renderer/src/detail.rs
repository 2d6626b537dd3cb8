//! Scenes with fewer triangles that look the same: edges are collapsed as long as no surface moves by more than a bound
//! (Garland and Heckbert, *Surface Simplification Using Quadric Error Metrics*, SIGGRAPH 1997).

use std::cmp::Reverse;
use std::collections::hash_map::Entry;
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use akrobat_model::TriMesh;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{RenderBody, RenderScene};

/// How far surfaces may move where detail is `auto`, metres: half a pixel of the paper's cameras at arm's length.
pub const AUTO_DEVIATION_M: f64 = 0.001;

/// How many triangles are drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Detail {
    /// All.
    #[default]
    Full,
    /// As many as hold every surface within a millimetre.
    Auto,
}

impl FromStr for Detail {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "full" => Ok(Self::Full),
            "auto" => Ok(Self::Auto),
            other => Err(format!("valid choices: full, auto; got \"{other}\"")),
        }
    }
}

impl fmt::Display for Detail {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Full => "full",
            Self::Auto => "auto",
        })
    }
}

impl Detail {
    /// The scene with this detail.
    pub fn of(self, scene: RenderScene) -> RenderScene {
        match self {
            Self::Full => scene,
            Self::Auto => simplified_scene(&scene, AUTO_DEVIATION_M),
        }
    }
}

/// The same scene from fewer triangles; no vertex is farther than `deviation_m` from the planes of the triangles that it
/// stands for. Meshes that would hardly get smaller stay as they are.
pub fn simplified_scene(scene: &RenderScene, deviation_m: f64) -> RenderScene {
    let mut known = HashSet::new();
    let meshes = scene.bodies.iter().flat_map(|body| &body.meshes);
    let meshes: Vec<_> = meshes.filter(|mesh| known.insert(Arc::as_ptr(mesh))).cloned().collect();
    let smaller = |mesh: &Arc<TriMesh>| {
        // Below this share of the triangles, the other mesh is worth its memory.
        const SHARE: f64 = 0.8;
        let simplified = simplified(mesh, deviation_m);
        let most = mesh.triangles.len() as f64 * SHARE;
        let is_smaller = (simplified.triangles.len() as f64) <= most;
        (Arc::as_ptr(mesh) as usize, if is_smaller { Arc::new(simplified) } else { mesh.clone() })
    };
    let smaller: HashMap<_, _> = meshes.par_iter().map(smaller).collect();
    let of_body = |body: &RenderBody| RenderBody {
        meshes: body
            .meshes
            .iter()
            .map(|mesh| smaller[&(Arc::as_ptr(mesh) as usize)].clone())
            .collect(),
        ..body.clone()
    };
    scene.with_bodies(scene.bodies.iter().map(of_body).collect())
}

/// A mesh with as few triangles as a greedy order of collapses gives. Vertices keep their places, normals and texture
/// coordinates; boundaries and seams of the texture stay where they are.
pub fn simplified(mesh: &TriMesh, deviation_m: f64) -> TriMesh {
    let mut surface = Surface::new(mesh);
    surface.collapse_all(deviation_m * deviation_m);
    surface.into_mesh()
}

/// Sum of square distances from planes, as a symmetric matrix's upper triangle.
#[derive(Debug, Clone, Copy, Default)]
struct Quadric([f64; 10]);

impl Quadric {
    /// Of the plane `normal . p = offset`, with a unit normal.
    fn of_plane([a, b, c]: [f64; 3], offset: f64) -> Self {
        let d = -offset;
        Self([a * a, a * b, a * c, a * d, b * b, b * c, b * d, c * c, c * d, d * d])
    }

    fn add(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, value)| *sum += value);
    }

    /// An upper bound of the square distance from any of the planes.
    fn at(&self, [x, y, z]: [f64; 3]) -> f64 {
        let [aa, ab, ac, ad, bb, bc, bd, cc, cd, dd] = self.0;
        let value = aa * x * x
            + bb * y * y
            + cc * z * z
            + 2.0 * (ab * x * y + ac * x * z + bc * y * z + ad * x + bd * y + cd * z)
            + dd;
        value.max(0.0)
    }
}

/// A collapse of one place into a neighbour, cheapest first; equal ones in the order of the places.
type Candidate = Reverse<(u64, u32, u32, [u32; 2])>;

/// Triangles over places: vertices at the same place are one for the shape, and several for normals and textures.
struct Surface<'a> {
    mesh: &'a TriMesh,
    /// Of each place, metres.
    position: Vec<[f64; 3]>,
    /// Place of each vertex.
    place_of: Vec<u32>,
    /// Vertices of each triangle that is left.
    triangles: Vec<Option<[u32; 3]>>,
    /// Triangles around each place; some may be gone.
    around: Vec<Vec<u32>>,
    quadric: Vec<Quadric>,
    /// Places that stay: where more than two triangles meet at an edge.
    is_fixed: Vec<bool>,
    /// How often a place's surroundings have changed; see [`Candidate`].
    version: Vec<u32>,
    heap: BinaryHeap<Candidate>,
}

impl<'a> Surface<'a> {
    fn new(mesh: &'a TriMesh) -> Self {
        let mut places = HashMap::new();
        let mut position = Vec::new();
        // Relative to the first vertex, quadrics lose fewer digits.
        let origin = mesh.positions.first().copied().unwrap_or_default();
        let place_of = mesh.positions.iter().map(|p| {
            *places.entry(p.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                position.push(std::array::from_fn(|i| f64::from(p[i]) - f64::from(origin[i])));
                position.len() as u32 - 1
            })
        });
        let place_of: Vec<u32> = place_of.collect();
        let is_drawable = |triangle: &[u32; 3]| {
            let exists = |&v: &u32| {
                mesh.positions.get(v as usize).is_some_and(|p| p.iter().all(|c| c.is_finite()))
            };
            triangle.iter().all(exists) && {
                let [a, b, c] = triangle.map(|v| place_of[v as usize]);
                a != b && b != c && c != a
            }
        };
        let triangles: Vec<_> =
            mesh.triangles.iter().map(|t| Some(*t).filter(is_drawable)).collect();
        let mut surface = Self {
            mesh,
            around: vec![Vec::new(); position.len()],
            quadric: vec![Quadric::default(); position.len()],
            is_fixed: vec![false; position.len()],
            version: vec![0; position.len()],
            heap: BinaryHeap::new(),
            position,
            place_of,
            triangles,
        };
        surface.measure();
        surface
    }

    /// Lists what is around each place, and gives it the planes of its triangles and of the boundary.
    fn measure(&mut self) {
        let mut edges: HashMap<[u32; 2], (u32, u32)> = HashMap::new();
        for index in 0..self.triangles.len() {
            let Some(places) = self.places(index as u32) else { continue };
            let (normal, _) = self.normal(places);
            let plane = Quadric::of_plane(normal, dot(normal, self.position[places[0] as usize]));
            for corner in 0..3 {
                let (p, q) = (places[corner], places[(corner + 1) % 3]);
                self.around[p as usize].push(index as u32);
                self.quadric[p as usize].add(&plane);
                edges.entry([p.min(q), p.max(q)]).or_insert((0, index as u32)).0 += 1;
            }
        }
        // In a fixed order, as sums of floating-point numbers depend on it.
        let mut edges: Vec<_> = edges.into_iter().collect();
        edges.sort_unstable();
        for ([p, q], (count, triangle)) in edges {
            if count > 2 {
                self.is_fixed[p as usize] = true;
                self.is_fixed[q as usize] = true;
            }
            let Some(places) = self.places(triangle).filter(|_| count == 1) else { continue };
            let [a, b] = [p, q].map(|place| self.position[place as usize]);
            let across = normalized(cross(subtract(b, a), self.normal(places).0));
            let plane = Quadric::of_plane(across, dot(across, a));
            self.quadric[p as usize].add(&plane);
            self.quadric[q as usize].add(&plane);
        }
    }

    fn places(&self, triangle: u32) -> Option<[u32; 3]> {
        self.triangles[triangle as usize].map(|t| t.map(|v| self.place_of[v as usize]))
    }

    /// Unit normal and twice the area.
    fn normal(&self, places: [u32; 3]) -> ([f64; 3], f64) {
        let [a, b, c] = places.map(|place| self.position[place as usize]);
        let normal = cross(subtract(b, a), subtract(c, a));
        (normalized(normal), dot(normal, normal).sqrt())
    }

    fn collapse_all(&mut self, most: f64) {
        for place in 0..self.position.len() as u32 {
            self.push_from(place, most);
        }
        while let Some(Reverse((_, p, q, versions))) = self.heap.pop() {
            if [p, q].map(|place| self.version[place as usize]) == versions {
                self.try_collapse(p, q, most);
            }
        }
    }

    /// Offers the collapses of a place into its neighbours.
    fn push_from(&mut self, p: u32, most: f64) {
        if self.is_fixed[p as usize] {
            return;
        }
        for q in self.neighbours(p) {
            let mut quadric = self.quadric[p as usize];
            quadric.add(&self.quadric[q as usize]);
            let cost = quadric.at(self.position[q as usize]);
            if cost <= most {
                let versions = [p, q].map(|place| self.version[place as usize]);
                self.heap.push(Reverse((cost.to_bits(), p, q, versions)));
            }
        }
    }

    /// In ascending order.
    fn neighbours(&self, p: u32) -> Vec<u32> {
        let around = self.around[p as usize].iter().filter_map(|&t| self.places(t)).flatten();
        let mut neighbours: Vec<u32> = around.filter(|&q| q != p).collect();
        neighbours.sort_unstable();
        neighbours.dedup();
        neighbours
    }

    fn try_collapse(&mut self, p: u32, q: u32, most: f64) {
        let around: Vec<u32> = self.around[p as usize].clone();
        let (gone, kept): (Vec<u32>, Vec<u32>) =
            around.into_iter().partition(|&t| self.places(t).is_some_and(|t| t.contains(&q)));
        if gone.is_empty() || !self.stays_a_surface(p, q, gone.len()) {
            return;
        }
        let Some(vertices) = self.vertices_after(p, q, &gone, &kept) else { return };
        if !kept.iter().all(|&triangle| self.may_move(triangle, p, q)) {
            return;
        }
        for &triangle in &gone {
            self.triangles[triangle as usize] = None;
        }
        for &triangle in &kept {
            if let Some(corners) = &mut self.triangles[triangle as usize] {
                for corner in corners.iter_mut().filter(|v| self.place_of[**v as usize] == p) {
                    *corner = vertices[corner];
                }
            }
        }
        self.around[p as usize].clear();
        self.around[q as usize].extend(kept);
        let triangles = &self.triangles;
        self.around[q as usize].retain(|&t| triangles[t as usize].is_some());
        let quadric = self.quadric[p as usize];
        self.quadric[q as usize].add(&quadric);
        self.version[p as usize] += 1;
        self.version[q as usize] += 1;
        self.push_from(q, most);
        for neighbour in self.neighbours(q) {
            let triangles = &self.triangles;
            self.around[neighbour as usize].retain(|&t| triangles[t as usize].is_some());
            self.version[neighbour as usize] += 1;
            self.push_from(neighbour, most);
        }
    }

    /// Whether the two places have no common neighbours but those of the triangles that vanish (Dey et al., *Topology
    /// Preserving Edge Contraction*, 1999).
    fn stays_a_surface(&self, p: u32, q: u32, shared: usize) -> bool {
        let of_q = self.neighbours(q);
        let common = self.neighbours(p).into_iter().filter(|n| of_q.binary_search(n).is_ok());
        common.count() == shared
    }

    /// Which vertex at `q` takes the place of each vertex at `p`: the one on the same side of the texture's and the
    /// normals' seams. `None` where there is none.
    fn vertices_after(
        &self,
        p: u32,
        q: u32,
        gone: &[u32],
        kept: &[u32],
    ) -> Option<HashMap<u32, u32>> {
        let at = |triangle: u32, place: u32| {
            let corners = self.triangles[triangle as usize]?;
            corners.into_iter().find(|&v| self.place_of[v as usize] == place)
        };
        let mut after = HashMap::new();
        for &triangle in gone {
            after.entry(at(triangle, p)?).or_insert(at(triangle, q)?);
        }
        let at_q: Vec<u32> =
            self.around[q as usize].iter().filter_map(|&triangle| at(triangle, q)).collect();
        for &triangle in kept {
            let vertex = at(triangle, p)?;
            if let Entry::Vacant(entry) = after.entry(vertex) {
                entry.insert(*at_q.iter().find(|&&other| self.are_alike(vertex, other))?);
            }
        }
        Some(after)
    }

    /// Whether a vertex without texture may take the place of another.
    fn are_alike(&self, a: u32, b: u32) -> bool {
        /// Cosine of the angle between normals that look alike.
        const ALIKE: f32 = 0.99;
        if self.mesh.material.base_color_texture.is_some() {
            return false;
        }
        let normal = |v: u32| self.mesh.normals.get(v as usize);
        match (normal(a), normal(b)) {
            (Some(a), Some(b)) => (0..3).map(|i| a[i] * b[i]).sum::<f32>() >= ALIKE,
            _ => true,
        }
    }

    /// Whether a triangle neither folds over nor degenerates when one of its corners moves.
    fn may_move(&self, triangle: u32, from: u32, to: u32) -> bool {
        /// Cosine of the largest turn of a triangle.
        const MOST_TURN: f64 = 0.3;
        /// Twice the smallest area, relative to the square of the longest edge.
        const THINNEST: f64 = 1e-4;
        let Some(before) = self.places(triangle) else { return true };
        let after = before.map(|place| if place == from { to } else { place });
        let ((old, _), (new, area)) = (self.normal(before), self.normal(after));
        let corners = after.map(|place| self.position[place as usize]);
        let longest = (0..3)
            .map(|i| subtract(corners[(i + 1) % 3], corners[i]))
            .map(|edge| dot(edge, edge))
            .fold(0.0, f64::max);
        dot(old, new) >= MOST_TURN && area >= THINNEST * longest
    }

    fn into_mesh(self) -> TriMesh {
        let Self { mesh, triangles, .. } = self;
        let mut new_of_old = HashMap::new();
        let mut result = TriMesh { material: mesh.material.clone(), ..TriMesh::default() };
        let has_normals = mesh.normals.len() == mesh.positions.len();
        let has_uvs = mesh.uvs.len() == mesh.positions.len();
        for corners in triangles.into_iter().flatten() {
            let corners = corners.map(|old| {
                *new_of_old.entry(old).or_insert_with(|| {
                    let old = old as usize;
                    result.positions.push(mesh.positions[old]);
                    if has_normals {
                        result.normals.push(mesh.normals[old]);
                    }
                    if has_uvs {
                        result.uvs.push(mesh.uvs[old]);
                    }
                    result.positions.len() as u32 - 1
                })
            });
            result.triangles.push(corners);
        }
        result
    }
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

fn normalized(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    if length > 0.0 { v.map(|c| c / length) } else { v }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "helpers of tests fail like tests do")]
mod tests {
    use super::*;

    /// A square of `cells` x `cells` in the plane z = 0, `height` of each vertex added.
    fn sheet(cells: u32, height: impl Fn(f32, f32) -> f32) -> TriMesh {
        let mut mesh = TriMesh::default();
        for row in 0..=cells {
            for column in 0..=cells {
                let (x, y) = (column as f32 / cells as f32, row as f32 / cells as f32);
                mesh.positions.push([x, y, height(x, y)]);
            }
        }
        for row in 0..cells {
            for column in 0..cells {
                let a = row * (cells + 1) + column;
                let [b, c, d] = [a + 1, a + cells + 1, a + cells + 2];
                mesh.triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
        mesh
    }

    fn area(mesh: &TriMesh) -> f64 {
        let double = |index: usize| {
            let [a, b, c] = mesh.corners(index).map(|p| p.map(f64::from));
            let normal = cross(subtract(b, a), subtract(c, a));
            dot(normal, normal).sqrt()
        };
        (0..mesh.triangles.len()).map(double).sum::<f64>() / 2.0
    }

    #[test]
    fn a_flat_square_needs_two_triangles() {
        let simple = simplified(&sheet(20, |_, _| 0.0), 1e-4);
        assert!(simple.triangles.len() <= 4, "{}", simple.triangles.len());
        assert!((area(&simple) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_bump_stays_within_the_bound_and_a_tighter_bound_keeps_more() {
        let bump = |x: f32, y: f32| 0.05 * (6.0 * x).sin() * (5.0 * y).cos();
        let mesh = sheet(60, bump);
        let counts = [2e-3, 5e-4, 1e-9].map(|bound_m| {
            let simple = simplified(&mesh, bound_m);
            // At the middles of the new triangles, the old surface is no farther than the bound, give or take what the
            // planes of the old triangles differ from it.
            for index in 0..simple.triangles.len() {
                let [a, b, c] = simple.corners(index);
                let [x, y, z] = std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0);
                let error_m = f64::from((z - bump(x, y)).abs());
                assert!(error_m <= 3.0 * bound_m + 2e-4, "{error_m} > {bound_m}");
            }
            simple.triangles.len()
        });
        assert!(counts[0] < counts[1] && counts[1] < mesh.triangles.len(), "{counts:?}");
        assert_eq!(counts[2], mesh.triangles.len());
    }

    #[test]
    fn seams_of_the_texture_and_loose_triangles_survive() {
        // Two halves with textures of their own, whose common edge has two vertices at each place.
        let mut mesh = sheet(8, |_, _| 0.0);
        mesh.uvs = mesh.positions.iter().map(|p| [p[0], p[1]]).collect();
        mesh.material.base_color_texture = Some(Arc::default());
        let mut right = mesh.clone();
        right.positions.iter_mut().for_each(|p| p[0] += 1.0);
        right.uvs.iter_mut().for_each(|uv| uv[0] = 5.0 - uv[0]);
        let count = mesh.positions.len() as u32;
        mesh.triangles.extend(right.triangles.iter().map(|t| t.map(|v| v + count)));
        mesh.positions.extend(right.positions);
        mesh.uvs.extend(right.uvs);
        let simple = simplified(&mesh, 1e-4);
        assert!(simple.triangles.len() <= 8, "{}", simple.triangles.len());
        assert!((area(&simple) - 2.0).abs() < 1e-9);
        for (position, uv) in simple.positions.iter().zip(&simple.uvs) {
            let expected = if uv[0] <= 1.0 { position[0] } else { 6.0 - position[0] };
            assert_eq!(uv[0], expected);
        }
        let single = TriMesh { triangles: vec![[0, 1, 9], [3, 3, 4], [7, 8, 900]], ..mesh };
        assert_eq!(simplified(&single, 1e-4).triangles.len(), 1);
    }

    #[test]
    fn choices_are_named() {
        assert_eq!("auto".parse(), Ok(Detail::Auto));
        assert!("low".parse::<Detail>().unwrap_err().contains("full, auto"));
    }
}
