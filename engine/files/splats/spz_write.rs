//! Writing SPZ, versions 4 and 2.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use flate2::write::GzEncoder;

use super::spz::{FLAG_ANTIALIASED, HEADER_BYTES, MAGIC};
use super::spz_pack::{MIRRORED, PLANES, Packing};
use super::{Outline, Produce};
use crate::atomic;
use ashsplat::{Error, Result};

const VERSION: u32 = 4;
const OLD_VERSION: u32 = 2;

/// zstd's level in the format's first implementation.
const LEVEL: i32 = 12;

/// Most fractional bits of a coordinate. The first implementation always writes 12, and reads any number below 24.
pub(super) const MAX_FRACTIONAL_BITS: u32 = 23;

/// Bits of a coordinate, including the sign.
const COORDINATE_BITS: u32 = 24;

/// Writes Gaussians as they arrive, version 4. In memory are a block and one encoder; the rest waits in files.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let Packed { packing, count, files } = Packed::of(path, VERSION, MIRRORED, outline, produce)?;
    let mut streams = Vec::new();
    for (mut file, row_bytes) in files.into_iter().zip(packing.row_bytes()) {
        // Planes without data have no stream.
        if outline.count * row_bytes as u64 == 0 {
            continue;
        }
        let mut encoder = zstd::stream::write::Encoder::new(room_for_one()?, LEVEL).map_err(temporary)?;
        io::copy(&mut file, &mut encoder).map_err(temporary)?;
        let mut packed = from_the_start(encoder.finish().map_err(temporary)?).map_err(temporary)?;
        let packed_bytes = packed.seek(SeekFrom::End(0)).map_err(temporary)?;
        packed.rewind().map_err(temporary)?;
        streams.push((packed, packed_bytes, outline.count * row_bytes as u64));
    }
    atomic::write(path, |writer| {
        writer.write_all(&head(packing, count, outline, streams.len() as u8))?;
        writer.write_all(&(HEADER_BYTES as u32).to_le_bytes())?;
        writer.write_all(&[0; 12])?;
        for (_, packed_bytes, unpacked_bytes) in &streams {
            writer.write_all(&packed_bytes.to_le_bytes())?;
            writer.write_all(&unpacked_bytes.to_le_bytes())?;
        }
        streams.iter_mut().try_for_each(|(packed, ..)| io::copy(packed, writer).map(drop))
    })
}

/// Same as [`write`], version 2: for programs that know no other.
pub(super) fn write_old(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let mut stream = old(path, MIRRORED, outline, produce)?;
    atomic::write(path, |writer| io::copy(&mut stream, writer).map(drop))
}

/// A file of version 2, from its beginning, in which some of this crate's axes are the other way round. `path` is for messages.
pub(super) fn old(
    path: &Path,
    mirrored: [bool; 3],
    outline: &Outline,
    produce: &mut Produce<'_>,
) -> Result<File> {
    let Packed { packing, count, files } = Packed::of(path, OLD_VERSION, mirrored, outline, produce)?;
    let mut encoder = GzEncoder::new(room_for_one()?, flate2::Compression::default());
    encoder.write_all(&head(packing, count, outline, 0)).map_err(temporary)?;
    for mut file in files {
        io::copy(&mut file, &mut encoder).map_err(temporary)?;
    }
    from_the_start(encoder.finish().map_err(temporary)?).map_err(temporary)
}

/// What all versions begin with. The last byte is the number of streams, 0 where there is but one.
fn head(packing: Packing, count: u32, outline: &Outline, streams: u8) -> [u8; 16] {
    let flags = if outline.antialiased { FLAG_ANTIALIASED } else { 0 };
    let mut head = [0; 16];
    head[..12].copy_from_slice([MAGIC, packing.version, count].map(u32::to_le_bytes).as_flattened());
    head[12..].copy_from_slice(&[packing.sh_degree as u8, packing.fractional_bits as u8, flags, streams]);
    head
}

/// The packed planes, each in a file: an encoder takes far more memory than what it writes, so that they wait for it.
struct Packed {
    packing: Packing,
    count: u32,
    files: Vec<File>,
}

impl Packed {
    fn of(
        path: &Path,
        version: u32,
        mirrored: [bool; 3],
        outline: &Outline,
        produce: &mut Produce<'_>,
    ) -> Result<Packed> {
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
        let fractional_bits = fractional_bits(outline).ok_or_else(|| {
            let problem = format!("a mean lies at {}, too far out for SPZ", farthest(outline));
            Error::input(
                path,
                problem,
                "crop (--crop-box) or shrink (--scale) the scene, or choose another format",
            )
        })?;
        let packing = Packing { version, sh_degree: outline.sh_degree, fractional_bits };
        let mut files = (0..PLANES).map(|_| room_for_one()).collect::<Result<Vec<BufWriter<File>>>>()?;
        let mut planes: [Vec<u8>; PLANES] = Default::default();
        produce(&mut |mut block| {
            block.mirror(mirrored);
            planes.iter_mut().for_each(Vec::clear);
            packing.pack(&block, &mut planes);
            files
                .iter_mut()
                .zip(&planes)
                .try_for_each(|(file, plane)| file.write_all(plane).map_err(temporary))
        })?;
        let files =
            files.into_iter().map(|file| from_the_start(file).map_err(temporary)).collect::<Result<_>>()?;
        Ok(Packed { packing, count, files })
    }
}

fn room_for_one() -> Result<BufWriter<File>> {
    tempfile::tempfile().map(BufWriter::new).map_err(temporary)
}

fn temporary(source: io::Error) -> Error {
    Error::io(std::env::temp_dir(), "write a temporary file", source)
}

/// What was written, to be read.
fn from_the_start(file: BufWriter<File>) -> io::Result<File> {
    let mut file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.rewind()?;
    Ok(file)
}

/// The largest coordinate, ignoring its sign.
pub(super) fn farthest(outline: &Outline) -> f32 {
    outline.bounds.map_or(0.0, |b| b.min.abs().max(b.max.abs()).max_element())
}

/// Fractional bits that the farthest coordinate leaves; None if it is too large.
pub(super) fn fractional_bits(outline: &Outline) -> Option<u32> {
    let farthest = f64::from(farthest(outline));
    let fits =
        |bits: &u32| farthest * f64::from(1u32 << bits) < f64::from((1u32 << (COORDINATE_BITS - 1)) - 1);
    (0..=MAX_FRACTIONAL_BITS).rev().find(fits)
}
