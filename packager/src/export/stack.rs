//! Stacks of images in HDF5, one frame a chunk, encoded on all cores.

use std::path::Path;

use hdf5::{Dataset, H5Type};
use rayon::prelude::*;

use crate::codec::Compression;
use crate::error::Result;
use crate::h5::{GroupWriter, write_chunk, write_error};

/// A dataset `[T, …]` that is filled frame by frame.
#[derive(Debug)]
pub(super) struct FrameStack {
    dataset: Dataset,
    element_bytes: usize,
}

impl FrameStack {
    /// An empty stack.
    pub fn create<T: H5Type>(group: &GroupWriter, name: &str, shape: &[usize]) -> Result<Self> {
        let mut chunk = shape.to_vec();
        chunk[0] = 1;
        let dataset = group.chunked::<T>(name, shape, &chunk, Compression::PORTABLE)?;
        Ok(Self { dataset, element_bytes: size_of::<T>() })
    }

    /// The dataset, for attributes.
    pub fn dataset(&self) -> &Dataset {
        &self.dataset
    }
}

/// Frames of one stack: little-endian bytes, from frame `first` on.
pub(super) struct Frames<'a> {
    pub stack: &'a FrameStack,
    pub first: usize,
    pub bytes: Vec<u8>,
}

/// Writes frames of several stacks; the order of the bytes does not depend on the number of threads.
pub(super) fn write(path: &Path, count: usize, stacks: &[Frames<'_>]) -> Result<()> {
    let jobs: Vec<(&FrameStack, usize, &[u8])> = stacks
        .iter()
        .flat_map(|frames| {
            let length = frames.bytes.len() / count.max(1);
            let chunks = frames.bytes.chunks(length.max(1)).enumerate();
            chunks.map(|(i, bytes)| (frames.stack, frames.first + i, bytes))
        })
        .collect();
    let encoded: Vec<Vec<u8>> = jobs
        .par_iter()
        .map(|(stack, _, bytes)| Compression::PORTABLE.encode(bytes, stack.element_bytes))
        .collect();
    for ((stack, frame, _), chunk) in jobs.iter().zip(&encoded) {
        let mut offset = vec![0; stack.dataset.ndim()];
        offset[0] = *frame as u64;
        write_chunk(&stack.dataset, &offset, chunk)
            .map_err(|e| write_error(path, &stack.dataset.name(), &e))?;
    }
    Ok(())
}

/// The bytes of values, little-endian.
pub(super) fn bytes<T: Copy, const N: usize>(values: &[T], to: impl Fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&v| to(v)).collect()
}
