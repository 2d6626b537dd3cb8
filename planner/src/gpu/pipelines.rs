//! Shaders and their layouts.

use akrobat_gpu::{Context, GpuError, Shader, ShaderPart, wgpu};

use super::layout::{MAX_FREE, NO_NODE, TRIANGLE};
use crate::collision::{FAR_M, PAIR_FAR_M};
use crate::esdf::{HALF_DIAGONAL, NEAR_VOXELS};
use crate::kernels::ik as reach;
use crate::kinematics::MAX_VARIABLES;
use crate::trajopt;

/// Invocations of a workgroup.
const WORKGROUP: u32 = 32;
/// The same where there is one invocation for each problem, of which there are few.
const PROBLEM_WORKGROUP: u32 = 8;
/// Residual (m, rad) below which the constraint counts as held in single precision.
pub(super) const DEVICE_TOLERANCE: f64 = 1e-5;

const CHAIN: ShaderPart<'_> =
    ShaderPart { name: "chain.wgsl", source: include_str!("../../shaders/chain.wgsl") };
const ESDF: ShaderPart<'_> =
    ShaderPart { name: "esdf.wgsl", source: include_str!("../../shaders/esdf.wgsl") };
const COLLISION: ShaderPart<'_> =
    ShaderPart { name: "collision.wgsl", source: include_str!("../../shaders/collision.wgsl") };
const IK: ShaderPart<'_> =
    ShaderPart { name: "ik.wgsl", source: include_str!("../../shaders/ik.wgsl") };
const TRAJOPT: ShaderPart<'_> =
    ShaderPart { name: "trajopt.wgsl", source: include_str!("../../shaders/trajopt.wgsl") };

/// An entry point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kernel {
    ForwardAll,
    SampleAll,
    ClearAll,
    SolveIk,
    Evaluate,
    Begin,
    Reduce,
    Couple,
    Solve,
    Advance,
    Accept,
}

impl Kernel {
    const ALL: [Self; 11] = [
        Self::ForwardAll,
        Self::SampleAll,
        Self::ClearAll,
        Self::SolveIk,
        Self::Evaluate,
        Self::Begin,
        Self::Reduce,
        Self::Couple,
        Self::Solve,
        Self::Advance,
        Self::Accept,
    ];

    fn entry_point(self) -> &'static str {
        match self {
            Self::ForwardAll => "forward_all",
            Self::SampleAll => "sample_all",
            Self::ClearAll => "clear_all",
            Self::SolveIk => "solve_ik",
            Self::Evaluate => "evaluate",
            Self::Begin => "begin",
            Self::Reduce => "reduce",
            Self::Couple => "couple",
            Self::Solve => "solve",
            Self::Advance => "advance",
            Self::Accept => "accept",
        }
    }

    /// Whether it works on configurations alone, not on paths.
    fn is_of_configurations(self) -> bool {
        matches!(self, Self::ForwardAll | Self::SampleAll | Self::ClearAll | Self::SolveIk)
    }

    pub(super) fn workgroup(self) -> u32 {
        match self {
            Self::Begin | Self::Solve | Self::Accept => PROBLEM_WORKGROUP,
            _ => WORKGROUP,
        }
    }
}

/// Every entry point, ready to run.
#[derive(Debug)]
pub(super) struct Pipelines {
    stage: wgpu::BindGroupLayout,
    configurations: wgpu::BindGroupLayout,
    paths: wgpu::BindGroupLayout,
    /// In the order of [`Kernel::ALL`].
    kernels: Vec<wgpu::ComputePipeline>,
}

impl Pipelines {
    pub(super) fn new(context: &Context) -> Result<Self, GpuError> {
        use Access::{Read, Uniform, Write};
        let prelude = constants();
        let constants = ShaderPart { name: "constants", source: &prelude };
        let parts = [constants, CHAIN, ESDF, COLLISION, IK, TRAJOPT];
        let module = Shader::compose("planner", &parts)?.module(context);
        let stage = [(0, Uniform), (1, Read), (2, Read), (3, Read), (4, Read), (5, Read)];
        let stage = layout(context, "world and robot", &stage);
        let configurations = [(0, Write), (1, Write), (2, Write)];
        let configurations = layout(context, "configurations", &configurations);
        let paths = layout(context, "paths", &[(0, Write), (3, Write), (4, Write), (5, Uniform)]);
        let device = context.device();
        let joined = |work: &wgpu::BindGroupLayout| {
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("planner"),
                bind_group_layouts: &[Some(&stage), Some(work)],
                immediate_size: 0,
            })
        };
        let (of_configurations, of_paths) = (joined(&configurations), joined(&paths));
        let kernel = |kernel: Kernel| {
            let of_configuration = kernel.is_of_configurations();
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(kernel.entry_point()),
                layout: Some(if of_configuration { &of_configurations } else { &of_paths }),
                module: &module,
                entry_point: Some(kernel.entry_point()),
                compilation_options: Default::default(),
                cache: None,
            })
        };
        let kernels = Kernel::ALL.map(kernel).into();
        Ok(Self { stage, configurations, paths, kernels })
    }

    pub(super) fn get(&self, kernel: Kernel) -> &wgpu::ComputePipeline {
        &self.kernels[kernel as usize]
    }

    /// Group 0: scene, joints, spheres, links, pairs, distances.
    pub(super) fn stage_group(
        &self,
        context: &Context,
        bindings: [wgpu::BindingResource<'_>; 6],
    ) -> wgpu::BindGroup {
        group(context, &self.stage, [0, 1, 2, 3, 4, 5].into_iter().zip(bindings))
    }

    /// Group 1 of what works on configurations: problems, configurations, poses.
    pub(super) fn configuration_group(
        &self,
        context: &Context,
        bindings: [wgpu::BindingResource<'_>; 3],
    ) -> wgpu::BindGroup {
        group(context, &self.configurations, [0, 1, 2].into_iter().zip(bindings))
    }

    /// Group 1 of what works on paths: problems, waypoints, the reduced system, settings.
    pub(super) fn path_group(
        &self,
        context: &Context,
        bindings: [wgpu::BindingResource<'_>; 4],
    ) -> wgpu::BindGroup {
        group(context, &self.paths, [0, 3, 4, 5].into_iter().zip(bindings))
    }
}

fn group<'a>(
    context: &Context,
    layout: &wgpu::BindGroupLayout,
    bindings: impl Iterator<Item = (u32, wgpu::BindingResource<'a>)>,
) -> wgpu::BindGroup {
    let entries: Vec<wgpu::BindGroupEntry<'_>> =
        bindings.map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    context.device().create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout,
        entries: &entries,
    })
}

/// How a shader uses a buffer.
#[derive(Debug, Clone, Copy)]
enum Access {
    Uniform,
    Read,
    Write,
}

fn layout(context: &Context, label: &str, entries: &[(u32, Access)]) -> wgpu::BindGroupLayout {
    let entry = |&(binding, access): &(u32, Access)| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: match access {
                Access::Uniform => wgpu::BufferBindingType::Uniform,
                Access::Read => wgpu::BufferBindingType::Storage { read_only: true },
                Access::Write => wgpu::BufferBindingType::Storage { read_only: false },
            },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    let entries: Vec<_> = entries.iter().map(entry).collect();
    context.device().create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(label),
        entries: &entries,
    })
}

/// The numbers that the CPU's kernels work with, so that twins cannot drift apart.
fn constants() -> String {
    let mut out = String::new();
    let counts = [
        ("MAX_VARIABLES", MAX_VARIABLES),
        ("TRIANGLE", TRIANGLE),
        ("MAX_FREE", MAX_FREE),
        ("BASIS", MAX_FREE * MAX_VARIABLES),
        ("BLOCK", MAX_FREE * MAX_FREE),
        ("CONSTRAINTS", 7 * MAX_VARIABLES),
        ("NO_NODE", NO_NODE as usize),
        ("MAX_STEPS", reach::MAX_STEPS as usize),
        ("PROJECTION_STEPS", crate::closure::MAX_STEPS),
        ("ROUNDS", trajopt::CLEARANCE_WEIGHTS.len()),
    ];
    for (name, value) in counts {
        out += &format!("const {name}: u32 = {value}u;\n");
    }
    let numbers = [
        ("HALF_DIAGONAL", HALF_DIAGONAL),
        ("NEAR_VOXELS", f64::from(NEAR_VOXELS)),
        ("FAR_M", FAR_M),
        ("PAIR_FAR_M", PAIR_FAR_M),
        ("CONVERGED", f64::from(reach::CONVERGED)),
        ("LEAST_DAMPING", f64::from(reach::LEAST_DAMPING)),
        ("DAMPING_PER_ERROR", f64::from(reach::DAMPING_PER_ERROR)),
        ("LONGEST_STEP", f64::from(reach::LONGEST_STEP)),
        ("CLEARANCE_WEIGHT_0", trajopt::CLEARANCE_WEIGHTS[0]),
        ("CLEARANCE_WEIGHT_1", trajopt::CLEARANCE_WEIGHTS[1]),
        ("CLEARANCE_WEIGHT_2", trajopt::CLEARANCE_WEIGHTS[2]),
        ("HOPELESS_START_M", trajopt::HOPELESS_START_M),
        ("HOPELESS_M", trajopt::HOPELESS_M),
        ("LEAST_GAIN", trajopt::LEAST_GAIN),
        ("LIMIT_WEIGHT", trajopt::LIMIT_WEIGHT),
        ("LIMIT_MARGIN", trajopt::LIMIT_MARGIN),
        ("LONGEST_ADVANCE", trajopt::LONGEST_STEP),
        ("DEVICE_TOLERANCE", DEVICE_TOLERANCE),
    ];
    for (name, value) in numbers {
        out += &format!("const {name}: f32 = {value:e};\n");
    }
    // Workgroup sizes are part of the entry points' attributes.
    out + &format!(
        "const WORKGROUP: u32 = {WORKGROUP}u;\nconst PROBLEM_WORKGROUP: u32 = {PROBLEM_WORKGROUP}u;\n"
    )
}
