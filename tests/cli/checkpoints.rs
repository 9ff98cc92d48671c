//! Checkpoints: written on request and on Ctrl-C, resumed, refused with a reason, and never half-written.

use super::*;
use crate::common::lpips_files;
use ashsplat_files::ply;

/// Its schedule does not stretch with the iterations.
const SCHEDULE: &str = "--strategy reference --sh_degree 1 --densify_from_iter 5 --densification_interval 10 \
                        --densify_until_iter 35 --opacity_reset_interval 11";

impl TestFolder {
    fn training(&self, model: &str, more: &str) -> Command {
        self.command(format!("train -s @data -m @{model} --quiet {SCHEDULE} {more}"))
    }

    /// Trains with a schedule that densifies within few iterations.
    pub(super) fn attempt(&self, model: &str, more: impl AsRef<str>) -> Finished {
        finish(&mut self.training(model, more.as_ref()))
    }

    #[track_caller]
    pub(super) fn train(&self, model: &str, more: impl AsRef<str>) -> Finished {
        self.attempt(model, more).ok()
    }
}

#[test]
fn a_resumed_training_equals_one_that_was_never_stopped() {
    let place = TestFolder::new();
    place.train("whole", "--iterations 40");
    // Stopped right before a densification and after an opacity reset, from which a run of 33 recovers, too.
    place.train("parts", "--iterations 33 --checkpoint_iterations 20 23");
    for (number, kept) in [("20", 1 + 20), ("23", 1 + 23)] {
        let log = || place.read_text("parts/train_log.csv");
        let before: Vec<String> = log().lines().take(kept).map(str::to_owned).collect();
        let resumed = format!("--iterations 40 --start_checkpoint @parts/chkpnt{number}.safetensors");
        place.train("parts", resumed);
        assert!(place.ply("parts", 40) == place.ply("whole", 40), "other bits from {number} on");
        assert_eq!(log().lines().count(), 41);
        assert!(log().lines().take(kept).eq(before), "the log's beginning has changed");
    }
    // A run that ends at a reset omits it, and a longer one that resumes there makes up for it.
    place.train("short", "--iterations 22 --checkpoint_iterations 22");
    let run = place.train("short", "--iterations 40 --start_checkpoint latest --save-iterations 24");
    assert!(place.ply("short", 40) == place.ply("whole", 40), "other bits");
    let run = run.warns(&["iteration_24/point_cloud.ply: saved 2 iterations after an opacity reset"]);
    assert!(!run.stderr.contains("iteration_40"), "{}", run.stderr);
    let scene = format!("--iterations 40 --start_checkpoint @{}", point_cloud("whole", 40));
    place.attempt("none", scene).refused(&["is a scene (PLY)", "--init"]);
    let refused = |model: &str, options: &str, words: &[&str]| {
        place.attempt(model, format!("--start_checkpoint latest --iterations {options}")).refused(words);
    };
    refused("parts", "40 --seed 1", &["chkpnt23.safetensors", "seed was 0, is 1"]);
    refused("parts", "23", &["iteration 23 already"]);
    let bytes = place.read("parts/chkpnt23.safetensors");
    place.write("parts/chkpnt23.safetensors", &bytes[..bytes.len() / 2]);
    refused("parts", "40", &["chkpnt23.safetensors", "truncated"]);
    refused("none", "40", &["no checkpoint", "--checkpoint-iterations"]);
    assert!(!place.has("none"));
}

/// The same command is repeated until training is done, as a scheduler does.
#[test]
fn the_same_command_continues_by_itself() {
    let place = TestFolder::new();
    place.train("whole", "--iterations 40");
    let auto = |iterations: &str| {
        let every = "--checkpoint-every 10 --checkpoint_iterations 20 --start_checkpoint auto";
        place.train("model", format!("{every} --iterations {iterations}"))
    };
    let checkpoints = || {
        let names = place.files("model").into_iter().map(|path| path.display().to_string());
        names.filter(|name| name.ends_with(".safetensors")).collect::<Vec<_>>()
    };
    auto("32").warns(&["has no checkpoint: training begins anew"]);
    // The newest automatic checkpoint, and the requested one.
    assert_eq!(checkpoints(), ["chkpnt20.safetensors", "chkpnt32.safetensors"]);
    // Files of a run that was killed between writing a checkpoint and removing the previous one.
    place.write("model/chkpnt30.safetensors", "");
    place.write("model/passing_checkpoints", "30\n32\n");
    let gone_on = auto("40");
    assert!(!gone_on.stderr.contains("anew"), "{}", gone_on.stderr);
    assert_eq!(checkpoints(), ["chkpnt20.safetensors", "chkpnt40.safetensors"]);
    assert!(place.ply("model", 40) == place.ply("whole", 40), "other bits");
    // Nothing remains to be done, which is no failure.
    let ply = place.at(point_cloud("model", 40));
    let written = || std::fs::metadata(&ply).and_then(|file| file.modified()).expect("a time");
    let before = written();
    auto("40").says(&["is trained to its end already"]);
    assert_eq!(written(), before);
    // Only the scene is missing, as if it could not be saved.
    place.remove("model/point_cloud");
    auto("40");
    assert!(place.ply("model", 40) == place.ply("whole", 40), "other bits");
    // A checkpoint named on the command line stays.
    let named = "--checkpoint-every 10 --iterations 50 --start-checkpoint @model/chkpnt40.safetensors";
    place.train("model", named);
    assert_eq!(checkpoints(), ["chkpnt20.safetensors", "chkpnt40.safetensors", "chkpnt50.safetensors"]);
}

/// The end of densification depends on the memory bound: a run that resumes with another bound warns.
#[test]
fn another_bound_of_memory_is_a_warning() {
    let place = TestFolder::new();
    let bounded = "--max-memory 1G --checkpoint_iterations 4 6 --iterations 8";
    let resume = "--start_checkpoint @model/chkpnt4.safetensors";
    place.train("model", bounded);
    let same = place.train("model", format!("{bounded} {resume}"));
    assert!(!same.stderr.contains("--max-memory"), "{}", same.stderr);
    for (more, words) in [("", "1G, here it is none"), ("--max-memory 2G", "1G, here it is 2G")] {
        let other = place.train("model", format!("{more} --iterations 8 {resume}")).warns(&["chkpnt4"]);
        let warned = other.stderr.lines().any(|line| line.contains("--max-memory") && line.contains(words));
        assert!(warned, "{}", other.stderr);
    }
}

/// The error names the total need, although photographs read ahead are the first that do not fit.
#[test]
fn memory_error_names_the_need() {
    let place = TestFolder::new();
    let refused = place.attempt("model", "--max-memory 1K");
    assert_eq!(refused.code, Some(2));
    let refused = refused.warns(&["more than 1024 (--max-memory)"]).stderr;
    let needed = refused.split("needs ").nth(1).and_then(|rest| rest.split(' ').next()).expect("bytes");
    place.train("model", format!("--max-memory {needed} --iterations 2"));
}

#[test]
fn offload_gives_the_same_scene() {
    let place = TestFolder::new();
    let usual = "--iterations 8 --checkpoint_iterations 4";
    place.train("here", usual);
    place.train("there", format!("{usual} --offload"));
    let first = "--start_checkpoint @here/chkpnt4.safetensors";
    place.train("resumed", format!("{usual} {first} --offload 1G"));
    for name in ["there", "resumed"] {
        assert!(place.ply(name, 8) == place.ply("here", 8), "{name}: another scene");
    }
    assert_says(place.read_text("there/report.html"), &["lie in the machine's memory"]);
    let refused = place.attempt("refused", format!("{usual} --offload 1K")).warns(&["--offload"]);
    assert_eq!(refused.code, Some(2));
    assert!(!place.has("refused"));
}

#[test]
fn determinism_is_verified_without_writing() {
    let place = TestFolder::new();
    let said = place.run("train -s @data --verify-determinism 3 --quiet").ok().stdout;
    assert!(said.starts_with("3 iterations twice on ") && said.contains("the same bits"), "{said}");
    assert_eq!(place.at("").read_dir().expect("the folder").count(), 1);
    let run = place.run("train -s @data --verify-determinism 3 --start_checkpoint latest");
    assert_ne!(run.code, Some(0));
    run.warns(&["-m/--model-path: is missing"]);
    // A run from a checkpoint verifies only the rest of the training.
    place.train("parts", "--iterations 12 --checkpoint_iterations 9");
    let run = place.train("parts", "--iterations 12 --start_checkpoint latest --verify-determinism 50");
    assert!(run.stdout.starts_with("3 iterations twice on "), "{}", run.stdout);
}

/// Kills a run. Returns true if it was still running.
fn kill(mut child: Running) -> bool {
    child.kill().ok();
    let status = child.wait().expect("it ends");
    #[cfg(unix)]
    let killed = std::os::unix::process::ExitStatusExt::signal(&status) == Some(9);
    #[cfg(windows)]
    let killed = status.code() == Some(1);
    assert!(killed || status.success(), "ends by itself, and fails: {status}");
    killed
}

/// Kills a few times; `ASHSPLAT_KILLS` sets the number.
///
/// The moments are counted in checkpoints, not in seconds, because the speed depends on the machine's load.
#[test]
fn killed_at_any_moment_training_continues() {
    let kills: u64 = std::env::var("ASHSPLAT_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(4);
    let place = TestFolder::new();
    let every: Vec<String> = (1..120).map(|n| n.to_string()).collect();
    let options = format!("--iterations 120 --checkpoint_iterations {}", every.join(" "));
    place.train("whole", &options);
    let newest = || -> Option<u32> {
        std::fs::read_to_string(place.at("killed/last_checkpoint")).ok()?.trim().parse().ok()
    };
    let begin = |checkpointed: bool| match checkpointed {
        true => format!("{options} --start_checkpoint latest"),
        false => options.clone(),
    };
    let (mut whole_files, mut alive, mut gone_on) = (0, 0, 0);
    for moment in 0..kills * 4 {
        if alive >= kills && gone_on > 0 {
            break;
        }
        let before = newest();
        let mut command = place.training("killed", &begin(before.is_some()));
        let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::null()));
        // Every fifth run dies before its first checkpoint. The moment within an iteration follows a low-discrepancy
        // sequence.
        let share = (0.5 + moment as f64 * 0.618_033_988_75) % 1.0;
        let wanted = before.unwrap_or(0) + [1, 9, 22, 4, 0][moment as usize % 5];
        let start = Instant::now();
        while newest().unwrap_or(0) < wanted && child.try_wait().expect("it is asked").is_none() {
            std::thread::sleep(Duration::from_millis(1));
            assert!(start.elapsed() < Duration::from_secs(300), "no checkpoint {wanted}");
        }
        std::thread::sleep(Duration::from_millis(40).mul_f64(share));
        let hit = kill(child);
        alive += u64::from(hit);
        gone_on += u64::from(hit && before.is_some() && newest() > before);
        for file in place.files("killed") {
            let name = file.to_string_lossy().into_owned();
            let path = place.at("killed").join(&file);
            if name.ends_with(".safetensors") {
                Checkpoint::read(&path).expect("whole");
                whole_files += 1;
            } else if name == "input.ply" {
                ply::read_points(&path, &mut Vec::new()).expect("whole");
            } else if name.ends_with(".ply") {
                splats::read(&path, &splats::ReadOptions::default()).expect(&name);
            }
        }
        // A new run begins once the last one has reached the end.
        if place.has("killed/point_cloud/iteration_120") {
            assert!(place.ply("killed", 120) == place.ply("whole", 120), "other bits");
            place.remove("killed");
        }
    }
    assert!(alive > 0 && gone_on > 0 && whole_files > 0, "{alive} {gone_on} {whole_files}");
    place.train("killed", begin(newest().is_some()));
    assert!(place.ply("killed", 120) == place.ply("whole", 120), "other bits");
}

/// No file may exceed a few KiB, like on a full disk.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_the_older_checkpoint_and_no_empty_folder() {
    let place = TestFolder::new();
    place.train("model", "--iterations 12 --checkpoint_iterations 5");
    let (before, files) = (place.read("model/chkpnt5.safetensors"), place.files("model"));
    for (saved, words) in
        [("40", "chkpnt7.safetensors: cannot write"), ("6", "iteration_6/point_cloud.ply: cannot write")]
    {
        let resumed = "--start_checkpoint latest --checkpoint_iterations 5 7 --iterations 30";
        let command = place.training("model", &format!("{resumed} --save_iterations {saved}"));
        // 24 blocks of 512 bytes: enough for text, too few for Gaussians. The signal is ignored, so that writing
        // fails. Training runs to its end.
        let mut limited = Command::new("sh");
        limited.args(["-c", "trap '' XFSZ; ulimit -f 24; exec \"$0\" \"$@\""]);
        limited.env_remove("ASHSPLAT_DEVICE").arg(command.get_program()).args(command.get_args());
        finish(&mut limited).fails(&["chkpnt30.safetensors", "cannot write"]).warns(&[words]);
    }
    assert_eq!(place.read("model/chkpnt5.safetensors"), before);
    assert_eq!(place.files("model"), files, "nothing new, nothing lost");
    assert!(!place.has("model/point_cloud/iteration_6"), "an empty folder is left");
    // With space again it resumes.
    place.train("model", "--iterations 12 --start_checkpoint latest");
}

#[test]
fn what_cannot_be_saved_is_tried_again() {
    let place = TestFolder::new();
    // These block the paths of the checkpoint, the scene and the test's pictures.
    place.create_folder("model/chkpnt5.safetensors");
    place.write("model/point_cloud", "in the way");
    place.write("model/test", "in the way");
    // No pruning, so that a scene remains to be saved.
    let mut training = place.start(
        "train -s @data -m @model --strategy fixed --eval --iterations 1000000 --quiet \
         --save_iterations 5 --test_iterations 5 --checkpoint_iterations 5",
    );
    for what in ["point_cloud", "test/ours_5", "chkpnt5"] {
        let line = training.lines.next().expect("a warning");
        assert!(line.starts_with("warning: ") && line.contains(what) && line.contains("goes on"), "{line}");
    }
    // The measurements are saved without the pictures.
    assert_says(place.read_text("model/results.json"), &["ours_5"]);
    place.remove("model/point_cloud");
    wait_until("nothing is saved", || {
        let files = place.files("model");
        let has = |ending: &str| files.iter().any(|file| file.to_string_lossy().ends_with(ending));
        has("point_cloud.ply") && has(".safetensors")
    });
    training.interrupt();
}

/// After Ctrl-C with --quiet, the message gives a command that resumes from any folder.
#[test]
fn a_quiet_training_says_how_to_go_on() {
    let place = TestFolder::new();
    lpips_files::write(&place.at("lpips"), &lpips_files::alexnet(0));
    let train = "train -s data -m model --quiet --iterations 1000000 --lpips-weights lpips";
    let mut command = place.command(format!("{train} {SCHEDULE}"));
    command.current_dir(place.at("")).stdout(Stdio::null()).stderr(Stdio::piped());
    let child = Running::start(&mut command);
    let log = place.at("model/train_log.csv");
    wait_until("no iterations", || {
        std::fs::read_to_string(&log).is_ok_and(|text| text.lines().count() >= 100)
    });
    child.interrupt();
    let Finished { code, stderr, .. } = child.finish().into();
    assert_eq!(code, Some(130), "{stderr}");
    let advice = stderr.lines().find_map(|line| line.strip_prefix("interrupted: to go on, ashsplat "));
    let text = place.read_text("model/train_log.csv");
    let last: u32 =
        text.lines().last().and_then(|line| line.split(',').next()?.parse().ok()).expect("a line");
    let elsewhere = TestFolder::empty();
    let again = format!("{} --quiet --iterations {}", advice.expect("how to go on"), last + 2);
    finish(elsewhere.command(again).current_dir(elsewhere.at(""))).ok().says(&["lpips_alex"]);
    assert!(!place.ply("model", last + 2).is_empty());
}

/// A model folder without write permission, and one that cannot be created.
#[cfg(unix)]
#[test]
fn a_read_only_folder_is_refused_and_keeps_its_checkpoint() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    use std::os::unix::process::CommandExt;
    let place = TestFolder::new();
    place.train("model", "--iterations 12 --checkpoint_iterations 5");
    let model = place.at("model");
    place.write("file", "no folder");
    place.attempt("file/model", "--iterations 12").refused(&["file"]);
    assert_eq!(place.read("file"), b"no folder");
    let (before, files) = (place.read("model/chkpnt5.safetensors"), place.files("model"));
    let allow = |mode: u32| {
        for folder in files.iter().filter_map(|file| model.join(file).parent().map(Path::to_owned)) {
            std::fs::set_permissions(folder, PermissionsExt::from_mode(mode)).expect("ours");
        }
    };
    let resumed = "--start_checkpoint latest --checkpoint_iterations 7 --iterations 30";
    let mut command = place.training("model", resumed);
    command.env("MESA_SHADER_CACHE_DISABLE", "true");
    if std::fs::metadata(&model).expect("the folder").uid() == 0 {
        // The superuser may write everywhere, so the test runs as another user.
        const NOBODY: u32 = 65_534;
        std::fs::set_permissions(place.at(""), PermissionsExt::from_mode(0o755)).expect("ours");
        command.uid(NOBODY).gid(NOBODY);
    }
    allow(0o555);
    let run = command.output();
    allow(0o755);
    match run {
        Err(error) => eprintln!("skipped: the user nobody may not start the program ({error})"),
        Ok(output) => {
            let run = Finished::from(output).refused(&[text(&model)]);
            assert_eq!(run.stderr.lines().count(), 1, "{}", run.stderr);
        }
    }
    assert_eq!(place.read("model/chkpnt5.safetensors"), before);
    assert_eq!(place.files("model"), files, "nothing new, nothing lost");
    place.train("model", "--iterations 14 --start_checkpoint latest");
}
