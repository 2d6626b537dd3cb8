//! `<geom>`: primitives and meshes.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use akrobat_model::{Link, Material, ModelError, Part, Pose, Shape, mesh_io};
use nalgebra::{UnitQuaternion, Vector3};
use roxmltree::Node;

use super::Compiler;
use super::asset::{Assets, linear};
use super::orientation::{list, pose_of};
use crate::import::Ledger;
use crate::import::xml::{error, numbers};

/// Half edge of planes that have no size, metres, and how thick planes are made.
const UNBOUNDED_PLANE_M: f64 = 10.0;
const PLANE_THICKNESS_M: f64 = 0.02;

/// A shape and what it is for.
#[derive(Debug, Clone)]
pub struct Geom {
    /// The shape in the body's frame.
    pub part: Part,
    collides: bool,
    is_shown: bool,
}

/// MuJoCo shows these groups where nothing else is said.
const SHOWN_GROUPS: std::ops::Range<i64> = 0..3;

/// The parts of a geom: a capsule is three.
pub fn read(
    path: &Path,
    node: Node,
    attributes: &BTreeMap<String, String>,
    compiler: &Compiler,
    assets: &Assets,
    ledger: &mut Ledger,
) -> Result<Vec<Geom>, ModelError> {
    let fail = |message: String| error(path, node, message);
    let name = attributes.get("name").map_or("geom", String::as_str);
    let mesh = attributes.get("mesh");
    let kind = attributes
        .get("type")
        .map_or(if mesh.is_some() { "mesh" } else { "sphere" }, String::as_str);
    let size = attributes.get("size").map_or(Ok(Vec::new()), |t| numbers(t)).map_err(fail)?;
    let mut pose = pose_of(attributes, compiler).map_err(fail)?;
    let mut half_length = None;
    if let Some(ends) = list::<6>(attributes, "fromto").map_err(fail)? {
        let [from, to] = [&ends[..3], &ends[3..]].map(Vector3::from_row_slice);
        let along = to - from;
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &along).unwrap_or_else(|| {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
        pose = Pose::from_parts(((from + to) / 2.0).into(), turn);
        half_length = Some(along.norm() / 2.0);
    }
    let needs = |count: usize| -> Result<&[f64], ModelError> {
        let long_enough = size.len() >= count && size[..count].iter().all(|&s| s > 0.0);
        long_enough.then_some(&size[..]).ok_or_else(|| {
            fail(format!("{kind} \"{name}\": size: expected {count} lengths above 0, got {size:?}"))
        })
    };
    let shapes: Vec<(Pose, Shape)> = match kind {
        "sphere" => vec![(Pose::identity(), Shape::Sphere { radius: needs(1)?[0] })],
        "box" => {
            let size = match half_length {
                Some(half) => [needs(1)?[0], *size.get(1).unwrap_or(&size[0]), half],
                None => [needs(3)?[0], size[1], size[2]],
            };
            vec![(Pose::identity(), Shape::Box { size: size.map(|s| 2.0 * s) })]
        }
        "cylinder" | "capsule" => {
            let half = match half_length {
                Some(half) => half,
                None => needs(2)?[1],
            };
            let radius = needs(1)?[0];
            let mut shapes =
                vec![(Pose::identity(), Shape::Cylinder { radius, length: 2.0 * half })];
            if kind == "capsule" {
                let end = |z: f64| (Pose::translation(0.0, 0.0, z), Shape::Sphere { radius });
                shapes.extend([end(half), end(-half)]);
            }
            shapes
        }
        "ellipsoid" => vec![(Pose::identity(), ellipsoid(name, [needs(3)?[0], size[1], size[2]]))],
        "plane" => {
            let edge =
                |i: usize| size.get(i).copied().filter(|&s| s > 0.0).unwrap_or(UNBOUNDED_PLANE_M);
            let size = [2.0 * edge(0), 2.0 * edge(1), PLANE_THICKNESS_M];
            vec![(Pose::translation(0.0, 0.0, -PLANE_THICKNESS_M / 2.0), Shape::Box { size })]
        }
        "mesh" => {
            let Some(mesh) = mesh else {
                return Err(fail(format!("mesh \"{name}\" names no mesh")));
            };
            let Some((source, meshes)) = assets.meshes.get(mesh) else {
                ledger.lost(format!("geom \"{name}\": its mesh \"{mesh}\" is not there"));
                return Ok(Vec::new());
            };
            vec![(Pose::identity(), Shape::Mesh { source: source.clone(), meshes: meshes.clone() })]
        }
        other => {
            ledger.lost(format!("geom \"{name}\": type \"{other}\" is not taken over"));
            return Ok(Vec::new());
        }
    };
    let integer = |name: &str, fallback: i64| {
        attributes.get(name).and_then(|v| v.parse().ok()).unwrap_or(fallback)
    };
    let collides = integer("contype", 1) != 0 || integer("conaffinity", 1) != 0;
    let is_shown = SHOWN_GROUPS.contains(&integer("group", 0));
    let material = material(attributes, assets, kind == "mesh").map_err(fail)?;
    let part_name = attributes.get("name").or(mesh).map_or(kind, String::as_str);
    let geom = |(offset, shape): (Pose, Shape)| Geom {
        part: Part {
            name: part_name.to_owned(),
            link_from_part: pose * offset,
            shape,
            material: material.clone(),
        },
        collides,
        is_shown,
    };
    Ok(shapes.into_iter().map(geom).collect())
}

fn ellipsoid(name: &str, radii: [f64; 3]) -> Shape {
    let unit = Part {
        name: name.to_owned(),
        link_from_part: Pose::identity(),
        shape: Shape::Sphere { radius: 1.0 },
        material: None,
    };
    let meshes = mesh_io::scaled(&unit.triangulate(), radii);
    Shape::Mesh { source: format!("{name}.obj"), meshes: Arc::new(meshes) }
}

/// A geom's own colour, else its material; a mesh without either keeps what its file says.
fn material(
    attributes: &BTreeMap<String, String>,
    assets: &Assets,
    is_mesh: bool,
) -> Result<Option<Material>, String> {
    let named = attributes.get("material").and_then(|m| assets.materials.get(m)).cloned();
    let rgba = list::<4>(attributes, "rgba")?;
    Ok(match (named, rgba) {
        (Some(material), None) => Some(material),
        (_, Some(rgba)) => {
            Some(Material { name: "rgba".into(), base_color: linear(rgba), ..Material::default() })
        }
        (None, None) if is_mesh => None,
        (None, None) => Some(Material { name: "grey".into(), ..Material::default() }),
    })
}

/// Gives a link its shapes. Where a body has shapes that are only seen, those that collide are not seen.
pub fn share_out(geoms: Vec<Geom>, link: &mut Link) {
    let has_visuals = geoms.iter().any(|g| !g.collides && g.is_shown);
    for geom in geoms {
        let is_seen = geom.is_shown && !(geom.collides && has_visuals);
        if is_seen {
            link.visuals.push(geom.part.clone());
        }
        if geom.collides {
            link.collisions.push(geom.part);
        }
    }
}
