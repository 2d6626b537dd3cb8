//! The augmented kinematic representation against the trees it is made of.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use akrobat_model::load::AssetSearch;
use akrobat_model::tree::Mimic;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, Part, Pose, Shape, pose, urdf};
use akrobat_planner::akr::{self, Akr, OBJECT_PREFIX, Rerooted, reroot};
use common::{apart, grasp_at, manipulated, numbers, random_configuration, random_pose};
use nalgebra::{Unit, Vector3};
use proptest::prelude::*;

const KINDS: [JointKind; 4] =
    [JointKind::Fixed, JointKind::Revolute, JointKind::Prismatic, JointKind::Continuous];

/// A joint and its child: parent (as a fraction of the links before), kind, whether it mimics, origin,
/// axis, number of parts.
type Spec = (f64, usize, bool, [f64; 3], [f64; 3], [f64; 3], usize);

fn spec() -> impl Strategy<Value = Spec> {
    let triple = || prop::array::uniform3(-1.5..1.5f64);
    (0.0..1.0f64, 0..4usize, any::<bool>(), triple(), triple(), triple(), 0..3usize)
}

fn link(index: usize, parts: usize) -> Link {
    let part = |k: usize| Part {
        name: format!("part{k}"),
        link_from_part: pose::from_xyz_rpy([0.1 * k as f64, 0.2, -0.1], [0.3, 0.1, k as f64]),
        shape: Shape::Box { size: [0.1, 0.2, 0.3] },
        material: None,
    };
    Link {
        name: format!("link{index}"),
        visuals: (0..parts).map(part).collect(),
        collisions: (0..parts).rev().map(part).collect(),
        inertial: None,
    }
}

fn tree_of(specs: &[Spec]) -> KinematicTree {
    let mut links = vec![link(0, 1)];
    let mut joints: Vec<Joint> = Vec::new();
    for &(parent, kind, mimics, xyz, rpy, axis, parts) in specs {
        let kind = KINDS[kind];
        let followed = joints.iter().position(|j| j.kind != JointKind::Fixed && j.mimic.is_none());
        let mimic = followed.filter(|_| mimics && kind != JointKind::Fixed);
        joints.push(Joint {
            name: format!("joint{}", joints.len()),
            kind,
            parent: (parent * links.len() as f64) as usize,
            child: links.len(),
            parent_from_joint: pose::from_xyz_rpy(xyz, rpy),
            axis: Unit::try_new(Vector3::from(axis), 1e-3).unwrap_or_else(Vector3::z_axis),
            limits: [-2.0, 2.0],
            velocity_limit: Some(1.0),
            effort_limit: None,
            damping: 0.1,
            friction: 0.2,
            mimic: mimic.map(|joint| Mimic { joint, multiplier: -0.5, offset: 0.1 }),
        });
        links.push(link(links.len(), parts));
    }
    KinematicTree::new("random".into(), links, joints).unwrap()
}

/// World poses of the links' old frames in a re-rooted tree, seen from the old frame of link 0.
fn old_frames(rerooted: &KinematicTree, new_from_old: &[Pose], q: &[f64]) -> Vec<Pose> {
    let new = rerooted.link_poses(&Pose::identity(), q);
    let old: Vec<Pose> = new.iter().zip(new_from_old).map(|(n, shift)| n * shift).collect();
    old.iter().map(|pose| old[0].inverse() * pose).collect()
}

fn largest_gap(a: &[Pose], b: &[Pose]) -> f64 {
    a.iter().zip(b).map(|(a, b)| apart(a, b)).fold(0.0, f64::max)
}

/// What a joint is, apart from where its frame lies.
fn nature(joint: &Joint) -> (&str, JointKind, [f64; 2], Option<f64>, &Option<Mimic>) {
    (&joint.name, joint.kind, joint.limits, joint.velocity_limit, &joint.mimic)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn rerooting_keeps_all_relative_poses(
        specs in prop::collection::vec(spec(), 3..8),
        root in 0.0..1.0f64,
        seed in any::<u64>(),
    ) {
        let tree = tree_of(&specs);
        let new_root = (root * tree.links().len() as f64) as usize;
        let once = reroot(&tree, new_root).unwrap();
        prop_assert_eq!(once.tree.root(), new_root);
        let twice = reroot(&once.tree, tree.root()).unwrap();
        prop_assert_eq!(twice.tree.root(), tree.root());
        let both: Vec<Pose> =
            twice.new_from_old.iter().zip(&once.new_from_old).map(|(b, a)| b * a).collect();
        let mut rng = numbers(seed);
        for _ in 0..4 {
            let q = random_configuration(&tree, &mut rng);
            let original = tree.link_poses(&Pose::identity(), &q);
            prop_assert!(largest_gap(&original, &old_frames(&once.tree, &once.new_from_old, &q)) < 1e-9);
            prop_assert!(largest_gap(&original, &old_frames(&twice.tree, &both, &q)) < 1e-9);
        }
    }

    #[test]
    fn rerooting_keeps_joints_and_geometry(
        specs in prop::collection::vec(spec(), 3..8),
        root in 0.0..1.0f64,
    ) {
        let tree = tree_of(&specs);
        let new_root = (root * tree.links().len() as f64) as usize;
        let rerooted = reroot(&tree, new_root).unwrap();
        for (old, new) in tree.joints().iter().zip(rerooted.tree.joints()) {
            prop_assert_eq!(nature(old), nature(new));
            let (mut ends, mut before) = ([new.parent, new.child], [old.parent, old.child]);
            ends.sort_unstable();
            before.sort_unstable();
            prop_assert_eq!(ends, before);
        }
        for (index, (old, new)) in tree.links().iter().zip(rerooted.tree.links()).enumerate() {
            prop_assert_eq!(&old.name, &new.name);
            for (old, new) in [(&old.visuals, &new.visuals), (&old.collisions, &new.collisions)] {
                prop_assert_eq!(old.len(), new.len());
                for (old, new) in old.iter().zip(new) {
                    let expected = rerooted.new_from_old[index] * old.link_from_part;
                    prop_assert!(apart(&expected, &new.link_from_part) < 1e-12);
                }
            }
        }
    }
}

/// Negative control: the comparison above sees an axis that was not turned round.
#[test]
fn a_wrong_axis_shows_in_the_relative_poses() {
    let triple = [0.3, -0.4, 0.5];
    let specs =
        [(0.0, 1, false, triple, triple, triple, 1), (0.9, 2, false, triple, triple, triple, 1)];
    let tree = tree_of(&specs);
    let q = [0.7, 0.3];
    let original = tree.link_poses(&Pose::identity(), &q);
    let Rerooted { tree: right, new_from_old } = reroot(&tree, 2).unwrap();
    assert!(largest_gap(&original, &old_frames(&right, &new_from_old, &q)) < 1e-12);
    for joint in 0..2 {
        let mut joints = right.joints().to_vec();
        joints[joint].axis = -joints[joint].axis;
        let wrong = KinematicTree::new("wrong".into(), right.links().to_vec(), joints).unwrap();
        assert!(largest_gap(&original, &old_frames(&wrong, &new_from_old, &q)) > 0.05);
    }
}

#[test]
fn real_objects_are_rerooted_at_every_link() {
    let Some(objects) = common::objects() else { return };
    let mut rng = numbers(1);
    for tree in &objects {
        for link in 0..tree.links().len() {
            let once = reroot(tree, link).unwrap();
            let twice = reroot(&once.tree, tree.root()).unwrap();
            let both: Vec<Pose> =
                twice.new_from_old.iter().zip(&once.new_from_old).map(|(b, a)| b * a).collect();
            for _ in 0..3 {
                let q = random_configuration(tree, &mut rng);
                // Seen from link 0, whichever link is the root.
                let original = old_frames(tree, &vec![Pose::identity(); tree.links().len()], &q);
                let gap = largest_gap(&original, &old_frames(&once.tree, &once.new_from_old, &q));
                assert!(gap < 1e-9, "{} at link {link}: {gap}", tree.name);
                let gap = largest_gap(&original, &old_frames(&twice.tree, &both, &q));
                assert!(gap < 1e-9, "{} at link {link} and back: {gap}", tree.name);
            }
        }
    }
}

/// Calls `check` with the AKR of Summit-Franka and every joint of every object, the object placed so
/// that the tool is at a random grasp in a random configuration.
fn for_every_object(
    check: impl Fn(
        &Akr,
        &akrobat_model::task::ManipulatedObject,
        &akrobat_model::trajectory::Grasp,
        &[f64],
    ),
) {
    let (Some(robot), Some(objects)) = (common::summit(), common::objects()) else { return };
    let mut rng = numbers(2);
    for tree in &objects {
        for &active in tree.dof_joints() {
            let mut object = manipulated(tree, active, Pose::identity());
            object.start = random_configuration(tree, &mut rng);
            let grasp = grasp_at(&object, random_pose(&mut rng));
            let mut robot_q = random_configuration(&robot.tree, &mut rng);
            for (&joint, position) in
                robot.gripper_joints.iter().zip(robot.finger_positions(grasp.width_m))
            {
                if let Some(column) = robot.tree.column(joint) {
                    robot_q[column] = position;
                }
            }
            let opened = rng.random_range(-0.5..0.5);
            let object_q = object.configuration(opened);
            let poses = robot.tree.link_poses(&robot.world_from_root, &robot_q);
            let world_from_held =
                poses[robot.tool_link] * robot.link_from_tool * grasp.link_from_tool.inverse();
            let root_from_link = tree.link_poses(&Pose::identity(), &object_q);
            object.world_from_root = world_from_held * root_from_link[object.handle_link].inverse();
            let akr = akr::assemble(&robot, &object, &grasp).unwrap();
            check(&akr, &object, &grasp, &[robot_q, object_q].concat());
        }
    }
}

#[test]
fn the_chain_ends_at_the_objects_root() {
    let Some(robot) = common::summit() else { return };
    for_every_object(|akr, object, _, q| {
        let poses = akr.tree.link_poses(&robot.world_from_root, q);
        let root = poses[akr.object_root] * akr.root_link_from_object;
        assert!(apart(&root, &object.world_from_root) < 1e-9, "{}", object.name);
        let own = object.tree.link_poses(&object.world_from_root, &q[robot.tree.dof()..]);
        let new_from_old = reroot(&object.tree, object.handle_link).unwrap().new_from_old;
        for (link, expected) in own.iter().enumerate() {
            let ours = poses[robot.tree.links().len() + link] * new_from_old[link];
            assert!(apart(&ours, expected) < 1e-9, "{} link {link}", object.name);
        }
        // Negative control: with the driven joint elsewhere, the root is not in its place.
        let mut moved = q.to_vec();
        let column = object.tree.column(object.active_joint).unwrap();
        moved[robot.tree.dof() + column] += 0.1;
        let poses = akr.tree.link_poses(&robot.world_from_root, &moved);
        let root = poses[akr.object_root] * akr.root_link_from_object;
        assert!(apart(&root, &object.world_from_root) > 0.05, "{}", object.name);
    });
}

#[test]
fn the_chain_keeps_every_branch_and_its_state() {
    let Some(robot) = common::summit() else { return };
    for_every_object(|akr, object, grasp, _| {
        let robot_links = robot.tree.links().len();
        assert_eq!(akr.tree.links().len(), robot_links + object.tree.links().len());
        assert_eq!(akr.tree.dof(), robot.tree.dof() + object.tree.dof());
        let originals = robot.tree.links().iter().chain(object.tree.links());
        for (index, (old, new)) in originals.zip(akr.tree.links()).enumerate() {
            let prefix = if index < robot_links { "" } else { OBJECT_PREFIX };
            assert_eq!(new.name, format!("{prefix}{}", old.name));
            assert_eq!(old.visuals.len(), new.visuals.len(), "{}", new.name);
            assert_eq!(old.collisions.len(), new.collisions.len(), "{}", new.name);
        }
        assert_eq!(akr.rest[robot.tree.dof()..], object.start);
        for (&joint, position) in
            robot.gripper_joints.iter().zip(robot.finger_positions(grasp.width_m))
        {
            assert_eq!(akr.rest[robot.tree.column(joint).unwrap()], position);
        }
        let driven = robot.tree.joints().len() + object.active_joint;
        assert_eq!(akr.variables.len(), 11);
        assert_eq!(akr.variables[10], driven);
        // The driven joint is on the way from the tool to the object's root.
        assert!(akr.tree.chain_to(akr.object_root).contains(&driven));
    });
}

#[test]
fn a_link_that_the_joint_does_not_move_cannot_be_held() {
    let (Some(robot), Some(objects)) = (common::summit(), common::objects()) else { return };
    let mut object = manipulated(&objects[0], objects[0].dof_joints()[0], Pose::identity());
    object.handle_link = object.tree.root();
    let error = akr::assemble(&robot, &object, &grasp_at(&object, Pose::identity())).unwrap_err();
    assert!(error.to_string().contains("is not moved by joint"), "{error}");
    let mut grasp = grasp_at(&object, Pose::identity());
    grasp.link = "no_such_link".into();
    let error = akr::assemble(&robot, &object, &grasp).unwrap_err();
    assert!(error.to_string().contains("no_such_link"), "{error}");
}

/// The tree written as a URDF and read again, without geometry.
fn through_urdf(tree: &KinematicTree) -> KinematicTree {
    let bare = tree.links().iter().map(|l| Link { name: l.name.clone(), ..Link::default() });
    let bare =
        KinematicTree::new(tree.name.clone(), bare.collect(), tree.joints().to_vec()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("akr.urdf");
    std::fs::write(&path, urdf::to_string(&bare)).unwrap();
    urdf::read(&path, &AssetSearch::default()).unwrap().0
}

#[test]
fn the_chain_survives_being_written_as_urdf() {
    let Some(robot) = common::summit() else { return };
    for_every_object(|akr, object, _, q| {
        let read = through_urdf(&akr.tree);
        assert_eq!(read.dof(), akr.tree.dof(), "{}", object.name);
        let by_name = |q: &[f64]| -> Vec<f64> {
            let value = |&j: &usize| {
                let name = &read.joints()[j].name;
                q[akr.tree.column(akr.tree.joint_index(name).unwrap()).unwrap()]
            };
            read.dof_joints().iter().map(value).collect()
        };
        let ours = akr.tree.link_poses(&robot.world_from_root, q);
        let theirs = read.link_poses(&robot.world_from_root, &by_name(q));
        for (index, link) in akr.tree.links().iter().enumerate() {
            let theirs = &theirs[read.link_index(&link.name).unwrap()];
            assert!(apart(&ours[index], theirs) < 1e-7, "{}: {}", object.name, link.name);
        }
    });
}
