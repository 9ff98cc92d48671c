//! `ashsplat bench quality`: trainings with several strategies and seeds.

use crate::bench::{number, read, runs};
use crate::cli::{assert_refused, finish, program, succeed, text, write_dataset};
use crate::common::new_paths;
use crate::program::running::Running;
use ashsplat::TrainSettings;
use ashsplat::train::settings::OptionKind;
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn strategies() -> [&'static str; 2] {
    let option = TrainSettings::OPTIONS.iter().find(|option| option.name == "strategy").expect("there");
    let OptionKind::Choice(names) = option.kind else { panic!("{:?}", option.kind) };
    [names[0], "mcmc"]
}

fn folders() -> (TempDir, PathBuf, PathBuf) {
    let (folder, [data, out]) = new_paths(["data", "out"]);
    write_dataset(&data);
    (folder, data, out)
}

fn assert_trained(end: &Value, model: &Path) {
    let trained = &read(&model.join("results.json"))["ours_12"];
    for (ours, theirs) in [("psnr", "PSNR"), ("ssim", "SSIM"), ("gaussians", "gaussians")] {
        assert!((number(&end[ours]) - number(&trained[theirs])).abs() < 1e-9, "{ours}: {end} {trained}");
    }
}

#[test]
fn bench_quality_measures_what_training_gives_and_continues() {
    let (folder, data, out) = folders();
    let model = folder.path().join("model");
    let names = strategies();
    let both = names.join(",");
    let schedule = ["--sh-degree", "1", "--densify-from-iter", "2", "--densification-interval", "3"];
    let quality = ["bench", "quality", text(&data), "-o", text(&out), "--strategies", &both, "--quiet"];
    let of_seeds = |seeds| {
        [&quality[..], &schedule, &["--iterations", "12", "--points", "3", "--seeds", seeds]].concat()
    };
    let until = ["--until", "3", "--until", "99"];
    let said = succeed(&[&of_seeds("0..2")[..], &until].concat());
    assert!(said.contains("3 dB: by 2 of 2") && said.contains("99 dB: not reached"), "{said}");

    let report = read(&out.join("quality.json"));
    let runs = runs(&report);
    let order: Vec<(&str, u64)> = runs
        .iter()
        .map(|run| (run["strategy"].as_str().expect("a name"), run["seed"].as_u64().expect("a seed")))
        .collect();
    assert_eq!(order, [(names[0], 0), (names[1], 0), (names[0], 1), (names[1], 1)], "in turn");
    for run in runs {
        let points = run["points"].as_array().expect("points");
        assert_eq!(points.iter().map(|p| p["iteration"].as_u64()).collect::<Vec<_>>(), [4, 8, 12].map(Some));
        let rises = |name: &str| points.windows(2).all(|p| number(&p[0][name]) < number(&p[1][name]));
        assert!(rises("seconds") && (cfg!(not(target_os = "linux")) || rises("cpu_seconds")), "{run}");
    }
    for (curve, name) in report["summary"]["curves"].as_array().expect("curves").iter().zip(names) {
        assert_eq!(curve["strategy"], name);
        let own = runs.iter().filter(|run| run["strategy"] == name);
        let ends: Vec<f64> = own.map(|run| number(&run["points"][2]["psnr"])).collect();
        assert!((number(&curve["places"][2]["psnr"]["mean"]) - (ends[0] + ends[1]) / 2.0).abs() < 1e-9);
        assert_ne!(ends[0], ends[1], "seeds differ");
    }
    let csv = std::fs::read_to_string(out.join("quality.csv")).expect("a table");
    assert_eq!(csv.lines().count(), 1 + 4 * 3);
    let svg = std::fs::read_to_string(out.join("quality.svg")).expect("a plot");
    assert!(svg.starts_with("<svg") && svg.matches("<polyline").count() == 8);

    // `train` gives the same training.
    let train = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--quiet", "--strategy", names[1]];
    let more = ["--iterations", "12", "--seed", "1", "--few-photos", "off"];
    succeed(&[&train[..], &schedule, &more].concat());
    let end = &runs[3]["points"][2];
    assert_trained(end, &model);

    // Finished runs are not repeated; missing ones are.
    let file = |strategy: &str, seed: u32| out.join(format!("runs/{strategy}-{seed}.json"));
    let kept = std::fs::read(file(names[0], 0)).expect("a run");
    std::fs::remove_file(file(names[1], 1)).expect("removed");
    succeed(&of_seeds("1,0"));
    assert_eq!(std::fs::read(file(names[0], 0)).expect("a run"), kept);
    let again = read(&file(names[1], 1));
    assert_eq!(again["points"][2]["psnr"], end["psnr"], "the same bits");
    // Another measurement must not mix with it.
    let other = [&quality[..], &schedule, &["--iterations", "11", "--points", "3"]].concat();
    let run = finish(program().args(other));
    assert_refused(&run, &["-0.json", "another iterations: 12, now 11", "-o"]);
    assert_eq!(std::fs::read(file(names[0], 0)).expect("a run"), kept);
}

#[test]
fn bench_quality_measures_presets_beside_strategies() {
    let (folder, data, out) = folders();
    let growth = ["--densify-from-iter", "2", "--densification-interval", "3"];
    let short = [&growth[..], &["--iterations", "12", "--quiet"]].concat();
    let both = ["--presets", "fast,quality", "--strategies", "reference", "--points", "2"];
    succeed(&[&["bench", "quality", text(&data), "-o", text(&out)], &both[..], &short].concat());
    let report = read(&out.join("quality.json"));
    let runs = runs(&report);
    let names: Vec<_> = runs.iter().map(|run| run["strategy"].as_str().expect("a name")).collect();
    assert_eq!(names, ["reference", "preset-fast", "preset-quality"]);
    for (run, preset) in runs[1..].iter().zip(["fast", "quality"]) {
        let model = folder.path().join(preset);
        let train = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--preset", preset];
        succeed(&[&train[..], &["--few-photos", "off"], &short].concat());
        assert_trained(&run["points"][1], &model);
    }
    let plain = &runs[0]["points"][1]["psnr"];
    assert!(runs[1..].iter().all(|run| run["points"][1]["psnr"] != *plain), "presets are no reference");
}

#[test]
fn bench_quality_refuses_what_makes_no_sense() {
    let (_folder, data, out) = folders();
    let refused = |more: &[&str], words: &[&str]| {
        let arguments = [&["bench", "quality", text(&data), "-o", text(&out)], more].concat();
        assert_refused(&finish(program().args(arguments)), words);
        assert!(!out.exists(), "{more:?}");
    };
    let some = ["--strategies", "mcmc"];
    let with = |more: &[&'static str]| [&some[..], more].concat();
    refused(&["--strategies", "mcmcm"], &["mcmcm", "mcmc"]);
    refused(&[], &["--strategies"]);
    refused(&with(&["--seeds", "3..3"]), &["--seeds", "0..3"]);
    refused(&["--strategies", "mcmc,mcmc"], &["--strategies", "twice"]);
    refused(&["--presets", "fast,fast"], &["--presets", "'fast' twice"]);
    refused(&["--presets", "faster"], &["faster", "quality"]);
    refused(&["--presets", "fast", "--strategy", "mcmc"], &["--strategy", "--strategies"]);
    refused(&with(&["--seed", "3"]), &["--seed", "--seeds"]);
    refused(&with(&["--strategy", "mcmc"]), &["--strategy", "--strategies"]);
    refused(&with(&["--iterations", "0"]), &["iterations", "at least 1"]);
    refused(&with(&["--until=-3"]), &["--until"]);
    // Errors of the second strategy come before the first training.
    let late = ["--strategies", "budget,reference", "--late-min-opacity", "0.1", "--iterations", "3"];
    refused(&late, &["late_min_opacity", "reference"]);
    refused(&with(&["-d", "nowhere"]), &["nowhere", "no folder with depth maps"]);
    // Without points, unless random ones are requested.
    let points = data.join("sparse/0/points3D.bin");
    assert!(points.exists());
    std::fs::write(points, 0_u64.to_le_bytes()).expect("written");
    refused(&some, &["no points to start from", "--random-points"]);
    let wanted = ["--random-points", "--strategies", strategies()[0], "--iterations", "1", "--quiet"];
    succeed(&[&["bench", "quality", text(&data), "-o", text(&out)], &wanted[..]].concat());
    let run = &read(&out.join("quality.json"))["runs"][0];
    assert_eq!(run["setup"]["random_points"], true, "{run}");
}

#[test]
fn bench_quality_keeps_what_is_over_when_stopped() {
    let (_folder, data, out) = folders();
    let name = strategies()[0];
    let mut command = program();
    command.args(["bench", "quality", text(&data), "-o", text(&out), "--strategies", name]);
    command.args(["--seeds", "0..1000", "--iterations", "20", "--points", "2", "--quiet"]);
    let mut child = Running::start(&mut command);
    let plot = out.join("quality.svg");
    while !plot.exists() {
        assert!(child.try_wait().expect("a child").is_none(), "it is over before the first run");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    child.interrupt();
    assert_eq!(child.finish().status.code(), Some(130));
    let runs = runs(&read(&out.join("quality.json"))).len();
    let files = std::fs::read_dir(out.join("runs")).expect("a folder").count();
    assert!(runs >= 1 && files == runs, "{files} files of {runs} runs");
    assert!(!out.join(".quality.lock").exists());
}

#[test]
fn bench_suite_trains_scenes_by_recipes_and_continues() {
    let (folder, data, out) = folders();
    let file = folder.path().join("suite.toml");
    let suite = r#"
        iterations = 6
        tests = [3]
        options = ["--sh-degree", "1"]
        scene = [{ name = "all", dataset = "data" }, { name = "six", dataset = "data", photographs = 6, first = 1 }]
        recipe = [{ name = "usual" }, { name = "reference", options = ["--preset", "reference"] }]
    "#;
    std::fs::write(&file, suite).expect("written");
    let run = || succeed(&["bench", "suite", text(&file), "-o", text(&out)]);
    let table = run();
    assert!(data.is_dir() && out.join("suite.md").is_file());
    for part in ["| PSNR, dB | usual | reference |", "| all |", "| six |", "| **mean** |", "Recipe reference"]
    {
        assert!(table.contains(part), "{part}: {table}");
    }
    let note = |scene: &str, recipe: &str| out.join(scene).join(format!("{recipe}-0.json"));
    let kept = std::fs::read(note("all", "usual")).expect("a note");
    let results = read(&out.join("all/usual-0/results.json"));
    let (psnr, last) = (number(&results["ours_6"]["PSNR"]), &read(&note("all", "usual"))["last"]);
    assert_eq!(number(&last["PSNR"]), psnr);
    assert!(table.contains(&format!("| all | {psnr:.2} |")), "{table}");
    // The same views are held out for all recipes: 9 views have two inner ones, 6 have one.
    for (scene, names) in [("all", ["03.png", "07.png"].as_slice()), ("six", &["06.png"])] {
        let folder = out.join(scene).join("reference-0");
        let cameras = read(&folder.join("cameras.json"));
        let listed =
            cameras.as_array().expect("cameras").iter().map(|c| c["img_name"].as_str().expect("a name"));
        assert_eq!(listed.take(names.len()).collect::<Vec<_>>(), names, "{scene}");
    }
    // A finished run stays, one without results is made again.
    std::fs::remove_file(note("six", "usual")).expect("removed");
    assert_eq!(run().lines().next(), table.lines().next());
    assert_eq!(std::fs::read(note("all", "usual")).expect("a note"), kept);
    assert!(note("six", "usual").is_file());
}
