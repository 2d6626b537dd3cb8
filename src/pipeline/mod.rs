//! The stages composed into the jobs that the command line and the Python package offer.

mod bench_plan;
mod demo;
mod episodes;
mod evaluate;
mod export;
mod generate;
mod generate_scene;
mod generate_variants;
mod import;
mod import_assets;
mod import_robot;
mod import_task;
mod judge;
mod overview;
mod plan;
mod planned;
mod produce;
mod production;
mod render;
mod replay;
mod report;
mod run;
mod sample;
mod share;
mod simulated;
mod survey;
mod view;
mod yields;

use std::path::{Path, PathBuf};

use akrobat_model::events::Observer;
use akrobat_model::load::AssetSearch;

use crate::{Error, Host};

pub use bench_plan::{PlanBenchReport, PlanBenchRequest, ProblemResult, bench_plan};
pub use demo::{DemoReport, DemoRequest, DemoRobotChoice, DemoTask, demo};
pub use episodes::{EpisodeFilter, EpisodeList};
pub use evaluate::{EvalJob, evaluate};
pub use export::{ExportReport, ExportRequest, card, export};
pub use generate::{GenerateObjectReport, GenerateObjectRequest, generate_object};
pub use generate_scene::{
    GenerateScenesRequest, SCENES_FILE, SceneEntry, SceneSet, SceneTask, generate_scenes,
};
pub use generate_variants::{GenerateVariantsRequest, generate_variants};
pub use import::{ImportReport, ImportRequest, import};
pub use import_assets::{
    AssetKind, AssetSource, ImportAssetReport, ImportAssetRequest, import_asset, import_grasps,
};
pub use import_robot::{ImportRobotReport, ImportRobotRequest, import_robot};
pub use judge::{JudgeRequest, Judged, judge};
pub use plan::{PlanBackend, PlanReport, PlanRequest, plan};
pub use planned::planned_task;
use planned::selection;
pub use produce::{ProduceReport, ProduceRequest, ProductionFile, produce};
pub use production::{
    BaseCoverage, CELL_M as BASE_CELL_M, Opening, Production, ProductionRequest, Shot,
    StartDiversity, files_below, is_production, production,
};
pub use render::{
    BackendChoice, DryRun, Format, RenderReport, RenderRequest, Sharing, States, dry_run, load_rig,
    render,
};
pub use replay::{
    JointGains, PhysicsConfig, ReplayJob, ReplayReport, ReplayRequest, audit_path, replay,
};
pub use report::{ReportRequest, report};
pub use run::{JobFile, RenderSettings, RunOutput, RunReport, RunRequest, Variants, run};
pub use survey::{CameraSurvey, Survey, SurveyRequest, ViewSurvey, survey};
pub use view::{ViewBody, ViewJob, ViewMesh, ViewReport, ViewRequest, ViewTable, view};
pub use yields::{Yield, Yields};

/// Folders of assets, separated like those of `PATH`.
pub const ASSET_PATH_VARIABLE: &str = "AKROBAT_ASSET_PATH";

/// What a job works with besides its request.
pub struct Context<'a> {
    /// What needs Python, where Python is there.
    pub host: Option<&'a dyn Host>,
    /// Takes the stages' reports, and knows whether the user wants to stop.
    pub observer: &'a dyn Observer,
}

impl Context<'_> {
    pub(crate) fn asset_search(&self, given: &[PathBuf]) -> Result<AssetSearch, Error> {
        asset_search(given, self.host)
    }
}

/// Where files are looked up: the folders given, then `$AKROBAT_ASSET_PATH`, then what the host
/// has. (Files beside the file that names them come first of all.)
///
/// # Errors
/// Where a folder that was given does not exist.
pub fn asset_search(given: &[PathBuf], host: Option<&dyn Host>) -> Result<AssetSearch, Error> {
    if let Some(folder) = given.iter().find(|folder| !folder.is_dir()) {
        return Err(Error::Usage(format!("asset folder {} does not exist", folder.display())));
    }
    let mut folders = given.to_vec();
    if let Some(path) = std::env::var_os(ASSET_PATH_VARIABLE) {
        folders
            .extend(std::env::split_paths(&path).filter(|folder| !folder.as_os_str().is_empty()));
    }
    folders.extend(host.map(Host::asset_folders).unwrap_or_default());
    Ok(AssetSearch { folders })
}

/// Runs `work` on this many threads; on one for each core where nothing is said.
fn on_threads<T: Send>(
    threads: Option<usize>,
    work: impl FnOnce() -> Result<T, Error> + Send,
) -> Result<T, Error> {
    let Some(threads) = threads else { return work() };
    if threads == 0 {
        return Err(Error::Usage("--threads: expected at least 1, got 0".into()));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| Error::Failed(format!("cannot start {threads} threads: {e}")))?;
    pool.install(work)
}

/// Checks, before hours of work, that a file can be created at `path`.
fn check_writable(path: &Path) -> Result<(), Error> {
    if path.is_dir() {
        return Err(Error::Usage(format!("{}: cannot write: it is a folder", path.display())));
    }
    let folder = folder_of(path);
    tempfile::Builder::new()
        .prefix(".akrobat-")
        .tempfile_in(folder)
        .map(drop)
        .map_err(|e| Error::write(path, &e))
}

/// The folder that holds `path`; `.` for a bare name.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}
