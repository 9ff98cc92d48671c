//! The attacked program as a child: limited, watched, and always ended.

use crate::siege::{Result, Siege, ensure};
use std::fmt::Write;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time until the program must be ready.
const READY: Duration = Duration::from_secs(60);
const WATCH: Duration = Duration::from_millis(5);

#[derive(Clone, Default)]
pub struct Limits {
    pub descriptors: Option<u64>,
    /// A folder that becomes a small disk, and its size in KiB.
    pub disk: Option<(PathBuf, u64)>,
}

/// True if small disks can be mounted, which takes a mount namespace.
pub fn can_mount() -> bool {
    let mut command = unshare();
    command.args(["sh", "-c", "mount -t tmpfs -o size=1m siege /mnt"]).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

fn unshare() -> Command {
    let mut command = Command::new("unshare");
    command.arg("--mount");
    if !rustix::process::getuid().is_root() {
        command.arg("--map-root-user");
    }
    command
}

#[derive(Debug)]
pub struct Ending {
    /// None after a signal.
    pub code: Option<i32>,
    pub errors: String,
}

impl Ending {
    /// Checks that it refused properly: one line `error: …` and exit code 2.
    pub fn check_refused(&self) -> Result<()> {
        let lines = self.errors.lines().filter(|line| !line.starts_with("warning: "));
        let (errors, rest): (Vec<&str>, Vec<&str>) = lines.partition(|line| line.starts_with("error: "));
        ensure!(self.code == Some(2) && errors.len() == 1 && rest.is_empty(), "no clear refusal: {self}");
        Ok(())
    }
}

impl std::fmt::Display for Ending {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.code {
            Some(code) => write!(f, "exit code {code}")?,
            None => write!(f, "killed by a signal")?,
        }
        let last = self.errors.lines().last().unwrap_or_default();
        write!(f, ", {:?}", last.chars().take(200).collect::<String>())
    }
}

pub struct Program {
    child: Child,
    output_lines: Receiver<String>,
    errors: Option<JoinHandle<String>>,
}

impl Program {
    /// Starts the attacked program without limits.
    pub fn start(siege: &Siege, arguments: &[&str]) -> Result<Program> {
        Program::limited(siege, &Limits::default(), arguments)
    }

    pub fn limited(siege: &Siege, limits: &Limits, arguments: &[&str]) -> Result<Program> {
        let mut script = String::new();
        let mut command = match &limits.disk {
            None => Command::new("sh"),
            Some((folder, kib)) => {
                write!(script, "mount -t tmpfs -o size={kib}k siege \"$DISK\" && ")?;
                let mut command = unshare();
                command.env("DISK", folder).arg("sh");
                command
            }
        };
        if let Some(descriptors) = limits.descriptors {
            write!(script, "ulimit -n {descriptors} && ")?;
        }
        command.args(["-c", &format!("{script}exec \"$0\" \"$@\"")]).arg(&siege.program).args(arguments);
        command.env_remove("ASHSPLAT_DEVICE").env("ASHSPLAT_PIPELINE_CACHE", "");
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        watch(child.id(), siege.peak.clone());
        let (sender, output_lines) = channel();
        let stdout = child.stdout.take().ok_or("no stdout")?;
        std::thread::spawn(move || {
            let lines = BufReader::new(stdout).lines().map_while(std::result::Result::ok);
            lines.for_each(|line| drop(sender.send(line)));
        });
        let mut stderr = child.stderr.take().ok_or("no stderr")?;
        let errors = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            stderr.read_to_end(&mut bytes).ok();
            String::from_utf8_lossy(&bytes).into_owned()
        });
        Ok(Program { child, output_lines, errors: Some(errors) })
    }

    /// Waits for the next line on stdout with this beginning; returns the rest.
    pub fn wait_for(&mut self, beginning: &str) -> Result<String> {
        let start = Instant::now();
        loop {
            let left = READY.saturating_sub(start.elapsed());
            match self.output_lines.recv_timeout(left) {
                Ok(line) => {
                    if let Some(rest) = line.strip_prefix(beginning) {
                        return Ok(rest.to_owned());
                    }
                }
                Err(RecvTimeoutError::Timeout) => {
                    return Err(format!("'{beginning}' was not said within {READY:?}").into());
                }
                Err(RecvTimeoutError::Disconnected) => {
                    let ending = self.end(READY)?;
                    return Err(format!("ended before it said '{beginning}': {ending}").into());
                }
            }
        }
    }

    /// Waits until it serves a page; returns host and port.
    pub fn host(&mut self) -> Result<String> {
        let address = self.wait_for("viewer at http://")?;
        Ok(address.split('/').next().unwrap_or_default().to_owned())
    }

    /// Waits for its end. If it takes longer, kills it and returns an error.
    pub fn end(&mut self, longest: Duration) -> Result<Ending> {
        let start = Instant::now();
        let mut late = false;
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            if start.elapsed() > longest {
                late = true;
                self.kill();
            }
            std::thread::sleep(WATCH);
        };
        let errors = self.errors.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        ensure!(!late, "was not over after {longest:?}: {:?}", errors.lines().last().unwrap_or_default());
        Ok(Ending { code: status.code(), errors })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn runs(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    pub fn kill(&mut self) {
        self.child.kill().ok();
    }

    /// Its peak memory so far, MiB.
    pub fn memory(&self) -> u64 {
        peak_of(self.child.id()).unwrap_or(0) >> 10
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.kill();
        self.child.wait().ok();
    }
}

/// Records a process's peak memory while it lives.
fn watch(id: u32, peak: Arc<AtomicU64>) {
    std::thread::spawn(move || {
        while let Some(kib) = peak_of(id) {
            peak.fetch_max(kib, Ordering::Relaxed);
            std::thread::sleep(WATCH);
        }
    });
}

/// A process's peak memory, KiB; none after its end.
fn peak_of(id: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    peak.trim().trim_end_matches(" kB").parse().ok()
}
