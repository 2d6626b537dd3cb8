//! A page about what physics made of a trajectory file: a table of the episodes and plots of each.

use std::path::Path;

use akrobat_model::trajectory::TrajectoryHeader;
use akrobat_packager::audit_file::{AuditFile, EpisodeAudit, Trace};
use maud::{Markup, html};

use super::chart::{Chart, Level, Series};
use super::document::document;
use super::save;
use crate::Error;

/// Points of a line in a plot, about.
const PLOT_POINTS: usize = 200;

const COLORS: [&str; 10] = [
    "#4269d0", "#efb118", "#ff725c", "#6cc5b0", "#3ca951", "#ff8ab7", "#a463f2", "#97bbf5",
    "#9c6b4e", "#9498a0",
];

/// A plot of a trace: its heading, the trace, a factor into the unit shown, and a marked value.
struct Plot {
    title: &'static str,
    trace: &'static str,
    column: Option<usize>,
    factor: f64,
    level: Option<(f64, &'static str)>,
}

const PLOTS: [Plot; 7] = [
    Plot {
        title: "opened, fraction of the goal",
        trace: "opened",
        column: None,
        factor: 1.0,
        level: None,
    },
    Plot {
        title: "force of the fingers on the handle, N",
        trace: "finger_force",
        column: None,
        factor: 1.0,
        level: None,
    },
    Plot {
        title: "slip of the handle in the hand, mm",
        trace: "slip",
        column: Some(0),
        factor: 1e3,
        level: None,
    },
    Plot {
        title: "penetration, mm",
        trace: "penetration",
        column: None,
        factor: 1e3,
        level: Some((5.0, "5 mm")),
    },
    Plot {
        title: "error of the tool, mm",
        trace: "tool_error",
        column: Some(0),
        factor: 1e3,
        level: None,
    },
    Plot {
        title: "tracking error of base and arm, m and rad",
        trace: "tracking_error",
        column: None,
        factor: 1.0,
        level: None,
    },
    Plot {
        title: "force on anything else, N",
        trace: "other_force",
        column: None,
        factor: 1.0,
        level: None,
    },
];

/// Writes the page.
///
/// # Errors
/// Where the file cannot be written.
pub fn write(path: &Path, header: &TrajectoryHeader, audit: &AuditFile) -> Result<(), Error> {
    save(path, page(header, audit).into_string().as_bytes()).map(drop)
}

fn page(header: &TrajectoryHeader, audit: &AuditFile) -> Markup {
    let succeeded = audit.episodes.iter().filter(|episode| episode.success).count();
    document(
        &format!("{} in physics · Akrobat", header.task_name),
        &html! {
            header.top {
                p.brand { "Akrobat audit" }
                h1 { (header.task_name) " in physics" }
                p { (succeeded) " of " (audit.episodes.len()) " episodes succeed." }
            }
            main {
                section { h2 { "Episodes" } (table(audit)) }
                @for episode in &audit.episodes { (plots(episode)) }
                section { h2 { "World" } pre { (format!("{:#}", audit.world)) } }
                section { h2 { "Settings" } pre { (format!("{:#}", audit.config)) } }
            }
            footer { "Akrobat " (env!("CARGO_PKG_VERSION")) " · time in seconds" }
        },
    )
}

fn table(audit: &AuditFile) -> Markup {
    let number = |episode: &EpisodeAudit, name: &str, factor: f64| {
        episode
            .findings
            .get(name)
            .and_then(serde_json::Value::as_f64)
            .map_or_else(|| "–".to_owned(), |value| format!("{:.3}", value * factor))
    };
    html! {
        table {
            thead { tr {
                th { "episode" } th { "result" } th { "opened" } th { "reached, s" }
                th { "gripper to handle, m" } th { "slip, mm" } th { "penetration, mm" } th { "tool error, mm" }
            } }
            tbody {
                @for episode in &audit.episodes {
                    tr {
                        td { a href=(format!("#episode-{}", episode.episode)) { (episode.episode) } }
                        td { (if episode.success { "success" } else { episode.reason.as_str() }) }
                        td { (number(episode, "opened_fraction_max", 1.0)) }
                        td { (number(episode, "reached_at_s", 1.0)) }
                        td { (number(episode, "handle_distance_end_m", 1.0)) }
                        td { (number(episode, "slip_max_m", 1e3)) }
                        td { (number(episode, "penetration_max_m", 1e3)) }
                        td { (number(episode, "tool_error_max_m", 1e3)) }
                    }
                }
            }
        }
    }
}

fn plots(episode: &EpisodeAudit) -> Markup {
    html! {
        section id=(format!("episode-{}", episode.episode)) {
            h2 { "Episode " (episode.episode) ": " (if episode.success { "success" } else { episode.reason.as_str() }) }
            div.multiples { @for plot in &PLOTS { (chart(episode, plot).draw()) } }
        }
    }
}

fn chart(episode: &EpisodeAudit, plot: &Plot) -> Chart {
    let empty = Trace::default();
    let times = &episode.traces.get("times").unwrap_or(&empty).values;
    let trace = episode.traces.get(plot.trace).unwrap_or(&empty);
    let columns = plot.column.map_or(0..trace.width, |column| column..column + 1);
    let stride = (times.len() / PLOT_POINTS).max(1);
    let series = columns.map(|column| {
        let point = |row: usize| {
            let value = trace.values.get(row * trace.width + column).copied().unwrap_or(f32::NAN);
            [f64::from(times[row]), f64::from(value) * plot.factor]
        };
        let rows = (0..times.len()).step_by(stride);
        Series {
            points: rows.map(point).filter(|p| p[1].is_finite()).collect(),
            color: COLORS[column % COLORS.len()].into(),
        }
    });
    Chart {
        title: plot.title.into(),
        size: [420.0, 170.0],
        x_label: "s",
        series: series.collect(),
        levels: plot.level.iter().map(|&(y, name)| Level { y, name: name.into() }).collect(),
        ..Chart::default()
    }
}
