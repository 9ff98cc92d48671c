//! `ashsplat bench`, run as users run it.

use crate::cli::{refuse, succeed, text, write_dataset};
use crate::common::splats::write_points;
use crate::common::{assert_says, new_paths};
use serde_json::Value;
use std::path::Path;
use tempfile::tempdir;

fn small(what: &str) -> Vec<&str> {
    const ELEMENTS: [&str; 2] = ["--elements", "3000"];
    const FRAME: [&str; 6] = ["--gaussians", "400", "--width", "72", "--height", "48"];
    const ITERATIONS: [&str; 4] = ["--iterations", "3", "--warmup", "1"];
    let size: &[&[&str]] = match what {
        "scan" | "sort" => &[&ELEMENTS, &ITERATIONS],
        "render" | "train-step" => &[&FRAME, &ITERATIONS],
        _ => &[&ELEMENTS, &FRAME, &ITERATIONS],
    };
    [&["bench", what], &size.concat()[..]].concat()
}

pub fn measure(what: &str, more: &[&str]) -> String {
    succeed(&[&small(what)[..], more].concat())
}

pub fn read(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON")
}

pub fn runs(report: &Value) -> &Vec<Value> {
    report["runs"].as_array().expect("runs")
}

pub fn kernels(run: &Value) -> &Vec<Value> {
    run["kernels"].as_array().expect("kernels")
}

pub fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn bench_all_follows_its_schema() {
    let (_folder, [json]) = new_paths(["a.json"]);
    let table = measure("all", &["--json", text(&json), "--frames", "900@64x64"]);
    assert_says(&table, &["copy bandwidth", "untimed", "sort/sort_", "optimizer/adam"]);
    assert_says(&table, &["workgroups"]);
    let report = read(&json);
    assert_eq!(report["schema"], "ashsplat-bench/1");
    assert_eq!(report["settings"]["clock"], "timestamps");
    assert!(number(&report["copy_bandwidth"]["gigabytes_per_second"]) > 0.0);
    assert!(number(&report["arithmetic"]["gigaoperations_per_second"]) > 0.0);
    let names: Vec<&str> = runs(&report).iter().filter_map(|run| run["name"].as_str()).collect();
    // On a CPU the smaller sort is only timed as a whole.
    let whole = report["device"]["kind"] == "CPU";
    assert_eq!(names, ["scan", "sort", "sort-3000", "render", "render-900@64x64", "train-step"]);
    let other = runs(&report).iter().find(|run| run["name"] == "render-900@64x64").expect("the frame");
    assert_eq!(other["workload"]["gaussians"], 900);
    assert_eq!(runs(&report)[1]["split"]["kernels_ms"].is_null(), whole);
    assert!(number(&runs(&report)[1]["untimed_ms"]["min"]) > 0.0);
    for (place, run) in runs(&report).iter().enumerate() {
        if !(whole && place == 1) {
            check_run(run);
        }
        let arenas = run["memory"].as_array().expect("arenas");
        let has_primitives = arenas.iter().any(|arena| arena["name"] == "primitive");
        assert_eq!(has_primitives, place < 3, "another run's memory: {arenas:?}");
    }
}

/// Checks that the parts add up, dispatches have grids, and the counts are those of a frame.
fn check_run(run: &Value) {
    let split = &run["split"];
    let parts = ["kernels_ms", "recording_ms", "submitting_ms", "waiting_ms", "host_ms"];
    let sum: f64 = parts.iter().map(|part| number(&split[part])).sum();
    let wall = number(&split["wall_ms"]);
    assert!((sum - wall).abs() < 0.05 * wall, "{split}");
    let mut times = 0.0;
    for kernel in kernels(run) {
        let transfer = !kernel["kernel"].as_str().expect("a name").contains('/');
        assert_eq!(kernel["workgroups"].is_null(), transfer, "{kernel}");
        assert!(transfer || number(&kernel["workgroups"]) >= 1.0, "{kernel}");
        assert!(number(&kernel["bytes_read"]) + number(&kernel["bytes_written"]) > 0.0, "{kernel}");
        times += number(&kernel["time_us"]["median"]);
    }
    assert!(times > 0.0 && times < 3e3 * number(&run["device_ms"]["median"]), "{run}");
    let workload = &run["workload"];
    assert_eq!(workload["hash"].as_str().map(str::len), Some(16));
    assert!(number(&run["untimed_ms"]["mean"]) > 0.0);
    if run["name"] == "render" && workload["width"] != 64 {
        assert_eq!((&workload["gaussians"], &workload["width"]), (&Value::from(400), &Value::from(72)));
        assert!(number(&workload["visible"]) > 100.0 && number(&workload["instances"]) > 400.0);
        assert!(number(&workload["longest_tile"]) > 10.0);
        // Three vec4 of each Gaussian and the camera block; the placeholder for cut-outs does not count.
        let cull = kernels(run).iter().find(|kernel| kernel["kernel"] == "forward/cull").expect("culling");
        let read = number(&cull["bytes_read"]);
        assert!((48.0 * 400.0..72.0 * 400.0).contains(&read), "{cull}");
    }
    if run["name"] == "train-step" {
        assert!(number(&workload["longest_tile"]) > 10.0 && number(&workload["visible"]) > 100.0);
    }
    assert!(run["memory"].as_array().is_some_and(|arenas| !arenas.is_empty()));
}

#[test]
fn bench_without_timestamps_says_so() {
    let (_folder, [json]) = new_paths(["host.json"]);
    let table = measure("render", &["--host-clock", "--json", text(&json)]);
    assert!(table.contains("timed by the host's clock") && table.contains("GB/s"), "{table}");
    let report = read(&json);
    assert_eq!(report["settings"]["clock"], "host");
    for (yardstick, rate) in
        [("copy_bandwidth", "gigabytes_per_second"), ("arithmetic", "gigaoperations_per_second")]
    {
        assert_eq!(report[yardstick]["clock"], "host");
        assert!(number(&report[yardstick][rate]) > 0.0);
    }
    let run = &runs(&report)[0];
    assert!(run["device_ms"].is_null() && run["split"]["kernels_ms"].is_null());
    let is_untimed = |k: &Value| k["time_us"].is_null() && k["gigabytes_per_second"].is_null();
    assert!(!kernels(run).is_empty() && kernels(run).iter().all(is_untimed));
    assert!(number(&run["wall_ms"]["median"]) > 0.0);
}

#[test]
fn bench_measures_files_and_refuses_bad_ones() {
    let (folder, [ply]) = new_paths(["scene.ply"]);
    write_points(&ply, (0..60u8).map(|i| [f32::from(i % 8), f32::from(i / 8), 0.0]).collect(), 1);
    let small = ["--width", "64", "--height", "48", "--iterations", "1", "--warmup", "1"];
    let table = succeed(&[&["bench", "render", "--scene", text(&ply)], &small[..]].concat());
    assert!(table.contains("60 Gaussians of SH degree 1, 64x48") && table.contains("scene.ply"), "{table}");
    // Pixels keep their shape: a wider picture has the same instances in its middle.
    let cameras = folder.path().join("cameras.json");
    let intrinsics = ashsplat::scene::Intrinsics::from_fov_x(0.8, 64, 48);
    let (eye, target) = (glam::Vec3::new(3.5, 3.5, -24.0), glam::Vec3::new(3.5, 3.5, 0.0));
    let camera = ashsplat::scene::Camera::look_at(eye, target, glam::Vec3::NEG_Y, intrinsics);
    ashsplat_files::cameras_json::write(&cameras, [("a", &camera)], &Default::default()).expect("written");
    let instances = |width: &str| {
        let json = folder.path().join("frame.json");
        let place = text(&cameras);
        let one = ["bench", "render", "--scene", text(&ply), "--camera", place, "--json", text(&json)];
        let size = ["--width", width, "--height", "192", "--iterations", "1", "--warmup", "0"];
        succeed(&[&one[..], &size].concat());
        runs(&read(&json))[0]["workload"]["instances"].as_u64().expect("instances")
    };
    assert_eq!(instances("256"), instances("1024"));
    std::fs::write(&cameras, "[]").expect("written");
    let place = format!("{}:3", text(&cameras));
    refuse(&["bench", "render", "--scene", text(&ply), "--camera", &place], &["cameras.json"]);
    refuse(&["bench", "render", "--scene", "missing.ply"], &["missing.ply"]);
    refuse(&["bench", "render", "--gaussians", "0"], &["no Gaussians"]);
    let max = u32::MAX.to_string();
    refuse(&["bench", "render", "--gaussians", &max], &["--gaussians", "67108864"]);
    refuse(&["bench", "all", "--frames", &format!("{max}@9x9")], &["--frames", "67108864"]);
    // The seed disturbs the scene that is trained on its own picture.
    let hash = |seed: &str| {
        let json = folder.path().join("step.json");
        let one = ["bench", "train-step", "--scene", text(&ply), "--seed", seed, "--json", text(&json)];
        succeed(&[&one[..], &small].concat());
        runs(&read(&json))[0]["workload"]["hash"].clone()
    };
    assert_ne!(hash("1"), hash("2"));
}

/// All rows of a table in one run: a scene at its own size, a second data set up to the first window.
#[test]
fn bench_all_measures_a_scene_and_data_sets() {
    let (_folder, [first, second, ply, json]) = new_paths(["first", "second", "scene.ply", "a.json"]);
    write_dataset(&first);
    write_dataset(&second);
    write_points(&ply, vec![[0.0; 3]; 9], 1);
    let own = ["--scene", text(&ply), "--scene-size", "80x48", "--frames", "900@64x64"];
    let sets = ["--dataset", text(&first), "--dataset", text(&second), "--windows", "200,100"];
    measure("all", &[&own[..], &sets, &["--json", text(&json)]].concat());
    let report = read(&json);
    let of = |name: &str| {
        runs(&report).iter().filter(|run| run["workload"]["source"].to_string().contains(name)).count()
    };
    let counts = ["first, iterations", "second, iterations", "second, iterations 1 to 100"].map(of);
    assert_eq!(counts, [2, 1, 1]);
    let scene = runs(&report).iter().find(|run| run["workload"]["source"] == text(&ply)).expect("the scene");
    assert_eq!((&scene["workload"]["width"], &scene["workload"]["height"]), (&80.into(), &48.into()));
    for bad in ["80", "80x", "0x48", "80x-4"] {
        refuse(&["bench", "all", "--scene", text(&ply), "--scene-size", bad], &["--scene-size", "1280x720"]);
    }
    refuse(&["bench", "all", "--scene-size", "80x48"], &["--scene"]);
}

#[test]
fn bench_train_measures_windows_of_real_training() {
    let (_folder, [data, json]) = new_paths(["set", "a.json"]);
    write_dataset(&data);
    let set = ["bench", "train", "--dataset", text(&data), "--windows"];
    let table = succeed(&[&set[..], &["100,230", "--json", text(&json)]].concat());
    assert_says(&table, &["iterations 131 to 230"]);
    let report = read(&json);
    assert_eq!(runs(&report).len(), 2);
    for run in runs(&report) {
        assert!(run["name"].as_str().is_some_and(|name| name.starts_with("train")), "{}", run["name"]);
        assert!(kernels(run).iter().any(|k| k["scope"] == "adam" && number(&k["time_us"]["median"]) > 0.0));
        assert!(number(&run["untimed_ms"]["mean"]) > 0.0);
        assert!(number(&run["workload"]["longest_tile"]) > 0.0 && run["iterations"] == 49);
    }
    refuse(&["bench", "train"], &["--dataset"]);
    refuse(&[&set[..], &["100,150"]].concat(), &["150", "overlap"]);
}

/// Sizes that would take minutes: bad arguments are refused before any work.
const LARGE: [&str; 4] = ["--gaussians", "3000000", "--iterations", "1000"];

#[test]
fn bench_refuses_results_that_cannot_be_written_at_once() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| text(&folder.path().join(name)).to_owned();
    std::fs::write(at("file"), "").expect("written");
    let (is_folder, below_file) = (at(""), at("file/result"));
    for bad in [is_folder.as_str(), &below_file, "/proc/result"] {
        refuse(&[&["bench", "render", "--json", bad], &LARGE[..]].concat(), &["error: "]);
        refuse(&["profile", "--trace", bad, "--gaussians", "3000000", "--frames", "1000"], &["error: "]);
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1, "nothing is left behind");
    // A missing folder is created.
    measure("scan", &["--quiet", "--json", &at("new/folder/a.json")]);
    assert!(folder.path().join("new/folder/a.json").is_file());
}

#[test]
fn options_that_would_not_be_used_are_refused() {
    let unused: [(&[&str], &[&str]); 10] = [
        (&["render", "--windows", "100"], &["--windows", "`bench train`, `bench all`"]),
        (&["render", "--frames", "9@9x9"], &["--frames", "`bench all`"]),
        (&["render", "--elements", "9"], &["--elements", "`bench scan`, `bench sort`"]),
        (&["scan", "--width", "9"], &["--width", "`bench render`"]),
        (&["sort", "--scene", "x.ply"], &["--scene"]),
        (&["train", "--dataset", "x", "--iterations", "9"], &["--iterations", "leave it out"]),
        (&["train", "--dataset", "x", "--view", "1"], &["--view"]),
        (&["all", "--windows", "100"], &["--dataset"]),
        (&["all", "--view", "1"], &["--view"]),
        (&["render", "--view", "1"], &["--dataset"]),
    ];
    for (arguments, words) in unused {
        refuse(&[&["bench"], arguments].concat(), words);
    }
    for command in [&["bench", "render"][..], &["bench", "train-step"], &["profile"]] {
        let of_file = |more: &[&'static str]| [command, &["--scene", "x.ply"], more].concat();
        refuse(&of_file(&["--gaussians", "9"]), &["--gaussians", "leave it or --scene out"]);
        refuse(&of_file(&["--sh-degree", "1"]), &["--sh-degree", "synthetic"]);
        let of_dataset = |more: &[&'static str]| [command, &["--dataset", "x"], more].concat();
        refuse(&of_dataset(&["--gaussians", "9"]), &["leave it or --dataset out"]);
        refuse(&of_dataset(&["--seed", "9"]), &["--seed"]);
    }
    refuse(&["bench", "render", "--scene", "x.ply", "--seed", "1"], &["--seed"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_a_failure_and_a_closed_one_is_not() {
    use crate::{cli::program, program::running::Running};
    use std::process::Stdio;
    let commands: [&[&str]; 4] =
        [&["devices"], &["--help"], &["bench", "scan", "--elements", "99"], &["--version"]];
    for arguments in commands {
        let full = std::fs::File::options().write(true).open("/dev/full").expect("a full device");
        let output = program().args(arguments).stdout(full).stderr(Stdio::piped()).output();
        let output = output.expect("it ends");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.starts_with("error: standard output: cannot write"), "{said}");
        let mut command = program();
        command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = Running::start(&mut command);
        drop(child.stdout.take());
        let output = child.finish();
        assert!(output.status.success() && output.stderr.is_empty(), "{arguments:?}");
    }
}

const BLENDED: [&str; 8] = ["--gaussians", "400", "--width", "72", "--height", "48", "--iterations", "3"];

fn blended(run: &Value) -> Vec<&str> {
    kernels(run).iter().filter(|k| k["scope"] == "blend").filter_map(|k| k["kernel"].as_str()).collect()
}

#[test]
fn bench_measures_the_form_that_is_asked_for() {
    let (_folder, [json]) = new_paths(["a.json"]);
    let forms = [("render", "shared", "forward/blend_shared"), ("train-step", "regions", "forward/blend")];
    for (what, form, kernel) in forms {
        succeed(&[&["bench", what, "--blending", form, "--json", text(&json)], &BLENDED[..]].concat());
        let report = read(&json);
        let run = &runs(&report)[0];
        assert_eq!((&run["name"], &run["workload"]["blending"]), (&what.into(), &form.into()));
        assert_eq!(blended(run), [kernel]);
        let blending = kernels(run).iter().find(|k| k["kernel"] == kernel).expect("blending");
        assert!(number(&blending["operations"]) > 0.0);
    }
    let profiled = ["profile", "render", "--blending", "shared", "--gaussians", "400", "--width", "72"];
    let table = succeed(&[&profiled[..], &["--height", "48", "--frames", "2"]].concat());
    assert!(table.contains("forward/blend_shared"), "{table}");
    refuse(&["bench", "render", "--blending", "tiles"], &["--blending", "regions", "shared"]);
    refuse(&["bench", "sort", "--blending", "shared"], &["--blending"]);
    let step = [&["bench", "train-step", "--no-read-back"], &BLENDED[..]].concat();
    refuse(&step, &["--no-read-back", "no picture"]);
}
