use thiserror::Error;

/// What can be wrong with a depth buffer.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum DepthError {
    /// The number of values does not fit the size.
    #[error("depth image of {width}x{height} needs {} values, got {have}", width * height)]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Values given.
        have: usize,
    },
}

/// Metric depth along the optical axis, row-major, metres; 0.0 = no reading.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DepthImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` values (m).
    pub data: Vec<f32>,
}

impl DepthImage {
    /// An image without readings.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, data: vec![0.0; width as usize * height as usize] }
    }

    /// From metres; NaN, infinities and values of zero or below become "no reading".
    ///
    /// # Errors
    /// [`DepthError::Size`].
    pub fn from_metres(width: u32, height: u32, mut data: Vec<f32>) -> Result<Self, DepthError> {
        if data.len() != width as usize * height as usize {
            return Err(DepthError::Size { width, height, have: data.len() });
        }
        for z in &mut data {
            if !(z.is_finite() && *z > 0.0) {
                *z = 0.0;
            }
        }
        Ok(Self { width, height, data })
    }

    /// From the sensor's 16-bit millimetres (0 = no reading).
    ///
    /// # Errors
    /// [`DepthError::Size`].
    pub fn from_millimetres(width: u32, height: u32, data: &[u16]) -> Result<Self, DepthError> {
        if data.len() != width as usize * height as usize {
            return Err(DepthError::Size { width, height, have: data.len() });
        }
        // Division, not a product with 0.001: the nearest f32 to the decimal value, so that
        // `to_millimetres` gives back the same number.
        Ok(Self { width, height, data: data.iter().map(|&mm| f32::from(mm) / 1000.0).collect() })
    }

    /// 16-bit millimetres, rounded; beyond 65.535 m there is no reading.
    pub fn to_millimetres(&self) -> Vec<u16> {
        self.data
            .iter()
            .map(|&z| {
                // Casting truncates, saturates and makes zero of NaN; `round` is a library call on the
                // baseline processor.
                let mm = (z * 1000.0 + 0.5) as u32;
                if mm <= u32::from(u16::MAX) { mm as u16 } else { 0 }
            })
            .collect()
    }

    /// The reading at a pixel; `None` outside the image or without a reading.
    pub fn get(&self, x: i32, y: i32) -> Option<f32> {
        if x < 0 || y < 0 || x >= self.width as i32 || y >= self.height as i32 {
            return None;
        }
        let z = *self.data.get(y as usize * self.width as usize + x as usize)?;
        (z > 0.0).then_some(z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_millimetre_survives_the_round_trip() {
        let all: Vec<u16> = (0..=u16::MAX).collect();
        let image = DepthImage::from_millimetres(256, 256, &all).unwrap();
        assert_eq!(image.to_millimetres(), all);
    }

    #[test]
    fn bad_readings_become_none_and_bad_sizes_are_refused() {
        let bad = vec![f32::NAN, f32::INFINITY, -1.0, 0.5];
        let image = DepthImage::from_metres(2, 2, bad).unwrap();
        assert_eq!(image.data, [0.0, 0.0, 0.0, 0.5]);
        assert_eq!(image.get(1, 1), Some(0.5));
        assert_eq!(image.get(0, 0), None);
        assert_eq!(image.get(2, 0), None);
        let far = DepthImage { width: 2, height: 1, data: vec![70.0, f32::NAN] };
        assert_eq!(far.to_millimetres(), [0, 0]);
        assert!(DepthImage::from_millimetres(2, 2, &[1, 2, 3]).is_err());
    }
}
