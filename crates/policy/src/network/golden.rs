//! The network against the same one in PyTorch: `tests/compare/policy_torch.py golden` made the data.

use super::{Architecture, Batch, Dimensions, Workspace};
use crate::normaliser::POSE_DIM;
use crate::{PolicyConfig, kernels};
use safetensors::tensor::SafeTensors;
use std::path::Path;

/// Numbers in -0.5..0.5 by the formula of the script.
fn number(n: usize, salt: u64) -> Vec<f32> {
    const MASK: u64 = 0xffff_ffff;
    (0..n as u64)
        .map(|i| {
            let h = (i * 2_654_435_761 + salt * 40503 + 12345) & MASK;
            let h = (h * 1_103_515_245 + 12345) & MASK;
            ((h >> 8) as f64 / f64::from(1 << 24) - 0.5) as f32
        })
        .collect()
}

fn read(file: &SafeTensors, name: &str) -> Vec<f32> {
    let view = file.tensor(name).unwrap();
    let (chunks, _) = view.data().as_chunks::<4>();
    chunks.iter().map(|c| f32::from_le_bytes(*c)).collect()
}

/// Every weight random, so that no gradient is zero by chance; two tasks, two procedures.
#[test]
fn output_and_every_gradient_equal_pytorch() {
    let config = PolicyConfig {
        history: 5,
        horizon: 7,
        d_model: 32,
        heads: 2,
        encoder_layers: 1,
        decoder_layers: 2,
        ..PolicyConfig::small()
    };
    let a = Architecture::new(&config, Dimensions { procedures: 2, text: 12 }).unwrap();
    let mut flat = vec![0.0; a.len()];
    for (salt, p) in a.parameters().iter().enumerate() {
        let values = a.values_mut(p, &mut flat);
        for (v, r) in values.iter_mut().zip(number(p.shape.iter().product(), salt as u64)) {
            *v = 0.5 * r;
        }
    }
    let (history, target, text) =
        (number(3 * 5 * POSE_DIM, 101), number(3 * 7 * POSE_DIM, 103), number(24, 104));
    let noisy: Vec<f32> = number(3 * 7 * POSE_DIM, 102).iter().map(|v| 2.0 * v).collect();
    let batch = Batch {
        len: 3,
        history: &history,
        procedure: &[0, 1, 0],
        noisy: &noisy,
        step: &[0, 57, 99],
        text: Some(&text),
        task: &[1, 0, 1],
    };
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/policy/network.safetensors");
    let bytes = std::fs::read(path).unwrap();
    let golden = SafeTensors::deserialize(&bytes).unwrap();
    let mut w = Workspace::new(&a, 3);
    w.forward(&a, &flat, &batch);
    let mut worst_output = 0.0f32;
    for (got, want) in w.output.iter().zip(read(&golden, "output")) {
        worst_output = worst_output.max((got - want).abs());
    }
    assert!(worst_output < 1e-5, "{worst_output}");
    let mut weights = [1.0 / (3.0 * 7.0 * POSE_DIM as f32); POSE_DIM];
    weights[0] *= 2.0;
    let mut grads = vec![0.0; a.len()];
    let loss = w.backward(&a, &flat, &batch, &target, &weights, &mut grads);
    let want = f64::from(read(&golden, "loss")[0]);
    assert!((loss - want).abs() < 1e-5 * want, "{loss} {want}");
    // Output and loss, and a gradient for each tensor: none is left out on either side.
    assert_eq!(golden.len(), a.parameters().len() + 2);
    let mut worst = 0.0f32;
    for p in a.parameters() {
        let want = read(&golden, &format!("gradient/{}", p.name));
        let got = a.values(p, &grads);
        assert_eq!(got.len(), want.len(), "{}", p.name);
        let size = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(size > 1e-7, "{} has no gradient in PyTorch", p.name);
        let off = got.iter().zip(&want).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / size;
        worst = worst.max(off);
        assert!(off < 1e-4, "{}: gradient off by {off}", p.name);
    }
    println!(
        "{:?}: largest difference of outputs {worst_output:.1e}, of gradients {worst:.1e} of their size",
        kernels::simd_level()
    );
}
