//! The configurations to be checked: the dense samples and points between them, as they are rendered.

use akrobat_model::{Phase, Trajectory};

/// Where on the dense path a configuration lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Index of the dense sample, with a fraction between two.
    pub sample: f64,
    /// Seconds from the start of the path.
    pub time_s: f64,
    /// Phase of the motion.
    pub phase: Phase,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "sample {} ({:?}, {:.3} s)", self.sample, self.phase, self.time_s)
    }
}

/// One configuration of robot and object.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// Where on the path.
    pub place: Place,
    /// True where the tool must be at its place on the handle.
    pub anchored: bool,
    /// The robot's trajectory columns (rad, m).
    pub robot: Vec<f64>,
    /// The object's columns (rad, m).
    pub object: Vec<f64>,
}

/// All dense samples with `between` evenly spaced configurations between neighbours.
///
/// The tool is anchored between the first and the last waypoint and while the fingers close before.
pub fn configurations(trajectory: &Trajectory, between: u32) -> Vec<Configuration> {
    let dense = &trajectory.dense;
    let held = trajectory.manipulation_samples();
    let parts = between as usize + 1;
    let mut configurations = Vec::with_capacity(dense.len() * parts);
    for sample in 0..dense.len() {
        let robot = dense.robot.row_f64(sample);
        let object = dense.object.row_f64(sample);
        let phase = dense.phase[sample];
        // A phase names the motion that arrives: the fingers begin to close at the sample before.
        let closing = phase == Phase::Grasp || dense.phase.get(sample + 1) == Some(&Phase::Grasp);
        if sample > 0 {
            for part in 1..parts {
                let fraction = part as f64 / parts as f64;
                let mix = |from: Vec<f64>, to: &[f64]| -> Vec<f64> {
                    from.iter().zip(to).map(|(a, b)| a + (b - a) * fraction).collect()
                };
                let time_s = dense.times_s[sample - 1]
                    + (dense.times_s[sample] - dense.times_s[sample - 1]) * fraction;
                configurations.push(Configuration {
                    place: Place { sample: (sample - 1) as f64 + fraction, time_s, phase },
                    anchored: phase == Phase::Grasp
                        || (sample > *held.start() && sample <= *held.end()),
                    robot: mix(dense.robot.row_f64(sample - 1), &robot),
                    object: mix(dense.object.row_f64(sample - 1), &object),
                });
            }
        }
        configurations.push(Configuration {
            place: Place { sample: sample as f64, time_s: dense.times_s[sample], phase },
            anchored: closing || held.contains(&sample),
            robot,
            object,
        });
    }
    configurations
}
