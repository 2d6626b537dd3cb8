//! Batch trajectory optimisation on the device.

use akrobat_gpu::{GpuError, StorageBuffer, wgpu};
use bytemuck::Zeroable;

use super::layout::{self, Body, Chain, DeviceFrame, Reduced, Settings, Waypoint};
use super::pipelines::Kernel;
use super::{Session, run};
use crate::collision::Penalty;
use crate::kinematics::MAX_VARIABLES;
use crate::trajopt::{CLEARANCE_WEIGHTS, Problem, Waypoints};

/// Iterations that are submitted together: processors that draw a screen as well must not be kept busy for long.
const ITERATIONS_PER_SUBMISSION: usize = 5;

/// Paths on the device.
struct Upload {
    stage: wgpu::BindGroup,
    work: wgpu::BindGroup,
    problems: StorageBuffer<layout::Problem>,
    waypoints: StorageBuffer<Waypoint>,
}

impl Session<'_> {
    /// Optimises each path as [`Problem::optimise`] does: the first waypoint stays, the last keeps the object's joint.
    /// All problems are of one robot, with the same settings, and all paths have the same number of waypoints. What
    /// comes back holds the constraint within 1e-5 m and rad; [`Problem::settle`] brings it onto it.
    ///
    /// # Errors
    /// [`GpuError`] where the device fails.
    ///
    /// # Panics
    /// Where paths differ in length.
    pub fn optimise(
        &self,
        problems: &[&Problem<'_>],
        paths: &[Waypoints],
    ) -> Result<Vec<Waypoints>, GpuError> {
        let Some(settings) = problems.first().map(|problem| problem.config) else {
            return Ok(Vec::new());
        };
        let upload = self.upload(problems, paths)?;
        let (count, length) = (problems.len(), paths[0].len());
        let groups = [&upload.stage, &upload.work];
        run(self.gpu, groups, [(Kernel::Evaluate, count * length), (Kernel::Begin, count)]);
        let iteration = [
            (Kernel::Reduce, count * length),
            (Kernel::Couple, count * length),
            (Kernel::Solve, count),
            (Kernel::Advance, count * length),
            (Kernel::Accept, count),
        ];
        let mut left = settings.iterations * CLEARANCE_WEIGHTS.len();
        while left > 0 {
            let now = left.min(ITERATIONS_PER_SUBMISSION);
            run(self.gpu, groups, std::iter::repeat_n(iteration, now).flatten());
            left -= now;
        }
        let states = upload.problems.read(&self.gpu.context)?;
        let waypoints = upload.waypoints.read(&self.gpu.context)?;
        let path = |((state, own), before): ((&layout::Problem, &[Waypoint]), &Waypoints)| {
            if state.taken == 0 {
                return before.clone();
            }
            let mut path: Waypoints = own
                .chunks(2)
                .map(|slots| {
                    let x = &slots[state.slot as usize].x[..state.dof as usize];
                    x.iter().map(|&value| f64::from(value)).collect()
                })
                .collect();
            path[0].clone_from(&before[0]);
            path
        };
        Ok(states.iter().zip(waypoints.chunks(2 * length)).zip(paths).map(path).collect())
    }

    /// Hinge penalties of every clearance at each configuration of the chain. Twin of
    /// [`crate::collision::RobotBody::penalty`].
    ///
    /// # Errors
    /// [`GpuError`] where the device fails.
    pub fn penalties(
        &self,
        problem: &Problem<'_>,
        configurations: &Waypoints,
    ) -> Result<Vec<Penalty>, GpuError> {
        let upload = self.upload(&[problem], std::slice::from_ref(configurations))?;
        let groups = [&upload.stage, &upload.work];
        run(self.gpu, groups, [(Kernel::Evaluate, configurations.len())]);
        let waypoints = upload.waypoints.read(&self.gpu.context)?;
        Ok(waypoints.chunks(2).map(|slots| penalty(&slots[0])).collect())
    }

    fn upload(&self, problems: &[&Problem<'_>], paths: &[Waypoints]) -> Result<Upload, GpuError> {
        let gpu = self.gpu;
        let (first, length) = (problems[0], paths[0].len());
        assert!(paths.iter().all(|path| path.len() == length), "paths differ in length");
        let body = Body::new(first.body, &Chain::new(first.kinematics));
        let mut joints = Vec::new();
        let states: Vec<layout::Problem> =
            problems.iter().map(|problem| state(problem, &mut joints)).collect();
        let stage = self.stage(&joints, Some(&body))?;
        let problems = gpu.storage("problems", &states)?;
        let start: Vec<Waypoint> = paths.iter().flatten().flat_map(|x| [waypoint(x); 2]).collect();
        let waypoints = gpu.storage("waypoints", &start)?;
        let none = wgpu::BufferUsages::empty();
        let reduced: StorageBuffer<Reduced> =
            StorageBuffer::zeroed(&gpu.context, "reduced system", paths.len() * length, none)?;
        let settings = Settings {
            waypoints: length as u32,
            iterations: first.config.iterations as u32,
            clearance_m: first.config.clearance_m as f32,
            min_clearance_m: first.config.min_clearance_m as f32,
        };
        let uniform = wgpu::BufferUsages::UNIFORM;
        let settings = StorageBuffer::new(&gpu.context, "settings", &[settings], uniform)?;
        let bindings =
            [problems.binding(), waypoints.binding(), reduced.binding(), settings.binding()];
        let work = gpu.pipelines.path_group(&gpu.context, bindings);
        Ok(Upload { stage, work, problems, waypoints })
    }
}

/// A problem to begin with; its joints are appended.
fn state(problem: &Problem<'_>, joints: &mut Vec<layout::Joint>) -> layout::Problem {
    let mut chain = Chain::new(problem.kinematics);
    for (i, joint) in chain.joints.iter_mut().enumerate() {
        joint.velocity_weight = problem.velocity_weights[i] as f32;
        joint.acceleration_weight = problem.acceleration_weights[i] as f32;
        joint.mobility = problem.mobility[i] as f32;
    }
    let node = problem.closure.node();
    let out = layout::Problem {
        node_from_end: chain.hanging(node, problem.closure.node_from_object()),
        world_from_goal: DeviceFrame::from(problem.closure.world_from_object()),
        first_joint: joints.len() as u32,
        dof: problem.kinematics.dof() as u32,
        end_node: node as u32,
        ..layout::Problem::zeroed()
    };
    joints.append(&mut chain.joints);
    out
}

fn waypoint(x: &[f64]) -> Waypoint {
    let mut out = Waypoint::zeroed();
    x.iter().zip(&mut out.x).for_each(|(value, out)| *out = *value as f32);
    out
}

fn penalty(at: &Waypoint) -> Penalty {
    let mut out = Penalty::zero();
    out.cost = f64::from(at.cost);
    out.largest = f64::from(at.largest);
    let mut entries = at.hessian.iter();
    for i in 0..MAX_VARIABLES {
        out.gradient[i] = f64::from(at.gradient[i]);
        for (j, &value) in (0..=i).zip(&mut entries) {
            out.hessian[(i, j)] = f64::from(value);
            out.hessian[(j, i)] = f64::from(value);
        }
    }
    out
}
