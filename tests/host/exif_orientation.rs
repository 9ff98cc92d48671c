//! Photos that their metadata turn, and masks of another size.

use super::files::{Folder, assert_says, assert_some, cloud, with};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Dataset, DatasetOptions, Photo, PhotoOrientation};
use glam::Vec3;
use image::{GrayImage, Luma};
use serde_json::{Value, json};

/// A black JPEG with its left quarter white and its upper quarter grey, and an orientation in its Exif data.
fn jpeg([width, height]: [u32; 2], orientation: u8) -> Vec<u8> {
    let color = |x, y| match (x < width / 4, y < height / 4) {
        (true, _) => 255,
        (false, true) => 128,
        (false, false) => 0,
    };
    let picture = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([color(x, y); 3]));
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(&picture).unwrap();
    let mut exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\0\0\0\0\0\0\0".to_vec();
    exif[25] = orientation;
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&bytes[..2], &[0xff, 0xe1], &length, &exif, &bytes[2..]].concat()
}

/// Writes a `transforms.json` with a frame of each size, orientation and own values. The photos are `N.jpg`.
fn write(folder: &Folder, mut document: Value, photos: &[([u32; 2], u8, Value)]) {
    let frame = |(index, (size, orientation, own)): (usize, &([u32; 2], u8, Value))| {
        let name = format!("images/{index}.jpg");
        folder.put(&name, jpeg(*size, *orientation));
        let pose = json!([[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
        with(json!({ "file_path": name, "transform_matrix": pose }), own)
    };
    document["frames"] = photos.iter().enumerate().map(frame).collect();
    folder.json("transforms.json", &document);
}

fn load(folder: &Folder, orientation: PhotoOrientation) -> Dataset {
    let options = DatasetOptions { orientation, ..Default::default() };
    let report = folder.inspect(&options);
    assert!(report.is_sound(), "{report}");
    folder.load_with(&options)
}

fn tells_of_exif(dataset: &Dataset) -> bool {
    dataset.warnings.iter().any(|warning| warning.contains("Exif"))
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
    let folder = Folder::new();
    for (shared, size, photos, untold) in [
        (json!({ "fl_x": 30, "w": 32, "h": 32 }), [32, 32], 8, 7),
        (json!({ "camera_angle_x": 0.9 }), [32, 24], 8, 7),
        (json!({ "fl_x": 30, "w": 32, "h": 24 }), [32, 24], 4, 3),
    ] {
        let all: Vec<_> = (1..=photos).map(|orientation| (size, orientation, json!({}))).collect();
        write(&folder, shared, &all);
        let auto = load(&folder, PhotoOrientation::Auto);
        assert_eq!(all_sides(&auto), vec![SHOWN[0]; all.len()]);
        let said = auto.warnings.iter().find(|warning| warning.contains("Exif")).expect("a warning");
        assert_says(said, &[&format!("{untold} photos are"), "--orientation upright"]);
        let [stored, upright] =
            [PhotoOrientation::Stored, PhotoOrientation::Upright].map(|way| load(&folder, way));
        assert_eq!(all_sides(&stored), all_sides(&auto));
        assert_eq!(all_sides(&upright), SHOWN[..all.len()]);
        assert!(!tells_of_exif(&stored) && !tells_of_exif(&upright));
    }
    // Without any of them, there is no note.
    write(&folder, json!({ "camera_angle_x": 0.9 }), &[([32, 24], 1, json!({})), ([32, 24], 1, json!({}))]);
    assert!(!tells_of_exif(&load(&folder, PhotoOrientation::Auto)));
}

/// One photo on its side decides for all, also for those upside down and square ones. The principal point shows the
/// orientation as well as the size does. If photos contradict each other, those that need a turn to fit their cameras
/// get it, and the others stay.
#[test]
fn a_photo_on_its_side_tells_of_the_others() {
    let folder = Folder::new();
    let (wide, none) = (json!({ "fl_x": 30, "w": 32, "h": 24 }), json!({}));
    let (turned, square) = (json!({ "w": 24, "h": 32 }), json!({ "w": 24, "h": 24 }));
    let principal = json!({ "fl_x": 30, "cx": 12, "cy": 16 });
    let three = |own: &Value| {
        vec![([32, 24], 6, own.clone()), ([32, 24], 3, none.clone()), ([24, 24], 8, square.clone())]
    };
    let opposed =
        vec![([32, 24], 6, turned.clone()), ([32, 24], 6, none.clone()), ([32, 24], 3, none.clone())];
    for (shared, photos, expected, told) in [
        (&wide, three(&turned), &[SHOWN[5], SHOWN[2], SHOWN[7]][..], None),
        (&wide, three(&none), &[SHOWN[0]; 3], None),
        (
            &principal,
            vec![([32, 24], 6, none.clone()), ([32, 24], 5, none.clone())],
            &[SHOWN[5], SHOWN[4]],
            None,
        ),
        (&wide, opposed, &[SHOWN[5], SHOWN[0], SHOWN[0]], Some("1 photo is")),
    ] {
        write(&folder, shared.clone(), &photos);
        let dataset = load(&folder, PhotoOrientation::Auto);
        assert_eq!(all_sides(&dataset), expected);
        if shared == &principal {
            assert_eq!((dataset.train[0].camera.width, dataset.train[0].camera.height), (24, 32));
        } else if let Some(told) = told {
            assert_some(&dataset.warnings, &[told]);
        } else {
            assert_eq!(dataset.warnings.len(), 1, "{:?}", dataset.warnings);
        }
    }
    // A photo that does not fit after the turn is refused.
    let options = DatasetOptions { orientation: PhotoOrientation::Upright, ..Default::default() };
    let words = "is 24x32 pixels when turned as its metadata say, its camera 32x24";
    assert_says(folder.try_load(&options).unwrap_err(), &[words]);
}

/// COLMAP uses photos as stored, without a note. If a model has the sizes of turned photos, all are turned.
#[test]
fn models_say_by_their_sizes_whether_photos_are_turned() {
    let folder = Folder::new();
    for (index, (size, orientation)) in [([32, 24], 6), ([32, 24], 3), ([24, 24], 8)].into_iter().enumerate()
    {
        folder.put(&format!("images/{index}.jpg"), jpeg(size, orientation));
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
        let points = cloud(&[[0.0; 3]; 2], [9; 3]);
        colmap::write(folder.join("sparse/0"), &lenses, &images, &points).unwrap();
        let dataset = load(&folder, PhotoOrientation::Auto);
        assert_eq!(all_sides(&dataset), expected);
        assert!(!tells_of_exif(&dataset), "{:?}", dataset.warnings);
    }
}

fn mask(width: u32, height: u32) -> GrayImage {
    let value = |x| if x < width / 2 || x + 1 == width { 0 } else { 255 };
    GrayImage::from_fn(width, height, |x, _| Luma([value(x)]))
}

#[test]
fn masks_may_be_larger_than_their_photos() {
    let folder = Folder::new();
    let own = json!({ "mask_path": "masks/0.png" });
    let photos = [([34, 26], 1, own), ([34, 26], 1, json!({}))];
    write(&folder, json!({ "fl_x": 30, "w": 34, "h": 26 }), &photos);
    ["images_4/0.jpg", "images_4/1.jpg"].iter().for_each(|name| drop(folder.put(name, jpeg([8, 6], 1))));
    folder.save("masks/0.png", mask(34, 26));
    let options = DatasetOptions { images: "images_4".into(), ..Default::default() };
    let row = || {
        let dataset = folder.load_with(&options);
        assert!(dataset.train[1].photo.mask().unwrap().is_none());
        dataset.train[0].photo.mask().unwrap().unwrap()[..8].to_vec()
    };
    // Scaled by 4.25: a pixel that covers any hidden one does not count.
    assert_eq!(row(), [0, 0, 0, 0, 255, 255, 255, 0]);
    // A mask of the photo's size has priority.
    folder.save("masks_4/0.png", mask(8, 6));
    assert_eq!(row(), [0, 0, 0, 0, 255, 255, 255, 0]);
    folder.save("masks_4/0.png", GrayImage::from_fn(8, 6, |x, _| Luma([if x == 1 { 0 } else { 255 }])));
    assert_eq!(row(), [255, 0, 255, 255, 255, 255, 255, 255]);
    std::fs::remove_dir_all(folder.join("masks_4")).unwrap();
    for (width, height) in [(26, 34), (34, 34), (7, 5), (4, 3)] {
        folder.save("masks/0.png", mask(width, height));
        let words = format!("masks/0.png: is {width}x{height} pixels, its photo 8x6");
        assert_says(folder.try_load(&options).unwrap_err(), &[&words]);
    }
}
