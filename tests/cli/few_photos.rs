//! `train --few-photos` and `--depth-points`.

use super::*;
use std::fmt::Write as _;
use tempfile::tempdir;

const SCHEDULE: [&str; 6] = ["--iterations", "12", "--sh_degree", "0", "--eval-share", "0"];

fn train(data: &Path, model: &Path, more: &[&str]) -> Finished {
    let usual = ["train", "-s", text(data), "-m", text(model)];
    finish(program().args(usual).args(SCHEDULE).args(more))
}

/// Value of a setting in a run's dump.
fn setting(model: &Path, name: &str) -> String {
    let dump = std::fs::read_to_string(model.join("settings.toml")).expect("a dump");
    let line = dump.lines().find_map(|line| line.strip_prefix(&format!("{name} = ")));
    line.unwrap_or_else(|| panic!("no {name} in {dump}")).to_owned()
}

/// Writes the data set of [`write_dataset`], with observations of the points in the photos.
fn write_tracks(folder: &Path) {
    write_dataset(folder);
    let points = wall_points();
    let sparse = folder.join("sparse/0");
    let mut images = String::new();
    for index in 0..VIEWS {
        let camera = view(index);
        let image = ColmapImage::posed(index + 1, 1, format!("{:02}.png", index + 1), &camera);
        let numbers: Vec<String> =
            image.quat.iter().chain(&image.translation).map(|x| format!("{x:.9}")).collect();
        writeln!(images, "{} {} 1 {}", image.id, numbers.join(" "), image.name).expect("text");
        for (id, position) in points.positions.iter().enumerate().step_by(3) {
            let (x, y, _) = camera.project(Vec3::from_array(*position));
            write!(images, "{x} {y} {id} ").expect("text");
        }
        images.push('\n');
    }
    let of_points: Vec<String> = (points.positions.iter().enumerate())
        .map(|(id, [x, y, z])| format!("{id} {x} {y} {z} 9 9 9 0.5 1 0 2 0\n"))
        .collect();
    let camera = view(0);
    let cameras = format!(
        "1 PINHOLE {} {} {} {} {} {}\n",
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    );
    for (name, contents) in [("cameras", cameras), ("images", images), ("points3D", of_points.concat())] {
        std::fs::remove_file(sparse.join(format!("{name}.bin"))).expect("was there");
        std::fs::write(sparse.join(format!("{name}.txt")), contents).expect("written");
    }
}

/// Data sets with few photos get special settings, and one line says so. Given options have priority.
#[test]
fn few_photos_are_noticed_and_said() {
    let folder = tempdir().expect("a temporary folder");
    let data = folder.path().join("data");
    write_dataset(&data);
    let lines = |run: &Finished| {
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        run.stderr.lines().filter(|line| line.starts_with("only ")).map(str::to_owned).collect::<Vec<_>>()
    };
    let model = folder.path().join("auto");
    let said = lines(&train(&data, &model, &[]));
    assert_eq!(said.len(), 1, "{said:?}");
    let options =
        ["--strategy budget", "--dropout 0.2", "--opacity-reg 0.01", "--scale-reg ", "--few-photos off"];
    for part in options.into_iter().chain(["only 9 photos"]) {
        assert!(said[0].contains(part), "{}", said[0]);
    }
    assert_eq!(
        (setting(&model, "strategy").as_str(), setting(&model, "dropout").as_str()),
        ("\"budget\"", "0.2")
    );
    assert_eq!(setting(&model, "few_photos"), "\"auto\"");
    // The weight on scales depends on the scene extent.
    let extent = ashsplat::scene::scene_extent((0..VIEWS).map(|index| view(index).position()));
    let weight: f64 = setting(&model, "scale_reg").parse().expect("a number");
    assert!((weight * f64::from(extent) / 0.045 - 1.0).abs() < 0.006, "{weight} {extent}");
    // A run with the dump's settings is identical, and prints no such line.
    let again = folder.path().join("again");
    let config = model.join("settings.toml");
    let run = train(&data, &again, &["--config", text(&config)]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let scene = |model: &Path| {
        std::fs::read(model.join("point_cloud/iteration_12/point_cloud.ply")).expect("a scene")
    };
    assert!(scene(&again) == scene(&model));
    let off = folder.path().join("off");
    assert!(lines(&train(&data, &off, &["--few-photos", "off"])).is_empty());
    assert_eq!(
        (setting(&off, "strategy").as_str(), setting(&off, "dropout").as_str()),
        ("\"reference\"", "0.0")
    );
    for strategy in ["mcmc", "fixed"] {
        let nothing =
            train(&data, &folder.path().join("none"), &["--few-photos", "on", "--strategy", strategy]);
        assert_refused(&nothing, &["--few-photos", "no settings for --strategy", strategy]);
    }
    let given = folder.path().join("given");
    let reference = ["--few-photos", "on", "--strategy", "reference"];
    let said = lines(&train(&data, &given, &reference));
    assert!(said.len() == 1 && said[0].contains("--densify-until-iter 1500"), "{said:?}");
    assert_eq!(
        (setting(&given, "strategy").as_str(), setting(&given, "dropout").as_str()),
        ("\"reference\"", "0.0")
    );
    let said = lines(&train(&data, &given, &[&reference[..], &["--densify-until-iter", "9"]].concat()));
    assert!(said.is_empty(), "{said:?}");
    assert_eq!(setting(&given, "densify_until_iter"), "9");
    // Budget does not work with this optimiser.
    let sparse = folder.path().join("sparse");
    let said = lines(&train(&data, &sparse, &["--optimizer-type", "sparse_adam"]));
    assert!(said.len() == 1 && said[0].contains(": --densify-until-iter 1500,"), "{said:?}");
    assert_eq!(setting(&sparse, "strategy"), "\"reference\"");
    // A training that began as one with many photos resumes as such.
    let begun = folder.path().join("begun");
    let stop = ["--few-photos", "off", "--checkpoint-iterations", "5"];
    assert!(lines(&train(&data, &begun, &stop)).is_empty());
    let on = ["--start-checkpoint", "latest", "--iterations", "14"];
    assert!(
        lines(&finish(
            program()
                .args(["train", "-s", text(&data), "-m", text(&begun)])
                .args(["--sh_degree", "0"])
                .args(on)
        ))
        .is_empty()
    );
    assert_eq!(setting(&begun, "strategy"), "\"reference\"");
    let quiet = folder.path().join("quiet");
    assert!(lines(&train(&data, &quiet, &["--quiet", "--scene-extent", "10"])).is_empty());
    assert_eq!(setting(&quiet, "scale_reg"), "0.0045");
    refuse(&["train", "-s", text(&data), "-m", "x", "--few-photos", "maybe"], &["maybe", "few-photos"]);
}

/// A model with observations gives depths for training. For a model without them, an error says so before the
/// training.
#[test]
fn points_are_taken_for_depths_where_photos_show_them() {
    let folder = tempdir().expect("a temporary folder");
    let (data, model) = (folder.path().join("data"), folder.path().join("model"));
    write_tracks(&data);
    let run = train(&data, &model, &["--few-photos", "off", "--depth-points", "0.1", "--eval"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(setting(&model, "depth_points"), "0.1");
    let without = folder.path().join("without");
    assert_eq!(train(&data, &without, &["--few-photos", "off", "--eval"]).code, Some(0));
    let scene = |model: &Path| {
        std::fs::read(model.join("point_cloud/iteration_12/point_cloud.ply")).expect("a scene")
    };
    assert!(scene(&model) != scene(&without));

    let (bare, none) = (folder.path().join("bare"), folder.path().join("none"));
    write_dataset(&bare);
    let refused = train(&bare, &none, &["--depth-points", "0.1"]);
    assert_refused(&refused, &["which photos show which points", "--depth-points"]);
    let refused = train(&data, &none, &["--depth-points", "0.1", "-d", "depths"]);
    assert_refused(&refused, &["depth_points", "-d"]);
    let refused = train(&data, &none, &["--dropout", "0.95"]);
    assert_refused(&refused, &["dropout", "0.95", "0.9"]);
    assert!(!none.exists(), "nothing is left of a run that was refused");
}
