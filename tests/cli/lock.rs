//! One training at a time in a model folder.

use super::checkpoints::Place;
use super::*;
use crate::program::running::Running;
use std::io::{BufRead, BufReader};
use std::process::Stdio;

/// A second training into the same folder is refused while the first runs, and removes none of its files.
#[test]
fn one_training_at_a_time_writes_into_a_folder() {
    let place = Place::new();
    let (data, model) = (place.model("data"), place.model("model"));
    let mut command = program();
    command.args(["train", "-s", text(&data), "-m", text(&model), "--iterations", "1000000"]);
    let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
    let mut lines = BufReader::new(child.stderr.take().expect("its stderr")).lines().map_while(Result::ok);
    lines.find(|line| line.starts_with("100/1000000")).expect("progress after 100 iterations");
    // A temporary file, as the first training has it while it writes.
    let unfinished = model.join(".chkpnt100.safetensors.aB3dE6.tmp");
    std::fs::write(&unfinished, "half").expect("written");
    let second = place.train("model", &["--iterations", "3"]);
    assert_refused(&second, &["another training (process ", "choose another -m"]);
    assert!(unfinished.is_file() && model.join("train_log.csv").is_file(), "{:?}", files_below(&model));
    // With --wait, a training runs after the first one.
    let mut command = program();
    command.args(["train", "-s", text(&data), "-m", text(&model), "--iterations", "3", "--wait"]);
    let mut patient = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
    let errors = patient.stderr.take().expect("its stderr");
    let mut heard = BufReader::new(errors).lines().map_while(Result::ok);
    let waiting = format!("waiting for another training (process {} on ", child.id());
    assert!(heard.next().is_some_and(|line| line.starts_with(&waiting)), "{waiting}");
    child.interrupt();
    lines.for_each(drop);
    assert_eq!(child.wait().expect("it ends").code(), Some(130));
    let rest: Vec<String> = heard.collect();
    assert!(rest.iter().any(|line| line.contains("had an earlier training")), "{rest:?}");
    assert_eq!(patient.wait().expect("it ends").code(), Some(0));
    // The folder is free again, as it is after a kill.
    assert!(!model.join(".training.lock").exists(), "{:?}", files_below(&model));
}

/// A scheduler starts a job twice at once: one trains, and the others find it done.
#[test]
fn patient_trainings_of_a_new_folder_are_one() {
    let place = Place::new();
    let (data, model) = (place.model("data"), place.model("blocks/one"));
    let train = ["train", "-s", text(&data), "-m", text(&model), "--wait", "--start-checkpoint", "auto"];
    let command = || {
        let mut command = program();
        command.args(train).args(["--checkpoint-every", "10", "--iterations", "25", "--quiet"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let all: Vec<Running> = (0..3).map(|_| Running::start(&mut command())).collect();
    let ends: Vec<_> = all.into_iter().map(Running::finish).collect();
    let said = |output: &std::process::Output| String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(ends.iter().all(|end| end.status.code() == Some(0)), "{ends:?}");
    let done = ends.iter().filter(|end| said(end).contains("is trained to its end already"));
    assert_eq!(done.count(), 2, "{ends:?}");
    assert!(!model.join("earlier_1").exists(), "{:?}", files_below(&model));
    // A refused training leaves no folder.
    let none = place.model("none/at/all");
    let train = ["train", "-s", text(&data), "-m", text(&none), "--wait", "--few-photos", "off"];
    refuse(&[&train[..], &["--strategy", "mcmc", "--cap-max", "7"]].concat(), &["cap_max"]);
    assert!(!place.model("none").exists());
}
