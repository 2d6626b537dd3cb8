//! Inverse kinematics of eight seeds at once.
//!
//! Levenberg-Marquardt steps whose damping follows the squared error (Sugihara, *Solvability-Unconcerned Inverse
//! Kinematics by the Levenberg-Marquardt Method*, IEEE T-RO 27(5), 2011), so that no step has to be taken back and no
//! lane takes a branch. A lane that has converged or has had its iterations goes on with the next seed; what becomes
//! of a seed depends on nothing but the seed. Solutions are as good as single precision allows and are
//! polished by [`crate::ik::solve`].

use nalgebra::Vector3;

use super::chain::{CompiledJoint, Config, FrameRows, compile, load, place, turned};
use super::obstacles::Points;
use crate::ik::Tool;
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES, Motion};
use akrobat_simd::{Kernel, LANES, Lanes, Row, Simd, run, xyz};

/// Sum of the squared errors (m, rad) at which a seed has converged.
pub(crate) const CONVERGED: f32 = 1e-8;
/// Steps that a seed gets.
pub(crate) const MAX_STEPS: u32 = 40;
/// Damping that stays when the error is gone.
pub(crate) const LEAST_DAMPING: f32 = 1e-5;
/// Share of the squared error in the damping.
pub(crate) const DAMPING_PER_ERROR: f32 = 0.05;
/// Longest step of a variable, rad or m.
pub(crate) const LONGEST_STEP: f32 = 0.6;

/// A robot's joints and its tool, compiled for [`BatchIk::solve`].
#[derive(Debug, Clone)]
pub struct BatchIk {
    simd: Simd,
    joints: Vec<CompiledJoint>,
    /// The node that carries the tool.
    tool_slot: usize,
    /// Columns of the rotation of the tool in that node's frame, then the translation.
    tool: [[f32; 3]; 4],
    /// Variables that move the tool.
    moving: Vec<usize>,
    lower: Config,
    upper: Config,
}

/// What became of a seed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solved {
    /// Number of the seed.
    pub seed: usize,
    /// Where it ended.
    pub x: Config,
    /// Whether the tool is at its target there.
    pub converged: bool,
}

/// Working memory of eight lanes.
struct Work {
    x: [Row; MAX_VARIABLES],
    frames: Vec<FrameRows>,
    /// Jacobian columns `[linear; angular]` of the moving variables.
    jacobian: Vec<[Row; 6]>,
    seeds: [Option<usize>; LANES],
    steps: [u32; LANES],
}

impl BatchIk {
    /// Compiles the tree for its tool.
    pub fn new(kinematics: &Kinematics, tool: &Tool) -> Self {
        let (joints, turned) = compile(kinematics);
        let back = Frame { rotation: turned[tool.node].transpose(), translation: Vector3::zeros() };
        let offset = back.compose(&tool.node_from_tool);
        let column = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        let rotation = |i: usize| column(offset.rotation.column(i).into_owned());
        let moved_by = kinematics.nodes()[tool.node].moved_by;
        let limit = |side: &[f64]| {
            let mut out = [0.0; MAX_VARIABLES];
            side.iter().zip(&mut out).for_each(|(value, out)| *out = *value as f32);
            out
        };
        Self {
            simd: Simd::detect(),
            joints,
            tool_slot: tool.node,
            tool: [rotation(0), rotation(1), rotation(2), column(offset.translation)],
            moving: (0..kinematics.dof()).filter(|&v| moved_by >> v & 1 == 1).collect(),
            lower: limit(kinematics.lower()),
            upper: limit(kinematics.upper()),
        }
    }

    /// The same with another implementation of the lanes.
    ///
    /// # Panics
    /// If the processor cannot run it.
    pub fn with_simd(self, simd: Simd) -> Self {
        assert!(simd == Simd::Portable || simd == Simd::detect(), "{simd:?} is not supported");
        Self { simd, ..self }
    }

    /// Moves the tool to `target` from each of `seeds`. The results are in the order of the seeds.
    pub fn solve(&self, target: &Frame, seeds: &[Config]) -> Vec<Solved> {
        let mut out = run(self.simd, Solve { batch: self, target, seeds });
        out.sort_unstable_by_key(|solved| solved.seed);
        out
    }

    #[inline(always)]
    fn solve_in<L: Lanes>(&self, target: &Frame, seeds: &[Config]) -> Vec<Solved> {
        let mut work = self.work();
        let mut out = Vec::with_capacity(seeds.len());
        let mut next = 0;
        for lane in 0..LANES {
            self.refill(&mut work, lane, seeds, &mut next);
        }
        while out.len() < seeds.len() {
            let mut squared = Row::default();
            self.step::<L>(target, &mut work, &mut squared);
            for lane in 0..LANES {
                let Some(seed) = work.seeds[lane] else { continue };
                work.steps[lane] += 1;
                let converged = squared.0[lane] < CONVERGED;
                if converged || work.steps[lane] >= MAX_STEPS || squared.0[lane].is_nan() {
                    let mut x = [0.0; MAX_VARIABLES];
                    work.x.iter().zip(&mut x).for_each(|(row, value)| *value = row.0[lane]);
                    out.push(Solved { seed, x, converged });
                    self.refill(&mut work, lane, seeds, &mut next);
                }
            }
        }
        out
    }

    fn work(&self) -> Work {
        let world = self.joints.len();
        let mut frames = vec![FrameRows::default(); world + 1];
        for axis in 0..3 {
            frames[world][axis][axis] = Row([1.0; LANES]);
        }
        Work {
            x: [Row::default(); MAX_VARIABLES],
            frames,
            jacobian: vec![Default::default(); self.moving.len()],
            seeds: [None; LANES],
            steps: [0; LANES],
        }
    }

    /// Starts a lane on the next seed. Where there is none, it goes on where it is, unseen.
    fn refill(&self, work: &mut Work, lane: usize, seeds: &[Config], next: &mut usize) {
        work.seeds[lane] = (*next < seeds.len()).then_some(*next);
        work.steps[lane] = 0;
        if let Some(seed) = seeds.get(*next) {
            work.x.iter_mut().zip(seed).for_each(|(row, value)| row.0[lane] = *value);
            *next += 1;
        }
    }

    /// Writes the squared errors, and steps every lane that has one left.
    #[inline(always)]
    fn step<L: Lanes>(&self, target: &Frame, work: &mut Work, squared: &mut Row) {
        for (index, joint) in self.joints.iter().enumerate() {
            let parent = work.frames[joint.parent];
            joint.place::<L>(&parent, L::load(&work.x[index]), &mut work.frames[index]);
        }
        let carrier = &work.frames[self.tool_slot];
        let point = place::<L>(carrier, &self.tool[3]);
        let error = self.error::<L>(target, carrier, &point);
        let sum = dot(&error, &error);
        sum.store(squared);
        self.linearise::<L>(work, &point, &error);
        let damping = sum * L::splat(DAMPING_PER_ERROR) + L::splat(LEAST_DAMPING);
        let y = solve_normal::<L>(&work.jacobian, damping, &error);
        // A lane that has converged stays where it is.
        let mut goes = Row::default();
        for (goes, squared) in goes.0.iter_mut().zip(&squared.0) {
            *goes = if *squared < CONVERGED { 0.0 } else { 1.0 };
        }
        let goes = L::load(&goes);
        let longest = L::splat(LONGEST_STEP);
        for (column, &variable) in work.jacobian.iter().zip(&self.moving) {
            let mut step = L::splat(0.0);
            for k in 0..6 {
                step = step + L::load(&column[k]) * y[k];
            }
            let step = step.max(L::splat(-LONGEST_STEP)).min(longest) * goes;
            let moved = L::load(&work.x[variable]) - step;
            let low = L::splat(self.lower[variable]);
            moved.max(low).min(L::splat(self.upper[variable])).store(&mut work.x[variable]);
        }
    }

    /// `[translation; rotation]` from the target to the tool: the rotation as its axis times `2 tan(angle / 2)`, which
    /// grows up to half a turn and is the angle where it is small.
    #[inline(always)]
    fn error<L: Lanes>(&self, target: &Frame, carrier: &FrameRows, point: &Points<L>) -> [L; 6] {
        let tool = xyz!(i => turned::<L>(carrier, &self.tool[i]));
        // Rows of `tool * goal^T`.
        let rows = xyz!(r => xyz!(c => {
            tool[0][r] * L::splat(target.rotation[(c, 0)] as f32)
                + tool[1][r] * L::splat(target.rotation[(c, 1)] as f32)
                + tool[2][r] * L::splat(target.rotation[(c, 2)] as f32)
        }));
        let trace = rows[0][0] + rows[1][1] + rows[2][2];
        // axis sin(angle) = vee / 2 and 1 + cos(angle) = (1 + trace) / 2.
        let scale = L::splat(2.0) / (trace + L::splat(1.0)).max(L::splat(0.1));
        [
            point[0] - L::splat(target.translation.x as f32),
            point[1] - L::splat(target.translation.y as f32),
            point[2] - L::splat(target.translation.z as f32),
            (rows[2][1] - rows[1][2]) * scale,
            (rows[0][2] - rows[2][0]) * scale,
            (rows[1][0] - rows[0][1]) * scale,
        ]
    }

    /// Jacobian columns; zero for a variable at a limit that the gradient would leave.
    #[inline(always)]
    fn linearise<L: Lanes>(&self, work: &mut Work, point: &Points<L>, error: &[L; 6]) {
        for (slot, &variable) in self.moving.iter().enumerate() {
            let frame = &work.frames[variable];
            let axis = load::<L>(&frame[2]);
            let zero = L::splat(0.0);
            let (linear, angular) = match self.joints[variable].motion {
                Motion::Turn => {
                    let origin = load::<L>(&frame[3]);
                    let arm = xyz!(i => point[i] - origin[i]);
                    (cross(&axis, &arm), axis)
                }
                Motion::Slide => (axis, [zero; 3]),
            };
            let column = [linear[0], linear[1], linear[2], angular[0], angular[1], angular[2]];
            let slope = dot(&column, error);
            // The step goes against the slope.
            let x = L::load(&work.x[variable]);
            let low = L::splat(self.lower[variable]);
            let high = L::splat(self.upper[variable]);
            let leaves_low = !low.less(x) & zero.less(slope);
            let leaves_high = !x.less(high) & slope.less(zero);
            let blocked = leaves_low | leaves_high;
            let mut free = Row::default();
            for (lane, free) in free.0.iter_mut().enumerate() {
                *free = if blocked >> lane & 1 == 1 { 0.0 } else { 1.0 };
            }
            let free = L::load(&free);
            for k in 0..6 {
                (column[k] * free).store(&mut work.jacobian[slot][k]);
            }
        }
    }
}

/// [`BatchIk::solve`].
struct Solve<'a> {
    batch: &'a BatchIk,
    target: &'a Frame,
    seeds: &'a [Config],
}

impl Kernel for Solve<'_> {
    type Output = Vec<Solved>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Vec<Solved> {
        self.batch.solve_in::<L>(self.target, self.seeds)
    }
}

#[inline(always)]
fn dot<L: Lanes>(a: &[L; 6], b: &[L; 6]) -> L {
    let mut sum = a[0] * b[0];
    for k in 1..6 {
        sum = sum + a[k] * b[k];
    }
    sum
}

#[inline(always)]
fn cross<L: Lanes>(a: &Points<L>, b: &Points<L>) -> Points<L> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Solves `(J J^T + damping I) y = error` by Cholesky's method, in every lane.
#[inline(always)]
fn solve_normal<L: Lanes>(jacobian: &[[Row; 6]], damping: L, error: &[L; 6]) -> [L; 6] {
    let zero = L::splat(0.0);
    let mut a = [[zero; 6]; 6];
    for column in jacobian {
        for i in 0..6 {
            let own = L::load(&column[i]);
            for j in 0..=i {
                a[i][j] = a[i][j] + own * L::load(&column[j]);
            }
        }
    }
    let mut inverse = [zero; 6];
    for i in 0..6 {
        for j in 0..=i {
            let mut sum = if i == j { a[i][j] + damping } else { a[i][j] };
            for k in 0..j {
                sum = sum - a[i][k] * a[j][k];
            }
            if i == j {
                // Positive but for rounding.
                inverse[i] = L::splat(1.0) / sum.max(L::splat(1e-12)).sqrt();
                a[i][i] = sum * inverse[i];
            } else {
                a[i][j] = sum * inverse[j];
            }
        }
    }
    let mut y = *error;
    for i in 0..6 {
        for k in 0..i {
            y[i] = y[i] - a[i][k] * y[k];
        }
        y[i] = y[i] * inverse[i];
    }
    for i in (0..6).rev() {
        for k in i + 1..6 {
            y[i] = y[i] - a[k][i] * y[k];
        }
        y[i] = y[i] * inverse[i];
    }
    y
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::ik;

    /// Seven turning joints, like those of an arm, on a slide.
    fn arm() -> (Kinematics, Tool) {
        use akrobat_model::{Joint, JointKind, KinematicTree, Link, pose};
        let link = |i: usize| Link { name: format!("l{i}"), ..Link::default() };
        let joint = |i: usize| Joint {
            name: format!("j{i}"),
            kind: if i == 0 { JointKind::Prismatic } else { JointKind::Revolute },
            parent: i,
            child: i + 1,
            parent_from_joint: pose::from_xyz_rpy([0.02, 0.0, 0.15], [0.3 * i as f64, 0.1, 0.2]),
            axis: nalgebra::Unit::new_normalize(
                [Vector3::new(1.0, 0.2, 0.0), Vector3::z(), Vector3::new(0.0, 1.0, 0.1)][i % 3],
            ),
            limits: if i == 0 { [-0.5, 0.5] } else { [-2.6, 2.4] },
            velocity_limit: None,
            effort_limit: None,
            damping: 0.0,
            friction: 0.0,
            mimic: None,
        };
        let links = (0..9).map(link).collect();
        let tree = KinematicTree::new("arm".into(), links, (0..8).map(joint).collect()).unwrap();
        let variables: Vec<usize> = (0..8).collect();
        let rest = [0.0; 8];
        let kinematics = Kinematics::compile(
            &tree,
            &pose::from_xyz_rpy([0.3, 0.0, 0.1], [0.0; 3]),
            &variables,
            &rest,
        );
        let offset = pose::from_xyz_rpy([0.0, 0.05, 0.1], [0.2, 0.4, 0.0]);
        (kinematics, Tool { node: 7, node_from_tool: Frame::from(&offset) })
    }

    fn draw(rng: &mut ChaCha8Rng, kinematics: &Kinematics) -> Vec<f64> {
        let limits = kinematics.lower().iter().zip(kinematics.upper());
        limits.map(|(low, high)| rng.random_range(*low..=*high)).collect()
    }

    fn single(x: &[f64]) -> Config {
        let mut out = [0.0; MAX_VARIABLES];
        out.iter_mut().zip(x).for_each(|(out, x)| *out = *x as f32);
        out
    }

    #[test]
    fn what_converged_is_at_the_target() {
        let (kinematics, tool) = arm();
        let batch = BatchIk::new(&kinematics, &tool);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut converged, mut by_scalar) = (0, 0);
        for _ in 0..20 {
            let goal = draw(&mut rng, &kinematics);
            let target = tool.frame(&kinematics.forward(&goal));
            let seeds: Vec<Config> =
                (0..30).map(|_| single(&draw(&mut rng, &kinematics))).collect();
            let found = batch.solve(&target, &seeds);
            for seed in &seeds {
                let mut x: Vec<f64> = seed[..8].iter().map(|&v| f64::from(v)).collect();
                by_scalar += usize::from(ik::solve(&kinematics, &tool, &target, &mut x, 0));
            }
            assert!(found.iter().enumerate().all(|(i, solved)| solved.seed == i));
            for solved in found.iter().filter(|s| s.converged) {
                let x: Vec<f64> = solved.x[..8].iter().map(|&v| f64::from(v)).collect();
                let frame = tool.frame(&kinematics.forward(&x));
                let error = ik::pose_error(&frame, &target);
                assert!(error.amax() < 2e-4, "{error}");
                assert!(kinematics.within_limits(&x, -1e-6));
                converged += 1;
            }
        }
        // As often, within a tenth, as the solver that takes steps back.
        assert!(10 * converged > 9 * by_scalar, "{converged} of {by_scalar}");
    }

    #[test]
    fn a_target_out_of_reach_is_not_reached() {
        let (kinematics, tool) = arm();
        let mut target = tool.frame(&kinematics.forward(&[0.1; 8]));
        target.translation.z += 5.0;
        let found = BatchIk::new(&kinematics, &tool).solve(&target, &[single(&[0.0; 8]); 5]);
        assert_eq!(found.len(), 5);
        assert!(found.iter().all(|s| !s.converged && s.x.iter().all(|v| v.is_finite())));
    }

    #[test]
    fn lanes_and_neighbours_change_nothing() {
        let (kinematics, tool) = arm();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let target = tool.frame(&kinematics.forward(&draw(&mut rng, &kinematics)));
        let seeds: Vec<Config> = (0..21).map(|_| single(&draw(&mut rng, &kinematics))).collect();
        let batch = BatchIk::new(&kinematics, &tool);
        let all = batch.solve(&target, &seeds);
        assert_eq!(all, batch.clone().with_simd(Simd::Portable).solve(&target, &seeds));
        for (index, seed) in seeds.iter().enumerate().step_by(5) {
            let alone = batch.solve(&target, &[*seed]);
            assert_eq!((alone[0].x, alone[0].converged), (all[index].x, all[index].converged));
        }
    }
}
