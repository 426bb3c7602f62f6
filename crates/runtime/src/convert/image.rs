//! Camera messages.

use super::ConvertError;
use tdv_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage, Image};
use tdv_msgs::std_msgs::msg::Header;
use tdv_rendering::codec::{self, DepthEncoding};
use tdv_rendering::{DepthImage, Intrinsics, Lens, RgbImage};

/// Rows of the message without padding, each of `width * bytes_per_pixel` bytes.
fn rows<'a>(
    topic: &str,
    image: &'a Image,
    bytes_per_pixel: u32,
) -> Result<impl Iterator<Item = &'a [u8]>, ConvertError> {
    let row = u64::from(image.width) * u64::from(bytes_per_pixel);
    let step = u64::from(image.step);
    // The last row may lack its padding.
    let need = match u64::from(image.height) {
        0 => 0,
        // Sizes come from outside: they may be anything.
        height => step.max(row).saturating_mul(height - 1).saturating_add(row),
    };
    if step < row || (image.data.len() as u64) < need || row == 0 || image.height == 0 {
        return Err(ConvertError::Size {
            topic: topic.into(),
            width: image.width,
            height: image.height,
            encoding: image.encoding.clone(),
            step: image.step,
            need: need.max(row),
            have: image.data.len(),
        });
    }
    let (row, step) = (row as usize, step as usize);
    Ok((0..image.height as usize).map(move |y| &image.data[y * step..y * step + row]))
}

fn wrong(topic: &str, encoding: &str, expected: &'static str) -> ConvertError {
    ConvertError::Encoding { topic: topic.into(), encoding: encoding.into(), expected }
}

/// Colour from rgb8, bgr8, rgba8, bgra8 or mono8 (also under their 8UC names, as BGR); row padding is
/// skipped.
///
/// # Errors
/// [`ConvertError::Encoding`], [`ConvertError::Size`].
pub fn color_from_image(topic: &str, image: &Image) -> Result<RgbImage, ConvertError> {
    const EXPECTED: &str = "rgb8, bgr8, rgba8, bgra8 or mono8";
    let (channels, order): (u32, [usize; 3]) = match image.encoding.as_str() {
        "rgb8" => (3, [0, 1, 2]),
        "bgr8" | "8UC3" => (3, [2, 1, 0]),
        "rgba8" => (4, [0, 1, 2]),
        "bgra8" | "8UC4" => (4, [2, 1, 0]),
        "mono8" | "8UC1" => (1, [0, 0, 0]),
        other => return Err(wrong(topic, other, EXPECTED)),
    };
    let rows = rows(topic, image, channels)?; // checks the size before anything is reserved
    let mut out = Vec::with_capacity(image.width as usize * image.height as usize * 3);
    for row in rows {
        if channels == 3 && order == [0, 1, 2] {
            out.extend_from_slice(row);
        } else {
            for pixel in row.chunks_exact(channels as usize) {
                out.extend(order.map(|i| pixel[i]));
            }
        }
    }
    RgbImage::from_raw(image.width, image.height, out)
        .ok_or_else(|| wrong(topic, &image.encoding, EXPECTED))
}

/// Depth in metres from 16UC1 (millimetres, also called mono16) or 32FC1 (metres), either byte order;
/// NaN, infinities and values of zero or below become "no reading".
///
/// # Errors
/// [`ConvertError::Encoding`], [`ConvertError::Size`].
pub fn depth_from_image(topic: &str, image: &Image) -> Result<DepthImage, ConvertError> {
    let big = image.is_bigendian != 0;
    let pixels = (image.width as usize).saturating_mul(image.height as usize);
    let depth = match image.encoding.as_str() {
        "16UC1" | "mono16" => {
            let read = if big { u16::from_be_bytes } else { u16::from_le_bytes };
            let rows = rows(topic, image, 2)?;
            let mut out = Vec::with_capacity(pixels);
            for row in rows {
                out.extend(row.chunks_exact(2).map(|b| read([b[0], b[1]])));
            }
            DepthImage::from_millimetres(image.width, image.height, &out)
        }
        "32FC1" => {
            let read = if big { f32::from_be_bytes } else { f32::from_le_bytes };
            let rows = rows(topic, image, 4)?;
            let mut out = Vec::with_capacity(pixels);
            for row in rows {
                out.extend(row.chunks_exact(4).map(|b| read([b[0], b[1], b[2], b[3]])));
            }
            DepthImage::from_metres(image.width, image.height, out)
        }
        other => return Err(wrong(topic, other, "16UC1 (millimetres) or 32FC1 (metres)")),
    };
    depth.map_err(|source| ConvertError::Depth { topic: topic.into(), source })
}

/// A label image (mono8): one octet a pixel, without padding.
///
/// # Errors
/// [`ConvertError::Encoding`], [`ConvertError::Size`].
pub fn labels_from_image(topic: &str, image: &Image) -> Result<Vec<u8>, ConvertError> {
    if image.encoding != "mono8" && image.encoding != "8UC1" {
        return Err(wrong(topic, &image.encoding, "mono8"));
    }
    Ok(rows(topic, image, 1)?.collect::<Vec<_>>().concat())
}

/// Colour from a JPEG or PNG message.
///
/// # Errors
/// [`ConvertError::Encoding`] for a depth topic, [`ConvertError::Codec`].
pub fn color_from_compressed(
    topic: &str,
    image: &CompressedImage,
) -> Result<RgbImage, ConvertError> {
    if image.format.contains("compressedDepth") {
        return Err(wrong(topic, &image.format, "a colour image (jpeg or png)"));
    }
    // "rgb8; jpeg compressed bgr8" and "jpeg" alike: the pixels inside are colour in JPEG's or PNG's
    // own order, whatever the topic's raw encoding was.
    codec::decode_color(&image.data)
        .map_err(|source| ConvertError::Codec { topic: topic.into(), source })
}

/// Depth from a compressedDepth message (16UC1 or 32FC1 as PNG).
///
/// # Errors
/// [`ConvertError::Encoding`] for another format, [`ConvertError::Codec`].
pub fn depth_from_compressed(
    topic: &str,
    image: &CompressedImage,
) -> Result<DepthImage, ConvertError> {
    const EXPECTED: &str = "\"16UC1; compressedDepth png\" or \"32FC1; compressedDepth png\"";
    let encoding = DepthEncoding::from_format(&image.format)
        .filter(|_| image.format.contains("compressedDepth"))
        .ok_or_else(|| wrong(topic, &image.format, EXPECTED))?;
    codec::decode_compressed_depth_as(&image.data, encoding)
        .map_err(|source| ConvertError::Codec { topic: topic.into(), source })
}

/// An rgb8 message.
pub fn image_from_color(image: &RgbImage, header: Header) -> Image {
    let (width, height) = image.dimensions();
    Image {
        header,
        height,
        width,
        encoding: "rgb8".into(),
        is_bigendian: 0,
        step: width * 3,
        data: image.as_raw().clone(),
    }
}

/// A 16UC1 message (millimetres, little endian).
pub fn image_from_depth(depth: &DepthImage, header: Header) -> Image {
    let data = depth.to_millimetres().into_iter().flat_map(u16::to_le_bytes).collect();
    Image {
        header,
        height: depth.height,
        width: depth.width,
        encoding: "16UC1".into(),
        is_bigendian: 0,
        step: depth.width * 2,
        data,
    }
}

/// A 32FC1 message (metres, 0 where nothing was measured, little endian).
pub fn image_from_depth_in_metres(depth: &DepthImage, header: Header) -> Image {
    Image {
        header,
        height: depth.height,
        width: depth.width,
        encoding: "32FC1".into(),
        is_bigendian: 0,
        step: depth.width * 4,
        data: depth.data.iter().flat_map(|z| z.to_le_bytes()).collect(),
    }
}

/// A mono8 message from one octet a pixel.
pub fn image_from_labels(width: u32, height: u32, labels: &[u8], header: Header) -> Image {
    Image {
        header,
        height,
        width,
        encoding: "mono8".into(),
        is_bigendian: 0,
        step: width,
        data: labels.to_vec(),
    }
}

/// A JPEG message as image_transport names it; `quality` 1 to 100.
pub fn compressed_from_color(image: &RgbImage, header: Header, quality: u8) -> CompressedImage {
    CompressedImage {
        header,
        format: "rgb8; jpeg compressed bgr8".into(),
        data: codec::encode_jpeg(image, quality),
    }
}

/// A compressedDepth message (16-bit PNG, millimetres).
pub fn compressed_from_depth(depth: &DepthImage, header: Header) -> CompressedImage {
    CompressedImage {
        header,
        format: "16UC1; compressedDepth png".into(),
        data: codec::encode_compressed_depth(depth),
    }
}

/// A calibration message without distortion.
pub fn info_from_intrinsics(camera: &Intrinsics, header: Header) -> CameraInfo {
    let Intrinsics { width, height, fx, fy, cx, cy } = *camera;
    CameraInfo {
        header,
        height,
        width,
        distortion_model: "plumb_bob".into(),
        d: vec![0.0; 5],
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..Default::default()
    }
}

/// The pinhole camera of a calibration message. Distortion is not applied: see [`has_distortion`].
///
/// # Errors
/// [`ConvertError::Camera`] for an empty, skewed or impossible matrix.
pub fn intrinsics_from_info(topic: &str, info: &CameraInfo) -> Result<Intrinsics, ConvertError> {
    let [fx, skew, cx, _, fy, cy, ..] = info.k;
    let bad = |reason: String| ConvertError::Camera { topic: topic.into(), reason };
    if info.k.iter().any(|v| !v.is_finite()) {
        return Err(bad(format!("not finite: {:?}", info.k)));
    }
    if fx <= 0.0 || fy <= 0.0 {
        return Err(bad(format!("focal lengths {fx} and {fy}: is the camera calibrated?")));
    }
    if skew != 0.0 {
        return Err(bad(format!("skew {skew} is not supported")));
    }
    let (width, height) = (info.width, info.height);
    if width == 0 || height == 0 {
        return Err(bad(format!("image size {width}x{height}")));
    }
    if cx < 0.0 || cy < 0.0 || cx >= f64::from(width) || cy >= f64::from(height) {
        return Err(bad(format!("principal point {cx}, {cy} outside of {width}x{height}")));
    }
    Ok(Intrinsics { width, height, fx, fy, cx, cy })
}

/// What the camera's lens does to raw images: `distortion_model` and `d`.
///
/// # Errors
/// [`ConvertError::Camera`] for a model or coefficients that cannot be used.
pub fn lens_from_info(topic: &str, info: &CameraInfo) -> Result<Lens, ConvertError> {
    Lens::from_coefficients(&info.distortion_model, &info.d)
        .map_err(|e| ConvertError::Camera { topic: topic.into(), reason: e.to_string() })
}

/// True when the calibration has lens distortion that a pinhole camera leaves out.
pub fn has_distortion(info: &CameraInfo) -> bool {
    info.d.iter().any(|d| d.abs() > 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(encoding: &str, width: u32, height: u32, step: u32, data: &[u8]) -> Image {
        Image {
            width,
            height,
            step,
            encoding: encoding.into(),
            data: data.to_vec(),
            ..Default::default()
        }
    }

    fn pixels(image: &RgbImage) -> Vec<[u8; 3]> {
        image.pixels().map(|p| p.0).collect()
    }

    #[test]
    fn colour_encodings_and_padding() {
        for (encoding, data) in [
            ("rgb8", vec![1, 2, 3, 4, 5, 6, 99, 7, 8, 9, 10, 11, 12, 99]),
            ("bgr8", vec![3, 2, 1, 6, 5, 4, 99, 9, 8, 7, 12, 11, 10]),
        ] {
            let image = color_from_image("t", &message(encoding, 2, 2, 7, &data)).expect(encoding);
            assert_eq!(pixels(&image), [[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]]);
        }
        let rgba = color_from_image("t", &message("rgba8", 1, 1, 4, &[1, 2, 3, 4])).expect("rgba");
        let bgra = color_from_image("t", &message("bgra8", 1, 1, 4, &[3, 2, 1, 4])).expect("bgra");
        assert_eq!((pixels(&rgba), pixels(&bgra)), (vec![[1, 2, 3]], vec![[1, 2, 3]]));
        let grey = color_from_image("t", &message("mono8", 1, 2, 1, &[5, 6])).expect("mono8");
        assert_eq!(pixels(&grey), [[5; 3], [6; 3]]);
    }

    #[test]
    fn depth_encodings_and_byte_orders() {
        let little = message("16UC1", 2, 1, 4, &[0xe8, 0x03, 0, 0]);
        assert_eq!(depth_from_image("t", &little).expect("little").data, [1.0, 0.0]);
        let mut big = message("16UC1", 2, 1, 6, &[0x03, 0xe8, 0, 1, 9, 9]);
        big.is_bigendian = 1;
        assert_eq!(depth_from_image("t", &big).expect("big").data, [1.0, 0.001]);
        let mut data = 1.5_f32.to_le_bytes().to_vec();
        data.extend(f32::NAN.to_le_bytes());
        data.extend((-1.0_f32).to_le_bytes());
        let float = message("32FC1", 3, 1, 12, &data);
        assert_eq!(depth_from_image("t", &float).expect("float").data, [1.5, 0.0, 0.0]);
    }

    #[test]
    fn errors_name_topic_and_encoding() {
        let text = |e: ConvertError| e.to_string();
        let e = color_from_image("/cam", &message("yuv422", 1, 1, 2, &[0, 0])).expect_err("yuv");
        assert!(text(e).starts_with("/cam: encoding \"yuv422\""));
        let e = depth_from_image("/cam", &message("rgb8", 1, 1, 3, &[0; 3])).expect_err("rgb");
        assert!(text(e).contains("16UC1"));
        for (width, height, step, length) in [
            (2, 2, 6, 11),
            (2, 2, 5, 100),
            (0, 2, 0, 0),
            (2, 0, 6, 0),
            (u32::MAX, u32::MAX, u32::MAX, 9),
        ] {
            let bad = message("rgb8", width, height, step, &vec![0; length]);
            let e = color_from_image("/cam", &bad).expect_err("size");
            assert!(text(e).contains(&format!("got {length}")), "{width} {height}");
        }
        let e = color_from_compressed(
            "/c",
            &CompressedImage { format: "jpeg".into(), data: vec![1, 2, 3], ..Default::default() },
        );
        assert!(text(e.expect_err("rubbish")).starts_with("/c: "));
        let e = depth_from_compressed(
            "/c",
            &CompressedImage { format: "jpeg".into(), data: vec![], ..Default::default() },
        );
        assert!(text(e.expect_err("jpeg")).contains("compressedDepth"));
    }

    #[test]
    fn round_trips() {
        let color = RgbImage::from_fn(4, 3, |x, y| image_pixel(x, y));
        let back = color_from_image("t", &image_from_color(&color, Header::default()));
        assert_eq!(back.expect("raw"), color);
        let depth = DepthImage::from_millimetres(3, 1, &[0, 500, 65535]).expect("size");
        let back = depth_from_image("t", &image_from_depth(&depth, Header::default()));
        assert_eq!(back.expect("raw"), depth);
        let metres = image_from_depth_in_metres(&depth, Header::default());
        assert_eq!(depth_from_image("t", &metres).expect("metres"), depth);
        let back = depth_from_compressed("t", &compressed_from_depth(&depth, Header::default()));
        assert_eq!(back.expect("png"), depth);
        let flat = RgbImage::from_pixel(16, 16, image_pixel(3, 2));
        let jpeg = compressed_from_color(&flat, Header::default(), 95);
        let back = color_from_compressed("t", &jpeg).expect("jpeg");
        assert!(back.as_raw().iter().zip(flat.as_raw()).all(|(a, b)| a.abs_diff(*b) <= 3));
        let labels = image_from_labels(2, 1, &[0, 7], Header::default());
        assert_eq!(labels_from_image("t", &labels).expect("mono8"), [0, 7]);
    }

    fn image_pixel<P: From<[u8; 3]>>(x: u32, y: u32) -> P {
        P::from([x as u8 * 40, y as u8 * 60, 90])
    }

    #[test]
    fn camera_info_round_trip_and_refusals() {
        let camera =
            Intrinsics { width: 640, height: 480, fx: 610.0, fy: 611.0, cx: 319.5, cy: 239.5 };
        let info = info_from_intrinsics(&camera, Header::default());
        assert!(!has_distortion(&info));
        assert_eq!(intrinsics_from_info("t", &info).expect("valid"), camera);
        let edits: [fn(&mut CameraInfo); 5] = [
            |i| i.k = [0.0; 9],
            |i| i.k[0] = f64::NAN,
            |i| i.k[1] = 0.5,
            |i| i.width = 0,
            |i| i.k[2] = 700.0,
        ];
        for edit in edits {
            let mut bad = info.clone();
            edit(&mut bad);
            let text = intrinsics_from_info("/info", &bad).expect_err("bad").to_string();
            assert!(text.starts_with("/info: "), "{text}");
        }
        let mut lens = info;
        lens.d[0] = 0.1;
        assert!(has_distortion(&lens));
        assert!(matches!(lens_from_info("t", &lens), Ok(Lens::Brown { .. })));
        lens.distortion_model = "mirror".into();
        let text = lens_from_info("/info", &lens).expect_err("model").to_string();
        assert!(text.starts_with("/info: ") && text.contains("mirror"), "{text}");
    }
}
