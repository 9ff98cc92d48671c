//! `train`, and commands on its results.

use super::*;
use crate::common::gpu::Gpu;
use crate::program::running::Running;
use ashsplat::loss::Windowing;
use ashsplat::trainer::Checkpoint;
use ashsplat_files::CheckpointFile;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::sync::OnceLock;
use tempfile::tempdir;

/// A data set and a model trained on it for a few iterations; created once.
pub(super) struct Trained {
    pub(super) data: PathBuf,
    pub(super) model: PathBuf,
    stdout: String,
}

pub(super) fn trained() -> &'static Trained {
    static TRAINED: OnceLock<Trained> = OnceLock::new();
    TRAINED.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli");
        std::fs::remove_dir_all(&folder).ok();
        let (data, model) = (folder.join("data"), folder.join("model"));
        write_dataset(&data);
        // Option names with hyphens and with underscores.
        let schedule =
            ["--iterations", "30", "--sh_degree", "1", "--sh-degree-interval=10", "--test_iterations", "10"];
        let densify = ["--densify_from_iter", "5", "--densification-interval=10", "--densify_until_iter=25"];
        let paths =
            ["train", "-s", text(&data), "-m", text(&model), "--eval", "--seed=4", "--save-iterations", "20"];
        let stdout = succeed(&[paths.as_slice(), &schedule, &densify].concat());
        Trained { data, model, stdout }
    })
}

fn json(path: PathBuf) -> Value {
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn leaves_what_the_reference_leaves() {
    let model = &trained().model;
    let mut expected: Vec<PathBuf> = [
        "cameras.json",
        "cfg_args",
        "input.ply",
        "last_iteration",
        "per_view.json",
        "report.html",
        "results.json",
        "settings.toml",
        "train_log.csv",
    ]
    .map(PathBuf::from)
    .to_vec();
    for iteration in [20, 30] {
        expected.push(format!("point_cloud/iteration_{iteration}/point_cloud.ply").into());
    }
    for (iteration, kind, index) in [10, 30]
        .iter()
        .flat_map(|i| ["renders", "gt"].map(|k| (i, k)))
        .flat_map(|(i, k)| [0, 1].map(|n| (i, k, n)))
    {
        expected.push(format!("test/ours_{iteration}/{kind}/{index:05}.png").into());
    }
    expected.sort();
    assert_eq!(files_below(model), expected);
}

#[test]
fn results_have_the_references_form() {
    let model = &trained().model;
    let (results, per_view) = (json(model.join("results.json")), json(model.join("per_view.json")));
    for run in ["ours_10", "ours_30"] {
        for metric in ["PSNR", "SSIM"] {
            let views = per_view[run][metric].as_object().expect("views");
            assert_eq!(views.keys().collect::<Vec<_>>(), ["00000.png", "00001.png"]);
            let mean = views.values().filter_map(Value::as_f64).sum::<f64>() / 2.0;
            assert!((mean - results[run][metric].as_f64().expect("a mean")).abs() < 1e-9);
        }
    }
    assert!(results["ours_30"]["PSNR"].as_f64() > results["ours_10"]["PSNR"].as_f64(), "{results}");
    assert_eq!(json(model.join("cameras.json")).as_array().map(Vec::len), Some(9));
}

#[test]
fn log_has_a_line_for_each_iteration() {
    let log = std::fs::read_to_string(trained().model.join("train_log.csv")).expect("the log");
    let rows: Vec<Vec<&str>> = log.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 31);
    assert_eq!(rows[0][..6], ["iteration", "loss", "psnr", "gaussians", "ms", "skipped"]);
    // Resident and peak bytes of each arena.
    let last = rows[0].len() - 1;
    assert_eq!(rows[0][last], "tracked_psnr");
    let arenas: Vec<&str> =
        rows[0][6..last].iter().step_by(2).filter_map(|n| n.strip_suffix("_bytes")).collect();
    assert_eq!(arenas[..3], ["total", "scene", "moments"]);
    for row in &rows[1..] {
        let bytes: Vec<u64> = row[6..last].iter().map(|n| n.parse().expect("bytes")).collect();
        assert!(bytes.as_chunks::<2>().0.iter().all(|[now, peak]| now <= peak), "{row:?}");
        let parts: u64 = bytes.iter().skip(2).step_by(2).sum();
        assert!(parts <= bytes[0] && bytes[2] > 0 && bytes[4] > 0, "{row:?}");
    }
    let loss = |row: usize| rows[row][1].parse::<f64>().expect("a loss");
    assert!(loss(30) < loss(1), "{log}");
    let tested: Vec<usize> = (1..31).filter(|&row| !rows[row][2].is_empty()).collect();
    assert_eq!(tested, [10, 30]);
    // Tracking covers both held-out views: after a test the two columns agree.
    assert!(tested.iter().all(|&row| rows[row][last] == rows[row][2]), "{log}");
    assert!(rows[1..].iter().all(|row| row[5] == "0"), "{log}");
}

#[test]
fn reports_speed_and_quality() {
    let said = &trained().stdout;
    for word in ["iteration 30: PSNR", "held-out views", "it/s", "all 30 iterations"] {
        assert!(said.contains(word), "no '{word}' in {said}");
    }
    if cfg!(target_os = "linux") {
        assert!(said.contains("CPU-seconds per iteration"), "{said}");
    }
}

#[test]
fn settings_are_dumped_and_read_back() {
    let Trained { model, .. } = trained();
    let dump = std::fs::read_to_string(model.join("settings.toml")).expect("the dump");
    for line in
        ["sh_degree = 1", "densification_interval = 10", "densify_until_iter = 25", "seed = 4", "eval = true"]
    {
        assert!(dump.lines().any(|l| l == line), "no '{line}' in {dump}");
    }
    let arguments = std::fs::read_to_string(model.join("cfg_args")).expect("cfg_args");
    assert!(arguments.starts_with("Namespace(sh_degree=1, source_path='"), "{arguments}");
    // The same settings give the same scene, to the last bit. The command line has priority over the file.
    let folder = tempdir().expect("a temporary folder");
    let again = folder.path().join("again");
    succeed(&[
        "train",
        "--config",
        text(&model.join("settings.toml")),
        "-m",
        text(&again),
        "--test_iterations",
        "-1",
        "--quiet",
    ]);
    let ply = |folder: &Path| {
        std::fs::read(folder.join("point_cloud/iteration_30/point_cloud.ply")).expect("a PLY")
    };
    assert!(ply(&again) == ply(model), "two runs with the same settings differ");
}

#[test]
fn eval_agrees_with_training() {
    let Trained { data, model, .. } = trained();
    let during = json(model.join("results.json"))["ours_30"].clone();
    let after: Value =
        serde_json::from_str(&succeed(&["eval", text(model), "--json", "--quiet"])).expect("JSON");
    // The PLY alone with the data set: the same views are held out.
    let ply = model.join("point_cloud/iteration_30/point_cloud.ply");
    let bare: Value =
        serde_json::from_str(&succeed(&["eval", text(&ply), "-s", text(data), "--json"])).expect("JSON");
    for metric in ["PSNR", "SSIM"] {
        let value = |of: &Value| of[metric].as_f64().expect("a number");
        assert!((value(&during) - value(&after["mean"])).abs() < 1e-4, "{during} {after}");
        assert!((value(&bare["mean"]) - value(&after["mean"])).abs() < 1e-4, "{bare} {after}");
    }
    let table = succeed(&["eval", "-m", text(model), "--quiet"]);
    assert!(table.contains("01.png") && table.contains("09.png") && table.contains("mean of 2"), "{table}");

    // A model trained on all views has no held-out views to measure.
    let folder = tempdir().expect("a temporary folder");
    let saved = "point_cloud/iteration_30/point_cloud.ply";
    std::fs::create_dir_all(folder.path().join(saved).parent().expect("a folder")).expect("created");
    std::fs::copy(&ply, folder.path().join(saved)).expect("copied");
    let settings = std::fs::read_to_string(model.join("settings.toml")).expect("the dump");
    let settings = settings.replace("eval = true", "eval = false");
    std::fs::write(folder.path().join("settings.toml"), settings).expect("written");
    let run = finish(program().args(["eval", text(folder.path()), "--eval", "--quiet"]));
    assert!(run.code == Some(0) && run.stderr.contains("was trained on all views"), "{}", run.stderr);
}

/// `eval` reads photos one at a time, and only those that it measures.
#[test]
fn eval_reads_what_it_measures() {
    let folder = tempdir().expect("a temporary folder");
    let data = folder.path().join("data");
    write_dataset(&data);
    std::fs::write(data.join("images/04.png"), "damaged").expect("written");
    let ply = trained().model.join("point_cloud/iteration_30/point_cloud.ply");
    let eval = ["eval", text(&ply), "-s", text(&data), "--json", "--quiet"];
    let measured: Value = serde_json::from_str(&succeed(&eval)).expect("JSON");
    let during = json(trained().model.join("results.json"))["ours_30"].clone();
    let value = |of: &Value| of["PSNR"].as_f64().expect("a number");
    assert!((value(&during) - value(&measured["mean"])).abs() < 1e-4, "{during} {measured}");
    assert_refused(&finish(program().args(eval).arg("--all")), &["04.png"]);
}

#[test]
fn renders_its_own_cameras_and_those_of_a_data_set() {
    let Trained { data, model, .. } = trained();
    let folder = tempdir().expect("a temporary folder");
    let (own, from_data) = (folder.path().join("own"), folder.path().join("data"));
    succeed(&["render", "-m", text(model), "-o", text(&own)]);
    succeed(&["render", text(model), "-s", text(data), "-o", text(&from_data), "--width", "24"]);
    assert_eq!((files_below(&own).len(), files_below(&from_data).len()), (9, 9));
    let size = |path: PathBuf| image::image_dimensions(path).expect("a PNG");
    assert_eq!(size(own.join("00000.png")), (48, 32));
    assert_eq!(size(from_data.join("00008.png")), (24, 16));
    // The first of the model's cameras is the first held-out one; training has saved the same picture.
    let bytes = |path: PathBuf| image::open(path).expect("a PNG").to_rgb8().into_raw();
    assert_eq!(bytes(own.join("00000.png")), bytes(model.join("test/ours_30/renders/00000.png")));
}

#[test]
fn inspect_takes_the_trainings_cameras() {
    let model = text(&trained().model);
    let [own, first, second] = [
        succeed(&["inspect", model, "--pixel", "24,16"]),
        succeed(&["inspect", model, "--pixel", "24,16", "--camera", "01.png"]),
        succeed(&["inspect", model, "--pixel", "24,16", "--camera", "02.png"]),
    ];
    assert!(own.contains("final colour"), "{own}");
    // Held-out views come first in cameras.json.
    assert!(own == first && own != second, "{own}{first}{second}");
}

#[test]
fn demo_leaves_data_set_sheet_metrics_and_scene() {
    let folder = tempdir().expect("a temporary folder");
    let out = folder.path().join("demo");
    let said = succeed(&["demo", "--out", text(&out), "--iterations", "6", "--quiet"]);
    for file in ["contact_sheet.png", "metrics.json", "model/point_cloud/iteration_6/point_cloud.ply"] {
        assert!(out.join(file).is_file(), "{file} in {:?}", files_below(&out));
        assert!(said.contains(text(&out.join(file))), "{file} in {said}");
    }
    let metrics = json(out.join("metrics.json"));
    assert_eq!(metrics["views"].as_array().map(Vec::len), Some(5));
    assert!(metrics["psnr"].as_f64() > Some(5.0), "{metrics}");
    // The demo's data set works like any other.
    let info = succeed(&["info", text(&out.join("dataset")), "--eval"]);
    assert!(info.contains("40 registered, 40 sound photos"), "{info}");
    assert!(info.contains("35 for training, 5 held out"), "{info}");
    // Three columns with margins.
    assert_eq!(image::image_dimensions(out.join("contact_sheet.png")).expect("a PNG").0, 3 * 256 + 4 * 8);
}

/// A data set, a model folder and a short training for one test.
struct Short {
    folder: tempfile::TempDir,
}

impl Short {
    fn new() -> Short {
        let folder = tempdir().expect("a temporary folder");
        write_dataset(&folder.path().join("data"));
        Short { folder }
    }

    fn model(&self) -> PathBuf {
        self.folder.path().join("model")
    }

    fn train(&self, more: &[&str]) -> Finished {
        let (data, model) = (self.folder.path().join("data"), self.model());
        finish(program().args(["train", "-s", text(&data), "-m", text(&model), "--quiet"]).args(more))
    }

    fn ply(&self, iteration: u32) -> PathBuf {
        self.model().join(format!("point_cloud/iteration_{iteration}/point_cloud.ply"))
    }
}

/// The point cloud of an earlier, longer training in the same folder is not mistaken for the new one.
#[test]
fn newest_point_cloud_counts_not_the_highest_number() {
    let short = Short::new();
    let checkpoint = ["--iterations", "5", "--checkpoint_iterations", "3"];
    assert_eq!(short.train(&checkpoint).stderr, "");
    let mut had = files_below(&short.model());
    had.retain(|name| !name.ends_with(".training.lock"));
    assert!(had.len() > 8, "{had:?}");
    // A temporary file of a run that was killed while saving.
    let leftover = short.ply(5).with_file_name(".point_cloud.ply.aB3dE6.tmp");
    std::fs::write(&leftover, "half").expect("written");
    let again = short.train(&["--iterations", "3"]);
    assert_eq!(again.code, Some(0), "{}", again.stderr);
    assert!(again.stderr.starts_with("warning: ") && again.stderr.contains("earlier_1"), "{}", again.stderr);
    // The earlier training becomes its own model folder, with all its files.
    let earlier = short.model().join("earlier_1");
    assert!(!short.ply(5).exists() && !leftover.exists());
    assert_eq!(files_below(&earlier), had);
    let log = |folder: &Path| std::fs::read_to_string(folder.join("train_log.csv")).expect("the log");
    assert_eq!(log(&earlier).lines().count(), 6);
    let shown = succeed(&["info", text(&earlier), "--json"]);
    assert!(shown.contains("iteration_5"), "{shown}");
    assert_eq!(log(&short.model()).lines().count(), 4);
    let info: Value =
        serde_json::from_str(&succeed(&["info", text(&short.model()), "--json"])).expect("JSON");
    assert_eq!(info["file"].as_str(), short.ply(3).to_str());
}

#[test]
fn a_training_that_fails_saves_what_it_has() {
    let short = Short::new();
    std::fs::create_dir(short.model()).expect("created");
    std::fs::write(short.model().join("test"), "no folder").expect("written");
    let run = short.train(&["--iterations", "9", "--eval", "--test_iterations", "6"]);
    // Before the end this is a warning, and the measurements are kept.
    assert!(run.stderr.starts_with("warning: the test of iteration 6 is not saved"), "{}", run.stderr);
    assert_refused(&run, &["model/test", "cannot create"]);
    assert!(short.ply(9).is_file(), "{:?}", files_below(&short.model()));
    assert!(short.model().join("chkpnt9.safetensors").is_file(), "{:?}", files_below(&short.model()));
    succeed(&["info", text(&short.model())]);
    let log = std::fs::read_to_string(short.model().join("train_log.csv")).expect("the log");
    assert_eq!(log.lines().count(), 10, "{log}");
}

/// Every Gaussian is too faint and is pruned.
#[test]
fn training_ends_when_nothing_is_left() {
    let short = Short::new();
    let schedule =
        ["--densify_from_iter", "2", "--densification_interval", "2", "--densify_until_iter", "20"];
    let run = short.train(
        &[&["--iterations", "30", "--min_opacity", "1", "--strategy", "reference"], schedule.as_slice()]
            .concat(),
    );
    assert_refused(&run, &["no Gaussians", "--min-opacity"]);
    assert!(!short.model().join("point_cloud").exists(), "{:?}", files_below(&short.model()));
}

/// Ctrl-C during training: it finishes the iteration, saves the scene and exits with the code of an interrupted
/// program.
#[cfg(unix)]
#[test]
fn ctrl_c_saves() {
    let folder = tempdir().expect("a temporary folder");
    let (data, out) = (folder.path().join("data"), folder.path().join("out"));
    write_dataset(&data);
    let mut command = program();
    command.args(["train", "-s", text(&data), "-m", text(&out), "--iterations", "1000000"]);
    command.args(["--max-memory", "2048M", "--offload", "1G"]);
    let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
    let mut lines = BufReader::new(child.stderr.take().expect("its stderr")).lines().map_while(Result::ok);
    let first = lines.find(|line| line.starts_with("100/1000000")).expect("progress after 100 iterations");
    assert!(first.contains("it/s") && first.contains("Gaussians") && first.contains("left"), "{first}");
    child.interrupt();
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().expect("it ends").code(), Some(130), "{rest:?}");
    assert!(rest.iter().any(|line| line.starts_with("interrupted: saved ")), "{rest:?}");
    let log = std::fs::read_to_string(out.join("train_log.csv")).expect("the log");
    let last = log.lines().last().and_then(|line| line.split(',').next()).expect("a line");
    let saved = out.join(format!("point_cloud/iteration_{last}/point_cloud.ply"));
    assert!(saved.is_file(), "{:?}", files_below(&out));
    assert!(out.join(format!("chkpnt{last}.safetensors")).is_file(), "{:?}", files_below(&out));
    let report = || std::fs::read_to_string(out.join("report.html")).expect("the report");
    assert!(report().contains(&format!("stopped after {last} of 1,000,000 iterations")));
    let advice = rest.iter().find(|line| line.starts_with("interrupted: to go on, ")).expect("how to go on");
    // The printed command works, with --offload and --max-memory.
    let typed: Vec<&str> = advice.split(", ashsplat ").nth(1).expect("a command").split(' ').collect();
    let same = ["--start-checkpoint", "latest", "--max-memory", "2G", "--offload", "1G"];
    assert!(typed.ends_with(&same), "{advice}");
    let next = last.parse::<u32>().expect("a number") + 3;
    let more = ["--iterations", &next.to_string(), "--quiet"];
    succeed(&[typed.as_slice(), &more].concat());
    assert!(out.join(format!("point_cloud/iteration_{next}/point_cloud.ply")).is_file());
    // The curves begin with the first run.
    assert!(report().contains(&format!("\">{next} iterations</span>")) && report().contains(",1,\""));
}

/// A scene that cannot be saved is a warning, because the checkpoint has everything. SIGTERM acts like Ctrl-C.
#[cfg(unix)]
#[test]
fn sigterm_writes_its_checkpoint_where_the_scene_cannot_be_saved() {
    let folder = tempdir().expect("a temporary folder");
    let (data, out) = (folder.path().join("data"), folder.path().join("out"));
    write_dataset(&data);
    std::fs::create_dir(&out).expect("created");
    std::fs::write(out.join("point_cloud"), "no folder").expect("written");
    let mut command = program();
    command.args(["train", "-s", text(&data), "-m", text(&out), "--iterations", "1000000"]);
    let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
    let mut lines = BufReader::new(child.stderr.take().expect("its stderr")).lines().map_while(Result::ok);
    lines.find(|line| line.starts_with("100/1000000")).expect("progress after 100 iterations");
    child.signal(nix::sys::signal::Signal::SIGTERM);
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().expect("it ends").code(), Some(130), "{rest:?}");
    assert!(
        rest.iter().any(|line| line.starts_with("warning: ") && line.contains("point_cloud")),
        "{rest:?}"
    );
    let path = rest.iter().find_map(|line| line.strip_prefix("checkpoint ")).expect("a checkpoint");
    Checkpoint::read(path).expect("whole");
}

/// Photographs that do not fit are read during training, and nothing else changes.
#[test]
fn photos_may_stay_on_disk() {
    let folder = tempdir().expect("a temporary folder");
    let data = folder.path().join("data");
    write_dataset(&data);
    let train = |name: &str, more: &[&str]| {
        let model = folder.path().join(name);
        let run = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--iterations", "25", "--quiet"];
        let run = finish(program().args([&run[..], more].concat()));
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        let read = |file: &str| std::fs::read(model.join(file)).expect(file);
        let files = ["point_cloud/iteration_25/point_cloud.ply", "results.json", "test/ours_25/gt/00001.png"];
        let [scene, results, photo] = files.map(read);
        let mut results: Value = serde_json::from_slice(&results).expect("JSON");
        // A time, which varies.
        let tested = results["ours_25"].as_object_mut().expect("a test");
        assert!(tested.remove("frame_ms").is_some_and(|time| time.as_f64() > Some(0.0)));
        ((scene, results, photo), run.stderr)
    };
    let (in_memory, said) = train("memory", &[]);
    assert!(!said.contains("kept in a file"), "{said}");
    let (on_disk, said) = train("disk", &["--photo-memory", "40K"]);
    assert!(said.contains("are kept in a file in"), "{said}");
    assert!(in_memory == on_disk);
    let left = std::fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(left, 3, "the file goes with the program");
    let model = folder.path().join("refused");
    let run = ["train", "-s", text(&data), "-m", text(&model), "--photo-memory", "20K"];
    // In planes (as on CPUs), or pixel by pixel.
    let planes = Windowing::for_device(Gpu::new().context.limits()) == Windowing::Sweeps;
    let needed = if planes { "30144 bytes" } else { "30720 bytes" };
    assert_refused(&finish(program().args(run)), &["reading ahead", needed, "20480"]);
}
