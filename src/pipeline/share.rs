//! One dataset made by several processes.
//!
//! A part is what goes into one HDF5 shard: the next trajectories that the judge has not refused. It is made
//! as a dataset of its own in an attempt folder, which is renamed into place when it is whole. When all parts are
//! there, they are put together to the bytes that one process would have written.

use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use akrobat_packager::dataset::{Container, DatasetConfig, publish_parts};
use akrobat_packager::{DatasetReader, DatasetWriter, FolderLock, check_writable};
use akrobat_renderer::Backend;

use super::render::{Job, RenderReport, Tally, interrupted};
use crate::Error;
use crate::jobs::{Claim, JobFolder, Ledger};

/// How long a worker sleeps before it asks the ledger again.
const PAUSE: Duration = Duration::from_millis(200);

/// Trajectories of one part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Part {
    /// Positions in the trajectory file, with those that the judge has refused.
    positions: Vec<usize>,
    /// Episodes that are rendered in the parts before.
    rendered_before: usize,
}

/// Cuts a job into parts.
pub(super) fn parts(job: &Job<'_>, selected: &[usize]) -> Vec<Part> {
    let per_part = job.request.storage.episodes_per_shard.max(1) as usize;
    let mut parts = vec![Part { positions: Vec::new(), rendered_before: 0 }];
    let mut rendered = 0;
    for &index in selected {
        let last = parts.last_mut().expect("there is always one");
        if rendered - last.rendered_before == per_part {
            parts.push(Part { positions: vec![index], rendered_before: rendered });
        } else {
            last.positions.push(index);
        }
        rendered += usize::from(job.refusal(index).is_none());
    }
    parts
}

/// Makes parts as long as there are any, beside other processes, and puts them together in the end.
pub(super) fn join(
    job: &Job<'_>,
    selected: &[usize],
    backend: &mut dyn Backend,
) -> Result<RenderReport, Error> {
    job.check_placement(selected)?;
    let shared = Shared::new(job, selected)?;
    let mut tally = Tally::new(job, job.frames(selected));
    if shared.is_complete() {
        shared.put_together()?;
        tally.report.resumed = selected.len() as u64;
        return Ok(tally.finish());
    }
    let lock = FolderLock::shared(&job.request.output)?;
    let worker = shared.worker_folder()?;
    let _alive = FolderLock::exclusive(worker.path())?;
    let mut ledger = shared.ledger()?;
    if job.request.resume {
        ledger.retry_failed()?;
    }
    loop {
        match ledger.claim(worker.path())? {
            Claim::Make { part, attempt } => {
                shared.attempt(part, attempt, worker.path(), &mut ledger, backend, &mut tally)?;
            }
            Claim::Wait if job.observer.cancelled() => {
                return Err(interrupted(&job.request.output));
            }
            Claim::Wait => std::thread::sleep(PAUSE),
            Claim::Finished => break,
        }
    }
    let failures = ledger.failures()?;
    if let Some((part, error)) = failures.first() {
        return Err(Error::Failed(format!(
            "{}: {} shards were given up; the first, {part}, with: {error}; the others are kept, \
             and --resume tries them again",
            job.request.output.display(),
            failures.len()
        )));
    }
    drop((ledger, worker, lock));
    shared.put_together()?;
    Ok(tally.finish())
}

/// Makes the parts with these numbers, which no other process is given, and leaves the rest to `join`.
pub(super) fn make(
    job: &Job<'_>,
    selected: &[usize],
    wanted: &[usize],
    backend: &mut dyn Backend,
) -> Result<RenderReport, Error> {
    let shared = Shared::new(job, selected)?;
    if let Some(part) = wanted.iter().find(|&&part| part >= shared.parts.len()) {
        let last = shared.parts.len() - 1;
        return Err(Error::Usage(format!(
            "--only-shards: no shard {part}; valid choices: 0 to {last}"
        )));
    }
    job.check_placement(selected)?;
    let _lock = FolderLock::shared(&job.request.output)?;
    let positions: Vec<usize> =
        wanted.iter().flat_map(|&part| shared.parts[part].positions.clone()).collect();
    let mut tally = Tally::new(job, job.frames(&positions));
    for &part in wanted {
        if shared.is_complete() || shared.folder.part(part).is_dir() {
            tally.report.resumed += shared.parts[part].positions.len() as u64;
            continue;
        }
        let worker = shared.worker_folder()?;
        let place = worker.path().join("attempt");
        shared.render(part, &place, backend, &mut tally, &mut || Ok(()))?;
        shared.put_in_place(part, &place)?;
    }
    Ok(tally.finish())
}

/// A job that several processes work on.
struct Shared<'a> {
    job: &'a Job<'a>,
    ids: HashSet<String>,
    parts: Vec<Part>,
    folder: JobFolder,
}

impl<'a> Shared<'a> {
    fn new(job: &'a Job<'a>, selected: &[usize]) -> Result<Self, Error> {
        if job.request.storage.shard_bytes.is_some() {
            return Err(Error::Usage(
                "--shard-bytes: how many episodes fit is not known before they are rendered, so \
                 they cannot be shared between processes; use --episodes-per-shard"
                    .into(),
            ));
        }
        let output = &job.request.output;
        check_writable(output)?;
        let folder = JobFolder::of(output);
        let ids = job.ids(selected).map(String::from).collect();
        let shared = Self { job, ids, parts: parts(job, selected), folder };
        if shared.is_complete() {
            return Ok(shared);
        }
        if !shared.folder.path().is_dir() {
            shared.begin(output)?;
        }
        shared.check_fingerprint()?;
        Ok(shared)
    }

    /// Makes the job's folder in an output that nobody else uses.
    fn begin(&self, output: &Path) -> Result<(), Error> {
        let entries = std::fs::read_dir(output).map_err(|e| Error::write(output, &e))?;
        let foreign = entries.flatten().any(|entry| entry.file_name() != crate::jobs::JOB_FOLDER);
        if foreign {
            return Err(Error::Usage(format!(
                "{}: the folder is not empty; choose another for a shared job",
                output.display()
            )));
        }
        for folder in [self.folder.attempts(), self.folder.path().join("parts")] {
            std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, &e))?;
        }
        Ok(())
    }

    /// The first process of a job says which it is; parts of another must not be taken for its own.
    fn check_fingerprint(&self) -> Result<(), Error> {
        let (own, file) = (self.fingerprint(), self.folder.fingerprint());
        let folder = self.folder.path();
        let mut first =
            tempfile::NamedTempFile::new_in(folder).map_err(|e| Error::write(folder, &e))?;
        first.write_all(own.as_bytes()).map_err(|e| Error::write(&file, &e))?;
        if first.persist_noclobber(&file).is_ok() {
            return Ok(());
        }
        let known = std::fs::read_to_string(&file).map_err(|e| Error::write(&file, &e))?;
        if known == own {
            return Ok(());
        }
        Err(Error::Usage(format!(
            "{}: another job was begun here; use the command it was begun with, or another output",
            self.job.request.output.display()
        )))
    }

    /// True where the datasets are there and hold this job's episodes.
    fn is_complete(&self) -> bool {
        self.job.datasets(&self.job.request.output).iter().all(|(folder, config)| {
            DatasetReader::open(folder).is_ok_and(|dataset| {
                dataset.is_complete()
                    && dataset.config() == config
                    && dataset.entries().len() == self.ids.len()
                    && dataset.entries().iter().all(|entry| self.ids.contains(&entry.id))
            })
        })
    }

    fn worker_folder(&self) -> Result<tempfile::TempDir, Error> {
        let attempts = self.folder.attempts();
        std::fs::create_dir_all(&attempts).map_err(|e| Error::write(&attempts, &e))?;
        tempfile::tempdir_in(&attempts).map_err(|e| Error::write(&attempts, &e))
    }

    fn ledger(&self) -> Result<Ledger, Error> {
        Ledger::open(&self.folder.ledger(), &self.fingerprint(), self.parts.len(), |part| {
            self.folder.part(part).is_dir()
        })
    }

    /// Stands for everything that decides what the parts hold.
    fn fingerprint(&self) -> String {
        let output = &self.job.request.output;
        let configs: Vec<DatasetConfig> =
            self.job.datasets(output).into_iter().map(|(_, config)| config).collect();
        let mut ids: Vec<&String> = self.ids.iter().collect();
        ids.sort();
        let all = serde_json::json!([configs, ids, self.job.request.manipulation_only]);
        akrobat_model::hash::of_bytes(all.to_string().as_bytes())
    }

    /// One attempt at a part.
    fn attempt(
        &self,
        part: usize,
        attempt: u32,
        worker: &Path,
        ledger: &mut Ledger,
        backend: &mut dyn Backend,
        tally: &mut Tally<'_>,
    ) -> Result<(), Error> {
        if self.folder.part(part).is_dir() {
            return ledger.done(part);
        }
        let place = worker.join(format!("{part:06}.{attempt}"));
        let made = self
            .render(part, &place, backend, tally, &mut || ledger.renew(part, attempt).map(|_| ()));
        match made.and_then(|()| self.put_in_place(part, &place)) {
            Ok(()) => ledger.done(part),
            Err(error @ Error::Interrupted(_)) => {
                ledger.release(part, attempt)?;
                Err(error)
            }
            Err(error) => {
                // What is wrong here may be this machine: another worker may do better.
                ledger.failed(part, attempt, &error.to_string())?;
                Err(error)
            }
        }
    }

    /// Renders a part into datasets below `place`.
    fn render(
        &self,
        part: usize,
        place: &Path,
        backend: &mut dyn Backend,
        tally: &mut Tally<'_>,
        on_batch: &mut dyn FnMut() -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Part { positions, rendered_before } = &self.parts[part];
        let mut writers = Vec::new();
        for (folder, config) in self.job.datasets(place) {
            let first_shard = match config.container {
                Container::Hdf5 => part,
                Container::Mcap => *rendered_before,
            };
            writers.push(DatasetWriter::create_part(&folder, config, first_shard as u32)?);
        }
        self.job.render_episodes(positions, &mut writers, backend, tally, on_batch)?;
        for writer in writers {
            writer.close()?;
        }
        Ok(())
    }

    /// Gives a whole attempt its final name, unless another was first.
    fn put_in_place(&self, part: usize, place: &Path) -> Result<(), Error> {
        let whole = self.folder.part(part);
        match std::fs::rename(place, &whole) {
            Ok(()) => Ok(()),
            // Another worker made the same part, or the job is over already.
            Err(_) if whole.is_dir() || self.is_complete() => Ok(()),
            Err(error) => Err(Error::write(&whole, &error)),
        }
    }

    /// Puts the parts together. One worker does so; the others wait until it is done.
    fn put_together(&self) -> Result<(), Error> {
        let output = &self.job.request.output;
        let _lock = loop {
            if self.is_complete() && !self.folder.path().exists() {
                return Ok(());
            }
            match FolderLock::exclusive(output) {
                Ok(lock) => break lock,
                // Others still look whether there is anything to do, or are at it.
                Err(_) if !self.job.observer.cancelled() => std::thread::sleep(PAUSE),
                Err(error) => return Err(error.into()),
            }
        };
        if !self.is_complete() {
            for (index, (folder, config)) in self.job.datasets(output).into_iter().enumerate() {
                publish_parts(&folder, config, &self.part_folders(index))?;
            }
        }
        match std::fs::remove_dir_all(self.folder.path()) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::write(self.folder.path(), &error))
            }
            _ => Ok(()),
        }
    }

    /// Folders of dataset `index` in all parts.
    fn part_folders(&self, index: usize) -> Vec<PathBuf> {
        (0..self.parts.len())
            .map(|part| self.job.datasets(&self.folder.part(part)).swap_remove(index).0)
            .collect()
    }
}
