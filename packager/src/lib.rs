//! What Akrobat stores: trajectory files, dataset shards, MCAP logs and manifests.
//!
//! Files appear under their final name only when they are whole: they are written under a
//! temporary name in the same folder, synced and renamed. The same input gives the same bytes.

pub mod audit_file;
pub mod dataset;
pub mod episode;
pub mod error;
pub mod export;
mod h5;
pub mod import;
pub mod mcap_log;
pub mod shard;
pub mod trajectory_file;
mod whole_file;
mod whole_folder;

pub use dataset::{DatasetConfig, DatasetReader, DatasetWriter, check_writable, validate};
pub use episode::{Attachment, CloudLayout, DepthEncoding, EpisodeInfo};
pub use error::PackError;
pub use mcap_log::{ColorEncoding, McapWriter};
pub use shard::ShardWriter;
pub use whole_folder::StagingFolder;
