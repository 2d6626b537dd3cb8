//! A scene as binary glTF 2.0: one node a body, one primitive a finish, textures inside.

use std::collections::BTreeMap;
use std::io::Cursor;

use akrobat_model::Pose;
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

use super::PlacedBody;
use crate::error::AssetError;
use crate::finish::Finish;

/// Values of glTF: component type `float`, buffer targets, filters and wrapping are its defaults.
const FLOAT: u32 = 5126;
const MAGIC: u32 = 0x4654_6C67;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;

/// The file.
pub fn glb(bodies: &[PlacedBody]) -> Result<Vec<u8>, AssetError> {
    let mut writer = Writer::default();
    for body in bodies {
        writer.add_body(body)?;
    }
    Ok(writer.finish())
}

#[derive(Default)]
struct Writer {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    images: Vec<Value>,
    textures: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    material_of: BTreeMap<String, usize>,
}

/// Z up to Y up.
fn turned(v: [f64; 3]) -> [f64; 3] {
    [v[0], v[2], -v[1]]
}

impl Writer {
    fn add_body(&mut self, body: &PlacedBody) -> Result<(), AssetError> {
        let mut primitives = Vec::new();
        for visual in &body.link.visuals {
            let material = self.material(&visual.finish)?;
            let (mut positions, mut normals, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
            for solid in &visual.solids {
                let corner_normals = solid.corner_normals();
                for (triangle, face_normals) in solid.triangles.iter().zip(&corner_normals) {
                    for (corner, normal) in triangle.iter().zip(face_normals) {
                        let Point3 { coords } = solid.positions[corner.position];
                        positions.push(turned(coords.into()));
                        let normal: Vector3<f64> = *normal;
                        normals.push(turned(normal.into()));
                        let [u, v] = solid.uvs[corner.uv];
                        // Row 0 is the top of an image here, and the bottom in OBJ.
                        uvs.push([u / visual.finish.tile_m, 1.0 - v / visual.finish.tile_m]);
                    }
                }
            }
            let attributes = json!({
                "POSITION": self.accessor(&positions, true),
                "NORMAL": self.accessor(&normals, false),
                "TEXCOORD_0": self.accessor(&uvs, false),
            });
            primitives.push(json!({ "attributes": attributes, "material": material }));
        }
        let mesh = self.meshes.len();
        self.meshes.push(json!({ "name": body.name, "primitives": primitives }));
        self.nodes.push(node(body, mesh));
        Ok(())
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.binary.len().is_multiple_of(4) {
            self.binary.push(0);
        }
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len()
        }));
        self.binary.extend_from_slice(bytes);
        self.views.len() - 1
    }

    fn accessor<const N: usize>(&mut self, rows: &[[f64; N]], bounds: bool) -> usize {
        let single = |v: f64| v as f32;
        let bytes: Vec<u8> = rows.iter().flatten().flat_map(|&v| single(v).to_le_bytes()).collect();
        let view = self.view(&bytes);
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "count": rows.len(),
            "type": if N == 2 { "VEC2" } else { "VEC3" },
        });
        if bounds {
            let fold = |pick: fn(f32, f32) -> f32, from: f32| -> Vec<f32> {
                (0..N).map(|i| rows.iter().map(|row| single(row[i])).fold(from, pick)).collect()
            };
            accessor["min"] = json!(fold(f32::min, f32::INFINITY));
            accessor["max"] = json!(fold(f32::max, f32::NEG_INFINITY));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn material(&mut self, finish: &Finish) -> Result<usize, AssetError> {
        if let Some(&known) = self.material_of.get(&finish.name) {
            return Ok(known);
        }
        let mut appearance = json!({
            "baseColorFactor": base_color(finish),
            "metallicFactor": finish.metallic,
            "roughnessFactor": finish.roughness,
        });
        if let Some(texture) = finish.texture {
            let mut png = Cursor::new(Vec::new());
            texture.image().write_to(&mut png, image::ImageFormat::Png).map_err(|source| {
                AssetError::Texture { path: format!("{}.png", finish.name).into(), source }
            })?;
            let view = self.view(&png.into_inner());
            self.images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
            self.textures.push(json!({ "source": self.images.len() - 1 }));
            appearance["baseColorTexture"] = json!({ "index": self.textures.len() - 1 });
        }
        self.materials.push(json!({ "name": finish.name, "pbrMetallicRoughness": appearance }));
        self.material_of.insert(finish.name.clone(), self.materials.len() - 1);
        Ok(self.materials.len() - 1)
    }

    fn finish(mut self) -> Vec<u8> {
        while !self.binary.len().is_multiple_of(4) {
            self.binary.push(0);
        }
        let nodes: Vec<usize> = (0..self.nodes.len()).collect();
        let mut document = json!({
            "asset": { "version": "2.0", "generator": "Akrobat" },
            "scene": 0,
            "scenes": [{ "nodes": nodes }],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.binary.len() }],
        });
        if !self.images.is_empty() {
            document["images"] = json!(self.images);
            document["textures"] = json!(self.textures);
        }
        let mut text = document.to_string().into_bytes();
        while !text.len().is_multiple_of(4) {
            text.push(b' ');
        }
        let total = 12 + 8 + text.len() + 8 + self.binary.len();
        let mut file = Vec::with_capacity(total);
        let word = |file: &mut Vec<u8>, value: u32| file.extend(value.to_le_bytes());
        word(&mut file, MAGIC);
        word(&mut file, 2);
        word(&mut file, total as u32);
        word(&mut file, text.len() as u32);
        word(&mut file, JSON_CHUNK);
        file.extend(text);
        word(&mut file, self.binary.len() as u32);
        word(&mut file, BINARY_CHUNK);
        file.extend(self.binary);
        file
    }
}

fn node(body: &PlacedBody, mesh: usize) -> Value {
    let Pose { translation, rotation } = body.world_from_body;
    let q = rotation.quaternion();
    let [x, y, z] = turned([q.i, q.j, q.k]);
    json!({
        "name": body.name,
        "mesh": mesh,
        "translation": turned(translation.vector.into()),
        "rotation": [x, y, z, q.w],
        "extras": { "class": body.class },
    })
}

/// Linear RGBA from the finish's sRGB; white under a texture.
pub(super) fn base_color(finish: &Finish) -> [f64; 4] {
    if finish.texture.is_some() {
        return [1.0; 4];
    }
    // IEC 61966-2-1.
    let linear = |c: f64| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    let [r, g, b] = finish.color.map(linear);
    [r, g, b, 1.0]
}
