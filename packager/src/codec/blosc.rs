//! The registered Blosc filter (32001): chunks are Blosc 1 buffers with bit shuffle and LZ4.

use std::ffi::{CStr, c_int, c_void};

/// Compressor inside Blosc.
const COMPRESSOR: &CStr = c"lz4";

/// Blosc's number of that compressor, as the filter's parameters state it.
const COMPRESSOR_CODE: u32 = 1;

/// Blosc's number of the bit shuffle.
const BIT_SHUFFLE: c_int = 2;

/// Versions of filter and format, element and chunk size in bytes, level, shuffle, compressor.
pub(super) fn parameters(element_size: usize, chunk_bytes: usize, level: u32) -> Vec<u32> {
    const FILTER_VERSION: u32 = 2;
    const FORMAT_VERSION: u32 = 2;
    let shuffle = BIT_SHUFFLE as u32;
    let (element, chunk) = (element_size as u32, chunk_bytes as u32);
    vec![FILTER_VERSION, FORMAT_VERSION, element, chunk, level, shuffle, COMPRESSOR_CODE]
}

/// Encodes a chunk.
pub(super) fn encode(raw: &[u8], element_size: usize, level: u8) -> Vec<u8> {
    let mut stored = vec![0u8; raw.len() + blosc_src::BLOSC_MAX_OVERHEAD as usize];
    // SAFETY: both buffers are valid for the lengths that are passed, the name is NUL-terminated, and the
    // context variant of the call shares no state between threads.
    let size = unsafe {
        blosc_src::blosc_compress_ctx(
            c_int::from(level),
            BIT_SHUFFLE,
            element_size,
            raw.len(),
            raw.as_ptr().cast::<c_void>(),
            stored.as_mut_ptr().cast::<c_void>(),
            stored.len(),
            COMPRESSOR.as_ptr(),
            0,
            1,
        )
    };
    assert!(size > 0, "a buffer of the documented overhead always suffices");
    stored.truncate(size as usize);
    stored
}

/// Decodes a chunk of `chunk_bytes` bytes.
pub(super) fn decode(stored: &[u8], chunk_bytes: usize) -> Result<Vec<u8>, String> {
    let mut raw_bytes = 0usize;
    // SAFETY: the buffer is valid for its length, which is what the call reads at most.
    let status = unsafe {
        blosc_src::blosc_cbuffer_validate(
            stored.as_ptr().cast::<c_void>(),
            stored.len(),
            &raw mut raw_bytes,
        )
    };
    if status != 0 || raw_bytes != chunk_bytes {
        return Err(format!("Blosc: claims {raw_bytes} bytes"));
    }
    let mut raw = vec![0u8; chunk_bytes];
    // SAFETY: the header was found to agree with the buffer's length, and Blosc checks every block's
    // place against it; the output is valid for the length that is passed.
    let size = unsafe {
        blosc_src::blosc_decompress_ctx(
            stored.as_ptr().cast::<c_void>(),
            raw.as_mut_ptr().cast::<c_void>(),
            raw.len(),
            1,
        )
    };
    if usize::try_from(size) == Ok(chunk_bytes) {
        return Ok(raw);
    }
    Err(format!("Blosc: decoding failed with {size}"))
}
