//! Damaged, hostile and unusual files: one trial per case of `data/malformed/expected.json`.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use crate::absent_data;
use crate::common::prelude::*;
use ashsplat_files::colmap::Model;
use ashsplat_files::dataset::{Dataset, DatasetOptions, View};
use ashsplat_files::{Progress, splats};
use libtest_mimic::{Failed, Trial};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

/// Far more than any of the small files needs.
const TIMEOUT: Duration = Duration::from_secs(120);

/// Far more than any of the small files needs, and far less than their counts claim.
const MAX_MEMORY_KIB: u64 = 1 << 20;

/// A row of expected.json.
#[derive(serde::Deserialize)]
struct Case {
    path: String,
    what: String,
    verdict: String,
}

pub fn trials(shared: &Path) -> Vec<Trial> {
    let folder = shared.join("data/malformed");
    let Ok(text) = std::fs::read(folder.join("expected.json")) else {
        return vec![absent_data("malformed_absent", format!("no malformed files in {}", folder.display()))];
    };
    let cases: Vec<Case> = serde_json::from_slice(&text).expect("expected.json is a list");
    let trial = |case: Case| {
        let stem = case.path.trim_end_matches('/').trim_end_matches(".ply");
        let name = format!("malformed_{}", stem.replace(['/', '.', '-'], "_"));
        let path = folder.join(&case.path);
        Trial::test(name, move || guarded(path, case))
    };
    cases.into_iter().map(trial).collect()
}

/// Result of loading: a description of the scene, or the error.
type Outcome = Result<String, Error>;

/// Runs a case with a time limit. The rise of this process's peak memory is checked, because other trials that run at the
/// same time hold up to a gigabyte.
fn guarded(path: PathBuf, case: Case) -> Result<(), Failed> {
    let before = peak_memory_kib();
    let (sender, receiver) = mpsc::channel();
    let loaded = path.clone();
    let thread = std::thread::spawn(move || {
        let _ = sender.send(load(&loaded));
    });
    let outcome = match receiver.recv_timeout(TIMEOUT) {
        Ok(outcome) => outcome,
        Err(mpsc::RecvTimeoutError::Timeout) => return Err(format!("hangs: {}", case.what).into()),
        Err(mpsc::RecvTimeoutError::Disconnected) => {
            let panic = thread.join().expect_err("only a panic drops the sender");
            std::panic::resume_unwind(panic)
        }
    };
    let rise = peak_memory_kib().zip(before).map(|(after, before)| after.saturating_sub(before));
    if let Some(kib) = rise.filter(|&kib| kib > MAX_MEMORY_KIB) {
        return Err(format!("took {kib} KiB: {}", case.what).into());
    }
    judge(&path, &case, &outcome).map_err(|e| format!("{e} ({}, {outcome:?})", case.what).into())
}

fn load(path: &Path) -> Outcome {
    if path.is_file() {
        return splats::read(path, &splats::ReadOptions::default())
            .map(|scene| format!("{} Gaussians, {:?}", scene.gaussians.len(), scene.warnings));
    }
    let options = DatasetOptions::default();
    let report = Dataset::inspect(path, &options, Progress::NONE);
    let loaded = Dataset::load(path, &options, Progress::NONE);
    assert_eq!(report.is_sound(), loaded.is_ok(), "load and inspect disagree: {report}");
    // The report notes how photographs of distorting lenses are treated.
    let said: Vec<_> = report.warnings.iter().chain(&report.notes).collect();
    loaded.map(|set| format!("{} views, {} points, {said:?}", set.train.len(), set.points.len()))
}

fn judge(path: &Path, case: &Case, outcome: &Outcome) -> Result<(), String> {
    match (case.verdict.as_str(), outcome) {
        ("accept", Ok(_)) => {
            check(path, case.path.trim_end_matches('/'));
            Ok(())
        }
        ("accept", Err(_)) => Err("must be accepted".into()),
        ("refuse", Ok(_)) => Err("must be refused".into()),
        (_, Err(e)) => check_message(path, &e.to_string()),
        ("either", Ok(text)) if text.ends_with("[]") => Err("accepted without a warning or a note".into()),
        ("either", Ok(_)) => Ok(()),
        (verdict, _) => Err(format!("unknown verdict {verdict}")),
    }?;
    check_refused(path, case.path.trim_end_matches('/'), outcome.as_ref().err());
    Ok(())
}

/// Checks that the message is one line that names the file, or a file of the data set, and has more text.
fn check_message(path: &Path, message: &str) -> Result<(), String> {
    let named = path.to_str().expect("UTF-8").trim_end_matches('/');
    let Some(rest) = message.strip_prefix(named) else {
        return Err("the error does not begin with the file".into());
    };
    let is_empty = rest.split_once(": ").is_none_or(|(_, problem)| problem.len() < 10);
    for (is_wrong, what) in [
        (message.contains('\n'), "the error has several lines"),
        (message.len() > 600, "the error is longer than 600 bytes"),
        (is_empty, "the error says nothing"),
    ] {
        if is_wrong {
            return Err(what.into());
        }
    }
    Ok(())
}

/// Peak memory of this process, if the system reports it. Linux adds up its threads late, so it may fall by a few pages.
fn peak_memory_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_ascii_whitespace().nth(1)?.parse().ok()
}

fn check(path: &Path, case: &str) {
    match case.split_once('/') {
        Some(("ply", name)) => check_gaussians(path, name),
        Some(("splat", "ok_v3_recompressed.spz")) => check_three_points(path),
        Some(("colmap", "ok_jpeg")) => check_counts(path, 3, 20),
        Some(("colmap", name)) => check_generated(path, name),
        Some(("transforms", _)) => check_frames(path),
        Some(("fetched", "tiny_model_3_of_many")) => check_counts(path, 3, 1334),
        Some(("fetched", "two_pinhole_fx_ne_fy")) => check_counts(path, 3, 368),
        _ => panic!("nothing known of {case}"),
    }
}

fn check_refused(path: &Path, case: &str, error: Option<&Error>) {
    let message = error.map(ToString::to_string).unwrap_or_default();
    let says = |words: &str| assert!(message.contains(words), "no '{words}' in: {message}");
    match case {
        "ply/nan_inf.ply" => {
            says("5 of 16");
            says("vertex 0: x = NaN");
            assert_eq!(dropping(path), (11, 5));
        }
        "ply/extreme_values.ply" => {
            says("2 of 16");
            assert_eq!(dropping(path), (14, 2));
        }
        "ply/points_only.ply" => says("point cloud"),
        "ply/empty.ply" => says("empty"),
        "ply/missing_f_rest_7.ply" => says("f_rest_7"),
        "fetched/lfs_pointer_point_cloud.ply" => says("git lfs pull"),
        "splat/bomb_512_mib.spz" => says("more data"),
        "splat/compressed_count_mismatch.compressed.ply" => says("152746 vertex elements need"),
        "splat/nan_inf.splat" => says("Gaussian 0: x = NaN"),
        "colmap/png_wrong_size" => says("is 32x24 pixels, its camera 64x48"),
        "colmap/missing_image_file" => says("c.png"),
        "fetched/per_image_cameras_simple_radial" => {
            let model = Model::of_dataset(path).unwrap();
            assert_eq!((model.cameras.len(), model.images.len(), model.points.len()), (362, 362, 8649));
        }
        _ => {}
    }
}

fn dropping(path: &Path) -> (usize, u64) {
    let options = splats::ReadOptions { drop_invalid: true, ..Default::default() };
    let scene = splats::read(path, &options).unwrap();
    assert!(!scene.warnings.is_empty());
    scene.gaussians.check_shapes().unwrap();
    (scene.gaussians.len(), scene.dropped)
}

/// Values of ok_inria.ply: 16 rows of 62 floats after the header, by position.
fn plain_rows(folder: &Path) -> Vec<[f32; 62]> {
    let bytes = std::fs::read(folder.join("ok_inria.ply")).unwrap();
    let data = &bytes[bytes.len() - 16 * 248..];
    let floats: Vec<f32> = data.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    floats.as_chunks::<62>().0.to_vec()
}

/// Three Gaussians that the same authors stored as PLY, SPZ and .splat: equal within the quantisation.
fn check_three_points(path: &Path) {
    let folder = path.ancestors().nth(3).unwrap().join("trained");
    let read = |path: &Path| splats::read(path, &splats::ReadOptions::default()).unwrap().gaussians;
    let (spz, ply) = (read(path), read(&folder.join("test-splat.3-points-from-train.ply")));
    assert_eq!((spz.len(), spz.sh_degree), (3, 3));
    for index in 0..3 {
        for axis in 0..3 {
            assert!((spz.means[index][axis] - ply.means[index][axis]).abs() < 1e-3);
            assert!((spz.log_scales[index][axis] - ply.log_scales[index][axis]).abs() < 0.04);
        }
        assert!((spz.opacity(index) - ply.opacity(index)).abs() < 0.5 / 255.0 + 1e-5);
        let cosine: f32 = spz.quats[index].iter().zip(ply.quats[index]).map(|(a, b)| a * b).sum();
        let length = ply.quats[index].iter().map(|q| q * q).sum::<f32>().sqrt();
        assert!(cosine.abs() / length > 0.9999);
        for (a, b) in spz.sh_of(index)[1..].as_flattened().iter().zip(ply.sh_of(index)[1..].as_flattened()) {
            assert!((a - b.clamp(-1.0, 1.0)).abs() < 0.07, "{a} {b}");
        }
    }
}

fn check_gaussians(path: &Path, name: &str) {
    let scene = splats::read(path, &splats::ReadOptions::default()).unwrap();
    let told = match name {
        "ok_extra_properties.ply" => "such properties are not used",
        "ok_trailing_bytes.ply" => "37 bytes behind the 16 Gaussians",
        _ => "",
    };
    assert_eq!((scene.dropped, scene.warnings.is_empty()), (0, told.is_empty()));
    assert!(scene.warnings.first().is_none_or(|warning| warning.contains(told)));
    let gaussians = scene.gaussians;
    gaussians.check_shapes().unwrap();
    if name == "zero_vertices.ply" {
        return assert_eq!(gaussians, Gaussians { sh_degree: 3, ..Gaussians::default() });
    }
    let degree = ["ok_sh0.ply", "ok_sh1.ply", "ok_sh2.ply"].iter().position(|&n| n == name).unwrap_or(3);
    assert_eq!(gaussians.sh_degree as usize, degree);
    let higher = (degree + 1).pow(2) - 1;
    let stretch = if name == "ok_unnormalised_quaternions.ply" { 50.0 } else { 1.0 };
    assert_eq!(gaussians.len(), 16);
    for (index, row) in plain_rows(path.parent().unwrap()).iter().enumerate() {
        assert_eq!(gaussians.means[index], row[..3]);
        assert_eq!(gaussians.opacity_logits[index], row[54]);
        assert_eq!(gaussians.log_scales[index], row[55..58]);
        let quat: Vec<f32> = row[58..].iter().map(|q| q * stretch).collect();
        assert_eq!(gaussians.quats[index], quat[..]);
        let sh = gaussians.sh_of(index);
        assert_eq!(sh[0], row[6..9]);
        for (k, coefficient) in sh[1..].iter().enumerate() {
            // Channel-major: all higher coefficients of red, then of green, then of blue.
            assert_eq!(*coefficient, [0, 1, 2].map(|channel| row[9 + channel * higher + k]));
        }
    }
}

fn load_sound(path: &Path) -> Dataset {
    Dataset::load(path, &DatasetOptions::default(), Progress::NONE).unwrap()
}

fn check_counts(path: &Path, views: usize, points: usize) {
    let dataset = load_sound(path);
    assert_eq!((dataset.train.len(), dataset.points.len()), (views, points));
    for View { camera, photo, .. } in &dataset.train {
        camera.check().unwrap();
        assert_eq!((camera.width, camera.height), (photo.width, photo.height));
        let photo = photo.photo().unwrap();
        assert_eq!(photo.rgb.len(), 3 * (photo.width * photo.height) as usize);
        // Real pictures are not uniform.
        assert!(photo.rgb.iter().max() > photo.rgb.iter().min().map(|v| v + 100).as_ref());
    }
}

/// Three pictures of 64×48 with a formula for each pixel.
fn check_generated(path: &Path, name: &str) {
    let dataset = load_sound(path);
    let plain = load_sound(&path.parent().unwrap().join("ok"));
    assert_eq!(dataset.points.positions, plain.points.positions);
    // One case has a different colour at its last point.
    assert_eq!(dataset.points.colors[..19], plain.points.colors[..19]);
    assert_eq!(dataset.points.len(), 20);
    assert!(dataset.test.is_empty());
    assert_eq!(dataset.train.len(), 3);
    for view in &dataset.train {
        let stem = view.name.trim_start_matches("left/");
        let seed = stem.as_bytes()[0] - b'a';
        let same = plain.train.iter().find(|v| v.name == stem).unwrap();
        assert!(view.camera.camera_from_world.abs_diff_eq(same.camera.camera_from_world, 1e-6));
        assert_eq!(view.camera.translation, same.camera.translation);
        assert_eq!(view.camera.intrinsics(), same.camera.intrinsics());
        let ids = if name == "ok_gap_in_ids" { [5, 900, 41] } else { [1, 2, 3] };
        assert_eq!(view.image_id, ids[usize::from(seed)]);
        check_pixels(view, seed, name);
    }
}

/// Three RGBA pictures of 64×48 at a field of view of 0.98, or a focal length of 60.
fn check_frames(path: &Path) {
    let dataset = load_sound(path);
    assert_eq!((dataset.train.len(), dataset.test.len(), dataset.points.len()), (3, 0, 0));
    for (index, view) in dataset.train.iter().enumerate() {
        assert_eq!(view.name, format!("train/r_{index}.png"));
        let angle = 0.2 * [0.0f32, 1.0, -1.0][index];
        let forward = Vec3::new(-angle.sin(), 0.0, -angle.cos());
        assert!(view.camera.forward().abs_diff_eq(forward, 1e-6), "{}", view.camera.forward());
        let eye = Vec3::new(0.5 * index as f32, 0.0, 4.0);
        assert!(view.camera.position().abs_diff_eq(eye, 1e-5));
        // Up is y.
        assert!(view.camera.camera_from_world.row(1).abs_diff_eq(Vec3::NEG_Y, 1e-6));
        let focal = if path.ends_with("ok_nerfstudio") { 60.0 } else { 32.0 / 0.49f32.tan() };
        assert!((view.camera.fx - focal).abs() < 1e-3 && view.camera.fx == view.camera.fy);
        assert_eq!((view.camera.cx, view.camera.cy), (32.0, 24.0));
        assert_eq!((view.photo.width, view.photo.height), (64, 48));
    }
}

fn check_pixels(view: &View, seed: u8, name: &str) {
    let [fx, fy, cx, cy] = [view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy];
    assert_eq!([fx, fy, cx, cy], [60.0, 60.0, 32.0, 24.0]);
    let (width, height) = (view.photo.width, view.photo.height);
    assert_eq!((width, height), (64, 48));
    let grey = name == "ok_png_kinds" && seed == 0;
    let seed = if name == "ok_png_kinds" { 0 } else { u32::from(seed) };
    for (index, &pixel) in view.photo.photo().unwrap().rgb.as_chunks::<3>().0.iter().enumerate() {
        let (x, y) = (index as u32 % width, index as u32 / width);
        let [r, g, b] = [x * 4 + 40 * seed, y * 5, x + y].map(|v| (v % 256) as u8);
        assert_eq!(pixel, if grey { [r; 3] } else { [r, g, b] }, "{} ({x}, {y})", view.name);
    }
}
