use crate::arguments::{ClosedLoopArgs, DemoArgs};
use crate::{eval, teach};
use std::path::Path;
use tdv_demonstration::Task;

/// Teaches, then carries the task out once; the last line is the lab's verdict.
pub fn run(args: &DemoArgs) -> anyhow::Result<bool> {
    let task = Task::load(&args.teach.task)?;
    let model = args.teach.out.clone().unwrap_or_else(|| Path::new("models").join(&task.name));
    if args.reuse && model.join("policy.safetensors").exists() {
        println!("1/2 using the model in {}", model.display());
    } else {
        println!("1/2 teaching \"{}\" from one demonstration", task.text);
        teach::run(&args.teach)?;
    }
    println!("2/2 carrying it out in the virtual lab, from a start that was not demonstrated");
    let setup = ClosedLoopArgs {
        json: Some(args.run.join("result.json")),
        pictures: true,
        bag: true,
        ..ClosedLoopArgs::one(args.teach.task.clone(), Some(model), args.lab_seed, args.run.clone())
    };
    let good = eval::closed_loop(&setup)?;
    println!("verdict: {}", if good { "success" } else { "failure" });
    Ok(good)
}
