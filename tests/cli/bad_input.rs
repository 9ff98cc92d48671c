//! Bad input of every kind: one line names the problem, the exit code is 2, and nothing is half-written.

use super::*;
use ashsplat_files::PhotoFileFormat;
use tempfile::{TempDir, tempdir};

/// A data set that a test may damage, and a folder for results.
struct Place {
    folder: TempDir,
}

impl Place {
    fn new() -> Place {
        let folder = tempdir().expect("a temporary folder");
        write_dataset(&folder.path().join("data"));
        Place { folder }
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    /// Runs a training that must refuse before it writes anything.
    fn training_refuses(&self, words: &[&str]) {
        refuse(&["train", "-s", text(&self.data()), "-m", text(&self.out()), "--quiet"], words);
        assert!(!self.out().exists(), "{:?}", files_below(&self.out()));
    }
}

#[test]
fn missing_folder() {
    let place = Place::new();
    std::fs::remove_dir_all(place.data()).expect("removed");
    place.training_refuses(&[text(&place.data())]);
}

#[test]
fn empty_folder() {
    let place = Place::new();
    std::fs::remove_dir_all(place.data()).expect("removed");
    std::fs::create_dir(place.data()).expect("created");
    place.training_refuses(&[text(&place.data()), "sparse"]);
}

#[test]
fn no_images_registered() {
    let place = Place::new();
    write_model(&place.data(), &[], &wall_points());
    place.training_refuses(&["images.bin", "no images are registered"]);
}

#[test]
fn photo_missing() {
    let place = Place::new();
    std::fs::remove_file(place.data().join("images/04.png")).expect("removed");
    place.training_refuses(&["04.png", "missing"]);
    let run = finish(program().args(["info", text(&place.data())]));
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stdout.contains("9 registered, 8 sound photos"), "{}", run.stdout);
}

#[test]
fn photo_of_another_size() {
    let place = Place::new();
    let small = Photo { width: 2, height: 2, rgb: vec![0; 12] };
    small.write_png(place.data().join("images/05.png")).expect("written");
    place.training_refuses(&["05.png", "2x2", "48x32"]);
}

/// The cameras give the photos' sizes, so these photos are refused without being decoded. They are not even
/// pictures.
#[test]
fn photos_that_cannot_be_trained_on_are_refused_before_they_are_read() {
    let place = Place::new();
    let lens = Intrinsics::from_fov_x(0.8, 60_000, 50_000);
    let lenses = [view(0), Camera::look_at(vec3(0.0, 0.0, -2.5), Vec3::ZERO, Vec3::NEG_Y, lens)];
    let lenses: Vec<_> = (1..).zip(&lenses).map(|(id, camera)| ColmapCamera::pinhole(id, camera)).collect();
    let posed = |id: u32| {
        let lens = if id == 4 || id == 7 { 2 } else { 1 };
        ColmapImage::posed(id, lens, format!("{id:02}.png"), &view(id - 1))
    };
    let images: Vec<_> = (1..=VIEWS).map(posed).collect();
    colmap::write(place.data().join("sparse/0"), &lenses, &images, &wall_points()).expect("a model");
    for name in ["04.png", "07.png"] {
        std::fs::write(place.data().join("images").join(name), "no photo").expect("written");
    }
    let (data, out) = (place.data(), place.out());
    let arguments = ["train", "-s", text(&data), "-m", text(&out), "--quiet", "-r"];
    let words = ["'04.png' of 60000x50000 pixels and 1 other (", "-r ", "48000000000 bytes"];
    refuse(&[&arguments[..], &["1"]].concat(), &words);
    // Small enough for memory: now threads read them, and either may be refused first.
    refuse(&[&arguments[..], &["50"]].concat(), &[".png: is not a JPEG or PNG"]);
    assert!(!out.exists());
}

#[test]
fn zero_points_are_refused_unless_random_ones_are_wanted() {
    let place = Place::new();
    let images: Vec<_> =
        (1..=VIEWS).map(|id| ColmapImage::posed(id, 1, format!("{id:02}.png"), &view(id - 1))).collect();
    write_model(&place.data(), &images, &PointCloud::default());
    place.training_refuses(&["no points", "--random-points"]);
    let (data, out) = (place.data(), place.out());
    let told = succeed(&["info", text(&data)]);
    assert!(told.contains("next ") && told.trim_end().ends_with(" --eval --random-points"), "{told}");
    let run = finish(program().args([
        "train",
        "-s",
        text(&data),
        "-m",
        text(&out),
        "--iterations",
        "1",
        "--random-points",
        "--few-photos",
        "off",
        "--quiet",
    ]));
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(run.stderr.starts_with("warning: ") && run.stderr.contains("random"), "{}", run.stderr);
    // Photos without texture give no points: the points are random, and a warning says so.
    for photo in std::fs::read_dir(data.join("images")).expect("photos") {
        let flat = Photo { width: 48, height: 32, rgb: vec![90; 3 * 48 * 32] };
        flat.write_png(photo.expect("a photo").path()).expect("written");
    }
    let run = finish(program().args([
        "train",
        "-s",
        text(&data),
        "-m",
        text(&place.out()),
        "--iterations",
        "1",
        "--photo-points",
        "--quiet",
    ]));
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    for words in ["points only, too few to start from", "100000 random ones stand in"] {
        assert!(run.stderr.contains(words), "{}", run.stderr);
    }
}

#[test]
fn zero_points_of_a_textured_scene_are_found_in_its_photos() {
    let folder = tempdir().expect("a temporary folder");
    let [dataset, model] = ["demo", "model"].map(|name| folder.path().join(name));
    succeed(&["demo", "--out", text(&dataset), "--dataset-only", "--quiet"]);
    let dataset = dataset.join("dataset");
    colmap_without_points(&dataset);
    let train = ["train", "-s", text(&dataset), "-m", text(&model), "-r", "4"];
    let short = ["--iterations", "2", "--random-points"];
    let found = "no points to start from; 20,000 at which the photos agree stand in for them";
    for (arguments, finds) in [
        (&["--strategy", "budget"][..], true),
        (&[], false),
        (&["--photo-points", "--checkpoint-iterations", "1"], true),
    ] {
        let run = finish(program().args([&train[..], &short, arguments].concat()));
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        assert_eq!(run.stderr.contains(found), finds, "{arguments:?}: {}", run.stderr);
        assert_eq!(run.stderr.contains("random ones stand in"), !finds, "{arguments:?}: {}", run.stderr);
    }
    // A resumed training needs no points.
    let settings = model.join("settings.toml");
    let run = finish(program().args(["train", "--config", text(&settings), "--start-checkpoint", "latest"]));
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(!run.stderr.contains("no points"), "{}", run.stderr);
}

/// Removes the points from a binary model.
fn colmap_without_points(dataset: &Path) {
    std::fs::write(dataset.join("sparse/0/points3D.bin"), 0_u64.to_le_bytes()).expect("written");
}

#[test]
fn ply_is_an_lfs_pointer() {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ply");
    let pointer =
        format!("version https://git-lfs.github.com/spec/v1\noid sha256:{}\nsize 12345\n", "0".repeat(64));
    std::fs::write(&path, pointer).expect("written");
    let out = folder.path().join("out");
    refuse(&["info", text(&path)], &["scene.ply", "LFS", "git lfs pull"]);
    refuse(&["render", text(&path), "--orbit", "1", "-o", text(&out)], &["scene.ply", "LFS"]);
    assert!(!out.exists());
}

/// The program must not wait for a pipe or read a device without end.
#[cfg(unix)]
#[test]
fn pipes_and_devices_are_no_files() {
    let place = Place::new();
    let at = |name: &str| place.folder.path().join(name);
    let (data, out, scene, pipe) = (place.data(), place.out(), at("scene.ply"), at("pipe"));
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    ashsplat_files::splats::write(&scene, &gaussians, &Default::default()).expect("written");
    let make_pipe = |path: &Path| nix::unistd::mkfifo(path, nix::sys::stat::Mode::S_IRWXU).expect("a pipe");
    let refuse = |arguments: &[&str], words: &[&str]| {
        let mut limited = std::process::Command::new("timeout");
        assert_refused(&finish(limited.arg("20").arg(program().get_program()).args(arguments)), words);
    };
    make_pipe(&pipe);
    let (data, out, scene) = (text(&data), text(&out), text(&scene));
    let converted = at("converted.ply");
    let ply = text(&converted);
    for file in [text(&pipe), "/dev/zero"] {
        let job = format!("{file}:1");
        let commands: [&[&str]; 12] = [
            &["info", file],
            &["convert", file, ply],
            &["view", file, "--port", "0"],
            &["render", scene, "--path", file, "-o", out],
            &["inspect", scene, "--pixel", "1,1", "--path", file],
            &["train", "-s", data, "-m", out, "--config", file],
            &["train", "-s", data, "-m", out, "--start-checkpoint", file],
            &["train", "--job", &job],
            &["blocks", file],
            &["exchange", file],
            &["merge", file, "-o", ply],
            &["eval", scene, "-s", data, "--lpips-weights", file],
        ];
        for arguments in commands {
            refuse(arguments, &[file, "is not a file but a device or a pipe"]);
        }
    }
    let photo = at("data/images/04.png");
    std::fs::remove_file(&photo).expect("removed");
    make_pipe(&photo);
    refuse(&["train", "-s", data, "-m", out, "--quiet"], &["04.png", "missing"]);
}

#[test]
fn parameters_that_are_not_finite() {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.ply");
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    gaussians.means[7][1] = f32::NAN;
    gaussians.log_scales[9][0] = f32::INFINITY;
    // Opacities 1 and 0 occur in real files.
    gaussians.opacity_logits[1] = f32::INFINITY;
    gaussians.opacity_logits[2] = f32::NEG_INFINITY;
    ashsplat_files::ply::write(&path, &gaussians).expect("written");
    refuse(&["info", text(&path)], &["scene.ply", "2", "--drop-invalid"]);
    let report: serde_json::Value =
        serde_json::from_str(&succeed(&["info", text(&path), "--drop-invalid", "--json"])).expect("JSON");
    assert_eq!((report["gaussians"].as_u64(), report["dropped"].as_u64()), (Some(398), Some(2)));
}

#[test]
fn unknown_device() {
    let place = Place::new();
    let (data, out) = (place.data(), place.out());
    refuse(
        &["train", "-s", text(&data), "-m", text(&out), "--device", "no such card"],
        &["'no such card'", "there are: 0 '"],
    );
    assert!(!out.exists());
    // The device is checked before the photos.
    std::fs::write(data.join("images/05.png"), "no photo").expect("written");
    let ask =
        |command: &[&str]| refuse(&[command, &["--device", "no such card"]].concat(), &["'no such card'"]);
    ask(&["train", "-s", text(&data), "-m", text(&out)]);
    ask(&["bench", "train-step", "--dataset", text(&data)]);
    ask(&["profile", "train-step", "--dataset", text(&data)]);
    assert!(!out.exists());
}

#[test]
fn no_driver() {
    let mut command = program();
    command
        .args(["devices"])
        .env("VK_DRIVER_FILES", "/nowhere.json")
        .env("VK_ICD_FILENAMES", "/nowhere.json");
    assert_refused(&finish(&mut command), &["Vulkan", "driver"]);
}

/// A file with the loader's name that is no library, found before the real one.
#[cfg(target_os = "linux")]
#[test]
fn no_loader() {
    let folder = tempdir().expect("a temporary folder");
    for name in ["libvulkan.so.1", "libvulkan.so"] {
        std::fs::write(folder.path().join(name), "").expect("written");
    }
    let run = finish(program().args(["devices"]).env("LD_LIBRARY_PATH", folder.path()));
    assert_refused(&run, &["no Vulkan loader", "libvulkan1"]);
}

#[test]
fn unwritable_output() {
    let place = Place::new();
    std::fs::write(place.out(), "a file, not a folder").expect("written");
    let model = place.out().join("model");
    refuse(
        &["train", "-s", text(&place.data()), "-m", text(&model), "--quiet"],
        &[text(&model), "cannot create"],
    );
    assert_eq!(std::fs::read_to_string(place.out()).expect("still there"), "a file, not a folder");
}

/// The system refuses files above a size, like a full disk. Every existing file stays whole, and no temporary file
/// is left.
#[cfg(unix)]
#[test]
fn disk_full_while_saving() {
    let place = Place::new();
    // Only the point cloud exceeds the limit (blocks of 512 or 1024 bytes, depending on the shell).
    let images: Vec<_> =
        (1..=VIEWS).map(|id| ColmapImage::posed(id, 1, format!("{id:02}.png"), &view(id - 1))).collect();
    let cloud = wall_points();
    let many = PointCloud { positions: cloud.positions.repeat(10), colors: cloud.colors.repeat(10) };
    write_model(&place.data(), &images, &many);
    let script = "trap '' XFSZ; ulimit -f 16; exec \"$@\"";
    let mut command = Command::new("sh");
    command.args([
        "-c",
        script,
        "sh",
        env!("CARGO_BIN_EXE_ashsplat"),
        "train",
        "--quiet",
        "--iterations",
        "1",
    ]);
    command.args(["-s", text(&place.data()), "-m", text(&place.out())]);
    assert_refused(&finish(&mut command), &["input.ply", "cannot write"]);
    let left = files_below(&place.out());
    assert!(left.iter().all(|file| !file.to_string_lossy().contains("tmp")), "{left:?}");
    assert!(!left.contains(&PathBuf::from("input.ply")), "{left:?}");
    let cameras = std::fs::read_to_string(place.out().join("cameras.json")).expect("cameras.json");
    serde_json::from_str::<serde_json::Value>(&cameras).expect("whole");
}

#[test]
fn mistakes_on_the_command_line() {
    refuse(&[], &["no command"]);
    refuse(&["train"], &["--source-path"]);
    refuse(&["train", "-s", "somewhere"], &["--model-path"]);
    refuse(&["train", "-s", "a", "-m", "b", "--sh_degree", "5"], &["sh_degree", "5"]);
    refuse(&["train", "-s", "a", "-m", "b", "--iterations", "many"], &["many"]);
    refuse(&["train", "-s", "a", "-m", "b", "--resolution", "3"], &["resolution", "3"]);
    refuse(&["inspect", "scene.ply", "--pixel", "420"], &["420"]);
    refuse(&["train", "-s", "a", "-m", "b", "--config", "/nowhere.toml"], &["/nowhere.toml"]);
}
