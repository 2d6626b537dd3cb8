//! Objects that slide on the floor: every displacement in the plane is a turn about a pole, or a slide, so the
//! way to each goal is one joint, and planning is that of a door or a drawer.

use std::f64::consts::{PI, TAU};

use akrobat_model::events::Observer;
use akrobat_model::task::Task;
use akrobat_model::trajectory::Trajectory;
use akrobat_model::{JointKind, JointPath, KinematicTree, ModelError, Pose, free_object, pose};
use nalgebra::{Matrix2, Translation3, Unit, UnitQuaternion, Vector2, Vector3};

use super::{JudgeFn, PlanError, PlanOutcome, Preparation, Run, plan_driven};
use crate::backend::Backend;
use crate::config::PlannerConfig;
use crate::world::World;

/// Turns smaller than this count as slides, radians.
const LEAST_TURN: f64 = 1e-3;
/// Spare travel of the joint beyond both ends, rad or m.
const SPARE: f64 = 0.1;

/// A displacement in the plane as one joint, whose position is 0 at the start.
#[derive(Debug, Clone, Copy)]
enum Screw {
    /// About the vertical through a point, by an angle.
    Turn { pole: Vector2<f64>, angle: f64 },
    /// Along a unit direction, by a distance.
    Slide { direction: Vector2<f64>, distance: f64 },
}

impl Screw {
    /// The displacement from one pose to another that differs in x, y and yaw alone.
    fn between(start: &Pose, goal: &Pose) -> Self {
        let displacement = goal * start.inverse();
        let (_, _, yaw) = displacement.rotation.euler_angles();
        let shift = displacement.translation.vector.xy();
        if yaw.abs() < LEAST_TURN {
            let moved = (goal.translation.vector - start.translation.vector).xy();
            let direction = moved.try_normalize(1e-9).unwrap_or_else(Vector2::x);
            return Self::Slide { direction, distance: moved.norm() };
        }
        // The pole stays where it is: (1 - R) pole = shift.
        let (sin, cos) = yaw.sin_cos();
        let fixed = Matrix2::new(1.0 - cos, sin, -sin, 1.0 - cos);
        let pole = fixed.try_inverse().map_or(shift, |inverse| inverse * shift);
        Self::Turn { pole, angle: yaw }
    }

    fn travel(&self) -> f64 {
        match *self {
            Self::Turn { angle, .. } => angle,
            Self::Slide { distance, .. } => distance,
        }
    }

    /// Pose at position `q` (rad, m) of what is at `start` at 0.
    fn moved(&self, start: &Pose, q: f64) -> Pose {
        match *self {
            Self::Turn { pole, .. } => {
                let pole = Translation3::new(pole.x, pole.y, 0.0);
                let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q);
                pole * turn * pole.inverse() * start
            }
            Self::Slide { direction, .. } => {
                Translation3::new(direction.x * q, direction.y * q, 0.0) * start
            }
        }
    }

    /// The object's tree with this joint in place of its virtual ones; the joint keeps the index and name of
    /// the first of them.
    fn tree(&self, tree: &KinematicTree, start: &Pose) -> Result<KinematicTree, ModelError> {
        let [x, y, yaw] = free_object::PLANAR_JOINTS;
        let mut joints = tree.joints().to_vec();
        let (pole, axis, kind) = match *self {
            Self::Turn { pole, .. } => (pole, Vector3::z(), JointKind::Revolute),
            Self::Slide { direction, .. } => (
                Vector2::zeros(),
                Vector3::new(direction.x, direction.y, 0.0),
                JointKind::Prismatic,
            ),
        };
        let travel = self.travel();
        let driven = &mut joints[tree.joint_index(x)?];
        driven.kind = kind;
        driven.axis = Unit::new_normalize(axis);
        driven.parent_from_joint = Pose::translation(pole.x, pole.y, 0.0);
        driven.limits = [travel.min(0.0) - SPARE, travel.max(0.0) + SPARE];
        for (name, place) in [(y, planar_place(start, &pole)), (yaw, Pose::identity())] {
            let fixed = &mut joints[tree.joint_index(name)?];
            fixed.kind = JointKind::Fixed;
            fixed.parent_from_joint = place;
        }
        KinematicTree::new(tree.name.clone(), tree.links().to_vec(), joints)
    }

    /// The task of driving this joint.
    fn task(&self, task: &Task, start: &Pose, goal_index: usize) -> Result<Task, ModelError> {
        let mut driven = task.clone();
        let object = &mut driven.object;
        object.tree = self.tree(&task.object.tree, start)?;
        object.start = object.tree.neutral();
        for &joint in object.tree.dof_joints() {
            if let (Some(to), Some(from)) =
                (object.tree.column(joint), task.object.tree.column(joint))
                && joint != object.active_joint
            {
                object.start[to] = task.object.start[from];
            }
        }
        if let Some(column) = object.tree.column(object.active_joint) {
            object.start[column] = 0.0;
        }
        driven.file.goal.start = 0.0;
        driven.file.goal.positions = vec![self.travel()];
        // Random numbers and identities of each goal are its own.
        driven.file.name = format!("{}, goal {goal_index}", task.file.name);
        driven.toml = format!("{}\n# goal {goal_index}", task.toml);
        Ok(driven)
    }

    /// A trajectory of that task in the object's own columns.
    fn restored(
        &self,
        task: &Task,
        driven: &Task,
        start: &Pose,
        trajectory: &Trajectory,
    ) -> Trajectory {
        let (from, to) = (&driven.object.tree, &task.object.tree);
        let active = from.column(driven.object.active_joint).unwrap_or(0);
        let yaw_column = to.joint_index("object_yaw").ok().and_then(|joint| to.column(joint));
        let start_yaw = yaw_column.map_or(0.0, |column| task.object.start[column]);
        let row = |row: &[f32]| -> Vec<f64> {
            let q = f64::from(row[active]);
            let mut values = task.object.start.clone();
            let positions = free_object::positions(task.file.object.kind, &self.moved(start, q));
            for (name, mut position) in free_object::PLANAR_JOINTS.iter().zip(positions) {
                let Some(column) = to.joint_index(name).ok().and_then(|joint| to.column(joint))
                else {
                    continue;
                };
                if Some(column) == yaw_column {
                    // Without a jump where the angle passes half a turn.
                    let turned = if matches!(self, Self::Turn { .. }) { q } else { 0.0 };
                    let expected = start_yaw + turned;
                    position += TAU * ((expected - position + PI) / TAU).floor();
                }
                values[column] = position;
            }
            values
        };
        let table = |path: &JointPath| {
            let mut table = JointPath::new(to.dof());
            (0..path.rows()).for_each(|index| table.push(row(path.row(index))));
            table
        };
        let mut restored = trajectory.clone();
        restored.waypoints_object = table(&trajectory.waypoints_object);
        restored.dense.object = table(&trajectory.dense.object);
        restored.start = start.translation.x;
        restored.goal = self.moved(start, self.travel()).translation.x;
        restored
    }
}

/// The planar part of a pose, seen from a pole.
fn planar_place(pose: &Pose, pole: &Vector2<f64>) -> Pose {
    let (_, _, yaw) = pose.rotation.euler_angles();
    let t = pose.translation.vector;
    Pose::from_parts(
        Translation3::new(t.x - pole.x, t.y - pole.y, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
    )
}

/// Plans each goal of a planar task, with an equal share of the trajectories wanted.
pub(super) fn plan_planar(
    backend: &Backend,
    task: &Task,
    preparation: &Preparation,
    config: &PlannerConfig,
    observer: &dyn Observer,
    judge: &JudgeFn<'_>,
) -> Result<PlanOutcome, PlanError> {
    let start_poses = task.object.tree.link_poses(&task.object.world_from_root, &task.object.start);
    let start = start_poses[free_object::body_link(&task.object.tree)];
    let goals: Vec<Pose> =
        task.file.goal.poses.iter().filter_map(|goal| pose::from_xyz_wxyz(*goal)).collect();
    let mut run = Run::new(task, preparation, config, observer);
    let (mut trajectories, mut notes) = (Vec::new(), Vec::new());
    for (index, goal) in goals.iter().enumerate() {
        let wanted = config.limit * (index + 1) / goals.len() - trajectories.len();
        if wanted == 0 {
            continue;
        }
        let screw = Screw::between(&start, goal);
        let driven = screw.task(task, &start, index)?;
        let config = PlannerConfig { limit: wanted, ..config.clone() };
        let judge = |t: &Trajectory| judge(&screw.restored(task, &driven, &start, t));
        // What moves with the object hangs from this goal's joint.
        let world = World::build(&driven, &config);
        let outcome =
            plan_driven(backend, &driven, preparation, &world, &config, observer, &judge)?;
        let accepted = outcome.set.trajectories.iter();
        trajectories.extend(accepted.map(|t| screw.restored(task, &driven, &start, t)));
        run.absorb(&outcome);
        notes.extend(outcome.notes);
    }
    Ok(run.outcome(trajectories, notes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use akrobat_model::pose::from_xyz_rpy;

    #[test]
    fn a_screw_ends_at_its_goal() {
        let start = from_xyz_rpy([1.0, 2.0, 0.3], [0.0, 0.0, 0.4]);
        for goal in [
            from_xyz_rpy([0.2, 2.5, 0.3], [0.0, 0.0, -1.0]),
            from_xyz_rpy([1.7, 1.0, 0.3], [0.0, 0.0, 0.4]),
        ] {
            let screw = Screw::between(&start, &goal);
            let end = screw.moved(&start, screw.travel());
            assert!((end.translation.vector - goal.translation.vector).norm() < 1e-12, "{screw:?}");
            assert!(end.rotation.angle_to(&goal.rotation) < 1e-7);
        }
    }
}
