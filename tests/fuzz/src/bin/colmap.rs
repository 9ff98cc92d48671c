//! Arbitrary bytes as the three files of a COLMAP model, binary or text.
#![no_main]

use ashsplat_files::colmap::{self, Model};
use ashsplat_fuzz::{folder, in_one_line, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = folder("colmap");
    std::fs::create_dir_all(folder.join("sparse/0")).expect("a folder for the model");
    folder
});

// First byte: the format. Then the lengths of cameras and images, two bytes each; the rest is points.
fuzz_target!(|data: &[u8]| {
    let [format, a, b, c, d, rest @ ..] = data else { return };
    let [mine, other] = if format & 1 == 0 { ["bin", "txt"] } else { ["txt", "bin"] };
    let cameras = usize::from(u16::from_le_bytes([*a, *b])).min(rest.len());
    let images = usize::from(u16::from_le_bytes([*c, *d])).min(rest.len() - cameras);
    let (cameras, rest) = rest.split_at(cameras);
    let (images, points) = rest.split_at(images);
    for (part, bytes) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        std::fs::remove_file(FOLDER.join(format!("sparse/0/{part}.{other}"))).ok();
        std::fs::write(FOLDER.join(format!("sparse/0/{part}.{mine}")), bytes).expect("written");
    }
    within(data.len(), |_| {
        let model = colmap::find(&*FOLDER).and_then(|source| Model::read(&source));
        if let Some(model) = in_one_line(model) {
            for image in &model.images {
                let _ = model.camera_of(image);
            }
        }
    });
});
