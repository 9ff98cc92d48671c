//! Trials that need a process of their own: another environment, or no other trial beside them.
//!
//! Such a trial is `#[ignore]`d, so that it counts as ignored in the parent. Another trial runs it by [`run`] and
//! judges it.

use std::process::{Command, Stdio};

/// Runs trials of this test binary, also ignored ones, in a process of their own. Returns their output.
///
/// # Panics
/// When a trial fails, or fewer than `min` have run.
pub fn run(trials: &[&str], min: usize, configure: impl FnOnce(&mut Command)) -> String {
    let mut child = Command::new(std::env::current_exe().expect("the test binary"));
    child.args(trials).args(["--include-ignored", "--nocapture"]).stdin(Stdio::null());
    configure(&mut child);
    let output = child.output().expect("the test binary runs");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    // The test binary's own summary.
    let counts = text.split_once("test result: ok. ").and_then(|(_, counts)| counts.split_once(" passed"));
    let passed = counts.and_then(|(count, _)| count.parse::<usize>().ok());
    assert!(passed.is_some_and(|passed| passed >= min), "{passed:?} trials ran, not {min}:\n{text}");
    text
}
