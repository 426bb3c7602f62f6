//! Bounds-checked reading of flatbuffers: every access is checked against the file's length, so a
//! truncated or random file gives an error and never a panic.

use super::error::Flaw;

/// A flatbuffer in memory.
#[derive(Clone, Copy)]
pub(super) struct Buffer<'a> {
    bytes: &'a [u8],
}

/// One table: a place in the buffer and the place of its field directory.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    buffer: Buffer<'a>,
    position: usize,
    directory: usize,
    directory_size: usize,
}

/// A vector of `length` elements of a known size.
#[derive(Clone, Copy)]
pub(super) struct Vector<'a> {
    buffer: Buffer<'a>,
    start: usize,
    length: usize,
}

impl<'a> Buffer<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    fn array<const N: usize>(self, at: usize) -> Result<[u8; N], Flaw> {
        at.checked_add(N)
            .and_then(|end| self.bytes.get(at..end))
            .and_then(|slice| slice.try_into().ok())
            .ok_or_else(|| Flaw::malformed(format!("it ends before byte {at} + {N}")))
    }

    fn u16(self, at: usize) -> Result<u16, Flaw> {
        self.array(at).map(u16::from_le_bytes)
    }

    fn u32(self, at: usize) -> Result<u32, Flaw> {
        self.array(at).map(u32::from_le_bytes)
    }

    fn i32(self, at: usize) -> Result<i32, Flaw> {
        self.array(at).map(i32::from_le_bytes)
    }

    /// Follows the forward offset stored at `at`.
    fn follow(self, at: usize) -> Result<usize, Flaw> {
        at.checked_add(self.u32(at)? as usize)
            .filter(|target| *target < self.bytes.len())
            .ok_or_else(|| Flaw::malformed(format!("the offset at byte {at} leads out of it")))
    }

    fn table(self, position: usize) -> Result<Table<'a>, Flaw> {
        let back = i64::from(self.i32(position)?);
        let directory = usize::try_from(position as i64 - back)
            .map_err(|_| Flaw::malformed(format!("the table at byte {position} is broken")))?;
        let directory_size = usize::from(self.u16(directory)?);
        Ok(Table { buffer: self, position, directory, directory_size })
    }

    /// The root table; `identifier` are the four letters expected at byte 4.
    pub(super) fn root(self, identifier: &[u8; 4]) -> Result<Table<'a>, Flaw> {
        if &self.array::<4>(4)? != identifier {
            let name = String::from_utf8_lossy(identifier);
            return Err(Flaw::malformed(format!("the identifier {name} is missing")));
        }
        self.table(self.follow(0)?)
    }
}

impl<'a> Table<'a> {
    /// Place of field number `id`, or nothing where the file leaves it at its default.
    fn field(self, id: usize) -> Result<Option<usize>, Flaw> {
        let entry = 4 + 2 * id;
        if entry + 2 > self.directory_size {
            return Ok(None);
        }
        let offset = usize::from(self.buffer.u16(self.directory + entry)?);
        Ok((offset != 0).then_some(self.position + offset))
    }

    pub(super) fn byte(self, id: usize, default: u8) -> Result<u8, Flaw> {
        Ok(match self.field(id)? {
            Some(at) => self.buffer.array::<1>(at)?[0],
            None => default,
        })
    }

    pub(super) fn int(self, id: usize, default: i32) -> Result<i32, Flaw> {
        self.field(id)?.map_or(Ok(default), |at| self.buffer.i32(at))
    }

    pub(super) fn index(self, id: usize) -> Result<usize, Flaw> {
        self.field(id)?.map_or(Ok(0), |at| self.buffer.u32(at).map(|value| value as usize))
    }

    pub(super) fn table(self, id: usize) -> Result<Option<Table<'a>>, Flaw> {
        self.field(id)?.map(|at| self.buffer.table(self.buffer.follow(at)?)).transpose()
    }

    fn vector(self, id: usize, element: usize) -> Result<Vector<'a>, Flaw> {
        let Some(at) = self.field(id)? else {
            return Ok(Vector { buffer: self.buffer, start: 0, length: 0 });
        };
        let at = self.buffer.follow(at)?;
        let length = self.buffer.u32(at)? as usize;
        let start = at + 4;
        let fits = length
            .checked_mul(element)
            .and_then(|size| size.checked_add(start))
            .is_some_and(|end| end <= self.buffer.bytes.len());
        if !fits {
            return Err(Flaw::malformed(format!(
                "the vector at byte {at} is longer than the file"
            )));
        }
        Ok(Vector { buffer: self.buffer, start, length })
    }

    /// A vector of 32-bit integers; empty where the field is absent.
    pub(super) fn ints(self, id: usize) -> Result<Vec<i32>, Flaw> {
        let vector = self.vector(id, 4)?;
        (0..vector.length).map(|i| vector.buffer.i32(vector.start + 4 * i)).collect()
    }

    /// A vector of bytes; empty where the field is absent.
    pub(super) fn bytes(self, id: usize) -> Result<&'a [u8], Flaw> {
        let vector = self.vector(id, 1)?;
        Ok(&self.buffer.bytes[vector.start..vector.start + vector.length])
    }

    /// A vector of tables; empty where the field is absent.
    pub(super) fn tables(self, id: usize) -> Result<Vec<Table<'a>>, Flaw> {
        let vector = self.vector(id, 4)?;
        (0..vector.length)
            .map(|i| {
                let at = vector.buffer.follow(vector.start + 4 * i)?;
                vector.buffer.table(at)
            })
            .collect()
    }

    pub(super) fn text(self, id: usize) -> Result<String, Flaw> {
        self.bytes(id).map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A root table with field 0 = i32 7 and field 1 = vector [1, 2].
    fn sample() -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend(20u32.to_le_bytes()); // root table at 20
        bytes.extend(b"TFL3");
        bytes.extend(8u16.to_le_bytes()); // directory at 8: size, table size, two fields
        bytes.extend(12u16.to_le_bytes());
        bytes.extend(4u16.to_le_bytes());
        bytes.extend(8u16.to_le_bytes());
        bytes.extend(0u32.to_le_bytes()); // padding
        bytes.extend(12i32.to_le_bytes()); // table at 20, directory 12 bytes before
        bytes.extend(7i32.to_le_bytes());
        bytes.extend(4u32.to_le_bytes()); // vector 4 bytes further
        bytes.extend(2u32.to_le_bytes());
        bytes.extend(1i32.to_le_bytes());
        bytes.extend(2i32.to_le_bytes());
        bytes
    }

    #[test]
    fn fields_and_defaults_are_read() {
        let bytes = sample();
        let root = Buffer::new(&bytes).root(b"TFL3").unwrap();
        assert_eq!(root.int(0, 0).unwrap(), 7);
        assert_eq!(root.ints(1).unwrap(), [1, 2]);
        assert_eq!(root.int(2, 5).unwrap(), 5);
        assert!(root.ints(3).unwrap().is_empty());
        assert!(root.table(9).unwrap().is_none());
    }

    #[test]
    fn every_truncation_is_an_error_or_reads_within_bounds() {
        let bytes = sample();
        for end in 0..bytes.len() {
            let outcome = Buffer::new(&bytes[..end]).root(b"TFL3").and_then(|root| root.ints(1));
            assert!(outcome.is_err(), "{end} bytes");
        }
        assert!(Buffer::new(&bytes).root(b"ABCD").is_err());
    }
}
