//! Which starts are connected with which goals.

use rayon::prelude::*;

use super::{Hold, Pair, Run};
use crate::config::PlannerConfig;
use crate::trajopt::Problem;
use crate::world::World;

/// Clearance of a followed path from which optimisation mostly finds a free one, metres; starts with less come after
/// all others.
const PROMISING_M: f64 = -0.02;
const UNPROMISING_RANK: usize = 100;

impl Run<'_> {
    pub(super) fn problem<'b>(
        &self,
        world: &'b World,
        hold: &'b Hold,
        config: &'b PlannerConfig,
    ) -> Problem<'b> {
        let dof = hold.kinematics.dof();
        Problem {
            kinematics: &hold.kinematics,
            closure: &hold.closure,
            body: &hold.body,
            world,
            config,
            velocity_weights: Problem::weights(self.config.velocity_weights, self.base(), dof),
            acceleration_weights: Problem::weights(
                self.config.acceleration_weights,
                self.base(),
                dof,
            ),
            mobility: vec![1.0; dof],
        }
    }

    /// Starts with goals: for each start the end that following the joint leads to, and the nearest of the
    /// goal configurations; ordered so that grasps, starts and goals take turns.
    pub(super) fn pairs(&mut self, world: &World, holds: &[Hold]) -> Vec<Pair> {
        let yaw = (self.base() == 3).then_some(2);
        let mut pairs: Vec<Pair> = holds
            .par_iter()
            .enumerate()
            .flat_map_iter(|(hold_index, hold)| {
                let problem = self.problem(world, hold, self.config);
                let mut own = Vec::new();
                for (start_index, start) in hold.starts.iter().enumerate() {
                    for (goal_index, goals) in hold.goals.iter().enumerate() {
                        let q = self.task.file.goal.positions[goal_index];
                        let followed = problem.follow_with_clearance(start, q);
                        let clear = followed
                            .as_ref()
                            .is_some_and(|(_, clearance)| *clearance > PROMISING_M);
                        let followed = followed.map(|(end, _)| end);
                        let mut ends: Vec<Vec<f64>> = goals.clone();
                        ends.retain(|g| {
                            yaw.is_none_or(|y| {
                                (g[y] - start[y]).abs() <= self.config.max_base_yaw_rad
                            })
                        });
                        let distance = |g: &Vec<f64>| -> f64 {
                            g.iter().zip(start).map(|(a, b)| (a - b) * (a - b)).sum()
                        };
                        ends.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
                        ends.truncate(3);
                        let ends = followed.into_iter().chain(ends);
                        own.extend(ends.enumerate().map(|(rank, goal)| Pair {
                            hold: hold_index,
                            start: start_index,
                            goal_index,
                            goal,
                            rank: if clear { rank } else { rank + UNPROMISING_RANK },
                        }));
                    }
                }
                own
            })
            .collect();
        // Each start gets one goal before any gets its second, and goals take turns.
        let goals = self.task.file.goal.positions.len();
        let turn = |p: &Pair| (p.goal_index + goals - p.start % goals) % goals;
        pairs.sort_by_key(|p| (p.rank, turn(p), p.start, p.hold));
        let mut per_hold = vec![0usize; holds.len()];
        let most = self.config.pairs_per_grasp * self.task.file.goal.positions.len();
        pairs.retain(|p| {
            per_hold[p.hold] += 1;
            per_hold[p.hold] <= most
        });
        pairs
    }
}
