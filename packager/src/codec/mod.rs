//! Chunks as HDF5's filter pipeline stores them, encoded and decoded on all cores.
//!
//! The library runs its filters under one global lock, and its inflating trusts the stream's own
//! length. Here chunks are independent of each other, and a decoded chunk never grows beyond the size that
//! the dataset states. The filters' numbers and layouts are those that the HDF Group has registered;
//! `hdf5plugin` reads what h5py alone does not.

mod blosc;
mod checksum;
mod lz4;
mod registry;
mod shuffle;

use std::cell::RefCell;

use hdf5::filters::Filter;
pub(crate) use registry::register;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How images and clouds in HDF5 shards are compressed; all without loss.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum Codec {
    /// Byte shuffle and deflate: read by every HDF5 library.
    #[default]
    Gzip,
    /// Byte shuffle and LZ4: fastest, largest (readers need `hdf5plugin`).
    Lz4,
    /// Byte shuffle and Zstandard: smallest for its speed (readers need `hdf5plugin`).
    Zstd,
    /// Blosc with bit shuffle and LZ4 (readers need `hdf5plugin`).
    Blosc,
}

/// Registered numbers of filters that HDF5 does not bring itself.
const LZ4_FILTER: i32 = 32004;
const ZSTD_FILTER: i32 = 32015;
const BLOSC_FILTER: i32 = 32001;

/// A codec with its level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Compression {
    codec: Codec,
    level: u8,
}

impl Compression {
    /// What small arrays are stored with: readable everywhere.
    pub const PORTABLE: Self = Self { codec: Codec::Gzip, level: 4 };

    /// A codec at `level`, or at its own default.
    pub fn new(codec: Codec, level: Option<u8>) -> Self {
        let (_, default, highest) = levels(codec);
        Self { codec, level: level.unwrap_or(default).min(highest) }
    }

    /// The filters of a dataset whose chunks of `chunk_bytes` bytes hold elements of `element_size` bytes.
    pub fn filters(self, element_size: usize, chunk_bytes: usize) -> Vec<Filter> {
        let level = u32::from(self.level);
        let compress = match self.codec {
            Codec::Gzip => Filter::Deflate(self.level),
            Codec::Lz4 => Filter::User(LZ4_FILTER, vec![0]),
            Codec::Zstd => Filter::User(ZSTD_FILTER, vec![level]),
            Codec::Blosc => {
                Filter::User(BLOSC_FILTER, blosc::parameters(element_size, chunk_bytes, level))
            }
        };
        let shuffle = (self.codec != Codec::Blosc).then_some(Filter::Shuffle);
        shuffle.into_iter().chain([compress, Filter::Fletcher32]).collect()
    }

    /// Encodes one chunk of little-endian elements of `element_size` bytes. No filter is ever skipped:
    /// noise grows by a few bytes rather than need a filter mask that readers treat differently.
    pub fn encode(self, raw: &[u8], element_size: usize) -> Vec<u8> {
        let shuffled = || shuffle::shuffle(raw, element_size);
        let mut stored = match self.codec {
            Codec::Gzip => deflate(&shuffled(), self.level),
            Codec::Lz4 => lz4::encode(&shuffled()),
            Codec::Zstd => zstd::bulk::compress(&shuffled(), i32::from(self.level))
                .expect("compressing into memory fails only where memory does"),
            Codec::Blosc => blosc::encode(raw, element_size, self.level),
        };
        checksum::append(&mut stored);
        stored
    }
}

/// Appends HDF5's checksum to a chunk that has no other filter.
pub(crate) fn append_checksum(chunk: &mut Vec<u8>) {
    checksum::append(chunk);
}

/// Lowest, default and highest level of a codec. LZ4 has none.
pub(crate) fn levels(codec: Codec) -> (u8, u8, u8) {
    match codec {
        Codec::Gzip => (1, 4, 9),
        Codec::Lz4 => (0, 0, 0),
        Codec::Zstd => (1, 3, 19),
        Codec::Blosc => (1, 5, 9),
    }
}

/// Undoes the filters of a chunk that holds exactly `chunk_bytes` bytes of elements of `element_size`.
///
/// # Errors
/// What is wrong with the chunk, or which filter is not known.
pub(crate) fn decode(
    filters: &[Filter],
    stored: Vec<u8>,
    element_size: usize,
    chunk_bytes: usize,
) -> Result<Vec<u8>, String> {
    let mut bytes = stored;
    for filter in filters.iter().rev() {
        bytes = match filter {
            Filter::Fletcher32 => checksum::verified(bytes)?,
            Filter::Deflate(_) => inflate(&bytes, chunk_bytes)?,
            Filter::Shuffle => shuffle::unshuffle(&bytes, element_size),
            Filter::User(LZ4_FILTER, _) => lz4::decode(&bytes, chunk_bytes)?,
            Filter::User(ZSTD_FILTER, _) => zstd::bulk::decompress(&bytes, chunk_bytes)
                .map_err(|e| format!("Zstandard: {e}"))?,
            Filter::User(BLOSC_FILTER, _) => blosc::decode(&bytes, chunk_bytes)?,
            other => return Err(format!("filter {other:?} is not one that we write")),
        };
    }
    if bytes.len() != chunk_bytes {
        return Err(format!("holds {} bytes, the dataset says {chunk_bytes}", bytes.len()));
    }
    Ok(bytes)
}

/// What a thread compresses with: setting it up takes longer than compressing a small chunk.
struct Deflater {
    level: u8,
    compressor: libdeflater::Compressor,
    output: Vec<u8>,
}

impl Deflater {
    fn new(level: u8) -> Self {
        let valid = libdeflater::CompressionLvl::new(i32::from(level))
            .expect("levels are held within libdeflate's range");
        Self { level, compressor: libdeflater::Compressor::new(valid), output: Vec::new() }
    }

    fn deflate(&mut self, input: &[u8]) -> Vec<u8> {
        let bound = self.compressor.zlib_compress_bound(input.len());
        if self.output.len() < bound {
            self.output.resize(bound, 0);
        }
        let size = self
            .compressor
            .zlib_compress(input, &mut self.output)
            .expect("the bound is the largest size a stream can have");
        self.output[..size].to_vec()
    }
}

/// A zlib stream.
fn deflate(input: &[u8], level: u8) -> Vec<u8> {
    thread_local! {
        static DEFLATER: RefCell<Option<Deflater>> = const { RefCell::new(None) };
    }
    DEFLATER.with_borrow_mut(|deflater| {
        let fitting = deflater.take().filter(|known| known.level == level);
        deflater.insert(fitting.unwrap_or_else(|| Deflater::new(level))).deflate(input)
    })
}

fn inflate(stream: &[u8], chunk_bytes: usize) -> Result<Vec<u8>, String> {
    let mut output = vec![0; chunk_bytes];
    let size = libdeflater::Decompressor::new()
        .zlib_decompress(stream, &mut output)
        .map_err(|e| format!("deflate: {e}"))?;
    output.truncate(size);
    Ok(output)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;
    use proptest::prelude::*;

    fn bytes_of(values: &[u16]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    /// Chunks written directly are read back by the library through its own filters.
    fn library_reads(values: &[u16]) -> Vec<u16> {
        let folder = tempfile::tempdir().unwrap();
        let file = hdf5::File::create(folder.path().join("c.h5")).unwrap();
        let dataset = file
            .new_dataset::<u16>()
            .chunk((values.len(),))
            .set_filters(&Compression::PORTABLE.filters(2, 2 * values.len()));
        let dataset = dataset.shape((values.len(),)).create("d").unwrap();
        let chunk = Compression::PORTABLE.encode(&bytes_of(values), 2);
        crate::h5::write_chunk(&dataset, &[0], &chunk).unwrap();
        dataset.read_raw().unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn library_decodes_noise_and_constants(noise in prop::collection::vec(any::<u16>(), 1..2000), constant: u16) {
            prop_assert_eq!(library_reads(&noise), noise.clone());
            let constant = vec![constant; noise.len()];
            prop_assert_eq!(library_reads(&constant), constant);
        }

        #[test]
        fn every_codec_gives_back_what_it_took(noise in prop::collection::vec(any::<u16>(), 1..9000), constant: u16) {
            for &codec in Codec::value_variants() {
                let compression = Compression::new(codec, None);
                for values in [noise.clone(), vec![constant; noise.len()]] {
                    let raw = bytes_of(&values);
                    let filters = compression.filters(2, raw.len());
                    let decoded = decode(&filters, compression.encode(&raw, 2), 2, raw.len());
                    prop_assert_eq!(decoded, Ok(raw), "{:?}", codec);
                }
            }
        }

        /// Without the checksum, which would hide the codecs from the damage.
        #[test]
        fn damaged_chunks_are_refused_or_decoded_within_bounds(
            values in prop::collection::vec(0u16..9, 100..4000), flips in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..4), cut: prop::sample::Index,
        ) {
            for &codec in Codec::value_variants() {
                let compression = Compression::new(codec, None);
                let raw = bytes_of(&values);
                let mut stored = compression.encode(&raw, 2);
                stored.truncate(stored.len() - 4);
                for (place, flip) in &flips {
                    let index = place.index(stored.len());
                    stored[index] ^= flip;
                }
                let mut filters = compression.filters(2, raw.len());
                filters.pop();
                let cut = stored[..cut.index(stored.len())].to_vec();
                for damaged in [stored, cut] {
                    if let Ok(decoded) = decode(&filters, damaged, 2, raw.len()) {
                        prop_assert_eq!(decoded.len(), raw.len());
                    }
                }
            }
        }
    }

    #[test]
    fn a_bomb_is_refused_before_it_grows() {
        let zeros = vec![0; 64 << 20];
        for &codec in Codec::value_variants() {
            let compression = Compression::new(codec, None);
            let stored = compression.encode(&zeros, 1);
            let filters = compression.filters(1, zeros.len());
            let error = decode(&filters, stored, 1, 1000).unwrap_err();
            assert!(!error.is_empty(), "{codec:?}");
        }
    }

    #[test]
    fn every_flipped_bit_fails_the_checksum() {
        for &codec in Codec::value_variants() {
            let compression = Compression::new(codec, None);
            let raw: Vec<u8> = (0..200u8).collect();
            let filters = compression.filters(1, raw.len());
            let stored = compression.encode(&raw, 1);
            for index in 0..stored.len() {
                let mut damaged = stored.clone();
                damaged[index] ^= 1 << (index % 8);
                assert!(decode(&filters, damaged, 1, raw.len()).is_err(), "{codec:?} byte {index}");
            }
        }
    }
}
