//! Several processes of this program on one job.

use std::ffi::OsString;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use akrobat_model::events::Event;

use crate::Error;
use crate::jobs::ledger::MAX_ATTEMPTS;
use crate::pipeline::Context;

/// Option that this process was started with, and its workers are not.
const OPTION: &str = "--workers";

/// How often the workers are looked at.
const PAUSE: Duration = Duration::from_millis(100);

/// The command line of this process without options that only it heeds: `left_out`, each with its value.
///
/// # Errors
/// [`Error::Usage`] where the command was called from a program, which cannot be started once more.
pub fn own_command(left_out: &[&str]) -> Result<Vec<OsString>, Error> {
    let mut command = Vec::new();
    let mut skip = false;
    for word in std::env::args_os() {
        let text = word.to_string_lossy();
        let is_option = left_out.iter().any(|option| text == *option);
        let has_value = left_out.iter().any(|option| text.starts_with(&format!("{option}=")));
        if !skip && !is_option && !has_value {
            command.push(word.clone());
        }
        skip = is_option;
    }
    if command.iter().any(|word| word == "render") {
        return Ok(command);
    }
    Err(Error::Usage(format!(
        "{} can only be used on the command line",
        left_out.first().unwrap_or(&OPTION)
    )))
}

/// Starts `count` workers, replaces those that die, and waits until all have ended. Gives the number of
/// replacements. What is left undone, or why, is the caller's to find out.
///
/// # Errors
/// [`Error::Failed`] where no process can be started.
pub fn run(
    count: u32,
    threads: Option<usize>,
    done: impl Fn() -> u64,
    total: u64,
    context: &Context<'_>,
) -> Result<u32, Error> {
    const STAGE: &str = "rendering shards";
    let mut command = own_command(&[OPTION, "--threads"])?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.unwrap_or(cores).div_ceil(count.max(1) as usize).max(1);
    command.extend(["--join", "--quiet", "--threads"].map(OsString::from));
    command.push(threads.to_string().into());
    let mut workers: Vec<Child> =
        (0..count).map(|_| start(&command)).collect::<Result<_, Error>>()?;
    let started = std::time::Instant::now();
    context.observer.event(&Event::StageStarted { stage: STAGE, total: Some(total) });
    let mut replacements = 0;
    while !workers.is_empty() {
        std::thread::sleep(PAUSE);
        context.observer.event(&Event::Progress { stage: STAGE, done: done() });
        let mut running = Vec::new();
        for mut worker in workers {
            let status = worker.try_wait();
            let status =
                status.map_err(|e| Error::Failed(format!("cannot watch a worker: {e}")))?;
            match status {
                None => running.push(worker),
                // A worker that was killed leaves no exit code.
                Some(status)
                    if status.code().is_none()
                        && replacements < count * MAX_ATTEMPTS
                        && !context.observer.cancelled() =>
                {
                    replacements += 1;
                    running.push(start(&command)?);
                }
                Some(_) => {}
            }
        }
        workers = running;
    }
    let seconds = started.elapsed().as_secs_f64();
    context.observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(replacements)
}

fn start(command: &[OsString]) -> Result<Child, Error> {
    let [program, arguments @ ..] = command else {
        return Err(Error::Failed("this process does not know its own name".into()));
    };
    // What goes wrong is said once, by the process that the user has started.
    Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| Error::Failed(format!("{}: cannot start a worker: {e}", program.display())))
}
