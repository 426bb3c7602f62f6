//! BERT's uncased tokeniser: words to pieces of a vocabulary file (`vocab.txt`, one piece a line).

use crate::FoundationError;
use std::collections::HashMap;
use std::path::Path;

/// Words of more characters become one unknown token.
const LONGEST: usize = 100;

/// A vocabulary with its special tokens.
#[derive(Debug, Clone)]
pub struct WordPiece {
    ids: HashMap<String, i64>,
    /// Start of the text, `[CLS]`.
    pub start: i64,
    /// End of the text, `[SEP]`.
    pub end: i64,
    unknown: i64,
}

impl WordPiece {
    /// Reads a vocabulary.
    ///
    /// # Errors
    /// [`FoundationError`] for a missing file or one without BERT's special tokens.
    pub fn load(path: &Path) -> Result<Self, FoundationError> {
        let text = std::fs::read_to_string(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => FoundationError::Missing {
                path: path.into(),
                what: "the vocabulary of bert-base-uncased",
                hint: "It comes with the GroundingDINO model (Apache-2.0); \
                       launch_scripts/export_onnx.py copies it",
            },
            _ => FoundationError::File { path: path.into(), reason: e.to_string() },
        })?;
        Self::parse(&text).map_err(|reason| FoundationError::File { path: path.into(), reason })
    }

    /// From the text of a vocabulary file; the error is a sentence.
    ///
    /// # Errors
    /// When one of BERT's special tokens is not in it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let ids: HashMap<String, i64> =
            text.lines().enumerate().map(|(i, l)| (l.trim_end().to_owned(), i as i64)).collect();
        let special = |name: &str| {
            ids.get(name).copied().ok_or_else(|| format!("has no {name}; is it BERT's vocab.txt?"))
        };
        Ok(Self {
            start: special("[CLS]")?,
            end: special("[SEP]")?,
            unknown: special("[UNK]")?,
            ids,
        })
    }

    /// The number of a piece.
    pub fn id(&self, piece: &str) -> Option<i64> {
        self.ids.get(piece).copied()
    }

    /// Numbers of a text's pieces, without start and end.
    pub fn encode(&self, text: &str) -> Vec<i64> {
        let mut out = Vec::new();
        for word in words(text) {
            self.pieces(&word, &mut out);
        }
        out
    }

    /// The longest piece that begins the word, then the longest that goes on, and so forth.
    fn pieces(&self, word: &str, out: &mut Vec<i64>) {
        let before = out.len();
        if word.chars().count() > LONGEST {
            out.push(self.unknown);
            return;
        }
        let mut rest = word;
        while !rest.is_empty() {
            let ends = rest.char_indices().map(|(i, c)| i + c.len_utf8()).rev();
            let found = ends.into_iter().find_map(|end| {
                let piece = &rest[..end];
                let id = if rest.len() == word.len() {
                    self.ids.get(piece)
                } else {
                    self.ids.get(&format!("##{piece}"))
                };
                id.map(|id| (*id, end))
            });
            let Some((id, end)) = found else {
                // One part unknown, all unknown.
                out.truncate(before);
                out.push(self.unknown);
                return;
            };
            out.push(id);
            rest = &rest[end..];
        }
    }
}

/// Lower-case words without accents; punctuation and ideographs stand alone.
fn words(text: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let mut open = false;
    for c in text.chars().flat_map(char::to_lowercase) {
        if c.is_whitespace() {
            open = false;
        } else if c.is_control() || c == '\u{fffd}' || ('\u{300}'..='\u{36f}').contains(&c) {
            // Combining accents go, as controls do.
        } else if alone(c) {
            out.push(c.to_string());
            open = false;
        } else {
            match out.last_mut().filter(|_| open) {
                Some(word) => word.push(plain(c)),
                None => out.push(plain(c).to_string()),
            }
            open = true;
        }
    }
    out
}

fn alone(c: char) -> bool {
    let ideograph = matches!(u32::from(c), 0x4e00..=0x9fff | 0x3400..=0x4dbf | 0x20000..=0x2fa1f
        | 0xf900..=0xfaff);
    let punctuation = c.is_ascii_punctuation()
        || matches!(u32::from(c), 0xa1 | 0xa7 | 0xab | 0xb6 | 0xb7 | 0xbb | 0xbf
            | 0x2010..=0x2027 | 0x2030..=0x205e | 0x3001..=0x3003 | 0x3008..=0x3011);
    ideograph || punctuation
}

/// The letter under an accent, for the letters of western European languages.
fn plain(c: char) -> char {
    match c {
        'à'..='å' | 'ā' | 'ă' | 'ą' => 'a',
        'ç' | 'ć' | 'č' => 'c',
        'è'..='ë' | 'ē' | 'ę' | 'ě' => 'e',
        'ì'..='ï' | 'ī' => 'i',
        'ñ' | 'ń' | 'ň' => 'n',
        'ò'..='ö' | 'ō' | 'ő' => 'o',
        'ř' => 'r',
        'ś' | 'š' | 'ş' => 's',
        'ť' => 't',
        'ù'..='ü' | 'ū' | 'ů' | 'ű' => 'u',
        'ý' | 'ÿ' => 'y',
        'ź' | 'ż' | 'ž' => 'z',
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Golden {
        vocabulary: Vec<String>,
        texts: Vec<(String, Vec<i64>)>,
    }

    #[test]
    fn pieces_are_those_of_transformers() {
        let text = include_str!("../../../../tests/golden/foundation/phrases.json");
        let golden: Golden = serde_json::from_str(text).unwrap();
        let w = WordPiece::parse(&golden.vocabulary.join("\n")).unwrap();
        assert!(golden.texts.len() > 10);
        for (text, want) in &golden.texts {
            let mut got = vec![w.start];
            got.extend(w.encode(text));
            got.push(w.end);
            assert_eq!(&got, want, "{text}");
        }
    }

    #[test]
    fn a_vocabulary_without_special_tokens_is_refused() {
        assert!(WordPiece::parse("a\nb").unwrap_err().contains("[CLS]"));
        let e = WordPiece::load(Path::new("no/vocab.txt")).unwrap_err().to_string();
        assert!(e.contains("vocab.txt") && e.contains("Apache"), "{e}");
    }
}
