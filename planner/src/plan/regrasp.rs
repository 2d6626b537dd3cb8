//! Changes of grasp: where one grasp cannot follow the joint to its goal, another takes over on the way.
//!
//! Each configuration that inverse kinematics has found, at the start, at the goal or between, is followed
//! along the joint as far as it goes. What is followed from it is an interval of the joint's travel; a chain
//! of overlapping intervals from start to goal is a plan, and the hand changes over inside the overlaps.

use std::sync::Arc;

use rayon::prelude::*;

use super::timeline::Leg;
use super::{Hold, Outcome, PlanError, Run, Starts, StepClock, stage_seed};
use crate::akr;
use crate::collision::MovingCheck;
use crate::config::PlannerConfig;
use crate::trajopt::Problem;
use crate::world::World;

/// Steps of the joint's travel from start to goal.
const STEPS: usize = 60;
/// Least steps of the travel that one grasp does.
const LEAST_STEPS: usize = 4;
/// How deep a configuration that is merely followed may collide: optimisation moves it away, metres.
const FOLLOWED_CLEARANCE_M: f64 = -0.02;
/// Chains tried for each goal, at most, and places inside an overlap where the hand changes over.
const MAX_CHAINS: usize = 192;
const PLACES: [f64; 3] = [0.5, 0.2, 0.8];

/// What one grasp can follow from one configuration.
#[derive(Debug)]
struct Stretch {
    /// Its grasp.
    hold: usize,
    /// Number of the start configuration, if it is one.
    start: Option<usize>,
    /// Step of the first configuration.
    first: usize,
    /// Configurations at consecutive steps, and whether each is free.
    path: Vec<(Vec<f64>, bool)>,
}

impl Stretch {
    fn last(&self) -> usize {
        self.first + self.path.len() - 1
    }

    fn at(&self, step: usize) -> &[f64] {
        &self.path[step - self.first].0
    }

    fn is_free(&self, step: usize) -> bool {
        self.path[step - self.first].1
    }

    /// Steps at which the hand may change over from this grasp to `next`, having taken hold at `from`.
    fn overlap(&self, next: &Self, from: usize) -> Vec<usize> {
        let low = next.first.max(from + LEAST_STEPS);
        let high = self.last().min(next.last() - LEAST_STEPS.min(next.last()));
        (low..=high).filter(|&step| self.is_free(step) && next.is_free(step)).collect()
    }
}

/// Grasps that take turns from the start to a goal.
pub(super) struct Chain {
    goal_index: usize,
    /// What each does, with the steps at which it takes hold and lets go.
    links: Vec<(Arc<Stretch>, usize, usize)>,
    /// Names it among the task's.
    key: String,
}

impl Run<'_> {
    /// Chains of grasps that reach the goals `goals`, as short as each goal allows.
    pub(super) fn chains(
        &mut self,
        world: &World,
        holds: &[Hold],
        goals: &[usize],
    ) -> Result<Vec<Chain>, PlanError> {
        let mut chains = Vec::new();
        for &goal_index in goals {
            let stretches = self.stretches(world, holds, goal_index)?;
            let farthest = stretches.iter().filter(|s| s.first == 0).map(|s| s.last()).max();
            self.note_farthest(goal_index, farthest.unwrap_or(0));
            let mut own = Vec::new();
            for count in 2..=self.task.file.goal.regrasps + 1 {
                for start in stretches.iter().filter(|s| s.start.is_some()) {
                    extend(&stretches, &mut vec![(Arc::clone(start), 0, 0)], count, &mut own);
                }
                if !own.is_empty() {
                    break;
                }
            }
            self.count("regrasp/chains", own.len());
            chains.extend(self.take_turns(own, goal_index).into_iter().enumerate());
        }
        // Goals take turns, so that none uses up what is wanted.
        chains.sort_by_key(|(turn, _)| *turn);
        Ok(chains.into_iter().map(|(_, chain)| chain).collect())
    }

    /// Counts how far the best single grasp follows, in thousandths of the way to the goal.
    fn note_farthest(&mut self, goal_index: usize, step: usize) {
        self.count(
            &format!("regrasp/one_grasp_reaches_permille/{goal_index}"),
            1000 * step / STEPS,
        );
    }

    /// Orders chains so that first grasps and last grasps take turns, and names them.
    fn take_turns(
        &self,
        own: Vec<Vec<(Arc<Stretch>, usize, usize)>>,
        goal_index: usize,
    ) -> Vec<Chain> {
        let mut used = std::collections::HashMap::<(usize, Option<usize>), usize>::new();
        let mut ranked: Vec<(usize, usize, Vec<_>)> = own
            .into_iter()
            .enumerate()
            .map(|(number, links)| {
                let (first, _, _) = &links[0];
                let turn = used.entry((first.hold, first.start)).or_default();
                *turn += 1;
                (*turn, number, links)
            })
            .collect();
        ranked.sort_by_key(|(turn, number, _)| (*turn, *number));
        ranked.truncate(MAX_CHAINS);
        let chain = |(_, number, links)| Chain {
            goal_index,
            links,
            key: format!("regrasp {goal_index} {number}"),
        };
        ranked.into_iter().map(chain).collect()
    }

    /// What can be followed from every configuration of every grasp.
    fn stretches(
        &mut self,
        world: &World,
        holds: &[Hold],
        goal_index: usize,
    ) -> Result<Vec<Arc<Stretch>>, PlanError> {
        let regrasps = self.task.file.goal.regrasps;
        let mut seeds: Vec<(usize, Option<usize>, usize, Vec<f64>)> = Vec::new();
        for (index, hold) in holds.iter().enumerate() {
            let starts = hold.starts(Starts::Clustered);
            seeds.extend(starts.map(|s| (index, Some(s), 0, hold.starts[s].clone())));
            seeds.extend(hold.goals[goal_index].iter().map(|x| (index, None, STEPS, x.clone())));
            for station in 1..regrasps {
                let step = STEPS * station / regrasps;
                let target = 256 * (goal_index + 1) + station;
                let akr = akr::assemble(&self.task.robot, &self.task.object, &hold.grasp)?;
                let q = self.position_at(goal_index, step);
                let found = self.configurations(world, &akr, hold, q, target)?;
                seeds.extend(found.into_iter().map(|x| (index, None, step, x)));
            }
        }
        let follow = |(hold, start, step, x): &(usize, Option<usize>, usize, Vec<f64>)| {
            let problem = self.problem(world, &holds[*hold], self.config);
            let forward = self.follow_free(&problem, goal_index, x, (*step..=STEPS).skip(1));
            let mut path = self.follow_free(&problem, goal_index, x, (0..*step).rev());
            let first = step - path.len();
            path.reverse();
            path.push((x.clone(), true));
            path.extend(forward);
            Arc::new(Stretch { hold: *hold, start: *start, first, path })
        };
        Ok(seeds.par_iter().map(follow).collect())
    }

    /// Position of the driven joint after some of [`STEPS`] steps to a goal.
    fn position_at(&self, goal_index: usize, step: usize) -> f64 {
        let goal = &self.task.file.goal;
        goal.start + (goal.positions[goal_index] - goal.start) * step as f64 / STEPS as f64
    }

    /// Configurations at `steps`, as far as the joint can be followed from `x`, each with whether it is free.
    fn follow_free(
        &self,
        problem: &Problem<'_>,
        goal_index: usize,
        x: &[f64],
        steps: impl Iterator<Item = usize>,
    ) -> Vec<(Vec<f64>, bool)> {
        let object = x.len() - 1;
        let mut at = x.to_vec();
        let mut path = Vec::new();
        for step in steps {
            at[object] = self.position_at(goal_index, step);
            let before = at.clone();
            if !problem.closure.project(problem.kinematics, &mut at, &problem.mobility, true) {
                break;
            }
            let jump = at.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let turned = self.base() == 3 && (at[2] - x[2]).abs() > self.config.max_base_yaw_rad;
            let frames = problem.kinematics.forward(&at);
            let clearance = problem
                .body
                .clearance(
                    &frames,
                    problem.world,
                    at[object],
                    MovingCheck::NotTool,
                    FOLLOWED_CLEARANCE_M,
                )
                .distance_m;
            if jump > 0.5 || turned || clearance < FOLLOWED_CLEARANCE_M {
                break;
            }
            path.push((at.clone(), clearance >= self.config.min_clearance_m));
        }
        path
    }

    /// Optimises a chain and has the result judged.
    pub(super) fn connect_chain(
        &self,
        world: &World,
        holds: &[Hold],
        chain: &Chain,
        judge: &super::JudgeFn<'_>,
        steps: &mut StepClock,
    ) -> Outcome {
        let seed = stage_seed(self.task, &chain.key, 0);
        let (first, _, _) = &chain.links[0];
        let approach = match (self.config.approach, first.start) {
            (true, Some(start)) => {
                match self.approach_to(world, &holds[first.hold], first.hold, start) {
                    Ok(approach) => Some(approach),
                    Err(reason) => return Outcome::Failed(reason, String::new()),
                }
            }
            _ => None,
        };
        let mut legs: Vec<Leg<'_>> = Vec::new();
        let shares = shares(self.config.waypoints, &chain.links);
        for ((stretch, from, to), waypoints) in chain.links.iter().zip(shares) {
            let hold = &holds[stretch.hold];
            let config = PlannerConfig { waypoints, ..self.config.clone() };
            let (start, end) = (stretch.at(*from), stretch.at(*to));
            let mut leg = match self.leg(world, hold, &config, start, end, steps) {
                Ok(leg) => leg,
                Err((reason, detail)) => return Outcome::Failed(reason, detail),
            };
            if let Some(before) = legs.last() {
                let left_at = before.samples.last().map_or(start, Vec::as_slice);
                leg.transfer = match self.transfer(world, left_at, start, seed) {
                    Ok(transfer) => Some(transfer),
                    Err(reason) => return Outcome::Failed(reason, String::new()),
                };
            }
            legs.push(leg);
        }
        if let Err(reason) = self.let_go(world, legs.last_mut()) {
            return Outcome::Failed(reason, String::new());
        }
        let goal = self.task.file.goal.positions[chain.goal_index];
        let trajectory = self.trajectory(&chain.key, seed, goal, legs, approach);
        let verdict = judge(&trajectory);
        steps.lap("judge");
        Outcome::Judged(Box::new(trajectory), verdict)
    }
}

/// Waypoints of each link, in proportion to its share of the way; all together `total`.
fn shares(total: usize, links: &[(Arc<Stretch>, usize, usize)]) -> Vec<usize> {
    let mut left = total;
    let mut steps: usize = links.iter().map(|(_, from, to)| to - from).sum();
    let share = |(index, (_, from, to)): (usize, &(Arc<Stretch>, usize, usize))| {
        let least = 2 * (links.len() - 1 - index);
        let own =
            (left * (to - from)).div_ceil(steps.max(1)).clamp(2, left.saturating_sub(least).max(2));
        left = left.saturating_sub(own);
        steps -= to - from;
        own
    };
    links.iter().enumerate().map(share).collect()
}

/// Appends to `found` the chains of `count` stretches that begin with `chain` and reach the goal. The first
/// place at which each change is possible decides how the overlap is used: see [`PLACES`].
fn extend(
    stretches: &[Arc<Stretch>],
    chain: &mut Vec<(Arc<Stretch>, usize, usize)>,
    count: usize,
    found: &mut Vec<Vec<(Arc<Stretch>, usize, usize)>>,
) {
    let Some((current, from, _)) = chain.last().cloned() else { return };
    for next in stretches {
        let completes = chain.len() + 1 == count;
        let goes_on = next.last() > current.last() && next.start.is_none();
        if !goes_on || completes != (next.last() == STEPS) {
            continue;
        }
        let overlap = current.overlap(next, from);
        if overlap.is_empty() {
            continue;
        }
        let place = PLACES[found.len() % PLACES.len()];
        let step = overlap[((overlap.len() - 1) as f64 * place).round() as usize];
        if let Some(last) = chain.last_mut() {
            last.2 = step;
        }
        chain.push((Arc::clone(next), step, STEPS));
        if completes {
            found.push(chain.clone());
        } else {
            extend(stretches, chain, count, found);
        }
        chain.pop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stretch(first: usize, last: usize, start: Option<usize>) -> Arc<Stretch> {
        let path = (first..=last).map(|step| (vec![step as f64], true)).collect();
        Arc::new(Stretch { hold: 0, start, first, path })
    }

    #[test]
    fn chains_join_what_overlaps() {
        let stretches =
            [stretch(0, 40, Some(0)), stretch(30, STEPS, None), stretch(45, STEPS, None)];
        let mut found = Vec::new();
        extend(&stretches, &mut vec![(Arc::clone(&stretches[0]), 0, 0)], 2, &mut found);
        assert_eq!(found.len(), 1, "only one of the two begins before the first has ended");
        let [(first, 0, change), (second, taken, STEPS)] = &found[0][..] else {
            panic!("{found:?}")
        };
        assert_eq!(change, taken);
        assert!((30..=40).contains(change));
        assert_eq!((first.first, second.first), (0, 30));
    }

    #[test]
    fn two_changes_where_one_does_not_suffice() {
        let stretches = [stretch(0, 20, Some(0)), stretch(15, 45, None), stretch(40, STEPS, None)];
        let begin = || vec![(Arc::clone(&stretches[0]), 0, 0)];
        let (mut two, mut three) = (Vec::new(), Vec::new());
        extend(&stretches, &mut begin(), 2, &mut two);
        extend(&stretches, &mut begin(), 3, &mut three);
        assert!(two.is_empty());
        assert_eq!(three.len(), 1);
        assert_eq!(shares(30, &three[0]).iter().sum::<usize>(), 30);
        assert!(shares(7, &three[0]).iter().all(|&n| n >= 2));
    }
}
