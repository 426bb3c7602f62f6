use crate::arguments::FaultsArgs;
use crate::eval::write_json;
use crate::live_faults;
use indicatif::ProgressBar;
use std::sync::Arc;
use tdv_evaluation::campaign::run_campaign;
use tdv_simulation::{LabAssets, Scene};

/// The fault campaign. True when no case broke anything.
pub fn campaign(args: &FaultsArgs) -> anyhow::Result<bool> {
    if let Some(cases) = args.live {
        return live_faults::campaign(args, cases);
    }
    let assets = Arc::new(LabAssets::load(Scene::load(&args.scene)?)?);
    let bar = ProgressBar::new(args.cases);
    let report = run_campaign(&assets, args.seed, args.cases, &|_| bar.inc(1))?;
    bar.finish_and_clear();
    print!("{}", report.table());
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(report.safe())
}
