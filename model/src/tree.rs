//! Kinematic trees: links, joints, forward kinematics.

use nalgebra::{Translation3, Unit, UnitQuaternion, Vector3};

use crate::{ModelError, Part, Pose};

mod scale;

/// How a joint moves its child.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Does not move.
    Fixed,
    /// Turns about its axis, within limits (radians).
    Revolute,
    /// Turns about its axis without limits (radians).
    Continuous,
    /// Slides along its axis, within limits (metres).
    Prismatic,
}

/// A joint that follows another: `q = multiplier * q[joint] + offset`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mimic {
    /// Index of the joint that is followed, which itself mimics nothing.
    pub joint: usize,
    /// Factor.
    pub multiplier: f64,
    /// Offset, radians or metres.
    pub offset: f64,
}

/// A joint between two links.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Unique name, exactly as the file has it (spaces included).
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// Index of the parent link.
    pub parent: usize,
    /// Index of the child link.
    pub child: usize,
    /// Pose of the joint frame (the child's frame at q = 0) in the parent link's frame.
    pub parent_from_joint: Pose,
    /// Axis in the joint frame; normalised on load.
    pub axis: Unit<Vector3<f64>>,
    /// Lower and upper position limit, rad or m; infinite for continuous joints.
    pub limits: [f64; 2],
    /// Largest speed, rad/s or m/s, where the file states one.
    pub velocity_limit: Option<f64>,
    /// Largest effort, N m or N, where the file states one.
    pub effort_limit: Option<f64>,
    /// Viscous damping, N m s/rad or N s/m.
    pub damping: f64,
    /// Coulomb friction, N m or N.
    pub friction: f64,
    /// Set for a joint that follows another.
    pub mimic: Option<Mimic>,
}

impl Joint {
    /// Pose of the child link in the parent link's frame at joint position `q` (rad or m).
    pub fn parent_from_child(&self, q: f64) -> Pose {
        match self.kind {
            JointKind::Fixed => self.parent_from_joint,
            JointKind::Revolute | JointKind::Continuous => {
                self.parent_from_joint * UnitQuaternion::from_axis_angle(&self.axis, q)
            }
            JointKind::Prismatic => {
                self.parent_from_joint * Translation3::from(self.axis.into_inner() * q)
            }
        }
    }
}

/// Mass properties of a link; several `<inertial>` elements are merged on load.
#[derive(Debug, Clone, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass: f64,
    /// Pose of the inertia frame (origin at the centre of mass) in the link's frame.
    pub link_from_inertia: Pose,
    /// `ixx, ixy, ixz, iyy, iyz, izz` in the inertia frame, kg m^2.
    pub inertia: [f64; 6],
}

/// A rigid link.
#[derive(Debug, Clone, Default)]
pub struct Link {
    /// Unique name.
    pub name: String,
    /// What is seen.
    pub visuals: Vec<Part>,
    /// What collides.
    pub collisions: Vec<Part>,
    /// Mass properties, if stated.
    pub inertial: Option<Inertial>,
}

/// Links connected by joints, without cycles, with one root.
///
/// A *configuration* `q` holds one position for each joint of [`KinematicTree::dof_joints`], in
/// that order.
#[derive(Debug, Clone)]
pub struct KinematicTree {
    /// The robot's or object's name.
    pub name: String,
    links: Vec<Link>,
    joints: Vec<Joint>,
    root: usize,
    /// Joint indices, parents before children.
    order: Vec<usize>,
    dof_joints: Vec<usize>,
    /// For each joint, its column in q (its own, or that of the joint it follows).
    column: Vec<Option<usize>>,
    parent_joint: Vec<Option<usize>>,
}

impl KinematicTree {
    /// Assembles a tree and checks that it is one.
    ///
    /// # Errors
    /// Where a link has two parents, a joint closes a cycle, there is not exactly one root, a link is
    /// disconnected, names repeat, or a mimic joint follows itself, another mimic or a fixed joint.
    pub fn new(name: String, links: Vec<Link>, joints: Vec<Joint>) -> Result<Self, ModelError> {
        let fail = |message: String| Err(ModelError::bad_value(&name, message));
        if links.is_empty() {
            return fail("has no links".into());
        }
        for (kind, repeated) in [
            ("link", first_repeated(links.iter().map(|l| l.name.as_str()))),
            ("joint", first_repeated(joints.iter().map(|j| j.name.as_str()))),
        ] {
            if let Some(repeated) = repeated {
                return fail(format!("{kind} name \"{repeated}\" is used twice"));
            }
        }
        let mut parent_joint = vec![None; links.len()];
        for (index, joint) in joints.iter().enumerate() {
            if let Some(other) = parent_joint[joint.child].replace(index) {
                let other: &Joint = &joints[other];
                return fail(format!(
                    "link \"{}\" has two parent joints, \"{}\" and \"{}\"",
                    links[joint.child].name, other.name, joint.name
                ));
            }
        }
        let roots: Vec<usize> = (0..links.len()).filter(|&l| parent_joint[l].is_none()).collect();
        if roots.is_empty() {
            return fail(format!(
                "the joints form a cycle through link \"{}\": every link has a parent",
                links[0].name
            ));
        }
        if roots.len() > 1 {
            let names: Vec<&str> = roots.iter().map(|&l| links[l].name.as_str()).collect();
            return fail(format!(
                "expected one root link, found {} disconnected ones: {}",
                roots.len(),
                names.join(", ")
            ));
        }
        let order = breadth_first(&joints, roots[0]);
        if order.len() < joints.len() {
            let missing = (0..joints.len()).find(|j| !order.contains(j));
            let missing = missing.map_or("?", |j| joints[j].name.as_str());
            return fail(format!(
                "the joints form a cycle: joint \"{missing}\" cannot be reached from the root"
            ));
        }
        let dof_joints: Vec<usize> = (0..joints.len())
            .filter(|&j| joints[j].kind != JointKind::Fixed && joints[j].mimic.is_none())
            .collect();
        let mut column = vec![None; joints.len()];
        for (index, joint) in joints.iter().enumerate() {
            let source = joint.mimic.as_ref().map_or(index, |mimic| mimic.joint);
            column[index] = dof_joints.iter().position(|&j| j == source);
            if joint.mimic.is_some() && column[index].is_none() {
                return fail(format!(
                    "joint \"{}\" mimics \"{}\", which is fixed or itself a mimic",
                    joint.name, joints[source].name
                ));
            }
        }
        Ok(Self { root: roots[0], name, links, joints, order, dof_joints, column, parent_joint })
    }

    /// This tree with another bolted on: a fixed joint named `<other's root>_mount` holds the root
    /// of `other` at `link_from_other` in `link`. Links and joints of this tree keep their indices.
    ///
    /// # Errors
    /// Where the two share a link or joint name.
    pub fn attach(
        self,
        link: usize,
        link_from_other: Pose,
        other: Self,
    ) -> Result<Self, ModelError> {
        let (first_link, first_joint) = (self.links.len(), self.joints.len());
        let mount = Joint {
            name: format!("{}_mount", other.links[other.root].name),
            kind: JointKind::Fixed,
            parent: link,
            child: first_link + other.root,
            parent_from_joint: link_from_other,
            axis: Vector3::x_axis(),
            limits: [0.0, 0.0],
            velocity_limit: None,
            effort_limit: None,
            damping: 0.0,
            friction: 0.0,
            mimic: None,
        };
        let moved = other.joints.into_iter().map(|mut joint| {
            joint.parent += first_link;
            joint.child += first_link;
            joint.mimic =
                joint.mimic.map(|mimic| Mimic { joint: mimic.joint + first_joint, ..mimic });
            joint
        });
        let joints = self.joints.into_iter().chain(moved).chain([mount]).collect();
        let links = self.links.into_iter().chain(other.links).collect();
        Self::new(self.name, links, joints)
    }

    /// Replaces the position limits of a joint (rad, m).
    pub(crate) fn set_limits(&mut self, joint: usize, limits: [f64; 2]) {
        self.joints[joint].limits = limits;
    }

    /// All links.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// All joints.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Index of the root link.
    pub fn root(&self) -> usize {
        self.root
    }

    /// Joint indices ordered so that each joint's parent link is placed before it.
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// Indices of the joints that a configuration holds: neither fixed nor mimics, in file order.
    pub fn dof_joints(&self) -> &[usize] {
        &self.dof_joints
    }

    /// Number of degrees of freedom, the length of a configuration.
    pub fn dof(&self) -> usize {
        self.dof_joints.len()
    }

    /// The joint whose child is `link`; `None` for the root.
    pub fn parent_joint(&self, link: usize) -> Option<usize> {
        self.parent_joint[link]
    }

    /// Joint indices on the way from the root to `link`, root first.
    pub fn chain_to(&self, link: usize) -> Vec<usize> {
        let mut chain: Vec<usize> = std::iter::successors(self.parent_joint[link], |&j| {
            self.parent_joint[self.joints[j].parent]
        })
        .collect();
        chain.reverse();
        chain
    }

    /// Index of the link of this name.
    ///
    /// # Errors
    /// [`ModelError::UnknownName`], which lists the links.
    pub fn link_index(&self, link: &str) -> Result<usize, ModelError> {
        self.links.iter().position(|l| l.name == link).ok_or_else(|| {
            ModelError::unknown(&self.name, "link", link, self.links.iter().map(|l| l.name.clone()))
        })
    }

    /// Index of the joint of this name.
    ///
    /// # Errors
    /// [`ModelError::UnknownName`], which lists the movable joints.
    pub fn joint_index(&self, joint: &str) -> Result<usize, ModelError> {
        self.joints.iter().position(|j| j.name == joint).ok_or_else(|| {
            let movable = self.joints.iter().filter(|j| j.kind != JointKind::Fixed);
            ModelError::unknown(&self.name, "joint", joint, movable.map(|j| j.name.clone()))
        })
    }

    /// Column of a joint in a configuration (a mimic joint's is that of the joint it follows);
    /// `None` for fixed joints.
    pub fn column(&self, joint: usize) -> Option<usize> {
        self.column[joint]
    }

    /// Position of `joint` (rad or m) at configuration `q`; 0 for fixed joints.
    pub fn joint_position(&self, joint: usize, q: &[f64]) -> f64 {
        let Some(column) = self.column[joint] else { return 0.0 };
        match &self.joints[joint].mimic {
            Some(mimic) => mimic.multiplier * q[column] + mimic.offset,
            None => q[column],
        }
    }

    /// The configuration nearest to zero that respects the position limits.
    pub fn neutral(&self) -> Vec<f64> {
        let clamp = |&j: &usize| 0.0f64.clamp(self.joints[j].limits[0], self.joints[j].limits[1]);
        self.dof_joints.iter().map(clamp).collect()
    }

    /// World pose of every link at configuration `q`, in link order.
    ///
    /// # Panics
    /// If `q` does not have [`KinematicTree::dof`] values.
    pub fn link_poses(&self, world_from_root: &Pose, q: &[f64]) -> Vec<Pose> {
        assert_eq!(q.len(), self.dof(), "configuration length of {}", self.name);
        let mut world_from_link = vec![*world_from_root; self.links.len()];
        for &index in &self.order {
            let joint = &self.joints[index];
            world_from_link[joint.child] = world_from_link[joint.parent]
                * joint.parent_from_child(self.joint_position(index, q));
        }
        world_from_link
    }
}

fn first_repeated<'a>(names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let mut seen = std::collections::HashSet::new();
    names.into_iter().find(|name| !seen.insert(*name))
}

fn breadth_first(joints: &[Joint], root: usize) -> Vec<usize> {
    let mut order = Vec::with_capacity(joints.len());
    let mut frontier = std::collections::VecDeque::from([root]);
    while let Some(link) = frontier.pop_front() {
        for (index, joint) in joints.iter().enumerate().filter(|(_, j)| j.parent == link) {
            order.push(index);
            frontier.push_back(joint.child);
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slider(name: &str, links: [&str; 2]) -> KinematicTree {
        let links = links.map(|name| Link { name: name.into(), ..Link::default() });
        let joint = Joint {
            name: format!("{name}_joint"),
            kind: JointKind::Prismatic,
            parent: 0,
            child: 1,
            parent_from_joint: Pose::translation(1.0, 0.0, 0.0),
            axis: Vector3::y_axis(),
            limits: [0.0, 1.0],
            velocity_limit: None,
            effort_limit: None,
            damping: 0.0,
            friction: 0.0,
            mimic: None,
        };
        KinematicTree::new(name.into(), links.into(), vec![joint]).unwrap()
    }

    #[test]
    fn an_attached_tree_moves_with_its_carrier_and_on_its_own() {
        let arm = slider("arm", ["base", "wrist"]);
        let gripper = slider("gripper", ["palm", "finger"]);
        let quarter =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let wrist_from_palm = Translation3::new(0.0, 0.0, 1.0) * quarter;
        let both = arm.attach(1, wrist_from_palm, gripper).unwrap();
        assert_eq!(both.dof(), 2);
        let world_from_link = both.link_poses(&Pose::identity(), &[0.25, 0.5]);
        let finger = world_from_link[both.link_index("finger").unwrap()].translation.vector;
        assert!((finger - Vector3::new(1.0 - 0.5, 0.25 + 1.0, 1.0)).norm() < 1e-12, "{finger}");
    }

    #[test]
    fn attaching_a_tree_to_its_copy_is_refused() {
        let arm = slider("arm", ["base", "wrist"]);
        let error = arm.clone().attach(1, Pose::identity(), arm).unwrap_err().to_string();
        assert!(error.contains("\"base\" is used twice"), "{error}");
    }
}
