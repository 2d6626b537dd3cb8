//! Where a plan's batches are computed.

use akrobat_gpu::{AdapterChoice, GpuError};

use crate::gpu::Gpu;

/// Where inverse kinematics and trajectory optimisation run. All else runs on the CPU with either.
#[derive(Debug, Default)]
pub enum Backend {
    /// Lanes of eight numbers, and double precision.
    #[default]
    Cpu,
    /// A graphics processor, or a software driver that stands for one.
    Wgpu(Box<Gpu>),
}

impl Backend {
    /// The graphics processor where there is one, else the CPU: a software driver is slower than our own lanes.
    ///
    /// # Errors
    /// [`GpuError`] where a graphics processor is there but cannot be used.
    pub fn auto() -> Result<Self, GpuError> {
        match Gpu::open(&AdapterChoice::Auto) {
            Ok(gpu) => Ok(Self::Wgpu(Box::new(gpu))),
            Err(GpuError::NoAdapter { .. }) => Ok(Self::Cpu),
            Err(error) => Err(error),
        }
    }

    /// The best adapter, real or software.
    ///
    /// # Errors
    /// [`GpuError`] where there is none, or it cannot be used.
    pub fn wgpu() -> Result<Self, GpuError> {
        Ok(Self::Wgpu(Box::new(Gpu::open(&AdapterChoice::Any)?)))
    }
}

impl std::fmt::Display for Backend {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Cpu => f.write_str("CPU"),
            Self::Wgpu(gpu) => write!(f, "wgpu: {}", gpu.adapter()),
        }
    }
}
