//! From parts to triangles and convex solids.

use std::collections::HashMap;

use akrobat_model::{Part, Shape};
use parry3d_f64::math::Vector;

use crate::convex::ConvexPiece;
use crate::kinematics::Frame;

/// Sides of a tessellated cylinder, and meridians of a sphere.
const SIDES: usize = 32;
/// Rings of a tessellated sphere.
const RINGS: usize = 16;
/// A closed mesh is convex if it fills its hull up to this fraction of the hull's volume …
const CONVEX_VOLUME_TOLERANCE: f64 = 0.05;
/// … and no corner lies deeper in the hull than this fraction of the hull's diagonal.
const CONVEX_DEPTH_FRACTION: f64 = 5e-3;

/// An indexed triangle set in a link's or body's frame, metres.
#[derive(Debug, Clone, Default)]
pub struct Triangles {
    pub vertices: Vec<Vector>,
    pub indices: Vec<[u32; 3]>,
}

impl Triangles {
    /// The triangles of a part in the frame of its link or body. Primitives are given by the hull of
    /// their corners.
    pub fn of_part(part: &Part) -> Self {
        let link_from_part = Frame::from_pose(&part.link_from_part);
        let mut triangles = match &part.shape {
            Shape::Mesh { meshes, .. } => {
                let mut all = Self::default();
                for mesh in meshes.iter() {
                    let first = all.vertices.len() as u32;
                    all.vertices
                        .extend(mesh.positions.iter().map(|p| Vector::from(p.map(f64::from))));
                    all.indices.extend(mesh.triangles.iter().map(|t| t.map(|v| v + first)));
                }
                all
            }
            primitive => Self::of_hull(&primitive_corners(primitive)),
        };
        for vertex in &mut triangles.vertices {
            *vertex = link_from_part.point(*vertex);
        }
        triangles
    }

    fn of_hull(corners: &[Vector]) -> Self {
        ConvexPiece::hull(corners)
            .map(|piece| Self { vertices: piece.vertices, indices: piece.triangles })
            .unwrap_or_default()
    }

    /// True where every coordinate is finite.
    pub fn is_finite(&self) -> bool {
        self.vertices.iter().all(|v| v.is_finite())
    }

    /// Corners of each triangle.
    pub fn corners(&self) -> impl Iterator<Item = [Vector; 3]> + '_ {
        self.indices.iter().map(|triangle| triangle.map(|v| self.vertices[v as usize]))
    }

    /// The convex hull of all vertices that belong to triangles.
    pub fn hull(&self) -> Option<ConvexPiece> {
        let mut used: Vec<u32> = self.indices.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        ConvexPiece::hull(&used.iter().map(|&v| self.vertices[v as usize]).collect::<Vec<_>>())
    }

    /// The mesh as closed convex solids if that is what it consists of: one hull, or the several of a
    /// convex decomposition kept in one file. Components share vertex indices; where a file repeats
    /// the vertices of every face, they share positions.
    pub fn convex_components(&self) -> Option<Vec<ConvexPiece>> {
        let indexed = self.components(|vertex| vertex);
        convex_solids(&indexed).or_else(|| {
            let welded = self.welded();
            convex_solids(&self.components(|vertex| welded[vertex as usize]))
        })
    }

    /// For each vertex the first one at the same position (to a micrometre).
    fn welded(&self) -> Vec<u32> {
        let mut first_at: HashMap<[i64; 3], u32> = HashMap::new();
        let key = |v: &Vector| [v.x, v.y, v.z].map(|c| (c * 1e6).round() as i64);
        let numbered = self.vertices.iter().zip(0u32..);
        numbered.map(|(v, index)| *first_at.entry(key(v)).or_insert(index)).collect()
    }

    /// Connected components, where `identity` says which vertices are the same.
    fn components(&self, identity: impl Fn(u32) -> u32) -> Vec<Self> {
        let mut parent: Vec<u32> = (0..self.vertices.len() as u32).collect();
        for triangle in &self.indices {
            let [a, b, c] = triangle.map(|v| find(&mut parent, identity(v)));
            parent[b as usize] = a;
            let c = find(&mut parent, c);
            parent[c as usize] = find(&mut parent, a);
        }
        let mut component_of: HashMap<u32, usize> = HashMap::new();
        let mut components: Vec<Self> = Vec::new();
        for triangle in &self.indices {
            let root = find(&mut parent, identity(triangle[0]));
            let index = *component_of.entry(root).or_insert_with(|| {
                components.push(Self::default());
                components.len() - 1
            });
            let component = &mut components[index];
            let first = component.vertices.len() as u32;
            component.vertices.extend(triangle.map(|v| self.vertices[v as usize]));
            component.indices.push([first, first + 1, first + 2]);
        }
        components
    }

    /// True where the triangles cover the surface of `hull` and nothing else. Works without
    /// consistent winding.
    fn fills(&self, hull: &ConvexPiece) -> bool {
        let center = hull.vertices.iter().sum::<Vector>() / hull.vertices.len() as f64;
        let volume: f64 = self
            .corners()
            .map(|[a, b, c]| ((a - center).dot((b - center).cross(c - center))).abs() / 6.0)
            .sum();
        let deepest = self.vertices.iter().map(|&v| -hull.distance(v)).fold(0.0, f64::max);
        let diagonal = hull.bounds.extents().length();
        (volume / hull.volume - 1.0).abs() < CONVEX_VOLUME_TOLERANCE
            && deepest < CONVEX_DEPTH_FRACTION * diagonal
    }
}

fn find(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        let above = parent[parent[vertex as usize] as usize];
        parent[vertex as usize] = above;
        vertex = above;
    }
    vertex
}

/// The hulls of the components if every one is a convex solid.
fn convex_solids(components: &[Triangles]) -> Option<Vec<ConvexPiece>> {
    let hulls = components.iter().map(|component| {
        let hull = component.hull()?;
        component.fills(&hull).then_some(hull)
    });
    let hulls: Vec<ConvexPiece> = hulls.collect::<Option<_>>()?;
    (!hulls.is_empty()).then_some(hulls)
}

fn primitive_corners(shape: &Shape) -> Vec<Vector> {
    let circle = |sides: usize| {
        (0..sides).map(move |k| (std::f64::consts::TAU * k as f64 / sides as f64).sin_cos())
    };
    match shape {
        Shape::Box { size } => (0..8)
            .map(|i| {
                let side = |axis: usize| size[axis] * if i >> axis & 1 == 1 { 0.5 } else { -0.5 };
                Vector::new(side(0), side(1), side(2))
            })
            .collect(),
        Shape::Cylinder { radius, length } => circle(SIDES)
            .flat_map(|(sin, cos)| {
                [-0.5, 0.5].map(|end| Vector::new(radius * cos, radius * sin, end * length))
            })
            .collect(),
        Shape::Sphere { radius } => (0..=RINGS)
            .flat_map(|ring| {
                let (ring_radius, z) =
                    (std::f64::consts::PI * ring as f64 / RINGS as f64).sin_cos();
                circle(SIDES).map(move |(sin, cos)| {
                    Vector::new(ring_radius * cos, ring_radius * sin, z) * *radius
                })
            })
            .collect(),
        Shape::Mesh { .. } => Vec::new(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::Arc;

    use akrobat_model::{Pose, TriMesh};

    use super::*;

    fn part(shape: Shape) -> Part {
        Part { name: "part".into(), link_from_part: Pose::identity(), shape, material: None }
    }

    fn cube_mesh(offset: f32) -> TriMesh {
        let triangles = Triangles::of_part(&part(Shape::Box { size: [1.0; 3] }));
        TriMesh {
            positions: triangles
                .vertices
                .iter()
                .map(|v| [v.x as f32 + offset, v.y as f32, v.z as f32])
                .collect(),
            triangles: triangles.indices,
            ..TriMesh::default()
        }
    }

    fn mesh(meshes: Vec<TriMesh>) -> Triangles {
        Triangles::of_part(&part(Shape::Mesh { source: "test".into(), meshes: Arc::new(meshes) }))
    }

    #[test]
    fn primitives_are_convex_solids_of_the_right_volume() {
        let volume = |shape| {
            let pieces = Triangles::of_part(&part(shape)).convex_components().unwrap();
            pieces.iter().map(|p| p.volume).sum::<f64>()
        };
        assert!((volume(Shape::Box { size: [1.0, 2.0, 3.0] }) - 6.0).abs() < 1e-9);
        let tau = std::f64::consts::TAU;
        assert!((volume(Shape::Cylinder { radius: 1.0, length: 2.0 }) / tau - 1.0).abs() < 0.01);
        assert!((volume(Shape::Sphere { radius: 1.0 }) / (tau * 2.0 / 3.0) - 1.0).abs() < 0.02);
    }

    #[test]
    fn a_decomposition_in_one_file_is_taken_apart() {
        // The second pair touches: it must be told apart by indices, not by positions.
        for offset in [3.0, 1.0] {
            let pieces = mesh(vec![cube_mesh(0.0), cube_mesh(offset)]).convex_components().unwrap();
            assert_eq!(pieces.len(), 2);
        }
    }

    #[test]
    fn faces_with_their_own_vertices_are_welded() {
        let shared = mesh(vec![cube_mesh(0.0)]);
        let vertices: Vec<Vector> = shared.corners().flatten().collect();
        let indices =
            (0..vertices.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let split = Triangles { vertices, indices };
        assert_eq!(split.convex_components().unwrap().len(), 1);
    }

    #[test]
    fn open_and_concave_meshes_are_not_convex_solids() {
        let mut open = cube_mesh(0.0);
        open.triangles.truncate(10);
        assert!(mesh(vec![open]).convex_components().is_none());
        // An L of two cubes with a common face edge, welded into one mesh: the hull is larger.
        let mut corner = mesh(vec![cube_mesh(0.0), cube_mesh(1.0)]);
        let above: Vec<Vector> =
            mesh(vec![cube_mesh(0.0)]).vertices.iter().map(|v| *v + Vector::Z).collect();
        let first = corner.vertices.len() as u32;
        corner
            .indices
            .extend(mesh(vec![cube_mesh(0.0)]).indices.iter().map(|t| t.map(|v| v + first)));
        corner.vertices.extend(above);
        let welded = corner.welded();
        for triangle in &mut corner.indices {
            *triangle = triangle.map(|v| welded[v as usize]);
        }
        assert!(corner.convex_components().is_none());
        assert!(corner.hull().is_some());
    }
}
