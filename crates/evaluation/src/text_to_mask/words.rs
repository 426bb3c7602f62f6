//! The sentences about a table: by name, by another name, by colour; every third one is about
//! something that is not there.

use super::scene::{Table, key};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tdv_perception::ObjectModel;
use tdv_perception::color::{COLOR_WORDS, color_word};

/// In what way a sentence asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Asked {
    /// By the catalogue's name.
    Name,
    /// By another name.
    Synonym,
    /// With colour words, of the whole or of a part.
    Colour,
}

impl Asked {
    /// All of them, in the order of the questions.
    pub const ALL: [Self; 3] = [Self::Name, Self::Synonym, Self::Colour];
}

/// A sentence and what it means.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// In what way it asks.
    pub asked: Asked,
    /// The sentence.
    pub text: String,
    /// Index into the table's things; none if it is not there.
    pub target: Option<usize>,
}

/// How people ask.
const FRAMES: [&str; 8] = [
    "the {}",
    "pick up the {}",
    "where is the {}?",
    "grasp the {} gently",
    "Move the {} to the left, please.",
    "{}",
    "take the {} off the table",
    "show me the {}",
];

/// What nobody put into the catalogue.
const FOREIGN: [&str; 8] = [
    "banana",
    "screwdriver",
    "green stapler",
    "apple",
    "phone",
    "pair of scissors",
    "pencil case",
    "cup holder",
];

/// What one may say of parts: object, colour, part.
const DETAILS: [(&str, &str, &str); 6] = [
    ("mug", "blue", "handle"),
    ("bottle", "red", "label"),
    ("peg", "yellow", "tip"),
    ("drawer", "metal", "handle"),
    ("plug", "metal", "tip"),
    ("tissue_box", "yellow", "stripe"),
];

/// One sentence of each way.
pub fn questions(table: &Table, models: &[ObjectModel], index: usize, seed: u64) -> Vec<Question> {
    let mut rng = ChaCha8Rng::seed_from_u64(key(seed, index) ^ 0x0077_6f72_6473);
    let mut out = Vec::new();
    for (number, asked) in Asked::ALL.into_iter().enumerate() {
        // One sentence of every table is about what is not there, each way in turn.
        let absent = (index + number).is_multiple_of(3);
        let seen: Vec<usize> = (0..table.things.len()).filter(|i| table.things[*i].seen).collect();
        let phrase = if absent {
            absent_phrase(asked, table, models, &seen, &mut rng).map(|p| (p, None))
        } else {
            seen.choose(&mut rng)
                .map(|i| (present_phrase(asked, *i, table, models, &mut rng), Some(*i)))
        };
        let Some((phrase, target)) = phrase else { continue };
        let frame = FRAMES.choose(&mut rng).copied().unwrap_or("{}");
        out.push(Question { asked, text: frame.replace("{}", &phrase), target });
    }
    out
}

fn spoken(name: &str) -> String {
    name.replace('_', " ")
}

fn synonym(model: &ObjectModel, rng: &mut ChaCha8Rng) -> String {
    spoken(model.synonyms.choose(rng).unwrap_or(&model.name))
}

fn present_phrase(
    asked: Asked,
    thing: usize,
    table: &Table,
    models: &[ObjectModel],
    rng: &mut ChaCha8Rng,
) -> String {
    let index = table.things[thing].model;
    let model = &models[index];
    match asked {
        Asked::Name => spoken(&model.name),
        Asked::Synonym => synonym(model, rng),
        Asked::Colour => {
            let name = if rng.random_bool(0.5) { spoken(&model.name) } else { synonym(model, rng) };
            let detail = DETAILS.iter().find(|d| d.0 == model.name);
            if let Some((_, color, part)) = detail.filter(|_| rng.random_bool(0.5)) {
                return format!("{name} with the {color} {part}");
            }
            let Some(color) = model.colors.choose(rng) else { return name };
            // Colour alone will do where nothing else of that colour is about.
            let word = color_word(color).unwrap_or_default();
            let alone =
                table.things.iter().all(|t| t.model == index || !models[t.model].shows(word));
            if alone && rng.random_bool(0.4) {
                format!("{color} one")
            } else {
                format!("{color} {name}")
            }
        }
    }
}

fn absent_phrase(
    asked: Asked,
    table: &Table,
    models: &[ObjectModel],
    seen: &[usize],
    rng: &mut ChaCha8Rng,
) -> Option<String> {
    let here = |i: usize| table.things.iter().any(|t| t.model == i);
    let missing: Vec<&ObjectModel> =
        models.iter().enumerate().filter(|(i, _)| !here(*i)).map(|(_, m)| m).collect();
    let missing_one = missing.choose(rng).copied();
    if asked != Asked::Colour && rng.random_bool(0.25) {
        return FOREIGN.choose(rng).map(|w| (*w).to_owned());
    }
    match asked {
        Asked::Name => missing_one.map(|m| spoken(&m.name)),
        Asked::Synonym => {
            // Not a word by which something that is there could be called as well.
            let taken = |name: &str| {
                let last = name.rsplit([' ', '_']).next().unwrap_or(name);
                table.things.iter().any(|t| {
                    let m = &models[t.model];
                    std::iter::once(&m.name)
                        .chain(&m.synonyms)
                        .any(|n| n.split([' ', '_']).any(|w| w == last))
                })
            };
            let all: Vec<&String> =
                missing.iter().flat_map(|m| &m.synonyms).filter(|s| !taken(s)).collect();
            all.choose(rng).map(|s| spoken(s))
        }
        Asked::Colour => {
            // Half of the time what is there, in a colour that it has nowhere.
            let there = seen.choose(rng).filter(|_| rng.random_bool(0.6));
            if let Some(i) = there {
                let model = &models[table.things[*i].model];
                let wrong: Vec<&str> =
                    COLOR_WORDS.iter().map(|(w, _)| *w).filter(|w| !model.shows(w)).collect();
                let color = wrong.choose(rng)?;
                let detail = DETAILS.iter().find(|d| d.0 == model.name);
                return Some(match detail.filter(|_| rng.random_bool(0.5)) {
                    Some((_, _, part)) => {
                        format!("{} with the {color} {part}", spoken(&model.name))
                    }
                    None => format!("{color} {}", spoken(&model.name)),
                });
            }
            let model = missing_one?;
            let color = model.colors.choose(rng).cloned().unwrap_or_default();
            Some(format!("{color} {}", spoken(&model.name)).trim().to_owned())
        }
    }
}
