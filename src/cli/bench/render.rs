//! `akrobat bench render`: CPU time of an image and of a cloud.

use std::path::{Path, PathBuf};
use std::time::Instant;

use akrobat_assets::demo;
use akrobat_cameras::{CameraFrame, Rig};
use akrobat_gpu::AdapterChoice;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::pose::from_xyz_wxyz;
use akrobat_model::task::Task;
use akrobat_model::trajectory::{Grasp, PathSample};
use akrobat_model::{ModelError, Phase};
use akrobat_renderer::handle::Handle;
use akrobat_renderer::placement::PlacedRig;
use akrobat_renderer::pointcloud::{CloudConfig, CloudPlace, fuse};
use akrobat_renderer::raster::WgpuBackend;
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{Backend, Detail, FrameState, PlacedCamera, RenderScene, SoftBackend};
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::Error;
use crate::cli::Report;
use crate::pipeline::Context;
use crate::resources::cpu_seconds;

mod export;

/// Measure the CPU time of an image (colour, depth and segmentation, 320 x 240) and of a cloud of 4,096 points from
/// three of them: the paper's cameras at twelve instants of a planned trajectory.
///
/// Two scenes: a robot opens a microwave oven in the built-in kitchen; and Summit-Franka opens one in the furnished
/// `infinigen_kitchen_1`, where its files are found. `soft.cpu_ms_per_image` is that of the last.
///
/// Examples:
///   akrobat bench render                          with the assets of $AKROBAT_ASSET_PATH
///   akrobat --json bench render --assets ASSETS   one JSON document
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct BenchRenderArgs {
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
    /// How often the instants are rendered; the median counts.
    #[arg(long, value_name = "N", default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Measure the `wgpu` backend too, on a graphics processor or a software driver.
    #[arg(long)]
    wgpu: bool,
    /// Write the last scene's meshes (OBJ), poses and cameras of all instants (JSON), and the depth images (f32,
    /// metres) into this folder instead of measuring: for other renderers to draw the same.
    #[arg(long, value_name = "DIR")]
    export: Option<PathBuf>,
}

/// A grasp and states of a trajectory that was planned once.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct States {
    held_link: String,
    link_from_tool: [f64; 7],
    frames: Vec<State>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    robot: Vec<f64>,
    object: Vec<f64>,
}

const EMBEDDED_STATES: &str = include_str!("embedded.toml");
const INFINIGEN_STATES: &str = include_str!("infinigen.toml");
const INFINIGEN_TASK: &str = include_str!("../../../configs/tasks/summit_microwave_kitchen.toml");
const INFINIGEN_ROBOT: &str = include_str!("../../../configs/robots/summit_franka.toml");

/// A scene with everything in place at each instant.
struct Workload {
    scene: RenderScene,
    frames: Vec<(FrameState, Vec<PlacedCamera>)>,
    handle: Handle,
}

impl Workload {
    fn new(task: &Task, states: &str) -> Result<Self, Error> {
        let invalid = |reason: String| ModelError::invalid(Path::new("states.toml"), reason);
        let states: States = toml::from_str(states).map_err(|e| invalid(e.to_string()))?;
        let link_from_tool = from_xyz_wxyz(states.link_from_tool)
            .ok_or_else(|| invalid(format!("not a pose: {:?}", states.link_from_tool)))?;
        let grasp = Grasp { id: 0, link: states.held_link, link_from_tool, width_m: 0.02 };
        let scene = RenderScene::from_task(task)?;
        let handle = Handle::new(task, &grasp)?;
        let replay = Replay::new(task, &scene);
        let place = |(frame, state): (u32, State)| {
            let State { robot, object } = state;
            let sample = PathSample { robot, object, phase: Phase::Manipulate };
            replay.at_sample(frame, f64::from(frame), sample)
        };
        let frames: Vec<FrameState> = (0..).zip(states.frames).map(place).collect();
        let rig = Rig::preset("paper").map_err(akrobat_renderer::RenderError::from)?;
        let rig = PlacedRig::new(&rig, task, &scene, &handle, &frames)?;
        let with_cameras = |frame: FrameState| {
            let cameras = rig.at(&frame);
            (frame, cameras)
        };
        Ok(Self { frames: frames.into_iter().map(with_cameras).collect(), scene, handle })
    }

    fn image_count(&self) -> usize {
        self.frames.iter().map(|(_, cameras)| cameras.len()).sum()
    }
}

/// The built-in kitchen, which needs no files.
fn embedded(folder: &Path) -> Result<Workload, Error> {
    let paths = demo::write(folder, 1, None)?;
    let is_microwave = |path: &&PathBuf| path.ends_with("microwave_pillar.toml");
    let path = paths.tasks.iter().find(is_microwave);
    let path = path.ok_or_else(|| Error::Failed("the demo has no microwave oven".into()))?;
    Workload::new(&load::task(path, &AssetSearch::default())?, EMBEDDED_STATES)
}

/// The furnished kitchen; `None` where its files are not found.
fn infinigen(folder: &Path, search: &AssetSearch) -> Result<Option<Workload>, Error> {
    let needed = ["scenes/infinigen_kitchen_1/scene.glb", "objects/microwave_1001/microwave.urdf"];
    let has = |file: &&str| search.folders.iter().any(|folder| folder.join(file).is_file());
    if !needed.iter().all(has) {
        return Ok(None);
    }
    let [robots, tasks] = ["robots", "tasks"].map(|name| folder.join(name));
    let write = |path: &Path, text: &str| {
        std::fs::write(path, text).map_err(|error| Error::write(path, &error))
    };
    for folder in [&robots, &tasks] {
        std::fs::create_dir_all(folder).map_err(|error| Error::write(folder, &error))?;
    }
    write(&robots.join("summit_franka.toml"), INFINIGEN_ROBOT)?;
    let path = tasks.join("summit_microwave_kitchen.toml");
    let task = load::task_from_text(INFINIGEN_TASK.to_owned(), &path, search)?;
    Workload::new(&task, INFINIGEN_STATES).map(Some)
}

/// What one scene took.
#[derive(Debug, Serialize)]
struct Measured {
    scene: String,
    triangles: usize,
    images: usize,
    /// Median over the repeats, sum over all threads.
    cpu_ms_per_image: f64,
    /// The same on one thread.
    cpu_ms_per_image_one_thread: f64,
    /// Wall time on one thread, and on all.
    wall_ms_per_image_one_thread: f64,
    wall_ms_per_image: f64,
    /// The same where each image is asked for alone, so that all threads work on one.
    wall_ms_alone_one_thread: f64,
    wall_ms_alone: f64,
    threads: usize,
    /// The scene with level of detail, and what all triangles make of the same images.
    detail_auto: Reduced,
    /// Fusing three images into a cloud of 4,096 points.
    cpu_ms_per_cloud: f64,
}

/// What level of detail changes.
#[derive(Debug, Serialize)]
struct Reduced {
    triangles: usize,
    cpu_ms_per_image: f64,
    /// Share of the pixels whose depths differ by at most 2 mm.
    depth_within_2_mm: f64,
}

impl Reduced {
    fn measure(workload: &Workload, repeats: u32) -> Result<Self, Error> {
        const NEAR_ENOUGH_M: f32 = 0.002;
        let scene = Detail::Auto.of(workload.scene.clone());
        let (mut all, mut fewer) = (SoftBackend::new(), SoftBackend::new());
        let (mut agreeing, mut compared) = (0, 0);
        for (frame, cameras) in &workload.frames {
            let expected = all.render(&workload.scene, frame, cameras)?;
            let found = fewer.render(&scene, frame, cameras)?;
            let depths = |images: Vec<CameraFrame>| images.into_iter().flat_map(|i| i.depth_m);
            for (expected, found) in depths(expected).zip(depths(found)) {
                agreeing += usize::from((expected - found).abs() <= NEAR_ENOUGH_M);
                compared += 1;
            }
        }
        let [cpu, _] = median_ms(repeats, || {
            for (frame, cameras) in &workload.frames {
                fewer.render(&scene, frame, cameras)?;
            }
            Ok(())
        })?;
        Ok(Self {
            triangles: scene.triangle_count(),
            cpu_ms_per_image: cpu / workload.image_count() as f64,
            depth_within_2_mm: f64::from(agreeing as u32) / f64::from(compared as u32),
        })
    }
}

/// CPU and wall milliseconds of `work`, each the median over repeats.
fn median_ms(repeats: u32, mut work: impl FnMut() -> Result<(), Error>) -> Result<[f64; 2], Error> {
    let mut taken = [Vec::new(), Vec::new()];
    for _ in 0..repeats {
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        work()?;
        let wall = wall.elapsed().as_secs_f64();
        // Where the system does not tell the processor time, the wall time is an upper bound on one thread.
        let cpu = cpu_seconds().zip(cpu).map_or(wall, |(now, before)| now - before);
        taken[0].push(1e3 * cpu);
        taken[1].push(1e3 * wall);
    }
    Ok(taken.map(|mut ms| {
        ms.sort_by(f64::total_cmp);
        ms[ms.len() / 2]
    }))
}

fn measure(workload: &Workload, repeats: u32, context: &Context<'_>) -> Result<Measured, Error> {
    let mut backend = SoftBackend::new();
    let mut render = || {
        for (frame, cameras) in &workload.frames {
            if context.observer.cancelled() {
                return Err(Error::Interrupted("nothing is left behind".into()));
            }
            backend.render(&workload.scene, frame, cameras)?;
        }
        Ok(())
    };
    // The first time, meshes are cut into clusters and buffers grow.
    render()?;
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let one = one.map_err(|e| Error::Failed(format!("cannot start a thread: {e}")))?;
    let images = workload.image_count() as f64;
    let [cpu, wall] = median_ms(repeats, &mut render)?;
    let [cpu_one, wall_one] = one.install(|| median_ms(repeats, &mut render))?;
    let mut alone = SoftBackend::new();
    let mut render_alone = || {
        for (frame, cameras) in &workload.frames {
            for camera in cameras {
                alone.render(&workload.scene, frame, std::slice::from_ref(camera))?;
            }
        }
        Ok(())
    };
    let [_, wall_alone] = median_ms(repeats, &mut render_alone)?;
    let [_, wall_alone_one] = one.install(|| median_ms(repeats, &mut render_alone))?;
    let clouds: Vec<_> = workload
        .frames
        .iter()
        .map(|(frame, cameras)| {
            let images = SoftBackend::new().render(&workload.scene, frame, cameras)?;
            let place = CloudPlace {
                handle: workload.handle.position(frame),
                world_from_base: frame.world_from_base,
            };
            Ok((images, place))
        })
        .collect::<Result<_, Error>>()?;
    let config = CloudConfig::default();
    let [cloud_cpu, _] = median_ms(repeats.min(3), || {
        for (images, place) in &clouds {
            std::hint::black_box(fuse(images, place, &config));
        }
        Ok(())
    })?;
    Ok(Measured {
        scene: workload.scene.name.clone(),
        triangles: workload.scene.triangle_count(),
        images: workload.image_count(),
        cpu_ms_per_image: cpu / images,
        cpu_ms_per_image_one_thread: cpu_one / images,
        wall_ms_per_image_one_thread: wall_one / images,
        wall_ms_per_image: wall / images,
        wall_ms_alone_one_thread: wall_alone_one / images,
        wall_ms_alone: wall_alone / images,
        detail_auto: Reduced::measure(workload, repeats)?,
        threads: rayon::current_num_threads(),
        cpu_ms_per_cloud: cloud_cpu / workload.frames.len() as f64,
    })
}

/// Runs the verb.
pub fn run(args: &BenchRenderArgs, context: &Context<'_>) -> Result<Report, Error> {
    let search = context.asset_search(&args.assets)?;
    let folder = tempfile::tempdir()
        .map_err(|e| Error::Failed(format!("cannot make a temporary folder: {e}")))?;
    let furnished = infinigen(folder.path(), &search)?;
    if let Some(output) = &args.export {
        let workload = match furnished {
            Some(workload) => workload,
            None => embedded(folder.path())?,
        };
        let triangles = export::write(output, &workload.scene, &workload.frames)?;
        let text = format!("{}: {triangles} triangles", output.display());
        return Ok(Report::done(text, json!({ "folder": output, "triangles": triangles })));
    }
    let built_in = embedded(folder.path())?;
    let mut scenes = vec![measure(&built_in, args.repeats, context)?];
    if let Some(workload) = &furnished {
        scenes.push(measure(workload, args.repeats, context)?);
    }
    let last = furnished.as_ref().unwrap_or(&built_in);
    let wgpu = args.wgpu.then(|| measure_wgpu(last, args.repeats)).transpose()?;
    Ok(report(&scenes, wgpu))
}

/// CPU time of an image by the `wgpu` backend; where its driver computes on the CPU, that counts.
fn measure_wgpu(workload: &Workload, repeats: u32) -> Result<serde_json::Value, Error> {
    let mut backend = WgpuBackend::open(&AdapterChoice::Any)?;
    let mut render = || {
        for (frame, cameras) in &workload.frames {
            backend.render(&workload.scene, frame, cameras)?;
        }
        Ok(())
    };
    render()?;
    let [cpu, _] = median_ms(repeats, &mut render)?;
    Ok(json!({
        "adapter": backend.adapter().to_string(),
        "cpu_ms_per_image": cpu / workload.image_count() as f64,
    }))
}

fn report(scenes: &[Measured], wgpu: Option<serde_json::Value>) -> Report {
    let mut lines: Vec<String> = scenes
        .iter()
        .map(|m| {
            format!(
                "{} ({} triangles): {:.2} CPU-ms per image on {} threads, {:.2} on one; wall {:.2} and {:.2} ms, one image at a time {:.2} and {:.2} ms; {:.1} CPU-ms per cloud; {} triangles with level of detail, {:.2} CPU-ms, {:.2} % of the depths within 2 mm",
                m.scene,
                m.triangles,
                m.cpu_ms_per_image,
                m.threads,
                m.cpu_ms_per_image_one_thread,
                m.wall_ms_per_image,
                m.wall_ms_per_image_one_thread,
                m.wall_ms_alone,
                m.wall_ms_alone_one_thread,
                m.cpu_ms_per_cloud,
                m.detail_auto.triangles,
                m.detail_auto.cpu_ms_per_image,
                100.0 * m.detail_auto.depth_within_2_mm
            )
        })
        .collect();
    let main = scenes.last().map(|m| {
        json!({
            "scene": m.scene,
            "triangles": m.triangles,
            "cpu_ms_per_image": m.cpu_ms_per_image,
            "cpu_ms_per_cloud": m.cpu_ms_per_cloud,
            "cpu_ms_per_image_detail_auto": m.detail_auto.cpu_ms_per_image,
        })
    });
    if let Some(wgpu) = &wgpu {
        lines.push(format!("wgpu: {wgpu}"));
    }
    let mut json = json!({ "soft": main, "scenes": scenes });
    if let (Some(wgpu), Some(fields)) = (wgpu, json.as_object_mut()) {
        fields.insert("wgpu".into(), wgpu);
    }
    Report::done(lines.join("\n"), json)
}
