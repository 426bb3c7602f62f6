//! `tdv`: teach a robot a task from one recording, run it, record, replay, measure.

mod arguments;
mod bag;
mod calibrate;
mod demo;
mod doctor;
mod domains;
mod eval;
mod faults;
mod graph;
mod hands;
mod launch;
mod live_faults;
mod motion;
mod object;
mod observe;
mod picture;
mod record;
mod record_demo;
mod report;
mod table2;
mod teach;
mod teach_multi;
mod text_to_mask;
mod tracking;
mod tracking_synthetic;
mod training;

use arguments::{Arguments, BagCommand, Command, EvalCommand, ObjectCommand};
use clap::Parser as _;
use std::process::ExitCode;

fn main() -> ExitCode {
    tdv_policy::tune_allocator();
    // Usage mistakes end in clap with exit code 2.
    let arguments = Arguments::parse();
    let outcome = match arguments.command {
        Command::Teach(a) => teach::run(&a).map(|_| true),
        Command::Demo(a) => demo::run(&a),
        Command::Launch(a) => launch::run(&a),
        Command::Record(a) => record::run(&a).map(|()| true),
        Command::RecordDemo(a) => record_demo::run(&a).map(|()| true),
        Command::Eval(EvalCommand::ClosedLoop(a)) => eval::closed_loop(&a),
        Command::Eval(EvalCommand::Domains(a)) => domains::run(&a),
        Command::Eval(EvalCommand::Faults(a)) => faults::campaign(&a),
        Command::Eval(EvalCommand::Tracking(a)) => tracking::run(&a),
        Command::Eval(EvalCommand::Hands(a)) => hands::run(&a),
        Command::Eval(EvalCommand::TextToMask(a)) => text_to_mask::run(&a),
        Command::Eval(EvalCommand::Table2(a)) => table2::table(&a),
        Command::Eval(EvalCommand::Ablations(a)) => table2::ablations(&a),
        Command::Object(ObjectCommand::Add(a)) => object::add(&a).map(|()| true),
        Command::Calibrate(a) => calibrate::run(&a).map(|()| true),
        Command::Bag(BagCommand::Info { bag }) => bag::info(&bag).map(|()| true),
        Command::Doctor(a) => doctor::run(&a),
        Command::Graph(a) => graph::run(&a).map(|()| true),
    };
    match outcome {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("tdv: {error:#}");
            ExitCode::FAILURE
        }
    }
}
