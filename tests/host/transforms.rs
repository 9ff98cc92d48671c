//! Data sets in transforms.json, masks, orientations and archives.

use std::path::Path;

use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Dataset, DatasetOptions, Photo, PhotoFileFormat, Progress, Resolution, ply};
use glam::Vec3;
use serde_json::{Value, json};

const SIZE: [u32; 2] = [20, 12];

fn camera(index: u32) -> Camera {
    let (sin, cos) = (index as f32 * 0.7).sin_cos();
    let intrinsics = Intrinsics { fx: 21.0, fy: 21.0, cx: 10.0, cy: 6.0, width: SIZE[0], height: SIZE[1] };
    Camera::look_at(Vec3::new(3.0 * cos, 3.0 * sin, 1.0), Vec3::ZERO, Vec3::Z, intrinsics)
}

/// Camera-to-world matrix with y up and z backward, as in the files.
fn matrix(camera: &Camera) -> Value {
    let r = camera.camera_from_world;
    let eye = camera.position();
    let row = |i: usize| json!([r.row(0)[i], -r.row(1)[i], -r.row(2)[i], eye[i]]);
    json!([row(0), row(1), row(2), [0, 0, 0, 1]])
}

fn photo(grey: u8) -> Photo {
    Photo { width: SIZE[0], height: SIZE[1], rgb: vec![grey; 3 * (SIZE[0] * SIZE[1]) as usize] }
}

fn write_json(path: &Path, value: &Value) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, value.to_string()).unwrap();
}

/// Writes photos 0.. of a folder and returns their frames; `ending` is appended to the names.
fn frames(folder: &Path, below: &str, indices: std::ops::Range<u32>, ending: &str) -> Vec<Value> {
    std::fs::create_dir_all(folder.join(below)).unwrap();
    let frame = |index: u32| {
        photo(index as u8).write_png(folder.join(below).join(format!("r_{index}.png"))).unwrap();
        json!({ "file_path": format!("./{below}/r_{index}{ending}"), "transform_matrix": matrix(&camera(index)) })
    };
    indices.map(frame).collect()
}

fn load(folder: &Path, options: &DatasetOptions) -> Dataset {
    let report = Dataset::inspect(folder, options, Progress::NONE);
    assert!(report.is_sound(), "{report}");
    let dataset = Dataset::load(folder, options, Progress::NONE).unwrap();
    assert_eq!((report.train_views, report.test_views), (dataset.train.len(), dataset.test.len()));
    dataset
}

fn refusal(folder: &Path) -> String {
    let message = Dataset::load(folder, &DatasetOptions::default(), Progress::NONE).unwrap_err().to_string();
    assert!(message.starts_with(folder.to_str().unwrap()) && !message.contains('\n'), "{message}");
    message
}

/// Horizontal field of view for fx = 21 and a width of 20.
fn angle() -> f64 {
    2.0 * (10.0f64 / 21.0).atan()
}

#[test]
fn synthetic_scenes_have_their_own_split() {
    let folder = tempfile::tempdir().unwrap();
    let train = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "train", 0..5, "") });
    let test = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "test", 5..7, "") });
    write_json(&folder.path().join("transforms_train.json"), &train);
    write_json(&folder.path().join("transforms_test.json"), &test);
    let all = load(folder.path(), &DatasetOptions::default());
    assert_eq!((all.train.len(), all.test.len()), (7, 0));
    let dataset = load(folder.path(), &DatasetOptions { eval: true, ..Default::default() });
    assert_eq!((dataset.train.len(), dataset.test.len()), (5, 2));
    assert_eq!(dataset.test[0].name, "test/r_5.png");
    for view in dataset.train.iter().chain(&dataset.test) {
        let index: u32 = view.name.rsplit_once("r_").unwrap().1.trim_end_matches(".png").parse().unwrap();
        let expected = camera(index);
        assert!(view.camera.camera_from_world.abs_diff_eq(expected.camera_from_world, 1e-5));
        assert!(view.camera.translation.abs_diff_eq(expected.translation, 1e-5));
        for (a, b) in
            [(view.camera.fx, 21.0), (view.camera.fy, 21.0), (view.camera.cx, 10.0), (view.camera.cy, 6.0)]
        {
            assert!((a - b).abs() < 1e-4);
        }
        assert!(view.photo.photo().unwrap().rgb.iter().all(|&v| u32::from(v) == index));
    }
    // Without points, the initial points are random and lie where the cameras look.
    assert!(dataset.points.is_empty() && dataset.may_lack_points());
    let bounds = dataset.initial_points(1).bounds().unwrap();
    assert!(bounds.center().length() < 0.1 && bounds.max.max_element() < 2.0, "{bounds:?}");
    for view in &dataset.train {
        let (x, y, _) = view.camera.project(bounds.center());
        assert!((x - 10.0).abs() < 1.0 && (y - 6.0).abs() < 1.0);
    }
}

#[test]
fn transparent_photos_show_the_background() {
    let folder = tempfile::tempdir().unwrap();
    let document = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "train", 0..2, "") });
    write_json(&folder.path().join("transforms_train.json"), &document);
    image::RgbaImage::from_pixel(20, 12, image::Rgba([200, 100, 0, 51]))
        .save(folder.path().join("train/r_0.png"))
        .unwrap();
    let first = |white_background| {
        let view =
            load(folder.path(), &DatasetOptions { white_background, ..Default::default() }).train.remove(0);
        // The background counts there; the pixel is not masked.
        assert!(!view.photo.is_masked());
        let photo = view.photo.photo().unwrap();
        [photo.rgb[0], photo.rgb[1], photo.rgb[2]]
    };
    assert_eq!(first(false), [40, 20, 0]);
    assert_eq!(first(true), [244, 224, 204]);
    // Training on random backgrounds gets the same photo with its opacity: here 0.2 of 254 steps.
    for resolution in [Resolution::Auto, Resolution::Width(10)] {
        let options = DatasetOptions { keep_opacity: true, resolution, ..Default::default() };
        let train = load(folder.path(), &options).train;
        let [clear, opaque] = [0, 1].map(|index| &train[index].photo);
        assert!(clear.is_transparent() && clear.mask().unwrap().is_none() && !opaque.is_masked());
        assert!(clear.texels().unwrap().as_chunks::<4>().0.iter().all(|texel| *texel == [40, 20, 0, 52]));
        // The right half is hidden, as with train_test_exp.
        let half = clear.hiding(|pixel| pixel % 2 == 1).unwrap();
        assert_eq!(half.mask().unwrap().unwrap()[..4], [255, 0, 255, 0]);
        assert_eq!(half.texels().unwrap()[..8], [40, 20, 0, 52, 40, 20, 0, 0]);
    }
}

#[test]
fn frames_may_have_their_own_lens_and_points() {
    let folder = tempfile::tempdir().unwrap();
    let mut list = frames(folder.path(), "images", 0..3, ".png");
    list[1]["fl_x"] = json!(30.0);
    list[1]["fl_y"] = json!(25.0);
    let document = json!({
        "fl_x": 21.0, "fl_y": 21.0, "cx": 10.0, "cy": 6.0, "w": 20, "h": 12, "k1": 0.0, "camera_model": "OPENCV",
        "ply_file_path": "sparse pc.ply", "frames": list,
    });
    write_json(&folder.path().join("transforms.json"), &document);
    assert!(refusal(folder.path()).contains("the point cloud of transforms.json is missing"));
    let points = PointCloud { positions: vec![[0.1, 0.2, 0.3]; 5], colors: vec![[1, 2, 3]; 5] };
    ply::write_points(folder.path().join("sparse pc.ply"), &points, &WorldFrame::default()).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.points, points);
    let focal: Vec<f32> = dataset.train.iter().map(|view| view.camera.fx).collect();
    assert_eq!(focal, [21.0, 30.0, 21.0]);
    assert_eq!(dataset.train[1].camera.fy, 25.0);
    // Every second photo is held out, as with COLMAP.
    let options = DatasetOptions { eval: true, test_every: 2, ..Default::default() };
    assert_eq!(load(folder.path(), &options).test.len(), 2);
}

/// Points stored before the transform of the poses are moved to the cameras.
#[test]
fn points_in_the_older_frame_are_moved() {
    let folder = tempfile::tempdir().unwrap();
    let applied = json!([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, -8.0]]);
    let document = json!({
        "camera_angle_x": angle(), "applied_transform": applied, "ply_file_path": "a.ply",
        "frames": frames(folder.path(), "images", 0..6, ".png"),
    });
    write_json(&folder.path().join("transforms.json"), &document);
    let stored = |position: [f32; 3]| {
        let points = PointCloud { positions: vec![position; 4], colors: vec![[1; 3]; 4] };
        ply::write_points(folder.path().join("a.ply"), &points, &WorldFrame::default()).unwrap();
        load(folder.path(), &DatasetOptions::default())
    };
    let dataset = stored([0.1, 0.2, 0.0]);
    assert_eq!((dataset.points.positions[0], dataset.warnings.len()), ([0.1, 0.2, 0.0], 0));
    let dataset = stored([0.1, 0.2, -8.0]);
    assert_eq!(dataset.points.positions[0], [0.2, 0.1, 0.0]);
    assert!(dataset.warnings[0].contains("applied_transform"), "{:?}", dataset.warnings);
}

/// The poses were multiplied by the scale after the transform.
#[test]
fn points_from_before_the_scale_are_moved() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let list = frames(folder.path(), "images", 0..6, ".png");
    let mut document = json!({
        "camera_angle_x": angle(), "applied_scale": 0.1, "ply_file_path": "a.ply", "frames": list,
        "applied_transform": [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, -8.0]],
    });
    write_json(&place("transforms.json"), &document);
    let points = PointCloud { positions: vec![[1.0, 2.0, -8.0]; 4], colors: vec![[1; 3]; 4] };
    ply::write_points(place("a.ply"), &points, &WorldFrame::default()).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.points.positions[0], [0.2, 0.1, 0.0]);
    assert!(dataset.warnings[0].contains("applied_scale"), "{:?}", dataset.warnings);
    document["frames"][1]["transform_matrix"][3] = json!([0.1, 0, 0, 1]);
    write_json(&place("transforms.json"), &document);
    assert!(
        refusal(folder.path()).contains("frame 1: the last row of transform_matrix is [0.1, 0.0, 0.0, 1.0]")
    );
    document["frames"][1]["transform_matrix"][3] = json!([0, 0, 0, 1]);
    document["applied_scale"] = json!("0.1");
    write_json(&place("transforms.json"), &document);
    assert!(refusal(folder.path()).contains("applied_scale is not a number above 0"));
}

/// Warnings name keys without effect, unless they are 0.
#[test]
fn keys_that_are_not_used_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let warnings = |keys: Value, of_frame: Value| {
        let mut list = frames(folder.path(), "images", 0..3, ".png");
        list[0]["time"] = json!(0);
        list[1].as_object_mut().unwrap().extend(of_frame.as_object().unwrap().clone());
        let mut document = json!({ "fl_x": 21.0, "w": 20, "h": 12, "frames": list });
        document.as_object_mut().unwrap().extend(keys.as_object().unwrap().clone());
        write_json(&folder.path().join("transforms.json"), &document);
        let mut lines = load(folder.path(), &DatasetOptions::default()).warnings;
        lines.retain(|line| !line.contains("point"));
        lines
    };
    let none =
        json!({ "b1": 0, "b2": 0.0, "distortion_params": [0, 0, 0, 0, 0, 0], "distortion": [0, 0], "k1": 0 });
    assert_eq!(warnings(none, json!({})), [""; 0]);
    let lines = warnings(json!({ "test_frames": [{}] }), json!({ "sky_mask": "a.png", "is_bad": true }));
    assert!(lines.len() == 1 && lines[0].contains("is_bad, sky_mask, test_frames: such keys"), "{lines:?}");
    let lines =
        warnings(json!({ "b1": 2, "ftheta_p0": 0.1, "distortion": { "k1": 1 } }), json!({ "k6": 0.1 }));
    assert!(lines.len() == 1 && lines[0].contains("b1, distortion, ftheta_p0, k6 are"), "{lines:?}");
    let lines = warnings(json!({ "distortion_params": [0.1, 0.2] }), json!({}));
    assert!(lines.len() == 1 && lines[0].contains("distortion_params is"), "{lines:?}");
    let lines = warnings(json!({ "camera_model": "OPENCV_FISHEYE", "k1": 0.01, "p2": 0.01 }), json!({}));
    assert!(lines.len() == 1 && lines[0].contains(": p2 is"), "{lines:?}");
    let lines = warnings(json!({ "camera_angle_x": 0.8886 }), json!({ "time": 0.5 }));
    assert!(lines.len() == 1 && lines[0].contains("are of times from 0 to 0.5"), "{lines:?}");
    let lines = warnings(json!({ "camera_angle_x": 1.2 }), json!({ "fl_x": 40 }));
    assert!(lines.len() == 1 && lines[0].contains("camera_angle_x means 14.6: fl_x is used"), "{lines:?}");
}

/// The list of nerfstudio means the keys k1, k2, k3, k4, p1 and p2.
#[test]
fn distortion_params_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = |keys: Value| {
        let mut document =
            json!({ "fl_x": 21.0, "w": 20, "h": 12, "frames": frames(folder.path(), "images", 0..2, "") });
        document.as_object_mut().unwrap().extend(keys.as_object().unwrap().clone());
        write_json(&folder.path().join("transforms.json"), &document);
        let dataset = load(folder.path(), &DatasetOptions::default());
        dataset.train.iter().map(|view| (view.camera, view.photo.clone())).collect::<Vec<_>>()
    };
    let by_list = sizes(json!({ "distortion_params": [-0.2, 0, 0, 0, 0.01, 0] }));
    assert!(by_list == sizes(json!({ "k1": -0.2, "p1": 0.01 })) && by_list[0].0.width < 20);
}

/// If no placement is better, the points stay, with a warning.
#[test]
fn points_that_fit_either_frame_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let applied = json!([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]]);
    let document = json!({
        "camera_angle_x": angle(), "applied_transform": applied, "ply_file_path": "/home/me/data/a.ply",
        "frames": frames(folder.path(), "images", 0..6, ".png"),
    });
    write_json(&folder.path().join("transforms.json"), &document);
    let points = PointCloud { positions: vec![[0.1, 0.2, 0.0]; 4], colors: vec![[1; 3]; 4] };
    ply::write_points(folder.path().join("a.ply"), &points, &WorldFrame::default()).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.points, points);
    let said = ["\"/home/me/data/a.ply\" is not there", "as many points before applied_transform"];
    assert!(
        said.iter().all(|words| dataset.warnings.iter().any(|w| w.contains(words))),
        "{:?}",
        dataset.warnings
    );
    assert_eq!(dataset.warnings.len(), 2);
}

/// Warnings name points without finite positions and files of points that are not read.
#[test]
fn points_that_cannot_be_used_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let document = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "images", 0..3, "") });
    write_json(&place("transforms.json"), &document);
    let warnings = |said: &str| {
        let mut lines = load(folder.path(), &DatasetOptions::default()).warnings;
        lines.retain(|line| line.contains(said));
        lines
    };
    for name in ["points.las", "Scan.LAZ", "a.e57", "b.pts", "c.xyz"] {
        std::fs::write(place(name), "").unwrap();
        let lines = warnings("its points are not used");
        assert!(
            lines.len() == 1 && lines[0].contains(name) && lines[0].contains("points3d.ply"),
            "{lines:?}"
        );
        std::fs::remove_file(place(name)).unwrap();
    }
    std::fs::write(place("points.las"), "").unwrap();
    let points = PointCloud { positions: vec![[0.0; 3], [f32::NAN; 3], [0.0; 3]], colors: vec![[9; 3]; 3] };
    ply::write_points(place("points3d.ply"), &points, &WorldFrame::default()).unwrap();
    assert_eq!(warnings("its points are not used"), [""; 0]);
    assert_eq!(warnings("1 of 3 points have a position that is not finite").len(), 1);
}

/// Points without a `ply_file_path` are used under the usual names; a warning names others.
#[test]
fn points_beside_the_file_are_used_or_named() {
    let folder = tempfile::tempdir().unwrap();
    let document = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "images", 0..3, "") });
    write_json(&folder.path().join("transforms.json"), &document);
    let points = PointCloud { positions: vec![[0.1, 0.2, 0.0]; 4], colors: vec![[1; 3]; 4] };
    colmap::write(folder.path().join("colmap/sparse/0"), &[], &[], &points).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert!(dataset.warnings[0].contains("colmap/sparse/0: its points are not used; `colmap model_conv"));
    for (name, words) in [
        ("mesh.ply", Some("mesh.ply is not used; name it there")),
        ("sparse_pc.ply", Some("the points of ")),
        ("points3D.ply", Some("sparse_pc.ply is not")),
    ] {
        ply::write_points(folder.path().join(name), &points, &WorldFrame::default()).unwrap();
        let dataset = load(folder.path(), &DatasetOptions::default());
        assert_eq!(dataset.points.is_empty(), name == "mesh.ply", "{name}");
        let said = |words: &str| dataset.warnings.iter().filter(|w| w.contains(words)).count();
        assert_eq!((said("has no ply_file_path"), words.map(said)), (1, Some(1)), "{:?}", dataset.warnings);
    }
}

/// A file of Gaussians can serve as points.
#[test]
fn points_may_be_gaussians() {
    let folder = tempfile::tempdir().unwrap();
    let document = json!({
        "camera_angle_x": angle(), "ply_file_path": "a.ply",
        "frames": frames(folder.path(), "images", 0..3, ""),
    });
    write_json(&folder.path().join("transforms.json"), &document);
    let points = PointCloud { positions: vec![[0.1, 0.2, 0.0]; 4], colors: vec![[10, 20, 30]; 4] };
    let gaussians = ashsplat_files::initial_gaussians(&points, 1).unwrap();
    ply::write(folder.path().join("a.ply"), &gaussians).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.points, points);
    assert!(
        dataset.warnings[0].contains("a.ply: holds Gaussians, taken as points"),
        "{:?}",
        dataset.warnings
    );
}

#[test]
fn files_of_other_names_are_taken_where_one_is_meant() {
    let folder = tempfile::tempdir().unwrap();
    let train = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "train", 0..3, "") });
    let test = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "test", 3..5, "") });
    let eval = DatasetOptions { eval: true, test_every: 2, ..Default::default() };
    for (files, counts) in [
        (&["transform.json"][..], (1, 2)),
        (&["Transforms.JSON"], (1, 2)),
        (&["cameras.json"], (1, 2)),
        (&["transforms.json.txt"], (1, 2)),
        (&["transforms_test.json"], (1, 2)),
        (&["transform_train.json"], (1, 2)),
        (&["transform_train.json", "transform_test.json"], (3, 2)),
        (&["transforms_train.json", "transform_val.json"], (3, 2)),
    ] {
        let place = |name: &str| folder.path().join(name);
        std::fs::write(place("notes.json"), "[1, 2]").unwrap();
        files.iter().zip([&train, &test]).for_each(|(name, document)| write_json(&place(name), document));
        let dataset = load(folder.path(), &eval);
        let said = dataset.warnings.iter().filter(|w| w.contains("taken for transforms.json")).count();
        assert_eq!(said, usize::from(files[0] != "transforms_train.json"), "{:?}", dataset.warnings);
        assert_eq!((dataset.train.len(), dataset.test.len()), counts, "{files:?}");
        files.iter().for_each(|name| std::fs::remove_file(place(name)).unwrap());
    }
    write_json(&folder.path().join("one.json"), &train);
    write_json(&folder.path().join("two.json"), &test);
    let message = refusal(folder.path());
    assert!(
        message.contains("several files have poses (") && message.contains("two.json): call one"),
        "{message}"
    );
}

#[test]
fn json_with_decimal_commas_or_in_utf_16_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let document = json!({ "fl_x": 21.5, "frames": frames(folder.path(), "images", 0..2, "") }).to_string();
    std::fs::write(&path, document.replace("21.5", "21,5")).unwrap();
    assert!(refusal(folder.path()).contains("has a decimal comma"), "{}", refusal(folder.path()));
    let utf_16 = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    std::fs::write(&path, utf_16(&format!("\u{feff}{document}"))).unwrap();
    assert!(refusal(folder.path()).contains("is text in UTF-16"), "{}", refusal(folder.path()));
}

#[test]
fn distorted_frames_are_undistorted() {
    let folder = tempfile::tempdir().unwrap();
    let document = json!({
        "fl_x": 21.0, "cx": 10.0, "cy": 6.0, "w": 20, "h": 12, "k1": -0.2, "p1": 0.01,
        "frames": frames(folder.path(), "images", 0..2, ".png"),
    });
    write_json(&folder.path().join("transforms.json"), &document);
    let dataset = load(folder.path(), &DatasetOptions::default());
    let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
    assert!(report.notes[0].contains("distortion") && report.notes[0].contains("19x11"), "{report}");
    let camera = dataset.train[0].camera;
    // The image loses half a pixel at each side, and keeps its scale.
    assert_eq!((camera.width, camera.height, camera.fx, camera.fy), (19, 11, 21.0, 21.0));
    assert_eq!(dataset.train[0].photo.width, camera.width);
}

#[test]
fn masks_and_alpha_say_what_counts() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let images: Vec<_> =
        (0..4).map(|i| ColmapImage::posed(i + 1, 1, format!("{i}.png"), &camera(i))).collect();
    let points = PointCloud { positions: vec![[0.0; 3]; 2], colors: vec![[9; 3]; 2] };
    colmap::write(place("sparse/0"), &[ColmapCamera::pinhole(1, &camera(0))], &images, &points).unwrap();
    std::fs::create_dir_all(place("images")).unwrap();
    std::fs::create_dir_all(place("masks")).unwrap();
    (0..4).for_each(|i| photo(50).write_png(place("images").join(format!("{i}.png"))).unwrap());
    // The left half counts in 0 by a mask, the top half in 1 by its alpha, everything in 2 by a mask; 3 has no mask.
    let half = |left: bool| {
        image::GrayImage::from_fn(20, 12, |x, y| {
            image::Luma([if (left && x < 10) || (!left && y < 6) { 255 } else { 0 }])
        })
    };
    half(true).save(place("masks/0.png")).unwrap();
    let alpha = half(false);
    image::RgbaImage::from_fn(20, 12, |x, y| image::Rgba([50, 50, 50, alpha.get_pixel(x, y).0[0]]))
        .save(place("images/1.png"))
        .unwrap();
    image::GrayImage::from_pixel(20, 12, image::Luma([255])).save(place("masks/2.png.png")).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    let masks: Vec<_> = dataset.train.iter().map(|view| view.photo.mask().unwrap()).collect();
    let shown = |i: usize| masks[i].as_ref().unwrap().to_vec();
    assert!(shown(0) == *half(true).as_raw() && shown(1) == *half(false).as_raw());
    assert_eq!(masks[2..], [None, None]);
    // The mask is scaled with the photo.
    let options = DatasetOptions { resolution: "2".parse().unwrap(), ..Default::default() };
    let small = load(folder.path(), &options).train.remove(0).photo.mask().unwrap().unwrap();
    assert_eq!((small.len(), small[0], small[9]), (60, 255, 0));
    image::GrayImage::new(3, 3).save(place("masks/3.png")).unwrap();
    assert!(refusal(folder.path()).contains("masks/3.png: is 3x3 pixels, its photo 20x12"));
}

#[test]
fn a_zip_is_a_data_set() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let document = json!({ "camera_angle_x": angle(), "frames": frames(&data, "images", 0..3, ".png") });
    write_json(&data.join("transforms.json"), &document);
    let pack = |name: &str, prefix: &str, photos: u32| {
        let mut zip = zip::ZipWriter::new(std::fs::File::create(folder.path().join(name)).unwrap());
        let options = zip::write::SimpleFileOptions::default();
        let mut add = |file: &str| {
            zip.start_file(format!("{prefix}{file}"), options).unwrap();
            zip.write_all(&std::fs::read(data.join(file)).unwrap()).unwrap();
        };
        add("transforms.json");
        (0..photos).for_each(|i| add(&format!("images/r_{i}.png")));
        zip.finish().unwrap();
        folder.path().join(name)
    };
    let plain = load(&data, &DatasetOptions::default());
    for (name, prefix) in [("plain.zip", ""), ("in_folder.zip", "scene/")] {
        let zipped = load(&pack(name, prefix, 3), &DatasetOptions::default());
        assert_eq!(zipped.train, plain.train);
        assert_eq!(Dataset::cameras(folder.path().join(name), &DatasetOptions::default()).unwrap().len(), 3);
    }
    // An archive as macOS and Windows create it.
    let mut zip = zip::ZipWriter::new(std::fs::File::create(folder.path().join("finder.zip")).unwrap());
    let options = zip::write::SimpleFileOptions::default();
    for name in
        ["scene/.DS_Store", "__MACOSX/scene/._transforms.json", "scene/images/._r_0.png", "__MACOSX/._scene"]
    {
        zip.start_file(name, options).unwrap();
        zip.write_all(b"no picture").unwrap();
    }
    for name in ["transforms.json", "images/r_0.png", "images/r_1.png", "images/r_2.png"] {
        zip.start_file(format!("outer\\scene\\{}", name.replace('/', "\\")), options).unwrap();
        zip.write_all(&std::fs::read(data.join(name)).unwrap()).unwrap();
    }
    zip.finish().unwrap();
    assert_eq!(load(&folder.path().join("finder.zip"), &DatasetOptions::default()).train, plain.train);
    // An archive without a file extension, and beside other folders.
    std::fs::copy(folder.path().join("plain.zip"), folder.path().join("plain")).unwrap();
    assert!(Dataset::is_archive(folder.path().join("plain")) && !Dataset::is_archive(&data));
    assert_eq!(load(&folder.path().join("plain"), &DatasetOptions::default()).train, plain.train);
    let several = |name: &str, files: &[&str]| {
        let path = folder.path().join(name);
        let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
        for file in files {
            zip.start_file(*file, zip::write::SimpleFileOptions::default()).unwrap();
            let source = data.join(file.split_once('/').unwrap().1);
            zip.write_all(&std::fs::read(source).unwrap_or_default()).unwrap();
        }
        zip.finish().unwrap();
        path
    };
    let photos = ["fox/transforms.json", "fox/images/r_0.png", "fox/images/r_1.png", "fox/images/r_2.png"];
    let beside = several("beside.zip", &[&photos[..], &["notes/a.txt"]].concat());
    assert_eq!(load(&beside, &DatasetOptions::default()).train, plain.train);
    let two = several("two.zip", &["fox/transforms.json", "hare/transforms.json"]);
    assert!(refusal(&two).contains("holds several data sets: fox, hare; unpack it"));
    assert!(refusal(&several("empty.zip", &[])).contains("is an empty ZIP"));
    let text = folder.path().join("text.zip");
    std::fs::write(&text, "none").unwrap();
    assert!(refusal(&text).contains("is not a folder, nor a ZIP"));
    // Problems name the archive.
    let missing = pack("missing.zip", "", 2);
    assert!(
        refusal(&missing)
            .contains("missing.zip/images/r_2.png: the photo of frame images/r_2.png is missing")
    );
    let bytes = std::fs::read(folder.path().join("plain.zip")).unwrap();
    let cut = folder.path().join("cut.zip");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    assert!(refusal(&cut).contains("is no whole ZIP"));
    let mut evil = zip::ZipWriter::new(std::fs::File::create(folder.path().join("evil.zip")).unwrap());
    evil.start_file("../outside.txt", zip::write::SimpleFileOptions::default()).unwrap();
    evil.write_all(b"x").unwrap();
    evil.finish().unwrap();
    assert!(refusal(&folder.path().join("evil.zip")).contains("leads out of the archive"));
    assert!(!folder.path().join("outside.txt").exists());
    let mut only = zip::ZipWriter::new(std::fs::File::create(folder.path().join("photos.zip")).unwrap());
    only.start_file("scene/images/a.jpg", zip::write::SimpleFileOptions::default()).unwrap();
    only.write_all(b"x").unwrap();
    only.finish().unwrap();
    let message = refusal(&folder.path().join("photos.zip"));
    assert!(message.contains("photos.zip: holds photos without cameras; unpack it"), "{message}");
}

#[test]
fn lists_of_names_split_the_frames() {
    let folder = tempfile::tempdir().unwrap();
    let list = frames(folder.path(), "images", 0..6, ".png");
    let named =
        |indices: &[u32]| json!(indices.iter().map(|i| format!("images/r_{i}.png")).collect::<Vec<_>>());
    let write = |lists: Value| {
        let mut document = json!({ "camera_angle_x": angle(), "frames": list.clone() });
        document.as_object_mut().unwrap().extend(lists.as_object().unwrap().clone());
        write_json(&folder.path().join("transforms.json"), &document);
    };
    let split = || {
        let dataset = load(folder.path(), &DatasetOptions { eval: true, ..Default::default() });
        let names = |views: &[ashsplat_files::View]| views.iter().map(|v| v.name[9..10].to_owned()).collect();
        let (train, test): (String, String) = (names(&dataset.train), names(&dataset.test));
        (train, test, dataset.warnings[0].clone())
    };
    // The last photo is in no list, and the one before only in a list that the test's list overrides.
    write(
        json!({ "train_filenames": named(&[0, 1, 2]), "test_filenames": named(&[3]), "val_filenames": named(&[4]) }),
    );
    let (train, test, warning) = split();
    assert_eq!((train.as_str(), test.as_str()), ("012", "3"));
    assert!(warning.contains("2 of 6 frames are in none of the lists train_filenames and test_filenames"));
    assert_eq!(load(folder.path(), &DatasetOptions::default()).train.len(), 4);
    write(
        json!({ "train_filenames": named(&[0, 1]), "test_filenames": [], "val_filenames": named(&[4, 5]) }),
    );
    let (train, test, _) = split();
    assert_eq!((train.as_str(), test.as_str()), ("01", "45"));
    write(json!({ "test_filenames": named(&[1]) }));
    let (train, test, _) = split();
    assert_eq!((train.as_str(), test.as_str()), ("02345", "1"));
    write(json!({ "train_filenames": ["images/r_0.png", "images/other.png"] }));
    assert!(
        refusal(folder.path()).contains("train_filenames names \"images/other.png\", which no frame has")
    );
    write(json!({ "test_filenames": "images/r_0.png" }));
    assert!(refusal(folder.path()).contains("test_filenames is not a list of names"));
}

#[test]
fn masks_beside_the_photos_need_no_mask_path() {
    let folder = tempfile::tempdir().unwrap();
    let document = json!({ "camera_angle_x": angle(), "frames": frames(folder.path(), "images", 0..3, "") });
    write_json(&folder.path().join("transforms.json"), &document);
    std::fs::create_dir_all(folder.path().join("masks")).unwrap();
    let half = image::GrayImage::from_fn(20, 12, |x, _| image::Luma([if x < 10 { 255 } else { 0 }]));
    half.save(folder.path().join("masks/r_1.png")).unwrap();
    let train = load(folder.path(), &DatasetOptions::default()).train;
    let masks: Vec<_> = train.iter().map(|view| view.photo.mask().unwrap()).collect();
    assert!(masks[0].is_none() && masks[2].is_none());
    assert!(**masks[1].as_ref().unwrap() == **half.as_raw());
}

#[test]
fn absurd_cameras_are_refused_or_named() {
    let folder = tempfile::tempdir().unwrap();
    let list = frames(folder.path(), "images", 0..5, ".png");
    let moved = |x: f64| {
        let mut list = list.clone();
        list[2]["transform_matrix"][0][3] = json!(x);
        list
    };
    let write = |mut document: Value, frames: Vec<Value>| {
        document["frames"] = json!(frames);
        write_json(&folder.path().join("transforms.json"), &document);
    };
    for far in [1e38, 2e9] {
        write(json!({ "fl_x": 21.0 }), moved(far));
        let message = refusal(folder.path());
        assert!(
            message.contains("frame images/r_2.png: ") && message.contains("from the origin"),
            "{message}"
        );
    }
    for (key, value, what) in [
        ("cx", 1e9, "the principal point in x is at 1000000000 of 20 pixels"),
        ("fl_x", 1e-9, "the focal length in x is"),
        ("fl_x", 1e9, "the focal length in x is"),
    ] {
        let mut document = json!({ "fl_x": 21.0, "fl_y": 21.0 });
        document[key] = json!(value);
        write(document, list.clone());
        let message = refusal(folder.path());
        assert!(message.contains(what), "{message}");
    }
    write(json!({ "fl_x": 21.0 }), moved(1e5));
    let stray = |dataset: &Dataset| {
        dataset.warnings.iter().any(|w| w.contains("the camera of images/r_2.png lies at"))
    };
    assert!(stray(&load(folder.path(), &DatasetOptions::default())));
    write(json!({ "fl_x": 21.0 }), moved(6.0));
    assert!(!stray(&load(folder.path(), &DatasetOptions::default())));
}

#[test]
fn far_frames_and_points_keep_their_places() {
    let loaded = |offset: [f64; 3]| {
        let folder = tempfile::tempdir().unwrap();
        let mut list = frames(folder.path(), "images", 0..6, ".png");
        for frame in &mut list {
            for (axis, offset) in offset.iter().enumerate() {
                let value = &mut frame["transform_matrix"][axis][3];
                *value = (value.as_f64().unwrap() + offset).into();
            }
        }
        let point = [0.25, -0.5, 0.125].iter().zip(offset).map(|(v, offset)| (v + offset).to_string());
        let point = point.collect::<Vec<_>>().join(" ");
        let header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
        std::fs::write(folder.path().join("a.ply"), format!("{header}end_header\n{point}\n")).unwrap();
        let document = json!({ "camera_angle_x": angle(), "ply_file_path": "a.ply", "frames": list });
        write_json(&folder.path().join("transforms.json"), &document);
        load(folder.path(), &DatasetOptions::default())
    };
    let (near, far) = (loaded([0.0; 3]), loaded([500_000.0, 5_000_000.0, 120.0]));
    assert!(near.frame.is_identity() && far.frame.origin.y == 5e6);
    assert_eq!(far.points, near.points);
    for (far, near) in far.train.iter().zip(&near.train) {
        assert!(
            far.camera.translation.abs_diff_eq(near.camera.translation, 1e-6),
            "{}",
            far.camera.translation
        );
    }
}
