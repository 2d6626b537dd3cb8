//! Chunks as HDF5's own filter pipeline would store them: byte shuffle, deflate, Fletcher-32.
//!
//! The library runs its filters under a global lock; encoding chunks here lets all cores share the
//! work. Filters are those of the HDF5 File Format Specification, version 3, section IV.A.2.l.

use crate::h5::DEFLATE_LEVEL;

/// Encodes one chunk of little-endian elements of `element_size` bytes. No filter is ever skipped:
/// noise grows by a few bytes rather than need a filter mask that readers treat differently.
pub(crate) fn encode(raw: &[u8], element_size: usize) -> Vec<u8> {
    let mut bytes =
        if element_size > 1 { deflate(&shuffle(raw, element_size)) } else { deflate(raw) };
    let checksum = fletcher32(&bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
    bytes
}

/// All first bytes, then all second bytes, and so on; a ragged tail stays as it is.
fn shuffle(raw: &[u8], element_size: usize) -> Vec<u8> {
    let count = raw.len() / element_size;
    let mut shuffled = Vec::with_capacity(raw.len());
    for byte in 0..element_size {
        shuffled.extend(raw[byte..].iter().step_by(element_size).take(count));
    }
    shuffled.extend_from_slice(&raw[count * element_size..]);
    shuffled
}

/// A zlib stream.
fn deflate(input: &[u8]) -> Vec<u8> {
    let level = libdeflater::CompressionLvl::new(i32::from(DEFLATE_LEVEL))
        .expect("the level is a constant within libdeflate's range");
    let mut compressor = libdeflater::Compressor::new(level);
    let mut output = vec![0; compressor.zlib_compress_bound(input.len())];
    let size = compressor
        .zlib_compress(input, &mut output)
        .expect("the bound is the largest size a stream can have");
    output.truncate(size);
    output
}

/// Fletcher's checksum over big-endian 16-bit words, an odd last byte counting as a high byte, with
/// sums modulo 65535 (Fletcher 1982, in the folded form that HDF5 documents).
fn fletcher32(bytes: &[u8]) -> u32 {
    // 360 words keep both sums within 32 bits between folds.
    const WORDS_PER_FOLD: usize = 360;
    let fold = |sum: u32| (sum & 0xffff) + (sum >> 16);
    let (mut sum1, mut sum2) = (0u32, 0u32);
    let (words, tail) = bytes.split_at(bytes.len() & !1);
    for block in words.chunks(2 * WORDS_PER_FOLD) {
        for word in block.chunks_exact(2) {
            sum1 += u32::from(u16::from_be_bytes([word[0], word[1]]));
            sum2 += sum1;
        }
        (sum1, sum2) = (fold(sum1), fold(sum2));
    }
    if let [last] = tail {
        sum1 += u32::from(*last) << 8;
        sum2 += sum1;
        (sum1, sum2) = (fold(sum1), fold(sum2));
    }
    (fold(sum2) << 16) | fold(sum1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Chunks written directly are read back by the library through its own filters.
    fn library_reads(values: &[u16]) -> Vec<u16> {
        let folder = tempfile::tempdir().unwrap();
        let file = hdf5::File::create(folder.path().join("c.h5")).unwrap();
        let dataset = file
            .new_dataset::<u16>()
            .chunk((values.len(),))
            .shuffle()
            .deflate(DEFLATE_LEVEL)
            .fletcher32()
            .shape((values.len(),))
            .create("d")
            .unwrap();
        let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        crate::h5::write_chunk(&dataset, &[0], &encode(&raw, 2)).unwrap();
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
    }

    #[test]
    fn library_checks_the_checksum() {
        let folder = tempfile::tempdir().unwrap();
        let file = hdf5::File::create(folder.path().join("c.h5")).unwrap();
        let dataset = file.new_dataset::<u8>().chunk((100,)).shuffle().deflate(4).fletcher32();
        let dataset = dataset.shape((100,)).create("d").unwrap();
        let mut chunk = encode(&[7; 100], 1);
        *chunk.last_mut().unwrap() ^= 1;
        crate::h5::write_chunk(&dataset, &[0], &chunk).unwrap();
        assert!(dataset.read_raw::<u8>().is_err());
    }

    #[test]
    fn published_checksums_hold() {
        // Little-endian examples are common; these are the big-endian words "ab", "cd", "e\0".
        let words = [0x6162u32, 0x6364, 0x6500];
        let sum1 = words.iter().sum::<u32>() % 65535;
        let sum2 = (3 * words[0] + 2 * words[1] + words[2]) % 65535;
        assert_eq!(fletcher32(b"abcde"), (sum2 << 16) | sum1);
    }
}
