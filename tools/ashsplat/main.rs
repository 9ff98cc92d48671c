//! `ashsplat`: train, render and examine 3D Gaussian Splatting scenes from the command line.
//!
//! Every failure is one line `error: …` on stderr and exit code 2. An interrupted training saves and exits with 130. A
//! benchmark comparison exits with 1 if --fail-above finds something worse.

/// Prints a line on stdout. Unlike `println!`, a failure does not panic: a training must continue. A full disk is
/// reported at the end, a closed pipe never.
macro_rules! say {
    ($($text:tt)*) => { $crate::output::say(format_args!($($text)*)) };
}

/// Prints a line on stderr.
macro_rules! tell {
    ($($text:tt)*) => { $crate::output::tell(format_args!($($text)*)) };
}

mod args;
mod axis;
mod bench;
mod block_status;
mod blocks;
mod child;
mod command_line;
mod config;
mod convert;
mod cpu_time;
mod demo;
mod devices;
mod eval;
mod exchange;
mod film_file;
mod guarded;
mod html;
mod info;
mod inspect;
mod light;
mod lock;
mod measure;
mod merge;
mod model;
mod output;
mod partition;
mod pipeline_cache;
mod poses;
mod profile;
mod progress;
mod render;
mod session;
mod tiles;
mod train;
mod view;

use ashsplat::{Error, Result};
use std::process::ExitCode;

/// Exit code of every failure.
const FAILURE: u8 = 2;
/// Exit code after Ctrl-C, as shells report a process ended by SIGINT.
const INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    survive_file_limits();
    let command = match command_line::parse(std::env::args_os()) {
        Ok(command) => command,
        Err(stop) => return stop,
    };
    let result = run(command).and_then(|code| output::check_stdout().map(|()| code));
    match result {
        Ok(code) => code,
        Err(Error::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(error) => {
            tell!("error: {}", one_line(&error.to_string()));
            ExitCode::from(FAILURE)
        }
    }
}

/// Turns a file beyond `ulimit -f` into a write error, like a full disk, instead of the end of the program.
fn survive_file_limits() {
    #[cfg(unix)]
    {
        // The handler only notes the signal; the system call returns the error.
        let came = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, came) {
            tell!("warning: {error}: a file beyond `ulimit -f` will end the program");
        }
    }
}

fn run(command: command_line::Command) -> Result<ExitCode> {
    use command_line::Command;
    let done = match command {
        Command::Train(arguments) => train::run(&arguments),
        Command::Poses(arguments) => poses::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Partition(arguments) => partition::run(&arguments),
        Command::Blocks(arguments) => block_status::run(&arguments),
        Command::Exchange(arguments) => exchange::run(&arguments),
        Command::Merge(arguments) => merge::run(&arguments),
        Command::Tiles(arguments) => tiles::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Bench(arguments) => return bench::run(&arguments),
        Command::View(arguments) => view::run(&arguments),
        Command::Profile(arguments) => profile::run(&arguments),
    };
    done.map(|()| ExitCode::SUCCESS)
}

/// Replaces line breaks, such as those of an operating system's message, by spaces.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
