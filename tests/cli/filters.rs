//! Mip-Splatting's filters in the program: from a training to files, pictures and measurements.

use super::*;
use serde_json::Value;
use tempfile::tempdir;

#[test]
fn filters_go_from_training_into_files_and_pictures() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let (data, model) = (at("data"), at("model"));
    write_dataset(&data);
    let train = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--quiet", "--few-photos", "off"];
    let filters = ["--iterations", "20", "--filter-3d", "--antialiasing", "--kernel-size", "0.1"];
    succeed(&[&train[..], &filters].concat());
    let ply = model.join("point_cloud/iteration_20/point_cloud.ply");
    let header = |path: &Path| {
        let bytes = std::fs::read(path).expect("a PLY");
        let end = bytes.windows(10).position(|word| word == b"end_header").expect("a header");
        String::from_utf8_lossy(&bytes[..end]).into_owned()
    };
    assert!(header(&ply).contains("property float filter_3D\n"), "{}", header(&ply));
    assert!(header(&ply).contains("comment SplatRenderMode: mip"), "{}", header(&ply));
    // A converted file has the filtered Gaussians, and the mark.
    let baked = at("baked.ply");
    succeed(&["convert", text(&ply), text(&baked)]);
    assert!(!header(&baked).contains("filter_3D") && header(&baked).contains("comment SplatRenderMode: mip"));
    // A model folder has the training's settings; a single file needs options.
    let measured = |scene: &Path, more: &[&str]| -> f64 {
        let eval = ["eval", text(scene), "-s", text(&data), "--eval", "--json", "--quiet"];
        let said = succeed(&[&eval[..], more].concat());
        let table: Value = serde_json::from_str(&said).expect("JSON");
        table["mean"]["PSNR"].as_f64().expect("a number")
    };
    let results = std::fs::read_to_string(model.join("results.json")).expect("results");
    let results: Value = serde_json::from_str(&results).expect("JSON");
    let trained = results["ours_20"]["PSNR"].as_f64().expect("a number");
    let [whole, alone, other] = [
        measured(&model, &[]),
        measured(&baked, &["--kernel-size", "0.1"]),
        measured(&baked, &["--kernel-size", "3"]),
    ];
    assert!((whole - trained).abs() < 1e-4 && (alone - trained).abs() < 1e-3, "{trained} {whole} {alone}");
    assert!((other - trained).abs() > 1e-2, "{other}");
    let picture = |scene: &Path, name: &str, more: &[&str]| {
        let out = at(name);
        let render = ["render", text(scene), "-s", text(&data), "-o", text(&out), "--quiet"];
        succeed(&[&render[..], more].concat());
        image::open(out.join("00000.png")).expect("a picture").to_rgb8().into_raw()
    };
    let whole = picture(&model, "whole", &[]);
    let differ = |other: &[u8]| whole.iter().zip(other).map(|(a, b)| a.abs_diff(*b)).max().expect("pixels");
    assert!(differ(&picture(&baked, "alone", &["--kernel-size", "0.1"])) <= 1);
    assert!(differ(&picture(&baked, "other", &["--kernel-size", "3"])) > 8);
    // Without the filter, the file has neither the column nor the mark.
    let plain = at("plain");
    let train = ["train", "-s", text(&data), "-m", text(&plain), "--quiet", "--iterations", "2"];
    succeed(&train);
    let without = header(&plain.join("point_cloud/iteration_2/point_cloud.ply"));
    assert!(!without.contains("filter_3D") && !without.contains("mip"), "{without}");
    // An invalid size.
    let none = at("none");
    let refused = ["train", "-s", text(&data), "-m", text(&none), "--kernel-size", "0"];
    refuse(&refused, &["kernel_size", "0"]);
    assert!(!none.exists());
    refuse(
        &["render", text(&baked), "--orbit", "2", "-o", text(&none), "--kernel-size", "0"],
        &["--kernel-size"],
    );
    assert!(!none.exists());
}
