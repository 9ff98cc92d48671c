//! Arbitrary bytes as the files of a COLMAP model, binary or text.
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

// First byte: the format. Then the lengths of cameras, images, rigs and frames, two bytes each; the rest is points.
fuzz_target!(|data: &[u8]| {
    let [format, rest @ ..] = data else { return };
    let Some((lengths, mut rest)) = rest.split_at_checked(8) else { return };
    let [mine, other] = if format & 1 == 0 { ["bin", "txt"] } else { ["txt", "bin"] };
    let mut parts = [("cameras", rest), ("images", rest), ("rigs", rest), ("frames", rest), ("points3D", rest)];
    for ((_, bytes), length) in parts.iter_mut().zip(lengths.chunks(2)) {
        let length = usize::from(u16::from_le_bytes([length[0], length[1]]));
        (*bytes, rest) = rest.split_at(length.min(rest.len()));
    }
    parts[4].1 = rest;
    for (part, bytes) in parts {
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
