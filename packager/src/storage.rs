//! How a dataset is stored.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::codec::{self, Codec, Compression};
use crate::episode::DepthEncoding;

/// How colour images are stored.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum ColorEncoding {
    /// Without loss, as the container does it best: arrays in HDF5 shards, PNG in MCAP logs.
    #[default]
    Native,
    /// PNG files, one after the other.
    Png,
    /// JPEG files of quality 95, one after the other.
    Jpeg,
}

/// How a dataset is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::Args)]
#[serde(default, deny_unknown_fields)]
pub struct StorageConfig {
    /// Compression of images and clouds in HDF5 shards; MCAP logs use Zstandard.
    #[arg(long, value_enum, default_value_t)]
    pub codec: Codec,
    /// Level of the compression; the codec's own default where absent.
    #[arg(long, value_name = "N")]
    pub codec_level: Option<u8>,
    /// How colour images are stored.
    #[arg(long, value_enum, default_value_t)]
    pub color: ColorEncoding,
    /// How depth images are stored in HDF5 shards; MCAP logs hold millimetres.
    #[arg(long, value_enum, default_value_t)]
    pub depth: DepthEncoding,
    /// Episodes in one HDF5 shard. What is interrupted loses at most the shard that was being written.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
    pub episodes_per_shard: u32,
    /// Bytes after which a shard is closed before it has all its episodes.
    #[arg(long, value_name = "N")]
    pub shard_bytes: Option<u64>,
}

impl Default for StorageConfig {
    fn default() -> Self {
        Self {
            codec: Codec::default(),
            codec_level: None,
            color: ColorEncoding::default(),
            depth: DepthEncoding::default(),
            episodes_per_shard: 50,
            shard_bytes: None,
        }
    }
}

impl StorageConfig {
    /// What is wrong with the values, and the valid choices.
    pub(crate) fn problem(&self) -> Option<String> {
        let (lowest, _, highest) = codec::levels(self.codec);
        if let Some(level) = self.codec_level.filter(|l| !(lowest..=highest).contains(l)) {
            let codec = format!("{:?}", self.codec).to_lowercase();
            return Some(format!("codec_level {level}: {codec} has levels {lowest} to {highest}"));
        }
        (self.episodes_per_shard == 0).then(|| "episodes_per_shard 0: expected at least 1".into())
    }

    /// How images and clouds are compressed.
    pub(crate) fn compression(&self) -> Compression {
        Compression::new(self.codec, self.codec_level)
    }
}
