//! What `akrobat inspect` says of a dataset.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_packager::dataset::summary::{Summary, summarize};
use serde_json::{Value, json};

use crate::Error;
use crate::report::dataset_page::{self, megabytes};

/// Text and JSON about the dataset in `folder`; a page in `report` where given.
pub fn inspect(folder: &Path, report: Option<&Path>) -> Result<(String, Value), Error> {
    let summary = summarize(folder)?;
    let mut text = text(folder, &summary);
    let mut json = serde_json::to_value(&summary).unwrap_or_default();
    if let Some(place) = report {
        let page = place.join("dataset.html");
        std::fs::create_dir_all(place).map_err(|e| Error::write(place, &e))?;
        dataset_page::write(&page, &summary)?;
        text += &format!("\n  page    {}", page.display());
        json["report"] = json!([page]);
    }
    Ok((text, json))
}

fn text(folder: &Path, summary: &Summary) -> String {
    let mut lines = vec![
        format!(
            "{}: {} episodes, {} frames, {} MB in {} files",
            folder.display(),
            summary.episodes,
            summary.frames,
            megabytes(summary.bytes),
            summary.files
        ),
        format!("  starts  {} different states", summary.unique_starts),
        format!("  robots  {}", list(&summary.robots)),
        format!("  objects {}", list(&summary.objects)),
        format!("  scenes  {}", list(&summary.scenes)),
    ];
    if !summary.complete {
        lines.push("  state   not completed: resume or repair it".into());
    }
    if !summary.reasons.is_empty() {
        lines.push(format!("  left out {}", list(&summary.reasons)));
    }
    for (name, array) in &summary.arrays {
        let row: Vec<String> = array.row.iter().map(usize::to_string).collect();
        lines.push(format!(
            "  {name:<44} {:<8} [T{}{}] {:>9} MB, {:.1} times smaller than raw",
            array.element,
            if row.is_empty() { "" } else { ", " },
            row.join(", "),
            megabytes(array.stored_bytes),
            array.raw_bytes as f64 / array.stored_bytes.max(1) as f64
        ));
    }
    for (robot, joints) in &summary.joints {
        for joint in joints {
            lines.push(format!(
                "  {robot} {:<32} {:>8.3} to {:>7.3}, mean {:>7.3}",
                joint.name, joint.min, joint.max, joint.mean
            ));
        }
    }
    lines.join("\n")
}

fn list(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(name, count)| format!("{name} ({count})")).collect::<Vec<_>>().join(", ")
}
