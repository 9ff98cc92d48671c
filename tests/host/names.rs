//! File names of phones, other systems and other programs, and errors for inputs that are no data set.

use std::path::Path;

use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Dataset, DatasetOptions, Photo, PhotoFileFormat, Progress};
use glam::Vec3;
use serde_json::json;

use super::images::png_chunk;

fn photo(path: &Path, grey: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    Photo { width: 20, height: 12, rgb: vec![grey; 720] }.write_png(path).unwrap();
}

fn pose(index: usize) -> serde_json::Value {
    json!([[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
}

fn load(folder: &Path, images: &str) -> Result<Dataset, String> {
    let options = DatasetOptions { images: images.into(), ..Default::default() };
    Dataset::load(folder, &options, Progress::NONE).map_err(|error| error.to_string())
}

fn greys(dataset: &Dataset) -> Vec<u8> {
    dataset.train.iter().map(|view| view.photo.photo().unwrap().rgb[0]).collect()
}

#[test]
fn frames_name_photos_as_other_systems_do() {
    let folder = tempfile::tempdir().unwrap();
    // Name in the file, name on disk, and name of the view.
    let cases = [
        ("images/a.png", "images/a.png", "images/a.png"),
        (".\\images\\b.png", "images/b.png", "images/b.png"),
        ("././images/c", "images/c.PNG", "images/c.PNG"),
        ("images/D.JPG", "images/d.jpg", "images/D.JPG"),
        ("Images/e e \u{fc}.png", "images/e e \u{fc}.png", "Images/e e \u{fc}.png"),
        ("images/f.jpg", "images/f.png", "images/f.jpg"),
        ("images/g.1", "images/g.1.jpeg", "images/g.1.jpeg"),
    ];
    let mut frames = Vec::new();
    for (index, (named, there, _)) in cases.iter().enumerate() {
        photo(&folder.path().join(there), 10 + index as u8);
        frames.push(json!({ "file_path": named, "transform_matrix": pose(index) }));
    }
    let document = json!({ "fl_x": 21, "w": 20, "h": 12, "frames": frames });
    std::fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let dataset = load(folder.path(), "images").unwrap();
    let mut expected: Vec<(&str, u8)> =
        cases.iter().enumerate().map(|(index, (.., name))| (*name, 10 + index as u8)).collect();
    expected.sort();
    let found = dataset.train.iter().map(|view| view.name.as_str()).zip(greys(&dataset));
    assert_eq!(found.collect::<Vec<_>>(), expected);
    assert_eq!(dataset.warnings.len(), 1, "{:?}", dataset.warnings);
}

/// Paths of another machine: files below the data set with these names are used, never files outside.
#[test]
fn paths_that_lead_out_mean_photos_below() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    photo(&data.join("images/a.png"), 1);
    photo(&data.join("b.png"), 2);
    photo(&data.join("images/c.png"), 3);
    photo(&folder.path().join("secret.png"), 4);
    let write = |names: &[&str]| {
        let frames: Vec<_> = names
            .iter()
            .enumerate()
            .map(|(index, name)| json!({ "file_path": name, "transform_matrix": pose(index) }))
            .collect();
        let document = json!({ "fl_x": 21, "w": 20, "h": 12, "frames": frames });
        std::fs::write(data.join("transforms.json"), document.to_string()).unwrap();
    };
    write(&["/home/me/garden/images/a.png", "../elsewhere/b.png", "C:\\garden\\images\\c.png"]);
    let dataset = load(&data, "images").unwrap();
    let names: Vec<&str> = dataset.train.iter().map(|view| view.name.as_str()).collect();
    assert_eq!((names, greys(&dataset)), (vec!["b.png", "images/a.png", "images/c.png"], vec![2, 1, 3]));
    assert!(dataset.warnings.iter().any(|w| w.contains("3 of 3 paths lead out")), "{:?}", dataset.warnings);
    write(&["../secret.png"]);
    let message = load(&data, "images").unwrap_err();
    assert!(message.contains("\"../secret.png\" leads out of the folder, and nothing in it"), "{message}");
}

/// Writes a model with images of these names.
fn model(folder: &Path, names: &[&str]) {
    let intrinsics = Intrinsics { fx: 21.0, fy: 21.0, cx: 10.0, cy: 6.0, width: 20, height: 12 };
    let camera = |id: u32| {
        let eye = Vec3::new(id as f32, 0.0, -3.0);
        Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, intrinsics)
    };
    let images: Vec<_> =
        (1..).zip(names).map(|(id, name)| ColmapImage::posed(id, 1, *name, &camera(id))).collect();
    let points = PointCloud { positions: vec![[0.0; 3]; 2], colors: vec![[9; 3]; 2] };
    colmap::write(folder.join("sparse/0"), &[ColmapCamera::pinhole(1, &camera(1))], &images, &points)
        .unwrap();
}

/// Names of a model contain folders of another machine, or folders that are missing here.
#[test]
fn models_name_photos_that_lie_elsewhere() {
    for (names, there) in [
        (["images/a.png", "images/b.png"], ["a.png", "b.png"]),
        (["rig/cam0/a.png", "rig/cam0/b.png"], ["a.png", "b.png"]),
        (["C:\\Users\\me\\a.png", "C:\\Users\\me\\b.png"], ["a.png", "b.png"]),
        (["/home/me/x/a.png", "../b.png"], ["a.png", "x/y/b.png"]),
        (["a.png", "b.jpg"], ["images/a.png", "images/b.png"]),
        (["left/a.png", "right/a.png"], ["rig/left/a.png", "rig/right/a.png"]),
        (["old/left/a.png", "old/a.png"], ["left/a.png", "a.png"]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        model(folder.path(), &names);
        (0..2).for_each(|i| photo(&folder.path().join("images").join(there[i]), 5 + i as u8));
        photo(&folder.path().join("masks").join(there[0]), 0);
        let dataset = load(folder.path(), "images").unwrap();
        let mut greys = greys(&dataset);
        greys.sort();
        assert_eq!(greys, [5, 6], "{names:?}");
        assert_eq!(dataset.train.iter().filter(|view| view.photo.is_masked()).count(), 1, "{names:?}");
        let said = dataset.warnings.iter().filter(|w| w.contains("2 of 2 photos do not lie where it says"));
        assert_eq!(said.count(), 1, "{:?}", dataset.warnings);
        // Views have clean names, which are shown and written.
        assert!(dataset.train.iter().all(|view| !view.name.contains("..") && !view.name.starts_with('/')));
    }
}

#[test]
fn a_name_that_may_mean_two_photos_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = || load(folder.path(), "images").unwrap_err();
    model(folder.path(), &["a.png", "b.png"]);
    for name in ["b.png", "left/a.png", "right/a.png"] {
        photo(&folder.path().join("images").join(name), 1);
    }
    let message = refusal();
    assert!(
        message.contains("the photo of \"a.png\" may be ") && message.contains("left/a.png or "),
        "{message}"
    );
    model(folder.path(), &["up/b.png", "down/b.png"]);
    let message = refusal();
    assert!(message.contains("down/b.png and up/b.png would both have the photo "), "{message}");
    // A photo that another image names does not replace a missing one.
    model(folder.path(), &["left/a.png", "below/a.png"]);
    std::fs::remove_dir_all(folder.path().join("images/right")).unwrap();
    assert!(refusal().contains("below/a.png: the photo of image 2 is missing"));
    // One mask would serve two photos of different cameras.
    model(folder.path(), &["left/a.png", "right/a.png"]);
    photo(&folder.path().join("images/right/a.png"), 1);
    photo(&folder.path().join("masks/a.png"), 1);
    assert!(refusal().contains("left/a.png and right/a.png would both have the mask "), "{}", refusal());
}

/// Photos converted to PNG or JPEG, with or without the originals.
#[test]
fn converted_photos_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["a.webp", "b.TIFF", "c.heic", "d.jpg"];
    model(folder.path(), &names);
    std::fs::create_dir_all(folder.path().join("images")).unwrap();
    std::fs::write(folder.path().join("images/a.webp"), b"RIFF\x10\0\0\0WEBPVP8 ").unwrap();
    for (index, name) in ["a.png", "b.jpg", "c.PNG", "d.png"].into_iter().enumerate() {
        photo(&folder.path().join("images").join(name), index as u8);
    }
    let dataset = load(folder.path(), "images").unwrap();
    assert_eq!(greys(&dataset), [0, 1, 2, 3]);
    assert_eq!(dataset.train[1].name, "b.TIFF");
}

/// A mask of the left half.
fn half_mask(path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::GrayImage::from_fn(20, 12, |x, _| image::Luma([if x < 10 { 255 } else { 0 }])).save(path).unwrap();
}

/// Warnings name photos that are entirely masked and unused folders of masks, in training and in `info`.
#[test]
fn masks_that_hide_everything_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let warnings = || {
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        let warnings = load(folder.path(), "images").unwrap().warnings;
        assert_eq!(warnings, report.warnings);
        warnings
    };
    model(folder.path(), &["a.png", "b.png"]);
    ["images/a.png", "images/b.png"].iter().for_each(|name| photo(&place(name), 9));
    half_mask(&place("masks/a.png"));
    half_mask(&place("masks/b.png"));
    assert_eq!(warnings(), [""; 0]);
    photo(&place("masks/b.png"), 0);
    let lines = warnings();
    assert!(lines.len() == 1 && lines[0].starts_with("1 of 2 photos, b.png for example"), "{lines:?}");
    photo(&place("masks/a.png"), 0);
    let lines = warnings();
    assert!(lines.len() == 1 && lines[0].starts_with("2 of 2 photos, a.png for example"), "{lines:?}");
    half_mask(&place("masks/a.png"));
    half_mask(&place("masks/b.png"));
    half_mask(&place("masks_2/b.png"));
    half_mask(&place("dynamic_masks/a.png"));
    half_mask(&place("sky_masks/a.png"));
    let lines = warnings();
    assert!(lines.len() == 2 && lines[0].contains("dynamic_masks: its 1 pictures are not used"), "{lines:?}");
    assert!(lines[1].contains("sky_masks: its 1 pictures are not used"), "{lines:?}");
}

/// A photo with a mask file and an alpha channel: a warning says which one hides.
#[test]
fn alpha_beside_a_mask_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let notes = || {
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        let mut lines = load(folder.path(), "images").unwrap().notes;
        lines.retain(|line| line.contains("alpha"));
        assert!(lines.iter().all(|line| report.notes.contains(line)), "{lines:?} {report}");
        lines
    };
    model(folder.path(), &["a.png"]);
    half_mask(&place("masks/a.png"));
    std::fs::create_dir_all(place("images")).unwrap();
    let transparent_below = |row: u32| {
        let alpha = |y| image::Rgba([9, 9, 9, if y < row { 255 } else { 0 }]);
        image::RgbaImage::from_fn(20, 12, |_, y| alpha(y)).save(place("images/a.png")).unwrap();
    };
    transparent_below(12);
    assert_eq!(notes(), [""; 0]);
    transparent_below(6);
    assert_eq!(notes(), ["1 photos have a mask and an alpha channel: what either hides does not count"]);
    let counting = load(folder.path(), "images").unwrap().train[0].photo.mask().unwrap().unwrap();
    assert_eq!(counting.iter().filter(|&&value| value > 0).count(), 60);
    std::fs::remove_dir_all(place("sparse")).unwrap();
    let frame = json!({ "file_path": "images/a.png", "transform_matrix": pose(0) });
    let document = json!({ "camera_angle_x": 1.0, "frames": [frame] });
    std::fs::write(place("transforms.json"), document.to_string()).unwrap();
    let lines = notes();
    assert!(lines.len() == 1 && lines[0].contains("what is transparent shows the background"), "{lines:?}");
}

/// A PNG of linear light gives a warning; its values are used unchanged.
#[test]
fn png_gamma_is_told() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path(), &["a.png", "b.png"]);
    photo(&folder.path().join("images/b.png"), 9);
    let path = folder.path().join("images/a.png");
    photo(&path, 9);
    let png = std::fs::read(&path).unwrap();
    let warnings = |gamma: Option<u32>, is_srgb: bool| {
        let gamma = gamma.map(|gamma| png_chunk(b"gAMA", &gamma.to_be_bytes())).unwrap_or_default();
        let srgb = if is_srgb { png_chunk(b"sRGB", &[0]) } else { Vec::new() };
        // The chunks follow the header chunk.
        std::fs::write(&path, [&png[..33], &gamma, &srgb, &png[33..]].concat()).unwrap();
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        let dataset = load(folder.path(), "images").unwrap();
        assert_eq!((greys(&dataset), &dataset.warnings), (vec![9, 9], &report.warnings));
        dataset.warnings
    };
    for (gamma, is_srgb) in [(None, false), (Some(45455), false), (Some(100_000), true)] {
        assert_eq!(warnings(gamma, is_srgb), [""; 0]);
    }
    let lines = warnings(Some(100_000), false);
    assert!(
        lines.len() == 1 && lines[0].contains("1 photos are PNGs that name a gamma of 1, a.png for example"),
        "{lines:?}"
    );
}

/// A photo with two poses is used twice, with a warning.
#[test]
fn photos_with_several_poses_are_told() {
    let folder = tempfile::tempdir().unwrap();
    photo(&folder.path().join("images/a.png"), 5);
    photo(&folder.path().join("images/b.png"), 6);
    let frame = |name: &str, index| json!({ "file_path": name, "transform_matrix": pose(index) });
    let frames = [frame("images/a.png", 0), frame("images/a.png", 1), frame("images/b.png", 2)];
    let document = json!({ "camera_angle_x": 1.0, "frames": frames });
    std::fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let dataset = load(folder.path(), "images").unwrap();
    assert_eq!(greys(&dataset), [5, 5, 6]);
    let mut lines = dataset.warnings;
    lines.retain(|line| {
        line.contains("1 photos have more than one pose, images/a.png for example: all are used")
    });
    assert_eq!(lines.len(), 1);
}

/// nerfstudio's depth maps are no inverse depths: a warning names them, unless others are given.
#[test]
fn named_depth_maps_are_told() {
    let folder = tempfile::tempdir().unwrap();
    photo(&folder.path().join("images/a.png"), 5);
    let map = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(20, 12, image::Luma([2000]));
    std::fs::create_dir_all(folder.path().join("depths")).unwrap();
    map.save(folder.path().join("depths/a.png")).unwrap();
    let frame = json!({ "file_path": "images/a.png", "depth_file_path": "depths/a.png", "transform_matrix": pose(0) });
    let document = json!({ "camera_angle_x": 1.0, "frames": [frame] });
    std::fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let depth_notes = |depths: Option<&str>| {
        let options = DatasetOptions { depths: depths.map(Into::into), ..Default::default() };
        let mut lines = Dataset::inspect(folder.path(), &options, Progress::NONE).notes;
        lines.retain(|line| line.contains("depth"));
        lines
    };
    let lines = depth_notes(None);
    assert!(lines.len() == 1 && lines[0].contains("its 1 depth_file_path are not used"), "{lines:?}");
    assert_eq!(depth_notes(Some("depths")), [""; 0]);
}

/// Masks with the names of other programs are read, counted, and not taken for photos. A warning names others.
#[test]
fn masks_of_other_programs_are_found() {
    let place = |folder: &Path, name: &str| folder.join(name);
    for name in [
        "masks/a.png",
        "Masks/a.jpg.png",
        "mask/a.png",
        "segmentation/a.jpg.png",
        "masks/a_mask.png",
        "masks/mask_a.jpg",
        "masks/a.mask.png",
        "images/a_mask.png",
        "images/mask_a.png",
        "images/a.jpg.png",
        "images/a.jpg.mask.png",
        "images/masks/a.png",
    ] {
        let folder = tempfile::tempdir().unwrap();
        model(folder.path(), &["a.jpg", "b.png"]);
        photo(&place(folder.path(), "images/a.jpg"), 1);
        photo(&place(folder.path(), "images/b.png"), 2);
        half_mask(&place(folder.path(), name));
        let dataset = load(folder.path(), "images").unwrap();
        let masked: Vec<bool> = dataset.train.iter().map(|view| view.photo.is_masked()).collect();
        assert_eq!((masked, dataset.warnings.len()), (vec![true, false], 0), "{name} {:?}", dataset.warnings);
        let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
        assert!(
            report.notes.iter().any(|note| note.contains("1 of 2 photos have a mask")),
            "{name} {report}"
        );
        let stray = Path::new(name).with_file_name("c_mask.png");
        photo(&folder.path().join(stray), 0);
        let warnings = load(folder.path(), "images").unwrap().warnings;
        assert!(warnings[0].contains("no photo with a camera are not used (1, "), "{name} {warnings:?}");
        assert_eq!(warnings.len(), 1, "{warnings:?}");
    }
}

/// Masks may use 1 for pixels that count.
#[test]
fn masks_of_ones_hide_nothing() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path(), &["a.png"]);
    photo(&folder.path().join("images/a.png"), 9);
    image::GrayImage::from_fn(20, 12, |x, _| image::Luma([u8::from(x < 10)]))
        .save({
            std::fs::create_dir_all(folder.path().join("masks")).unwrap();
            folder.path().join("masks/a.png")
        })
        .unwrap();
    let mask = load(folder.path(), "images").unwrap().train[0].photo.mask().unwrap().unwrap();
    assert_eq!((mask[0], mask[19]), (255, 0));
}

/// Background removers write the object's picture in place of its mask.
#[test]
fn masks_may_be_cut_outs() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path(), &["a.png"]);
    photo(&folder.path().join("images/a.png"), 9);
    std::fs::create_dir_all(folder.path().join("masks")).unwrap();
    let cut_out = |x: u32| image::Rgba([90, 20, 200, if x < 10 { 255 } else { 0 }]);
    let picture = image::RgbaImage::from_fn(20, 12, |x, _| cut_out(x));
    picture.save(folder.path().join("masks/a.png")).unwrap();
    let dataset = load(folder.path(), "images").unwrap();
    let mask = dataset.train[0].photo.mask().unwrap().unwrap();
    assert_eq!((mask[0], mask[19]), (255, 0));
    assert!(
        dataset.notes.iter().any(|note| note.contains("masks of 1 photos are cut-outs")),
        "{:?}",
        dataset.notes
    );
}

#[test]
fn depth_maps_that_are_not_used_are_told() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path(), &["a.jpg", "b.png"]);
    for name in ["images/a.jpg", "images/b.png", "depth/a.png"] {
        photo(&folder.path().join(name), 1);
    }
    let report = Dataset::inspect(folder.path(), &DatasetOptions::default(), Progress::NONE);
    assert!(report.notes.iter().any(|n| n.contains("depth maps for 1 of 2 photos; only -d depth uses")));
}

#[test]
fn models_name_photos_in_another_case_or_folder_of_another_ending() {
    let folder = tempfile::tempdir().unwrap();
    model(folder.path(), &["IMG_1.JPG", "left\\IMG_2.JPG"]);
    photo(&folder.path().join("images/img_1.jpg"), 5);
    photo(&folder.path().join("images/left/IMG_2.JPG"), 6);
    photo(&folder.path().join("other/IMG_1.png"), 7);
    photo(&folder.path().join("other/left/IMG_2.png"), 8);
    assert_eq!(greys(&load(folder.path(), "images").unwrap()), [5, 6]);
    // The same holds for masks.
    for name in ["masks/IMG_1.jpg.PNG", "masks/left/img_2.png"] {
        photo(&folder.path().join(name), 0);
        let masked = load(folder.path(), "images").unwrap().train;
        assert!(masked[usize::from(name.contains('2'))].photo.is_masked(), "{name}");
    }
    assert_eq!(greys(&load(folder.path(), "other").unwrap()), [7, 8]);
}

#[test]
fn what_is_no_data_set_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let refusal = |path: &Path| load(path, "images").unwrap_err();
    photo(&place("phone/images/a.jpg"), 1);
    photo(&place("loose/a.JPG"), 1);
    std::fs::create_dir_all(place("polycam/keyframes/images")).unwrap();
    photo(&place("metashape/a.jpg"), 1);
    std::fs::write(place("metashape/cameras.xml"), "<document/>").unwrap();
    for (name, words) in [
        ("phone", "phone` finds their cameras"),
        ("loose", "photos alone are not enough: `ashsplat poses "),
        ("polycam", "`ns-process-data polycam --data "),
        ("metashape", "cameras.xml has the cameras of Metashape, which is not read"),
    ] {
        assert!(refusal(&place(name)).contains(words), "{}", refusal(&place(name)));
    }
    photo(&place("outer/scene/train/a.png"), 1);
    let frames = [json!({ "file_path": "train/a", "transform_matrix": pose(0) })];
    let json = json!({ "camera_angle_x": 0.9, "frames": frames }).to_string();
    std::fs::write(place("outer/scene/transforms.json"), json).unwrap();
    let message = refusal(&place("outer"));
    assert!(message.contains("outer/scene, which has one"), "{message}");
    let message = refusal(&place("outer/scene/transforms.json"));
    assert!(message.contains("give the folder in which it lies"), "{message}");
    // A requested folder must be one that is used.
    let message = load(&place("outer/scene"), "images_4").unwrap_err();
    assert!(message.contains("images_4 has no effect") && message.contains("train/a.png"), "{message}");
    assert_eq!(load(&place("outer/scene"), "images").unwrap().train.len(), 1);
    let frames = [json!({ "file_path": "train/a", "transform_matrix": pose(0) })];
    let json = json!({ "fl_x": 9, "camera_model": "EQUIRECTANGULAR", "frames": frames }).to_string();
    std::fs::write(place("outer/scene/transforms.json"), json).unwrap();
    assert!(refusal(&place("outer/scene")).contains("frame 0: is a panorama"));
}

#[test]
fn pictures_of_other_kinds_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    for (bytes, words) in [
        (&b"\0\0\0\x24ftypheic\0\0\0\0"[..], "HEIC photo"),
        (b"\0\0\0\x20ftypavif\0\0\0\0", "AVIF"),
        (b"\0\0\0\x14ftypqt  \0\0\0\0", "is a video"),
        (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
        (b"II*\0\x08\0\0\0", "TIFF or a raw photo"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = Photo::read(&path, [0.0; 3]).unwrap_err().to_string();
        assert!(message.contains(words) && !message.contains('\n'), "{message}");
    }
}

/// A folder may hold several data sets: one is used, and a warning names the others.
#[test]
fn other_poses_beside_those_in_use_are_told() {
    let folder = tempfile::tempdir().unwrap();
    photo(&folder.path().join("images/a.png"), 10);
    let frames = json!([{ "file_path": "images/a.png", "transform_matrix": pose(0) }]);
    let document = json!({ "fl_x": 21, "w": 20, "h": 12, "frames": frames }).to_string();
    let said = || load(folder.path(), "images").unwrap().warnings.join("\n");
    std::fs::write(folder.path().join("transforms.json"), &document).unwrap();
    assert!(!said().contains("not used"), "{}", said());
    std::fs::write(folder.path().join("transforms_train.json"), &document).unwrap();
    assert!(said().contains("transforms_train.json: not used, because transforms.json is"), "{}", said());
    model(folder.path(), &["a.png"]);
    let both = "transforms.json, transforms_train.json: not used, because the COLMAP model is";
    assert!(said().contains(both), "{}", said());
}

/// Gaussians take their size from the distance of their neighbours, which is 0 between copies.
#[test]
fn points_at_one_place_count_once() {
    let folder = tempfile::tempdir().unwrap();
    photo(&folder.path().join("images/a.png"), 10);
    let frames = json!([{ "file_path": "images/a.png", "transform_matrix": pose(0) }]);
    let document = json!({ "fl_x": 21, "w": 20, "h": 12, "frames": frames, "ply_file_path": "points.ply" });
    std::fs::write(folder.path().join("transforms.json"), document.to_string()).unwrap();
    let cases = [
        (200, 200, "200 of 400 points lie exactly where others do and are left out"),
        (300, 400, "100 of 400 points lie exactly where others do: their Gaussians begin smaller"),
    ];
    for (places, used, line) in cases {
        let positions: Vec<[f32; 3]> = (0..400).map(|index| [(index % places) as f32, 0.0, -3.0]).collect();
        let points = PointCloud { colors: vec![[9; 3]; positions.len()], positions };
        ashsplat_files::ply::write_points(folder.path().join("points.ply"), &points, &WorldFrame::default())
            .unwrap();
        let dataset = load(folder.path(), "images").unwrap();
        assert_eq!((dataset.points.positions.len(), dataset.points.colors.len()), (used, used));
        assert!(dataset.warnings.iter().any(|warning| warning.contains(line)), "{:?}", dataset.warnings);
    }
}
