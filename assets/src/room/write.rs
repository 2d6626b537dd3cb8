//! The folder of a scene: glTF, URDF, USD, manifest, objects and tasks.

use std::path::Path;

use akrobat_model::pose::to_xyz_wxyz;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, Material, Part, Pose, Shape, urdf};
use nalgebra::Vector3;
use serde::Serialize;

use super::usd::display_color;
use super::{GeneratedScene, Layout, PlacedBody, gltf, usd};
use crate::error::{AssetError, make_folder, write_file};
use crate::object::{Articulation, LICENSE, ObjectClass};

/// A robot that tasks are written for.
#[derive(Debug, Clone)]
pub struct TaskRobot {
    /// Name, as in [`super::REACHERS`] where it is checked for.
    pub name: String,
    /// Robot file, absolute or relative to the scene's `tasks` folder.
    pub file: String,
}

/// `scene.json`.
#[derive(Debug, Serialize)]
struct Manifest<'a> {
    format: &'static str,
    name: &'a str,
    seed: u64,
    confinement: f64,
    layout: Layout,
    room_m: [f64; 3],
    aisle_m: f64,
    free_floor: f64,
    units: &'static str,
    up: &'static str,
    quat_order: &'static str,
    files: [&'static str; 3],
    license: &'static str,
    objects: Vec<ObjectEntry<'a>>,
}

#[derive(Debug, Serialize)]
struct ObjectEntry<'a> {
    name: &'a str,
    class: &'a str,
    /// Pose in the world, `[x y z qw qx qy qz]`.
    pose: [f64; 7],
    /// Axis-aligned bounds in the world, metres.
    bounds_m: [[f64; 3]; 2],
    /// The articulated object, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    asset: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    articulation: Option<&'a Articulation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reached_by: Option<&'a [&'static str]>,
}

impl GeneratedScene {
    /// Writes the scene into `folder`, with a task for every object and every robot that reaches it.
    /// Returns the task files, relative to the folder, with their classes and robots.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn write(
        &self,
        folder: &Path,
        name: &str,
        robots: &[TaskRobot],
    ) -> Result<Vec<(String, ObjectClass, String)>, AssetError> {
        make_folder(folder)?;
        write_file(&folder.join("scene.glb"), gltf::glb(&self.bodies)?)?;
        write_file(&folder.join("scene.usda"), usd::usda(name, &self.bodies))?;
        write_file(&folder.join("scene.urdf"), urdf::to_string(&tree(name, &self.bodies)?))?;
        let text =
            serde_json::to_string_pretty(&self.manifest(name)).map_err(AssetError::Manifest)?;
        write_file(&folder.join("scene.json"), text + "\n")?;
        make_folder(&folder.join("tasks"))?;
        let mut tasks = Vec::new();
        for placed in &self.objects {
            let object = &placed.object.description.name;
            placed.object.write(&folder.join("objects").join(object))?;
            let reaches = |robot: &&TaskRobot| {
                placed.reached_by.contains(&robot.name.as_str())
                    || super::REACHERS.iter().all(|known| known.name != robot.name)
            };
            for robot in robots.iter().filter(reaches) {
                let file = format!("tasks/{object}_{}.toml", robot.name);
                let text = format!(
                    "name = \"{name}_{object}_{}\"\nseed = {}\n\n[robot]\nfile = \"{}\"\n\n{}\n[scene]\nname = \"{name}\"\nfile = \"../scene.glb\"\n# The static twin of the object.\nremove = [\"{object}\"]\n\n{}",
                    robot.name,
                    self.seed,
                    robot.file,
                    placed
                        .object
                        .task_tables(&format!("../objects/{object}"), &placed.world_from_root),
                    placed.object.goal_table(&placed.world_from_root),
                );
                write_file(&folder.join(&file), text)?;
                tasks.push((file, placed.object.class, robot.name.clone()));
            }
        }
        Ok(tasks)
    }

    fn manifest<'a>(&'a self, name: &'a str) -> Manifest<'a> {
        let entry = |body: &'a PlacedBody| {
            let placed = self.objects.iter().find(|o| o.object.description.name == body.name);
            ObjectEntry {
                name: &body.name,
                class: &body.class,
                pose: to_xyz_wxyz(&body.world_from_body).map(|v| (v * 1e6).round() / 1e6),
                bounds_m: bounds(body).map(|corner| corner.map(|v| (v * 1e4).round() / 1e4)),
                asset: placed.map(|_| format!("objects/{0}/{0}.urdf", body.name)),
                articulation: placed.and_then(|o| o.object.articulation.as_ref()),
                reached_by: placed.map(|o| o.reached_by.as_slice()),
            }
        };
        Manifest {
            format: "akrobat scene 1",
            name,
            seed: self.seed,
            confinement: self.confinement,
            layout: self.layout,
            room_m: self.room_m,
            aisle_m: (self.aisle_m * 1e4).round() / 1e4,
            free_floor: (self.free_floor * 1e4).round() / 1e4,
            units: "m",
            up: "z",
            quat_order: "wxyz",
            files: ["scene.glb", "scene.urdf", "scene.usda"],
            license: LICENSE,
            objects: self.bodies.iter().map(entry).collect(),
        }
    }
}

fn bounds(body: &PlacedBody) -> [[f64; 3]; 2] {
    let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for solid in body.link.visuals.iter().flat_map(|visual| &visual.solids) {
        for position in &solid.positions {
            let at = body.world_from_body * position;
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(at[axis]);
                bounds[1][axis] = bounds[1][axis].max(at[axis]);
            }
        }
    }
    bounds
}

/// The bodies as links fixed to an empty root. What is seen is what collides: boxes in the finish's colour.
fn tree(name: &str, bodies: &[PlacedBody]) -> Result<KinematicTree, AssetError> {
    let mut links = vec![Link { name: "world".into(), ..Link::default() }];
    let mut joints = Vec::new();
    for body in bodies {
        let color = body.link.visuals.first().map_or([0.7; 3], |v| display_color(&v.finish));
        let [r, g, b] = color.map(|c| c as f32);
        let part = |material: Option<Material>| {
            let material = material.clone();
            body.link.collisions.iter().map(move |shape| Part {
                name: shape.name.clone(),
                link_from_part: shape.link_from_box,
                shape: Shape::Box { size: shape.size },
                material: material.clone(),
            })
        };
        let base_color = [r, g, b, 1.0];
        let material =
            Material { name: format!("{}_color", body.name), base_color, ..Material::default() };
        joints.push(fixed(&body.name, links.len(), body.world_from_body));
        links.push(Link {
            name: body.name.clone(),
            visuals: part(Some(material)).collect(),
            collisions: part(None).collect(),
            inertial: None,
        });
    }
    Ok(KinematicTree::new(name.into(), links, joints)?)
}

fn fixed(name: &str, child: usize, pose: Pose) -> Joint {
    Joint {
        name: format!("{name}_mount"),
        kind: JointKind::Fixed,
        parent: 0,
        child,
        parent_from_joint: pose,
        axis: Vector3::x_axis(),
        limits: [0.0; 2],
        velocity_limit: None,
        effort_limit: None,
        damping: 0.0,
        friction: 0.0,
        mimic: None,
    }
}
