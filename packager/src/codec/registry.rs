//! Makes the library know filters that it does not bring, so that it creates datasets with them. It never
//! runs them: chunks are written and read directly.

use std::ffi::{CStr, c_uint, c_void};
use std::sync::Once;

use hdf5_sys::h5z::{H5Z_CLASS_T_VERS, H5Z_class2_t, H5Zregister};

use super::{BLOSC_FILTER, LZ4_FILTER, ZSTD_FILTER};

const FILTERS: [(i32, &CStr); 3] =
    [(LZ4_FILTER, c"lz4"), (ZSTD_FILTER, c"zstd"), (BLOSC_FILTER, c"blosc")];

/// Registers the filters, once in a process.
pub(crate) fn register() {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        for (id, name) in FILTERS {
            let class = H5Z_class2_t {
                version: H5Z_CLASS_T_VERS as _,
                id,
                encoder_present: 1,
                decoder_present: 1,
                name: name.as_ptr(),
                can_apply: None,
                set_local: None,
                filter: Some(refuse),
            };
            // SAFETY: the library copies the class, whose name and function live as long as the process.
            // A failure shows when a dataset is created with the filter.
            hdf5::sync::sync(|| unsafe { H5Zregister((&raw const class).cast::<c_void>()) });
        }
    });
}

/// Fails, as a filter of HDF5 does by giving 0 bytes.
extern "C" fn refuse(
    _flags: c_uint,
    _parameters: usize,
    _values: *const c_uint,
    _bytes: usize,
    _buffer_bytes: *mut usize,
    _buffer: *mut *mut c_void,
) -> usize {
    0
}
