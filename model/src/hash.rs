//! Content hashes for identities.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::ModelError;

/// Lower-case hexadecimal SHA-256 of some bytes.
pub fn of_bytes(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 of a file's content.
///
/// # Errors
/// [`ModelError::Read`].
pub fn of_file(path: &Path) -> Result<String, ModelError> {
    std::fs::read(path).map(|bytes| of_bytes(&bytes)).map_err(|e| ModelError::read(path, e))
}
