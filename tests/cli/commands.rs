//! Commands that need no training.

use super::*;
use ashsplat::scene::WorldFrame;
use serde_json::Value;
use std::fs::File;
use std::io::BufReader;
use tempfile::tempdir;

#[test]
fn help_names_every_command() {
    let help = succeed(&["--help"]);
    for command in [
        "train",
        "poses",
        "render",
        "eval",
        "info",
        "convert",
        "inspect",
        "devices",
        "demo",
        "bench",
        "profile",
        "partition",
        "exchange",
        "merge",
    ] {
        assert!(help.contains(command), "{help}");
        assert!(succeed(&[command, "--help"]).contains("Usage: ashsplat"), "{command}");
    }
}

#[test]
fn what_a_host_has_to_enable_is_printed() {
    let list = succeed(&["devices", "--requirements"]);
    for part in ["Vulkan               1.3", "maintenance4", "optional", "VK_KHR_push_descriptor"] {
        assert!(list.contains(part), "{part} is missing:\n{list}");
    }
}

#[test]
fn devices_are_listed_with_their_limits() {
    let list = succeed(&["devices"]);
    assert!(list.starts_with("0: "), "{list}");
    for word in ["subgroups", "shared memory", "per allocation", "usable"] {
        assert!(list.contains(word), "no '{word}' in {list}");
    }
}

#[test]
fn info_of_a_data_set() {
    let folder = tempdir().expect("a temporary folder");
    write_dataset(folder.path());
    let report: Value =
        serde_json::from_str(&succeed(&["info", text(folder.path()), "--eval", "--json"])).expect("JSON");
    assert_eq!(report["images"], 9);
    assert_eq!(report["sound_photos"], 9);
    assert_eq!((&report["train_views"], &report["test_views"]), (&Value::from(7), &Value::from(2)));
    assert_eq!(report["points"], 400);
    assert_eq!(report["cameras"]["PINHOLE 48x32"], 1);
}

#[test]
fn info_of_a_ply() {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ply");
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 2).expect("Gaussians");
    ashsplat_files::ply::write(&path, &gaussians).expect("written");
    let report: Value = serde_json::from_str(&succeed(&["info", text(&path), "--json"])).expect("JSON");
    assert_eq!((&report["gaussians"], &report["sh_degree"]), (&Value::from(400), &Value::from(2)));
    // All Gaussians start at opacity 0.1.
    let counts: Vec<u64> = serde_json::from_value(report["opacity"]["counts"].clone()).expect("counts");
    assert_eq!(counts.iter().sum::<u64>(), 400);
    assert_eq!(counts[0] + counts[1], 400);
    let table = succeed(&["info", text(&path)]);
    assert!(table.contains("Gaussians  400") && table.contains("largest scale"), "{table}");
}

#[test]
fn camera_path_is_rendered_to_png_and_exr() {
    let folder = tempdir().expect("a temporary folder");
    let (ply, path, out) =
        (folder.path().join("scene.ply"), folder.path().join("path.json"), folder.path().join("out"));
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    gaussians.opacity_logits.fill(4.0);
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    // No cx and cy, as in the reference's files; looks along +z from in front of the wall.
    let camera = r#"[{"id": 0, "img_name": "front", "width": 64, "height": 48, "position": [0, 0, -2],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 60, "fy": 60}]"#;
    std::fs::write(&path, camera).expect("written");
    let said = succeed(&["render", text(&ply), "--path", text(&path), "--format", "both", "-o", text(&out)]);
    assert!(said.contains("front 64x48") && said.contains(" ms"), "{said}");
    assert_eq!(files_below(&out), ["00000.exr", "00000.png"].map(PathBuf::from));
    compare_exr_with_png(&out);
}

/// Without a background, colours are those of the covering Gaussians: straight in a PNG, premultiplied and linear in
/// an EXR.
#[test]
fn pictures_without_background_have_the_colours_of_what_covers() {
    use exr::prelude::*;
    let folder = tempdir().expect("a temporary folder");
    let (ply, path, out) =
        (folder.path().join("scene.ply"), folder.path().join("path.json"), folder.path().join("out"));
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    gaussians.opacity_logits.fill(-1.5);
    // A uniform grey of 128, whatever the coverage.
    gaussians.sh.fill([(128.0 / 255.0 - 0.5) / 0.282_094_8; 3]);
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    let camera = r#"[{"id": 0, "img_name": "front", "width": 64, "height": 48, "position": [0, 0, -2],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 60, "fy": 60}]"#;
    std::fs::write(&path, camera).expect("written");
    let views = ["render", text(&ply), "--path", text(&path), "--transparent", "-o"];
    succeed(&[&views[..], &[text(&out), "--format", "both"]].concat());
    let picture = image::open(out.join("00000.png")).expect("a PNG");
    let image = read_first_flat_layer_from_file(out.join("00000.exr")).expect("an EXR");
    let values = |name: &str| -> Vec<f32> {
        let channel = image.layer_data.channel_data.list.iter().find(|channel| channel.name.eq(name));
        channel.expect(name).sample_data.values_as_f32().collect()
    };
    let (green, alpha) = (values("G"), values("A"));
    let grey = ((128.0_f32 / 255.0 + 0.055) / 1.055).powf(2.4);
    let mut partly = 0;
    for (index, pixel) in picture.as_rgba8().expect("with opacity").pixels().enumerate() {
        assert!((alpha[index] * 255.0 - f32::from(pixel[3])).abs() < 0.51, "pixel {index}");
        if alpha[index] == 0.0 {
            assert_eq!((pixel.0, green[index]), ([0; 4], 0.0));
            continue;
        }
        assert!(pixel[1].abs_diff(128) <= 1, "pixel {index}: {:?}", pixel.0);
        assert!((green[index] - alpha[index] * grey).abs() < 2e-4, "pixel {index}: {}", green[index]);
        partly += usize::from((0.1..0.9).contains(&alpha[index]));
    }
    assert!(partly > 100, "{partly} pixels are partly covered");
    refuse(
        &[&views[..], &[text(&out), "--background", "1,1,1"]].concat(),
        &["--transparent", "--background"],
    );
    refuse(&[&views[..], &[text(&folder.path().join("a.gif"))]].concat(), &["--transparent", "no opacity"]);
}

/// The EXR's colour equals the PNG's without the sRGB curve; the wall's depth is 2.
fn compare_exr_with_png(folder: &Path) {
    use exr::prelude::*;
    let picture = image::open(folder.join("00000.png")).expect("a PNG").to_rgb8();
    // Otherwise tiles are stored in the order in which threads finish: the same picture, but not the same bytes.
    let header = MetaData::read_from_file(folder.join("00000.exr"), true).expect("an EXR").headers.remove(0);
    assert_eq!(header.line_order, LineOrder::Increasing);
    let image = read_first_flat_layer_from_file(folder.join("00000.exr")).expect("an EXR");
    let channels = &image.layer_data.channel_data.list;
    let values = |name: &str| -> Vec<f32> {
        let channel = channels.iter().find(|channel| channel.name.eq(name)).expect(name);
        channel.sample_data.values_as_f32().collect()
    };
    let (red, alpha, depth) = (values("R"), values("A"), values("Z"));
    assert_eq!(red.len(), 64 * 48);
    for (index, pixel) in picture.pixels().enumerate() {
        let linear = red[index].clamp(0.0, 1.0);
        let srgb =
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
        assert!((srgb * 255.0 - f32::from(pixel[0])).abs() < 0.51, "pixel {index}");
    }
    let middle = 24 * 64 + 32;
    assert!(alpha[middle] > 0.9, "alpha {}", alpha[middle]);
    assert!((depth[middle] - 2.0).abs() < 0.01, "depth {}", depth[middle]);
}

/// A ball stays round in pictures of any shape, and on a curve through cameras of several shapes.
#[test]
fn pictures_of_another_shape_show_more_and_stretch_nothing() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    write_gaussians(&at("ball.ply"), &[([0.0, 0.0, 4.0], 5.0, 0.3)]);
    let camera = |name: &str, [w, h]: [u32; 2]| {
        format!(
            r#"{{"id": 0, "img_name": "{name}", "width": {w}, "height": {h}, "position": [0, 0, 0],
            "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 150, "fy": 150}}"#
        )
    };
    std::fs::write(at("one.json"), format!("[{}]", camera("a", [160, 120]))).expect("written");
    let two = [camera("a", [160, 120]), camera("b", [120, 160])].join(",");
    std::fs::write(at("two.json"), format!("[{two}]")).expect("written");
    // Standard deviations of the brightness in x and y, pixels.
    let spread = |picture: &Path| {
        let picture = image::open(picture).expect("a PNG").to_luma8();
        let mut sums = [0.0; 5];
        for (x, y, pixel) in picture.enumerate_pixels() {
            let (x, y, light) = (f64::from(x), f64::from(y), f64::from(pixel[0]));
            let terms = [light, light * x, light * y, light * x * x, light * y * y];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        let [light, x, y, xx, yy] = sums;
        let size = picture.dimensions();
        ([(xx / light - (x / light).powi(2)).sqrt(), (yy / light - (y / light).powi(2)).sqrt()], size)
    };
    let drawn = |options: &[&str]| {
        let (ply, out) = (at("ball.ply"), at("out.png"));
        let said = succeed(&[&["render", text(&ply), "-o", text(&out)][..], options].concat());
        let ([x, y], size) = spread(&out);
        assert!((x / y - 1.0).abs() < 0.03, "{options:?}: {x} {y}");
        (x, size, said)
    };
    let one = at("one.json");
    let path = ["--path", text(&one)];
    let (own, _, said) = drawn(&path);
    assert!(!said.contains("shows more"), "{said}");
    for (options, size, scale, words) in [
        (
            &["--width", "320", "--height", "120"][..],
            (320, 120),
            1.0,
            "320x120 shows more at the left and right",
        ),
        (&["--width", "120", "--height", "240"], (120, 240), 0.75, "120x240 shows more above and below"),
        (&["--width", "80"], (80, 60), 0.5, ""),
        (&["--height", "61"], (81, 61), 0.507, ""),
        (&["--width", "320", "--height", "120", "--fov", "90"], (320, 120), 160.0 / 150.0, ""),
    ] {
        let (x, drawn, said) = drawn(&[&path[..], options].concat());
        assert_eq!(drawn, size, "{options:?}");
        assert!((x / own / scale - 1.0).abs() < 0.1, "{options:?}: {x} for {own}");
        assert_eq!(said.matches("shows more").count(), usize::from(!words.is_empty()), "{said}");
        assert!(said.contains(words), "{said}");
    }
    let (two, ply, out) = (at("two.json"), at("ball.ply"), at("curve"));
    succeed(&["render", text(&ply), "--path", text(&two), "--frames", "3", "-o", text(&out), "--quiet"]);
    for picture in files_below(&out) {
        let ([x, y], size) = spread(&out.join(&picture));
        assert!(size == (160, 120) && (x / y - 1.0).abs() < 0.03, "{}: {x} {y}", picture.display());
    }
}

/// Cameras that look elsewhere give black pictures: a warning says so, in `eval` too.
#[test]
fn pictures_that_show_nothing_are_told() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let (ply, data, out) = (at("ball.ply"), at("data"), at("out"));
    write_dataset(&data);
    for (z, told) in [(0.0, 0), (-90.0, 1)] {
        write_gaussians(&ply, &[([0.0, 0.0, z], 5.0, 0.3)]);
        for command in [&["render", text(&ply), "-o", text(&out)][..], &["eval", text(&ply)]] {
            let run = finish(program().args(command).args(["-s", text(&data), "--quiet"]));
            assert_eq!(run.code, Some(0), "{}", run.stderr);
            let line =
                "warning: no picture shows a Gaussian: do scene and cameras have the same coordinates?";
            assert_eq!(run.stderr.matches(line).count(), told, "{command:?}: {}", run.stderr);
        }
    }
}

/// A sixth of the Gaussians is far away, like floaters or a sky: an orbit shows the others.
#[test]
fn an_orbit_does_not_go_by_far_gaussians() {
    let folder = tempdir().expect("a temporary folder");
    let (ply, out) = (folder.path().join("scene.ply"), folder.path().join("out.png"));
    let lit = |far: f32| {
        let ball = |i: u32| {
            let place = vec3((i % 6) as f32, (i / 6 % 6) as f32, (i / 36) as f32) - 2.5;
            let far = if i.is_multiple_of(6) { far } else { 0.0 };
            ([place.x + far, place.y, place.z], 5.0, 0.3)
        };
        write_gaussians(&ply, &(0..216).map(ball).collect::<Vec<_>>());
        succeed(&["render", text(&ply), "--orbit", "1", "--width", "96", "-o", text(&out), "--quiet"]);
        let picture = image::open(&out).expect("a PNG").to_luma8();
        picture.pixels().filter(|pixel| pixel[0] > 40).count()
    };
    let whole = lit(0.0);
    assert!(lit(800.0) > whole / 2, "{} of {whole} pixels", lit(800.0));
}

/// One pixel in front of two Gaussians, at 2 (opacity 0.5) and 10 (0.99).
#[test]
fn an_exrs_depth_is_the_mean_or_the_harmonic_mean() {
    use exr::prelude::*;
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    write_gaussians(&at("two.ply"), &[([0.0, 0.0, 2.0], 0.0, 0.5), ([0.0, 0.0, 10.0], 9.0, 0.5)]);
    let camera = r#"[{"id": 0, "img_name": "a", "width": 33, "height": 33, "position": [0, 0, 0],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 40, "fy": 40}]"#;
    std::fs::write(at("path.json"), camera).expect("written");
    let (ply, path, exr, png) = (at("two.ply"), at("path.json"), at("a.exr"), at("a.png"));
    let render = ["render", text(&ply), "--path", text(&path), "--quiet", "-o"];
    let depth = |options: &[&str]| {
        succeed(&[&render[..], &[text(&exr)], options].concat());
        let image = read_first_flat_layer_from_file(&exr).expect("an EXR");
        let z = image.layer_data.channel_data.list.iter().find(|channel| channel.name.eq("Z")).expect("Z");
        let values: Vec<f32> = z.sample_data.values_as_f32().collect();
        values[16 * 33 + 16]
    };
    let [near, far] = [0.5, 0.5 * 0.99];
    let mean = (near * 2.0 + far * 10.0) / (near + far);
    let harmonic = (near + far) / (near / 2.0 + far / 10.0);
    assert!((depth(&[]) - mean).abs() < 0.01, "{}", depth(&[]));
    assert!((depth(&["--depth", "mean"]) - mean).abs() < 0.01);
    assert!((depth(&["--depth", "harmonic"]) - harmonic).abs() < 0.01);
    refuse(&[&render[..], &[text(&png), "--depth", "mean"]].concat(), &["--depth", "EXR"]);
}

/// Writes white balls: position, opacity logit, standard deviation.
fn write_gaussians(path: &Path, balls: &[([f32; 3], f32, f32)]) {
    let mut gaussians = ashsplat::scene::Gaussians { sh_degree: 0, ..Default::default() };
    for &(mean, logit, deviation) in balls {
        gaussians.means.push(mean);
        gaussians.log_scales.push([deviation.ln(); 3]);
        gaussians.quats.push([1.0, 0.0, 0.0, 0.0]);
        gaussians.opacity_logits.push(logit);
        gaussians.sh.push([0.5 / 0.282_094_8; 3]);
    }
    ashsplat_files::ply::write(path, &gaussians).expect("written");
}

#[test]
fn views_that_cannot_be_meant_are_refused() {
    let folder = tempdir().expect("a temporary folder");
    let ply = folder.path().join("scene.ply");
    write_gaussians(&ply, &[([0.0, 0.0, 4.0], 5.0, 0.3)]);
    for (option, values) in [
        ("--up", &["0,0,0", "nan,0,1", "1,2"][..]),
        ("--fov", &["0", "180", "-60", "nan", "1e30"]),
        ("--width", &["0", "70000", "-5"]),
        ("--height", &["0"]),
        ("--background", &["-1,0,0", "0,0,1e30"]),
        ("--kernel-size", &["nan", "0", "1e30"]),
    ] {
        for value in values {
            let run =
                finish(program().args(["render", text(&ply), "--orbit", "1", &format!("{option}={value}")]));
            assert!(
                run.code == Some(2) && run.stderr.lines().count() == 1,
                "{option} {value}: {}",
                run.stderr
            );
        }
    }
}

#[test]
fn orbit_of_a_bare_ply_shows_the_scene() {
    let folder = tempdir().expect("a temporary folder");
    let (ply, out) = (folder.path().join("scene.ply"), folder.path().join("out"));
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    gaussians.opacity_logits.fill(4.0);
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    refuse(&["render", text(&ply), "-o", text(&out)], &["scene.ply", "--orbit"]);
    let size = ["--width", "40", "--height", "30"];
    succeed(&[["render", text(&ply), "--orbit", "4", "-o", text(&out)].as_slice(), &size].concat());
    assert_eq!(files_below(&out).len(), 4);
    let brightest = |index: usize| {
        let path = out.join(format!("{index:05}.png"));
        image::open(path).expect("a PNG").to_luma8().pixels().map(|pixel| pixel[0]).max()
    };
    assert!((0..4).all(|index| brightest(index) > Some(60)));
}

#[test]
fn films_are_files_and_never_folders() {
    let folder = tempdir().expect("a temporary folder");
    let ply = folder.path().join("scene.ply");
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    let film = |name: &str| folder.path().join("films").join(name);
    let small = ["--width", "40", "--orbit", "3", "--out"];
    let gif = film("film.gif");
    succeed(&[["render", text(&ply)].as_slice(), &small, &[text(&gif)]].concat());
    let decoder = image::codecs::gif::GifDecoder::new(BufReader::new(File::open(&gif).expect("a film")));
    let frames =
        image::AnimationDecoder::into_frames(decoder.expect("a GIF")).collect_frames().expect("frames");
    let sizes: Vec<(u32, u32)> = frames.iter().map(|frame| frame.buffer().dimensions()).collect();
    assert_eq!(sizes, [(40, 22); 3]);
    assert_eq!(files_below(&film("")), [PathBuf::from("film.gif")]);
    for (name, words) in
        [("a.mov", [".mp4", "a.mov"]), ("b.mp4", ["ffmpeg", ".gif"]), ("c.webm", ["ffmpeg", ".gif"])]
    {
        let path = film(name);
        let arguments = [["render", text(&ply)].as_slice(), &small, &[text(&path)]].concat();
        // Without ffmpeg anywhere.
        assert_refused(&finish(program().args(arguments).env("PATH", "")), &words);
        assert!(!path.exists(), "{name}");
    }
    let exr = [["render", text(&ply), "--format", "exr"].as_slice(), &small, &[text(&gif)]].concat();
    refuse(&exr, &["--format", "8 bits"]);
    // A single picture can be a file, too.
    let one = ["render", text(&ply), "--width", "40", "--orbit", "1", "--out"];
    for name in ["one.png", "one.exr"] {
        succeed(&[one.as_slice(), &[text(&film(name))]].concat());
        assert!(film(name).is_file());
    }
    assert_eq!(image::open(film("one.png")).expect("a PNG").width(), 40);
    let named = |name: &str, words: &[&str]| {
        refuse(&[["render", text(&ply)].as_slice(), &small, &[text(&film(name))]].concat(), words);
        assert!(!film(name).exists(), "{name}");
    };
    named("several.png", &["several.png", "3 views", "folder", ".mp4"]);
    named("one.jpg", &["one.jpg", ".png or .exr"]);
    for (format, name) in [("png", "other.exr"), ("exr", "other.png"), ("both", "other.png")] {
        refuse(
            &[one.as_slice(), &[text(&film(name)), "--format", format]].concat(),
            &["--format", "name a folder"],
        );
        assert!(!film(name).exists(), "{format} {name}");
    }
    refuse(&["render", text(&ply), "--frames", "12"], &["--frames", "--path", "`--orbit 12`"]);
}

/// Training lists the held-out cameras first, but a curve visits the photographs in order. A path that a user wrote
/// keeps its order.
#[test]
fn a_models_cameras_are_a_path_by_name() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    let ply = at("model/point_cloud/iteration_1/point_cloud.ply");
    std::fs::create_dir_all(ply.parent().expect("a folder")).expect("created");
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    let path = |names: [u32; 3]| {
        let camera = |n: u32| {
            let x = f64::from(n) * 0.05;
            format!(
                r#"{{"id": {n}, "img_name": "{n}.jpg", "width": 32, "height": 24, "position": [{x}, 0, -2],
                "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 30, "fy": 30}}"#
            )
        };
        format!("[{}]", names.map(camera).join(","))
    };
    std::fs::write(at("model/cameras.json"), path([10, 1, 2])).expect("written");
    std::fs::write(at("listed.json"), path([10, 1, 2])).expect("written");
    std::fs::write(at("cameras.json"), path([1, 2, 10])).expect("written");
    let first = |name: &str| {
        let (path, out) = (at(name), folder.path().join("out").join(name));
        succeed(&["render", text(&ply), "--path", text(&path), "--frames", "2", "-o", text(&out), "--quiet"]);
        std::fs::read(out.join("00000.png")).expect("a PNG")
    };
    assert!(first("model/cameras.json") == first("cameras.json"), "not by name");
    assert!(first("listed.json") != first("cameras.json"), "not as it was written");
}

#[test]
fn a_window_needs_something_to_show() {
    let remedy = match cfg!(feature = "window") {
        true => "`ashsplat view --window out/MODEL`",
        false => "--features window",
    };
    refuse(&["view", "--window"], &["--window", remedy]);
}

/// An orbit of a very small scene stays far enough away that not all of it is culled.
#[test]
fn orbit_of_a_single_gaussian_shows_it() {
    let folder = tempdir().expect("a temporary folder");
    let ply = folder.path().join("scene.ply");
    for log_scale in [-1.0, -7.0] {
        let gaussian = ashsplat::scene::Gaussians {
            sh_degree: 0,
            means: vec![[3.0, -1.0, 2.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            log_scales: vec![[log_scale; 3]],
            opacity_logits: vec![4.0],
            sh: vec![[1.0; 3]],
        };
        ashsplat_files::ply::write(&ply, &gaussian).expect("written");
        let out = folder.path().join("out");
        let said = succeed(&["render", text(&ply), "--orbit", "3", "--width", "40", "-o", text(&out)]);
        assert_eq!(said.matches("1 of 1 Gaussians visible").count(), 3, "{said}");
    }
}

/// Cameras in a row that look the same way define no depth: the Gaussians do.
#[test]
fn orbit_of_parallel_cameras_shows_the_scene() {
    let folder = tempdir().expect("a temporary folder");
    let (model, out) = (folder.path().join("model"), folder.path().join("out"));
    let ply = model.join("point_cloud/iteration_1/point_cloud.ply");
    std::fs::create_dir_all(ply.parent().expect("a folder")).expect("created");
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    gaussians.means.iter_mut().for_each(|mean| mean[2] += 40.0);
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    let named = |index: u32| {
        let x = index as f32 - 1.0;
        let intrinsics = Intrinsics::from_fov_x(0.8, SIZE[0], SIZE[1]);
        let camera = Camera::look_at(vec3(x, 0.0, 0.0), vec3(x, 0.0, 1.0), Vec3::NEG_Y, intrinsics);
        (format!("{index}.png"), camera)
    };
    let cameras: Vec<(String, Camera)> = (0..3).map(named).collect();
    let named = cameras.iter().map(|(name, camera)| (name.as_str(), camera));
    ashsplat_files::cameras_json::write(model.join("cameras.json"), named, &WorldFrame::default())
        .expect("written");
    std::fs::write(model.join("cfg_args"), "Namespace(sh_degree=0)").expect("written");
    let said = succeed(&["render", text(&model), "--orbit", "4", "--width", "64", "-o", text(&out)]);
    assert_eq!(said.matches(" 400 of 400 Gaussians visible").count(), 4, "{said}");
}

/// Upright photographs give an upright film.
#[test]
fn orbit_of_upright_photographs_is_upright() {
    let folder = tempdir().expect("a temporary folder");
    let model = folder.path().join("model");
    let ply = model.join("point_cloud/iteration_1/point_cloud.ply");
    std::fs::create_dir_all(ply.parent().expect("a folder")).expect("created");
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    ashsplat_files::ply::write(&ply, &gaussians).expect("written");
    let rendered = |cameras: [[u32; 2]; 3], more: &[&str]| {
        let named = cameras.map(|[width, height]| {
            let intrinsics = Intrinsics::from_fov_x(0.8, width, height);
            Camera::look_at(vec3(0.0, 0.0, -3.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
        });
        let named = named.iter().map(|camera| ("a.png", camera));
        ashsplat_files::cameras_json::write(model.join("cameras.json"), named, &WorldFrame::default())
            .expect("written");
        let out = tempdir().expect("a temporary folder");
        succeed(&[&["render", text(&model), "--orbit", "1", "-o", text(out.path())], more].concat());
        let frame = std::fs::read_dir(out.path()).expect("a folder").next().expect("a picture");
        image::image_dimensions(frame.expect("a picture").path()).expect("a PNG")
    };
    let [upright, lying] = [[32, 48], [48, 32]];
    assert_eq!(rendered([upright, lying, upright], &[]), (720, 1280));
    assert_eq!(rendered([upright, lying, lying], &[]), (1280, 720));
    assert_eq!(rendered([upright; 3], &["--width", "36"]), (36, 64));
    assert_eq!(rendered([upright; 3], &["--height", "32"]), (18, 32));
}

#[test]
fn compiled_kernels_are_kept_between_runs() {
    let folder = tempdir().expect("a folder");
    let scene = folder.path().join("scene.ply");
    ashsplat_files::ply::write(
        &scene,
        &ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians"),
    )
    .expect("written");
    let caches = folder.path().join("caches/pipelines");
    let arguments = [
        "inspect",
        text(&scene),
        "--pixel",
        "8,8",
        "--fx",
        "20",
        "--width",
        "16",
        "--height",
        "16",
        "--json",
    ];
    let run = || {
        let finished = finish(program().args(arguments).env("ASHSPLAT_PIPELINE_CACHE", &caches));
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        finished.stdout
    };
    let first = run();
    // One file for the device: the header of version one, 32 bytes, then the driver's data.
    let files: Vec<_> =
        std::fs::read_dir(&caches).expect("a folder").map(|entry| entry.expect("a file")).collect();
    assert_eq!(files.len(), 1);
    let cache = files[0].path();
    let kept = std::fs::read(&cache).expect("a cache");
    assert!(kept.len() >= 32 && kept.starts_with(&[32, 0, 0, 0, 1, 0, 0, 0]), "{} bytes", kept.len());
    assert_eq!(run(), first);
    // Other contents are not passed to the driver.
    std::fs::write(&cache, b"no cache").expect("written");
    assert_eq!(run(), first);
    assert!(std::fs::read(&cache).expect("a cache").starts_with(&[32, 0, 0, 0]));
}
