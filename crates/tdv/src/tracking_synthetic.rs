//! `tdv eval tracking --synthetic`: the benchmark with exact truth, sequence by sequence; a run that was
//! cut short goes on where it stopped.

use crate::arguments::TrackingArgs;
use crate::eval::write_json;
use anyhow::Context as _;
use std::path::Path;
use tdv_evaluation::tracking_synthetic::{
    KINDS, SequenceResult, SyntheticConfig, SyntheticError, SyntheticReport, objects, run as follow,
};

/// Runs what is not there yet, prints the table; false when a target is missed.
pub fn run(args: &TrackingArgs) -> anyhow::Result<bool> {
    let config =
        SyntheticConfig { frames: args.frames, seed: args.seed, ..SyntheticConfig::default() };
    let all = objects();
    let known: Vec<&str> = all.iter().map(|o| o.name).collect();
    let names: Vec<&str> = args.object.split(',').map(str::trim).collect();
    let every = names == ["all"];
    if let Some(name) = names.iter().find(|n| !every && !known.contains(n)) {
        return Err(SyntheticError::Object { name: (*name).into(), known: known.join(", ") }.into());
    }
    let wanted = sequences(&args.sequences)?;
    let folder = args.run.join("synthetic");
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let mut results = Vec::new();
    for (number, object) in all.iter().enumerate() {
        if !every && !names.contains(&object.name) {
            continue;
        }
        for index in &wanted {
            let path = folder
                .join(format!("{}_{index}_{}x{}.json", object.name, config.seed, config.frames));
            let result = match kept(&path)? {
                Some(result) => result,
                None => {
                    let result = follow(object, number, *index, &config, |_| {})?;
                    write_json(&path, &result)?;
                    println!("{} {index}: {} frames", object.name, result.frames.len());
                    result
                }
            };
            results.push(result);
        }
    }
    let report = SyntheticReport::new(results);
    print!("{}", report.table());
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(report.met())
}

/// A finished sequence of an earlier run.
fn kept(path: &Path) -> anyhow::Result<Option<SequenceResult>> {
    if !path.is_file() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let result = serde_json::from_str(&text).with_context(|| {
        format!("{}: not a result of this benchmark; remove it", path.display())
    })?;
    Ok(Some(result))
}

/// "all" or numbers with commas.
fn sequences(text: &str) -> anyhow::Result<Vec<usize>> {
    if text == "all" {
        return Ok((0..KINDS.len()).collect());
    }
    text.split(',')
        .map(|t| {
            let n: usize = t.trim().parse().with_context(|| format!("--sequences {text:?}"))?;
            anyhow::ensure!(n < KINDS.len(), "--sequences: there are 0 to {}", KINDS.len() - 1);
            Ok(n)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_sequences_are_checked() {
        assert_eq!(sequences("all").unwrap(), vec![0, 1, 2, 3, 4]);
        assert_eq!(sequences("2, 0").unwrap(), vec![2, 0]);
        assert!(sequences("5").is_err());
        assert!(sequences("x").is_err());
    }
}
