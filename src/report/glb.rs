//! Animated binary glTF 2.0: every body of a trajectory as a node that moves.
//!
//! Layout after the glTF 2.0 specification: section 4.4 (GLB), 3.6 (accessors), 3.11 (animations).

use std::collections::HashMap;
use std::sync::Arc;

use akrobat_model::{Material, Pose, TriMesh};
use serde_json::{Value, json};

use simplify::simplified;

mod simplify;

/// Component and buffer-view numbers of the specification.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
/// Turns Z up into Y up: -90 degrees about x, xyzw.
const Y_UP_FROM_Z_UP: [f64; 4] =
    [-std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2];
/// Movement below this is rest: metres, and length of a quaternion's difference.
const REST: f64 = 1e-6;
/// Bytes of a vertex (position and normal) and of a triangle.
const VERTEX_BYTES: usize = 24;
const TRIANGLE_BYTES: usize = 12;
/// Cell sizes tried, metres, until the meshes fit; 0 only merges equal vertices.
const CELLS_M: [f32; 6] = [0.0, 0.002, 0.004, 0.008, 0.016, 0.032];

/// A rigid body and where it is over time.
#[derive(Debug, Clone)]
pub struct Body {
    /// Node name.
    pub name: String,
    /// Meshes in the body's frame.
    pub meshes: Vec<Arc<TriMesh>>,
    /// Pose at each of the animation's times; a single one for bodies at rest.
    pub world_from_body: Vec<Pose>,
}

/// Writes bodies as a GLB. World frame Z up, metres; `times_s` increases from 0. Meshes are thinned until
/// they take about `mesh_bytes`; textures are replaced by their mean colour.
pub fn encode(bodies: &[Body], times_s: &[f64], mesh_bytes: usize) -> Vec<u8> {
    let mut document = Document::default();
    document.add_meshes(bodies, mesh_bytes);
    for body in bodies {
        document.add_node(body);
    }
    document.add_animation(bodies, times_s);
    document.into_glb()
}

/// A glTF document under construction.
#[derive(Default)]
struct Document {
    buffer: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    animations: Vec<Value>,
    /// Primitive of each mesh, by the mesh's address.
    primitives: HashMap<*const TriMesh, Value>,
    /// Mesh number by the addresses of its primitives.
    mesh_numbers: HashMap<Vec<*const TriMesh>, usize>,
    material_numbers: HashMap<[u32; 6], usize>,
}

impl Document {
    fn add_meshes(&mut self, bodies: &[Body], mesh_bytes: usize) {
        let mut distinct: Vec<&Arc<TriMesh>> = Vec::new();
        let mut known = std::collections::HashSet::new();
        for mesh in bodies.iter().flat_map(|body| &body.meshes) {
            if known.insert(Arc::as_ptr(mesh)) {
                distinct.push(mesh);
            }
        }
        for (mesh, thinned) in distinct.iter().zip(thinned_to(&distinct, mesh_bytes)) {
            if !thinned.triangles.is_empty() {
                let primitive = self.primitive(&thinned, &mesh.material);
                self.primitives.insert(Arc::as_ptr(mesh), primitive);
            }
        }
    }

    fn primitive(&mut self, mesh: &TriMesh, material: &Material) -> Value {
        let (low, high) = mesh.bounds().unwrap_or_default();
        let positions = self.accessor(
            bytes_of(mesh.positions.as_flattened(), f32::to_le_bytes),
            json!({ "componentType": FLOAT, "type": "VEC3", "count": mesh.positions.len(), "min": low, "max": high }),
            Some(ARRAY_BUFFER),
        );
        let normals = self.accessor(
            bytes_of(mesh.normals.as_flattened(), f32::to_le_bytes),
            json!({ "componentType": FLOAT, "type": "VEC3", "count": mesh.normals.len() }),
            Some(ARRAY_BUFFER),
        );
        let indices = self.accessor(
            bytes_of(mesh.triangles.as_flattened(), u32::to_le_bytes),
            json!({ "componentType": UNSIGNED_INT, "type": "SCALAR", "count": 3 * mesh.triangles.len() }),
            Some(ELEMENT_ARRAY_BUFFER),
        );
        json!({
            "attributes": { "POSITION": positions, "NORMAL": normals },
            "indices": indices,
            "material": self.material(material),
        })
    }

    fn material(&mut self, material: &Material) -> usize {
        let [r, g, b, a] = mean_color(material);
        let values = [r, g, b, a, material.metallic, material.roughness].map(|v| v.clamp(0.0, 1.0));
        let [r, g, b, a, metallic, roughness] = values;
        let next = self.materials.len();
        *self.material_numbers.entry(values.map(f32::to_bits)).or_insert_with(|| {
            self.materials.push(json!({
                "name": material.name,
                // The renderer, too, shows every triangle from both sides.
                "doubleSided": true,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [r, g, b, a],
                    "metallicFactor": metallic,
                    "roughnessFactor": roughness,
                },
            }));
            next
        })
    }

    fn add_node(&mut self, body: &Body) {
        let mut node = json!({ "name": body.name });
        if let Some(pose) = body.world_from_body.first() {
            node["translation"] = json!(translation(pose));
            node["rotation"] = json!(rotation(pose));
        }
        if let Some(mesh) = self.mesh(body) {
            node["mesh"] = json!(mesh);
        }
        self.nodes.push(node);
    }

    /// Number of the body's mesh, shared with bodies of the same geometry.
    fn mesh(&mut self, body: &Body) -> Option<usize> {
        let key: Vec<_> = body.meshes.iter().map(Arc::as_ptr).collect();
        let primitives: Vec<&Value> = key.iter().filter_map(|k| self.primitives.get(k)).collect();
        if primitives.is_empty() {
            return None;
        }
        let next = self.meshes.len();
        Some(*self.mesh_numbers.entry(key).or_insert_with(|| {
            self.meshes.push(json!({ "name": body.name, "primitives": primitives }));
            next
        }))
    }

    fn add_animation(&mut self, bodies: &[Body], times_s: &[f64]) {
        let moving = |body: &Body| body.world_from_body.len() == times_s.len() && moves(body);
        if times_s.len() < 2 || !bodies.iter().any(moving) {
            return;
        }
        let times: Vec<f32> = times_s.iter().map(|&t| t as f32).collect();
        let input = self.accessor(
            bytes_of(&times, f32::to_le_bytes),
            json!({ "componentType": FLOAT, "type": "SCALAR", "count": times.len(), "min": [times[0]], "max": [times[times.len() - 1]] }),
            None,
        );
        let (mut channels, mut samplers) = (Vec::new(), Vec::new());
        for (node, body) in bodies.iter().enumerate().filter(|(_, body)| moving(body)) {
            let poses = &body.world_from_body;
            let translations: Vec<f32> = poses.iter().flat_map(translation).collect();
            for (path, kind, values) in
                [("translation", "VEC3", translations), ("rotation", "VEC4", rotations(poses))]
            {
                let output = self.accessor(
                    bytes_of(&values, f32::to_le_bytes),
                    json!({ "componentType": FLOAT, "type": kind, "count": poses.len() }),
                    None,
                );
                channels.push(
                    json!({ "sampler": samplers.len(), "target": { "node": node, "path": path } }),
                );
                samplers
                    .push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
            }
        }
        self.animations
            .push(json!({ "name": "trajectory", "channels": channels, "samplers": samplers }));
    }

    /// Stores content and describes it; returns the accessor's number.
    fn accessor(&mut self, content: Vec<u8>, mut description: Value, target: Option<u32>) -> usize {
        let mut view =
            json!({ "buffer": 0, "byteOffset": self.buffer.len(), "byteLength": content.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        // Every component has four bytes, so that offsets stay aligned.
        self.buffer.extend(content);
        description["bufferView"] = json!(self.views.len());
        self.views.push(view);
        self.accessors.push(description);
        self.accessors.len() - 1
    }

    fn into_glb(mut self) -> Vec<u8> {
        let root = self.nodes.len();
        let children: Vec<usize> = (0..root).collect();
        self.nodes
            .push(json!({ "name": "world", "rotation": Y_UP_FROM_Z_UP, "children": children }));
        let mut document = json!({
            "asset": { "version": "2.0", "generator": concat!("akrobat ", env!("CARGO_PKG_VERSION")) },
            "scene": 0,
            "scenes": [{ "nodes": [root] }],
            "nodes": self.nodes,
        });
        // The specification forbids empty lists.
        for (key, list) in [
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
            ("animations", self.animations),
        ] {
            if !list.is_empty() {
                document[key] = Value::Array(list);
            }
        }
        if !self.buffer.is_empty() {
            document["buffers"] = json!([{ "byteLength": self.buffer.len() }]);
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let chunks: &[(&[u8; 4], &[u8])] = &[(b"JSON", &text), (b"BIN\0", &self.buffer)];
        let used = chunks.iter().filter(|(_, content)| !content.is_empty());
        let length: usize = 12 + used.clone().map(|(_, content)| 8 + content.len()).sum::<usize>();
        let mut glb = Vec::with_capacity(length);
        glb.extend(b"glTF");
        glb.extend(2u32.to_le_bytes());
        glb.extend((length as u32).to_le_bytes());
        for (kind, content) in used {
            glb.extend((content.len() as u32).to_le_bytes());
            glb.extend(*kind);
            glb.extend(*content);
        }
        glb
    }
}

/// The meshes, all thinned with the finest cell at which they fit.
pub fn thinned_to(meshes: &[&Arc<TriMesh>], limit_bytes: usize) -> Vec<TriMesh> {
    let mut thinned = Vec::new();
    for cell_m in CELLS_M {
        thinned = meshes.iter().map(|mesh| simplified(mesh, cell_m)).collect();
        let bytes: usize = thinned
            .iter()
            .map(|m| m.positions.len() * VERTEX_BYTES + m.triangles.len() * TRIANGLE_BYTES)
            .sum();
        if bytes <= limit_bytes {
            break;
        }
    }
    thinned
}

/// Linear RGBA of a material: its factor, times the mean of its texture.
pub fn mean_color(material: &Material) -> [f32; 4] {
    let Some(texture) = &material.base_color_texture else { return material.base_color };
    // A few thousand texels tell the mean.
    let step = (texture.pixels().len() / 4096).max(1) | 1;
    let mut sum = [0.0f32; 3];
    let mut count = 0.0;
    for texel in texture.pixels().step_by(step) {
        count += 1.0;
        for (sum, &level) in sum.iter_mut().zip(&texel.0) {
            *sum += linear(level);
        }
    }
    let [r, g, b, a] = material.base_color;
    let mean = sum.map(|s| if count > 0.0 { s / count } else { 1.0 });
    [r * mean[0], g * mean[1], b * mean[2], a]
}

/// sRGB level to linear light (IEC 61966-2-1).
fn linear(level: u8) -> f32 {
    let c = f32::from(level) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

fn translation(pose: &Pose) -> [f32; 3] {
    let t = pose.translation.vector;
    [t.x as f32, t.y as f32, t.z as f32]
}

/// xyzw.
fn rotation(pose: &Pose) -> [f32; 4] {
    let q = pose.rotation.coords;
    [q.x as f32, q.y as f32, q.z as f32, q.w as f32]
}

/// Rotations (xyzw) with signs that never jump, as interpolation needs.
fn rotations(poses: &[Pose]) -> Vec<f32> {
    let mut out: Vec<f32> = Vec::with_capacity(4 * poses.len());
    for pose in poses {
        let q = rotation(pose);
        let before = out.last_chunk::<4>().copied().unwrap_or(q);
        let along: f32 = (0..4).map(|i| before[i] * q[i]).sum();
        out.extend(q.map(|v| if along < 0.0 { -v } else { v }));
    }
    out
}

fn moves(body: &Body) -> bool {
    let Some(first) = body.world_from_body.first() else { return false };
    body.world_from_body.iter().any(|pose| {
        (pose.translation.vector - first.translation.vector).norm() > REST
            || pose.rotation.angle_to(&first.rotation) > REST
    })
}

fn bytes_of<T: Copy>(values: &[T], to_bytes: fn(T) -> [u8; 4]) -> Vec<u8> {
    values.iter().flat_map(|&value| to_bytes(value)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gltf::animation::util::ReadOutputs;
    use nalgebra::{UnitQuaternion, Vector3};

    fn tetrahedron() -> Arc<TriMesh> {
        Arc::new(TriMesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
            material: Material { base_color: [0.9, 0.1, 0.2, 1.0], ..Material::default() },
            ..TriMesh::default()
        })
    }

    /// A body that turns once about z and climbs, and a copy of it at rest.
    fn sample() -> (Vec<Body>, Vec<f64>) {
        let times_s: Vec<f64> = (0..=30).map(|k| f64::from(k) / 30.0).collect();
        let turn = |t: &f64| {
            let angle = t * std::f64::consts::TAU;
            Pose::from_parts(
                Vector3::new(1.0, 2.0, *t).into(),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
            )
        };
        let mesh = tetrahedron();
        let moving = Body {
            name: "turner".into(),
            meshes: vec![mesh.clone()],
            world_from_body: times_s.iter().map(turn).collect(),
        };
        let resting = Body {
            name: "still \"quoted\"".into(),
            meshes: vec![mesh],
            world_from_body: vec![Pose::translation(0.0, 0.0, 3.0)],
        };
        (vec![moving, resting], times_s)
    }

    #[test]
    fn another_reader_finds_nodes_meshes_and_colors() {
        let (bodies, times_s) = sample();
        let file = gltf::Gltf::from_slice(&encode(&bodies, &times_s, usize::MAX)).unwrap();
        let names: Vec<_> = file.nodes().filter_map(|node| node.name()).collect();
        assert_eq!(names, ["turner", "still \"quoted\"", "world"]);
        assert_eq!(file.meshes().len(), 1, "bodies of the same geometry share it");
        let primitive = file.meshes().next().unwrap().primitives().next().unwrap();
        let color = primitive.material().pbr_metallic_roughness().base_color_factor();
        assert_eq!(color, [0.9, 0.1, 0.2, 1.0]);
        let blob = file.blob.as_deref().unwrap();
        let reader = primitive.reader(|_| Some(blob));
        let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
        let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
        assert_eq!(indices.len(), 12);
        assert!(indices.iter().all(|&i| (i as usize) < positions.len()));
        for normal in reader.read_normals().unwrap() {
            assert!((Vector3::from(normal).norm() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn up_is_y() {
        let (bodies, times_s) = sample();
        let file = gltf::Gltf::from_slice(&encode(&bodies, &times_s, usize::MAX)).unwrap();
        let root = file.default_scene().unwrap().nodes().next().unwrap();
        let (_, [x, y, z, w], _) = root.transform().decomposed();
        let q = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        assert!((q * Vector3::z() - Vector3::y()).norm() < 1e-6);
        assert_eq!(root.children().count(), 2);
    }

    #[test]
    fn the_animation_covers_the_path_and_turns_without_jumps() {
        let (bodies, times_s) = sample();
        let file = gltf::Gltf::from_slice(&encode(&bodies, &times_s, usize::MAX)).unwrap();
        let blob = file.blob.as_deref().unwrap();
        let animation = file.animations().next().unwrap();
        assert_eq!(animation.channels().count(), 2, "only the moving body has channels");
        for channel in animation.channels() {
            assert_eq!(channel.target().node().name(), Some("turner"));
            let reader = channel.reader(|_| Some(blob));
            let inputs: Vec<f32> = reader.read_inputs().unwrap().collect();
            assert_eq!((inputs.len(), inputs[0], inputs[30]), (31, 0.0, 1.0));
            match reader.read_outputs().unwrap() {
                ReadOutputs::Translations(values) => {
                    assert_eq!(values.last(), Some([1.0, 2.0, 1.0]));
                }
                ReadOutputs::Rotations(values) => {
                    let values: Vec<[f32; 4]> = values.into_f32().collect();
                    let along =
                        |pair: &[[f32; 4]]| (0..4).map(|i| pair[0][i] * pair[1][i]).sum::<f32>();
                    assert!(values.windows(2).all(|pair| along(pair) > 0.9));
                }
                _ => panic!("unexpected channel"),
            }
        }
    }

    #[test]
    fn a_limit_thins_the_meshes() {
        let side = 60u32;
        let vertex = |k: u32| [(k % side) as f32 * 1e-3, (k / side) as f32 * 1e-3, 0.0];
        let square = |k: u32| [[k, k + 1, k + side], [k + 1, k + side + 1, k + side]];
        let plate = TriMesh {
            positions: (0..side * side).map(vertex).collect(),
            triangles: (0..side * (side - 1))
                .filter(|k| k % side < side - 1)
                .flat_map(square)
                .collect(),
            ..TriMesh::default()
        };
        let body = Body {
            name: "plate".into(),
            meshes: vec![Arc::new(plate)],
            world_from_body: vec![Pose::identity()],
        };
        let full = encode(std::slice::from_ref(&body), &[], usize::MAX);
        let small = encode(std::slice::from_ref(&body), &[], 40_000);
        assert!(full.len() > 150_000 && small.len() < 45_000, "{} {}", full.len(), small.len());
        let file = gltf::Gltf::from_slice(&small).unwrap();
        let bounds = file.meshes().next().unwrap().primitives().next().unwrap().bounding_box();
        assert!(bounds.max[0] > 0.055, "the plate keeps its size: {bounds:?}");
    }
}
