//! Runs on a device, real or software. A missing one is a failure, not a skip.

use akrobat_gpu::{AdapterChoice, Context, GpuError, Shader, ShaderPart, StorageBuffer, wgpu};

fn context() -> Context {
    Context::new(&AdapterChoice::Any).unwrap_or_else(|error| panic!("{error}"))
}

const DOUBLE: ShaderPart<'_> = ShaderPart {
    name: "double.wgsl",
    source: "
@group(0) @binding(0) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(64)
fn double(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&values) {
        values[id.x] *= 2.0;
    }
}
",
};

#[test]
fn a_compute_shader_runs_and_its_result_comes_back() {
    let context = context();
    let values: Vec<f32> = (0..1000).map(|i| i as f32).collect();
    let buffer =
        StorageBuffer::new(&context, "values", &values, wgpu::BufferUsages::empty()).unwrap();
    let module = Shader::compose("double", &[DOUBLE]).unwrap().module(&context);
    let device = context.device();
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("double"),
        compilation_options: Default::default(),
        cache: None,
    });
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.binding() }],
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(1000_u32.div_ceil(64), 1, 1);
    }
    context.queue().submit([encoder.finish()]);
    let doubled = buffer.read(&context).unwrap();
    assert_eq!(doubled, values.iter().map(|v| 2.0 * v).collect::<Vec<_>>());
}

#[test]
fn odd_byte_counts_round_trip() {
    let context = context();
    let values = [1_u8, 2, 3, 4, 5, 6, 7];
    let buffer =
        StorageBuffer::new(&context, "bytes", &values, wgpu::BufferUsages::empty()).unwrap();
    assert_eq!(buffer.read(&context).unwrap(), values);
}

#[test]
fn refused_commands_become_errors() {
    let context = context();
    // A read-back buffer may not also be a storage buffer.
    let _ = context.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some("impossible"),
        size: 16,
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::STORAGE,
        mapped_at_creation: false,
    });
    let error = context.check().unwrap_err();
    assert!(matches!(error, GpuError::Command { .. }), "{error}");
    assert!(context.check().is_ok(), "a failure is reported once");
}

#[test]
fn an_unknown_name_is_refused_with_the_list() {
    let choice = AdapterChoice::Name("no such adapter".into());
    let error = Context::new(&choice).unwrap_err();
    assert!(matches!(error, GpuError::NoAdapter { .. }), "{error}");
}
