//! Checkpoints: written on request and on Ctrl-C, resumed, refused with a reason, and never half-written.

use super::*;
use crate::common::lpips_files;
use crate::program::running::Running;
use ashsplat_files::{CheckpointFile, ply};
use std::process::Stdio;
use std::time::Duration;
use tempfile::{TempDir, tempdir};

const SCHEDULE: [&str; 12] = [
    // Its schedule does not stretch with the iterations.
    "--strategy",
    "reference",
    "--sh_degree",
    "1",
    "--densify_from_iter",
    "5",
    "--densification_interval",
    "10",
    "--densify_until_iter",
    "35",
    "--opacity_reset_interval",
    "11",
];

pub(super) struct Place {
    folder: TempDir,
}

impl Place {
    pub(super) fn new() -> Place {
        let folder = tempdir().expect("a temporary folder");
        write_dataset(&folder.path().join("data"));
        Place { folder }
    }

    pub(super) fn model(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, model: &str, more: &[&str]) -> Command {
        let (data, model) = (self.folder.path().join("data"), self.model(model));
        let mut command = program();
        command.args(["train", "-s", text(&data), "-m", text(&model), "--quiet"]).args(SCHEDULE).args(more);
        command
    }

    pub(super) fn train(&self, model: &str, more: &[&str]) -> Finished {
        finish(&mut self.command(model, more))
    }

    pub(super) fn ply(&self, model: &str, iteration: u32) -> Vec<u8> {
        let path = format!("point_cloud/iteration_{iteration}/point_cloud.ply");
        std::fs::read(self.model(model).join(&path)).expect("a PLY")
    }
}

pub(super) fn assert_trained(run: &Finished) {
    assert_eq!(run.code, Some(0), "{}", run.stderr);
}

#[test]
fn a_resumed_training_equals_one_that_was_never_stopped() {
    let place = Place::new();
    assert_trained(&place.train("whole", &["--iterations", "40"]));
    // Stopped right before a densification and after an opacity reset, from which a run of 33 recovers, too.
    assert_trained(&place.train("parts", &["--iterations", "33", "--checkpoint_iterations", "20", "23"]));
    for (number, kept) in [("20", 1 + 20), ("23", 1 + 23)] {
        let file = place.model("parts").join(format!("chkpnt{number}.safetensors"));
        let log = || std::fs::read_to_string(place.model("parts").join("train_log.csv")).expect("the log");
        let before: Vec<String> = log().lines().take(kept).map(str::to_owned).collect();
        assert_trained(&place.train("parts", &["--iterations", "40", "--start_checkpoint", text(&file)]));
        assert!(place.ply("parts", 40) == place.ply("whole", 40), "other bits from {number} on");
        assert_eq!(log().lines().count(), 41);
        assert!(log().lines().take(kept).eq(before), "the log's beginning has changed");
    }
    // A run that ends at a reset omits it, and a longer one that resumes there makes up for it.
    assert_trained(&place.train("short", &["--iterations", "22", "--checkpoint_iterations", "22"]));
    let longer = ["--iterations", "40", "--start_checkpoint", "latest", "--save-iterations", "24"];
    let run = place.train("short", &longer);
    assert_trained(&run);
    assert!(place.ply("short", 40) == place.ply("whole", 40), "other bits");
    assert!(run.stderr.contains("iteration_24/point_cloud.ply: saved 2 iterations after an opacity reset"));
    assert!(!run.stderr.contains("iteration_40"), "{}", run.stderr);
    let scene = place.model("whole").join("point_cloud/iteration_40/point_cloud.ply");
    let started = place.train("none", &["--iterations", "40", "--start_checkpoint", text(&scene)]);
    assert_refused(&started, &["is a scene (PLY)", "--init"]);
    let latest = place.train("parts", &["--iterations", "40", "--start_checkpoint", "latest", "--seed", "1"]);
    assert_refused(&latest, &["chkpnt23.safetensors", "seed was 0, is 1"]);
    let over = place.train("parts", &["--iterations", "23", "--start_checkpoint", "latest"]);
    assert_refused(&over, &["iteration 23 already"]);
    let file = place.model("parts").join("chkpnt23.safetensors");
    let bytes = std::fs::read(&file).expect("the checkpoint");
    std::fs::write(&file, &bytes[..bytes.len() / 2]).expect("written");
    let cut = place.train("parts", &["--iterations", "40", "--start_checkpoint", "latest"]);
    assert_refused(&cut, &["chkpnt23.safetensors", "truncated"]);
    let none = place.train("none", &["--iterations", "40", "--start_checkpoint", "latest"]);
    assert_refused(&none, &["no checkpoint", "--checkpoint-iterations"]);
    assert!(!place.model("none").exists());
}

/// The same command is repeated until training is done, as a scheduler does.
#[test]
fn the_same_command_goes_on_by_itself() {
    let place = Place::new();
    assert_trained(&place.train("whole", &["--iterations", "40"]));
    let auto = |iterations: &str| {
        let every =
            ["--checkpoint-every", "10", "--checkpoint_iterations", "20", "--start_checkpoint", "auto"];
        place.train("model", &[every.as_slice(), &["--iterations", iterations]].concat())
    };
    let checkpoints = || {
        let names = files_below(&place.model("model")).into_iter().map(|path| path.display().to_string());
        let mut names: Vec<_> = names.filter(|name| name.ends_with(".safetensors")).collect();
        names.sort();
        names
    };
    let begun = auto("32");
    assert_trained(&begun);
    assert!(begun.stderr.contains("has no checkpoint: training begins anew"), "{}", begun.stderr);
    // The newest automatic checkpoint, and the requested one.
    assert_eq!(checkpoints(), ["chkpnt20.safetensors", "chkpnt32.safetensors"]);
    // Files of a run that was killed between writing a checkpoint and removing the previous one.
    let model = place.model("model");
    std::fs::write(model.join("chkpnt30.safetensors"), "").expect("written");
    std::fs::write(model.join("passing_checkpoints"), "30\n32\n").expect("written");
    let gone_on = auto("40");
    assert_trained(&gone_on);
    assert!(!gone_on.stderr.contains("anew"), "{}", gone_on.stderr);
    assert_eq!(checkpoints(), ["chkpnt20.safetensors", "chkpnt40.safetensors"]);
    assert!(place.ply("model", 40) == place.ply("whole", 40), "other bits");
    // Nothing remains to be done, which is no failure.
    let ply = place.model("model").join("point_cloud/iteration_40/point_cloud.ply");
    let written = || std::fs::metadata(&ply).and_then(|file| file.modified()).expect("a time");
    let before = written();
    let done = auto("40");
    assert_trained(&done);
    assert!(done.stdout.contains("is trained to its end already"), "{}", done.stdout);
    assert_eq!(written(), before);
    // Only the scene is missing, as if it could not be saved.
    std::fs::remove_dir_all(model.join("point_cloud")).expect("removed");
    assert_trained(&auto("40"));
    assert!(place.ply("model", 40) == place.ply("whole", 40), "other bits");
    // A checkpoint named on the command line stays.
    let last = model.join("chkpnt40.safetensors");
    let named = ["--checkpoint-every", "10", "--iterations", "50", "--start-checkpoint", text(&last)];
    assert_trained(&place.train("model", &named));
    assert_eq!(checkpoints(), ["chkpnt20.safetensors", "chkpnt40.safetensors", "chkpnt50.safetensors"]);
}

/// The end of densification depends on the memory bound: a run that resumes with another bound warns.
#[test]
fn another_bound_of_memory_is_a_warning() {
    let place = Place::new();
    let bounded = ["--max-memory", "1G", "--checkpoint_iterations", "4", "6", "--iterations"];
    let run = place.train("model", &[&bounded[..], &["8"]].concat());
    assert_trained(&run);
    let first = text(&place.model("model").join("chkpnt4.safetensors")).to_owned();
    let resume = ["--start_checkpoint", &first];
    let same = place.train("model", &[&bounded[..], &["8"], &resume].concat());
    assert_trained(&same);
    assert!(!same.stderr.contains("--max-memory"), "{}", same.stderr);
    for (more, words) in [(vec![], "1G, here it is none"), (vec!["--max-memory", "2G"], "1G, here it is 2G")]
    {
        let other = place.train("model", &[&more[..], &["--iterations", "8"], &resume].concat());
        assert_trained(&other);
        let warned = other.stderr.lines().any(|line| line.contains("--max-memory") && line.contains(words));
        assert!(warned && other.stderr.contains("chkpnt4"), "{}", other.stderr);
    }
}

/// The error names the total need, although photographs read ahead are the first that do not fit.
#[test]
fn too_little_memory_is_told_how_much_would_do() {
    let place = Place::new();
    let refused = place.train("model", &["--max-memory", "1K"]);
    assert!(
        refused.code == Some(2) && refused.stderr.contains("more than 1024 (--max-memory)"),
        "{}",
        refused.stderr
    );
    let needed =
        refused.stderr.split("needs ").nth(1).and_then(|rest| rest.split(' ').next()).expect("bytes");
    assert_trained(&place.train("model", &["--max-memory", needed, "--iterations", "2"]));
}

/// Training in host memory gives the same scene as in device memory, also when it resumes there.
#[test]
fn offload_gives_the_same_scene() {
    let place = Place::new();
    let usual = ["--iterations", "8", "--checkpoint_iterations", "4"];
    let scene = |name: &str| place.ply(name, 8);
    assert_trained(&place.train("here", &usual));
    assert_trained(&place.train("there", &[&usual[..], &["--offload"]].concat()));
    assert!(scene("there") == scene("here"), "another scene");
    let first = text(&place.model("here").join("chkpnt4.safetensors")).to_owned();
    let resumed = ["--start_checkpoint", &first, "--offload", "1G"];
    assert_trained(&place.train("resumed", &[&usual[..], &resumed].concat()));
    assert!(scene("resumed") == scene("here"), "another scene");
    let report = std::fs::read_to_string(place.model("there").join("report.html")).expect("a report");
    assert!(report.contains("lie in the machine's memory"));
    let refused = place.train("refused", &[&usual[..], &["--offload", "1K"]].concat());
    assert!(refused.code == Some(2) && refused.stderr.contains("--offload"), "{}", refused.stderr);
    assert!(!place.model("refused").exists());
}

#[test]
fn determinism_is_verified_without_writing() {
    let place = Place::new();
    let data = place.folder.path().join("data");
    let said = succeed(&["train", "-s", text(&data), "--verify-determinism", "3", "--quiet"]);
    assert!(said.starts_with("3 iterations twice on ") && said.contains("the same bits"), "{said}");
    assert_eq!(place.folder.path().read_dir().expect("the folder").count(), 1);
    // `latest` needs a model folder.
    let asked = ["train", "-s", text(&data), "--verify-determinism", "3", "--start_checkpoint", "latest"];
    let run = finish(program().args(asked));
    assert!(run.code != Some(0) && run.stderr.contains("-m/--model-path: is missing"), "{}", run.stderr);
    // From a checkpoint, only the rest of the training.
    assert_trained(&place.train("parts", &["--iterations", "12", "--checkpoint_iterations", "9"]));
    let more = ["--iterations", "12", "--start_checkpoint", "latest", "--verify-determinism", "50"];
    let run = finish(&mut place.command("parts", &more));
    assert!(
        run.code == Some(0) && run.stdout.starts_with("3 iterations twice on "),
        "{}{}",
        run.stdout,
        run.stderr
    );
}

/// Kills a run. Returns true if it was still running.
#[cfg(unix)]
fn kill(mut child: Running) -> bool {
    use std::os::unix::process::ExitStatusExt;
    child.kill().ok();
    let status = child.wait().expect("it ends");
    let killed = status.signal() == Some(9);
    assert!(killed || status.success(), "ends by itself, and fails: {status}");
    killed
}

/// Kills a few times; `ASHSPLAT_KILLS` sets the number.
///
/// The moments are counted in checkpoints, not in seconds, because the speed depends on the machine's load.
#[cfg(unix)]
#[test]
fn killed_at_any_moment_training_goes_on() {
    let kills: u64 = std::env::var("ASHSPLAT_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(4);
    let place = Place::new();
    let every: Vec<String> = (1..120).map(|n| n.to_string()).collect();
    let mut arguments = vec!["--iterations", "120", "--checkpoint_iterations"];
    arguments.extend(every.iter().map(String::as_str));
    assert_trained(&place.train("whole", &arguments));
    let newest = || -> Option<u32> {
        std::fs::read_to_string(place.model("killed").join("last_checkpoint")).ok()?.trim().parse().ok()
    };
    let begin = |checkpointed: bool| match checkpointed {
        true => [arguments.as_slice(), &["--start_checkpoint", "latest"]].concat(),
        false => arguments.clone(),
    };
    let (mut whole_files, mut alive, mut gone_on) = (0, 0, 0);
    for moment in 0..kills * 4 {
        if alive >= kills && gone_on > 0 {
            break;
        }
        let before = newest();
        let mut command = place.command("killed", &begin(before.is_some()));
        let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::null()));
        // Every fifth run dies before its first checkpoint. The moment within an iteration follows a low-discrepancy
        // sequence.
        let share = (0.5 + moment as f64 * 0.618_033_988_75) % 1.0;
        let wanted = before.unwrap_or(0) + [1, 9, 22, 4, 0][moment as usize % 5];
        let start = std::time::Instant::now();
        while newest().unwrap_or(0) < wanted && child.try_wait().expect("it is asked").is_none() {
            std::thread::sleep(Duration::from_millis(1));
            assert!(start.elapsed() < Duration::from_secs(300), "no checkpoint {wanted}");
        }
        std::thread::sleep(Duration::from_millis(40).mul_f64(share));
        let hit = kill(child);
        alive += u64::from(hit);
        gone_on += u64::from(hit && before.is_some() && newest() > before);
        for file in files_below(&place.model("killed")) {
            let name = file.to_string_lossy().into_owned();
            let path = place.model("killed").join(&file);
            if name.ends_with(".safetensors") {
                ashsplat::trainer::Checkpoint::read(&path).expect("whole");
                whole_files += 1;
            } else if name.ends_with(".ply") {
                let points = name == "input.ply";
                let whole = if points {
                    ply::read_points(&path).is_ok()
                } else {
                    ply::read(&path, &ply::PlyOptions::default()).is_ok()
                };
                assert!(whole, "{name}");
            }
        }
        // A new run begins once the last one has reached the end.
        if place.model("killed").join("point_cloud/iteration_120").exists() {
            assert!(place.ply("killed", 120) == place.ply("whole", 120), "other bits");
            std::fs::remove_dir_all(place.model("killed")).expect("removed");
        }
    }
    eprintln!("{alive} kills of a live process, {gone_on} of runs that had gone on from a checkpoint");
    eprintln!("{whole_files} times a checkpoint was found whole");
    assert!(alive > 0 && gone_on > 0 && whole_files > 0, "{alive} {gone_on} {whole_files}");
    assert_trained(&place.train("killed", &begin(newest().is_some())));
    assert!(place.ply("killed", 120) == place.ply("whole", 120), "other bits");
}

/// No file may exceed a few KiB, like on a full disk.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_the_older_checkpoint_and_no_empty_folder() {
    let place = Place::new();
    assert_trained(&place.train("model", &["--iterations", "12", "--checkpoint_iterations", "5"]));
    let checkpoint = place.model("model").join("chkpnt5.safetensors");
    let before = std::fs::read(&checkpoint).expect("the checkpoint");
    let files = files_below(&place.model("model"));
    let full = |more: &[&str]| {
        let command = place.command("model", more);
        let mut limited = Command::new("sh");
        // 24 blocks of 512 bytes: enough for text, too few for Gaussians. The signal is ignored, so that writing
        // fails.
        limited.args(["-c", "trap '' XFSZ; ulimit -f 24; exec \"$0\" \"$@\""]);
        limited.env_remove("ASHSPLAT_DEVICE");
        finish(limited.arg(command.get_program()).args(command.get_args()))
    };
    let resumed = ["--start_checkpoint", "latest", "--checkpoint_iterations", "5", "7", "--save_iterations"];
    let run = full(&[resumed.as_slice(), &["40", "--iterations", "30"]].concat());
    // Training runs to its end.
    assert_refused_with_warnings(&run, &["chkpnt30.safetensors", "cannot write"]);
    assert!(run.stderr.contains("chkpnt7.safetensors: cannot write"), "{}", run.stderr);
    let run = full(&[resumed.as_slice(), &["6", "--iterations", "30"]].concat());
    assert_refused_with_warnings(&run, &["chkpnt30.safetensors", "cannot write"]);
    assert!(run.stderr.contains("iteration_6/point_cloud.ply: cannot write"), "{}", run.stderr);
    assert_eq!(std::fs::read(&checkpoint).expect("the checkpoint"), before);
    assert_eq!(files_below(&place.model("model")), files, "nothing new, nothing lost");
    let left = place.model("model").join("point_cloud/iteration_6");
    assert!(!left.exists(), "an empty folder is left");
    // With space again it resumes.
    assert_trained(&place.train("model", &["--iterations", "12", "--start_checkpoint", "latest"]));
}

/// Training continues while the disk refuses files, and saves them later.
#[cfg(unix)]
#[test]
fn what_cannot_be_saved_is_tried_again() {
    use std::io::{BufRead, BufReader};
    let place = Place::new();
    let model = place.model("model");
    std::fs::create_dir_all(model.join("chkpnt5.safetensors")).expect("created");
    // Files block the paths of the scene, the test's pictures and the checkpoint.
    for name in ["point_cloud", "test"] {
        std::fs::write(model.join(name), "in the way").expect("written");
    }
    // No pruning, so that a scene remains to be saved.
    let mut asked = vec!["--strategy", "fixed", "--eval", "--iterations", "1000000", "--quiet"];
    asked.extend(
        ["--save_iterations", "--test_iterations", "--checkpoint_iterations"].map(|o| [o, "5"]).concat(),
    );
    let data = place.folder.path().join("data");
    let mut command = program();
    command.args(["train", "-s", text(&data), "-m", text(&model)]).args(asked);
    let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
    let mut lines = BufReader::new(child.stderr.take().expect("its stderr")).lines().map_while(Result::ok);
    for what in ["point_cloud", "test/ours_5", "chkpnt5"] {
        let line = lines.next().expect("a warning");
        assert!(line.starts_with("warning: ") && line.contains(what) && line.contains("goes on"), "{line}");
    }
    // The measurements are saved without the pictures.
    let results = std::fs::read_to_string(model.join("results.json")).expect("the results");
    assert!(results.contains("ours_5"), "{results}");
    std::fs::remove_file(model.join("point_cloud")).expect("removed");
    let start = std::time::Instant::now();
    let saved = || {
        let files = files_below(&model);
        let has = |ending: &str| files.iter().any(|file| file.to_string_lossy().ends_with(ending));
        has("point_cloud.ply") && has(".safetensors")
    };
    while !saved() {
        assert!(start.elapsed() < Duration::from_secs(120), "{:?}", files_below(&model));
        std::thread::sleep(Duration::from_millis(100));
    }
    child.interrupt();
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().expect("it ends").code(), Some(130), "{rest:?}");
}

/// After Ctrl-C with --quiet, the message gives a command that resumes from any folder.
#[cfg(unix)]
#[test]
fn a_quiet_training_says_how_to_go_on() {
    let place = Place::new();
    let train = ["train", "-s", "data", "-m", "model", "--quiet", "--iterations", "1000000"];
    let mut command = program();
    command.current_dir(place.folder.path()).args(train).args(SCHEDULE);
    lpips_files::write(&place.model("lpips"), &lpips_files::alexnet(0));
    let child = Running::start(
        command.args(["--lpips-weights", "lpips"]).stdout(Stdio::null()).stderr(Stdio::piped()),
    );
    let log = place.model("model").join("train_log.csv");
    let start = std::time::Instant::now();
    while std::fs::read_to_string(&log).map_or(0, |text| text.lines().count()) < 100 {
        assert!(start.elapsed() < Duration::from_secs(120), "no iterations");
        std::thread::sleep(Duration::from_millis(50));
    }
    child.interrupt();
    let output = child.finish();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    let advice = stderr.lines().find_map(|line| line.strip_prefix("interrupted: to go on, ashsplat "));
    let typed: Vec<&str> = advice.expect("how to go on").split(' ').collect();
    let text = std::fs::read_to_string(&log).expect("the log");
    let last: u32 =
        text.lines().last().and_then(|line| line.split(',').next()?.parse().ok()).expect("a line");
    let next = (last + 2).to_string();
    let elsewhere = tempdir().expect("a temporary folder");
    let mut again = program();
    again.current_dir(elsewhere.path()).args(typed).args(["--quiet", "--iterations", &next]);
    let run = finish(&mut again);
    assert_trained(&run);
    assert!(run.stdout.contains("lpips_alex"), "{}", run.stdout);
    assert!(!place.ply("model", last + 2).is_empty());
}

/// A model folder without write permission, and one that cannot be created.
#[cfg(unix)]
#[test]
fn a_read_only_folder_is_refused_and_keeps_its_checkpoint() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    use std::os::unix::process::CommandExt;
    let place = Place::new();
    assert_trained(&place.train("model", &["--iterations", "12", "--checkpoint_iterations", "5"]));
    let model = place.model("model");
    let (file, checkpoint) = (place.model("file"), model.join("chkpnt5.safetensors"));
    std::fs::write(&file, "no folder").expect("written");
    assert_refused(&place.train("file/model", &["--iterations", "12"]), &["file"]);
    assert_eq!(std::fs::read(&file).expect("the file"), b"no folder");
    let (before, files) = (std::fs::read(&checkpoint).expect("the checkpoint"), files_below(&model));
    let allow = |mode: u32| {
        let folders = files.iter().filter_map(|file| model.join(file).parent().map(Path::to_owned));
        for folder in folders {
            std::fs::set_permissions(folder, PermissionsExt::from_mode(mode)).expect("ours");
        }
    };
    let mut command = place.command(
        "model",
        &["--start_checkpoint", "latest", "--checkpoint_iterations", "7", "--iterations", "30"],
    );
    command.env("MESA_SHADER_CACHE_DISABLE", "true");
    if std::fs::metadata(&model).expect("the folder").uid() == 0 {
        // The superuser may write everywhere, so the test runs as another user.
        const NOBODY: u32 = 65_534;
        std::fs::set_permissions(place.folder.path(), PermissionsExt::from_mode(0o755)).expect("ours");
        command.uid(NOBODY).gid(NOBODY);
    }
    allow(0o555);
    let run = command.output();
    allow(0o755);
    match run {
        Err(error) => eprintln!("skipped: the user nobody may not start the program ({error})"),
        Ok(output) => {
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{stderr}");
            assert!(stderr.starts_with("error: ") && stderr.contains(text(&model)), "{stderr}");
            assert_eq!(stderr.lines().count(), 1, "{stderr}");
        }
    }
    assert_eq!(std::fs::read(&checkpoint).expect("the checkpoint"), before);
    assert_eq!(files_below(&model), files, "nothing new, nothing lost");
    assert_trained(&place.train("model", &["--iterations", "14", "--start_checkpoint", "latest"]));
}

fn assert_refused_with_warnings(run: &Finished, words: &[&str]) {
    assert_eq!(run.code, Some(2), "{}{}", run.stdout, run.stderr);
    let last = run.stderr.lines().last().unwrap_or_default();
    assert!(last.starts_with("error: "), "{}", run.stderr);
    words.iter().for_each(|word| assert!(last.contains(word), "no '{word}' in {}", run.stderr));
}
