//! The page that shows what was planned: pictures, plots, tables, animations.
//!
//! [`write`] renders some trajectories of a set and leaves one HTML page that needs nothing else, with
//! an animated GIF and an animated GLB of each shown trajectory beside it. The same input gives the
//! same bytes: nothing on the page depends on dates or machines but the times that it is handed.

pub mod animation;
pub mod audit_page;
pub mod chart;
pub mod cloud;
pub mod dataset_page;
mod document;
pub mod drift;
pub mod footprint;
pub mod glb;
mod index;
pub mod near;
mod page;
pub mod picture;
pub mod production_page;
mod shown;

pub use index::{IndexEntry, write_index};

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

/// What a trajectory file does not keep of a planning run. What is empty is left out of the page.
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
    use akrobat_model::events::Silent;
    use akrobat_model::load::{self, AssetSearch};
    use akrobat_model::trajectory::{DensePath, Grasp, TrajectoryHeader};
    use akrobat_model::{JointPath, Phase, Pose, Trajectory};
    use akrobat_renderer::SoftBackend;

    #[test]
    fn shown_trajectories_are_spread() {
        assert_eq!(spread(10, 3), [0, 4, 9]);
        assert_eq!(spread(2, 3), [0, 1]);
        assert_eq!(spread(5, 1), [0]);
        assert!(spread(0, 3).is_empty());
    }

    /// The drawer slides open on its own while the robot stands still.
    fn untouched_drawer(task: &Task) -> TrajectorySet {
        let (robot, object) = (&task.robot, &task.object);
        let columns = robot.trajectory_joints();
        let row: Vec<f64> =
            columns.iter().map(|&joint| robot.tree.joint_position(joint, &robot.rest)).collect();
        let mut dense = DensePath {
            robot: JointPath::new(row.len()),
            object: JointPath::new(object.tree.dof()),
            ..DensePath::default()
        };
        for k in 0..30 {
            let open = object.configuration(0.01 * f64::from(k));
            dense.push(0.02 * f64::from(k), row.iter().copied(), open, Phase::Manipulate);
        }
        let trajectory = Trajectory {
            id: "<b>id</b>".into(),
            seed: 1,
            grasp: Grasp {
                id: 0,
                link: object.tree.links()[object.handle_link].name.clone(),
                link_from_tool: Pose::identity(),
                width_m: 0.02,
            },
            start: 0.0,
            goal: 0.29,
            waypoints_robot: dense.robot.clone(),
            waypoints_object: dense.object.clone(),
            waypoint_interval_s: 0.02,
            manipulation_start: 0,
            substeps: 1,
            regrasps: Vec::new(),
            dense,
            verdict: None,
        };
        let names = object.tree.dof_joints().iter().map(|&j| object.tree.joints()[j].name.clone());
        let header = TrajectoryHeader {
            task_toml: String::new(),
            task_dir: String::new(),
            task_name: "<script>alert(1)</script>".into(),
            scene_id: task.scene.name.clone(),
            object_id: object.name.clone(),
            robot_id: robot.name.clone(),
            base_kind: robot.file.base.kind,
            content_hashes: BTreeMap::new(),
            robot_joints: robot.trajectory_joint_names(),
            object_joints: names.collect(),
            active_joint: object.tree.joints()[object.active_joint].name.clone(),
            contact_exceptions: Vec::new(),
            seed: 1,
            planner_config: serde_json::Value::Null,
            backend: "cpu".into(),
            counts: BTreeMap::from([("rejected/anchor_translation".into(), 7)]),
        };
        TrajectorySet { header, trajectories: vec![trajectory] }
    }

    fn drawer_task() -> Option<Task> {
        let search = AssetSearch { folders: vec![akrobat_model::fixtures::shared_assets()?] };
        let file =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/tasks/summit_drawer_empty.toml");
        Some(load::task(&file, &search).unwrap())
    }

    #[test]
    fn the_page_of_a_real_task_needs_nothing_else() {
        let Some(task) = drawer_task() else { return };
        let set = untouched_drawer(&task);
        let run = RunDetails {
            stage_seconds: BTreeMap::from([("grasps".into(), 1.5)]),
            sphere_fits: Vec::new(),
            notes: vec!["a < b".into()],
        };
        let rig = Rig::preset("paper").unwrap();
        let input = ReportInput { task: &task, set: &set, rig: &rig, run: Some(&run) };
        let folder = tempfile::tempdir().unwrap();
        let written = ["a", "b"].map(|name| {
            let (options, mut backend) = (ReportOptions::default(), SoftBackend::new());
            write(&folder.path().join(name), &input, &options, &mut backend, &Silent).unwrap()
        });
        for (a, b) in written[0].iter().zip(&written[1]) {
            assert!(
                std::fs::read(a).unwrap() == std::fs::read(b).unwrap(),
                "{} differs",
                a.display()
            );
        }
        let page = std::fs::read_to_string(&written[0][0]).unwrap();
        assert!(!page.contains("<script>alert") && !page.contains("<b>id"), "names are escaped");
        for attribute in ["src=\"", "href=\""] {
            let addresses = page.split(attribute).skip(1);
            for address in addresses {
                let inside = address.starts_with("data:") || address.starts_with('#');
                assert!(inside, "{attribute}{}", &address[..address.len().min(60)]);
            }
        }
        let names = ["Anchor drift", "anchor_translation", "a &lt; b", "1.50 s", "manipulate"];
        for name in names {
            assert!(page.contains(name), "{name} is missing");
        }
    }

    #[test]
    fn the_model_of_a_real_task_opens_its_drawer() {
        let Some(task) = drawer_task() else { return };
        let set = untouched_drawer(&task);
        let scene = RenderScene::from_task(&task).unwrap();
        let bytes = shown::model(&task, &scene, &set.trajectories[0], 4_000_000);
        assert!(bytes.len() < 5_000_000, "{} bytes", bytes.len());
        let file = gltf::Gltf::from_slice(&bytes).unwrap();
        let animation = file.animations().next().unwrap();
        let blob = file.blob.as_deref().unwrap();
        let mut moving = std::collections::BTreeSet::new();
        for channel in animation.channels() {
            moving.insert(channel.target().node().name().unwrap().to_owned());
            let inputs: Vec<f32> = channel.reader(|_| Some(blob)).read_inputs().unwrap().collect();
            assert_eq!(inputs.first(), Some(&0.0));
            assert!((inputs[inputs.len() - 1] - 0.58).abs() < 1e-6, "30 samples of 20 ms");
        }
        assert_eq!(moving.into_iter().collect::<Vec<_>>(), ["object/link_1"]);
        assert!(file.nodes().any(|node| node.name() == Some("robot/panda_hand")));
    }

    #[test]
    fn drift_tells_that_nothing_is_held() {
        let Some(task) = drawer_task() else { return };
        let trajectory = &untouched_drawer(&task).trajectories[0];
        let drift = drift::anchor_drift(&task, trajectory).unwrap();
        let (first, last) = (drift[0], drift[drift.len() - 1]);
        assert_eq!((first.progress, last.progress), (0.0, 1.0));
        let farthest = drift.iter().map(|d| d.translation_m).fold(0.0, f64::max);
        assert!(farthest > 0.29, "the drawer moved 0.29 m away from or past the tool: {farthest}");
    }
}
