//! Commands that need no training.

use super::*;
use ashsplat_files::cameras_json;
use exr::prelude::{LineOrder, MetaData, read_first_flat_layer_from_file};

#[test]
fn devices_are_listed_with_their_limits_and_requirements() {
    let list = succeed(&["devices"]);
    assert!(list.starts_with("0: "), "{list}");
    assert_says(&list, &["subgroups", "shared memory", "per allocation", "usable"]);
    let list = succeed(&["devices", "--requirements"]);
    assert_says(&list, &["Vulkan               1.3", "maintenance4", "optional", "VK_KHR_push_descriptor"]);
}

#[test]
fn info_of_a_data_set() {
    let report = TestFolder::new().json_of("info @data --eval --json");
    for (name, number) in
        [("images", 9), ("sound_photos", 9), ("train_views", 7), ("test_views", 2), ("points", 400)]
    {
        assert_eq!(report[name], number, "{name}");
    }
    assert_eq!(report["cameras"]["PINHOLE 48x32"], 1);
}

#[test]
fn info_of_a_ply() {
    let place = TestFolder::empty();
    place.write_scene("scene.ply", &wall(2));
    let report = place.json_of("info @scene.ply --json");
    assert_eq!((&report["gaussians"], &report["sh_degree"]), (&Value::from(400), &Value::from(2)));
    // All Gaussians start at opacity 0.1.
    let counts: Vec<u64> = serde_json::from_value(report["opacity"]["counts"].clone()).expect("counts");
    assert_eq!(counts.iter().sum::<u64>(), 400);
    assert_eq!(counts[0] + counts[1], 400);
    place.run("info @scene.ply").ok().says(&["Gaussians  400", "largest scale"]);
}

/// A camera in cameras.json that looks along +z. Without cx and cy, as in the reference's files.
fn camera(name: &str, [width, height]: [u32; 2], [x, z]: [f64; 2], focal: u32) -> Value {
    serde_json::json!({
        "id": 0, "img_name": name, "width": width, "height": height, "position": [x, 0, z],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": focal, "fy": focal,
    })
}

fn write_cameras(place: &TestFolder, file: &str, cameras: &[Value]) {
    place.write(file, Value::from(cameras).to_string());
}

fn channel(picture: &Path, name: &str) -> Vec<f32> {
    let image = read_first_flat_layer_from_file(picture).expect("an EXR");
    let channel = image.layer_data.channel_data.list.iter().find(|channel| channel.name.eq(name));
    channel.expect(name).sample_data.values_as_f32().collect()
}

/// The EXR's colour equals the PNG's without the sRGB curve; the wall's depth is 2.
#[test]
fn camera_path_is_rendered_to_png_and_exr() {
    let place = TestFolder::empty();
    let mut opaque = wall(0);
    opaque.opacity_logits.fill(4.0);
    place.write_scene("scene.ply", &opaque);
    place.run("render @scene.ply -o @out").refused(&["scene.ply", "--orbit"]);
    write_cameras(&place, "path.json", &[camera("front", [64, 48], [0.0, -2.0], 60)]);
    let render = place.run("render @scene.ply --path @path.json --format both -o @out").ok();
    render.says(&["front 64x48", " ms"]);
    assert_eq!(place.files("out"), ["00000.exr", "00000.png"].map(PathBuf::from));
    let exr = place.at("out/00000.exr");
    // Otherwise tiles are stored in the order in which threads finish: the same picture, but not the same bytes.
    let header = MetaData::read_from_file(&exr, true).expect("an EXR").headers.remove(0);
    assert_eq!(header.line_order, LineOrder::Increasing);
    let [red, alpha, depth] = ["R", "A", "Z"].map(|name| channel(&exr, name));
    assert_eq!(red.len(), 64 * 48);
    for (index, pixel) in place.picture("out/00000.png").pixels().enumerate() {
        let linear = red[index].clamp(0.0, 1.0);
        let srgb =
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
        assert!((srgb * 255.0 - f32::from(pixel[0])).abs() < 0.51, "pixel {index}");
    }
    let middle = 24 * 64 + 32;
    assert!(alpha[middle] > 0.9, "alpha {}", alpha[middle]);
    assert!((depth[middle] - 2.0).abs() < 0.01, "depth {}", depth[middle]);
}

/// Without a background, colours are those of the covering Gaussians: straight in a PNG, premultiplied and linear in
/// an EXR.
#[test]
fn pictures_without_background_have_the_colours_of_what_covers() {
    let place = TestFolder::empty();
    let mut gaussians = wall(0);
    gaussians.opacity_logits.fill(-1.5);
    // A uniform grey of 128, whatever the coverage.
    gaussians.sh.fill([(128.0 / 255.0 - 0.5) / 0.282_094_8; 3]);
    place.write_scene("scene.ply", &gaussians);
    write_cameras(&place, "path.json", &[camera("front", [64, 48], [0.0, -2.0], 60)]);
    let render =
        |more: &str| place.run(format!("render @scene.ply --path @path.json --transparent -o {more}"));
    render("@out --format both").ok();
    let picture = image::open(place.at("out/00000.png")).expect("a PNG");
    let [green, alpha] = ["G", "A"].map(|name| channel(&place.at("out/00000.exr"), name));
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
    render("@out --background 1,1,1").refused(&["--transparent", "--background"]);
    render("@a.gif").refused(&["--transparent", "no opacity"]);
}

/// A ball stays round in pictures of any shape, and on a curve through cameras of several shapes.
#[test]
fn pictures_of_another_shape_show_more_and_stretch_nothing() {
    let place = TestFolder::empty();
    write_balls(&place, "ball.ply", &[([0.0, 0.0, 4.0], 5.0, 0.3)]);
    let [wide, high] = [("a", [160, 120]), ("b", [120, 160])].map(|(n, size)| camera(n, size, [0.0; 2], 150));
    write_cameras(&place, "one.json", std::slice::from_ref(&wide));
    write_cameras(&place, "two.json", &[wide, high]);
    // Standard deviation of the brightness in x, which must be that in y, pixels; and the size.
    let spread = |picture: &str| {
        let pixels = image::open(place.at(picture)).expect("a PNG").to_luma8();
        let mut sums = [0.0; 5];
        for (x, y, pixel) in pixels.enumerate_pixels() {
            let (x, y, light) = (f64::from(x), f64::from(y), f64::from(pixel[0]));
            let terms = [light, light * x, light * y, light * x * x, light * y * y];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        let [light, x, y, xx, yy] = sums;
        let [x, y] = [(x, xx), (y, yy)].map(|(x, xx)| (xx / light - (x / light).powi(2)).sqrt());
        assert!((x / y - 1.0).abs() < 0.03, "{picture}: {x} {y}");
        (x, pixels.dimensions())
    };
    let drawn = |options: &str| {
        let said = place.run(format!("render @ball.ply --path @one.json -o @out.png {options}")).ok().stdout;
        let (x, size) = spread("out.png");
        (x, size, said)
    };
    let (own, _, said) = drawn("");
    assert!(!said.contains("shows more"), "{said}");
    for (options, size, scale, words) in [
        ("--width 320 --height 120", (320, 120), 1.0, "320x120 shows more at the left and right"),
        ("--width 120 --height 240", (120, 240), 0.75, "120x240 shows more above and below"),
        ("--width 80", (80, 60), 0.5, ""),
        ("--height 61", (81, 61), 0.507, ""),
        ("--width 320 --height 120 --fov 90", (320, 120), 160.0 / 150.0, ""),
    ] {
        let (x, drawn, said) = drawn(options);
        assert_eq!(drawn, size, "{options}");
        assert!((x / own / scale - 1.0).abs() < 0.1, "{options}: {x} for {own}");
        assert_eq!(said.matches("shows more").count(), usize::from(!words.is_empty()), "{said}");
        assert!(said.contains(words), "{said}");
    }
    place.run("render @ball.ply --path @two.json --frames 3 -o @curve --quiet").ok();
    for picture in place.files("curve") {
        assert_eq!(spread(&format!("curve/{}", picture.display())).1, (160, 120));
    }
}

/// Balls to the right of the camera and behind it lie a quarter and half a turn from the middle of a panorama.
#[test]
fn pictures_through_a_lens_show_what_lies_beside_and_behind() {
    let place = TestFolder::empty();
    write_balls(&place, "balls.ply", &[([4.0, 0.0, 0.0], 5.0, 0.2), ([-0.5, 0.0, -4.0], 5.0, 0.2)]);
    write_cameras(&place, "path.json", &[camera("a", [160, 120], [0.0; 2], 150)]);
    let run = |options: &str| {
        place.run(format!("render @balls.ply --path @path.json -o @out.png --quiet --camera-model {options}"))
    };
    let drawn = |options: &str| {
        run(options).ok();
        image::open(place.at("out.png")).expect("a PNG").to_luma8()
    };
    let panorama = drawn("EQUIRECTANGULAR --height 100");
    assert_eq!(panorama.dimensions(), (200, 100));
    assert!(panorama[(150, 50)][0] > 200 && panorama[(3, 50)][0] > 100 && panorama[(100, 50)][0] == 0);
    // 240 degrees over 120 pixels: 90 degrees are 45 pixels.
    let fisheye = drawn("opencv_fisheye --width 120 --height 120 --fov 240");
    assert!(fisheye[(105, 60)][0] > 200 && fisheye[(60, 60)][0] == 0);
    run("EQUIRECTANGULAR --width 100 --height 80").refused(&["panorama of 100x80", "2:1"]);
    run("EQUIRECTANGULAR --fov 90").refused(&["--fov", "all directions"]);
    run("OPENCV").refused(&["--camera-model", "OPENCV_FISHEYE"]);
}

/// Cameras that look elsewhere give black pictures: a warning says so, in `eval` too.
#[test]
fn pictures_that_show_nothing_are_told() {
    let place = TestFolder::new();
    for (z, output) in [(0.0, 0), (-90.0, 1)] {
        write_balls(&place, "ball.ply", &[([0.0, 0.0, z], 5.0, 0.3)]);
        for command in ["render @ball.ply -o @out", "eval @ball.ply"] {
            let said = place.run(format!("{command} -s @data --quiet")).ok().stderr;
            let line =
                "warning: no picture shows a Gaussian: do scene and cameras have the same coordinates?";
            assert_eq!(said.matches(line).count(), output, "{command}: {said}");
        }
    }
}

/// A sixth of the Gaussians is far away, like floaters or a sky: an orbit shows the others.
#[test]
fn an_orbit_does_not_go_by_far_gaussians() {
    let place = TestFolder::empty();
    let lit = |far: f32| {
        let ball = |i: u32| {
            let place = vec3((i % 6) as f32, (i / 6 % 6) as f32, (i / 36) as f32) - 2.5;
            let far = if i.is_multiple_of(6) { far } else { 0.0 };
            ([place.x + far, place.y, place.z], 5.0, 0.3)
        };
        write_balls(&place, "scene.ply", &(0..216).map(ball).collect::<Vec<_>>());
        place.run("render @scene.ply --orbit 1 --width 96 -o @out.png --quiet").ok();
        let picture = image::open(place.at("out.png")).expect("a PNG").to_luma8();
        picture.pixels().filter(|pixel| pixel[0] > 40).count()
    };
    let whole = lit(0.0);
    assert!(lit(800.0) > whole / 2, "{} of {whole} pixels", lit(800.0));
}

/// One pixel in front of two Gaussians, at 2 (opacity 0.5) and 10 (0.99).
#[test]
fn an_exrs_depth_is_the_mean_or_the_harmonic_mean() {
    let place = TestFolder::empty();
    write_balls(&place, "two.ply", &[([0.0, 0.0, 2.0], 0.0, 0.5), ([0.0, 0.0, 10.0], 9.0, 0.5)]);
    write_cameras(&place, "path.json", &[camera("a", [33, 33], [0.0; 2], 40)]);
    let render = |more: &str| place.run(format!("render @two.ply --path @path.json --quiet -o {more}"));
    let [near, far] = [0.5, 0.5 * 0.99];
    let mean = (near * 2.0 + far * 10.0) / (near + far);
    let harmonic = (near + far) / (near / 2.0 + far / 10.0);
    for (options, expected) in [("", mean), ("--depth mean", mean), ("--depth harmonic", harmonic)] {
        render(&format!("@a.exr {options}")).ok();
        let depth = channel(&place.at("a.exr"), "Z")[16 * 33 + 16];
        assert!((depth - expected).abs() < 0.01, "{options}: {depth}");
    }
    render("@a.png --depth mean").refused(&["--depth", "EXR"]);
}

/// Writes white balls: position, opacity logit, standard deviation.
fn write_balls(place: &TestFolder, file: &str, balls: &[([f32; 3], f32, f32)]) {
    let mut gaussians = Gaussians { sh_degree: 0, ..Default::default() };
    for &(mean, logit, deviation) in balls {
        gaussians.means.push(mean);
        gaussians.log_scales.push([deviation.ln(); 3]);
        gaussians.quats.push([1.0, 0.0, 0.0, 0.0]);
        gaussians.opacity_logits.push(logit);
        gaussians.sh.push([0.5 / 0.282_094_8; 3]);
    }
    place.write_scene(file, &gaussians);
}

#[test]
fn views_that_cannot_be_meant_are_refused() {
    let place = TestFolder::empty();
    write_balls(&place, "scene.ply", &[([0.0, 0.0, 4.0], 5.0, 0.3)]);
    for (option, values) in [
        ("--up", &["0,0,0", "nan,0,1", "1,2"][..]),
        ("--fov", &["0", "180", "-60", "nan", "1e30"]),
        ("--width", &["0", "70000", "-5"]),
        ("--height", &["0"]),
        ("--background", &["-1,0,0", "0,0,1e30"]),
        ("--kernel-size", &["nan", "0", "1e30"]),
    ] {
        for value in values {
            let run = place.run(format!("render @scene.ply --orbit 1 {option}={value}")).refused(&[]);
            assert_eq!(run.stderr.lines().count(), 1, "{option} {value}: {}", run.stderr);
        }
    }
}

#[test]
fn films_are_files_and_never_folders() {
    let place = TestFolder::empty();
    place.write_scene("scene.ply", &wall(0));
    let film = |name: &str| format!("@films/{name} --width 40 --orbit 3");
    let render = |more: &str| place.run(format!("render @scene.ply --out {more}"));
    render(&film("film.gif")).ok();
    let gif = std::io::Cursor::new(place.read("films/film.gif"));
    let decoder = image::codecs::gif::GifDecoder::new(gif).expect("a GIF");
    let frames = image::AnimationDecoder::into_frames(decoder).collect_frames().expect("frames");
    let sizes: Vec<(u32, u32)> = frames.iter().map(|frame| frame.buffer().dimensions()).collect();
    assert_eq!(sizes, [(40, 22); 3]);
    assert_eq!(place.files("films"), [PathBuf::from("film.gif")]);
    for (name, words) in
        [("a.mov", [".mp4", "a.mov"]), ("b.mp4", ["ffmpeg", ".gif"]), ("c.webm", ["ffmpeg", ".gif"])]
    {
        // Without ffmpeg anywhere.
        let mut command = place.command(format!("render @scene.ply --out {}", film(name)));
        finish(command.env("PATH", "")).refused(&words);
        assert!(!place.has(format!("films/{name}")), "{name}");
    }
    render(&format!("{} --format exr", film("film.gif"))).refused(&["--format", "8 bits"]);
    // A single picture can be a file, too.
    let one = |name: &str| format!("@films/{name} --width 40 --orbit 1");
    for name in ["one.png", "one.exr"] {
        render(&one(name)).ok();
        assert!(place.at("films").join(name).is_file());
    }
    assert_eq!(place.picture("films/one.png").width(), 40);
    for (name, arguments, words) in [
        ("several.png", film("several.png"), &["several.png", "3 views", "folder", ".mp4"][..]),
        ("one.jpg", film("one.jpg"), &["one.jpg", ".png or .exr"]),
        ("other.exr", one("other.exr") + " --format png", &["--format", "name a folder"]),
        ("other.png", one("other.png") + " --format exr", &["--format", "name a folder"]),
        ("other.png", one("other.png") + " --format both", &["--format", "name a folder"]),
    ] {
        render(&arguments).refused(words);
        assert!(!place.has(format!("films/{name}")), "{arguments}");
    }
    place.run("render @scene.ply --frames 12").refused(&["--frames", "--path", "`--orbit 12`"]);
}

/// Training lists the held-out cameras first, but a curve visits the photographs in order. A path that a user wrote
/// keeps its order.
#[test]
fn a_models_cameras_are_a_path_by_name() {
    let place = TestFolder::empty();
    place.write_scene(point_cloud("model", 1), &wall(0));
    let path = |file: &str, names: [u32; 3]| {
        let camera = |n: u32| camera(&format!("{n}.jpg"), [32, 24], [f64::from(n) * 0.05, -2.0], 30);
        write_cameras(&place, file, &names.map(camera));
    };
    path("model/cameras.json", [10, 1, 2]);
    path("listed.json", [10, 1, 2]);
    path("cameras.json", [1, 2, 10]);
    let first = |name: &str| {
        let scene = point_cloud("model", 1);
        place.run(format!("render @{scene} --path @{name} --frames 2 -o @out/{name} --quiet")).ok();
        place.read(format!("out/{name}/00000.png"))
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
    let place = TestFolder::empty();
    for log_scale in [-1.0_f32, -7.0] {
        write_balls(&place, "scene.ply", &[([3.0, -1.0, 2.0], 4.0, log_scale.exp())]);
        let said = place.run("render @scene.ply --orbit 3 --width 40 -o @out").ok().stdout;
        assert_eq!(said.matches("1 of 1 Gaussians visible").count(), 3, "{said}");
    }
}

/// Cameras in a row that look the same way define no depth: the Gaussians do.
#[test]
fn orbit_of_parallel_cameras_shows_the_scene() {
    let place = TestFolder::empty();
    let mut gaussians = wall(0);
    gaussians.means.iter_mut().for_each(|mean| mean[2] += 40.0);
    place.write_scene(point_cloud("model", 1), &gaussians);
    let row = [-1.0, 0.0, 1.0].map(|x| {
        let intrinsics = Intrinsics::from_fov_x(0.8, SIZE[0], SIZE[1]);
        Camera::look_at(vec3(x, 0.0, 0.0), vec3(x, 0.0, 1.0), Vec3::NEG_Y, intrinsics)
    });
    write_model_cameras(&place, &row);
    place.write("model/cfg_args", "Namespace(sh_degree=0)");
    let said = place.run("render @model --orbit 4 --width 64 -o @out").ok().stdout;
    assert_eq!(said.matches(" 400 of 400 Gaussians visible").count(), 4, "{said}");
}

fn write_model_cameras(place: &TestFolder, cameras: &[Camera]) {
    let named = ["0.png", "1.png", "2.png"].into_iter().zip(cameras);
    cameras_json::write(place.at("model/cameras.json"), named, &WorldFrame::default()).expect("written");
}

#[test]
fn orbit_of_upright_photographs_is_upright() {
    let place = TestFolder::empty();
    place.write_scene(point_cloud("model", 1), &wall(0));
    let [upright, lying] = [[32, 48], [48, 32]];
    for (cameras, options, size) in [
        ([upright, lying, upright], "", (720, 1280)),
        ([upright, lying, lying], "", (1280, 720)),
        ([upright; 3], "--width 36", (36, 64)),
        ([upright; 3], "--height 32", (18, 32)),
    ] {
        let photographed = cameras.map(|[width, height]| {
            let intrinsics = Intrinsics::from_fov_x(0.8, width, height);
            Camera::look_at(vec3(0.0, 0.0, -3.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
        });
        write_model_cameras(&place, &photographed);
        place.run(format!("render @model --orbit 1 -o @out {options}")).ok();
        assert_eq!(place.picture("out/00000.png").dimensions(), size, "{cameras:?} {options}");
    }
}

#[test]
fn compiled_kernels_are_kept_between_runs() {
    let place = TestFolder::empty();
    place.write_scene("scene.ply", &wall(0));
    let run = || {
        let mut command = place.command("render @scene.ply --orbit 1 --width 16 --height 16 -o @out");
        finish(command.env("ASHSPLAT_PIPELINE_CACHE", place.at("caches/pipelines"))).ok();
        place.read("out/00000.png")
    };
    let first = run();
    // One file for the device: the header of version one, 32 bytes, then the driver's data.
    let files = place.files("caches/pipelines");
    assert_eq!(files.len(), 1);
    let cache = Path::new("caches/pipelines").join(&files[0]);
    let kept = place.read(&cache);
    assert!(kept.len() >= 32 && kept.starts_with(&[32, 0, 0, 0, 1, 0, 0, 0]), "{} bytes", kept.len());
    assert_eq!(run(), first);
    // Other contents are not passed to the driver.
    place.write(&cache, b"no cache");
    assert_eq!(run(), first);
    assert!(place.read(&cache).starts_with(&[32, 0, 0, 0]));
}
