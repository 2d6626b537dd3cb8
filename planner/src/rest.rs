//! A resting configuration for a robot that nobody has given one.

use akrobat_model::{JointKind, Pose, Robot};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::collision;
use crate::mask::{Bounded, configurations, touches};
use crate::spheres::SphereModel;

/// Configurations that are tried.
const SAMPLES: usize = 6000;
/// The hand rests this fraction of the arm's reach in front of the shoulder.
const FORWARD: f64 = 0.4;
/// Lowest that anything above the base may be, metres.
const FLOOR_CLEARANCE_M: f64 = 0.05;

/// Positions of the arm's joints (rad, m) in which no links touch and the hand is held in front of the
/// shoulder, pointing forward; `None` where no sampled configuration is free. The same seed gives the same.
pub fn find(robot: &Robot, spheres: &SphereModel, seed: u64) -> Option<Vec<f64>> {
    let bounded = Bounded::of_robot(robot, spheres);
    let pairs = collision::comparable_pairs(robot, spheres);
    let shoulder = robot.tree.joints()[*robot.arm_joints.first()?].child;
    let candidates = configurations(robot, SAMPLES, seed);
    let reach = reach(robot, &candidates, shoulder);
    let cost = |q: &Vec<f64>| {
        let poses = robot.tree.link_poses(&Pose::identity(), q);
        let arm = |l: &usize| {
            robot.tree.chain_to(*l).iter().any(|j| robot.arm_joints.contains(j)) && *l != shoulder
        };
        let is_low = |l: usize| bounded[l].lowest(&poses[l]) < FLOOR_CLEARANCE_M;
        let stands = poses[shoulder].translation.z > FLOOR_CLEARANCE_M;
        if stands && (0..poses.len()).filter(arm).any(is_low) {
            return None;
        }
        let touch =
            |&(a, b): &(usize, usize)| touches(&bounded[a], &bounded[b], &poses[a], &poses[b]);
        if pairs.iter().any(touch) {
            return None;
        }
        let tool = poses[robot.tool_link] * robot.link_from_tool;
        let forward = (tool.rotation * Vector3::z()).x;
        let wanted = poses[shoulder].translation.vector + Vector3::new(FORWARD * reach, 0.0, 0.0);
        let away = (tool.translation.vector - wanted).norm() / reach;
        Some((1.0 - forward) + 2.0 * away + off_middle(robot, q))
    };
    let costs: Vec<Option<f64>> = candidates.par_iter().map(cost).collect();
    let best = (0..candidates.len())
        .filter_map(|index| costs[index].map(|cost| (cost, index)))
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    let position = |&joint: &usize| {
        let value = robot.tree.joint_position(joint, &candidates[best.1]);
        let [low, high] = robot.tree.joints()[joint].limits;
        ((value * 1e3).round() / 1e3).clamp(low, high)
    };
    Some(robot.arm_joints.iter().map(position).collect())
}

/// How far the tool gets from the shoulder, metres.
fn reach(robot: &Robot, candidates: &[Vec<f64>], shoulder: usize) -> f64 {
    let distance = |q: &Vec<f64>| {
        let poses = robot.tree.link_poses(&Pose::identity(), q);
        let tool = poses[robot.tool_link] * robot.link_from_tool * Point3::origin();
        (tool.coords - poses[shoulder].translation.vector).norm()
    };
    candidates.iter().take(500).map(distance).fold(0.1, f64::max)
}

/// Mean distance of the arm's joints from the middle of their ranges, as a fraction of these: turning
/// joints count from zero where they may turn more than once.
fn off_middle(robot: &Robot, q: &[f64]) -> f64 {
    let off = |&joint: &usize| {
        let [low, high] = robot.tree.joints()[joint].limits;
        let half = (high - low) / 2.0;
        let value = robot.tree.joint_position(joint, q);
        // Lifting joints rest low, where the robot stands firmest.
        let lifts = robot.tree.joints()[joint].kind == JointKind::Prismatic;
        let rests = if lifts { low + 0.3 * half } else { (low + high) / 2.0 };
        ((value - rests) / half.max(1e-6)).abs()
    };
    robot.arm_joints.iter().map(off).sum::<f64>() / robot.arm_joints.len().max(1) as f64
}
