//! Grippers in kinematic trees: two sides that move against each other at the end of a chain.

use akrobat_model::{KinematicTree, Pose};
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::{is_driven, snapped};

/// Largest distance between points of a gripper, metres.
const LARGEST_EXTENT_M: f64 = 0.5;
/// Most driven joints of a gripper that opens and closes in one way.
const MOST_JOINTS: usize = 3;
/// The tool's origin lies this far behind the finger tips, in the middle of usual pads, metres.
const TIP_TO_TOOL_M: f64 = 0.01;
/// The pads reach this far to both sides of the tool's origin along the approach direction, metres.
const PAD_HALF_M: f64 = 0.008;
/// Spacing of surface samples, metres.
const SAMPLE_M: f64 = 0.003;
/// Widths between the pads that a parallel gripper can have, metres.
const OPEN_WIDTHS_M: std::ops::Range<f64> = 0.01..0.4;

/// A gripper that opens and closes along one line.
#[derive(Debug, Clone)]
pub struct Gripper {
    /// Link that carries the sides.
    pub palm: usize,
    /// Driven joints.
    pub joints: Vec<usize>,
    /// Their positions when closed, rad or m.
    pub closed: Vec<f64>,
    /// Their positions when open, rad or m.
    pub open: Vec<f64>,
    /// Free width between the pads when open, metres.
    pub open_width_m: f64,
    /// Links whose surfaces are the pads.
    pub finger_links: Vec<usize>,
    /// Tool frame in the palm's: z along the approach, y along the closing direction.
    pub palm_from_tool: Pose,
}

/// All grippers of a tree, in the order of their palms.
pub fn find(tree: &KinematicTree) -> Vec<Gripper> {
    (0..tree.links().len()).filter_map(|palm| at_palm(tree, palm)).collect()
}

/// Points of the surface of a link that hangs from the palm, in its own frame.
struct FingerSurface {
    link: usize,
    points: Vec<Point3<f64>>,
}

/// The gripper that a link is the palm of.
fn at_palm(tree: &KinematicTree, palm: usize) -> Option<Gripper> {
    let below = |link: usize| tree.chain_to(link).iter().any(|&j| tree.joints()[j].parent == palm);
    let links: Vec<usize> = (0..tree.links().len()).filter(|&l| below(l)).collect();
    let moved_at_palm =
        |j: &&akrobat_model::Joint| j.parent == palm && j.kind != akrobat_model::JointKind::Fixed;
    if tree.joints().iter().filter(moved_at_palm).count() < 2 {
        return None;
    }
    let joints: Vec<usize> = (0..tree.joints().len())
        .filter(|&j| links.contains(&tree.joints()[j].child) && is_driven(&tree.joints()[j]))
        .collect();
    let finite = |&j: &usize| tree.joints()[j].limits.iter().all(|l| l.is_finite());
    if joints.is_empty() || joints.len() > MOST_JOINTS || !joints.iter().all(finite) {
        return None;
    }
    let moves_with_palm = |link: usize| {
        let own = tree.chain_to(link);
        own.iter()
            .filter(|j| !tree.chain_to(palm).contains(j))
            .all(|&j| tree.joints()[j].kind == akrobat_model::JointKind::Fixed)
    };
    let surfaces: Vec<FingerSurface> = links
        .iter()
        .filter(|&&link| !moves_with_palm(link))
        .map(|&link| FingerSurface { link, points: surface(tree, link) })
        .filter(|surface| !surface.points.is_empty())
        .collect();
    let mut ends: Vec<State> = corners(tree, &joints)
        .into_iter()
        .map(|values| State::new(tree, palm, &joints, values, &surfaces))
        .collect();
    if ends.iter().any(|state| state.extent() > LARGEST_EXTENT_M) {
        return None;
    }
    widest_pair(&mut ends)
        .and_then(|[closed, open]| measured(palm, &joints, &surfaces, closed, open))
}

/// All combinations of the joints' limits.
fn corners(tree: &KinematicTree, joints: &[usize]) -> Vec<Vec<f64>> {
    let combination = |bits: usize| {
        let limit = |(k, &j): (usize, &usize)| tree.joints()[j].limits[bits >> k & 1];
        joints.iter().enumerate().map(limit).collect()
    };
    (0..1 << joints.len()).map(combination).collect()
}

/// The gripper's surfaces in the palm's frame, at some joint positions.
#[derive(Clone)]
struct State {
    values: Vec<f64>,
    /// Points of each surface.
    points: Vec<Vec<Vector3<f64>>>,
}

impl State {
    fn new(
        tree: &KinematicTree,
        palm: usize,
        joints: &[usize],
        values: Vec<f64>,
        surfaces: &[FingerSurface],
    ) -> Self {
        let mut q = tree.neutral();
        for (&joint, &value) in joints.iter().zip(&values) {
            if let Some(column) = tree.column(joint) {
                q[column] = value;
            }
        }
        let poses = tree.link_poses(&Pose::identity(), &q);
        let place = |surface: &FingerSurface| {
            let palm_from_link = poses[palm].inverse() * poses[surface.link];
            surface.points.iter().map(|p| (palm_from_link * p).coords).collect()
        };
        Self { points: surfaces.iter().map(place).collect(), values }
    }

    fn extent(&self) -> f64 {
        let all = || self.points.iter().flatten();
        let low = all().fold(Vector3::repeat(f64::INFINITY), |a, p| a.inf(p));
        let high = all().fold(Vector3::repeat(f64::NEG_INFINITY), |a, p| a.sup(p));
        (high - low).max()
    }

    fn centroid(&self, surface: usize) -> Vector3<f64> {
        let points = &self.points[surface];
        points.iter().sum::<Vector3<f64>>() / points.len() as f64
    }

    /// Mean distance of the surfaces' centres from the middle of them all.
    fn spread(&self) -> f64 {
        let count = self.points.len().max(1) as f64;
        let centres: Vec<_> = (0..self.points.len()).map(|s| self.centroid(s)).collect();
        let middle = centres.iter().sum::<Vector3<f64>>() / count;
        centres.iter().map(|c| (c - middle).norm()).sum::<f64>() / count
    }
}

/// The states in which the sides are nearest and farthest.
fn widest_pair(states: &mut [State]) -> Option<[&State; 2]> {
    states.sort_by(|a, b| a.spread().total_cmp(&b.spread()));
    let [closed, .., open] = &*states else { return None };
    (open.spread() - closed.spread() > 1e-3).then_some([closed, open])
}

/// The tool frame, the width and the pads from the closed and the open state.
fn measured(
    palm: usize,
    joints: &[usize],
    surfaces: &[FingerSurface],
    closed: &State,
    open: &State,
) -> Option<Gripper> {
    let travel: Vec<Vector3<f64>> =
        (0..surfaces.len()).map(|s| open.centroid(s) - closed.centroid(s)).collect();
    // The surface that travels farthest tells the line; the others are on one side or the other of it.
    let farthest = travel.iter().max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    let middle = (0..surfaces.len()).map(|s| closed.centroid(s)).sum::<Vector3<f64>>()
        / surfaces.len() as f64;
    let rough_closing = farthest.try_normalize(1e-6)?;
    let approach = middle - rough_closing * middle.dot(&rough_closing);
    let approach = snapped(approach.try_normalize(1e-3)?);
    let closing = rough_closing - approach * rough_closing.dot(&approach);
    let closing = snapped(closing.try_normalize(0.3)?);
    let closing = (closing - approach * closing.dot(&approach)).normalize();
    let sides: Vec<f64> = travel.iter().map(|t| t.dot(&closing)).collect();
    let is_moving = |side: f64| side.abs() > 1e-3;
    if !(sides.iter().any(|&s| s > 1e-3) && sides.iter().any(|&s| s < -1e-3)) {
        return None;
    }
    let moving = || (0..surfaces.len()).filter(|&s| is_moving(sides[s]));
    let tip = moving()
        .flat_map(|s| &closed.points[s])
        .map(|p| p.dot(&approach))
        .fold(f64::NEG_INFINITY, f64::max);
    let along = tip - TIP_TO_TOOL_M;
    let across = closing.cross(&approach);
    let near_tip = |p: &&Vector3<f64>| (p.dot(&approach) - along).abs() <= PAD_HALF_M;
    let pads = |state: &State, positive: bool| -> Vec<Vector3<f64>> {
        let side = moving().filter(|&s| (sides[s] > 0.0) == positive);
        side.flat_map(|s| state.points[s].iter().filter(near_tip).copied().collect::<Vec<_>>())
            .collect()
    };
    let open_pads = [pads(open, false), pads(open, true)];
    if open_pads.iter().any(Vec::is_empty) {
        return None;
    }
    let mean_across = |side: &[Vector3<f64>]| {
        side.iter().map(|p| p.dot(&across)).sum::<f64>() / side.len() as f64
    };
    let centre_across = (mean_across(&open_pads[0]) + mean_across(&open_pads[1])) / 2.0;
    let left = open_pads[0].iter().map(|p| p.dot(&closing)).fold(f64::NEG_INFINITY, f64::max);
    let right = open_pads[1].iter().map(|p| p.dot(&closing)).fold(f64::INFINITY, f64::min);
    let open_width_m = right - left;
    if !OPEN_WIDTHS_M.contains(&open_width_m) {
        return None;
    }
    let rotation = Matrix3::from_columns(&[across, closing, approach]);
    let origin = across * centre_across + closing * ((left + right) / 2.0) + approach * along;
    let palm_from_tool = Pose::from_parts(
        origin.into(),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
    );
    let finger_links = moving()
        .filter(|&s| open.points[s].iter().any(|p| near_tip(&p)))
        .map(|s| surfaces[s].link)
        .collect();
    Some(Gripper {
        palm,
        joints: joints.to_vec(),
        closed: closed.values.clone(),
        open: open.values.clone(),
        open_width_m: (open_width_m * 1e4).round() / 1e4,
        finger_links,
        palm_from_tool,
    })
}

/// Points on the surface of a link (its collision parts, or its visuals where it has none), in its frame.
fn surface(tree: &KinematicTree, link: usize) -> Vec<Point3<f64>> {
    let link = &tree.links()[link];
    let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
    let mut points = Vec::new();
    for mesh in parts.iter().flat_map(|part| part.triangulate()) {
        for index in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(index).map(|p| Vector3::from(p.map(f64::from)));
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            let steps = (longest / SAMPLE_M).ceil().clamp(1.0, 100.0);
            for i in 0..=steps as usize {
                for j in 0..=steps as usize - i {
                    let (u, v) = (i as f64 / steps, j as f64 / steps);
                    points.push(Point3::from(a + (b - a) * u + (c - a) * v));
                }
            }
        }
    }
    points
}
