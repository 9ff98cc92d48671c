//! `partition`, `train --job`, `merge`: scenes that cannot be divided, and divisions that are out of date.

use super::checkpoints::assert_trained;
use super::merge::{division, job, merge, partition, place, read};
use super::*;
use ashsplat_files::splats;
use serde_json::Value;

#[test]
fn what_cannot_be_divided_or_trained_is_refused() {
    let place = place();
    assert_refused(&partition(&place, "plan", &["--max-gaussians", "300"]), &["--out", ".json"]);
    let data = place.model("data");
    let refused = |more: &[&str], words: &[&str]| {
        assert_refused(&partition(&place, "blocks.json", more), words);
        assert!(!place.model("blocks.json").exists() && !place.model("plan.svg").exists());
    };
    let plot = place.model("plan.svg");
    refused(
        &["--max-gaussians", "9", "--min-share", "1", "--plot", text(&plot)],
        &["block ", "has no photo", "--min-share"],
    );
    refused(&["--max-gaussians", "300", "--min-share", "nan"], &["--min-share"]);
    refused(&["--max-gaussians", "300", "--margin=-1"], &["--margin"]);
    refused(&["--max-gaussians", "0"], &["--max-gaussians"]);
    let photo = data.join("images/05.png");
    let kept = std::fs::read(&photo).expect("a photo");
    std::fs::remove_file(&photo).expect("removed");
    refused(&["--max-gaussians", "300"], &["05.png", "the photo of image 5 is missing"]);
    std::fs::write(&photo, kept).expect("written");
    // Another data set, with other positions, and with photos that see nothing.
    let other = place.model("other");
    write_dataset(&other);
    let images = |count: u32, turned: f32| -> Vec<ColmapImage> {
        let image = |id: u32| {
            let lens = view(0).intrinsics();
            let eye = vec3(0.1 * id as f32, 5.0, -2.5);
            let camera = Camera::look_at(eye, eye + turned * Vec3::Z, Vec3::NEG_Y, lens);
            ColmapImage::posed(id, 1, format!("{id:02}.png"), &camera)
        };
        (1..=count).map(image).collect()
    };
    write_model(&other, &images(9, 1.0), &wall_points());
    refused(
        &[text(&other), "--max-gaussians", "300"],
        &["cameras.json", "of its 9 cameras 0 are in", "another scene"],
    );
    write_model(&other, &images(9, -1.0), &wall_points());
    let ply = place.model("coarse/point_cloud/iteration_12/point_cloud.ply");
    let out = place.model("blocks.json");
    let bare =
        ["partition", text(&other), "--coarse", text(&ply), "--max-gaussians", "300", "-o", text(&out)];
    refuse(&bare, &["point_cloud.ply", "next to nothing"]);
    // Same size, other colours.
    let mut negative = read(&ply);
    negative.sh.iter_mut().flatten().for_each(|coefficient| *coefficient *= -1.0);
    let path = place.model("negative.ply");
    splats::write(&path, &negative, &splats::WriteOptions::default()).expect("written");
    let bare =
        ["partition", text(&data), "--coarse", text(&path), "--max-gaussians", "300", "-o", text(&out)];
    refuse(&bare, &["negative.ply", "does not look like the photos", "another scene"]);

    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "300"]));
    let written = std::fs::read_to_string(&out).expect("blocks.json");
    let before = files_below(&place.model(""));
    let changed = |from: &str, to: &str, words: &[&str]| {
        assert!(written.contains(from), "{from}");
        std::fs::write(&out, written.replacen(from, to, 1)).expect("written");
        assert_refused(&job(&place, 1, &[]), words);
        assert_refused(&merge(&place, "scene.ply"), words);
        refuse(&["exchange", text(&out)], words);
        refuse(&["blocks", text(&out)], words);
        std::fs::write(&out, &written).expect("written");
    };
    let mut none: Value = serde_json::from_str(&written).expect("JSON");
    none["blocks"][1]["photos"] = serde_json::json!([]);
    std::fs::write(&out, none.to_string()).expect("written");
    for refused in [job(&place, 2, &[]), merge(&place, "scene.ply")] {
        assert_refused(&refused, &["blocks.json", "block 2 has no photos to train on"]);
    }
    changed("\"version\": 1", "\"version\": 2", &["blocks.json", "is of version 2", "partition"]);
    changed("\"version\": 1", "\"versions\": 1", &["blocks.json", "no version"]);
    changed("{", "", &["blocks.json", "no list of blocks"]);
    changed("\"number\": 2", "\"number\": 7", &["blocks.json", "numbered"]);
    changed("null", "-0.3", &["blocks.json", "do not divide"]);
    changed("\"margin\"", "\"margins\"", &["blocks.json", "margins"]);
    let all = [text(&out), ":9999"].concat();
    refuse(&["train", "--job", &all], &["job", "has the blocks 1 to"]);
    refuse(&["train", "--job", text(&out)], &["job", "blocks.json:3"]);
    refuse(&["train", "--job", &all, "--margin", "1"], &["--job", "cannot be used with"]);
    // A file that the blocks refer to has changed.
    let photo = data.join("images/05.png");
    let kept = std::fs::read(&photo).expect("a photo");
    std::fs::remove_file(&photo).expect("removed");
    assert_refused(&job(&place, 1, &[]), &["05.png", "the photo of image 5 is missing"]);
    std::fs::write(&photo, kept).expect("written");
    let kept = std::fs::read(&ply).expect("a scene");
    let mut other = kept.clone();
    other[kept.len() - 3] ^= 1;
    std::fs::write(&ply, other).expect("written");
    assert_refused(&job(&place, 1, &[]), &["point_cloud.ply", "is not the coarse model that"]);
    std::fs::write(&ply, kept).expect("written");
    assert_eq!(files_below(&place.model("")), before);
    write_model(&data, &images(9, 1.0), &wall_points());
    assert_refused(&job(&place, 1, &[]), &["data: its cameras are not those that", "blocks.json"]);
    assert!(!place.model("blocks").exists());
}

/// If all photos show a single object, its parts use whole photos.
#[test]
fn photos_of_a_single_object_are_used_whole() {
    let place = place();
    let divided = |more: &[&str]| {
        let out = partition(&place, "blocks.json", &[&["--max-gaussians", "500"], more].concat());
        assert_trained(&out);
        (division(&place), out.stdout)
    };
    let blocks = |of: &Value| of["blocks"].as_array().expect("blocks").clone();
    let parts =
        |of: &Value| -> Vec<Value> { blocks(of).iter().map(|block| block["parts"].clone()).collect() };
    let used = |of: &Value| -> usize {
        let number = |block: &Value, list: &str| block[list].as_array().expect("photos").len();
        blocks(of).iter().map(|block| number(block, "photos") + number(block, "held_out")).sum()
    };
    let (whole, said) = divided(&[]);
    let margin = whole["margin"].as_f64().expect("a margin");
    assert!(used(&whole) == 18 && said.contains("a single object: photos show 100 %"), "{said}");
    assert!(said.contains("whole photos") && parts(&whole) == [Value::Null, Value::Null], "{whole}");
    let (rounds, said) = divided(&["--rounds", "2"]);
    assert!(said.contains("whole photos") && rounds["blocks"] == whole["blocks"], "{said}");
    assert_eq!(rounds["margin"], whole["margin"]);
    // Parts of photos include the wide margin, too.
    let (of_parts, said) = divided(&["--rounds", "2", "--photo-parts", "on"]);
    assert!(said.contains("parts of photos") && of_parts["margin"] == whole["margin"], "{said}");
    let wide = (margin as f32).to_string();
    let (given, _) = divided(&["--rounds", "2", "--photo-parts", "on", "--margin", &wide]);
    assert!(parts(&given) != [Value::Null, Value::Null] && given == of_parts, "{given}");
    let (narrow, _) = divided(&["--rounds", "2", "--photo-parts", "on", "--margin", "0.001"]);
    assert!(parts(&narrow) != parts(&given), "{narrow}");
    assert_eq!(narrow["margin"].as_f64().map(|margin| margin as f32), Some(0.001));

    // Each photo is used for the block that it shows most of, and some photos for more.
    let several = ["--rounds", "2", "--min-share", "0.33"];
    let (several_places, said) = divided(&several);
    assert!(used(&several_places) < 15 && !said.contains("single object"), "{said}");
    assert!(parts(&several_places) != [Value::Null, Value::Null], "{several_places}");
    let thin = several_places["margin"].as_f64().expect("a margin");
    assert!((thin - margin / 3.0).abs() < 1e-6 * margin, "{thin} {margin}");
    let (off, _) = divided(&[&several[..], &["--photo-parts", "off"]].concat());
    assert_eq!(parts(&off), [Value::Null, Value::Null]);
}
