//! What of our ROS 2 messages can be checked: images, clouds and joint positions.

/// Content of a message.
#[derive(Debug)]
pub(crate) enum Content<'a> {
    /// A colour image file.
    Image {
        /// Camera name, from the topic.
        camera: &'a str,
        /// PNG or JPEG.
        file: &'a [u8],
    },
    /// A depth image.
    Depth {
        /// Bytes of 16-bit millimetres.
        millimetres: &'a [u8],
    },
    /// A cloud.
    Cloud {
        /// Points in the world frame, metres.
        positions: Vec<[f32; 3]>,
    },
    /// Joint positions.
    Joints {
        /// In the message's order, rad or m.
        positions: Vec<f64>,
    },
    /// Anything else.
    Other,
}

/// Reads a message of one of our topics.
///
/// # Errors
/// What does not fit the topic's message definition.
pub(crate) fn parse<'a>(topic: &'a str, data: &'a [u8]) -> Result<Content<'a>, String> {
    let camera = |suffix: &str| topic.strip_prefix("/camera/")?.strip_suffix(suffix);
    if let Some(camera) = camera("/color/image/compressed") {
        let mut cdr = CdrReader::new(data)?;
        cdr.header()?;
        cdr.skip_string()?;
        return Ok(Content::Image { camera, file: cdr.bytes()? });
    }
    if camera("/depth/image_raw").is_some() {
        let mut cdr = CdrReader::new(data)?;
        cdr.header()?;
        let [height, width] = [cdr.u32()?, cdr.u32()?];
        cdr.skip_string()?;
        cdr.take(1)?;
        cdr.u32()?;
        let millimetres = cdr.bytes()?;
        let expected = 2 * u64::from(height) * u64::from(width);
        if millimetres.len() as u64 != expected {
            return Err(format!("{} bytes of depth, expected {expected}", millimetres.len()));
        }
        return Ok(Content::Depth { millimetres });
    }
    match topic {
        "/points" => cloud(data),
        "/joint_states" => joints(data),
        _ => Ok(Content::Other),
    }
}

fn cloud(data: &[u8]) -> Result<Content<'_>, String> {
    let mut cdr = CdrReader::new(data)?;
    cdr.header()?;
    cdr.u32()?;
    let count = cdr.u32()? as usize;
    for _ in 0..cdr.u32()? {
        cdr.skip_string()?;
        cdr.u32()?;
        cdr.take(1)?;
        cdr.u32()?;
    }
    cdr.take(1)?;
    let step = cdr.u32()? as usize;
    cdr.u32()?;
    let points = cdr.bytes()?;
    if step < 12 || Some(points.len()) != step.checked_mul(count) {
        return Err(format!("{} bytes are not {count} points of {step} bytes", points.len()));
    }
    let value = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("four bytes"));
    let position = |p: &[u8]| [value(&p[0..4]), value(&p[4..8]), value(&p[8..12])];
    Ok(Content::Cloud { positions: points.chunks_exact(step).map(position).collect() })
}

fn joints(data: &[u8]) -> Result<Content<'_>, String> {
    let mut cdr = CdrReader::new(data)?;
    cdr.header()?;
    for _ in 0..cdr.u32()? {
        cdr.skip_string()?;
    }
    let count = cdr.u32()? as usize;
    cdr.align(8);
    let bytes = cdr.take(count.checked_mul(8).ok_or("a count without bounds")?)?;
    let value = |v: &[u8]| f64::from_le_bytes(v.try_into().expect("eight bytes"));
    Ok(Content::Joints { positions: bytes.chunks_exact(8).map(value).collect() })
}

/// A message being read: the counterpart of [`super::cdr::CdrWriter`].
struct CdrReader<'a> {
    body: &'a [u8],
    position: usize,
}

impl<'a> CdrReader<'a> {
    fn new(message: &'a [u8]) -> Result<Self, String> {
        match message.split_at_checked(4) {
            Some(([0, 1, ..], body)) => Ok(Self { body, position: 0 }),
            _ => Err("the message is not little-endian CDR".into()),
        }
    }

    fn align(&mut self, size: usize) {
        self.position = self.position.next_multiple_of(size);
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.position.checked_add(count).filter(|&end| end <= self.body.len());
        let end = end.ok_or_else(|| format!("the message ends {count} bytes early"))?;
        let taken = &self.body[self.position..end];
        self.position = end;
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.align(4);
        Ok(u32::from_le_bytes(self.take(4)?.try_into().expect("four bytes")))
    }

    fn bytes(&mut self) -> Result<&'a [u8], String> {
        let count = self.u32()? as usize;
        self.take(count)
    }

    fn skip_string(&mut self) -> Result<(), String> {
        self.bytes().map(drop)
    }

    /// `std_msgs/msg/Header`.
    fn header(&mut self) -> Result<(), String> {
        self.u32()?;
        self.u32()?;
        self.skip_string()
    }
}

#[cfg(test)]
mod tests {
    use super::super::messages;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_written_is_read() {
        let points = [[1.0, -2.0, 3.0, 10.0, 20.0, 30.0], [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]];
        let message = messages::point_cloud(7, "world", &points);
        let Ok(Content::Cloud { positions }) = parse("/points", &message) else { panic!() };
        assert_eq!(positions, [[1.0, -2.0, 3.0], [4.0, 5.0, 6.0]]);
        let message = messages::joint_state(7, &["a", "door joint_0"], &[0.5, -1.5]);
        let Ok(Content::Joints { positions }) = parse("/joint_states", &message) else { panic!() };
        assert_eq!(positions, [0.5, -1.5]);
        let message = messages::compressed_image(7, "fixed", "png", b"content");
        let topic = "/camera/fixed/color/image/compressed";
        let Ok(Content::Image { camera, file }) = parse(topic, &message) else { panic!() };
        assert_eq!((camera, file), ("fixed", &b"content"[..]));
    }

    proptest! {
        #[test]
        fn no_message_is_read_beyond_its_end(mut noise in prop::collection::vec(any::<u8>(), 4..200)) {
            noise[..2].copy_from_slice(&[0, 1]);
            for topic in ["/points", "/joint_states", "/camera/a/depth/image_raw", "/camera/a/color/image/compressed"] {
                // Either is fine; neither may panic or ask for memory that the message does not fill.
                let _ = parse(topic, &noise);
            }
        }
    }
}
