//! Which starts are connected with which goals.

use std::collections::BTreeSet;
use std::ops::Range;

use rayon::prelude::*;

use super::{Hold, Pair, Promise, Run, Starts};
use crate::config::PlannerConfig;
use crate::trajopt::Problem;
use crate::world::World;

/// Clearances of a followed path from which optimisation nearly always finds a free one, and about every second
/// time, metres. With less it is one of ten.
const GOOD_M: f64 = -0.02;
const FAIR_M: f64 = -0.12;
/// Goal configurations that each start is paired with, for each position of the joint.
const NEAREST_GOALS: usize = 3;

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

    /// Starts with the ends that following the joint leads to: those whose way is nearly free come first, and
    /// grasps, starts and goals take turns.
    pub(super) fn followed_pairs(
        &mut self,
        world: &World,
        holds: &[Hold],
        which: Starts,
    ) -> Vec<Pair> {
        self.stage("pairing", |run| run.follow_all(world, holds, which))
    }

    fn follow_all(&self, world: &World, holds: &[Hold], which: Starts) -> Vec<Pair> {
        let starts = |hold: &Hold| hold.starts(which);
        let mut pairs = self.of_each_start(holds, starts, |hold, start, goal_index| {
            let problem = self.problem(world, hold, self.config);
            let q = self.task.file.goal.positions[goal_index];
            let followed = problem.follow_with_clearance(start, q).into_iter();
            followed.map(|(end, clearance)| (end, promise(clearance))).collect()
        });
        self.in_turn(&mut pairs);
        pairs
    }

    /// Starts with the nearest of the goal configurations, in the same order; `followed` counts towards the number of
    /// pairs that a grasp may have.
    pub(super) fn goal_pairs(&self, holds: &[Hold], followed: &[Pair]) -> Vec<Pair> {
        let yaw = (self.base() == 3).then_some(2);
        let starts = |hold: &Hold| hold.starts(Starts::Clustered);
        let mut pairs = self.of_each_start(holds, starts, |hold, start, goal_index| {
            let mut ends: Vec<&Vec<f64>> = hold.goals[goal_index].iter().collect();
            let turn = |g: &Vec<f64>, y: usize| (g[y] - start[y]).abs();
            ends.retain(|g| yaw.is_none_or(|y| turn(g, y) <= self.config.max_base_yaw_rad));
            let distance =
                |g: &Vec<f64>| -> f64 { g.iter().zip(start).map(|(a, b)| (a - b) * (a - b)).sum() };
            ends.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
            ends.into_iter().take(NEAREST_GOALS).map(|end| (end.clone(), Promise::Good)).collect()
        });
        pairs.iter_mut().for_each(|pair| pair.rank += 1);
        self.in_turn(&mut pairs);
        let mut per_hold = vec![0usize; holds.len()];
        followed.iter().for_each(|pair| per_hold[pair.hold] += 1);
        let most = self.config.pairs_per_grasp * self.task.file.goal.positions.len();
        pairs.retain(|pair| {
            per_hold[pair.hold] += 1;
            per_hold[pair.hold] <= most
        });
        pairs
    }

    /// The pairs of every one of the `starts` and goal position; `ends` gives configurations in the order of their rank, and
    /// how likely the way there is to become free.
    fn of_each_start(
        &self,
        holds: &[Hold],
        starts: impl Fn(&Hold) -> Range<usize>,
        ends: impl Fn(&Hold, &[f64], usize) -> Vec<(Vec<f64>, Promise)> + Sync,
    ) -> Vec<Pair> {
        let starts: Vec<(usize, usize)> = holds
            .iter()
            .enumerate()
            .flat_map(|(hold, h)| starts(h).map(move |start| (hold, start)))
            .collect();
        let of_start = |&(hold, start): &(usize, usize)| {
            let mut own = Vec::new();
            for goal_index in 0..self.task.file.goal.positions.len() {
                let ends = ends(&holds[hold], &holds[hold].starts[start], goal_index);
                own.extend(ends.into_iter().enumerate().map(|(rank, (goal, promise))| Pair {
                    hold,
                    start,
                    goal_index,
                    goal,
                    rank,
                    promise,
                }));
            }
            own
        };
        starts.par_iter().flat_map_iter(of_start).collect()
    }

    /// Orders pairs: what is likely to succeed first, and grasps, starts and goals in turn.
    pub(super) fn in_turn(&self, pairs: &mut [Pair]) {
        let goals = self.task.file.goal.positions.len();
        let turn = |p: &Pair| (p.goal_index + goals - p.start % goals) % goals;
        pairs.sort_by_key(|p| (p.promise, p.rank, turn(p), p.start, p.hold));
    }
}

fn promise(clearance_m: f64) -> Promise {
    match clearance_m {
        good if good > GOOD_M => Promise::Good,
        fair if fair > FAIR_M => Promise::Fair,
        _ => Promise::Poor,
    }
}

/// Number of starts from which some way is nearly free.
pub(super) fn promising_starts(pairs: &[Pair]) -> usize {
    let good = pairs.iter().filter(|pair| pair.promise == Promise::Good);
    good.map(|pair| (pair.hold, pair.start)).collect::<BTreeSet<_>>().len()
}

/// Takes out of `pairs` the first of each start that is not among `reached`; all, where there is none.
pub(super) fn next_round(pairs: &mut Vec<Pair>, reached: &BTreeSet<(usize, usize)>) -> Vec<Pair> {
    let mut taken = reached.clone();
    let (round, rest) =
        pairs.drain(..).partition(|pair: &Pair| taken.insert((pair.hold, pair.start)));
    *pairs = rest;
    if round.is_empty() { std::mem::take(pairs) } else { round }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(start: usize, goal_index: usize) -> Pair {
        Pair { hold: 0, start, goal_index, goal: Vec::new(), rank: 0, promise: Promise::Good }
    }

    #[test]
    fn every_start_comes_before_any_comes_again() {
        let mut pairs: Vec<Pair> =
            [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1)].map(|(s, g)| pair(s, g)).into();
        let mut reached = BTreeSet::new();
        let keys =
            |pairs: &[Pair]| -> Vec<_> { pairs.iter().map(|p| (p.start, p.goal_index)).collect() };
        assert_eq!(keys(&next_round(&mut pairs, &reached)), [(0, 0), (1, 0), (2, 0)]);
        reached.insert((0, 0));
        assert_eq!(keys(&next_round(&mut pairs, &reached)), [(1, 1)], "start 0 is done");
        assert_eq!(keys(&next_round(&mut pairs, &reached)), [(0, 1)], "then its others");
        assert!(next_round(&mut pairs, &reached).is_empty());
    }
}
