//! Single kernels: forward kinematics, distances, clearances, penalties.

use akrobat_gpu::{GpuError, StorageBuffer, wgpu};
use bytemuck::Zeroable;
use nalgebra::Vector3;

use super::layout::{Chain, Configuration, DeviceFrame, Problem};
use super::pipelines::Kernel;
use super::{Session, run};
use crate::collision::RobotBody;
use crate::kernels::Config;
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES};

fn at(x: &Config) -> Configuration {
    Configuration { x: *x, squared: 0.0, clearance: 0.0 }
}

impl Session<'_> {
    /// World frames of all nodes at each configuration. Twin of [`Kinematics::forward`].
    ///
    /// # Errors
    /// [`GpuError`] where the device fails.
    pub fn forward(
        &self,
        kinematics: &Kinematics,
        configurations: &[Config],
    ) -> Result<Vec<Vec<Frame>>, GpuError> {
        let gpu = self.gpu;
        let chain = Chain::new(kinematics);
        let problem = Problem { dof: kinematics.dof() as u32, ..Problem::zeroed() };
        let configurations: Vec<Configuration> = configurations.iter().map(at).collect();
        let stage = self.stage(&chain.joints, None)?;
        let problems = gpu.storage("problems", &[problem])?;
        let values = gpu.storage("configurations", &configurations)?;
        let count = configurations.len();
        let poses: StorageBuffer<DeviceFrame> = StorageBuffer::zeroed(
            &gpu.context,
            "poses",
            count * MAX_VARIABLES,
            wgpu::BufferUsages::empty(),
        )?;
        let bindings = [problems.binding(), values.binding(), poses.binding()];
        let work = gpu.pipelines.configuration_group(&gpu.context, bindings);
        run(gpu, [&stage, &work], [(Kernel::ForwardAll, count)]);
        let poses = poses.read(&gpu.context)?;
        let restored = |own: &[DeviceFrame]| -> Vec<Frame> {
            own[..kinematics.dof()].iter().enumerate().map(|(n, f)| chain.restored(n, f)).collect()
        };
        Ok(poses.chunks(MAX_VARIABLES).take(count).map(restored).collect())
    }

    /// Distance to the resting world, metres, and its gradient, at each point. Twin of
    /// [`crate::esdf::Esdf::distance_and_gradient`].
    ///
    /// # Errors
    /// [`GpuError`] where the device fails.
    pub fn distances(
        &self,
        kinematics: &Kinematics,
        points: &[Vector3<f64>],
    ) -> Result<Vec<(f64, Vector3<f64>)>, GpuError> {
        let chain = Chain::new(kinematics);
        let point = |p: &Vector3<f64>| {
            let mut x = [0.0; MAX_VARIABLES];
            x[..3].copy_from_slice(&[p.x as f32, p.y as f32, p.z as f32]);
            at(&x)
        };
        let points: Vec<Configuration> = points.iter().map(point).collect();
        let passes = [Kernel::SampleAll];
        let found = self.on_configurations(&chain, None, Problem::zeroed(), &points, &passes)?;
        let value = |c: &Configuration| {
            let [x, y, z, distance] = [0, 1, 2, 3].map(|i| f64::from(c.x[i]));
            (distance, Vector3::new(x, y, z))
        };
        Ok(found.iter().map(value).collect())
    }

    /// Smallest clearance of each configuration with the hand on the object, whose joint is at `object_q`, metres. Twin
    /// of [`RobotBody::clearance`]; what is farther than it looks gives 1e9.
    ///
    /// # Errors
    /// [`GpuError`] where the device fails.
    pub fn clearances(
        &self,
        kinematics: &Kinematics,
        body: &RobotBody,
        object_q: f64,
        configurations: &[Config],
    ) -> Result<Vec<f64>, GpuError> {
        let chain = Chain::new(kinematics);
        let problem = Problem {
            dof: kinematics.dof() as u32,
            object_q: object_q as f32,
            ..Problem::zeroed()
        };
        let all: Vec<Configuration> = configurations.iter().map(at).collect();
        let passes = [Kernel::ClearAll];
        let found = self.on_configurations(&chain, Some(body), problem, &all, &passes)?;
        Ok(found.iter().map(|c| f64::from(c.clearance)).collect())
    }
}
