//! LPIPS in `eval` and `train`, with weights by a formula.

use super::training::trained;
use super::*;
use crate::common::lpips_files::{alexnet, vgg16, write};
use crate::reference::lpips::{ALEXNET, Step, VGG16, Weights, formula, lpips};

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
    let place = trained();
    write(&place.at("twin_alex"), &alexnet(0));
    write(&place.at("twin_vgg"), &vgg16(64));
    let ply = point_cloud("model", 30);
    let eval = |more: &str| place.run(format!("eval @{ply} -s @data --quiet {more}")).ok().stdout;
    let said = eval("--lpips-weights @twin_vgg --lpips-weights @twin_alex --json");
    let json: Value = serde_json::from_str(&said).expect("JSON");
    let cases = [("lpips_alex", &ALEXNET[..], 0, true), ("lpips_vgg_unscaled", &VGG16, 64, false)];
    for (name, steps, tag, scaled) in cases {
        let weights = formula(steps, tag);
        let mut sum = 0.0;
        for (index, view) in json["views"].as_array().expect("views").iter().enumerate() {
            let [render, photo] =
                ["renders", "gt"].map(|kind| place.at(format!("model/test/ours_30/{kind}/{index:05}.png")));
            let expected = of_pictures(steps, &weights, scaled, [&render, &photo]);
            let actual = view[name].as_f64().expect("a number");
            // The saved pictures are rounded to 8 bits.
            assert!((actual - expected).abs() < 0.02 * expected, "{name}: {actual}, expected {expected}");
            sum += actual;
        }
        let mean = json["mean"][name].as_f64().expect("a number");
        assert!((mean - sum / 2.0).abs() < 1e-12, "{name}");
    }
    assert_eq!(json["mean"]["LPIPS"], json["mean"]["lpips_vgg_unscaled"], "the reference's");
    assert_eq!(json["scene_bytes"], place.read(&ply).len());
    let timed = json["mean"]["frame_ms"].as_f64() > Some(0.0);
    assert!(json["gaussians"].as_u64() > Some(100) && timed, "{json}");
    let table = eval("--lpips-weights @twin_vgg");
    assert_says(&table, &["lpips_vgg_unscaled", "Gaussians, ", "ms per frame on "]);
    assert!(!table.contains("lpips_alex") && !table.contains("not measured"), "{table}");
    assert_says(eval(""), &["LPIPS is not measured"]);
}

#[test]
fn lpips_of_training_is_in_its_results_and_its_report() {
    let place = TestFolder::new();
    write(&place.at("alex"), &alexnet(0));
    let train = |model: &str, more: &str| {
        let run = format!("train -s @data -m @{model} --eval --iterations 4 --quiet {more}");
        let said = place.run(run).ok().stdout;
        (said, place.read_json(format!("{model}/results.json")))
    };
    let (said, results) = train("model", "--test-iterations 2 --lpips-weights @alex");
    assert_says(&said, &[", lpips_alex 0."]);
    let value = results["ours_4"]["lpips_alex"].as_f64().expect("a number");
    assert!(value > 0.0 && results["ours_2"]["lpips_alex"].is_null(), "the last test alone: {results}");
    assert_eq!(results["ours_4"]["scene_bytes"], place.ply("model", 4).len());
    let per_view = place.read_json("model/per_view.json");
    let views = per_view["ours_4"]["lpips_alex"].as_object().expect("views");
    let mean = views.values().filter_map(Value::as_f64).sum::<f64>() / 2.0;
    assert!((mean - value).abs() < 1e-12);
    let page = place.read_text("model/report.html");
    for words in
        ["<th>lpips_alex</th>", "lpips_alex, held out", "file of the scene", "frame, median of the views"]
    {
        assert!(page.contains(words), "no '{words}'");
    }
    assert!(!page.contains("LPIPS is not computed"));
    // LPIPS does not change the scene, and a file of settings gives the same measure.
    place.write("lpips.toml", format!("lpips_weights = [{:?}]\n", text(&place.at("alex"))));
    for (model, more, measured) in [("again", "", None), ("by_file", "--config @lpips.toml", Some(value))] {
        let (_, results) = train(model, more);
        assert!(place.ply("model", 4) == place.ply(model, 4), "measuring changes nothing");
        assert_eq!(results["ours_4"]["lpips_alex"].as_f64(), measured);
    }
}

#[test]
fn lpips_weights_that_are_none_are_refused_before_the_work() {
    let place = trained();
    let weights = place.at("bad.safetensors");
    let check = |words: &[&str], more: &str| {
        for command in [
            format!("eval @{} -s @data --json", point_cloud("model", 30)),
            "train -s @data -m @unweighted --eval --iterations 2".into(),
        ] {
            let run = place.run(format!("{command} --lpips-weights @bad.safetensors {more}")).refused(words);
            assert_eq!(run.stdout, "", "no number");
        }
        assert!(!place.has("unweighted"));
    };
    std::fs::write(&weights, "PK").expect("written");
    check(&["bad.safetensors: is truncated or no safetensors file"], "");
    write(&weights, &alexnet(0));
    check(&["once more", "AlexNet"], "--lpips-weights @bad.safetensors");
}

/// Photographs smaller than the network's least input: an error before the training, only for photos that are
/// tested.
#[test]
fn photos_that_are_too_small_for_lpips_are_refused_before_the_work() {
    let place = trained();
    write(&place.at("small_alex"), &alexnet(0));
    let eval = format!("eval @{} -s @data -r 2", point_cloud("model", 30));
    let train = "train -s @data -m @too_small --iterations 2 --quiet";
    // The photos have 48x32 pixels. Without --eval the first training view is tested.
    for (line, photo) in
        [(format!("{train} -r 2 --eval"), "03"), (format!("{train} -r 2"), "01"), (eval, "03")]
    {
        let words = [&format!("photo {photo}.png is 24x16 pixels"), "AlexNet needs 31"];
        place.run(format!("{line} --lpips-weights @small_alex")).refused(&words);
    }
    let halves = format!("{train} --lpips-weights @small_alex --eval --train-test-exp");
    let words = ["photo 01.png is 24x32 pixels", "right half", "AlexNet needs 31"];
    place.run(halves).refused(&words);
    assert!(!place.has("too_small"));
}
