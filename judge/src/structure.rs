//! Is the trajectory whole: shapes, finite values, increasing times, phases, waypoints on the dense path.

use akrobat_model::trajectory::Segment;
use akrobat_model::{JointPath, Phase, Rejection, Trajectory};

use crate::finding::Finding;

/// Fewest dense samples from one waypoint to the next: four between them.
const MIN_SUBSTEPS: u32 = 5;
/// A waypoint and its dense sample are the same numbers, up to rounding, rad or m.
const SAME_POSITION: f32 = 1e-5;

/// Checks everything later checks rely on.
///
/// # Errors
/// A [`Rejection::Malformed`] finding.
pub fn check(
    trajectory: &Trajectory,
    robot_columns: usize,
    object_columns: usize,
) -> Result<(), Finding> {
    let malformed = |detail: String| Err(Finding::new(Rejection::Malformed, detail));
    let dense = &trajectory.dense;
    let samples = dense.len();
    let waypoints = trajectory.waypoints_robot.rows();
    for (what, table, columns, rows) in [
        ("robot waypoints", &trajectory.waypoints_robot, robot_columns, waypoints),
        ("object waypoints", &trajectory.waypoints_object, object_columns, waypoints),
        ("dense robot path", &dense.robot, robot_columns, samples),
        ("dense object path", &dense.object, object_columns, samples),
    ] {
        if table.columns() != columns || table.rows() != rows {
            return malformed(format!(
                "{what}: expected {rows} rows of {columns} columns, got {} rows of {}",
                table.rows(),
                table.columns()
            ));
        }
        if let Some(at) = table.values().iter().position(|v| !v.is_finite()) {
            let (row, column) = (at / columns, at % columns);
            return malformed(format!("{what}: row {row}, column {column} is not a finite number"));
        }
    }
    if dense.phase.len() != samples {
        return malformed(format!("{} phases for {samples} dense samples", dense.phase.len()));
    }
    if waypoints < 2 {
        return malformed(format!("{waypoints} waypoints, expected at least 2"));
    }
    if let Some(at) = dense.times_s.iter().position(|t| !t.is_finite()) {
        return malformed(format!("the time of sample {at} is not a finite number"));
    }
    if dense.times_s.first() != Some(&0.0) {
        return malformed("the dense path does not begin at time 0".into());
    }
    if let Some(at) = dense.times_s.windows(2).position(|pair| pair[1] <= pair[0]) {
        return malformed(format!(
            "the time does not increase from sample {at} to sample {}",
            at + 1
        ));
    }
    for (what, value) in [
        ("start", trajectory.start),
        ("goal", trajectory.goal),
        ("waypoint interval", trajectory.waypoint_interval_s),
    ] {
        if !value.is_finite() {
            return malformed(format!("the {what} is not a finite number"));
        }
    }
    check_waypoints(trajectory)?;
    check_phases(trajectory)
}

/// Every waypoint is a sample of the dense path.
fn check_waypoints(trajectory: &Trajectory) -> Result<(), Finding> {
    let malformed = |detail: String| Err(Finding::new(Rejection::Malformed, detail));
    let dense = &trajectory.dense;
    if trajectory.substeps < MIN_SUBSTEPS {
        return malformed(format!(
            "{} dense samples from one waypoint to the next, expected at least {MIN_SUBSTEPS}",
            trajectory.substeps
        ));
    }
    check_segments(trajectory)?;
    let last = *trajectory.manipulation_samples().end();
    if last >= dense.len() {
        return malformed(format!(
            "the last waypoint would be dense sample {last} of {}",
            dense.len()
        ));
    }
    for waypoint in 0..trajectory.waypoints_robot.rows() {
        let sample = trajectory.waypoint_sample(waypoint);
        for (what, waypoints, path) in [
            ("robot", &trajectory.waypoints_robot, &dense.robot),
            ("object", &trajectory.waypoints_object, &dense.object),
        ] {
            if let Some((column, off)) = first_difference(waypoints, waypoint, path, sample) {
                return malformed(format!(
                    "{what} waypoint {waypoint} differs from dense sample {sample} by {off:.2e} in column {column}"
                ));
            }
        }
    }
    Ok(())
}

fn first_difference(
    a: &JointPath,
    row_a: usize,
    b: &JointPath,
    row_b: usize,
) -> Option<(usize, f32)> {
    let differences = a.row(row_a).iter().zip(b.row(row_b)).map(|(x, y)| (x - y).abs());
    differences.enumerate().find(|(_, difference)| *difference > SAME_POSITION)
}

/// Grasps follow one another, each with at least two waypoints, and with a motion in between.
fn check_segments(trajectory: &Trajectory) -> Result<(), Finding> {
    let segments = trajectory.segments();
    if let Some(short) = segments.iter().position(|s| s.waypoints.len() < 2) {
        let detail = format!("grasp {short} has fewer than 2 waypoints");
        return Err(Finding::new(Rejection::Malformed, detail));
    }
    let touching = |pair: &[Segment<'_>]| pair[1].samples.start() <= pair[0].samples.end();
    if let Some(at) = segments.windows(2).position(touching) {
        let detail = format!("grasp {} begins before the one before it has ended", at + 1);
        return Err(Finding::new(Rejection::Malformed, detail));
    }
    Ok(())
}

/// Every phase is where it belongs: the held one between the waypoints of a grasp.
fn check_phases(trajectory: &Trajectory) -> Result<(), Finding> {
    let segments = trajectory.segments();
    let range = trajectory.manipulation_samples();
    for (sample, phase) in trajectory.dense.phase.iter().enumerate() {
        // A sample's phase is that of the motion that arrives at it; nothing arrives at the first one.
        if sample == *range.start() {
            continue;
        }
        let held = |s: &Segment<'_>| s.samples.contains(&sample) && *s.samples.start() < sample;
        let expected: &[Phase] = if segments.iter().any(held) {
            &[Phase::Manipulate]
        } else if sample < *range.start() {
            &[Phase::Approach, Phase::Reach, Phase::Grasp]
        } else if sample > *range.end() {
            &[Phase::Release]
        } else {
            &[Phase::Regrasp]
        };
        if !expected.contains(phase) {
            return Err(Finding::new(
                Rejection::Malformed,
                format!(
                    "sample {sample} has phase {phase:?}, expected {expected:?}: the waypoints are samples {range:?}"
                ),
            ));
        }
    }
    Ok(())
}
