//! Data sets in transforms.json, masks, orientations and archives.

use super::files::{Folder, assert_one, assert_says, assert_some, cloud, left_half, named, refusal, with};
use ashsplat::scene::{Camera, Intrinsics, Readout, WorldFrame};
use ashsplat_files::{AlphaUse, Dataset, DatasetOptions, Progress, Resolution, splats};
use ashsplat_files::{cameras_json, colmap};
use glam::{Vec3, dvec2};
use image::{GrayImage, Luma, Rgba, RgbaImage};
use serde_json::{Value, json};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;

fn camera(index: u32) -> Camera {
    let (sin, cos) = (index as f32 * 0.7).sin_cos();
    let intrinsics = Intrinsics { fx: 21.0, fy: 21.0, cx: 10.0, cy: 6.0, width: 20, height: 12 };
    Camera::look_at(Vec3::new(3.0 * cos, 3.0 * sin, 1.0), Vec3::ZERO, Vec3::Z, intrinsics)
}

/// Camera-to-world matrix with y up and z backward, as in the files.
fn matrix(camera: &Camera) -> Value {
    let r = camera.camera_from_world;
    let eye = camera.position();
    let row = |i: usize| json!([r.row(0)[i], -r.row(1)[i], -r.row(2)[i], eye[i]]);
    json!([row(0), row(1), row(2), [0, 0, 0, 1]])
}

impl Folder {
    /// Writes photos of a folder and returns their frames; `ending` is appended to the names.
    fn frames(&self, below: &str, indices: Range<u32>, ending: &str) -> Vec<Value> {
        let frame = |index: u32| {
            self.photo(&format!("{below}/r_{index}.png"), index as u8);
            let name = format!("./{below}/r_{index}{ending}");
            json!({ "file_path": name, "transform_matrix": matrix(&camera(index)) })
        };
        indices.map(frame).collect()
    }

    fn transforms(&self, count: u32, keys: &Value) {
        let frames = self.frames("images", 0..count, ".png");
        self.json("transforms.json", &with(json!({ "camera_angle_x": angle(), "frames": frames }), keys));
    }

    fn sound(&self) -> Dataset {
        load(self, &DatasetOptions::default())
    }
}

fn load(path: &Path, options: &DatasetOptions) -> Dataset {
    let report = Dataset::inspect(path, options, Progress::NONE);
    assert!(report.is_sound(), "{report}");
    let dataset = Dataset::load(path, options, Progress::NONE).unwrap();
    assert_eq!((report.train_views, report.test_views), (dataset.train.len(), dataset.test.len()));
    dataset
}

#[track_caller]
fn assert_refused(path: &Path, words: &[&str]) {
    assert_says(refusal(path, Dataset::load(path, &DatasetOptions::default(), Progress::NONE)), words);
}

/// Horizontal field of view for fx = 21 and a width of 20.
fn angle() -> f64 {
    2.0 * (10.0f64 / 21.0).atan()
}

#[test]
fn synthetic_scenes_have_their_own_split() {
    let folder = Folder::new();
    let split = |name: &str, indices: Range<u32>| {
        let document = json!({ "camera_angle_x": angle(), "frames": folder.frames(name, indices, "") });
        folder.json(&format!("transforms_{name}.json"), &document);
    };
    split("train", 0..5);
    split("test", 5..7);
    let all = folder.sound();
    assert_eq!((all.train.len(), all.test.len()), (7, 0));
    let dataset = load(&folder, &DatasetOptions { eval: true, ..Default::default() });
    assert_eq!((dataset.train.len(), dataset.test.len()), (5, 2));
    assert_eq!(dataset.test[0].name, "test/r_5.png");
    for view in dataset.train.iter().chain(&dataset.test) {
        let index: u32 = view.name.rsplit_once("r_").unwrap().1.trim_end_matches(".png").parse().unwrap();
        let expected = camera(index);
        assert!(view.camera.camera_from_world.abs_diff_eq(expected.camera_from_world, 1e-5));
        assert!(view.camera.translation.abs_diff_eq(expected.translation, 1e-5));
        let Camera { fx, fy, cx, cy, .. } = view.camera;
        for (value, expected) in [(fx, 21.0), (fy, 21.0), (cx, 10.0), (cy, 6.0)] {
            assert!((value - expected).abs() < 1e-4);
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
    let folder = Folder::new();
    folder.transforms(2, &json!({}));
    folder.save("images/r_0.png", RgbaImage::from_pixel(20, 12, Rgba([200, 100, 0, 51])));
    for (white_background, color) in [(false, [40, 20, 0]), (true, [244, 224, 204])] {
        let options = DatasetOptions { white_background, ..Default::default() };
        let view = load(&folder, &options).train.remove(0);
        // The background counts there; the pixel is not masked.
        assert!(!view.photo.is_masked());
        assert_eq!(view.photo.photo().unwrap().rgb[..3], color);
    }
    // Training on random backgrounds gets the same photo with its opacity: here 0.2 of 254 steps.
    for resolution in [Resolution::Auto, Resolution::Width(10)] {
        let options = DatasetOptions { keep_opacity: true, resolution, ..Default::default() };
        let train = load(&folder, &options).train;
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
    let folder = Folder::new();
    let mut list = folder.frames("images", 0..3, ".png");
    list[1]["fl_x"] = json!(30.0);
    list[1]["fl_y"] = json!(25.0);
    let document = json!({
        "fl_x": 21.0, "fl_y": 21.0, "cx": 10.0, "cy": 6.0, "w": 20, "h": 12, "k1": 0.0, "camera_model": "OPENCV",
        "ply_file_path": "sparse pc.ply", "frames": list,
    });
    folder.json("transforms.json", &document);
    assert_refused(&folder, &["the point cloud of transforms.json is missing"]);
    let points = cloud(&[[0.1, 0.2, 0.3]; 5], [1, 2, 3]);
    folder.points("sparse pc.ply", &points);
    let dataset = folder.sound();
    assert_eq!(dataset.points, points);
    let focal: Vec<f32> = dataset.train.iter().map(|view| view.camera.fx).collect();
    assert_eq!(focal, [21.0, 30.0, 21.0]);
    assert_eq!(dataset.train[1].camera.fy, 25.0);
    // Every second photo is held out, as with COLMAP.
    let options = DatasetOptions { eval: true, test_every: 2, ..Default::default() };
    assert_eq!(load(&folder, &options).test.len(), 2);
}

/// Points stored before the transform of the poses, or before their scale, are moved to the cameras. If no placement
/// is better, the points stay, with a warning.
/// The files are those that nerfstudio's `polycam_to_json` and `record3d_to_json` write, with the points of its `--glb` and `--ply`
/// options.
#[test]
fn captures_of_polycam_and_record3d_are_read_as_nerfstudio_leaves_them() {
    let points = cloud(&[[0.1, 0.2, 0.0]; 4], [1; 3]);
    let expected: Vec<Camera> = (0..3).map(camera).collect();
    let assert_places = |dataset: &Dataset| {
        assert_eq!((dataset.train.len(), &dataset.points), (3, &points));
        for (view, camera) in dataset.train.iter().zip(&expected) {
            assert!(view.camera.position().distance(camera.position()) < 1e-5);
            assert!(view.camera.camera_from_world.abs_diff_eq(camera.camera_from_world, 1e-6));
        }
    };

    let polycam = Folder::new();
    polycam.points("point_cloud.ply", &points);
    // Each frame has intrinsics of its own, less the cropped border. Two blurred photos have no frame.
    let frame = |index: u32| {
        let name = format!("images/frame_{:05}.png", index + 1);
        ["images", "images_2", "images_4"]
            .iter()
            .for_each(|folder| polycam.photo(&name.replace("images", folder), 7));
        let own =
            json!({ "fl_x": 21.0 + f64::from(index), "fl_y": 21.5, "cx": 9.7, "cy": 6.25, "w": 20, "h": 12 });
        let depth = format!("./depth/frame_{:05}.png", index + 1);
        let files = json!({ "file_path": format!("./{name}"), "depth_file_path": depth });
        with(with(own, &files), &json!({ "transform_matrix": matrix(&expected[index as usize]) }))
    };
    let frames: Vec<Value> = (0..3).map(frame).collect();
    polycam.photo("images/frame_00004.png", 7);
    polycam.json(
        "transforms.json",
        &json!({ "camera_model": "OPENCV", "orientation_override": "none", "frames": frames, "ply_file_path": "point_cloud.ply" }),
    );
    let dataset = polycam.sound();
    assert_places(&dataset);
    let optics = |index: usize| dataset.train[index].camera.intrinsics();
    let first = Intrinsics { fx: 21.0, fy: 21.5, cx: 9.7, cy: 6.25, width: 20, height: 12 };
    assert_eq!((optics(0), optics(2)), (first, Intrinsics { fx: 23.0, ..first }));
    let report = polycam.inspect(&DatasetOptions::default());
    let read = "transforms.json: poses of 3 frames with cameras of their own; points: point_cloud.ply";
    assert_some(&report.notes, &[read]);
    assert_some(
        &report.notes,
        &["the depth maps of its 3 depth_file_path are not used", "65536000 / value for maps in mm"],
    );
    assert_one(
        &dataset.warnings,
        &["only 3 of its 4 photos have a camera", "the program that wrote the cameras left them out"],
    );

    let record3d = Folder::new();
    record3d.points("sparse_pc.ply", &points);
    let frames: Vec<Value> = (0..3)
        .map(|index| {
            let name = format!("images/frame_{:05}.png", index + 1);
            record3d.photo(&name, 7);
            json!({ "file_path": name, "transform_matrix": matrix(&expected[index as usize]) })
        })
        .collect();
    let shared = json!({ "fl_x": 21.0, "fl_y": 21.0, "cx": 10.0, "cy": 6.0, "w": 20, "h": 12, "camera_model": "OPENCV" });
    let rest = json!({ "frames": frames, "ply_file_path": "sparse_pc.ply" });
    record3d.json("transforms.json", &with(shared, &rest));
    let dataset = record3d.sound();
    assert_places(&dataset);
    assert_eq!(dataset.train[1].camera.intrinsics(), expected[1].intrinsics());
    assert_eq!(dataset.warnings, [""; 0]);
    let notes = record3d.inspect(&DatasetOptions::default()).notes;
    assert_one(&notes, &["transforms.json: poses of 3 frames with one camera; points: sparse_pc.ply"]);
}

#[test]
fn points_in_the_older_frame_are_moved() {
    let folder = Folder::new();
    let (transform, scale) = ("applied_transform", "applied_scale");
    let lowered = json!([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, -8.0]]);
    let turned = json!([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]]);
    let keys = json!({ transform: lowered, "ply_file_path": "a.ply" });
    let scaled = with(keys.clone(), &json!({ scale: 0.1 }));
    let either = json!({ transform: turned, "ply_file_path": "/home/me/data/a.ply" });
    let elsewhere = "\"/home/me/data/a.ply\" is not there";
    for (keys, stored, used, words) in [
        (&keys, [0.1, 0.2, 0.0], [0.1, 0.2, 0.0], &[][..]),
        (&keys, [0.1, 0.2, -8.0], [0.2, 0.1, 0.0], &[transform]),
        (&scaled, [1.0, 2.0, -8.0], [0.2, 0.1, 0.0], &[scale]),
        (&either, [0.1, 0.2, 0.0], [0.1, 0.2, 0.0], &[elsewhere, "as many points before applied_transform"]),
    ] {
        folder.transforms(6, keys);
        folder.points("a.ply", &cloud(&[stored; 4], [1; 3]));
        let dataset = folder.sound();
        assert_eq!(dataset.points.positions[0], used, "{words:?}");
        assert!(words.len() == 1 || dataset.warnings.len() == words.len(), "{:?}", dataset.warnings);
        words.iter().for_each(|words| assert_some(&dataset.warnings, &[words]));
    }
    let mut list = folder.frames("images", 0..6, ".png");
    list[1]["transform_matrix"][3] = json!([0.1, 0, 0, 1]);
    for (keys, words) in [
        (json!({ "frames": list }), "frame 1: the last row of transform_matrix is [0.1, 0.0, 0.0, 1.0]"),
        (json!({ scale: "0.1" }), "applied_scale is not a number above 0"),
    ] {
        folder.transforms(6, &with(scaled.clone(), &keys));
        assert_refused(&folder, &[words]);
    }
}

/// nerfstudio's radius of a fisheye's picture refers to the camera's size; masks apply too.
#[test]
fn a_fisheyes_rim_hides_what_lies_beyond() {
    let folder = Folder::new();
    let lens = json!({ "camera_model": "OPENCV_FISHEYE", "fl_x": 5.0, "w": 40, "h": 24, "fisheye_crop_radius": 12.0 });
    let frames = folder.frames("images", 0..2, ".png");
    folder.json("transforms.json", &with(lens, &json!({ "frames": frames })));
    let texels = folder.load().train[0].photo.texels().unwrap().to_vec();
    let counts = |x: usize, y: usize| texels[4 * (20 * y + x) + 3] != 0;
    assert!(counts(10, 0) && counts(4, 6) && counts(15, 6));
    assert!(!counts(3, 6) && !counts(16, 6) && !counts(4, 0) && !counts(19, 11));
}

/// Warnings name keys without effect, unless they are 0.
#[test]
fn keys_that_are_not_used_are_named() {
    let folder = Folder::new();
    let none =
        json!({ "b1": 0, "b2": 0.0, "distortion_params": [0, 0, 0, 0, 0, 0], "distortion": [0, 0], "k1": 0 });
    let fisheye = json!({ "camera_model": "OPENCV_FISHEYE", "k1": 0.01, "p2": 0.01 });
    let models = json!({ "b1": 2, "ftheta_p0": 0.1, "distortion": { "k1": 1 } });
    let masks = json!({ "sky_mask": "a.png", "is_bad": true });
    for (keys, of_frame, words) in [
        (none, json!({}), ""),
        (json!({ "test_frames": [{}] }), masks, "is_bad, sky_mask, test_frames: such keys"),
        (models, json!({ "k6": 0.1 }), "b1, distortion, ftheta_p0, k6 are"),
        (json!({ "distortion_params": [0.1, 0.2] }), json!({}), "distortion_params is"),
        (fisheye, json!({}), ": p2 is"),
        (json!({ "camera_angle_x": 0.8886 }), json!({ "time": 0.5 }), "are of times from 0 to 0.5"),
        (json!({ "camera_angle_x": 1.2 }), json!({ "fl_x": 40 }), "camera_angle_x means 14.6: fl_x is used"),
    ] {
        let mut list = folder.frames("images", 0..3, ".png");
        list[0]["time"] = json!(0);
        list[1] = with(list[1].clone(), &of_frame);
        folder
            .json("transforms.json", &with(json!({ "fl_x": 21.0, "w": 20, "h": 12, "frames": list }), &keys));
        let mut lines = folder.sound().warnings;
        lines.retain(|line| !line.contains("point"));
        match words {
            "" => assert_eq!(lines, [""; 0]),
            _ => assert_one(&lines, &[words]),
        }
    }
}

/// The list of nerfstudio means the keys k1, k2, k3, k4, p1 and p2.
#[test]
fn distortion_params_are_used() {
    let folder = Folder::new();
    let sizes = |keys: Value| {
        let document = json!({ "fl_x": 21.0, "w": 20, "h": 12, "frames": folder.frames("images", 0..2, "") });
        folder.json("transforms.json", &with(document, &keys));
        let dataset = folder.sound();
        dataset.train.iter().map(|view| (view.camera, view.photo.clone())).collect::<Vec<_>>()
    };
    let by_list = sizes(json!({ "distortion_params": [-0.2, 0, 0, 0, 0.01, 0] }));
    assert!(
        by_list == sizes(json!({ "k1": -0.2, "p1": 0.01 }))
            && by_list[0].0.projection == ashsplat::scene::Projection::Brown
    );
}

#[test]
fn points_that_cannot_be_used_are_told() {
    let folder = Folder::new();
    folder.transforms(3, &json!({}));
    let unused = "its points are not used";
    for name in ["points.las", "Scan.LAZ", "a.e57", "b.pts", "c.xyz"] {
        folder.put(name, "");
        assert_one(&folder.warnings(unused), &[name, "points3d.ply"]);
        folder.remove(name);
    }
    folder.put("points.las", "");
    folder.points("points3d.ply", &cloud(&[[0.0; 3], [f32::NAN; 3], [0.0; 3]], [9; 3]));
    assert_eq!(folder.warnings(unused), [""; 0]);
    assert_eq!(folder.warnings("1 of 3 points have a position that is not finite").len(), 1);
}

/// Points without a `ply_file_path` are used under the usual names; a warning names others.
#[test]
fn points_beside_the_file_are_used_or_named() {
    let folder = Folder::new();
    folder.transforms(3, &json!({}));
    let points = cloud(&[[0.1, 0.2, 0.0]; 4], [1; 3]);
    colmap::write(folder.join("colmap/sparse/0"), &[], &[], &points).unwrap();
    let line = "colmap/sparse/0: its points are not used; `colmap model_conv";
    assert_some(&folder.sound().warnings, &[line]);
    for (name, words) in [
        ("mesh.ply", "mesh.ply is not used; name it there"),
        ("sparse_pc.ply", "the points of "),
        ("points3D.ply", "sparse_pc.ply is not"),
    ] {
        folder.points(name, &points);
        let dataset = folder.sound();
        assert_eq!(dataset.points.is_empty(), name == "mesh.ply", "{name}");
        for words in ["has no ply_file_path", words] {
            assert_eq!(folder.warnings(words).len(), 1, "{name}: {:?}", dataset.warnings);
        }
    }
}

/// A file of Gaussians can serve as points.
#[test]
fn points_may_be_gaussians() {
    let folder = Folder::new();
    folder.transforms(3, &json!({ "ply_file_path": "a.ply" }));
    let points = cloud(&[[0.1, 0.2, 0.0]; 4], [10, 20, 30]);
    let gaussians = ashsplat_files::initial_gaussians(&points, 1).unwrap();
    splats::write(folder.join("a.ply"), &gaussians, &Default::default()).unwrap();
    let dataset = folder.sound();
    assert_eq!(dataset.points, points);
    assert_says(&dataset.warnings[0], &["a.ply: holds Gaussians, taken as points"]);
}

#[test]
fn files_of_other_names_are_taken_where_one_is_meant() {
    let folder = Folder::new();
    let document = |name: &str, indices: Range<u32>| json!({ "camera_angle_x": angle(), "frames": folder.frames(name, indices, "") });
    let documents = [document("train", 0..3), document("test", 3..5)];
    let eval = DatasetOptions { eval: true, test_every: 2, ..Default::default() };
    folder.put("notes.json", "[1, 2]");
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
        files.iter().zip(&documents).for_each(|(name, document)| folder.json(name, document));
        let dataset = load(&folder, &eval);
        let said = dataset.warnings.iter().filter(|w| w.contains("taken for transforms.json")).count();
        // On some systems Transforms.JSON is transforms.json.
        let usual = files[0] == "transforms_train.json" || folder.join("transforms.json").exists();
        assert_eq!(said, usize::from(!usual), "{:?}", dataset.warnings);
        assert_eq!((dataset.train.len(), dataset.test.len()), counts, "{files:?}");
        files.iter().for_each(|name| folder.remove(name));
    }
    ["one.json", "two.json"].iter().zip(&documents).for_each(|(name, value)| folder.json(name, value));
    assert_refused(&folder, &["several files have poses (", "two.json): call one"]);
}

#[test]
fn json_with_decimal_commas_or_in_utf_16_is_named() {
    let folder = Folder::new();
    let document = json!({ "fl_x": 21.5, "frames": folder.frames("images", 0..2, "") }).to_string();
    folder.put("transforms.json", document.replace("21.5", "21,5"));
    assert_refused(&folder, &["has a decimal comma"]);
    let utf_16 = format!("\u{feff}{document}").encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    folder.put("transforms.json", utf_16);
    assert_refused(&folder, &["is text in UTF-16"]);
}

#[test]
fn distorted_frames_are_used_as_they_are_or_undistorted() {
    let folder = Folder::new();
    let lens = json!({ "fl_x": 21.0, "cx": 10.0, "cy": 6.0, "w": 20, "h": 12, "k1": -0.2, "p1": 0.01 });
    let frames = folder.frames("images", 0..2, ".png");
    folder.json("transforms.json", &with(lens, &json!({ "frames": frames })));
    let as_taken = folder.sound().train[0].camera;
    assert_eq!(
        (as_taken.width, as_taken.height, as_taken.coefficients[..3].to_vec()),
        (20, 12, vec![-0.2, 0.0, 0.01])
    );
    let options = DatasetOptions { undistort: true, ..Default::default() };
    assert_some(&folder.inspect(&options).notes, &["the camera has a lens", "19x11"]);
    let dataset = Dataset::load(&folder, &options, Progress::NONE).unwrap();
    let camera = dataset.train[0].camera;
    // The image loses half a pixel at each side, and keeps its scale.
    assert_eq!((camera.width, camera.height, camera.fx, camera.fy), (19, 11, 21.0, 21.0));
    assert_eq!(dataset.train[0].photo.width, camera.width);
}

/// A second pose is that of the last row or column, also of photographs of half the size and in a list of cameras.
#[test]
fn a_second_pose_is_a_rolling_shutter() {
    let folder = Folder::new();
    let lens = json!({ "fl_x": 21.0, "w": 20, "h": 12, "k1": -0.02 });
    let write = |keys: [Value; 3]| {
        let mut frames = folder.frames("images", 0..3, ".png");
        for (frame, keys) in frames.iter_mut().zip(keys) {
            *frame = with(frame.clone(), &keys);
        }
        folder.json("transforms.json", &with(lens.clone(), &json!({ "shutter": "up", "frames": frames })));
    };
    let end = matrix(&camera(4));
    let moving = json!({ "transform_matrix_end": end });
    write([moving.clone(), json!({ "transform_matrix_end": end, "shutter": "left" }), json!({})]);
    let half = DatasetOptions { resolution: Resolution::Factor(2), ..Default::default() };
    for dataset in [folder.sound(), load(&folder, &half)] {
        let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
        let readout = |camera: &Camera| camera.shutter.map(|shutter| shutter.readout);
        let readouts = [Some(Readout::Up), Some(Readout::Left), None];
        assert_eq!(cameras.iter().map(readout).collect::<Vec<_>>(), readouts);
        for (index, own) in (0..2).zip(&cameras) {
            for (time, expected) in [(-0.5, camera(index)), (0.5, camera(4))] {
                let at = own.at_time(time);
                assert!(at.position().abs_diff_eq(expected.position(), 1e-5), "{at:?}");
                assert!(at.camera_from_world.abs_diff_eq(expected.camera_from_world, 1e-5), "{at:?}");
            }
        }
        // The last row is read first, and the right column before the left one.
        let [wide, high] = [cameras[0].width, cameras[0].height].map(|side| f64::from(side) - 0.5);
        assert_eq!([0.5, high].map(|y| cameras[0].time_of(dvec2(3.0, y))), [0.5, -0.5]);
        assert_eq!([0.5, wide].map(|x| cameras[1].time_of(dvec2(x, 3.0))), [0.5, -0.5]);
        let (path, frame) = (folder.join("cameras.json"), WorldFrame { unit: 0.25, ..WorldFrame::default() });
        cameras_json::write(&path, [("a", &cameras[1])], &frame).unwrap();
        let back = cameras_json::read(&path, &frame).unwrap()[0].camera;
        assert_eq!(back.shutter, cameras[1].shutter);
        assert!(back.translation.abs_diff_eq(cameras[1].translation, 1e-5));
    }
    assert_some(&folder.inspect(&half).notes, &["2 of 3 photos have a rolling shutter"]);
    let straight = DatasetOptions { undistort: true, ..Default::default() };
    assert_some(&folder.inspect(&straight).warnings, &["--undistort bends the rows"]);
    write([moving, json!({ "transform_matrix_end": end, "shutter": "diagonal" }), json!({})]);
    assert_refused(&folder, &["frame 1: shutter: ", "'diagonal': down, up, right, left"]);
    write([
        json!({ "transform_matrix_end": [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]] }),
        json!({}),
        json!({}),
    ]);
    assert_refused(&folder, &["frame 0: transform_matrix_end is no rotation"]);
}

#[test]
fn masks_and_alpha_say_what_counts() {
    let folder = Folder::new();
    let images = [(1, "0.png"), (2, "1.png"), (3, "2.png"), (4, "3.png")];
    let images = images.map(|(id, name)| (id, name, camera(id - 1)));
    folder.model(&images, &cloud(&[[0.0; 3]; 2], [9; 3]));
    images.iter().for_each(|(_, name, _)| folder.photo(&format!("images/{name}"), 50));
    // The left half counts in 0 by a mask, the top half in 1 by its alpha, everything in 2 by a mask; 3 has no mask.
    let top_half = GrayImage::from_fn(20, 12, |_, y| Luma([if y < 6 { 255 } else { 0 }]));
    folder.save("masks/0.png", left_half());
    let alpha = |x, y| Rgba([50, 50, 50, top_half.get_pixel(x, y).0[0]]);
    folder.save("images/1.png", RgbaImage::from_fn(20, 12, alpha));
    folder.save("masks/2.png.png", GrayImage::from_pixel(20, 12, Luma([255])));
    let dataset = load(&folder, &DatasetOptions { alpha: AlphaUse::Mask, ..Default::default() });
    let masks: Vec<_> = dataset.train.iter().map(|view| view.photo.mask().unwrap()).collect();
    let shown = |i: usize| masks[i].as_ref().unwrap().to_vec();
    assert!(shown(0) == *left_half().as_raw() && shown(1) == *top_half.as_raw());
    assert_eq!(masks[2..], [None, None]);
    // The mask is scaled with the photo.
    let options = DatasetOptions { resolution: "2".parse().unwrap(), ..Default::default() };
    let small = load(&folder, &options).train.remove(0).photo.mask().unwrap().unwrap();
    assert_eq!((small.len(), small[0], small[9]), (60, 255, 0));
    folder.save("masks/3.png", GrayImage::new(3, 3));
    assert_refused(&folder, &["masks/3.png: is 3x3 pixels, its photo 20x12"]);
}

/// Files of an archive below a folder.
fn below<'a>(prefix: &str, files: &'a [(&str, Vec<u8>)]) -> Vec<(String, &'a [u8])> {
    files.iter().map(|(name, bytes)| (format!("{prefix}{name}"), &**bytes)).collect()
}

#[test]
fn a_zip_is_a_data_set() {
    let (folder, data) = (Folder::new(), Folder::new());
    data.transforms(3, &json!({}));
    const PHOTOS: [&str; 3] = ["images/r_0.png", "images/r_1.png", "images/r_2.png"];
    let files = ["transforms.json"].iter().chain(&PHOTOS);
    let files: Vec<(&str, Vec<u8>)> = files.map(|name| (*name, data.bytes(name))).collect();
    let zip = |name: &str, entries: &[(String, &[u8])]| -> PathBuf {
        let path = folder.join(name);
        let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
        for (entry, bytes) in entries {
            zip.start_file(entry.as_str(), SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap();
        path
    };
    // As macOS and Windows pack; with another file beside the data set; without a file extension.
    let of_mac =
        ["scene/.DS_Store", "__MACOSX/._scene", "__MACOSX/scene/._transforms.json", "scene/images/._r_0.png"];
    let of_mac = of_mac.map(|name| (name.to_owned(), &b"no picture"[..])).to_vec();
    let windows = below("outer/scene/", &files);
    let windows = windows.into_iter().map(|(name, bytes)| (name.replace('/', "\\"), bytes)).collect();
    let notes = vec![("notes/a.txt".to_owned(), &b"none"[..])];
    let plain = load(&data, &DatasetOptions::default());
    for (name, entries) in [
        ("plain.zip", below("", &files)),
        ("in_folder.zip", below("scene/", &files)),
        ("finder.zip", [of_mac, windows].concat()),
        ("beside.zip", [below("fox/", &files), notes].concat()),
        ("plain", below("", &files)),
    ] {
        let path = zip(name, &entries);
        assert!(Dataset::is_archive(&path), "{name}");
        assert_eq!(load(&path, &DatasetOptions::default()).train, plain.train, "{name}");
    }
    assert!(!Dataset::is_archive(&data));
    // Problems name the archive.
    let two = ["fox/transforms.json", "hare/transforms.json"].map(|name| (name.to_owned(), &*files[0].1));
    let one = |name: &str| [(name.to_owned(), &b"x"[..])];
    for (name, entries, words) in [
        ("two.zip", &two[..], "holds several data sets: fox, hare; unpack it"),
        ("empty.zip", &[], "is an empty ZIP"),
        (
            "missing.zip",
            &below("", &files[..3]),
            "missing.zip/images/r_2.png: the photo of frame images/r_2.png is missing",
        ),
        ("evil.zip", &one("../outside.txt"), "leads out of the archive"),
        ("photos.zip", &one("scene/images/a.jpg"), "photos.zip: holds photos without cameras; unpack it"),
    ] {
        assert_refused(&zip(name, entries), &[words]);
    }
    assert!(!folder.join("outside.txt").exists());
    assert_refused(&folder.put("text.zip", "none"), &["is not a folder, nor a ZIP"]);
    let bytes = folder.bytes("plain.zip");
    assert_refused(&folder.put("cut.zip", &bytes[..bytes.len() / 2]), &["is no whole ZIP"]);
}

#[test]
fn lists_of_names_split_the_frames() {
    let folder = Folder::new();
    let list =
        |indices: &[u32]| json!(indices.iter().map(|i| format!("images/r_{i}.png")).collect::<Vec<_>>());
    let [train, test, val] = ["train_filenames", "test_filenames", "val_filenames"];
    let none_of_two = "2 of 6 frames are in none of the lists train_filenames and test_filenames";
    // The last photo is in no list, and the one before only in a list that the test's list overrides.
    for (lists, [train, test], words) in [
        (json!({ train: list(&[0, 1, 2]), test: list(&[3]), val: list(&[4]) }), ["012", "3"], none_of_two),
        (json!({ train: list(&[0, 1]), test: [], val: list(&[4, 5]) }), ["01", "45"], ""),
        (json!({ test: list(&[1]) }), ["02345", "1"], ""),
    ] {
        folder.transforms(6, &lists);
        let dataset = load(&folder, &DatasetOptions { eval: true, ..Default::default() });
        let digits = [&dataset.train, &dataset.test]
            .map(|views| named(views).iter().map(|name| &name[9..10]).collect::<String>());
        assert_eq!(digits, [train, test]);
        assert_says(&dataset.warnings[0], &[words]);
        if !words.is_empty() {
            assert_eq!(folder.load().train.len(), 4);
        }
    }
    for (lists, words) in [
        (
            json!({ train: ["images/r_0.png", "images/other.png"] }),
            "train_filenames names \"images/other.png\", which no frame has",
        ),
        (json!({ test: "images/r_0.png" }), "test_filenames is not a list of names"),
    ] {
        folder.transforms(6, &lists);
        assert_refused(&folder, &[words]);
    }
}

#[test]
fn absurd_cameras_are_refused_or_named() {
    let folder = Folder::new();
    let list = folder.frames("images", 0..5, ".png");
    let write = |x: Option<f64>, lens: Value| {
        let mut list = list.clone();
        if let Some(x) = x {
            list[2]["transform_matrix"][0][3] = json!(x);
        }
        folder.json("transforms.json", &with(lens, &json!({ "frames": list })));
    };
    for far in [1e38, 2e9] {
        write(Some(far), json!({ "fl_x": 21.0 }));
        assert_refused(&folder, &["frame images/r_2.png: ", "from the origin"]);
    }
    for (key, value, what) in [
        ("cx", 1e9, "the principal point in x is at 1000000000 of 20 pixels"),
        ("fl_x", 1e-9, "the focal length in x is"),
        ("fl_x", 1e9, "the focal length in x is"),
        ("k1", -0.5, "folds the picture"),
    ] {
        write(None, with(json!({ "fl_x": 21.0, "fl_y": 21.0 }), &json!({ key: value })));
        assert_refused(&folder, &[what]);
    }
    for (x, strays) in [(1e5, 1), (6.0, 0)] {
        write(Some(x), json!({ "fl_x": 21.0 }));
        assert_eq!(folder.warnings("the camera of images/r_2.png lies at").len(), strays, "{x}");
    }
}

#[test]
fn far_frames_and_points_keep_their_places() {
    let loaded = |offset: [f64; 3]| {
        let folder = Folder::new();
        let mut list = folder.frames("images", 0..6, ".png");
        for frame in &mut list {
            for (axis, offset) in offset.iter().enumerate() {
                let value = &mut frame["transform_matrix"][axis][3];
                *value = (value.as_f64().unwrap() + offset).into();
            }
        }
        let point = [0.25, -0.5, 0.125].iter().zip(offset).map(|(v, offset)| (v + offset).to_string());
        let point = point.collect::<Vec<_>>().join(" ");
        let header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
        folder.put("a.ply", format!("{header}end_header\n{point}\n"));
        folder.transforms(6, &json!({ "ply_file_path": "a.ply", "frames": list }));
        folder.sound()
    };
    let (near, far) = (loaded([0.0; 3]), loaded([500_000.0, 5_000_000.0, 120.0]));
    assert!(near.frame.is_identity() && far.frame.origin.y == 5e6);
    assert_eq!(far.points, near.points);
    for (far, near) in far.train.iter().zip(&near.train) {
        let (there, here) = (far.camera.translation, near.camera.translation);
        assert!(there.abs_diff_eq(here, 1e-6), "{there}");
    }
}
