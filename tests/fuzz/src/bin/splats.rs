//! Arbitrary bytes as a file of Gaussians in any format.
#![no_main]

use ashsplat_files::splats::{self, WriteOptions};
use ashsplat_fuzz::{check_gaussians, folder, gaussians, leave_seed};
use flate2::{Compression, write::GzEncoder};
use libfuzzer_sys::fuzz_target;
use std::io::Write;
use std::path::PathBuf;
use std::sync::LazyLock;

/// The first byte of an input chooses the name. For the last one, the rest is the unpacked content of an SPZ.
const NAMES: [&str; 10] =
    ["a.ply", "a.compressed.ply", "a.splat", "a.spz", "a.glb", "a.gltf", "a.sog", "a.usda", "b.ksplat", "packed.spz"];

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| folder("splats"));

fn seeds() {
    for degree in [0, 1] {
        for (kind, name) in NAMES.iter().enumerate().filter(|(_, name)| name.starts_with("a.")) {
            let path = FOLDER.join(name);
            splats::write(&path, &gaussians(2, degree), &WriteOptions::default()).expect("written");
            let bytes = std::fs::read(&path).expect("there");
            leave_seed(&format!("{name}{degree}"), &[&[kind as u8], &bytes[..]].concat());
        }
    }
    for level in 0..3 {
        // Two Gaussians of degree 1 in a bucket of their own; one number repeats after the headers.
        let mut ksplat = vec![0; 1 + 4096 + 1024];
        ksplat[0] = NAMES.len() as u8 - 2;
        for (at, value) in [(1, 1), (4, 1), (8, 1), (12, 2), (16, 2), (20, level)] {
            ksplat[1 + at] = value;
        }
        for (at, value) in [(0, 2), (4, 2), (12, 1), (18, 0x80), (19, 0x3f), (20, 12), (36, 1), (40, 1)] {
            ksplat[1 + 4096 + at] = value;
        }
        ksplat.extend([2, 0, 0, 0]);
        ksplat.extend([0x3c; 12 + 2 * 80]);
        leave_seed(&format!("ksplat{level}"), &ksplat);
    }
    for version in [2u32, 3] {
        let mut unpacked = vec![NAMES.len() as u8 - 1];
        unpacked.extend(b"NGSP");
        unpacked.extend(version.to_le_bytes());
        unpacked.extend(2u32.to_le_bytes());
        unpacked.extend([0, 12, 0, 0]);
        unpacked.extend([7; 2 * 20]);
        leave_seed(&format!("packed{version}"), &unpacked);
    }
}

fuzz_target!(init: seeds(), |data: &[u8]| {
    let [kind, bytes @ ..] = data else { return };
    let name = NAMES[usize::from(*kind) % NAMES.len()];
    let path = FOLDER.join(name);
    if name.starts_with("packed") {
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(bytes).expect("packed");
        check_gaussians(&path, &packed.finish().expect("packed"));
    } else {
        check_gaussians(&path, bytes);
    }
});
