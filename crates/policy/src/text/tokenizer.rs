//! The tokenizer of BERT: words and punctuation, then the longest known pieces from the left.

use super::TextError;
use std::collections::HashMap;
use std::path::Path;
use unicode_normalization::UnicodeNormalization;
use unicode_normalization::char::is_combining_mark;

/// Words with more characters than this are unknown as a whole.
const LONGEST_WORD: usize = 100;

/// Splits text into the numbers of a vocabulary's pieces.
#[derive(Debug, Clone)]
pub struct WordPiece {
    pieces: HashMap<String, u32>,
    lowercase: bool,
    unknown: u32,
    start: u32,
    end: u32,
}

impl WordPiece {
    /// From pieces with their numbers; `lowercase` also drops accents, as uncased models want it.
    ///
    /// # Errors
    /// The name of a marker that the vocabulary lacks.
    pub fn new(pieces: HashMap<String, u32>, lowercase: bool) -> Result<Self, String> {
        let marker = |name: &str| {
            pieces.get(name).copied().ok_or_else(|| format!("the vocabulary lacks `{name}`"))
        };
        let (unknown, start, end) = (marker("[UNK]")?, marker("[CLS]")?, marker("[SEP]")?);
        Ok(Self { pieces, lowercase, unknown, start, end })
    }

    /// From `vocab.txt` (a piece a line) or else `tokenizer.json` of a model folder. Case is folded
    /// unless one of the folder's tokenizer files says otherwise.
    ///
    /// # Errors
    /// [`TextError::Io`], [`TextError::Model`].
    pub fn load(folder: &Path) -> Result<Self, TextError> {
        let json = folder.join("tokenizer.json");
        let tokenizer = read_json(&json)?;
        let settings = read_json(&folder.join("tokenizer_config.json"))?;
        let flag = |value: Option<&serde_json::Value>| value.and_then(serde_json::Value::as_bool);
        let lowercase = flag(tokenizer.as_ref().and_then(|t| t.pointer("/normalizer/lowercase")))
            .or_else(|| flag(settings.as_ref().and_then(|t| t.get("do_lower_case"))))
            .unwrap_or(true);
        let list = folder.join("vocab.txt");
        let (path, pieces) = match (std::fs::read_to_string(&list), tokenizer) {
            (Ok(text), _) => {
                let numbered = text.lines().zip(0..).map(|(piece, i)| (piece.to_owned(), i));
                (list, numbered.collect())
            }
            (Err(_), Some(t)) => {
                let table = t.pointer("/model/vocab").and_then(serde_json::Value::as_object);
                let entry = |(k, v): (&String, &serde_json::Value)| {
                    v.as_u64().and_then(|v| u32::try_from(v).ok()).map(|v| (k.clone(), v))
                };
                let pieces: Option<HashMap<_, _>> =
                    table.and_then(|table| table.iter().map(entry).collect());
                let Some(pieces) = pieces else {
                    let problem = "it has no table of pieces under model.vocab".into();
                    return Err(TextError::Model { path: json, problem });
                };
                (json, pieces)
            }
            (Err(source), None) => return Err(TextError::Io { path: list, source }),
        };
        Self::new(pieces, lowercase).map_err(|problem| TextError::Model { path, problem })
    }

    /// One more than the highest number.
    pub fn size(&self) -> usize {
        self.pieces.values().max().map_or(0, |m| *m as usize + 1)
    }

    /// The pieces' numbers between the start and end markers.
    pub fn encode(&self, text: &str) -> Vec<u32> {
        let mut ids = vec![self.start];
        for word in self.words(text) {
            self.split(&word, &mut ids);
        }
        ids.push(self.end);
        ids
    }

    fn words(&self, text: &str) -> Vec<String> {
        let folded: String = if self.lowercase {
            // Lower case after the accents, as the models were trained.
            let bare: String = text.nfd().filter(|c| !is_combining_mark(*c)).collect();
            bare.to_lowercase()
        } else {
            text.to_owned()
        };
        let mut words: Vec<String> = Vec::new();
        let mut open = false;
        for c in folded.chars() {
            if c.is_whitespace() {
                open = false;
            } else if c == '\0' || c == '\u{fffd}' || c.is_control() {
                // Left out, the word goes on.
            } else if stands_alone(c) {
                words.push(c.to_string());
                open = false;
            } else if open && let Some(word) = words.last_mut() {
                word.push(c);
            } else {
                words.push(c.to_string());
                open = true;
            }
        }
        words
    }

    fn split(&self, word: &str, ids: &mut Vec<u32>) {
        let before = ids.len();
        let bounds: Vec<usize> = word.char_indices().map(|(i, _)| i).chain([word.len()]).collect();
        let count = bounds.len() - 1;
        let mut from = 0;
        while from < count && count <= LONGEST_WORD {
            let known = (from + 1..=count).rev().find_map(|to| {
                let piece = &word[bounds[from]..bounds[to]];
                let id = if from == 0 {
                    self.pieces.get(piece)
                } else {
                    self.pieces.get(&format!("##{piece}"))
                };
                id.map(|id| (*id, to))
            });
            let Some((id, to)) = known else { break };
            ids.push(id);
            from = to;
        }
        if from < count {
            ids.truncate(before);
            ids.push(self.unknown);
        }
    }
}

fn read_json(path: &Path) -> Result<Option<serde_json::Value>, TextError> {
    let Ok(text) = std::fs::read_to_string(path) else { return Ok(None) };
    serde_json::from_str(&text)
        .map(Some)
        .map_err(|e| TextError::Model { path: path.to_path_buf(), problem: e.to_string() })
}

/// Punctuation, and ideographs, which have no spaces between them.
fn stands_alone(c: char) -> bool {
    c.is_ascii_punctuation()
        || matches!(c,
            '\u{a1}' | '\u{a7}' | '\u{ab}' | '\u{b6}' | '\u{b7}' | '\u{bb}' | '\u{bf}'
            | '\u{2010}'..='\u{2027}' | '\u{2030}'..='\u{2043}' | '\u{2045}'..='\u{2051}'
            | '\u{2053}'..='\u{205e}' | '\u{3001}'..='\u{3003}' | '\u{3008}'..='\u{3011}'
            | '\u{ff01}'..='\u{ff03}' | '\u{ff05}'..='\u{ff0a}' | '\u{ff0c}'..='\u{ff0f}'
            | '\u{ff1a}' | '\u{ff1b}' | '\u{ff1f}'
            | '\u{3400}'..='\u{4dbf}' | '\u{4e00}'..='\u{9fff}' | '\u{f900}'..='\u{faff}'
            | '\u{20000}'..='\u{2ceaf}')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokenizer(lowercase: bool) -> WordPiece {
        let pieces = [
            "[UNK]", "[CLS]", "[SEP]", "put", "the", "mug", "##s", "cafe", ",", ".", "un",
            "##known", "Mug", "杯",
        ];
        WordPiece::new(pieces.iter().zip(0..).map(|(p, i)| (p.to_string(), i)).collect(), lowercase)
            .unwrap()
    }

    #[test]
    fn words_punctuation_accents_and_pieces() {
        let t = tokenizer(true);
        assert_eq!(t.encode("Put the\tMUGS, the Café."), [1, 3, 4, 5, 6, 8, 4, 7, 9, 2]);
        assert_eq!(t.encode("unknown 杯杯 xyz"), [1, 10, 11, 13, 13, 0, 2]);
        assert_eq!(t.encode(" \n "), [1, 2]);
        assert_eq!(t.encode(&"mug".repeat(40)), [1, 0, 2]);
        assert_eq!(tokenizer(false).encode("Mug mug"), [1, 12, 5, 2]);
    }

    #[test]
    fn folders_without_a_vocabulary_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let error = WordPiece::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("vocab.txt"), "{error}");
        std::fs::write(dir.path().join("tokenizer.json"), r#"{"model":{}}"#).unwrap();
        let error = WordPiece::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("tokenizer.json") && error.contains("model.vocab"), "{error}");
        std::fs::write(dir.path().join("vocab.txt"), "[UNK]\n[CLS]\nput\n").unwrap();
        let error = WordPiece::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("[SEP]"), "{error}");
        std::fs::remove_file(dir.path().join("vocab.txt")).unwrap();
        let json = r#"{"normalizer":{"lowercase":false},
            "model":{"vocab":{"[UNK]":0,"[CLS]":1,"[SEP]":2,"put":3,"Put":4}}}"#;
        std::fs::write(dir.path().join("tokenizer.json"), json).unwrap();
        assert_eq!(WordPiece::load(dir.path()).unwrap().encode("Put put"), [1, 4, 3, 2]);
    }
}
