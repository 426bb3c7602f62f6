//! A prompt as GroundingDINO takes it: phrases in one text, each ended by a full stop, none of which
//! sees the others.

use super::wordpiece::WordPiece;
use crate::FoundationError;
use std::ops::Range;

/// Most tokens of a prompt.
pub const MOST_TOKENS: usize = 256;
/// Tokens that part phrases, besides start and end.
const PARTING: [&str; 2] = [".", "?"];

/// The text inputs of the network; `n` tokens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Phrases {
    /// Token numbers, `n`.
    pub ids: Vec<i64>,
    /// Each token's place in its phrase, `n`.
    pub positions: Vec<i64>,
    /// Which tokens see which, row-major `n * n`.
    pub sees: Vec<bool>,
    /// The tokens of each phrase.
    pub spans: Vec<Range<usize>>,
}

impl Phrases {
    /// Tokenises phrases such as "red mug".
    ///
    /// # Errors
    /// [`FoundationError::Input`] without phrases, for an empty one, or for too many tokens.
    pub fn new(phrases: &[String], words: &WordPiece) -> Result<Self, FoundationError> {
        let bad = |reason: String| Err(FoundationError::input("prompt", reason));
        let parting: Vec<i64> = PARTING.iter().filter_map(|p| words.id(p)).collect();
        let Some(stop) = words.id(".") else {
            return bad("cannot be written: the vocabulary has no full stop".into());
        };
        let mut ids = vec![words.start];
        let mut spans = Vec::new();
        for phrase in phrases {
            let from = ids.len();
            ids.extend(words.encode(phrase).into_iter().filter(|id| !parting.contains(id)));
            if ids.len() == from {
                return bad(format!("has an empty phrase: {phrase:?}"));
            }
            spans.push(from..ids.len());
            ids.push(stop);
        }
        ids.push(words.end);
        if phrases.is_empty() || ids.len() > MOST_TOKENS {
            return bad(format!(
                "has {} phrases and {} tokens; one phrase at least, {MOST_TOKENS} tokens at most",
                phrases.len(),
                ids.len()
            ));
        }
        let (positions, sees) =
            blocks(&ids, |id| id == words.start || id == words.end || parting.contains(&id));
        Ok(Self { ids, positions, sees, spans })
    }
}

/// Positions within the blocks that end at a parting token, and the mask that keeps blocks apart.
fn blocks(ids: &[i64], parts: impl Fn(i64) -> bool) -> (Vec<i64>, Vec<bool>) {
    let n = ids.len();
    let mut positions = vec![0; n];
    let mut sees = vec![false; n * n];
    let mut from = 0;
    for at in 0..n {
        positions[at] = (at - from) as i64;
        sees[at * n + at] = true;
        if parts(ids[at]) {
            // Start and end stand alone.
            if at != 0 && at != n - 1 {
                for row in from..=at {
                    sees[row * n + from..=row * n + at].fill(true);
                }
            }
            from = at + 1;
        }
    }
    (positions, sees)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Golden {
        vocabulary: Vec<String>,
        prompts: Vec<Prompt>,
    }

    #[derive(Deserialize)]
    struct Prompt {
        phrases: Vec<String>,
        ids: Vec<i64>,
        positions: Vec<i64>,
        sees: Vec<u8>,
    }

    #[test]
    fn inputs_are_those_of_transformers() {
        let text = include_str!("../../../../tests/golden/foundation/phrases.json");
        let golden: Golden = serde_json::from_str(text).unwrap();
        let w = WordPiece::parse(&golden.vocabulary.join("\n")).unwrap();
        assert!(golden.prompts.len() > 2);
        for p in &golden.prompts {
            let got = Phrases::new(&p.phrases, &w).unwrap();
            assert_eq!(got.ids, p.ids, "{:?}", p.phrases);
            assert_eq!(got.positions, p.positions, "{:?}", p.phrases);
            let sees: Vec<u8> = got.sees.iter().map(|s| u8::from(*s)).collect();
            assert_eq!(sees, p.sees, "{:?}", p.phrases);
            assert_eq!(got.spans.len(), p.phrases.len());
            for (span, phrase) in got.spans.iter().zip(&p.phrases) {
                assert_eq!(got.ids[span.clone()], w.encode(phrase.trim_end_matches('.')));
            }
        }
    }

    #[test]
    fn prompts_that_cannot_be_are_refused() {
        let w = WordPiece::parse("[UNK]\n[CLS]\n[SEP]\n.\nmug").unwrap();
        for bad in [vec![], vec!["mug".to_owned(), " . ".into()], vec!["mug ".repeat(300)]] {
            assert!(Phrases::new(&bad, &w).is_err(), "{bad:?}");
        }
        assert_eq!(Phrases::new(&["mug.".into()], &w).unwrap().ids, [1, 4, 3, 2]);
    }
}
