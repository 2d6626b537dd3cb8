//! The page that shows what was planned: pictures, plots, tables, animations.
//!
//! [`write`] renders some trajectories of a set and leaves one HTML page that needs nothing else, with
//! an animated GIF and an animated GLB of each shown trajectory beside it. The same input gives the
//! same bytes: nothing on the page depends on dates or machines but the times that it is handed.

pub mod animation;
pub mod chart;
pub mod cloud;
pub mod drift;
pub mod footprint;
pub mod glb;
mod page;
pub mod picture;
mod shown;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use akrobat_cameras::Rig;
use akrobat_model::TrajectorySet;
use akrobat_model::events::{Event, Observer};
use akrobat_model::task::Task;
use akrobat_planner::spheres::SphereFit;
use akrobat_renderer::{Backend, RenderScene};

use crate::Error;
use crate::pipeline::PlanReport;

/// Name of the page within its folder.
pub const PAGE: &str = "report.html";
/// Name of the progress stage.
const STAGE: &str = "report";

/// What the page is about.
#[derive(Debug, Clone, Copy)]
pub struct ReportInput<'a> {
    /// The task that was planned.
    pub task: &'a Task,
    /// The trajectories.
    pub set: &'a TrajectorySet,
    /// Cameras of the pictures.
    pub rig: &'a Rig,
    /// What is known of the planning run besides its trajectories.
    pub run: Option<&'a RunDetails>,
}

/// What a trajectory file does not keep of a planning run.
#[derive(Debug, Clone, Default)]
pub struct RunDetails {
    /// Wall time by stage, seconds.
    pub stage_seconds: BTreeMap<String, f64>,
    /// How well the collision spheres stand for each link.
    pub sphere_fits: Vec<SphereFit>,
    /// What judge and planner noted.
    pub notes: Vec<String>,
}

impl From<&PlanReport> for RunDetails {
    fn from(report: &PlanReport) -> Self {
        Self {
            stage_seconds: report.stage_seconds.clone(),
            sphere_fits: report.sphere_fits.clone(),
            notes: report.notes.clone(),
        }
    }
}

/// How much is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportOptions {
    /// Trajectories with pictures, spread over the set.
    pub shown: usize,
    /// Largest size of one GIF, bytes.
    pub gif_bytes: usize,
    /// Largest size of the meshes of one GLB, bytes.
    pub glb_mesh_bytes: usize,
}

impl Default for ReportOptions {
    fn default() -> Self {
        Self { shown: 3, gif_bytes: 2_500_000, glb_mesh_bytes: 8_000_000 }
    }
}

/// Writes the page and what goes with it into `folder`, which is made where it is absent. Returns the files,
/// the page first.
///
/// # Errors
/// Where a trajectory does not fit the task, the backend or the disk fails, or the user asked to stop.
pub fn write(
    folder: &Path,
    input: &ReportInput<'_>,
    options: &ReportOptions,
    backend: &mut dyn Backend,
    observer: &dyn Observer,
) -> Result<Vec<PathBuf>, Error> {
    std::fs::create_dir_all(folder).map_err(|error| Error::write(folder, &error))?;
    let scene = RenderScene::from_task(input.task)?;
    let chosen = spread(input.set.trajectories.len(), options.shown);
    let started = std::time::Instant::now();
    observer.event(&Event::StageStarted { stage: STAGE, total: Some(chosen.len() as u64) });
    let mut files = vec![folder.join(PAGE)];
    let mut panels = Vec::new();
    for (&index, done) in chosen.iter().zip(1..) {
        let shown = shown::render(input, &scene, index, options, backend, observer)?;
        for (name, content) in [(&shown.gif_name, &shown.gif), (&shown.glb_name, &shown.glb)] {
            files.push(save(&folder.join(name), content)?);
        }
        panels.push(shown);
        observer.event(&Event::Progress { stage: STAGE, done });
    }
    let page = page::page(input, &scene, &panels)?.into_string();
    save(&files[0], page.as_bytes())?;
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(files)
}

/// `wanted` positions of `count`, evenly spread, first and last among them.
fn spread(count: usize, wanted: usize) -> Vec<usize> {
    match wanted.min(count) {
        0 => Vec::new(),
        1 => vec![0],
        wanted => (0..wanted).map(|k| k * (count - 1) / (wanted - 1)).collect(),
    }
}

/// CSS colour of a trajectory: any two that follow one another differ by the golden angle in hue.
fn trajectory_color(index: usize) -> String {
    let hue = (210.0 + 137.508 * index as f64) % 360.0;
    format!("hsl({hue:.0} 68% 52%)")
}

/// Writes a file so that it appears under its name only when whole.
fn save(path: &Path, content: &[u8]) -> Result<PathBuf, Error> {
    let folder = path.parent().unwrap_or(Path::new("."));
    // Not `tempfile_in`, whose files nobody else may read.
    let written = tempfile::Builder::new()
        .prefix(".akrobat-")
        .make_in(folder, |path| std::fs::File::create_new(path))
        .and_then(|mut file| {
            file.write_all(content)?;
            file.as_file().sync_all()?;
            file.persist(path).map_err(|error| error.error)
        });
    written.map(|_| path.to_path_buf()).map_err(|error| Error::write(path, &error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shown_trajectories_are_spread() {
        assert_eq!(spread(10, 3), [0, 4, 9]);
        assert_eq!(spread(2, 3), [0, 1]);
        assert_eq!(spread(5, 1), [0]);
        assert!(spread(0, 3).is_empty());
    }
}
