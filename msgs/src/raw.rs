//! A message that is not decoded: what recorder and replay move.

use serde::de::{SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// The little-endian CDR payload of any message, WITHOUT the 4-byte encapsulation header.
///
/// On the wire it is exactly these bytes. Only messages from little-endian machines can be received
/// in this form.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RawMessage(pub Vec<u8>);

impl ros2_client::Message for RawMessage {}

impl RawMessage {
    /// From bytes as a bag holds them (with header).
    ///
    /// # Errors
    /// [`crate::CdrError`] when the header is missing or is not little-endian CDR.
    pub fn from_bag(bytes: &[u8]) -> Result<Self, crate::CdrError> {
        match bytes {
            [0, 1, _, _, payload @ ..] => Ok(Self(payload.to_vec())),
            [a, b, _, _, ..] => Err(crate::CdrError::Encapsulation(*a, *b)),
            _ => Err(crate::CdrError::TooShort(bytes.len())),
        }
    }

    /// As a bag holds it (with header).
    pub fn to_bag(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.0.len() + 4);
        out.extend_from_slice(&[0, 1, 0, 0]);
        out.extend_from_slice(&self.0);
        out
    }
}

// The payload starts at offset 0, where every alignment is met, so whole words pass through the
// encoder unpadded; the rest goes octet by octet. This is what makes it fast enough for images.
impl Serialize for RawMessage {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (words, rest) = self.0.as_chunks::<8>();
        let mut tuple = serializer.serialize_tuple(words.len() + rest.len())?;
        for word in words {
            tuple.serialize_element(&u64::from_le_bytes(*word))?;
        }
        for octet in rest {
            tuple.serialize_element(octet)?;
        }
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for RawMessage {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct RawVisitor;
        impl<'de> Visitor<'de> for RawVisitor {
            type Value = RawMessage;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a CDR payload")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<RawMessage, A::Error> {
                let mut out = Vec::new();
                // The decoder does not tell how much is left: the end shows as a failed read, which
                // consumes nothing.
                while let Ok(Some(word)) = seq.next_element::<u64>() {
                    out.extend_from_slice(&word.to_le_bytes());
                }
                while let Ok(Some(octet)) = seq.next_element::<u8>() {
                    out.push(octet);
                }
                Ok(RawMessage(out))
            }
        }
        deserializer.deserialize_tuple(usize::MAX, RawVisitor)
    }
}
