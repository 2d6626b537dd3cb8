//! Trajectory or dataset episode -> what a viewer is handed.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use akrobat_model::events::Event;
use akrobat_model::load;
use akrobat_model::task::Task;
use akrobat_model::trajectory::PathSample;
use akrobat_model::{Phase, Pose, TriMesh};
use akrobat_packager::dataset::{Array, EpisodeReader, Values};
use akrobat_packager::{DatasetReader, trajectory_file};
use akrobat_renderer::replay::{FRAME_RATE_HZ, Replay};
use akrobat_renderer::{BodyGroup, FrameState, RenderScene};
use serde::Serialize;

use super::render::{check_unchanged, task_path};
use super::{Context, check_writable};
use crate::report::{glb, near};
use crate::{Error, Host};

/// Bytes that all meshes together are thinned to.
const MESH_BYTES: usize = 24 << 20;
/// Triangles of the surroundings, nearest bodies first.
const SCENE_TRIANGLES: usize = 300_000;

/// What is to be shown.
#[derive(Debug, Clone)]
pub struct ViewRequest {
    /// Trajectory file, or dataset folder with HDF5 shards.
    pub input: PathBuf,
    /// Position among the trajectories, or among the stored episodes.
    pub episode: usize,
    /// File to write instead of opening a window.
    pub save: Option<PathBuf>,
    /// Of so many images and clouds one is shown.
    pub every: usize,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
}

/// What a host is asked to show: bodies and joints over time and, of a dataset, images, which the host
/// reads itself.
#[derive(Debug)]
pub struct ViewJob<'a> {
    /// The request.
    pub request: &'a ViewRequest,
    /// Heading.
    pub title: String,
    /// Instants of tables and moving bodies, seconds.
    pub times_s: Vec<f64>,
    /// Robot, object and what of the scene is near.
    pub bodies: Vec<ViewBody>,
    /// Joint positions.
    pub tables: Vec<ViewTable>,
}

/// A rigid body.
#[derive(Debug)]
pub struct ViewBody {
    /// `robot/<link>`, `object/<link>`, `scene/<body>`, …
    pub name: String,
    /// Surfaces in the body's frame.
    pub meshes: Vec<ViewMesh>,
    /// Pose at each instant; a single one of bodies at rest. World frame, Z up, metres.
    pub world_from_body: Vec<Pose>,
}

/// A surface of one colour.
#[derive(Debug)]
pub struct ViewMesh {
    /// Geometry.
    pub mesh: TriMesh,
    /// Linear RGBA, the mean of what the surface's texture shows.
    pub color: [f32; 4],
}

/// Positions of joints over time, rad or m.
#[derive(Debug)]
pub struct ViewTable {
    /// `robot` or `object`.
    pub name: &'static str,
    /// Joint names.
    pub columns: Vec<String>,
    /// Row-major, a row for each instant.
    pub values: Vec<f64>,
}

/// What was shown.
#[derive(Debug, Clone, Serialize)]
pub struct ViewReport {
    /// Where it was written; absent where a window was opened.
    pub file: Option<PathBuf>,
    /// Bodies with surfaces.
    pub bodies: usize,
    /// Instants.
    pub frames: usize,
    /// Cameras with images.
    pub cameras: Vec<String>,
}

/// Shows a trajectory or an episode, in a window or into a file.
///
/// # Errors
/// Where the input is wrong, the viewer is not installed, or the disk fails.
pub fn view(request: &ViewRequest, context: &Context<'_>) -> Result<ViewReport, Error> {
    let host = context.host.ok_or_else(|| {
        Error::Usage(
            "the viewer needs the Python package: pip install 'akrobat[viewer]', then the same command with \
             its `akrobat`"
                .into(),
        )
    })?;
    if request.every == 0 {
        return Err(Error::Usage("--every: expected at least 1, got 0".into()));
    }
    if let Some(file) = &request.save {
        check_writable(file)?;
    }
    let job = if request.input.is_dir() {
        of_dataset(request, context)?
    } else {
        of_trajectories(request, context)?
    };
    show(&job, host)
}

fn show(job: &ViewJob<'_>, host: &dyn Host) -> Result<ViewReport, Error> {
    let cameras = host.view(job)?;
    Ok(ViewReport {
        file: job.request.save.clone(),
        bodies: job.bodies.len(),
        frames: job.times_s.len(),
        cameras,
    })
}

fn of_trajectories<'a>(
    request: &'a ViewRequest,
    context: &Context<'_>,
) -> Result<ViewJob<'a>, Error> {
    let path = &request.input;
    let set = trajectory_file::read(path)?;
    check_episode(request, set.trajectories.len())?;
    let search = context.asset_search(&request.assets)?;
    let task = load::task_from_text(set.header.task_toml.clone(), &task_path(path, &set), &search)?;
    check_unchanged(path, &set, &task)?;
    let trajectory = &set.trajectories[request.episode];
    let scene = RenderScene::from_task(&task)?;
    let replay = Replay::new(&task, &scene);
    replay.check(trajectory)?;
    let times_s = trajectory.frame_times(FRAME_RATE_HZ, false);
    let states: Vec<FrameState> =
        times_s.iter().map(|&time_s| replay.at_time(trajectory, 0, time_s)).collect();
    let flat = |of: fn(&FrameState) -> &[f64]| states.iter().flat_map(of).copied().collect();
    let tables = vec![
        ViewTable { name: "robot", columns: set.header.robot_joints, values: flat(|s| &s.robot) },
        ViewTable {
            name: "object",
            columns: set.header.object_joints,
            values: flat(|s| &s.object),
        },
    ];
    let bodies = bodies(&scene, &states);
    let title = format!("{}: trajectory {}", set.header.task_name, request.episode);
    Ok(ViewJob { request, title, times_s, bodies, tables })
}

fn of_dataset<'a>(request: &'a ViewRequest, context: &Context<'_>) -> Result<ViewJob<'a>, Error> {
    let dataset = DatasetReader::open(&request.input)?;
    check_episode(request, dataset.episodes().count())?;
    let Some((_, stored)) = dataset.episodes().nth(request.episode) else {
        return Err(Error::Usage(format!("{}: no episodes", request.input.display())));
    };
    let episode = dataset.episode(stored)?;
    let columns = [("robot", "robot_joints"), ("object", "object_joints")];
    let mut tables = Vec::new();
    for (name, joints) in columns {
        let id = episode.text(&format!("{name}_id"))?.replace('/', "_");
        let values = format!("states/articulation/{id}/joint_position");
        let values = numbers(episode.array(&values)?);
        tables.push(ViewTable { name, columns: episode.texts(joints)?, values });
    }
    let times_s = numbers(episode.array("time")?);
    // The images tell most; without the robot's files, they alone are shown.
    let bodies = match moved_bodies(&episode, &times_s, &tables, request, context) {
        Ok(bodies) => bodies,
        Err(Error::Input(missing)) => {
            let message = format!(
                "robot, object and scene are not shown: {missing}; --assets tells where the task and its files are"
            );
            context.observer.event(&Event::Warning { message: &message });
            Vec::new()
        }
        Err(other) => return Err(other),
    };
    let title = format!("{}: episode {}", dataset.config().name, request.episode);
    Ok(ViewJob { request, title, times_s, bodies, tables })
}

fn check_episode(request: &ViewRequest, count: usize) -> Result<(), Error> {
    super::selection(&request.input, Some(&[request.episode]), count).map(drop)
}

/// The bodies of the task that an episode was planned for, as its states move them.
fn moved_bodies(
    episode: &EpisodeReader,
    times_s: &[f64],
    tables: &[ViewTable],
    request: &ViewRequest,
    context: &Context<'_>,
) -> Result<Vec<ViewBody>, Error> {
    let search = context.asset_search(&request.assets)?;
    let path = episode.path().with_file_name("task.toml");
    let task = load::task_from_text(episode.text("task_toml")?, &path, &search)?;
    let scene = RenderScene::from_task(&task)?;
    check_columns(episode.path(), &task, tables)?;
    let replay = Replay::new(&task, &scene);
    let row = |table: &ViewTable, index: usize| {
        let columns = table.columns.len();
        table.values[index * columns..(index + 1) * columns].to_vec()
    };
    let states: Vec<FrameState> = times_s
        .iter()
        .enumerate()
        .map(|(index, &time_s)| {
            let (robot, object) = (row(&tables[0], index), row(&tables[1], index));
            replay.at_sample(
                index as u32,
                time_s,
                PathSample { robot, object, phase: Phase::Approach },
            )
        })
        .collect();
    Ok(bodies(&scene, &states))
}

/// Whether states fit the task's robot and object: the file may be older than they are.
fn check_columns(file: &Path, task: &Task, tables: &[ViewTable]) -> Result<(), Error> {
    let wanted = [task.robot.trajectory_joints().len(), task.object.tree.dof()];
    let found = [tables[0].columns.len(), tables[1].columns.len()];
    if wanted == found {
        return Ok(());
    }
    let message = format!(
        "expected {} robot and {} object joints, as the task's files have them, found {} and {}",
        wanted[0], wanted[1], found[0], found[1]
    );
    Err(akrobat_model::ModelError::invalid(file, message).into())
}

fn numbers(array: Array) -> Vec<f64> {
    match array.values {
        Values::U8(values) => values.into_iter().map(f64::from).collect(),
        Values::U16(values) => values.into_iter().map(f64::from).collect(),
        Values::F32(values) => values.into_iter().map(f64::from).collect(),
        Values::F64(values) => values,
    }
}

/// Robot, object, clutter and the nearest of the scene.
fn bodies(scene: &RenderScene, states: &[FrameState]) -> Vec<ViewBody> {
    if states.is_empty() {
        return Vec::new();
    }
    let near: HashSet<usize> = near::bodies(scene, states, SCENE_TRIANGLES).into_iter().collect();
    let shown: Vec<usize> = (0..scene.bodies.len())
        .filter(|place| scene.bodies[*place].group != BodyGroup::Scene || near.contains(place))
        .collect();
    let meshes: Vec<&Arc<TriMesh>> = shown.iter().flat_map(|&p| &scene.bodies[p].meshes).collect();
    let thinned = glb::thinned_to(&meshes, MESH_BYTES);
    let mut thinned = meshes
        .iter()
        .zip(thinned)
        .map(|(mesh, thinned)| ViewMesh { color: glb::mean_color(&mesh.material), mesh: thinned });
    let mut bodies = Vec::new();
    for place in shown {
        let body = &scene.bodies[place];
        let moves = matches!(body.group, BodyGroup::Robot | BodyGroup::Object);
        let states = if moves { states } else { &states[..1] };
        bodies.push(ViewBody {
            name: format!("{}/{}", body.group.name(), body.name),
            meshes: thinned.by_ref().take(body.meshes.len()).collect(),
            world_from_body: states.iter().map(|state| state.world_from_body[place]).collect(),
        });
    }
    bodies
}
