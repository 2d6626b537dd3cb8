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

/// What the hand must be doing. Numbers count the grasps of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Nothing: it is on its way to the first grasp.
    Away,
    /// The tool is at its place, the fingers may be closing.
    Closing(usize),
    /// The tool is at its place, the fingers are closed.
    Held(usize),
    /// After this grasp and before the next, if there is one: the tool is at its place in either of them,
    /// or the fingers are open.
    Leaving(usize),
}

/// One configuration of robot and object.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// Where on the path.
    pub place: Place,
    /// What the hand must be doing.
    pub hold: Hold,
    /// The robot's trajectory columns (rad, m).
    pub robot: Vec<f64>,
    /// The object's columns (rad, m).
    pub object: Vec<f64>,
}

/// All dense samples with `between` evenly spaced configurations between neighbours.
pub fn configurations(trajectory: &Trajectory, between: u32) -> Vec<Configuration> {
    let dense = &trajectory.dense;
    let segments: Vec<_> = trajectory.segments().into_iter().map(|s| s.samples).collect();
    let parts = between as usize + 1;
    let mut configurations = Vec::with_capacity(dense.len() * parts);
    // The grasp that holds, or the last one before; `arriving` asks about the motion to the sample.
    let hold = |sample: usize, arriving: bool| {
        let begun = |start: usize| if arriving { start < sample } else { start <= sample };
        match segments.iter().rposition(|s| begun(*s.start())) {
            Some(grasp) if sample <= *segments[grasp].end() => Hold::Held(grasp),
            Some(grasp) => Hold::Leaving(grasp),
            None => Hold::Away,
        }
    };
    for sample in 0..dense.len() {
        let robot = dense.robot.row_f64(sample);
        let object = dense.object.row_f64(sample);
        let phase = dense.phase[sample];
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
                    hold: match hold(sample, true) {
                        Hold::Away if phase == Phase::Grasp => Hold::Closing(0),
                        other => other,
                    },
                    robot: mix(dense.robot.row_f64(sample - 1), &robot),
                    object: mix(dense.object.row_f64(sample - 1), &object),
                });
            }
        }
        // A phase names the motion that arrives: the fingers begin to close at the sample before.
        let closing = phase == Phase::Grasp || dense.phase.get(sample + 1) == Some(&Phase::Grasp);
        configurations.push(Configuration {
            place: Place { sample: sample as f64, time_s: dense.times_s[sample], phase },
            hold: match hold(sample, false) {
                Hold::Away if closing => Hold::Closing(0),
                other => other,
            },
            robot,
            object,
        });
    }
    configurations
}
