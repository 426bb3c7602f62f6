//! The content of a `.tflite` file: tensors, constants, operators. Field numbers are those of the
//! TFLite schema, version 3.

use super::error::Flaw;
use super::flatbuffer::{Buffer, Table};

/// More elements than any tensor of the networks in question has; guards the allocations.
const MAX_ELEMENTS: usize = 1 << 26;

/// Element types that occur; everything else is refused where it is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Element {
    F32,
    F16,
    I32,
    Other(u8),
}

/// One tensor: a constant when `data` is not empty, an activation otherwise.
pub(super) struct Tensor<'a> {
    pub name: String,
    pub shape: Vec<usize>,
    pub element: Element,
    pub data: &'a [u8],
}

impl Tensor<'_> {
    pub(super) fn elements(&self) -> usize {
        self.shape.iter().product()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Add,
    Concatenation,
    Conv2d,
    DepthwiseConv2d,
    Dequantize,
    FullyConnected,
    Logistic,
    MaxPool2d,
    Pad,
    Reshape,
    ResizeBilinear,
    Mean,
    Prelu,
}

/// One operator with its tensors' numbers (an absent optional input is dropped) and its options.
pub(super) struct Operator<'a> {
    pub kind: Kind,
    pub inputs: Vec<usize>,
    pub outputs: Vec<usize>,
    pub options: Option<Table<'a>>,
}

pub(super) struct Model<'a> {
    pub tensors: Vec<Tensor<'a>>,
    pub operators: Vec<Operator<'a>>,
    pub inputs: Vec<usize>,
    pub outputs: Vec<usize>,
}

fn kind(code: i32, custom: &str) -> Result<Kind, Flaw> {
    Ok(match code {
        0 => Kind::Add,
        2 => Kind::Concatenation,
        3 => Kind::Conv2d,
        4 => Kind::DepthwiseConv2d,
        6 => Kind::Dequantize,
        9 => Kind::FullyConnected,
        14 => Kind::Logistic,
        17 => Kind::MaxPool2d,
        22 => Kind::Reshape,
        23 => Kind::ResizeBilinear,
        34 => Kind::Pad,
        40 => Kind::Mean,
        54 => Kind::Prelu,
        32 => return Err(Flaw::Operator(format!("CUSTOM \"{custom}\""))),
        _ => return Err(Flaw::Operator(operator_name(code))),
    })
}

/// Schema names of the operators that convolutional networks commonly hold, for the error message.
fn operator_name(code: i32) -> String {
    let name = match code {
        1 => "AVERAGE_POOL_2D",
        5 => "DEPTH_TO_SPACE",
        18 => "MUL",
        19 => "RELU",
        21 => "RELU6",
        25 => "SOFTMAX",
        28 => "TANH",
        36 => "GATHER",
        39 => "TRANSPOSE",
        41 => "SUB",
        42 => "DIV",
        43 => "SQUEEZE",
        45 => "STRIDED_SLICE",
        49 => "SPLIT",
        67 => "TRANSPOSE_CONV",
        97 => "RESIZE_NEAREST_NEIGHBOR",
        114 => "QUANTIZE",
        117 => "HARD_SWISH",
        _ => return format!("number {code} of the TFLite schema"),
    };
    name.to_owned()
}

fn tensor<'a>(table: Table<'a>, buffers: &[Table<'a>]) -> Result<Tensor<'a>, Flaw> {
    let name = table.text(3)?;
    let mut elements = 1usize;
    let mut shape = Vec::new();
    for size in table.ints(0)? {
        let size = usize::try_from(size)
            .map_err(|_| Flaw::malformed(format!("tensor {name:?} has a negative size")))?;
        elements = elements
            .checked_mul(size)
            .filter(|elements| *elements <= MAX_ELEMENTS)
            .ok_or_else(|| Flaw::malformed(format!("tensor {name:?} is absurdly large")))?;
        shape.push(size);
    }
    let element = match table.byte(1, 0)? {
        0 => Element::F32,
        1 => Element::F16,
        2 => Element::I32,
        other => Element::Other(other),
    };
    let buffer = buffers
        .get(table.index(2)?)
        .ok_or_else(|| Flaw::malformed(format!("tensor {name:?} has no buffer")))?;
    let data = buffer.bytes(0)?;
    let width = match element {
        Element::F32 | Element::I32 => 4,
        Element::F16 => 2,
        // Refused as soon as an operator reads it.
        Element::Other(_) => return Ok(Tensor { name, shape, element, data }),
    };
    if !data.is_empty() && data.len() != elements * width {
        let length = data.len();
        return Err(Flaw::malformed(format!(
            "tensor {name:?} of shape {shape:?} holds {length} bytes"
        )));
    }
    Ok(Tensor { name, shape, element, data })
}

fn indices(list: &[i32], tensors: usize) -> Result<Vec<usize>, Flaw> {
    list.iter()
        .filter(|index| **index != -1)
        .map(|index| {
            usize::try_from(*index)
                .ok()
                .filter(|index| *index < tensors)
                .ok_or_else(|| Flaw::malformed(format!("there is no tensor {index}")))
        })
        .collect()
}

impl<'a> Model<'a> {
    /// Reads a whole file.
    ///
    /// # Errors
    /// A [`Flaw`] for a damaged file, more than one subgraph, or an unknown operator.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, Flaw> {
        let root = Buffer::new(bytes).root(b"TFL3")?;
        let kinds = root
            .tables(1)?
            .into_iter()
            .map(|code| {
                // Old files keep the number in the first field, newer ones in the last.
                let number = code.int(3, 0)?.max(i32::from(code.byte(0, 0)?));
                kind(number, &code.text(1)?)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let buffers = root.tables(4)?;
        let subgraphs = root.tables(2)?;
        let [graph] = subgraphs[..] else {
            let count = subgraphs.len();
            return Err(Flaw::unsupported(format!("a network of {count} subgraphs")));
        };
        let tensors = graph
            .tables(0)?
            .into_iter()
            .map(|table| tensor(table, &buffers))
            .collect::<Result<Vec<_>, _>>()?;
        let operators = graph
            .tables(3)?
            .into_iter()
            .map(|table| {
                Ok(Operator {
                    kind: *kinds
                        .get(table.index(0)?)
                        .ok_or_else(|| Flaw::malformed("an operator has no code"))?,
                    inputs: indices(&table.ints(1)?, tensors.len())?,
                    outputs: indices(&table.ints(2)?, tensors.len())?,
                    options: table.table(4)?,
                })
            })
            .collect::<Result<Vec<_>, Flaw>>()?;
        let inputs = indices(&graph.ints(1)?, tensors.len())?;
        let outputs = indices(&graph.ints(2)?, tensors.len())?;
        Ok(Self { tensors, operators, inputs, outputs })
    }

    /// A constant's values as f32.
    pub(super) fn floats(&self, index: usize) -> Result<Vec<f32>, Flaw> {
        let tensor = &self.tensors[index];
        if tensor.data.is_empty() && tensor.elements() > 0 {
            return Err(Flaw::unsupported(format!(
                "a computed {:?} (not a constant)",
                tensor.name
            )));
        }
        match tensor.element {
            Element::F32 => {
                let (words, _) = tensor.data.as_chunks::<4>();
                Ok(words.iter().map(|word| f32::from_le_bytes(*word)).collect())
            }
            Element::F16 => {
                let (words, _) = tensor.data.as_chunks::<2>();
                Ok(words.iter().map(|word| half_to_f32(u16::from_le_bytes(*word))).collect())
            }
            other => Err(Flaw::unsupported(format!("tensor {:?} of type {other:?}", tensor.name))),
        }
    }

    /// A constant's values as integers.
    pub(super) fn integers(&self, index: usize) -> Result<Vec<i32>, Flaw> {
        let tensor = &self.tensors[index];
        if tensor.element != Element::I32 || (tensor.data.is_empty() && tensor.elements() > 0) {
            return Err(Flaw::unsupported(format!(
                "tensor {:?} in place of constant integers",
                tensor.name
            )));
        }
        let (words, _) = tensor.data.as_chunks::<4>();
        Ok(words.iter().map(|word| i32::from_le_bytes(*word)).collect())
    }
}

/// IEEE 754 binary16 to binary32; exact for every input.
fn half_to_f32(bits: u16) -> f32 {
    let sign = u32::from(bits >> 15) << 31;
    let exponent = u32::from(bits >> 10) & 0x1f;
    let fraction = u32::from(bits) & 0x3ff;
    match exponent {
        0 => {
            // Zero and subnormals: fraction * 2^-24.
            let magnitude = fraction as f32 / 16_777_216.0;
            f32::from_bits(sign | magnitude.to_bits())
        }
        31 => f32::from_bits(sign | 0x7f80_0000 | (fraction << 13)),
        _ => f32::from_bits(sign | ((exponent + 112) << 23) | (fraction << 13)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_is_exact() {
        let cases = [
            (0x0000, 0.0),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 5.960_464_5e-8),
            (0x03ff, 6.097_555e-5),
            (0x3555, 0.333_251_95),
            (0x7c00, f32::INFINITY),
        ];
        for (bits, value) in cases {
            assert_eq!(half_to_f32(bits), value, "{bits:#06x}");
        }
        assert!(half_to_f32(0x8000).is_sign_negative());
        assert!(half_to_f32(0x7e01).is_nan());
    }

    #[test]
    fn garbage_is_refused() {
        for bytes in [&b""[..], b"TFL3", b"\x08\0\0\0TFL3\0\0\0\0", &[0xff; 64]] {
            assert!(Model::parse(bytes).is_err());
        }
    }
}
