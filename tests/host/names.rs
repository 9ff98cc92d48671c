//! File names of phones, other systems and other programs, and errors for inputs that are no data set.

use super::files::{Folder, assert_one, assert_says, assert_some, cloud, greys, left_half, named, with};
use super::images::png_chunk;
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat_files::{AlphaUse, Dataset, DatasetOptions, Progress};
use glam::Vec3;
use image::{GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};
use serde_json::{Value, json};
use std::path::Path;

impl Folder {
    fn model_of(&self, names: &[&str]) {
        let intrinsics = Intrinsics { fx: 21.0, fy: 21.0, cx: 10.0, cy: 6.0, width: 20, height: 12 };
        let eye = |id: u32| Vec3::new(id as f32, 0.0, -3.0);
        let camera = |id| Camera::look_at(eye(id), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
        let images: Vec<_> = (1..).zip(names).map(|(id, name)| (id, *name, camera(id))).collect();
        self.model(&images, &cloud(&[[0.0; 3]; 2], [9; 3]));
    }

    fn all_warnings(&self) -> Vec<String> {
        let warnings = self.load().warnings;
        assert_eq!(warnings, self.inspect(&DatasetOptions::default()).warnings);
        warnings
    }
}

fn frame(name: &str, index: usize) -> Value {
    let pose = json!([[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    json!({ "file_path": name, "transform_matrix": pose })
}

fn transforms(names: &[&str]) -> Value {
    let frames: Vec<Value> = names.iter().enumerate().map(|(index, name)| frame(name, index)).collect();
    json!({ "fl_x": 21, "w": 20, "h": 12, "frames": frames })
}

#[test]
fn frames_name_photos_as_other_systems_do() {
    let folder = Folder::new();
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
    let mut expected = Vec::new();
    for (grey, (_, there, view)) in (10..).zip(cases) {
        folder.photo(there, grey);
        expected.push((view, grey));
    }
    folder.json("transforms.json", &transforms(&cases.map(|(named, ..)| named)));
    let dataset = folder.load();
    expected.sort();
    let found: Vec<_> = named(&dataset.train).into_iter().zip(greys(&dataset)).collect();
    assert_eq!(found, expected);
    assert_eq!(dataset.warnings.len(), 1, "{:?}", dataset.warnings);
}

/// Paths of another machine: files below the data set with these names are used, never files outside.
#[test]
fn paths_that_lead_out_mean_photos_below() {
    let folder = Folder::new();
    for (grey, name) in (1..).zip(["data/images/a.png", "data/b.png", "data/images/c.png", "secret.png"]) {
        folder.photo(name, grey);
    }
    let load = |names: &[&str]| {
        folder.json("data/transforms.json", &transforms(names));
        Dataset::load(folder.join("data"), &DatasetOptions::default(), Progress::NONE)
    };
    let paths = ["/home/me/garden/images/a.png", "../elsewhere/b.png", "C:\\garden\\images\\c.png"];
    let dataset = load(&paths).unwrap();
    assert_eq!(named(&dataset.train), ["b.png", "images/a.png", "images/c.png"]);
    assert_eq!(greys(&dataset), [2, 1, 3]);
    assert_some(&dataset.warnings, &["3 of 3 paths lead out"]);
    let message = load(&["../secret.png"]).unwrap_err().to_string();
    assert_says(message, &["\"../secret.png\" leads out of the folder, and nothing in it"]);
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
        let folder = Folder::new();
        folder.model_of(&names);
        (5..).zip(there).for_each(|(grey, name)| folder.photo(&format!("images/{name}"), grey));
        folder.photo(&format!("masks/{}", there[0]), 0);
        let dataset = folder.load();
        let mut greys = greys(&dataset);
        greys.sort();
        assert_eq!(greys, [5, 6], "{names:?}");
        assert_eq!(dataset.train.iter().filter(|view| view.photo.is_masked()).count(), 1, "{names:?}");
        assert_eq!(folder.warnings("2 of 2 photos do not lie where it says").len(), 1, "{names:?}");
        // Views have clean names, which are shown and written.
        assert!(named(&dataset.train).iter().all(|name| !name.contains("..") && !name.starts_with('/')));
    }
}

#[test]
fn a_name_that_may_mean_two_photos_is_an_error() {
    let folder = Folder::new();
    folder.model_of(&["a.png", "b.png"]);
    for name in ["images/b.png", "images/left/a.png", "images/right/a.png"] {
        folder.photo(name, 1);
    }
    assert_says(folder.refusal(), &["the photo of \"a.png\" may be ", "left/a.png or "]);
    folder.model_of(&["up/b.png", "down/b.png"]);
    assert_says(folder.refusal(), &["down/b.png and up/b.png would both have the photo "]);
    // A photo that another image names does not replace a missing one.
    folder.model_of(&["left/a.png", "below/a.png"]);
    std::fs::remove_dir_all(folder.join("images/right")).unwrap();
    assert_says(folder.refusal(), &["below/a.png: the photo of image 2 is missing"]);
    // One mask would serve two photos of different cameras.
    folder.model_of(&["left/a.png", "right/a.png"]);
    folder.photo("images/right/a.png", 1);
    folder.photo("masks/a.png", 1);
    assert_says(folder.refusal(), &["left/a.png and right/a.png would both have the mask "]);
}

/// Photos converted to PNG or JPEG, with or without the originals.
#[test]
fn converted_photos_are_found() {
    let folder = Folder::new();
    folder.model_of(&["a.webp", "b.TIFF", "c.heic", "d.jpg"]);
    folder.put("images/a.webp", b"RIFF\x10\0\0\0WEBPVP8 ");
    for (grey, name) in (0..).zip(["images/a.png", "images/b.jpg", "images/c.PNG", "images/d.png"]) {
        folder.photo(name, grey);
    }
    let dataset = folder.load();
    assert_eq!(greys(&dataset), [0, 1, 2, 3]);
    assert_eq!(dataset.train[1].name, "b.TIFF");
}

/// Warnings name photos that are entirely masked and unused folders of masks, in training and in `info`.
#[test]
fn masks_that_hide_everything_are_told() {
    let folder = Folder::new();
    folder.model_of(&["a.png", "b.png"]);
    ["images/a.png", "images/b.png"].iter().for_each(|name| folder.photo(name, 9));
    let save = |names: &[&str]| names.iter().for_each(|name| folder.save(name, left_half()));
    save(&["masks/a.png", "masks/b.png"]);
    assert_eq!(folder.all_warnings(), [""; 0]);
    folder.photo("masks/b.png", 0);
    assert_one(&folder.all_warnings(), &["1 of 2 photos, b.png for example"]);
    folder.photo("masks/a.png", 0);
    assert_one(&folder.all_warnings(), &["2 of 2 photos, a.png for example"]);
    save(&["masks/a.png", "masks/b.png", "masks_2/b.png", "dynamic_masks/a.png", "sky_masks/a.png"]);
    let lines = folder.all_warnings();
    assert_eq!(lines.len(), 2, "{lines:?}");
    for (line, masks) in lines.iter().zip(["dynamic_masks", "sky_masks"]) {
        assert_says(line, &[masks, ": its 1 pictures are not used"]);
    }
}

/// A photo with a mask file and an alpha channel: a warning says which one hides.
#[test]
fn alpha_beside_a_mask_is_told() {
    let folder = Folder::new();
    let notes = |alpha| {
        let options = DatasetOptions { alpha, ..DatasetOptions::default() };
        let report = folder.inspect(&options);
        let mut lines = folder.load_with(&options).notes;
        lines.retain(|line| line.contains("alpha"));
        assert!(lines.iter().all(|line| report.notes.contains(line)), "{lines:?} {report}");
        lines
    };
    folder.model_of(&["a.png"]);
    folder.save("masks/a.png", left_half());
    let transparent_below = |row: u32| {
        let alpha = |y| Rgba([9, 9, 9, if y < row { 255 } else { 0 }]);
        folder.save("images/a.png", RgbaImage::from_fn(20, 12, |_, y| alpha(y)));
    };
    transparent_below(12);
    assert_eq!(notes(AlphaUse::Target), [""; 0]);
    assert_one(&notes(AlphaUse::Mask), &["--alpha mask changes nothing: no photo has transparent pixels"]);
    transparent_below(6);
    for (alpha, words, counting) in [
        (AlphaUse::Mask, "what either hides does not count", 60),
        (AlphaUse::Target, "what is transparent shows the background", 120),
    ] {
        assert_one(&notes(alpha), &["1 photos have a mask and an alpha channel", words]);
        let options = DatasetOptions { alpha, ..DatasetOptions::default() };
        let mask = folder.load_with(&options).train[0].photo.mask().unwrap().unwrap();
        assert_eq!(mask.iter().filter(|&&value| value > 0).count(), counting);
    }
}

/// A PNG of linear light gives a warning; its values are used unchanged.
#[test]
fn png_gamma_is_told() {
    let folder = Folder::new();
    folder.model_of(&["a.png", "b.png"]);
    ["images/a.png", "images/b.png"].iter().for_each(|name| folder.photo(name, 9));
    let png = folder.bytes("images/a.png");
    let warnings = |gamma: Option<u32>, is_srgb: bool| {
        let gamma = gamma.map(|gamma| png_chunk(b"gAMA", &gamma.to_be_bytes())).unwrap_or_default();
        let srgb = if is_srgb { png_chunk(b"sRGB", &[0]) } else { Vec::new() };
        // The chunks follow the header chunk.
        folder.put("images/a.png", [&png[..33], &gamma, &srgb, &png[33..]].concat());
        assert_eq!(greys(&folder.load()), [9, 9]);
        folder.all_warnings()
    };
    for (gamma, is_srgb) in [(None, false), (Some(45455), false), (Some(100_000), true)] {
        assert_eq!(warnings(gamma, is_srgb), [""; 0]);
    }
    let words = "1 photos are PNGs that name a gamma of 1, a.png for example";
    assert_one(&warnings(Some(100_000), false), &[words]);
}

#[test]
fn photos_with_several_poses_are_told() {
    let folder = Folder::new();
    folder.photo("images/a.png", 5);
    folder.photo("images/b.png", 6);
    folder.json("transforms.json", &transforms(&["images/a.png", "images/a.png", "images/b.png"]));
    assert_eq!(greys(&folder.load()), [5, 5, 6]);
    let line = "1 photos have more than one pose, images/a.png for example: all are used";
    assert_eq!(folder.warnings(line).len(), 1);
}

/// Depth maps of nerfstudio are not inverse depths, so a note names them unless others are given. A model's unused depth
/// maps are named too.
#[test]
fn depth_maps_that_are_not_used_are_told() {
    let folder = Folder::new();
    folder.photo("images/a.png", 5);
    folder.save("depths/a.png", ImageBuffer::<Luma<u16>, _>::from_pixel(20, 12, Luma([2000])));
    let frame = with(frame("images/a.png", 0), &json!({ "depth_file_path": "depths/a.png" }));
    folder.json("transforms.json", &json!({ "camera_angle_x": 1.0, "frames": [frame] }));
    let depth_notes = |depths: Option<&str>| {
        let options = DatasetOptions { depths: depths.map(Into::into), ..Default::default() };
        let mut lines = folder.inspect(&options).notes;
        lines.retain(|line| line.contains("depth"));
        lines
    };
    assert_one(&depth_notes(None), &["its 1 depth_file_path are not used"]);
    assert_eq!(depth_notes(Some("depths")), [""; 0]);

    let folder = Folder::new();
    folder.model_of(&["a.jpg", "b.png"]);
    ["images/a.jpg", "images/b.png", "depth/a.png"].iter().for_each(|name| folder.photo(name, 1));
    let notes = folder.inspect(&DatasetOptions::default()).notes;
    assert_some(&notes, &["depth maps for 1 of 2 photos; only -d depth uses"]);
}

/// Masks with the names of other programs are read, counted, and not taken for photos. A warning names others.
#[test]
fn masks_of_other_programs_are_found() {
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
        let folder = Folder::new();
        folder.model_of(&["a.jpg", "b.png"]);
        folder.photo("images/a.jpg", 1);
        folder.photo("images/b.png", 2);
        folder.save(name, left_half());
        let dataset = folder.load();
        let masked: Vec<bool> = dataset.train.iter().map(|view| view.photo.is_masked()).collect();
        assert_eq!((masked, dataset.warnings.len()), (vec![true, false], 0), "{name} {:?}", dataset.warnings);
        assert_some(&folder.inspect(&DatasetOptions::default()).notes, &["1 of 2 photos have a mask"]);
        folder.photo(Path::new(name).with_file_name("c_mask.png").to_str().unwrap(), 0);
        assert_one(&folder.load().warnings, &["no photo with a camera are not used (1, "]);
    }
}

/// Masks may use 1 for pixels that count. Background removers write the object's picture in place of its mask.
#[test]
fn masks_of_ones_and_cut_outs_hide_the_rest() {
    let folder = Folder::new();
    folder.model_of(&["a.png"]);
    folder.photo("images/a.png", 9);
    folder.save("masks/a.png", GrayImage::from_fn(20, 12, |x, _| Luma([u8::from(x < 10)])));
    let ends = |dataset: &Dataset| {
        let mask = dataset.train[0].photo.mask().unwrap().unwrap();
        [mask[0], mask[19]]
    };
    assert_eq!(ends(&folder.load()), [255, 0]);
    let cut_out = |x: u32| Rgba([90, 20, 200, if x < 10 { 255 } else { 0 }]);
    folder.save("masks/a.png", RgbaImage::from_fn(20, 12, |x, _| cut_out(x)));
    let dataset = folder.load();
    assert_eq!(ends(&dataset), [255, 0]);
    assert_some(&dataset.notes, &["masks of 1 photos are cut-outs"]);
}

#[test]
fn models_name_photos_in_another_case_or_folder_of_another_ending() {
    let folder = Folder::new();
    folder.model_of(&["IMG_1.JPG", "left\\IMG_2.JPG"]);
    let photos = ["images/img_1.jpg", "images/left/IMG_2.JPG", "other/IMG_1.png", "other/left/IMG_2.png"];
    (5..).zip(photos).for_each(|(grey, name)| folder.photo(name, grey));
    assert_eq!(greys(&folder.load()), [5, 6]);
    // The same holds for masks.
    for (index, name) in ["masks/IMG_1.jpg.PNG", "masks/left/img_2.png"].into_iter().enumerate() {
        folder.photo(name, 0);
        assert!(folder.load().train[index].photo.is_masked(), "{name}");
    }
    let other = DatasetOptions { images: "other".into(), ..Default::default() };
    assert_eq!(greys(&folder.load_with(&other)), [7, 8]);
}

#[test]
fn what_is_no_data_set_says_what_to_do() {
    let folder = Folder::new();
    let load = |name: &str, images: &str| {
        let options = DatasetOptions { images: images.into(), ..Default::default() };
        Dataset::load(folder.join(name), &options, Progress::NONE).map_err(|error| error.to_string())
    };
    let refused = |name: &str, images: &str, words: &[&str]| {
        assert_says(load(name, images).unwrap_err(), words);
    };
    ["phone/images/a.jpg", "loose/a.JPG", "openmvg/a.jpg"].iter().for_each(|name| folder.photo(name, 1));
    std::fs::create_dir_all(folder.join("polycam/keyframes/images")).unwrap();
    ["openmvg/sfm_data.json", "record3d/metadata.json"].iter().for_each(|name| drop(folder.put(name, "{}")));
    folder.photo("record3d/rgb/0.jpg", 1);
    for (name, words) in [
        ("phone", "phone` finds their cameras"),
        ("loose", "photos alone are not enough: `ashsplat poses "),
        ("polycam", "`ns-process-data polycam --data "),
        ("record3d", "`ns-process-data record3d --data "),
        ("openmvg", "sfm_data.json has the cameras of OpenMVG, which is not read"),
    ] {
        refused(name, "images", &[words]);
    }
    folder.photo("outer/scene/train/a.png", 1);
    let frames = [frame("train/a", 0)];
    folder.json("outer/scene/transforms.json", &json!({ "camera_angle_x": 0.9, "frames": frames }));
    refused("outer", "images", &["outer/scene, which has one"]);
    refused("outer/scene/transforms.json", "images", &["give the folder in which it lies"]);
    // A requested folder must be one that is used.
    refused("outer/scene", "images_4", &["images_4 has no effect", "train/a.png"]);
    assert_eq!(load("outer/scene", "images").unwrap().train.len(), 1);
    let panorama = json!({ "fl_x": 9, "camera_model": "EQUIRECTANGULAR", "frames": frames });
    folder.json("outer/scene/transforms.json", &panorama);
    refused("outer/scene", "images", &["frame train/a.png: ", "panorama of 20x12 is not 2:1"]);
}

/// A folder may hold several data sets: one is used, and a warning names the others.
#[test]
fn other_poses_beside_those_in_use_are_told() {
    let folder = Folder::new();
    folder.photo("images/a.png", 10);
    folder.json("transforms.json", &transforms(&["images/a.png"]));
    assert_eq!(folder.warnings("not used"), [""; 0]);
    folder.json("transforms_train.json", &transforms(&["images/a.png"]));
    assert_some(&folder.load().warnings, &["transforms_train.json: not used, because transforms.json is"]);
    folder.model_of(&["a.png"]);
    let both = "transforms.json, transforms_train.json: not used, because the COLMAP model is";
    assert_some(&folder.load().warnings, &[both]);
}

/// Gaussians take their size from the distance of their neighbours, which is 0 between copies.
#[test]
fn points_at_one_place_count_once() {
    let folder = Folder::new();
    folder.photo("images/a.png", 10);
    let document = with(transforms(&["images/a.png"]), &json!({ "ply_file_path": "points.ply" }));
    folder.json("transforms.json", &document);
    for (places, used, line) in [
        (200, 200, "200 of 400 points lie exactly where others do and are left out"),
        (300, 400, "100 of 400 points lie exactly where others do: their Gaussians begin smaller"),
    ] {
        let positions: Vec<[f32; 3]> = (0..400).map(|index| [(index % places) as f32, 0.0, -3.0]).collect();
        folder.points("points.ply", &cloud(&positions, [9; 3]));
        let dataset = folder.load();
        assert_eq!((dataset.points.positions.len(), dataset.points.colors.len()), (used, used));
        assert_some(&dataset.warnings, &[line]);
    }
}
