//! `<joint>` elements.

use std::collections::HashMap;

use nalgebra::{Unit, Vector3};
use roxmltree::Node;

use super::xml::{Context, child, tag};
use crate::tree::Mimic;
use crate::{Joint, JointKind, ModelError};

const KINDS: [&str; 4] = ["revolute", "continuous", "prismatic", "fixed"];
/// An axis further from unit length than this is mentioned.
const AXIS_LENGTH_TOLERANCE: f64 = 1e-6;
/// Friction (N m or N) above which a joint cannot be meant to move under contact: mentioned.
const LARGE_FRICTION: f64 = 1000.0;

/// A joint whose mimic, if any, is still a name.
pub struct NamedJoint {
    pub joint: Joint,
    pub mimic: Option<NamedMimic>,
    pub line: u32,
}

/// `<mimic>` as the file has it.
pub struct NamedMimic {
    pub joint: String,
    pub multiplier: f64,
    pub offset: f64,
}

/// Reads a `<joint>`.
pub fn read(
    context: Context,
    node: Node,
    link_names: &[String],
    notes: &mut Vec<String>,
) -> Result<NamedJoint, ModelError> {
    let name = context.attribute(node, "name")?.to_owned();
    let kind = kind(context, node)?;
    let link = |element: &str| -> Result<usize, ModelError> {
        let reference = context.child(node, element)?;
        let link = context.attribute(reference, "link")?;
        link_names.iter().position(|l| l == link).ok_or_else(|| {
            let line = super::xml::line_of(reference);
            let place =
                format!("{}: line {line}: {element} of joint \"{name}\"", context.path.display());
            ModelError::unknown(place, "link", link, link_names.iter().cloned())
        })
    };
    let (parent, child_link) = (link("parent")?, link("child")?);
    let axis = axis(context, node, kind, notes)?;
    let limit = child(node, "limit");
    let limits = limits(context, node, kind)?;
    let positive = |attribute: &str| -> Result<Option<f64>, ModelError> {
        let Some(limit) = limit else { return Ok(None) };
        match context.number(limit, attribute)? {
            Some(value) if value < 0.0 => Err(context
                .error(limit, format!("{}: {attribute} limit {value} is negative", tag(node)))),
            // Exporters write 0 where they know no limit.
            value => Ok(value.filter(|&v| v > 0.0)),
        }
    };
    let dynamics = |attribute: &str| match child(node, "dynamics") {
        Some(element) => context.number(element, attribute).map(Option::unwrap_or_default),
        None => Ok(0.0),
    };
    let friction = dynamics("friction")?;
    if friction >= LARGE_FRICTION && kind != JointKind::Fixed {
        notes.push(format!("joint \"{name}\": unusually large friction {friction} kept"));
    }
    let mimic = child(node, "mimic").map(|mimic| {
        Ok(NamedMimic {
            joint: context.attribute(mimic, "joint")?.to_owned(),
            multiplier: context.number(mimic, "multiplier")?.unwrap_or(1.0),
            offset: context.number(mimic, "offset")?.unwrap_or(0.0),
        })
    });
    let joint = Joint {
        kind,
        parent,
        child: child_link,
        parent_from_joint: context.origin(node)?,
        axis,
        limits,
        velocity_limit: positive("velocity")?,
        effort_limit: positive("effort")?,
        damping: dynamics("damping")?,
        friction,
        mimic: None,
        name,
    };
    Ok(NamedJoint { joint, mimic: mimic.transpose()?, line: super::xml::line_of(node) })
}

fn kind(context: Context, node: Node) -> Result<JointKind, ModelError> {
    match context.attribute(node, "type")? {
        "revolute" => Ok(JointKind::Revolute),
        "continuous" => Ok(JointKind::Continuous),
        "prismatic" => Ok(JointKind::Prismatic),
        "fixed" => Ok(JointKind::Fixed),
        other => Err(context.error(
            node,
            format!(
                "{}: joint type \"{other}\" is not supported; valid choices: {}",
                tag(node),
                KINDS.join(", ")
            ),
        )),
    }
}

/// The unit axis; +x where a joint states none, as the URDF specification says.
fn axis(
    context: Context,
    node: Node,
    kind: JointKind,
    notes: &mut Vec<String>,
) -> Result<Unit<Vector3<f64>>, ModelError> {
    if kind == JointKind::Fixed {
        return Ok(Vector3::x_axis());
    }
    let Some(element) = child(node, "axis") else { return Ok(Vector3::x_axis()) };
    let xyz: [f64; 3] = context.numbers(element, "xyz")?.unwrap_or([1.0, 0.0, 0.0]);
    let vector = Vector3::from(xyz);
    let Some(axis) = Unit::try_new(vector, 1e-9) else {
        return Err(context.error(
            element,
            format!("{}: the axis has no direction: {xyz:?}; expected a unit vector", tag(node)),
        ));
    };
    if (vector.norm() - 1.0).abs() > AXIS_LENGTH_TOLERANCE {
        let name = node.attribute("name").unwrap_or("");
        notes.push(format!("joint \"{name}\": axis of length {} normalised", vector.norm()));
    }
    Ok(axis)
}

fn limits(context: Context, node: Node, kind: JointKind) -> Result<[f64; 2], ModelError> {
    match kind {
        JointKind::Fixed => return Ok([0.0, 0.0]),
        JointKind::Continuous => return Ok([f64::NEG_INFINITY, f64::INFINITY]),
        JointKind::Revolute | JointKind::Prismatic => {}
    }
    let Some(limit) = child(node, "limit") else {
        return Err(context.error(
            node,
            format!(
                "{} lacks <limit lower=… upper=…>, which revolute and prismatic joints need (a joint that turns without limits is \"continuous\")",
                tag(node)
            ),
        ));
    };
    let lower = context.number(limit, "lower")?.unwrap_or(0.0);
    let upper = context.number(limit, "upper")?.unwrap_or(0.0);
    if lower > upper {
        return Err(context.error(
            limit,
            format!("{}: inverted limits: lower {lower} is above upper {upper}", tag(node)),
        ));
    }
    Ok([lower, upper])
}

/// Joints with mimics as indices; a mimic of a mimic follows the first joint of the chain directly.
pub fn resolve_mimics(context: Context, named: Vec<NamedJoint>) -> Result<Vec<Joint>, ModelError> {
    let index: HashMap<&str, usize> =
        named.iter().enumerate().map(|(i, j)| (j.joint.name.as_str(), i)).collect();
    let follow = |start: usize| -> Result<Option<Mimic>, ModelError> {
        let (mut at, mut multiplier, mut offset) = (start, 1.0, 0.0);
        for _ in 0..=named.len() {
            let Some(mimic) = &named[at].mimic else {
                let followed = Mimic { joint: at, multiplier, offset };
                return Ok((at != start).then_some(followed));
            };
            // q[at] = m q[next] + o, put into q[start] = multiplier q[at] + offset.
            offset += multiplier * mimic.offset;
            multiplier *= mimic.multiplier;
            at = *index.get(mimic.joint.as_str()).ok_or_else(|| {
                let NamedJoint { joint, line, .. } = &named[at];
                let place = format!(
                    "{}: line {line}: mimic of joint \"{}\"",
                    context.path.display(),
                    joint.name
                );
                let movable = named.iter().filter(|j| j.joint.kind != JointKind::Fixed);
                ModelError::unknown(
                    place,
                    "joint",
                    &mimic.joint,
                    movable.map(|j| j.joint.name.clone()),
                )
            })?;
        }
        let NamedJoint { joint, line, .. } = &named[start];
        Err(ModelError::invalid(
            context.path,
            format!("line {line}: joint \"{}\" mimics itself through a cycle", joint.name),
        ))
    };
    let mimics: Vec<Option<Mimic>> = (0..named.len()).map(follow).collect::<Result<_, _>>()?;
    Ok(named.into_iter().zip(mimics).map(|(named, mimic)| Joint { mimic, ..named.joint }).collect())
}
