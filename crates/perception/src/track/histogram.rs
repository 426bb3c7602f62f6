//! Colour statistics of an object and of what surrounds it.

/// Bins per channel.
const BINS: usize = 16;
const CELLS: usize = BINS * BINS * BINS;

/// Foreground and background histograms and the posterior they give for each colour.
#[derive(Debug, Clone)]
pub(crate) struct Histograms {
    foreground: Vec<f32>,
    background: Vec<f32>,
    /// Probability that a pixel of this colour belongs to the object.
    posterior: Vec<f32>,
    started: bool,
    /// Mean posterior over the object's and over the surroundings' colours.
    expected: (f32, f32),
}

/// Counts of one frame.
#[derive(Debug, Clone)]
pub(crate) struct Counts {
    pub foreground: Vec<f32>,
    pub background: Vec<f32>,
}

impl Counts {
    pub fn new() -> Self {
        Self { foreground: vec![0.0; CELLS], background: vec![0.0; CELLS] }
    }
}

#[inline]
pub(crate) fn cell(c: &[u8]) -> usize {
    (usize::from(c[0] >> 4) << 8) | (usize::from(c[1] >> 4) << 4) | usize::from(c[2] >> 4)
}

impl Histograms {
    pub fn new() -> Self {
        Self {
            foreground: vec![0.0; CELLS],
            background: vec![0.0; CELLS],
            posterior: vec![0.5; CELLS],
            started: false,
            expected: (0.5, 0.5),
        }
    }

    /// Blends new counts in with learning rate `rate` (1 the first time).
    pub fn update(&mut self, counts: &Counts, rate: f32) {
        let rate = if self.started { rate } else { 1.0 };
        let mut blended = true;
        for (h, new) in
            [(&mut self.foreground, &counts.foreground), (&mut self.background, &counts.background)]
        {
            let sum: f32 = new.iter().sum();
            // Too few pixels (occluded all round): what is known is better.
            if sum < 50.0 {
                blended = false;
                continue;
            }
            for (h, n) in h.iter_mut().zip(new) {
                *h = (1.0 - rate) * *h + rate * n / sum;
            }
        }
        self.started |= blended;
        for ((p, f), b) in self.posterior.iter_mut().zip(&self.foreground).zip(&self.background) {
            // The small term keeps a colour seen once from deciding alone.
            *p = (f + 2e-5) / (f + b + 4e-5);
        }
        let mean = |h: &[f32]| h.iter().zip(&self.posterior).map(|(h, p)| h * p).sum::<f32>();
        self.expected = (mean(&self.foreground), mean(&self.background));
    }

    #[inline]
    pub fn posterior(&self, color: &[u8]) -> f32 {
        self.posterior[cell(color)]
    }

    /// How much a mean posterior looks like the object (1) rather than its surroundings (0).
    pub fn likeness(&self, posterior: f32) -> f64 {
        let (f, b) = self.expected;
        f64::from(((posterior - b) / (f - b).max(1e-3)).clamp(0.0, 1.0))
    }

    /// 0 = object and surroundings have the same colours, 1 = no colour in common.
    pub fn separability(&self) -> f64 {
        let common: f32 =
            self.foreground.iter().zip(&self.background).map(|(f, b)| (f * b).sqrt()).sum();
        f64::from((1.0 - common).clamp(0.0, 1.0))
    }
}
