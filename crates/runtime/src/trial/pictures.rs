//! A few small pictures of a run.

use crate::convert;
use crate::record::{RecordError, Recorder};
use crate::tracked;
use std::time::{Duration, Instant};
use tdv_msgs::sensor_msgs::msg::Image;
use tdv_rendering::RgbImage;

/// Time between two pictures.
const PERIOD: Duration = Duration::from_millis(200);
/// Enough for a run of a minute.
const MOST: usize = 320;

/// Where the frames stand in a bag, and their JPEG quality.
const COLOR_TOPIC: &str = "/camera/camera/color/image_raw/compressed";
const QUALITY: u8 = 80;

/// Keeps every few frames at half size.
#[derive(Default)]
pub struct PictureTaker {
    last: Option<Instant>,
    /// The newest kept frame at full size, until it has been recorded.
    full: Option<(tdv_msgs::std_msgs::msg::Header, RgbImage)>,
    pictures: Vec<RgbImage>,
}

impl PictureTaker {
    /// Looks at a frame; keeps it when its time has come.
    pub fn take(&mut self, image: &Image, at: Instant) {
        if self.last.is_some_and(|l| at - l < PERIOD) || self.pictures.len() >= MOST {
            return;
        }
        if let Ok(full) = convert::color_from_image("the camera", image) {
            self.last = Some(at);
            let (w, h) = (full.width() / 2, full.height() / 2);
            self.pictures.push(RgbImage::from_fn(w, h, |x, y| {
                let sum =
                    [(0, 0), (1, 0), (0, 1), (1, 1)].iter().fold([0_u16; 3], |s, (dx, dy)| {
                        let p = full.get_pixel(2 * x + dx, 2 * y + dy).0;
                        std::array::from_fn(|i| s[i] + u16::from(p[i]))
                    });
                tdv_rendering::Rgb(sum.map(|v| (v / 4) as u8))
            }));
            self.full = Some((image.header.clone(), full));
        }
    }

    /// The newest kept frame into a bag, once.
    pub fn hand_over(&mut self, recorder: &mut Recorder) -> Result<(), RecordError> {
        let Some((header, full)) = self.full.take() else { return Ok(()) };
        let stamp = tracked::stamp(&header);
        recorder.write(COLOR_TOPIC, stamp, &convert::compressed_from_color(&full, header, QUALITY))
    }

    /// The pictures in order.
    pub fn into_pictures(self) -> Vec<RgbImage> {
        self.pictures
    }
}
