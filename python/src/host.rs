//! What the Python package does for the command line.

use std::path::{Path, PathBuf};

use akrobat::pipeline::{EvalJob, ReplayJob, ViewJob};
use akrobat::{ConvertedStage, Error, Host, SapienShaders};
use akrobat_model::TrajectorySet;
use akrobat_packager::audit_file::EpisodeAudit;
use akrobat_packager::export::{ExportFormat, ExportHeader, Sink};
use akrobat_packager::import::Recordings;
use akrobat_renderer::{Backend, RenderError};
use pyo3::prelude::*;

use crate::export::PythonSink;
use crate::physics;
use crate::sapien::SapienBackend;

/// The host that hands work back to Python.
pub struct PythonHost;

impl Host for PythonHost {
    fn asset_folders(&self) -> Vec<PathBuf> {
        // Without the folders, a file that is needed is reported missing, with what was tried.
        Python::attach(|py| {
            py.import("akrobat.assets")?.call_method0("installed_asset_folders")?.extract()
        })
        .unwrap_or_default()
    }

    fn sapien_backend(&self, shaders: SapienShaders) -> Result<Box<dyn Backend>, RenderError> {
        Ok(Box::new(SapienBackend::new(shaders)?))
    }

    fn replay(
        &self,
        job: &ReplayJob<'_>,
        sink: &mut dyn FnMut(EpisodeAudit) -> bool,
    ) -> Result<serde_json::Value, Error> {
        physics::replay(job, sink)
    }

    fn evaluate(
        &self,
        job: &EvalJob,
        sink: &mut dyn FnMut(serde_json::Value) -> bool,
    ) -> Result<serde_json::Value, Error> {
        physics::evaluate(job, sink)
    }

    fn export_sink(
        &self,
        format: ExportFormat,
        folder: &Path,
        header: &ExportHeader,
    ) -> Result<Box<dyn Sink>, Error> {
        Ok(Box::new(PythonSink::open(format, folder, header)?))
    }

    fn write_traj_data(&self, file: &Path, set: &TrajectorySet) -> Result<(), Error> {
        crate::export::write_traj_data(file, set)
    }

    fn read_traj_data(&self, file: &Path) -> Result<Recordings, Error> {
        crate::export::read_traj_data(file)
    }

    fn usd_to_urdf(&self, stage: &Path, folder: &Path) -> Result<ConvertedStage, Error> {
        Python::attach(|py| {
            let module = py.import("akrobat.usd")?;
            let paths = (stage.to_string_lossy(), folder.to_string_lossy());
            let (urdf, repairs, lost): (PathBuf, Vec<String>, Vec<String>) =
                module.call_method1("to_urdf", paths)?.extract()?;
            Ok(ConvertedStage { urdf, repairs, lost })
        })
        .map_err(crate::export::usage_error)
    }

    fn view(&self, job: &ViewJob<'_>) -> Result<Vec<String>, Error> {
        crate::viewer::view(job)
    }
}
