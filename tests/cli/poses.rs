//! `ashsplat poses` with stand-ins for COLMAP and ffmpeg, and the hints that name it.

use super::*;
use std::borrow::BorrowMut;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::CommandExt;

/// A folder with photographs without cameras, and the model that the stand-in produces.
struct Photographs(TestFolder);

impl Photographs {
    /// `photographs`: folder for the photographs.
    fn new(photographs: &str) -> Self {
        let place = TestFolder::new();
        place.create_folder("fake");
        place.rename("data/sparse/0", "fake/model");
        place.create_folder(Path::new(photographs).parent().expect("a parent"));
        place.rename("data/images", photographs);
        place.remove("data");
        Self(place)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.at(name)
    }

    /// A command in this folder with the stand-ins and the program in its PATH.
    fn command(&self, program: &str) -> Command {
        let tools = crate::common::root().join("tests/cli/poses");
        let own = Path::new(env!("CARGO_BIN_EXE_ashsplat")).parent().expect("a folder");
        let path =
            std::env::join_paths([&tools, own, Path::new("/usr/bin"), Path::new("/bin")]).expect("a path");
        let mut command = Command::new(program);
        command.current_dir(self.at("")).env("PATH", path).env("FAKE", self.at("fake"));
        command.env("ASHSPLAT_PIPELINE_CACHE", "");
        command
    }

    /// The program with a command line, not yet started.
    fn ashsplat(&self, line: &str) -> Command {
        let mut command = self.command(env!("CARGO_BIN_EXE_ashsplat"));
        command.args(line.split_whitespace());
        command
    }

    fn run(&self, line: &str) -> Finished {
        finish(&mut self.ashsplat(line))
    }

    /// Runs a command that must fail with these words in its last line.
    #[track_caller]
    fn fails(&self, mut command: impl BorrowMut<Command>, words: &[&str]) {
        let run = finish(command.borrow_mut()).fails(words);
        assert_eq!(run.stdout, "");
    }

    fn calls(&self) -> Vec<String> {
        let calls = std::fs::read_to_string(self.at("fake/calls")).unwrap_or_default();
        std::fs::remove_file(self.at("fake/calls")).ok();
        calls.lines().filter(|call| !call.ends_with(" -h")).map(str::to_owned).collect()
    }

    fn stages(&self) -> Vec<String> {
        self.calls().iter().filter_map(|call| call.split(' ').next().map(str::to_owned)).collect()
    }
}

fn hint(message: &str) -> &str {
    message.split('`').nth(1).unwrap_or_else(|| panic!("no command in {message}"))
}

/// A user with photographs runs a command, and then the command that it prints.
#[test]
fn hints_work_as_they_are_printed() {
    let place = Photographs::new("my photos");
    for line in ["info", "train -m out -s"] {
        let run = finish(place.ashsplat(line).arg("my photos"));
        assert_eq!((run.code, hint(&run.stderr)), (Some(2), "ashsplat poses 'my photos'"));
    }
    let type_it = |line: &str| finish(place.command("sh").args(["-c", line])).ok();
    let said = type_it("ashsplat poses 'my photos'").says(&["registered      9 of 9 photographs"]);
    let said = said.warns(&["features ", "matches ", "mapping ", " s: 1 camera (SIMPLE_RADIAL)"]);
    let next = |what: &str| {
        let line = said.stdout.lines().find_map(|line| line.strip_prefix(what)).expect("printed");
        line.trim().to_owned()
    };
    let checked = type_it(&next("check it")).says(&["9 registered, 9 sound photos"]).stdout;
    let train = checked.lines().find_map(|line| line.strip_prefix("next      it can be trained on: "));
    assert_eq!(train, Some(&*next("train")));
    type_it(&format!("{} --iterations 1 --quiet", next("train")));
    assert!(place.at(&point_cloud("out/my photos", 1)).is_file());
    assert_eq!(next("look at it"), "ashsplat view 'out/my photos'");
}

#[test]
fn photographs_stay_and_are_linked() {
    let place = Photographs::new("photos");
    place.run("poses photos --quiet").ok();
    let photos: Vec<String> = (0..VIEWS).map(photo_name).collect();
    let mut expected: Vec<String> = photos.iter().map(|name| format!("images/{name}")).collect();
    let others = ["poses.log", "sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"];
    expected.extend(others.map(str::to_owned));
    assert_eq!(place.0.files("photos_dataset"), expected.iter().map(PathBuf::from).collect::<Vec<_>>());
    let inode = |name: &str| place.at(name).metadata().expect("there").ino();
    assert_eq!(inode("photos/01.png"), inode("photos_dataset/images/01.png"));
    assert_eq!(place.0.files("photos").len(), 9);
    assert!(place.0.read_text("fake/photographs").lines().eq(photos));
    let calls = place.calls();
    assert_eq!(calls.len(), 3);
    assert!(calls[0].starts_with("feature_extractor ") && calls[1].starts_with("exhaustive_matcher "));
    assert_says(&calls[0], &["single_camera 1"]);
    assert_says(&calls[1], &["SiftMatching.use_gpu 0"]);
    place.fails(place.ashsplat("poses photos"), &["photos_dataset/sparse: is there already", "another -o"]);
    place.fails(place.ashsplat("poses photos --every 2"), &["--every", "for videos"]);
    place.run("poses photos -o other --matcher sequential --cameras each").ok();
    let calls = place.calls();
    assert!(calls[0].contains("single_camera 0") && calls[1].starts_with("sequential_matcher "), "{calls:?}");
}

#[test]
fn a_damaged_photograph_is_left_out() {
    let place = Photographs::new("photos");
    let damaged = ["05a.jpg", "05b.jpg"];
    for name in damaged {
        place.0.write(format!("photos/{name}"), "no JPEG");
    }
    let run = place.run("poses photos --quiet").ok().says(&["registered      9 of 9 photographs"]);
    assert_eq!(run.stderr.lines().count(), damaged.len(), "{}", run.stderr);
    for (line, name) in run.stderr.lines().zip(damaged) {
        assert!(line.starts_with(&format!("warning: left out: photos/{name}: ")), "{line}");
        assert!(!place.at("photos_dataset/images").join(name).exists());
    }
    place.0.write("few/01.png", place.0.read("photos/01.png"));
    place.fails(place.ashsplat("poses few"), &["has 1 photograph, too few"]);
    for name in ["few/02.jpg", "few/03.jpg"] {
        place.0.write(name, "no JPEG");
    }
    // Too few photographs remain without them.
    place.fails(place.ashsplat("poses few"), &["few/02.jpg", "(and 1 more)"]);
}

#[test]
fn photographs_in_a_data_set_are_used_where_they_are() {
    let place = Photographs::new("scene/images");
    place.run("poses scene --quiet").ok();
    assert!(place.0.has("scene/sparse/0/images.bin") && place.0.has("scene/images/01.png"));
    assert_eq!(std::fs::read_dir(place.at("scene")).expect("a folder").count(), 3);
    place.fails(place.ashsplat("poses scene"), &["has cameras already", "`ashsplat train -s scene`"]);
    // An output folder without subfolders works, and its photos are counted right.
    let flat = Photographs::new("flat");
    flat.run("poses flat -o flat --quiet").ok();
    assert!(flat.0.has("flat/sparse/0/images.bin") && !flat.0.has("flat/images"));
    flat.run("info flat").says(&["9 registered, 9 sound photos"]);
    // Folders beside the photographs are ignored, but another photograph counts.
    let photo = flat.0.read("flat/01.png");
    flat.0.write("flat/thumbnails/01.png", &photo);
    flat.0.write("flat/stereo/deep/01.png", &photo);
    let info = flat.run("info flat");
    assert!(!info.stdout.contains("warning"), "{}", info.stdout);
    flat.0.write("flat/99.png", &photo);
    // COLMAP has already compared all of them.
    let words = ["only 9 of its 10 photos have a camera", "all were compared with each other"];
    flat.run("info flat").says(&words);
    flat.run("info flat --images .").says(&["9 registered", "9 of its 10 photos"]);
}

#[test]
fn failures_name_the_log_and_a_second_run_continues() {
    let place = Photographs::new("photos");
    let log = "photos_dataset/poses.unfinished/poses.log";
    let failing = |stage: &str| {
        let mut command = place.ashsplat("poses photos");
        command.env("FAIL", stage);
        command
    };
    let said = "something went before / ERROR: it failed";
    place.fails(failing("feature_extractor"), &["COLMAP", said, log]);
    place.fails(failing("mapper"), &["mapping failed", log]);
    assert_eq!(place.stages(), ["feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"]);
    let info = place.run("info photos_dataset").warns(&["run the same `ashsplat poses` once more"]);
    assert_eq!(info.code, Some(2));
    let words = ["none of the 9 photographs", "more photographs", "overlapping", log];
    place.fails(failing("mapper").env("WORDS", "failed to create sparse model"), &words);
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
    // Another camera model needs other features.
    place.fails(failing("mapper").args(["--camera-model", "OPENCV"]), &["mapping failed"]);
    assert_eq!(place.stages(), ["feature_extractor", "exhaustive_matcher", "mapper"]);
    // A larger model might have followed.
    let mut killed = place.ashsplat("poses photos --camera-model OPENCV");
    place.fails(killed.env("CRASH", "1"), &["mapping failed", log]);
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
    place.run("poses photos --camera-model OPENCV").ok();
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
    assert!(!place.0.has("photos_dataset/poses.unfinished"));
}

#[test]
fn ctrl_c_ends_colmap_and_can_be_continued() {
    let place = Photographs::new("photos");
    for (stage, features) in [("feature_extractor", 1), ("mapper", 0)] {
        std::fs::remove_file(place.at("fake/pid")).ok();
        let mut command = place.ashsplat("poses photos");
        // A separate process group, so that only the program gets the signal.
        command.env("HANG", stage).process_group(0).stdout(Stdio::null()).stderr(Stdio::piped());
        let running = Running::start(&mut command);
        let mut pid = None;
        wait_until("COLMAP does not start", || {
            let written = std::fs::read_to_string(place.at("fake/pid")).unwrap_or_default();
            pid = written.trim().parse().ok().map(nix::unistd::Pid::from_raw);
            pid.is_some()
        });
        running.interrupt();
        let Finished { code, stderr, .. } = running.finish().into();
        assert_eq!(code, Some(130));
        assert!(nix::sys::signal::kill(pid.expect("started"), None).is_err(), "COLMAP is still there");
        assert!(!place.0.has("photos_dataset/sparse"));
        assert_eq!(stderr.contains("goes on from here"), features == 0, "{stderr}");
        assert_eq!(place.0.has("photos_dataset"), features == 0, "nothing is left of nothing");
        place.calls();
    }
    place.run("poses photos").ok();
    assert_eq!(place.stages(), ["exhaustive_matcher", "mapper"]);
}

#[test]
fn without_its_gpu_colmap_takes_the_processor() {
    let place = Photographs::new("photos");
    let run = finish(place.ashsplat("poses photos").env("CUDA", "with")).ok();
    run.warns(&["failed on the GPU", "on the processor"]);
    let calls = place.calls();
    assert_says(&calls[0], &["SiftExtraction.use_gpu 1"]);
    assert_says(&calls[1], &["SiftExtraction.use_gpu 0", "SiftExtraction.max_image_size 2000"]);
    assert_says(&calls[2], &["SiftMatching.use_gpu 0"]);
    // Only matching fails on the GPU; a resumed run does not extract features again.
    let place = Photographs::new("photos");
    let mut command = place.ashsplat("poses photos");
    command.env("CUDA", "with").env("GPU_FEATURES", "1");
    place.fails(command.env("CRASH", "1"), &["mapping failed"]);
    let stages = ["feature_extractor", "exhaustive_matcher", "exhaustive_matcher", "mapper"];
    assert_eq!(place.stages(), stages);
    finish(command.env_remove("CRASH")).ok();
    assert_eq!(place.stages(), stages[1..]);
}

#[test]
fn the_sharpest_frames_of_a_video_become_a_data_set() {
    let place = Photographs::new("unused");
    // One of every four frames is sharp; its grey identifies it.
    let mut frames = Vec::new();
    for index in 0..12u8 {
        let sharp = [1, 6, 11].contains(&index);
        frames.extend(b"P6\n48 32\n255\n");
        let pixel = |at: usize| if sharp && at % 2 == 1 { 255 - 10 * index } else { 10 * index };
        frames.extend((0..48 * 32).flat_map(|at| [pixel(at); 3]));
    }
    place.0.write("fake/frames", frames);
    place.0.write("my film.mov", "a film");
    let hinted = finish(place.ashsplat("train -m out -s").arg("my film.mov"));
    assert_eq!(hint(&hinted.stderr), "ashsplat poses 'my film.mov'");
    // The stand-in's model has other names and cannot be used, but the frames exist.
    let poses = |more: &str| {
        let mut command = place.ashsplat("poses");
        command.arg("my film.mov").args(more.split_whitespace());
        command
    };
    place.fails(poses("--frames 3"), &["01.png", "missing"]);
    let folder = "my film_dataset/poses.unfinished/frames";
    let kept = [("frame_00001.jpg", 1_u8), ("frame_00002.jpg", 6), ("frame_00003.jpg", 11)];
    assert_eq!(place.0.files(folder), kept.map(|(name, _)| PathBuf::from(name)));
    for (name, index) in kept {
        let frame = image::open(place.at(folder).join(name)).expect("a JPEG").to_luma8();
        let darkest = frame.pixels().map(|pixel| pixel[0]).min().expect("pixels");
        assert!(darkest.abs_diff(10 * index) < 12, "{name}: {darkest}");
    }
    let calls = place.calls();
    assert!(calls[0].contains("-i file:my film.mov") && calls[1].contains("fps=6.000000"), "{calls:?}");
    // Frames are extracted only once.
    place.fails(poses("--frames 3"), &["missing"]);
    assert_eq!(place.calls().iter().filter(|call| call.contains("image2pipe")).count(), 0);
    place.fails(poses("").env("FAIL", "ffmpeg"), &["my film.mov: ffmpeg: moov atom not found"]);
}

/// A playlist may name files anywhere.
#[test]
fn a_playlist_is_no_video() {
    let place = Photographs::new("unused");
    place.0.write("fake/frames", "");
    for (name, list) in [
        ("walk.m3u8", "#EXTM3U\n#EXTINF:1.0,\n/home/other/film.ts\n"),
        ("walk.mp4", "ffconcat version 1.0\nfile '/home/other/film.mp4'\n"),
    ] {
        place.0.write(name, list);
        place.fails(place.ashsplat(&format!("poses {name}")), &[name, "playlist", "MP4"]);
        assert!(!place.0.has("walk_dataset"));
    }
}

/// A folder named as unfinished work may belong to anyone. Paths are checked before COLMAP runs for hours.
#[test]
fn what_lies_in_the_data_sets_places_stays() {
    let place = Photographs::new("photos");
    place.0.create_folder("elsewhere");
    place.0.write("photos_dataset/images/keep.jpg", "mine");
    let state = r#"{"frames": null, "features": null, "images": true}"#;
    place.0.write("photos_dataset/poses.unfinished/state.json", state);
    let refused = |words: &[&str]| {
        place.fails(place.ashsplat("poses photos"), words);
        assert!(place.stages().is_empty(), "{words:?}");
    };
    refused(&["photos_dataset/images", "is there already"]);
    assert!(place.0.has("photos_dataset/images/keep.jpg"));
    for (name, words) in [("sparse", "a link"), ("images", "a link"), ("poses.log", "is a folder")] {
        place.0.remove("photos_dataset");
        place.0.create_folder("photos_dataset");
        let path = place.at("photos_dataset").join(name);
        match name {
            "poses.log" => std::fs::create_dir(path).expect("a folder"),
            _ => std::os::unix::fs::symlink("../elsewhere", path).expect("a link"),
        }
        refused(&[name, words, "another -o"]);
    }
}

/// A run is killed before or after one of its final moves.
#[test]
fn a_second_run_completes_what_a_killed_one_was_moving() {
    let place = Photographs::new("photos");
    place.run("poses photos --quiet").ok();
    let whole = place.0.files("photos_dataset");
    place.stages();
    for moved in 0..=3 {
        let work = Path::new("photos_dataset/poses.unfinished");
        place.0.create_folder(work.join("ready"));
        place.0.write(work.join("state.json"), "{}");
        for name in &["images", "poses.log", "sparse"][moved..] {
            place.0.rename(Path::new("photos_dataset").join(name), work.join("ready").join(name));
        }
        place.run("poses photos").ok().says(&["photos_dataset: is complete now"]);
        assert_eq!(place.0.files("photos_dataset"), whole);
        assert!(place.stages().is_empty());
    }
    place.fails(place.ashsplat("poses photos"), &["photos_dataset/sparse", "is there already"]);
}

#[test]
fn what_is_missing_says_how_to_get_it() {
    let place = Photographs::new("photos");
    place.0.write("film.mp4", "a film");
    let missing = "which is not installed";
    for (line, words) in [
        ("photos --colmap no-such-colmap", [missing, "apt install colmap", "brew install colmap"]),
        ("film.mp4 --ffmpeg no-such-ffmpeg", [missing, "apt install ffmpeg", "brew install ffmpeg"]),
        ("photos --colmap /bin/cat", ["feature_extractor", "apt install colmap", "--colmap"]),
    ] {
        place.run(&format!("poses {line}")).refused(&words);
    }
    assert!(!place.0.has("photos_dataset") && !place.0.has("film_dataset"));
    let small = Photo { width: 2, height: 2, rgb: vec![0; 12] };
    small.write_png(place.at("photos/00.png")).expect("written");
    // A photo of another size gets its own camera.
    place.run("poses photos --quiet").ok();
    assert_eq!(place.stages(), ["feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"]);
    place.fails(place.ashsplat("poses photos -o b --cameras one"), &["--cameras", "2x2", "48x32"]);
    // All photographs are damaged.
    for photo in place.0.files("photos") {
        place.0.write(Path::new("photos").join(photo), "no photograph");
    }
    place.run("poses photos -o c").refused(&["photos/0", ".png"]);
    assert!(!place.0.has("b") && !place.0.has("c"));
}
