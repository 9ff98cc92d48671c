//! LPIPS in `eval` and `train`, with weights by a formula.

use super::training::trained;
use super::*;
use crate::common::lpips_files::{Tensor, alexnet, vgg16, write};
use crate::reference::lpips::{ALEXNET, Step, VGG16, Weights, formula, lpips};
use serde_json::Value;
use tempfile::tempdir;

/// LPIPS of two saved pictures by the twin.
fn of_pictures(steps: &[Step], weights: &Weights, scaled: bool, paths: [&Path; 2]) -> f64 {
    let [a, b] = paths.map(|path| {
        let picture = image::open(path).expect("a picture").to_rgb8();
        let value = |x: u8| if scaled { f64::from(x) / 127.5 - 1.0 } else { f64::from(x) / 255.0 };
        picture.pixels().map(|pixel| pixel.0.map(value)).collect::<Vec<[f64; 3]>>()
    });
    lpips(steps, weights, [&a, &b], SIZE.map(|n| n as usize)).iter().sum()
}

#[test]
fn lpips_of_eval_is_that_of_the_twin() {
    let folder = tempdir().expect("a temporary folder");
    let (alex, vgg) = (folder.path().join("alex.safetensors"), folder.path().join("vgg.safetensors"));
    write(&alex, &alexnet(0));
    write(&vgg, &vgg16(64));
    let (data, model) = (&trained().data, &trained().model);
    let ply = model.join("point_cloud/iteration_30/point_cloud.ply");
    let eval = ["eval", text(&ply), "-s", text(data), "--quiet"];
    let weights = ["--lpips-weights", text(&vgg), "--lpips-weights", text(&alex)];
    let said = succeed(&[&eval[..], &weights, &["--json"]].concat());
    let json: Value = serde_json::from_str(&said).expect("JSON");
    let cases = [("lpips_alex", &ALEXNET[..], 0, true), ("lpips_vgg_unscaled", &VGG16, 64, false)];
    for (name, steps, tag, scaled) in cases {
        let weights = formula(steps, tag);
        let mut sum = 0.0;
        for (index, view) in json["views"].as_array().expect("views").iter().enumerate() {
            let picture = |kind: &str| model.join(format!("test/ours_30/{kind}/{index:05}.png"));
            let expected = of_pictures(steps, &weights, scaled, [&picture("renders"), &picture("gt")]);
            let actual = view[name].as_f64().expect("a number");
            // The saved pictures are rounded to 8 bits.
            assert!((actual - expected).abs() < 0.02 * expected, "{name}: {actual}, expected {expected}");
            sum += actual;
        }
        let mean = json["mean"][name].as_f64().expect("a number");
        assert!((mean - sum / 2.0).abs() < 1e-12, "{name}");
    }
    assert_eq!(json["mean"]["LPIPS"], json["mean"]["lpips_vgg_unscaled"], "the reference's");
    // Size of the scene.
    let bytes = std::fs::metadata(&ply).expect("a file").len();
    assert_eq!(json["scene_bytes"].as_u64(), Some(bytes));
    assert!(
        json["gaussians"].as_u64() > Some(100) && json["mean"]["frame_ms"].as_f64() > Some(0.0),
        "{json}"
    );
    let table = succeed(&[&eval[..], &weights[..2]].concat());
    assert!(table.contains("lpips_vgg_unscaled") && !table.contains("lpips_alex"), "{table}");
    assert!(!table.contains("not measured") && succeed(&eval).contains("LPIPS is not measured"));
    assert!(table.contains("Gaussians, ") && table.contains("ms per frame on "), "{table}");
}

#[test]
fn lpips_of_training_is_in_its_results_and_its_report() {
    let folder = tempdir().expect("a temporary folder");
    let (weights, model) = (folder.path().join("alex.safetensors"), folder.path().join("model"));
    write(&weights, &alexnet(0));
    let data = &trained().data;
    let train = [
        "train",
        "-s",
        text(data),
        "-m",
        text(&model),
        "--eval",
        "--iterations",
        "4",
        "--test-iterations",
        "2",
    ];
    let said = succeed(&[&train[..], &["--quiet", "--lpips-weights", text(&weights)]].concat());
    assert!(said.contains(", lpips_alex 0."), "{said}");
    let read = |name: &str| std::fs::read_to_string(model.join(name)).expect("a file");
    let results: Value = serde_json::from_str(&read("results.json")).expect("JSON");
    let value = results["ours_4"]["lpips_alex"].as_f64().expect("a number");
    assert!(value > 0.0 && results["ours_2"]["lpips_alex"].is_null(), "the last test alone: {results}");
    let ply = model.join("point_cloud/iteration_4/point_cloud.ply");
    let bytes = std::fs::metadata(ply).expect("a file").len();
    assert_eq!(results["ours_4"]["scene_bytes"].as_u64(), Some(bytes));
    let per_view: Value = serde_json::from_str(&read("per_view.json")).expect("JSON");
    let views = per_view["ours_4"]["lpips_alex"].as_object().expect("views");
    let mean = views.values().filter_map(Value::as_f64).sum::<f64>() / 2.0;
    assert!((mean - value).abs() < 1e-12);
    let page = read("report.html");
    for words in
        ["<th>lpips_alex</th>", "lpips_alex, held out", "file of the scene", "frame, median of the views"]
    {
        assert!(page.contains(words), "no '{words}'");
    }
    assert!(!page.contains("LPIPS is not computed"));
    // LPIPS does not change the scene, and a file of settings gives the same measure.
    let settings = folder.path().join("lpips.toml");
    std::fs::write(&settings, format!("lpips_weights = [{:?}]\n", text(&weights))).expect("written");
    let train = ["train", "-s", text(data), "--eval", "--iterations", "4", "--quiet"];
    let ply =
        |model: &Path| std::fs::read(model.join("point_cloud/iteration_4/point_cloud.ply")).expect("a PLY");
    for more in [&[][..], &["--config", text(&settings)]] {
        let again = folder.path().join(if more.is_empty() { "again" } else { "by_file" });
        succeed(&[&train[..], &["-m", text(&again)], more].concat());
        assert!(ply(&model) == ply(&again), "measuring changes nothing");
        let results = std::fs::read_to_string(again.join("results.json")).expect("a file");
        let results: Value = serde_json::from_str(&results).expect("JSON");
        assert_eq!(results["ours_4"]["lpips_alex"].as_f64(), (!more.is_empty()).then_some(value));
    }
}

#[test]
fn lpips_weights_that_are_none_are_refused_before_the_work() {
    let folder = tempdir().expect("a temporary folder");
    let (weights, model) = (folder.path().join("weights.safetensors"), folder.path().join("model"));
    let ply = trained().model.join("point_cloud/iteration_30/point_cloud.ply");
    let data = &trained().data;
    let commands = [
        vec!["eval", text(&ply), "-s", text(data), "--json"],
        vec!["train", "-s", text(data), "-m", text(&model), "--eval", "--iterations", "2"],
    ];
    let check = |words: &[&str], more: &[&str]| {
        for command in &commands {
            let arguments = [&command[..], &["--lpips-weights", text(&weights)], more].concat();
            let run = finish(program().args(arguments));
            assert_refused(&run, words);
            assert_eq!(run.stdout, "", "no number");
        }
        assert!(!model.exists());
    };
    check(&["weights.safetensors: cannot read"], &[]);
    std::fs::write(&weights, "PK").expect("written");
    check(&["weights.safetensors: is truncated or no safetensors file"], &[]);
    write(&weights, &alexnet(0).into_iter().filter(|t| t.name != "lin4.model.1.weight").collect::<Vec<_>>());
    check(&["weights.safetensors: lacks the tensor 'lin4.model.1.weight'", "tools/lpips_weights.py"], &[]);
    // Weights of another network, here ResNet's first tensor.
    let mut other = alexnet(0);
    other[0] = Tensor::new("net.0.weight", &[64, 3, 7, 7], vec![0.0; 64 * 147]);
    write(&weights, &other);
    check(&["weights.safetensors: has a tensor 'net.0.weight' of [64, 3, 7, 7]", "of AlexNet or"], &[]);
    // Damaged weights, which would give 0 or no number.
    let damaged = |name: &str, value: f32| {
        let mut tensors = alexnet(0);
        let tensor = tensors.iter_mut().find(|tensor| tensor.name == name).expect("there");
        tensor.values[2] = value;
        write(&weights, &tensors);
    };
    damaged("net.3.weight", 2e20);
    check(&["weights.safetensors: tensor 'net.3.weight': value 2 is 2e20, more than any network has"], &[]);
    damaged("lin4.model.1.weight", -0.25);
    check(&["tensor 'lin4.model.1.weight': value 2 is -0.25, no head of LPIPS has one below 0"], &[]);
    write(&weights, &alexnet(0));
    check(&["once more", "AlexNet"], &["--lpips-weights", text(&weights)]);
}

/// Photographs smaller than the network's least input: an error before the training, only for photos that are
/// tested.
#[test]
fn photos_that_are_too_small_for_lpips_are_refused_before_the_work() {
    let folder = tempdir().expect("a temporary folder");
    let (weights, model) = (folder.path().join("weights.safetensors"), folder.path().join("model"));
    write(&weights, &alexnet(0));
    let ply = trained().model.join("point_cloud/iteration_30/point_cloud.ply");
    let data = &trained().data;
    let train = ["train", "-s", text(data), "-m", text(&model), "--iterations", "2", "--quiet"];
    let of = ["--lpips-weights", text(&weights)];
    // The photos have 48x32 pixels. Without --eval the first training view is tested.
    let small = ["photo 01.png is 24x16 pixels", "AlexNet needs 31"];
    refuse(&[&train[..], &of, &["-r", "2", "--eval"]].concat(), &small);
    refuse(&[&train[..], &of, &["-r", "2"]].concat(), &small);
    refuse(&[&["eval", text(&ply), "-s", text(data), "-r", "2"], &of[..]].concat(), &small);
    let halves = [&train[..], &of, &["--eval", "--train-test-exp"]].concat();
    refuse(&halves, &["photo 01.png is 24x32 pixels", "right half", "AlexNet needs 31"]);
    assert!(!model.exists());
}
