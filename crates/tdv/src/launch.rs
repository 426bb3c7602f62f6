use crate::arguments::LaunchArgs;
use anyhow::{Context as _, bail};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tdv_runtime::launch::{LaunchFile, Launched, StartOptions};

/// The folder that holds `config/`: that of the launch file's parent, or the working folder.
pub fn share(file: &Path) -> PathBuf {
    let beside = file.canonicalize().ok().and_then(|f| Some(f.parent()?.parent()?.to_owned()));
    beside
        .filter(|p| p.join("config").is_dir())
        .or_else(|| std::env::current_dir().ok())
        .unwrap_or_else(|| PathBuf::from("."))
}

/// Arguments of a launch file, as `NAME:=VALUE`.
pub fn settings(words: &[String]) -> anyhow::Result<BTreeMap<String, String>> {
    let setting = |word: &String| {
        let (name, value) =
            word.split_once(":=").with_context(|| format!("{word:?} is not NAME:=VALUE"))?;
        Ok((name.to_owned(), value.to_owned()))
    };
    words.iter().map(setting).collect()
}

/// Starts the nodes and waits for Ctrl-C or for all of them to end. False when a node failed.
pub fn run(args: &LaunchArgs) -> anyhow::Result<bool> {
    let file = LaunchFile::load(&args.file)?;
    if args.show_args {
        for (name, default, description) in file.arguments() {
            let default = default.map_or("(required)".into(), |d| format!("default {d:?}"));
            println!("  {name:20} {default:24} {description}");
        }
        return Ok(true);
    }
    let settings = settings(&args.arguments)?;
    let commands = file.commands(&settings, &share(&args.file))?;
    let named = |until: &str| commands.iter().any(|c| c.name == until);
    if let Some(until) = args.until.as_deref().filter(|until| !named(until)) {
        let names: Vec<&str> = commands.iter().map(|c| c.name.as_str()).collect();
        bail!("--until {until:?}: the nodes are {}", names.join(", "));
    }
    let options =
        StartOptions { log_folder: args.logs.clone(), ..StartOptions::beside_this_program() };
    let mut launched = Launched::start(&commands, options)?;
    println!("started {}; Ctrl-C ends them", launched.names().join(", "));
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("tokio runtime")?;
    runtime.block_on(async move {
        let mut good = true;
        let (mut left, mut over) = (commands.len(), false);
        let mut terminate =
            tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
        while left > 0 && !over {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => break,
                _ = terminate.recv() => break,
                () = tokio::time::sleep(Duration::from_millis(100)) => {}
            }
            for exit in launched.exited() {
                left -= 1;
                let how = exit.code.map_or("was killed".into(), |c| format!("ended with code {c}"));
                println!("{} {how}", exit.name);
                good &= exit.code == Some(0);
                over |= args.until.as_ref() == Some(&exit.name);
            }
        }
        for name in launched.stop(Duration::from_secs(3)) {
            println!("{name} did not end by itself and was killed");
            good = false;
        }
        Ok(good)
    })
}
