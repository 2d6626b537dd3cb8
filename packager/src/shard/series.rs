//! Everything of an episode that is small: collected while frames come, written at the end.

use akrobat_cameras::Observation;
use akrobat_model::{Pose, pose};

/// Per-frame values of one camera.
#[derive(Debug, Default)]
pub(crate) struct CameraSeries {
    /// K `[T, 3, 3]`.
    pub intrinsics: Vec<f64>,
    /// `world_from_camera` `[T, 4, 4]`.
    pub world_from_camera: Vec<f64>,
    /// Frame at which the image that stands at each frame was taken.
    pub captured: Vec<usize>,
}

/// Per-frame values of an episode.
#[derive(Debug, Default)]
pub(crate) struct Series {
    /// Times, seconds.
    pub time_s: Vec<f64>,
    /// Phase numbers.
    pub phase: Vec<u8>,
    /// Robot joint positions `[T, columns]`.
    pub robot: Vec<f32>,
    /// Object joint positions `[T, columns]`.
    pub object: Vec<f32>,
    /// Tool poses.
    pub world_from_tool: Vec<Pose>,
    /// Base link poses.
    pub world_from_base: Vec<Pose>,
    /// Object root poses.
    pub world_from_object: Vec<Pose>,
    /// Cameras in the rig's order.
    pub cameras: Vec<CameraSeries>,
}

impl Series {
    /// No frames yet.
    pub fn new(cameras: usize) -> Self {
        let cameras = (0..cameras).map(|_| CameraSeries::default()).collect();
        Self { cameras, ..Self::default() }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Takes the small values of a frame.
    pub fn push(&mut self, observation: &Observation) {
        self.time_s.push(observation.time_s);
        self.phase.push(observation.phase as u8);
        self.robot.extend(observation.robot.iter().map(|&v| v as f32));
        self.object.extend(observation.object.iter().map(|&v| v as f32));
        self.world_from_tool.push(observation.world_from_tool);
        self.world_from_base.push(observation.world_from_base);
        self.world_from_object.push(observation.world_from_object);
        for (series, camera) in self.cameras.iter_mut().zip(&observation.cameras) {
            series.captured.push((camera.captured_frame.min(observation.frame)) as usize);
            series.intrinsics.extend(camera.intrinsics.matrix().as_flattened());
            series
                .world_from_camera
                .extend(pose::to_matrix(&camera.world_from_camera).as_flattened());
        }
    }
}

/// Rows moved one frame ahead, the last repeated: row t is what leads from frame t to frame t + 1.
pub(crate) fn targets(rows: &[f32], columns: usize) -> Vec<f32> {
    let last = rows.len().saturating_sub(columns);
    [rows.get(columns..).unwrap_or_default(), &rows[last..]].concat()
}

/// The frames before and after frame `t` between which its rate of change is taken.
fn neighbours(t: usize, frames: usize) -> (usize, usize) {
    (t.saturating_sub(1), (t + 1).min(frames - 1))
}

/// Rates of change by central differences (one-sided at the ends), per second.
pub(crate) fn velocities(time_s: &[f64], rows: &[f32], columns: usize) -> Vec<f32> {
    let mut velocities = Vec::with_capacity(rows.len());
    for t in 0..time_s.len() {
        let (before, after) = neighbours(t, time_s.len());
        let span = time_s[after] - time_s[before];
        for column in 0..columns {
            let change = f64::from(rows[after * columns + column])
                - f64::from(rows[before * columns + column]);
            velocities.push(if span > 0.0 { (change / span) as f32 } else { 0.0 });
        }
    }
    velocities
}

/// Linear (m/s) and angular (rad/s) velocities `[T, 6]` in the world frame, by central differences.
pub(crate) fn twists(time_s: &[f64], poses: &[Pose]) -> Vec<f32> {
    let mut twists = Vec::with_capacity(poses.len() * 6);
    for t in 0..poses.len() {
        let (before, after) = neighbours(t, poses.len());
        let span = time_s[after] - time_s[before];
        let linear = poses[after].translation.vector - poses[before].translation.vector;
        let angular = (poses[after].rotation * poses[before].rotation.inverse()).scaled_axis();
        let change = linear.iter().chain(angular.iter());
        twists.extend(change.map(|v| if span > 0.0 { (v / span) as f32 } else { 0.0 }));
    }
    twists
}

/// Poses as rows `x y z qw qx qy qz`.
pub(crate) fn pose_rows(poses: &[Pose]) -> Vec<f32> {
    poses.iter().flat_map(pose::to_xyz_wxyz).map(|v| v as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_lead_to_the_next_frame() {
        assert_eq!(targets(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 2), [3.0, 4.0, 5.0, 6.0, 5.0, 6.0]);
        assert_eq!(targets(&[1.0, 2.0], 2), [1.0, 2.0]);
        assert!(targets(&[], 2).is_empty());
    }

    #[test]
    fn velocities_of_a_straight_line_are_its_slope() {
        let time_s = [0.0, 0.1, 0.2, 0.25];
        let rows: Vec<f32> = time_s.iter().map(|t| (3.0 * t) as f32).collect();
        for velocity in velocities(&time_s, &rows, 1) {
            assert!((velocity - 3.0).abs() < 1e-4, "{velocity}");
        }
        assert_eq!(velocities(&[0.0], &[5.0], 1), [0.0]);
    }

    #[test]
    fn twists_of_a_turning_body_are_its_rate() {
        let time_s = [0.0, 0.1, 0.2];
        let turn = |t: f64| pose::from_xyz_rpy([t, 0.0, 0.0], [0.0, 0.0, 2.0 * t]);
        for twist in twists(&time_s, &time_s.map(turn)).chunks(6) {
            assert!((twist[0] - 1.0).abs() < 1e-5 && (twist[5] - 2.0).abs() < 1e-5, "{twist:?}");
        }
    }
}
