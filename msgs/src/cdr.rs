//! Messages as the bytes that a bag or the wire holds: a 4-byte encapsulation header, then CDR.

use byteorder::{BigEndian, LittleEndian};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Why bytes and message do not go together.
#[derive(Debug, thiserror::Error)]
pub enum CdrError {
    /// Shorter than the header.
    #[error("{0} bytes are too few for a CDR message (the header alone has 4)")]
    TooShort(usize),
    /// Not plain CDR.
    #[error("encapsulation {0:02x} {1:02x} is not plain CDR (00 00 or 00 01)")]
    Encapsulation(u8, u8),
    /// The payload does not fit the type.
    #[error("CDR payload does not decode as {type_name}: {reason}")]
    Decode {
        /// Rust name of the type.
        type_name: &'static str,
        /// What the decoder says.
        reason: String,
    },
    /// The message cannot be written, for example because a bounded sequence is too long.
    #[error("{type_name} cannot be encoded as CDR: {reason}")]
    Encode {
        /// Rust name of the type.
        type_name: &'static str,
        /// What the encoder says.
        reason: String,
    },
}

/// Encodes with the little-endian header `00 01 00 00`.
///
/// # Errors
/// [`CdrError::Encode`] when a bounded field is too long.
pub fn to_cdr_bytes<M: Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    let payload = cdr_encoding::to_vec::<M, LittleEndian>(message).map_err(|e| {
        CdrError::Encode { type_name: std::any::type_name::<M>(), reason: e.to_string() }
    })?;
    let mut out = Vec::with_capacity(payload.len() + 4);
    out.extend_from_slice(&[0, 1, 0, 0]);
    out.extend_from_slice(&payload);
    Ok(out)
}

/// Decodes bytes with either byte order. Trailing padding is ignored.
///
/// # Errors
/// [`CdrError`] for a missing or foreign header and for a payload that ends early or breaks a rule.
pub fn from_cdr_bytes<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, CdrError> {
    let [a, b, _, _, payload @ ..] = bytes else {
        return Err(CdrError::TooShort(bytes.len()));
    };
    let decoded = match (a, b) {
        (0, 0) => cdr_encoding::from_bytes::<M, BigEndian>(payload),
        (0, 1) => cdr_encoding::from_bytes::<M, LittleEndian>(payload),
        (a, b) => return Err(CdrError::Encapsulation(*a, *b)),
    };
    decoded.map(|(message, _)| message).map_err(|e| CdrError::Decode {
        type_name: std::any::type_name::<M>(),
        reason: e.to_string(),
    })
}
