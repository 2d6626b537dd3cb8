//! How far the tool strays from its place on the handle while it holds it: the original trees' forward
//! kinematics, nothing of the planner's.

use akrobat_model::Trajectory;
use akrobat_model::task::Task;

use crate::Error;

/// Points looked at between neighbouring samples, where everything moves linearly.
const SUBSTEPS: usize = 4;

/// Distance of tool and handle at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Time on the dense path, seconds.
    pub time_s: f64,
    /// Fraction of the manipulation's time, 0 to 1.
    pub progress: f64,
    /// Distance, metres.
    pub translation_m: f64,
    /// Angle, radians.
    pub rotation_rad: f64,
}

/// The drift over the whole manipulation, at the samples of the dense path and between them.
///
/// # Errors
/// Where the object has no link of the grasp's name.
pub fn anchor_drift(task: &Task, trajectory: &Trajectory) -> Result<Vec<Drift>, Error> {
    let (robot, object) = (&task.robot, &task.object);
    let times = &trajectory.dense.times_s;
    let (first, last) = trajectory.manipulation_samples().into_inner();
    let duration_s = (times[last] - times[first]).max(f64::MIN_POSITIVE);
    let mut drifts = Vec::new();
    for segment in trajectory.segments() {
        let held = object.tree.link_index(&segment.grasp.link)?;
        let (first_held, last_held) = segment.samples.into_inner();
        for step in first_held * SUBSTEPS..=last_held * SUBSTEPS {
            let (sample, part) = (step / SUBSTEPS, (step % SUBSTEPS) as f64 / SUBSTEPS as f64);
            let next = times[(sample + 1).min(last_held)];
            let time_s = times[sample] + (next - times[sample]) * part;
            let state = trajectory.dense.sample(time_s);
            let q = robot.configuration(&state.robot);
            let world_from_tool = robot.tree.link_poses(&robot.world_from_root, &q)
                [robot.tool_link]
                * robot.link_from_tool;
            let world_from_grasp = object.tree.link_poses(&object.world_from_root, &state.object)
                [held]
                * segment.grasp.link_from_tool;
            let grasp_from_tool = world_from_grasp.inv_mul(&world_from_tool);
            drifts.push(Drift {
                time_s,
                progress: (time_s - times[first]) / duration_s,
                translation_m: grasp_from_tool.translation.vector.norm(),
                rotation_rad: grasp_from_tool.rotation.angle(),
            });
        }
    }
    Ok(drifts)
}
