//! HDF5's Fletcher-32 filter (HDF5 File Format Specification, version 3, section IV.A.2.l).

/// Appends the checksum of what is there.
pub(super) fn append(bytes: &mut Vec<u8>) {
    let checksum = fletcher32(bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
}

/// Removes the checksum again where it is that of the bytes before it.
pub(super) fn verified(mut bytes: Vec<u8>) -> Result<Vec<u8>, String> {
    let Some(stored) = bytes.last_chunk::<4>().map(|last| u32::from_le_bytes(*last)) else {
        return Err("is too short for its checksum".into());
    };
    bytes.truncate(bytes.len() - 4);
    let found = fletcher32(&bytes);
    if found == stored {
        return Ok(bytes);
    }
    Err(format!("the checksum is {found:08x}, the file says {stored:08x}"))
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

    #[test]
    fn published_checksums_hold() {
        // Little-endian examples are common; these are the big-endian words "ab", "cd", "e\0".
        let words = [0x6162u32, 0x6364, 0x6500];
        let sum1 = words.iter().sum::<u32>() % 65535;
        let sum2 = (3 * words[0] + 2 * words[1] + words[2]) % 65535;
        assert_eq!(fletcher32(b"abcde"), (sum2 << 16) | sum1);
    }

    #[test]
    fn the_library_refuses_a_wrong_checksum() {
        use crate::codec::Compression;
        let folder = tempfile::tempdir().unwrap();
        let file = hdf5::File::create(folder.path().join("c.h5")).unwrap();
        let dataset = file
            .new_dataset::<u8>()
            .chunk((100,))
            .set_filters(&Compression::PORTABLE.filters(1, 100));
        let dataset = dataset.shape((100,)).create("d").unwrap();
        let mut chunk = Compression::PORTABLE.encode(&[7; 100], 1);
        *chunk.last_mut().unwrap() ^= 1;
        crate::h5::write_chunk(&dataset, &[0], &chunk).unwrap();
        assert!(dataset.read_raw::<u8>().is_err());
    }
}
