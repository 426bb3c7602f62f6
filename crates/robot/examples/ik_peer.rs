//! Writes random poses and all our joint solutions to standard output, for tests/peers/ik_peer.py.
//!
//! `ik_peer ARM COUNT SEED`, ARM is ur5 or ur5e. Each record, little-endian f64: the matrix
//! `T_base_tool0` (16, row-major, UR controller frame), the number of solutions, then six angles each.

use rand::{Rng, SeedableRng};
use std::f64::consts::PI;
use std::io::Write;
use tdv_robot::{Joints, Kinematics, base_link_to_base};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, arm, count, seed] = args.as_slice() else {
        return Err("usage: ik_peer ARM COUNT SEED".into());
    };
    let k = match arm.as_str() {
        "ur5" => Kinematics::ur5(),
        "ur5e" => Kinematics::ur5e(),
        other => return Err(format!("arm {other}: expected ur5 or ur5e").into()),
    };
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed.parse()?);
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    for _ in 0..count.parse::<usize>()? {
        let q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
        let target = k.fk(&q);
        // Column-major of the transpose is row-major of the matrix.
        let rows = (base_link_to_base().inverse() * target).to_homogeneous().transpose();
        let solutions = k.ik(&target);
        let numbers = rows.iter().copied().chain([solutions.len() as f64]);
        for v in numbers.chain(solutions.iter().flatten().copied()) {
            out.write_all(&v.to_le_bytes())?;
        }
    }
    Ok(out.flush()?)
}
