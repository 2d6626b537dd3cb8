//! Trajectory optimisation on the constraint manifold.
//!
//! Minimises `sum |W_v dx|^2 + sum |W_a d(dx)|^2` plus hinge penalties for clearance and joint limits,
//! subject to the AKR's chain constraint at every waypoint. Gauss-Newton steps are taken in the null
//! space of the constraint's Jacobian (a reduced-space SQP; Nocedal and Wright, *Numerical
//! Optimization*, 2006, section 18.3), so that the linear system is small and block-banded, and every
//! iterate is projected back onto the manifold: the anchor is held exactly throughout.

use nalgebra::SVector;

use crate::closure::Closure;
use crate::collision::{MovingCheck, Penalty, RobotBody};
use crate::config::PlannerConfig;
use crate::kinematics::{Kinematics, MAX_VARIABLES};
use crate::reduced::{Banded, Basis, Column, MAX_ROWS, add_scaled, dot};
use crate::world::World;

/// Waypoints, each a configuration of the AKR.
pub type Waypoints = Vec<Vec<f64>>;

/// Weights of squared clearance hinges (per square metre), one round of optimisation each: the next round
/// is for paths that are still too close to something.
pub(crate) const CLEARANCE_WEIGHTS: [f64; 3] = [4e3, 4e4, 4e5];
/// A path that begins this deep in something is not tried, and one that is left this deep after a round is given up,
/// metres. In a narrow kitchen and a closet, 6 of 391 and 2 of 444 such paths came to be free.
pub(crate) const HOPELESS_START_M: f64 = 0.2;
pub(crate) const HOPELESS_M: f64 = 0.03;
/// A step that lowers the cost by less than this share is the last of its round.
pub(crate) const LEAST_GAIN: f64 = 1e-3;
/// Waypoints from one look at the clearance of a followed path to the next.
const FOLLOW_CHECK_STEPS: usize = 4;
/// Weight of squared limit hinges (per square radian).
pub(crate) const LIMIT_WEIGHT: f64 = 100.0;
/// Longest step of a variable in one iteration, rad or m.
pub(crate) const LONGEST_STEP: f64 = 0.4;
/// Distance from a joint limit at which its hinge begins, rad or m.
pub(crate) const LIMIT_MARGIN: f64 = 0.03;

/// One problem: the same for all pairs of a grasp.
pub struct Problem<'a> {
    /// The compiled AKR; its last variable is the object's joint.
    pub kinematics: &'a Kinematics,
    /// The chain constraint.
    pub closure: &'a Closure,
    /// Robot spheres on it.
    pub body: &'a RobotBody,
    /// Distance fields.
    pub world: &'a World,
    /// Settings.
    pub config: &'a PlannerConfig,
    /// Squared weights of steps, per variable.
    pub velocity_weights: Vec<f64>,
    /// Squared weights of second differences, per variable.
    pub acceleration_weights: Vec<f64>,
    /// Share of each variable in projections.
    pub mobility: Vec<f64>,
}

impl Problem<'_> {
    /// Weights of a robot with `base` base variables from the settings' four classes.
    pub fn weights(classes: [f64; 4], base: usize, dof: usize) -> Vec<f64> {
        (0..dof)
            .map(|i| match i {
                _ if i + 1 == dof => classes[3],
                _ if i < base.min(2) => classes[0],
                2 if base == 3 => classes[1],
                _ => classes[2],
            })
            .collect()
    }

    /// Waypoints from a start to a goal configuration, with the object's joint following a smooth profile: straight in the
    /// variables and projected onto the constraint, or else between the ways that both ends take when the joint is
    /// merely followed. `None` where projections fail.
    pub fn straight(&self, start: &[f64], goal: &[f64]) -> Option<Waypoints> {
        self.along_line(start, goal).or_else(|| self.between_ways(start, goal))
    }

    /// Waypoints that pass from the start's way along the joint to the goal's: both are on the constraint at the same joint
    /// position, and mostly nearer to each other than to the straight line.
    fn between_ways(&self, start: &[f64], goal: &[f64]) -> Option<Waypoints> {
        let (object, last) = (start.len() - 1, self.config.waypoints - 1);
        let share = |step: usize| smooth(step as f64 / last as f64);
        let positions = (1..last).map(|step| {
            let s = share(step);
            start[object] + (goal[object] - start[object]) * s
        });
        let way = |from: &[f64], positions: &mut dyn Iterator<Item = f64>| {
            let mut x = from.to_vec();
            let project = |q: f64| {
                x[object] = q;
                let held = self.closure.project(self.kinematics, &mut x, &self.mobility, true);
                held.then(|| x.clone())
            };
            positions.map(project).collect::<Option<Waypoints>>()
        };
        let from_start = way(start, &mut positions.clone())?;
        let from_goal = way(goal, &mut positions.rev())?;
        let mut path = vec![start.to_vec()];
        for (step, (a, b)) in (1..).zip(from_start.iter().zip(from_goal.iter().rev())) {
            let mut x: Vec<f64> = a.iter().zip(b).map(|(a, b)| a + (b - a) * share(step)).collect();
            self.closure.project(self.kinematics, &mut x, &self.mobility, true).then_some(())?;
            path.push(x);
        }
        path.push(goal.to_vec());
        Some(path)
    }

    /// Waypoints straight in the variables, each projected onto the constraint.
    fn along_line(&self, start: &[f64], goal: &[f64]) -> Option<Waypoints> {
        let last = self.config.waypoints - 1;
        let mut path = vec![start.to_vec()];
        for step in 1..=last {
            let s = smooth(step as f64 / last as f64);
            let mut x: Vec<f64> = start.iter().zip(goal).map(|(a, b)| a + (b - a) * s).collect();
            // Half of the last correction is carried on: neighbours then settle on the same branch.
            let straight_before = smooth((step - 1) as f64 / last as f64);
            if step < last {
                let before = &path[step - 1];
                for (i, value) in x.iter_mut().enumerate().take(start.len() - 1) {
                    let line = start[i] + (goal[i] - start[i]) * straight_before;
                    *value += 0.9 * (before[i] - line);
                }
            }
            self.closure.project(self.kinematics, &mut x, &self.mobility, true).then_some(())?;
            path.push(x);
        }
        Some(path)
    }

    /// Follows the object's joint from a start configuration to `goal_q` by projection alone: the end
    /// that is reached most naturally from this start.
    pub fn follow(&self, start: &[f64], goal_q: f64) -> Option<Vec<f64>> {
        self.follow_each(start, goal_q, |_, _| ())
    }

    fn follow_each(
        &self,
        start: &[f64],
        goal_q: f64,
        mut look: impl FnMut(usize, &[f64]),
    ) -> Option<Vec<f64>> {
        let object = start.len() - 1;
        let last = self.config.waypoints - 1;
        let mut x = start.to_vec();
        for step in 1..=last {
            x[object] = start[object] + (goal_q - start[object]) * step as f64 / last as f64;
            self.closure.project(self.kinematics, &mut x, &self.mobility, true).then_some(())?;
            look(step, &x);
        }
        Some(x)
    }

    /// Optimises in place: the first waypoint stays, the last keeps the object's joint. What there is no hope
    /// for is left as it is. Memory is asked for before the first iteration alone.
    pub fn optimise(&self, path: &mut Waypoints) {
        let spare = self.config.clearance_m - self.config.min_clearance_m;
        let deepest = path.iter().map(|x| self.waypoint_terms(x, 1.0).largest).fold(0.0, f64::max);
        if deepest > HOPELESS_START_M {
            return;
        }
        let mut memory = Memory::new(path, self.kinematics.dof());
        for weight in CLEARANCE_WEIGHTS {
            let left = self.round(path, weight, &mut memory);
            if left < 0.8 * spare || left > HOPELESS_M {
                break;
            }
        }
    }

    /// Follows the object's joint as [`Self::follow`] does, and tells the smallest clearance at every
    /// few waypoints of the way, metres: what this way would have to be pushed out of.
    pub fn follow_with_clearance(&self, start: &[f64], goal_q: f64) -> Option<(Vec<f64>, f64)> {
        let mut worst = f64::INFINITY;
        let end = self.follow_each(start, goal_q, |step, x| {
            if step % FOLLOW_CHECK_STEPS == 0 {
                let frames = self.kinematics.forward(x);
                let (q, moving) = (x[x.len() - 1], MovingCheck::NotTool);
                let found = self.body.clearance(&frames, self.world, q, moving, f64::NEG_INFINITY);
                worst = worst.min(found.distance_m);
            }
        })?;
        Some((end, worst))
    }

    /// What a path costs with the weight of the first round, and its largest clearance hinge, metres.
    pub fn cost(&self, path: &Waypoints) -> (f64, f64) {
        let mut terms = Vec::new();
        self.terms(path, CLEARANCE_WEIGHTS[0], &mut terms);
        (self.total(path, &terms), terms.iter().map(|t| t.largest).fold(0.0, f64::max))
    }

    /// Brings every waypoint but the first onto the constraint, with the object's joint held. False where one does not
    /// get there.
    pub fn settle(&self, path: &mut Waypoints) -> bool {
        path.iter_mut()
            .skip(1)
            .all(|x| self.closure.project(self.kinematics, x, &self.mobility, true))
    }

    /// One round with a fixed clearance weight. Returns the largest clearance hinge that is left, metres.
    fn round(&self, path: &mut Waypoints, weight: f64, memory: &mut Memory) -> f64 {
        let mut damping = 1e-3;
        self.terms(path, weight, &mut memory.terms);
        let mut cost = self.total(path, &memory.terms);
        for _ in 0..self.config.iterations {
            if self.step(path, damping, memory).is_none() {
                break;
            }
            memory.trial.iter_mut().zip(&*path).for_each(|(to, from)| to.copy_from_slice(from));
            let projected = self.apply(&mut memory.trial, &memory.steps);
            self.terms(&memory.trial, weight, &mut memory.trial_terms);
            let trial_cost = self.total(&memory.trial, &memory.trial_terms);
            if projected && trial_cost < cost {
                let gain = (cost - trial_cost) / cost.max(1e-12);
                std::mem::swap(path, &mut memory.trial);
                std::mem::swap(&mut memory.terms, &mut memory.trial_terms);
                cost = trial_cost;
                damping = (damping * 0.3).max(1e-6);
                if gain < LEAST_GAIN {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e4 {
                    break;
                }
            }
        }
        memory.terms.iter().map(|t| t.largest).fold(0.0, f64::max)
    }

    fn apply(&self, path: &mut Waypoints, steps: &[Column]) -> bool {
        let last = path.len() - 1;
        let mut held = true;
        for (t, x) in path.iter_mut().enumerate().skip(1) {
            for (value, step) in x.iter_mut().zip(&steps[t]) {
                *value += step.clamp(-LONGEST_STEP, LONGEST_STEP);
            }
            self.kinematics.clamp(x);
            held &= self.closure.project(self.kinematics, x, &self.mobility, t == last);
        }
        held
    }

    /// Clearance and limit penalties of every waypoint.
    fn terms(&self, path: &Waypoints, weight: f64, terms: &mut Vec<Penalty>) {
        terms.clear();
        terms.extend(path.iter().map(|x| self.waypoint_terms(x, weight)));
    }

    pub(crate) fn waypoint_terms(&self, x: &[f64], weight: f64) -> Penalty {
        let mut penalty = Penalty::zero();
        let frames = self.kinematics.forward(x);
        let object = x.len() - 1;
        let margin = self.config.clearance_m;
        self.body.penalty(self.kinematics, &frames, self.world, x, object, margin, &mut penalty);
        penalty.cost *= weight;
        penalty.gradient *= weight;
        penalty.hessian *= weight;
        let mut limits = Penalty::zero();
        for i in 0..object {
            let low = self.kinematics.lower()[i] + LIMIT_MARGIN - x[i];
            let high = x[i] - (self.kinematics.upper()[i] - LIMIT_MARGIN);
            for (hinge, sign) in [(low, -1.0), (high, 1.0)] {
                if hinge > 0.0 {
                    let mut row = SVector::zeros();
                    row[i] = sign;
                    limits.add(hinge, &row);
                }
            }
        }
        penalty.cost += LIMIT_WEIGHT * limits.cost;
        penalty.gradient += limits.gradient * LIMIT_WEIGHT;
        penalty.hessian += limits.hessian * LIMIT_WEIGHT;
        penalty
    }

    fn total(&self, path: &Waypoints, terms: &[Penalty]) -> f64 {
        self.smoothness(path) + terms.iter().map(|t| t.cost).sum::<f64>()
    }

    /// The objective without penalties.
    pub(crate) fn smoothness(&self, path: &Waypoints) -> f64 {
        let last = path.len() - 1;
        (0..self.kinematics.dof())
            .map(|i| {
                let steps: f64 = path.windows(2).map(|w| (w[1][i] - w[0][i]).powi(2)).sum();
                // Rest before the first and after the last waypoint.
                let bend = |t: usize| {
                    path[(t + 1).min(last)][i] - 2.0 * path[t][i] + path[t.saturating_sub(1)][i]
                };
                let bends: f64 = (0..=last).map(|t| bend(t).powi(2)).sum();
                self.velocity_weights[i] * steps + self.acceleration_weights[i] * bends
            })
            .sum()
    }

    /// Half the derivative of [`Self::smoothness`] with respect to a variable of a waypoint that is neither the first
    /// nor the last.
    pub(crate) fn smoothness_slope(&self, path: &Waypoints, waypoint: usize, i: usize) -> f64 {
        let last = path.len() as isize - 1;
        let at = |t: isize| path[t.clamp(0, last) as usize][i];
        let t = waypoint as isize;
        let bend = |t: isize| at(t + 1) - 2.0 * at(t) + at(t - 1);
        let velocity = 2.0 * at(t) - at(t - 1) - at(t + 1);
        let acceleration = bend(t - 1) - 2.0 * bend(t) + bend(t + 1);
        self.velocity_weights[i] * velocity + self.acceleration_weights[i] * acceleration
    }

    /// A Gauss-Newton step in the null space of the constraints of waypoints 1..T, into `memory.steps`.
    fn step(&self, path: &Waypoints, damping: f64, memory: &mut Memory) -> Option<()> {
        let (count, dof) = (path.len(), self.kinematics.dof());
        let Memory { terms, bases, offsets, system, steps, stencil, .. } = memory;
        let (mut size, mut widest) = (0, 0);
        for t in 1..count {
            bases[t] = self.null_space(&path[t], t + 1 == count);
            offsets[t] = size;
            size += bases[t].columns().len();
            widest = bases[t].columns().len().max(widest);
        }
        system.reset(size, 3 * widest);
        for t in 1..count {
            let mut gradient: Column = [0.0; MAX_VARIABLES];
            gradient[..dof].copy_from_slice(&terms[t].gradient.as_slice()[..dof]);
            for other in t.saturating_sub(2)..count.min(t + 3) {
                for i in 0..dof {
                    gradient[i] += stencil.weight(self, t, other, i) * path[other][i];
                }
            }
            for (row, column) in (offsets[t]..).zip(bases[t].columns()) {
                system.right[row] = -dot(column, &gradient);
            }
            for s in t..count.min(t + 3) {
                let diagonal: Column = std::array::from_fn(|i| {
                    let smooth = if i < dof { stencil.weight(self, t, s, i) } else { return 0.0 };
                    let weights = self.velocity_weights[i] + self.acceleration_weights[i];
                    smooth + if s == t { damping * weights } else { 0.0 }
                });
                for (column, own) in (offsets[t]..).zip(bases[t].columns()) {
                    let mut product: Column = std::array::from_fn(|i| diagonal[i] * own[i]);
                    if s == t {
                        for i in 0..dof {
                            add_scaled(&mut product, own[i], &terms[t].hessian.data.0[i]);
                        }
                    }
                    for (row, other) in (offsets[s]..).zip(bases[s].columns()) {
                        if row >= column {
                            system.add(row, column, dot(other, &product));
                        }
                    }
                }
            }
        }
        system.solve()?;
        for t in 1..count {
            steps[t] = [0.0; MAX_VARIABLES];
            for (row, column) in (offsets[t]..).zip(bases[t].columns()) {
                add_scaled(&mut steps[t], system.right[row], column);
            }
        }
        Some(())
    }

    /// Orthonormal basis of the directions that keep the constraint to first order.
    fn null_space(&self, x: &[f64], hold_object: bool) -> Basis {
        let dof = x.len();
        let frames = self.kinematics.forward(x);
        let jacobian = self.closure.linearise(self.kinematics, &frames).jacobian;
        let mut rows = [[0.0; MAX_VARIABLES]; MAX_ROWS];
        for (row, values) in rows.iter_mut().zip(jacobian.row_iter()) {
            row[..dof].iter_mut().zip(values.iter()).for_each(|(to, from)| *to = *from);
        }
        rows[MAX_ROWS - 1][dof - 1] = 1.0;
        let count = if hold_object { MAX_ROWS } else { MAX_ROWS - 1 };
        Basis::of_complement(&mut rows[..count], dof)
    }
}

/// What iterations write to.
struct Memory {
    trial: Waypoints,
    terms: Vec<Penalty>,
    trial_terms: Vec<Penalty>,
    bases: Vec<Basis>,
    /// First row of each waypoint in the system.
    offsets: Vec<usize>,
    system: Banded,
    steps: Vec<Column>,
    stencil: Stencil,
}

impl Memory {
    /// Room for a path and the largest system that it can give.
    fn new(path: &Waypoints, dof: usize) -> Self {
        let count = path.len();
        let mut system = Banded::default();
        system.reserve(count * dof, 3 * dof);
        Self {
            trial: path.clone(),
            terms: Vec::with_capacity(count),
            trial_terms: Vec::with_capacity(count),
            bases: vec![Basis::EMPTY; count],
            offsets: vec![0; count],
            system,
            steps: vec![[0.0; MAX_VARIABLES]; count],
            stencil: Stencil::new(count),
        }
    }
}

/// Smooth profile from 0 to 1 with zero speed and acceleration at the ends (quintic).
pub fn smooth(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// Second derivatives of the smoothness terms between waypoints.
struct Stencil {
    velocity: Vec<[f64; 3]>,
    acceleration: Vec<[f64; 3]>,
}

impl Stencil {
    fn new(count: usize) -> Self {
        let n = count as isize;
        let mut velocity = vec![[0.0; 3]; count];
        let mut acceleration = vec![[0.0; 3]; count];
        let add = |table: &mut Vec<[f64; 3]>, terms: &[(isize, f64)]| {
            for &(a, wa) in terms {
                for &(b, wb) in terms {
                    let (a, b) = (a.clamp(0, n - 1), b.clamp(0, n - 1));
                    if b >= a {
                        table[a as usize][(b - a) as usize] += wa * wb;
                    }
                }
            }
        };
        for t in 0..n - 1 {
            add(&mut velocity, &[(t, -1.0), (t + 1, 1.0)]);
        }
        for t in 0..n {
            // At the ends two of the three coincide: the path is at rest before and after.
            let mut terms = [(t - 1, 1.0), (t, -2.0), (t + 1, 1.0)];
            terms.iter_mut().for_each(|(at, _)| *at = (*at).clamp(0, n - 1));
            add(&mut acceleration, &merged(&terms));
        }
        Self { velocity, acceleration }
    }

    fn weight(&self, problem: &Problem<'_>, t: usize, s: usize, variable: usize) -> f64 {
        let (first, gap) = (t.min(s), t.abs_diff(s));
        if gap > 2 {
            return 0.0;
        }
        problem.velocity_weights[variable] * self.velocity[first][gap]
            + problem.acceleration_weights[variable] * self.acceleration[first][gap]
    }
}

fn merged(terms: &[(isize, f64)]) -> Vec<(isize, f64)> {
    let mut out: Vec<(isize, f64)> = Vec::new();
    for &(at, weight) in terms {
        match out.iter_mut().find(|(other, _)| *other == at) {
            Some((_, sum)) => *sum += weight,
            None => out.push((at, weight)),
        }
    }
    out
}
