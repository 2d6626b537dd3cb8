//! What the appliances share: carcasses, fronts, hinges.

use akrobat_model::JointKind;
use nalgebra::Vector3;

use crate::description::{JointDescription, LinkDescription, Motion};
use crate::error::AssetError;
use crate::finish::Finish;
use crate::handle::{HandleStyle, Orientation, handle_link};

/// Reveal around a front and gap behind it, metres.
pub(super) const REVEAL_M: f64 = 0.0015;

/// Opening angles of doors that a task asks for: 62, 69, 75 and 83 degrees.
pub(super) const DOOR_GOALS: [f64; 4] = [1.08, 1.2, 1.31, 1.45];

/// Which side of a door its hinges are on, seen from the front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HingeSide {
    /// At -y.
    Left,
    /// At +y.
    Right,
}

impl HingeSide {
    /// Sign of y on the hinges' side: someone in front looks along -x, with +y on the right.
    pub(super) fn sign(self) -> f64 {
        match self {
            Self::Left => -1.0,
            Self::Right => 1.0,
        }
    }
}

/// Refuses a dimension outside `range` (metres).
pub(crate) fn check(
    what: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), AssetError> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err(AssetError::Dimension { what, expected, value })
    }
}

/// An open-fronted box of boards: back at x = 0.
pub(super) struct Carcass<'a> {
    pub depth: f64,
    pub width: f64,
    /// Lower and upper edge.
    pub z: [f64; 2],
    pub wall: f64,
    pub finish: &'a Finish,
}

impl Carcass<'_> {
    pub fn add_to(&self, link: &mut LinkDescription) {
        let Self { depth, width, z: [low, high], wall, finish } = *self;
        let half = width / 2.0;
        let inner = half - wall;
        let boards = [
            ("side_left", [0.0, inner, low], [depth, half, high]),
            ("side_right", [0.0, -half, low], [depth, -inner, high]),
            ("bottom", [0.0, -inner, low], [depth, inner, low + wall]),
            ("top", [0.0, -inner, high - wall], [depth, inner, high]),
            ("back", [0.0, -inner, low + wall], [wall.min(0.012), inner, high - wall]),
        ];
        for (name, low, high) in boards {
            link.add_box(name, finish, low, high);
        }
    }
}

/// A revolute joint with the friction and damping of a light door on sprung hinges.
pub(super) fn hinge(
    name: &str,
    child: &str,
    origin: [f64; 3],
    axis: Vector3<f64>,
    upper: f64,
) -> JointDescription {
    JointDescription {
        name: name.into(),
        parent: "body".into(),
        child: child.into(),
        origin,
        motion: Some(Motion {
            kind: JointKind::Revolute,
            axis,
            limits: [0.0, upper],
            velocity: 2.0,
            damping: 0.8,
            friction: 0.4,
        }),
    }
}

/// A prismatic joint along x with the friction and damping of a ball-bearing runner.
pub(super) fn runner(name: &str, child: &str, origin: [f64; 3], travel: f64) -> JointDescription {
    JointDescription {
        name: name.into(),
        parent: "body".into(),
        child: child.into(),
        origin,
        motion: Some(Motion {
            kind: JointKind::Prismatic,
            axis: Vector3::x(),
            limits: [0.0, travel],
            velocity: 1.0,
            damping: 6.0,
            friction: 3.0,
        }),
    }
}

/// A handle fixed to a front: its link and the joint that mounts it at `origin` in the parent's frame.
pub(super) fn mounted_handle(
    name: &str,
    parent: &str,
    origin: [f64; 3],
    style: HandleStyle,
    orientation: Orientation,
    finish: &Finish,
) -> (LinkDescription, JointDescription) {
    let joint = JointDescription {
        name: format!("{name}_mount"),
        parent: parent.into(),
        child: name.into(),
        origin,
        motion: None,
    };
    (handle_link(name, style, orientation, finish), joint)
}

/// A side-hinged door. Its frame lies on the hinge axis, in the lower front corner of the hinges' side:
/// turning about that corner keeps the door clear of the carcass behind and of neighbours beside.
pub(super) struct SideDoor<'a> {
    /// Name of its link; its joint is `<name>_hinge`.
    pub name: &'a str,
    pub side: HingeSide,
    /// Outer width of the front that it closes, with the reveal.
    pub width: f64,
    /// Middle of that front.
    pub middle_y: f64,
    /// Lower and upper edge of that front.
    pub z: [f64; 2],
    /// Front of the carcass.
    pub carcass_depth: f64,
    pub thickness: f64,
    pub finish: &'a Finish,
    pub mass_kg: f64,
    pub upper: f64,
}

impl SideDoor<'_> {
    /// Front face of the closed door.
    pub fn front_x(&self) -> f64 {
        self.carcass_depth + REVEAL_M + self.thickness
    }

    /// Width of the panel.
    pub fn panel_width(&self) -> f64 {
        self.width - 2.0 * REVEAL_M
    }

    /// Height of the panel.
    pub fn panel_height(&self) -> f64 {
        self.z[1] - self.z[0] - 2.0 * REVEAL_M
    }

    /// A y in the door's frame, `inward` metres from the hinges.
    pub fn inward_y(&self, inward: f64) -> f64 {
        -self.side.sign() * inward
    }

    pub fn build(&self) -> (LinkDescription, JointDescription) {
        let mut link = LinkDescription::new(self.name, self.mass_kg);
        let (near, far) = (0.0, self.inward_y(self.panel_width()));
        link.add_box(
            "panel",
            self.finish,
            [-self.thickness, far.min(near), 0.0],
            [0.0, far.max(near), self.panel_height()],
        );
        let hinge_y = self.middle_y + self.side.sign() * (self.width / 2.0 - REVEAL_M);
        let origin = [self.front_x(), hinge_y, self.z[0] + REVEAL_M];
        let axis = Vector3::z() * self.side.sign();
        (link, hinge(&format!("{}_hinge", self.name), self.name, origin, axis, self.upper))
    }
}

/// A door hinged at its lower edge, in its lower front corner.
pub(super) struct DropDoor<'a> {
    pub width: f64,
    pub z: [f64; 2],
    pub carcass_depth: f64,
    pub thickness: f64,
    pub finish: &'a Finish,
    pub mass_kg: f64,
    pub upper: f64,
}

impl DropDoor<'_> {
    /// Height of the panel.
    pub fn panel_height(&self) -> f64 {
        self.z[1] - self.z[0] - 2.0 * REVEAL_M
    }

    /// Half the width of the panel.
    pub fn panel_half_width(&self) -> f64 {
        self.width / 2.0 - REVEAL_M
    }

    pub fn build(&self) -> (LinkDescription, JointDescription) {
        let mut link = LinkDescription::new("door", self.mass_kg);
        let half = self.panel_half_width();
        let height = self.panel_height();
        link.add_box("panel", self.finish, [-self.thickness, -half, 0.0], [0.0, half, height]);
        let front = self.carcass_depth + REVEAL_M + self.thickness;
        let origin = [front, 0.0, self.z[0] + REVEAL_M];
        let joint = hinge("door_hinge", "door", origin, Vector3::y(), self.upper);
        (link, joint)
    }
}
