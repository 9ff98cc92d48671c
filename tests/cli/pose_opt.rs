//! Poses that `--pose-opt` finds, and where they are written.

use super::*;
use ashsplat::scene::Twist;
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::colmap::Model;

fn cameras_of(place: &TestFolder, model: &str) -> Vec<NamedCamera> {
    cameras_json::read(place.at(model).join("cameras.json"), &WorldFrame::default()).expect("cameras")
}

/// Cameras of the training move, and those that are held out stay. Results, poses and the report say so, and `eval`
/// gives the same numbers.
#[test]
fn poses_are_written_and_held_out_cameras_aligned() {
    let place = TestFolder::new();
    let few = "--pose-lr 1e-3 --iterations 40 --sh-degree 0 --eval-share 0 --quiet";
    let stdout = place.run(format!("train -s @data -m @model --eval --pose-opt {few}")).ok().stdout;
    assert_says(&stdout, &["poses turned by "]);
    let results = place.read_json("model/results.json")["ours_40"].clone();
    let number =
        |entry: &Value, name: &str| entry[name].as_f64().unwrap_or_else(|| panic!("{name}: {entry}"));
    assert!((0.0..1.0).contains(&number(&results, "SSIM_aligned")), "{results}");
    let poses = place.read_json("model/poses.json");
    assert!(number(&poses["degrees"], "mean") > 0.0, "{poses}");
    let given = Model::read(&colmap::find(place.at("data")).expect("a folder")).expect("a model");
    let cameras = cameras_of(&place, "model");
    assert_eq!((poses["xi"].as_object().expect("poses").len(), cameras.len()), (7, 9));
    for named in &cameras {
        let image = given.images.iter().find(|image| image.name == named.name).expect("known");
        let stayed = is_at(&named.camera, &given.camera_of(image).expect("a camera"), 1e-5);
        assert_eq!(stayed, poses["xi"].get(&named.name).is_none(), "{}", named.name);
    }
    assert_says(place.read_text("model/report.html"), &["poses turned, mean", "cameras aligned"]);
    let again = place.json_of("eval @model --json --quiet");
    let difference = number(&again["mean"], "PSNR_aligned") - number(&results, "PSNR_aligned");
    assert!(difference.abs() < 0.05, "{again}");
}

/// With `--train-test-exp` held-out views are trained on, too. Each pose has its view's name, and `eval` uses the
/// training's poses.
#[test]
fn poses_of_halves_stand_under_their_names() {
    let place = TestFolder::new();
    let few = "--pose-lr 1e-3 --iterations 40 --sh-degree 0 --eval-share 0 --quiet";
    place.run(format!("train -s @data -m @model --eval --train-test-exp --pose-opt {few}")).ok();
    let given = Model::read(&colmap::find(place.at("data")).expect("a folder")).expect("a model");
    let poses = place.read_json("model/poses.json");
    let cameras = cameras_of(&place, "model");
    assert_eq!((poses["xi"].as_object().expect("poses").len(), cameras.len()), (9, 9));
    for named in &cameras {
        let image = given.images.iter().find(|image| image.name == named.name).expect("known");
        let xi: [f64; 6] = serde_json::from_value(poses["xi"][&named.name].clone()).expect("six numbers");
        assert!(xi.iter().any(|&x| x != 0.0), "{}: not moved", named.name);
        let moved = Twist::from_array(xi).applied_to(&given.camera_of(image).expect("a camera"));
        assert!(is_at(&named.camera, &moved, 1e-4), "{}: {:?}", named.name, named.camera);
    }
    let measured = || place.read_json("model/per_view.json")["ours_40"]["PSNR"].clone();
    let trained = measured();
    place.run("eval @model --quiet").ok();
    let again = measured();
    for view in ["00000.png", "00001.png"] {
        let [a, b] = [&trained, &again].map(|psnr| psnr[view].as_f64().expect("a number"));
        assert!((a - b).abs() < 0.01, "{view}: {a} dB in training, {b} dB after it");
    }
}

fn is_at(camera: &Camera, other: &Camera, margin: f32) -> bool {
    let turned = camera.camera_from_world.abs_diff_eq(other.camera_from_world, margin);
    turned && camera.translation.abs_diff_eq(other.translation, margin)
}
