//! COLMAP models: round trips, text against binary, choice among several models, damage.

use super::files::{Folder, assert_one, assert_says, for_each_mutation, for_each_truncation, names, refusal};
use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat_files::colmap::{self, CameraModel, ColmapCamera, ColmapImage, Model};
use glam::{DQuat, DVec3, Vec3};
use std::path::Path;
use std::time::{Duration, SystemTime};

struct Parts {
    cameras: Vec<ColmapCamera>,
    images: Vec<ColmapImage>,
    points: PointCloud,
}

/// Two cameras, three unordered images, four points.
fn parts() -> Parts {
    let intrinsics = Intrinsics { fx: 60.5, fy: 61.0, cx: 31.0, cy: 25.0, width: 64, height: 48 };
    let camera = |x: f32| Camera::look_at(Vec3::new(x, -2.0, 1.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    let simple = ColmapCamera {
        id: 900,
        model: CameraModel::SIMPLE_PINHOLE,
        width: 20,
        height: 10,
        parameters: vec![15.0, 10.0, 5.0],
    };
    Parts {
        cameras: vec![ColmapCamera::pinhole(7, &camera(0.0)), simple],
        images: vec![
            ColmapImage::posed(12, 7, "left/b c.png", &camera(1.0)),
            ColmapImage::posed(3, 900, "ä.jpg", &camera(2.0)),
            ColmapImage::posed(5, 7, "a.png", &camera(3.0)),
        ],
        points: PointCloud {
            positions: vec![[0.1, 0.2, 0.3], [1.0, -1e-7, 1e7], [0.0; 3], [4.0, 5.0, 6.0]],
            colors: vec![[1, 2, 3], [255, 0, 128], [9; 3], [0; 3]],
        },
    }
}

fn write(dataset: &Path, place: &str, parts: &Parts) {
    colmap::write(dataset.join(place), &parts.cameras, &parts.images, &parts.points).unwrap();
}

/// The same model as text, with comments, blank lines and observations.
fn write_text(folder: &Path, parts: &Parts) {
    let join = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let mut cameras = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n\n".to_owned();
    for c in &parts.cameras {
        cameras += &format!("{} {} {} {} {}\n", c.id, c.model.name(), c.width, c.height, join(&c.parameters));
    }
    let mut images = "# two lines per image\n".to_owned();
    for (index, i) in parts.images.iter().enumerate() {
        let pose = format!("{} {}", join(&i.quat), join(&i.translation));
        let observations = ["1.5 2.5 -1 3 4 2", "", "  "][index % 3];
        images += &format!("{} {pose} {} {}\n{observations}\n", i.id, i.camera_id, i.name);
    }
    let mut points = "# points\n".to_owned();
    for (index, (p, c)) in parts.points.positions.iter().zip(&parts.points.colors).enumerate() {
        points += &format!("{index} {} {} {} {} 0.5 3 0 5 1\n", join(&p.map(f64::from)), c[0], c[1], c[2]);
    }
    std::fs::create_dir_all(folder).unwrap();
    for (name, text) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        std::fs::write(folder.join(format!("{name}.txt")), text).unwrap();
    }
}

fn assert_same(model: &Model, parts: &Parts) {
    assert_eq!(model.cameras.values().cloned().collect::<Vec<_>>(), parts.cameras);
    assert_eq!(model.images, parts.images);
    assert_eq!(model.points.clone().in_frame(&WorldFrame::default()), parts.points);
}

/// A field of COLMAP's files of rigs and frames.
enum Field {
    Kind(&'static str),
    Id(u32),
    Flag(u8),
    Data(u64),
    Number(f64),
}

use Field::{Data, Flag, Id, Kind, Number};

/// Writes records with one line, or the bytes of each field.
fn write_records(folder: &Path, part: &str, records: &[Vec<Field>], text: bool) {
    let word = |field: &Field| match field {
        Kind(kind) => (*kind).to_owned(),
        Id(id) => id.to_string(),
        Flag(flag) => flag.to_string(),
        Data(id) => id.to_string(),
        Number(number) => number.to_string(),
    };
    let line = |record: &Vec<Field>| record.iter().map(word).collect::<Vec<_>>().join(" ");
    let bytes = |field: &Field| match field {
        Kind(kind) => i32::from(*kind == "IMU").to_le_bytes().to_vec(),
        Id(id) => id.to_le_bytes().to_vec(),
        Flag(flag) => vec![*flag],
        Data(id) => id.to_le_bytes().to_vec(),
        Number(number) => number.to_le_bytes().to_vec(),
    };
    let contents = match text {
        true => {
            format!("# comment\n{}\n", records.iter().map(line).collect::<Vec<_>>().join("\n")).into_bytes()
        }
        false => [(records.len() as u64).to_le_bytes().to_vec()]
            .into_iter()
            .chain(records.iter().flatten().map(bytes))
            .flatten()
            .collect(),
    };
    std::fs::write(folder.join(part).with_extension(if text { "txt" } else { "bin" }), contents).unwrap();
}

/// Writes a rig of both cameras of [`parts`], and one of an absent camera. The first frame has the first two images, the second
/// one the third.
fn write_rigs(folder: &Path, images: &[ColmapImage], text: bool) {
    let pose = |image: &ColmapImage| {
        let [w, x, y, z] = image.quat;
        (DQuat::from_xyzw(x, y, z, w), DVec3::from_array(image.translation))
    };
    let numbers = |(q, t): (DQuat, DVec3)| [q.w, q.x, q.y, q.z, t.x, t.y, t.z].map(Number);
    let [first, second, third] = [0, 1, 2].map(|index| pose(&images[index]));
    let turn = second.0 * first.0.inverse();
    let mut rig = vec![Id(1), Id(3), Kind("CAMERA"), Id(7), Kind("CAMERA"), Id(900), Flag(1)];
    rig.extend(numbers((turn, second.1 - turn * first.1)));
    rig.extend([Kind("IMU"), Id(900), Flag(0)]);
    write_records(folder, "rigs", &[rig, vec![Id(4), Id(1), Kind("CAMERA"), Id(8)]], text);
    let frame = |id: u32, pose, data: Vec<(&'static str, u32, u64)>| {
        let mut frame = vec![Id(id), Id(1)];
        frame.extend(numbers(pose));
        frame.push(Id(data.len() as u32));
        frame.extend(data.into_iter().flat_map(|(kind, sensor, id)| [Kind(kind), Id(sensor), Data(id)]));
        frame
    };
    let both = vec![("CAMERA", 7, 12), ("CAMERA", 900, 3), ("IMU", 900, 77)];
    let frames = [frame(1, first, both), frame(2, third, vec![("CAMERA", 7, 5)])];
    write_records(folder, "frames", &frames, text);
}

fn error(dataset: &Path) -> String {
    refusal(dataset, Model::of_dataset(dataset))
}

#[test]
fn binary_round_trip_and_text_are_equal() {
    let folder = Folder::new();
    let parts = parts();
    write(&folder, "binary/sparse/0", &parts);
    write_text(&folder.join("text/sparse/0"), &parts);
    assert_eq!(names(&folder.join("binary/sparse/0")), ["cameras.bin", "images.bin", "points3D.bin"]);
    let binary = Model::of_dataset(folder.join("binary")).unwrap();
    assert_same(&binary, &parts);
    assert!(binary.warnings.is_empty() && !binary.source.text);
    let text = Model::of_dataset(folder.join("text")).unwrap();
    assert_same(&text, &parts);
    assert!(text.warnings.is_empty() && text.source.text);
    // The pose survives the conversion to a quaternion.
    let camera = binary.camera_of(&binary.images[0]).unwrap();
    assert!(camera.position().abs_diff_eq(Vec3::new(1.0, -2.0, 1.0), 1e-5));
    assert_eq!(camera.intrinsics().fy, 61.0);
    let simple = binary.camera_of(&binary.images[1]).unwrap().intrinsics();
    assert_eq!((simple.fx, simple.fy, simple.cx, simple.cy), (15.0, 15.0, 10.0, 5.0));
}

#[test]
fn every_place_of_a_model_is_found() {
    let parts = parts();
    for (place, text) in
        [("sparse/0", false), ("sparse", false), (".", false), ("sparse/0", true), ("sparse", true)]
    {
        let folder = Folder::new();
        match text {
            true => write_text(&folder.join(place), &parts),
            false => write(&folder, place, &parts),
        }
        let model = Model::of_dataset(&folder).unwrap();
        assert_same(&model, &parts);
        assert_eq!((model.source.text, model.warnings.len()), (text, 0), "{place}");
    }
}

#[test]
fn binary_is_preferred_to_text_and_folders_without_model_are_passed_over() {
    let folder = Folder::new();
    let all = parts();
    write(&folder, "sparse/1", &all);
    let fewer = Parts { images: all.images[..1].to_vec(), ..parts() };
    write_text(&folder.join("sparse/1"), &fewer);
    std::fs::create_dir_all(folder.join("sparse/0")).unwrap();
    let model = Model::of_dataset(&folder).unwrap();
    assert_same(&model, &all);
    assert!(model.warnings.is_empty());
    // The text was edited after the conversion.
    let images = std::fs::File::options().append(true).open(folder.join("sparse/1/images.txt")).unwrap();
    images.set_modified(SystemTime::now() + Duration::from_secs(9)).unwrap();
    let model = Model::of_dataset(&folder).unwrap();
    assert!(model.warnings[0].contains("images.txt is newer than images.bin, which is used"));
}

#[test]
fn the_largest_of_several_is_taken() {
    let folder = Folder::new();
    let all = parts();
    let images = |n: usize| Parts { images: all.images[..n].to_vec(), ..parts() };
    let no_points = Parts { points: PointCloud::default(), ..parts() };
    write(&folder, "sparse/0", &images(2));
    write(&folder, "sparse/10", &all);
    write(&folder, "sparse/2", &no_points);
    write_text(&folder.join("sparse/3"), &images(1));
    let chosen = |expected: &str| {
        let found = colmap::find(&folder).unwrap();
        assert_eq!(found.folder, folder.join("sparse").join(expected));
        let named = folder.join("sparse").join(expected);
        assert!(found.warning.unwrap().contains(&format!("{}, the largest", named.display())));
    };
    chosen("10");
    write_text(&folder.join("sparse/3"), &all);
    // Among equally large models, the lowest number.
    chosen("3");
    std::fs::remove_dir_all(folder.join("sparse/3")).unwrap();
    std::fs::remove_dir_all(folder.join("sparse/10")).unwrap();
    chosen("2");
}

#[test]
fn what_is_missing_is_named() {
    let folder = Folder::new();
    assert!(error(&folder.join("none")).contains("none: cannot read"));
    assert!(
        error(&folder).contains("has no COLMAP model (sparse/0/cameras.bin or .txt) and no transforms.json")
    );
    write(&folder, "sparse/0", &parts());
    let model = folder.join("sparse/0");
    std::fs::remove_file(model.join("cameras.bin")).unwrap();
    assert!(error(&folder).contains("the model has no cameras.bin"));
    std::fs::remove_file(model.join("images.bin")).unwrap();
    assert!(error(&folder).contains("has no COLMAP model"));
    let file = folder.join("file");
    std::fs::write(&file, "x").unwrap();
    assert!(error(&file).contains("is not a folder"));
}

#[test]
fn no_truncation_of_a_binary_model_is_accepted_and_no_mutation_panics() {
    let folder = Folder::new();
    let check = || {
        if let Ok(model) = Model::of_dataset(&folder) {
            assert_eq!(model.points.colors.len(), model.points.len());
            for image in &model.images {
                if let Ok(camera) = model.camera_of(image) {
                    camera.check().unwrap();
                }
                let _ = image.photo_path(Path::new("images"), Path::new("images.bin"));
            }
        }
    };
    for text in [false, true] {
        match text {
            true => write_text(&folder.join("sparse/0"), &parts()),
            false => write(&folder, "sparse/0", &parts()),
        }
        write_rigs(&folder.join("sparse/0"), &parts().images, text);
        for part in ["cameras", "images", "points3D", "rigs", "frames"] {
            let ending = if text { "txt" } else { "bin" };
            let path = folder.join("sparse/0").join(part).with_extension(ending);
            let bytes = std::fs::read(&path).unwrap();
            for_each_mutation(&path, &bytes, check);
            for_each_truncation(&path, &bytes, |_| match text {
                true => check(),
                false => assert!(error(&folder).contains(part)),
            });
            std::fs::write(&path, &bytes).unwrap();
        }
        assert_same(&Model::of_dataset(&folder).unwrap(), &parts());
        std::fs::remove_dir_all(folder.join("sparse")).unwrap();
    }
}

/// Rigs add a line, and change neither poses nor photos. Where they contradict the images, a warning says what is used.
#[test]
fn rigs_are_compared_with_the_images() {
    let folder = Folder::new();
    let sparse = folder.join("sparse/0");
    for text in [false, true] {
        match text {
            true => write_text(&sparse, &parts()),
            false => write(&folder, "sparse/0", &parts()),
        }
        write_rigs(&sparse, &parts().images, text);
        let model = Model::of_dataset(&folder).unwrap();
        assert_same(&model, &parts());
        assert_one(&model.notes, &["2 rigs of up to 3 sensors, 2 frames: the poses are those of images."]);
        assert!(model.warnings.is_empty(), "{:?}", model.warnings);
        // A tool that moves the images leaves the frames where they were.
        let mut moved = parts().images;
        moved.iter_mut().for_each(|image| image.translation[1] += 0.1);
        write_rigs(&sparse, &moved, text);
        let model = Model::of_dataset(&folder).unwrap();
        assert_same(&model, &parts());
        let words = [
            "frame 1 and its rig give image 12 (left/b c.png) another pose than images.",
            "2 more",
            "are used",
        ];
        assert_one(&model.warnings, &words);
        std::fs::remove_dir_all(folder.join("sparse")).unwrap();
    }
    write_text(&sparse, &parts());
    for (part, old, new, words) in [
        ("rigs", "1 3 CAMERA", "9 3 CAMERA", "frame 1 has the rig 1, which does not exist (and 2 more"),
        ("rigs", "CAMERA 7", "CAMERA 6", "frame 1 has camera 7, which its rig 1 does not have (and 1 more"),
        ("frames", "900 3", "900 33", "frame 1 has image 33, which images.txt does not list:"),
        ("frames", "CAMERA 7 5", "CAMERA 900 5", "image 5 of camera 900, in images.txt it is of camera 7"),
    ] {
        write_rigs(&sparse, &parts().images, true);
        let path = sparse.join(part).with_extension("txt");
        let changed = std::fs::read_to_string(&path).unwrap().replace(old, new);
        std::fs::write(&path, changed).unwrap();
        assert_one(
            &Model::of_dataset(&folder).unwrap().warnings,
            &[words, "the poses of images.txt are used"],
        );
    }
    // COLMAP knows no pose of the second camera in its rig.
    write_rigs(&sparse, &parts().images, true);
    std::fs::write(sparse.join("rigs.txt"), "1 2 CAMERA 7 CAMERA 900 0\n").unwrap();
    let words = ["frame 1 has camera 900, which has no pose in its rig 1: the poses of images.txt are used"];
    assert_one(&Model::of_dataset(&folder).unwrap().warnings, &words);
    std::fs::write(sparse.join("rigs.txt"), "1 2 CAMERA 7 CAMERA 900 1 1 0\n").unwrap();
    assert!(error(&folder).contains("rigs.txt: line 1: the quaternion is missing"), "{}", error(&folder));
}

#[test]
fn text_errors_name_the_line() {
    let folder = Folder::new();
    let model = folder.join("sparse/0");
    for (part, text, words) in [
        ("cameras", "1 PINHOLE 64 48 1 2 3", "cameras.txt: line 1: the parameter is missing"),
        ("cameras", "# x\n1 PINHOLE 64 48 1 2 3 4 5", "line 2: has more values than its camera model"),
        ("cameras", "1 BALL 64 48 1", "line 1: unknown camera model \"BALL\""),
        (
            "cameras",
            "1 SPHERE 64 48 1",
            "unknown camera model \"SPHERE\"; COLMAP calls panoramas EQUIRECTANGULAR",
        ),
        ("cameras", "1 PINHOLE -64 48 1 2 3 4", "\"-64\" is no valid width"),
        ("images", "1 1 0 0 0 0 0 0 7 a.png\n1 2 3 4\n", "line 2: the quaternion is missing"),
        ("images", "1 1 0 0 0 0 0 0 7 a.png\n1 2 3\n4 5 6\n", "line 3: the quaternion is missing"),
        ("cameras", "1 PINHOLE 64 48 1,5 2 3 4", "\"1,5\" is no valid parameter (a decimal comma"),
        ("images", "1.5 1 0 0 0 0 0 0 7 a.png\n", "\"1.5\" is no valid image id; correct"),
        ("images", "1 1 0 0 0 0 0 0 7\n", "line 1: the image name is missing"),
        ("images", "1 1 0 0 0 0 0 0 7 a.png\n\n1 1 0 0 0 0 0 0 7 b.png\n", "image id 1 appears twice"),
        (
            "images",
            "1 1 0 0 0 0 0 0 7 a.png\n\n2 1 0 0 0 0 0 0 7 a.png\n",
            "image name \"a.png\" appears twice",
        ),
        ("points3D", "1 0 0 0 256 0 0 1", "line 1: \"256\" is no valid colour"),
        ("points3D", "<!DOCTYPE html>", "is a web page"),
    ] {
        write_text(&model, &parts());
        std::fs::write(model.join(part).with_extension("txt"), text).unwrap();
        assert_says(error(&folder), &[words]);
    }
}

/// Other programs omit the lines of observations, or insert blank lines, whatever the names are.
#[test]
fn images_are_told_from_observations_by_their_words() {
    let folder = Folder::new();
    let model = folder.join("sparse/0");
    let parts = Parts { points: PointCloud::default(), ..parts() };
    let three_words = ["one.png", "shot 2.png", "my shot 3.png"];
    for between in ["", "\n", "\n\n", "1.5 2.5 -1\n", "\n1.5 2.5 -1 10 2e1 3\n\n"] {
        write_text(&model, &parts);
        let mut text = String::new();
        for (id, name) in (1..).zip(three_words) {
            text += &format!("{id} 1 0 0 0 0 0 0 7 {name}\n{between}");
        }
        std::fs::write(model.join("images.txt"), text).unwrap();
        let read = Model::of_dataset(&folder).unwrap();
        let names: Vec<&str> = read.images.iter().map(|image| image.name.as_str()).collect();
        assert_eq!(names, three_words, "{between:?}");
        assert_eq!(colmap::observations(&read).unwrap().len(), 3);
    }
}

#[test]
fn text_may_have_a_byte_order_mark_or_be_latin_1() {
    let folder = Folder::new();
    let model = folder.join("sparse/0");
    write_text(&model, &parts());
    for part in ["cameras", "images", "points3D"] {
        let path = model.join(part).with_extension("txt");
        let text = std::fs::read(&path).unwrap();
        std::fs::write(&path, [b"\xef\xbb\xbf", &*text].concat()).unwrap();
    }
    assert_same(&Model::of_dataset(&folder).unwrap(), &parts());
    let images = std::fs::read_to_string(model.join("images.txt")).unwrap();
    let latin_1: Vec<u8> = images.chars().skip(1).map(|c| u8::try_from(c).unwrap()).collect();
    std::fs::write(model.join("images.txt"), latin_1).unwrap();
    assert_same(&Model::of_dataset(&folder).unwrap(), &parts());
    let utf_16: Vec<u8> = images.encode_utf16().flat_map(u16::to_le_bytes).collect();
    std::fs::write(model.join("images.txt"), utf_16).unwrap();
    assert!(error(&folder).contains("images.txt: is text in UTF-16; save it in UTF-8"));
    std::fs::write(model.join("images.txt"), images.replace('\n', "\r")).unwrap();
    assert!(error(&folder).contains("images.txt: ends its lines with CR alone"));
}

/// Points may be in points3D.ply, as the reference reads it.
#[test]
fn points_may_be_a_ply() {
    let folder = Folder::new();
    let model = folder.join("sparse/0");
    write(&folder, "sparse/0", &parts());
    let more = PointCloud { positions: vec![[1.0; 3]; 9], colors: vec![[7; 3]; 9] };
    ashsplat_files::ply::write_points(model.join("points3D.ply"), &more, &WorldFrame::default()).unwrap();
    let points = |read: &Model| read.points.clone().in_frame(&WorldFrame::default());
    let read = Model::of_dataset(&folder).unwrap();
    assert_eq!(points(&read), parts().points);
    assert_says(&read.warnings[0], &["points3D.ply: has other points than"]);
    std::fs::write(model.join("points3D.bin"), 0_u64.to_le_bytes()).unwrap();
    assert_eq!(points(&Model::of_dataset(&folder).unwrap()), more);
    std::fs::remove_file(model.join("points3D.bin")).unwrap();
    let read = Model::of_dataset(&folder).unwrap();
    assert_eq!((points(&read), read.warnings.len()), (more, 0));
    assert!(colmap::observations(&read).is_ok());
}

#[test]
fn names_stay_in_the_images_folder() {
    let camera = Camera::look_at(Vec3::ONE, Vec3::ZERO, Vec3::Y, Intrinsics::from_fov_x(1.0, 8, 8));
    let path = |name: &str| {
        ColmapImage::posed(1, 1, name, &camera).photo_path(Path::new("/data/images"), Path::new("images.bin"))
    };
    for name in ["../a.png", "a/../../b.png", "/etc/passwd", "..", "a\\..\\b.png", "", "a\0b", "left/.."] {
        assert!(path(name).unwrap_err().to_string().starts_with("images.bin: image 1"), "{name:?}");
    }
    for name in ["a.png", "left/a.png", "a..b.png", "...", "./a.png", "a b/ü.jpg"] {
        assert_eq!(path(name).unwrap(), Path::new("/data/images").join(name));
    }
}

#[test]
fn what_cannot_be_written_is_refused() {
    let folder = Folder::new();
    let mut parts = parts();
    parts.cameras[0].parameters.pop();
    assert!(colmap::write(&folder, &parts.cameras, &[], &parts.points).is_err());
    parts.images[0].name = "a\0b".into();
    assert!(colmap::write(&folder, &[], &parts.images, &parts.points).is_err());
    assert_eq!(names(&folder), [""; 0]);
}

/// In text, points have the ids 0, 1, …; in binary 1, 2, ….
#[test]
fn observations_are_those_of_the_points_that_exist() {
    let folder = Folder::new();
    let parts = parts();
    write_text(&folder.join("text/sparse/0"), &parts);
    write(&folder, "binary/sparse/0", &parts);
    let mut images = 3_u64.to_le_bytes().to_vec();
    for (index, image) in parts.images.iter().enumerate() {
        let seen: &[([f64; 2], u64)] = match index {
            0 => &[([1.5, 2.5], u64::MAX), ([3.0, 4.0], 3)],
            _ => &[([5.0, 6.0], 77)],
        };
        images.extend(image.id.to_le_bytes());
        image.quat.iter().chain(&image.translation).for_each(|x| images.extend(x.to_le_bytes()));
        images.extend(image.camera_id.to_le_bytes());
        images.extend(image.name.as_bytes());
        images.push(0);
        images.extend((seen.len() as u64).to_le_bytes());
        for (at, point) in seen {
            at.iter().for_each(|x| images.extend(x.to_le_bytes()));
            images.extend(point.to_le_bytes());
        }
    }
    folder.put("binary/sparse/0/images.bin", images);
    for name in ["text", "binary"] {
        let all = colmap::observations(&Model::of_dataset(folder.join(name)).unwrap()).unwrap();
        assert_eq!(all.len(), 3, "{name}");
        let [point] = all[&12][..] else { panic!("{name}: {:?}", all[&12]) };
        assert_eq!(point.position_px, [3.0, 4.0], "{name}");
        // Depth of the point at the origin.
        let z = parts.images[0].translation[2];
        assert!((point.inverse_z * z - 1.0).abs() < 1e-9, "{name}: {}", point.inverse_z);
        assert!(all[&3].is_empty() && all[&5].is_empty(), "{name}");
    }
}
