//! `photonfarm`: renders scenes, runs the coordinator of a farm, and sends scenes to it.

// Module `say` writes instead: these panic where nobody reads.
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod args;
mod backup;
mod check;
mod client;
mod compare;
mod converge;
mod doctor;
mod events;
mod farm_args;
mod frames;
mod help;
mod input;
mod job;
mod kept;
mod local;
mod log;
mod logs;
mod manual;
mod metrics;
mod output;
mod plot;
mod progress;
mod render;
mod repeat;
mod say;
mod serve;
mod serve_args;
mod settings;
mod stats;
mod steer;
mod steer_args;
mod submit;
mod table;
mod token;
mod token_args;
mod watch;

use args::{Cli, Command};
use clap::Parser;
use photonfarm_proto::problem::Problem;
use serve_args::LogFormat;
use std::process::ExitCode;

/// The user pressed Ctrl-C.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
struct Interrupted;

const EXIT_FAILED: u8 = 1;
const EXIT_JOB_FAILED: u8 = 3;
const EXIT_JOB_CANCELLED: u8 = 4;
const EXIT_UNREACHABLE: u8 = 5;
const EXIT_REFUSED: u8 = 6;
const EXIT_INTERRUPTED: u8 = 130;

/// What the process ends with, so that scripts can tell one failure from another.
fn exit_code(error: &anyhow::Error) -> u8 {
    match error.downcast_ref::<submit::JobEnded>() {
        Some(submit::JobEnded::Failed(..)) => EXIT_JOB_FAILED,
        Some(submit::JobEnded::Cancelled(..)) => EXIT_JOB_CANCELLED,
        None if error.is::<Problem>() => EXIT_REFUSED,
        None if error.is::<client::Unreachable>() => EXIT_UNREACHABLE,
        None => EXIT_FAILED,
    }
}

fn main() -> ExitCode {
    let command = Cli::parse().command;
    match &command {
        Command::Serve(args) => log::start("info", args.log_format),
        // A render that stops early drops what was begun beyond its end: that is as it should be.
        Command::Render(args) if args.noise_target.is_some() || args.within.is_some() => {
            log::start("warn,photonfarm_worker::outbox=error", LogFormat::Text);
        }
        _ => log::start("warn", LogFormat::Text),
    }
    let result = match command {
        Command::Render(args) => render::run(args),
        Command::Check(args) => check::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Converge(args) => converge::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Submit(args) => submit::run(args),
        Command::Wait(args) => submit::wait(args),
        Command::Fetch(args) => submit::fetch_picture(args),
        Command::Backup(args) => backup::run(args),
        Command::Token(args) => token::run(args),
        Command::Jobs(args) => steer::jobs(args),
        Command::Watch(args) => watch::run(args),
        Command::Logs(args) => logs::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Pause(args) => steer::act(args, "pause"),
        Command::Resume(args) => steer::act(args, "resume"),
        Command::Cancel(args) => steer::act(args, "cancel"),
        Command::Delete(args) => steer::delete(args),
        Command::Resubmit(args) => steer::resubmit(args),
        Command::Retry(args) => steer::act(args, "retry"),
        Command::Drain(args) => steer::drain(args),
        Command::Extend(args) => steer::extend(args),
        Command::Priority(args) => steer::priority(args),
        Command::Workers(args) => steer::workers(args),
        Command::Completions { shell } => manual::completions(shell),
        Command::Man { folder } => manual::pages(&folder),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<say::ReaderLeft>() => ExitCode::SUCCESS,
        Err(error) if error.is::<Interrupted>() => ExitCode::from(EXIT_INTERRUPTED),
        Err(error) => {
            say::tell(format_args!("error: {}", say::causes(&error)));
            ExitCode::from(exit_code(&error))
        }
    }
}
