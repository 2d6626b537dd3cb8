//! The jobs of the command line as functions.

use std::path::PathBuf;

use akrobat::CancelToken;
use akrobat::pipeline::{
    self, BackendChoice, Context, EpisodeFilter, EpisodeList, Format, PlanBackend, PlanRequest,
    RenderRequest, Sharing, States,
};
use akrobat::progress::{Progress, Verbosity};
use akrobat_cameras::Modality;
use clap::ValueEnum;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{InputError, to_python};
use crate::host::PythonHost;
use crate::interruptible::run_interruptibly;
use crate::trajectories::{PyTrajectories, plain};

/// Plans a task; see `akrobat.plan`.
#[pyfunction]
#[pyo3(signature = (task, output, *, limit, seed, threads, backend, assets, quiet))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of a Python function")]
pub fn plan(
    py: Python<'_>,
    task: PathBuf,
    output: Option<PathBuf>,
    limit: Option<usize>,
    seed: Option<u64>,
    threads: Option<usize>,
    backend: &str,
    assets: Vec<PathBuf>,
    quiet: bool,
) -> PyResult<PyTrajectories> {
    let backend = choice::<PlanBackend>("backend", backend)?;
    let defaults = PlanRequest::default();
    let request = PlanRequest { task, output, assets, seed, limit, threads, backend, ..defaults };
    let report = run(py, quiet, |context| pipeline::plan(&request, context))?;
    Ok(PyTrajectories::new(report.set))
}

/// Renders a trajectory file; see `akrobat.render`.
#[pyfunction]
#[pyo3(signature = (trajectories, output, *, backend, rig, lighting, variation, variation_seed, appearance, supersampling, detail, sensor, modalities, cloud, seed, format, episodes, manipulation_only, states, storage, resume, threads, assets, quiet))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of a Python function")]
pub fn render<'py>(
    py: Python<'py>,
    trajectories: PathBuf,
    output: PathBuf,
    backend: &str,
    rig: String,
    lighting: String,
    variation: Option<String>,
    variation_seed: u64,
    appearance: Option<PathBuf>,
    supersampling: u32,
    detail: &str,
    sensor: String,
    modalities: Vec<String>,
    cloud: &str,
    seed: u64,
    format: &str,
    episodes: Option<Vec<usize>>,
    manipulation_only: bool,
    states: &str,
    storage: &str,
    resume: bool,
    threads: Option<usize>,
    assets: Vec<PathBuf>,
    quiet: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let request = RenderRequest {
        trajectories,
        output,
        assets,
        backend: choice::<BackendChoice>("backend", backend)?,
        rig: Some(rig),
        lighting: Some(lighting),
        variation,
        variation_seed,
        appearance,
        supersampling: supersampling
            .try_into()
            .map_err(|message| InputError::new_err(format!("supersampling: {message}")))?,
        detail: detail
            .parse()
            .map_err(|message| InputError::new_err(format!("detail: {message}")))?,
        sensor: Some(sensor),
        modalities: modalities.iter().map(|name| modality(name)).collect::<PyResult<_>>()?,
        cloud: serde_json::from_str(cloud)
            .map_err(|e| to_python(akrobat::Error::Usage(format!("cloud: {e}"))))?,
        seed,
        format: choice::<Format>("format", format)?,
        filter: EpisodeFilter {
            episodes: episodes.map(EpisodeList::from),
            ..EpisodeFilter::default()
        },
        manipulation_only,
        states: choice::<States>("states", states)?,
        storage: serde_json::from_str(storage)
            .map_err(|e| InputError::new_err(format!("storage: {e}")))?,
        resume,
        threads,
        sharing: Sharing::Alone,
    };
    let report = run(py, quiet, |context| pipeline::render(&request, context))?;
    plain(py, &report)
}

fn modality(name: &str) -> PyResult<Modality> {
    Modality::from_name(name).ok_or_else(|| {
        let choices = Modality::ALL.map(Modality::name).join(", ");
        let message = format!("unknown modality \"{name}\"; valid choices: {choices}");
        to_python(akrobat::Error::Usage(message))
    })
}

fn run<T: Send>(
    py: Python<'_>,
    quiet: bool,
    job: impl FnOnce(&Context<'_>) -> Result<T, akrobat::Error> + Send,
) -> PyResult<T> {
    let cancel = CancelToken::default();
    let verbosity = if quiet { Verbosity::Quiet } else { Verbosity::Normal };
    let observer = Progress::new(cancel.clone(), verbosity);
    let context = Context { host: Some(&PythonHost), observer: &observer };
    run_interruptibly(py, &cancel, || job(&context))?.map_err(to_python)
}

/// A value of a closed set by the name it has on the command line.
fn choice<T: ValueEnum>(argument: &str, name: &str) -> PyResult<T> {
    T::from_str(name, false).map_err(|_| {
        let choices: Vec<String> = T::value_variants()
            .iter()
            .filter_map(|v| Some(v.to_possible_value()?.get_name().to_owned()))
            .collect();
        let choices = choices.join(", ");
        InputError::new_err(format!("{argument}: unknown \"{name}\"; valid choices: {choices}"))
    })
}

/// Colours of a PNG or JPEG file of exactly this size, row by row.
#[pyfunction]
pub fn decode_color<'py>(
    py: Python<'py>,
    file: &[u8],
    width: u32,
    height: u32,
) -> PyResult<Bound<'py, PyBytes>> {
    let pixels = akrobat_packager::color::decode(file, width, height);
    pixels.map(|pixels| PyBytes::new(py, &pixels)).map_err(InputError::new_err)
}
