//! URDF out.

use std::fmt::Write as _;

use crate::{Joint, JointKind, KinematicTree, Link, Material, Part, Pose, Shape};

/// The tree as URDF text, with meshes under the names they were loaded by.
pub fn to_string(tree: &KinematicTree) -> String {
    write_with_meshes(tree, |_, source| source.to_owned())
}

/// The tree as URDF text. `mesh_file` gives the file name to write for a mesh part, from the part and
/// the name it was loaded by. Scales are part of the meshes by now, so none is written: the named file
/// must hold the scaled mesh.
pub fn write_with_meshes(
    tree: &KinematicTree,
    mesh_file: impl Fn(&Part, &str) -> String,
) -> String {
    let mut text = String::from("<?xml version=\"1.0\"?>\n");
    line(&mut text, 0, &format!("<robot name=\"{}\">", escaped(&tree.name)));
    for link in tree.links() {
        write_link(&mut text, link, &mesh_file);
    }
    for joint in tree.joints() {
        write_joint(&mut text, tree, joint);
    }
    line(&mut text, 0, "</robot>");
    text
}

fn line(text: &mut String, depth: usize, content: &str) {
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{:width$}{content}", "", width = 2 * depth);
}

fn write_link(text: &mut String, link: &Link, mesh_file: &impl Fn(&Part, &str) -> String) {
    line(text, 1, &format!("<link name=\"{}\">", escaped(&link.name)));
    if let Some(inertial) = &link.inertial {
        let [ixx, ixy, ixz, iyy, iyz, izz] = inertial.inertia;
        line(text, 2, "<inertial>");
        line(text, 3, &origin(&inertial.link_from_inertia));
        line(text, 3, &format!("<mass value=\"{}\"/>", inertial.mass));
        line(
            text,
            3,
            &format!(
                "<inertia ixx=\"{ixx}\" ixy=\"{ixy}\" ixz=\"{ixz}\" iyy=\"{iyy}\" iyz=\"{iyz}\" izz=\"{izz}\"/>"
            ),
        );
        line(text, 2, "</inertial>");
    }
    for (element, parts) in [("visual", &link.visuals), ("collision", &link.collisions)] {
        for part in parts {
            write_part(text, element, part, mesh_file);
        }
    }
    line(text, 1, "</link>");
}

fn write_part(
    text: &mut String,
    element: &str,
    part: &Part,
    mesh_file: &impl Fn(&Part, &str) -> String,
) {
    let shape = match &part.shape {
        Shape::Box { size: [x, y, z] } => format!("<box size=\"{x} {y} {z}\"/>"),
        Shape::Cylinder { radius, length } => {
            format!("<cylinder radius=\"{radius}\" length=\"{length}\"/>")
        }
        Shape::Sphere { radius } => format!("<sphere radius=\"{radius}\"/>"),
        Shape::Mesh { source, .. } => {
            format!("<mesh filename=\"{}\"/>", escaped(&mesh_file(part, source)))
        }
    };
    line(text, 2, &format!("<{element} name=\"{}\">", escaped(&part.name)));
    line(text, 3, &origin(&part.link_from_part));
    line(text, 3, &format!("<geometry>{shape}</geometry>"));
    if let Some(Material { name, base_color: [r, g, b, alpha], .. }) = &part.material {
        let [r, g, b] = [r, g, b].map(|&c| srgb(c));
        line(
            text,
            3,
            &format!(
                "<material name=\"{}\"><color rgba=\"{r} {g} {b} {alpha}\"/></material>",
                escaped(name)
            ),
        );
    }
    line(text, 2, &format!("</{element}>"));
}

fn write_joint(text: &mut String, tree: &KinematicTree, joint: &Joint) {
    let kind = match joint.kind {
        JointKind::Fixed => "fixed",
        JointKind::Revolute => "revolute",
        JointKind::Continuous => "continuous",
        JointKind::Prismatic => "prismatic",
    };
    let link = |index: usize| escaped(&tree.links()[index].name);
    line(text, 1, &format!("<joint name=\"{}\" type=\"{kind}\">", escaped(&joint.name)));
    line(text, 2, &origin(&joint.parent_from_joint));
    line(text, 2, &format!("<parent link=\"{}\"/>", link(joint.parent)));
    line(text, 2, &format!("<child link=\"{}\"/>", link(joint.child)));
    if joint.kind != JointKind::Fixed {
        let axis = &joint.axis;
        line(text, 2, &format!("<axis xyz=\"{} {} {}\"/>", axis.x, axis.y, axis.z));
        let mut limit = String::from("<limit");
        if joint.kind != JointKind::Continuous {
            let _ = write!(limit, " lower=\"{}\" upper=\"{}\"", joint.limits[0], joint.limits[1]);
        }
        for (name, value) in [("velocity", joint.velocity_limit), ("effort", joint.effort_limit)] {
            if let Some(value) = value {
                let _ = write!(limit, " {name}=\"{value}\"");
            }
        }
        line(text, 2, &(limit + "/>"));
        line(
            text,
            2,
            &format!("<dynamics damping=\"{}\" friction=\"{}\"/>", joint.damping, joint.friction),
        );
    }
    if let Some(mimic) = &joint.mimic {
        line(
            text,
            2,
            &format!(
                "<mimic joint=\"{}\" multiplier=\"{}\" offset=\"{}\"/>",
                escaped(&tree.joints()[mimic.joint].name),
                mimic.multiplier,
                mimic.offset
            ),
        );
    }
    line(text, 1, "</joint>");
}

fn origin(pose: &Pose) -> String {
    let t = pose.translation.vector;
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    format!("<origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} {yaw}\"/>", t.x, t.y, t.z)
}

/// IEC 61966-2-1, the inverse of what the reader does to colours.
fn srgb(linear: f32) -> f64 {
    let c = f64::from(linear);
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
