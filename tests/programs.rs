//! Comparisons with optional programs: COLMAP, for lenses and cameras, and ffmpeg, for films and videos. The trial
//! of a missing program is listed as skipped.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use ashsplat_files::metrics;
use ashsplat_files::{Dataset, DatasetOptions, Progress};
use libtest_mimic::Trial;
use serde_json::json;
use std::path::Path;
use std::process::Command;

#[path = "cli/run.rs"]
#[allow(dead_code)]
mod run;

use crate::absent;
use crate::common::lenses::write;
use crate::common::splats::write_points;
use crate::common::{assert_says, corner};
use crate::program::cinema::{Cinema, film, pixels};
use run::{finish, program};

pub fn trials() -> Vec<Trial> {
    // Any answer shows that a program is installed.
    let tried = |program: &str, argument: &str| Command::new(program).arg(argument).output();
    let trial = |name: &str, programs: &[(&str, &str)], check: fn()| {
        for &(program, argument) in programs {
            if let Err(error) = tried(program, argument) {
                return absent(name, format!("{program} is not installed: {error}"));
            }
        }
        Trial::test(name, move || {
            check();
            Ok(())
        })
    };
    let [colmap, ffmpeg] = [("colmap", "help"), ("ffmpeg", "-version")];
    vec![
        trial("programs_colmap_undistorts_the_same", &[colmap], colmap_undistorts_the_same),
        trial("programs_colmap_finds_poses", &[colmap], colmap_finds_poses),
        trial("programs_colmap_finds_poses_of_a_video", &[ffmpeg, colmap], colmap_finds_poses_of_a_video),
        trial("programs_ffmpeg_makes_films", &[ffmpeg], ffmpeg_makes_films),
        trial("programs_ffmpeg_makes_rendered_films", &[ffmpeg], ffmpeg_makes_rendered_films),
    ]
}

/// COLMAP's image_undistorter gives the same cameras and pictures.
fn colmap_undistorts_the_same() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let path = |name: &str| folder.path().join(name);
    let mut colmap = Command::new("colmap");
    colmap
        .env("QT_QPA_PLATFORM", "offscreen")
        .args(["image_undistorter", "--image_path"])
        .arg(path("images"));
    colmap.arg("--input_path").arg(path("sparse/0")).arg("--output_path").arg(path("theirs"));
    let run = colmap.output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let undistorted = DatasetOptions { undistort: true, ..Default::default() };
    let ours = Dataset::load(folder.path(), &undistorted, Progress::NONE).unwrap();
    let theirs = Dataset::load(path("theirs"), &DatasetOptions::default(), Progress::NONE).unwrap();
    // There are no warnings.
    assert!(ours.warnings.is_empty(), "{:?}", ours.warnings);
    assert_eq!(ours.train.len(), theirs.train.len());
    for (a, b) in ours.train.iter().zip(&theirs.train) {
        let (i, j) = (a.camera.intrinsics(), b.camera.intrinsics());
        assert_eq!((&a.name, i.width, i.height), (&b.name, j.width, j.height));
        for (x, y) in [(i.fx, j.fx), (i.fy, j.fy), (i.cx, j.cx), (i.cy, j.cy)] {
            assert!((x - y).abs() < 1e-3, "{i:?} {j:?}");
        }
        let [ours, theirs] = [a, b].map(|view| view.photo.photo().unwrap().to_f32());
        let psnr = metrics::psnr(&ours, &theirs, None).unwrap();
        assert!(psnr > 45.0, "{}: {psnr} dB", a.name);
    }
}

fn succeed(command: &mut Command) -> String {
    let run = finish(command);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    run.stdout
}

/// Runs `ashsplat poses` and loads its data set. Returns its output and the data set.
fn poses(folder: &Path, arguments: &[&str], dataset: &str) -> (String, Dataset) {
    let said = succeed(program().current_dir(folder).arg("poses").args(arguments));
    let options = DatasetOptions::default();
    let report = Dataset::inspect(folder.join(dataset), &options, Progress::NONE);
    assert!(report.is_sound() && report.points > 300, "{report}");
    (said, Dataset::load(folder.join(dataset), &options, Progress::NONE).unwrap())
}

/// Fails unless positions equal the true ones up to a similarity: all distances have the same ratio.
fn assert_placed(dataset: &Dataset, truth: impl Fn(&str) -> f32) {
    let views = dataset.views();
    let place = |view: &ashsplat_files::View| corner::camera(truth(&view.name)).position();
    let first = views[0];
    let ratio = |view: &&ashsplat_files::View| {
        view.camera.position().distance(first.camera.position()) / place(view).distance(place(first))
    };
    let ratios: Vec<f32> = views[views.len() / 2..].iter().map(ratio).collect();
    let mean = ratios.iter().sum::<f32>() / ratios.len() as f32;
    assert!(ratios.iter().all(|ratio| (ratio / mean - 1.0).abs() < 0.03), "{ratios:?}");
}

fn number(name: &str) -> f32 {
    name.chars().filter(char::is_ascii_digit).collect::<String>().parse().unwrap()
}

/// Eleven photographs in a flat folder, stored sideways with orientation metadata, as phones store them. Neither COLMAP nor
/// ashsplat turns them.
fn colmap_finds_poses() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("my photos")).unwrap();
    for index in 0..11 {
        let photo = corner::photograph(&corner::camera(index as f32 / 10.0));
        let upright = image::RgbImage::from_raw(photo.width, photo.height, photo.rgb).unwrap();
        let stored = image::imageops::rotate270(&upright);
        let mut bytes = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(&stored).unwrap();
        let exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        let length = (exif.len() as u16 + 2).to_be_bytes();
        let file = [&bytes[..2], &[0xff, 0xe1], &length, exif, &bytes[2..]].concat();
        std::fs::write(folder.path().join("my photos").join(format!("IMG_{index:02}.JPG")), file).unwrap();
    }
    let (said, dataset) = poses(folder.path(), &["my photos"], "my photos_dataset");
    assert!(said.contains("11 of 11 photographs"), "{said}");
    let [width, height] = corner::SIZE;
    let camera = dataset.train[0].original_camera;
    // Undistortion removes some pixels.
    assert!(camera.width.abs_diff(height) < 9 && camera.height.abs_diff(width) < 9, "{camera:?}");
    assert_placed(&dataset, |name| number(name) / 10.0);
    let model = ["train", "-s", "my photos_dataset", "-m", "out", "--iterations", "20", "--quiet"];
    succeed(program().current_dir(folder.path()).args(model));
}

/// A video with every fourth frame sharp.
fn colmap_finds_poses_of_a_video() {
    let folder = tempfile::tempdir().unwrap();
    let mut raw = Vec::new();
    for index in 0..48 {
        let photo = corner::photograph(&corner::camera(index as f32 / 47.0));
        let picture = image::RgbImage::from_raw(photo.width, photo.height, photo.rgb).unwrap();
        let sharp = index % 4 == 2;
        raw.extend(if sharp { picture } else { image::imageops::fast_blur(&picture, 4.0) }.into_raw());
    }
    std::fs::write(folder.path().join("raw"), raw).unwrap();
    let [width, height] = corner::SIZE;
    let made = Command::new("ffmpeg")
        .current_dir(folder.path())
        .args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-framerate", "24", "-video_size"])
        .args([&format!("{width}x{height}"), "-i", "raw", "-c:v", "mpeg4", "-q:v", "1", "walk.mp4"])
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let (said, dataset) = poses(folder.path(), &["walk.mp4", "--frames", "12"], "walk_dataset");
    assert!(said.contains("12 of 12 frames"), "{said}");
    assert_placed(&dataset, |name| (4.0 * (number(name) - 1.0) + 2.0) / 47.0);
}

fn decoded(film: &Path, options: &[&str]) -> Vec<u8> {
    let run = Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(film).args(options).output();
    let run = run.expect("ffmpeg");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    run.stdout
}

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
    // Decoded as players do: the tags define the colours.
    let decode = ["-f", "rawvideo", "-vf", "scale=in_color_matrix=auto", "-pix_fmt", "rgb24", "-"];
    let decoded = decoded(&path, &decode);
    let (width, height) = (162, 122);
    assert_eq!(decoded.len(), 5 * width * height * 3);
    let frames = Path::new(files["frames"].as_str().expect("a folder"));
    for (index, shown) in (0..).zip(decoded.chunks_exact(width * height * 3)) {
        let frame = pixels(frames, index);
        let rows = frame.chunks_exact(161 * 3).zip(shown.chunks_exact(width * 3));
        let errors = rows.flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))));
        let mean = errors.sum::<f64>() / frame.len() as f64;
        assert!(mean < 4.0, "frame {index}: {mean}");
    }
    // No temporary files remain.
    assert_eq!(cinema.files(), ["film_001", "film_001.gif", "film_001.json", "film_001.mp4"]);
}

/// `render --out film.mp4`, and WebM.
fn ffmpeg_makes_rendered_films() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let ply = folder.path().join("scene.ply");
    let point = |i| [(0.3 * i as f32).sin(), 0.02 * i as f32, (0.7 * i as f32).cos()];
    write_points(&ply, (0..50).map(point).collect(), 0);
    let render = |out: &Path, more: &[&str]| {
        let paths = ["render", ply.to_str().expect("a path"), "-o", out.to_str().expect("a path")];
        let arguments =
            [paths.as_slice(), &["--orbit", "7", "--width", "97", "--height", "53"], more].concat();
        succeed(program().args(arguments));
    };
    render(&folder.path().join("frames"), &[]);
    for (name, format) in [("film.mp4", "mov,mp4"), ("film.webm", "matroska,webm")] {
        let path = folder.path().join("films").join(name);
        render(&path, &["--fps", "12"]);
        let probe = Command::new("ffmpeg").args(["-hide_banner", "-i"]).arg(&path).output().expect("ffmpeg");
        let said = String::from_utf8_lossy(&probe.stderr).into_owned();
        assert_says(&said, &[format, "98x54", "12 fps"]);
        let decode = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"];
        let decoded = decoded(&path, &decode);
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
