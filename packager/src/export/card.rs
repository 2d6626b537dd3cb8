//! The dataset card: `README.md` with Hugging Face's front matter, and pictures in `card/`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use super::config::{ExportFormat, Needs};
use super::licence::non_commercial;
use super::sink::ExportHeader;
use super::source::Source;
use crate::dataset::Licence;
use crate::error::{PackError, Result};

/// Episodes that are shown.
const SHOWN_EPISODES: usize = 3;

/// Writes the card of a dataset, or of an export of it, into `folder`. Returns the number of pictures.
///
/// # Errors
/// [`PackError::Io`], and as reading the frames that are shown.
pub fn write_card(
    folder: &Path,
    source: &Source,
    header: &ExportHeader,
    format: Option<ExportFormat>,
) -> Result<usize> {
    let pictures = folder.join("card");
    std::fs::create_dir_all(&pictures).map_err(|e| PackError::io(&pictures, e))?;
    let mut shown = Vec::new();
    let count = source.len().min(SHOWN_EPISODES);
    for number in 0..count {
        let index = number * source.len() / count;
        let name = format!("episode_{index}.png");
        let caption = write_picture(&pictures.join(&name), source, index)?;
        shown.push((format!("card/{name}"), caption));
    }
    let text = card_text(header, format, &shown);
    crate::whole_file::write(&folder.join("README.md"), text.as_bytes())?;
    Ok(shown.len())
}

/// First, middle and last frame of every camera: a row each. Returns the caption.
fn write_picture(path: &Path, source: &Source, index: usize) -> Result<String> {
    let (episode, frames) = source.episode(index)?;
    let last = episode.frames() - 1;
    let times = [0, last / 2, last];
    let width = episode.cameras.iter().map(|c| c.width).max().unwrap_or(0);
    let height: usize = episode.cameras.iter().map(|c| c.height).sum();
    let mut sheet = image::RgbImage::new((times.len() * width) as u32, height as u32);
    let needs = Needs { rgb: true, depth: false, segmentation: false, cloud: false };
    for (column, &time) in times.iter().enumerate() {
        let batch = frames.batch(time, 1, needs)?;
        let mut top = 0;
        for (camera, images) in episode.cameras.iter().zip(&batch.cameras) {
            let size = [camera.width as u32, camera.height as u32];
            if let Some(shot) = image::RgbImage::from_raw(size[0], size[1], images.rgb.clone()) {
                image::imageops::replace(&mut sheet, &shot, (column * width) as i64, top as i64);
            }
            top += camera.height;
        }
    }
    let mut png = Vec::new();
    sheet.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).map_err(|e| {
        PackError::Library { path: path.to_path_buf(), item: "PNG".into(), message: e.to_string() }
    })?;
    crate::whole_file::write(path, &png)?;
    let known = &episode.attributes;
    let names: Vec<&str> = episode.cameras.iter().map(|c| c.name.as_str()).collect();
    Ok(format!(
        "{}, {}, {}: {} at the start, in the middle and at the end",
        known.robot_id,
        known.object_id,
        known.scene_id,
        names.join(", ")
    ))
}

fn card_text(
    header: &ExportHeader,
    format: Option<ExportFormat>,
    pictures: &[(String, String)],
) -> String {
    let mut text = front_matter(header, format);
    // Writing to a string cannot fail.
    let _ = writeln!(text, "\n# {}\n", header.name);
    let _ = writeln!(
        text,
        "{} episodes, {} frames at {} Hz, made by [Akrobat]: planned, judged by independent code, replayed \
         and rendered. No robot was teleoperated and no physics decided what happens: the object moves as \
         the hand that holds it does.\n\n[Akrobat]: https://pypi.org/project/akrobat/\n",
        header.episodes, header.frames, header.frame_rate_hz
    );
    for (file, caption) in pictures {
        let _ = writeln!(text, "![{caption}]({file})\n\n*{caption}*\n");
    }
    contents(&mut text, header, format);
    statistics(&mut text, header);
    let _ = writeln!(text, "## Conventions\n\n| topic | |\n|---|---|");
    for (topic, words) in &header.conventions {
        let _ = writeln!(text, "| {topic} | {} |", cell(words));
    }
    licences(&mut text, &header.licences);
    provenance(&mut text, header);
    text
}

/// YAML between `---` lines, as the Hugging Face hub reads it.
fn front_matter(header: &ExportHeader, format: Option<ExportFormat>) -> String {
    let mut lines = vec!["---".to_owned()];
    lines.extend(front_licence(&header.licences));
    lines.push("task_categories:".into());
    lines.push("- robotics".into());
    lines.push("tags:".into());
    let mut tags = vec!["akrobat".to_owned(), "mobile-manipulation".into(), "synthetic".into()];
    if format == Some(ExportFormat::Lerobot) {
        tags.push("LeRobot".into());
    }
    tags.extend(header.robots.keys().cloned());
    lines.extend(tags.iter().map(|tag| format!("- {}", quoted(tag))));
    lines.push(format!("pretty_name: {}", quoted(&header.name)));
    let size = match header.episodes {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        _ => "100K<n<1M",
    };
    lines.push("size_categories:".into());
    lines.push(format!("- {size}"));
    if format == Some(ExportFormat::Lerobot) {
        lines.push("configs:".into());
        lines.push("- config_name: default".into());
        lines.push("  data_files: data/*/*.parquet".into());
    }
    lines.push("---\n".into());
    lines.join("\n")
}

/// One licence where all assets have the same; `other` with a name where they differ.
fn front_licence(licences: &[Licence]) -> Vec<String> {
    let mut names: Vec<&str> = licences.iter().map(|l| l.license.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    match names[..] {
        [one] if !one.is_empty() && !one.contains(' ') => {
            vec![format!("license: {}", quoted(&one.to_lowercase()))]
        }
        _ => vec![
            "license: other".into(),
            "license_name: by-asset".into(),
            "license_link: README.md#licences".into(),
        ],
    }
}

/// A YAML string.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Text for a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

fn contents(text: &mut String, header: &ExportHeader, format: Option<ExportFormat>) {
    let counts = |counts: &BTreeMap<String, u64>| -> String {
        counts.iter().map(|(name, n)| format!("{name} ({n})")).collect::<Vec<_>>().join(", ")
    };
    let _ = writeln!(text, "## Contents\n\n| | |\n|---|---|");
    let [shortest, longest] = header.episode_frames;
    let rows = [
        ("format", format.map_or("akrobat".into(), |f| f.name().to_owned())),
        ("episodes", header.episodes.to_string()),
        ("accepted by the judge", header.successes.to_string()),
        ("frames", format!("{} ({shortest} to {longest} an episode)", header.frames)),
        ("rate", format!("{} Hz", header.frame_rate_hz)),
        ("robots", counts(&header.robots)),
        ("bases", counts(&header.base_kinds)),
        ("objects", counts(&header.objects)),
        ("scenes", counts(&header.scenes)),
        (
            "goals of the driven joint",
            format!("{:.3} to {:.3} (rad or m)", header.goals[0], header.goals[1]),
        ),
        ("points of each cloud", header.cloud_points.to_string()),
    ];
    for (name, value) in rows {
        let _ = writeln!(text, "| {name} | {} |", cell(&value));
    }
    let _ = writeln!(text, "\n| camera | size | field of view across | rate |\n|---|---|---|---|");
    for camera in &header.cameras {
        let intrinsics = camera.intrinsics();
        let half = f64::from(camera.width) / 2.0 / intrinsics.fx;
        let rate = camera.rate_hz.unwrap_or(header.frame_rate_hz);
        let _ = writeln!(
            text,
            "| {} | {} x {} | {:.1} degrees | {rate} Hz |",
            camera.name,
            camera.width,
            camera.height,
            2.0 * half.atan().to_degrees()
        );
    }
    let _ = writeln!(text);
}

fn statistics(text: &mut String, header: &ExportHeader) {
    let tables = [
        ("Actions", &header.action_names, &header.action_statistics),
        ("States", &header.state_names, &header.state_statistics),
    ];
    for (title, names, statistics) in tables {
        let _ = writeln!(
            text,
            "## {title}\n\n| column | least | greatest | mean | deviation |\n|---|---|---|---|---|"
        );
        for (i, name) in names.iter().enumerate() {
            let _ = writeln!(
                text,
                "| {} | {:.4} | {:.4} | {:.4} | {:.4} |",
                cell(name),
                statistics.min[i],
                statistics.max[i],
                statistics.mean[i],
                statistics.std[i]
            );
        }
        let _ = writeln!(text);
    }
}

fn licences(text: &mut String, licences: &[Licence]) {
    let _ = writeln!(text, "\n## Licences\n\n| asset | licence | source |\n|---|---|---|");
    let or_unknown = |value: &str| {
        if value.is_empty() { "not stated".to_owned() } else { cell(value) }
    };
    for licence in licences {
        let _ = writeln!(
            text,
            "| {} | {} | {} |",
            cell(&licence.asset),
            or_unknown(&licence.license),
            or_unknown(&licence.source)
        );
    }
    let bound: Vec<&str> = non_commercial(licences).iter().map(|l| l.asset.as_str()).collect();
    if !bound.is_empty() {
        let _ = writeln!(text, "\n**Not for commercial use**, because of: {}.", bound.join(", "));
    }
}

fn provenance(text: &mut String, header: &ExportHeader) {
    let config = serde_json::to_value(&header.config).unwrap_or_default();
    let _ = writeln!(
        text,
        "\n## Provenance\n\nSettings of the export, and what the dataset says of how it came to be:\n\n```json\n{:#}\n```\n\n```json\n{:#}\n```",
        config, header.provenance
    );
}
