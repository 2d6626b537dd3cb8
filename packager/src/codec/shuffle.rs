//! HDF5's byte shuffle: neighbouring elements' equal bytes come to stand beside each other.

/// All first bytes, then all second bytes, and so on; a ragged tail stays as it is.
pub(super) fn shuffle(raw: &[u8], element_size: usize) -> Vec<u8> {
    if element_size < 2 {
        return raw.to_vec();
    }
    let count = raw.len() / element_size;
    let mut shuffled = Vec::with_capacity(raw.len());
    for byte in 0..element_size {
        shuffled.extend(raw[byte.min(raw.len())..].iter().step_by(element_size).take(count));
    }
    shuffled.extend_from_slice(&raw[count * element_size..]);
    shuffled
}

/// Undoes [`shuffle`].
pub(super) fn unshuffle(shuffled: &[u8], element_size: usize) -> Vec<u8> {
    let count = shuffled.len() / element_size.max(1);
    if element_size < 2 || count == 0 {
        return shuffled.to_vec();
    }
    let (whole, tail) = shuffled.split_at(count * element_size);
    let mut raw = vec![0; whole.len()];
    for (byte, plane) in whole.chunks_exact(count).enumerate() {
        for (element, &value) in raw.chunks_exact_mut(element_size).zip(plane) {
            element[byte] = value;
        }
    }
    raw.extend_from_slice(tail);
    raw
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_gathered_and_scattered() {
        let raw = [1, 2, 3, 11, 12, 13, 99];
        assert_eq!(shuffle(&raw, 3), [1, 11, 2, 12, 3, 13, 99]);
        for size in 0..9 {
            assert_eq!(unshuffle(&shuffle(&raw, size), size), raw, "{size}");
        }
    }
}
