//! Writes SPZ, versions 4 and 2.

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

/// zstd level of the format's first implementation.
const LEVEL: i32 = 12;

/// Largest number of fractional bits. The first implementation always writes 12, and reads any number below 24.
pub(super) const MAX_FRACTIONAL_BITS: u32 = 23;

/// Bits of a coordinate, including the sign.
const COORDINATE_BITS: u32 = 24;

/// Writes Gaussians block by block, version 4. Memory holds a block and one encoder; temporary files hold the rest.
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

/// Same as [`write`], but version 2, for programs that know no other.
pub(super) fn write_old(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let mut stream = old(path, MIRRORED, outline, produce)?;
    atomic::write(path, |writer| io::copy(&mut stream, writer).map(drop))
}

/// Makes a file of version 2 in which some axes are mirrored, ready to be read from its start. `path` is for messages.
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

/// The header that all versions begin with. The last byte is the number of streams, 0 if there is only one.
fn head(packing: Packing, count: u32, outline: &Outline, streams: u8) -> [u8; 16] {
    let flags = if outline.antialiased { FLAG_ANTIALIASED } else { 0 };
    let mut head = [0; 16];
    head[..12].copy_from_slice([MAGIC, packing.version, count].map(u32::to_le_bytes).as_flattened());
    head[12..].copy_from_slice(&[packing.sh_degree as u8, packing.fractional_bits as u8, flags, streams]);
    head
}

/// The packed planes, each in a file. They are encoded one by one, because an encoder needs far more memory than its
/// output.
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

/// Rewinds a written file for reading.
fn from_the_start(file: BufWriter<File>) -> io::Result<File> {
    let mut file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.rewind()?;
    Ok(file)
}

/// The largest coordinate, ignoring its sign.
pub(super) fn farthest(outline: &Outline) -> f32 {
    outline.bounds.map_or(0.0, |b| b.min.abs().max(b.max.abs()).max_element())
}

/// Largest number of fractional bits for the farthest coordinate; `None` if it is too large.
pub(super) fn fractional_bits(outline: &Outline) -> Option<u32> {
    let farthest = f64::from(farthest(outline));
    let fits =
        |bits: &u32| farthest * f64::from(1u32 << bits) < f64::from((1u32 << (COORDINATE_BITS - 1)) - 1);
    (0..=MAX_FRACTIONAL_BITS).rev().find(fits)
}
