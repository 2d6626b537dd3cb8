//! Batch inverse kinematics on the device.

use akrobat_gpu::{GpuError, StorageBuffer, wgpu};
use bytemuck::Zeroable;

use super::layout::{Body, Chain, Configuration, DeviceFrame, Problem};
use super::pipelines::Kernel;
use super::{Session, run};
use crate::collision::RobotBody;
use crate::ik::Tool;
use crate::kernels::Config;
use crate::kernels::ik::{CONVERGED, Solved};
use crate::kinematics::{Frame, Kinematics};

/// What became of a seed on the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reached {
    /// The end of the seed.
    pub solved: Solved,
    /// Smallest clearance there with the hand on the object, metres; clearances above 2 cm (5 cm between the robot's
    /// own links) are not told apart. Meaningless where it has not converged.
    pub clearance_m: f64,
}

impl Session<'_> {
    /// Moves the tool to `target` from each of `seeds`, and measures the clearance of what converged with the object's
    /// joint at `object_q`. Twin of [`crate::kernels::ik::BatchIk::solve`].
    ///
    /// # Errors
    /// [`GpuError`] where the device fails.
    pub fn solve_ik(
        &self,
        kinematics: &Kinematics,
        body: &RobotBody,
        tool: &Tool,
        target: &Frame,
        object_q: f64,
        seeds: &[Config],
    ) -> Result<Vec<Reached>, GpuError> {
        if seeds.is_empty() {
            return Ok(Vec::new());
        }
        let chain = Chain::new(kinematics);
        let problem = Problem {
            node_from_end: chain.hanging(tool.node, &tool.node_from_tool),
            world_from_goal: DeviceFrame::from(target),
            dof: kinematics.dof() as u32,
            end_node: tool.node as u32,
            object_q: object_q as f32,
            ..Problem::zeroed()
        };
        let from_seed = |x: &Config| Configuration { x: *x, squared: 0.0, clearance: 0.0 };
        let seeds: Vec<Configuration> = seeds.iter().map(from_seed).collect();
        let passes = [Kernel::SolveIk, Kernel::ClearAll];
        let found = self.on_configurations(&chain, Some(body), problem, &seeds, &passes)?;
        let reached = |(seed, at): (usize, &Configuration)| Reached {
            solved: Solved { seed, x: at.x, converged: at.squared < CONVERGED },
            clearance_m: f64::from(at.clearance),
        };
        Ok(found.iter().enumerate().map(reached).collect())
    }

    /// Runs kernels on configurations, in place.
    pub(super) fn on_configurations(
        &self,
        chain: &Chain,
        body: Option<&RobotBody>,
        problem: Problem,
        configurations: &[Configuration],
        kernels: &[Kernel],
    ) -> Result<Vec<Configuration>, GpuError> {
        let gpu = self.gpu;
        let body = body.map(|body| Body::new(body, chain));
        let stage = self.stage(&chain.joints, body.as_ref())?;
        let problems = gpu.storage("problems", &[problem])?;
        let values = gpu.storage("configurations", configurations)?;
        let poses: StorageBuffer<DeviceFrame> =
            StorageBuffer::zeroed(&gpu.context, "poses", 1, wgpu::BufferUsages::empty())?;
        let bindings = [problems.binding(), values.binding(), poses.binding()];
        let work = gpu.pipelines.configuration_group(&gpu.context, bindings);
        let count = configurations.len();
        run(gpu, [&stage, &work], kernels.iter().map(|&kernel| (kernel, count)));
        values.read(&gpu.context)
    }
}
