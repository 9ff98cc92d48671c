//! Viewers of a running training.

use super::*;
use crate::cli::write_dataset;
use std::path::PathBuf;
use tempfile::{TempDir, tempdir};

/// A training, usually without an end of its own.
pub struct Training {
    pub folder: TempDir,
    pub server: Server,
}

impl Training {
    pub fn start(more: &[&str], last: &str) -> Training {
        let folder = tempdir().expect("a temporary folder");
        let (data, model) = (folder.path().join("data"), folder.path().join("model"));
        write_dataset(&data);
        let train = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--quiet", "--iterations"];
        let server = Server::start_until(&[&train[..], more].concat(), last);
        Training { folder, server }
    }

    /// Starts it with few descriptors.
    #[cfg(unix)]
    pub fn start_within(descriptors: u32, more: &[&str]) -> Training {
        let folder = tempdir().expect("a temporary folder");
        let (data, model) = (folder.path().join("data"), folder.path().join("model"));
        write_dataset(&data);
        let train = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--quiet", "--iterations"];
        let server = Server::start_within(descriptors, &[&train[..], more].concat(), "viewer at ");
        Training { folder, server }
    }

    pub fn model(&self) -> PathBuf {
        self.folder.path().join("model")
    }
}

impl Page {
    pub fn status(&mut self, since: u64) -> Value {
        self.send(&json!({ "type": "status", "since": since }));
        self.wait_for("status")
    }

    pub fn act(&mut self, action: &str) {
        self.send(&json!({ "type": "train", "action": action }));
    }

    /// Waits for an iteration while training is stepped.
    pub fn reach(&mut self, iteration: u64) {
        let start = Instant::now();
        while self.status(0)["iteration"].as_u64() != Some(iteration) {
            assert!(start.elapsed() < PATIENCE, "iteration {iteration} does not come");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until training is paused, after the first iteration at the earliest. Returns the iteration.
    pub fn rest(&mut self) -> u64 {
        let start = Instant::now();
        while self.status(0)["paused"] != true {
            assert!(start.elapsed() < PATIENCE, "it does not pause");
            std::thread::sleep(Duration::from_millis(20));
        }
        self.same()
    }

    /// Waits until the iteration stays the same. Returns it.
    pub fn same(&mut self) -> u64 {
        loop {
            let first = self.status(0);
            std::thread::sleep(Duration::from_millis(300));
            let second = self.status(0);
            if first["iteration"] != 0 && first["iteration"] == second["iteration"] {
                return first["iteration"].as_u64().expect("a number");
            }
        }
    }
}

#[test]
fn viewer_of_a_training_shows_and_steers_it() {
    let mut training = Training::start(&["1000000", "--view=0"], "viewer at ");
    let mut page = training.server.page();
    assert_eq!(page.greeting["training"], 1_000_000);
    assert_eq!(page.greeting["cameras"].as_array().map(Vec::len), Some(9));
    assert_eq!(training.server.get("/photo/0", &[]).0, 200);
    // Frames of the current scene, renewed while training runs.
    let mut request = view(1, &camera(0.0), &json!({}));
    request["follow"] = json!(true);
    page.send(&request);
    let iteration = |shown: &Shown| shown.header["iteration"].as_u64().expect("an iteration");
    let first = iteration(&page.frame());
    page.send(&json!({ "type": "ack" }));
    let second = iteration(&page.frame());
    assert!(second > first, "{first} {second}");
    // Training pauses, and makes a single step.
    page.act("pause");
    let at = page.rest();
    let status = page.status(0);
    assert_eq!(status["paused"], true);
    let loss = status["points"]["loss"].as_array().expect("points");
    assert!(!loss.is_empty() && loss.last().expect("a point")[1].as_f64() < loss[0][1].as_f64(), "{loss:?}");
    page.act("step");
    page.reach(at + 1);
    assert_eq!(page.rest(), at + 1);
    // A pick in a paused training.
    let pick = json!({ "type": "pick", "id": 1, "camera": message(&camera(0.0)), "pixel": [48, 32] });
    page.send(&pick);
    assert!(page.wait_for("picked")["samples"].is_array());
    page.act("save");
    let ply = training.model().join(format!("point_cloud/iteration_{}/point_cloud.ply", at + 1));
    let start = Instant::now();
    while !ply.is_file() {
        assert!(start.elapsed() < PATIENCE, "{}", ply.display());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(page.rest(), at + 1, "a save leaves it waiting");
    page.act("resume");
    let start = Instant::now();
    while page.status(0)["iteration"].as_u64() <= Some(at + 1) {
        assert!(start.elapsed() < PATIENCE);
    }
    page.act("stop");
    let (code, stderr) = training.server.wait();
    assert_eq!(code, Some(130), "{stderr}");
    let model = training.model();
    let last = std::fs::read_to_string(model.join("last_iteration")).expect("a note");
    assert!(model.join(format!("chkpnt{}.safetensors", last.trim())).is_file());
}

/// A viewer does not change the bits of a training.
#[test]
fn viewer_does_not_change_a_training() {
    let cloud = |watched: bool| {
        let more = ["200", "--densify_from_iter", "5", "--densification_interval", "10", "--view=0"];
        let mut training = Training::start(&more, "viewer at ");
        let mut page = watched.then(|| training.server.page());
        if let Some(page) = &mut page {
            let mut request = view(1, &camera(0.0), &json!({ "mode": "tiles" }));
            request["follow"] = json!(true);
            page.send(&request);
            page.frame();
        }
        let (code, stderr) = training.server.wait();
        assert_eq!(code, Some(0), "{stderr}");
        std::fs::read(training.model().join("point_cloud/iteration_200/point_cloud.ply")).expect("a PLY")
    };
    assert!(cloud(true) == cloud(false), "looking on has changed the training");
}

/// If a save fails, the page gets an error and training continues.
#[test]
fn viewer_survives_a_save_that_fails() {
    let mut training = Training::start(&["1000000", "--view=0"], "viewer at ");
    let mut page = training.server.page();
    // A file blocks the folder of point clouds.
    let place = training.model().join("point_cloud");
    std::fs::write(&place, "in the way").expect("written");
    page.act("pause");
    let at = page.rest();
    page.act("save");
    let problem = page.wait_for("problem")["message"].to_string();
    assert!(problem.contains("point_cloud"), "{problem}");
    std::fs::remove_file(&place).expect("removed");
    page.act("step");
    page.reach(at + 1);
    page.act("stop");
    let (code, stderr) = training.server.wait();
    assert!(code == Some(130) && stderr.contains("warning: not saved"), "{code:?} {stderr}");
}
