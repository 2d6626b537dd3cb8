//! Batch inverse kinematics by damped least squares from random seeds.

use akrobat_gpu::GpuError;
use akrobat_model::Robot;
use nalgebra::{Matrix6, SVector, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::gpu::Reached;
use crate::kernels::Config;
use crate::kernels::ik::{BatchIk, Solved};
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES, NodeFrames, Variables, rotation_log};

/// Largest position and rotation error of a solution (metres, radians).
pub const TOLERANCE: f64 = 1e-6;

const MAX_ITERATIONS: usize = 60;
/// Random draws for each seed until one passes the prefilter.
const SEED_DRAWS: usize = 20;

/// The tool of a compiled robot.
#[derive(Debug, Clone)]
pub struct Tool {
    /// Node it hangs from.
    pub node: usize,
    /// Tool frame in the node's frame.
    pub node_from_tool: Frame,
}

impl Tool {
    /// The tool of `robot` on `kinematics`; `None` if no variable moves it.
    pub fn new(robot: &Robot, kinematics: &Kinematics) -> Option<Self> {
        let attachment = kinematics.attachment(robot.tool_link);
        let offset = attachment.node_from_link * robot.link_from_tool;
        Some(Self { node: attachment.node?, node_from_tool: Frame::from(&offset) })
    }

    /// World frame of the tool.
    pub fn frame(&self, frames: &NodeFrames) -> Frame {
        frames.frames[self.node].compose(&self.node_from_tool)
    }
}

/// `[translation; rotation]` error from `target` to `actual`, world axes (m, rad).
pub fn pose_error(actual: &Frame, target: &Frame) -> Vector6<f64> {
    let rotation = rotation_log(&(actual.rotation * target.rotation.transpose()));
    let translation = actual.translation - target.translation;
    let mut error = Vector6::zeros();
    error.fixed_rows_mut::<3>(0).copy_from(&translation);
    error.fixed_rows_mut::<3>(3).copy_from(&rotation);
    error
}

/// Moves the first `active` variables of `x` until the tool is at `target`; variables below `frozen`
/// stay. Levenberg-Marquardt with limits by clamping (Nocedal and Wright, *Numerical Optimization*,
/// 2006, section 10.3). True on success.
pub fn solve(
    kinematics: &Kinematics,
    tool: &Tool,
    target: &Frame,
    x: &mut Variables,
    frozen: usize,
) -> bool {
    let mut damping = 1e-3;
    let mut frames = kinematics.forward(x);
    let mut error = pose_error(&tool.frame(&frames), target);
    for _ in 0..MAX_ITERATIONS {
        if error.amax() < TOLERANCE {
            return true;
        }
        let step = damped_step(kinematics, tool, &frames, x, &error, damping, frozen);
        let mut trial = [0.0; MAX_VARIABLES];
        let trial = &mut trial[..x.len()];
        for (i, value) in trial.iter_mut().enumerate() {
            *value = x[i] + step[i].clamp(-0.5, 0.5);
        }
        kinematics.clamp(trial);
        let trial_frames = kinematics.forward(trial);
        let trial_error = pose_error(&tool.frame(&trial_frames), target);
        if trial_error.norm_squared() < error.norm_squared() {
            x.copy_from_slice(trial);
            (frames, error) = (trial_frames, trial_error);
            damping = (damping * 0.2).max(1e-12);
        } else {
            damping = (damping * 5.0).max(1e-6);
            if damping > 1e3 {
                return false;
            }
        }
    }
    error.amax() < TOLERANCE
}

/// Step `-J^T (J J^T + damping I)^-1 error`; variables at a limit that the step would leave are frozen.
fn damped_step(
    kinematics: &Kinematics,
    tool: &Tool,
    frames: &NodeFrames,
    x: &Variables,
    error: &Vector6<f64>,
    damping: f64,
    frozen: usize,
) -> SVector<f64, MAX_VARIABLES> {
    let point = tool.frame(frames).translation;
    let mut jacobian = kinematics.jacobian(frames, tool.node, &point);
    for variable in 0..frozen {
        jacobian.column_mut(variable).fill(0.0);
    }
    for _ in 0..3 {
        let normal = jacobian * jacobian.transpose() + Matrix6::identity() * damping;
        let Some(cholesky) = normal.cholesky() else { return SVector::zeros() };
        let step = -(jacobian.transpose() * cholesky.solve(error));
        let mut blocked = false;
        for variable in 0..kinematics.dof() {
            let at_low = x[variable] <= kinematics.lower()[variable] && step[variable] < -1e-9;
            let at_high = x[variable] >= kinematics.upper()[variable] && step[variable] > 1e-9;
            if at_low || at_high {
                jacobian.column_mut(variable).fill(0.0);
                blocked = true;
            }
        }
        if !blocked {
            return step;
        }
    }
    SVector::zeros()
}

/// Where random seeds put the base and the arm.
#[derive(Debug, Clone)]
pub struct SeedRegion {
    /// Number of base variables: 3, or 0 for a fixed base.
    pub base: usize,
    /// Arm mount in the base frame, in the plane.
    pub mount: [f64; 2],
    /// Direction from the target towards free space, horizontal unit vector.
    pub outward: Vector3<f64>,
    /// Distance of the mount from the target, metres.
    pub distance_m: [f64; 2],
    /// Half angle around `outward` in which the base is placed, radians.
    pub half_angle: f64,
}

impl SeedRegion {
    /// A random start for [`solve`]: the base near the target and roughly facing it, the arm anywhere.
    pub fn sample(
        &self,
        kinematics: &Kinematics,
        target: &Frame,
        rng: &mut ChaCha8Rng,
    ) -> Vec<f64> {
        let mut x: Vec<f64> = (0..kinematics.dof())
            .map(|i| {
                let (low, high) = (kinematics.lower()[i].max(-3.2), kinematics.upper()[i].min(3.2));
                rng.random_range(low..=high)
            })
            .collect();
        if self.base == 3 {
            let bearing = self.outward.y.atan2(self.outward.x)
                + rng.random_range(-self.half_angle..=self.half_angle);
            let distance = rng.random_range(self.distance_m[0]..=self.distance_m[1]);
            let mount =
                target.translation + Vector3::new(bearing.cos(), bearing.sin(), 0.0) * distance;
            let yaw = wrap(bearing + std::f64::consts::PI + rng.random_range(-1.6..=1.6));
            let (sin, cos) = yaw.sin_cos();
            x[0] = mount.x - (cos * self.mount[0] - sin * self.mount[1]);
            x[1] = mount.y - (sin * self.mount[0] + cos * self.mount[1]);
            x[2] = yaw;
        }
        x
    }
}

/// An angle in -pi..pi.
pub fn wrap(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

/// Seeds that are solved between two looks at whether they suffice: constant, so that results do not depend on
/// threads.
const CHUNK: usize = 128;
/// Seeds that one thread solves together.
const GROUP: usize = 32;

fn single(x: &Variables) -> Config {
    let mut out = [0.0; MAX_VARIABLES];
    out.iter_mut().zip(x).for_each(|(out, value)| *out = *value as f32);
    out
}

/// How hard a batch tries.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Random starts at most.
    pub seeds: usize,
    /// Accepted solutions that suffice.
    pub enough: usize,
}

/// What a batch gave.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Batch {
    /// Accepted solutions, in the order of their seeds.
    pub accepted: Vec<Vec<f64>>,
    /// Seeds that were used.
    pub seeds: usize,
    /// Seeds that converged.
    pub solved: usize,
}

/// What a batch looks for.
pub struct Search<'a> {
    /// The chain to the tool.
    pub kinematics: &'a Kinematics,
    /// Its end.
    pub tool: &'a Tool,
    /// Where the tool belongs.
    pub target: &'a Frame,
    /// Where seeds are drawn.
    pub region: &'a SeedRegion,
    /// Seed of the random numbers.
    pub seed: u64,
    /// How hard to try.
    pub effort: Effort,
    /// What seeds must satisfy.
    pub prefilter: &'a (dyn Fn(&Variables) -> bool + Sync),
    /// What solutions must satisfy.
    pub accept: &'a (dyn Fn(&Variables) -> bool + Sync),
}

impl Search<'_> {
    /// Solves from random starts until enough solutions are accepted. The result does not depend on the number of
    /// threads.
    pub fn on_cpu(&self) -> Batch {
        let kernel = BatchIk::new(self.kinematics, self.tool);
        let solve_seeds = |first: usize| -> Vec<(bool, Option<Vec<f64>>)> {
            let last = (first + GROUP).min(self.effort.seeds);
            let seeds: Vec<Config> = (first..last).filter_map(|index| self.draw(index)).collect();
            let found = kernel.solve(self.target, &seeds);
            found.iter().map(|solved| self.polish(solved)).collect()
        };
        let mut batch = Batch::default();
        while !self.is_done(&batch) {
            let last = (batch.seeds + CHUNK).min(self.effort.seeds);
            let groups: Vec<usize> = (batch.seeds..last).step_by(GROUP).collect();
            batch.add(last, groups.into_par_iter().flat_map_iter(solve_seeds).collect());
        }
        batch
    }

    /// The same with seeds solved by `device`, up to `chunks_ahead` chunks of them at once: where it stops does not depend on
    /// that. Solutions whose clearance the device says is below `least_m` are dropped unpolished.
    ///
    /// # Errors
    /// Those of the device.
    pub fn on_device(
        &self,
        device: impl Fn(&[Config]) -> Result<Vec<Reached>, GpuError>,
        chunks_ahead: usize,
        least_m: f64,
    ) -> Result<Batch, GpuError> {
        let polish = |found: &Reached| match found.solved.converged && found.clearance_m < least_m {
            true => (true, None),
            false => self.polish(&found.solved),
        };
        let mut batch = Batch::default();
        while !self.is_done(&batch) {
            let first = batch.seeds;
            let last = (first + chunks_ahead * CHUNK).min(self.effort.seeds);
            let drawn: Vec<(usize, Config)> = (first..last)
                .into_par_iter()
                .filter_map(|index| Some((index, self.draw(index)?)))
                .collect();
            let seeds: Vec<Config> = drawn.iter().map(|(_, x)| *x).collect();
            let found = device(&seeds)?;
            while batch.seeds < last && !self.is_done(&batch) {
                let chunk = batch.seeds..(batch.seeds + CHUNK).min(last);
                let own = drawn.iter().zip(&found).filter(|((index, _), _)| chunk.contains(index));
                let own: Vec<&Reached> = own.map(|(_, found)| found).collect();
                batch.add(chunk.end, own.into_par_iter().map(polish).collect());
            }
        }
        Ok(batch)
    }

    fn is_done(&self, batch: &Batch) -> bool {
        batch.seeds >= self.effort.seeds || batch.accepted.len() >= self.effort.enough
    }

    fn draw(&self, index: usize) -> Option<Config> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(index as u64);
        (0..SEED_DRAWS)
            .map(|_| self.region.sample(self.kinematics, self.target, &mut rng))
            .find(|x| (self.prefilter)(x))
            .map(|x| single(&x))
    }

    /// Whether a seed has converged, in double precision, and its solution where that is accepted.
    fn polish(&self, found: &Solved) -> (bool, Option<Vec<f64>>) {
        let dof = self.kinematics.dof();
        let mut x: Vec<f64> = found.x[..dof].iter().map(|&v| f64::from(v)).collect();
        if !(found.converged && solve(self.kinematics, self.tool, self.target, &mut x, 0)) {
            return (false, None);
        }
        (true, (self.accept)(&x).then_some(x))
    }
}

impl Batch {
    /// Adds what became of the seeds up to `seeds`.
    fn add(&mut self, seeds: usize, results: Vec<(bool, Option<Vec<f64>>)>) {
        self.seeds = seeds;
        self.solved += results.iter().filter(|(solved, _)| *solved).count();
        self.accepted.extend(results.into_iter().filter_map(|(_, x)| x));
    }
}
