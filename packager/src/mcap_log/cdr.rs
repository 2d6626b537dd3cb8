//! Common Data Representation, little-endian, as ROS 2 middleware puts messages on the wire (OMG
//! DDS-RTPS 2.5 section 10; OMG CORBA 3.3 part 2, section 9.3).

/// Encapsulation header: plain CDR, little-endian, no options.
const HEADER: [u8; 4] = [0x00, 0x01, 0x00, 0x00];

/// A message being serialised. Primitives are aligned to their size, counted from the end of the
/// encapsulation header.
#[derive(Debug)]
pub(crate) struct CdrWriter {
    bytes: Vec<u8>,
}

impl CdrWriter {
    pub fn new() -> Self {
        Self { bytes: HEADER.to_vec() }
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    fn align(&mut self, size: usize) {
        let position = self.bytes.len() - HEADER.len();
        self.bytes.resize(self.bytes.len() + position.next_multiple_of(size) - position, 0);
    }

    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub fn i32(&mut self, value: i32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Length with the closing NUL, then both.
    pub fn string(&mut self, value: &str) {
        self.length(value.len() + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.u8(0);
    }

    /// Number of elements of the sequence that follows.
    pub fn length(&mut self, count: usize) {
        self.u32(u32::try_from(count).expect("images, clouds and names stay below 4 GiB"));
    }

    pub fn byte_sequence(&mut self, values: &[u8]) {
        self.length(values.len());
        self.bytes.extend_from_slice(values);
    }

    pub fn f64_sequence(&mut self, values: impl ExactSizeIterator<Item = f64>) {
        self.length(values.len());
        values.for_each(|value| self.f64(value));
    }

    /// An array of fixed length: no count.
    pub fn f64_array(&mut self, values: &[f64]) {
        values.iter().for_each(|&value| self.f64(value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primitives_are_aligned_behind_the_header() {
        let mut cdr = CdrWriter::new();
        cdr.u8(1);
        cdr.u32(2);
        cdr.string("ab");
        cdr.f64(1.0);
        let expected = [
            &[0, 1, 0, 0][..],
            &[1, 0, 0, 0, 2, 0, 0, 0],
            &[3, 0, 0, 0, b'a', b'b', 0],
            &[0],
            &1.0f64.to_le_bytes(),
        ];
        assert_eq!(cdr.finish(), expected.concat());
    }
}
