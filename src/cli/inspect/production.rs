//! What `akrobat inspect` says of a folder of trajectory files.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};

use crate::Error;
use crate::pipeline::{self, Context, Production, ProductionRequest, Yield};
use crate::report::production_page;

/// Text and JSON about the trajectories below a folder; a page in `report` where given.
pub fn inspect(
    request: &ProductionRequest,
    report: Option<&Path>,
    context: &Context<'_>,
) -> Result<(String, Value), Error> {
    let (production, shots) = pipeline::production(request, context)?;
    let mut text = text(&production);
    let mut json = serde_json::to_value(&production).unwrap_or_default();
    if let Some(place) = report {
        let page = place.join("production.html");
        std::fs::create_dir_all(place).map_err(|e| Error::write(place, &e))?;
        production_page::write(&page, &production, &shots)?;
        text += &format!("\n  page    {}", page.display());
        json["report"] = json!([page]);
    }
    Ok((text, json))
}

fn text(production: &Production) -> String {
    let mut lines = vec![format!(
        "{}: {} trajectories in {} files, {} accepted by the judge, {:.1} h of motion",
        production.folder.display(),
        production.trajectories,
        production.files,
        production.accepted,
        production.motion_s / 3600.0
    )];
    lines.extend(production.yields.table());
    lines.push(format!("scenes: {}", scenes(&production.yields.by_scene)));
    for (class, opening) in &production.openings {
        lines.push(format!(
            "opened   {class:<16}{:.2} to {:.2}, {:.2} on average (rad or m)",
            opening.least, opening.most, opening.mean
        ));
    }
    for (robot, base) in &production.bases {
        lines.push(format!(
            "bases    {robot:<16}{} cells of {:.0} cm ({:.0} effective), {:.0}% of headings, {:.2} to {:.2} m from the object",
            base.cells,
            100.0 * base.cell_m,
            base.effective_cells,
            100.0 * base.headings,
            base.distance_m[0],
            base.distance_m[1]
        ));
    }
    for (robot, starts) in &production.starts {
        lines.push(format!(
            "starts   {robot:<16}{} different in {} trajectories, {} when grasping, {} grasps",
            starts.starts, starts.trajectories, starts.grasped, starts.grasps
        ));
    }
    lines.extend(production.not_drawn.iter().map(|reason| format!("not drawn: {reason}")));
    lines.extend(production.yields.reasons_table());
    lines.join("\n")
}

fn scenes(sums: &BTreeMap<String, Yield>) -> String {
    let solved = sums.values().filter(|sum| sum.solved > 0).count();
    let accepted = sums.values().map(|sum| sum.accepted);
    let (least, most) = (accepted.clone().min().unwrap_or(0), accepted.max().unwrap_or(0));
    format!("{}, {solved} with trajectories, {least} to {most} each", sums.len())
}
