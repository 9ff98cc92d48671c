//! Exposures of photos, and inverse-depth maps.

use super::*;
use ashsplat_files::exposure_json;
use ashsplat_files::lens_json::LensFile;
use glam::Mat3;
use tempfile::{TempDir, tempdir};

const FEW: [&str; 6] = ["--iterations", "40", "--test-iterations=-1", "--sh-degree=0", "--quiet", "--seed=3"];

fn train(data: &Path, model: &Path, more: &[&str]) -> String {
    let paths = ["train", "-s", text(data), "-m", text(model)];
    succeed(&[&paths, FEW.as_slice(), more].concat())
}

fn report(model: &Path) -> String {
    std::fs::read_to_string(model.join("report.html")).expect("a report")
}

fn picture(folder: &Path) -> Vec<u8> {
    std::fs::read(folder.join("00000.png")).expect("a picture")
}

#[test]
fn exposures_are_learnt_saved_and_asked_for() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    write_dataset(&at("data"));
    train(&at("data"), &at("model"), &["--eval", "--exposure", "--exposure-lr-init=0.1"]);
    let exposures = exposure_json::read(at("model").join("exposure.json")).expect("the exposures");
    // Held-out photos have no exposure.
    let names: Vec<&str> = exposures.keys().map(String::as_str).collect();
    assert_eq!(names, ["02.png", "03.png", "04.png", "05.png", "06.png", "07.png", "08.png"]);
    assert!(exposures.values().all(|exposure| *exposure != Default::default()));
    let page = report(&at("model"));
    let gain = exposures["04.png"].of([0.5; 3])[0] / 0.5;
    assert!(page.contains(&format!("04.png</td><td>{gain:.3}</td>")), "{page}");
    assert!(!page.contains("<h2>Lens effects"), "{page}");
    let render = |out: &Path, more: &[&str]| {
        let model = at("model");
        succeed(&[&["render", text(&model), "-o", text(out), "--quiet"], more].concat());
        picture(out)
    };
    let (plain, exposed) = (render(&at("a"), &[]), render(&at("b"), &["--exposure-of", "03.png"]));
    assert_ne!(plain, exposed);
    let (model, out, none) = (at("model"), at("c"), at("none"));
    let wanted = ["render", text(&model), "-o", text(&out), "--exposure-of"];
    refuse(&[wanted.as_slice(), &["01.png"]].concat(), &["exposure.json", "01.png", "02.png"]);
    let ply = at("model").join("point_cloud/iteration_40/point_cloud.ply");
    let bare = ["render", text(&ply), "-o", text(&out), "--orbit=1", "--exposure-of", "02.png"];
    refuse(&bare, &["--exposure-of", "model folder"]);
    // A new training removes the exposures of an older one.
    train(&at("data"), &model, &["--eval"]);
    assert!(!at("model").join("exposure.json").exists());
    refuse(&[wanted.as_slice(), &["02.png"]].concat(), &["exposure.json", "--exposure"]);
    std::fs::write(at("model").join("exposure.json"), "{\"02.png\": [[1, 2], 3]}").expect("written");
    refuse(&[wanted.as_slice(), &["02.png"]].concat(), &["exposure.json", "not a list of exposures"]);
    assert!(!out.exists() && !none.exists());
}

/// Vignetting and response: learned, saved for all photos, used by `render` and by measurements.
#[test]
fn lens_effects_are_learnt_saved_and_asked_for() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    write_dataset(&at("data"));
    let (data, model, out) = (at("data"), at("model"), at("out"));
    train(&data, &model, &["--eval", "--lens-effects", "--lens-lr=0.05"]);
    let lenses = LensFile::read(model.join("lens.json")).expect("the lenses");
    assert_eq!((lenses.cameras.len(), lenses.photos.len()), (1, 9));
    let learnt = lenses.of("01.png").expect("that of a held-out photo");
    assert!(learnt != Default::default() && lenses.of("none.png").is_none());
    assert!(!model.join("exposure.json").exists());
    let page = report(&model);
    let corner = learnt.vignetting(0, 1.0);
    assert!(page.contains(&format!(">1</td><td>9</td><td>{corner:.3}</td>")), "{page}");
    assert!(!page.contains("<h2>Exposures"), "{page}");
    // `eval` gives the training's results.
    let results = || std::fs::read_to_string(model.join("per_view.json")).expect("results");
    let trained = results();
    succeed(&["eval", text(&model), "--quiet"]);
    assert_eq!(trained, results());
    std::fs::rename(model.join("lens.json"), at("aside.json")).expect("moved");
    succeed(&["eval", text(&model), "--quiet"]);
    assert_ne!(trained, results());
    let wanted = ["render", text(&model), "-o", text(&out), "--quiet", "--lens-of"];
    refuse(&[wanted.as_slice(), &["01.png"]].concat(), &["lens.json", "--lens-effects"]);
    std::fs::rename(at("aside.json"), model.join("lens.json")).expect("back");
    refuse(&[wanted.as_slice(), &["99.png"]].concat(), &["lens.json", "99.png", "01.png"]);
    succeed(&wanted[..5]);
    let plain = picture(&out);
    succeed(&[wanted.as_slice(), &["01.png"]].concat());
    assert_ne!(plain, picture(&out));
    // Invalid files.
    let good = std::fs::read_to_string(model.join("lens.json")).expect("text");
    let unknown = good.replace("\"01.png\": 1", "\"01.png\": 8");
    assert_ne!(good, unknown);
    for (spoilt, words) in [
        ("{}".into(), ["lens.json", "cameras"]),
        (unknown, ["01.png", "camera 8"]),
        (good.replace("\"response\": [", "\"response\": [0.0,"), ["lens.json", "light"]),
        (good.replace("\"vignetting\"", "\"vignette\""), ["lens.json", "vignett"]),
    ] {
        std::fs::write(model.join("lens.json"), spoilt).expect("written");
        refuse(&[wanted.as_slice(), &["01.png"]].concat(), &words);
    }
    // A new training removes them.
    train(&data, &model, &["--eval"]);
    assert!(!model.join("lens.json").exists());
}

/// The reference's protocol: trains on the left half of the held-out views, and measures the right half.
#[test]
fn held_out_views_are_trained_on_their_left_half() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    write_dataset(&at("data"));
    let (data, model) = (at("data"), at("model"));
    refuse(
        &["train", "-s", text(&data), "-m", text(&model), "--train-test-exp"],
        &["train_test_exp", "--eval"],
    );
    train(&data, &model, &["--eval", "--train_test_exp"]);
    assert_eq!(exposure_json::read(model.join("exposure.json")).expect("the exposures").len(), 9);
    // The test's pictures are halves.
    let saved = |kind: &str| at("model").join("test/ours_40").join(kind).join("00000.png");
    for kind in ["gt", "renders"] {
        let size = ashsplat_files::images::photo_size(saved(kind)).expect("a picture");
        assert_eq!(size, (SIZE[0] / 2, SIZE[1]));
    }
    let results = |_| std::fs::read_to_string(at("model").join("per_view.json")).expect("results");
    let trained = results(());
    succeed(&["eval", text(&model), "--quiet"]);
    assert_eq!(trained, results(()));
    let cameras = std::fs::read_to_string(model.join("cameras.json")).expect("cameras");
    assert_eq!(cameras.matches("img_name").count(), 9);
    // The right half's pixels do not matter.
    let held_out = data.join("images/01.png");
    let mut photo = Photo::read(&held_out, [0.0; 3]).expect("a photo");
    for (pixel, rgb) in photo.rgb.chunks_mut(3).enumerate() {
        if pixel as u32 % SIZE[0] >= SIZE[0] / 2 {
            rgb.fill(0);
        }
    }
    photo.write_png(&held_out).expect("written");
    let spoilt = at("spoilt");
    train(&data, &spoilt, &["--eval", "--train_test_exp"]);
    let gaussians = |model: &Path| {
        std::fs::read(model.join("point_cloud/iteration_40/point_cloud.ply")).expect("the scene")
    };
    assert_eq!(gaussians(&model), gaussians(&spoilt));
    std::fs::remove_file(model.join("exposure.json")).expect("removed");
    refuse(&["eval", text(&model), "--quiet"], &["exposure.json"]);
}

/// A data set with observations of its points, and maps that are no inverse depths yet. Those of photo k are (1 / z
/// - 0.1) / (1 + k / 10).
struct Mapped {
    folder: TempDir,
}

fn scale_of(index: u32) -> f32 {
    1.0 + index as f32 / 10.0
}

impl Mapped {
    fn new() -> Mapped {
        let folder = tempdir().expect("a temporary folder");
        let data = folder.path().join("data");
        write_dataset(&data);
        let mapped = Mapped { folder };
        mapped.write_text_model();
        std::fs::create_dir(data.join("depths")).expect("a folder");
        (0..VIEWS).for_each(|index| mapped.write_map(index));
        mapped
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn map(&self, index: u32) -> PathBuf {
        self.data().join("depths").join(format!("{:02}.png", index + 1))
    }

    fn params(&self) -> PathBuf {
        self.data().join("sparse/0/depth_params.json")
    }

    fn write_text_model(&self) {
        let folder = self.data().join("sparse/0");
        std::fs::remove_dir_all(&folder).expect("removed");
        std::fs::create_dir_all(&folder).expect("created");
        let lens = view(0);
        let camera =
            format!("1 PINHOLE {} {} {} {} {} {}\n", SIZE[0], SIZE[1], lens.fx, lens.fy, lens.cx, lens.cy);
        std::fs::write(folder.join("cameras.txt"), camera).expect("written");
        let points = wall_points();
        let (mut images, mut rows) = (String::new(), String::new());
        for index in 0..VIEWS {
            let camera = view(index);
            let image = ColmapImage::posed(index + 1, 1, format!("{:02}.png", index + 1), &camera);
            let ([w, x, y, z], [tx, ty, tz]) = (image.quat, image.translation);
            images += &format!("{} {w} {x} {y} {z} {tx} {ty} {tz} 1 {}\n", image.id, image.name);
            for (id, point) in points.positions.iter().enumerate() {
                let p = camera.camera_from_world * Vec3::from_array(*point) + camera.translation;
                let place = [camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy];
                images += &format!("{} {} {} ", place[0], place[1], id + 1);
            }
            images += "3 3 -1\n";
        }
        for (id, (p, c)) in points.positions.iter().zip(&points.colors).enumerate() {
            rows += &format!("{} {} {} {} {} {} {} 0.5 1 2\n", id + 1, p[0], p[1], p[2], c[0], c[1], c[2]);
        }
        std::fs::write(folder.join("images.txt"), images).expect("written");
        std::fs::write(folder.join("points3D.txt"), rows).expect("written");
    }

    fn write_map(&self, index: u32) {
        let camera = view(index);
        let world_from_camera: Mat3 = camera.camera_from_world.transpose();
        let map = image::ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
            let (x, y) = (x as f32 + 0.5 - camera.cx, y as f32 + 0.5 - camera.cy);
            let ray = world_from_camera * Vec3::new(x / camera.fx, y / camera.fy, 1.0);
            // Distance to the wall at z = 0, along the ray with z = 1 in the camera's frame.
            let inverse_z = ray.z / -camera.position().z;
            image::Luma([((inverse_z - 0.1) / scale_of(index) * 65536.0) as u16])
        });
        map.save(self.map(index)).expect("a map");
    }

    fn refuses(&self, folder: &str, words: &[&str]) {
        let out = self.folder.path().join("out");
        let data = self.data();
        refuse(&["train", "-s", text(&data), "-m", text(&out), "-d", folder, "--quiet"], words);
        assert!(!out.exists(), "{:?}", files_below(&out));
    }
}

#[test]
fn depth_maps_are_scaled_and_trained_on() {
    let mapped = Mapped::new();
    let at = |name: &str| mapped.folder.path().join(name);
    let losses = |model: &Path| {
        let checkpoint = model.join("chkpnt40.safetensors");
        let read = <ashsplat::trainer::Checkpoint as ashsplat_files::CheckpointFile>::read(checkpoint);
        read.expect("a checkpoint").strategy.terms
    };
    let depth_of = |model: &Path| {
        let out = at("depth");
        succeed(&["render", text(model), "-o", text(&out), "--format=exr", "--quiet"]);
        std::fs::read(out.join("00000.exr")).expect("a picture")
    };
    let data = mapped.data();
    // Switches off the terms that few photos add.
    let [alone, too] = ["--opacity-reg=0", "--scale-reg=0"];
    train(&data, &at("plain"), &["--checkpoint-iterations=40", alone, too]);
    train(&data, &at("fitted"), &["--checkpoint-iterations=40", "-d", "depths", alone, too]);
    assert_eq!(losses(&at("plain")), ["photometric"]);
    assert_eq!(losses(&at("fitted")), ["photometric", "inverse_depth"]);
    assert_ne!(depth_of(&at("plain")), depth_of(&at("fitted")));
    // Parameters from a file have priority. These are the true ones, so the scene is nearly the same.
    let entry =
        |index: u32| format!("\"{:02}\": {{\"scale\": {}, \"offset\": 0.1}}", index + 1, scale_of(index));
    let entries: Vec<String> = (0..VIEWS).map(entry).collect();
    std::fs::write(mapped.params(), format!("{{{}}}", entries.join(", "))).expect("written");
    train(&data, &at("given"), &["--depths", "depths", alone, too]);
    let means = |model: &str| {
        let ply = at(model).join("point_cloud/iteration_40/point_cloud.ply");
        ashsplat_files::splats::read(ply, &Default::default()).expect("a scene").gaussians.means
    };
    let apart = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    let (plain, fitted, given) = (means("plain"), means("fitted"), means("given"));
    assert!(apart(&fitted, &given) < 0.2 * apart(&fitted, &plain), "{}", apart(&fitted, &given));
}

#[test]
fn depth_maps_that_lack_something_are_refused() {
    let mapped = Mapped::new();
    mapped.refuses("nowhere", &["nowhere", "no folder with depth maps"]);
    // A file with only some photos.
    std::fs::write(mapped.params(), "{\"01\": {\"scale\": 1, \"offset\": 0}}").expect("written");
    mapped.refuses("depths", &["depth_params.json", "02.png"]);
    std::fs::write(mapped.params(), "{\"01\": {\"scale\": 1}}").expect("written");
    mapped.refuses("depths", &["depth_params.json", "offset"]);
    // Values beyond the device's range; and values that no photograph can use, which is no fault of the sparse
    // points.
    let all_of = |scale: &str| {
        let entry = |index: u32| format!("\"{:02}\": {{\"scale\": {scale}, \"offset\": 0.1}}", index + 1);
        let entries: Vec<String> = (0..VIEWS).map(entry).collect();
        std::fs::write(mapped.params(), format!("{{{}}}", entries.join(", "))).expect("written");
    };
    all_of("1e300");
    mapped.refuses("depths", &["depth_params.json", "01 has a number that is too large"]);
    all_of("-1");
    mapped.refuses("depths", &["depth_params.json: has no scale above 0 for any photo", "remove it"]);
    std::fs::remove_file(mapped.params()).expect("removed");
    std::fs::remove_file(mapped.map(4)).expect("removed");
    mapped.refuses("depths", &["05.png", "depth map", "missing"]);
    image::GrayImage::new(SIZE[0], SIZE[1]).save(mapped.map(4)).expect("written");
    mapped.refuses("depths", &["05.png", "16-bit"]);
    std::fs::write(mapped.map(4), b"no picture").expect("written");
    mapped.refuses("depths", &["05.png"]);
    mapped.write_map(4);
    // Without observations the scale is unknown.
    write_dataset(&mapped.data());
    let text_parts = ["cameras.txt", "images.txt", "points3D.txt"];
    text_parts
        .iter()
        .for_each(|part| std::fs::remove_file(mapped.data().join("sparse/0").join(part)).expect("removed"));
    mapped.refuses("depths", &["depths", "none of the depth maps", "depth_params.json"]);
}

/// Depth maps of held-out photographs are never read: they may be missing, and the trained scene is the same.
#[test]
fn held_out_photos_need_no_depth_maps() {
    let mapped = Mapped::new();
    let data = mapped.data();
    let scene_of = |name: &str| {
        let model = mapped.folder.path().join(name);
        train(&data, &model, &["--eval", "-d", "depths"]);
        std::fs::read(model.join("point_cloud/iteration_40/point_cloud.ply")).expect("a scene")
    };
    let with_all = scene_of("all");
    [0, VIEWS - 1].iter().for_each(|&index| std::fs::remove_file(mapped.map(index)).expect("removed"));
    assert!(scene_of("some") == with_all);
    let entry = |index: u32| format!("\"{:02}\": {{\"scale\": 1.0, \"offset\": 0.1}}", index + 1);
    let entries: Vec<String> = (1..VIEWS - 1).map(entry).collect();
    std::fs::write(mapped.params(), format!("{{{}}}", entries.join(", "))).expect("written");
    assert!(scene_of("given") != with_all);
    // Training uses halves of the held-out photographs.
    let out = mapped.folder.path().join("out");
    let halves = ["train", "-s", text(&data), "-m", text(&out), "-d", "depths", "--eval", "--train-test-exp"];
    refuse(&halves, &["01.png", "depth map", "missing"]);
    mapped.refuses("depths", &["01.png", "depth map", "missing"]);
}

/// Depths in place of inverse depths.
#[test]
fn maps_of_depths_are_told() {
    let mapped = Mapped::new();
    for index in 0..VIEWS {
        let mut map = image::open(mapped.map(index)).expect("a map").into_luma16();
        map.pixels_mut().for_each(|pixel| pixel[0] = u16::MAX - pixel[0]);
        map.save(mapped.map(index)).expect("saved");
    }
    let (data, out) = (mapped.data(), mapped.folder.path().join("out"));
    let run = ["train", "-s", text(&data), "-m", text(&out), "--iterations=1", "-d", "depths"];
    let said = finish(program().args(run)).stderr;
    assert!(said.contains("fall where the sparse points come nearer"), "{said}");
}
