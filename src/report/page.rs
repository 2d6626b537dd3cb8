//! The HTML of the page. Every string goes through `maud`, which escapes it.

use std::collections::BTreeMap;

use akrobat_model::{JointKind, Phase, Trajectory, Verdict};
use akrobat_renderer::RenderScene;
use maud::{Markup, PreEscaped, html};

use super::chart::{Band, Chart, Level, Series, number};
use super::document::document;
use super::drift::{Drift, anchor_drift};
use super::shown::{CameraSheet, Shown};
use super::{ReportInput, footprint, picture, trajectory_color};
use crate::Error;

/// Tolerances of the judge, drawn beside what was measured.
const DRIFT_TOLERANCE_MM: f64 = 1.0;
const DRIFT_TOLERANCE_RAD: f64 = 0.01;
/// What is below this is drawn here on logarithmic axes, millimetres or radians.
const LEAST_DRIFT: f64 = 1e-6;
/// Points of a line in a joint's plot, about.
const PLOT_POINTS: usize = 240;
/// Rows of the table of trajectories, at most.
const MAX_ROWS: usize = 60;

const SCRIPT: &str = include_str!("page.js");

/// The whole page.
///
/// # Errors
/// Where a trajectory does not fit the task.
pub fn page(
    input: &ReportInput<'_>,
    scene: &RenderScene,
    panels: &[Shown],
) -> Result<Markup, Error> {
    let header = &input.set.header;
    let indices: Vec<usize> = panels.iter().map(|panel| panel.index).collect();
    Ok(document(
        &format!("{} · Akrobat", header.task_name),
        &html! {
            header.top {
                p.brand { "Akrobat report" }
                h1 { (header.task_name) }
                (facts(input))
                nav {
                    @for (id, name) in sections(input) { a href=(format!("#{id}")) { (name) } }
                }
            }
            main {
                (trajectories_section(input, panels))
                (footprint_section(input, scene, &indices))
                (drift_section(input, &indices)?)
                (verdict_section(input, &indices))
                (counts_section(&header.counts))
                (run_sections(input))
                (licence_section(input))
            }
            footer { "Akrobat " (env!("CARGO_PKG_VERSION")) " · units are SI, angles radians, the world is Z up" }
            script { (PreEscaped(SCRIPT)) }
        },
    ))
}

fn sections(input: &ReportInput<'_>) -> Vec<(&'static str, &'static str)> {
    let mut all = vec![
        ("trajectories", "Trajectories"),
        ("bases", "Bases"),
        ("drift", "Anchor drift"),
        ("verdicts", "Verdicts"),
        ("counts", "Counts"),
    ];
    if let Some(run) = input.run {
        let optional = [
            (run.stage_seconds.is_empty(), ("timing", "Timing")),
            (run.sphere_fits.is_empty(), ("spheres", "Spheres")),
            (run.notes.is_empty(), ("notes", "Notes")),
        ];
        all.extend(optional.into_iter().filter(|(empty, _)| !empty).map(|(_, section)| section));
    }
    all.push(("licences", "Licences"));
    all
}

fn facts(input: &ReportInput<'_>) -> Markup {
    let header = &input.set.header;
    let trajectories = &input.set.trajectories;
    let accepted =
        trajectories.iter().filter(|t| t.verdict.as_ref().is_some_and(Verdict::accepted));
    let mut grasps: Vec<u32> = trajectories.iter().map(|t| t.grasp.id).collect();
    grasps.sort_unstable();
    grasps.dedup();
    let seconds: f64 = trajectories.iter().map(|t| t.dense.duration_s()).sum();
    let base = format!("{:?}", header.base_kind).to_lowercase();
    let rows = [
        ("Robot", header.robot_id.clone()),
        ("Base", base),
        ("Object", header.object_id.clone()),
        ("Driven joint", header.active_joint.clone()),
        ("Scene", header.scene_id.clone()),
        ("Seed", header.seed.to_string()),
        ("Planned on", header.backend.clone()),
        ("Trajectories", trajectories.len().to_string()),
        ("Accepted", accepted.count().to_string()),
        ("Grasps", grasps.len().to_string()),
        ("Motion", format!("{seconds:.0} s")),
    ];
    html! {
        dl.facts { @for (name, value) in rows { div { dt { (name) } dd { (value) } } } }
    }
}

fn trajectories_section(input: &ReportInput<'_>, panels: &[Shown]) -> Markup {
    html! {
        section #trajectories {
            h2 { "Trajectories" }
            @if panels.is_empty() { p.empty { "The set holds no trajectory." } }
            div.tabs role="tablist" {
                @for (place, panel) in panels.iter().enumerate() {
                    button role="tab" data-panel=(place) aria-selected=(if place == 0 { "true" } else { "false" }) {
                        span.dot style=(format!("background:{}", trajectory_color(panel.index))) {}
                        "Trajectory " (panel.index)
                    }
                }
            }
            @for (place, panel) in panels.iter().enumerate() {
                div.panel data-panel=(place) hidden[place > 0] { (trajectory_panel(input, panel)) }
            }
        }
    }
}

fn trajectory_panel(input: &ReportInput<'_>, panel: &Shown) -> Markup {
    let trajectory = &input.set.trajectories[panel.index];
    let names: Vec<&str> = panel.cameras.iter().map(|camera| camera.name.as_str()).collect();
    html! {
        p.lead {
            "Grasp " (trajectory.grasp.id) " on " code { (trajectory.grasp.link) } ", "
            code { (input.set.header.active_joint) } " from " (number(trajectory.start)) " to "
            (number(trajectory.goal)) (unit(input)) ", " (format!("{:.1}", trajectory.dense.duration_s())) " s. "
            span.id { (trajectory.id) }
        }
        figure.film {
            img src=(picture::data_uri("image/gif", &panel.gif)) alt=(format!("Animation of trajectory {}", panel.index));
            figcaption {
                (names.join(" · ")) " — the file " code { (panel.gif_name) } " is the same; "
                code { (panel.glb_name) } " (" (format!("{:.1}", panel.glb.len() as f64 / 1e6))
                " MB, glTF 2.0) holds the moving model."
            }
        }
        h3 { "Cameras" }
        (contact_sheet(panel))
        h3 { "Point clouds" }
        div.clouds {
            @for sheet in &panel.clouds {
                @for (name, picture) in &sheet.views {
                    figure { img src=(picture) alt=(format!("Cloud {name}"));
                        figcaption { (format!("{:.1} s", sheet.time_s)) " · " (name) } }
                }
            }
        }
        @if let Some(sheet) = panel.clouds.first() {
            p.note { (thousands(sheet.points as u64)) " points fused from all cameras; the farther, the paler." }
        }
        h3 { "Joints" }
        (phase_legend(trajectory))
        div.multiples { @for chart in joint_charts(input, trajectory, panel.index) { (chart.draw()) } }
        p.note { "Seconds along x; radians or metres along y." }
    }
}

fn contact_sheet(panel: &Shown) -> Markup {
    html! {
        @for camera in &panel.cameras {
            div.sheet style=(format!("--columns:{};--aspect:{:.4}", panel.instants.len(), camera.aspect)) {
                div.sheet-head { strong { (camera.name) } (depth_legend(camera)) }
                div.row.times {
                    @for instant in &panel.instants {
                        span { (format!("{:.1} s", instant.time_s)) " · " (phase_name(instant.phase)) }
                    }
                }
                @for (kind, pictures) in [("colour", &camera.color), ("depth", &camera.depth), ("segments", &camera.segmentation)] {
                    div.row {
                        @for picture in pictures {
                            img loading="lazy" src=(picture) alt=(format!("{} {kind}", camera.name));
                        }
                    }
                }
            }
        }
        p.note {
            "Rows: colour, depth (logarithmic; black where nothing is seen), segments: "
            span.swatch style="background:#d9603b" {} "robot, "
            span.swatch style="background:#3fae5a" {} "object, "
            span.swatch style="background:#7d97b5" {} "scene."
        }
    }
}

fn depth_legend(camera: &CameraSheet) -> Markup {
    let stops: Vec<String> = (0..=5)
        .map(|k| {
            let [r, g, b] = picture::depth_color(k as f32 / 5.0);
            format!("rgb({r} {g} {b})")
        })
        .collect();
    let [near_m, far_m] = camera.depth_range_m;
    html! {
        span.ramp {
            (format!("{near_m:.2} m"))
            i style=(format!("background:linear-gradient(90deg,{})", stops.join(","))) {}
            (format!("{far_m:.2} m"))
        }
    }
}

/// One chart for each robot column that moves or could, and one for the driven joint.
fn joint_charts(input: &ReportInput<'_>, trajectory: &Trajectory, index: usize) -> Vec<Chart> {
    let header = &input.set.header;
    let tree = &input.task.robot.tree;
    let dense = &trajectory.dense;
    let bands = phase_bands(trajectory);
    let chart =
        |name: &str, values: &dyn Fn(usize) -> f64, limits: Option<[f64; 2]>, color: String| {
            let step = (dense.len() / PLOT_POINTS).max(1);
            let samples = (0..dense.len()).step_by(step).chain(dense.len().checked_sub(1));
            let points = samples.map(|k| [dense.times_s[k], values(k)]).collect();
            let level = |y: f64| Level { y, name: "limit".into() };
            Chart {
                title: name.to_owned(),
                size: [320.0, 132.0],
                bands: bands.clone(),
                series: vec![Series { points, color }],
                levels: limits.into_iter().flatten().filter(|y| y.is_finite()).map(level).collect(),
                ..Chart::default()
            }
        };
    let mut charts = Vec::new();
    if let Some(column) = header.object_joints.iter().position(|name| *name == header.active_joint)
    {
        let value = |k: usize| f64::from(dense.object.row(k)[column]);
        let limits = input.task.object.tree.joints()[input.task.object.active_joint].limits;
        let name = format!("{} (object)", header.active_joint);
        charts.push(chart(&name, &value, Some(limits), "var(--object)".into()));
    }
    for (column, name) in header.robot_joints.iter().enumerate() {
        let value = |k: usize| f64::from(dense.robot.row(k)[column]);
        let joint = tree.joint_index(name).ok().map(|j| &tree.joints()[j]);
        let limits = joint.filter(|j| j.kind != JointKind::Continuous).map(|j| j.limits);
        charts.push(chart(name, &value, limits, trajectory_color(index)));
    }
    charts
}

fn phase_bands(trajectory: &Trajectory) -> Vec<Band> {
    phase_runs(trajectory)
        .into_iter()
        .map(|(phase, range)| Band {
            range,
            class: phase_class(phase),
            name: phase_name(phase).into(),
        })
        .collect()
}

/// Phases with the times between which they last, seconds.
fn phase_runs(trajectory: &Trajectory) -> Vec<(Phase, [f64; 2])> {
    let dense = &trajectory.dense;
    let mut runs: Vec<(Phase, [f64; 2])> = Vec::new();
    // A sample's phase is that of the motion which arrives at it.
    for (pair, &phase) in dense.times_s.windows(2).zip(dense.phase.iter().skip(1)) {
        match runs.last_mut() {
            Some((last, range)) if *last == phase => range[1] = pair[1],
            _ => runs.push((phase, [pair[0], pair[1]])),
        }
    }
    runs
}

fn phase_legend(trajectory: &Trajectory) -> Markup {
    html! {
        p.legend {
            @for (phase, [from, to]) in phase_runs(trajectory) {
                span { svg.key viewBox="0 0 14 14" { rect class=(phase_class(phase)) width="14" height="14" rx="3" {} }
                    (phase_name(phase)) " " small { (format!("{:.1} s", to - from)) } }
            }
        }
    }
}

fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Approach => "approach",
        Phase::Reach => "reach",
        Phase::Grasp => "grasp",
        Phase::Manipulate => "manipulate",
        Phase::Regrasp => "re-grasp",
        Phase::Release => "release",
    }
}

fn phase_class(phase: Phase) -> &'static str {
    match phase {
        Phase::Approach => "band approach",
        Phase::Reach => "band reach",
        Phase::Grasp => "band grasp",
        Phase::Manipulate => "band manipulate",
        Phase::Regrasp => "band regrasp",
        Phase::Release => "band release",
    }
}

fn unit(input: &ReportInput<'_>) -> &'static str {
    let object = &input.task.object;
    match object.tree.joints()[object.active_joint].kind {
        JointKind::Prismatic => " m",
        _ => " rad",
    }
}

fn footprint_section(input: &ReportInput<'_>, scene: &RenderScene, shown: &[usize]) -> Markup {
    html! {
        section #bases {
            h2 { "Where the base stands" }
            p.note {
                "Seen from above, one colour for each trajectory: " svg.key viewBox="0 0 14 14" { circle.start cx="7" cy="7" r="5" {} }
                " where the manipulation starts, " svg.key viewBox="0 0 14 14" { circle.goal cx="7" cy="7" r="5" {} }
                " where it ends; the stroke points ahead. Outlines of the base belong to the trajectories above. The object is drawn closed and, dashed, open; the scene is cut at 0.12 m and, thin, at 0.8 m."
            }
            div.card { (footprint::draw(input.task, scene, input.set, shown)) }
        }
    }
}

fn drift_section(input: &ReportInput<'_>, shown: &[usize]) -> Result<Markup, Error> {
    let drifts = input
        .set
        .trajectories
        .iter()
        .map(|trajectory| anchor_drift(input.task, trajectory))
        .collect::<Result<Vec<_>, _>>()?;
    let chart = |title: &str, value: fn(&Drift) -> f64, tolerance: f64, name: &str| {
        // Those shown above come last, on top of the others.
        let mut order: Vec<usize> = (0..drifts.len()).collect();
        order.sort_by_key(|index| shown.contains(index));
        let line = |index: usize| Series {
            points: thinned(&drifts[index], |d| [d.progress, value(d).max(LEAST_DRIFT)]),
            color: match shown.contains(&index) {
                true => trajectory_color(index),
                false => "var(--faint)".into(),
            },
        };
        Chart {
            title: title.into(),
            size: [620.0, 270.0],
            x_label: "share of the manipulation",
            logarithmic: true,
            series: order.into_iter().map(line).collect(),
            levels: vec![Level { y: tolerance, name: name.into() }],
            ..Chart::default()
        }
    };
    let worst = |value: fn(&Drift) -> f64| drifts.iter().flatten().map(value).fold(0.0, f64::max);
    let translation = |d: &Drift| d.translation_m * 1e3;
    let rotation = |d: &Drift| d.rotation_rad;
    Ok(html! {
        section #drift {
            h2 { "Anchor drift" }
            p.note {
                "How far the tool strays from its place on the handle while it holds it, by forward kinematics of the original robot and object at every dense sample and at three points between each two. Worst of all: "
                strong { (format!("{:.4} mm", worst(translation))) } " and "
                strong { (format!("{:.6} rad", worst(rotation))) } "."
            }
            div.pair {
                div.card { (chart("translation, mm", translation, DRIFT_TOLERANCE_MM, "1 mm tolerance").draw()) }
                div.card { (chart("rotation, rad", rotation, DRIFT_TOLERANCE_RAD, "0.01 rad tolerance").draw()) }
            }
        }
    })
}

fn thinned<T>(values: &[T], point: impl Fn(&T) -> [f64; 2]) -> Vec<[f64; 2]> {
    // The worst of each group, so that no peak is lost.
    let group = (values.len() / PLOT_POINTS).max(1);
    let worst = |points: Vec<[f64; 2]>| points.into_iter().max_by(|a, b| a[1].total_cmp(&b[1]));
    values.chunks(group).filter_map(|chunk| worst(chunk.iter().map(&point).collect())).collect()
}

fn verdict_section(input: &ReportInput<'_>, shown: &[usize]) -> Markup {
    let trajectories = &input.set.trajectories;
    html! {
        section #verdicts {
            h2 { "What the judge found" }
            div.scroll { table {
                thead { tr {
                    th { "#" } th { "grasp" } th { "goal" } th { "length, s" } th.word { "verdict" }
                    th { "anchor, mm" } th { "anchor, rad" } th { "speed, %" } th { "acceleration, %" }
                    th { "base yaw, rad" } th { "penetration, mm" }
                } }
                tbody { @for (index, trajectory) in trajectories.iter().enumerate().take(MAX_ROWS) {
                    (verdict_row(index, trajectory, shown.contains(&index)))
                } }
            } }
            p.note {
                "Worst values over all samples; speed and acceleration as shares of the limits."
                @if trajectories.len() > MAX_ROWS {
                    " " (trajectories.len() - MAX_ROWS) " more trajectories are not listed."
                }
            }
        }
    }
}

fn verdict_row(index: usize, trajectory: &Trajectory, shown: bool) -> Markup {
    let dot = format!("background:{}", trajectory_color(index));
    html! {
        tr {
            td { @if shown { span.dot style=(dot) {} } (index) }
            td { (trajectory.grasp.id) }
            td { (number(trajectory.goal)) }
            td { (format!("{:.1}", trajectory.dense.duration_s())) }
            @if let Some(v) = &trajectory.verdict {
                td.word title=(v.detail) {
                    @match v.rejection {
                        None => span.good { "accepted" },
                        Some(reason) => span.bad { (reason.name()) },
                    }
                }
                td { (format!("{:.4}", v.anchor_translation_m * 1e3)) }
                td { (format!("{:.6}", v.anchor_rotation_rad)) }
                td { (format!("{:.0}", v.velocity_fraction * 1e2)) }
                td { (format!("{:.0}", v.acceleration_fraction * 1e2)) }
                td { (format!("{:.2}", v.base_yaw_rad)) }
                td { (format!("{:.2}", v.penetration_m * 1e3)) }
            } @else {
                td.word { "not judged" }
                @for _ in 0..6 { td { "–" } }
            }
        }
    }
}

/// Counts grouped by what stands before the slash, with bars on a logarithmic scale.
fn counts_section(counts: &BTreeMap<String, u64>) -> Markup {
    let mut groups: BTreeMap<&str, Vec<(&str, u64)>> = BTreeMap::new();
    for (key, &count) in counts {
        let (group, name) = key.split_once('/').unwrap_or((key, "all"));
        groups.entry(group).or_default().push((name, count));
    }
    let largest = counts.values().copied().max().unwrap_or(1);
    let share = |count: u64| 100.0 * (1.0 + count as f64).ln() / (1.0 + largest as f64).ln();
    html! {
        section #counts {
            h2 { "Counts and rejections" }
            @if counts.is_empty() { p.empty { "The file holds no counts." } }
            div.groups { @for (group, rows) in &in_order(groups) {
                div.card { h3 { (group) }
                    table.bars { tbody { @for (name, count) in rows {
                        tr { th { (name) } td { (thousands(*count)) }
                            td.bar { i class=(if matches!(*group, "failed" | "rejected") { "loss" } else { "" })
                                style=(format!("width:{:.1}%", share(*count))) {} } }
                    } } }
                }
            } }
            p.note { "Bars are logarithmic." }
        }
    }
}

/// Groups of counts in the order of the stages; those of no known stage before the outcome.
fn in_order<V>(groups: BTreeMap<&str, V>) -> Vec<(&str, V)> {
    const FIRST: [&str; 3] = ["grasps", "ik", "pairs"];
    const LAST: [&str; 3] = ["failed", "rejected", "accepted"];
    let rank = |group: &str| {
        let first = FIRST.iter().position(|&known| known == group);
        let last = LAST.iter().position(|&known| known == group);
        first.or(last.map(|place| FIRST.len() + 1 + place)).unwrap_or(FIRST.len())
    };
    let mut ordered: Vec<(&str, V)> = groups.into_iter().collect();
    ordered.sort_by_key(|(group, _)| rank(group));
    ordered
}

fn run_sections(input: &ReportInput<'_>) -> Markup {
    let Some(run) = input.run else { return html! {} };
    let slowest = run.stage_seconds.values().copied().fold(1e-9, f64::max);
    html! {
        @if !run.stage_seconds.is_empty() { section #timing {
            h2 { "Time by stage" }
            div.card { table.bars { tbody { @for (stage, &seconds) in &run.stage_seconds {
                tr { th { (stage) } td { (format!("{seconds:.2} s")) }
                    td.bar { i style=(format!("width:{:.1}%", 100.0 * seconds / slowest)) {} } }
            } } } }
        } }
        @if !run.sphere_fits.is_empty() { section #spheres {
            h2 { "Collision spheres" }
            div.scroll { table {
                thead { tr { th.word { "link" } th { "spheres" } th { "coverage, %" } th { "protrusion, mm" } } }
                tbody { @for fit in &run.sphere_fits { tr {
                    td.word { (fit.link) } td { (fit.count) }
                    td { (format!("{:.1}", fit.coverage * 1e2)) } td { (format!("{:.1}", fit.protrusion_m * 1e3)) }
                } } }
            } }
            p.note { "Coverage: share of the link's surface inside some sphere. Protrusion: how far a sphere reaches beyond it." }
        } }
        @if !run.notes.is_empty() { section #notes {
            h2 { "Notes" }
            ul.notes { @for note in &run.notes { li { (note) } } }
        } }
    }
}

fn licence_section(input: &ReportInput<'_>) -> Markup {
    let (robot, object) = (&input.task.robot, &input.task.file.object);
    let rows = [
        (robot.name.as_str(), robot.file.license.as_str(), robot.file.source.as_str()),
        (input.task.object.name.as_str(), object.license.as_str(), ""),
    ];
    let stated =
        |text: &str| if text.is_empty() { "not stated".to_owned() } else { text.to_owned() };
    html! {
        section #licences {
            h2 { "Licences of what is seen" }
            div.scroll { table {
                thead { tr { th.word { "asset" } th.word { "licence" } th.word { "source" } } }
                tbody { @for (asset, licence, source) in rows { tr {
                    td.word { (asset) } td.word { (stated(licence)) } td.word { (stated(source)) }
                } } }
            } }
            h3 { "Inputs" }
            div.scroll { table {
                thead { tr { th.word { "file" } th.word { "SHA-256" } } }
                tbody { @for (file, hash) in &input.set.header.content_hashes { tr {
                    td.word { (file) } td.word { code { (hash) } }
                } } }
            } }
        }
    }
}

/// A whole number with thin spaces between its thousands.
fn thousands(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_files_cannot_leave_their_place() {
        let counts = BTreeMap::from([("a<script>/\"><img src=x>".to_owned(), 3)]);
        let html = counts_section(&counts).into_string();
        assert!(html.contains("a&lt;script&gt;"), "{html}");
        assert!(!html.contains("<script") && !html.contains("<img"), "{html}");
    }

    #[test]
    fn thousands_are_grouped() {
        assert_eq!(thousands(1234567), "1\u{202f}234\u{202f}567");
        assert_eq!([0, 999].map(thousands), ["0", "999"]);
    }

    #[test]
    fn thinning_keeps_the_peak() {
        let values: Vec<f64> = (0..1000).map(|k| if k == 777 { 9.0 } else { 1.0 }).collect();
        let points = thinned(&values, |&v| [0.0, v]);
        assert!(points.len() < 500 && points.iter().any(|p| p[1] == 9.0));
    }
}
