//! `ashsplat`: train, render and examine 3D Gaussian Splatting scenes from the command line.
//!
//! Every failure is one line `error: …` on stderr and exit code 2. An interrupted training saves and exits with 130.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::expect_used))]

#[macro_use]
extern crate ashsplat_program;

mod command_line;
mod convert;
mod demo;
mod devices;
#[cfg(windows)]
mod double_click;
mod eval;
mod info;
mod inspect;
mod mesh;
mod poses;
mod render;
mod train;

use ashsplat::{Error, Result};
use ashsplat_program::output;
use ashsplat_program::session::INTERRUPTED;
use std::process::ExitCode;

const FAILURE: u8 = 2;

fn main() -> ExitCode {
    survive_file_limits();
    #[cfg(windows)]
    if std::env::args_os().len() < 2 && double_click::explain() {
        return ExitCode::from(FAILURE);
    }
    let command = match command_line::parse(std::env::args_os()) {
        Ok(command) => command,
        Err(stop) => return stop,
    };
    match run(command).and_then(|()| output::check_stdout()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Error::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(error) => {
            errln!("error: {}", one_line(&error.to_string()));
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
            errln!("warning: {error}: a file beyond `ulimit -f` will end the program");
        }
    }
}

fn run(command: command_line::Command) -> Result<()> {
    use command_line::Command;
    match command {
        Command::Train(arguments) => train::run(&arguments),
        Command::Poses(arguments) => poses::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        #[cfg(feature = "scale")]
        Command::Partition(arguments) => ashsplat_scale::partition::run(&arguments),
        #[cfg(feature = "scale")]
        Command::Blocks(arguments) => ashsplat_scale::block_status::run(&arguments),
        #[cfg(feature = "scale")]
        Command::Exchange(arguments) => ashsplat_scale::exchange::run(&arguments),
        #[cfg(feature = "scale")]
        Command::Merge(arguments) => ashsplat_scale::merge::run(&arguments),
        #[cfg(feature = "scale")]
        Command::Tiles(arguments) => ashsplat_scale::tiles::run(&arguments),
        Command::Mesh(arguments) => mesh::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        #[cfg(feature = "bench")]
        Command::Bench(arguments) => ashsplat_bench::run(&arguments),
        #[cfg(feature = "view")]
        Command::View(arguments) => ashsplat_view::run(&arguments),
        #[cfg(feature = "bench")]
        Command::Profile(arguments) => ashsplat_bench::profile::run(&arguments),
    }
}

/// Replaces line breaks, such as those of an operating system's message, by spaces.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
