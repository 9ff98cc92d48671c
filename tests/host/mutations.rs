//! Valid files with random damage: readers refuse or read them, and never panic. A short form of tests/fuzz.

use crate::common::scenes::Random;
use ashsplat::scene::{PointCloud, WorldFrame};
use ashsplat::trainer::Checkpoint;
use ashsplat_files::colmap::{self, Model};
use ashsplat_files::{CheckpointFile, ply};
use std::path::Path;
use tempfile::tempdir;

/// Numbers that break readers.
const NUMBERS: [&str; 8] =
    ["0", "-1", "4294967295", "18446744073709551615", "1e30", "nan", "65536", "2147483648"];

fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len().max(1) as u32) as usize;
        match random.below(6) {
            0 => bytes.truncate(at),
            1 if !bytes.is_empty() => bytes[at] = random.bits() as u8,
            2 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            3 => {
                bytes.splice(at..at, NUMBERS[random.below(8) as usize].bytes());
            }
            4 => {
                let end = (at + random.below(40) as usize).min(bytes.len());
                bytes.drain(at.min(end)..end);
            }
            _ => {
                let end = (at + 8).min(bytes.len());
                bytes[at.min(end)..end].fill(0xFF);
            }
        }
    }
    bytes
}

fn points() -> PointCloud {
    PointCloud { positions: vec![[0.0, 1.0, 2.0]; 5], colors: vec![[1, 2, 3]; 5] }
}

/// Damages a file `times` times and reads it.
fn mutate(path: &Path, seed: u64, times: u32, read: impl Fn(&Path)) {
    let sound = std::fs::read(path).expect("a sound file");
    let mut random = Random::new(seed);
    for _ in 0..times {
        std::fs::write(path, damage(&sound, &mut random)).expect("written");
        read(path);
    }
    std::fs::write(path, sound).expect("written");
}

#[test]
fn damaged_ply_files_are_read_or_refused() {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("a.ply");
    let scene = ashsplat_files::initial_gaussians(&points(), 1).expect("Gaussians");
    ply::write(&path, &scene).expect("written");
    let options = ply::PlyOptions { drop_invalid: true };
    mutate(&path, 1, 600, |path| {
        if let Ok(read) = ply::read(path, &options) {
            read.gaussians.check_shapes().expect("shapes that fit together");
        }
    });
    ply::write_points(&path, &points(), &WorldFrame::default()).expect("written");
    mutate(&path, 2, 300, |path| drop(ply::read_points(path)));
}

#[test]
fn damaged_colmap_models_are_read_or_refused() {
    let folder = tempdir().expect("a temporary folder");
    let model = folder.path().join("sparse/0");
    std::fs::create_dir_all(&model).expect("a folder");
    let camera = crate::common::engine::camera(&crate::common::scenes::small_view([20, 10]));
    let images = [1, 2].map(|id| colmap::ColmapImage::posed(id, 1, format!("{id}.png"), &camera));
    let lens = colmap::ColmapCamera::pinhole(1, &camera);
    colmap::write(&model, &[lens], &images, &points()).expect("a model");
    for (seed, part) in (10..).zip(["cameras.bin", "images.bin", "points3D.bin"]) {
        mutate(&model.join(part), seed, 200, |_| {
            let read = colmap::find(folder.path()).and_then(|source| Model::read(&source));
            if let Ok(read) = read {
                read.images.iter().for_each(|image| drop(read.camera_of(image)));
            }
        });
    }
}

#[test]
fn damaged_safetensors_are_refused() {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("a.safetensors");
    let header = br#"{"__metadata__":{"format":"ashsplat-checkpoint/2"},"means":{"dtype":"F32","shape":[1,3],"data_offsets":[0,12]}}"#;
    let bytes = [&(header.len() as u64).to_le_bytes(), header.as_slice(), &[0; 12]].concat();
    std::fs::write(&path, bytes).expect("written");
    mutate(&path, 20, 400, |path| {
        let message = Checkpoint::read(path).expect_err("no checkpoint").to_string();
        assert!(!message.contains('\n'), "{message}");
    });
}
