//! Audit files: what physics made of the trajectories of one file, HDF5, beside it.
//!
//! | path | shape | type | unit |
//! |---|---|---|---|
//! | `episode` (position in the trajectory file) | `[N]` | u32 | |
//! | `id`, `reason` (empty on success) | `[N]` | text | |
//! | `success` | `[N]` | u8 | |
//! | `findings` | `[N]` | JSON text | in the names |
//! | `offset` | `[N + 1]` | u64 | samples |
//! | `phase` | `[M]` | u8 | |
//! | `traces/times` | `[M, 1]` | f32 | s |
//! | `traces/robot`, `traces/object` (what they really did) | `[M, columns]` | f32 | rad or m |
//! | `traces/tool` (`world_from_tool`, `x y z qw qx qy qz`) | `[M, 7]` | f32 | m |
//! | `traces/...` | `[M, columns]` | f32 | N, m, rad, 1 |
//!
//! Episode i owns the samples `offset[i] .. offset[i + 1]`. The attribute `columns` of a trace names its columns. Attributes of the
//! root hold the settings and the world (gains, resistance of the object's joints, error of the collision shapes) as JSON.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_model::trajectory::DensePath;
use akrobat_model::{JointPath, Phase};

use crate::error::{PackError, Result};
use crate::h5::{H5Reader, H5Writer};
use crate::trajectory_file::check_format;

/// Value of the root attribute `format`.
pub const FORMAT: &str = "akrobat.audit";

/// Value of the root attribute `format_version`; raised when older readers would misread a file.
pub const FORMAT_VERSION: u32 = 1;

/// A table of numbers over time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// Names of the columns; empty where the number of columns tells all.
    pub columns: Vec<String>,
    /// Values per sample.
    pub width: usize,
    /// Row-major values.
    pub values: Vec<f32>,
}

/// The findings about one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeAudit {
    /// Position in the trajectory file.
    pub episode: u32,
    /// Identity of the trajectory.
    pub id: String,
    /// Whether it succeeded.
    pub success: bool,
    /// Why it failed; empty on success.
    pub reason: String,
    /// Numbers by name, units in the names.
    pub findings: serde_json::Value,
    /// Phase of each sample, by its number.
    pub phase: Vec<u8>,
    /// Tables by name, one row per sample; `times`, `robot` and `object` are always there.
    pub traces: BTreeMap<String, Trace>,
}

impl EpisodeAudit {
    /// What robot and object really did, as a dense path; `None` where the traces do not fit together.
    pub fn simulated(&self) -> Option<DensePath> {
        let table = |name: &str| {
            let trace = self.traces.get(name)?;
            JointPath::from_values(trace.width, trace.values.clone())
        };
        let times = table("times")?;
        let phase = self.phase.iter().map(|&n| Phase::ALL.get(usize::from(n)).copied());
        let path = DensePath {
            times_s: times.values().iter().map(|&t| f64::from(t)).collect(),
            robot: table("robot")?,
            object: table("object")?,
            phase: phase.collect::<Option<_>>()?,
        };
        let rows = path.times_s.len();
        let whole = path.robot.rows() == rows && path.object.rows() == rows;
        (whole && path.phase.len() == rows && rows > 0).then_some(path)
    }
}

/// What an audit file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditFile {
    /// SHA-256 of the trajectory file that was replayed.
    pub trajectories_sha256: String,
    /// The physics settings.
    pub config: serde_json::Value,
    /// Gains, resistance of the object's joints, error of the collision shapes.
    pub world: serde_json::Value,
    /// The episodes, in the order of the trajectory file.
    pub episodes: Vec<EpisodeAudit>,
}

/// Writes an audit file.
///
/// # Errors
/// As [`crate::trajectory_file::write`]; `path` is left as it was then.
pub fn write(path: &Path, audit: &AuditFile) -> Result<()> {
    let file = H5Writer::create(path)?;
    let root = file.root();
    root.attr_str("format", FORMAT)?;
    root.attr("format_version", FORMAT_VERSION)?;
    root.attr_str("trajectories_sha256", &audit.trajectories_sha256)?;
    root.attr_str("config", &audit.config.to_string())?;
    root.attr_str("world", &audit.world.to_string())?;
    let episodes = &audit.episodes;
    let count = [episodes.len()];
    root.array("episode", &count, &each(episodes, |e| e.episode))?;
    root.strings("id", &each(episodes, |e| e.id.clone()))?;
    root.strings("reason", &each(episodes, |e| e.reason.clone()))?;
    root.array("success", &count, &each(episodes, |e| u8::from(e.success)))?;
    root.strings("findings", &each(episodes, |e| e.findings.to_string()))?;
    let mut offset = vec![0u64];
    for episode in episodes {
        offset.push(offset.last().unwrap_or(&0) + episode.phase.len() as u64);
    }
    root.array("offset", &[offset.len()], &offset)?;
    let phase: Vec<u8> = episodes.iter().flat_map(|e| e.phase.iter().copied()).collect();
    root.array("phase", &[phase.len()], &phase)?;
    let traces = root.group("traces")?;
    let names = episodes.first().map(|e| e.traces.keys()).into_iter().flatten();
    for name in names {
        let of_name = |e: &EpisodeAudit| e.traces.get(name).cloned().unwrap_or_default();
        let tables = each(episodes, of_name);
        let width = tables.first().map_or(1, |trace| trace.width);
        if tables
            .iter()
            .zip(episodes)
            .any(|(trace, e)| trace.width != width || trace.values.len() != width * e.phase.len())
        {
            return Err(PackError::inconsistent(
                path,
                format!("traces/{name}"),
                format!("{width} values for each sample of every episode"),
                "others",
            ));
        }
        let values: Vec<f32> = tables.iter().flat_map(|t| t.values.iter().copied()).collect();
        let dataset = traces.array(name, &[phase.len(), width], &values)?;
        let columns = tables.first().map(|trace| trace.columns.clone()).unwrap_or_default();
        let columns = serde_json::Value::from(columns).to_string();
        traces.dataset_attr_str(&dataset, "columns", &columns)?;
    }
    drop((root, traces));
    file.finish()
}

fn each<T>(episodes: &[EpisodeAudit], value: impl Fn(&EpisodeAudit) -> T) -> Vec<T> {
    episodes.iter().map(value).collect()
}

/// Reads an audit file.
///
/// # Errors
/// [`PackError::Read`], [`PackError::Damaged`] or [`PackError::Content`].
pub fn read(path: &Path) -> Result<AuditFile> {
    let file = H5Reader::open(path)?;
    check_format(&file, FORMAT, &[FORMAT_VERSION])?;
    let (numbers, shape) = file.array::<u32>("episode", &[None])?;
    let count = shape[0];
    let ids = file.strings("id", count)?;
    let reasons = file.strings("reason", count)?;
    let findings = file.strings("findings", count)?;
    let success = file.array::<u8>("success", &[Some(count)])?.0;
    let offset = file.array::<u64>("offset", &[count.checked_add(1)])?.0;
    let (phase, shape) = file.array::<u8>("phase", &[None])?;
    let samples = shape[0];
    if offset.first() != Some(&0) || offset.last() != Some(&(samples as u64)) || !offset.is_sorted()
    {
        let expected = format!("non-decreasing numbers from 0 to {samples}");
        return Err(PackError::content(path, "offset", expected, "others"));
    }
    let mut tables = BTreeMap::new();
    let members = file.group("traces")?.member_names();
    for name in members.map_err(|e| PackError::content(path, "traces", "tables", e.to_string()))? {
        let item = format!("traces/{name}");
        let (values, shape) = file.array::<f32>(&item, &[Some(samples), None])?;
        let columns = file.attr_json::<Vec<String>>(&*file.dataset(&item)?, "columns")?;
        tables.insert(name, (columns, shape[1], values));
    }
    let mut episodes = Vec::with_capacity(count);
    for index in 0..count {
        let rows = offset[index] as usize..offset[index + 1] as usize;
        let parsed = serde_json::from_str(&findings[index]);
        let traces = tables.iter().map(|(name, (columns, width, values))| {
            let values = values[rows.start * width..rows.end * width].to_vec();
            (name.clone(), Trace { columns: columns.clone(), width: *width, values })
        });
        episodes.push(EpisodeAudit {
            episode: numbers[index],
            id: ids[index].clone(),
            success: success[index] != 0,
            reason: reasons[index].clone(),
            findings: parsed
                .map_err(|e| PackError::content(path, "findings", "JSON", e.to_string()))?,
            phase: phase[rows.clone()].to_vec(),
            traces: traces.collect(),
        });
    }
    Ok(AuditFile {
        trajectories_sha256: file.attr_str(file.root(), "trajectories_sha256")?,
        config: file.attr_json(file.root(), "config")?,
        world: file.attr_json(file.root(), "world")?,
        episodes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn audit() -> AuditFile {
        let trace = |width: usize, values: &[f32]| Trace {
            columns: (0..width).map(|c| format!("c{c}")).collect(),
            width,
            values: values.to_vec(),
        };
        let episode = |number: u32, rows: usize| EpisodeAudit {
            episode: number,
            id: format!("id{number}"),
            success: number == 0,
            reason: if number == 0 { String::new() } else { "slipped".into() },
            findings: serde_json::json!({ "slip_max_m": 0.25 }),
            phase: vec![3; rows],
            traces: BTreeMap::from([
                ("times".into(), trace(1, &[0.0, 0.5, 1.0][..rows])),
                ("robot".into(), trace(2, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0][..2 * rows])),
                ("object".into(), trace(1, &[0.0, 0.1, 0.2][..rows])),
            ]),
        };
        AuditFile {
            trajectories_sha256: "00".into(),
            config: serde_json::json!({ "timestep_s": 0.004 }),
            world: serde_json::json!({}),
            episodes: vec![episode(0, 3), episode(4, 2)],
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.audit.h5");
        write(&path, &audit()).unwrap();
        let read = read(&path).unwrap();
        assert_eq!(read, audit());
        let path = read.episodes[1].simulated().unwrap();
        assert_eq!((path.len(), path.robot.row(1)), (2, &[2.0, 3.0][..]));
    }

    #[test]
    fn tables_of_the_wrong_length_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.audit.h5");
        let mut wrong = audit();
        wrong.episodes[1].traces.get_mut("robot").unwrap().values.pop();
        assert!(matches!(write(&path, &wrong), Err(PackError::Inconsistent { .. })));
        assert!(!path.exists());
    }

    #[test]
    fn traces_that_do_not_fit_give_no_path() {
        let mut wrong = audit().episodes.remove(0);
        wrong.phase.push(9);
        assert!(wrong.simulated().is_none());
    }
}
