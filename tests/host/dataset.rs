//! Data sets: loading, splitting, reported problems.

use super::files::{Folder, assert_one, assert_says, assert_some, cloud, named};
use ashsplat::scene::{Camera, Intrinsics, WorldFrame};
use ashsplat_files::colmap::ColmapImage;
use ashsplat_files::{
    Dataset, DatasetOptions, EvalSplit, Gallery, Level, Progress, Resolution, initial_gaussians,
};
use glam::{DVec3, Quat, Vec3};
use image::{GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};
use serde_json::{Map, Value, json};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

const INTRINSICS: Intrinsics = Intrinsics { fx: 21.0, fy: 22.0, cx: 10.5, cy: 6.0, width: 20, height: 12 };

fn look(eye: Vec3, target: Vec3) -> Camera {
    Camera::look_at(eye, target, Vec3::NEG_Y, INTRINSICS)
}

fn outward(camera: &Camera) -> Camera {
    look(camera.position(), 2.0 * camera.position())
}

fn eval() -> DatasetOptions {
    DatasetOptions { eval: true, ..DatasetOptions::default() }
}

impl Folder {
    /// Pictures from a circle of radius 3 around the origin; every picture has a different grey.
    fn circle(&self, count: u32, points: usize) -> Vec<Camera> {
        let camera = |i: u32| {
            let (sin, cos) = (std::f32::consts::TAU * i as f32 / count as f32).sin_cos();
            look(3.0 * Vec3::new(cos, 0.0, sin), Vec3::ZERO)
        };
        let cameras: Vec<Camera> = (0..count).map(camera).collect();
        self.cameras(&cameras, points);
        cameras
    }

    fn cameras(&self, cameras: &[Camera], points: usize) {
        let names: Vec<String> = (0..cameras.len()).map(|i| format!("{i:03}.png")).collect();
        // Images registered in reverse order of their names.
        let images = (0..cameras.len()).rev().map(|i| (100 - i as u32, &*names[i], cameras[i]));
        self.model(&images.collect::<Vec<_>>(), &cloud(&vec![[0.5, 0.0, -0.5]; points], [10, 20, 30]));
        (0..).zip(&names).for_each(|(grey, name)| self.photo(&format!("images/{name}"), grey));
    }

    fn text_model(&self, images: &str, points: &str) {
        let parts = [("cameras", "1 PINHOLE 20 12 21 22 10.5 6\n"), ("images", images), ("points3D", points)];
        for (part, text) in parts {
            self.put(&format!("sparse/0/{part}.txt"), text);
            let _ = std::fs::remove_file(self.join(format!("sparse/0/{part}.bin")));
        }
    }
}

fn image_lines(id: u32, name: &str, quat: [f64; 4], translation: [f64; 3], seen: &str) -> String {
    let numbers: String = quat.iter().chain(&translation).map(|x| format!("{x} ")).collect();
    format!("{id} {numbers}1 {name}\n{seen}\n")
}

fn lines_of(index: usize, camera: &Camera, seen: &str) -> String {
    let image = ColmapImage::posed(index as u32 + 1, 1, format!("{index:03}.png"), camera);
    image_lines(image.id, &image.name, image.quat, image.translation, seen)
}

#[test]
fn views_come_by_name_with_their_cameras_and_photos() {
    let folder = Folder::new();
    let cameras = folder.circle(5, 4);
    let dataset = folder.load();
    assert!(dataset.test.is_empty() && dataset.warnings.is_empty());
    assert_eq!(named(&dataset.train), ["000.png", "001.png", "002.png", "003.png", "004.png"]);
    for (index, (view, camera)) in dataset.train.iter().zip(&cameras).enumerate() {
        assert!(view.camera.position().abs_diff_eq(camera.position(), 1e-5));
        assert_eq!(view.camera.intrinsics(), camera.intrinsics());
        assert_eq!(view.image_id, 100 - index as u32);
        assert!(view.photo.photo().unwrap().rgb.iter().all(|&v| v == index as u8));
    }
    assert_eq!(dataset.points.len(), 4);
    assert!((dataset.scene_extent - 3.3).abs() < 1e-4);
    assert_eq!(dataset.source, folder.join("sparse/0"));
}

#[test]
fn every_eighth_view_is_held_out() {
    let folder = Folder::new();
    folder.circle(18, 1);
    let dataset = folder.load_with(&eval());
    assert_eq!(named(&dataset.test), ["000.png", "008.png", "016.png"]);
    assert_eq!(dataset.train.len(), 15);
    assert_eq!(dataset.views().len(), 18);
    assert!(dataset.views().is_sorted_by_key(|view| &view.name));
    let every_second = folder.load_with(&DatasetOptions { test_every: 2, ..eval() });
    assert_eq!(every_second.test.len(), 9);
}

#[test]
fn few_views_are_held_out_between_others() {
    let inner = DatasetOptions { eval_split: EvalSplit::Inner, ..eval() };
    for (views, expected) in [(1, &[0][..]), (2, &[1]), (9, &[2, 6]), (11, &[2, 8]), (23, &[3, 11, 19])] {
        let folder = Folder::new();
        folder.circle(views, 1);
        let gallery = Gallery::open(folder.join(""), &inner, Progress::NONE).unwrap();
        let held = gallery.held_out().into_iter().enumerate().filter(|(_, held)| *held).map(|(at, _)| at);
        assert_eq!(held.collect::<Vec<_>>(), expected, "{views} views");
    }
    let folder = Folder::new();
    folder.circle(24, 1);
    assert_eq!(named(&folder.load_with(&inner).test), ["000.png", "008.png", "016.png"]);
}

#[test]
fn exposures_differ_as_common_points_do() {
    let spread = |greys: [u8; 2], points: usize| {
        let folder = Folder::new();
        let cameras = folder.circle(40, 1);
        let names: Vec<String> = (0..40).map(|view| format!("{view:03}.png")).collect();
        let images: Vec<_> =
            (1..).zip(&names).zip(&cameras).map(|((id, name), camera)| (id, &**name, *camera)).collect();
        let positions: Vec<_> =
            (0..points).map(|at| [0.04 * (at % 9) as f32, 0.03 * (at / 9) as f32, 0.0]).collect();
        folder.model(&images, &cloud(&positions, [10, 20, 30]));
        (0..40).for_each(|view| folder.photo(&format!("images/{view:03}.png"), greys[view % 2]));
        let gallery = Gallery::open(folder.join(""), &DatasetOptions::default(), Progress::NONE).unwrap();
        gallery.exposure_spread().unwrap()
    };
    let stops = spread([80, 160], 40).unwrap();
    assert!((0.3..1.01).contains(&stops), "{stops}");
    assert!(spread([80, 80], 40).unwrap() < 1e-9);
    assert_eq!(spread([80, 160], 5), None, "too few points");
    assert_eq!(spread([255, 160], 40), None, "half of them are saturated");
}

#[test]
fn the_resolution_scales_photos_and_cameras() {
    let folder = Folder::new();
    folder.circle(3, 1);
    let options = DatasetOptions { resolution: Resolution::Width(15), ..DatasetOptions::default() };
    for view in folder.load_with(&options).train {
        assert_eq!((view.photo.width, view.photo.height), (15, 9));
        assert_eq!((view.camera.width, view.camera.height), (15, 9));
        assert_eq!((view.original_camera.width, view.original_camera.height), (20, 12));
        assert!((view.camera.fx - 21.0 * 0.75).abs() < 1e-5 && (view.camera.cy - 4.5).abs() < 1e-5);
    }
}

#[test]
fn another_images_folder_and_background() {
    let folder = Folder::new();
    folder.circle(2, 1);
    std::fs::rename(folder.join("images"), folder.join("images_2")).unwrap();
    folder.save("images_2/000.png", RgbaImage::new(20, 12));
    let mut options = DatasetOptions { images: "images_2".into(), ..DatasetOptions::default() };
    for (white_background, value) in [(false, 0), (true, 255)] {
        options.white_background = white_background;
        let photo = folder.load_with(&options).train[0].photo.photo().unwrap();
        assert!(photo.rgb.iter().all(|&v| v == value));
    }
    let message = folder.refusal();
    assert_says(&message, &["images: there is no folder with photos"]);
    // Without photographs the images still have cameras.
    let report = folder.inspect(&DatasetOptions::default());
    assert_eq!((report.images, report.sound_photos, report.problems), (2, 0, vec![message]));
}

/// Cameras that look down on a tilted scene give it back its up direction; points stay where their photos show them. The turn
/// can be repeated for another data set.
#[test]
fn level_turns_cameras_and_points_upright() {
    let tilt = Quat::from_axis_angle(Vec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
    let middle = Vec3::new(5.0, 6.0, 7.0);
    let camera = |i: u32| {
        let (sin, cos) = (i as f32 * 0.9).sin_cos();
        let eye = Vec3::new(3.0 * cos, -2.0, 3.0 * sin);
        Camera::look_at(middle + tilt * eye, middle, tilt * Vec3::NEG_Y, INTRINSICS)
    };
    let folder = Folder::new();
    folder.cameras(&(0..7).map(camera).collect::<Vec<_>>(), 1);
    let with = |level: Level| folder.load_with(&DatasetOptions { level, ..Default::default() });
    let (tilted, upright) = (with(Level::Off), with(Level::On));
    let shown = |dataset: &Dataset, view: usize| {
        let (x, y, z) = dataset.train[view].camera.project(Vec3::from_array(dataset.points.positions[0]));
        Vec3::new(x, y, z)
    };
    for view in 0..7 {
        let camera = upright.train[view].camera;
        assert!(camera.camera_from_world.row(0).y.abs() < 1e-5, "{camera:?}");
        assert!(camera.camera_from_world.row(1).y > 0.5, "down is +y: {camera:?}");
        assert!(shown(&tilted, view).distance(shown(&upright, view)) < 1e-3);
    }
    let angle = (tilt * Vec3::NEG_Y).angle_between(Vec3::NEG_Y).to_degrees();
    let options = DatasetOptions { level: Level::On, ..Default::default() };
    let gallery = Gallery::open(&*folder, &options, Progress::NONE).unwrap();
    assert_some(gallery.notes(), &[&format!("turned by {angle:.1} degrees"), "--level"]);
    let again: Level = gallery.level().to_string().parse().unwrap();
    assert_eq!(again, gallery.level());
    folder.cameras(&(0..2).map(camera).collect::<Vec<_>>(), 1);
    assert_eq!(with(again).train[1].camera, upright.train[1].camera);
    for wrong in ["up", "0,0,0,1,2,3", "0,1,0,1,2", "0,1,0,1,2,nan"] {
        assert!(wrong.parse::<Level>().unwrap_err().to_string().contains(wrong));
    }
}

/// In both layouts transparent pixels show the background, do not count, or have their stored colours. A note says which.
#[test]
fn alpha_is_a_target_a_mask_or_ignored() {
    for of_colmap in [true, false] {
        let folder = Folder::new();
        if of_colmap {
            folder.circle(2, 1);
        } else {
            let frame = |index: u32| {
                let pose = json!([[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0]]);
                json!({ "file_path": format!("images/{index:03}.png"), "transform_matrix": pose })
            };
            folder.photo("images/001.png", 9);
            folder.json("transforms.json", &json!({ "camera_angle_x": 1.0, "frames": [frame(0), frame(1)] }));
        }
        folder.save("images/000.png", RgbaImage::from_pixel(20, 12, Rgba([200, 100, 0, 51])));
        let first = |alpha: &str, line: &str| {
            let (alpha, white_background) = (alpha.parse().unwrap(), true);
            let options =
                DatasetOptions { alpha, white_background, keep_opacity: true, ..Default::default() };
            let mut dataset = folder.load_with(&options);
            for notes in [&dataset.notes, &folder.inspect(&options).notes] {
                assert_some(notes, &[line]);
            }
            let photo = dataset.train.remove(0).photo;
            let hidden = photo.mask().unwrap().is_some_and(|mask| mask.iter().all(|&value| value == 0));
            (photo.photo().unwrap().rgb[..3].to_vec(), photo.is_transparent(), hidden)
        };
        assert_eq!(first("target", "1 photos have transparent pixels"), (vec![244, 224, 204], true, false));
        assert!(first("mask", "alpha channel of 1 photos is taken as").2);
        assert_eq!(
            first("ignore", "alpha channel of 1 photos is ignored"),
            (vec![200, 100, 0], false, false)
        );
    }
}

#[test]
fn photos_in_a_folder_of_a_fraction_are_of_that_size() {
    let folder = Folder::new();
    folder.circle(2, 1);
    // An eighth of 20×12, rounded either way.
    folder.picture("images_8/000.png", [2, 1], 9);
    folder.picture("images_8/001.png", [3, 2], 9);
    let options = DatasetOptions { images: "images_8".into(), ..DatasetOptions::default() };
    let dataset = folder.load_with(&options);
    let train = &dataset.train;
    assert_eq!((train[0].camera.width, train[0].camera.height), (2, 1));
    assert!((train[0].camera.fx - 2.1).abs() < 1e-5 && (train[1].camera.cy - 1.0).abs() < 1e-5);
    assert_eq!(train[1].original_camera.width, 3);
    assert!(dataset.warnings.is_empty());
    folder.picture("images_8/001.png", [9, 2], 9);
    let message = folder.try_load(&options).unwrap_err();
    assert_says(&message, &["is 9x2 pixels, its camera 20x12; use the pictures"]);
    assert_eq!(folder.inspect(&options).problems, [message]);
}

/// Photos that were scaled after COLMAP have their cameras scaled, with one note. Others are refused.
#[test]
fn cameras_are_scaled_to_their_photos() {
    let folder = Folder::new();
    let put = |index: u32, size: [u32; 2]| folder.picture(&format!("images/{index:03}.png"), size, 9);
    for [width, height] in [[10, 6], [40, 24], [20, 11], [7, 4]] {
        folder.circle(3, 1);
        (0..3).for_each(|index| put(index, [width, height]));
        let dataset = folder.load();
        let (camera, scale) = (dataset.train[0].camera, [width as f32 / 20.0, height as f32 / 12.0]);
        assert_eq!((camera.width, camera.height), (width, height));
        let expected = [21.0 * scale[0], 22.0 * scale[1], 10.5 * scale[0], 6.0 * scale[1]];
        for (value, expected) in [camera.fx, camera.fy, camera.cx, camera.cy].into_iter().zip(expected) {
            assert!((value - expected).abs() < 1e-4, "{width}x{height}");
        }
        let said = format!("3 photos are not of their camera's size, {width}x{height} and 20x12");
        assert_one(&dataset.warnings, &[&said]);
        let report = folder.inspect(&DatasetOptions::default());
        assert_eq!((report.warnings, report.problems.len()), (dataset.warnings, 0));
    }
    for (size, remedy) in [
        ([20, 6], "or whole ones scaled"),
        ([12, 20], "turn it on its side"),
        ([10, 6], "all photos of this camera"),
    ] {
        folder.circle(3, 1);
        put(1, size);
        assert_some(&folder.inspect(&DatasetOptions::default()).problems, &[remedy]);
    }
}

/// A warning names a camera of another size or in other units, with the value.
#[test]
fn doubtful_cameras_are_named() {
    let folder = Folder::new();
    for (intrinsics, words) in [
        (INTRINSICS, ""),
        (
            Intrinsics { fx: 2100.0, fy: 2200.0, ..INTRINSICS },
            "view of 0.5 degrees (focal length 2100 for 20 pixels)",
        ),
        (Intrinsics { fx: 0.9, fy: 0.9, ..INTRINSICS }, "a field of view of 169.7 degrees"),
        (Intrinsics { cx: 21.0, cy: 12.0, ..INTRINSICS }, "its principal point at 21 of 20 pixels"),
        (Intrinsics { fy: 42.0, ..INTRINSICS }, "focal lengths of 21 and 42 pixels"),
    ] {
        let eye = |i: u32| Vec3::new(i as f32, 0.5, 3.0);
        let camera = |i| Camera::look_at(eye(i), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
        folder.cameras(&[0, 1, 2].map(camera), 0);
        let mut lines = folder.inspect(&DatasetOptions::default()).warnings;
        lines.retain(|line| line.contains("camera 1 has"));
        match words {
            "" => assert_eq!(lines, [""; 0]),
            _ => assert_one(&lines, &[words]),
        }
    }
}

/// Three of nine cameras are no strays; a warning names the farthest.
#[test]
fn far_cameras_that_decide_the_extent_are_told() {
    let folder = Folder::new();
    let warnings = |far: f32| {
        let eye = |i: u32| Vec3::new(i as f32 + if i > 5 { far } else { 0.0 }, 0.5, 3.0);
        let cameras: Vec<Camera> = (0..9).map(|i| look(eye(i), eye(i) - Vec3::Z)).collect();
        folder.cameras(&cameras, 0);
        let mut lines = folder.inspect(&DatasetOptions::default()).warnings;
        lines.retain(|line| line.contains("scene extent"));
        lines
    };
    assert_eq!(warnings(0.0), [""; 0]);
    let words =
        "times the median distance from the cameras' middle, with others, and decides the scene extent";
    assert_one(&warnings(100.0), &["images", words]);
}

#[test]
fn points_that_no_camera_sees_are_told() {
    let folder = Folder::new();
    folder.circle(4, 30);
    assert_eq!(folder.load().warnings, [""; 0]);
    folder.remove("sparse/0/points3D.bin");
    folder.points("sparse/0/points3D.ply", &cloud(&[[0.0, 90.0, 0.0]; 30], [9; 3]));
    assert_says(&folder.load().warnings[0], &["0 of 30 of its points (a sample) lie in the view"]);

    // All but a quarter of the cameras look at the points.
    let mut cameras = folder.circle(12, 0);
    cameras[..3].iter_mut().for_each(|camera| *camera = outward(camera));
    folder.cameras(&cameras, 0);
    folder.remove("sparse/0/points3D.bin");
    let positions: Vec<[f32; 3]> = (0..600).map(|k| [k as f32 * 1e-3 - 0.3, 0.0, 0.0]).collect();
    folder.points("sparse/0/points3D.ply", &cloud(&positions, [9; 3]));
    let words = "3 of 12 of its cameras (a sample) see none of the points";
    assert_some(&folder.load().warnings, &[words]);
}

#[test]
fn without_points_it_starts_from_random_ones_around_the_cameras() {
    let folder = Folder::new();
    folder.circle(6, 0);
    let dataset = folder.load();
    assert!(dataset.points.is_empty());
    assert_says(&dataset.warnings[0], &["100000 random"]);
    let points = dataset.initial_points(5);
    assert_eq!(points.len(), 100_000);
    assert!(points == dataset.initial_points(5), "the seed gives the points");
    // Random points lie where the cameras look: around the origin, within their pictures.
    let bounds = points.bounds().unwrap();
    assert!(bounds.center().length() < 0.01);
    let half_edge = 0.9 * 3.0 * (0.5 * 20.0 / 21.0f32).min(0.5 * 12.0 / 22.0);
    assert!((0.5 * bounds.size().max_element() - half_edge).abs() < 0.01, "{bounds:?}");
    // For cameras that look outwards, the cube is around them.
    let mut turned = dataset.clone();
    turned.train.iter_mut().for_each(|view| view.camera = outward(&view.camera));
    let bounds = turned.initial_points(5).bounds().unwrap();
    for position in turned.train.iter().map(|view| view.camera.position()) {
        assert!(position.cmpgt(bounds.min).all() && position.cmplt(bounds.max).all());
    }
    let gaussians = initial_gaussians(&dataset.initial_points(5), 1).unwrap();
    gaussians.check_shapes().unwrap();
    assert!(gaussians.means == points.positions, "one Gaussian at each point");
}

/// Axes that never meet define no depth, but the points still lie in the cameras' views.
#[test]
fn without_points_parallel_cameras_see_the_random_ones() {
    let folder = Folder::new();
    for apart in [0.0, 0.5] {
        let eye = |i: u32| Vec3::new(5.0 + apart * i as f32, 0.0, 1.0);
        let camera = |i| Camera::look_at(eye(i), eye(i) + Vec3::Y, Vec3::Z, INTRINSICS);
        let cameras = [0, 1, 2, 3].map(camera);
        folder.cameras(&cameras, 0);
        let dataset = folder.load();
        assert_some(&dataset.warnings, &["do not look at one place"]);
        let points = dataset.initial_points(5);
        assert_eq!(points.len(), 100_000);
        for camera in &cameras {
            let seen = |&&p: &&[f32; 3]| {
                let (x, y, depth) = camera.project(Vec3::from_array(p));
                depth > 0.0 && (0.0..20.0).contains(&x) && (0.0..12.0).contains(&y)
            };
            assert!(points.positions.iter().filter(seen).count() > 25_000 - 100);
        }
    }
}

#[test]
fn photos_without_a_camera_are_counted() {
    let folder = Folder::new();
    folder.circle(3, 1);
    for name in ["extra.png", "below/extra.JPG", "._000.png", "notes.txt"] {
        folder.put(&format!("images/{name}"), "");
    }
    let missing = "only 3 of its 5 photos have a camera";
    assert_one(&folder.load().warnings, &[missing]);
    folder.put("images/000.jpg", "");
    let warnings = folder.load().warnings.join("\n");
    assert_says(warnings, &["1 of its photos have the name of another one", missing]);
}

/// Warnings name files and values that have a meaning in other programs.
#[test]
fn what_other_programs_leave_beside_a_model_is_named() {
    let folder = Folder::new();
    let cameras = folder.circle(4, 4);
    assert_eq!(folder.load_with(&eval()).warnings, [""; 0]);
    for name in ["test_list.txt", "init.ply", "images/dynamic_mask_000.png"] {
        std::fs::copy(folder.join("images/000.png"), folder.join(name)).unwrap();
    }
    let said = folder.load_with(&eval()).warnings.join("\n");
    let lines = ["test_list.txt: not used; one in 8", "init.ply: not used", "masks that belong to no photo"];
    assert_says(said, &lines);
    folder.model(&[(1, "000.png", cameras[0])], &cloud(&[[0.5, 0.0, -0.5]; 3], [0; 3]));
    let dataset = folder.load();
    assert_eq!(dataset.points.colors, [[127; 3]; 3]);
    assert_some(&dataset.warnings, &["all its points are black"]);
}

/// Warnings about poses of another convention, or points that were scaled or turned alone.
#[test]
fn points_that_do_not_lie_where_photos_show_them_are_told() {
    let folder = Folder::new();
    let cameras = folder.circle(4, 0);
    let place = |k: u32| Vec3::new(k as f32 * 0.01 - 0.3, (k % 7) as f32 * 0.05 - 0.1, (k % 5) as f32 * 0.04);
    let lines = |(i, camera): (usize, &Camera)| {
        let seen = |k: u32| {
            let (x, y, _) = camera.project(place(k));
            format!("{x} {y} {k} ")
        };
        lines_of(i, camera, &(0..60).map(seen).collect::<String>())
    };
    let images: String = cameras.iter().enumerate().map(lines).collect();
    for (scale, told) in [(1.0, 0), (10.0, 1), (-1.0, 1)] {
        let line = |k: u32| {
            let [x, y, z] = (scale * place(k)).to_array();
            format!("{k} {x} {y} {z} 1 2 3 0.5\n")
        };
        folder.text_model(&images, &(0..60).map(line).collect::<String>());
        assert_eq!(folder.warnings("do not lie where its photos show them").len(), told, "{scale}");
    }
}

#[test]
fn one_camera_has_an_extent() {
    let folder = Folder::new();
    folder.circle(1, 3);
    let dataset = folder.load();
    assert_eq!((dataset.scene_extent, dataset.warnings.len()), (1.0, 1));
    assert_says(folder.try_load(&eval()).unwrap_err(), &["none is left to train on"]);
}

#[test]
fn progress_is_reported_and_an_interruption_obeyed() {
    let folder = Folder::new();
    folder.circle(12, 1);
    let seen = Mutex::new(Vec::new());
    let report = |done, total| seen.lock().unwrap().push((done, total));
    let progress = Progress { report: Some(&report), interrupted: None };
    Dataset::load(&folder, &DatasetOptions::default(), progress).unwrap();
    let mut seen = seen.into_inner().unwrap();
    seen.sort();
    assert_eq!(seen, (0..=12).map(|done| (done, 12)).collect::<Vec<_>>());
    let interrupted = AtomicBool::new(true);
    let progress = Progress { report: None, interrupted: Some(&interrupted) };
    let result = Dataset::load(&folder, &DatasetOptions::default(), progress);
    assert!(matches!(result, Err(ashsplat::Error::Interrupted)), "{result:?}");
}

#[test]
fn inspect_lists_every_problem() {
    let folder = Folder::new();
    folder.circle(10, 7);
    let report = folder.inspect(&eval());
    assert!(report.is_sound(), "{report}");
    assert_eq!((report.images, report.sound_photos, report.points), (10, 10, 7));
    assert_eq!((report.train_views, report.test_views), (8, 2));
    assert_eq!(report.cameras.iter().next(), Some((&"PINHOLE 20x12".to_owned(), &1)));
    assert!((report.camera_bounds.unwrap().size().x - 6.0).abs() < 1e-4);

    folder.remove("images/001.png");
    folder.put("images/004.png", "text");
    folder.picture("images/007.png", [4, 4], 0);
    let report = folder.inspect(&eval());
    assert_eq!((report.sound_photos, report.problems.len()), (7, 3), "{report}");
    for (name, words) in
        [("001.png", "missing"), ("004.png", "not a JPEG"), ("007.png", "is 4x4 pixels, its camera 20x12")]
    {
        assert_some(&report.problems, &[name, words]);
    }
    assert!(report.to_string().lines().filter(|line| line.starts_with("problem ")).count() == 3);
    // Loading reports one of them.
    let message = folder.try_load(&eval()).unwrap_err();
    assert!(report.problems.contains(&message), "{message}");

    let report = Dataset::inspect(folder.join("none"), &eval(), Progress::NONE);
    assert_eq!((report.model.is_none(), report.problems.len()), (true, 1));
}

/// Photos have the points that the model lists for them, at the photo's size, if inside the picture and not masked.
/// Held-out photos have none.
#[test]
fn photos_have_the_points_that_they_show() {
    let folder = Folder::new();
    let cameras = folder.circle(9, 0);
    // The third point is behind some cameras, the fourth outside all pictures.
    let points = [[0.0, 0.0, 0.0], [0.25, 0.5, -0.25], [0.0, 0.0, 4.5], [0.0, 40.0, 0.0]];
    let (mut images, mut list) = (String::new(), String::new());
    for (i, camera) in cameras.iter().enumerate() {
        // One observation without a point, one point twice, and the last photo without any.
        images += &lines_of(i, camera, if i == 7 { "" } else { "1 1 0 2 2 -1 3 3 1 3 3 1 4 4 2 5 5 3" });
    }
    for (id, [x, y, z]) in points.iter().enumerate() {
        list += &format!("{id} {x} {y} {z} 1 2 3 0.5 1 0\n");
    }
    folder.text_model(&images, &list);
    // Masks the last third of the second photo, and with it the second point.
    folder.save("masks/001.png", GrayImage::from_fn(20, 12, |_, y| Luma([u8::from(y < 8) * 255])));

    let options = DatasetOptions { resolution: Resolution::Width(10), ..eval() };
    let mut gallery = Gallery::open(&folder, &options, Progress::NONE).unwrap();
    assert!(gallery.train_photos().iter().all(|photo| photo.depth_points == 0));
    // Seven training photos, one of them without points.
    assert_eq!(gallery.read_tracks().unwrap(), 6 * points.len());
    let counts: Vec<u32> = gallery.train_photos().iter().map(|photo| photo.depth_points).collect();
    assert_eq!(counts, [4, 4, 4, 4, 4, 4, 0]);
    let dataset = gallery.load(Progress::NONE).unwrap();
    assert!(dataset.test.iter().all(|view| view.depth_points.is_none()));
    for view in &dataset.train {
        let Some(found) = &view.depth_points else {
            assert_eq!(view.name, "007.png");
            continue;
        };
        let expected: Vec<[f32; 3]> = points
            .iter()
            .map(|&point| view.camera.project(Vec3::from_array(point)))
            .filter(|&(x, y, z)| z > 0.0 && (0.5..=9.5).contains(&x) && (0.5..=5.5).contains(&y))
            .filter(|&(_, y, _)| view.name != "001.png" || y < 4.0)
            .map(|(x, y, z)| [x - 0.5, y - 0.5, 1.0 / z])
            .collect();
        let [near, ..] = expected[..] else { panic!("{} shows the first", view.name) };
        // The origin is in the middle of each picture, at a depth of 3.
        assert!((near[0] - 4.75).abs() < 1e-3 && (near[2] - 1.0 / 3.0).abs() < 1e-4, "{near:?}");
        let found: Vec<[f32; 3]> =
            found.iter().map(|point| [point.position_px[0], point.position_px[1], point.inverse_z]).collect();
        assert_eq!(found, expected, "{}", view.name);
    }
    // Without observations, photos have no points.
    folder.circle(9, 3);
    ["images", "points3D", "cameras"].iter().for_each(|name| folder.remove(&format!("sparse/0/{name}.txt")));
    let mut gallery = Gallery::open(&folder, &options, Progress::NONE).unwrap();
    assert_eq!(gallery.read_tracks().unwrap(), 0);
}

#[test]
fn views_are_chosen_by_name() {
    let folder = Folder::new();
    folder.circle(9, 3);
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    let mut gallery = Gallery::open(&folder, &eval(), Progress::NONE).unwrap();
    let refused = gallery.keep(&names(&["002.png", "009.png"])).unwrap_err().to_string();
    assert_says(refused, &["images.bin: has no photo 009.png"]);
    assert_eq!(gallery.cameras().len(), 9);
    gallery.keep(&names(&["008.png", "002.png", "003.png"])).unwrap();
    // The ninth photo stays held out.
    assert_eq!(gallery.held_out(), [false, false, true]);
    let dataset = gallery.load(Progress::NONE).unwrap();
    assert_eq!(named(&dataset.train), ["002.png", "003.png"]);
    assert_eq!(named(&dataset.test), ["008.png"]);
    assert_eq!(dataset.train[1].photo.photo().unwrap().rgb[0], 3);
}

fn write_moved(folder: &Folder, scale: f64, offset: DVec3) {
    let (mut images, mut points, mut fits) = (String::new(), String::new(), Map::new());
    for i in 0..9 {
        let (sin, cos) = (0.7 * i as f32).sin_cos();
        let camera = look(3.0 * Vec3::new(cos, 0.25, sin), Vec3::new(0.3, -0.2, 0.1));
        let image = ColmapImage::posed(i + 1, 1, format!("{i}.png"), &camera);
        let translation = scale * DVec3::from_array(image.translation) - image.rotation() * offset;
        // Each photo observes all points.
        let seen = "1 1 0 1 1 1 1 1 2";
        images += &image_lines(i + 1, &image.name, image.quat, translation.to_array(), seen);
        let map = ImageBuffer::<Luma<u16>, _>::from_pixel(20, 12, Luma([30_000]));
        folder.save(&format!("depths/{i}.png"), map);
        fits.insert(i.to_string(), json!({ "scale": 0.5 / scale, "offset": 0.1 / scale }));
        folder.photo(&format!("images/{i}.png"), i as u8);
    }
    for id in 0..40_u32 {
        let point =
            Vec3::new(id as f32 * 0.03 - 0.5, (id % 7) as f32 * 0.11 - 0.3, (id % 5) as f32 * 0.2 - 0.4);
        let [x, y, z] = (scale * point.as_dvec3() + offset).to_array();
        points += &format!("{id} {x} {y} {z} 1 2 3 0.5\n");
    }
    folder.text_model(&images, &points);
    folder.json("sparse/0/depth_params.json", &Value::Object(fits));
}

/// Data sets in map coordinates or other units load as the same one at the origin.
#[test]
fn far_and_tiny_and_huge_data_sets_have_the_world_of_one_at_the_origin() {
    let loaded = |scale: f64, offset: DVec3| {
        let folder = Folder::new();
        write_moved(&folder, scale, offset);
        let options = DatasetOptions { depths: Some("depths".into()), ..DatasetOptions::default() };
        let mut gallery = Gallery::open(&folder, &options, Progress::NONE).unwrap();
        gallery.read_tracks().unwrap();
        (gallery.load(Progress::NONE).unwrap(), folder.inspect(&DatasetOptions::default()))
    };
    let (near, report) = loaded(1.0, DVec3::ZERO);
    assert!(near.frame.is_identity() && !report.to_string().contains("frame"), "{report}");
    let utm = DVec3::new(500_000.0, 5_000_000.0, 120.0);
    let ecef = DVec3::new(4.2e6, 1.7e5, 4.78e6);
    let all = [(1.0, utm), (1.0, ecef), (1e-4, DVec3::ZERO), (1e-2, DVec3::ZERO), (1e4, DVec3::ZERO)];
    for (scale, offset) in all {
        let (moved, report) = loaded(scale, offset);
        assert_eq!(moved.frame, WorldFrame { origin: offset, unit: scale });
        assert_eq!(moved.points, near.points, "{scale} {offset}");
        assert_eq!(moved.scene_extent, near.scene_extent);
        for (view, near) in moved.train.iter().zip(&near.train) {
            assert_eq!(view.camera, near.camera, "{scale} {offset}");
            assert_eq!(view.depth_points, near.depth_points, "{scale} {offset}");
            let [there, here] = [near, view].map(|view| view.inverse_depth.as_ref().unwrap()[0]);
            assert!((there - here).abs() < 1e-6 && there > 0.1, "{there} {here}");
        }
        let line = format!("frame     origin {} {} {}, unit {scale}", offset.x, offset.y, offset.z);
        assert_says(report.to_string(), &[&line]);
    }
    // Both at once: float64 resolves a tiny scene there to a millionth of its size.
    let (moved, _) = loaded(1e-2, utm);
    assert_eq!(moved.frame, WorldFrame { origin: utm, unit: 1e-2 });
    let distance = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from_array(*a).distance(Vec3::from_array(*b));
    let apart = moved.points.positions.iter().zip(&near.points.positions).map(distance);
    assert!(apart.fold(0.0, f32::max) < 1e-6);
    // The frame of an existing scene instead of the data set's own.
    let folder = Folder::new();
    write_moved(&folder, 1.0, utm);
    let frame = WorldFrame { origin: utm - DVec3::X, unit: 1.0 };
    let options = DatasetOptions { frame: Some(frame), ..DatasetOptions::default() };
    let cameras = Gallery::open(&folder, &options, Progress::NONE).unwrap().cameras();
    let moved = cameras[3].camera.position() - near.train[3].camera.position();
    assert!(moved.abs_diff_eq(Vec3::X, 1e-5), "{moved}");
    // A frame that does not suit the data set.
    let options = DatasetOptions { frame: Some(WorldFrame::default()), ..DatasetOptions::default() };
    let gallery = Gallery::open(&folder, &options, Progress::NONE).unwrap();
    assert_says(&gallery.warnings()[0], &["single precision rounds"]);
}
