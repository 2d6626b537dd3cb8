//! What only Python can do, behind one trait that the Python package implements and hands in.

use std::path::PathBuf;

use akrobat_renderer::{Backend, RenderError};

/// Work that needs Python. The pure binary has no host and says which command to run instead.
///
/// A host is called per batch of frames or per episode, never per frame.
pub trait Host: Sync {
    /// Folders of robot and object files that installed Python packages bring.
    fn asset_folders(&self) -> Vec<PathBuf>;

    /// A renderer that draws with SAPIEN.
    ///
    /// # Errors
    /// [`RenderError::Device`] where SAPIEN is not installed or finds no usable Vulkan driver.
    fn sapien_backend(&self) -> Result<Box<dyn Backend>, RenderError>;
}
