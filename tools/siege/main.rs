//! `siege`: attacks a running trainer and viewer, and prints the result of each attack.
//!
//! `cargo build --release && target/release/siege` runs all attacks against the `ashsplat` beside it, in at most ten minutes;
//! `--short` is for CI. The exit code is 1 if anything failed. Limits and peak memory need Linux.

#![allow(clippy::disallowed_methods)]

#[cfg(target_os = "linux")]
mod attacks;
#[cfg(target_os = "linux")]
mod data;
#[cfg(target_os = "linux")]
mod page;
#[cfg(target_os = "linux")]
mod program;
#[cfg(target_os = "linux")]
mod report;
#[cfg(target_os = "linux")]
mod siege;
#[cfg(target_os = "linux")]
mod training;

use std::process::ExitCode;

#[cfg(target_os = "linux")]
fn main() -> ExitCode {
    report::run()
}

#[cfg(not(target_os = "linux"))]
fn main() -> ExitCode {
    eprintln!("error: the siege needs Linux: it sets limits and reads /proc");
    ExitCode::from(2)
}
