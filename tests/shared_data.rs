//! Data-driven tests: one named trial for each set of golden vectors.

mod common;
mod golden;
mod reference;

use std::path::PathBuf;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = libtest_mimic::Arguments::from_args();
    let shared = std::env::var_os("ASHSPLAT_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    libtest_mimic::run(&arguments, golden::trials(&shared)).exit_code()
}
