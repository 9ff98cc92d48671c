//! Any bytes as a PLY: Gaussians with and without unusable ones, and points.
#![no_main]

use ashsplat_fuzz::folder;
use ashsplat_files::ply;
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("ply").join("input.ply"));

fuzz_target!(|data: &[u8]| {
    std::fs::write(&*FILE, data).expect("written");
    for drop_invalid in [false, true] {
        match ply::read(&*FILE, &ply::PlyOptions { drop_invalid }) {
            Ok(scene) => scene.gaussians.check_shapes().expect("shapes that fit together"),
            Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
        }
    }
    if let Ok(points) = ply::read_points(&*FILE) {
        assert_eq!(points.positions.len(), points.colors.len());
    }
});
