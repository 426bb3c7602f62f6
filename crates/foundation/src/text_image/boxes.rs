//! GroundingDINO's outputs to boxes.

use super::phrases::Phrases;
use tdv_perception::backend::{Located, PixelBox};

/// Boxes whose best phrase scores more than `threshold`, best first. `logits` is row-major with one row
/// of `columns` numbers for each box (-inf beyond the text), `boxes` holds centre and size as fractions
/// of the image's `width` and `height`. A phrase scores as its best token does.
pub fn located(
    logits: &[f32],
    columns: usize,
    boxes: &[f32],
    phrases: &Phrases,
    (width, height): (u32, u32),
    threshold: f64,
) -> Vec<Located> {
    let (w, h) = (f64::from(width), f64::from(height));
    let mut out: Vec<Located> = Vec::new();
    for (row, b) in logits.chunks_exact(columns.max(1)).zip(boxes.chunks_exact(4)) {
        let best = |span: &std::ops::Range<usize>| {
            let tokens = row.get(span.clone()).unwrap_or_default();
            tokens.iter().copied().filter(|v| !v.is_nan()).fold(f32::NEG_INFINITY, f32::max)
        };
        let scores = phrases.spans.iter().map(best).enumerate();
        let Some((phrase, logit)) = scores.max_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
        let score = 1.0 / (1.0 + (-f64::from(logit)).exp());
        let [cx, cy, bw, bh] = [b[0], b[1], b[2], b[3]].map(f64::from);
        if score.is_nan() || score <= threshold || ![cx, cy, bw, bh].iter().all(|v| v.is_finite()) {
            continue;
        }
        // A fraction of 0 is the left border of the first pixel, whose centre is at 0.
        let x = |f: f64| (f * w - 0.5).clamp(-0.5, w - 0.5);
        let y = |f: f64| (f * h - 0.5).clamp(-0.5, h - 0.5);
        let pixels = PixelBox {
            left: x(cx - 0.5 * bw),
            top: y(cy - 0.5 * bh),
            right: x(cx + 0.5 * bw),
            bottom: y(cy + 0.5 * bh),
        };
        if pixels.area() > 0.0 {
            out.push(Located { phrase, pixels, score });
        }
    }
    out.sort_by(|a, b| b.score.total_cmp(&a.score));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_carry_their_best_phrase() {
        let phrases = Phrases {
            ids: vec![1, 5, 6, 3, 7, 3, 2],
            positions: vec![0; 7],
            sees: vec![true; 49],
            spans: vec![1..3, 4..5],
        };
        let no = f32::NEG_INFINITY;
        let logits = [
            // The full stop's own logit does not count.
            -3.0,
            -2.0,
            1.0,
            9.0,
            0.5,
            0.0,
            0.0,
            no, //
            -3.0,
            -4.0,
            -5.0,
            9.0,
            2.0,
            0.0,
            0.0,
            no, //
            -3.0,
            -4.0,
            -5.0,
            9.0,
            -2.0,
            0.0,
            0.0,
            no, //
            9.0,
            f32::NAN,
            f32::NAN,
            9.0,
            f32::NAN,
            9.0,
            9.0,
            no,
        ];
        let boxes =
            [0.5, 0.5, 0.2, 0.4, 0.1, 0.9, 0.4, 0.4, 0.5, 0.5, 0.1, 0.1, 0.5, 0.5, 0.1, 0.1];
        let found = located(&logits, 8, &boxes, &phrases, (100, 50), 0.25);
        assert_eq!(found.iter().map(|f| f.phrase).collect::<Vec<_>>(), [1, 0]);
        assert!((found[0].score - 0.880_797).abs() < 1e-5);
        assert!((found[1].score - 0.731_058).abs() < 1e-5);
        // Cut at the image's borders.
        let b = found[0].pixels;
        assert_eq!((b.left, b.bottom), (-0.5, 49.5));
        assert!((b.right - 29.5).abs() < 1e-4 && (b.top - 34.5).abs() < 1e-4, "{b:?}");
        assert!(located(&[], 8, &[], &phrases, (100, 50), 0.25).is_empty());
        assert!(located(&logits, 0, &boxes, &phrases, (0, 0), 0.25).is_empty());
    }
}
