//! Arbitrary bytes as a PLY: Gaussians, with and without unusable ones, and points.
#![no_main]

use ashsplat_files::ply;
use ashsplat_fuzz::{folder, in_one_line, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("ply").join("input.ply"));

fuzz_target!(|data: &[u8]| {
    std::fs::write(&*FILE, data).expect("written");
    within(data.len(), |_| {
        for drop_invalid in [false, true] {
            if let Some(scene) = in_one_line(ply::read(&*FILE, &ply::PlyOptions { drop_invalid })) {
                scene.gaussians.check_shapes().expect("shapes that fit together");
            }
        }
        if let Some(points) = in_one_line(ply::read_points(&*FILE)) {
            assert_eq!(points.positions.len(), points.colors.len());
        }
    });
});
