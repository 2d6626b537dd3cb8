//! A page about a dataset: counts, arrays with their compression, ranges of the joints.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_packager::dataset::summary::Summary;
use maud::{Markup, html};

use super::document::document;
use super::save;
use crate::Error;

/// Writes the page.
///
/// # Errors
/// Where the file cannot be written.
pub fn write(path: &Path, summary: &Summary) -> Result<(), Error> {
    save(path, page(summary).into_string().as_bytes()).map(drop)
}

fn page(summary: &Summary) -> Markup {
    document(
        &format!("{} · Akrobat dataset", summary.name),
        &html! {
            header.top {
                p.brand { "Akrobat dataset" }
                h1 { (summary.name) }
                p {
                    (summary.episodes) " episodes, " (summary.frames) " frames, "
                    (megabytes(summary.bytes)) " MB in " (summary.files) " files; "
                    (summary.unique_starts) " different start states."
                    @if !summary.complete { " The run that writes it has not come to its end." }
                }
            }
            main {
                section { h2 { "Episodes" }
                    (counts("robot", &summary.robots))
                    (counts("object", &summary.objects))
                    (counts("scene", &summary.scenes))
                    @if !summary.reasons.is_empty() { (counts("left out", &summary.reasons)) }
                }
                section { h2 { "Arrays" } (arrays(summary)) }
                @for robot in summary.joints.keys() {
                    section { h2 { "Joints of " (robot) } (joints(summary, robot)) }
                }
            }
            footer { "Akrobat " (env!("CARGO_PKG_VERSION")) " · rad and m" }
        },
    )
}

/// Bytes in millions.
pub fn megabytes(bytes: u64) -> String {
    format!("{:.2}", bytes as f64 / 1e6)
}

fn counts(what: &str, counts: &BTreeMap<String, u64>) -> Markup {
    html! {
        table {
            thead { tr { th { (what) } th { "episodes" } } }
            tbody { @for (name, count) in counts { tr { td { (name) } td { (count) } } } }
        }
    }
}

fn arrays(summary: &Summary) -> Markup {
    html! {
        table {
            thead { tr { th { "array" } th { "row" } th { "raw MB" } th { "stored MB" } th { "ratio" } } }
            tbody {
                @for (name, array) in &summary.arrays {
                    tr {
                        td { (name) }
                        td { (array.element) " " (format!("{:?}", array.row)) }
                        td { (megabytes(array.raw_bytes)) }
                        td { (megabytes(array.stored_bytes)) }
                        td { (format!("{:.1}", array.raw_bytes as f64 / array.stored_bytes.max(1) as f64)) }
                    }
                }
            }
        }
    }
}

fn joints(summary: &Summary, robot: &str) -> Markup {
    html! {
        table {
            thead { tr { th { "joint" } th { "min" } th { "mean" } th { "max" } } }
            tbody {
                @for joint in &summary.joints[robot] {
                    tr {
                        td { (joint.name) }
                        @for value in [joint.min, joint.mean, joint.max] { td { (format!("{value:.3}")) } }
                    }
                }
            }
        }
    }
}
