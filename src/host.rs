//! What only Python can do, behind one trait that the Python package implements and hands in.

use std::path::{Path, PathBuf};

use akrobat_model::TrajectorySet;
use akrobat_packager::audit_file::EpisodeAudit;
use akrobat_packager::export::{ExportFormat, ExportHeader, Sink};
use akrobat_packager::import::Recordings;
use akrobat_renderer::{Backend, RenderError};

use crate::Error;
use crate::pipeline::{EvalJob, ReplayJob, ViewJob};

/// Which of SAPIEN's shaders make the colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SapienShaders {
    /// The fastest.
    Minimal,
    /// Deferred shading, ManiSkill's default for pictures.
    Default,
    /// Path tracing.
    Rt,
}

impl SapienShaders {
    /// SAPIEN's name of the pack.
    pub fn pack(self) -> &'static str {
        match self {
            Self::Minimal => "minimal",
            Self::Default => "default",
            Self::Rt => "rt",
        }
    }

    /// Name of the backend.
    pub fn backend(self) -> &'static str {
        match self {
            Self::Minimal => "sapien",
            Self::Default => "sapien-default",
            Self::Rt => "sapien-rt",
        }
    }
}

/// A USD stage that was written as a URDF.
#[derive(Debug, Clone)]
pub struct ConvertedStage {
    /// The URDF.
    pub urdf: PathBuf,
    /// What was repaired.
    pub repairs: Vec<String>,
    /// What could not be taken over.
    pub lost: Vec<String>,
}

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
    fn sapien_backend(&self, shaders: SapienShaders) -> Result<Box<dyn Backend>, RenderError>;

    /// Drives trajectories through physics. `sink` takes each episode as it ends, in any order, and
    /// returns whether to go on. Returns what the world was made of.
    ///
    /// # Errors
    /// Where the physics engine is not installed or fails.
    fn replay(
        &self,
        job: &ReplayJob<'_>,
        sink: &mut dyn FnMut(EpisodeAudit) -> bool,
    ) -> Result<serde_json::Value, Error>;

    /// Tries a policy in closed loop and writes tables, videos and a plot into the job's folder. `sink`
    /// takes each trial's row as it ends and returns whether to go on. Returns the summary.
    ///
    /// # Errors
    /// Where the policy cannot be loaded or the physics engine is not installed.
    fn evaluate(
        &self,
        job: &EvalJob,
        sink: &mut dyn FnMut(serde_json::Value) -> bool,
    ) -> Result<serde_json::Value, Error>;

    /// A writer of a format that needs a Python library, into an empty folder.
    ///
    /// # Errors
    /// [`Error::Usage`] where the library is not installed, with what to install.
    fn export_sink(
        &self,
        format: ExportFormat,
        folder: &Path,
        header: &ExportHeader,
    ) -> Result<Box<dyn Sink>, Error>;

    /// Writes trajectories as AutoMoMa's `traj_data.pt`.
    ///
    /// # Errors
    /// Where the file cannot be written.
    fn write_traj_data(&self, file: &Path, set: &TrajectorySet) -> Result<(), Error>;

    /// Reads AutoMoMa's `traj_data.pt`.
    ///
    /// # Errors
    /// [`Error::Usage`] where the file is not of that kind.
    fn read_traj_data(&self, file: &Path) -> Result<Recordings, Error>;

    /// Writes a USD stage as a URDF with meshes into a folder.
    ///
    /// # Errors
    /// [`Error::Usage`] where the stage cannot be read or usd-core is not installed, with what to install.
    fn usd_to_urdf(&self, stage: &Path, folder: &Path) -> Result<ConvertedStage, Error>;

    /// Shows a trajectory or an episode with Rerun. Returns the names of the cameras with images.
    ///
    /// # Errors
    /// [`Error::Usage`] where Rerun is not installed, with what to install.
    fn view(&self, job: &ViewJob<'_>) -> Result<Vec<String>, Error>;
}
