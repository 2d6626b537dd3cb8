//! Progress bars and warnings on stderr: the only place that draws what stages report.

use std::collections::HashMap;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use akrobat_model::events::{Event, Observer};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use crate::CancelToken;

/// Stages shorter than this never show a bar.
const PATIENCE: Duration = Duration::from_secs(1);

/// Draws a bar per running stage where stderr is a terminal, and prints warnings.
#[derive(Debug)]
pub struct Progress {
    cancel: CancelToken,
    warnings: bool,
    bars: Option<Bars>,
}

#[derive(Debug, Default)]
struct Bars {
    screen: MultiProgress,
    stages: Mutex<HashMap<String, Stage>>,
}

#[derive(Debug)]
struct Stage {
    started: Instant,
    total: Option<u64>,
    bar: Option<ProgressBar>,
}

/// How much a command says on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verbosity {
    /// Bars (on a terminal) and warnings.
    Normal,
    /// Warnings only.
    WarningsOnly,
    /// Nothing.
    Quiet,
}

impl Progress {
    /// An observer that tells stages to stop once `cancel` is set.
    pub fn new(cancel: CancelToken, verbosity: Verbosity) -> Self {
        let draw = verbosity == Verbosity::Normal && std::io::stderr().is_terminal();
        Self { cancel, warnings: verbosity != Verbosity::Quiet, bars: draw.then(Bars::default) }
    }

    fn warn(&self, message: &str) {
        let line = format!("warning: {message}");
        match &self.bars {
            Some(bars) => bars.screen.suspend(|| eprintln!("{line}")),
            None => eprintln!("{line}"),
        }
    }
}

impl Observer for Progress {
    fn event(&self, event: &Event<'_>) {
        if let Event::Warning { message } = event {
            if self.warnings {
                self.warn(message);
            }
        } else if let Some(bars) = &self.bars {
            bars.event(event);
        }
    }

    fn cancelled(&self) -> bool {
        self.cancel.is_cancelled()
    }
}

impl Bars {
    fn event(&self, event: &Event<'_>) {
        // A poisoned table of bars is still good enough to draw from.
        let mut stages = self.stages.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        match *event {
            Event::StageStarted { stage, total } => {
                stages.insert(stage.into(), Stage { started: Instant::now(), total, bar: None });
            }
            Event::Progress { stage, done } => {
                if let Some(running) = stages.get_mut(stage) {
                    running.advance(stage, done, &self.screen);
                }
            }
            Event::StageFinished { stage, .. } => {
                if let Some(bar) = stages.remove(stage).and_then(|finished| finished.bar) {
                    bar.finish_and_clear();
                }
            }
            Event::Warning { .. } => {}
        }
    }
}

impl Stage {
    fn advance(&mut self, name: &str, done: u64, screen: &MultiProgress) {
        if self.bar.is_none() && self.started.elapsed() >= PATIENCE {
            let bar = screen.add(new_bar(self.total)).with_elapsed(self.started.elapsed());
            bar.set_message(name.to_owned());
            self.bar = Some(bar);
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done);
        }
    }
}

fn new_bar(total: Option<u64>) -> ProgressBar {
    let (bar, template) = match total {
        Some(total) => (
            ProgressBar::new(total),
            "{msg:>24} [{bar:32}] {pos}/{len} {per_sec:.1} {elapsed} (left: {eta})",
        ),
        None => (ProgressBar::new_spinner(), "{msg:>24} {spinner} {pos} {elapsed}"),
    };
    let style = ProgressStyle::with_template(template).expect("the templates are valid");
    bar.with_style(style.progress_chars("=> "))
}
