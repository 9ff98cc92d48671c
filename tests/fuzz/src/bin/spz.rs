//! SPZ of versions 2, 3 and 4, with counts that do or do not fit the packed data.
#![no_main]

use arbitrary::Arbitrary;
use ashsplat_files::splats::{self, WriteOptions};
use ashsplat_fuzz::hostile::{Filling, Number, Patch, patch};
use ashsplat_fuzz::{check_gaussians, folder, gaussians};
use flate2::{Compression, write::GzEncoder};
use libfuzzer_sys::fuzz_target;
use std::io::Write;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("spz").join("input.spz"));

#[derive(Arbitrary, Debug)]
enum Spz {
    Gzip {
        version: u8,
        count: u32,
        claimed: Number,
        degree: u8,
        fractional_bits: u8,
        flags: u8,
        data: Filling,
        length: Number,
        patches: Vec<Patch>,
    },
    Zstd {
        count: u16,
        degree: u8,
        inside: Vec<Patch>,
    },
}

impl Spz {
    fn file(&self) -> Vec<u8> {
        match self {
            Self::Gzip { version, count, claimed, degree, fractional_bits, flags, data, length, patches } => {
                let version = u32::from(version % 4) + 1;
                // Large counts are slow, so they are rare.
                let count = u64::from(count % 600_000 >> (degree / 5 % 8 * 2));
                let degree = degree % 5;
                let coefficients = (u64::from(degree) + 1).pow(2) - 1;
                let row = 9 + 1 + 3 + 3 + if version == 2 { 3 } else { 4 } + 3 * coefficients;
                let mut unpacked = b"NGSP".to_vec();
                unpacked.extend(version.to_le_bytes());
                unpacked.extend((claimed.of(count) as u32).to_le_bytes());
                unpacked.extend([degree, fractional_bits % 32, *flags, 0]);
                unpacked.extend(data.exactly(length.of(count * row).min(data.max_packed() as u64) as usize));
                let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
                packed.write_all(&unpacked).expect("packed");
                let mut file = packed.finish().expect("packed");
                patch(&mut file, patches);
                file
            }
            Self::Zstd { count, degree, inside } => {
                let some = gaussians(usize::from(count % 300) + 1, u32::from(degree % 4));
                splats::write(&*FILE, &some, &WriteOptions::default()).expect("written");
                let mut file = std::fs::read(&*FILE).expect("there");
                patch(&mut file, inside);
                file
            }
        }
    }
}

fuzz_target!(|spz: Spz| {
    check_gaussians(&FILE, &spz.file());
});
