//! BertModel's forward pass for one sentence, and the pooling that makes one vector of its tokens.

use super::{TextError, WordPiece};
use crate::kernels::{AttentionShape, add, attention, fill_rows, matmul};
use safetensors::tensor::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How a sentence's vector comes from those of its tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pooling {
    /// Mean of all tokens, scaled to length 1: what all-MiniLM-L6-v2 was trained for.
    #[default]
    Mean,
    /// The first token as it is: for plain BERT.
    Cls,
}

/// What is read of `config.json`; the rest does not change the result.
#[derive(Debug, Deserialize)]
struct Config {
    hidden_size: usize,
    num_hidden_layers: usize,
    num_attention_heads: usize,
    intermediate_size: usize,
    vocab_size: usize,
    max_position_embeddings: usize,
    #[serde(default = "default_eps")]
    layer_norm_eps: f64,
    #[serde(default = "default_activation")]
    hidden_act: String,
    #[serde(default = "default_position")]
    position_embedding_type: String,
}

fn default_eps() -> f64 {
    1e-12
}

fn default_activation() -> String {
    "gelu".into()
}

fn default_position() -> String {
    "absolute".into()
}

/// Weights `[inputs, outputs]`, turned from the file's `[outputs, inputs]`.
struct Linear {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Linear {
    fn apply(&self, x: &[f32], rows: usize) -> Vec<f32> {
        let (outputs, inputs) = (self.bias.len(), self.weight.len() / self.bias.len());
        let mut y = vec![0.0; rows * outputs];
        fill_rows(&self.bias, &mut y);
        matmul(x, &self.weight, &mut y, [rows, inputs, outputs], true);
        y
    }
}

struct Norm {
    scale: Vec<f32>,
    shift: Vec<f32>,
    eps: f64,
}

impl Norm {
    fn apply(&self, x: &mut [f32]) {
        let d = self.scale.len();
        for row in x.chunks_exact_mut(d) {
            let mean = row.iter().map(|v| f64::from(*v)).sum::<f64>() / d as f64;
            let variance =
                row.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / d as f64;
            let r = 1.0 / (variance + self.eps).sqrt();
            for ((v, scale), shift) in row.iter_mut().zip(&self.scale).zip(&self.shift) {
                *v = ((f64::from(*v) - mean) * r) as f32 * scale + shift;
            }
        }
    }
}

struct Layer {
    /// Query, key and value side by side.
    qkv: Linear,
    out: Linear,
    attention_norm: Norm,
    up: Linear,
    down: Linear,
    output_norm: Norm,
}

/// A model of the BERT family with its tokenizer: text in, vector out.
pub struct TextEncoder {
    name: String,
    tokenizer: WordPiece,
    pooling: Pooling,
    width: usize,
    heads: usize,
    positions: usize,
    words: Vec<f32>,
    /// Positions plus the vector of token type 0, `[positions, width]`.
    places: Vec<f32>,
    norm: Norm,
    layers: Vec<Layer>,
}

impl TextEncoder {
    /// Reads a folder with `config.json`, `vocab.txt` or `tokenizer.json`, and `model.safetensors`
    /// (f32, names as BertModel or BertFor... give them).
    ///
    /// # Errors
    /// [`TextError::Io`], [`TextError::Model`] naming file and fault.
    pub fn load(folder: &Path, pooling: Pooling) -> Result<Self, TextError> {
        let path = folder.join("config.json");
        let bytes =
            std::fs::read(&path).map_err(|source| TextError::Io { path: path.clone(), source })?;
        let fail = |problem: String| TextError::Model { path: path.clone(), problem };
        let c: Config = serde_json::from_slice(&bytes).map_err(|e| fail(e.to_string()))?;
        c.check().map_err(fail)?;
        let tokenizer = WordPiece::load(folder)?;
        if tokenizer.size() > c.vocab_size {
            let (have, room) = (tokenizer.size(), c.vocab_size);
            return Err(fail(format!("vocab_size is {room}, the vocabulary has {have} pieces")));
        }
        let path = folder.join("model.safetensors");
        let bytes =
            std::fs::read(&path).map_err(|source| TextError::Io { path: path.clone(), source })?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self::from_tensors(&c, &bytes, tokenizer, pooling, name)
            .map_err(|problem| TextError::Model { path, problem })
    }

    fn from_tensors(
        c: &Config,
        bytes: &[u8],
        tokenizer: WordPiece,
        pooling: Pooling,
        name: String,
    ) -> Result<Self, String> {
        let file = Tensors {
            tensors: SafeTensors::deserialize(bytes)
                .map_err(|e| format!("not a readable safetensors file ({e}); is it complete?"))?,
        };
        let (d, wide) = (c.hidden_size, c.intermediate_size);
        let linear = |name: &str, inputs: usize, outputs: usize| -> Result<Linear, String> {
            Ok(Linear {
                weight: transposed(
                    &file.read(&format!("{name}.weight"), &[outputs, inputs])?,
                    inputs,
                ),
                bias: file.read(&format!("{name}.bias"), &[outputs])?,
            })
        };
        let norm = |name: &str| -> Result<Norm, String> {
            Ok(Norm {
                scale: file.read(&format!("{name}.weight"), &[d])?,
                shift: file.read(&format!("{name}.bias"), &[d])?,
                eps: c.layer_norm_eps,
            })
        };
        let mut places =
            file.read("embeddings.position_embeddings.weight", &[c.max_position_embeddings, d])?;
        // Sentences alone are all of type 0; how many types there are does not matter.
        let kind = file.rows("embeddings.token_type_embeddings.weight", d)?;
        for row in places.chunks_exact_mut(d) {
            add(&kind[..d], row);
        }
        let layers = (0..c.num_hidden_layers)
            .map(|i| {
                let at = |part: &str| format!("encoder.layer.{i}.{part}");
                let [q, k, v] = ["query", "key", "value"]
                    .map(|part| linear(&at(&format!("attention.self.{part}")), d, d));
                Ok(Layer {
                    qkv: side_by_side(&[q?, k?, v?], d),
                    out: linear(&at("attention.output.dense"), d, d)?,
                    attention_norm: norm(&at("attention.output.LayerNorm"))?,
                    up: linear(&at("intermediate.dense"), d, wide)?,
                    down: linear(&at("output.dense"), wide, d)?,
                    output_norm: norm(&at("output.LayerNorm"))?,
                })
            })
            .collect::<Result<_, String>>()?;
        Ok(Self {
            name,
            tokenizer,
            pooling,
            width: d,
            heads: c.num_attention_heads,
            positions: c.max_position_embeddings,
            words: file.read("embeddings.word_embeddings.weight", &[c.vocab_size, d])?,
            places,
            norm: norm("embeddings.LayerNorm")?,
            layers,
        })
    }

    /// Name of the model's folder.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Numbers of an embedding.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The text's embedding, [`TextEncoder::width`] numbers. Equal texts give equal bytes on equal
    /// processors.
    ///
    /// # Errors
    /// [`TextError::Empty`], [`TextError::TooLong`].
    pub fn embed(&self, text: &str) -> Result<Vec<f32>, TextError> {
        if text.trim().is_empty() {
            return Err(TextError::Empty);
        }
        let ids = self.tokenizer.encode(text);
        if ids.len() > self.positions {
            return Err(TextError::TooLong { tokens: ids.len(), limit: self.positions });
        }
        let x = self.forward(&ids);
        if self.pooling == Pooling::Cls {
            return Ok(x[..self.width].to_vec());
        }
        let mut sum = vec![0.0f64; self.width];
        for row in x.chunks_exact(self.width) {
            sum.iter_mut().zip(row).for_each(|(s, v)| *s += f64::from(*v));
        }
        let norm = sum.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
        Ok(sum.iter().map(|v| (v / norm) as f32).collect())
    }

    /// Last hidden state `[tokens, width]`.
    fn forward(&self, ids: &[u32]) -> Vec<f32> {
        let (n, d) = (ids.len(), self.width);
        let mut x = self.places[..n * d].to_vec();
        for (row, id) in x.chunks_exact_mut(d).zip(ids) {
            add(&self.words[*id as usize * d..][..d], row);
        }
        self.norm.apply(&mut x);
        let shape = AttentionShape { batch: 1, tokens: n, heads: self.heads, head: d / self.heads };
        let mut scratch = vec![0.0; shape.scratch()];
        let mut mixed = vec![0.0; n * d];
        for layer in &self.layers {
            attention(shape, &layer.qkv.apply(&x, n), &mut mixed, &mut scratch);
            add(&layer.out.apply(&mixed, n), &mut x);
            layer.attention_norm.apply(&mut x);
            let mut wide = layer.up.apply(&x, n);
            wide.iter_mut().for_each(|v| *v = gelu(*v));
            add(&layer.down.apply(&wide, n), &mut x);
            layer.output_norm.apply(&mut x);
        }
        x
    }
}

impl Config {
    fn check(&self) -> Result<(), String> {
        for (name, value, high) in [
            ("hidden_size", self.hidden_size, 8192),
            ("num_hidden_layers", self.num_hidden_layers, 96),
            ("num_attention_heads", self.num_attention_heads, 256),
            ("intermediate_size", self.intermediate_size, 65_536),
            ("vocab_size", self.vocab_size, 1 << 22),
            ("max_position_embeddings", self.max_position_embeddings, 1 << 16),
        ] {
            if !(1..=high).contains(&value) {
                return Err(format!("{name} is {value}, must be 1..={high}"));
            }
        }
        let (d, heads) = (self.hidden_size, self.num_attention_heads);
        if !d.is_multiple_of(heads) || !(d / heads).is_multiple_of(16) {
            return Err(format!("{d} over {heads} heads: their width must be a multiple of 16"));
        }
        if self.hidden_act != "gelu" {
            return Err(format!("hidden_act is `{}`, only `gelu` is known", self.hidden_act));
        }
        if self.position_embedding_type != "absolute" {
            let kind = &self.position_embedding_type;
            return Err(format!("position_embedding_type is `{kind}`, only `absolute` is known"));
        }
        Ok(())
    }
}

struct Tensors<'a> {
    tensors: SafeTensors<'a>,
}

impl Tensors<'_> {
    fn read(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
        // Checkpoints of BertFor... put the model under `bert.`.
        let view = self
            .tensors
            .tensor(name)
            .or_else(|_| self.tensors.tensor(&format!("bert.{name}")))
            .map_err(|_| format!("tensor `{name}` is missing; is it a BERT model?"))?;
        if view.dtype() != Dtype::F32 || view.shape() != shape {
            let (dtype, found) = (view.dtype(), view.shape());
            return Err(format!(
                "tensor `{name}` is {dtype:?} {found:?}, config.json asks for f32 {shape:?}"
            ));
        }
        let (chunks, _) = view.data().as_chunks::<4>();
        let values: Vec<f32> = chunks.iter().map(|c| f32::from_le_bytes(*c)).collect();
        if values.iter().any(|v| !v.is_finite()) {
            return Err(format!("tensor `{name}` holds values that are not finite"));
        }
        Ok(values)
    }

    /// A table of however many rows, at least one.
    fn rows(&self, name: &str, width: usize) -> Result<Vec<f32>, String> {
        let view = self.tensors.tensor(name);
        let view = view.or_else(|_| self.tensors.tensor(&format!("bert.{name}")));
        let rows = view.ok().and_then(|v| v.shape().first().copied()).unwrap_or(1).max(1);
        self.read(name, &[rows, width])
    }
}

fn transposed(w: &[f32], columns: usize) -> Vec<f32> {
    let rows = w.len() / columns;
    let mut t = vec![0.0; w.len()];
    for (r, row) in w.chunks_exact(columns).enumerate() {
        for (c, v) in row.iter().enumerate() {
            t[c * rows + r] = *v;
        }
    }
    t
}

fn side_by_side(parts: &[Linear], inputs: usize) -> Linear {
    let rows = |l: &Linear, i: usize| {
        let n = l.bias.len();
        l.weight[i * n..(i + 1) * n].to_vec()
    };
    Linear {
        weight: (0..inputs).flat_map(|i| parts.iter().flat_map(move |l| rows(l, i))).collect(),
        bias: parts.iter().flat_map(|l| l.bias.iter().copied()).collect(),
    }
}

/// The exact form, `x Phi(x)`; the policy's own network uses the tanh form.
fn gelu(x: f32) -> f32 {
    let x = f64::from(x);
    (0.5 * x * (1.0 + erf(x / std::f64::consts::SQRT_2))) as f32
}

/// Error function: `2/sqrt(pi) exp(-x^2) sum 2^n x^(2n+1) / (2n+1)!!`, all terms of one sign.
fn erf(x: f64) -> f64 {
    if x.abs() > 5.0 {
        return x.signum();
    }
    let (mut term, mut sum, mut n) = (x, x, 1.0);
    while term.abs() > 1e-17 * sum.abs() {
        term *= 2.0 * x * x / (2.0 * n + 1.0);
        sum += term;
        n += 1.0;
    }
    std::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp() * sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    #[derive(Deserialize)]
    struct Golden {
        sentences: Vec<Sentence>,
    }

    #[derive(Deserialize)]
    struct Sentence {
        text: String,
        ids: Vec<u32>,
        mean: Vec<f32>,
        cls: Vec<f32>,
    }

    fn root() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
    }

    /// Same pieces, and vectors within `limit` of the golden ones; the worst difference.
    fn compare(folder: &Path, golden: &Path, limit: f32) -> f32 {
        let golden: Golden = serde_json::from_slice(&std::fs::read(golden).unwrap()).unwrap();
        assert!(golden.sentences.len() >= 5);
        let mean = TextEncoder::load(folder, Pooling::Mean).unwrap();
        let cls = TextEncoder::load(folder, Pooling::Cls).unwrap();
        let mut worst = 0.0f32;
        for s in &golden.sentences {
            assert_eq!(mean.tokenizer.encode(&s.text), s.ids, "{:?}", s.text);
            for (encoder, want) in [(&mean, &s.mean), (&cls, &s.cls)] {
                let got = encoder.embed(&s.text).unwrap();
                assert_eq!(got.len(), want.len());
                for (a, b) in got.iter().zip(want) {
                    worst = worst.max((a - b).abs());
                    assert!((a - b).abs() < limit, "{:?}: {a} {b}", s.text);
                }
            }
        }
        worst
    }

    #[test]
    fn a_small_random_model_equals_pytorch() {
        let folder = root().join("tests/golden/text/tiny");
        let worst = compare(&folder, &root().join("tests/golden/text/tiny.json"), 1e-5);
        println!("largest difference {worst:.1e}");
    }

    #[test]
    fn the_real_weights_equal_pytorch() {
        let folder = root().join("models/text");
        if !folder.join("model.safetensors").exists() {
            println!("skipped: no models/text; launch_scripts/fetch_text_model.sh gets it");
            return;
        }
        let worst = compare(&folder, &root().join("tests/golden/text/minilm.json"), 1e-5);
        println!("largest difference {worst:.1e}");
        let encoder = TextEncoder::load(&folder, Pooling::Mean).unwrap();
        let cosine = |a: &str, b: &str| -> f32 {
            let (a, b) = (encoder.embed(a).unwrap(), encoder.embed(b).unwrap());
            a.iter().zip(&b).map(|(a, b)| a * b).sum()
        };
        let pour = "pour water from the bottle into the cup";
        let near = cosine(pour, "pour the bottle into the mug");
        let far = cosine(pour, "insert the peg into the hole");
        assert!(near > 0.8 && far < 0.45, "{near} {far}");
    }

    #[test]
    fn bad_texts_and_folders_are_refused() {
        let folder = root().join("tests/golden/text/tiny");
        let encoder = TextEncoder::load(&folder, Pooling::Mean).unwrap();
        assert!(matches!(encoder.embed(" \t"), Err(TextError::Empty)));
        let long = "mug ".repeat(200);
        assert!(matches!(encoder.embed(&long), Err(TextError::TooLong { tokens: 202, .. })));
        let dir = tempfile::tempdir().unwrap();
        let load = || match TextEncoder::load(dir.path(), Pooling::Mean) {
            Ok(_) => panic!("loaded"),
            Err(e) => e.to_string(),
        };
        assert!(load().contains("config.json"), "{}", load());
        for file in ["config.json", "vocab.txt", "model.safetensors"] {
            std::fs::copy(folder.join(file), dir.path().join(file)).unwrap();
        }
        TextEncoder::load(dir.path(), Pooling::Mean).unwrap();
        let config = std::fs::read_to_string(folder.join("config.json")).unwrap();
        let write = |from: &str, to: &str| {
            assert!(config.contains(from));
            std::fs::write(dir.path().join("config.json"), config.replace(from, to)).unwrap();
        };
        write("\"gelu\"", "\"relu\"");
        assert!(load().contains("`relu`"), "{}", load());
        write("\"num_hidden_layers\": 2", "\"num_hidden_layers\": 3");
        assert!(load().contains("`encoder.layer.2."), "{}", load());
        write("\"intermediate_size\": 48", "\"intermediate_size\": 64");
        assert!(load().contains("asks for f32 [64, 32]"), "{}", load());
        write("\"num_attention_heads\": 2", "\"num_attention_heads\": 3");
        assert!(load().contains("32 over 3 heads"), "{}", load());
        std::fs::write(dir.path().join("config.json"), &config).unwrap();
        let weights = std::fs::read(folder.join("model.safetensors")).unwrap();
        std::fs::write(dir.path().join("model.safetensors"), &weights[..500]).unwrap();
        assert!(load().contains("is it complete"), "{}", load());
    }

    #[test]
    fn error_function() {
        // Abramowitz and Stegun, table 7.1.
        for (x, want) in [(0.0, 0.0), (0.5, 0.5204998778), (1.0, 0.8427007929), (2.0, 0.9953222650)]
        {
            assert!((erf(x) - want).abs() < 1e-10 && (erf(-x) + want).abs() < 1e-10);
        }
        assert_eq!(erf(6.0), 1.0);
    }
}
