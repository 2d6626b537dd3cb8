//! What planning many tasks gave, and what stopped the rest.

use std::collections::BTreeMap;

use serde::Serialize;

use super::produce::Record;

/// Sums over tasks.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Yield {
    /// Tasks planned.
    pub tasks: usize,
    /// Those of which a trajectory was accepted.
    pub solved: usize,
    /// Accepted trajectories.
    pub accepted: usize,
    /// Wall time of planning, seconds.
    pub seconds: f64,
}

impl Yield {
    fn add(&mut self, record: &Record) {
        self.tasks += 1;
        self.solved += usize::from(record.accepted > 0);
        self.accepted += record.accepted;
        self.seconds += record.seconds;
    }

    /// Accepted trajectories an hour.
    pub fn per_hour(&self) -> f64 {
        if self.seconds > 0.0 { self.accepted as f64 * 3600.0 / self.seconds } else { 0.0 }
    }
}

/// Sums over tasks, and over tasks of a kind.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Yields {
    /// All of them.
    pub total: Yield,
    /// By confinement of the scene, from open to confined.
    pub by_confinement: BTreeMap<String, Yield>,
    /// By arrangement of the units, or imported scene.
    pub by_layout: BTreeMap<String, Yield>,
    /// By class of object.
    pub by_class: BTreeMap<String, Yield>,
    /// By robot.
    pub by_robot: BTreeMap<String, Yield>,
    /// By scene.
    pub by_scene: BTreeMap<String, Yield>,
    /// What stopped trajectories and tasks, with how often.
    pub reasons: BTreeMap<String, u64>,
}

impl Yields {
    pub(super) fn add(&mut self, record: &Record) {
        self.total.add(record);
        for (sums, key) in [
            (&mut self.by_confinement, &record.confinement_bin()),
            (&mut self.by_layout, &record.layout),
            (&mut self.by_class, &record.class),
            (&mut self.by_robot, &record.robot),
            (&mut self.by_scene, &record.scene),
        ] {
            sums.entry(key.clone()).or_default().add(record);
        }
        for (reason, count) in record.reasons() {
            *self.reasons.entry(reason).or_default() += count;
        }
    }

    /// A table for terminals: a line for all tasks, then one for each kind but the scenes.
    pub fn table(&self) -> Vec<String> {
        let mut lines = vec![
            format!(
                "{:<24}{:>8}{:>8}{:>10}{:>10}{:>10}",
                "", "tasks", "solved", "accepted", "seconds", "an hour"
            ),
            line("all", &self.total),
        ];
        for (title, sums) in [
            ("confinement", &self.by_confinement),
            ("layout", &self.by_layout),
            ("object", &self.by_class),
            ("robot", &self.by_robot),
        ] {
            lines.push(title.into());
            lines.extend(sums.iter().map(|(name, sum)| line(&format!("  {name}"), sum)));
        }
        lines
    }

    /// What stopped trajectories and tasks, a line each; none where nothing did.
    pub fn reasons_table(&self) -> Vec<String> {
        if self.reasons.is_empty() {
            return Vec::new();
        }
        let title = "what stopped trajectories and tasks".to_owned();
        let rows = self.reasons.iter().map(|(name, count)| format!("{count:>9}  {name}"));
        std::iter::once(title).chain(rows).collect()
    }
}

fn line(name: &str, sum: &Yield) -> String {
    format!(
        "{name:<24}{:>8}{:>8}{:>10}{:>10.0}{:>10.0}",
        sum.tasks,
        sum.solved,
        sum.accepted,
        sum.seconds,
        sum.per_hour()
    )
}
