//! Decodes PNGs by rows: a single decoded row is in memory.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use image::{DynamicImage, ImageBuffer, Luma, LumaA, Pixel, Rgb, Rgba};
use png::{BitDepth, ColorType, Limits, Transformations};

use super::decode::{Decoded, Header, Request, Rows, cannot_hold, check_size, claims, damaged};
use crate::{HostMemory, cost};
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};

/// Bytes of the file that are read at a time.
const BUFFER_BYTES: usize = 64 << 10;

/// Bytes that the decoder needs beside its rows, for reading ahead and unpacking.
const DECODER_BYTES: u64 = 1 << 20;

/// Rows that the decoder holds.
const DECODER_ROWS: u64 = 8;

/// The gamma exponent of a PNG, if it names one and is not marked as sRGB. Refuses a palette that is cut within an
/// entry or has too many entries: the decoder does not check it.
pub(super) fn checked_gamma(path: &Path, file: &File, memory: &HostMemory) -> Result<Option<f32>> {
    let reader = reader(file, memory).read_info().map_err(|e| damaged(path, &e))?;
    let bytes = reader.info().palette.as_ref().map_or(0, |palette| palette.len());
    match bytes.is_multiple_of(3) && bytes <= 3 * 256 {
        true => {
            let gamma = reader.info().gama_chunk.filter(|_| reader.info().srgb.is_none());
            Ok(gamma.map(png::ScaledFloat::into_value).filter(|gamma| *gamma > 0.0))
        }
        false => {
            Err(damaged(path, &format!("its palette has {bytes} bytes; up to 256 entries of 3 are possible")))
        }
    }
}

fn reader<R: Read + Seek>(file: R, memory: &HostMemory) -> png::Decoder<BufReader<cost::Counted<R>>> {
    let limits = Limits { bytes: usize::try_from(memory.limit()).unwrap_or(usize::MAX) };
    let reader = BufReader::with_capacity(BUFFER_BYTES, cost::Counted(file));
    let mut decoder = png::Decoder::new_with_limits(reader, limits);
    // Keeps the depth, so that 16 bits are rounded here, not cut.
    decoder.set_transformations(Transformations::EXPAND);
    // Unused chunks, which could unpack to a lot before their memory is counted.
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_ignore_text_chunk(true);
    decoder
}

/// Reads a picture as `request` says. `None` for an interlaced one.
pub(super) fn read(
    path: &Path,
    file: File,
    (gamma, request): (Option<f32>, &Request<'_>),
) -> Result<Option<Decoded>> {
    let damaged = |e: &dyn std::fmt::Display| damaged(path, e);
    let file_bytes = file.metadata().map_err(|source| Error::io(path, "read", source))?.len();
    let mut reader = reader(file, request.memory).read_info().map_err(|e| damaged(&e))?;
    let size = reader.info().size();
    if reader.info().interlaced {
        return Ok(None);
    }
    check_size(path, request, &Header::upright(size))?;
    if size.0.max(size.1) > MAX_IMAGE_SIDE {
        return Err(damaged(&format!("{}x{} pixels; {MAX_IMAGE_SIDE} a side are possible", size.0, size.1)));
    }
    let (Some(decoded), Some(row_bytes)) = (reader.output_buffer_size(), reader.output_line_size(size.0))
    else {
        return Err(damaged(&claims(size, file_bytes)));
    };
    if cannot_hold(file_bytes, decoded as u64) {
        return Err(damaged(&claims(size, file_bytes)));
    }
    let (color, depth) = reader.output_color_type();
    let has_alpha = matches!(color, ColorType::GrayscaleAlpha | ColorType::Rgba);
    let own = Rows::bytes(request, size, has_alpha) + DECODER_BYTES + DECODER_ROWS * row_bytes as u64;
    let lease = request.memory.take(path, own.saturating_add(request.besides))?;
    let mut rows = Rows::new(path, request, size, has_alpha)?;
    while let Some(row) = reader.next_row().map_err(|e| damaged(&e))? {
        cost::steps(row.data().len());
        let row = as_image(row.data(), color, depth, size.0);
        rows.push(row.ok_or_else(|| damaged(&"its colours are of a kind that is not read"))?);
    }
    let (photo, alpha) = rows.finish();
    Ok(Some(Decoded { photo, alpha, gamma, lease }))
}

/// Wraps a row as a picture.
fn as_image(row: &[u8], color: ColorType, depth: BitDepth, width: u32) -> Option<DynamicImage> {
    fn bytes<P: Pixel<Subpixel = u8>>(row: &[u8], width: u32) -> Option<ImageBuffer<P, Vec<u8>>> {
        ImageBuffer::from_raw(width, 1, Vec::from(row))
    }
    fn words<P: Pixel<Subpixel = u16>>(row: &[u8], width: u32) -> Option<ImageBuffer<P, Vec<u16>>> {
        let words = row.as_chunks::<2>().0.iter().map(|&word| u16::from_be_bytes(word));
        ImageBuffer::from_raw(width, 1, words.collect())
    }
    match (color, depth) {
        (ColorType::Grayscale, BitDepth::Eight) => bytes::<Luma<u8>>(row, width).map(Into::into),
        (ColorType::GrayscaleAlpha, BitDepth::Eight) => bytes::<LumaA<u8>>(row, width).map(Into::into),
        (ColorType::Rgb, BitDepth::Eight) => bytes::<Rgb<u8>>(row, width).map(Into::into),
        (ColorType::Rgba, BitDepth::Eight) => bytes::<Rgba<u8>>(row, width).map(Into::into),
        (ColorType::Grayscale, BitDepth::Sixteen) => words::<Luma<u16>>(row, width).map(Into::into),
        (ColorType::GrayscaleAlpha, BitDepth::Sixteen) => words::<LumaA<u16>>(row, width).map(Into::into),
        (ColorType::Rgb, BitDepth::Sixteen) => words::<Rgb<u16>>(row, width).map(Into::into),
        (ColorType::Rgba, BitDepth::Sixteen) => words::<Rgba<u16>>(row, width).map(Into::into),
        _ => None,
    }
}
