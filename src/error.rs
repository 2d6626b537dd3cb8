//! Every error of the command line, and the exit code it stands for.

use akrobat_judge::JudgeError;
use akrobat_model::ModelError;
use akrobat_packager::PackError;
use akrobat_renderer::RenderError;
use akrobat_renderer::lighting::LightingError;

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExitCode {
    /// Everything asked for was done.
    Done = 0,
    /// The machine failed: full disk, lost device, interruption.
    Failed = 1,
    /// The user's input was wrong, or the command line was.
    BadInput = 2,
    /// Finished, but something was lost or skipped.
    Incomplete = 3,
}

/// Why a command could not do its job.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file or value of the user's is wrong.
    #[error(transparent)]
    Input(#[from] ModelError),
    /// A file of ours could not be read or written.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// The judge cannot be built for a task.
    #[error("judge: {0}")]
    Judge(#[from] JudgeError),
    /// Rendering failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A lighting or a variation of it cannot be used.
    #[error(transparent)]
    Lighting(#[from] LightingError),
    /// The request is wrong in itself; the whole message.
    #[error("{0}")]
    Usage(String),
    /// The machine failed; the whole message.
    #[error("{0}")]
    Failed(String),
    /// The user asked to stop; says what was left behind.
    #[error("interrupted: {0}")]
    Interrupted(String),
}

impl Error {
    /// The exit code of this error.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::Input(_) | Self::Judge(_) | Self::Lighting(_) | Self::Usage(_) => {
                ExitCode::BadInput
            }
            Self::Failed(_) | Self::Interrupted(_) => ExitCode::Failed,
            Self::Pack(error) if error.exit_code() == ExitCode::BadInput as i32 => {
                ExitCode::BadInput
            }
            Self::Pack(_) | Self::Render(RenderError::Device { .. }) => ExitCode::Failed,
            Self::Render(_) => ExitCode::BadInput,
        }
    }

    /// The error of a failed write: a wrong path is the user's, everything else the machine's.
    pub fn write(path: &std::path::Path, source: &std::io::Error) -> Self {
        use std::io::ErrorKind as Kind;
        let message = format!("{}: cannot write: {source}", path.display());
        match source.kind() {
            Kind::NotFound
            | Kind::PermissionDenied
            | Kind::NotADirectory
            | Kind::IsADirectory
            | Kind::ReadOnlyFilesystem
            | Kind::InvalidFilename => Self::Usage(message),
            _ => Self::Failed(message),
        }
    }
}
