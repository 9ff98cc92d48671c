//! Exposures of photos, and inverse-depth maps.

use super::*;
use ashsplat_files::exposure_json;
use ashsplat_files::lens_json::LensFile;

fn train(place: &TestFolder, model: &str, more: &str) {
    let few = "--iterations 40 --test-iterations=-1 --sh-degree=0 --quiet --seed=3";
    place.run(format!("train -s @data -m @{model} {few} {more}")).ok();
}

#[test]
fn exposures_are_learnt_saved_and_asked_for() {
    let place = TestFolder::new();
    train(&place, "model", "--eval --exposure --exposure-lr-init=0.1");
    let exposures = exposure_json::read(place.at("model/exposure.json")).expect("the exposures");
    // Held-out photos have no exposure.
    let names: Vec<&str> = exposures.keys().map(String::as_str).collect();
    assert_eq!(names, ["01.png", "02.png", "04.png", "05.png", "06.png", "08.png", "09.png"]);
    assert!(exposures.values().all(|exposure| *exposure != Default::default()));
    let page = place.read_text("model/report.html");
    let gain = exposures["04.png"].of([0.5; 3])[0] / 0.5;
    assert!(page.contains(&format!("04.png</td><td>{gain:.3}</td>")), "{page}");
    assert!(!page.contains("<h2>Lens effects"), "{page}");
    let [plain, exposed] = ["", "--exposure-of 04.png"].map(|more| {
        place.run(format!("render @model -o @out --quiet {more}")).ok();
        place.read("out/00000.png")
    });
    assert_ne!(plain, exposed);
    let refused = |photo: &str, words: &[&str]| {
        place.run(format!("render @model -o @none --exposure-of {photo}")).refused(words);
    };
    refused("03.png", &["exposure.json", "03.png", "01.png"]);
    let ply = point_cloud("model", 40);
    let bare = format!("render @{ply} -o @none --orbit=1 --exposure-of 02.png");
    place.run(bare).refused(&["--exposure-of", "model folder"]);
    // A new training removes the exposures of an older one.
    train(&place, "model", "--eval");
    assert!(!place.has("model/exposure.json"));
    refused("02.png", &["exposure.json", "--exposure"]);
    place.write("model/exposure.json", "{\"02.png\": [[1, 2], 3]}");
    refused("02.png", &["exposure.json", "not a list of exposures"]);
    assert!(!place.has("none"));
}

/// Vignetting and response: learned, saved for all photos, used by `render` and by measurements.
#[test]
fn lens_effects_are_learnt_saved_and_asked_for() {
    let place = TestFolder::new();
    train(&place, "model", "--eval --lens-effects --lens-lr=0.05");
    let lenses = LensFile::read(place.at("model/lens.json")).expect("the lenses");
    assert_eq!((lenses.cameras.len(), lenses.photos.len()), (1, 9));
    let learnt = lenses.of("03.png").expect("that of a held-out photo");
    assert!(learnt != Default::default() && lenses.of("none.png").is_none());
    assert!(!place.has("model/exposure.json"));
    let page = place.read_text("model/report.html");
    let corner = learnt.vignetting(0, 1.0);
    assert!(page.contains(&format!(">1</td><td>9</td><td>{corner:.3}</td>")), "{page}");
    assert!(!page.contains("<h2>Exposures"), "{page}");
    // `eval` gives the training's results.
    let results = || place.read_text("model/per_view.json");
    let trained = results();
    place.run("eval @model --quiet").ok();
    assert_eq!(trained, results());
    place.rename("model/lens.json", "aside.json");
    place.run("eval @model --quiet").ok();
    assert_ne!(trained, results());
    let render = |more: &str| place.run(format!("render @model -o @out --quiet {more}"));
    render("--lens-of 03.png").refused(&["lens.json", "--lens-effects"]);
    place.rename("aside.json", "model/lens.json");
    render("--lens-of 99.png").refused(&["lens.json", "99.png", "01.png"]);
    let [plain, with_lens] = ["", "--lens-of 03.png"].map(|more| {
        render(more).ok();
        place.read("out/00000.png")
    });
    assert_ne!(plain, with_lens);
    let good = place.read_text("model/lens.json");
    let unknown = good.replace("\"03.png\": 1", "\"03.png\": 8");
    assert_ne!(good, unknown);
    for (spoilt, words) in [
        ("{}".into(), ["lens.json", "cameras"]),
        (unknown, ["03.png", "camera 8"]),
        (good.replace("\"response\": [", "\"response\": [0.0,"), ["lens.json", "light"]),
        (good.replace("\"vignetting\"", "\"vignette\""), ["lens.json", "vignett"]),
    ] {
        place.write("model/lens.json", spoilt);
        render("--lens-of 03.png").refused(&words);
    }
    // A new training removes them.
    train(&place, "model", "--eval");
    assert!(!place.has("model/lens.json"));
}

/// The reference's protocol: trains on the left half of the held-out views, and measures the right half.
#[test]
fn held_out_views_are_trained_on_their_left_half() {
    let place = TestFolder::new();
    place.run("train -s @data -m @model --train-test-exp").refused(&["train_test_exp", "--eval"]);
    train(&place, "model", "--eval --train_test_exp");
    assert_eq!(exposure_json::read(place.at("model/exposure.json")).expect("the exposures").len(), 9);
    // Saved pictures of held-out views show the right half only.
    for kind in ["gt", "renders"] {
        let saved = place.at(format!("model/test/ours_40/{kind}/00000.png"));
        let size = ashsplat_files::images::photo_size(saved).expect("a picture");
        assert_eq!(size, (SIZE[0] / 2, SIZE[1]));
    }
    let trained = place.read_text("model/per_view.json");
    place.run("eval @model --quiet").ok();
    assert_eq!(trained, place.read_text("model/per_view.json"));
    assert_eq!(place.read_text("model/cameras.json").matches("img_name").count(), 9);
    // The right half's pixels do not matter.
    let held_out = place.at("data/images/01.png");
    let mut photo = Photo::read(&held_out, [0.0; 3]).expect("a photo");
    for (pixel, rgb) in photo.rgb.chunks_mut(3).enumerate() {
        if pixel as u32 % SIZE[0] >= SIZE[0] / 2 {
            rgb.fill(0);
        }
    }
    photo.write_png(&held_out).expect("written");
    train(&place, "spoilt", "--eval --train_test_exp");
    assert_eq!(place.ply("model", 40), place.ply("spoilt", 40));
    place.remove("model/exposure.json");
    place.run("eval @model --quiet").refused(&["exposure.json"]);
}

fn scale_of(index: u32) -> f32 {
    1.0 + index as f32 / 10.0
}

const PARAMS: &str = "data/sparse/0/depth_params.json";

/// A data set with observations of its points, and maps that are no inverse depths yet. Those of photo k are
/// (1 / z - 0.1) / (1 + k / 10).
struct Mapped(TestFolder);

impl Mapped {
    fn new() -> Mapped {
        let place = TestFolder::empty();
        write_observed(&place.at("data"));
        place.create_folder("data/depths");
        let mapped = Mapped(place);
        (0..VIEWS).for_each(|index| mapped.write_map(index));
        mapped
    }

    fn map(&self, index: u32) -> PathBuf {
        self.0.at("data/depths").join(photo_name(index))
    }

    fn write_map(&self, index: u32) {
        let camera = view(index);
        let world_from_camera = camera.camera_from_world.transpose();
        let map = image::ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
            let (x, y) = (x as f32 + 0.5 - camera.cx, y as f32 + 0.5 - camera.cy);
            let ray = world_from_camera * Vec3::new(x / camera.fx, y / camera.fy, 1.0);
            // Distance to the wall at z = 0, along the ray with z = 1 in the camera's frame.
            let inverse_z = ray.z / -camera.position().z;
            image::Luma([((inverse_z - 0.1) / scale_of(index) * 65536.0) as u16])
        });
        map.save(self.map(index)).expect("a map");
    }

    /// Writes the scales of these photos' maps.
    fn write_params(&self, indices: std::ops::Range<u32>, scale: impl Fn(u32) -> String) {
        let entry =
            |index: u32| format!("\"{:02}\": {{\"scale\": {}, \"offset\": 0.1}}", index + 1, scale(index));
        let entries: Vec<String> = indices.map(entry).collect();
        self.0.write(PARAMS, format!("{{{}}}", entries.join(", ")));
    }

    fn refuses(&self, folder: &str, words: &[&str]) {
        self.0.run(format!("train -s @data -m @out -d {folder} --quiet")).refused(words);
        assert!(!self.0.has("out"), "{:?}", self.0.files("out"));
    }
}

#[test]
fn depth_maps_are_scaled_and_trained_on() {
    let mapped = Mapped::new();
    let place = &mapped.0;
    let losses = |model: &str| {
        let checkpoint = Checkpoint::read(place.at(model).join("chkpnt40.safetensors"));
        checkpoint.expect("a checkpoint").strategy.terms
    };
    let depth_of = |model: &str| {
        place.run(format!("render @{model} -o @depth --format=exr --quiet")).ok();
        place.read("depth/00000.exr")
    };
    // Switches off the terms that few photos add.
    let alone = "--opacity-reg=0 --scale-reg=0";
    train(place, "plain", &format!("--checkpoint-iterations=40 {alone}"));
    train(place, "fitted", &format!("--checkpoint-iterations=40 -d depths {alone}"));
    assert_eq!(losses("plain"), ["photometric"]);
    assert_eq!(losses("fitted"), ["photometric", "inverse_depth"]);
    assert_ne!(depth_of("plain"), depth_of("fitted"));
    // Parameters from a file have priority. These are the true ones, so the scene is nearly the same.
    mapped.write_params(0..VIEWS, |index| scale_of(index).to_string());
    train(place, "given", &format!("--depths depths {alone}"));
    let [plain, fitted, given] =
        ["plain", "fitted", "given"].map(|model| place.gaussians(point_cloud(model, 40)).means);
    let apart = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    assert!(apart(&fitted, &given) < 0.2 * apart(&fitted, &plain), "{}", apart(&fitted, &given));
}

#[test]
fn depth_maps_that_lack_something_are_refused() {
    let mapped = Mapped::new();
    let place = &mapped.0;
    mapped.refuses("nowhere", &["nowhere", "no folder with depth maps"]);
    // A file with only some photos.
    place.write(PARAMS, "{\"01\": {\"scale\": 1, \"offset\": 0}}");
    mapped.refuses("depths", &["depth_params.json", "02.png"]);
    place.write(PARAMS, "{\"01\": {\"scale\": 1}}");
    mapped.refuses("depths", &["depth_params.json", "offset"]);
    // Values beyond the device's range; and values that no photograph can use, which is no fault of the sparse
    // points.
    mapped.write_params(0..VIEWS, |_| "1e300".into());
    mapped.refuses("depths", &["depth_params.json", "01 has a number that is too large"]);
    mapped.write_params(0..VIEWS, |_| "-1".into());
    mapped.refuses("depths", &["depth_params.json: has no scale above 0 for any photo", "remove it"]);
    place.remove(PARAMS);
    std::fs::remove_file(mapped.map(4)).expect("removed");
    mapped.refuses("depths", &["05.png", "depth map", "missing"]);
    image::GrayImage::new(SIZE[0], SIZE[1]).save(mapped.map(4)).expect("written");
    mapped.refuses("depths", &["05.png", "16-bit"]);
    std::fs::write(mapped.map(4), b"no picture").expect("written");
    mapped.refuses("depths", &["05.png"]);
    mapped.write_map(4);
    // Without observations the scale is unknown.
    place.remove("data/sparse");
    write_dataset(&place.at("data"));
    mapped.refuses("depths", &["depths", "none of the depth maps", "depth_params.json"]);
}

/// Depth maps of held-out photographs are never read: they may be missing, and the trained scene is the same.
#[test]
fn held_out_photos_need_no_depth_maps() {
    let mapped = Mapped::new();
    let scene_of = |model: &str| {
        train(&mapped.0, model, "--eval --eval-split reference -d depths");
        mapped.0.ply(model, 40)
    };
    let with_all = scene_of("all");
    [0, VIEWS - 1].iter().for_each(|&index| std::fs::remove_file(mapped.map(index)).expect("removed"));
    assert!(scene_of("some") == with_all);
    mapped.write_params(1..VIEWS - 1, |_| "1.0".into());
    assert!(scene_of("given") != with_all);
    // Training uses halves of the held-out photographs.
    let words = ["01.png", "depth map", "missing"];
    mapped.0.run("train -s @data -m @out -d depths --eval --train-test-exp").refused(&words);
    mapped.refuses("depths", &words);
}

/// Depths in place of inverse depths; and a map of another shape, which is stretched.
#[test]
fn maps_of_depths_and_of_other_shapes_are_told() {
    let mapped = Mapped::new();
    for index in 0..VIEWS {
        let mut map = image::open(mapped.map(index)).expect("a map").into_luma16();
        map.pixels_mut().for_each(|pixel| pixel[0] = u16::MAX - pixel[0]);
        map.save(mapped.map(index)).expect("saved");
    }
    let cut = image::open(mapped.map(2)).expect("a map").crop_imm(0, 0, SIZE[0] / 2, SIZE[1]);
    cut.save(mapped.map(2)).expect("saved");
    let run = mapped.0.run("train -s @data -m @out --iterations=1 -d depths");
    let run = run.warns(&["fall where the sparse points come nearer"]);
    run.warns(&["03.png: 1 of 9 depth maps are not of their photos' shape"]);
}
