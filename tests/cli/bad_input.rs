//! Bad input of every kind: one line names the problem, the exit code is 2, and nothing is half-written.

use super::*;

impl TestFolder {
    /// Runs a training that must refuse before it writes anything.
    fn training_refuses(&self, words: &[&str]) {
        self.run("train -s @data -m @out --quiet").refused(words);
        assert!(!self.has("out"), "{:?}", self.files("out"));
    }
}

#[test]
fn data_sets_that_lack_something() {
    let place = TestFolder::empty();
    let data = place.at("data");
    place.training_refuses(&[text(&data)]);
    place.create_folder("data");
    place.training_refuses(&[text(&data), "sparse"]);
    write_dataset(&data);
    let small = Photo { width: 2, height: 2, rgb: vec![0; 12] };
    small.write_png(data.join("images/05.png")).expect("written");
    place.training_refuses(&["05.png", "2x2", "48x32"]);
    write_dataset(&data);
    place.remove("data/images/04.png");
    place.training_refuses(&["04.png", "missing"]);
    let run = place.run("info @data").says(&["9 registered, 8 sound photos"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    write_model(&data, &[], &wall_points());
    place.training_refuses(&["images.bin", "no images are registered"]);
}

/// The cameras give the photos' sizes, so these photos are refused without being decoded. They are not even
/// pictures.
#[test]
fn photos_that_cannot_be_trained_on_are_refused_before_they_are_read() {
    let place = TestFolder::new();
    let lens = Intrinsics::from_fov_x(0.8, 60_000, 50_000);
    let lenses = [view(0), Camera::look_at(vec3(0.0, 0.0, -2.5), Vec3::ZERO, Vec3::NEG_Y, lens)];
    let lenses: Vec<_> = (1..).zip(&lenses).map(|(id, camera)| ColmapCamera::pinhole(id, camera)).collect();
    let mut images = images();
    for index in [3, 6] {
        images[index].camera_id = 2;
        place.write(format!("data/images/{}", images[index].name), "no photo");
    }
    colmap::write(place.at("data/sparse/0"), &lenses, &images, &wall_points()).expect("a model");
    let words = ["'04.png' of 60000x50000 pixels and 1 other (", "-r ", "48000000000 bytes"];
    place.run("train -s @data -m @out --quiet -r 1").refused(&words);
    // Small enough for memory: now threads read them, and either may be refused first.
    place.run("train -s @data -m @out --quiet -r 50").refused(&[".png: is not a JPEG or PNG"]);
    assert!(!place.has("out"));
}

#[test]
fn zero_points_are_refused_unless_random_ones_are_wanted() {
    let place = TestFolder::new();
    write_model(&place.at("data"), &images(), &PointCloud::default());
    place.training_refuses(&["no points", "--random-points"]);
    let output = place.run("info @data").ok().stdout;
    assert!(output.contains("next ") && output.trim_end().ends_with(" --eval --random-points"), "{output}");
    let train = "train -s @data -m @out --iterations 1 --quiet --strategy reference";
    let run = place.run(format!("{train} --random-points")).ok();
    assert!(run.stderr.starts_with("warning: ") && run.stderr.contains("random"), "{}", run.stderr);
    // Photos without texture give no points: the points are random, and a warning says so.
    for index in 0..VIEWS {
        let flat = Photo { width: 48, height: 32, rgb: vec![90; 3 * 48 * 32] };
        flat.write_png(place.at("data/images").join(photo_name(index))).expect("written");
    }
    let words = ["points only, too few to start from", "100000 random ones stand in"];
    place.run(format!("{train} --photo-points")).ok().warns(&words);
}

#[test]
fn zero_points_of_a_textured_scene_are_found_in_its_photos() {
    let place = TestFolder::with_demo();
    place.write("demo/sparse/0/points3D.bin", 0_u64.to_le_bytes());
    let found = "no points to start from; 20,000 at which the photos agree stand in for them";
    for options in ["", "--strategy reference --photo-points --checkpoint-iterations 1"] {
        let train = "train -s @demo -m @model -r 4 --iterations 2 --random-points";
        let said = place.run(format!("{train} {options}")).ok().stderr;
        assert!(said.contains(found) && !said.contains("random ones stand in"), "{options}: {said}");
    }
    // A resumed training needs no points.
    let run = place.run("train --config @model/settings.toml --start-checkpoint latest").ok();
    assert!(!run.stderr.contains("no points"), "{}", run.stderr);
}

/// The program must not wait for a pipe or read a device without end.
#[cfg(unix)]
#[test]
fn pipes_and_devices_are_no_files() {
    let place = TestFolder::new();
    place.write_scene("scene.ply", &wall(0));
    let make_pipe =
        |name: &str| nix::unistd::mkfifo(&place.at(name), nix::sys::stat::Mode::S_IRWXU).expect("a pipe");
    let refuse = |line: &str, words: &[&str]| {
        let mut limited = Command::new("timeout");
        finish(limited.arg("20").arg(program().get_program()).args(place.words(line))).refused(words);
    };
    make_pipe("pipe");
    for file in ["@pipe", "/dev/zero"] {
        for line in [
            "info FILE",
            "convert FILE @converted.ply",
            "view FILE --port 0",
            "render @scene.ply --path FILE -o @out",
            "inspect @scene.ply --pixel 1,1 --path FILE",
            "train -s @data -m @out --config FILE",
            "train -s @data -m @out --start-checkpoint FILE",
            "train --job FILE:1",
            "blocks FILE",
            "exchange FILE",
            "merge FILE -o @converted.ply",
            "eval @scene.ply -s @data --lpips-weights FILE",
        ] {
            let named = &place.words(file)[0];
            refuse(&line.replace("FILE", file), &[named, "is not a file but a device or a pipe"]);
        }
    }
    place.remove("data/images/04.png");
    make_pipe("data/images/04.png");
    refuse("train -s @data -m @out --quiet", &["04.png", "missing"]);
}

#[test]
fn parameters_that_are_not_finite() {
    let place = TestFolder::empty();
    let mut gaussians = wall(0);
    gaussians.means[7][1] = f32::NAN;
    gaussians.log_scales[9][0] = f32::INFINITY;
    // Opacities 1 and 0 occur in real files.
    gaussians.opacity_logits[1] = f32::INFINITY;
    gaussians.opacity_logits[2] = f32::NEG_INFINITY;
    place.write_scene("scene.ply", &gaussians);
    place.run("info @scene.ply").refused(&["scene.ply", "2", "--drop-invalid"]);
    let report = place.json_of("info @scene.ply --drop-invalid --json");
    assert_eq!((report["gaussians"].as_u64(), report["dropped"].as_u64()), (Some(398), Some(2)));
}

#[test]
fn unknown_device() {
    let place = TestFolder::new();
    let ask = |line: &str, words: &[&str]| {
        finish(place.command(line).args(["--device", "no such card"])).refused(words);
        assert!(!place.has("out"));
    };
    ask("train -s @data -m @out", &["'no such card'", "there are: 0 '"]);
    // The device is checked before the photos.
    place.write("data/images/05.png", "no photo");
    for line in
        ["train -s @data -m @out", "bench train-step --dataset @data", "profile train-step --dataset @data"]
    {
        ask(line, &["'no such card'"]);
    }
}

#[test]
fn no_driver() {
    let mut command = program();
    let none = "/nowhere.json";
    command.arg("devices").env("VK_DRIVER_FILES", none).env("VK_ICD_FILENAMES", none);
    finish(&mut command).refused(&["Vulkan", "driver"]);
}

/// A file with the loader's name that is no library, found before the real one.
#[cfg(target_os = "linux")]
#[test]
fn no_loader() {
    let place = TestFolder::empty();
    for name in ["libvulkan.so.1", "libvulkan.so"] {
        place.write(name, "");
    }
    let mut command = program();
    finish(command.arg("devices").env("LD_LIBRARY_PATH", place.at("")))
        .refused(&["no Vulkan loader", "libvulkan1"]);
}

#[test]
fn unwritable_output() {
    let place = TestFolder::new();
    place.write("out", "a file, not a folder");
    let model = place.at("out/model");
    place.run("train -s @data -m @out/model --quiet").refused(&[text(&model), "cannot create"]);
    assert_eq!(place.read_text("out"), "a file, not a folder");
}

#[test]
fn mistakes_on_the_command_line() {
    for (line, words) in [
        ("", &["no command"][..]),
        ("train", &["--source-path"]),
        ("train -s somewhere", &["--model-path"]),
        ("train -s a -m b --sh_degree 5", &["sh_degree", "5"]),
        ("train -s a -m b --iterations many", &["many"]),
        ("train -s a -m b --resolution 3", &["resolution", "3"]),
        ("inspect scene.ply --pixel 420", &["420"]),
        ("train -s a -m b --config /nowhere.toml", &["/nowhere.toml"]),
    ] {
        finish(program().args(line.split_whitespace())).refused(words);
    }
}
