use serde::Serialize;
use std::io::{self, Write};

/// One record, one line.
///
/// # Errors
/// Of the writer.
pub fn append_line(into: &mut impl Write, record: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(record).map_err(io::Error::other)?;
    line.push(b'\n');
    into.write_all(&line)
}

/// The lines of a log up to and including `step`, for a training that goes on from there: what a
/// broken-off run wrote beyond it will be written again. A line that was cut off ends the log.
pub fn keep_until(log: &str, step: usize) -> String {
    let whole = log.split_inclusive('\n').filter(|l| l.ends_with('\n'));
    whole
        .take_while(|line| {
            let record: Option<serde_json::Value> = serde_json::from_str(line).ok();
            let at = record.and_then(|r| r.get("step").and_then(serde_json::Value::as_u64));
            at.is_some_and(|s| s <= step as u64)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Record {
        step: usize,
        loss: f64,
    }

    #[test]
    fn a_log_goes_on_where_the_training_does() {
        let mut log = Vec::new();
        for step in 1..=4 {
            append_line(&mut log, &Record { step, loss: 1.0 / step as f64 }).unwrap();
        }
        let mut log = String::from_utf8(log).unwrap();
        assert!(log.starts_with("{\"step\":1,\"loss\":1.0}\n"));
        log.push_str("{\"step\":5,\"lo");
        assert_eq!(keep_until(&log, 9).lines().count(), 4);
        assert_eq!(keep_until(&log, 2).lines().last(), Some("{\"step\":2,\"loss\":0.5}"));
        assert_eq!(keep_until(&log, 0), "");
    }
}
