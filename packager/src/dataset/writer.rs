//! Writing a dataset folder, interrupted or not.
//!
//! Episodes are assigned to shards by their order alone, and a shard's lines enter the manifest,
//! synced, only after the shard has its final name. An episode that turns out to be unusable keeps its place,
//! so that which shard an episode belongs to is known before anything is rendered. Whatever a killed run leaves beyond the
//! manifest is deleted on resuming and written again, so the finished folder has the same bytes.

use std::collections::{BTreeSet, HashSet};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use akrobat_cameras::Observation;

use super::description::{DESCRIPTION, Description};
use super::manifest::{
    self, Container, DatasetConfig, MANIFEST, ManifestEntry, Status, StoredEpisode,
};
use super::reader::DatasetReader;
use crate::episode::EpisodeInfo;
use crate::error::{PackError, Result};
use crate::folder_lock::FolderLock;
use crate::mcap_log::McapWriter;
use crate::shard::ShardWriter;
use crate::whole_file::{self, PARTIAL_SUFFIX};

/// Folder of the shards in a dataset folder.
pub(crate) const SHARD_FOLDER: &str = "shards";

/// Creates `folder` where it is absent and makes sure that files can be created in it.
///
/// # Errors
/// [`PackError::Unwritable`], or [`PackError::Io`] where the disk is full.
pub fn check_writable(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| PackError::create(folder, e))?;
    tempfile::tempfile_in(folder).map_err(|e| PackError::create(folder, e))?;
    Ok(())
}

/// Writes a dataset.
#[derive(Debug)]
pub struct DatasetWriter {
    _lock: FolderLock,
    folder: PathBuf,
    config: DatasetConfig,
    /// Ids of all episodes in the manifest or pending.
    known: HashSet<String>,
    /// Number of the open shard, or of the next.
    shards: u32,
    /// Episodes that were begun in it.
    begun: u32,
    shard: Option<OpenShard>,
    /// Lines that enter the manifest when the open shard is closed.
    pending: Vec<ManifestEntry>,
    /// Line of the episode between begin and finish.
    current: Option<ManifestEntry>,
}

#[derive(Debug)]
enum OpenShard {
    Hdf5(Box<ShardWriter>),
    Mcap(Box<McapWriter>),
}

impl DatasetWriter {
    /// Starts a dataset in a folder that is empty or does not exist.
    ///
    /// # Errors
    /// [`PackError::Unwritable`] where the folder cannot be written or holds something already.
    pub fn create(folder: &Path, config: DatasetConfig) -> Result<Self> {
        Self::create_part(folder, config, 0)
    }

    /// Starts a part of a dataset: its first shard has this number, and its lines are to be put behind
    /// those of the parts before it.
    ///
    /// # Errors
    /// As [`DatasetWriter::create`].
    pub fn create_part(folder: &Path, config: DatasetConfig, first_shard: u32) -> Result<Self> {
        check_writable(folder)?;
        let lock = FolderLock::exclusive(folder)?;
        let mut entries = std::fs::read_dir(folder).map_err(|e| PackError::create(folder, e))?;
        if entries.next().is_some() {
            let message = "the folder is not empty; resume the dataset in it or choose another";
            let source = std::io::Error::new(std::io::ErrorKind::AlreadyExists, message);
            return Err(PackError::Unwritable { path: folder.to_path_buf(), source });
        }
        Ok(Self { shards: first_shard, ..Self::start(lock, folder, config)? })
    }

    /// Continues a dataset that a run of the same configuration left, or starts one.
    ///
    /// # Errors
    /// [`PackError::Content`] where the folder's dataset has another configuration or its whole shards
    /// are gone, and as [`DatasetWriter::create`].
    pub fn resume(folder: &Path, config: DatasetConfig) -> Result<Self> {
        check_writable(folder)?;
        if !folder.join(DESCRIPTION).exists() {
            remove_partial(folder)?;
            // The run was killed after its first step. A folder with content stays, and is refused.
            let _ = std::fs::remove_dir(folder.join(SHARD_FOLDER));
            return Self::create(folder, config);
        }
        let lock = FolderLock::exclusive(folder)?;
        refuse_links(folder)?;
        let description = Description::read(folder)?;
        if description.config != as_read(&config) {
            return Err(PackError::content(
                &folder.join(DESCRIPTION),
                "config",
                "the configuration that the dataset was begun with",
                "another one",
            ));
        }
        let manifest = folder.join(MANIFEST);
        if !manifest.exists() {
            // The run was killed between the description and the manifest.
            return Self::start(lock, folder, config);
        }
        let (entries, whole_bytes) = manifest::read(folder)?;
        truncate(&manifest, whole_bytes)?;
        let shards_before = next_shard(&config, &entries);
        let stored: Vec<&str> =
            entries.iter().filter_map(|e| e.stored.as_ref()).map(|s| s.shard.as_str()).collect();
        let shards: HashSet<&str> = stored.into_iter().collect();
        remove_unlisted(folder, &shards)?;
        let known = entries.into_iter().map(|e| e.id).collect();
        Description::open(config.clone()).write(folder)?;
        Ok(Self { known, shards: shards_before, ..Self::empty(lock, folder, config) })
    }

    fn start(lock: FolderLock, folder: &Path, config: DatasetConfig) -> Result<Self> {
        if let Some(problem) = config.storage.problem() {
            return Err(PackError::inconsistent(folder, "dataset", "possible storage", problem));
        }
        let shards = folder.join(SHARD_FOLDER);
        std::fs::create_dir_all(&shards).map_err(|e| PackError::create(&shards, e))?;
        Description::open(config.clone()).write(folder)?;
        whole_file::write(&folder.join(MANIFEST), b"")?;
        Ok(Self::empty(lock, folder, config))
    }

    fn empty(lock: FolderLock, folder: &Path, config: DatasetConfig) -> Self {
        Self {
            _lock: lock,
            folder: folder.to_path_buf(),
            config,
            known: HashSet::new(),
            shards: 0,
            begun: 0,
            shard: None,
            pending: Vec::new(),
            current: None,
        }
    }

    /// True where the episode is dealt with already, by this run or the one that is resumed.
    pub fn contains(&self, id: &str) -> bool {
        self.known.contains(id)
    }

    /// Starts an episode. All runs must bring the episodes in the same order.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where the id is known already, another episode is open, or the rig
    /// is not the dataset's; [`PackError::Unwritable`] and [`PackError::Io`].
    pub fn begin_episode(&mut self, info: EpisodeInfo) -> Result<()> {
        self.check_new(&info.id)?;
        if info.rig != self.config.rig {
            let item = format!("episode {}", info.id);
            let expected = format!("the dataset's rig {}", self.config.rig.name);
            let got = format!("rig {}", info.rig.name);
            return Err(PackError::inconsistent(&self.folder, item, expected, got));
        }
        let shard = self.shard_name();
        let path = self.folder.join(&shard);
        let mut stored = StoredEpisode {
            shard,
            key: String::new(),
            shard_sha256: String::new(),
            frames: info.frames,
            success: info.success,
            seed: info.seed,
            traj_index: info.traj_index,
            grasp_id: info.grasp_id,
            start: info.start,
            start_state: String::new(),
            goal: info.goal,
            scene_id: info.scene_id.clone(),
            object_id: info.object_id.clone(),
            robot_id: info.robot_id.clone(),
        };
        let id = info.id.clone();
        match self.config.container {
            Container::Hdf5 => stored.key = self.hdf5_shard(&path)?.begin_episode(info)?,
            Container::Mcap => {
                let writer = McapWriter::create(&path, info, &self.config)?;
                self.shard = Some(OpenShard::Mcap(Box::new(writer)));
            }
        }
        let entry = ManifestEntry {
            id,
            status: Status::Accepted,
            reason: String::new(),
            split: None,
            stored: Some(stored),
        };
        self.current = Some(entry);
        Ok(())
    }

    /// Takes the next frame of the open episode.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where the observation does not fit, [`PackError::Io`].
    pub fn push(&mut self, observation: Observation) -> Result<()> {
        if observation.frame == 0 {
            let joints = observation.robot.iter().chain(&observation.object);
            let state = manifest::start_state(joints.map(|&v| v as f32));
            if let Some(stored) = self.current.as_mut().and_then(|entry| entry.stored.as_mut()) {
                stored.start_state = state;
            }
        }
        match &mut self.shard {
            Some(OpenShard::Hdf5(shard)) => shard.push(observation),
            Some(OpenShard::Mcap(log)) => log.push(&observation),
            None => Err(self.no_episode()),
        }
    }

    /// Completes the open episode, and the shard where it is full.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where frames are missing, [`PackError::Io`].
    pub fn finish_episode(&mut self) -> Result<()> {
        let entry = self.current.take().ok_or_else(|| self.no_episode())?;
        match &mut self.shard {
            Some(OpenShard::Hdf5(shard)) => shard.finish_episode()?,
            Some(OpenShard::Mcap(_)) => {}
            None => return Err(self.no_episode()),
        }
        self.settle(entry)
    }

    /// Gives up the open episode, whose frames turned out to be unusable, and records why.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where no episode is open, [`PackError::Io`].
    pub fn quarantine_episode(&mut self, reason: &str) -> Result<()> {
        let mut entry = self.current.take().ok_or_else(|| self.no_episode())?;
        match &mut self.shard {
            Some(OpenShard::Hdf5(shard)) => shard.abandon_episode()?,
            Some(OpenShard::Mcap(_)) => self.shard = None,
            None => return Err(self.no_episode()),
        }
        entry.status = Status::Quarantined;
        entry.reason = reason.to_owned();
        entry.stored = None;
        self.settle(entry)
    }

    /// Takes over an episode of another dataset as it is stored there.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where the id is known already or an episode is open, and where reading
    /// or writing fails.
    pub fn copy_episode(&mut self, source: &DatasetReader, entry: &ManifestEntry) -> Result<()> {
        self.check_new(&entry.id)?;
        let Some(stored) = &entry.stored else {
            self.known.insert(entry.id.clone());
            self.pending.push(entry.clone());
            return Ok(());
        };
        let mut copied = StoredEpisode { shard: self.shard_name(), ..stored.clone() };
        let path = self.folder.join(&copied.shard);
        match self.config.container {
            Container::Hdf5 => {
                let episode = source.episode(stored)?;
                copied.key = self.hdf5_shard(&path)?.copy_episode(&episode)?;
            }
            Container::Mcap => {
                whole_file::copy(&source.file_of(stored)?, &path)?;
                copied.shard_sha256 = sha256_of_file(&path)?;
            }
        }
        self.settle(ManifestEntry { stored: Some(copied), ..entry.clone() })
    }

    /// Takes the line of an episode that is done with, and closes the shard where it is full.
    fn settle(&mut self, entry: ManifestEntry) -> Result<()> {
        self.known.insert(entry.id.clone());
        self.pending.push(entry);
        self.begun += 1;
        let storage = &self.config.storage;
        let full = self.begun >= episodes_per_file(&self.config);
        let large = match &self.shard {
            Some(OpenShard::Hdf5(shard)) => storage.shard_bytes.is_some_and(|b| shard.size() >= b),
            _ => false,
        };
        if full || large { self.close_shard() } else { Ok(()) }
    }

    /// Records an episode that is not stored.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where the id is known already or an episode is open.
    pub fn skip_episode(&mut self, id: &str, status: Status, reason: &str) -> Result<()> {
        self.check_new(id)?;
        self.known.insert(id.to_owned());
        self.pending.push(ManifestEntry {
            id: id.to_owned(),
            status,
            reason: reason.to_owned(),
            split: None,
            stored: None,
        });
        Ok(())
    }

    /// Closes the last shard and marks the dataset as complete.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where an episode is still open, [`PackError::Io`].
    pub fn close(mut self) -> Result<()> {
        if let Some(entry) = &self.current {
            let item = format!("episode {}", entry.id);
            return Err(PackError::inconsistent(
                &self.folder,
                item,
                "it to be finished",
                "it open",
            ));
        }
        self.close_shard()?;
        let manifest_sha256 = sha256_of_file(&self.folder.join(MANIFEST))?;
        Description::complete(self.config.clone(), manifest_sha256).write(&self.folder)
    }

    fn shard_name(&self) -> String {
        shard_name(self.config.container, self.shards)
    }

    fn hdf5_shard(&mut self, path: &Path) -> Result<&mut ShardWriter> {
        if self.shard.is_none() {
            let writer = ShardWriter::create(path, &self.config)?;
            self.shard = Some(OpenShard::Hdf5(Box::new(writer)));
        }
        match &mut self.shard {
            Some(OpenShard::Hdf5(shard)) => Ok(shard),
            _ => unreachable!("the container of a dataset never changes"),
        }
    }

    fn close_shard(&mut self) -> Result<()> {
        let stored = self.pending.iter().any(|entry| entry.stored.is_some());
        // A shard of which nothing remained is not kept.
        let shard = self.shard.take().filter(|_| stored);
        if let Some(shard) = shard {
            match shard {
                OpenShard::Hdf5(shard) => shard.finish()?,
                OpenShard::Mcap(log) => log.finish()?,
            }
            let sha256 = sha256_of_file(&self.folder.join(self.shard_name()))?;
            for stored in self.pending.iter_mut().filter_map(|e| e.stored.as_mut()) {
                stored.shard_sha256.clone_from(&sha256);
            }
        }
        // Where bytes close shards, numbers cannot be known in advance, and none is left out.
        if stored || (self.begun > 0 && self.config.storage.shard_bytes.is_none()) {
            self.shards += 1;
        }
        self.begun = 0;
        let lines = manifest::to_lines(&self.pending);
        self.pending.clear();
        append(&self.folder.join(MANIFEST), &lines)
    }

    fn check_new(&self, id: &str) -> Result<()> {
        let got = match (&self.current, self.known.contains(id)) {
            (Some(open), _) => format!("episode {} open", open.id),
            (None, true) => "it is in the dataset already".to_owned(),
            (None, false) => return Ok(()),
        };
        Err(PackError::inconsistent(&self.folder, format!("episode {id}"), "a new episode", got))
    }

    fn no_episode(&self) -> PackError {
        PackError::inconsistent(&self.folder, "a frame", "an episode to be begun", "none")
    }
}

/// Name of shard or log `number`, relative to the dataset folder.
pub(crate) fn shard_name(container: Container, number: u32) -> String {
    match container {
        Container::Hdf5 => format!("{SHARD_FOLDER}/shard_{number:06}.hdf5"),
        Container::Mcap => format!("{SHARD_FOLDER}/episode_{number:06}.mcap"),
    }
}

/// Episodes that are begun in one file before the next is opened.
fn episodes_per_file(config: &DatasetConfig) -> u32 {
    match config.container {
        Container::Hdf5 => config.storage.episodes_per_shard.max(1),
        Container::Mcap => 1,
    }
}

/// Number of the shard that follows those of the manifest.
fn next_shard(config: &DatasetConfig, entries: &[ManifestEntry]) -> u32 {
    if config.storage.shard_bytes.is_some() && config.container == Container::Hdf5 {
        let files = entries.iter().filter_map(|e| e.stored.as_ref()).map(|s| s.shard.as_str());
        return files.collect::<HashSet<_>>().len() as u32;
    }
    let begun = entries.iter().filter(|e| e.status != Status::Filtered).count() as u32;
    // After a repair, fewer episodes than shards may be left; no file is written over.
    let number = |name: &str| name.rsplit_once('_')?.1.split_once('.')?.0.parse::<u32>().ok();
    let files = entries.iter().filter_map(|e| number(&e.stored.as_ref()?.shard));
    let last = files.max().map_or(0, |number| number + 1);
    begun.div_ceil(episodes_per_file(config)).max(last)
}

/// What is written and deleted in a dataset folder must lie in it.
pub(super) fn refuse_links(folder: &Path) -> Result<()> {
    for path in [folder.join(SHARD_FOLDER), folder.join(MANIFEST), folder.join(DESCRIPTION)] {
        if path.is_symlink() {
            let expected = "a dataset without symbolic links";
            return Err(PackError::content(&path, "file", expected, "a symbolic link"));
        }
    }
    Ok(())
}

/// Puts the parts of a dataset together, in order: their shards move into `folder`, and their lines make its
/// manifest. May be called again after an interruption.
///
/// # Errors
/// [`PackError::Content`] where a part lacks a shard that it lists, [`PackError::Io`].
pub fn publish_parts(folder: &Path, config: DatasetConfig, parts: &[PathBuf]) -> Result<()> {
    let shards = folder.join(SHARD_FOLDER);
    std::fs::create_dir_all(&shards).map_err(|e| PackError::create(&shards, e))?;
    refuse_links(folder)?;
    let mut lines = String::new();
    for part in parts {
        let (entries, _) = manifest::read(part)?;
        let names: BTreeSet<&str> =
            entries.iter().filter_map(|e| e.stored.as_ref()).map(|s| s.shard.as_str()).collect();
        for name in names {
            let (from, to) = (part.join(name), folder.join(name));
            if from.is_file() {
                std::fs::rename(&from, &to).map_err(|e| PackError::io(&to, e))?;
            } else if !to.is_file() {
                return Err(PackError::content(&from, "shard", "the file that is listed", "none"));
            }
        }
        lines += &manifest::to_lines(&entries);
    }
    whole_file::sync_folder_of(&shards.join(MANIFEST))?;
    whole_file::write(&folder.join(MANIFEST), lines.as_bytes())?;
    let sha256 = akrobat_model::hash::of_bytes(lines.as_bytes());
    Description::complete(config, sha256).write(folder)
}

fn append(path: &Path, lines: &str) -> Result<()> {
    if lines.is_empty() {
        return Ok(());
    }
    let mut file =
        OpenOptions::new().append(true).open(path).map_err(|e| PackError::create(path, e))?;
    file.write_all(lines.as_bytes())
        .and_then(|()| file.sync_all())
        .map_err(|e| PackError::io(path, e))
}

fn truncate(path: &Path, length: u64) -> Result<()> {
    let file = OpenOptions::new().write(true).open(path).map_err(|e| PackError::create(path, e))?;
    file.set_len(length).and_then(|()| file.sync_all()).map_err(|e| PackError::io(path, e))
}

/// Lower-case hexadecimal SHA-256 of a file, read in pieces.
pub(crate) fn sha256_of_file(path: &Path) -> Result<String> {
    use sha2::{Digest, Sha256};
    let mut file = std::fs::File::open(path).map_err(|e| PackError::read(path, e))?;
    let mut digest = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        match std::io::Read::read(&mut file, &mut buffer).map_err(|e| PackError::io(path, e))? {
            0 => break,
            count => digest.update(&buffer[..count]),
        }
    }
    Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

pub(super) fn remove_partial(folder: &Path) -> Result<()> {
    for path in files_in(folder)? {
        if path.as_os_str().to_string_lossy().ends_with(PARTIAL_SUFFIX) {
            std::fs::remove_file(&path).map_err(|e| PackError::io(&path, e))?;
        }
    }
    Ok(())
}

/// Deletes temporary files, and shards that never reached the manifest.
fn remove_unlisted(folder: &Path, listed: &HashSet<&str>) -> Result<()> {
    remove_partial(folder)?;
    let shards = folder.join(SHARD_FOLDER);
    std::fs::create_dir_all(&shards).map_err(|e| PackError::create(&shards, e))?;
    for path in files_in(&shards)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if !listed.contains(format!("{SHARD_FOLDER}/{name}").as_str()) {
            std::fs::remove_file(&path).map_err(|e| PackError::io(&path, e))?;
        }
    }
    for name in listed {
        let path = folder.join(name);
        if !path.is_file() {
            return Err(PackError::content(
                &path,
                "shard",
                "the file that the manifest lists",
                "none",
            ));
        }
    }
    Ok(())
}

pub(super) fn files_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| PackError::io(folder, e))?;
    let paths = entries.map(|entry| entry.map(|e| e.path())).collect::<std::io::Result<Vec<_>>>();
    Ok(paths.map_err(|e| PackError::io(folder, e))?.into_iter().filter(|p| p.is_file()).collect())
}

/// A configuration as it is read back: reading may round the last digit of a number.
fn as_read(config: &DatasetConfig) -> DatasetConfig {
    let text = serde_json::to_string(config).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_else(|_| config.clone())
}
