//! Robot files that the demonstration writes.

use std::path::{Path, PathBuf};

use crate::error::{AssetError, make_folder, write_file};

const PILLAR_URDF: &str = include_str!("pillar.urdf");
const PILLAR_TOML: &str = include_str!("pillar.toml");
const TIAGO_TOML: &str = include_str!("../../../configs/robots/tiago.toml");
const GRIPPER_URDF: &str = include_str!("../../../configs/robots/parallel_gripper.urdf");

/// A robot of the demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DemoRobot {
    /// The project's own robot of primitive shapes; needs nothing else.
    Pillar,
    /// TIAGo with a parallel gripper; its meshes are found on the asset search path.
    Tiago,
}

impl DemoRobot {
    /// Name, as in task names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pillar => "pillar",
            Self::Tiago => "tiago",
        }
    }

    /// Writes the robot file and what it needs into `folder`; returns the robot file.
    ///
    /// # Errors
    /// [`AssetError::Write`].
    pub fn write(self, folder: &Path) -> Result<PathBuf, AssetError> {
        make_folder(folder)?;
        let (toml, urdf, urdf_name) = match self {
            Self::Pillar => (PILLAR_TOML, PILLAR_URDF, "pillar.urdf"),
            Self::Tiago => (TIAGO_TOML, GRIPPER_URDF, "parallel_gripper.urdf"),
        };
        write_file(&folder.join(urdf_name), urdf)?;
        let path = folder.join(format!("{}.toml", self.name()));
        write_file(&path, toml)?;
        Ok(path)
    }
}
