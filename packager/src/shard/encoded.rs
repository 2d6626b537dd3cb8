//! Colour images as files in a shard: `<camera>_rgb_encoded` holds the bytes of all frames' files, one
//! after the other, and `<camera>_rgb_offsets` `[T + 1]` where each begins.

use std::path::Path;

use hdf5::Dataset;

use crate::codec;
use crate::error::{PackError, Result};
use crate::h5::{GroupWriter, write_chunk, write_error};

/// Bytes of a chunk; the last one is padded.
const CHUNK_BYTES: usize = 64 << 10;

/// One camera's files, being written.
#[derive(Debug)]
pub(super) struct EncodedImages {
    dataset: Dataset,
    /// What does not fill a chunk yet.
    tail: Vec<u8>,
    chunks: usize,
    offsets: Vec<u64>,
}

impl EncodedImages {
    pub fn create(
        group: &GroupWriter,
        camera: &str,
        format: &str,
        [height, width]: [u32; 2],
    ) -> Result<Self> {
        let dataset = group.growing_bytes(&format!("{camera}_rgb_encoded"), CHUNK_BYTES)?;
        group.dataset_attr_str(&dataset, "encoding", format)?;
        group.dataset_attr(&dataset, "height", height)?;
        group.dataset_attr(&dataset, "width", width)?;
        Ok(Self { dataset, tail: Vec::new(), chunks: 0, offsets: vec![0] })
    }

    pub fn push(&mut self, path: &Path, file: &[u8]) -> Result<()> {
        let end = self.offsets.last().expect("the first is there from the beginning");
        self.offsets.push(end + file.len() as u64);
        self.tail.extend_from_slice(file);
        let whole = self.tail.len() - self.tail.len() % CHUNK_BYTES;
        let rest = self.tail.split_off(whole);
        let full = std::mem::replace(&mut self.tail, rest);
        full.chunks_exact(CHUNK_BYTES).try_for_each(|chunk| self.write(path, chunk.to_vec()))
    }

    fn write(&mut self, path: &Path, mut chunk: Vec<u8>) -> Result<()> {
        let error = |e| write_error(path, &self.dataset.name(), &e);
        let first = self.chunks * CHUNK_BYTES;
        self.dataset.resize((first + chunk.len(),)).map_err(error)?;
        chunk.resize(CHUNK_BYTES, 0);
        codec::append_checksum(&mut chunk);
        write_chunk(&self.dataset, &[first as u64], &chunk).map_err(error)?;
        self.chunks += 1;
        Ok(())
    }

    pub fn finish(mut self, path: &Path, group: &GroupWriter, camera: &str) -> Result<()> {
        let tail = std::mem::take(&mut self.tail);
        if !tail.is_empty() {
            self.write(path, tail)?;
        }
        group.array(&format!("{camera}_rgb_offsets"), &[self.offsets.len()], &self.offsets)?;
        Ok(())
    }
}

/// An image that cannot be encoded.
pub(super) fn encode_error(path: &Path, camera: &str, error: &image::ImageError) -> PackError {
    PackError::Library {
        path: path.to_path_buf(),
        item: format!("colour image of {camera}"),
        message: error.to_string(),
    }
}
