//! Photos that their metadata turn, and masks of another size.

use std::path::Path;

use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Dataset, DatasetOptions, Photo, PhotoOrientation, Progress};
use glam::Vec3;
use serde_json::{Value, json};

/// A black JPEG with its left quarter white and its upper quarter grey, and an orientation in its Exif data.
fn jpeg(path: &Path, width: u32, height: u32, orientation: u8) {
    let color = |x, y| {
        if x < width / 4 {
            255
        } else if y < height / 4 {
            128
        } else {
            0
        }
    };
    let picture = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([color(x, y); 3]));
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(&picture).unwrap();
    let mut exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\0\0\0\0\0\0\0".to_vec();
    exif[25] = orientation;
    let mut file = bytes[..2].to_vec();
    file.extend([0xff, 0xe1]);
    file.extend((exif.len() as u16 + 2).to_be_bytes());
    file.extend(exif);
    file.extend(&bytes[2..]);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, file).unwrap();
}

/// Writes a `transforms.json` with a frame of each size, orientation and own values. The photos are `N.jpg`.
fn write(folder: &Path, shared: Value, photos: &[([u32; 2], u8, Value)]) {
    let mut frames = Vec::new();
    for (index, ([width, height], orientation, own)) in photos.iter().enumerate() {
        let name = format!("images/{index}.jpg");
        jpeg(&folder.join(&name), *width, *height, *orientation);
        let pose = json!([[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
        let mut frame = json!({ "file_path": name, "transform_matrix": pose });
        frame.as_object_mut().unwrap().extend(own.as_object().unwrap().clone());
        frames.push(frame);
    }
    let mut document = shared;
    document["frames"] = frames.into();
    std::fs::write(folder.join("transforms.json"), document.to_string()).unwrap();
}

fn load(folder: &Path, orientation: PhotoOrientation) -> Dataset {
    let options = DatasetOptions { orientation, ..Default::default() };
    let report = Dataset::inspect(folder, &options, Progress::NONE);
    assert!(report.is_sound(), "{report}");
    Dataset::load(folder, &options, Progress::NONE).unwrap()
}

/// Sides of a photo that are white and grey: left, top, right or bottom.
fn sides(photo: &Photo) -> [&'static str; 2] {
    let value = |x: u32, y: u32| photo.rgb[3 * (y * photo.width + x) as usize];
    let (x, y) = (photo.width / 2, photo.height / 2);
    let middles = [
        ("left", value(1, y)),
        ("top", value(x, 1)),
        ("right", value(photo.width - 2, y)),
        ("bottom", value(x, photo.height - 2)),
    ];
    [200..=255, 80..=180].map(|range| middles.iter().find(|(_, v)| range.contains(v)).unwrap().0)
}

/// Displayed sides of left and top under the orientations 1 to 8.
const SHOWN: [[&str; 2]; 8] = [
    ["left", "top"],
    ["right", "top"],
    ["right", "bottom"],
    ["left", "bottom"],
    ["top", "left"],
    ["top", "right"],
    ["bottom", "right"],
    ["bottom", "left"],
];

fn all_sides(dataset: &Dataset) -> Vec<[&'static str; 2]> {
    dataset.train.iter().map(|view| sides(&view.photo.photo().unwrap())).collect()
}

#[test]
fn where_no_size_tells_photos_stay_as_stored_and_it_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let square: Vec<_> = (1..=8).map(|orientation| ([32, 32], orientation, json!({}))).collect();
    let oblong: Vec<_> = (1..=8).map(|orientation| ([32, 24], orientation, json!({}))).collect();
    let half_turns: Vec<_> = (1..=4).map(|orientation| ([32, 24], orientation, json!({}))).collect();
    for (shared, photos, untold) in [
        (json!({ "fl_x": 30, "w": 32, "h": 32 }), &square, 7),
        (json!({ "camera_angle_x": 0.9 }), &oblong, 7),
        (json!({ "fl_x": 30, "w": 32, "h": 24 }), &half_turns, 3),
    ] {
        write(folder.path(), shared, photos);
        let auto = load(folder.path(), PhotoOrientation::Auto);
        assert_eq!(all_sides(&auto), vec![SHOWN[0]; photos.len()]);
        let said = auto.warnings.iter().find(|warning| warning.contains("Exif")).expect("a warning");
        assert!(
            said.contains(&format!("{untold} photos are")) && said.contains("--orientation upright"),
            "{said}"
        );
        assert_eq!(all_sides(&load(folder.path(), PhotoOrientation::Stored)), all_sides(&auto));
        let upright = load(folder.path(), PhotoOrientation::Upright);
        assert_eq!(all_sides(&upright), SHOWN[..photos.len()]);
        for dataset in [load(folder.path(), PhotoOrientation::Stored), upright] {
            assert!(
                !dataset.warnings.iter().any(|warning| warning.contains("Exif")),
                "{:?}",
                dataset.warnings
            );
        }
    }
    // Without any of them, there is no note.
    write(
        folder.path(),
        json!({ "camera_angle_x": 0.9 }),
        &[([32, 24], 1, json!({})), ([32, 24], 1, json!({}))],
    );
    let plain = load(folder.path(), PhotoOrientation::Auto);
    assert!(!plain.warnings.iter().any(|warning| warning.contains("Exif")), "{:?}", plain.warnings);
}

/// One photo on its side decides for all, also for those upside down and square ones.
#[test]
fn a_photo_on_its_side_tells_of_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let photos = |own: Value| {
        [([32, 24], 6, own), ([32, 24], 3, json!({})), ([24, 24], 8, json!({ "w": 24, "h": 24 }))]
    };
    for (own, expected) in
        [(json!({ "w": 24, "h": 32 }), [SHOWN[5], SHOWN[2], SHOWN[7]]), (json!({}), [SHOWN[0]; 3])]
    {
        write(folder.path(), json!({ "fl_x": 30, "w": 32, "h": 24 }), &photos(own));
        let dataset = load(folder.path(), PhotoOrientation::Auto);
        assert_eq!(
            (all_sides(&dataset), dataset.warnings.len()),
            (expected.to_vec(), 1),
            "{:?}",
            dataset.warnings
        );
    }
    // The principal point shows the orientation as well as the size does.
    write(
        folder.path(),
        json!({ "fl_x": 30, "cx": 12, "cy": 16 }),
        &[([32, 24], 6, json!({})), ([32, 24], 5, json!({}))],
    );
    let dataset = load(folder.path(), PhotoOrientation::Auto);
    assert_eq!(all_sides(&dataset), [SHOWN[5], SHOWN[4]]);
    assert_eq!((dataset.train[0].camera.width, dataset.train[0].camera.height), (24, 32));
    // If photos contradict each other, those that need a turn to fit their cameras get it, and the others stay.
    let turned = json!({ "w": 24, "h": 32 });
    write(
        folder.path(),
        json!({ "fl_x": 30, "w": 32, "h": 24 }),
        &[([32, 24], 6, turned), ([32, 24], 6, json!({})), ([32, 24], 3, json!({}))],
    );
    let dataset = load(folder.path(), PhotoOrientation::Auto);
    assert_eq!(all_sides(&dataset), [SHOWN[5], SHOWN[0], SHOWN[0]]);
    assert!(dataset.warnings.iter().any(|warning| warning.contains("1 photo is")), "{:?}", dataset.warnings);
    // A photo that does not fit after the turn is refused.
    let options = DatasetOptions { orientation: PhotoOrientation::Upright, ..Default::default() };
    let message = Dataset::load(folder.path(), &options, Progress::NONE).unwrap_err().to_string();
    assert!(
        message.contains("is 24x32 pixels when turned as its metadata say, its camera 32x24"),
        "{message}"
    );
}

/// COLMAP uses photos as stored, without a note. If a model has the sizes of turned photos, all are turned.
#[test]
fn models_say_by_their_sizes_whether_photos_are_turned() {
    let folder = tempfile::tempdir().unwrap();
    for (index, (size, orientation)) in [([32, 24], 6), ([32, 24], 3), ([24, 24], 8)].into_iter().enumerate()
    {
        jpeg(&folder.path().join(format!("images/{index}.jpg")), size[0], size[1], orientation);
    }
    for (first, expected) in [([32, 24], [SHOWN[0]; 3]), ([24, 32], [SHOWN[5], SHOWN[2], SHOWN[7]])] {
        let camera = |[width, height]: [u32; 2]| {
            let intrinsics = Intrinsics::from_fov_x(0.9, width, height);
            Camera::look_at(Vec3::Z * -3.0, Vec3::ZERO, Vec3::NEG_Y, intrinsics)
        };
        let cameras = [first, [32, 24], [24, 24]].map(camera);
        let lenses: Vec<_> =
            (1..).zip(&cameras).map(|(id, camera)| ColmapCamera::pinhole(id, camera)).collect();
        let posed = |(index, camera): (u32, &Camera)| {
            ColmapImage::posed(index + 1, index + 1, format!("{index}.jpg"), camera)
        };
        let images: Vec<_> = (0u32..).zip(&cameras).map(posed).collect();
        let points = PointCloud { positions: vec![[0.0; 3]; 2], colors: vec![[9; 3]; 2] };
        colmap::write(folder.path().join("sparse/0"), &lenses, &images, &points).unwrap();
        let dataset = load(folder.path(), PhotoOrientation::Auto);
        assert_eq!(all_sides(&dataset), expected);
        assert!(!dataset.warnings.iter().any(|warning| warning.contains("Exif")), "{:?}", dataset.warnings);
    }
}

/// A mask of this size that hides the left half and the last column.
fn mask(path: &Path, width: u32, height: u32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let value = |x| if x < width / 2 || x + 1 == width { 0 } else { 255 };
    image::GrayImage::from_fn(width, height, |x, _| image::Luma([value(x)])).save(path).unwrap();
}

#[test]
fn masks_may_be_larger_than_their_photos() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let own = json!({ "mask_path": "masks/0.png" });
    write(
        folder.path(),
        json!({ "fl_x": 30, "w": 34, "h": 26 }),
        &[([34, 26], 1, own), ([34, 26], 1, json!({}))],
    );
    for index in 0..2 {
        jpeg(&place(&format!("images_4/{index}.jpg")), 8, 6, 1);
    }
    mask(&place("masks/0.png"), 34, 26);
    let options = DatasetOptions { images: "images_4".into(), ..Default::default() };
    let row = || {
        let dataset = Dataset::load(folder.path(), &options, Progress::NONE).unwrap();
        assert!(dataset.train[1].photo.mask().unwrap().is_none());
        dataset.train[0].photo.mask().unwrap().unwrap()[..8].to_vec()
    };
    // Scaled by 4.25: a pixel that covers any hidden one does not count.
    assert_eq!(row(), [0, 0, 0, 0, 255, 255, 255, 0]);
    // A mask of the photo's size has priority.
    mask(&place("masks_4/0.png"), 8, 6);
    assert_eq!(row(), [0, 0, 0, 0, 255, 255, 255, 0]);
    image::GrayImage::from_fn(8, 6, |x, _| image::Luma([if x == 1 { 0 } else { 255 }]))
        .save(place("masks_4/0.png"))
        .unwrap();
    assert_eq!(row(), [255, 0, 255, 255, 255, 255, 255, 255]);
    std::fs::remove_dir_all(place("masks_4")).unwrap();
    for (width, height) in [(26, 34), (34, 34), (7, 5), (4, 3)] {
        mask(&place("masks/0.png"), width, height);
        let message = Dataset::load(folder.path(), &options, Progress::NONE).unwrap_err().to_string();
        assert!(
            message.contains(&format!("masks/0.png: is {width}x{height} pixels, its photo 8x6")),
            "{message}"
        );
    }
}
