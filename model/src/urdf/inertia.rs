//! Mass properties: several `<inertial>` elements merged, impossible ones repaired.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use roxmltree::Node;

use super::xml::{Context, child, children};
use crate::tree::Inertial;
use crate::{ModelError, Pose};

/// Smallest principal moment that a repair leaves, as a fraction of the largest.
const MIN_MOMENT_RATIO: f64 = 1e-2;
/// Radius of the solid sphere that stands in where a link has mass but no moment at all, metres.
const FALLBACK_RADIUS_M: f64 = 0.05;

/// The mass properties of a `<link>`; `None` where it states none or no mass.
pub fn read(
    context: Context,
    link: Node,
    notes: &mut Vec<String>,
) -> Result<Option<Inertial>, ModelError> {
    let name = link.attribute("name").unwrap_or("");
    let mut inertials = Vec::new();
    for element in children(link, "inertial") {
        inertials.extend(read_one(context, element)?);
    }
    if inertials.len() > 1 {
        notes.push(format!(
            "link \"{name}\": {} <inertial> elements merged into one",
            inertials.len()
        ));
    }
    let Some(merged) = merge(&inertials) else { return Ok(None) };
    let (repaired, changed) = repair(merged);
    if changed {
        notes.push(format!(
            "link \"{name}\": the inertia matrix is not that of a rigid body (positive definite, no principal moment above the sum of the others): repaired"
        ));
    }
    Ok(Some(repaired))
}

/// One element; `None` for a massless one.
fn read_one(context: Context, element: Node) -> Result<Option<Inertial>, ModelError> {
    let mass = context.required_number(context.child(element, "mass")?, "value")?;
    if mass < 0.0 {
        return Err(context.error(element, format!("expected a mass of at least 0 kg, got {mass}")));
    }
    let mut inertia = [0.0; 6];
    if let Some(matrix) = child(element, "inertia") {
        for (value, name) in inertia.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
            *value = context.number(matrix, name)?.unwrap_or(0.0);
        }
    }
    let link_from_inertia = context.origin(element)?;
    Ok((mass > 0.0).then_some(Inertial { mass, link_from_inertia, inertia }))
}

/// All bodies as one, its frame at the common centre of mass and parallel to the link (a single body
/// stays as it is).
fn merge(inertials: &[Inertial]) -> Option<Inertial> {
    if let [] | [_] = inertials {
        return inertials.first().cloned();
    }
    let mass: f64 = inertials.iter().map(|i| i.mass).sum();
    let centre = |i: &Inertial| i.link_from_inertia.translation.vector;
    let weighted: Vector3<f64> = inertials.iter().map(|i| centre(i) * i.mass).sum();
    let merged_centre = weighted / mass;
    let about_centre = |i: &Inertial| {
        let rotation = i.link_from_inertia.rotation.to_rotation_matrix();
        let turned = rotation * to_matrix(i.inertia) * rotation.transpose();
        // Parallel-axis theorem.
        let d = centre(i) - merged_centre;
        turned + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * i.mass
    };
    let inertia: Matrix3<f64> = inertials.iter().map(about_centre).sum();
    Some(Inertial {
        mass,
        link_from_inertia: Pose::translation(merged_centre.x, merged_centre.y, merged_centre.z),
        inertia: from_matrix(&inertia),
    })
}

/// The nearest inertia that a rigid body can have, and whether that is a change.
fn repair(inertial: Inertial) -> (Inertial, bool) {
    let eigen = SymmetricEigen::new(to_matrix(inertial.inertia));
    let largest = eigen.eigenvalues.max();
    if largest <= 0.0 {
        // Nothing to go by: a solid sphere.
        let moment = 0.4 * inertial.mass * FALLBACK_RADIUS_M * FALLBACK_RADIUS_M;
        return (Inertial { inertia: [moment, 0.0, 0.0, moment, 0.0, moment], ..inertial }, true);
    }
    let mut moments = eigen.eigenvalues;
    if moments.min() <= 0.0 {
        moments = moments.map(|moment| moment.max(MIN_MOMENT_RATIO * largest));
    }
    // No principal moment exceeds the sum of the other two; the small ones are raised to that.
    let top = moments.imax();
    let excess = 2.0 * moments[top] - moments.sum();
    if excess > 1e-9 * largest {
        for index in (0..3).filter(|&index| index != top) {
            moments[index] += excess / 2.0;
        }
    }
    if moments == eigen.eigenvalues {
        return (inertial, false);
    }
    let axes = eigen.eigenvectors;
    let matrix = axes * Matrix3::from_diagonal(&moments) * axes.transpose();
    (Inertial { inertia: from_matrix(&matrix), ..inertial }, true)
}

fn to_matrix([ixx, ixy, ixz, iyy, iyz, izz]: [f64; 6]) -> Matrix3<f64> {
    Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz)
}

fn from_matrix(m: &Matrix3<f64>) -> [f64; 6] {
    [m.m11, m.m12, m.m13, m.m22, m.m23, m.m33]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point_mass(mass: f64, x: f64) -> Inertial {
        let moment = 1e-3;
        Inertial {
            mass,
            link_from_inertia: Pose::translation(x, 0.0, 0.0),
            inertia: [moment, 0.0, 0.0, moment, 0.0, moment],
        }
    }

    #[test]
    fn merging_uses_the_parallel_axis_theorem() {
        let merged = merge(&[point_mass(1.0, 0.0), point_mass(3.0, 1.0)]).unwrap();
        assert_eq!(merged.mass, 4.0);
        assert!((merged.link_from_inertia.translation.x - 0.75).abs() < 1e-12);
        // Reduced mass 1*3/4 at distance 1 about y and z, nothing about x.
        assert!((merged.inertia[0] - 2e-3).abs() < 1e-12);
        assert!((merged.inertia[3] - 0.752).abs() < 1e-12);
    }

    #[test]
    fn impossible_inertias_become_possible() {
        let wrong =
            Inertial { inertia: [0.0, 0.0, 0.002, 0.0115, 0.0, 0.0085], ..point_mass(1.0, 0.0) };
        let (repaired, changed) = repair(wrong);
        assert!(changed);
        let moments = SymmetricEigen::new(to_matrix(repaired.inertia)).eigenvalues;
        assert!(moments.min() > 0.0 && 2.0 * moments.max() <= moments.sum() * (1.0 + 1e-9));
        assert!(!repair(repaired).1, "a repaired inertia needs no repair");
        assert!(!repair(point_mass(1.0, 0.0)).1);
    }
}
