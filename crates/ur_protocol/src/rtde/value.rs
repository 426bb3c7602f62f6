use crate::ProtocolError;

/// Data types of RTDE fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldType {
    /// One byte, 0 or 1.
    Bool,
    /// One byte.
    Uint8,
    /// Four bytes.
    Uint32,
    /// Eight bytes.
    Uint64,
    /// Four bytes, signed.
    Int32,
    /// IEEE 754 double.
    Double,
    /// Three doubles.
    Vector3d,
    /// Six doubles.
    Vector6d,
    /// Six signed 32-bit integers.
    Vector6Int32,
    /// Six unsigned 32-bit integers.
    Vector6Uint32,
}

impl FieldType {
    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bool => "BOOL",
            Self::Uint8 => "UINT8",
            Self::Uint32 => "UINT32",
            Self::Uint64 => "UINT64",
            Self::Int32 => "INT32",
            Self::Double => "DOUBLE",
            Self::Vector3d => "VECTOR3D",
            Self::Vector6d => "VECTOR6D",
            Self::Vector6Int32 => "VECTOR6INT32",
            Self::Vector6Uint32 => "VECTOR6UINT32",
        }
    }

    /// Type from its name on the wire.
    pub fn parse(name: &str) -> Option<Self> {
        [
            Self::Bool,
            Self::Uint8,
            Self::Uint32,
            Self::Uint64,
            Self::Int32,
            Self::Double,
            Self::Vector3d,
            Self::Vector6d,
            Self::Vector6Int32,
            Self::Vector6Uint32,
        ]
        .into_iter()
        .find(|t| t.name() == name)
    }

    /// Bytes on the wire.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Uint8 => 1,
            Self::Uint32 | Self::Int32 => 4,
            Self::Uint64 | Self::Double => 8,
            Self::Vector3d | Self::Vector6Int32 | Self::Vector6Uint32 => 24,
            Self::Vector6d => 48,
        }
    }
}

/// A value of an RTDE field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// `BOOL`
    Bool(bool),
    /// `UINT8`
    Uint8(u8),
    /// `UINT32`
    Uint32(u32),
    /// `UINT64`
    Uint64(u64),
    /// `INT32`
    Int32(i32),
    /// `DOUBLE`
    Double(f64),
    /// `VECTOR3D`
    Vector3d([f64; 3]),
    /// `VECTOR6D`
    Vector6d([f64; 6]),
    /// `VECTOR6INT32`
    Vector6Int32([i32; 6]),
    /// `VECTOR6UINT32`
    Vector6Uint32([u32; 6]),
}

macro_rules! accessor {
    ($(#[$doc:meta])* $name:ident, $variant:ident, $type:ty) => {
        $(#[$doc])*
        pub fn $name(&self) -> Option<$type> {
            if let Self::$variant(v) = self { Some(*v) } else { None }
        }
    };
}

impl Value {
    /// The type of this value.
    pub fn field_type(&self) -> FieldType {
        match self {
            Self::Bool(_) => FieldType::Bool,
            Self::Uint8(_) => FieldType::Uint8,
            Self::Uint32(_) => FieldType::Uint32,
            Self::Uint64(_) => FieldType::Uint64,
            Self::Int32(_) => FieldType::Int32,
            Self::Double(_) => FieldType::Double,
            Self::Vector3d(_) => FieldType::Vector3d,
            Self::Vector6d(_) => FieldType::Vector6d,
            Self::Vector6Int32(_) => FieldType::Vector6Int32,
            Self::Vector6Uint32(_) => FieldType::Vector6Uint32,
        }
    }

    /// A zero of the given type.
    pub fn zero(kind: FieldType) -> Self {
        match kind {
            FieldType::Bool => Self::Bool(false),
            FieldType::Uint8 => Self::Uint8(0),
            FieldType::Uint32 => Self::Uint32(0),
            FieldType::Uint64 => Self::Uint64(0),
            FieldType::Int32 => Self::Int32(0),
            FieldType::Double => Self::Double(0.0),
            FieldType::Vector3d => Self::Vector3d([0.0; 3]),
            FieldType::Vector6d => Self::Vector6d([0.0; 6]),
            FieldType::Vector6Int32 => Self::Vector6Int32([0; 6]),
            FieldType::Vector6Uint32 => Self::Vector6Uint32([0; 6]),
        }
    }

    accessor!(/// The value of a `BOOL`.
        as_bool, Bool, bool);
    accessor!(/// The value of a `UINT32`.
        as_u32, Uint32, u32);
    accessor!(/// The value of a `UINT8`.
        as_u8, Uint8, u8);
    accessor!(/// The value of a `UINT64`.
        as_u64, Uint64, u64);
    accessor!(/// The value of a `VECTOR3D`.
        as_vector3d, Vector3d, [f64; 3]);
    accessor!(/// The value of an `INT32`.
        as_i32, Int32, i32);
    accessor!(/// The value of a `DOUBLE`.
        as_f64, Double, f64);
    accessor!(/// The value of a `VECTOR6D`.
        as_vector6d, Vector6d, [f64; 6]);

    fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::Bool(v) => out.push(u8::from(*v)),
            Self::Uint8(v) => out.push(*v),
            Self::Uint32(v) => out.extend_from_slice(&v.to_be_bytes()),
            Self::Uint64(v) => out.extend_from_slice(&v.to_be_bytes()),
            Self::Int32(v) => out.extend_from_slice(&v.to_be_bytes()),
            Self::Double(v) => out.extend_from_slice(&v.to_be_bytes()),
            Self::Vector3d(v) => v.iter().for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
            Self::Vector6d(v) => v.iter().for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
            Self::Vector6Int32(v) => v.iter().for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
            Self::Vector6Uint32(v) => {
                v.iter().for_each(|x| out.extend_from_slice(&x.to_be_bytes()));
            }
        }
    }

    /// `bytes` has exactly `kind.size()` bytes.
    fn read(kind: FieldType, bytes: &[u8]) -> Self {
        fn four(b: &[u8], i: usize) -> [u8; 4] {
            [b[4 * i], b[4 * i + 1], b[4 * i + 2], b[4 * i + 3]]
        }
        fn eight(b: &[u8], i: usize) -> [u8; 8] {
            std::array::from_fn(|k| b[8 * i + k])
        }
        match kind {
            FieldType::Bool => Self::Bool(bytes[0] != 0),
            FieldType::Uint8 => Self::Uint8(bytes[0]),
            FieldType::Uint32 => Self::Uint32(u32::from_be_bytes(four(bytes, 0))),
            FieldType::Uint64 => Self::Uint64(u64::from_be_bytes(eight(bytes, 0))),
            FieldType::Int32 => Self::Int32(i32::from_be_bytes(four(bytes, 0))),
            FieldType::Double => Self::Double(f64::from_be_bytes(eight(bytes, 0))),
            FieldType::Vector3d => {
                Self::Vector3d(std::array::from_fn(|i| f64::from_be_bytes(eight(bytes, i))))
            }
            FieldType::Vector6d => {
                Self::Vector6d(std::array::from_fn(|i| f64::from_be_bytes(eight(bytes, i))))
            }
            FieldType::Vector6Int32 => {
                Self::Vector6Int32(std::array::from_fn(|i| i32::from_be_bytes(four(bytes, i))))
            }
            FieldType::Vector6Uint32 => {
                Self::Vector6Uint32(std::array::from_fn(|i| u32::from_be_bytes(four(bytes, i))))
            }
        }
    }
}

/// The fields of a data package, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// Identifier given by the controller, 1 to 255.
    pub id: u8,
    /// Names and types.
    pub fields: Vec<(String, FieldType)>,
}

impl Recipe {
    /// A recipe from the names that were asked for and the answered type list.
    ///
    /// # Errors
    /// [`ProtocolError::Field`] for `NOT_FOUND`, `IN_USE`, an unknown type, or a list of another length.
    pub fn from_answer(id: u8, names: &[&str], types: &str) -> Result<Self, ProtocolError> {
        let types: Vec<&str> = types.split(',').map(str::trim).filter(|t| !t.is_empty()).collect();
        if types.len() != names.len() {
            return Err(ProtocolError::ValueCount { have: types.len(), need: names.len() });
        }
        let mut fields = Vec::with_capacity(names.len());
        for (name, kind) in names.iter().zip(types) {
            let reason = match kind {
                "NOT_FOUND" => "this controller does not have it (PolyScope too old?)",
                "IN_USE" => "another client (a fieldbus, a second driver) owns it",
                _ => "unknown type in the answer",
            };
            let kind = FieldType::parse(kind).ok_or_else(|| ProtocolError::Field {
                field: (*name).to_owned(),
                reason: reason.to_owned(),
            })?;
            fields.push(((*name).to_owned(), kind));
        }
        Ok(Self { id, fields })
    }

    /// Bytes of all fields together.
    pub fn size(&self) -> usize {
        self.fields.iter().map(|f| f.1.size()).sum()
    }

    /// Position of a field.
    pub fn index_of(&self, name: &str) -> Option<usize> {
        self.fields.iter().position(|f| f.0 == name)
    }

    /// Payload of a `U` package: recipe id and values.
    ///
    /// # Errors
    /// [`ProtocolError::ValueCount`], [`ProtocolError::Field`] for a value of another type.
    pub fn encode(&self, values: &[Value]) -> Result<Vec<u8>, ProtocolError> {
        if values.len() != self.fields.len() {
            return Err(ProtocolError::ValueCount { have: values.len(), need: self.fields.len() });
        }
        let mut out = Vec::with_capacity(self.size() + 1);
        out.push(self.id);
        for (value, (name, kind)) in values.iter().zip(&self.fields) {
            if value.field_type() != *kind {
                return Err(ProtocolError::Field {
                    field: name.clone(),
                    reason: format!("is {}, got a {}", kind.name(), value.field_type().name()),
                });
            }
            value.write(&mut out);
        }
        Ok(out)
    }

    /// Values of a `U` package's payload (recipe id first).
    ///
    /// # Errors
    /// [`ProtocolError::Recipe`] for another id, [`ProtocolError::Truncated`].
    pub fn decode(&self, payload: &[u8]) -> Result<Vec<Value>, ProtocolError> {
        let need = self.size() + 1;
        if payload.len() < need {
            return Err(ProtocolError::Truncated { kind: "data", have: payload.len(), need });
        }
        if payload[0] != self.id {
            return Err(ProtocolError::Recipe(payload[0]));
        }
        let mut at = 1;
        Ok(self
            .fields
            .iter()
            .map(|(_, kind)| {
                let value = Value::read(*kind, &payload[at..at + kind.size()]);
                at += kind.size();
                value
            })
            .collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_round_trips() {
        let values = [
            Value::Bool(true),
            Value::Uint8(200),
            Value::Uint32(u32::MAX),
            Value::Uint64(1 << 60),
            Value::Int32(-7),
            Value::Double(-0.1),
            Value::Vector3d([1.0, -2.0, 3.5]),
            Value::Vector6d([0.1, 0.2, 0.3, 0.4, 0.5, -0.6]),
            Value::Vector6Int32([1, -2, 3, -4, 5, -6]),
            Value::Vector6Uint32([1, 2, 3, 4, 5, 6]),
        ];
        let fields = values.iter().map(|v| ("x".to_owned(), v.field_type())).collect();
        let recipe = Recipe { id: 3, fields };
        let bytes = recipe.encode(&values).unwrap();
        assert_eq!(bytes.len(), recipe.size() + 1);
        assert_eq!(recipe.decode(&bytes).unwrap(), values);
        assert!(matches!(
            recipe.decode(&bytes[..bytes.len() - 1]),
            Err(ProtocolError::Truncated { .. })
        ));
        for v in values {
            assert_eq!(FieldType::parse(v.field_type().name()), Some(v.field_type()));
        }
    }

    #[test]
    fn wire_order_is_big_endian() {
        let recipe = Recipe { id: 1, fields: vec![("a".into(), FieldType::Double)] };
        let bytes = recipe.encode(&[Value::Double(1.0)]).unwrap();
        assert_eq!(bytes, [1, 0x3f, 0xf0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn refused_fields_are_named() {
        let e =
            Recipe::from_answer(1, &["actual_q", "nonsense"], "VECTOR6D,NOT_FOUND").unwrap_err();
        assert!(e.to_string().contains("nonsense"));
        assert!(Recipe::from_answer(1, &["actual_q"], "VECTOR6D,INT32").is_err());
    }
}
