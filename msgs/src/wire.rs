//! Serde helpers for wire forms that serde does not have: long fixed arrays and bounded sequences.

use serde::de::{Error as _, SeqAccess, Visitor};
use serde::ser::{Error as _, SerializeTuple};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

/// Writes an array of any length without a length prefix.
pub(crate) fn write_array<T: Serialize, S: Serializer, const N: usize>(
    array: &[T; N],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut tuple = serializer.serialize_tuple(N)?;
    for item in array {
        tuple.serialize_element(item)?;
    }
    tuple.end()
}

/// Reads an array of any length without a length prefix.
pub(crate) fn read_array<'de, T: Deserialize<'de>, D: Deserializer<'de>, const N: usize>(
    deserializer: D,
) -> Result<[T; N], D::Error> {
    struct ArrayVisitor<T, const N: usize>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for ArrayVisitor<T, N> {
        type Value = [T; N];
        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            write!(f, "{N} elements")
        }
        fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
            let mut items = Vec::with_capacity(N);
            while let Some(item) = seq.next_element()? {
                items.push(item);
            }
            let count = items.len();
            items.try_into().map_err(|_| A::Error::invalid_length(count, &self))
        }
    }
    deserializer.deserialize_tuple(N, ArrayVisitor::<T, N>(PhantomData))
}

/// Writes a sequence, refusing more than `N` elements.
pub(crate) fn bounded<T: Serialize, S: Serializer, const N: usize>(
    items: &[T],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    if items.len() > N {
        return Err(S::Error::custom(format!("{} elements where at most {N} fit", items.len())));
    }
    items.serialize(serializer)
}

/// Writes octets, refusing more than `N`.
#[allow(dead_code)] // only used where an interface has such a field
pub(crate) fn bounded_bytes<S: Serializer, const N: usize>(
    bytes: &[u8],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    if bytes.len() > N {
        return Err(S::Error::custom(format!("{} octets where at most {N} fit", bytes.len())));
    }
    serializer.serialize_bytes(bytes)
}

/// Writes text, refusing more than `N` bytes.
#[allow(dead_code)] // only used where an interface has such a field
pub(crate) fn bounded_text<S: Serializer, const N: usize>(
    text: &str,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    if text.len() > N {
        return Err(S::Error::custom(format!("{} bytes where at most {N} fit", text.len())));
    }
    serializer.serialize_str(text)
}
