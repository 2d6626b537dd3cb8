//! Where tests find the shared real inputs (robots, objects, scenes).

use std::path::{Path, PathBuf};

/// The folder of shared inputs: `$AKROBAT_SHARED_ASSETS`, or `../shared/assets` beside the
/// checkout. `None`, with a message on stderr, where it is absent.
///
/// # Panics
/// Where `$AKROBAT_REQUIRE_SHARED` is set (as CI does) and the folder is absent.
pub fn shared_assets() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets");
    let folder = std::env::var_os("AKROBAT_SHARED_ASSETS").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(
        std::env::var_os("AKROBAT_REQUIRE_SHARED").is_none(),
        "shared inputs are required but {} is absent",
        folder.display()
    );
    eprintln!("skipped: shared inputs absent at {}", folder.display());
    None
}
