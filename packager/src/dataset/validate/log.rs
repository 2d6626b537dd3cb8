//! One MCAP log: every record with its checksum, every image, cloud and joint position.

use std::collections::HashMap;
use std::path::Path;

use super::Report;
use super::arrays::time_problems;
use crate::dataset::manifest::{DatasetConfig, StoredEpisode};
use crate::error::Result;
use crate::mcap_log::EPISODE_METADATA;
use crate::mcap_log::content::{self, Content};
use crate::mcap_log::read::{LogRecord, for_each_record};
use crate::quality::{CLOUD_RANGE_M, is_black};

/// What was seen on one topic.
#[derive(Debug, Default)]
struct Topic {
    times_s: Vec<f64>,
}

/// Checks a log against its line and against itself.
pub(super) fn check(
    path: &Path,
    id: &str,
    stored: &StoredEpisode,
    config: &DatasetConfig,
    report: &mut Report,
) -> Result<()> {
    let mut topics: HashMap<String, Topic> = HashMap::new();
    let mut problems: Vec<(String, String)> = Vec::new();
    let mut named = None;
    for_each_record(path, |record| match record {
        LogRecord::Metadata { name, entries } => {
            if name == EPISODE_METADATA {
                named = entries.get("episode_id").cloned();
            }
        }
        LogRecord::Message { topic, time_ns, data } => {
            let seen = topics.entry(topic.to_owned()).or_default();
            let frame = seen.times_s.len();
            seen.times_s.push(time_ns as f64 * 1e-9);
            if let Some(problem) = message_problem(topic, data, config) {
                problems.push((topic.to_owned(), format!("message {frame}: {problem}")));
            }
        }
    })?;
    for (topic, problem) in problems {
        report.add(format!("{} {topic}", stored.shard), problem);
    }
    if named.as_deref() != Some(id) {
        let found = named.unwrap_or_default();
        report.add(&stored.shard, format!("holds episode {found:?}, the manifest says {id}"));
    }
    check_topics(&topics, stored, config, report);
    Ok(())
}

/// Every frame has a message of every kind, without gaps.
fn check_topics(
    topics: &HashMap<String, Topic>,
    stored: &StoredEpisode,
    config: &DatasetConfig,
    report: &mut Report,
) {
    let of_camera = |name: &str| {
        ["color/image/compressed", "depth/image_raw", "camera_info"]
            .map(|suffix| format!("/camera/{name}/{suffix}"))
    };
    let mut expected: Vec<String> =
        config.rig.cameras.iter().flat_map(|camera| of_camera(&camera.name)).collect();
    expected.extend(["/tf", "/joint_states"].map(String::from));
    if topics.contains_key("/points") {
        expected.push("/points".into());
    }
    for topic in expected {
        let place = format!("{} {topic}", stored.shard);
        let times_s = topics.get(&topic).map_or(&[][..], |t| &t.times_s[..]);
        if times_s.len() != stored.frames as usize {
            let frames = stored.frames;
            report.add(&place, format!("has {} messages for {frames} frames", times_s.len()));
        }
        // The rate is not stated; the shortest interval but the last is it.
        let intervals = times_s.windows(2).map(|w| w[1] - w[0]);
        let rest = times_s.len().saturating_sub(2);
        let shortest = intervals.take(rest).filter(|&s| s > 0.0).fold(f64::INFINITY, f64::min);
        let rate_hz = if shortest.is_finite() { 1.0 / shortest } else { 0.0 };
        for message in time_problems(times_s, rate_hz) {
            report.add(&place, message);
        }
    }
}

fn message_problem(topic: &str, data: &[u8], config: &DatasetConfig) -> Option<String> {
    let content = match content::parse(topic, data) {
        Ok(content) => content,
        Err(error) => return Some(error),
    };
    match content {
        Content::Image { camera, file } => {
            let Some(spec) = config.rig.cameras.iter().find(|c| c.name == camera) else {
                return Some(format!("camera {camera} is not in the rig"));
            };
            match crate::color::decode(file, spec.width, spec.height) {
                Ok(rgb) => is_black(&rgb).then(|| "the image is black".into()),
                Err(error) => Some(format!("the image {error}")),
            }
        }
        Content::Depth { millimetres } => {
            let blind = millimetres.iter().all(|&byte| byte == 0);
            blind.then(|| "the image has no depth".into())
        }
        Content::Cloud { positions } => {
            let inside = |v: &f32| v.abs() <= CLOUD_RANGE_M;
            let far = !positions.iter().flatten().all(inside);
            far.then(|| format!("the cloud has points beyond {CLOUD_RANGE_M} m"))
        }
        Content::Joints { positions } => positions
            .iter()
            .any(|v| !v.is_finite())
            .then(|| "a joint position is NaN or infinite".into()),
        Content::Other => None,
    }
}
