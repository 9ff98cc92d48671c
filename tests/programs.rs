//! Programs that may be installed, beside ours: COLMAP's image_undistorter, and ffmpeg for films. Where one is missing, its
//! trial is skipped by name.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;

use ashsplat_files::metrics;
use ashsplat_files::{Dataset, DatasetOptions, Progress};
use libtest_mimic::Trial;
use serde_json::json;

#[path = "cli/run.rs"]
#[allow(dead_code)]
mod run;

use crate::absent;
use crate::common::cinema::{Cinema, film, pixels};
use crate::common::lenses::{cameras, write};
use run::{finish, program};

/// One trial per program.
pub fn trials() -> Vec<Trial> {
    let trial = |name: &str, program: &str, asked: &str, check: fn()| {
        // Whatever it answers, it is there.
        if let Err(error) = Command::new(program).arg(asked).output() {
            return absent(name, format!("{program} is not installed: {error}"));
        }
        Trial::test(name, move || {
            check();
            Ok(())
        })
    };
    vec![
        trial("programs_colmap_undistorts_the_same", "colmap", "help", colmap_undistorts_the_same),
        trial("programs_ffmpeg_makes_films", "ffmpeg", "-version", ffmpeg_makes_films),
        trial("programs_ffmpeg_makes_rendered_films", "ffmpeg", "-version", ffmpeg_makes_rendered_films),
    ]
}

/// COLMAP's image_undistorter makes the same cameras and the same pictures.
fn colmap_undistorts_the_same() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let path = |name: &str| folder.path().join(name);
    let run = Command::new("colmap")
        .env("QT_QPA_PLATFORM", "offscreen")
        .args(["image_undistorter", "--image_path"])
        .arg(path("images"))
        .arg("--input_path")
        .arg(path("sparse/0"))
        .arg("--output_path")
        .arg(path("theirs"))
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let ours = Dataset::load(folder.path(), &DatasetOptions::default(), Progress::NONE).unwrap();
    let theirs = Dataset::load(path("theirs"), &DatasetOptions::default(), Progress::NONE).unwrap();
    assert_eq!(ours.warnings.len(), cameras().len());
    assert_eq!(ours.train.len(), theirs.train.len());
    for (a, b) in ours.train.iter().zip(&theirs.train) {
        let (i, j) = (a.camera.intrinsics(), b.camera.intrinsics());
        assert_eq!((&a.name, i.width, i.height), (&b.name, j.width, j.height));
        for (x, y) in [(i.fx, j.fx), (i.fy, j.fy), (i.cx, j.cx), (i.cy, j.cy)] {
            assert!((x - y).abs() < 1e-3, "{i:?} {j:?}");
        }
        let psnr =
            metrics::psnr(&a.photo.photo().unwrap().to_f32(), &b.photo.photo().unwrap().to_f32()).unwrap();
        assert!(psnr > 45.0, "{}: {psnr} dB", a.name);
    }
}

/// Sides that are odd and colours that ffmpeg must not shift.
fn ffmpeg_makes_films() {
    let cinema = Cinema::open();
    let mut page = cinema.server.page();
    let mut request = film(5, [161, 121]);
    request["look"] = json!({ "background": [0.9, 0.2, 0.1] });
    page.send(&request);
    let files = page.hears("files");
    let name = files["mp4"].as_str().unwrap_or_else(|| panic!("{files}"));
    let (code, head, bytes) = cinema.server.get(&format!("/film/{name}"), &[]);
    assert!(code == 200 && head.contains("video/mp4"), "{head}");
    let path = cinema.films().join(name);
    assert_eq!(std::fs::read(&path).expect("a file"), bytes);
    // As players see it: the tags say how its colours are meant.
    let decode = ["-f", "rawvideo", "-vf", "scale=in_color_matrix=auto", "-pix_fmt", "rgb24", "-"];
    let decoded = Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(&path).args(decode).output();
    let decoded = decoded.expect("ffmpeg");
    assert!(decoded.status.success(), "{}", String::from_utf8_lossy(&decoded.stderr));
    let (width, height) = (162, 122);
    assert_eq!(decoded.stdout.len(), 5 * width * height * 3);
    let frames = Path::new(files["frames"].as_str().expect("a folder"));
    for (index, shown) in (0..).zip(decoded.stdout.chunks_exact(width * height * 3)) {
        let frame = pixels(frames, index);
        let rows = frame.chunks_exact(161 * 3).zip(shown.chunks_exact(width * 3));
        let errors: Vec<f64> =
            rows.flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)))).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean < 4.0, "frame {index}: {mean}");
    }
    // Nothing half-done beside it.
    assert_eq!(cinema.files(), ["film_001", "film_001.gif", "film_001.json", "film_001.mp4"]);
}

/// `render --out film.mp4`, and WebM.
fn ffmpeg_makes_rendered_films() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let ply = folder.path().join("scene.ply");
    let points = ashsplat::scene::PointCloud {
        positions: (0..50)
            .map(|i| [(0.3 * i as f32).sin(), 0.02 * i as f32, (0.7 * i as f32).cos()])
            .collect(),
        colors: vec![[230, 77, 26]; 50],
    };
    let gaussians = ashsplat_files::initial_gaussians(&points, 0).expect("Gaussians");
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    let render = |out: &Path, more: &[&str]| {
        let paths = ["render", ply.to_str().expect("a path"), "-o", out.to_str().expect("a path")];
        let arguments =
            [paths.as_slice(), &["--orbit", "7", "--width", "97", "--height", "53"], more].concat();
        let run = finish(program().args(arguments));
        assert_eq!(run.code, Some(0), "{}", run.stderr);
    };
    render(&folder.path().join("frames"), &[]);
    for (name, format) in [("film.mp4", "mov,mp4"), ("film.webm", "matroska,webm")] {
        let path = folder.path().join("films").join(name);
        render(&path, &["--fps", "12"]);
        let probe = Command::new("ffmpeg").args(["-hide_banner", "-i"]).arg(&path).output().expect("ffmpeg");
        let said = String::from_utf8_lossy(&probe.stderr).into_owned();
        assert!(said.contains(format) && said.contains("98x54") && said.contains("12 fps"), "{said}");
        let decode = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"];
        let decoded = Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(&path).args(decode).output();
        let decoded = decoded.expect("ffmpeg").stdout;
        assert_eq!(decoded.len(), 7 * 98 * 54 * 3, "{name}");
        for (index, shown) in (0..).zip(decoded.chunks_exact(98 * 54 * 3)) {
            let frame = pixels(&folder.path().join("frames"), index);
            let mean = |bytes: &[u8]| bytes.iter().map(|&b| f64::from(b)).sum::<f64>() / (97.0 * 53.0 * 3.0);
            assert!((mean(&frame) - mean(shown)).abs() < 4.0, "{name}, frame {index}");
        }
        assert_eq!(std::fs::read_dir(path.parent().expect("a folder")).expect("films").count(), 1);
        std::fs::remove_file(path).expect("removed");
    }
}
