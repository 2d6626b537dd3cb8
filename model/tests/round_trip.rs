//! A tree written as URDF and read again is the same tree.

#![allow(clippy::unwrap_used)] // A test that cannot go on has failed.

mod common;

use akrobat_model::load::AssetSearch;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, Part, Pose, Shape, pose, urdf};
use nalgebra::{Unit, Vector3};
use proptest::prelude::*;

fn assert_same(a: &KinematicTree, b: &KinematicTree) {
    assert_eq!(a.name, b.name);
    assert_eq!((a.links().len(), a.joints().len()), (b.links().len(), b.joints().len()));
    for (a, b) in a.joints().iter().zip(b.joints()) {
        assert_eq!((&a.name, a.kind, a.parent, a.child), (&b.name, b.kind, b.parent, b.child));
        assert!(
            a.kind == JointKind::Fixed
                || (a.axis.into_inner() - b.axis.into_inner()).norm() < 1e-12
        );
        assert_eq!(a.limits, b.limits);
        assert_eq!((a.velocity_limit, a.effort_limit), (b.velocity_limit, b.effort_limit));
        assert_eq!((a.damping, a.friction, &a.mimic), (b.damping, b.friction, &b.mimic));
        assert_near(&a.parent_from_joint, &b.parent_from_joint);
    }
    for (a, b) in a.links().iter().zip(b.links()) {
        assert_eq!(a.name, b.name);
        assert_eq!(a.inertial.is_some(), b.inertial.is_some());
        for (a, b) in [(&a.visuals, &b.visuals), (&a.collisions, &b.collisions)] {
            assert_eq!(a.len(), b.len());
            for (a, b) in a.iter().zip(b) {
                assert_eq!(a.name, b.name);
                assert_near(&a.link_from_part, &b.link_from_part);
                assert_eq!(
                    format!("{:?}", a.triangulate().len()),
                    format!("{:?}", b.triangulate().len())
                );
            }
        }
    }
}

fn assert_near(a: &Pose, b: &Pose) {
    assert!((a.translation.vector - b.translation.vector).norm() < 1e-12, "{a} {b}");
    assert!(a.rotation.angle_to(&b.rotation) < 1e-6, "{a} {b}");
}

fn reread(tree: &KinematicTree) -> KinematicTree {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("written.urdf");
    std::fs::write(&path, urdf::to_string(tree)).unwrap();
    urdf::read(&path, &AssetSearch::default()).unwrap_or_else(|e| panic!("{e}")).0
}

prop_compose! {
    fn any_pose()(xyz in prop::array::uniform3(-5.0..5.0f64), rpy in prop::array::uniform3(-3.0..3.0f64)) -> Pose {
        pose::from_xyz_rpy(xyz, rpy)
    }
}

fn any_shape() -> impl Strategy<Value = Shape> {
    let length = 0.001..10.0f64;
    prop_oneof![
        prop::array::uniform3(length.clone()).prop_map(|size| Shape::Box { size }),
        (length.clone(), length.clone())
            .prop_map(|(radius, length)| Shape::Cylinder { radius, length }),
        length.prop_map(|radius| Shape::Sphere { radius }),
    ]
}

fn any_kind() -> impl Strategy<Value = JointKind> {
    prop::sample::select(vec![
        JointKind::Fixed,
        JointKind::Revolute,
        JointKind::Continuous,
        JointKind::Prismatic,
    ])
}

prop_compose! {
    /// A joint whose parent is chosen among the links before its child.
    fn any_joint()(
        kind in any_kind(), parent in any::<prop::sample::Index>(), origin in any_pose(),
        axis in prop::array::uniform3(-1.0..1.0f64), lower in -3.0..0.0f64, upper in 0.0..3.0f64,
        velocity in prop::option::of(0.1..9.0f64), friction in 0.0..9.0f64,
    ) -> (prop::sample::Index, Joint) {
        let limits = match kind {
            JointKind::Fixed => [0.0, 0.0],
            JointKind::Continuous => [f64::NEG_INFINITY, f64::INFINITY],
            _ => [lower, upper],
        };
        let moves = kind != JointKind::Fixed;
        let axis = Unit::try_new(Vector3::from(axis), 1e-3).unwrap_or(Vector3::z_axis());
        (parent, Joint {
            name: String::new(), kind, parent: 0, child: 0, parent_from_joint: origin, axis, limits,
            velocity_limit: velocity.filter(|_| moves), effort_limit: None, damping: 0.0,
            friction: if moves { friction } else { 0.0 }, mimic: None,
        })
    }
}

prop_compose! {
    fn any_tree()(
        joints in prop::collection::vec(any_joint(), 0..8),
        parts in prop::collection::vec((any_pose(), any_shape()), 9),
    ) -> KinematicTree {
        let links = (0..=joints.len()).map(|i| Link {
            name: format!("link <{i}> & \"co\""),
            visuals: vec![Part {
                name: format!("part {i}"), link_from_part: parts[i].0, shape: parts[i].1.clone(), material: None,
            }],
            ..Link::default()
        }).collect();
        let joints = joints.into_iter().enumerate().map(|(i, (parent, joint))| Joint {
            name: format!("joint {i}"), parent: parent.index(i + 1), child: i + 1, ..joint
        }).collect();
        KinematicTree::new("tree".into(), links, joints).unwrap()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_tree_survives(tree in any_tree()) {
        assert_same(&tree, &reread(&tree));
    }

    /// Every point of a tree scaled by s, with lengths in q scaled too, is s times as far away.
    #[test]
    fn scaling_scales_positions(tree in any_tree(), factor in 0.1..4.0f64, t in 0.0..1.0f64) {
        let scaled = tree.scaled(factor);
        let q: Vec<f64> = tree.dof_joints().iter().map(|&j| {
            let [low, high] = tree.joints()[j].limits.map(|l| l.clamp(-3.0, 3.0));
            low + t * (high - low)
        }).collect();
        let scaled_q: Vec<f64> = tree.dof_joints().iter().zip(&q).map(|(&j, &q)| {
            if tree.joints()[j].kind == JointKind::Prismatic { q * factor } else { q }
        }).collect();
        let poses = tree.link_poses(&Pose::identity(), &q);
        let scaled_poses = scaled.link_poses(&Pose::identity(), &scaled_q);
        for (pose, scaled) in poses.iter().zip(&scaled_poses) {
            prop_assert!((pose.translation.vector * factor - scaled.translation.vector).norm() < 1e-9);
            prop_assert!(pose.rotation.angle_to(&scaled.rotation) < 1e-6);
        }
    }
}

#[test]
fn mimics_and_inertials_survive() {
    let files = common::Files::new();
    files.edit("bot.urdf", "</robot>", r#"<link name="other"><inertial><origin xyz="1 0 0"/><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><link name="third"/>
<joint name="third" type="prismatic"><parent link="hand"/><child link="third"/><limit lower="-1" upper="1"/>
<mimic joint="grip2" multiplier="2" offset="0.5"/></joint>
<joint name="grip2" type="prismatic"><parent link="hand"/><child link="other"/><limit lower="-1" upper="1"/>
<mimic joint="grip" multiplier="-1" offset="0.25"/></joint></robot>"#);
    let (tree, _) = files.urdf("bot.urdf").unwrap();
    // 2 (-q + 0.25) + 0.5 = -2 q + 1
    let third = tree.joint_index("third").unwrap();
    let mimic = tree.joints()[third].mimic.as_ref().unwrap();
    assert_eq!((mimic.multiplier, mimic.offset), (-2.0, 1.0));
    assert_eq!(mimic.joint, tree.joint_index("grip").unwrap());
    let again = reread(&tree);
    assert_same(&tree, &again);
    let inertial =
        |tree: &KinematicTree| tree.links()[tree.link_index("other").unwrap()].inertial.clone();
    assert_eq!(inertial(&tree), inertial(&again));
}
