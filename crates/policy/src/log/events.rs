//! TensorBoard's event files: records of TFRecord's framing, each a protocol buffer `Event` (fields:
//! 1 wall_time, 2 step, 3 file_version, 5 summary, 7 session_log).

use crate::TrainProgress;
use std::io::{self, Write};

/// Writes events.
pub struct EventWriter<W: Write> {
    into: W,
}

impl<W: Write> EventWriter<W> {
    /// Begins a file at a time (s since 1970). After `resumed_at` steps of an earlier file TensorBoard
    /// forgets what that one says about later steps.
    ///
    /// # Errors
    /// Of the writer.
    pub fn new(into: W, wall_time: f64, resumed_at: Option<usize>) -> io::Result<Self> {
        let mut writer = Self { into };
        writer.record(&event(wall_time, 0, &bytes_field(3, b"brain.Event:2")))?;
        if let Some(step) = resumed_at {
            // SessionLog { status: START }
            writer.record(&event(wall_time, step + 1, &bytes_field(7, &[0x08, 0x01])))?;
        }
        Ok(writer)
    }

    /// Named values of a step.
    ///
    /// # Errors
    /// Of the writer.
    pub fn write(&mut self, wall_time: f64, step: usize, values: &[(&str, f64)]) -> io::Result<()> {
        let mut summary = Vec::new();
        for (tag, value) in values {
            let mut v = bytes_field(1, tag.as_bytes());
            v.push(2 << 3 | 5);
            v.extend((*value as f32).to_le_bytes());
            summary.extend(bytes_field(1, &v));
        }
        self.record(&event(wall_time, step, &bytes_field(5, &summary)))
    }

    /// Hands on what is buffered.
    ///
    /// # Errors
    /// Of the writer.
    pub fn flush(&mut self) -> io::Result<()> {
        self.into.flush()
    }

    fn record(&mut self, data: &[u8]) -> io::Result<()> {
        let length = (data.len() as u64).to_le_bytes();
        self.into.write_all(&length)?;
        self.into.write_all(&masked_crc(&length).to_le_bytes())?;
        self.into.write_all(data)?;
        self.into.write_all(&masked_crc(data).to_le_bytes())
    }
}

/// What is shown of a training step, under the tags that TensorBoard groups by.
pub fn scalars(p: &TrainProgress) -> Vec<(&'static str, f64)> {
    let mut values = vec![
        ("train/loss", p.loss),
        ("train/learning_rate", p.learning_rate),
        ("train/gradient_norm", p.gradient_norm),
        ("train/step_ms", p.step_ms),
    ];
    if let Some(r) = &p.rollout {
        values.push(("rollout/success", r.success_rate()));
        values.push(("rollout/median_position_m", r.median_position));
        values.push(("rollout/median_rotation_rad", r.median_rotation));
        values.push(("rollout/max_position_m", r.max_position));
    }
    values
}

fn event(wall_time: f64, step: usize, content: &[u8]) -> Vec<u8> {
    let mut e = vec![1 << 3 | 1];
    e.extend(wall_time.to_le_bytes());
    // Zero is what an absent number means, and the canonical form leaves it out.
    if step > 0 {
        e.push(2 << 3);
        varint(step as u64, &mut e);
    }
    e.extend(content);
    e
}

fn bytes_field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut f = vec![number << 3 | 2];
    varint(bytes.len() as u64, &mut f);
    f.extend(bytes);
    f
}

fn varint(mut v: u64, into: &mut Vec<u8>) {
    while v >= 0x80 {
        into.push(v as u8 | 0x80);
        v >>= 7;
    }
    into.push(v as u8);
}

/// CRC-32C, rotated and shifted as the framing wants it.
fn masked_crc(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for b in bytes {
        crc ^= u32::from(*b);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 };
        }
    }
    (!crc).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of CRC-32C is e3069283.
    #[test]
    fn checksum() {
        let masked = 0xe306_9283_u32.rotate_right(15).wrapping_add(0xa282_ead8);
        assert_eq!(masked_crc(b"123456789"), masked);
    }

    /// Byte for byte what TensorBoard's own writer makes of the same events, and its reader reads.
    #[test]
    fn equals_the_file_that_tensorboard_writes() {
        let mut file = Vec::new();
        let mut w = EventWriter::new(&mut file, 1.75e9, Some(299)).unwrap();
        for step in [300, 301, 70_000] {
            let loss = 1.0 / step as f64;
            let values = [("train/loss", loss), ("rollout/success", 0.975)];
            w.write(1.75e9 + step as f64 * 0.125, step, &values).unwrap();
        }
        let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../tests/golden/events/golden.tfevents");
        assert_eq!(file, std::fs::read(golden).unwrap());
    }
}
