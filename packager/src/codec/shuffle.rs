//! HDF5's byte shuffle: neighbouring elements' equal bytes come to stand beside each other.

use std::borrow::Cow;

/// All first bytes, then all second bytes, and so on; a ragged tail stays as it is.
pub(super) fn shuffle(raw: &[u8], element_size: usize) -> Cow<'_, [u8]> {
    match element_size {
        0 | 1 => Cow::Borrowed(raw),
        // What images and clouds consist of: lengths that are known make it several times faster.
        2 => planes(raw.as_chunks::<2>()).into(),
        4 => planes(raw.as_chunks::<4>()).into(),
        8 => planes(raw.as_chunks::<8>()).into(),
        size => {
            let (whole, tail) = raw.split_at(raw.len() - raw.len() % size);
            let plane = |byte: usize| whole[byte.min(whole.len())..].iter().step_by(size);
            (0..size).flat_map(plane).chain(tail).copied().collect()
        }
    }
}

fn planes<const N: usize>((elements, tail): (&[[u8; N]], &[u8])) -> Vec<u8> {
    let mut shuffled = vec![0; elements.len() * N];
    for (byte, plane) in shuffled.chunks_exact_mut(elements.len().max(1)).enumerate() {
        for (place, element) in plane.iter_mut().zip(elements) {
            *place = element[byte];
        }
    }
    shuffled.extend_from_slice(tail);
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
        assert_eq!(shuffle(&raw, 3)[..], [1, 11, 2, 12, 3, 13, 99]);
        assert_eq!(shuffle(&raw, 2)[..], [1, 3, 12, 2, 11, 13, 99]);
        for size in 0..9 {
            assert_eq!(unshuffle(&shuffle(&raw, size), size), raw, "{size}");
        }
    }
}
