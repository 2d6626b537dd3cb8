//! Is the tool at its place on the handle while it holds, with closed fingers, and are they open elsewhere?

use akrobat_model::Rejection;
use akrobat_model::robot::Robot;
use akrobat_model::trajectory::Grasp;

use crate::JudgeConfig;
use crate::finding::{Finding, Worst};
use crate::kinematics::Frame;
use crate::motion::Motion;
use crate::path::{Hold, Place};

/// One configuration, seen from the grasps.
pub struct Grip {
    /// Where on the path.
    pub place: Place,
    /// What the hand must be doing.
    pub hold: Hold,
    /// Free width between the pads, metres.
    pub width_m: f64,
    /// Where the tool is in the frame of the grasp that `hold` names.
    pub grasp_from_tool: Frame,
    /// Where it is in the frame of the grasp after that, if there is one.
    pub next_from_tool: Option<Frame>,
}

/// Free width between the pads at a trajectory row, metres: that of the finger that is widest open.
pub fn finger_width_m(robot: &Robot, row: &[f64]) -> f64 {
    let gripper = &robot.file.gripper;
    let fingers = &row[row.len() - robot.gripper_joints.len()..];
    let fraction = |((q, closed), open): ((&f64, &f64), &f64)| (q - closed) / (open - closed);
    let ranges = fingers.iter().zip(&gripper.closed).zip(&gripper.open);
    let moving = ranges.filter(|((_, closed), open)| closed != open);
    gripper.open_width_m * moving.map(fraction).fold(0.0, f64::max)
}

fn is_at_place(grasp_from_tool: &Frame, config: &JudgeConfig) -> bool {
    grasp_from_tool.translation.length() <= config.anchor_translation_m
        && grasp_from_tool.angle() <= config.anchor_rotation_rad
}

impl Motion {
    /// Checks what the hand does against what it must be doing.
    pub fn check_grip(
        &mut self,
        grips: impl Iterator<Item = Grip>,
        grasps: &[&Grasp],
        config: &JudgeConfig,
    ) {
        let (mut translation, mut rotation) = (Worst::default(), Worst::default());
        let mut wrong = None;
        for grip in grips {
            let at_place = is_at_place(&grip.grasp_from_tool, config);
            match grip.hold {
                Hold::Away => {}
                Hold::Closing(_) | Hold::Held(_) => {
                    translation.see(grip.grasp_from_tool.translation.length(), grip.place);
                    rotation.see(grip.grasp_from_tool.angle(), grip.place);
                }
                Hold::Leaving(_) => {}
            }
            if wrong.is_none() {
                wrong = match grip.hold {
                    Hold::Held(grasp) => too_open(&grip, grasps[grasp], config),
                    Hold::Leaving(grasp) if !at_place => {
                        too_closed(&grip, &grasps[grasp..], config)
                    }
                    _ => None,
                };
            }
        }
        self.anchor_translation_m = translation.value;
        self.anchor_rotation_rad = rotation.value;
        if let Some(place) = translation.above(config.anchor_translation_m) {
            self.findings.push(Finding::new(
                Rejection::AnchorTranslation,
                format!(
                    "{place}: the tool is {:.2} mm away from its place on the handle",
                    translation.value * 1e3
                ),
            ));
        }
        if let Some(place) = rotation.above(config.anchor_rotation_rad) {
            self.findings.push(Finding::new(
                Rejection::AnchorRotation,
                format!(
                    "{place}: the tool is turned by {:.4} rad from its place on the handle",
                    rotation.value
                ),
            ));
        }
        self.findings.extend(wrong);
    }
}

/// Fingers that hold are no wider than what they hold.
fn too_open(grip: &Grip, grasp: &Grasp, config: &JudgeConfig) -> Option<Finding> {
    let most = grasp.width_m + config.finger_width_m;
    (grip.width_m > most).then(|| {
        let detail = format!(
            "{}: the fingers are {:.1} mm apart while they hold {:.1} mm",
            grip.place,
            grip.width_m * 1e3,
            grasp.width_m * 1e3
        );
        Finding::new(Rejection::Grip, detail)
    })
}

/// Away from its place in this grasp and the next, the hand is open wider than what it has held and
/// will hold.
fn too_closed(grip: &Grip, grasps: &[&Grasp], config: &JudgeConfig) -> Option<Finding> {
    if grip.next_from_tool.as_ref().is_some_and(|next| is_at_place(next, config)) {
        return None;
    }
    let held_m = grasps.iter().take(2).map(|g| g.width_m).fold(0.0, f64::max);
    (grip.width_m < held_m + config.finger_width_m).then(|| {
        let detail = format!(
            "{}: the hand leaves the handle with its fingers {:.1} mm apart; they hold {:.1} mm",
            grip.place,
            grip.width_m * 1e3,
            held_m * 1e3
        );
        Finding::new(Rejection::Grip, detail)
    })
}
