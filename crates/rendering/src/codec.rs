//! Image encodings of the camera topics and bags: JPEG and PNG colour, and the
//! `compressedDepth` form of image_transport (a 12-byte header, then a 16-bit PNG).
//!
//! The header is three little-endian fields: `i32 format`, `f32 a`, `f32 b`. For a 16UC1 topic the
//! PNG holds millimetres and the header's numbers mean nothing. For a 32FC1 topic it holds
//! quantised inverse depth: metres = a / (value - b), 0 = no reading.

use crate::{DepthError, DepthImage, RgbImage};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat};
use thiserror::Error;

const HEADER: usize = 12;
const PNG_MAGIC: [u8; 4] = [0x89, b'P', b'N', b'G'];

/// Why bytes could not be turned into an image, or an image into bytes.
#[derive(Debug, Error)]
pub enum CodecError {
    /// The payload is no PNG or JPEG image, or a damaged one.
    #[error("cannot decode the image ({bytes} bytes): {reason}")]
    Decode {
        /// Size of the payload.
        bytes: usize,
        /// What the decoder said.
        reason: String,
    },
    /// Too short for the compressedDepth header.
    #[error("compressed depth of {bytes} bytes is shorter than its 12-byte header")]
    Truncated {
        /// Size of the payload.
        bytes: usize,
    },
    /// After the header comes no PNG: the `rvl` form, or a colour topic.
    #[error(
        "no PNG behind the compressedDepth header (first bytes {found:02x?}); \
         set the publisher's compressed depth format to png"
    )]
    NotPng {
        /// The first bytes after the header.
        found: Vec<u8>,
    },
    /// A PNG of another pixel form.
    #[error("compressed depth holds {have} pixels, expected 16-bit grey")]
    PixelForm {
        /// What the PNG holds.
        have: String,
    },
    /// The quantisation parameters of a 32FC1 image make no sense.
    #[error("compressed depth has quantisation parameters {a} and {b}, expected a > 0, finite")]
    Quantisation {
        /// First parameter.
        a: f32,
        /// Second parameter.
        b: f32,
    },
    /// The encoder refused.
    #[error("cannot encode the image: {0}")]
    Encode(String),
    /// A depth buffer of the wrong size.
    #[error(transparent)]
    Depth(#[from] DepthError),
}

/// The pixel form of the topic that a compressed depth image stands for (the part of the message's
/// `format` field before the semicolon).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthEncoding {
    /// 16UC1, millimetres.
    Millimetres,
    /// 32FC1, quantised inverse depth.
    InverseMetres,
}

impl DepthEncoding {
    /// From a CompressedImage's `format` ("16UC1; compressedDepth png"); `None` for other encodings.
    pub fn from_format(format: &str) -> Option<Self> {
        match format.split(';').next().unwrap_or("").trim() {
            "16UC1" | "mono16" => Some(Self::Millimetres),
            "32FC1" => Some(Self::InverseMetres),
            _ => None,
        }
    }
}

/// JPEG bytes; `quality` 1 to 100. An empty image gives no bytes.
pub fn encode_jpeg(image: &RgbImage, quality: u8) -> Vec<u8> {
    let mut out = Vec::with_capacity(image.as_raw().len() / 8);
    let encoder = JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100));
    let (w, h) = image.dimensions();
    // The only failures are a zero or over-65535 side: no such image leaves a camera.
    if encoder.write_image(image.as_raw(), w, h, ExtendedColorType::Rgb8).is_err() {
        out.clear();
    }
    out
}

/// PNG bytes of a colour image.
///
/// # Errors
/// [`CodecError::Encode`] for an empty image.
pub fn encode_png(image: &RgbImage) -> Result<Vec<u8>, CodecError> {
    let (w, h) = image.dimensions();
    png(image.as_raw(), w, h, ExtendedColorType::Rgb8)
}

/// A colour image from JPEG or PNG bytes, whichever they are.
///
/// # Errors
/// [`CodecError::Decode`].
pub fn decode_color(bytes: &[u8]) -> Result<RgbImage, CodecError> {
    let decoded = image::load_from_memory(bytes)
        .map_err(|e| CodecError::Decode { bytes: bytes.len(), reason: e.to_string() })?;
    Ok(decoded.into_rgb8())
}

/// compressedDepth bytes of the 16UC1 form (whole millimetres).
pub fn encode_compressed_depth(depth: &DepthImage) -> Vec<u8> {
    let mut out = Vec::with_capacity(depth.data.len());
    // Format 1 is the transport's "inverse depth"; it writes that for 16-bit images as well.
    out.extend(1_i32.to_le_bytes());
    out.extend([0; 8]);
    let bytes: Vec<u8> = depth.to_millimetres().iter().flat_map(|v| v.to_ne_bytes()).collect();
    match png(&bytes, depth.width, depth.height, ExtendedColorType::L16) {
        Ok(image) => out.extend(image),
        // Only an empty image fails.
        Err(_) => out.clear(),
    }
    out
}

/// Depth from compressedDepth bytes, the form read from the header: quantised inverse depth if its
/// two parameters are such as the 32FC1 encoder writes, millimetres otherwise. Where the message's
/// `format` is at hand, [`decode_compressed_depth_as`] leaves nothing to guess.
///
/// # Errors
/// As [`decode_compressed_depth_as`].
pub fn decode_compressed_depth(bytes: &[u8]) -> Result<DepthImage, CodecError> {
    let (a, b) = header(bytes)?;
    // The encoder writes a = q (q + 1) and b = 1 - a / max_depth.
    let max_depth = a / (1.0 - b);
    let quantised = a.is_finite() && a > 0.0 && b < 1.0 && (0.1..1000.0).contains(&max_depth);
    let encoding =
        if quantised { DepthEncoding::InverseMetres } else { DepthEncoding::Millimetres };
    decode_compressed_depth_as(bytes, encoding)
}

/// Depth from compressedDepth bytes of a known form.
///
/// # Errors
/// All of [`CodecError`] but `Encode`.
pub fn decode_compressed_depth_as(
    bytes: &[u8],
    encoding: DepthEncoding,
) -> Result<DepthImage, CodecError> {
    let (a, b) = header(bytes)?;
    let payload = &bytes[HEADER..];
    if !payload.starts_with(&PNG_MAGIC) {
        let found = payload[..payload.len().min(4)].to_vec();
        return Err(CodecError::NotPng { found });
    }
    let decoded = image::load_from_memory_with_format(payload, ImageFormat::Png)
        .map_err(|e| CodecError::Decode { bytes: bytes.len(), reason: e.to_string() })?;
    let grey = match decoded {
        DynamicImage::ImageLuma16(grey) => grey,
        other => return Err(CodecError::PixelForm { have: format!("{:?}", other.color()) }),
    };
    let (w, h) = grey.dimensions();
    match encoding {
        DepthEncoding::Millimetres => Ok(DepthImage::from_millimetres(w, h, grey.as_raw())?),
        DepthEncoding::InverseMetres => {
            if !(a.is_finite() && b.is_finite() && a > 0.0) {
                return Err(CodecError::Quantisation { a, b });
            }
            let metres =
                grey.as_raw().iter().map(|&q| if q == 0 { 0.0 } else { a / (f32::from(q) - b) });
            Ok(DepthImage::from_metres(w, h, metres.collect())?)
        }
    }
}

fn header(bytes: &[u8]) -> Result<(f32, f32), CodecError> {
    match bytes {
        [_, _, _, _, a0, a1, a2, a3, b0, b1, b2, b3, ..] => {
            Ok((f32::from_le_bytes([*a0, *a1, *a2, *a3]), f32::from_le_bytes([*b0, *b1, *b2, *b3])))
        }
        _ => Err(CodecError::Truncated { bytes: bytes.len() }),
    }
}

fn png(data: &[u8], w: u32, h: u32, form: ExtendedColorType) -> Result<Vec<u8>, CodecError> {
    if w == 0 || h == 0 {
        return Err(CodecError::Encode(format!("it is {w}x{h} pixels")));
    }
    let mut out = Vec::with_capacity(data.len() / 2);
    PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Sub)
        .write_image(data, w, h, form)
        .map_err(|e| CodecError::Encode(e.to_string()))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> DepthImage {
        let mm: Vec<u16> = (0..64 * 48).map(|i| if i % 7 == 0 { 0 } else { 300 + i }).collect();
        DepthImage::from_millimetres(64, 48, &mm).unwrap()
    }

    #[test]
    fn depth_survives_to_the_millimetre_and_the_header_is_the_transports() {
        let bytes = encode_compressed_depth(&ramp());
        assert_eq!(bytes[..12], [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[12..16], PNG_MAGIC);
        assert_eq!(decode_compressed_depth(&bytes).unwrap(), ramp());
        // Older encoders leave the parameters of a 16UC1 image uninitialised.
        let mut junk = bytes.clone();
        junk[4..12].copy_from_slice(&[0xff; 8]);
        assert_eq!(decode_compressed_depth(&junk).unwrap(), ramp());
    }

    #[test]
    fn the_quantised_float_form_is_decoded() {
        // The transport's defaults: quantisation 100, maximum 10 m.
        let (a, b) = (100.0_f32 * 101.0, 1.0 - 100.0_f32 * 101.0 / 10.0);
        let truth = [0.4_f32, 0.85, 2.0, 9.0];
        let mut q: Vec<u16> = truth.iter().map(|z| (a / z + b) as u16).collect();
        q.extend([0, 0]);
        let data: Vec<u8> = q.iter().flat_map(|v| v.to_ne_bytes()).collect();
        let mut bytes = 1_i32.to_le_bytes().to_vec();
        bytes.extend(a.to_le_bytes());
        bytes.extend(b.to_le_bytes());
        bytes.extend(png(&data, 3, 2, ExtendedColorType::L16).unwrap());
        let depth = decode_compressed_depth(&bytes).unwrap();
        for (have, want) in depth.data.iter().zip(&truth) {
            assert!((have - want).abs() < 1e-3 * want * want * 1.2, "{have} {want}");
        }
        assert_eq!(depth.data[4..], [0.0, 0.0]);
        let format = DepthEncoding::from_format("32FC1; compressedDepth png");
        assert_eq!(format, Some(DepthEncoding::InverseMetres));
        assert_eq!(DepthEncoding::from_format("rgb8; jpeg compressed bgr8"), None);
    }

    #[test]
    fn colour_round_trips() {
        let image = RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8 * 3, y as u8 * 4, 90]));
        assert_eq!(decode_color(&encode_png(&image).unwrap()).unwrap(), image);
        let back = decode_color(&encode_jpeg(&image, 95)).unwrap();
        let off = image.as_raw().iter().zip(back.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(off.unwrap() < 12, "{off:?}");
    }

    #[test]
    fn damaged_input_is_named() {
        let good = encode_compressed_depth(&ramp());
        assert!(matches!(
            decode_compressed_depth(&good[..5]),
            Err(CodecError::Truncated { bytes: 5 })
        ));
        assert!(matches!(
            decode_compressed_depth(&good[..good.len() / 2]),
            Err(CodecError::Decode { .. })
        ));
        assert!(matches!(decode_compressed_depth(&[0; 40]), Err(CodecError::NotPng { .. })));
        let mut colour = vec![0; 12];
        colour.extend(encode_png(&RgbImage::new(4, 4)).unwrap());
        assert!(matches!(decode_compressed_depth(&colour), Err(CodecError::PixelForm { .. })));
        assert!(matches!(decode_color(b"no image"), Err(CodecError::Decode { .. })));
        assert!(matches!(
            decode_compressed_depth_as(&good, DepthEncoding::InverseMetres),
            Err(CodecError::Quantisation { .. })
        ));
        assert!(encode_png(&RgbImage::new(0, 0)).is_err());
        assert!(encode_jpeg(&RgbImage::new(0, 0), 90).is_empty());
    }
}
