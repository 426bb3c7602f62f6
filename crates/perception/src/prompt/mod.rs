//! From a sentence such as "put the blue cup on the coaster" to catalogue entries. A word that is not
//! known is reported with the nearest names, never guessed.

mod words;

use crate::catalogue::ObjectModel;
use crate::color::color_word;
use words::{is_part, is_stop, joins};

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
    /// Models that the words fit all alike ("the blue one"); what stands on the table may decide.
    pub may_be: Vec<usize>,
}

/// A parsed prompt.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Prompt {
    /// Entries in the order in which they are named, each once.
    pub wanted: Vec<Wanted>,
    /// What could not be resolved.
    pub unknown: Vec<Unknown>,
}

/// Finds the catalogue entries that a prompt names.
pub fn parse_prompt(text: &str, models: &[ObjectModel]) -> Prompt {
    let words: Vec<String> = text
        .split(|c: char| !c.is_alphanumeric())
        .filter(|w| !w.is_empty())
        .map(str::to_lowercase)
        .collect();
    let mut out = Prompt::default();
    let mut phrase = Phrase::default();
    // The model that the phrase before named, for "the mug with the blue handle".
    let mut last: Option<usize> = None;
    let mut described = false;
    let mut i = 0;
    while i < words.len() {
        let span = names_at(&words[i..], models);
        if let Some((length, named)) = span {
            if !phrase.named.is_empty() {
                last = phrase.end(models, &mut out);
                described = false;
            }
            phrase.text.extend_from_slice(&words[i..i + length]);
            phrase.named = named;
            i += length;
            continue;
        }
        let word = &words[i];
        i += 1;
        if !is_stop(word) {
            if phrase.named.is_empty() {
                phrase.before.push(word.clone());
            } else {
                phrase.after.push(word.clone());
            }
            phrase.text.push(word.clone());
            continue;
        }
        // "its handle is blue" is beyond this parser; "with a blue handle" is not.
        if !phrase.text.is_empty() {
            let about = described.then_some(last).flatten().filter(|_| phrase.describes());
            match about {
                Some(model) => phrase.describe(model, models, &mut out),
                None => last = phrase.end(models, &mut out),
            }
            phrase = Phrase::default();
            described = false;
        }
        described = described || joins(word);
    }
    match described.then_some(last).flatten().filter(|_| phrase.describes()) {
        Some(model) => phrase.describe(model, models, &mut out),
        None => {
            phrase.end(models, &mut out);
        }
    }
    out
}

/// A run of words between two that say nothing.
#[derive(Debug, Default)]
struct Phrase {
    text: Vec<String>,
    /// Words before the name.
    before: Vec<String>,
    /// Words after it.
    after: Vec<String>,
    /// The models that bear the name.
    named: Vec<usize>,
}

impl Phrase {
    /// Whether it tells the colour of a part and names nothing itself.
    fn describes(&self) -> bool {
        self.named.is_empty()
            && self.before.last().is_some_and(|w| is_part(w))
            && self.before.iter().any(|w| color_word(w).is_some())
    }

    /// Takes back what was found if the described part has a colour that the model does not show.
    fn describe(&self, model: usize, models: &[ObjectModel], out: &mut Prompt) {
        let missing = self.before.iter().filter_map(|w| color_word(w));
        let Some(color) = missing.into_iter().find(|c| !models[model].shows(c)) else { return };
        let Some(at) = out.wanted.iter().position(|w| w.model == model) else { return };
        let phrase = format!("{} with {}", out.wanted.remove(at).phrase, self.text.join(" "));
        let reason =
            format!("\"{phrase}\": the catalogue's {} shows no {color}", models[model].name);
        out.unknown.push(Unknown { phrase, reason, may_be: Vec::new() });
    }

    /// Resolves it, and leaves an empty one behind; the model that it names, if it names one.
    fn end(&mut self, models: &[ObjectModel], out: &mut Prompt) -> Option<usize> {
        let Self { text, before, after, named } = std::mem::take(self);
        if text.is_empty() {
            return None;
        }
        let text = text.join(" ");
        let colors: Vec<&str> = before.iter().chain(&after).filter_map(|w| color_word(w)).collect();
        let fits = |m: &ObjectModel| m.colors.is_empty() || colors.iter().all(|c| m.is_called(c));
        let mut unknown = |reason: String, may_be: Vec<usize>| {
            out.unknown.push(Unknown { phrase: text.clone(), reason, may_be });
        };
        // "Cup holder" is no cup: the last noun says what a thing is.
        let other = after.iter().find(|w| color_word(w).is_none() && !is_part(w));
        if named.is_empty() || other.is_some() {
            let plain = named.is_empty() && colors.len() == before.len();
            if !plain {
                let noun = other.or(before.last()).map_or("", String::as_str);
                unknown(not_known(&text, noun, models), Vec::new());
                return None;
            }
            let fitting: Vec<usize> = (0..models.len())
                .filter(|i| !models[*i].colors.is_empty() && fits(&models[*i]))
                .collect();
            if let [only] = fitting[..] {
                push(out, only, text);
                return Some(only);
            }
            let names: Vec<&str> = fitting.iter().map(|i| models[*i].name.as_str()).collect();
            let reason = match names.len() {
                0 => format!("\"{text}\": no object of the catalogue has this colour"),
                _ => format!("\"{text}\" may be any of {}; use a name", names.join(", ")),
            };
            unknown(reason, fitting);
            return None;
        }
        // Two entries may share the name; the colour decides, then the order.
        if let Some(model) = named.iter().copied().find(|i| fits(&models[*i])) {
            push(out, model, text);
            return Some(model);
        }
        let model = &models[named[0]];
        unknown(
            format!(
                "\"{text}\": the catalogue's {} is {}, not {}",
                model.name,
                model.colors.join("/"),
                colors.join(" ")
            ),
            Vec::new(),
        );
        None
    }
}

fn not_known(text: &str, noun: &str, models: &[ObjectModel]) -> String {
    if models.is_empty() {
        return format!("\"{text}\" is not in the catalogue, which is empty");
    }
    let nearest = nearest_names(noun, models).join(", ");
    format!("\"{text}\" is not in the catalogue; nearest: {nearest}")
}

/// Every name and synonym, with its model's index.
fn names_of(models: &[ObjectModel]) -> impl Iterator<Item = (usize, &str)> {
    models.iter().enumerate().flat_map(|(i, m)| {
        std::iter::once(m.name.as_str())
            .chain(m.synonyms.iter().map(String::as_str))
            .map(move |n| (i, n))
    })
}

/// The longest name that the words begin with, and all models that bear it. A last word alone stands
/// for a longer name ("the box" for a tissue box) where nothing else is called so.
fn names_at(words: &[String], models: &[ObjectModel]) -> Option<(usize, Vec<usize>)> {
    let first = words.first()?;
    let same = |word: &str, part: &str| {
        word == part
            || word.strip_suffix('s') == Some(part)
            || word.strip_suffix("es") == Some(part)
    };
    let mut best: Option<(usize, Vec<usize>)> = None;
    let mut heads: Vec<usize> = Vec::new();
    for (model, name) in names_of(models) {
        let parts: Vec<&str> = name.split([' ', '_', '-']).filter(|p| !p.is_empty()).collect();
        let n = parts.len();
        if n == 0 {
            continue;
        }
        if n > 1 && same(first, parts[n - 1]) && !heads.contains(&model) {
            heads.push(model);
        }
        let begins = words.len() >= n && words.iter().zip(&parts).all(|(w, p)| same(w, p));
        if !begins {
            continue;
        }
        match &mut best {
            Some((length, named)) if *length == n => {
                if !named.contains(&model) {
                    named.push(model);
                }
            }
            Some((length, _)) if *length > n => {}
            _ => best = Some((n, vec![model])),
        }
    }
    best.or_else(|| (heads.len() == 1 && !is_stop(first)).then_some((1, heads)))
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
        assert_eq!(found("where are the cups?"), (vec![1], vec![]));
        assert_eq!(found("the mug with the blue handle"), (vec![1], vec![]));
        assert_eq!(found("the mat"), (vec![0], vec![]));
        assert_eq!(found(""), (vec![], vec![]));
    }

    #[test]
    fn the_longest_name_counts_even_across_small_words() {
        let mut all = models();
        all[1].synonyms.push("box of tissues".into());
        all[0].synonyms.push("box".into());
        let found = |text: &str| parse_prompt(text, &all);
        let p = found("the box of tissues");
        assert_eq!((p.wanted.len(), p.wanted[0].model, p.unknown.len()), (1, 1, 0));
        assert_eq!(found("the box of the bottle").wanted[0].model, 0);
        // Of two red ones the words alone cannot choose.
        all[1].colors = vec!["red".into()];
        let p = parse_prompt("the red one", &all);
        assert_eq!((p.wanted.len(), p.unknown[0].may_be.clone()), (0, vec![0, 1]));
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
        let (w, u) = found("pick the mug with the green handle up and the bottle");
        assert_eq!(w, vec![2]);
        assert!(u[0].contains("mug shows no green"), "{}", u[0]);
        let (w, u) = found("the cup holder");
        assert!(w.is_empty() && u[0].contains("\"cup holder\" is not in"), "{u:?}");
        let (_, u) = found("the purple one");
        assert!(u[0].contains("colour"), "{}", u[0]);
    }
}
