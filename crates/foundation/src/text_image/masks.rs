//! SAM2's outputs to masks.

use tdv_perception::backend::PixelBox;
use tdv_perception::segment::Mask;

/// Pixels whose logit exceeds this belong to the object.
const THRESHOLD: f32 = 0.0;

/// The mask of an image of `width` x `height` from logits on a coarser grid of `columns` x `rows` that
/// covers the same view.
pub fn enlarged(logits: &[f32], (columns, rows): (usize, usize), width: u32, height: u32) -> Mask {
    let mut data = vec![false; width as usize * height as usize];
    if columns > 0 && logits.len() >= columns * rows && rows > 0 {
        let (sx, sy) = (columns as f32 / width as f32, rows as f32 / height as f32);
        for y in 0..height {
            let (y0, y1, fy) = between(y, sy, rows);
            for x in 0..width {
                let (x0, x1, fx) = between(x, sx, columns);
                let at = |r: usize, c: usize| logits[r * columns + c];
                let upper = at(y0, x0) * (1.0 - fx) + at(y0, x1) * fx;
                let lower = at(y1, x0) * (1.0 - fx) + at(y1, x1) * fx;
                data[(y * width + x) as usize] = upper * (1.0 - fy) + lower * fy > THRESHOLD;
            }
        }
    }
    Mask { x0: 0, y0: 0, width, height, data }
}

/// The two samples round a pixel of the larger image, and how far it is to the second.
fn between(pixel: u32, scale: f32, count: usize) -> (usize, usize, f32) {
    let at = ((pixel as f32 + 0.5) * scale - 0.5).clamp(0.0, (count - 1) as f32);
    let first = at as usize;
    (first, (first + 1).min(count - 1), at - first as f32)
}

/// The smallest box that holds a mask; `None` for an empty one.
pub fn bounds(mask: &Mask) -> Option<PixelBox> {
    let (mut low, mut high) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
    for (i, _) in mask.data.iter().enumerate().filter(|(_, on)| **on) {
        let (x, y) = (i as i32 % mask.width as i32, i as i32 / mask.width as i32);
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    let at = |v: i32, origin: i32, half: f64| f64::from(v + origin) + half;
    (high.0 >= low.0).then(|| PixelBox {
        left: at(low.0, mask.x0, -0.5),
        top: at(low.1, mask.y0, -0.5),
        right: at(high.0, mask.x0, 0.5),
        bottom: at(high.1, mask.y0, 0.5),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coarse_mask_keeps_its_place_when_enlarged() {
        // The right half of a 4 x 2 grid.
        let logits = [-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0];
        let m = enlarged(&logits, (4, 2), 40, 20);
        assert_eq!(m.data.iter().filter(|on| **on).count(), 20 * 20);
        let b = bounds(&m).unwrap();
        assert_eq!((b.left, b.top, b.right, b.bottom), (19.5, -0.5, 39.5, 19.5));
        let window = Mask { x0: 5, y0: 7, ..m };
        assert_eq!(bounds(&window).unwrap().left, 24.5);
        let none = enlarged(&logits, (0, 0), 40, 20);
        assert!(bounds(&none).is_none() && none.data.len() == 800);
    }
}
