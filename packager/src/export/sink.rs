//! What a format's writer is told, and in which order.

use std::collections::BTreeMap;

use akrobat_cameras::CameraSpec;
use serde::Serialize;

use super::columns::ColumnStatistics;
use super::config::{ActionKind, BaseActions, EefFrame, ExportConfig, GripperColumns};
use super::source::{Episode, FrameBatch, Source};
use crate::dataset::Licence;
use crate::episode::DepthEncoding;
use crate::error::{PackError, Result};

/// Writes one format. Calls come in this order: for each episode `begin`, `frames` until all are through,
/// `end`; at last `finish`.
pub trait Sink {
    /// Starts an episode.
    ///
    /// # Errors
    /// [`PackError`] where the episode does not fit the others, or the disk fails.
    fn begin(&mut self, episode: &Episode) -> Result<()>;

    /// Takes the next frames. Not called where the format holds nothing of frames.
    ///
    /// # Errors
    /// As [`Sink::begin`].
    fn frames(&mut self, episode: &Episode, batch: &FrameBatch) -> Result<()>;

    /// Completes the episode.
    ///
    /// # Errors
    /// As [`Sink::begin`].
    fn end(&mut self, episode: &Episode) -> Result<()>;

    /// Completes the output.
    ///
    /// # Errors
    /// As [`Sink::begin`].
    fn finish(&mut self) -> Result<()>;
}

/// What all episodes of an export share.
#[derive(Debug, Clone, Serialize)]
pub struct ExportHeader {
    /// Name of the dataset.
    pub name: String,
    /// The configuration.
    pub config: ExportConfig,
    /// The cameras.
    pub cameras: Vec<CameraSpec>,
    /// Robots, with the number of their episodes.
    pub robots: BTreeMap<String, u64>,
    /// Objects, with the number of their episodes.
    pub objects: BTreeMap<String, u64>,
    /// Scenes, with the number of their episodes.
    pub scenes: BTreeMap<String, u64>,
    /// Kinds of base that the robots were planned with.
    pub base_kinds: BTreeMap<String, u64>,
    /// Number of episodes.
    pub episodes: u64,
    /// Episodes that the judge accepted.
    pub successes: u64,
    /// Number of frames.
    pub frames: u64,
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// Shortest and longest episode, frames.
    pub episode_frames: [usize; 2],
    /// Goals of the driven joint, least and greatest (rad or m).
    pub goals: [f64; 2],
    /// Names of the action columns.
    pub action_names: Vec<String>,
    /// Names of the state columns.
    pub state_names: Vec<String>,
    /// Statistics of the actions.
    pub action_statistics: ColumnStatistics,
    /// Statistics of the states.
    pub state_statistics: ColumnStatistics,
    /// Points of each cloud.
    pub cloud_points: usize,
    /// Licences of everything that is seen.
    pub licences: Vec<Licence>,
    /// How the dataset came to be.
    pub provenance: serde_json::Value,
    /// Units, orders and frames, in words.
    pub conventions: BTreeMap<String, String>,
}

impl ExportHeader {
    /// Reads the small arrays of every episode once.
    ///
    /// # Errors
    /// [`PackError::Content`] where episodes differ in their columns, their rate or their clouds, and as
    /// reading them; what `stop` returns where it returns something.
    pub fn scan(
        source: &Source,
        config: &ExportConfig,
        stop: impl Fn() -> bool,
    ) -> Result<Option<Self>> {
        let dataset = source.dataset().config();
        let mut header: Option<Self> = None;
        for index in 0..source.len() {
            if stop() {
                return Ok(None);
            }
            let (episode, _) = source.episode(index)?;
            let header = header.get_or_insert_with(|| Self {
                name: dataset.name.clone(),
                config: config.clone(),
                cameras: source.cameras().to_vec(),
                robots: BTreeMap::new(),
                objects: BTreeMap::new(),
                scenes: BTreeMap::new(),
                base_kinds: BTreeMap::new(),
                episodes: 0,
                successes: 0,
                frames: 0,
                frame_rate_hz: episode.attributes.frame_rate_hz,
                episode_frames: [usize::MAX, 0],
                goals: [f64::INFINITY, f64::NEG_INFINITY],
                action_names: episode.action.names.clone(),
                state_names: episode.state.names.clone(),
                action_statistics: ColumnStatistics::default(),
                state_statistics: ColumnStatistics::default(),
                cloud_points: episode.cloud_points,
                licences: dataset.licences.clone(),
                provenance: dataset.provenance.clone(),
                conventions: conventions(config, dataset.storage.depth),
            });
            header.check(source, &episode)?;
            header.add(&episode);
        }
        Ok(header)
    }

    fn check(&self, source: &Source, episode: &Episode) -> Result<()> {
        let fail = |item: &str, expected: String, got: String| {
            let item = format!("{item} of episode {}", episode.attributes.id);
            Err(PackError::content(source.dataset().folder(), item, expected, got))
        };
        if episode.action.names != self.action_names || episode.state.names != self.state_names {
            let names = |names: &[String]| names.join(", ");
            return fail(
                "columns",
                format!(
                    "those of the first episode ({}); choose one --robot",
                    names(&self.action_names)
                ),
                names(&episode.action.names),
            );
        }
        if episode.attributes.frame_rate_hz != self.frame_rate_hz {
            let got = episode.attributes.frame_rate_hz;
            return fail("frame rate", format!("{} Hz", self.frame_rate_hz), format!("{got} Hz"));
        }
        if episode.cloud_points != self.cloud_points {
            let got = format!("{} points", episode.cloud_points);
            return fail("cloud", format!("{} points", self.cloud_points), got);
        }
        Ok(())
    }

    fn add(&mut self, episode: &Episode) {
        let attributes = &episode.attributes;
        let count = |counts: &mut BTreeMap<String, u64>, name: &str| {
            *counts.entry(name.to_owned()).or_default() += 1;
        };
        count(&mut self.robots, &attributes.robot_id);
        count(&mut self.objects, &attributes.object_id);
        count(&mut self.scenes, &attributes.scene_id);
        count(&mut self.base_kinds, &attributes.base_kind);
        self.episodes += 1;
        self.successes += u64::from(attributes.success);
        self.frames += episode.frames() as u64;
        let [shortest, longest] = self.episode_frames;
        self.episode_frames = [shortest.min(episode.frames()), longest.max(episode.frames())];
        self.goals = [self.goals[0].min(attributes.goal), self.goals[1].max(attributes.goal)];
        self.action_statistics.add(&episode.action);
        self.state_statistics.add(&episode.state);
    }
}

/// What a reader of the output has to know, by topic.
fn conventions(config: &ExportConfig, depth: DepthEncoding) -> BTreeMap<String, String> {
    let base = match (config.actions, config.base) {
        (ActionKind::JointVelocity, BaseActions::Local) => "velocity in the base's own frame",
        (ActionKind::JointVelocity, _) => "velocity along the world's axes",
        (_, BaseActions::Absolute) => "absolute x, y, yaw in the world",
        (_, BaseActions::Relative) => "change of x, y, yaw along the world's axes",
        (_, BaseActions::Local) => "displacement and turn in the base's own frame",
    };
    let frame = match config.eef_frame {
        EefFrame::Base => "the robot's base link",
        EefFrame::World => "the world",
    };
    let arm = match config.actions {
        ActionKind::JointPosition => "absolute joint positions (rad, m)".to_owned(),
        ActionKind::JointVelocity => "joint velocities (rad/s, m/s)".to_owned(),
        ActionKind::EefPose => {
            format!("tool pose in {frame}: position (m), quaternion ({})", config.quat.name())
        }
        ActionKind::EefDelta => {
            format!("tool motion along the axes of {frame}: translation (m), rotation vector (rad)")
        }
    };
    let gripper = match config.gripper {
        GripperColumns::Joints => "positions of the finger joints",
        GripperColumns::Opening => "mean position of the finger joints",
    };
    let entries = [
        ("action", "row t leads from frame t to frame t + 1; the last row repeats or rests".into()),
        ("action_base", base.to_owned()),
        ("action_arm", arm),
        ("action_gripper", format!("{gripper}, absolute")),
        ("quat_order", format!("{} in actions and states", config.quat.name())),
        ("eef_frame", format!("tool poses in actions and states are in {frame}")),
        ("color_order", "RGB, row 0 at the top, pixel centres at integer + 0.5".into()),
        (
            "depth",
            format!(
                "z-depth along the optical axis; 0 is invalid; stored in {} at the source",
                depth.unit()
            ),
        ),
        ("camera_frame", "OpenCV: x right, y down, z forward".into()),
        ("world_frame", "right-handed, z up, metres".into()),
        ("angle_unit", "rad".into()),
        ("time_unit", "s".into()),
        ("point_cloud", "x y z (m, world), r g b (0..255)".into()),
    ];
    entries.map(|(topic, words)| (topic.to_owned(), words)).into()
}
