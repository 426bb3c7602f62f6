use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;
use tdv_simulation::controller::Generation;

/// Learn a manipulation task from one human RGB-D recording and carry it out in closed loop on a UR5.
#[derive(Parser)]
#[command(version, about, max_term_width = 100)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Parse a recording, multiply it, train the policies, write a report page
    Teach(TeachArgs),
    /// Teach from a recording and carry the task out once in the virtual lab
    Demo(DemoArgs),
    /// Start the nodes of a launch file and keep watch over them
    Launch(LaunchArgs),
    /// Record topics of the running graph into a bag
    Record(RecordArgs),
    /// Render a human demonstration in the virtual lab into a bag
    RecordDemo(RecordDemoArgs),
    /// Measure
    #[command(subcommand)]
    Eval(EvalCommand),
    /// Work on the object catalogue
    #[command(subcommand)]
    Object(ObjectCommand),
    /// Find the camera's pose from pairs of a tool pose and a target seen (hand-eye calibration)
    Calibrate(CalibrateArgs),
    /// Look into bags
    #[command(subcommand)]
    Bag(BagCommand),
    /// Check what this machine has and what is missing
    Doctor(DoctorArgs),
    /// Print the running graph as a Mermaid diagram
    Graph(GraphArgs),
}

#[derive(Args, Clone)]
pub struct TeachArgs {
    /// Task file
    #[arg(
        long,
        required_unless_present = "multi",
        default_value = "(by --multi)",
        hide_default_value = true
    )]
    pub task: PathBuf,
    /// Recording: a rosbag2 folder or .mcap file with colour, aligned depth, camera_info and /tf_static
    #[arg(
        long,
        required_unless_present_any = ["import_dexmv", "multi"],
        conflicts_with = "import_dexmv"
    )]
    pub bag: Option<PathBuf>,
    /// Instead of a recording: names of tasks that were taught before, to be shared by one policy
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "TASK,TASK",
        conflicts_with_all = ["task", "bag", "import_dexmv"]
    )]
    pub multi: Vec<String>,
    /// Instead of a bag: the JSON file with the parsed DexMV mustard recording
    #[arg(long)]
    pub import_dexmv: Option<PathBuf>,
    /// Folder for the results [default: models/TASK]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Which frames belong to which procedure, instead of what parsing finds: an edited segments.yaml
    #[arg(long)]
    pub segments: Option<PathBuf>,
    /// Object catalogue
    #[arg(long, default_value = "config/objects")]
    pub objects: PathBuf,
    /// Folder with palm_detection_full.tflite and hand_landmark_full.tflite
    #[arg(long, default_value = "models/hands")]
    pub hand_models: PathBuf,
    /// Trajectories to make of the one [default: as the task file says]
    #[arg(long)]
    pub count: Option<usize>,
    #[command(flatten)]
    pub training: TrainingArgs,
    /// Seed of every random choice
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

#[derive(Args, Clone)]
pub struct TrainingArgs {
    /// Training steps at most
    #[arg(long, default_value_t = 600)]
    pub steps: usize,
    /// Keep a tenth of the trajectories aside, and stop when rollouts from their starts are good twice
    #[arg(long)]
    pub early_stop: bool,
    /// Go on from the state that a training in the same folder left
    #[arg(long)]
    pub resume: bool,
    /// Steps between states on the disk
    #[arg(long, default_value_t = 100, value_parser = steps)]
    pub save_every: usize,
    /// Folder of the sentence encoder: config.json, vocab.txt or tokenizer.json, model.safetensors
    #[arg(long, default_value = "models/text")]
    pub text_model: PathBuf,
    /// The encoder's first token stands for the sentence, as plain BERT wants it, not the mean of all
    #[arg(long)]
    pub text_cls: bool,
}

fn steps(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("at least 1".into()),
        Ok(n) => Ok(n),
        Err(e) => Err(format!("{e}")),
    }
}

#[derive(Args)]
pub struct DemoArgs {
    #[command(flatten)]
    pub teach: TeachArgs,
    /// Seed of the lab: which start pose, noise, light
    #[arg(long, default_value_t = 1)]
    pub lab_seed: u64,
    /// Folder for the run: bag, picture, logs
    #[arg(long, default_value = "runs/demo")]
    pub run: PathBuf,
    /// Use the model that is there instead of teaching again
    #[arg(long)]
    pub reuse: bool,
}

#[derive(Args)]
pub struct LaunchArgs {
    /// Launch file in ROS 2's YAML form
    pub file: PathBuf,
    /// Arguments of the launch file, NAME:=VALUE
    pub arguments: Vec<String>,
    /// Print the arguments of the file and end
    #[arg(short, long)]
    pub show_args: bool,
    /// Write each node's output to a file in this folder
    #[arg(long)]
    pub logs: Option<PathBuf>,
    /// End all nodes when this one has ended, such as camera_replay at the end of its bag
    #[arg(long)]
    pub until: Option<String>,
}

#[derive(Args)]
pub struct RecordArgs {
    /// Bag folder to write
    #[arg(short, long)]
    pub output: PathBuf,
    /// Topics; none: all that are published
    pub topics: Vec<String>,
    /// End after this many seconds instead of at Ctrl-C or SIGTERM
    #[arg(long)]
    pub duration: Option<f64>,
}

#[derive(Args)]
pub struct RecordDemoArgs {
    /// Which task is shown
    #[arg(long, default_value = "cup_on_coaster",
        value_parser = clap::builder::PossibleValuesParser::new(tdv_simulation::record::TASKS))]
    pub task: String,
    /// Bag folder to write; the ground truth goes to NAME_truth beside it
    #[arg(short, long)]
    pub output: PathBuf,
    /// Seed of noise, light and background
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Object catalogue
    #[arg(long, default_value = "config/objects")]
    pub objects: PathBuf,
    /// Quality of the JPEG images, 1 to 100
    #[arg(long, default_value_t = 85, value_parser = clap::value_parser!(u8).range(1..=100))]
    pub quality: u8,
}

#[derive(Subcommand)]
pub enum EvalCommand {
    /// Trials of the whole live graph in the virtual lab, judged on its truth
    ClosedLoop(ClosedLoopArgs),
    /// The same in scenes that look different: other tables, clutter, other places of the camera
    Domains(DomainArgs),
    /// Seeded troubles for controller, driver and robot, in one process on simulated time or live
    Faults(FaultsArgs),
    /// Track an object of a recorded data set and compare with its reference poses
    Tracking(TrackingArgs),
    /// Masks of what sentences name on rendered tables, against the true pixels
    TextToMask(TextToMaskArgs),
    /// Hand joints on a real video against MediaPipe's, grasps of rendered demonstrations against the lab
    Hands(HandsArgs),
    /// Success by task, demonstrations and level, in one process on simulated time
    Table2(Table2Args),
    /// The same for settings that change one thing each
    Ablations(AblationArgs),
}

#[derive(Args)]
pub struct DomainArgs {
    /// Task file
    #[arg(long, default_value = "config/tasks/cup_on_coaster.yaml")]
    pub task: PathBuf,
    /// Model folder [default: models/TASK]
    #[arg(long)]
    pub model: Option<PathBuf>,
    /// List of the domains
    #[arg(long, default_value = "config/domains.yaml")]
    pub domains: PathBuf,
    /// Only these, by name
    #[arg(long, value_delimiter = ',')]
    pub only: Vec<String>,
    /// Trials of each
    #[arg(long, default_value_t = 5)]
    pub trials: u64,
    /// First seed
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
    /// Folder for scenes, logs and pictures
    #[arg(long, default_value = "runs/domains")]
    pub run: PathBuf,
    /// Keep an animated picture of each trial
    #[arg(long)]
    pub pictures: bool,
}

#[derive(Args, Clone)]
pub struct Table2Args {
    /// Tasks, by their file's name in config/tasks
    #[arg(long, value_delimiter = ',', default_value = "cup_on_coaster")]
    pub tasks: Vec<String>,
    /// Demonstrations; 1 is the demonstration itself, more are made of it
    #[arg(long, value_delimiter = ',', default_value = "1,15,50")]
    pub demos: Vec<usize>,
    /// PG: the position varies; PoG: position and yaw
    #[arg(long, value_delimiter = ',', default_value = "PG,PoG")]
    pub levels: Vec<String>,
    /// Seeds of training and starts
    #[arg(long, value_delimiter = ',', default_value = "1")]
    pub seeds: Vec<u64>,
    /// Drawn starts per cell and seed, besides the 13 fixed points
    #[arg(long, default_value_t = 100)]
    pub starts: usize,
    /// Leave the 13 fixed points out
    #[arg(long)]
    pub no_points: bool,
    /// Who drives: learned, straight_line, open_loop
    #[arg(long, value_delimiter = ',', default_value = "learned,straight_line,open_loop")]
    pub policies: Vec<String>,
    /// Besides, all cells with an object pushed by 5 to 10 cm in mid-run
    #[arg(long)]
    pub disturb: bool,
    /// What is observed: 'truth' (with 2 mm and 1 deg of noise) or 'perceived' (needs --live)
    #[arg(long, default_value = "truth")]
    pub poses: String,
    /// Run each trial with the real graph over DDS
    #[arg(long)]
    pub live: bool,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
    /// Folder for models, trials, table and plot; a run that was ended goes on from there
    #[arg(long, default_value = "runs/table2")]
    pub out: PathBuf,
    /// Only every n-th trial, I/N with I from 1
    #[arg(long)]
    pub shard: Option<String>,
    /// Instead of teaching: the policies of DIR/TASK, as `tdv teach` writes them
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,
    /// Training steps of every policy
    #[arg(long, default_value_t = 600)]
    pub steps: usize,
    /// Threads, by trial
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=64))]
    pub threads: u8,
    /// Instead of running: one table of these result files (.json) and trial files (.jsonl)
    #[arg(long, num_args = 1.., value_name = "FILE")]
    pub merge: Vec<PathBuf>,
    /// Launch file of --live
    #[arg(long, default_value = "launch_scripts/closed_loop.launch.yaml")]
    pub launch_file: PathBuf,
}

#[derive(Args, Clone)]
pub struct AblationArgs {
    #[command(flatten)]
    pub table: Table2Args,
    /// Settings to try [default: all]
    #[arg(long, value_delimiter = ',')]
    pub arms: Vec<String>,
}

#[derive(Args)]
pub struct FaultsArgs {
    /// Scene of the virtual lab
    #[arg(long, default_value = "config/scenes/cup_on_coaster.yaml")]
    pub scene: PathBuf,
    /// Cases; each has its own seed
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    pub cases: u64,
    /// Instead: so many cases [40] on the real graph over DDS; processes are killed, connections cut
    #[arg(long, value_name = "CASES", num_args = 0..=1, default_missing_value = "40",
        value_parser = clap::value_parser!(u64).range(1..), conflicts_with_all = ["cases", "scene"])]
    pub live: Option<u64>,
    /// Task file of the live cases
    #[arg(long, default_value = "config/tasks/cup_on_coaster.yaml", requires = "live")]
    pub task: PathBuf,
    /// Model folder of the live cases [default: models/TASK]
    #[arg(long, requires = "live")]
    pub model: Option<PathBuf>,
    /// Folder for the logs of the live cases
    #[arg(long, default_value = "runs/faults", requires = "live")]
    pub run: PathBuf,
    /// First seed
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
}

#[derive(Args, Clone)]
pub struct ClosedLoopArgs {
    /// Task file
    #[arg(long)]
    pub task: PathBuf,
    /// Trials; each has its own seed, start pose, noise and light
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    pub trials: u64,
    /// First seed
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Run the real graph over DDS (the only way so far)
    #[arg(long)]
    pub live: bool,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
    /// Model folder [default: models/TASK]
    #[arg(long)]
    pub model: Option<PathBuf>,
    /// Displace the object or its target by 5 to 10 cm in mid-run
    #[arg(long)]
    pub disturb: bool,
    /// The grip fails once, soon after the lift
    #[arg(long)]
    pub drop: bool,
    /// Command that is started instead of our driver, in a shell; an imitation or the official one
    #[arg(long)]
    pub driver: Option<String>,
    /// Control: perception repeats its first result for ever
    #[arg(long)]
    pub freeze_perception: bool,
    /// Control: a network with random weights
    #[arg(long)]
    pub untrained: bool,
    /// Control: look once, then play the demonstration bent to what was seen
    #[arg(long, conflicts_with = "untrained")]
    pub open_loop: bool,
    /// Control: every grasp is commanded this far off (m, along x)
    #[arg(long, default_value_t = 0.0)]
    pub grasp_offset: f64,
    /// Kill this node while the arm moves, and start it again a second later; 'each': another one in
    /// each trial
    #[arg(long)]
    pub kill: Option<String>,
    /// Kill it while the arm carries the object, not on the way to it
    #[arg(long, requires = "kill")]
    pub kill_carrying: bool,
    /// Controller of the lab: cb3 (125 Hz), e_series (500 Hz) [default: as the scene says]
    #[arg(long, value_parser = generation())]
    pub controller: Option<Generation>,
    /// Argument of the launch file, such as backend:=remote; may be given several times
    #[arg(long = "set", value_name = "NAME:=VALUE")]
    pub settings: Vec<String>,
    /// Launch file
    #[arg(long, default_value = "launch_scripts/closed_loop.launch.yaml")]
    pub launch_file: PathBuf,
    /// Folder for logs and pictures
    #[arg(long, default_value = "runs/eval")]
    pub run: PathBuf,
    /// Keep an animated picture of each trial
    #[arg(long)]
    pub pictures: bool,
    /// Keep a bag of each trial: all topics, camera pictures at 5 Hz in JPEG
    #[arg(long)]
    pub bag: bool,
}

#[derive(Args)]
pub struct TrackingArgs {
    /// Folder of the data set
    #[arg(long, required_unless_present = "synthetic")]
    pub dataset: Option<PathBuf>,
    /// Object; with --synthetic a list with commas, or all
    #[arg(long, default_value = "cube", default_value_if("synthetic", "true", "all"))]
    pub object: String,
    /// Through the live graph: bag, camera_replay, perception_bridge, pose_tracker
    #[arg(long)]
    pub live: bool,
    /// The benchmark with exact truth instead of a data set: own objects, rendered, in process.
    /// Finished sequences are kept in --run and not run again
    #[arg(long, conflicts_with_all = ["dataset", "live"])]
    pub synthetic: bool,
    /// Sequences of each object, numbers from 0 with commas, or all (with --synthetic)
    #[arg(long, default_value = "all", requires = "synthetic")]
    pub sequences: String,
    /// Frames of each sequence (with --synthetic)
    #[arg(long, default_value_t = 150, requires = "synthetic")]
    pub frames: usize,
    /// Seed (with --synthetic)
    #[arg(long, default_value_t = 1, requires = "synthetic")]
    pub seed: u64,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
    /// Folder for the bag and the logs of the live form
    #[arg(long, default_value = "runs/tracking")]
    pub run: PathBuf,
}

#[derive(Args)]
pub struct HandsArgs {
    /// Frames of a video, NNNN.png
    #[arg(long, requires = "landmarks")]
    pub frames: Option<PathBuf>,
    /// What MediaPipe finds in them; tests/golden/hands/make_video_landmarks.py writes both
    #[arg(long, requires = "frames")]
    pub landmarks: Option<PathBuf>,
    /// Rendered demonstrations
    #[arg(long, default_value_t = 3)]
    pub demonstrations: u64,
    /// What they show: a task in which an object is carried
    #[arg(long, default_value = "cup_on_coaster",
        value_parser = clap::builder::PossibleValuesParser::new(tdv_simulation::record::TASKS))]
    pub task: String,
    /// Seed of the first one
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for their bags
    #[arg(long, default_value = "runs/hands")]
    pub run: PathBuf,
    /// Object catalogue
    #[arg(long, default_value = "config/objects")]
    pub objects: PathBuf,
    /// Folder with palm_detection_full.tflite and hand_landmark_full.tflite
    #[arg(long, default_value = "models/hands")]
    pub hand_models: PathBuf,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
}

#[derive(Args)]
pub struct TextToMaskArgs {
    /// Tables; each is asked three sentences
    #[arg(long, default_value_t = 50)]
    pub scenes: usize,
    /// Seed of tables, light, noise and words
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Result file
    #[arg(long)]
    pub json: Option<PathBuf>,
    /// Folder for a picture of every sentence: the true outline green, the given one pink
    #[arg(long)]
    pub pictures: Option<PathBuf>,
    /// Object catalogue
    #[arg(long, default_value = "config/objects")]
    pub objects: PathBuf,
}

#[derive(Subcommand)]
pub enum ObjectCommand {
    /// Make an entry from a mesh (OBJ, GLB, glTF, PLY, STL), a recording, or both
    Add(ObjectAddArgs),
}

#[derive(Args)]
pub struct ObjectAddArgs {
    /// Name of the object and of its folder
    pub name: String,
    /// Mesh, z up (glTF: y up), in any unit
    #[arg(long, required_unless_present = "bag")]
    pub mesh: Option<PathBuf>,
    /// Recording that begins with the object at rest on the table: gives a mesh its scale, or is made a
    /// mesh of
    #[arg(long)]
    pub bag: Option<PathBuf>,
    /// Which thing on the table, by colour, such as "the red one"
    #[arg(long)]
    pub prompt: Option<String>,
    /// Metres a unit of the mesh, instead of an estimate
    #[arg(long, conflicts_with = "height")]
    pub scale: Option<f64>,
    /// True height (m) of the standing object, instead of an estimate
    #[arg(long)]
    pub height: Option<f64>,
    /// Mass (kg) [default: a guess from the volume]
    #[arg(long)]
    pub mass: Option<f64>,
    /// Friction coefficient
    #[arg(long, default_value_t = 0.6)]
    pub friction: f64,
    /// Other words for it, separated by commas
    #[arg(long, value_delimiter = ',')]
    pub synonyms: Vec<String>,
    /// Frames at the beginning of the recording, with everything at rest, that are taken as one
    #[arg(long, default_value_t = 10)]
    pub frames: usize,
    /// Without a mesh: follow the object through the recording and cut away what later views see through
    #[arg(long)]
    pub carried: bool,
    /// Object catalogue
    #[arg(long, default_value = "config/objects")]
    pub objects: PathBuf,
    /// Replace an entry of this name
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct CalibrateArgs {
    /// YAML list of base_tool and camera_target, each with xyz (m) and xyzw (quaternion)
    #[arg(long)]
    pub poses: PathBuf,
    /// The camera is on the tool and the target fixed; without: the other way round
    #[arg(long)]
    pub eye_in_hand: bool,
    /// The camera's optical frame
    #[arg(long, default_value = "camera_color_optical_frame")]
    pub camera_frame: String,
}

#[derive(Subcommand)]
pub enum BagCommand {
    /// Topics, types, counts and duration
    Info {
        /// Bag folder or .mcap file
        bag: PathBuf,
    },
}

#[derive(Args)]
pub struct DoctorArgs {
    /// Folder of the sentence encoder
    #[arg(long, default_value = "models/text")]
    pub text_model: PathBuf,
    /// Folder of the hand networks
    #[arg(long, default_value = "models/hands")]
    pub hand_models: PathBuf,
    /// Folder of the learned perception backends' folders
    #[arg(long, default_value = "models")]
    pub models: PathBuf,
    /// Object catalogue
    #[arg(long, default_value = "config/objects")]
    pub objects: PathBuf,
}

#[derive(Args)]
pub struct GraphArgs {
    /// Seconds to look
    #[arg(long, default_value_t = 3.0)]
    pub wait: f64,
}

fn generation() -> impl TypedValueParser<Value = Generation> {
    PossibleValuesParser::new(Generation::ALL.map(Generation::name))
        .try_map(|name| Generation::of(&name).ok_or("unknown controller"))
}

impl ClosedLoopArgs {
    /// One plain live trial.
    pub fn one(task: PathBuf, model: Option<PathBuf>, seed: u64, run: PathBuf) -> Self {
        Self {
            task,
            trials: 1,
            seed,
            live: true,
            json: None,
            model,
            disturb: false,
            drop: false,
            driver: None,
            freeze_perception: false,
            untrained: false,
            open_loop: false,
            grasp_offset: 0.0,
            kill: None,
            kill_carrying: false,
            controller: None,
            settings: Vec::new(),
            launch_file: "launch_scripts/closed_loop.launch.yaml".into(),
            run,
            pictures: false,
            bag: false,
        }
    }
}
