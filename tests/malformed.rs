//! Damaged, hostile and unusual files: one trial per case of `data/malformed/expected.json`.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

mod values;

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use ashsplat::Error;
use ashsplat_files::dataset::{Dataset, DatasetOptions};
use ashsplat_files::{Progress, splats};
use libtest_mimic::{Failed, Trial};

use crate::absent_data;

/// Far more than any of the small files needs.
const TIMEOUT: Duration = Duration::from_secs(120);

/// Far more than any of the small files needs, and far less than their counts claim.
const MAX_MEMORY_KIB: u64 = 1 << 20;

/// A row of expected.json.
struct Case {
    path: String,
    what: String,
    verdict: String,
}

/// One trial per case.
pub fn trials(shared: &Path) -> Vec<Trial> {
    let folder = shared.join("data/malformed");
    let Ok(text) = std::fs::read(folder.join("expected.json")) else {
        return vec![absent_data("malformed_absent", format!("no malformed files in {}", folder.display()))];
    };
    let rows: Vec<serde_json::Value> = serde_json::from_slice(&text).expect("expected.json is a list");
    let text = |row: &serde_json::Value, key: &str| row[key].as_str().expect("a string").to_owned();
    rows.iter()
        .map(|row| Case { path: text(row, "path"), what: text(row, "what"), verdict: text(row, "verdict") })
        .map(|case| trial(&folder, case))
        .collect()
}

fn trial(folder: &Path, case: Case) -> Trial {
    let stem = case.path.trim_end_matches('/').trim_end_matches(".ply");
    let name = format!("malformed_{}", stem.replace(['/', '.', '-'], "_"));
    let path = folder.join(&case.path);
    Trial::test(name, move || guarded(path, case))
}

/// Result of loading: a description of the scene, or the error.
type Outcome = Result<String, Error>;

/// Runs a case with a time limit, and checks its memory.
fn guarded(path: PathBuf, case: Case) -> Result<(), Failed> {
    let (sender, receiver) = mpsc::channel();
    let loaded = path.clone();
    let thread = std::thread::spawn(move || {
        let _ = sender.send(load(&loaded));
    });
    let outcome = match receiver.recv_timeout(TIMEOUT) {
        Ok(outcome) => outcome,
        Err(mpsc::RecvTimeoutError::Timeout) => return Err(format!("hangs: {}", case.what).into()),
        Err(mpsc::RecvTimeoutError::Disconnected) => {
            let panic = thread.join().expect_err("only a panic drops the sender");
            std::panic::resume_unwind(panic)
        }
    };
    if let Some(kib) = peak_memory_kib().filter(|&kib| kib > MAX_MEMORY_KIB) {
        return Err(format!("took {kib} KiB: {}", case.what).into());
    }
    judge(&path, &case, &outcome).map_err(|e| format!("{e} ({}, {outcome:?})", case.what).into())
}

fn load(path: &Path) -> Outcome {
    if path.is_file() {
        return splats::read(path, &splats::ReadOptions::default())
            .map(|scene| format!("{} Gaussians, {:?}", scene.gaussians.len(), scene.warnings));
    }
    let options = DatasetOptions::default();
    let report = Dataset::inspect(path, &options, Progress::NONE);
    let loaded = Dataset::load(path, &options, Progress::NONE);
    assert_eq!(report.is_sound(), loaded.is_ok(), "load and inspect disagree: {report}");
    // The treatment of photographs of distorting lenses is a note.
    let said: Vec<_> = report.warnings.iter().chain(&report.notes).collect();
    loaded.map(|set| format!("{} views, {} points, {said:?}", set.train.len(), set.points.len()))
}

fn judge(path: &Path, case: &Case, outcome: &Outcome) -> Result<(), String> {
    match (case.verdict.as_str(), outcome) {
        ("accept", Ok(_)) => {
            values::check(path, case.path.trim_end_matches('/'));
            Ok(())
        }
        ("accept", Err(_)) => Err("must be accepted".into()),
        ("refuse", Ok(_)) => Err("must be refused".into()),
        (_, Err(e)) => check_message(path, &e.to_string()),
        ("either", Ok(text)) if text.ends_with("[]") => Err("accepted without a warning or a note".into()),
        ("either", Ok(_)) => Ok(()),
        (verdict, _) => Err(format!("unknown verdict {verdict}")),
    }?;
    values::check_refused(path, case.path.trim_end_matches('/'), outcome.as_ref().err());
    Ok(())
}

/// Checks that the message is one line that names the file, or a file of the data set, and has more text.
fn check_message(path: &Path, message: &str) -> Result<(), String> {
    let named = path.to_str().expect("UTF-8").trim_end_matches('/');
    let Some(rest) = message.strip_prefix(named) else {
        return Err("the error does not begin with the file".into());
    };
    match () {
        () if message.contains('\n') => Err("the error has several lines".into()),
        () if message.len() > 600 => Err("the error is longer than 600 bytes".into()),
        () if rest.split_once(": ").is_none_or(|(_, problem)| problem.len() < 10) => {
            Err("the error says nothing".into())
        }
        () => Ok(()),
    }
}

/// Peak memory of this process, if the system reports it.
fn peak_memory_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_ascii_whitespace().nth(1)?.parse().ok()
}
