//! A page that links to other pages.

use std::path::{Path, PathBuf};

use maud::html;

use super::document::document;
use super::save;
use crate::Error;

/// One link.
#[derive(Debug, Clone)]
pub struct IndexEntry {
    /// Heading.
    pub name: String,
    /// The page, relative to the index.
    pub link: String,
    /// An animated picture, relative to the index.
    pub picture: Option<String>,
    /// One sentence.
    pub summary: String,
}

/// Writes `index.html` into `folder` and returns its path.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_index(folder: &Path, title: &str, entries: &[IndexEntry]) -> Result<PathBuf, Error> {
    let page = document(
        title,
        &html! {
            header.top { p.brand { "Akrobat" } h1 { (title) } }
            main {
                @for entry in entries {
                    section {
                        h2 { a href=(entry.link) { (entry.name) } }
                        p { (entry.summary) }
                        @if let Some(picture) = &entry.picture {
                            a href=(entry.link) { img src=(picture) alt=(entry.name) style="max-width:100%"; }
                        }
                    }
                }
            }
        },
    );
    save(&folder.join("index.html"), page.into_string().as_bytes())
}
