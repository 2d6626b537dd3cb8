//! The ledger of a job: an SQLite file with the state of every part.
//!
//! A worker leases a part for a time and renews the lease while it works. A lease that has run out, or whose
//! worker no longer holds its folder locked, goes to whoever asks next. A part that was leased too often
//! without success is given up, so that one bad episode cannot keep a cluster busy.

use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use akrobat_packager::FolderLock;
use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};

use crate::Error;

/// How long a lease lasts without being renewed.
pub const LEASE: Duration = Duration::from_secs(120);

/// How often a part is tried.
pub const MAX_ATTEMPTS: u32 = 3;

/// How long a worker waits for the ledger while others write to it.
const PATIENCE: Duration = Duration::from_secs(60);

const SCHEMA: &str = "
    CREATE TABLE IF NOT EXISTS job (fingerprint TEXT NOT NULL);
    CREATE TABLE IF NOT EXISTS part (
        number INTEGER PRIMARY KEY,
        state TEXT NOT NULL DEFAULT 'open' CHECK (state IN ('open', 'leased', 'done', 'failed')),
        attempts INTEGER NOT NULL DEFAULT 0,
        worker TEXT NOT NULL DEFAULT '',
        lease_until_s REAL NOT NULL DEFAULT 0,
        error TEXT NOT NULL DEFAULT ''
    ) WITHOUT ROWID;
";

/// What a worker is to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Claim {
    /// Make this part, in this attempt.
    Make {
        /// Number of the part.
        part: usize,
        /// Number of the attempt, from 1.
        attempt: u32,
    },
    /// Others are at work on all that is left.
    Wait,
    /// All parts are done, or given up.
    Finished,
}

/// Numbers of parts in each state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct Counts {
    /// Nobody has made them yet.
    pub open: u64,
    /// Somebody is at work.
    pub leased: u64,
    /// Whole.
    pub done: u64,
    /// Given up.
    pub failed: u64,
}

/// The ledger of a job.
#[derive(Debug)]
pub struct Ledger {
    connection: Connection,
}

impl Ledger {
    /// Opens the ledger of a job of `parts` parts, or begins one in which those are done that `is_whole`
    /// finds. `fingerprint` stands for everything that decides the result.
    ///
    /// # Errors
    /// [`Error::Usage`] where the file is the ledger of another job, [`Error::Failed`] where it cannot be
    /// read or written.
    pub fn open(
        file: &Path,
        fingerprint: &str,
        parts: usize,
        is_whole: impl Fn(usize) -> bool,
    ) -> Result<Self, Error> {
        let failed = |e: rusqlite::Error| Error::Failed(format!("{}: {e}", file.display()));
        let mut connection = Connection::open(file).map_err(failed)?;
        connection.busy_timeout(PATIENCE).map_err(failed)?;
        let begun = immediately(&mut connection, |ledger| {
            ledger.execute_batch(SCHEMA)?;
            let known: Option<String> =
                ledger.query_row("SELECT fingerprint FROM job", [], |row| row.get(0)).optional()?;
            if known.is_some() {
                return Ok(known);
            }
            ledger.execute("INSERT INTO job VALUES (?1)", [fingerprint])?;
            for part in 0..parts {
                let state = if is_whole(part) { "done" } else { "open" };
                ledger.execute(
                    "INSERT INTO part (number, state) VALUES (?1, ?2)",
                    params![part as i64, state],
                )?;
            }
            Ok(None)
        })
        .map_err(failed)?;
        match begun {
            Some(known) if known != fingerprint => Err(Error::Usage(format!(
                "{}: this is the ledger of another job; use the command it was begun with, or another output",
                file.display()
            ))),
            _ => Ok(Self { connection }),
        }
    }

    /// Claims the next part for the worker that holds the folder `worker` locked as long as it lives.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be written.
    pub fn claim(&mut self, worker: &Path) -> Result<Claim, Error> {
        self.write(|ledger| {
            give_up_leases(ledger)?;
            let next: Option<(i64, u32)> = ledger
                .query_row(
                    "SELECT number, attempts FROM part WHERE state = 'open' ORDER BY number LIMIT 1",
                    [],
                    |row| Ok((row.get(0)?, row.get(1)?)),
                )
                .optional()?;
            let Some((number, attempts)) = next else {
                let leased: i64 = ledger.query_row(
                    "SELECT count(*) FROM part WHERE state = 'leased'",
                    [],
                    |row| row.get(0),
                )?;
                return Ok(if leased > 0 { Claim::Wait } else { Claim::Finished });
            };
            let (part, attempt) = (number as usize, attempts + 1);
            ledger.execute(
                "UPDATE part SET state = 'leased', attempts = ?2, worker = ?3, lease_until_s = ?4
                 WHERE number = ?1",
                params![number, attempt, worker.to_string_lossy(), now_s() + LEASE.as_secs_f64()],
            )?;
            Ok(Claim::Make { part, attempt })
        })
    }

    /// Renews a lease. False where it has gone to somebody else.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be written.
    pub fn renew(&mut self, part: usize, attempt: u32) -> Result<bool, Error> {
        let until_s = now_s() + LEASE.as_secs_f64();
        self.update(
            "UPDATE part SET lease_until_s = ?3 WHERE number = ?1 AND attempts = ?2 AND state = 'leased'",
            params![part as i64, attempt, until_s],
        )
    }

    /// Notes that a part is whole, whoever made it.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be written.
    pub fn done(&mut self, part: usize) -> Result<(), Error> {
        self.update("UPDATE part SET state = 'done' WHERE number = ?1", params![part as i64])?;
        Ok(())
    }

    /// Gives a part back that was not made through no fault of it.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be written.
    pub fn release(&mut self, part: usize, attempt: u32) -> Result<(), Error> {
        self.update(
            "UPDATE part SET state = 'open', attempts = attempts - 1
             WHERE number = ?1 AND attempts = ?2 AND state = 'leased'",
            params![part as i64, attempt],
        )?;
        Ok(())
    }

    /// Notes that an attempt failed; after the last one the part is given up.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be written.
    pub fn failed(&mut self, part: usize, attempt: u32, error: &str) -> Result<(), Error> {
        self.update(
            "UPDATE part SET error = ?3, state = CASE WHEN attempts >= ?4 THEN 'failed' ELSE 'open' END
             WHERE number = ?1 AND attempts = ?2 AND state = 'leased'",
            params![part as i64, attempt, error, MAX_ATTEMPTS],
        )?;
        Ok(())
    }

    /// Makes parts that were given up open again.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be written.
    pub fn retry_failed(&mut self) -> Result<(), Error> {
        self.update("UPDATE part SET state = 'open', attempts = 0 WHERE state = 'failed'", [])?;
        Ok(())
    }

    /// Parts that were given up, with what happened last.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be read.
    pub fn failures(&mut self) -> Result<Vec<(usize, String)>, Error> {
        self.write(|ledger| {
            let mut query = ledger
                .prepare("SELECT number, error FROM part WHERE state = 'failed' ORDER BY number")?;
            let rows =
                query.query_map([], |row| Ok((row.get::<_, i64>(0)? as usize, row.get(1)?)))?;
            rows.collect()
        })
    }

    /// How far the job is.
    ///
    /// # Errors
    /// [`Error::Failed`] where the ledger cannot be read.
    pub fn counts(&mut self) -> Result<Counts, Error> {
        self.write(|ledger| {
            let mut counts = Counts::default();
            let mut query = ledger.prepare("SELECT state, count(*) FROM part GROUP BY state")?;
            let mut rows = query.query([])?;
            while let Some(row) = rows.next()? {
                let count = row.get::<_, i64>(1)? as u64;
                match row.get::<_, String>(0)?.as_str() {
                    "open" => counts.open = count,
                    "leased" => counts.leased = count,
                    "done" => counts.done = count,
                    _ => counts.failed = count,
                }
            }
            Ok(counts)
        })
    }

    fn update(&mut self, sql: &str, values: impl rusqlite::Params) -> Result<bool, Error> {
        self.write(|ledger| Ok(ledger.execute(sql, values)? > 0))
    }

    fn write<T>(
        &mut self,
        work: impl FnOnce(&Transaction<'_>) -> rusqlite::Result<T>,
    ) -> Result<T, Error> {
        immediately(&mut self.connection, work)
            .map_err(|e| Error::Failed(format!("job ledger: {e}")))
    }
}

/// Takes the write lock at once: a transaction that begins by reading could not be finished where another
/// has written meanwhile.
fn immediately<T>(
    connection: &mut Connection,
    work: impl FnOnce(&Transaction<'_>) -> rusqlite::Result<T>,
) -> rusqlite::Result<T> {
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let result = work(&transaction)?;
    transaction.commit()?;
    Ok(result)
}

/// Leases that have run out, and those of workers that died on this machine.
fn give_up_leases(ledger: &Transaction<'_>) -> rusqlite::Result<()> {
    let now_s = now_s();
    let leased: Vec<(i64, u32, String, f64)> = ledger
        .prepare("SELECT number, attempts, worker, lease_until_s FROM part WHERE state = 'leased'")?
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?
        .collect::<rusqlite::Result<_>>()?;
    for (number, attempts, worker, until_s) in leased {
        if until_s > now_s && !is_dead(Path::new(&worker)) {
            continue;
        }
        let state = if attempts >= MAX_ATTEMPTS { "failed" } else { "open" };
        ledger.execute(
            "UPDATE part SET state = ?2, error = 'the worker died or hung' WHERE number = ?1",
            params![number, state],
        )?;
    }
    Ok(())
}

/// True where a worker of this machine has let go of its folder: the system does so when a process ends.
fn is_dead(worker: &Path) -> bool {
    cfg!(unix) && worker.is_dir() && FolderLock::exclusive(worker).is_ok()
}

/// Seconds since 1970. Workers on several machines need clocks that agree within a fraction of a lease.
fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ledger(folder: &Path, parts: usize) -> Ledger {
        Ledger::open(&folder.join("ledger.sqlite"), "job", parts, |_| false).unwrap()
    }

    #[test]
    fn every_part_is_given_once() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("worker");
        let place = place.as_path();
        let (mut one, mut two) = (ledger(folder.path(), 3), ledger(folder.path(), 3));
        assert_eq!(one.claim(place).unwrap(), Claim::Make { part: 0, attempt: 1 });
        assert_eq!(two.claim(place).unwrap(), Claim::Make { part: 1, attempt: 1 });
        assert_eq!(one.claim(place).unwrap(), Claim::Make { part: 2, attempt: 1 });
        assert_eq!(two.claim(place).unwrap(), Claim::Wait);
        assert!(one.renew(0, 1).unwrap());
        (0..3).for_each(|part| two.done(part).unwrap());
        assert!(!one.renew(0, 1).unwrap(), "it is done");
        assert_eq!(one.claim(place).unwrap(), Claim::Finished);
        assert_eq!(one.counts().unwrap(), Counts { done: 3, ..Counts::default() });
    }

    #[test]
    fn the_dead_are_replaced_and_bad_parts_given_up() {
        let folder = tempfile::tempdir().unwrap();
        let worker = |name: String| {
            let place = folder.path().join(name);
            std::fs::create_dir(&place).unwrap();
            let lock = FolderLock::exclusive(&place).unwrap();
            (place, lock)
        };
        let mut ledger = ledger(folder.path(), 1);
        for attempt in 1..=MAX_ATTEMPTS {
            let (place, lock) = worker(format!("worker{attempt}"));
            assert_eq!(ledger.claim(&place).unwrap(), Claim::Make { part: 0, attempt });
            assert_eq!(ledger.claim(&place).unwrap(), Claim::Wait, "it is being worked on");
            // The worker dies.
            drop(lock);
        }
        let (place, _lock) = worker("last".into());
        let place = place.as_path();
        assert_eq!(ledger.claim(place).unwrap(), Claim::Finished);
        assert_eq!(ledger.failures().unwrap()[0].0, 0);
        ledger.retry_failed().unwrap();
        assert_eq!(ledger.claim(place).unwrap(), Claim::Make { part: 0, attempt: 1 });
        ledger.release(0, 1).unwrap();
        assert_eq!(ledger.claim(place).unwrap(), Claim::Make { part: 0, attempt: 1 });
        ledger.failed(0, 1, "disk full").unwrap();
        assert_eq!(ledger.claim(place).unwrap(), Claim::Make { part: 0, attempt: 2 });
    }

    #[test]
    fn another_jobs_ledger_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        drop(ledger(folder.path(), 1));
        let file = folder.path().join("ledger.sqlite");
        let error = Ledger::open(&file, "another", 1, |_| false).unwrap_err();
        assert!(error.to_string().contains("another job"), "{error}");
    }

    #[test]
    fn whole_parts_are_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ledger.sqlite");
        let mut ledger = Ledger::open(&file, "job", 4, |part| part != 2).unwrap();
        assert_eq!(ledger.claim(folder.path()).unwrap(), Claim::Make { part: 2, attempt: 1 });
    }
}
