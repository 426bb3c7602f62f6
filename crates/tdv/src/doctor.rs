use crate::arguments::DoctorArgs;
use std::net::TcpListener;
use std::path::Path;
use std::process::Command;
use tdv_perception::Catalogue;
use tdv_perception::availability::availability;
use tdv_perception::hands::HandDetector;
use tdv_policy::text::{Pooling, TextEncoder};
use tdv_runtime::Environment;

struct Findings {
    good: bool,
}

impl Findings {
    fn say(&mut self, what: &str, outcome: Result<String, String>, needed: bool) {
        match outcome {
            Ok(text) => println!("  ok       {what}: {text}"),
            Err(text) if needed => {
                self.good = false;
                println!("  MISSING  {what}: {text}");
            }
            Err(text) => println!("  optional {what}: {text}"),
        }
    }
}

/// Checks what the demo and the graph need. False when something needed is missing.
pub fn run(args: &DoctorArgs) -> anyhow::Result<bool> {
    let mut f = Findings { good: true };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    f.say("processor", Ok(format!("{cores} cores")), true);
    f.say(
        "environment",
        Environment::read()
            .map(|e| format!("ROS_DOMAIN_ID {}, discovery {:?}", e.domain, e.range))
            .map_err(|e| e.to_string()),
        true,
    );
    f.say("object catalogue", catalogue(&args.objects), true);
    let hands = HandDetector::load(
        &args.hand_models.join("palm_detection_full.tflite"),
        &args.hand_models.join("hand_landmark_full.tflite"),
    );
    f.say(
        "hand networks",
        hands
            .map(|_| args.hand_models.display().to_string())
            .map_err(|e| format!("{e}; launch_scripts/fetch_hand_models.sh gets them")),
        true,
    );
    let text = TextEncoder::load(&args.text_model, Pooling::Mean);
    f.say(
        "sentence encoder",
        text.map(|_| args.text_model.display().to_string())
            .map_err(|e| format!("{e}; launch_scripts/fetch_text_model.sh gets one")),
        false,
    );
    // The classical chain runs without any of them.
    for found in availability(&args.models) {
        f.say(&format!("learned backend {}", found.backend), found.state, false);
    }
    f.say("onnxruntime", onnxruntime(), false);
    for (what, port) in [("RTDE", 30004), ("gripper", 63352), ("dashboard", 29999)] {
        f.say(
            &format!("{what} port {port} on 127.0.0.1"),
            TcpListener::bind(("127.0.0.1", port))
                .map(|_| "free for the virtual lab".into())
                .map_err(|e| format!("{e}; is a virtual lab running?")),
            true,
        );
    }
    let ros = Command::new("ros2").arg("--help").output();
    f.say(
        "ros2 command",
        ros.map(|_| "found".into()).map_err(|_| {
            "not found; the graph runs without it. With it, set \
             FASTRTPS_DEFAULT_PROFILES_FILE=config/fastdds_bigbuf.xml to see whole images"
                .into()
        }),
        false,
    );
    println!("{}", if f.good { "ready" } else { "not ready" });
    Ok(f.good)
}

fn catalogue(folder: &Path) -> Result<String, String> {
    let catalogue = Catalogue::load(folder).map_err(|e| e.to_string())?;
    let names: Vec<&str> = catalogue.models.iter().map(|m| m.name.as_str()).collect();
    Ok(names.join(", "))
}

/// The library that GroundingDINO and SAM2 run in, where the feature `onnx` of tdv-foundation looks for it.
fn onnxruntime() -> Result<String, String> {
    let how = "launch_scripts/fetch_onnxruntime.sh gets it and prints the line that sets it";
    let path = std::env::var_os("ORT_DYLIB_PATH")
        .ok_or_else(|| format!("ORT_DYLIB_PATH is not set; {how}"))?;
    let path = Path::new(&path);
    if path.is_file() {
        Ok(path.display().to_string())
    } else {
        Err(format!("ORT_DYLIB_PATH names {}, which is no file; {how}", path.display()))
    }
}
