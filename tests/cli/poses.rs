//! `ashsplat poses` with stand-ins for COLMAP and ffmpeg, and the hints that name it.

use super::*;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::CommandExt;
use std::process::Stdio;
use std::time::{Duration, Instant};
use tempfile::{TempDir, tempdir};

use crate::program::running::Running;

/// Photographs without cameras, and the model that the stand-in produces.
struct Place {
    folder: TempDir,
}

impl Place {
    /// `photographs`: folder for the photographs.
    fn new(photographs: &str) -> Self {
        let folder = tempdir().expect("a temporary folder");
        let data = folder.path().join("data");
        write_dataset(&data);
        std::fs::create_dir_all(folder.path().join("fake")).expect("a folder");
        std::fs::rename(data.join("sparse/0"), folder.path().join("fake/model")).expect("moved");
        let photos = folder.path().join(photographs);
        std::fs::create_dir_all(photos.parent().expect("a parent")).expect("a folder");
        std::fs::rename(data.join("images"), photos).expect("moved");
        std::fs::remove_dir_all(data).expect("removed");
        Self { folder }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A command in this folder with the stand-ins and the program in its PATH.
    fn command(&self, program: &str) -> Command {
        let tools = crate::common::root().join("tests/cli/poses");
        let own = Path::new(env!("CARGO_BIN_EXE_ashsplat")).parent().expect("a folder");
        let path =
            std::env::join_paths([&tools, own, Path::new("/usr/bin"), Path::new("/bin")]).expect("a path");
        let mut command = Command::new(program);
        command.current_dir(self.folder.path()).env("PATH", path).env("FAKE", self.at("fake"));
        command.env("ASHSPLAT_PIPELINE_CACHE", "");
        command
    }

    fn poses(&self, arguments: &[&str]) -> Command {
        let mut command = self.command(env!("CARGO_BIN_EXE_ashsplat"));
        command.arg("poses").args(arguments);
        command
    }

    /// Runs `ashsplat poses`. Returns stdout and stderr.
    fn succeed(&self, arguments: &[&str]) -> [String; 2] {
        let run = finish(&mut self.poses(arguments));
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        [run.stdout, run.stderr]
    }

    /// Runs a command that must fail with these words in its last line.
    fn fails(&self, command: &mut Command, words: &[&str]) {
        let run = finish(command);
        assert_eq!(run.code, Some(2), "{}{}", run.stdout, run.stderr);
        let last = run.stderr.lines().last().unwrap_or_default();
        assert!(run.stdout.is_empty() && last.starts_with("error: "), "{}", run.stderr);
        assert!(words.iter().all(|word| last.contains(word)), "{last}");
    }

    /// Calls of the stand-ins, without their calls of `-h`.
    fn calls(&self) -> Vec<String> {
        let calls = std::fs::read_to_string(self.at("fake/calls")).unwrap_or_default();
        std::fs::remove_file(self.at("fake/calls")).ok();
        calls.lines().filter(|call| !call.ends_with(" -h")).map(str::to_owned).collect()
    }

    /// First words of the calls.
    fn stages(&self) -> Vec<String> {
        self.calls().iter().filter_map(|call| call.split(' ').next().map(str::to_owned)).collect()
    }
}

/// Command in the backquotes of a message.
fn hint(message: &str) -> &str {
    message.split('`').nth(1).unwrap_or_else(|| panic!("no command in {message}"))
}

/// A user with photographs runs a command, and then the command that it prints.
#[test]
fn hints_work_as_they_are_printed() {
    let place = Place::new("my photos");
    for words in [["info", "my photos"].as_slice(), &["train", "-m", "out", "-s", "my photos"]] {
        let run = finish(place.command(env!("CARGO_BIN_EXE_ashsplat")).args(words));
        assert_eq!((run.code, hint(&run.stderr)), (Some(2), "ashsplat poses 'my photos'"));
    }
    let type_it = |line: &str| {
        let run = finish(place.command("sh").args(["-c", line]));
        assert_eq!(run.code, Some(0), "{line}: {}", run.stderr);
        run
    };
    let said = type_it("ashsplat poses 'my photos'");
    assert!(said.stdout.contains("registered      9 of 9 photographs"), "{}", said.stdout);
    for stage in ["features ", "matches ", "mapping "] {
        assert!(
            said.stderr.contains(stage) && said.stderr.contains(" s: 1 camera (SIMPLE_RADIAL)"),
            "{}",
            said.stderr
        );
    }
    let next = |what: &str| {
        let line = said.stdout.lines().find_map(|line| line.strip_prefix(what)).expect("printed");
        line.trim().to_owned()
    };
    let checked = type_it(&next("check it")).stdout;
    assert!(checked.contains("9 registered, 9 sound photos"));
    let train = checked.lines().find_map(|line| line.strip_prefix("next      it can be trained on: "));
    assert_eq!(train, Some(&*next("train")));
    type_it(&format!("{} --iterations 1 --quiet", next("train")));
    assert!(place.at("out/my photos/point_cloud/iteration_1/point_cloud.ply").is_file());
    assert_eq!(next("look at it"), "ashsplat view 'out/my photos'");
}

#[test]
fn photographs_stay_and_are_linked() {
    let place = Place::new("photos");
    place.succeed(&["photos", "--quiet"]);
    let files = files_below(&place.at("photos_dataset"));
    let names: Vec<String> = files.iter().map(|file| file.to_string_lossy().into_owned()).collect();
    assert_eq!(names[..2], ["images/01.png", "images/02.png"]);
    assert_eq!(
        names[9..],
        ["poses.log", "sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"]
    );
    let inode = |name: &str| place.at(name).metadata().expect("there").ino();
    assert_eq!(inode("photos/01.png"), inode("photos_dataset/images/01.png"));
    assert_eq!(files_below(&place.at("photos")).len(), 9);
    let listed = std::fs::read_to_string(place.at("fake/photographs")).expect("a list");
    assert_eq!(
        listed.lines().map(str::to_owned).collect::<Vec<_>>(),
        (1..=9).map(|n| format!("{n:02}.png")).collect::<Vec<_>>()
    );
    let calls = place.calls();
    assert_eq!(calls.len(), 3);
    assert!(
        calls[0].starts_with("feature_extractor ") && calls[0].contains("single_camera 1"),
        "{}",
        calls[0]
    );
    assert!(
        calls[1].starts_with("exhaustive_matcher ") && calls[1].contains("SiftMatching.use_gpu 0"),
        "{}",
        calls[1]
    );
    place.fails(&mut place.poses(&["photos"]), &["photos_dataset/sparse: is there already", "another -o"]);
    place.fails(&mut place.poses(&["photos", "--every", "2"]), &["--every", "for videos"]);
    place.succeed(&["photos", "-o", "other", "--matcher", "sequential", "--cameras", "each"]);
    let calls = place.calls();
    assert!(calls[0].contains("single_camera 0") && calls[1].starts_with("sequential_matcher "), "{calls:?}");
}

#[test]
fn a_damaged_photograph_is_left_out() {
    let place = Place::new("photos");
    let damaged = ["05a.jpg", "05b.jpg"];
    for name in damaged {
        std::fs::write(place.at("photos").join(name), "no JPEG").expect("written");
    }
    let [said, told] = place.succeed(&["photos", "--quiet"]);
    assert!(said.contains("registered      9 of 9 photographs"), "{said}");
    let lines: Vec<&str> = told.lines().collect();
    assert_eq!(lines.len(), damaged.len(), "{told}");
    for (line, name) in lines.iter().zip(damaged) {
        assert!(line.starts_with(&format!("warning: left out: photos/{name}: ")), "{told}");
        assert!(!place.at("photos_dataset/images").join(name).exists());
    }
    std::fs::create_dir(place.at("few")).expect("created");
    std::fs::copy(place.at("photos/01.png"), place.at("few/01.png")).expect("copied");
    place.fails(&mut place.poses(&["few"]), &["has 1 photograph, too few"]);
    for name in ["02.jpg", "03.jpg"] {
        std::fs::write(place.at("few").join(name), "no JPEG").expect("written");
    }
    // Too few photographs remain without them.
    place.fails(&mut place.poses(&["few"]), &["few/02.jpg", "(and 1 more)"]);
}

#[test]
fn photographs_in_a_data_set_are_used_where_they_are() {
    let place = Place::new("scene/images");
    place.succeed(&["scene", "--quiet"]);
    assert!(place.at("scene/sparse/0/images.bin").is_file() && place.at("scene/images/01.png").is_file());
    assert_eq!(std::fs::read_dir(place.at("scene")).expect("a folder").count(), 3);
    place.fails(&mut place.poses(&["scene"]), &["has cameras already", "`ashsplat train -s scene`"]);
    // An output folder without subfolders works, and its photos are counted right.
    let flat = Place::new("flat");
    flat.succeed(&["flat", "-o", "flat", "--quiet"]);
    assert!(flat.at("flat/sparse/0/images.bin").is_file() && !flat.at("flat/images").exists());
    let info = || finish(flat.command(env!("CARGO_BIN_EXE_ashsplat")).args(["info", "flat"]));
    assert!(info().stdout.contains("9 registered, 9 sound photos"), "{}", info().stderr);
    // Folders beside the photographs are ignored, but another photograph counts.
    for folder in ["flat/thumbnails", "flat/stereo/deep"] {
        std::fs::create_dir_all(flat.at(folder)).expect("a folder");
        std::fs::copy(flat.at("flat/01.png"), flat.at(folder).join("01.png")).expect("copied");
    }
    assert!(!info().stdout.contains("warning"), "{}", info().stdout);
    std::fs::copy(flat.at("flat/01.png"), flat.at("flat/99.png")).expect("copied");
    // COLMAP has already compared all of them.
    for words in ["only 9 of its 10 photos have a camera", "all were compared with each other"] {
        assert!(info().stdout.contains(words), "{}", info().stdout);
    }
    let named = finish(flat.command(env!("CARGO_BIN_EXE_ashsplat")).args(["info", "flat", "--images", "."]));
    assert!(
        named.stdout.contains("9 registered") && named.stdout.contains("9 of its 10 photos"),
        "{}",
        named.stdout
    );
}

#[test]
fn failures_name_the_log_and_a_second_run_goes_on() {
    let place = Place::new("photos");
    let log = "photos_dataset/poses.unfinished/poses.log";
    let failing = |stage: &str| {
        let mut command = place.poses(&["photos"]);
        command.env("FAIL", stage);
        command
    };
    place.fails(
        &mut failing("feature_extractor"),
        &["COLMAP", "something went before / ERROR: it failed", log],
    );
    place.fails(&mut failing("mapper"), &["mapping failed", log]);
    assert_eq!(place.stages(), ["feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"]);
    let info = finish(place.command(env!("CARGO_BIN_EXE_ashsplat")).args(["info", "photos_dataset"]));
    assert!(
        info.code == Some(2) && info.stderr.contains("run the same `ashsplat poses` once more"),
        "{}",
        info.stderr
    );
    let mut unconnected = failing("mapper");
    unconnected.env("WORDS", "failed to create sparse model");
    place.fails(&mut unconnected, &["none of the 9 photographs", "more photographs", "overlapping", log]);
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
    // Another camera model needs other features.
    place.fails(failing("mapper").args(["--camera-model", "OPENCV"]), &["mapping failed"]);
    assert_eq!(place.stages(), ["feature_extractor", "exhaustive_matcher", "mapper"]);
    // A larger model might have followed.
    let mut killed = place.poses(&["photos", "--camera-model", "OPENCV"]);
    place.fails(killed.env("CRASH", "1"), &["mapping failed", log]);
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
    place.succeed(&["photos", "--camera-model", "OPENCV"]);
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
    assert!(!place.at("photos_dataset/poses.unfinished").exists());
}

#[test]
fn ctrl_c_ends_colmap_and_can_be_continued() {
    let place = Place::new("photos");
    for (stage, features) in [("feature_extractor", 1), ("mapper", 0)] {
        std::fs::remove_file(place.at("fake/pid")).ok();
        let mut command = place.poses(&["photos"]);
        // A separate process group, so that only the program gets the signal.
        command.env("HANG", stage).process_group(0).stdout(Stdio::null()).stderr(Stdio::piped());
        let running = Running::start(&mut command);
        let begin = Instant::now();
        let pid = loop {
            let written = std::fs::read_to_string(place.at("fake/pid")).unwrap_or_default();
            if let Ok(pid) = written.trim().parse::<i32>() {
                break nix::unistd::Pid::from_raw(pid);
            }
            assert!(begin.elapsed() < Duration::from_secs(60), "{stage} does not start");
            std::thread::sleep(Duration::from_millis(20));
        };
        running.interrupt();
        let output = running.finish();
        assert_eq!(output.status.code(), Some(130));
        assert!(nix::sys::signal::kill(pid, None).is_err(), "COLMAP is still there");
        assert!(!place.at("photos_dataset/sparse").exists());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(said.contains("goes on from here"), features == 0, "{said}");
        assert_eq!(place.at("photos_dataset").exists(), features == 0, "nothing is left of nothing");
        place.calls();
    }
    place.succeed(&["photos"]);
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
}

#[test]
fn without_its_gpu_colmap_takes_the_processor() {
    let place = Place::new("photos");
    let run = finish(place.poses(&["photos"]).env("CUDA", "with"));
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(
        run.stderr.contains("failed on the GPU") && run.stderr.contains("on the processor"),
        "{}",
        run.stderr
    );
    let calls = place.calls();
    assert!(calls[0].contains("SiftExtraction.use_gpu 1") && calls[1].contains("SiftExtraction.use_gpu 0"));
    assert!(calls[2].contains("SiftMatching.use_gpu 0"), "{}", calls[2]);
    assert!(calls[1].contains("SiftExtraction.max_image_size 2000"), "{}", calls[1]);
    // Only matching fails on the GPU; a resumed run does not extract features again.
    let place = Place::new("photos");
    let mut command = place.poses(&["photos"]);
    place.fails(command.env("CUDA", "with").env("GPU_FEATURES", "1").env("CRASH", "1"), &["mapping failed"]);
    let stages = ["feature_extractor", "exhaustive_matcher", "exhaustive_matcher", "mapper"];
    assert_eq!(place.stages(), stages);
    let run = finish(place.poses(&["photos"]).env("CUDA", "with").env("GPU_FEATURES", "1"));
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(place.stages(), stages[1..]);
}

#[test]
fn the_sharpest_frames_of_a_video_become_a_data_set() {
    let place = Place::new("unused");
    // One of every four frames is sharp; its grey identifies it.
    let mut frames = Vec::new();
    for index in 0..12u8 {
        let sharp = [1, 6, 11].contains(&index);
        frames.extend(b"P6\n48 32\n255\n");
        let pixel = |at: usize| if sharp && at % 2 == 1 { 255 - 10 * index } else { 10 * index };
        frames.extend((0..48 * 32).flat_map(|at| [pixel(at); 3]));
    }
    std::fs::write(place.at("fake/frames"), frames).expect("written");
    std::fs::write(place.at("my film.mov"), "a film").expect("written");
    let hinted = finish(place.command(env!("CARGO_BIN_EXE_ashsplat")).args([
        "train",
        "-m",
        "out",
        "-s",
        "my film.mov",
    ]));
    assert_eq!(hint(&hinted.stderr), "ashsplat poses 'my film.mov'");
    // The stand-in's model has other names and cannot be used, but the frames exist.
    place.fails(&mut place.poses(&["my film.mov", "--frames", "3"]), &["01.png", "missing"]);
    let folder = place.at("my film_dataset/poses.unfinished/frames");
    assert_eq!(
        files_below(&folder),
        ["frame_00001.jpg", "frame_00002.jpg", "frame_00003.jpg"].map(PathBuf::from)
    );
    for (name, index) in [("frame_00001.jpg", 1u8), ("frame_00002.jpg", 6), ("frame_00003.jpg", 11)] {
        let frame = image::open(folder.join(name)).expect("a JPEG").to_luma8();
        let darkest = frame.pixels().map(|pixel| pixel[0]).min().expect("pixels");
        assert!(darkest.abs_diff(10 * index) < 12, "{name}: {darkest}");
    }
    let calls = place.calls();
    assert!(calls[0].contains("-i file:my film.mov") && calls[1].contains("fps=6.000000"), "{calls:?}");
    // Frames are extracted only once.
    place.fails(&mut place.poses(&["my film.mov", "--frames", "3"]), &["missing"]);
    assert_eq!(place.calls().iter().filter(|call| call.contains("image2pipe")).count(), 0);
    place.fails(
        place.poses(&["my film.mov"]).env("FAIL", "ffmpeg"),
        &["my film.mov: ffmpeg: moov atom not found"],
    );
}

/// A playlist may name files anywhere.
#[test]
fn a_playlist_is_no_video() {
    let place = Place::new("unused");
    std::fs::write(place.at("fake/frames"), "").expect("written");
    for (name, list) in [
        ("walk.m3u8", "#EXTM3U\n#EXTINF:1.0,\n/home/other/film.ts\n"),
        ("walk.mp4", "ffconcat version 1.0\nfile '/home/other/film.mp4'\n"),
    ] {
        std::fs::write(place.at(name), list).expect("written");
        place.fails(&mut place.poses(&[name]), &[name, "playlist", "MP4"]);
        assert!(!place.at("walk_dataset").exists());
    }
}

/// A folder named as unfinished work may belong to anyone. Paths are checked before COLMAP runs for hours.
#[test]
fn what_lies_in_the_data_sets_places_stays() {
    let place = Place::new("photos");
    let keep = "photos_dataset/images/keep.jpg";
    for folder in ["photos_dataset/images", "photos_dataset/poses.unfinished", "elsewhere"] {
        std::fs::create_dir_all(place.at(folder)).expect("a folder");
    }
    std::fs::write(place.at(keep), "mine").expect("written");
    let state = r#"{"frames": null, "features": null, "images": true}"#;
    std::fs::write(place.at("photos_dataset/poses.unfinished/state.json"), state).expect("written");
    place.fails(&mut place.poses(&["photos"]), &["photos_dataset/images", "is there already"]);
    assert!(place.at(keep).exists() && place.stages().is_empty());
    std::fs::remove_dir_all(place.at("photos_dataset")).expect("removed");
    for (name, words) in [("sparse", "a link"), ("images", "a link"), ("poses.log", "is a folder")] {
        std::fs::create_dir_all(place.at("photos_dataset")).expect("a folder");
        match name {
            "poses.log" => std::fs::create_dir(place.at("photos_dataset/poses.log")).expect("a folder"),
            _ => std::os::unix::fs::symlink("../elsewhere", place.at("photos_dataset").join(name))
                .expect("a link"),
        }
        place.fails(&mut place.poses(&["photos"]), &[name, words, "another -o"]);
        assert!(place.stages().is_empty(), "{name}");
        std::fs::remove_dir_all(place.at("photos_dataset")).expect("removed");
    }
}

/// A run is killed before or after one of its final moves.
#[test]
fn a_second_run_completes_what_a_killed_one_was_moving() {
    let place = Place::new("photos");
    place.succeed(&["photos", "--quiet"]);
    let (whole, work) = (files_below(&place.at("photos_dataset")), "photos_dataset/poses.unfinished");
    place.stages();
    for moved in 0..=3 {
        std::fs::create_dir_all(place.at(work).join("ready")).expect("a folder");
        std::fs::write(place.at(work).join("state.json"), "{}").expect("written");
        for name in &["images", "poses.log", "sparse"][moved..] {
            let ready = place.at(work).join("ready").join(name);
            std::fs::rename(place.at("photos_dataset").join(name), ready).expect("moved");
        }
        let [said, _] = place.succeed(&["photos"]);
        assert!(said.contains("photos_dataset: is complete now"), "{said}");
        assert_eq!((files_below(&place.at("photos_dataset")), place.stages().len()), (whole.clone(), 0));
    }
    place.fails(&mut place.poses(&["photos"]), &["photos_dataset/sparse", "is there already"]);
}

#[test]
fn what_is_missing_says_how_to_get_it() {
    let place = Place::new("photos");
    std::fs::write(place.at("film.mp4"), "a film").expect("written");
    for (arguments, words) in [
        (
            ["photos", "--colmap", "no-such-colmap"],
            ["which is not installed", "apt install colmap", "brew install colmap"],
        ),
        (
            ["film.mp4", "--ffmpeg", "no-such-ffmpeg"],
            ["which is not installed", "apt install ffmpeg", "brew install ffmpeg"],
        ),
        (["photos", "--colmap", "/bin/cat"], ["feature_extractor", "apt install colmap", "--colmap"]),
    ] {
        let run = finish(&mut place.poses(&arguments));
        assert_refused(&run, &words);
    }
    assert!(!place.at("photos_dataset").exists() && !place.at("film_dataset").exists());
    let small = Photo { width: 2, height: 2, rgb: vec![0; 12] };
    small.write_png(place.at("photos/00.png")).expect("written");
    // A photo of another size gets its own camera.
    place.succeed(&["photos", "--quiet"]);
    assert_eq!(place.stages(), ["feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"]);
    place.fails(&mut place.poses(&["photos", "-o", "b", "--cameras", "one"]), &["--cameras", "2x2", "48x32"]);
    assert!(!place.at("b").exists());
    // All photographs are damaged.
    for photo in std::fs::read_dir(place.at("photos")).expect("photographs") {
        std::fs::write(photo.expect("a photograph").path(), "no photograph").expect("written");
    }
    assert_refused(&finish(&mut place.poses(&["photos", "-o", "c"])), &["photos/0", ".png"]);
    assert!(!place.at("c").exists());
}
