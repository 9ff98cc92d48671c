//! One scene in two layouts: as the synthetic scenes of the NeRF paper, and as a COLMAP model.

use super::*;
use ashsplat_files::{Dataset, DatasetOptions, Progress, View};
use serde_json::Value;
use tempfile::tempdir;

/// Writes the demo's scene without its sky in both layouts.
fn write_both(folder: &Path, points: &str) -> [PathBuf; 2] {
    ["nerf-synthetic", "colmap"].map(|layout| {
        let out = folder.join(layout);
        let kind = ["--layout", layout, "--points", points, "--without-sky"];
        succeed(&[&["demo", "--out", text(&out), "--dataset-only", "--quiet"], &kind[..]].concat());
        out.join("dataset")
    })
}

fn load(dataset: &Path) -> Dataset {
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    Dataset::load(dataset, &options, Progress::NONE).expect("a data set")
}

/// Trains. Returns the held-out PSNR, dB, and the scene's bytes.
fn train(dataset: &Path, model: &Path, arguments: &[&str]) -> (f64, Vec<u8>) {
    let run = ["train", "-s", text(dataset), "-m", text(model), "--eval", "--random-points", "--quiet"];
    succeed(&[&run[..], &["--test_iterations", "-1"], arguments].concat());
    let results = std::fs::read_to_string(model.join("results.json")).expect("results");
    let results: Value = serde_json::from_str(&results).expect("JSON");
    let (iteration, last) = results.as_object().expect("by iteration").iter().next_back().expect("a test");
    let scene = format!("point_cloud/{}/point_cloud.ply", iteration.replace("ours", "iteration"));
    let scene = std::fs::read(model.join(scene)).expect("a scene");
    (last["PSNR"].as_f64().expect("a number"), scene)
}

/// An aerial survey.
#[test]
fn the_city_is_a_data_set_of_many_photos() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let city =
        ["demo", "--out", text(&at("city")), "--scene", "city", "--photo-width", "64"].map(String::from);
    succeed(&city.iter().map(String::as_str).chain(["--dataset-only", "--quiet"]).collect::<Vec<_>>());
    let dataset = load(&at("city/dataset"));
    assert_eq!((dataset.train.len(), dataset.test.len()), (141, 21));
    let camera = dataset.train[0].camera;
    assert_eq!((camera.width, camera.height), (64, 48));
    assert!(dataset.points.positions.len() > 1000);
    for of_the_city in [["--lots", "12"], ["--photo-width", "64"]] {
        let out = at("none");
        refuse(&[&["demo", "--out", text(&out)][..], &of_the_city].concat(), &[of_the_city[0], "city"]);
        assert!(!out.exists());
    }
}

/// Fails unless both layouts load identically, to the bit.
fn assert_alike(nerf: &Dataset, colmap: &Dataset) {
    assert_eq!((nerf.train.len(), nerf.test.len()), (35, 5));
    let corner: Vec<u8> = nerf.train[0].photo.photo().expect("in memory").rgb[..3].to_vec();
    assert_eq!(corner, [0; 3], "the sky is transparent, and so the background");
    assert_eq!((&nerf.points, nerf.scene_extent), (&colmap.points, colmap.scene_extent));
    let number =
        |view: &View| view.name.trim_end_matches(".png").rsplit_once('_').expect("a number").1.to_owned();
    for (a, b) in [(&nerf.train, &colmap.train), (&nerf.test, &colmap.test)] {
        assert_eq!(a.len(), b.len());
        for (a, b) in a.iter().zip(b) {
            assert_eq!((number(a), a.camera), (number(b), b.camera));
            assert!(a.photo == b.photo, "the photos of {} differ", a.name);
        }
    }
}

/// Photographs, cameras, split and points are equal, so the scenes must be equal to the bit. Densification would
/// amplify any difference.
fn compare(points: &str, arguments: &[&str], least: f64) {
    let folder = tempdir().expect("a temporary folder");
    let [nerf, colmap] = write_both(folder.path(), points);
    assert_alike(&load(&nerf), &load(&colmap));
    let nerf = train(&nerf, &folder.path().join("a"), arguments);
    let colmap = train(&colmap, &folder.path().join("b"), arguments);
    println!("{points}: held out {:.3} dB as NeRF-synthetic, {:.3} dB as COLMAP", nerf.0, colmap.0);
    assert!((nerf.0 - colmap.0).abs() < 0.1 && nerf.0 > least, "{:.3} dB, {:.3} dB", nerf.0, colmap.0);
    assert!(nerf.1 == colmap.1, "the scenes differ");
}

#[test]
fn layouts_of_a_scene_train_alike() {
    let short = ["--iterations", "40", "-r", "4", "--sh_degree", "1", "--densify_from_iter", "15"];
    let densify = ["--densification_interval", "10", "--densify_until_iter", "35"];
    compare("sparse", &[&short[..], &densify].concat(), 15.0);
}

/// The demo's schedule for this number of iterations.
fn schedule(iterations: u32) -> Vec<String> {
    let n = |share: f64| format!("{}", (f64::from(iterations) * share) as u32);
    [
        ("iterations", n(1.0)),
        ("sh_degree_interval", n(1.0 / 6.0)),
        ("position_lr_max_steps", n(1.0)),
        ("position_lr_init", "8e-4".into()),
        ("feature_lr", "0.005".into()),
        ("opacity_lr", "0.05".into()),
        ("scaling_lr", "0.015".into()),
        ("densify_from_iter", n(0.1)),
        ("densify_until_iter", n(0.6)),
        ("opacity_reset_interval", n(2.0)),
    ]
    .into_iter()
    .flat_map(|(name, value)| [format!("--{name}"), value])
    .collect()
}

/// Takes minutes on a CPU.
#[test]
#[ignore = "takes minutes"]
fn layouts_of_a_scene_train_alike_for_long() {
    for points in ["sparse", "none"] {
        let schedule = schedule(1200);
        let arguments: Vec<&str> = schedule.iter().map(String::as_str).chain(["-r", "2"]).collect();
        compare(points, &arguments, 21.0);
    }
}
