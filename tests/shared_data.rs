//! Data-driven tests: one named trial per set of golden vectors, malformed file, real data set and third-party program (of
//! npm only with `ASHSPLAT_NPM` set); and tests that need a control group.
//!
//! The data lie in `$ASHSPLAT_SHARED`, by default `../shared` beside the repository; a few golden vectors in
//! tests/golden/sets. Without the data, one ignored trial per kind says so; with `ASHSPLAT_REQUIRE_SHARED=1` it fails.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

extern crate ashsplat_reference as reference;

mod common;
#[cfg(target_os = "linux")]
mod control_groups;
mod ecosystem;
mod golden;
mod malformed;
mod program;
mod programs;
mod real_data;

use libtest_mimic::{Failed, Trial};
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = libtest_mimic::Arguments::from_args();
    let shared = common::shared_folder();
    let mut trials = golden::trials(&shared);
    trials.extend(malformed::trials(&shared));
    trials.extend(real_data::trials(&shared));
    trials.extend(programs::trials());
    #[cfg(target_os = "linux")]
    trials.extend(control_groups::trials());
    trials.extend(ecosystem::trials());
    libtest_mimic::run(&arguments, trials).exit_code()
}

/// An ignored trial that says why nothing is tested; run nevertheless, it fails with the reason.
fn absent(name: &str, reason: impl Into<String>) -> Trial {
    let reason = reason.into();
    Trial::ignorable_test(name, move || Err(Failed::from(reason))).with_ignored_flag(true)
}

/// Same as [`absent`], for data expected beside the project: with `ASHSPLAT_REQUIRE_SHARED` set, as in CI, the trial runs
/// and fails.
fn absent_data(name: &str, reason: impl Into<String>) -> Trial {
    let required = std::env::var_os("ASHSPLAT_REQUIRE_SHARED").is_some_and(|value| value != "0");
    absent(name, reason).with_ignored_flag(!required)
}
