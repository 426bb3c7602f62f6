use crate::ProtocolError;

/// Largest package that is accepted, bytes (the size field is 16 bits; real packages are below 4 kB).
pub const MAX_PACKAGE: usize = 16 * 1024;

/// One package: its type byte and its payload without the header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Package type (an ASCII letter).
    pub kind: u8,
    /// Payload.
    pub payload: Vec<u8>,
}

impl Frame {
    /// Header (u16 size of the whole package, u8 type) and payload.
    pub fn to_bytes(&self) -> Vec<u8> {
        let size = (self.payload.len() + 3) as u16;
        let mut out = Vec::with_capacity(usize::from(size));
        out.extend_from_slice(&size.to_be_bytes());
        out.push(self.kind);
        out.extend_from_slice(&self.payload);
        out
    }
}

/// Cuts a byte stream into frames; holds at most one incomplete package.
#[derive(Debug, Default)]
pub struct FrameReader {
    buffer: Vec<u8>,
}

impl FrameReader {
    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole package, or `None` until more bytes arrive.
    ///
    /// # Errors
    /// [`ProtocolError::PackageSize`]: the stream is out of step and has to be closed.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, ProtocolError> {
        let [a, b, kind, ..] = self.buffer[..] else { return Ok(None) };
        let size = usize::from(u16::from_be_bytes([a, b]));
        if !(3..=MAX_PACKAGE).contains(&size) {
            return Err(ProtocolError::PackageSize { size, max: MAX_PACKAGE });
        }
        if self.buffer.len() < size {
            return Ok(None);
        }
        let payload = self.buffer[3..size].to_vec();
        self.buffer.drain(..size);
        Ok(Some(Frame { kind, payload }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_survive_any_cut() {
        let frames =
            [Frame { kind: b'V', payload: vec![0, 2] }, Frame { kind: b'S', payload: vec![] }];
        let bytes: Vec<u8> = frames.iter().flat_map(Frame::to_bytes).collect();
        for cut in 0..bytes.len() {
            let mut r = FrameReader::default();
            let mut got = Vec::new();
            for part in [&bytes[..cut], &bytes[cut..]] {
                r.push(part);
                while let Some(f) = r.next_frame().unwrap() {
                    got.push(f);
                }
            }
            assert_eq!(got, frames);
        }
    }

    #[test]
    fn garbage_is_an_error_not_a_wait() {
        let mut r = FrameReader::default();
        r.push(b"GET / HTTP/1.1\r\n");
        assert!(matches!(r.next_frame(), Err(ProtocolError::PackageSize { .. })));
        let mut r = FrameReader::default();
        r.push(&[0, 1, 86]);
        assert!(r.next_frame().is_err());
    }
}
