//! Trials that need a process of their own: another environment, or no other trial beside them.
//!
//! Such a trial is `#[ignore]`d, so that it counts as ignored in the parent. Another trial runs it by [`run`] and
//! judges it.

use std::process::{Command, Stdio};

/// Runs trials of this test binary, also ignored ones, in a process of their own. Returns their output.
///
/// # Panics
/// When a trial fails, or fewer than `least` have run.
pub fn run(trials: &[&str], least: usize, configure: impl FnOnce(&mut Command)) -> String {
    let mut child = Command::new(std::env::current_exe().expect("the test binary"));
    child.args(trials).args(["--include-ignored", "--nocapture"]).stdin(Stdio::null());
    configure(&mut child);
    let output = child.output().expect("the test binary runs");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let passed = passed(&text);
    assert!(passed.is_some_and(|passed| passed >= least), "{passed:?} trials ran, not {least}:\n{text}");
    text
}

/// Number of trials passed, from the test binary's own summary.
fn passed(text: &str) -> Option<usize> {
    let (_, counts) = text.split_once("test result: ok. ")?;
    counts.split_once(" passed").and_then(|(count, _)| count.parse().ok())
}

#[test]
fn children_that_run_nothing_are_noticed() {
    assert_eq!(passed("test result: ok. 12 passed; 0 failed; 0 ignored"), Some(12));
    assert_eq!(passed("test result: FAILED. 12 passed; 1 failed"), None);
    let nothing = std::panic::catch_unwind(|| run(&["no_trial_has_this_name"], 1, |_| {}));
    assert!(nothing.is_err());
}
