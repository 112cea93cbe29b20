//! `photonfarm`: renders scenes, runs the coordinator of a farm, and sends scenes to it.

mod args;
mod client;
mod job;
mod log;
mod output;
mod progress;
mod render;
mod serve;
mod settings;
mod stats;
mod submit;
mod token;

use args::{Cli, Command, LogFormat};
use clap::Parser;
use std::process::ExitCode;

/// The user pressed Ctrl-C.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
struct Interrupted;

const EXIT_FAILED: u8 = 1;
const EXIT_INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    let command = Cli::parse().command;
    match &command {
        Command::Serve(args) => log::start("info", args.log_format),
        Command::Render(_) | Command::Submit(_) | Command::Token(_) => log::start("warn", LogFormat::Text),
    }
    let result = match command {
        Command::Render(args) => render::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Submit(args) => submit::run(args),
        Command::Token(args) => token::run(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<Interrupted>() => ExitCode::from(EXIT_INTERRUPTED),
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(EXIT_FAILED)
        }
    }
}
