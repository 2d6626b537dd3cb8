//! Dataset folders: `dataset.json`, `manifest.jsonl` and `shards/`.

pub mod manifest;
mod reader;
mod validate;
mod writer;

pub use manifest::{Container, DatasetConfig, Licence, ManifestEntry, Status, StoredEpisode};
pub use reader::{Array, DatasetReader, EpisodeReader, Values};
pub use validate::{Problem, Report, validate};
pub use writer::{DatasetWriter, check_writable};
