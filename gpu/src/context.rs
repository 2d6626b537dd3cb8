//! One opened device.

use std::sync::{Arc, Mutex};

use crate::{AdapterChoice, AdapterDescription, GpuError, adapter};

/// An opened device and its queue. Failures of asynchronous commands are kept until the next
/// [`Context::check`] or [`Context::wait`], instead of ending the process.
#[derive(Debug, Clone)]
pub struct Context {
    device: wgpu::Device,
    queue: wgpu::Queue,
    adapter: AdapterDescription,
    failure: Arc<Mutex<Option<Failure>>>,
}

#[derive(Debug)]
enum Failure {
    Command(String),
    Lost(String),
}

impl Context {
    /// Opens the best adapter that satisfies `choice`, with WebGPU's default limits where the adapter
    /// reaches them, its own where it does not, and its own buffer and texture sizes.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] or [`GpuError::Open`].
    pub fn new(choice: &AdapterChoice) -> Result<Self, GpuError> {
        let (description, adapter) = adapter::choose(choice)?;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("akrobat"),
            required_limits: limits(&adapter.limits()),
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| {
                GpuError::Open { adapter: description.to_string(), message: error.to_string() }
            })?;
        let failure = Arc::new(Mutex::new(None));
        keep_failures(&device, &failure);
        Ok(Self { device, queue, adapter: description, failure })
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// The device's queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Which adapter this is.
    pub fn adapter(&self) -> &AdapterDescription {
        &self.adapter
    }

    /// Blocks until all submitted work is done.
    ///
    /// # Errors
    /// [`GpuError::Command`] or [`GpuError::Lost`] where anything failed since the last check.
    pub fn wait(&self) -> Result<(), GpuError> {
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        polled.map(|_| ()).map_err(|error| GpuError::Command { message: error.to_string() })
    }

    /// Reports the first failure since the last check.
    ///
    /// # Errors
    /// [`GpuError::Command`] or [`GpuError::Lost`].
    pub fn check(&self) -> Result<(), GpuError> {
        let failure = self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take();
        match failure {
            None => Ok(()),
            Some(Failure::Command(message)) => Err(GpuError::Command { message }),
            Some(Failure::Lost(message)) => Err(GpuError::Lost { message }),
        }
    }
}

/// WebGPU's default limits as far as the adapter has them; sizes of buffers and textures as large
/// as it has.
fn limits(available: &wgpu::Limits) -> wgpu::Limits {
    wgpu::Limits {
        max_buffer_size: available.max_buffer_size,
        max_storage_buffer_binding_size: available.max_storage_buffer_binding_size,
        ..wgpu::Limits::defaults()
            .or_worse_values_from(available)
            .using_resolution(available.clone())
    }
}

fn keep_failures(device: &wgpu::Device, failure: &Arc<Mutex<Option<Failure>>>) {
    let keep = |slot: &Mutex<Option<Failure>>, new: Failure| {
        slot.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get_or_insert(new);
    };
    let slot = failure.clone();
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        keep(&slot, Failure::Command(error.to_string()));
    }));
    let slot = failure.clone();
    device.set_device_lost_callback(move |reason, message| {
        // Dropping the device also "loses" it; nobody is left to care.
        if reason != wgpu::DeviceLostReason::Destroyed {
            keep(&slot, Failure::Lost(message));
        }
    });
}
