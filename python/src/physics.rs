//! Physics and trials: hands jobs to `akrobat.physics` and `akrobat.evaluate`, takes episodes back.

use std::collections::BTreeMap;

use akrobat::Error;
use akrobat::pipeline::{EvalJob, PhysicsConfig, ReplayJob};
use akrobat_packager::audit_file::{EpisodeAudit, Trace};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{InputError, RunError};
use crate::trajectories::plain;

/// The settings of a replay: the defaults with some values replaced.
#[pyfunction]
pub fn physics_config<'py>(
    py: Python<'py>,
    values: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyAny>> {
    let text: String = py.import("json")?.call_method1("dumps", (values,))?.extract()?;
    let config: PhysicsConfig = serde_json::from_str(&text)
        .map_err(|error| InputError::new_err(format!("physics settings: {error}")))?;
    config.check().map_err(|m| InputError::new_err(format!("physics settings: {m}")))?;
    plain(py, &config)
}

/// Runs `akrobat.physics.replay.replay_all`.
pub fn replay(
    job: &ReplayJob<'_>,
    sink: &mut dyn FnMut(EpisodeAudit) -> bool,
) -> Result<serde_json::Value, Error> {
    Python::attach(|py| {
        let module = py.import("akrobat.physics.replay")?;
        let arguments = (
            job.trajectories,
            job.episodes.to_vec(),
            plain(py, job.config)?,
            job.assets.to_vec(),
            job.workers,
        );
        let run = module.getattr("ReplayRun")?.call1(arguments)?;
        for episode in run.try_iter()? {
            if !sink(episode_audit(&episode?)?) {
                run.call_method0("stop")?;
                break;
            }
        }
        value(py, &run.getattr("world")?)
    })
    .map_err(to_rust)
}

/// Runs `akrobat.evaluate.Evaluation`.
pub fn evaluate(
    job: &EvalJob,
    sink: &mut dyn FnMut(serde_json::Value) -> bool,
) -> Result<serde_json::Value, Error> {
    Python::attach(|py| {
        let module = py.import("akrobat.evaluate")?;
        let run = module.getattr("Evaluation")?.call1((plain(py, job)?,))?;
        for row in run.try_iter()? {
            if !sink(value(py, &row?)?) {
                return Ok(serde_json::Value::Null);
            }
        }
        value(py, &run.call_method0("finish")?)
    })
    .map_err(to_rust)
}

fn value(py: Python<'_>, object: &Bound<'_, PyAny>) -> PyResult<serde_json::Value> {
    let text: String = py.import("json")?.call_method1("dumps", (object,))?.extract()?;
    serde_json::from_str(&text).map_err(|error| RunError::new_err(error.to_string()))
}

fn episode_audit(audit: &Bound<'_, PyAny>) -> PyResult<EpisodeAudit> {
    let py = audit.py();
    let columns: BTreeMap<String, Vec<String>> = audit.getattr("columns")?.extract()?;
    let traces: BTreeMap<String, PyReadonlyArray2<'_, f32>> = audit.getattr("traces")?.extract()?;
    let traces = traces.iter().map(|(name, table)| {
        let trace = Trace {
            columns: columns.get(name).cloned().unwrap_or_default(),
            width: table.shape()[1],
            values: table.as_slice()?.to_vec(),
        };
        Ok((name.clone(), trace))
    });
    let phase: PyReadonlyArray1<'_, u8> = audit.getattr("phase")?.extract()?;
    Ok(EpisodeAudit {
        episode: audit.getattr("episode")?.extract()?,
        id: audit.getattr("id")?.extract()?,
        success: audit.getattr("success")?.extract()?,
        reason: audit.getattr("reason")?.extract()?,
        findings: value(py, &audit.getattr("findings")?)?,
        phase: phase.as_slice()?.to_vec(),
        traces: traces.collect::<PyResult<_>>()?,
    })
}

/// Input errors stay input errors; what the policy or the engine raised is a failure.
fn to_rust(error: PyErr) -> Error {
    Python::attach(|py| {
        if error.is_instance_of::<InputError>(py) {
            Error::Usage(error.value(py).to_string())
        } else if error.is_instance_of::<RunError>(py) {
            Error::Failed(error.value(py).to_string())
        } else if error.is_instance_of::<pyo3::exceptions::PyKeyboardInterrupt>(py) {
            Error::Interrupted("nothing was written".into())
        } else {
            let trace = error.traceback(py).and_then(|trace| trace.format().ok());
            Error::Failed(format!("{}{error}", trace.unwrap_or_default()))
        }
    })
}
