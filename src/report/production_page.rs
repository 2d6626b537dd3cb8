//! A page about a folder of trajectory files: yields, heat maps of bases, openings, starts, pictures.

use std::collections::BTreeMap;
use std::path::Path;

use maud::{Markup, html};

use super::document::document;
use super::{picture, save};
use crate::Error;
use crate::pipeline::{BaseCoverage, Opening, Production, Shot, StartDiversity, Yield};

/// Side of a heat map's cell, pixels of the drawing.
const CELL_PX: f64 = 8.0;

/// Writes the page.
///
/// # Errors
/// Where the file cannot be written.
pub fn write(path: &Path, production: &Production, shots: &[Shot]) -> Result<(), Error> {
    save(path, page(production, shots)?.into_string().as_bytes()).map(drop)
}

fn page(production: &Production, shots: &[Shot]) -> Result<Markup, Error> {
    let name = production.folder.file_name().unwrap_or_default().to_string_lossy();
    let pictures = shots
        .iter()
        .map(|shot| Ok((shot.caption.as_str(), picture::jpeg_uri(&shot.picture)?)))
        .collect::<Result<Vec<_>, Error>>()?;
    Ok(document(
        &format!("{name} · Akrobat production"),
        &html! {
            header.top {
                p.brand { "Akrobat production" }
                h1 { (name) }
                dl.facts {
                    (fact("trajectories", &production.trajectories.to_string()))
                    (fact("accepted by the judge", &production.accepted.to_string()))
                    (fact("files", &production.files.to_string()))
                    (fact("scenes", &production.yields.by_scene.len().to_string()))
                    (fact("tasks planned", &production.yields.total.tasks.to_string()))
                    (fact("tasks solved", &production.yields.total.solved.to_string()))
                    (fact("accepted an hour", &format!("{:.0}", production.yields.total.per_hour())))
                    (fact("motion", &format!("{:.1} h", production.motion_s / 3600.0)))
                }
            }
            main {
                @if !pictures.is_empty() {
                    section { h2 { "Some of them" }
                        div.groups {
                            @for (caption, uri) in &pictures {
                                figure.film { img src=(uri) alt=(caption); figcaption { (caption) } }
                            }
                        }
                    }
                }
                section { h2 { "Yield" }
                    (yields("confinement", &production.yields.by_confinement))
                    (yields("layout", &production.yields.by_layout))
                    (yields("object", &production.yields.by_class))
                    (yields("robot", &production.yields.by_robot))
                }
                section { h2 { "Where bases stood" }
                    p.note {
                        "When they took hold, in the object's frame: its root is the cross, its front faces to the right. "
                        "One cell is " (format!("{:.0}", 100.0 * crate::pipeline::BASE_CELL_M)) " cm wide; darker is more often."
                    }
                    div.groups { @for (robot, base) in &production.bases { (heat_map(robot, base)) } }
                }
                section { h2 { "How far things were opened" }
                    div.groups { @for (class, opening) in &production.openings { (histogram(class, opening)) } }
                }
                section { h2 { "How much starts differ" } (starts(&production.starts)) }
                @if !production.yields.reasons.is_empty() {
                    section { h2 { "What stopped trajectories and tasks" } (reasons(&production.yields.reasons)) }
                }
                section { h2 { "Scenes" } (yields("scene", &production.yields.by_scene)) }
            }
            footer { "Akrobat " (env!("CARGO_PKG_VERSION")) " · rad and m" }
        },
    ))
}

fn fact(name: &str, value: &str) -> Markup {
    html! { div { dt { (name) } dd { (value) } } }
}

fn yields(what: &str, sums: &BTreeMap<String, Yield>) -> Markup {
    html! {
        h3 { "By " (what) }
        div.scroll { table {
            thead { tr {
                th.word { (what) } th { "tasks" } th { "solved" } th { "accepted" } th { "seconds" } th { "an hour" }
            } }
            tbody { @for (name, sum) in sums { tr {
                td.word { (name) } td { (sum.tasks) } td { (sum.solved) } td { (sum.accepted) }
                td { (format!("{:.0}", sum.seconds)) } td { (format!("{:.0}", sum.per_hour())) }
            } } }
        } }
    }
}

fn heat_map(robot: &str, base: &BaseCoverage) -> Markup {
    let range = |axis: usize| {
        let values = base.heat.iter().map(|cell| cell[axis]);
        [values.clone().min().unwrap_or(0).min(-2), values.max().unwrap_or(0).max(2) + 1]
    };
    let ([left, right], [low, high]) = (range(0), range(1));
    let most = base.heat.iter().map(|cell| cell[2]).max().unwrap_or(1).max(1) as f64;
    let x = |cell: i64| (cell - left) as f64 * CELL_PX;
    // y grows upwards.
    let y = |cell: i64| (high - 1 - cell) as f64 * CELL_PX;
    let (width, height) = ((right - left) as f64 * CELL_PX, (high - low) as f64 * CELL_PX);
    let (zero_x, zero_y) = (x(0), y(0) + CELL_PX);
    html! {
        figure.card {
            h3 { (robot) }
            svg viewBox=(format!("0 0 {width} {height}")) role="img" aria-label=(format!("bases of {robot}"))
                style="width:100%;max-height:420px;background:var(--ground)" {
                @for cell in &base.heat {
                    rect x=(x(cell[0])) y=(y(cell[1])) width=(CELL_PX) height=(CELL_PX)
                        style=(format!("fill:var(--accent);fill-opacity:{:.3}", 0.08 + 0.92 * (cell[2] as f64 / most).sqrt())) {
                        title { (format!("{:.1} m, {:.1} m: {}", cell[0] as f64 * base.cell_m, cell[1] as f64 * base.cell_m, cell[2])) }
                    }
                }
                path d=(format!("M{} {zero_y}h10M{zero_x} {}v10", zero_x - 5.0, zero_y - 5.0))
                    style="stroke:var(--bad);stroke-width:2" {}
            }
            figcaption {
                (base.trajectories) " trajectories in " (base.cells) " cells (" (format!("{:.0}", base.effective_cells))
                " effective), " (format!("{:.0}", 100.0 * base.headings)) "% of the headings, "
                (format!("{:.2} to {:.2} m away", base.distance_m[0], base.distance_m[1]))
            }
        }
    }
}

fn histogram(class: &str, opening: &Opening) -> Markup {
    let most = opening.histogram.iter().copied().max().unwrap_or(1).max(1) as f64;
    html! {
        figure.card {
            h3 { (class) }
            table.bars { tbody {
                @for (bin, count) in opening.histogram.iter().enumerate() { tr {
                    th { (format!("{:.2}", bin as f64 * opening.step)) }
                    td.bar { i style=(format!("width:{:.1}%", 100.0 * *count as f64 / most)) {} }
                    td { (count) }
                } }
            } }
            figcaption { (format!("{:.2} to {:.2}, {:.2} on average (rad or m)", opening.least, opening.most, opening.mean)) }
        }
    }
}

fn starts(starts: &BTreeMap<String, StartDiversity>) -> Markup {
    html! {
        @for (robot, diversity) in starts {
            h3 { (robot) }
            p.note {
                (diversity.starts) " different starts and " (diversity.grasped) " different states of grasping in "
                (diversity.trajectories) " trajectories, by " (diversity.grasps) " grasps. Deviation of each joint while grasping:"
            }
            div.scroll { table {
                thead { tr { @for name in diversity.deviation.keys() { th { (name) } } } }
                tbody { tr { @for value in diversity.deviation.values() { td { (format!("{value:.3}")) } } } }
            } }
        }
    }
}

fn reasons(reasons: &BTreeMap<String, u64>) -> Markup {
    let most = reasons.values().copied().max().unwrap_or(1).max(1) as f64;
    let mut sorted: Vec<_> = reasons.iter().collect();
    sorted.sort_by_key(|(name, count)| (std::cmp::Reverse(**count), *name));
    html! {
        table.bars { tbody { @for (name, count) in sorted { tr {
            th { (name) }
            td.bar { i.loss style=(format!("width:{:.1}%", 100.0 * *count as f64 / most)) {} }
            td { (count) }
        } } } }
    }
}
