//! Meshes cut into small clusters of neighbouring triangles, each with a bounding sphere: what is culled
//! and transformed together.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use akrobat_model::TriMesh;

use crate::RenderBody;

/// Largest number of triangles of a cluster; a power of two, so that a cluster and a triangle in it pack
/// into one id.
pub(crate) const CLUSTER_TRIANGLES: usize = 128;

/// Vertex runs are padded to this many lanes.
const LANES: usize = 8;

/// A sphere that holds everything of something, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sphere {
    pub center: [f32; 3],
    pub radius: f32,
}

impl Sphere {
    /// Around the middle of the bounding box, and a little larger than needed to outlast rounding.
    fn around(points: impl Iterator<Item = [f32; 3]> + Clone) -> Self {
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        for p in points.clone() {
            low = std::array::from_fn(|i| low[i].min(p[i]));
            high = std::array::from_fn(|i| high[i].max(p[i]));
        }
        let center: [f32; 3] = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
        let distance = |p: [f32; 3]| {
            (0..3).map(|i| (p[i] - center[i]) * (p[i] - center[i])).sum::<f32>().sqrt()
        };
        let radius = points.map(distance).fold(0.0, f32::max) * 1.0001 + 1e-6;
        Self { center, radius }
    }
}

/// Some neighbouring triangles of a mesh.
#[derive(Debug, Clone)]
pub(crate) struct Cluster {
    pub sphere: Sphere,
    /// Its part of [`ClusteredMesh::positions`]; a multiple of eight long, the last vertex repeated.
    pub vertices: Range<usize>,
    /// Its part of [`ClusteredMesh::triangles`].
    pub triangles: Range<usize>,
}

/// A triangle of a cluster.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ClusterTriangle {
    /// Corners, counted from the cluster's first vertex.
    pub corners: [u16; 3],
    /// Index in the mesh's own triangles.
    pub source: u32,
}

/// A mesh in clusters. Vertices at the same place are merged within a cluster; normals and texture
/// coordinates stay with the source mesh.
#[derive(Debug)]
pub(crate) struct ClusteredMesh {
    pub mesh: Arc<TriMesh>,
    /// x, y and z of all clusters' vertices in the body's frame, metres.
    pub positions: [Vec<f32>; 3],
    pub triangles: Vec<ClusterTriangle>,
    pub clusters: Vec<Cluster>,
    pub sphere: Sphere,
}

impl ClusteredMesh {
    fn new(mesh: Arc<TriMesh>) -> Self {
        let mut order: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        order.retain(|&triangle| is_drawable(&mesh, triangle as usize));
        let centroid: Vec<[f32; 3]> = (0..mesh.triangles.len())
            .map(|triangle| {
                let corner = |v: u32| mesh.positions.get(v as usize).copied().unwrap_or_default();
                let [a, b, c] = mesh.triangles[triangle].map(corner);
                std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0)
            })
            .collect();
        let mut result = Self {
            sphere: Sphere::around(
                order.iter().flat_map(|&triangle| mesh.corners(triangle as usize)),
            ),
            positions: Default::default(),
            triangles: Vec::with_capacity(order.len()),
            clusters: Vec::new(),
            mesh,
        };
        if !order.is_empty() {
            result.split(&mut order, &centroid);
        }
        result
    }

    /// Halves the triangles along the longest extent of their centroids until a cluster holds them.
    fn split(&mut self, order: &mut [u32], centroid: &[[f32; 3]]) {
        if order.len() <= CLUSTER_TRIANGLES {
            return self.push_cluster(order);
        }
        let extent = |axis: usize| {
            let along = order.iter().map(|&t| centroid[t as usize][axis]);
            let (low, high) = along.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
            high - low
        };
        let extents = [extent(0), extent(1), extent(2)];
        let axis = (0..3).max_by(|&i, &j| extents[i].total_cmp(&extents[j])).unwrap_or(0);
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |&i, &j| {
            let along = centroid[i as usize][axis].total_cmp(&centroid[j as usize][axis]);
            along.then(i.cmp(&j))
        });
        let (left, right) = order.split_at_mut(middle);
        self.split(left, centroid);
        self.split(right, centroid);
    }

    fn push_cluster(&mut self, order: &mut [u32]) {
        order.sort_unstable();
        let first_vertex = self.positions[0].len();
        let first_triangle = self.triangles.len();
        let mut place_of = HashMap::new();
        for &source in order.iter() {
            let corners = self.mesh.corners(source as usize).map(|p| {
                let next = place_of.len() as u16;
                // Adding zero makes -0 and 0 the same place.
                *place_of.entry(p.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                    (0..3).for_each(|axis| self.positions[axis].push(p[axis]));
                    next
                })
            });
            self.triangles.push(ClusterTriangle { corners, source });
        }
        for positions in &mut self.positions {
            let last = positions[positions.len() - 1];
            let padded = first_vertex + (positions.len() - first_vertex).next_multiple_of(LANES);
            positions.resize(padded, last);
        }
        let vertices = first_vertex..self.positions[0].len();
        let [x, y, z] = &self.positions;
        self.clusters.push(Cluster {
            sphere: Sphere::around(vertices.clone().map(|i| [x[i], y[i], z[i]])),
            vertices,
            triangles: first_triangle..self.triangles.len(),
        });
    }
}

/// True where all corners exist and are finite.
fn is_drawable(mesh: &TriMesh, triangle: usize) -> bool {
    let exists =
        |&v: &u32| mesh.positions.get(v as usize).is_some_and(|p| p.iter().all(|c| c.is_finite()));
    mesh.triangles[triangle].iter().all(exists)
}

/// One mesh of one body.
#[derive(Debug)]
pub(crate) struct Instance {
    /// Place of the body in [`crate::RenderScene::bodies`].
    pub body: usize,
    /// Place of the mesh in [`RenderBody::meshes`].
    pub part: usize,
    pub mesh: Arc<ClusteredMesh>,
}

/// All meshes of a scene in clusters.
#[derive(Debug, Default)]
pub(crate) struct ClusteredScene {
    pub instances: Vec<Instance>,
}

impl ClusteredScene {
    /// The bodies' meshes; those that `known` has are taken from there.
    pub fn new(bodies: &[RenderBody], known: Option<&Self>) -> Self {
        let known = known.into_iter().flat_map(|scene| &scene.instances);
        // Sources are kept alive by their clusters, so that an address stands for one mesh.
        let mut by_mesh: HashMap<*const TriMesh, Arc<ClusteredMesh>> =
            known.map(|i| (Arc::as_ptr(&i.mesh.mesh), i.mesh.clone())).collect();
        let mut instances = Vec::new();
        for (place, body) in bodies.iter().enumerate() {
            for (part, mesh) in body.meshes.iter().enumerate() {
                let clustered = by_mesh
                    .entry(Arc::as_ptr(mesh))
                    .or_insert_with(|| Arc::new(ClusteredMesh::new(mesh.clone())));
                if !clustered.clusters.is_empty() {
                    instances.push(Instance { body: place, part, mesh: clustered.clone() });
                }
            }
        }
        Self { instances }
    }
}
