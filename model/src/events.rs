//! What long-running stages report while they work. Libraries emit, the command line draws.

/// One report from a stage.
#[derive(Debug, Clone, PartialEq)]
pub enum Event<'a> {
    /// A stage began; `total` is its number of steps where it is known.
    StageStarted {
        /// Stage name in the user's words: `inverse kinematics`, `rendering`, …
        stage: &'a str,
        /// Number of steps, if known in advance.
        total: Option<u64>,
    },
    /// `done` steps of the stage are finished.
    Progress {
        /// Stage name, as in [`Event::StageStarted`].
        stage: &'a str,
        /// Finished steps so far.
        done: u64,
    },
    /// The stage ended.
    StageFinished {
        /// Stage name, as in [`Event::StageStarted`].
        stage: &'a str,
        /// Wall time of the stage, seconds.
        seconds: f64,
    },
    /// Something a user should know about, though the run goes on (a repair, a skipped item).
    Warning {
        /// The whole message.
        message: &'a str,
    },
}

/// Receives events, and is asked whether to stop. Called from worker threads.
pub trait Observer: Sync {
    /// Takes one event.
    fn event(&self, event: &Event<'_>);

    /// True once the user asked to stop (Ctrl-C); stages then return early with what is whole.
    fn cancelled(&self) -> bool {
        false
    }
}

/// An observer that ignores everything.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {
    fn event(&self, _event: &Event<'_>) {}
}
