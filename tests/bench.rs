//! `ashsplat bench`, run as its users run it.

use crate::cli::{finish, program, refuse, succeed, text};
use serde_json::Value;
use std::path::Path;
use tempfile::tempdir;

/// A workload that takes no time.
const SMALL: [&str; 12] = [
    "--elements",
    "3000",
    "--gaussians",
    "400",
    "--width",
    "72",
    "--height",
    "48",
    "--iterations",
    "3",
    "--warmup",
    "1",
];

fn measure(what: &str, more: &[&str]) -> String {
    succeed(&[&["bench", what], &SMALL[..], more].concat())
}

fn read(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON")
}

fn write(path: &Path, value: &Value) {
    std::fs::write(path, value.to_string()).expect("written");
}

fn runs(report: &Value) -> &Vec<Value> {
    report["runs"].as_array().expect("runs")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn bench_all_follows_its_schema() {
    let folder = tempdir().expect("a temporary folder");
    let (json, csv) = (folder.path().join("a.json"), folder.path().join("a.csv"));
    let table = measure("all", &["--json", text(&json), "--csv", text(&csv), "--frames", "900@64x64"]);
    for word in
        ["copy bandwidth", "cost of measuring", "sort/sort_", "optimizer/adam", "workgroups", "std stable"]
    {
        assert!(table.contains(word), "no '{word}' in {table}");
    }
    let report = read(&json);
    assert_eq!(report["schema"], "ashsplat-bench/1");
    assert_eq!(report["settings"]["clock"], "timestamps");
    assert!(number(&report["copy_bandwidth"]["gigabytes_per_second"]) > 0.0);
    assert!(number(&report["arithmetic"]["gigaoperations_per_second"]) > 0.0);
    let names: Vec<&str> = runs(&report).iter().filter_map(|run| run["name"].as_str()).collect();
    assert_eq!(names, ["scan", "sort", "sort-3000", "render", "render-900@64x64", "train-step"]);
    assert_eq!(runs(&report)[4]["workload"]["gaussians"], 900);
    // The smaller sort is timed as a whole only.
    assert!(
        runs(&report)[1]["split"]["kernels_ms"].is_null()
            && number(&runs(&report)[1]["untimed_ms"]["min"]) > 0.0
    );
    for run in runs(&report).iter().enumerate().filter(|(place, _)| *place != 1).map(|(_, run)| run) {
        check_run(run);
    }
    let lines = std::fs::read_to_string(&csv).expect("a file").lines().count();
    let kernels: usize = runs(&report).iter().map(|run| run["kernels"].as_array().map_or(0, Vec::len)).sum();
    assert_eq!(lines, 1 + kernels);
    let sorts = runs(&report)[1]["cpu"].as_array().expect("sorts of the processor");
    assert_eq!(sorts.len(), if cfg!(feature = "cpu-sorts") { 6 } else { 2 });
}

/// The parts add up, dispatches have grids, and the counts are those of a frame.
fn check_run(run: &Value) {
    let split = &run["split"];
    let parts = ["kernels_ms", "recording_ms", "submitting_ms", "waiting_ms", "host_ms"];
    let sum: f64 = parts.iter().map(|part| number(&split[part])).sum();
    let wall = number(&split["wall_ms"]);
    assert!((sum - wall).abs() < 0.05 * wall, "{split}");
    let mut times = 0.0;
    for kernel in run["kernels"].as_array().expect("kernels") {
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
    }
    assert!(run["memory"].as_array().is_some_and(|arenas| !arenas.is_empty()));
}

#[test]
fn bench_compare_names_what_became_slower() {
    let folder = tempdir().expect("a temporary folder");
    let (a, b) = (folder.path().join("a.json"), folder.path().join("b.json"));
    measure("sort", &["--json", text(&a), "--quiet"]);
    let same = succeed(&["bench", "compare", text(&a), text(&a), "--fail-above", "1.01"]);
    assert!(same.contains("1.000") && same.contains("same"), "{same}");
    assert!(!same.contains("SLOWER") && !same.contains("faster"), "{same}");

    let mut report = read(&a);
    let kernel = &mut report["runs"][0]["kernels"][0];
    let name = kernel["kernel"].as_str().expect("a name").to_owned();
    assert!(name.starts_with("sort/sort_"), "{name}");
    for part in ["min", "median", "p90"] {
        kernel["time_us"][part] = Value::from(50.0 * number(&kernel["time_us"][part]) + 1e4);
    }
    write(&b, &report);
    let slower = succeed(&["bench", "compare", text(&a), text(&b)]);
    let marked: Vec<&str> = slower.lines().filter(|line| line.ends_with("SLOWER")).collect();
    assert!(marked.len() == 1 && marked[0].contains(&name), "{slower}");
    let run = finish(program().args(["bench", "compare", text(&a), text(&b), "--fail-above", "1.15"]));
    assert_eq!(run.code, Some(2));
    assert!(run.stderr.contains(&format!("slower than 1.15 times: sort {name} in 'sort'")), "{}", run.stderr);
    // A kernel that only one of them has is named, and no comparison.
    report["runs"][0]["kernels"].as_array_mut().expect("kernels").remove(0);
    write(&b, &report);
    assert!(succeed(&["bench", "compare", text(&a), text(&b)]).contains("only in A: sort sort/sort_"));
    refuse(
        &["bench", "compare", text(&a), text(&b), "--fail-above", "9"],
        &["cannot be compared", "sort/sort_"],
    );
    report["settings"]["clock"] = Value::from("host");
    write(&b, &report);
    refuse(&["bench", "compare", text(&a), text(&b)], &["clocks differ"]);
    report = read(&a);
    write(&b, &report);
    // The other way round nothing is slower.
    succeed(&["bench", "compare", text(&b), text(&a), "--fail-above", "1.15"]);
}

#[test]
fn bench_compare_refuses_what_cannot_be_compared() {
    let folder = tempdir().expect("a temporary folder");
    let (a, b) = (folder.path().join("a.json"), folder.path().join("b.json"));
    measure("scan", &["--json", text(&a), "--quiet"]);
    let mut report = read(&a);
    report["schema"] = "ashsplat-bench/2".into();
    write(&b, &report);
    refuse(&["bench", "compare", text(&a), text(&b)], &["b.json", "ashsplat-bench/2", "ashsplat-bench/1"]);
    measure("scan", &["--json", text(&b), "--quiet", "--seed", "1"]);
    refuse(&["bench", "compare", text(&a), text(&b)], &["workloads of scan differ", "seed 1"]);
    measure("sort", &["--json", text(&b), "--quiet"]);
    refuse(&["bench", "compare", text(&a), text(&b)], &["runs differ", "scan", "sort"]);
    std::fs::write(&b, "no JSON").expect("written");
    refuse(&["bench", "compare", text(&a), text(&b)], &["b.json", "JSON"]);
    refuse(&["bench", "compare", text(&a), "missing.json"], &["missing.json"]);
    refuse(&["bench", "compare", text(&a), text(&a), "--fail-above", "0"], &["--fail-above"]);
}

#[test]
fn bench_without_timestamps_says_so() {
    let folder = tempdir().expect("a temporary folder");
    let json = folder.path().join("host.json");
    let table = measure("render", &["--host-clock", "--json", text(&json)]);
    assert!(table.contains("no timestamps"), "{table}");
    let report = read(&json);
    assert_eq!(report["settings"]["clock"], "host");
    assert!(report["copy_bandwidth"].is_null());
    let run = &runs(&report)[0];
    assert!(run["device_ms"].is_null() && run["split"]["kernels_ms"].is_null());
    let kernels = run["kernels"].as_array().expect("kernels");
    assert!(
        !kernels.is_empty()
            && kernels.iter().all(|k| k["time_us"].is_null() && k["gigabytes_per_second"].is_null())
    );
    assert!(number(&run["wall_ms"]["median"]) > 0.0);
}

#[test]
fn bench_scaling_fits_and_plots() {
    let folder = tempdir().expect("a temporary folder");
    let plot = folder.path().join("plot.svg");
    let sizes = ["--counts", "100,1000", "--widths", "32,64", "--plot", text(&plot)];
    let table = succeed(&[&["bench", "scaling"], &SMALL[2..4], &SMALL[8..], &sizes[..]].concat());
    assert!(table.contains("exponent") && table.contains("tile sort") && table.contains("1,000"), "{table}");
    let svg = std::fs::read_to_string(&plot).expect("a plot");
    assert!(svg.starts_with("<svg") && svg.contains("blend") && svg.contains("pixels"), "{svg}");
}

#[test]
fn bench_measures_files_and_refuses_bad_ones() {
    let folder = tempdir().expect("a temporary folder");
    let ply = folder.path().join("scene.ply");
    let points = ashsplat::scene::PointCloud {
        positions: (0..60u8).map(|i| [f32::from(i % 8), f32::from(i / 8), 0.0]).collect(),
        colors: vec![[200, 100, 50]; 60],
    };
    let gaussians = ashsplat::scene::Gaussians::from_points(&points, 1).expect("Gaussians");
    ashsplat::io::ply::write(&ply, &gaussians).expect("written");
    let small = ["--width", "64", "--height", "48", "--iterations", "1", "--warmup", "1"];
    let table = succeed(&[&["bench", "render", "--scene", text(&ply)], &small[..]].concat());
    assert!(table.contains("60 Gaussians of SH degree 1, 64x48") && table.contains("scene.ply"), "{table}");
    let cameras = folder.path().join("cameras.json");
    std::fs::write(&cameras, "[]").expect("written");
    let place = format!("{}:3", text(&cameras));
    refuse(&["bench", "render", "--scene", text(&ply), "--camera", &place], &["cameras.json"]);
    refuse(&["bench", "render", "--scene", "missing.ply"], &["missing.ply"]);
    refuse(&["bench", "render", "--gaussians", "0"], &["no Gaussians"]);
}

#[test]
fn bench_train_measures_windows_of_real_training() {
    let folder = tempdir().expect("a temporary folder");
    let (data, json) = (folder.path().join("set"), folder.path().join("a.json"));
    crate::cli::write_dataset(&data);
    let arguments =
        ["bench", "train", "--dataset", text(&data), "--windows", "100,230", "--json", text(&json)];
    let table = succeed(&arguments);
    assert!(table.contains("iterations 131 to 230"), "{table}");
    let report = read(&json);
    assert_eq!(runs(&report).len(), 2);
    for run in runs(&report) {
        assert!(run["name"].as_str().is_some_and(|name| name.starts_with("train")), "{}", run["name"]);
        let kernels = run["kernels"].as_array().expect("kernels");
        assert!(kernels.iter().any(|k| k["scope"] == "adam" && number(&k["time_us"]["median"]) > 0.0));
        assert!(number(&run["untimed_ms"]["mean"]) > 0.0);
    }
    refuse(&["bench", "train"], &["--dataset"]);
    refuse(&["bench", "train", "--dataset", text(&data), "--windows", "100,150"], &["150", "overlap"]);
}
