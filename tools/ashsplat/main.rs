//! `ashsplat`: train, render and examine 3D Gaussian Splatting scenes from the command line.
//!
//! Every failure is one line `error: …` on stderr and exit code 2; an interrupted training saves and exits with 130.

/// A line on stdout. Unlike `println!`, a closed pipe is no reason to die: a training must go on.
macro_rules! say {
    ($($text:tt)*) => { $crate::output::say(&mut std::io::stdout(), format_args!($($text)*)) };
}

/// A line on stderr.
macro_rules! tell {
    ($($text:tt)*) => { $crate::output::say(&mut std::io::stderr(), format_args!($($text)*)) };
}

mod args;
mod bench;
mod config;
mod convert;
mod cpu_time;
mod demo;
mod devices;
mod eval;
mod info;
mod inspect;
mod measure;
mod model;
mod output;
mod profile;
mod progress;
mod render;
mod session;
mod train;

use ashsplat::{Error, Result};
use std::process::ExitCode;

/// Exit code of every failure.
const FAILURE: u8 = 2;
/// Exit code after Ctrl-C, as shells report a process ended by SIGINT.
const INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    let command = match args::parse(std::env::args_os()) {
        Ok(command) => command,
        Err(stop) => return stop,
    };
    match run(command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Error::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(error) => {
            tell!("error: {}", one_line(&error.to_string()));
            ExitCode::from(FAILURE)
        }
    }
}

fn run(command: args::Command) -> Result<()> {
    use args::Command;
    match command {
        Command::Train(arguments) => train::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Profile(arguments) => profile::run(&arguments),
    }
}

/// Line breaks (of an operating system's message, say) become spaces.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
