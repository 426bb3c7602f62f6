//! Colours as the mask stage sees them: hue, saturation, value; palettes and a table colour model.

/// Hue (degrees 0..360), saturation and value (0..1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hsv {
    /// Degrees.
    pub hue: f32,
    /// 0..1.
    pub saturation: f32,
    /// 0..1.
    pub value: f32,
}

impl From<[u8; 3]> for Hsv {
    fn from(c: [u8; 3]) -> Self {
        let [r, g, b] = c.map(|v| f32::from(v) / 255.0);
        let max = r.max(g).max(b);
        let min = r.min(g).min(b);
        let d = max - min;
        let hue = if d < 1e-6 {
            0.0
        } else if max == r {
            60.0 * ((g - b) / d).rem_euclid(6.0)
        } else if max == g {
            60.0 * ((b - r) / d + 2.0)
        } else {
            60.0 * ((r - g) / d + 4.0)
        };
        Self { hue, saturation: if max > 0.0 { d / max } else { 0.0 }, value: max }
    }
}

/// Colour words a prompt may use.
pub const COLOR_WORDS: [(&str, [u8; 3]); 12] = [
    ("red", [200, 30, 30]),
    ("orange", [230, 130, 30]),
    ("brown", [130, 75, 40]),
    ("yellow", [220, 200, 40]),
    ("green", [50, 150, 60]),
    ("turquoise", [60, 190, 190]),
    ("blue", [40, 80, 190]),
    ("purple", [120, 50, 160]),
    ("pink", [230, 130, 170]),
    ("white", [240, 240, 240]),
    ("grey", [128, 128, 128]),
    ("black", [25, 25, 25]),
];

/// Other words for the same colours.
const SAME_COLOR: [(&str, &str); 19] = [
    ("gray", "grey"),
    ("silver", "grey"),
    ("steel", "grey"),
    ("metal", "grey"),
    ("cream", "white"),
    ("ivory", "white"),
    ("wooden", "brown"),
    ("beige", "brown"),
    ("tan", "brown"),
    ("teal", "turquoise"),
    ("cyan", "turquoise"),
    ("aqua", "turquoise"),
    ("violet", "purple"),
    ("lilac", "purple"),
    ("magenta", "pink"),
    ("navy", "blue"),
    ("crimson", "red"),
    ("scarlet", "red"),
    ("golden", "yellow"),
];

/// The canonical colour word of `word` ("gray" is "grey"), if it is one.
pub fn color_word(word: &str) -> Option<&'static str> {
    let word = SAME_COLOR.iter().find(|(other, _)| *other == word).map_or(word, |(_, plain)| plain);
    COLOR_WORDS.iter().find(|(name, _)| *name == word).map(|(name, _)| *name)
}

/// A few colours an object shows, with the part of its surface each one covers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Palette {
    entries: Vec<(Hsv, f32)>,
}

impl Palette {
    /// From colours and weights; near-equal colours are merged, colours below 4 % dropped, weights
    /// made to sum to one.
    pub fn new(colors: impl IntoIterator<Item = ([u8; 3], f32)>) -> Self {
        // Merging on a coarse grid first keeps textured meshes cheap.
        let mut bins = std::collections::BTreeMap::<[u8; 3], (f32, [f32; 3])>::new();
        for (c, w) in colors {
            let e = bins.entry(c.map(|v| v / 43)).or_default();
            e.0 += w;
            for k in 0..3 {
                e.1[k] += w * f32::from(c[k]);
            }
        }
        let total: f32 = bins.values().map(|b| b.0).sum();
        let entries = bins
            .values()
            .filter(|b| b.0 > 0.04 * total)
            .map(|(w, sum)| (Hsv::from(sum.map(|s| (s / w).round() as u8)), w / total))
            .collect();
        Self { entries }
    }

    /// No colour known: the palette says nothing.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The strong colours alone; `None` without a weak one beside a strong one. White and grey are
    /// everywhere: what also has a strong colour is told by that.
    pub fn vivid(&self) -> Option<Self> {
        let entries: Vec<(Hsv, f32)> =
            self.entries.iter().filter(|(e, _)| e.saturation > STRONG).copied().collect();
        (!entries.is_empty() && entries.len() < self.entries.len()).then_some(Self { entries })
    }

    /// Whether a pixel has the colour that covers most of it.
    pub fn is_main(&self, c: [u8; 3]) -> bool {
        let main = self.entries.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        main.is_some_and(|(e, _)| fit_one(e, &Hsv::from(c)) > 0.3)
    }

    /// Whether one of its colours is what the word (a canonical one) means.
    pub fn shows(&self, word: &str) -> bool {
        let Some((_, rgb)) = COLOR_WORDS.iter().find(|(name, _)| *name == word) else {
            return false;
        };
        let meant = Hsv::from(*rgb);
        self.entries.iter().any(|(e, _)| fit_one(&meant, e) > 0.2)
    }

    /// How well a pixel's colour fits the nearest palette colour, 0..1. Hue decides for saturated
    /// colours, brightness hardly: light and shadow change it.
    pub fn fit(&self, c: [u8; 3]) -> f32 {
        let p = Hsv::from(c);
        self.entries.iter().map(|(e, _)| fit_one(e, &p)).fold(0.0, f32::max)
    }
}

/// Saturation above which the hue tells a colour.
const STRONG: f32 = 0.3;

fn fit_one(e: &Hsv, p: &Hsv) -> f32 {
    let soft = |x: f32, width: f32| (1.0 - (x / width).powi(2)).max(0.0);
    let dv = (e.value - p.value).abs();
    // Shadow darkens white to grey; light does not make grey white.
    let plain_width = if p.value < e.value { 0.65 } else { 0.45 };
    if e.saturation > STRONG {
        if p.value < 0.08 || p.saturation < 0.4 * e.saturation {
            return 0.0;
        }
        let dh = (e.hue - p.hue).abs();
        soft(dh.min(360.0 - dh), 32.0) * soft(dv, 0.75)
    } else {
        soft((p.saturation - e.saturation).max(0.0), 0.3) * soft(dv, plain_width)
    }
}

/// RGB histogram (16 bins a channel) of the table's own pixels.
#[derive(Debug, Clone)]
pub struct TableColors {
    bins: Vec<f32>,
}

impl TableColors {
    /// From pixels known to be on the plane.
    pub fn new(pixels: impl Iterator<Item = [u8; 3]>) -> Self {
        let mut raw = vec![0.0f32; 4096];
        let mut n = 0.0f32;
        for p in pixels {
            raw[bin(p)] += 1.0;
            n += 1.0;
        }
        // Spread over the neighbouring bins, so that a colour at a bin border is not "different".
        let mut bins = vec![0.0f32; 4096];
        for r in 0..16usize {
            for g in 0..16usize {
                for b in 0..16usize {
                    let v = raw[(r << 8) | (g << 4) | b];
                    if v == 0.0 {
                        continue;
                    }
                    for rr in r.saturating_sub(1)..=(r + 1).min(15) {
                        for gg in g.saturating_sub(1)..=(g + 1).min(15) {
                            for bb in b.saturating_sub(1)..=(b + 1).min(15) {
                                bins[(rr << 8) | (gg << 4) | bb] += v / n.max(1.0);
                            }
                        }
                    }
                }
            }
        }
        Self { bins }
    }

    /// Whether a colour is one the table hardly shows (under 0.4 % of its pixels near it).
    pub fn differs(&self, c: [u8; 3]) -> bool {
        self.bins[bin(c)] < 0.004
    }
}

#[inline]
fn bin(c: [u8; 3]) -> usize {
    (usize::from(c[0] >> 4) << 8) | (usize::from(c[1] >> 4) << 4) | usize::from(c[2] >> 4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn palettes_look_through_shadow() {
        let p = Palette::new([([40, 80, 190], 1.0)]);
        assert!(p.fit([25, 50, 115]) > 0.6, "the same blue in shadow");
        assert!(p.fit([130, 75, 40]) < 0.1);
        assert!(p.shows("blue") && !p.shows("red") && !p.shows("grey"));
        assert_eq!(color_word("wooden"), Some("brown"));
        assert_eq!(p.vivid(), None);
        let plug = Palette::new([([118, 74, 152], 0.6), ([188, 192, 198], 0.4)]);
        let vivid = plug.vivid().unwrap();
        assert!(plug.fit([180, 184, 188]) > 0.8 && vivid.fit([180, 184, 188]) < 0.1);
        assert!(vivid.fit([118, 74, 152]) > 0.9);
        assert!(plug.is_main([110, 70, 140]) && !plug.is_main([180, 184, 188]));
        assert!(p.fit([150, 150, 150]) < 0.1);
        let grey = Palette::new([([128, 128, 128], 1.0)]);
        assert!(grey.fit([110, 110, 112]) > 0.8 && grey.fit([200, 30, 30]) < 0.1);
    }

    #[test]
    fn table_colours() {
        let t = TableColors::new((0..1000).map(|i| [180 + (i % 8) as u8, 178, 170]));
        assert!(!t.differs([183, 178, 170]) && t.differs([130, 75, 40]));
    }
}
