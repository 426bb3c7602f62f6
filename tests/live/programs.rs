//! The programs under test, and a model to run them with.

use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tdv_evaluation::STOLEN_MS;
use tdv_runtime::host::StolenTime;

/// The repository.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new(".."))
}

/// A program of the workspace.
///
/// # Panics
/// When it has not been built: cargo builds the programs of other packages only when asked to.
pub fn program(name: &str) -> PathBuf {
    let here = std::env::current_exe().expect("the path of this test");
    let folder = here.parent().and_then(Path::parent).expect("target/PROFILE/deps");
    let path = folder.join(name);
    assert!(path.is_file(), "{} is missing: run `cargo build --workspace --bins`", path.display());
    path
}

/// A graph needs the whole machine and the lab's ports: one at a time.
pub fn machine() -> MutexGuard<'static, ()> {
    static MACHINE: Mutex<()> = Mutex::new(());
    MACHINE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// How often a claim is tried on a machine that keeps being taken away, and how long all tests together
/// may spend on attempts that did not count.
const ATTEMPTS: usize = 4;
const PATIENCE: Duration = Duration::from_secs(600);

/// Checks what only a running machine can show. A virtual machine whose host gives its cores to others
/// stands still for tenths of a second, which says nothing about the programs: an attempt that fails
/// while that happened is made again, as long as patience lasts. A claim that no attempt could decide is
/// said not to be measured; on a machine of its own the first attempt decides.
///
/// # Panics
/// As `attempt` does, when the machine was there all the time.
pub fn holds(claim: &str, mut attempt: impl FnMut()) {
    static WASTED: Mutex<Duration> = Mutex::new(Duration::ZERO);
    let mut stolen = 0.0;
    for k in 1..=ATTEMPTS {
        let result;
        let began = Instant::now();
        (result, stolen) = beside_stolen_time(|| catch_unwind(AssertUnwindSafe(&mut attempt)));
        match result {
            Ok(()) => return,
            Err(panic) if stolen <= STOLEN_MS => resume_unwind(panic),
            Err(_) => println!(
                "{claim}: attempt {k} does not count: the machine's host took {stolen:.0} ms of CPU time \
                 within a second"
            ),
        }
        let mut wasted = WASTED.lock().unwrap_or_else(PoisonError::into_inner);
        *wasted += began.elapsed();
        if *wasted > PATIENCE {
            break;
        }
    }
    println!(
        "skipped: {claim}: not measured, the machine's host took up to {stolen:.0} ms each time"
    );
}

/// What `work` gives, and the most CPU time (ms) that the host took within a second meanwhile.
fn beside_stolen_time<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut stolen = StolenTime::start();
            while !over.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(100));
                stolen.look();
            }
            stolen.worst_ms()
        });
        let result = work();
        over.store(true, Ordering::Relaxed);
        (result, watch.join().unwrap_or(0.0))
    })
}

/// A command in the repository whose graph, if it has one, is nobody else's.
pub fn command(name: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(program(name));
    command
        .args(arguments)
        .current_dir(repository())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("ROS_DOMAIN_ID", (101 + std::process::id() % 60).to_string())
        .stdin(Stdio::null());
    command
}

/// Runs a command to its end, for at most `patience`, and gives its code and everything it said.
///
/// # Panics
/// When it does not end in time.
pub fn run(name: &str, arguments: &[&str], patience: Duration) -> (Option<i32>, String) {
    let mut child = command(name, arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Read while it runs: a full pipe would stop it.
    let said = [collect(child.stdout.take()), collect(child.stderr.take())];
    let said = || said.map(|t| t.join().unwrap_or_default()).join("\n");
    let began = Instant::now();
    loop {
        if let Some(status) = child.try_wait().expect("the state of a child") {
            return (status.code(), said());
        }
        if began.elapsed() > patience {
            let _ = child.kill();
            let _ = child.wait();
            panic!("{name} {arguments:?} did not end within {patience:?}; it said:\n{}", said());
        }
        thread::sleep(Duration::from_millis(20));
    }
}

/// Everything that comes out of a pipe, read by a thread of its own.
fn collect(pipe: Option<impl Read + Send + 'static>) -> JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut pipe) = pipe {
            let _ = pipe.read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// A folder with a policy for the cup task, taught from the recorded demonstration once per build;
/// none, with a message, where the hand networks are absent.
///
/// # Panics
/// When teaching fails.
pub fn model() -> Option<&'static Path> {
    static MODEL: OnceLock<Option<PathBuf>> = OnceLock::new();
    MODEL
        .get_or_init(|| {
            let networks = repository().join("models/hands/hand_landmark_full.tflite");
            if !networks.is_file() {
                println!(
                    "skipped: no hand networks; launch_scripts/fetch_hand_models.sh gets them"
                );
                return None;
            }
            let folder = program("tdv").with_file_name("test_model");
            if newer(&folder.join("policy.safetensors"), &program("tdv")) {
                return Some(folder);
            }
            let out = folder.display().to_string();
            let task = "config/tasks/cup_on_coaster.yaml";
            let bag = "rosbags/cup_on_coaster";
            let arguments = ["teach", "--task", task, "--bag", bag, "--out", &out];
            let (code, said) = run("tdv", &arguments, Duration::from_secs(600));
            assert_eq!(code, Some(0), "{said}");
            Some(folder)
        })
        .as_deref()
}

fn newer(a: &Path, b: &Path) -> bool {
    let time = |p: &Path| p.metadata().and_then(|m| m.modified());
    matches!((time(a), time(b)), (Ok(a), Ok(b)) if a > b)
}

/// A JSON file.
///
/// # Panics
/// When it is missing or broken.
pub fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).expect("a result file");
    serde_json::from_str(&text).expect("JSON")
}
