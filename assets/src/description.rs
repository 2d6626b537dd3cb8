//! Articulated things as solids, boxes and joints, and how they are written.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use akrobat_model::tree::{Inertial, Mimic};
use akrobat_model::urdf;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, Part, Pose, Shape};
use nalgebra::{Matrix3, Vector3};

use crate::error::{AssetError, make_folder, write_file};
use crate::finish::Finish;
use crate::import::free_name;
use crate::solid::Solid;

/// Solids of one finish; written as one OBJ file.
#[derive(Debug, Clone)]
pub struct Visual {
    /// Name, unique in its link.
    pub name: String,
    /// Surface finish.
    pub finish: Finish,
    /// The solids, in the link's frame.
    pub solids: Vec<Solid>,
}

/// A box that stands for part of a link in collision checks.
#[derive(Debug, Clone)]
pub struct CollisionBox {
    /// Name for reports.
    pub name: String,
    /// Pose of the box's centre in the link's frame.
    pub link_from_box: Pose,
    /// Edge lengths, metres.
    pub size: [f64; 3],
}

impl CollisionBox {
    /// An axis-aligned box between two corners of the link's frame, metres.
    pub fn between(name: &str, low: [f64; 3], high: [f64; 3]) -> Self {
        let centre = |axis: usize| (low[axis] + high[axis]) / 2.0;
        Self {
            name: name.into(),
            link_from_box: Pose::translation(centre(0), centre(1), centre(2)),
            size: std::array::from_fn(|axis| high[axis] - low[axis]),
        }
    }
}

/// A rigid link.
#[derive(Debug, Clone)]
pub struct LinkDescription {
    /// Unique name.
    pub name: String,
    /// What is seen.
    pub visuals: Vec<Visual>,
    /// What collides.
    pub collisions: Vec<CollisionBox>,
    /// Mass, kg, spread evenly over the collision boxes; 0 for the static surroundings.
    pub mass_kg: f64,
}

impl LinkDescription {
    /// A link without shape or mass.
    pub fn new(name: &str, mass_kg: f64) -> Self {
        Self { name: name.into(), visuals: Vec::new(), collisions: Vec::new(), mass_kg }
    }

    /// Adds a box that is seen and collides.
    pub fn add_box(&mut self, name: &str, finish: &Finish, low: [f64; 3], high: [f64; 3]) {
        self.add_visual(name, finish, vec![Solid::cuboid(low, high)]);
        self.collisions.push(CollisionBox::between(name, low, high));
    }

    /// Adds solids that are seen; solids of one finish and name share a file.
    pub fn add_visual(&mut self, name: &str, finish: &Finish, solids: Vec<Solid>) {
        match self.visuals.iter_mut().find(|v| v.name == name && v.finish == *finish) {
            Some(visual) => visual.solids.extend(solids),
            None => self.visuals.push(Visual { name: name.into(), finish: finish.clone(), solids }),
        }
    }

    /// Mass properties of the collision boxes with the mass spread evenly over their volume.
    fn inertial(&self) -> Option<Inertial> {
        if self.mass_kg <= 0.0 || self.collisions.is_empty() {
            return None;
        }
        let volume = |b: &CollisionBox| b.size.iter().product::<f64>();
        let density = self.mass_kg / self.collisions.iter().map(volume).sum::<f64>();
        let centre = self
            .collisions
            .iter()
            .map(|b| b.link_from_box.translation.vector * (volume(b) * density / self.mass_kg))
            .sum::<Vector3<f64>>();
        let inertia = self
            .collisions
            .iter()
            .map(|b| box_inertia(b, volume(b) * density, &centre))
            .sum::<Matrix3<f64>>();
        Some(Inertial {
            mass: self.mass_kg,
            link_from_inertia: Pose::translation(centre.x, centre.y, centre.z),
            inertia: [
                inertia[(0, 0)],
                inertia[(0, 1)],
                inertia[(0, 2)],
                inertia[(1, 1)],
                inertia[(1, 2)],
                inertia[(2, 2)],
            ],
        })
    }
}

/// Inertia of a homogeneous box about a point, along the link's axes: the box's own, turned, plus the
/// parallel-axis term.
fn box_inertia(shape: &CollisionBox, mass: f64, about: &Vector3<f64>) -> Matrix3<f64> {
    let [x, y, z] = shape.size.map(|edge| edge * edge);
    let own = Matrix3::from_diagonal(&(Vector3::new(y + z, z + x, x + y) * (mass / 12.0)));
    let turn = shape.link_from_box.rotation.to_rotation_matrix();
    let offset = shape.link_from_box.translation.vector - about;
    let parallel = Matrix3::identity() * offset.norm_squared() - offset * offset.transpose();
    turn.matrix() * own * turn.matrix().transpose() + parallel * mass
}

/// How a joint moves its child.
#[derive(Debug, Clone)]
pub struct Motion {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Axis in the parent's frame.
    pub axis: Vector3<f64>,
    /// Lower and upper limit, rad or m.
    pub limits: [f64; 2],
    /// Largest speed, rad/s or m/s.
    pub velocity: f64,
    /// Viscous damping, N m s/rad or N s/m.
    pub damping: f64,
    /// Coulomb friction, N m or N.
    pub friction: f64,
}

/// A joint; links are given by name.
#[derive(Debug, Clone)]
pub struct JointDescription {
    /// Unique name.
    pub name: String,
    /// Name of the parent link.
    pub parent: String,
    /// Name of the child link.
    pub child: String,
    /// Origin of the child's frame in the parent's, metres; frames are parallel when closed.
    pub origin: [f64; 3],
    /// `None` for a fixed joint.
    pub motion: Option<Motion>,
}

/// A thing made of links and joints, ready to be written as URDF, OBJ, MTL and PNG.
#[derive(Debug, Clone)]
pub struct Description {
    /// Name of the thing and of its URDF file.
    pub name: String,
    /// Links; the first is the root.
    pub links: Vec<LinkDescription>,
    /// Joints.
    pub joints: Vec<JointDescription>,
}

impl Description {
    /// The kinematic tree; its mesh parts name their OBJ files but hold no triangles.
    ///
    /// # Errors
    /// Where the joints do not connect the links to one tree.
    pub fn tree(&self) -> Result<KinematicTree, AssetError> {
        // Simulators want names of shapes that differ in the whole model.
        let mut names = HashSet::new();
        let mut named = |shape: &CollisionBox| {
            let part = box_part(shape);
            let name = free_name(&part.name, |name| names.contains(name));
            names.insert(name.clone());
            Part { name, ..part }
        };
        let links = self.links.iter().map(|link| Link {
            name: link.name.clone(),
            visuals: link.visuals.iter().map(|visual| mesh_part(link, visual)).collect(),
            collisions: link.collisions.iter().map(&mut named).collect(),
            inertial: link.inertial(),
        });
        let joints = self.joints.iter().map(|joint| self.joint(joint)).collect::<Result<_, _>>()?;
        Ok(KinematicTree::new(self.name.clone(), links.collect(), joints)?)
    }

    fn joint(&self, joint: &JointDescription) -> Result<Joint, AssetError> {
        let [x, y, z] = joint.origin;
        let motion = joint.motion.as_ref();
        Ok(Joint {
            name: joint.name.clone(),
            kind: motion.map_or(JointKind::Fixed, |m| m.kind),
            parent: self.link_index(&joint.parent)?,
            child: self.link_index(&joint.child)?,
            parent_from_joint: Pose::translation(x, y, z),
            axis: nalgebra::Unit::new_normalize(motion.map_or(Vector3::x(), |m| m.axis)),
            limits: motion.map_or([0.0; 2], |m| m.limits),
            velocity_limit: motion.map(|m| m.velocity),
            effort_limit: motion.map(|_| 100.0),
            damping: motion.map_or(0.0, |m| m.damping),
            friction: motion.map_or(0.0, |m| m.friction),
            mimic: None::<Mimic>,
        })
    }

    fn link_index(&self, name: &str) -> Result<usize, AssetError> {
        self.links.iter().position(|link| link.name == name).ok_or_else(|| {
            let links = self.links.iter().map(|link| link.name.clone());
            akrobat_model::ModelError::unknown(&self.name, "link", name, links).into()
        })
    }

    /// Writes `<name>.urdf` and its meshes, materials and textures (in `meshes/`) into `folder`, which
    /// is made where it is missing.
    ///
    /// # Errors
    /// Where a file cannot be written or the joints do not form a tree.
    pub fn write(&self, folder: &Path) -> Result<(), AssetError> {
        let tree = self.tree()?;
        let meshes = folder.join("meshes");
        make_folder(&meshes)?;
        let library = format!("{}.mtl", self.name);
        let mut finishes = BTreeMap::new();
        for link in &self.links {
            for visual in &link.visuals {
                finishes.insert(visual.finish.name.as_str(), &visual.finish);
                write_file(&meshes.join(mesh_name(link, visual)), obj_text(visual, &library))?;
            }
        }
        write_file(&meshes.join(library), mtl_text(finishes.values().copied()))?;
        for (name, texture) in finishes.iter().filter_map(|(n, f)| f.texture.map(|t| (n, t))) {
            let path = meshes.join(format!("{name}.png"));
            let image = texture.image();
            image.save(&path).map_err(|source| AssetError::Texture { path, source })?;
        }
        write_file(&folder.join(format!("{}.urdf", self.name)), urdf::to_string(&tree))
    }
}

fn mesh_name(link: &LinkDescription, visual: &Visual) -> String {
    format!("{}_{}.obj", link.name, visual.name)
}

fn mesh_part(link: &LinkDescription, visual: &Visual) -> Part {
    let source = format!("meshes/{}", mesh_name(link, visual));
    Part {
        name: visual.name.clone(),
        link_from_part: Pose::identity(),
        shape: Shape::Mesh { source, meshes: Arc::new(Vec::new()) },
        material: None,
    }
}

fn box_part(shape: &CollisionBox) -> Part {
    Part {
        name: shape.name.clone(),
        link_from_part: shape.link_from_box,
        shape: Shape::Box { size: shape.size },
        material: None,
    }
}

/// Wavefront OBJ with shared positions, so that the surfaces stay closed.
fn obj_text(visual: &Visual, library: &str) -> String {
    let mut text = format!("mtllib {library}\no {}\nusemtl {}\n", visual.name, visual.finish.name);
    let mut first = [1; 3];
    for solid in &visual.solids {
        first = push_solid(&mut text, solid, visual.finish.tile_m, first);
    }
    text
}

/// Appends a solid whose first position, texture coordinate and normal have the given numbers; returns
/// the next ones. Writing to a `String` cannot fail, so its results are dropped.
fn push_solid(text: &mut String, solid: &Solid, tile_m: f64, first: [usize; 3]) -> [usize; 3] {
    for p in &solid.positions {
        let _ = writeln!(text, "v {:.6} {:.6} {:.6}", p.x, p.y, p.z);
    }
    for [u, v] in &solid.uvs {
        let _ = writeln!(text, "vt {:.5} {:.5}", u / tile_m, v / tile_m);
    }
    let normals = solid.corner_normals();
    for n in normals.iter().flatten() {
        let _ = writeln!(text, "vn {:.4} {:.4} {:.4}", n.x, n.y, n.z);
    }
    for (index, triangle) in solid.triangles.iter().enumerate() {
        text.push('f');
        for (k, corner) in triangle.iter().enumerate() {
            let (position, uv) = (first[0] + corner.position, first[1] + corner.uv);
            let _ = write!(text, " {position}/{uv}/{}", first[2] + 3 * index + k);
        }
        text.push('\n');
    }
    [
        first[0] + solid.positions.len(),
        first[1] + solid.uvs.len(),
        first[2] + 3 * solid.triangles.len(),
    ]
}

/// MTL with the PBR extension (`Pm`, `Pr`) beside the classic terms.
fn mtl_text<'a>(finishes: impl Iterator<Item = &'a Finish>) -> String {
    let mut text = String::new();
    for finish in finishes {
        let [r, g, b] = finish.color;
        let _ = writeln!(
            text,
            "newmtl {}\nKd {r:.4} {g:.4} {b:.4}\nNs {:.0}\nPm {:.2}\nPr {:.2}",
            finish.name,
            1.0 + 200.0 * (1.0 - finish.roughness),
            finish.metallic,
            finish.roughness
        );
        if finish.texture.is_some() {
            let _ = writeln!(text, "map_Kd {}.png", finish.name);
        }
    }
    text
}
