//! Dataset folders: `dataset.json`, `manifest.jsonl` and `shards/`.

mod description;
pub mod manifest;
mod reader;
pub mod repair;
pub mod select;
pub mod split;
pub mod summary;
mod validate;
mod writer;

pub use description::DESCRIPTION;
pub use manifest::{
    Container, DatasetConfig, Licence, MANIFEST, ManifestEntry, Status, StoredEpisode,
};
pub use reader::{Array, DatasetReader, EpisodeReader, Values};
pub use validate::{Problem, Report, validate};
pub use writer::{DatasetWriter, check_writable, publish_parts};
