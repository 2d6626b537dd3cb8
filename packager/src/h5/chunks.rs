//! Reading rows of chunked datasets on all cores, within bounds that the shape sets.

use std::ops::Range;

use bytemuck::Pod;
use hdf5::filters::Filter;
use hdf5::{Dataset, H5Type, Hyperslab, SliceOrIndex};
use rayon::prelude::*;

use super::read::H5Reader;
use super::{read_chunk, read_error};
use crate::codec;
use crate::error::{PackError, Result};

/// Largest chunk that is read, bytes: an image of 8192 x 8192 pixels of 16 bytes.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// Encoded chunks may be larger than their content by less than this.
const MAX_OVERHEAD: u64 = 1 << 16;

/// A dataset whose chunks span whole rows.
struct Chunked {
    rows_per_chunk: usize,
    chunk_bytes: usize,
    filters: Vec<Filter>,
}

impl H5Reader {
    /// Values of rows `rows` along the first axis of a dataset of type `T`.
    pub fn rows<T: H5Type + Pod>(
        &self,
        name: &str,
        dataset: &Dataset,
        rows: Range<usize>,
    ) -> Result<Vec<T>> {
        let shape = dataset.get_shape().map_err(|e| read_error(self.path(), name, &e))?;
        if rows.is_empty() || shape.contains(&0) {
            return Ok(Vec::new());
        }
        match self.chunked::<T>(name, dataset, &shape)? {
            Some(chunked) => self.decoded_rows(name, dataset, &chunked, rows, &shape),
            None => self.sliced_rows(name, dataset, rows, &shape),
        }
    }

    fn chunked<T>(
        &self,
        name: &str,
        dataset: &Dataset,
        shape: &[usize],
    ) -> Result<Option<Chunked>> {
        let Some(chunk) = dataset.chunk().filter(|chunk| chunk[1..] == shape[1..]) else {
            return Ok(None);
        };
        let bytes = chunk.iter().try_fold(size_of::<T>() as u64, |n, &d| n.checked_mul(d as u64));
        match bytes {
            Some(bytes) if bytes > 0 && bytes <= MAX_CHUNK_BYTES => Ok(Some(Chunked {
                rows_per_chunk: chunk[0],
                chunk_bytes: bytes as usize,
                filters: dataset.filters(),
            })),
            _ => {
                let expected = format!("chunks of at most {MAX_CHUNK_BYTES} bytes");
                Err(PackError::content(self.path(), name, expected, format!("chunks {chunk:?}")))
            }
        }
    }

    fn decoded_rows<T: Pod>(
        &self,
        name: &str,
        dataset: &Dataset,
        chunked: &Chunked,
        rows: Range<usize>,
        shape: &[usize],
    ) -> Result<Vec<T>> {
        let &Chunked { rows_per_chunk, chunk_bytes, ref filters } = chunked;
        let chunks = rows.start / rows_per_chunk..rows.end.div_ceil(rows_per_chunk);
        let decoded = chunks.clone().into_par_iter().map(|index| {
            let mut offset = vec![0; shape.len()];
            offset[0] = (index * rows_per_chunk) as u64;
            let limit = chunk_bytes as u64 + chunk_bytes as u64 / 8 + MAX_OVERHEAD;
            let stored = read_chunk(dataset, &offset, limit)
                .map_err(|e| read_error(self.path(), name, &e))?;
            let damaged = |message: &str| {
                let first = index * rows_per_chunk;
                PackError::damaged(
                    self.path(),
                    format!("{name}: the chunk of row {first} {message}"),
                )
            };
            let stored = stored.ok_or_else(|| damaged("was never written"))?;
            codec::decode(filters, stored, size_of::<T>(), chunk_bytes).map_err(|m| damaged(&m))
        });
        let decoded = decoded.collect::<Result<Vec<Vec<u8>>>>()?;
        let row_bytes = chunk_bytes / rows_per_chunk;
        let mut values = Vec::with_capacity(rows.len() * row_bytes / size_of::<T>());
        for (index, bytes) in chunks.zip(&decoded) {
            let first = index * rows_per_chunk;
            let wanted = rows.start.max(first) - first..(rows.end - first).min(rows_per_chunk);
            let bytes = &bytes[wanted.start * row_bytes..wanted.end * row_bytes];
            values
                .extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
        }
        Ok(values)
    }

    /// Through the library: for what is not chunked along its first axis alone.
    fn sliced_rows<T: H5Type>(
        &self,
        name: &str,
        dataset: &Dataset,
        rows: Range<usize>,
        shape: &[usize],
    ) -> Result<Vec<T>> {
        let mut selection = vec![SliceOrIndex::from(rows)];
        selection.extend(shape[1..].iter().map(|&length| SliceOrIndex::from(0..length)));
        let values = dataset
            .read_slice::<T, _, ndarray::IxDyn>(Hyperslab::from(selection))
            .map_err(|e| read_error(self.path(), name, &e))?;
        Ok(values.into_iter().collect())
    }
}
