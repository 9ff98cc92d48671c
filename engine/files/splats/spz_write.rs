//! Writing SPZ, version 4.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use super::spz::{FLAG_ANTIALIASED, HEADER_BYTES, MAGIC};
use super::spz_pack::{MIRRORED, PLANES, Packing};
use super::{Outline, Produce};
use crate::atomic;
use ashsplat::{Error, Result};

const VERSION: u32 = 4;

/// zstd's level in the format's first implementation.
const LEVEL: i32 = 12;

/// Fractional bits of a coordinate, if the scene is not too large for them (first implementation).
const FRACTIONAL_BITS: u32 = 12;

/// Bits of a coordinate, including the sign.
const COORDINATE_BITS: u32 = 24;

/// Writes Gaussians as they arrive. In memory are a block and one encoder; the rest waits in files.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let Ok(count) = u32::try_from(outline.count) else {
        let (needed, limit) = (outline.count, u64::from(u32::MAX));
        return Err(Error::TooLarge {
            what: "an SPZ".into(),
            needed,
            unit: "Gaussians",
            limit,
            limit_name: "its format",
        });
    };
    let packing = Packing {
        version: VERSION,
        sh_degree: outline.sh_degree,
        fractional_bits: fractional_bits(path, outline)?,
    };
    // An encoder takes far more memory than what it writes: one at a time. Until its turn comes, a plane lies in a file.
    let room = std::env::temp_dir();
    let temporary = |source| Error::io(&room, "write a temporary file", source);
    let room_for_one = || tempfile::tempfile().map(BufWriter::new).map_err(temporary);
    let mut files = (0..PLANES).map(|_| room_for_one()).collect::<Result<Vec<BufWriter<File>>>>()?;
    let mut planes: [Vec<u8>; PLANES] = Default::default();
    produce(&mut |mut block| {
        block.mirror(MIRRORED);
        planes.iter_mut().for_each(Vec::clear);
        packing.pack(&block, &mut planes);
        files.iter_mut().zip(&planes).try_for_each(|(file, plane)| file.write_all(plane).map_err(temporary))
    })?;
    drop(planes);
    let mut streams = Vec::new();
    for (file, row_bytes) in files.into_iter().zip(packing.row_bytes()) {
        // Planes without data have no stream.
        if outline.count * row_bytes as u64 == 0 {
            continue;
        }
        let mut file = from_the_start(file).map_err(temporary)?;
        let mut encoder = zstd::stream::write::Encoder::new(room_for_one()?, LEVEL).map_err(temporary)?;
        io::copy(&mut file, &mut encoder).map_err(temporary)?;
        let mut packed = from_the_start(encoder.finish().map_err(temporary)?).map_err(temporary)?;
        let packed_bytes = packed.seek(SeekFrom::End(0)).map_err(temporary)?;
        packed.rewind().map_err(temporary)?;
        streams.push((packed, packed_bytes, outline.count * row_bytes as u64));
    }
    atomic::write(path, |writer| {
        writer.write_all(&MAGIC.to_le_bytes())?;
        writer.write_all(&VERSION.to_le_bytes())?;
        writer.write_all(&count.to_le_bytes())?;
        let flags = if outline.antialiased { FLAG_ANTIALIASED } else { 0 };
        writer.write_all(&[
            packing.sh_degree as u8,
            packing.fractional_bits as u8,
            flags,
            streams.len() as u8,
        ])?;
        writer.write_all(&(HEADER_BYTES as u32).to_le_bytes())?;
        writer.write_all(&[0; 12])?;
        for (_, packed_bytes, unpacked_bytes) in &streams {
            writer.write_all(&packed_bytes.to_le_bytes())?;
            writer.write_all(&unpacked_bytes.to_le_bytes())?;
        }
        streams.iter_mut().try_for_each(|(packed, ..)| io::copy(packed, writer).map(drop))
    })
}

/// What was written, to be read.
fn from_the_start(file: BufWriter<File>) -> io::Result<File> {
    let mut file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.rewind()?;
    Ok(file)
}

/// The bits that the farthest coordinate leaves, at most 12.
fn fractional_bits(path: &Path, outline: &Outline) -> Result<u32> {
    let farthest = outline.bounds.map_or(0.0, |b| b.min.abs().max(b.max.abs()).max_element());
    let fits = |bits: &u32| {
        f64::from(farthest) * f64::from(1u32 << bits) < f64::from((1u32 << (COORDINATE_BITS - 1)) - 1)
    };
    (0..=FRACTIONAL_BITS).rev().find(fits).ok_or_else(|| {
        let problem = format!("a mean lies at {farthest}, too far out for SPZ");
        Error::input(
            path,
            problem,
            "crop (--crop-box) or shrink (--scale) the scene, or choose another format",
        )
    })
}
