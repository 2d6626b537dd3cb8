//! Recordings of other tools as motions to replay: AutoMoMa's recorder (and robomimic files like it) and
//! ManiSkill.
//!
//! AutoMoMa: `data/demo_<i>/states/articulation/{robot, <object>}/joint_position`, or `obs/joint_pos` for the
//! robot where the states lack it. ManiSkill: `traj_<i>/env_states/articulations/<name> [T, 13 + 2 n]`,
//! of which the n joint positions follow the 13 values of the root.

use std::path::Path;

use crate::error::{PackError, Result};
use crate::h5::H5Reader;

/// Longest recording that is believed.
const MAX_ROWS: usize = 1 << 21;

/// Values of an articulation's root before its joint positions in ManiSkill's states.
const MANISKILL_ROOT: usize = 13;

/// One recorded motion, a row for each frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Name of its group in the file, or its number.
    pub key: String,
    /// Number of rows.
    pub rows: usize,
    /// Robot joint positions `[rows, columns]`, rad or m.
    pub robot: Vec<f32>,
    /// Object joint positions `[rows, columns]`, rad or m.
    pub object: Vec<f32>,
    /// Whether the recorder called it a success.
    pub success: bool,
    /// Number of the grasp, where it is known.
    pub grasp_id: u32,
    /// Seed, where it is known.
    pub seed: u64,
}

/// The motions of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Recordings {
    /// Which tool wrote the file.
    pub tool: &'static str,
    /// Number of robot columns.
    pub robot_columns: usize,
    /// Number of object columns.
    pub object_columns: usize,
    /// True where the rows are waypoints, equally many in each motion, rather than frames.
    pub waypoints: bool,
    /// The motions, in the file's order.
    pub motions: Vec<Recording>,
}

/// Reads an HDF5 recording. `robot` and `object` are the names to look for; AutoMoMa calls every robot
/// `robot`.
///
/// # Errors
/// [`PackError::Read`], [`PackError::Damaged`] or [`PackError::Content`].
pub fn read_recording(path: &Path, robot: &str, object: &str) -> Result<Recordings> {
    let file = H5Reader::open(path)?;
    let reader = Reader { file: &file, path, robot, object };
    if file.root().link_exists("data") {
        reader.recordings("automoma", "data", "demo_", |key| reader.automoma(key))
    } else {
        reader.recordings("maniskill", "/", "traj_", |key| reader.maniskill(key))
    }
}

struct Reader<'a> {
    file: &'a H5Reader,
    path: &'a Path,
    robot: &'a str,
    object: &'a str,
}

/// A table of joint positions with its number of columns.
type Positions = (Vec<f32>, usize);

impl Reader<'_> {
    fn recordings(
        &self,
        tool: &'static str,
        folder: &str,
        prefix: &str,
        read: impl Fn(&str) -> Result<(Recording, [usize; 2])>,
    ) -> Result<Recordings> {
        let mut numbers: Vec<u64> = self
            .members(folder)?
            .iter()
            .filter_map(|name| name.strip_prefix(prefix)?.parse().ok())
            .collect();
        numbers.sort_unstable();
        let mut motions = Vec::new();
        let mut columns = None;
        for number in numbers {
            let key = format!("{prefix}{number}");
            let (motion, found) = read(&key)?;
            if columns.is_some_and(|columns| columns != found) {
                let expected = format!("{columns:?} robot and object columns, as before");
                return Err(PackError::content(self.path, key, expected, format!("{found:?}")));
            }
            columns = Some(found);
            motions.push(motion);
        }
        let Some([robot_columns, object_columns]) = columns else {
            let expected = "groups data/demo_<i> (AutoMoMa, robomimic) or traj_<i> (ManiSkill)";
            return Err(PackError::content(self.path, folder, expected, "none"));
        };
        Ok(Recordings { tool, robot_columns, object_columns, waypoints: false, motions })
    }

    fn automoma(&self, key: &str) -> Result<(Recording, [usize; 2])> {
        let place = format!("data/{key}");
        let states = format!("{place}/states/articulation");
        let names = self.members(&states)?;
        let robot_name = ["robot", self.robot].into_iter().find(|n| names.iter().any(|m| m == n));
        let robot = match robot_name {
            Some(name) => self.table(&format!("{states}/{name}/joint_position"))?,
            None => self.table(&format!("{place}/obs/joint_pos"))?,
        };
        let object = self.named_or_other(&states, &names, robot_name)?;
        let object = self.table(&format!("{states}/{object}/joint_position"))?;
        self.recording(key, &place, robot, object)
    }

    fn maniskill(&self, key: &str) -> Result<(Recording, [usize; 2])> {
        let states = format!("{key}/env_states/articulations");
        let names = self.members(&states)?;
        let robot = names.iter().find(|name| *name == self.robot);
        let Some(robot) = robot.or_else(|| names.iter().find(|name| *name != self.object)) else {
            let expected = format!("the robot \"{}\"", self.robot);
            return Err(PackError::content(self.path, states, expected, names.join(", ")));
        };
        let object = self.named_or_other(&states, &names, Some(robot))?;
        let robot = self.joints_of_state(&format!("{states}/{robot}"))?;
        let object = self.joints_of_state(&format!("{states}/{object}"))?;
        self.recording(key, key, robot, object)
    }

    /// The object by its name, or the only articulation that is not the robot.
    fn named_or_other(
        &self,
        states: &str,
        names: &[String],
        robot: Option<&str>,
    ) -> Result<String> {
        if let Some(name) = names.iter().find(|name| *name == self.object) {
            return Ok(name.clone());
        }
        let others: Vec<&String> =
            names.iter().filter(|name| Some(name.as_str()) != robot).collect();
        match others[..] {
            [only] => Ok(only.clone()),
            _ => {
                let expected = format!("the object \"{}\"", self.object);
                Err(PackError::content(self.path, states, expected, names.join(", ")))
            }
        }
    }

    fn recording(
        &self,
        key: &str,
        place: &str,
        (robot, robot_columns): Positions,
        (object, object_columns): Positions,
    ) -> Result<(Recording, [usize; 2])> {
        let rows = robot.len() / robot_columns;
        if object.len() / object_columns != rows {
            let (expected, got) = (format!("{rows} rows"), object.len() / object_columns);
            return Err(PackError::content(
                self.path,
                key,
                expected,
                format!("{got} of the object"),
            ));
        }
        let group = self.file.group(place)?;
        let recording = Recording {
            key: key.to_owned(),
            rows,
            robot,
            object,
            success: self.file.attr(&group, "success").unwrap_or(true),
            grasp_id: self.file.attr(&group, "grasp_id").unwrap_or(0),
            seed: self.file.attr(&group, "seed").unwrap_or(0),
        };
        Ok((recording, [robot_columns, object_columns]))
    }

    fn joints_of_state(&self, place: &str) -> Result<Positions> {
        let (values, columns) = self.table(place)?;
        if columns <= MANISKILL_ROOT || !(columns - MANISKILL_ROOT).is_multiple_of(2) {
            let expected = format!("{MANISKILL_ROOT} + 2 n columns");
            return Err(PackError::content(self.path, place, expected, columns.to_string()));
        }
        let joints = (columns - MANISKILL_ROOT) / 2;
        let rows = values.chunks(columns);
        let positions = rows.flat_map(|row| &row[MANISKILL_ROOT..][..joints]).copied();
        Ok((positions.collect(), joints))
    }

    /// A table of finite numbers, in single or double precision.
    fn table(&self, place: &str) -> Result<Positions> {
        let any = [None, None];
        let (values, shape) = match self.file.array::<f32>(place, &any) {
            Ok(found) => found,
            Err(single) => match self.file.array::<f64>(place, &any) {
                Ok((values, shape)) => (values.iter().map(|&v| v as f32).collect(), shape),
                Err(_) => return Err(single),
            },
        };
        let [rows, columns] = [shape[0], shape[1]];
        if !(2..=MAX_ROWS).contains(&rows) || columns == 0 {
            let expected = format!("2 to {MAX_ROWS} rows of joint positions");
            return Err(PackError::content(self.path, place, expected, format!("{shape:?}")));
        }
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            let item = format!("{place} row {} column {}", at / columns, at % columns);
            return Err(PackError::content(self.path, item, "a number", values[at].to_string()));
        }
        Ok((values, columns))
    }

    fn members(&self, place: &str) -> Result<Vec<String>> {
        let group = self.file.group(place)?;
        let names = group.member_names();
        names.map_err(|e| crate::h5::read_error(self.path, place, &e))
    }
}
