//! Runs other programs: ffmpeg for films and videos, COLMAP for cameras.

use ashsplat::{Error, Result};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

pub const INSTALL_FFMPEG: &str = "`apt install ffmpeg` on Debian and Ubuntu, `brew install ffmpeg` on macOS, `dnf install \
    ffmpeg-free` on Fedora, `winget install ffmpeg` on Windows";
const POLL: Duration = Duration::from_millis(20);
/// Checks of `stop` after a program failed: Ctrl-C on a terminal also ends the program, perhaps before this one
/// notices.
const LAST_CHECKS: u32 = 10;
/// Number of last output lines that are kept.
const TAIL: usize = 40;

/// True if a program is installed that accepts `-version`.
pub fn has(name: &str) -> bool {
    let mut program = Command::new(name);
    program.arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    program.status().is_ok_and(|status| status.success())
}

/// A running program, which is ended when the value is dropped.
pub struct Running(pub Child);

impl Running {
    /// Waits for its end; `None` if `stop` was raised.
    pub fn wait(&mut self, stop: &AtomicBool) -> std::io::Result<Option<ExitStatus>> {
        let stopped = || stop.load(Ordering::Relaxed);
        let pause = || std::thread::sleep(POLL);
        loop {
            match self.0.try_wait()? {
                Some(status) if status.success() => return Ok(Some(status)),
                Some(status) => {
                    (0..LAST_CHECKS).take_while(|_| !stopped()).for_each(|_| pause());
                    return Ok((!stopped()).then_some(status));
                }
                None if stopped() => return Ok(None),
                None => pause(),
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A program that is still running has failed.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

pub fn not_started(program: &str, error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => format!("needs {program}, which is not installed"),
        _ => format!("needs {program}, which cannot be started: {error}"),
    }
}

pub struct LoggedOutput {
    pub status: ExitStatus,
    /// Last lines of its output, without empty ones.
    pub tail: Vec<String>,
}

/// Runs a program to its end. All of its output is appended to the file `log`, and each line is passed to `on_line`.
///
/// # Errors
/// [`Error::Interrupted`] if `stop` was raised; the program has ended then. [`Error::Io`] if the program cannot be
/// started or the file cannot be written.
pub fn run_logged(
    mut command: Command,
    log: &Path,
    stop: &AtomicBool,
    on_line: &(dyn Fn(&str) + Sync),
) -> Result<LoggedOutput> {
    let io = |e| Error::io(log, "write", e);
    let file = File::options().create(true).append(true).open(log).map_err(io)?;
    let (reader, writer) = std::io::pipe().map_err(io)?;
    command.stdin(Stdio::null()).stdout(writer.try_clone().map_err(io)?).stderr(writer);
    let program = command.get_program().to_os_string();
    let child = command.spawn().map_err(|e| Error::io(program, "start", e))?;
    // The command holds an end of the pipe, which would otherwise never close.
    drop(command);
    let mut child = Running(child);
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| copy_lines(BufReader::new(reader), file, on_line));
        let status = child.wait(stop);
        drop(child);
        let tail = reader.join().unwrap_or_else(|_| Ok(VecDeque::new()));
        let status = status.map_err(io)?.ok_or(Error::Interrupted)?;
        Ok(LoggedOutput { status, tail: tail.map_err(io)?.into() })
    })
}

/// Copies lines to a file; returns the last ones. If the file cannot be written, the program's output is read on.
fn copy_lines(
    mut from: impl BufRead,
    mut to: impl Write,
    on_line: &(dyn Fn(&str) + Sync),
) -> std::io::Result<VecDeque<String>> {
    let mut tail = VecDeque::new();
    let mut written = Ok(());
    let mut line = Vec::new();
    while from.read_until(b'\n', &mut line)? > 0 {
        written = written.and_then(|()| to.write_all(&line));
        let text = String::from_utf8_lossy(&line).trim().to_owned();
        on_line(&text);
        if !text.is_empty() {
            tail.push_back(text);
        }
        if tail.len() > TAIL {
            tail.pop_front();
        }
        line.clear();
    }
    written.and_then(|()| to.flush()).map(|()| tail)
}
