//! Typed data on the device and back.

use std::marker::PhantomData;

use bytemuck::Pod;

use crate::{Context, GpuError};

/// An array of `T` in device memory, bound to shaders as `array<T>`. `T`'s layout must be the one
/// WGSL gives it (`vec3` takes 16 bytes, for example).
#[derive(Debug)]
pub struct StorageBuffer<T> {
    buffer: wgpu::Buffer,
    len: usize,
    element: PhantomData<T>,
}

impl<T: Pod> StorageBuffer<T> {
    /// Stores `values`; further `usage`s (vertices, indices, …) may be added.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the device cannot hold them in one buffer.
    pub fn new(
        context: &Context,
        label: &str,
        values: &[T],
        usage: wgpu::BufferUsages,
    ) -> Result<Self, GpuError> {
        let this = Self::zeroed(context, label, values.len(), usage)?;
        this.write(context, values);
        Ok(this)
    }

    /// `len` elements, all bytes zero.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the device cannot hold them in one buffer.
    pub fn zeroed(
        context: &Context,
        label: &str,
        len: usize,
        usage: wgpu::BufferUsages,
    ) -> Result<Self, GpuError> {
        // A binding may not be empty, and copies go by four bytes.
        let size = (len * size_of::<T>()).max(size_of::<T>()).next_multiple_of(4) as u64;
        let limits = context.device().limits();
        let available = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
        if size > available {
            return Err(GpuError::TooLarge {
                what: format!("buffer \"{label}\""),
                needed: format!("{size} bytes"),
                available: format!("{available} bytes"),
            });
        }
        let buffer = context.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage: usage
                | wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Ok(Self { buffer, len, element: PhantomData })
    }

    /// Replaces the first `values.len()` elements, before any work submitted later.
    ///
    /// # Panics
    /// Where `values` is longer than the buffer.
    pub fn write(&self, context: &Context, values: &[T]) {
        assert!(values.len() <= self.len, "{} values into {} places", values.len(), self.len);
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let whole = bytes.len() / 4 * 4;
        context.queue().write_buffer(&self.buffer, 0, &bytes[..whole]);
        if whole < bytes.len() {
            let mut last = [0; 4];
            last[..bytes.len() - whole].copy_from_slice(&bytes[whole..]);
            context.queue().write_buffer(&self.buffer, whole as u64, &last);
        }
    }

    /// Copies all elements back; blocks until earlier work is done.
    ///
    /// # Errors
    /// [`GpuError`] where earlier work or the copy failed.
    pub fn read(&self, context: &Context) -> Result<Vec<T>, GpuError> {
        let readback = Readback::new(context, self.buffer.size())?;
        let mut encoder = context.device().create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&self.buffer, 0, readback.buffer(), 0, self.buffer.size());
        context.queue().submit([encoder.finish()]);
        readback.read(context, |bytes| {
            let mut values = vec![T::zeroed(); self.len];
            let target: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
            target.copy_from_slice(&bytes[..target.len()]);
            values
        })
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True without elements.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The whole buffer, to bind.
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        self.buffer.as_entire_binding()
    }

    /// The raw buffer, for vertex and index slots and copies.
    pub fn raw(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}

/// Memory that the device copies into and the CPU reads.
#[derive(Debug)]
pub struct Readback {
    buffer: wgpu::Buffer,
}

impl Readback {
    /// Room for `size` bytes, a multiple of 4.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the device cannot hold them in one buffer.
    pub fn new(context: &Context, size: u64) -> Result<Self, GpuError> {
        let available = context.device().limits().max_buffer_size;
        if size > available {
            return Err(GpuError::TooLarge {
                what: "the memory for reading results back".into(),
                needed: format!("{size} bytes"),
                available: format!("{available} bytes"),
            });
        }
        let buffer = context.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some("readback"),
            size,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Ok(Self { buffer })
    }

    /// The target of copy commands.
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Blocks until all submitted work is done and hands the bytes to `take`.
    ///
    /// # Errors
    /// [`GpuError`] where the work or the mapping failed.
    pub fn read<R>(&self, context: &Context, take: impl FnOnce(&[u8]) -> R) -> Result<R, GpuError> {
        let (sender, receiver) = std::sync::mpsc::channel();
        self.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone only if waiting failed, which is reported there.
            let _ = sender.send(result);
        });
        context.wait()?;
        let failed = |message: String| GpuError::Command { message };
        receiver
            .recv()
            .map_err(|_| failed("the read-back was never answered".into()))?
            .map_err(|error| failed(error.to_string()))?;
        let view = self.buffer.get_mapped_range(..).map_err(|error| failed(error.to_string()))?;
        let taken = take(&view);
        drop(view);
        self.buffer.unmap();
        Ok(taken)
    }
}
