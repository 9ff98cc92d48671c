//! COLMAP's text: long lists, long lines, comments, many models to choose from.

use super::assert_linear;
use crate::colmap::Model;
use std::fmt::Write;
use std::path::Path;

/// Writes a text model; images have observations, points have tracks.
pub(super) fn write_model(folder: &Path, cameras: &str, images: &str, points: &str) {
    std::fs::create_dir_all(folder).unwrap();
    for (name, text) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        std::fs::write(folder.join(name).with_extension("txt"), text).unwrap();
    }
}

/// Text of `count` lines, numbered from 1.
fn lines(count: usize, line: impl Fn(usize, &mut String)) -> String {
    let mut text = String::new();
    (1..=count).for_each(|index| line(index, &mut text));
    text
}

const CAMERA: &str = "1 PINHOLE 4 2 5 5 2 1\n";
const IMAGE: &str = "1 1 0 0 0 0 0 0 1 a.png\n";

/// A comment before each line; images have eight observations, points a track of ten. One rig has all cameras.
#[test]
fn text_models_of_many_cameras_images_points_and_frames() {
    let write = |folder: &Path, size: usize| {
        let cameras = lines(size, |id, text| {
            writeln!(text, "# camera {id}\n{id} OPENCV 400 200 50{id} 500 200 100 0 0 0 0").unwrap();
        });
        let images = lines(size, |id, text| {
            let observations = "1.5 2.5 -1 ".repeat(8);
            writeln!(text, "# image\n{id} 1 0 0 0 0.25 0 {id} {id} a name {id}.png\n{observations}").unwrap();
        });
        let points = lines(size, |id, text| {
            writeln!(text, "\n# point\n{id} 0.5 -1.5 {id} 10 20 30 0.7{}", " 1 2".repeat(10)).unwrap();
        });
        write_model(&folder.join("sparse/0"), &cameras, &images, &points);
        let others: String = (2..=size).map(|id| format!(" CAMERA {id} 1 1 0 0 0 0 0 0")).collect();
        std::fs::write(folder.join("sparse/0/rigs.txt"), format!("1 {size} CAMERA 1{others}\n")).unwrap();
        let frames = lines(size, |id, text| {
            writeln!(text, "# frame\n{id} 1 1 0 0 0 0.25 0 {id} 1 CAMERA {id} {id}").unwrap();
        });
        std::fs::write(folder.join("sparse/0/frames.txt"), frames).unwrap();
    };
    assert_linear(3000, write, |folder| {
        let model = Model::of_dataset(folder).unwrap();
        assert!(model.points.len() >= 3000 && model.images.len() == model.points.len());
        assert!(model.notes.len() == 1 && model.warnings.is_empty(), "{:?}", model.warnings);
        assert!(model.images.iter().all(|image| model.camera_of(image).is_ok()));
    });
}

#[test]
fn text_models_with_long_lines() {
    let write = |folder: &Path, size: usize| {
        let images = format!("{IMAGE}{}\n", "1.5 2.5 -1 ".repeat(size));
        let points = format!("1 0.5 0.5 0.5 1 2 3 0.5{}\n", " 1 2".repeat(size));
        let cameras = format!("#{}\n{CAMERA}", " comment".repeat(size));
        write_model(&folder.join("sparse/0"), &cameras, &images, &points);
    };
    assert_linear(50_000, write, |folder| {
        let model = Model::of_dataset(folder).unwrap();
        assert_eq!((model.images.len(), model.points.len()), (1, 1));
    });
}

#[test]
fn many_text_models_beside_each_other() {
    let write = |folder: &Path, size: usize| {
        for model in 0..size {
            let points = lines(1 + model % 5, |id, text| writeln!(text, "{id} 0 0 1 1 2 3 0.5").unwrap());
            write_model(&folder.join(format!("sparse/{model}")), CAMERA, &format!("{IMAGE}\n"), &points);
        }
    };
    assert_linear(40, write, |folder| {
        let model = Model::of_dataset(folder).unwrap();
        assert_eq!(model.source.folder, folder.join("sparse/4"));
    });
}
