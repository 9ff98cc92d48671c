//! `--pose-opt` recovers the demo's poses after known displacements.

use super::{succeed, text, write_dataset};
use ashsplat::Camera;
use ashsplat::scene::{Similarity, Twist, WorldFrame, scene_extent};
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::colmap::{self, ColmapImage, Model};
use glam::{DMat3, DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::path::Path;
use tempfile::tempdir;

const ITERATIONS: &str = "2000";

/// Turns each camera of a COLMAP model by a degree and moves it by a hundredth of the extent. Returns the cameras
/// before and after, with their photographs' names.
fn perturb(data: &Path) -> [Vec<(String, Camera)>; 2] {
    let model = Model::read(&colmap::find(data).expect("a folder")).expect("a model");
    let true_ones: Vec<(String, Camera)> = (model.images.iter())
        .map(|image| (image.name.clone(), model.camera_of(image).expect("a camera")))
        .collect();
    let extent =
        scene_extent(true_ones.iter().map(|(_, camera)| camera.position()).collect::<Vec<_>>().into_iter());
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut direction = || loop {
        let v = DVec3::from_array([0; 3].map(|_| random.random_range(-1.0..1.0)));
        if (0.1..1.0).contains(&v.length()) {
            return v.normalize();
        }
    };
    let mut move_one = |(name, camera): &(String, Camera)| {
        let twist =
            Twist { nu: direction() * 0.01 * f64::from(extent), omega: direction() * 1_f64.to_radians() };
        (name.clone(), twist.applied_to(camera))
    };
    let moved: Vec<(String, Camera)> = true_ones.iter().map(&mut move_one).collect();
    let images: Vec<ColmapImage> = (model.images.iter().zip(&moved))
        .map(|(image, (name, camera))| ColmapImage::posed(image.id, image.camera_id, name.clone(), camera))
        .collect();
    let lenses: Vec<_> = model.cameras.values().cloned().collect();
    colmap::write(data.join("sparse/0"), &lenses, &images, &model.points.in_frame(&WorldFrame::default()))
        .expect("written");
    [true_ones, moved]
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON")
}

fn train(data: &Path, model: &Path, more: &[&str]) -> (String, Value) {
    let usual = ["train", "-s", text(data), "-m", text(model), "--eval", "-r", "2", "--quiet"];
    // Fixed Gaussians, because new ones could fit a photograph at its wrong pose.
    let schedule = ["--iterations", ITERATIONS, "--position_lr_max_steps", ITERATIONS, "--strategy", "fixed"];
    let rest = ["--sh_degree", "0", "--eval-share", "0"];
    let stdout = succeed(&[usual.as_slice(), &schedule, &rest, more].concat());
    let results = json(&model.join("results.json"));
    (stdout, results[format!("ours_{ITERATIONS}")].clone())
}

/// Angle of a rotation, degrees.
fn angle_of(turn: &DMat3) -> f64 {
    let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
    (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Similarity from the cameras' world to the true one: the mean turn between directions, then the best scale and
/// translation of the centres.
fn similarity(cameras: &[NamedCamera], true_ones: &[(String, Camera)]) -> Similarity {
    let pairs = pairs(cameras, true_ones);
    let turn = |[found, wanted]: &[Camera; 2]| {
        let turn = wanted.camera_from_world.as_dmat3().transpose() * found.camera_from_world.as_dmat3();
        let turn = DQuat::from_mat3(&turn);
        if turn.w < 0.0 { -turn } else { turn }
    };
    let rotation = pairs.iter().map(turn).fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, turn| sum + turn);
    let rotation = rotation.normalize();
    let middle = |which: usize| {
        pairs.iter().map(|pair| pair[which].exact_position()).sum::<DVec3>() / pairs.len() as f64
    };
    let (found, wanted) = (middle(0), middle(1));
    let (mut likeness, mut size) = (0.0, 0.0);
    for pair in &pairs {
        let arm = rotation * (pair[0].exact_position() - found);
        likeness += arm.dot(pair[1].exact_position() - wanted);
        size += arm.length_squared();
    }
    let scale = likeness / size;
    Similarity { rotation, scale, translation: wanted - scale * (rotation * found) }
}

/// Pairs each camera with the true one of its name.
fn pairs(cameras: &[NamedCamera], true_ones: &[(String, Camera)]) -> Vec<[Camera; 2]> {
    let of = |name: &str| true_ones.iter().find(|(other, _)| other == name).expect("known").1;
    cameras.iter().map(|named| [named.camera, of(&named.name)]).collect()
}

/// Mean errors of the cameras after alignment by a similarity: angle, degrees, and distance of the centres, as a
/// share of the extent.
fn away(cameras: &[NamedCamera], true_ones: &[(String, Camera)]) -> [f64; 2] {
    let aligned = similarity(cameras, true_ones);
    let extent = scene_extent(true_ones.iter().map(|(_, c)| c.position()).collect::<Vec<_>>().into_iter());
    let pairs = pairs(cameras, true_ones);
    let mean = |of: &dyn Fn(&[Camera; 2]) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
    let angle = |[found, wanted]: &[Camera; 2]| {
        let turn = wanted.camera_from_world.as_dmat3().transpose() * found.camera_from_world.as_dmat3();
        angle_of(&(turn * DMat3::from_quat(aligned.rotation).transpose()))
    };
    let distance = |[found, wanted]: &[Camera; 2]| {
        aligned.apply(found.exact_position()).distance(wanted.exact_position())
    };
    [mean(&angle), mean(&distance) / f64::from(extent)]
}

#[test]
fn poses_of_the_demo_are_found_again() {
    let folder = tempdir().expect("a temporary folder");
    let out = folder.path().join("demo");
    succeed(&["demo", "--out", text(&out), "--dataset-only", "--quiet"]);
    let data = out.join("dataset");
    let [true_ones, moved] = perturb(&data);
    let (off, on) = (folder.path().join("off"), folder.path().join("on"));
    let (_, without) = train(&data, &off, &[]);
    let (stdout, with) = train(&data, &on, &["--pose-opt", "--pose-lr", "1e-3"]);
    let number =
        |entry: &Value, name: &str| entry[name].as_f64().unwrap_or_else(|| panic!("{name}: {entry}"));
    let (psnr, aligned) = (number(&without, "PSNR"), number(&with, "PSNR_aligned"));
    println!("{without}\n{with}");
    assert!(without.get("PSNR_aligned").is_none(), "{without}");
    assert!(aligned > psnr + 3.0, "{psnr} dB without, {aligned} dB with poses");
    assert!(aligned > number(&with, "PSNR") + 2.0, "{with}");
    assert!(number(&with, "SSIM_aligned") > number(&without, "SSIM"), "{with}");

    // The first eighth of the cameras is held out and unchanged; the others have moved to their true positions.
    let cameras = cameras_json::read(on.join("cameras.json"), &WorldFrame::default()).expect("cameras");
    assert_eq!(cameras.len(), 40);
    let given = |name: &str| &moved.iter().find(|(other, _)| other == name).expect("known").1;
    let stayed = |named: &&NamedCamera| {
        let given = given(&named.name);
        let near = given.camera_from_world.abs_diff_eq(named.camera.camera_from_world, 1e-5);
        near && given.translation.abs_diff_eq(named.camera.translation, 1e-5)
    };
    assert_eq!(cameras.iter().filter(stayed).count(), 5);
    let before: Vec<NamedCamera> = (cameras[5..].iter())
        .map(|named| NamedCamera { camera: *given(&named.name), ..named.clone() })
        .collect();
    let [before, after] = [&before[..], &cameras[5..]].map(|cameras| away(cameras, &true_ones));
    println!(
        "degrees and shares of the extent from the true poses, mean: {before:.5?} before, {after:.5?} after"
    );
    // 0.11 of 0.99 degrees and 0.0016 of 0.0097 of the extent remain; about 0.35 and 0.005 with turns about the
    // camera centres. Optimised true poses end equally far away, because these Gaussians fit them better
    // (tools/strategies.md).
    assert!(after[0] < 0.15 * before[0], "{before:?} before, {after:?} after");
    assert!(after[1] < 0.2 * before[1], "{before:?} before, {after:?} after");

    // Printed and written results.
    assert!(stdout.contains("poses turned by "), "{stdout}");
    let poses = json(&on.join("poses.json"));
    let xi = poses["xi"].as_object().expect("poses");
    assert_eq!(xi.len(), 35);
    assert!(xi.values().all(|xi| xi.as_array().is_some_and(|xi| xi.len() == 6)), "{poses}");
    assert!((0.1..5.0).contains(&number(&poses["degrees"], "mean")), "{poses}");
    let report = std::fs::read_to_string(on.join("report.html")).expect("a report");
    assert!(report.contains("poses turned, mean") && report.contains("cameras aligned"));
    assert!(!off.join("poses.json").exists());

    // `eval` of the saved model gives the same numbers.
    let again: Value =
        serde_json::from_str(&succeed(&["eval", text(&on), "--json", "--quiet"])).expect("JSON");
    let difference = number(&again["mean"], "PSNR_aligned") - aligned;
    assert!(difference.abs() < 0.05, "{again}");
    let all: Value =
        serde_json::from_str(&succeed(&["eval", text(&on), "--all", "--json", "--quiet"])).expect("JSON");
    // Training views are at their optimised poses.
    assert!(number(&all["mean"], "PSNR") > number(&with, "PSNR") + 2.0, "{}", all["mean"]);
}

/// With `--train-test-exp` held-out views are trained on, too. Each pose has its view's name, and `eval` uses the
/// training's poses.
#[test]
fn poses_of_halves_stand_under_their_names() {
    let folder = tempdir().expect("a temporary folder");
    let (data, model) = (folder.path().join("data"), folder.path().join("model"));
    write_dataset(&data);
    let paths = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--train-test-exp", "--pose-opt"];
    let few = ["--pose-lr", "1e-3", "--iterations", "40", "--sh-degree", "0", "--eval-share", "0", "--quiet"];
    succeed(&[paths.as_slice(), &few].concat());
    let given = Model::read(&colmap::find(&data).expect("a folder")).expect("a model");
    let poses = json(&model.join("poses.json"));
    let cameras = cameras_json::read(model.join("cameras.json"), &WorldFrame::default()).expect("cameras");
    assert_eq!((poses["xi"].as_object().expect("poses").len(), cameras.len()), (9, 9));
    for named in &cameras {
        let image = given.images.iter().find(|image| image.name == named.name).expect("known");
        let xi: [f64; 6] = serde_json::from_value(poses["xi"][&named.name].clone()).expect("six numbers");
        assert!(xi.iter().any(|&x| x != 0.0), "{}: not moved", named.name);
        let moved = Twist::from_array(xi).applied_to(&given.camera_of(image).expect("a camera"));
        let at = &named.camera;
        let near = moved.camera_from_world.abs_diff_eq(at.camera_from_world, 1e-4);
        assert!(near && moved.translation.abs_diff_eq(at.translation, 1e-4), "{}: {at:?}", named.name);
    }
    let trained = json(&model.join("per_view.json"));
    succeed(&["eval", text(&model), "--quiet"]);
    let again = json(&model.join("per_view.json"));
    let psnr = |results: &Value, view: &str| results["ours_40"]["PSNR"][view].as_f64().expect("a number");
    for view in ["00000.png", "00001.png"] {
        let (trained, again) = (psnr(&trained, view), psnr(&again, view));
        assert!((trained - again).abs() < 0.01, "{view}: {trained} dB in training, {again} dB after it");
    }
}
