//! Arbitrary bytes as a PLY: Gaussians, with and without unusable ones, and points.
#![no_main]

use ashsplat_files::ply;
use ashsplat_fuzz::{check_gaussians, folder, in_one_line, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("ply").join("input.ply"));

fuzz_target!(|data: &[u8]| {
    check_gaussians(&FILE, data);
    within(data.len(), |_| {
        if let Some(points) = in_one_line(ply::read_points(&*FILE, &mut Vec::new())) {
            assert_eq!(points.positions.len(), points.colors.len());
        }
    });
});
