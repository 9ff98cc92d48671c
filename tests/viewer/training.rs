//! Viewers of a running training.

use super::*;
use std::process::Command;

/// A training, usually without an end of its own.
pub struct Training {
    pub place: TestFolder,
    pub server: Server,
}

impl Training {
    /// Starts it with a page, and without an end.
    pub fn endless() -> Training {
        Training::start("1000000")
    }

    /// `more`: the number of iterations and other arguments.
    pub fn start(more: &str) -> Training {
        let place = TestFolder::new();
        let words =
            place.words(format!("train -s @data -m @model --eval --quiet --view=0 --iterations {more}"));
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let server = Server::run(Command::new(env!("CARGO_BIN_EXE_ashsplat")), &words);
        Training { place, server }
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

    pub fn reach(&mut self, iteration: u64) {
        wait_until("the iteration does not come", || self.status(0)["iteration"] == iteration);
    }

    pub fn pass(&mut self, iteration: u64) {
        wait_until("it does not go on", || self.status(0)["iteration"].as_u64() > Some(iteration));
    }

    /// Waits until training is paused, after the first iteration at the earliest. Returns the iteration.
    pub fn rest(&mut self) -> u64 {
        wait_until("it does not pause", || self.status(0)["paused"] == true);
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
    let mut training = Training::endless();
    let mut page = training.server.page();
    assert_eq!(page.greeting["training"], 1_000_000);
    assert_eq!(page.greeting["cameras"].as_array().map(Vec::len), Some(9));
    assert_eq!(training.server.get("/photo/0", &[]).0, 200);
    // Frames of the current scene, renewed while training runs.
    let mut request = view(1, &camera(0.0), &json!({}));
    request["follow"] = json!(true);
    page.send(&request);
    let iteration = |shown: &PageFrame| shown.header["iteration"].as_u64().expect("an iteration");
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
    let ply = training.place.at(point_cloud("model", at as u32 + 1));
    wait_until("nothing is saved", || ply.is_file());
    assert_eq!(page.rest(), at + 1, "a save leaves it waiting");
    page.act("resume");
    page.pass(at + 1);
    page.act("stop");
    let (code, stderr) = training.server.wait();
    assert_eq!(code, Some(130), "{stderr}");
    let last = training.place.read_text("model/last_iteration");
    assert!(training.place.has(format!("model/chkpnt{}.safetensors", last.trim())));
}

#[test]
fn viewer_does_not_change_a_training() {
    let cloud = |watched: bool| {
        let more = "200 --densify_from_iter 5 --densification_interval 10";
        let mut training = Training::start(more);
        let mut page = watched.then(|| training.server.page());
        if let Some(page) = &mut page {
            let mut request = view(1, &camera(0.0), &json!({ "mode": "tiles" }));
            request["follow"] = json!(true);
            page.send(&request);
            page.frame();
        }
        let (code, stderr) = training.server.wait();
        assert_eq!(code, Some(0), "{stderr}");
        training.place.ply("model", 200)
    };
    assert!(cloud(true) == cloud(false), "looking on has changed the training");
}

#[test]
fn viewer_survives_a_save_that_fails() {
    let mut training = Training::endless();
    let mut page = training.server.page();
    // A file blocks the folder of point clouds.
    training.place.write("model/point_cloud", "in the way");
    page.act("pause");
    let at = page.rest();
    page.act("save");
    let problem = page.wait_for_problem();
    assert!(problem.contains("point_cloud"), "{problem}");
    training.place.remove("model/point_cloud");
    page.act("step");
    page.reach(at + 1);
    page.act("stop");
    let (code, stderr) = training.server.wait();
    assert!(code == Some(130) && stderr.contains("warning: not saved"), "{code:?} {stderr}");
}
