//! HDF5 files as this project writes them: format 1.10, no object times, checksummed metadata and
//! chunks, and errors that name file and dataset.

mod chunks;
mod digest;
mod read;
mod write;

pub(crate) use digest::{DIGEST_ATTRIBUTE, digest};
pub(crate) use read::H5Reader;
pub(crate) use write::{GroupWriter, H5Writer};

use std::path::Path;

use crate::error::PackError;

/// Largest ratios by which deflate and any other codec that we read can shrink data. (Zstandard: a block of
/// 128 KiB of one value takes 4 bytes.)
const DEFLATE_MAX_RATIO: u64 = 1032;
const MAX_RATIO: u64 = 32768;

/// The system's error number in an HDF5 error, whose frames state it as `errno = N`.
fn os_error(error: &hdf5::Error) -> Option<std::io::Error> {
    let stack = error.stack()?;
    let code = stack.iter().find_map(|frame| {
        let digits = frame.desc().split_once("errno = ")?.1;
        let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
        digits[..end].parse::<i32>().ok()
    })?;
    (code != 0).then(|| std::io::Error::from_raw_os_error(code))
}

/// The innermost frame says what happened; the outermost only which call failed.
fn message(error: &hdf5::Error) -> String {
    match error.stack().as_deref().and_then(|frames| frames.last().cloned()) {
        Some(frame) => frame.desc().to_owned(),
        None => error.to_string(),
    }
}

/// An error of writing `item`.
pub(crate) fn write_error(path: &Path, item: &str, error: &hdf5::Error) -> PackError {
    match os_error(error) {
        Some(source) => PackError::io(path, source),
        None => PackError::Library {
            path: path.to_path_buf(),
            item: item.to_owned(),
            message: message(error),
        },
    }
}

/// An error of reading `item`.
pub(crate) fn read_error(path: &Path, item: &str, error: &hdf5::Error) -> PackError {
    PackError::damaged(path, format!("{item}: {}", message(error)))
}

/// Writes a chunk that is already encoded for the dataset's filters, at element `offset`.
pub(crate) fn write_chunk(
    dataset: &hdf5::Dataset,
    offset: &[u64],
    chunk: &[u8],
) -> hdf5::Result<()> {
    const ALL_FILTERS: u32 = 0;
    assert_eq!(offset.len(), dataset.ndim(), "one offset per axis");
    hdf5::sync::sync(|| {
        // SAFETY: the dataset is open, `offset` has one value per axis, and `chunk` outlives the call,
        // which reads exactly its length.
        let status = unsafe {
            hdf5_sys::h5d::H5Dwrite_chunk(
                dataset.id(),
                hdf5_sys::h5p::H5P_DEFAULT,
                ALL_FILTERS,
                offset.as_ptr(),
                chunk.len(),
                chunk.as_ptr().cast(),
            )
        };
        if status < 0 { Err(hdf5::Error::query()?) } else { Ok(()) }
    })
}

/// Reads a chunk as it is stored, by the offset of its first element. `None` where it was never written.
pub(crate) fn read_chunk(
    dataset: &hdf5::Dataset,
    offset: &[u64],
    limit: u64,
) -> hdf5::Result<Option<Vec<u8>>> {
    assert_eq!(offset.len(), dataset.ndim(), "one offset per axis");
    hdf5::sync::sync(|| {
        let (mut mask, mut address, mut size) = (0, 0, 0);
        // SAFETY: the dataset is open, `offset` has one value per axis, and the results outlive the call.
        let status = unsafe {
            hdf5_sys::h5d::H5Dget_chunk_info_by_coord(
                dataset.id(),
                offset.as_ptr(),
                &raw mut mask,
                &raw mut address,
                &raw mut size,
            )
        };
        if status < 0 {
            return Err(hdf5::Error::query()?);
        }
        if address == hdf5_sys::h5::HADDR_UNDEF {
            return Ok(None);
        }
        if mask != 0 || size > limit {
            return Err(format!("a chunk claims {size} bytes with filter mask {mask}").into());
        }
        let mut chunk = vec![0u8; size as usize];
        let mut length = chunk.len();
        // SAFETY: as above, and the buffer holds the size that the library itself has just stated.
        let status = unsafe {
            hdf5_sys::h5d::H5Dread_chunk2(
                dataset.id(),
                hdf5_sys::h5p::H5P_DEFAULT,
                offset.as_ptr(),
                &raw mut mask,
                chunk.as_mut_ptr().cast(),
                &raw mut length,
            )
        };
        if status < 0 { Err(hdf5::Error::query()?) } else { Ok(Some(chunk)) }
    })
}
