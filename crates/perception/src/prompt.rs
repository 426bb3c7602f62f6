//! From a sentence such as "put the blue cup on the coaster" to catalogue entries. A word that is not
//! known is reported with the nearest names, never guessed.

use crate::catalogue::ObjectModel;
use crate::color::color_word;

/// A catalogue entry that the prompt asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wanted {
    /// Index into the models.
    pub model: usize,
    /// The words of the prompt.
    pub phrase: String,
}

/// Words of the prompt that name nothing in the catalogue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unknown {
    /// The words.
    pub phrase: String,
    /// A sentence for the operator, with the nearest candidates.
    pub reason: String,
}

/// A parsed prompt.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Prompt {
    /// Entries in the order in which they are named, each once.
    pub wanted: Vec<Wanted>,
    /// What could not be resolved.
    pub unknown: Vec<Unknown>,
}

/// Words that separate or decorate noun phrases.
const STOP: &[&str] = &[
    "a",
    "an",
    "the",
    "this",
    "that",
    "its",
    "it",
    "my",
    "your",
    "and",
    "then",
    "with",
    "without",
    "in",
    "into",
    "on",
    "onto",
    "to",
    "from",
    "of",
    "off",
    "over",
    "under",
    "at",
    "by",
    "near",
    "next",
    "beside",
    "between",
    "upon",
    "up",
    "down",
    "out",
    "put",
    "place",
    "set",
    "move",
    "bring",
    "carry",
    "pick",
    "take",
    "grasp",
    "grab",
    "lift",
    "push",
    "pull",
    "drop",
    "release",
    "lay",
    "stack",
    "find",
    "track",
    "follow",
    "look",
    "for",
    "is",
    "be",
    "please",
    "one",
    "top",
    "gently",
    "slowly",
    "carefully",
    "upright",
    "left",
    "right",
    "back",
    "there",
    "here",
    "robot",
    "gripper",
    "hand",
    "table",
    "desk",
    "object",
    "only",
    "let",
    "go",
    "you",
    "should",
    "so",
    "stands",
    "stand",
    "leave",
    "center",
    "centre",
    "middle",
    "some",
    "both",
    "each",
];

/// Finds the catalogue entries that a prompt names.
pub fn parse_prompt(text: &str, models: &[ObjectModel]) -> Prompt {
    let mut out = Prompt::default();
    let words: Vec<String> = text
        .split(|c: char| !(c.is_alphanumeric() || c == '_' || c == '-'))
        .filter(|w| !w.is_empty())
        .map(str::to_lowercase)
        .collect();
    let stop = |w: &str| STOP.contains(&w) && !names_of(models).any(|(_, n)| n == w);
    for phrase in words.split(|w| stop(w)).filter(|p| !p.is_empty()) {
        resolve(phrase, models, &mut out);
    }
    out
}

/// Every name and synonym, with its model's index.
fn names_of(models: &[ObjectModel]) -> impl Iterator<Item = (usize, &str)> {
    models.iter().enumerate().flat_map(|(i, m)| {
        std::iter::once(m.name.as_str())
            .chain(m.synonyms.iter().map(String::as_str))
            .map(move |n| (i, n))
    })
}

fn resolve(phrase: &[String], models: &[ObjectModel], out: &mut Prompt) {
    let colors: Vec<&str> = phrase.iter().filter_map(|w| color_word(w)).collect();
    let text = phrase.join(" ");
    // The longest name inside the phrase wins, the last one of equal length: "coffee mug" over "mug".
    let mut named: Option<(usize, usize)> = None;
    for (model, name) in names_of(models) {
        let parts: Vec<String> =
            name.split([' ', '_', '-']).filter(|p| !p.is_empty()).map(str::to_lowercase).collect();
        let flat: Vec<&str> = phrase.iter().flat_map(|w| w.split(['_', '-'])).collect();
        let inside = flat.windows(parts.len().max(1)).any(|w| {
            w.iter().zip(&parts).all(|(a, b)| *a == b.as_str() || a.strip_suffix('s') == Some(b))
        });
        if inside && named.is_none_or(|(_, n)| parts.len() > n) {
            named = Some((model, parts.len()));
        }
    }
    let fits_color = |m: &ObjectModel| {
        m.colors.is_empty()
            || colors.iter().all(|c| m.colors.iter().any(|k| color_word(k) == Some(*c)))
    };
    let nearest = |noun: &str| nearest_names(noun, models).join(", ");
    match named {
        Some((model, _)) if fits_color(&models[model]) => push(out, model, text),
        Some((model, _)) => {
            // A second entry may share the word and have the right colour.
            let parts = models[model].name.clone();
            if let Some(other) = (0..models.len()).find(|i| {
                *i != model
                    && fits_color(&models[*i])
                    && !models[*i].colors.is_empty()
                    && names_of(&models[*i..=*i])
                        .any(|(_, n)| phrase.iter().any(|w| w == n) || n == parts)
            }) {
                return push(out, other, text);
            }
            out.unknown.push(Unknown {
                reason: format!(
                    "\"{text}\": the catalogue's {} is {}, not {}",
                    models[model].name,
                    models[model].colors.join("/"),
                    colors.join(" ")
                ),
                phrase: text,
            });
        }
        None if colors.len() == phrase.len() => {
            let fitting: Vec<usize> = (0..models.len())
                .filter(|i| !models[*i].colors.is_empty() && fits_color(&models[*i]))
                .collect();
            if let [only] = fitting[..] {
                push(out, only, text);
            } else {
                let names: Vec<&str> = fitting.iter().map(|i| models[*i].name.as_str()).collect();
                let reason = match names.len() {
                    0 => format!("\"{text}\": no object of the catalogue has this colour"),
                    _ => format!("\"{text}\" may be any of {}; use a name", names.join(", ")),
                };
                out.unknown.push(Unknown { phrase: text, reason });
            }
        }
        None => {
            let noun = phrase.last().map_or("", String::as_str);
            let reason = if models.is_empty() {
                format!("\"{text}\" is not in the catalogue, which is empty")
            } else {
                format!("\"{text}\" is not in the catalogue; nearest: {}", nearest(noun))
            };
            out.unknown.push(Unknown { phrase: text, reason });
        }
    }
}

fn push(out: &mut Prompt, model: usize, phrase: String) {
    if out.wanted.iter().all(|w| w.model != model) {
        out.wanted.push(Wanted { model, phrase });
    }
}

/// Up to three model names, those with the nearest spelling (of name or synonym) first.
fn nearest_names(word: &str, models: &[ObjectModel]) -> Vec<String> {
    let mut scored: Vec<(usize, usize)> = (0..models.len())
        .map(|i| {
            let d = names_of(&models[i..=i]).map(|(_, n)| edit_distance(word, n)).min();
            (d.unwrap_or(usize::MAX), i)
        })
        .collect();
    scored.sort();
    scored.iter().take(3).map(|(_, i)| models[*i].name.clone()).collect()
}

fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let next = (diagonal + usize::from(ca != *cb)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::Symmetry;
    use tdv_rendering::mesh::primitives;

    fn models() -> Vec<ObjectModel> {
        let make = |name: &str, synonyms: &[&str], colors: &[&str]| {
            let mut m = ObjectModel::new(
                name,
                primitives::cuboid([0.1, 0.1, 0.1], [90, 90, 90]),
                Symmetry::None,
            );
            m.synonyms = synonyms.iter().map(|s| (*s).to_owned()).collect();
            m.colors = colors.iter().map(|s| (*s).to_owned()).collect();
            m
        };
        vec![
            make("coaster", &["disc", "beer mat"], &["brown", "red"]),
            make("mug", &["cup"], &["blue"]),
            make("mustard_bottle", &["bottle"], &["yellow"]),
        ]
    }

    fn found(text: &str) -> (Vec<usize>, Vec<String>) {
        let p = parse_prompt(text, &models());
        (
            p.wanted.iter().map(|w| w.model).collect(),
            p.unknown.iter().map(|u| u.reason.clone()).collect(),
        )
    }

    #[test]
    fn names_synonyms_colours() {
        assert_eq!(found("put the cup on the coaster"), (vec![1, 0], vec![]));
        assert_eq!(found("Place the BLUE mug on the red coaster, upright."), (vec![1, 0], vec![]));
        assert_eq!(found("set the bottle onto the beer mat"), (vec![2, 0], vec![]));
        assert_eq!(found("move the mustard bottle"), (vec![2], vec![]));
        assert_eq!(found("pick the blue one up"), (vec![1], vec![]));
        assert_eq!(found(""), (vec![], vec![]));
    }

    #[test]
    fn unknown_words_give_reasons() {
        let (w, u) = found("put the red cup on the coaster");
        assert_eq!(w, vec![0]);
        assert!(u[0].contains("blue") && u[0].contains("red"), "{}", u[0]);
        let (w, u) = found("put the mugg on the plate");
        assert!(w.is_empty());
        assert!(u[0].contains("nearest: mug"), "{}", u[0]);
        assert!(u[1].contains("plate"), "{}", u[1]);
        let (_, u) = found("the purple one");
        assert!(u[0].contains("colour"), "{}", u[0]);
    }
}
