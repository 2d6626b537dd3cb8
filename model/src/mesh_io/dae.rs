//! COLLADA 1.4/1.5: geometry, node transforms, unit, diffuse colour or texture. `<up_axis>` is
//! ignored on purpose; see [`super`].

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use nalgebra::{Matrix4, Unit, Vector3};
use roxmltree::{Document, Node};

use super::MeshFile;
use super::assemble::{Assembler, Attributes, Corner};
use super::texture::TextureCache;
use super::transform::mapped;
use crate::{Material, ModelError, TriMesh};

/// Nodes nested deeper than this are taken for a cycle of `<instance_node>`.
const MAX_DEPTH: usize = 64;

/// Reads a COLLADA file's content; textures are looked up beside it.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<MeshFile, ModelError> {
    let text = String::from_utf8_lossy(bytes);
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let document = Document::parse_with_options(&text, options)
        .map_err(|e| ModelError::invalid(path, format!("malformed XML: {e}")))?;
    let root = document.root_element();
    if root.tag_name().name() != "COLLADA" {
        return Err(ModelError::invalid(
            path,
            format!("expected a <COLLADA> root element, got <{}>", root.tag_name().name()),
        ));
    }
    let by_id = root.descendants().filter_map(|n| Some((n.attribute("id")?, n))).collect();
    let mut reader = Reader {
        by_id,
        folder: path.parent().unwrap_or(Path::new("")),
        textures: TextureCache::default(),
        meshes: Vec::new(),
    };
    reader.file(root).map_err(|Fault { line, reason }| {
        ModelError::invalid(path, format!("line {line}: {reason}"))
    })?;
    Ok(MeshFile { meshes: reader.meshes, notes: reader.textures.notes })
}

/// What is wrong, and on which line.
struct Fault {
    line: u32,
    reason: String,
}

fn fault<T>(node: Node, reason: impl Into<String>) -> Result<T, Fault> {
    let line = node.document().text_pos_at(node.range().start).row;
    Err(Fault { line, reason: reason.into() })
}

type Parsed<T> = Result<T, Fault>;

struct Reader<'a, 'input> {
    by_id: HashMap<&'a str, Node<'a, 'input>>,
    folder: &'a Path,
    textures: TextureCache,
    meshes: Vec<TriMesh>,
}

impl<'a, 'input> Reader<'a, 'input> {
    fn file(&mut self, root: Node<'a, 'input>) -> Parsed<()> {
        let metres_from_unit = unit_in_metres(root)?;
        let scale = Matrix4::new_scaling(metres_from_unit);
        let scene = child(root, "scene").and_then(|s| child(s, "instance_visual_scene"));
        if let Some(instance) = scene {
            let scene = self.target(instance, "url")?;
            for node in children(scene, "node") {
                self.node(node, &scale, 0)?;
            }
            return Ok(());
        }
        let geometries = root.descendants().filter(|n| n.tag_name().name() == "geometry");
        for geometry in geometries.collect::<Vec<_>>() {
            self.geometry(geometry, None, &scale)?;
        }
        Ok(())
    }

    /// The element that `attribute` (`#id`) refers to.
    fn target(&self, node: Node<'a, 'input>, attribute: &str) -> Parsed<Node<'a, 'input>> {
        let reference = node.attribute(attribute).unwrap_or("");
        match self.by_id.get(reference.trim_start_matches('#')) {
            Some(target) => Ok(*target),
            None => {
                let name = node.tag_name().name();
                fault(node, format!("<{name} {attribute}=\"{reference}\"> refers to nothing"))
            }
        }
    }

    fn node(
        &mut self,
        node: Node<'a, 'input>,
        file_from_parent: &Matrix4<f64>,
        depth: usize,
    ) -> Parsed<()> {
        if depth > MAX_DEPTH {
            return fault(node, format!("nodes are nested more than {MAX_DEPTH} deep: a cycle?"));
        }
        let mut file_from_node = *file_from_parent;
        for element in node.children().filter(Node::is_element) {
            if let Some(step) = transform_step(element)? {
                file_from_node *= step;
            }
        }
        for element in node.children().filter(Node::is_element) {
            match element.tag_name().name() {
                "node" => self.node(element, &file_from_node, depth + 1)?,
                "instance_node" => {
                    let target = self.target(element, "url")?;
                    self.node(target, &file_from_node, depth + 1)?;
                }
                "instance_geometry" => {
                    let geometry = self.target(element, "url")?;
                    self.geometry(geometry, Some(element), &file_from_node)?;
                }
                "instance_controller" => {
                    let controller = self.target(element, "url")?;
                    if let Some(skin) = child(controller, "skin") {
                        let geometry = self.target(skin, "source")?;
                        self.geometry(geometry, Some(element), &file_from_node)?;
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn geometry(
        &mut self,
        geometry: Node<'a, 'input>,
        instance: Option<Node<'a, 'input>>,
        file_from_geometry: &Matrix4<f64>,
    ) -> Parsed<()> {
        let Some(mesh) = child(geometry, "mesh") else { return Ok(()) };
        for primitive in mesh.children().filter(Node::is_element) {
            let kind = primitive.tag_name().name();
            if !matches!(kind, "triangles" | "polylist" | "polygons" | "tristrips" | "trifans") {
                continue;
            }
            if let Some(mut triangles) = self.primitive(primitive)? {
                triangles.material = self.material(primitive, instance);
                self.meshes.extend(mapped(&[triangles], file_from_geometry));
            }
        }
        Ok(())
    }

    fn primitive(&self, primitive: Node<'a, 'input>) -> Parsed<Option<TriMesh>> {
        let inputs = self.inputs(primitive)?;
        let attributes =
            Attributes { positions: &inputs.positions, uvs: &inputs.uvs, normals: &inputs.normals };
        let mut assembler = Assembler::default();
        for polygon in polygons(primitive, inputs.stride)? {
            let corners: Vec<Corner> = polygon
                .chunks_exact(inputs.stride)
                .map(|indices| inputs.corner(indices))
                .collect::<Result<_, _>>()
                .or_else(|reason| fault(primitive, reason))?;
            assembler.polygon(&corners, &attributes);
        }
        Ok(assembler.finish())
    }

    fn inputs(&self, primitive: Node<'a, 'input>) -> Parsed<Inputs> {
        let mut inputs = Inputs::default();
        for input in children(primitive, "input") {
            let offset = input.attribute("offset").unwrap_or("0");
            let Ok(offset) = offset.parse::<usize>() else {
                return fault(input, format!("expected an input offset, got \"{offset}\""));
            };
            inputs.stride = inputs.stride.max(offset + 1);
            let source = self.target(input, "source")?;
            match input.attribute("semantic").unwrap_or("") {
                "VERTEX" => {
                    inputs.position_offset = Some(offset);
                    for nested in children(source, "input") {
                        let source = self.target(nested, "source")?;
                        match nested.attribute("semantic").unwrap_or("") {
                            "POSITION" => inputs.positions = self.vectors(source)?,
                            "NORMAL" if inputs.normal_offset.is_none() => {
                                inputs.normals = self.vectors(source)?;
                                inputs.normal_offset = Some(offset);
                            }
                            "TEXCOORD" if inputs.uv_offset.is_none() => {
                                inputs.uvs = self.vectors(source)?;
                                inputs.uv_offset = Some(offset);
                            }
                            _ => {}
                        }
                    }
                }
                "NORMAL" => {
                    inputs.normals = self.vectors(source)?;
                    inputs.normal_offset = Some(offset);
                }
                "TEXCOORD" if inputs.uv_offset.is_none() => {
                    inputs.uvs = self.vectors(source)?;
                    inputs.uv_offset = Some(offset);
                }
                _ => {}
            }
        }
        if inputs.position_offset.is_none() {
            return fault(primitive, "the primitive has no VERTEX input");
        }
        Ok(inputs)
    }

    /// The first `N` numbers of each element of a `<source>`.
    fn vectors<const N: usize>(&self, source: Node<'a, 'input>) -> Parsed<Vec<[f32; N]>> {
        let accessor = child(source, "technique_common").and_then(|t| child(t, "accessor"));
        let array = match accessor {
            Some(accessor) => self.target(accessor, "source")?,
            None => match child(source, "float_array") {
                Some(array) => array,
                None => return fault(source, "<source> has no <float_array>"),
            },
        };
        let attribute = |name: &str, default: usize| {
            accessor.and_then(|a| a.attribute(name)).and_then(|v| v.parse().ok()).unwrap_or(default)
        };
        let (stride, offset) = (attribute("stride", N), attribute("offset", 0));
        if stride < N {
            return fault(source, format!("expected {N} numbers per element, got {stride}"));
        }
        let values: Vec<f32> = numbers(array)?;
        let values = values.get(offset..).unwrap_or(&[]);
        Ok(values.chunks_exact(stride).map(|v| std::array::from_fn(|i| v[i])).collect())
    }

    /// The diffuse appearance bound to a primitive's material symbol; the default where there is none.
    fn material(
        &mut self,
        primitive: Node<'a, 'input>,
        instance: Option<Node<'a, 'input>>,
    ) -> Material {
        let Some(symbol) = primitive.attribute("material") else { return Material::default() };
        let bound = instance.and_then(|instance| {
            instance
                .descendants()
                .filter(|n| n.tag_name().name() == "instance_material")
                .find(|n| n.attribute("symbol") == Some(symbol))
                .and_then(|n| n.attribute("target"))
        });
        let id = bound.unwrap_or(symbol).trim_start_matches('#');
        let mut material = Material { name: symbol.to_owned(), ..Material::default() };
        let by_id = |reference: &str| self.by_id.get(reference.trim_start_matches('#')).copied();
        let effect = by_id(id)
            .and_then(|m| child(m, "instance_effect"))
            .and_then(|e| by_id(e.attribute("url")?));
        let Some(profile) = effect.and_then(|e| child(e, "profile_COMMON")) else {
            return material;
        };
        let shading = child(profile, "technique").and_then(|technique| {
            technique
                .children()
                .find(|n| matches!(n.tag_name().name(), "phong" | "blinn" | "lambert" | "constant"))
        });
        let Some(diffuse) = shading.and_then(|s| child(s, "diffuse")) else { return material };
        if let Some(color) = child(diffuse, "color").and_then(|c| numbers::<f32>(c).ok())
            && let [r, g, b, ..] = color[..]
        {
            material.base_color = [r, g, b, 1.0];
        }
        if let Some(sampler) = child(diffuse, "texture").and_then(|t| t.attribute("texture")) {
            material.base_color = [1.0; 4];
            material.base_color_texture = self.texture(profile, sampler);
        }
        material
    }

    /// sampler -> surface -> image -> file; short cuts on the way are common and accepted.
    fn texture(
        &mut self,
        profile: Node<'a, 'input>,
        sampler: &str,
    ) -> Option<Arc<image::RgbaImage>> {
        let parameter =
            |sid: &str| children(profile, "newparam").find(|p| p.attribute("sid") == Some(sid));
        let text = |node: Node<'a, 'input>| node.text().map(|t| t.trim().to_owned());
        let sampler_source = parameter(sampler)
            .and_then(|p| child(p, "sampler2D"))
            .and_then(|s| child(s, "source").or_else(|| child(s, "instance_image")))
            .and_then(|s| {
                s.attribute("url").map(|u| u.trim_start_matches('#').to_owned()).or(text(s))
            })
            .unwrap_or_else(|| sampler.to_owned());
        let image = parameter(&sampler_source)
            .and_then(|p| child(p, "surface"))
            .and_then(|s| child(s, "init_from"))
            .and_then(text)
            .unwrap_or(sampler_source);
        let init = self.by_id.get(image.as_str()).and_then(|i| child(*i, "init_from"))?;
        let file = child(init, "ref").and_then(text).or_else(|| text(init))?;
        let file = file.strip_prefix("file://").unwrap_or(&file);
        self.textures.get(self.folder, &super::gltf::percent_decoded(file))
    }
}

/// The arrays of one primitive and where its index tuples name them.
#[derive(Default)]
struct Inputs {
    positions: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    position_offset: Option<usize>,
    uv_offset: Option<usize>,
    normal_offset: Option<usize>,
    stride: usize,
}

impl Inputs {
    fn corner(&self, indices: &[usize]) -> Result<Corner, String> {
        let pick = |offset: Option<usize>, count: usize, what: &str| match offset {
            None => Ok(None),
            Some(offset) if indices[offset] < count => Ok(Some(indices[offset])),
            Some(offset) => {
                Err(format!("{what} index {} is out of range 0..{count}", indices[offset]))
            }
        };
        let position = pick(self.position_offset, self.positions.len(), "position")?;
        Ok(Corner {
            position: position.ok_or("the primitive has no VERTEX input")?,
            uv: pick(self.uv_offset, self.uvs.len(), "texture coordinate")?,
            normal: pick(self.normal_offset, self.normals.len(), "normal")?,
        })
    }
}

/// The index tuples of each polygon of a primitive, `stride` indices per corner.
fn polygons(primitive: Node, stride: usize) -> Parsed<Vec<Vec<usize>>> {
    let kind = primitive.tag_name().name();
    let mut polygons = Vec::new();
    if kind == "polylist" {
        let indices: Vec<usize> =
            child(primitive, "p").map(numbers).transpose()?.unwrap_or_default();
        let counts: Vec<usize> =
            child(primitive, "vcount").map(numbers).transpose()?.unwrap_or_default();
        let mut at = 0;
        for count in counts {
            let Some(polygon) = indices.get(at..at + count * stride) else {
                return fault(primitive, "<vcount> asks for more corners than <p> has");
            };
            polygons.push(polygon.to_vec());
            at += count * stride;
        }
        return Ok(polygons);
    }
    let direct = children(primitive, "p");
    let with_holes = children(primitive, "ph").filter_map(|ph| child(ph, "p"));
    for p in direct.chain(with_holes) {
        let indices: Vec<usize> = numbers(p)?;
        if !indices.len().is_multiple_of(stride) {
            return fault(p, format!("expected groups of {stride} indices, got {}", indices.len()));
        }
        let corner = |i: usize| &indices[i * stride..(i + 1) * stride];
        let count = indices.len() / stride;
        match kind {
            "triangles" if !count.is_multiple_of(3) => {
                return fault(p, format!("expected a multiple of 3 corners, got {count}"));
            }
            "triangles" => polygons.extend(indices.chunks_exact(3 * stride).map(<[usize]>::to_vec)),
            "tristrips" => polygons.extend((2..count).map(|i| {
                let [a, b] = if i % 2 == 0 { [i - 2, i - 1] } else { [i - 1, i - 2] };
                [corner(a), corner(b), corner(i)].concat()
            })),
            "trifans" => {
                polygons.extend((2..count).map(|i| [corner(0), corner(i - 1), corner(i)].concat()))
            }
            _ => polygons.push(indices),
        }
    }
    Ok(polygons)
}

/// The matrix of one transform element of a node; `None` for other elements.
fn transform_step(element: Node) -> Parsed<Option<Matrix4<f64>>> {
    let kind = element.tag_name().name();
    let expected = match kind {
        "matrix" => 16,
        "rotate" => 4,
        "translate" | "scale" => 3,
        _ => return Ok(None),
    };
    let v: Vec<f64> = numbers(element)?;
    if v.len() != expected {
        return fault(element, format!("<{kind}> needs {expected} numbers, got {}", v.len()));
    }
    Ok(Some(match kind {
        "matrix" => Matrix4::from_row_slice(&v),
        "translate" => Matrix4::new_translation(&Vector3::new(v[0], v[1], v[2])),
        "scale" => Matrix4::new_nonuniform_scaling(&Vector3::new(v[0], v[1], v[2])),
        _ => Unit::try_new(Vector3::new(v[0], v[1], v[2]), 1e-12)
            .map_or_else(Matrix4::identity, |axis| {
                Matrix4::from_axis_angle(&axis, v[3].to_radians())
            }),
    }))
}

fn unit_in_metres(root: Node) -> Parsed<f64> {
    let unit = child(root, "asset").and_then(|a| child(a, "unit"));
    let Some((unit, text)) = unit.and_then(|u| Some((u, u.attribute("meter")?))) else {
        return Ok(1.0);
    };
    match text.trim().parse::<f64>() {
        Ok(metres) if metres.is_finite() && metres > 0.0 => Ok(metres),
        _ => fault(unit, format!("expected a positive unit in metres, got \"{text}\"")),
    }
}

fn children<'a, 'input: 'a>(
    node: Node<'a, 'input>,
    name: &'a str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |n| n.tag_name().name() == name)
}

fn child<'a, 'input: 'a>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|n| n.tag_name().name() == name)
}

/// The numbers in an element's text.
fn numbers<T: std::str::FromStr>(node: Node) -> Parsed<Vec<T>> {
    let text = node.text().unwrap_or("");
    let parse = |word: &str| word.parse().or_else(|_| fault(node, format!("not a number: {word}")));
    text.split_whitespace().map(parse).collect()
}
