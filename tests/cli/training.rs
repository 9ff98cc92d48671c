//! `train`, and commands on its results.

use super::*;
use crate::common::gpu::Gpu;
use ashsplat::passes::loss::NativeLayout;
use glam::{Mat3, Quat};
use std::sync::OnceLock;

/// A folder with a data set, a model trained on it for a few iterations, and the training's stdout; created once.
pub(super) fn trained() -> &'static TestFolder {
    static TRAINED: OnceLock<TestFolder> = OnceLock::new();
    TRAINED.get_or_init(|| {
        let place = TestFolder::lasting("cli");
        write_dataset(&place.at("data"));
        // Option names with hyphens and with underscores.
        let schedule = "--iterations 30 --sh_degree 1 --sh-degree-interval=10 --test_iterations 10";
        let densify = "--densify_from_iter 5 --densification-interval=10 --densify_until_iter=25";
        let train = "train -s @data -m @model --eval --seed=4 --save-iterations 20";
        let run = place.run(format!("{train} {schedule} {densify}")).ok();
        place.write("stdout", run.stdout);
        place
    })
}

/// Fails unless two tables of means agree.
#[track_caller]
fn assert_near(a: &Value, b: &Value, metrics: &[&str]) {
    for metric in metrics {
        let value = |of: &Value| of[metric].as_f64().expect("a number");
        assert!((value(a) - value(b)).abs() < 1e-4, "{metric}: {a} {b}");
    }
}

#[test]
fn leaves_what_the_reference_leaves() {
    let names = "cameras.json cfg_args input.ply last_iteration per_view.json report.html results.json \
                 settings.toml train_log.csv point_cloud/iteration_20/point_cloud.ply \
                 point_cloud/iteration_30/point_cloud.ply";
    let mut expected: Vec<PathBuf> = names.split_whitespace().map(PathBuf::from).collect();
    for folder in ["ours_10/renders", "ours_10/gt", "ours_30/renders", "ours_30/gt"] {
        expected.extend([0, 1].map(|index| PathBuf::from(format!("test/{folder}/{index:05}.png"))));
    }
    expected.sort();
    assert_eq!(trained().files("model"), expected);
}

#[test]
fn results_have_the_references_form() {
    let [results, per_view] =
        ["results", "per_view"].map(|name| trained().read_json(format!("model/{name}.json")));
    for run in ["ours_10", "ours_30"] {
        for metric in ["PSNR", "SSIM"] {
            let views = per_view[run][metric].as_object().expect("views");
            assert_eq!(views.keys().collect::<Vec<_>>(), ["00000.png", "00001.png"]);
            let mean = views.values().filter_map(Value::as_f64).sum::<f64>() / 2.0;
            assert!((mean - results[run][metric].as_f64().expect("a mean")).abs() < 1e-9);
        }
    }
    assert!(results["ours_30"]["PSNR"].as_f64() > results["ours_10"]["PSNR"].as_f64(), "{results}");
    assert_eq!(trained().read_json("model/cameras.json").as_array().map(Vec::len), Some(9));
}

#[test]
fn log_has_a_line_for_each_iteration() {
    let log = trained().read_text("model/train_log.csv");
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
fn info_says_how_many_gaussians_fit() {
    let max = |memory: &str| {
        let report = trained().json_of(format!("info @data --json --max-memory {memory}"));
        ["default", "--sh-storage f32", "--sh-storage f32 --moments f32"]
            .map(|storage| report["most_gaussians"][storage].as_u64().unwrap_or_else(|| panic!("{report}")))
    };
    let ([usual, floats, all_floats], more) = (max("64M"), max("128M"));
    assert!(usual > floats && floats > all_floats && all_floats > 0, "{usual} {floats} {all_floats}");
    assert!(more[0] > usual, "{more:?}");
    let said = trained().run("info @data --max-memory 64M").ok().stdout;
    assert_says(&said, &["training in 64M can begin with", "--sh-storage f32", "--moments f32"]);
}

#[test]
fn reports_speed_and_quality() {
    let said = trained().read_text("stdout");
    assert_says(&said, &["iteration 30: PSNR", "held-out views", "it/s", "all 30 iterations"]);
    if cfg!(target_os = "linux") {
        assert_says(&said, &["CPU-seconds per iteration"]);
    }
}

#[test]
fn settings_are_dumped_and_read_back() {
    let place = trained();
    let dump = place.read_text("model/settings.toml");
    for line in
        ["sh_degree = 1", "densification_interval = 10", "densify_until_iter = 25", "seed = 4", "eval = true"]
    {
        assert!(dump.lines().any(|l| l == line), "no '{line}' in {dump}");
    }
    let arguments = place.read_text("model/cfg_args");
    assert!(arguments.starts_with("Namespace(sh_degree=1, source_path='"), "{arguments}");
    // The same settings give the same scene, to the last bit. The command line has priority over the file.
    place.run("train --config @model/settings.toml -m @again --test_iterations -1 --quiet").ok();
    assert!(place.ply("again", 30) == place.ply("model", 30), "two runs with the same settings differ");
}

#[test]
fn eval_agrees_with_training() {
    let place = trained();
    let during = &place.read_json("model/results.json")["ours_30"];
    let after = &place.json_of("eval @model --json --quiet")["mean"];
    // The PLY alone with the data set: the same views are held out.
    let ply = point_cloud("model", 30);
    let bare = &place.json_of(format!("eval @{ply} -s @data --json"))["mean"];
    for other in [during, bare] {
        assert_near(other, after, &["PSNR", "SSIM"]);
    }
    place.run("eval @model --quiet").ok().says(&["03.png", "07.png", "mean of 2"]);

    // A model trained on all views has no held-out views to measure.
    place.write(point_cloud("on_all", 30), place.read(ply));
    let settings = place.read_text("model/settings.toml");
    place.write("on_all/settings.toml", settings.replace("eval = true", "eval = false"));
    place.run("eval @on_all --eval --quiet").ok().warns(&["was trained on all views"]);
}

/// `eval` reads photos one at a time, and only those that it measures.
#[test]
fn eval_reads_what_it_measures() {
    let place = trained();
    write_dataset(&place.at("damaged"));
    place.write("damaged/images/04.png", "damaged");
    let eval = format!("eval @{} -s @damaged --json --quiet", point_cloud("model", 30));
    let during = &place.read_json("model/results.json")["ours_30"];
    assert_near(during, &place.json_of(&eval)["mean"], &["PSNR"]);
    place.run(eval + " --all").refused(&["04.png"]);
}

#[test]
fn renders_its_own_cameras_and_those_of_a_data_set() {
    let place = trained();
    place.run("render @model -o @own").ok();
    place.run("render @model -s @data -o @from_data --width 24").ok();
    assert_eq!((place.files("own").len(), place.files("from_data").len()), (9, 9));
    let own = place.picture("own/00000.png");
    assert_eq!(own.dimensions(), (48, 32));
    assert_eq!(place.picture("from_data/00008.png").dimensions(), (24, 16));
    // The first of the model's cameras is the first held-out one; training has saved the same picture.
    assert!(own == place.picture("model/test/ours_30/renders/00000.png"));
}

/// A scene on its side is trained upright. The turn is in settings.toml, so that `eval`, `render` and a resumed training, which read
/// the data set again, turn it the same way.
#[test]
fn level_is_kept_in_what_is_written() {
    let place = TestFolder::new();
    let turn = Quat::from_rotation_z(1.2) * Quat::from_rotation_x(0.4);
    let tilted = |camera: Camera| {
        let rotation = camera.camera_from_world * Mat3::from_quat(turn.inverse());
        Camera { camera_from_world: rotation, ..camera }
    };
    let image = |index: u32| ColmapImage::posed(index + 1, 1, photo_name(index), &tilted(view(index)));
    let mut points = wall_points();
    for position in &mut points.positions {
        *position = (turn * Vec3::from_array(*position)).to_array();
    }
    write_model(&place.at("data"), &(0..VIEWS).map(image).collect::<Vec<_>>(), &points);
    let train = "train -s @data -m @model --eval --sh-degree 1 --checkpoint-iterations 20 --iterations";
    place
        .run(format!("{train} 20 --level"))
        .ok()
        .warns(&["the scene is turned by", "so that up is -y (--level)"]);
    let level = place.read_text("model/settings.toml");
    let level = level.lines().find(|line| line.starts_with("level = ")).expect("a level").to_owned();
    assert_eq!(level.split(',').count(), 6, "{level}");
    let cameras = place.read_json("model/cameras.json");
    for camera in cameras.as_array().expect("cameras") {
        // The second row of the rotation from the camera: y of its right, down and forward axes.
        let y = |axis: usize| camera["rotation"][1][axis].as_f64().expect("a number");
        assert!(y(0).abs() < 1e-4 && y(1) > 0.9, "{camera}");
    }
    place.run("render @model -o @own").ok();
    place.run("render @model -s @data -o @from_data").ok();
    // The first of the model's cameras is the first held-out one, 03.png, but for the rounding of its file.
    let [own, from_data] = ["own/00000.png", "from_data/00002.png"].map(|name| place.picture(name));
    assert!(own.iter().zip(from_data.iter()).all(|(a, b)| a.abs_diff(*b) <= 2));
    let during = &place.read_json("model/results.json")["ours_20"];
    assert_near(during, &place.json_of("eval @model --json --quiet")["mean"], &["PSNR", "SSIM"]);
    place
        .run(format!("{train} 24 --start-checkpoint latest"))
        .refused(&["made with other photographs or cameras"]);
    place.run(format!("{train} 24 --level --start-checkpoint latest")).ok();
    place.run("train -s @data -m @other --level=up").refused(&["level: 'up' is not off, on"]);
}

#[test]
fn inspect_takes_the_trainings_cameras() {
    let inspect = |camera: &str| {
        trained().run(format!("inspect @model --pixel 24,16 {camera}")).ok().says(&["final colour"]).stdout
    };
    let [own, first, second] = ["", "--camera 03.png", "--camera 01.png"].map(inspect);
    // Held-out views come first in cameras.json.
    assert!(own == first && own != second, "{own}{first}{second}");
}

/// The demo after a few iterations, and its stdout; created once, because photographing it takes seconds.
fn demo() -> &'static (TestFolder, String) {
    static DEMO: OnceLock<(TestFolder, String)> = OnceLock::new();
    DEMO.get_or_init(|| {
        let place = TestFolder::lasting("demo");
        let said = place.run("demo --out @demo --iterations 6 --quiet").ok().stdout;
        (place, said)
    })
}

impl TestFolder {
    /// A folder with the demo's data set as `demo`.
    pub(super) fn with_demo() -> TestFolder {
        let (place, data) = (TestFolder::empty(), Path::new("demo/dataset"));
        for file in demo().0.files(data) {
            place.write(Path::new("demo").join(&file), demo().0.read(data.join(file)));
        }
        place
    }
}

#[test]
fn demo_leaves_data_set_sheet_and_scene() {
    let (place, said) = demo();
    for file in ["contact_sheet.png", &point_cloud("model", 6)] {
        let path = place.at("demo").join(file);
        assert!(path.is_file(), "{file} in {:?}", place.files("demo"));
        assert_says(said, &[text(&path)]);
    }
    let views = place.read_json("demo/model/per_view.json")["ours_6"]["PSNR"].take();
    assert_eq!(views.as_object().map(serde_json::Map::len), Some(5), "{views}");
    // The demo's data set works like any other.
    let words = ["40 registered, 40 sound photos", "35 for training, 5 held out"];
    place.run("info @demo/dataset --eval").ok().says(&words);
    // Three columns with margins.
    assert_eq!(place.picture("demo/contact_sheet.png").width(), 3 * 256 + 4 * 8);
}

/// The point cloud of an earlier, longer training in the same folder is not mistaken for the new one.
#[test]
fn newest_point_cloud_counts_not_the_highest_number() {
    let place = TestFolder::new();
    let train = "train -s @data -m @model --quiet";
    let first = place.run(format!("{train} --iterations 5 --checkpoint_iterations 3"));
    assert_eq!(first.stderr, "");
    let mut had = place.files("model");
    had.retain(|name| !name.ends_with(".training.lock"));
    assert!(had.len() > 8, "{had:?}");
    // A temporary file of a run that was killed while saving.
    let leftover = "model/point_cloud/iteration_5/.point_cloud.ply.aB3dE6.tmp";
    place.write(leftover, "half");
    let again = place.run(format!("{train} --iterations 3")).ok();
    assert!(again.stderr.starts_with("warning: ") && again.stderr.contains("earlier_1"), "{}", again.stderr);
    // The earlier training becomes its own model folder, with all its files.
    assert!(!place.has(point_cloud("model", 5)) && !place.has(leftover));
    assert_eq!(place.files("model/earlier_1"), had);
    assert_eq!(place.read_text("model/earlier_1/train_log.csv").lines().count(), 6);
    place.run("info @model/earlier_1 --json").ok().says(&["iteration_5"]);
    assert_eq!(place.read_text("model/train_log.csv").lines().count(), 4);
    let info = place.json_of("info @model --json");
    assert_eq!(info["file"].as_str().map(Path::new), Some(&*place.at(point_cloud("model", 3))));
}

#[test]
fn a_training_that_fails_saves_what_it_has() {
    let place = TestFolder::new();
    place.write("model/test", "no folder");
    let run = place.run("train -s @data -m @model --quiet --iterations 9 --eval --test_iterations 6");
    // Before the end this is a warning, and the measurements are kept.
    assert!(run.stderr.starts_with("warning: the test of iteration 6 is not saved"), "{}", run.stderr);
    run.refused(&["model/test", "cannot create"]);
    for file in [point_cloud("model", 9), "model/chkpnt9.safetensors".into()] {
        assert!(place.at(&file).is_file(), "{file} in {:?}", place.files("model"));
    }
    place.run("info @model").ok();
    let log = place.read_text("model/train_log.csv");
    assert_eq!(log.lines().count(), 10, "{log}");
}

/// Every Gaussian is too faint and is pruned.
#[test]
fn training_ends_when_nothing_is_left() {
    let place = TestFolder::new();
    let schedule = "--densify_from_iter 2 --densification_interval 2 --densify_until_iter 20";
    let faint = "--iterations 30 --min_opacity 1 --strategy reference";
    let run = place.run(format!("train -s @data -m @model --quiet {faint} {schedule}"));
    run.refused(&["no Gaussians", "--min-opacity"]);
    assert!(!place.has("model/point_cloud"), "{:?}", place.files("model"));
}

/// Ctrl-C during training: it finishes the iteration, saves the scene and exits with the code of an interrupted
/// program.
#[test]
fn ctrl_c_saves() {
    let place = TestFolder::new();
    let mut training =
        place.start("train -s @data -m @out --iterations 1000000 --max-memory 2048M --offload 1G");
    let first = training.wait_for("100/1000000");
    assert_says(&first, &["it/s", "Gaussians", "left"]);
    let rest = training.interrupt();
    assert!(rest.iter().any(|line| line.starts_with("interrupted: saved ")), "{rest:?}");
    let log = place.read_text("out/train_log.csv");
    let last = log.lines().last().and_then(|line| line.split(',').next()).expect("a line");
    let last: u32 = last.parse().expect("a number");
    for file in [point_cloud("out", last), format!("out/chkpnt{last}.safetensors")] {
        assert!(place.at(&file).is_file(), "{file} in {:?}", place.files("out"));
    }
    let stopped = format!("stopped after {last} of 1,000,000 iterations");
    assert_says(place.read_text("out/report.html"), &[&stopped]);
    let advice = rest.iter().find(|line| line.starts_with("interrupted: to go on, ")).expect("how to go on");
    // The printed command works, with --offload and --max-memory.
    let typed = advice.split(", ashsplat ").nth(1).expect("a command");
    assert!(typed.ends_with(" --start-checkpoint latest --max-memory 2G --offload 1G"), "{advice}");
    let next = last + 3;
    place.run(format!("{typed} --iterations {next} --quiet")).ok();
    assert!(place.at(point_cloud("out", next)).is_file());
    // The curves begin with the first run.
    assert_says(place.read_text("out/report.html"), &[&format!("\">{next} iterations</span>"), ",1,\""]);
}

/// A scene that cannot be saved is a warning, because the checkpoint has everything. SIGTERM acts like Ctrl-C.
#[cfg(unix)]
#[test]
fn sigterm_writes_its_checkpoint_where_the_scene_cannot_be_saved() {
    let place = TestFolder::new();
    place.write("out/point_cloud", "no folder");
    let mut training = place.start("train -s @data -m @out --iterations 1000000");
    training.wait_for("100/1000000");
    training.child.signal(nix::sys::signal::Signal::SIGTERM);
    let (code, rest) = training.end();
    assert_eq!(code, Some(130), "{rest:?}");
    let warned = |line: &String| line.starts_with("warning: ") && line.contains("point_cloud");
    assert!(rest.iter().any(warned), "{rest:?}");
    let path = rest.iter().find_map(|line| line.strip_prefix("checkpoint ")).expect("a checkpoint");
    Checkpoint::read(path).expect("whole");
}

/// Photographs that do not fit are read during training, and nothing else changes.
#[test]
fn photos_may_stay_on_disk() {
    let place = TestFolder::new();
    let train = |data: &str, model: &str, more: &str| {
        let run =
            place.run(format!("train -s @{data} -m @{model} --eval --iterations 25 --quiet {more}")).ok();
        let mut results = place.read_json(format!("{model}/results.json"));
        // A time, which varies.
        let tested = results["ours_25"].as_object_mut().expect("a test");
        assert!(tested.remove("frame_ms").is_some_and(|time| time.as_f64() > Some(0.0)));
        let photo = place.read(format!("{model}/test/ours_25/gt/00001.png"));
        ((place.ply(model, 25), results, photo), run.stderr)
    };
    let (in_memory, said) = train("data", "memory", "");
    assert!(!said.contains("kept in a file"), "{said}");
    let (on_disk, said) = train("data", "disk", "--photo-memory 40K");
    assert_says(&said, &["are kept in a file in"]);
    assert!(in_memory == on_disk);
    let left = std::fs::read_dir(place.at("")).expect("the folder").count();
    assert_eq!(left, 3, "the file goes with the program");
    // JPEGs take no space: they are decoded again.
    write_dataset(&place.at("jpegs"));
    for entry in std::fs::read_dir(place.at("jpegs/images")).expect("a folder").flatten() {
        let photo = image::open(entry.path()).expect("a PNG");
        photo.save_with_format(entry.path(), image::ImageFormat::Jpeg).expect("written");
    }
    let (in_memory, _) = train("jpegs", "memory-jpeg", "");
    let (again, said) = train("jpegs", "jpeg", "--photo-memory 40K");
    assert_says(&said, &["unscaled JPEGs are decoded again when needed, 2 are kept in a file in"]);
    assert!(in_memory == again);
    // In planes (as on CPUs), or pixel by pixel.
    let planes = NativeLayout::of(Gpu::new().context.limits()) == NativeLayout::Strips;
    let needed = if planes { "31488 bytes" } else { "36864 bytes" };
    let refused = place.run("train -s @data -m @refused --photo-memory 20K");
    refused.refused(&["reading ahead", needed, "20480"]);
}

#[test]
fn a_training_begins_with_a_scene() {
    let place = TestFolder::new();
    let still = "--strategy fixed --position_lr_init 1e-12 --position_lr_final 1e-12 --feature_lr 0 --opacity_lr 0 \
                 --scaling_lr 0 --rotation_lr 0 --iterations 1";
    // SH degree 1 is active from iteration 5 on, so that the scene has higher coefficients.
    place.train("coarse", "--iterations 30 --sh_degree_interval 5");
    let coarse = point_cloud("coarse", 30);
    let begin = |model: &str, scene: &str, more: &str| {
        place.run(format!("train -s @data -m @{model} --quiet --init @{scene} {more}"))
    };
    let first = place.gaussians(&coarse);
    assert!(first.sh.iter().skip(1).step_by(4).flatten().any(|&c| c != 0.0), "no SH above degree 0");
    // One step with zero rates keeps the scene. Its SH coefficients are cut to the degree asked for, or padded.
    let [cut, same, more] = [0, 1, 2].map(|degree| {
        let model = format!("degree{degree}");
        begin(&model, &coarse, &format!("{still} --sh_degree {degree}")).ok();
        place.gaussians(point_cloud(&model, 1))
    });
    assert_eq!((same.means.len(), &same.sh), (first.means.len(), &first.sh));
    assert_eq!((&same.opacity_logits, &same.log_scales), (&first.opacity_logits, &first.log_scales));
    assert!(!place.has("degree1/input.ply"));
    // The scene's SH degree is active at once.
    assert_says(place.read_text("degree1/settings.toml"), &["sh_degree_start = 1"]);
    assert_eq!(cut.sh.len(), first.means.len());
    let rows = more.sh.chunks_exact(9).zip(first.sh.chunks_exact(4));
    assert!(rows.into_iter().all(|(more, first)| more[..4] == *first && more[4..] == [[0.0; 3]; 5]));
    // Training from a compressed scene, with a checkpoint to resume from.
    place.run(format!("convert @{coarse} @coarse.spz")).ok();
    let options = "--strategy reference --iterations 12 --checkpoint_iterations 8";
    begin("on", "coarse.spz", options).ok();
    let ply = place.ply("on", 12);
    place.remove("on/point_cloud");
    begin("on", "coarse.spz", &format!("{options} --start-checkpoint latest")).ok();
    assert!(place.ply("on", 12) == ply, "other bits");
    // A file that this training would move away.
    begin("on", &point_cloud("on", 12), options).refused(&["lies in the model folder"]);
    begin("none", "nowhere.ply", "").refused(&["nowhere.ply"]);
    assert!(!place.has("none"));
}

/// A second training into the same folder is refused while the first runs, and removes none of its files.
#[test]
fn one_training_at_a_time_writes_into_a_folder() {
    let place = TestFolder::new();
    let mut first = place.start("train -s @data -m @model --iterations 1000000");
    first.wait_for("100/1000000");
    // A temporary file, as the first training has it while it writes.
    let unfinished = "model/.chkpnt100.safetensors.aB3dE6.tmp";
    place.write(unfinished, "half");
    place.attempt("model", "--iterations 3").refused(&["another training (process ", "choose another -m"]);
    assert!(place.has(unfinished) && place.has("model/train_log.csv"), "{:?}", place.files("model"));
    // With --wait, a training runs after the first one.
    let mut patient = place.start("train -s @data -m @model --iterations 3 --wait");
    let waiting = format!("waiting for another training (process {} on ", first.child.id());
    assert!(patient.lines.next().is_some_and(|line| line.starts_with(&waiting)), "{waiting}");
    first.interrupt();
    let (code, rest) = patient.end();
    assert!(rest.iter().any(|line| line.contains("had an earlier training")), "{rest:?}");
    assert_eq!(code, Some(0));
    // The folder is free again, as it is after a kill.
    assert!(!place.has("model/.training.lock"), "{:?}", place.files("model"));
}

/// A scheduler starts a job twice at once: one trains, and the others find it done.
#[test]
fn patient_trainings_of_a_new_folder_are_one() {
    let place = TestFolder::new();
    let train = "train -s @data -m @blocks/one --wait --start-checkpoint auto --checkpoint-every 10 \
                 --iterations 25 --quiet";
    let start = |_| Running::start(place.command(train).stdout(Stdio::piped()).stderr(Stdio::piped()));
    let all: Vec<Running> = (0..3).map(start).collect();
    let ends: Vec<Finished> = all.into_iter().map(|running| Finished::from(running.finish()).ok()).collect();
    let done = ends.iter().filter(|end| end.stdout.contains("is trained to its end already"));
    assert_eq!(done.count(), 2);
    assert!(!place.has("blocks/one/earlier_1"), "{:?}", place.files("blocks"));
    // A refused training leaves no folder.
    let none = "train -s @data -m @none/at/all --wait --few-photos off --strategy mcmc --cap-max 7";
    place.run(none).refused(&["cap_max"]);
    assert!(!place.has("none"));
}

#[test]
fn report_is_whole_and_needs_nothing_else() {
    let page = trained().read_text("model/report.html");
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    for address in ["http:", "https:", "//cdn", "@import", "<link"] {
        assert!(!page.contains(address), "{address}");
    }
    let addresses = page.matches(" src=\"").count();
    assert_eq!(addresses, 6, "photo, render and error of two views");
    assert_eq!(page.matches(" src=\"data:image/jpeg;base64,/9j/").count(), addresses);
    for title in ["Curves", "Contact sheet", "Views", "Gaussians", "Kernels", "Device memory", "Settings"] {
        assert!(page.contains(&format!("<h2>{title}</h2>")), "{title}");
    }
    for words in [
        "LPIPS is not computed",
        // Kernels were timed.
        "backward/blend_backward",
        "optimizer/adam",
        "<tr class=\"own\"><td class=\"name\">iterations</td><td>30</td></tr>",
        // A default is not bold.
        "<tr><td class=\"name\">lambda_dssim</td>",
    ] {
        assert!(page.contains(words), "no '{words}'");
    }
    // The same figures as in the results, with the worst view first.
    let results = trained().read_json("model/per_view.json");
    let views = results["ours_30"]["PSNR"].as_object().expect("views");
    let mut psnrs: Vec<f64> = views.values().filter_map(Value::as_f64).collect();
    psnrs.sort_by(f64::total_cmp);
    let places: Vec<usize> =
        psnrs.iter().map(|psnr| page.find(&format!("</b> {psnr:.2} dB")).expect("in the sheet")).collect();
    assert!(places.is_sorted(), "{psnrs:?}");
    assert_eq!(page.matches("<span class=\"badge\">30 iterations</span>").count(), 1);
}

/// Charts are valid JSON, with one entry per iteration of a short run.
#[test]
fn report_has_the_curves_of_all_iterations() {
    let page = trained().read_text("model/report.html");
    let data: Vec<Vec<(f64, f64, u32, String)>> = page
        .split("<script type=\"application/json\">")
        .skip(1)
        .map(|part| serde_json::from_str(part.split("</script>").next().expect("an end")).expect("JSON"))
        .collect();
    let lengths: Vec<usize> = data.iter().map(Vec::len).collect();
    // The PSNR is measured at tests, and in between as often as its share of the time allows.
    let [loss, psnr, gaussians, speed] = lengths[..] else { panic!("{lengths:?}") };
    assert_eq!([loss, gaussians, speed], [30; 3]);
    assert!((2..=30).contains(&psnr), "{psnr}");
    assert_eq!((data[0][0].2, data[0][29].2), (1, 30));
    let measured: Vec<u32> = data[1].iter().map(|(.., iteration, _)| *iteration).collect();
    assert!(measured.is_sorted() && [10, 30].iter().all(|tested| measured.contains(tested)), "{measured:?}");
    assert!(data.iter().flatten().all(|(x, y, ..)| (0.0..=560.0).contains(x) && (0.0..=220.0).contains(y)));
}

/// `render -s` draws the cameras of a data set as they are in training: with its folder of photos, where there is one.
#[test]
fn cameras_of_a_data_set_are_of_the_folder_that_was_trained_on() {
    let place = TestFolder::new();
    std::fs::create_dir(place.at("data/images_2")).expect("a folder");
    for index in 0..VIEWS {
        let half = view(index).scaled_to(view(index).width / 2, view(index).height / 2);
        photograph(&half).write_png(place.at("data/images_2").join(photo_name(index))).expect("a photo");
    }
    place.run("train -s @data -m @model --images images_2 --sh-degree 0 --iterations 2").ok();
    let width = |folder: &str| {
        place.run(format!("render @model -s @data -o @{folder}")).ok();
        place.picture(format!("{folder}/00000.png")).width()
    };
    assert_eq!(width("halves"), view(0).width / 2);
    std::fs::remove_dir_all(place.at("data/images_2")).expect("removed");
    assert_eq!(width("wholes"), view(0).width);
}
