//! Writes an episode of a dataset again and again, for `benchmarks/packager.py`:
//! `repack SOURCE OUTPUT CODEC COPIES FRAMES EPISODES_PER_SHARD`. Prints one line of JSON.

#[allow(dead_code, reason = "the example of the other files writes whole datasets")]
mod sample;

use std::path::Path;
use std::time::{Duration, Instant};

use akrobat_cameras::{CameraFrame, Intrinsics, Observation};
use akrobat_model::{Phase, Pose};
use akrobat_packager::dataset::Values;
use akrobat_packager::{
    Codec, DatasetConfig, DatasetReader, DatasetWriter, EpisodeInfo, StorageConfig,
};
use clap::ValueEnum;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [source, output, codec, copies, frames, per_shard] = &arguments[..] else {
        return Err("usage: repack SOURCE OUTPUT CODEC COPIES FRAMES EPISODES_PER_SHARD".into());
    };
    let copies: u32 = copies.parse()?;
    let source = DatasetReader::open(Path::new(source))?;
    let storage = StorageConfig {
        codec: Codec::from_str(codec, false)?,
        episodes_per_shard: per_shard.parse()?,
        ..source.config().storage.clone()
    };
    let observations = read(&source, frames.parse()?)?;
    let info = info(&source, &observations);
    let config = DatasetConfig { storage, ..source.config().clone() };
    let mut writer = DatasetWriter::create(Path::new(output), config)?;
    let (mut spent, mut cpu_s) = (Duration::ZERO, 0.0);
    for copy in 0..copies {
        let info = EpisodeInfo { id: format!("copy-{copy:06}"), ..info.clone() };
        let frames = observations.clone();
        let (started, cpu_before_s) = (Instant::now(), cpu_seconds()?);
        writer.begin_episode(info)?;
        frames.into_iter().try_for_each(|frame| writer.push(frame))?;
        writer.finish_episode()?;
        spent += started.elapsed();
        cpu_s += cpu_seconds()? - cpu_before_s;
    }
    let (started, cpu_before_s) = (Instant::now(), cpu_seconds()?);
    writer.close()?;
    spent += started.elapsed();
    cpu_s += cpu_seconds()? - cpu_before_s;
    let seconds = spent.as_secs_f64();
    println!("{}", serde_json::json!({ "seconds": seconds, "cpu_s": cpu_s, "peak_mb": peak_mb() }));
    Ok(())
}

/// User and system time of all threads so far, as Linux states it, in hundredths of a second.
fn cpu_seconds() -> Outcome<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks = fields.skip(11).take(2).map(str::parse::<u64>).sum::<Result<u64, _>>()?;
    Ok(ticks as f64 / 100.0)
}

/// Largest resident memory of this process so far, as Linux states it.
fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches(" kB").parse::<f64>().ok()? / 1024.0)
}

/// The first `count` frames of the first episode.
fn read(source: &DatasetReader, count: usize) -> Outcome<Vec<Observation>> {
    let (_, stored) = source.episodes().next().ok_or("the dataset holds no episode")?;
    let episode = source.episode(stored)?;
    let rig = &source.config().rig;
    let mut observations = Vec::new();
    for frame in 0..count.min(stored.frames as usize) {
        let mut cameras = Vec::new();
        for camera in &rig.cameras {
            let image = |kind: &str| {
                episode
                    .frame(&format!("camera_obs/{}_{kind}", camera.name), frame)
                    .map(|a| a.values)
            };
            let intrinsics =
                Intrinsics::from_focal_length(camera.width, camera.height, 18.0, 20.955);
            let mut images = CameraFrame::new(&camera.name, intrinsics, Pose::identity());
            if let (Values::U8(rgb), Values::U16(depth_mm), Values::U16(segmentation)) =
                (image("rgb")?, image("depth")?, image("segmentation")?)
            {
                images.rgb = rgb;
                images.depth_m = depth_mm.into_iter().map(|mm| f32::from(mm) / 1000.0).collect();
                images.segmentation = segmentation;
            }
            cameras.push(images);
        }
        let cloud = match episode.frame("point_cloud", frame)?.values {
            Values::F32(values) => values.as_chunks::<6>().0.to_vec(),
            _ => Vec::new(),
        };
        let robot = match episode.frame("obs/joint_pos", frame)?.values {
            Values::F32(values) => values.into_iter().map(f64::from).collect(),
            _ => Vec::new(),
        };
        observations.push(Observation {
            frame: frame as u32,
            time_s: frame as f64 / 30.0,
            phase: Phase::Manipulate,
            cameras,
            cloud,
            robot,
            object: vec![0.0],
            ..sample::observation(0, 0)
        });
    }
    Ok(observations)
}

fn info(source: &DatasetReader, observations: &[Observation]) -> EpisodeInfo {
    let columns = observations.first().map_or(0, |o| o.robot.len());
    EpisodeInfo {
        frames: observations.len() as u32,
        robot_joints: (0..columns).map(|index| format!("joint_{index}")).collect(),
        rig: source.config().rig.clone(),
        cloud_points: observations.first().map_or(0, |o| o.cloud.len()),
        ..sample::info(0)
    }
}
