//! The short form of `tools/siege` against the program built beside it.

#![allow(clippy::expect_used)]

/// Ignored by default, because it takes half a minute. `.ci/run` runs a copy of the same program during a build.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "half a minute"]
fn short_siege_is_withstood() {
    let siege = std::process::Command::new(env!("CARGO_BIN_EXE_siege")).arg("--short").status();
    assert!(siege.expect("the siege begins").success(), "its table is above");
}
