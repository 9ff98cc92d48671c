//! Data sets: loading, splitting, reported problems.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{
    Dataset, DatasetOptions, Gallery, Photo, PhotoFileFormat, Progress, Resolution, View, cameras_json,
};
use glam::{DVec3, Vec3};
use serde_json::{Map, Value, json};

/// Pictures of 20×12 from a circle of radius 3 around the origin; every picture has a different grey.
fn write(folder: &Path, count: u32, points: usize) -> Vec<Camera> {
    let intrinsics = Intrinsics { fx: 21.0, fy: 22.0, cx: 10.5, cy: 6.0, width: 20, height: 12 };
    let camera = |i: u32| {
        let (sin, cos) = (std::f32::consts::TAU * i as f32 / count as f32).sin_cos();
        Camera::look_at(3.0 * Vec3::new(cos, 0.0, sin), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
    };
    let cameras: Vec<Camera> = (0..count).map(camera).collect();
    write_with(folder, &cameras, points);
    cameras
}

fn write_with(folder: &Path, cameras: &[Camera], points: usize) {
    let count = cameras.len() as u32;
    let name = |i: u32| format!("{i:03}.png");
    // Images registered in reverse order of their names.
    let images: Vec<_> =
        (0..count).rev().map(|i| ColmapImage::posed(100 - i, 1, name(i), &cameras[i as usize])).collect();
    let points = PointCloud { positions: vec![[0.5, 0.0, -0.5]; points], colors: vec![[10, 20, 30]; points] };
    colmap::write(folder.join("sparse/0"), &[ColmapCamera::pinhole(1, &cameras[0])], &images, &points)
        .unwrap();
    std::fs::create_dir_all(folder.join("images")).unwrap();
    for i in 0..count {
        let photo = Photo { width: 20, height: 12, rgb: vec![i as u8; 20 * 12 * 3] };
        photo.write_png(folder.join("images").join(name(i))).unwrap();
    }
}

fn load(folder: &Path, options: &DatasetOptions) -> Dataset {
    Dataset::load(folder, options, Progress::NONE).unwrap()
}

fn names(views: &[View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}

#[test]
fn views_come_by_name_with_their_cameras_and_photos() {
    let folder = tempfile::tempdir().unwrap();
    let cameras = write(folder.path(), 5, 4);
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert!(dataset.test.is_empty() && dataset.warnings.is_empty());
    assert_eq!(names(&dataset.train), ["000.png", "001.png", "002.png", "003.png", "004.png"]);
    for (index, (view, camera)) in dataset.train.iter().zip(&cameras).enumerate() {
        assert!(view.camera.position().abs_diff_eq(camera.position(), 1e-5));
        assert_eq!(view.camera.intrinsics(), camera.intrinsics());
        assert_eq!(view.image_id, 100 - index as u32);
        assert!(view.photo.photo().unwrap().rgb.iter().all(|&v| v == index as u8));
    }
    assert_eq!(dataset.points.len(), 4);
    assert!((dataset.scene_extent - 3.3).abs() < 1e-4);
    assert_eq!(dataset.source, folder.path().join("sparse/0"));
}

#[test]
fn every_eighth_view_is_held_out() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 18, 1);
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    let dataset = load(folder.path(), &options);
    assert_eq!(names(&dataset.test), ["000.png", "008.png", "016.png"]);
    assert_eq!(dataset.train.len(), 15);
    assert_eq!(dataset.views().len(), 18);
    assert!(dataset.views().is_sorted_by_key(|view| &view.name));
    let every_second = load(folder.path(), &DatasetOptions { test_every: 2, ..options });
    assert_eq!(every_second.test.len(), 9);
    // The held-out views come first in cameras.json, with the size of their files.
    let path = folder.path().join("cameras.json");
    dataset.write_cameras_json(&path).unwrap();
    let listed = cameras_json::read(&path, &WorldFrame::default()).unwrap();
    assert_eq!(listed.len(), 18);
    assert_eq!((listed[1].name.as_str(), listed[3].name.as_str()), ("008.png", "001.png"));
}

#[test]
fn the_resolution_scales_photos_and_cameras() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 3, 1);
    let options = DatasetOptions { resolution: Resolution::Width(15), ..DatasetOptions::default() };
    for view in load(folder.path(), &options).train {
        assert_eq!((view.photo.width, view.photo.height), (15, 9));
        assert_eq!((view.camera.width, view.camera.height), (15, 9));
        assert_eq!((view.original_camera.width, view.original_camera.height), (20, 12));
        assert!((view.camera.fx - 21.0 * 0.75).abs() < 1e-5 && (view.camera.cy - 4.5).abs() < 1e-5);
    }
}

#[test]
fn another_images_folder_and_background() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 2, 1);
    std::fs::rename(folder.path().join("images"), folder.path().join("images_2")).unwrap();
    let clear = image::RgbaImage::new(20, 12);
    clear.save(folder.path().join("images_2/000.png")).unwrap();
    let mut options = DatasetOptions { images: "images_2".into(), ..DatasetOptions::default() };
    assert!(load(folder.path(), &options).train[0].photo.photo().unwrap().rgb.iter().all(|&v| v == 0));
    options.white_background = true;
    assert!(load(folder.path(), &options).train[0].photo.photo().unwrap().rgb.iter().all(|&v| v == 255));
    let message =
        Dataset::load(folder.path(), &DatasetOptions::default(), Progress::NONE).unwrap_err().to_string();
    assert!(message.contains("images: there is no folder with photos"), "{message}");
    // Beside a COLMAP model, alpha is a mask, and a note says so.
    let said = |notes: &[String]| notes.iter().any(|note| note.contains("alpha channel of 1 photos"));
    options.keep_opacity = true;
    let dataset = load(folder.path(), &options);
    assert!(said(&dataset.notes) && !dataset.train[0].photo.is_transparent(), "{:?}", dataset.notes);
    assert!(said(&Dataset::inspect(folder.path(), &options, Progress::NONE).notes));
    // Without photographs the images still have cameras.
    let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
    assert_eq!((report.images, report.sound_photos, report.problems), (2, 0, vec![message]));
}

#[test]
fn photos_in_a_folder_of_a_fraction_are_of_that_size() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 2, 1);
    let small = folder.path().join("images_8");
    std::fs::create_dir_all(&small).unwrap();
    let put = |name: &str, width: u32, height: u32| {
        let rgb = vec![9; 3 * (width * height) as usize];
        Photo { width, height, rgb }.write_png(small.join(name)).unwrap();
    };
    // An eighth of 20×12, rounded either way.
    put("000.png", 2, 1);
    put("001.png", 3, 2);
    let options = DatasetOptions { images: "images_8".into(), ..DatasetOptions::default() };
    let train = load(folder.path(), &options).train;
    assert_eq!((train[0].camera.width, train[0].camera.height), (2, 1));
    assert!((train[0].camera.fx - 2.1).abs() < 1e-5 && (train[1].camera.cy - 1.0).abs() < 1e-5);
    assert_eq!(train[1].original_camera.width, 3);
    assert!(load(folder.path(), &options).warnings.is_empty());
    put("001.png", 9, 2);
    let message = Dataset::load(folder.path(), &options, Progress::NONE).unwrap_err().to_string();
    assert!(message.contains("is 9x2 pixels, its camera 20x12; use the pictures"), "{message}");
    assert_eq!(Dataset::inspect(folder.path(), &options, Progress::NONE).problems, [message]);
}

/// Photos that were scaled after COLMAP have their cameras scaled, with one note. Others are refused.
#[test]
fn cameras_are_scaled_to_their_photos() {
    let folder = tempfile::tempdir().unwrap();
    let put = |index: u32, width: u32, height: u32| {
        let rgb = vec![9; 3 * (width * height) as usize];
        let path = folder.path().join("images").join(format!("{index:03}.png"));
        Photo { width, height, rgb }.write_png(path).unwrap();
    };
    for (width, height) in [(10, 6), (40, 24), (20, 11), (7, 4)] {
        write(folder.path(), 3, 1);
        (0..3).for_each(|index| put(index, width, height));
        let dataset = load(folder.path(), &DatasetOptions::default());
        let (camera, scale) = (dataset.train[0].camera, [width as f32 / 20.0, height as f32 / 12.0]);
        assert_eq!((camera.width, camera.height), (width, height));
        let expected = [21.0 * scale[0], 22.0 * scale[1], 10.5 * scale[0], 6.0 * scale[1]];
        for (value, expected) in [camera.fx, camera.fy, camera.cx, camera.cy].into_iter().zip(expected) {
            assert!((value - expected).abs() < 1e-4, "{width}x{height}");
        }
        assert_eq!(dataset.warnings.len(), 1);
        let said = format!("3 photos are not of their camera's size, {width}x{height} and 20x12");
        assert!(dataset.warnings[0].contains(&said), "{:?}", dataset.warnings);
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        assert_eq!((report.warnings, report.problems.len()), (dataset.warnings, 0));
    }
    let others = [
        (20, 6, "or whole ones scaled"),
        (12, 20, "turn it on its side"),
        (10, 6, "all photos of this camera"),
    ];
    for (width, height, remedy) in others {
        write(folder.path(), 3, 1);
        put(1, width, height);
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        assert!(report.problems.iter().any(|problem| problem.contains(remedy)), "{report}");
    }
}

/// A warning names a camera of another size or in other units, with the value.
#[test]
fn doubtful_cameras_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let plain = Intrinsics { fx: 21.0, fy: 22.0, cx: 10.5, cy: 6.0, width: 20, height: 12 };
    let warnings = |intrinsics: Intrinsics| {
        let eye = |i: u32| Vec3::new(i as f32, 0.5, 3.0);
        let cameras: Vec<Camera> =
            (0..3).map(|i| Camera::look_at(eye(i), Vec3::ZERO, Vec3::NEG_Y, intrinsics)).collect();
        write_with(folder.path(), &cameras, 0);
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        report.warnings.into_iter().filter(|warning| warning.contains("camera 1 has")).collect::<Vec<_>>()
    };
    assert!(warnings(plain).is_empty());
    for (doubtful, words) in [
        (
            Intrinsics { fx: 2100.0, fy: 2200.0, ..plain },
            "view of 0.5 degrees (focal length 2100 for 20 pixels)",
        ),
        (Intrinsics { fx: 0.9, fy: 0.9, ..plain }, "a field of view of 169.7 degrees"),
        (Intrinsics { cx: 21.0, cy: 12.0, ..plain }, "its principal point at 21 of 20 pixels"),
        (Intrinsics { fy: 42.0, ..plain }, "focal lengths of 21 and 42 pixels"),
    ] {
        let said = warnings(doubtful);
        assert!(said.len() == 1 && said[0].contains(words), "{said:?}");
    }
}

/// Three of nine cameras are no strays; a warning names the farthest.
#[test]
fn far_cameras_that_decide_the_extent_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let intrinsics = Intrinsics { fx: 21.0, fy: 21.0, cx: 10.0, cy: 6.0, width: 20, height: 12 };
    let warnings = |far: f32| {
        let eye = |i: u32| Vec3::new(i as f32 + if i > 5 { far } else { 0.0 }, 0.5, 3.0);
        let cameras: Vec<Camera> =
            (0..9).map(|i| Camera::look_at(eye(i), eye(i) - Vec3::Z, Vec3::NEG_Y, intrinsics)).collect();
        write_with(folder.path(), &cameras, 0);
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        report.warnings.into_iter().filter(|warning| warning.contains("scene extent")).collect::<Vec<_>>()
    };
    assert_eq!(warnings(0.0), [""; 0]);
    let said = warnings(100.0);
    let words = [
        "images",
        "times the median distance from the cameras' middle, with others, and decides the scene extent",
    ];
    assert!(said.len() == 1 && words.iter().all(|word| said[0].contains(word)), "{said:?}");
}

#[test]
fn points_that_no_camera_sees_are_told() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 4, 30);
    assert!(load(folder.path(), &DatasetOptions::default()).warnings.is_empty());
    let far = PointCloud { positions: vec![[0.0, 90.0, 0.0]; 30], colors: vec![[9; 3]; 30] };
    std::fs::remove_file(folder.path().join("sparse/0/points3D.bin")).unwrap();
    ashsplat_files::ply::write_points(
        folder.path().join("sparse/0/points3D.ply"),
        &far,
        &ashsplat::scene::WorldFrame::default(),
    )
    .unwrap();
    let warnings = load(folder.path(), &DatasetOptions::default()).warnings;
    assert!(warnings[0].contains("0 of 30 of its points (a sample) lie in the view"), "{warnings:?}");

    // All but a quarter of the cameras look at the points.
    let mut cameras = write(folder.path(), 12, 0);
    for camera in &mut cameras[..3] {
        *camera =
            Camera::look_at(camera.position(), 2.0 * camera.position(), Vec3::NEG_Y, camera.intrinsics());
    }
    write_with(folder.path(), &cameras, 0);
    std::fs::remove_file(folder.path().join("sparse/0/points3D.bin")).unwrap();
    let positions: Vec<[f32; 3]> = (0..600).map(|k| [k as f32 * 1e-3 - 0.3, 0.0, 0.0]).collect();
    let near = PointCloud { colors: vec![[9; 3]; positions.len()], positions };
    let ply = folder.path().join("sparse/0/points3D.ply");
    ashsplat_files::ply::write_points(ply, &near, &ashsplat::scene::WorldFrame::default()).unwrap();
    let warnings = load(folder.path(), &DatasetOptions::default()).warnings.join("\n");
    assert!(warnings.contains("3 of 12 of its cameras (a sample) see none of the points"), "{warnings}");
}

#[test]
fn without_points_it_starts_from_random_ones_around_the_cameras() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 6, 0);
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert!(dataset.points.is_empty());
    assert!(dataset.warnings[0].contains("100000 random"), "{:?}", dataset.warnings);
    let points = dataset.initial_points(5);
    assert_eq!(points.len(), 100_000);
    assert!(points == dataset.initial_points(5), "the seed gives the points");
    // Random points lie where the cameras look: around the origin, within their pictures.
    let bounds = points.bounds().unwrap();
    assert!(bounds.center().length() < 0.01);
    let half_edge = 0.9 * 3.0 * (0.5 * 20.0 / 21.0f32).min(0.5 * 12.0 / 22.0);
    assert!((0.5 * bounds.size().max_element() - half_edge).abs() < 0.01, "{bounds:?}");
    // For cameras that look outwards, the cube is around them.
    let mut outward = dataset.clone();
    for view in &mut outward.train {
        let position = view.camera.position();
        let intrinsics = view.camera.intrinsics();
        view.camera = Camera::look_at(position, 2.0 * position, Vec3::NEG_Y, intrinsics);
    }
    let bounds = outward.initial_points(5).bounds().unwrap();
    for view in &outward.train {
        let position = view.camera.position();
        assert!(position.cmpgt(bounds.min).all() && position.cmplt(bounds.max).all());
    }
    let gaussians = dataset.initial_gaussians(1, 5).unwrap();
    gaussians.check_shapes().unwrap();
    assert!(gaussians.means == points.positions, "one Gaussian at each point");
}

/// Axes that never meet define no depth, but the points still lie in the cameras' views.
#[test]
fn without_points_parallel_cameras_see_the_random_ones() {
    let folder = tempfile::tempdir().unwrap();
    let intrinsics = Intrinsics { fx: 21.0, fy: 22.0, cx: 10.5, cy: 6.0, width: 20, height: 12 };
    let camera = |i: u32, apart: f32| {
        let eye = Vec3::new(5.0 + apart * i as f32, 0.0, 1.0);
        Camera::look_at(eye, eye + Vec3::Y, Vec3::Z, intrinsics)
    };
    for apart in [0.0, 0.5] {
        let cameras: Vec<Camera> = (0..4).map(|i| camera(i, apart)).collect();
        write_with(folder.path(), &cameras, 0);
        let dataset = load(folder.path(), &DatasetOptions::default());
        assert!(
            dataset.warnings.iter().any(|w| w.contains("do not look at one place")),
            "{:?}",
            dataset.warnings
        );
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
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 3, 1);
    for name in ["extra.png", "below/extra.JPG", "._000.png", "notes.txt"] {
        let path = folder.path().join("images").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "").unwrap();
    }
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.warnings.len(), 1);
    assert!(dataset.warnings[0].contains("only 3 of its 5 photos have a camera"), "{:?}", dataset.warnings);
    std::fs::write(folder.path().join("images/000.jpg"), "").unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert!(dataset.warnings.join("\n").contains("1 of its photos have the name of another one"));
    assert!(dataset.warnings.join("\n").contains("only 3 of its 5 photos have a camera"));
}

/// Warnings name files and values that have a meaning in other programs.
#[test]
fn what_other_programs_leave_beside_a_model_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let cameras = write(folder.path(), 4, 4);
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    assert_eq!(load(folder.path(), &options).warnings, [""; 0]);
    for name in ["test_list.txt", "init.ply", "images/dynamic_mask_000.png"] {
        std::fs::copy(folder.path().join("images/000.png"), folder.path().join(name)).unwrap();
    }
    let said = load(folder.path(), &options).warnings.join("\n");
    for line in ["test_list.txt: not used; one in 8", "init.ply: not used", "masks that belong to no photo"] {
        assert!(said.contains(line), "{said}");
    }
    let image = ColmapImage::posed(1, 1, "000.png", &cameras[0]);
    let points = PointCloud { positions: vec![[0.5, 0.0, -0.5]; 3], colors: vec![[0; 3]; 3] };
    let model = folder.path().join("sparse/0");
    colmap::write(model, &[ColmapCamera::pinhole(1, &cameras[0])], &[image], &points).unwrap();
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.points.colors, [[127; 3]; 3]);
    assert!(dataset.warnings.join("\n").contains("all its points are black"), "{:?}", dataset.warnings);
}

/// Warnings about poses of another convention, or points that were scaled or turned alone.
#[test]
fn points_that_do_not_lie_where_photos_show_them_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let cameras = write(folder.path(), 4, 0);
    let sparse = folder.path().join("sparse/0");
    let place = |k: u32| Vec3::new(k as f32 * 0.01 - 0.3, (k % 7) as f32 * 0.05 - 0.1, (k % 5) as f32 * 0.04);
    let mut images = String::new();
    for (i, camera) in cameras.iter().enumerate() {
        let image = ColmapImage::posed(i as u32 + 1, 1, format!("{i:03}.png"), camera);
        let numbers =
            image.quat.iter().chain(&image.translation).map(|x| format!("{x} ")).collect::<String>();
        let seen = |k: u32| {
            let (x, y, _) = camera.project(place(k));
            format!("{x} {y} {k} ")
        };
        images +=
            &format!("{} {numbers}1 {}\n{}\n", image.id, image.name, (0..60).map(seen).collect::<String>());
    }
    std::fs::write(sparse.join("images.txt"), images).unwrap();
    std::fs::write(sparse.join("cameras.txt"), "1 PINHOLE 20 12 21 22 10.5 6\n").unwrap();
    ["images", "cameras", "points3D"].iter().for_each(|part| {
        std::fs::remove_file(sparse.join(format!("{part}.bin"))).unwrap();
    });
    let told = |scale: f32| {
        let line = |k: u32| {
            let [x, y, z] = (scale * place(k)).to_array();
            format!("{k} {x} {y} {z} 1 2 3 0.5\n")
        };
        std::fs::write(sparse.join("points3D.txt"), (0..60).map(line).collect::<String>()).unwrap();
        let warnings = load(folder.path(), &DatasetOptions::default()).warnings;
        warnings.iter().any(|warning| warning.contains("do not lie where its photos show them"))
    };
    assert!(!told(1.0) && told(10.0) && told(-1.0));
}

#[test]
fn one_camera_has_an_extent() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 1, 3);
    let dataset = load(folder.path(), &DatasetOptions::default());
    assert_eq!(dataset.scene_extent, 1.0);
    assert_eq!(dataset.warnings.len(), 1);
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    let message = Dataset::load(folder.path(), &options, Progress::NONE).unwrap_err().to_string();
    assert!(message.contains("none is left to train on"), "{message}");
}

#[test]
fn progress_is_reported_and_an_interruption_obeyed() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 12, 1);
    let seen = Mutex::new(Vec::new());
    let report = |done, total| seen.lock().unwrap().push((done, total));
    let progress = Progress { report: Some(&report), interrupted: None };
    Dataset::load(folder.path(), &DatasetOptions::default(), progress).unwrap();
    let mut seen = seen.into_inner().unwrap();
    seen.sort();
    assert_eq!(seen, (0..=12).map(|done| (done, 12)).collect::<Vec<_>>());
    let interrupted = AtomicBool::new(true);
    let progress = Progress { report: None, interrupted: Some(&interrupted) };
    let result = Dataset::load(folder.path(), &DatasetOptions::default(), progress);
    assert!(matches!(result, Err(ashsplat::Error::Interrupted)), "{result:?}");
}

#[test]
fn inspect_lists_every_problem() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 10, 7);
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    let report = Dataset::inspect(folder.path(), &options, Progress::NONE);
    assert!(report.is_sound(), "{report}");
    assert_eq!((report.images, report.sound_photos, report.points), (10, 10, 7));
    assert_eq!((report.train_views, report.test_views), (8, 2));
    assert_eq!(report.cameras.iter().next(), Some((&"PINHOLE 20x12".to_owned(), &1)));
    assert!((report.camera_bounds.unwrap().size().x - 6.0).abs() < 1e-4);

    let image = |name: &str| folder.path().join("images").join(name);
    std::fs::remove_file(image("001.png")).unwrap();
    std::fs::write(image("004.png"), "text").unwrap();
    Photo { width: 4, height: 4, rgb: vec![0; 48] }.write_png(image("007.png")).unwrap();
    let report = Dataset::inspect(folder.path(), &options, Progress::NONE);
    assert_eq!(report.sound_photos, 7);
    assert_eq!(report.problems.len(), 3, "{report}");
    for (name, words) in
        [("001.png", "missing"), ("004.png", "not a JPEG"), ("007.png", "is 4x4 pixels, its camera 20x12")]
    {
        assert!(report.problems.iter().any(|p| p.contains(name) && p.contains(words)), "{report}");
    }
    assert!(report.to_string().lines().filter(|line| line.starts_with("problem ")).count() == 3);
    // Loading reports one of them.
    let message = Dataset::load(folder.path(), &options, Progress::NONE).unwrap_err().to_string();
    assert!(report.problems.contains(&message), "{message}");

    let report = Dataset::inspect(folder.path().join("none"), &options, Progress::NONE);
    assert_eq!((report.model.is_none(), report.problems.len()), (true, 1));
}

/// Photos have the points that the model lists for them, at the photo's size, if inside the picture and not masked.
/// Held-out photos have none.
#[test]
fn photos_have_the_points_that_they_show() {
    let folder = tempfile::tempdir().unwrap();
    let cameras = write(folder.path(), 9, 0);
    let sparse = folder.path().join("sparse/0");
    // The third point is behind some cameras, the fourth outside all pictures.
    let points = [[0.0, 0.0, 0.0], [0.25, 0.5, -0.25], [0.0, 0.0, 4.5], [0.0, 40.0, 0.0]];
    let (mut images, mut list) = (String::new(), String::new());
    for (i, camera) in cameras.iter().enumerate() {
        let image = ColmapImage::posed(i as u32 + 1, 1, format!("{i:03}.png"), camera);
        let numbers =
            image.quat.iter().chain(&image.translation).map(|x| format!("{x} ")).collect::<String>();
        // One observation without a point, one point twice, and the last photo without any.
        let seen = if i == 7 { "" } else { "1 1 0 2 2 -1 3 3 1 3 3 1 4 4 2 5 5 3" };
        images += &format!("{} {numbers}1 {}\n{seen}\n", image.id, image.name);
    }
    for (id, [x, y, z]) in points.iter().enumerate() {
        list += &format!("{id} {x} {y} {z} 1 2 3 0.5 1 0\n");
    }
    for (name, text) in [("images", images), ("points3D", list)] {
        std::fs::remove_file(sparse.join(format!("{name}.bin"))).unwrap();
        std::fs::write(sparse.join(format!("{name}.txt")), text).unwrap();
    }
    std::fs::remove_file(sparse.join("cameras.bin")).unwrap();
    std::fs::write(sparse.join("cameras.txt"), "1 PINHOLE 20 12 21 22 10.5 6\n").unwrap();
    // Masks the last third of the second photo, and with it the second point.
    let hidden = image::GrayImage::from_fn(20, 12, |_, y| image::Luma([u8::from(y < 8) * 255]));
    std::fs::create_dir_all(folder.path().join("masks")).unwrap();
    hidden.save(folder.path().join("masks/001.png")).unwrap();

    let options =
        DatasetOptions { eval: true, resolution: Resolution::Width(10), ..DatasetOptions::default() };
    let mut gallery = Gallery::open(folder.path(), &options, Progress::NONE).unwrap();
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
    write(folder.path(), 9, 3);
    ["images", "points3D", "cameras"].iter().for_each(|name| {
        std::fs::remove_file(sparse.join(format!("{name}.txt"))).unwrap();
    });
    let mut gallery = Gallery::open(folder.path(), &options, Progress::NONE).unwrap();
    assert_eq!(gallery.read_tracks().unwrap(), 0);
}

#[test]
fn views_are_chosen_by_name() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), 9, 3);
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    let mut gallery = Gallery::open(folder.path(), &options, Progress::NONE).unwrap();
    let refused = gallery.keep(&names(&["002.png", "009.png"])).unwrap_err().to_string();
    assert!(refused.contains("images.bin: has no photo 009.png"), "{refused}");
    assert_eq!(gallery.cameras().len(), 9);
    gallery.keep(&names(&["008.png", "002.png", "003.png"])).unwrap();
    // The ninth photo stays held out.
    assert_eq!(gallery.held_out(), [false, false, true]);
    let dataset = gallery.load(Progress::NONE).unwrap();
    let named = |views: &[View]| views.iter().map(|view| view.name.clone()).collect::<Vec<_>>();
    assert_eq!(named(&dataset.train), ["002.png", "003.png"]);
    assert_eq!(named(&dataset.test), ["008.png"]);
    assert_eq!(dataset.train[1].photo.photo().unwrap().rgb[0], 3);
}

/// Writes a data set in text, scaled and then moved by `offset`.
fn write_moved(folder: &Path, scale: f64, offset: DVec3) {
    let intrinsics = Intrinsics { fx: 21.0, fy: 22.0, cx: 10.5, cy: 6.0, width: 20, height: 12 };
    let target = Vec3::new(0.3, -0.2, 0.1);
    let (mut images, mut points, mut fits) = (String::new(), String::new(), Map::new());
    ["images", "depths", "sparse/0"]
        .iter()
        .for_each(|name| std::fs::create_dir_all(folder.join(name)).unwrap());
    for i in 0..9 {
        let (sin, cos) = (0.7 * i as f32).sin_cos();
        let eye = 3.0 * Vec3::new(cos, 0.25, sin);
        let camera = Camera::look_at(eye, target, Vec3::NEG_Y, intrinsics);
        let image = ColmapImage::posed(i + 1, 1, format!("{i}.png"), &camera);
        let [x, y, z] = (scale * DVec3::from_array(image.translation) - image.rotation() * offset).to_array();
        let [qw, qx, qy, qz] = image.quat;
        let map = image::ImageBuffer::from_pixel(20, 12, image::Luma([30_000_u16]));
        map.save(folder.join(format!("depths/{i}.png"))).unwrap();
        fits.insert(i.to_string(), json!({ "scale": 0.5 / scale, "offset": 0.1 / scale }));
        // Each photo observes all points.
        images += &format!("{} {qw} {qx} {qy} {qz} {x} {y} {z} 1 {i}.png\n1 1 0 1 1 1 1 1 2\n", i + 1);
        let photo = Photo { width: 20, height: 12, rgb: vec![i as u8; 20 * 12 * 3] };
        photo.write_png(folder.join(format!("images/{i}.png"))).unwrap();
    }
    for id in 0..40_u32 {
        let point =
            Vec3::new(id as f32 * 0.03 - 0.5, (id % 7) as f32 * 0.11 - 0.3, (id % 5) as f32 * 0.2 - 0.4);
        let [x, y, z] = (scale * point.as_dvec3() + offset).to_array();
        points += &format!("{id} {x} {y} {z} 1 2 3 0.5\n");
    }
    std::fs::write(folder.join("sparse/0/depth_params.json"), Value::Object(fits).to_string()).unwrap();
    for (part, text) in
        [("cameras", "1 PINHOLE 20 12 21 22 10.5 6"), ("images", &images), ("points3D", &points)]
    {
        std::fs::write(folder.join(format!("sparse/0/{part}.txt")), text).unwrap();
    }
}

/// Data sets in map coordinates or other units load as the same one at the origin.
#[test]
fn far_and_tiny_and_huge_data_sets_have_the_world_of_one_at_the_origin() {
    let loaded = |scale: f64, offset: DVec3| {
        let folder = tempfile::tempdir().unwrap();
        write_moved(folder.path(), scale, offset);
        let options = DatasetOptions { depths: Some("depths".into()), ..DatasetOptions::default() };
        let mut gallery = Gallery::open(folder.path(), &options, Progress::NONE).unwrap();
        gallery.read_tracks().unwrap();
        (
            gallery.load(Progress::NONE).unwrap(),
            Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE),
        )
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
        assert!(report.to_string().contains(&line), "{report}");
    }
    // Both at once: float64 resolves a tiny scene there to a millionth of its size.
    let (moved, _) = loaded(1e-2, utm);
    assert_eq!(moved.frame, WorldFrame { origin: utm, unit: 1e-2 });
    let distance = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from_array(*a).distance(Vec3::from_array(*b));
    let apart = moved.points.positions.iter().zip(&near.points.positions).map(distance);
    assert!(apart.fold(0.0, f32::max) < 1e-6);
    // The frame of an existing scene instead of the data set's own.
    let folder = tempfile::tempdir().unwrap();
    write_moved(folder.path(), 1.0, utm);
    let frame = WorldFrame { origin: utm - DVec3::X, unit: 1.0 };
    let options = DatasetOptions { frame: Some(frame), ..DatasetOptions::default() };
    let cameras = Dataset::cameras(folder.path(), &options).unwrap();
    let moved = cameras[3].camera.position() - near.train[3].camera.position();
    assert!(moved.abs_diff_eq(Vec3::X, 1e-5), "{moved}");
    // The frame of a checkpoint from before frames existed.
    let options = DatasetOptions { frame: Some(WorldFrame::default()), ..DatasetOptions::default() };
    let gallery = Gallery::open(folder.path(), &options, Progress::NONE).unwrap();
    assert!(gallery.warnings()[0].contains("single precision rounds"), "{:?}", gallery.warnings());
}
