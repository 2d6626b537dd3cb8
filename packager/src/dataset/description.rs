//! The description of a dataset: `dataset.json`, which carries a checksum of itself.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::manifest::DatasetConfig;
use crate::error::{PackError, Result};

/// File name of the description in a dataset folder.
pub const DESCRIPTION: &str = "dataset.json";

/// Value of `format` in the description.
pub const FORMAT: &str = "akrobat.dataset";

/// Value of `format_version` in the description.
pub const FORMAT_VERSION: u32 = 1;

/// The description file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Description {
    pub format: String,
    pub format_version: u32,
    /// True once all episodes were written and the dataset was closed.
    pub complete: bool,
    /// SHA-256 of the manifest, where the dataset is complete.
    pub manifest_sha256: Option<String>,
    /// SHA-256 of this file's text with this value left empty.
    pub sha256: String,
    pub config: DatasetConfig,
}

impl Description {
    /// Of a dataset that is being written.
    pub fn open(config: DatasetConfig) -> Self {
        Self {
            format: FORMAT.into(),
            format_version: FORMAT_VERSION,
            complete: false,
            manifest_sha256: None,
            sha256: String::new(),
            config,
        }
    }

    /// Of a dataset whose manifest is final.
    pub fn complete(config: DatasetConfig, manifest_sha256: String) -> Self {
        let manifest_sha256 = Some(manifest_sha256);
        Self { complete: true, manifest_sha256, ..Self::open(config) }
    }

    pub fn write(&self, folder: &Path) -> Result<()> {
        let mut sealed = Self { sha256: String::new(), ..self.clone() };
        sealed.sha256 = akrobat_model::hash::of_bytes(sealed.text().as_bytes());
        crate::whole_file::write(&folder.join(DESCRIPTION), sealed.text().as_bytes())
    }

    fn text(&self) -> String {
        serde_json::to_string_pretty(self).expect("plain data has a JSON form") + "\n"
    }

    pub fn read(folder: &Path) -> Result<Self> {
        let (path, text) = read_text(folder)?;
        let description: Self =
            serde_json::from_str(&text).map_err(|e| PackError::damaged(&path, e.to_string()))?;
        if description.format != FORMAT || description.format_version != FORMAT_VERSION {
            let expected = format!("{FORMAT} {FORMAT_VERSION}");
            let got = format!("{} {}", description.format, description.format_version);
            return Err(PackError::content(&path, "format", expected, got));
        }
        Ok(description)
    }

    /// True where the file's text is the one that was written.
    pub fn is_sealed(folder: &Path) -> Result<bool> {
        const KEY: &str = "\"sha256\": \"";
        let (_, text) = read_text(folder)?;
        let Some((before, rest)) = text.split_once(KEY) else { return Ok(false) };
        let Some((sha256, after)) = rest.split_once('"') else { return Ok(false) };
        let unsealed = format!("{before}{KEY}\"{after}");
        Ok(akrobat_model::hash::of_bytes(unsealed.as_bytes()) == sha256)
    }
}

fn read_text(folder: &Path) -> Result<(std::path::PathBuf, String)> {
    let path = folder.join(DESCRIPTION);
    let text = std::fs::read_to_string(&path).map_err(|e| PackError::read(&path, e))?;
    Ok((path, text))
}
