//! Runs of the program.

use crate::common::with_slashes;
use std::path::Path;
use std::process::{Command, Output};

pub(crate) struct Finished {
    /// The command line, for failure messages.
    command: String,
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl From<Output> for Finished {
    fn from(output: Output) -> Finished {
        Finished {
            command: String::new(),
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Finished {
    #[track_caller]
    pub(crate) fn ok(self) -> Finished {
        assert_eq!(self.code, Some(0), "{}: {}{}", self.command, self.stdout, self.stderr);
        self
    }

    #[track_caller]
    pub(crate) fn says(self, words: &[&str]) -> Finished {
        self.has(&self.stdout, words);
        self
    }

    #[track_caller]
    pub(crate) fn warns(self, words: &[&str]) -> Finished {
        self.has(&self.stderr, words);
        self
    }

    /// See [`assert_refused`].
    #[track_caller]
    pub(crate) fn refused(self, words: &[&str]) -> Finished {
        assert_refused(&self, words);
        self
    }

    /// Checks that the program failed: exit code 2, and a last line `error: …` with all of these words.
    #[cfg(unix)]
    #[track_caller]
    pub(crate) fn fails(self, words: &[&str]) -> Finished {
        self.ends_with_error(self.stderr.lines().last().unwrap_or_default(), words);
        self
    }

    #[track_caller]
    fn ends_with_error(&self, line: &str, words: &[&str]) {
        assert_eq!(self.code, Some(2), "{}: {}{}", self.command, self.stdout, self.stderr);
        assert!(line.starts_with("error: "), "{}: {}", self.command, self.stderr);
        self.has(line, words);
    }

    #[track_caller]
    fn has(&self, text: &str, words: &[&str]) {
        let plain = with_slashes(text);
        for word in words {
            assert!(plain.contains(&with_slashes(word)), "{}: no '{word}' in: {text}", self.command);
        }
    }
}

/// Checks that the program refused: exit code 2, and beside warnings one line `error: …` with all of these words.
#[track_caller]
pub(crate) fn assert_refused(run: &Finished, words: &[&str]) {
    let errors: Vec<&str> = run.stderr.lines().filter(|line| !line.starts_with("warning: ")).collect();
    assert_eq!(errors.len(), 1, "{}: {}", run.command, run.stderr);
    run.ends_with_error(errors[0], words);
}

pub(crate) fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ashsplat"));
    command.env_remove("ASHSPLAT_DEVICE").env("ASHSPLAT_PIPELINE_CACHE", "");
    command
}

pub(crate) fn finish(command: &mut Command) -> Finished {
    let output = command.output().expect("the program starts");
    Finished { command: format!("{command:?}"), ..output.into() }
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().expect("temporary paths are UTF-8")
}
