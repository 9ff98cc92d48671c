//! Mip-Splatting's filters and the order of distances in the program: from a training to files, pictures and measurements.

use super::*;

#[test]
fn filters_go_from_training_into_files_and_pictures() {
    let place = TestFolder::new();
    place
        .run(
            "train -s @data -m @model --eval --quiet --few-photos off --iterations 20 --filter-3d \
             --antialiasing --kernel-size 0.1 --distance-order",
        )
        .ok();
    let ply = point_cloud("model", 20);
    let header = |name: &str| {
        let bytes = place.read(name);
        let end = bytes.windows(10).position(|word| word == b"end_header").expect("a header");
        String::from_utf8_lossy(&bytes[..end]).into_owned()
    };
    let marks = ["comment SplatRenderMode: mip", "comment distance_order=true", "comment kernel_size=0.1"];
    assert_says(header(&ply), &["property float filter_3D\n"]);
    assert_says(header(&ply), &marks);
    // A converted file has the filtered Gaussians, and the marks.
    place.run(format!("convert @{ply} @baked.ply")).ok();
    assert_says(header("baked.ply"), &marks);
    let converted = place.run(format!("convert @{ply} @unordered.spz")).ok();
    assert_says(&converted.stderr, &["draw it with --distance-order", "draw it with --kernel-size 0.1"]);
    assert!(!header("baked.ply").contains("filter_3D"));
    // A model folder has the training's settings, and a single file its marks.
    let measured = |scene: &str| -> f64 {
        let table = place.json_of(format!("eval {scene} -s @data --eval --json --quiet"));
        table["mean"]["PSNR"].as_f64().expect("a number")
    };
    let trained = place.read_json("model/results.json")["ours_20"]["PSNR"].as_f64().expect("a number");
    let [whole, alone, other] = ["@model", "@baked.ply", "@baked.ply --kernel-size 3"].map(measured);
    assert!((whole - trained).abs() < 1e-4 && (alone - trained).abs() < 1e-3, "{trained} {whole} {alone}");
    assert!((other - trained).abs() > 1e-2, "{other}");
    let picture = |scene: &str| {
        place.run(format!("render {scene} -s @data -o @out --quiet")).ok();
        place.picture("out/00000.png").into_raw()
    };
    let whole = picture("@model");
    let differ = |other: &[u8]| whole.iter().zip(other).map(|(a, b)| a.abs_diff(*b)).max().expect("pixels");
    assert!(differ(&picture("@baked.ply")) <= 1);
    let unordered = picture("@unordered.spz --kernel-size 0.1");
    assert!(differ(&picture("@unordered.spz --kernel-size 0.1 --distance-order")) < differ(&unordered));
    assert!(differ(&picture("@baked.ply --kernel-size 3")) > 8);
    // Without the filter, the file has neither the column nor the mark.
    place.run("train -s @data -m @plain --quiet --iterations 2 --preset reference").ok();
    let without = header(&point_cloud("plain", 2));
    assert!(!without.contains("filter_3D") && !without.contains("mip"), "{without}");
    place.run("train -s @data -m @none --kernel-size 0").refused(&["kernel_size", "0"]);
    place.run("render @baked.ply --orbit 2 -o @none --kernel-size 0").refused(&["--kernel-size"]);
    assert!(!place.has("none"));
}
