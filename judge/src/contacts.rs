//! Which pairs may touch: adjacent links, the robot file's list, what the robot stands on, and the
//! listed finger-handle pairs.

use akrobat_model::robot::Robot;
use akrobat_model::task::{Task, matches_pattern};
use akrobat_model::trajectory::ContactException;
use akrobat_model::{JointKind, ModelError};

use crate::JudgeError;
use crate::bodies::Obstacle;

/// May a robot link touch a part of an obstacle?
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// No.
    Forbidden,
    /// Yes, anywhere.
    Allowed,
    /// Yes, inside the handle's region; collision spheres, which are coarse, anywhere.
    AllowedInRegion,
}

/// What moves with what in a robot.
#[derive(Debug)]
pub struct RobotGroups {
    /// For each link, the topmost link that it is rigidly attached to in a trajectory.
    rigid: Vec<usize>,
    /// True for links that only base joints move.
    stands: Vec<bool>,
    /// True for links that finger joints move.
    finger: Vec<bool>,
    /// Pairs of rigid groups with a moving joint between.
    joined: Vec<[usize; 2]>,
}

impl RobotGroups {
    /// Reads the joints of a robot. A joint moves if it is a trajectory column or follows one.
    pub fn new(robot: &Robot) -> Self {
        let tree = &robot.tree;
        let driven = |joints: &[usize], joint: usize| {
            let description = &tree.joints()[joint];
            let source = description.mimic.as_ref().map_or(joint, |mimic| mimic.joint);
            description.kind != JointKind::Fixed && joints.contains(&source)
        };
        let columns = robot.trajectory_joints();
        let links = tree.links().len();
        let above = |link: usize| {
            std::iter::successors(tree.parent_joint(link), |&joint| {
                tree.parent_joint(tree.joints()[joint].parent)
            })
        };
        let rigid: Vec<usize> = (0..links)
            .map(|link| {
                let first_moving = above(link).find(|&joint| driven(&columns, joint));
                first_moving.map_or(tree.root(), |joint| tree.joints()[joint].child)
            })
            .collect();
        let upper = [&robot.arm_joints[..], &robot.gripper_joints].concat();
        Self {
            stands: (0..links)
                .map(|link| !above(link).any(|joint| driven(&upper, joint)))
                .collect(),
            finger: (0..links)
                .map(|link| above(link).any(|joint| driven(&robot.gripper_joints, joint)))
                .collect(),
            joined: (0..tree.joints().len())
                .filter(|&joint| driven(&columns, joint))
                .map(|joint| {
                    [tree.joints()[joint].parent, tree.joints()[joint].child].map(|l| rigid[l])
                })
                .collect(),
            rigid,
        }
    }

    /// True for links that stand on the floor with the base: no arm or finger joint is below them.
    pub fn stands(&self, link: usize) -> bool {
        self.stands[link]
    }

    /// True for pairs that may touch whatever the pose: rigidly attached to each other, joined by one
    /// moving joint, or two fingers.
    fn neighbours(&self, a: usize, b: usize) -> bool {
        let [group_a, group_b] = [a, b].map(|link| self.rigid[link]);
        let joined = |pair: &[usize; 2]| *pair == [group_a, group_b] || *pair == [group_b, group_a];
        group_a == group_b || self.joined.iter().any(joined) || (self.finger[a] && self.finger[b])
    }
}

/// Robot links that must not touch each other, as a symmetric table.
#[derive(Debug, Clone)]
pub struct LinkPairs {
    links: usize,
    checked: Vec<bool>,
}

impl LinkPairs {
    /// All pairs but neighbours and those that the robot file lists.
    pub fn new(robot: &Robot, groups: &RobotGroups) -> Self {
        let links = robot.tree.links().len();
        let mut pairs = Self { links, checked: vec![false; links * links] };
        for a in 0..links {
            for b in 0..links {
                pairs.checked[a * links + b] = !groups.neighbours(a, b);
            }
        }
        for [a, b] in &robot.file.self_collision_ignore {
            if let (Ok(a), Ok(b)) = (robot.tree.link_index(a), robot.tree.link_index(b)) {
                pairs.ignore(a, b);
            }
        }
        pairs
    }

    /// Stops checking a pair.
    pub fn ignore(&mut self, a: usize, b: usize) {
        self.checked[a * self.links + b] = false;
        self.checked[b * self.links + a] = false;
    }

    /// True where the pair must not touch.
    pub fn checked(&self, a: usize, b: usize) -> bool {
        self.checked[a * self.links + b]
    }
}

/// For every robot link and obstacle (scene, then object links), what each of its owners may do.
pub type ContactTable = Vec<Vec<Vec<Contact>>>;

/// Fills the table from the listed exceptions and from what stands on the floor.
///
/// # Errors
/// [`JudgeError::Name`] for an exception that names a link or part that does not exist.
pub fn contact_table(
    task: &Task,
    obstacles: &[Obstacle],
    groups: &RobotGroups,
    exceptions: &[ContactException],
) -> Result<ContactTable, JudgeError> {
    let robot = &task.robot.tree;
    let forbidden = |obstacle: &Obstacle| vec![Contact::Forbidden; obstacle.owners.len()];
    let row = || obstacles.iter().map(forbidden).collect::<Vec<_>>();
    let mut table: ContactTable = (0..robot.links().len()).map(|_| row()).collect();
    for (_, row) in table.iter_mut().enumerate().filter(|(link, _)| groups.stands(*link)) {
        for (contact, owner) in row[0].iter_mut().zip(&obstacles[0].owners) {
            if owner.is_floor {
                *contact = Contact::Allowed;
            }
        }
    }
    for exception in exceptions {
        let link = robot.link_index(&exception.robot_link)?;
        let object_link = task.object.tree.link_index(&exception.object_link)?;
        let obstacle = &obstacles[1 + object_link];
        let bounded = task.object.handle_region.is_some() && object_link == task.object.handle_link;
        let contact = if bounded { Contact::AllowedInRegion } else { Contact::Allowed };
        let mut matched = false;
        for (index, owner) in obstacle.owners.iter().enumerate() {
            if matches_pattern(&exception.object_part, &owner.part) {
                table[link][1 + object_link][index] = contact;
                matched = true;
            }
        }
        if !matched {
            return Err(JudgeError::Name(ModelError::unknown(
                format!("contact exception of object link \"{}\"", exception.object_link),
                "part",
                &exception.object_part,
                obstacle.owners.iter().map(|owner| owner.part.clone()),
            )));
        }
    }
    Ok(table)
}
