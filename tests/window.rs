//! `ashsplat view --window` on its own X server (Xvfb), drawn by the present device under the validation layer.
//! Without Xvfb, the trial is listed as skipped.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

#[path = "common/slashes.rs"]
mod common;
#[allow(dead_code)]
#[path = "cli/run.rs"]
mod run;
#[path = "program/running.rs"]
mod running;
#[path = "window/server.rs"]
mod server;

use ashsplat::scene::{Camera, Exposure, Gaussians, Intrinsics, WorldFrame};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use ashsplat_files::tiles::{self, TileOptions};
use ashsplat_files::{Photo, PhotoFileFormat, Progress, cameras_json};
use glam::Vec3;
use libtest_mimic::{Failed, Trial};
use run::{Finished, finish, program, text};
use running::Running;
use server::{Desk, PATIENCE, PAUSE, Server};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

/// Size of the cameras, and of the resized window.
const SIZE: [u32; 2] = [480, 360];
const LARGER: [u32; 2] = [900, 610];
const LETTERS: [u8; 3] = [237, 242, 247];
/// Key codes of X.
const W: u8 = 25;
const H: u8 = 43;
const P: u8 = 33;
const Q: u8 = 24;
const ESCAPE: u8 = 9;
const RIGHT_BRACKET: u8 = 35;
const L: u8 = 46;
const SLASH: u8 = 61;
const SHIFT: u8 = 50;
const CONTROL: u8 = 37;
const DIGITS: [u8; 6] = [10, 11, 12, 13, 14, 15];
const HOME: u8 = 110;

fn main() -> ExitCode {
    let arguments = libtest_mimic::Arguments::from_args();
    let trial = |name: &str, check: fn()| {
        Trial::test(name, move || {
            check();
            Ok(())
        })
    };
    let on_server = |name: &str, check: fn()| match Command::new("Xvfb").arg("-help").output() {
        Ok(_) => trial(name, check),
        Err(error) => {
            let reason = format!("Xvfb is not installed: {error}");
            Trial::ignorable_test(name, move || Err(Failed::from(reason))).with_ignored_flag(true)
        }
    };
    let trials = vec![
        trial("window_without_a_display_is_one_line", without_display),
        trial("window_extensions_that_are_missing_are_named", missing_extensions),
        on_server("window_shows_what_render_draws", shows_what_render_draws),
        on_server("window_streams_a_tree", streams_a_tree),
        on_server("window_ends_in_every_way", ends_in_every_way),
    ];
    libtest_mimic::run(&arguments, trials).exit_code()
}

fn ball() -> Gaussians {
    let mut ball = Gaussians { sh_degree: 0, ..Gaussians::default() };
    for i in 0..1500 {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / 1500.0;
        let (turn, radius) = (i as f32 * 2.399_963, (1.0 - y * y).sqrt());
        ball.means.push([radius * turn.cos(), y, radius * turn.sin()]);
        ball.quats.push([1.0, 0.0, 0.0, 0.0]);
        ball.log_scales.push([-2.6, -3.0, -2.8]);
        ball.opacity_logits.push(if i % 3 == 0 { 0.0 } else { 3.0 });
        ball.sh.push([turn.cos(), y, turn.sin()].map(|c| 1.2 * c));
    }
    ball
}

/// A model folder with two cameras, the second with an off-centre lens.
fn model(folder: &Path) -> PathBuf {
    let model = folder.join("model");
    let ply = model.join("point_cloud/iteration_7");
    std::fs::create_dir_all(&ply).expect("a folder");
    splats::write(ply.join("point_cloud.ply"), &ball(), &WriteOptions::default()).expect("a PLY");
    let lens = Intrinsics::from_fov_x(0.8, SIZE[0], SIZE[1]);
    let first = Camera::look_at(Vec3::new(0.5, -1.0, -4.0), Vec3::ZERO, Vec3::NEG_Y, lens);
    let odd = Intrinsics { fx: 520.0, fy: 500.0, cx: 200.0, cy: 205.0, ..lens };
    let second = Camera::look_at(Vec3::new(-3.0, 0.5, 2.0), Vec3::new(0.2, 0.0, 0.0), Vec3::NEG_Y, odd);
    let write = |path: PathBuf, cameras: &[(&str, &Camera)]| {
        cameras_json::write(path, cameras.iter().copied(), &WorldFrame::default()).expect("cameras");
    };
    write(model.join("cameras.json"), &[("one", &first), ("two", &second)]);
    // Exposure that training has learned for the second photo.
    let rows = [[0.6, 0.1, 0.0, 0.05], [0.0, 1.2, 0.0, 0.0], [0.1, 0.0, 0.8, 0.0]];
    exposure_json::write(model.join(EXPOSURE_FILE), [("two", &Exposure { rows })]).expect("exposures");
    // The first camera in a larger window, which keeps its vertical field of view.
    let f = first.fy * LARGER[1] as f32 / SIZE[1] as f32;
    let [cx, cy] = LARGER.map(|side| 0.5 * side as f32);
    let lens = Intrinsics { fx: f, fy: f, cx, cy, width: LARGER[0], height: LARGER[1] };
    let larger = Camera::with_pose(first.camera_from_world, first.translation, lens);
    write(folder.join("path.json"), &[("one", &first), ("two", &second), ("three", &larger)]);
    model
}

/// Pictures of the model by `ashsplat render`.
fn rendered(model: &Path, folder: &Path, options: &[&str]) -> Vec<Photo> {
    let out = folder.join(format!("rendered{}", options.len()));
    let path = folder.join("path.json");
    let render = ["render", text(model), "--path", text(&path), "-o", text(&out)];
    finish(program().args(render).args(options)).ok();
    pictures(&out)
}

fn pictures(folder: &Path) -> Vec<Photo> {
    let files = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let mut files: Vec<_> = files.filter(|path| path.extension().is_some_and(|e| e == "png")).collect();
    files.sort();
    files.iter().map(|path| Photo::read(path, [0.0; 3]).expect("a picture")).collect()
}

fn start(server: &Server, model: &Path, out: &Path, options: &[&str]) -> Running {
    let mut command = program();
    command.args(["view", text(model), "--window", "--validation", "-o", text(out)]).args(options);
    command.env("DISPLAY", &server.display).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    Running::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()))
}

fn difference(shown: &Photo, photo: &Photo) -> Option<(u8, f64)> {
    if [shown.width, shown.height] != [photo.width, photo.height] {
        return None;
    }
    let differences = shown.rgb.iter().zip(&photo.rgb).map(|(a, b)| a.abs_diff(*b));
    let sum: f64 = differences.clone().map(f64::from).sum();
    Some((differences.max().unwrap_or(0), sum / shown.rgb.len() as f64))
}

/// Waits for a screenshot that the program saves.
fn saved(out: &Path) -> Photo {
    let start = Instant::now();
    loop {
        if out.is_dir()
            && let Some(picture) = pictures(out).pop()
        {
            return picture;
        }
        assert!(start.elapsed() < PATIENCE, "no screenshot");
        std::thread::sleep(PAUSE);
    }
}

/// Waits until the program ends, without an error. Returns its stdout.
fn end(child: Running, what: &str) -> String {
    let run = Finished::from(child.finish());
    assert_eq!((run.code, run.stderr.as_str()), (Some(0), ""), "{what}");
    run.stdout
}

fn is_close(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 2)
}

/// Waits until the window's content satisfies a condition.
fn wait_until(desk: &Desk, window: u32, what: &str, folder: &Path, is: impl Fn(&Photo) -> bool) -> Photo {
    let start = Instant::now();
    loop {
        let shown = desk.screenshot(window);
        if is(&shown) {
            keep(&shown, what, folder);
            return shown;
        }
        if start.elapsed() > PATIENCE {
            let path = keep(&shown, what, folder);
            panic!("{what} was not shown; what was is in {}", path.display());
        }
        std::thread::sleep(PAUSE);
    }
}

/// Writes a screenshot to the folder `ASHSPLAT_SCREENSHOTS`, for inspection.
fn keep(shown: &Photo, what: &str, folder: &Path) -> PathBuf {
    let folder = std::env::var_os("ASHSPLAT_SCREENSHOTS").map_or_else(|| folder.to_owned(), PathBuf::from);
    let path = folder.join(format!("window_{}.png", what.replace(' ', "_")));
    shown.write_png(&path).expect("written");
    path
}

fn shows_what_render_draws() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let model = model(folder.path());
    let expected = rendered(&model, folder.path(), &[]);
    let exposed = rendered(&model, folder.path(), &["--exposure-of", "two"]);
    let differs = |(a, b): (&u8, &u8)| a.abs_diff(*b) > 2;
    assert!(expected[1].rgb.iter().zip(&exposed[1].rgb).any(differs), "the exposure changes nothing");
    let (server, out) = (Server::start(), folder.path().join("out"));
    let child = start(&server, &model, &out, &[]);
    let desk = server.connect();
    let window = desk.window("model");
    let wait = |what: &str, is: &dyn Fn(&Photo) -> bool| wait_until(&desk, window, what, folder.path(), is);
    let equals = |photo: &Photo, shown: &Photo| {
        difference(shown, photo).is_some_and(|(max_gaussians, mean)| max_gaussians <= 2 && mean < 0.05)
    };
    let press = |key: u8, what: &str, photo: &Photo| {
        desk.key(key);
        wait(what, &|shown| equals(photo, shown));
    };
    let first = wait("first", &|shown| shown.width == 1280 && shown.rgb.iter().any(|&v| v > 100));
    assert_eq!(first.height, 720);
    desk.resize(window, SIZE);
    // The text covers only the corner.
    let below = 3 * (SIZE[0] * (SIZE[1] * 3 / 5)) as usize;
    let white = |shown: &Photo| shown.rgb[..below].chunks_exact(3).filter(|p| **p == LETTERS).count();
    wait("text", &|shown| {
        shown.height == SIZE[1]
            && is_close(&shown.rgb[below..], &expected[0].rgb[below..])
            && white(shown) > 1000
    });
    press(H, "splats", &expected[0]);
    // Every mode gives another picture; the first one returns.
    let mut seen = vec![expected[0].clone()];
    for (digit, mode) in
        DIGITS.iter().zip(["splats", "centres", "ellipsoids", "depth", "tiles", "normals"]).skip(1)
    {
        desk.key(*digit);
        let shown = wait(mode, &|shown| {
            seen.iter().all(|other| difference(shown, other).is_some_and(|(_, mean)| mean > 1.0))
        });
        seen.push(shown);
    }
    press(DIGITS[0], "splats again", &expected[0]);
    // The second photo's view with its lens. The message disappears by itself.
    desk.key(RIGHT_BRACKET);
    press(RIGHT_BRACKET, "second view", &expected[1]);
    press(L, "as photographed", &exposed[1]);
    // Only for that photo's view.
    press(RIGHT_BRACKET, "another photo's view", &expected[0]);
    press(RIGHT_BRACKET, "as photographed again", &exposed[1]);
    press(L, "as the scene is", &expected[1]);
    // Moved, and back at the first view.
    desk.hold(W, Duration::from_millis(300));
    desk.drag([200, 150], [260, 190]);
    wait("moved", &|shown| difference(shown, &expected[1]).is_some_and(|(_, mean)| mean > 1.0));
    desk.chord(SHIFT, SLASH);
    wait("keys", &|shown| white(shown) > 3000);
    desk.key(ESCAPE);
    press(HOME, "home", &expected[0]);
    desk.key(P);
    assert!(saved(&out).rgb == expected[0].rgb);
    // The message may still be shown; it lies in the upper part.
    desk.resize(window, LARGER);
    wait("larger", &|shown| {
        let half = 3 * (LARGER[0] * LARGER[1] / 2) as usize;
        [shown.width, shown.height] == LARGER && is_close(&shown.rgb[half..], &expected[2].rgb[half..])
    });
    desk.close(window);
    assert!(end(child, "model").starts_with("window on "));
}

/// Picture of a tree by `render` within a budget, from the window's first view.
fn rendered_tree(tree: &Path, budget: &str) -> Photo {
    let out = tree.with_file_name(format!("budget{budget}"));
    let size = ["--orbit", "1", "--width", "1280", "--height", "720", "--fov", "57.295779513"];
    finish(program().args(["render", text(tree), "--budget", budget, "-o", text(&out)]).args(size)).ok();
    pictures(&out).remove(0)
}

/// The picture becomes that of `render --budget`, without input, and again after the view has been elsewhere.
fn streams_a_tree() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [scene, tree, out] = ["scene.ply", "tree", "out"].map(|name| folder.path().join(name));
    splats::write(&scene, &ball(), &WriteOptions::default()).expect("a PLY");
    let options = TileOptions { max_gaussians: 60, packed: false };
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.1);
    tiles::write(&scene, &tree, &options, &ReadOptions::default(), &mut measure, &Progress::NONE)
        .expect("tiles");
    let [coarse, fine] = ["60", "600"].map(|budget| rendered_tree(&tree, budget));
    let server = Server::start();
    let child = start(&server, &tree, &out, &["--budget", "600"]);
    let desk = server.connect();
    let window = desk.window("tree");
    let wait = |what: &str, is: &dyn Fn(&Photo) -> bool| wait_until(&desk, window, what, folder.path(), is);
    // The text covers the upper part.
    let below = 3 * (1280 * 720 / 2) as usize;
    let equals = |photo: &Photo, shown: &Photo, from: usize| {
        shown.rgb.len() == photo.rgb.len() && is_close(&shown.rgb[from..], &photo.rgb[from..])
    };
    let shown = wait("tree", &|shown| equals(&fine, shown, below));
    assert!(!equals(&coarse, &shown, below), "the coarsest tile looks the same");
    desk.key(H);
    wait("tree without text", &|shown| equals(&fine, shown, 0));
    for _ in 0..3 {
        desk.drag([300, 300], [800, 330]);
        wait("turned", &|shown| difference(shown, &fine).is_some_and(|(_, mean)| mean > 1.0));
    }
    desk.key(DIGITS[3]);
    desk.key(HOME);
    wait("depth of a tree", &|shown| difference(shown, &fine).is_some_and(|(_, mean)| mean > 1.0));
    desk.key(DIGITS[0]);
    wait("tree again", &|shown| equals(&fine, shown, 0));
    // Beyond the scene no tile is in view.
    wait("nothing", &|shown| {
        desk.hold(W, Duration::from_secs(1));
        shown.rgb.iter().all(|value| *value == 0)
    });
    desk.key(HOME);
    wait("tree once more", &|shown| equals(&fine, shown, 0));
    desk.key(P);
    assert!(saved(&out).rgb == fine.rgb);
    desk.close(window);
    end(child, "tree");
}

fn ends_in_every_way() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let model = model(folder.path());
    let server = Server::start();
    type Act = fn(&Desk, &Running);
    let ways: [(&str, Act); 3] = [
        ("Escape", |desk, _| {
            // The first key press closes the list of keys.
            desk.chord(SHIFT, SLASH);
            std::thread::sleep(4 * PAUSE);
            desk.key(ESCAPE);
            std::thread::sleep(4 * PAUSE);
            desk.key(ESCAPE);
        }),
        ("Ctrl Q", |desk, _| desk.chord(CONTROL, Q)),
        ("Ctrl-C", |_, child| child.interrupt()),
    ];
    for (way, act) in ways {
        let child = start(&server, &model, folder.path(), &[]);
        let desk = server.connect();
        let window = desk.window("model");
        wait_until(&desk, window, way, folder.path(), |shown| shown.rgb.iter().any(|&v| v > 100));
        if way == "Ctrl Q" {
            desk.click([640, 360]);
        }
        act(&desk, &child);
        end(child, way);
    }
}

fn missing_extensions() {
    let extensions = vec![c"VK_KHR_looking_glass"];
    let instance = ContextOptions { instance_extensions: extensions.clone(), ..ContextOptions::default() };
    let device = ContextOptions { device_extensions: extensions, ..ContextOptions::default() };
    for options in [instance, device] {
        let error = Context::new(&options).err().expect("no such extension").to_string();
        assert!(error.contains("lacks VK_KHR_looking_glass"), "{error}");
    }
}

fn without_display() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for display in [None, Some(""), Some(":987"), Some("nonsense")] {
        let mut command = program();
        command.args(["view", text(folder.path()), "--window"]);
        for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
            command.env_remove(name);
        }
        if let Some(display) = display {
            command.env("DISPLAY", display);
        }
        let run = finish(&mut command).refused(&["error: --window: no display can be opened ("]);
        let remedy = "without --window the viewer is a page in a browser\n";
        assert!(run.stderr.lines().count() == 1 && run.stderr.ends_with(remedy), "{}", run.stderr);
        assert_eq!(run.stdout, "", "{display:?}");
    }
}
