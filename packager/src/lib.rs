//! What Akrobat stores: trajectory files, dataset shards, MCAP logs and manifests.
//!
//! Files appear under their final name only when they are whole: they are written under a
//! temporary name in the same folder, synced and renamed. The same input gives the same bytes.

pub mod audit_file;
pub mod codec;
pub mod color;
pub mod dataset;
pub mod episode;
pub mod error;
pub mod export;
mod folder_lock;
mod h5;
pub mod import;
pub mod mcap_log;
mod quality;
pub mod shard;
pub mod storage;
pub mod trajectory_file;
mod whole_file;
mod whole_folder;

pub use codec::Codec;
pub use dataset::{DatasetConfig, DatasetReader, DatasetWriter, check_writable, validate};
pub use episode::{Attachment, CloudLayout, DepthEncoding, EpisodeInfo};
pub use error::PackError;
pub use folder_lock::FolderLock;
pub use mcap_log::McapWriter;
pub use quality::defect;
pub use shard::ShardWriter;
pub use storage::{ColorEncoding, StorageConfig};
pub use whole_folder::StagingFolder;
