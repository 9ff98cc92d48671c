//! Decoding JPEG and PNG files that may be damaged or lie about their size.

use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::path::Path;

use image::metadata::Orientation;
use image::{ColorType, DynamicImage, GrayImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbImage};

use super::{Photo, jpeg};
use crate::host_memory::HostMemory;
use crate::sniff;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};

/// Deflate cannot compress further. A PNG with less data per decoded byte is cut short or has a wrong size in
/// its header.
const MAX_DEFLATE_RATIO: u64 = 1032;

/// Bytes that usually suffice for the part before the pixels, including a preview in the metadata.
const HEADER_BYTES: u64 = 256 << 10;

/// Properties of a picture from its header.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Header {
    /// Width and height as stored, pixels.
    stored: (u32, u32),
    /// The transformation from the stored to the displayed picture.
    orientation: Orientation,
}

impl Header {
    fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (mut decoder, stored) = decoder(path, bytes)?;
        Ok(Self { stored, orientation: orientation(&mut decoder) })
    }

    /// Whether the displayed picture differs from the stored one.
    pub(crate) fn has_orientation(&self) -> bool {
        self.orientation != Orientation::NoTransforms
    }

    /// Whether the rotation swaps its sides.
    pub(crate) fn lies_on_its_side(&self) -> bool {
        use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
        matches!(self.orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
    }

    /// Width and height, as stored or as rotated by the metadata, pixels.
    pub(crate) fn size(&self, turned: bool) -> (u32, u32) {
        let (width, height) = self.stored;
        if turned && self.lies_on_its_side() { (height, width) } else { (width, height) }
    }
}

/// Reads as little of the file as possible.
pub(crate) fn header(path: &Path) -> Result<Header> {
    let mut start = Vec::new();
    File::open(path)
        .and_then(|file| file.take(HEADER_BYTES).read_to_end(&mut start))
        .map_err(|source| Error::io(path, "read", source))?;
    match Header::of(path, &start) {
        Err(_) if start.len() as u64 == HEADER_BYTES => Header::of(path, &read_bytes(path)?),
        result => result,
    }
}

/// Width and height of a JPEG or PNG from its header, as stored, pixels.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Input`] when it is no such picture.
pub fn photo_size(path: impl AsRef<Path>) -> Result<(u32, u32)> {
    Ok(header(path.as_ref())?.stored)
}

/// None if the metadata cannot be read.
fn orientation(decoder: &mut impl ImageDecoder) -> Orientation {
    decoder.orientation().unwrap_or(Orientation::NoTransforms)
}

/// The picture, optionally rotated by its metadata, and its alpha channel if it has one.
pub(super) fn read(
    path: &Path,
    background: [f32; 3],
    turned: bool,
    expected: Option<(u32, u32)>,
    memory: &HostMemory,
) -> Result<(Photo, Option<Vec<u8>>)> {
    let io = |source| Error::io(path, "read", source);
    let file_bytes = fs::metadata(path).map_err(io)?.len();
    let lease = memory.take(path, file_bytes)?;
    let bytes = read_bytes(path)?;
    drop(lease);
    let (mut decoder, stored) = decoder(path, &bytes)?;
    let header = Header { stored, orientation: orientation(&mut decoder) };
    let (width, height) = header.size(turned);
    if let Some((w, h)) = expected.filter(|&size| size != (width, height)) {
        let how = if turned && header.has_orientation() { " when turned as its metadata say" } else { "" };
        let problem = format!("is {width}x{height} pixels{how}, its camera {w}x{h}");
        return Err(Error::input(path, problem, "use the pictures that the cameras were computed from"));
    }
    let (width, height) = stored;
    let damaged = |e: &dyn std::fmt::Display| {
        Error::input(path, format!("cannot be decoded: {}", one_line(e)), "copy or export the picture again")
    };
    let (pixels, decoded) = (u64::from(width) * u64::from(height), decoder.total_bytes());
    let color = decoder.color_type();
    let png = is_png(&bytes);
    let outline = if png { jpeg::Outline::default() } else { jpeg::Outline::of(&bytes) };
    if png && decoded / MAX_DEFLATE_RATIO > file_bytes || !png && !outline.can_hold_its_size() {
        return Err(damaged(&format!("claims {width}x{height} pixels in {file_bytes} bytes")));
    }
    if !png && !outline.complete {
        return Err(damaged(&"the data end before the picture does"));
    }
    // What is decoded, what a decoder holds beside it, and what becomes of it here.
    let coefficients = if outline.progressive { 2 * decoded } else { 0 };
    let converted = match color {
        ColorType::Rgb8 => 0,
        color if color.has_alpha() => 8 * pixels,
        _ => 3 * pixels,
    };
    let turned_copy = if turned && header.has_orientation() { decoded } else { 0 };
    let lease = memory.take(path, 2 * file_bytes + decoded + coefficients + converted.max(turned_copy))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    limits.max_alloc = Some(memory.limit());
    decoder.set_limits(limits).map_err(|e| damaged(&e))?;
    let mut image = if png {
        DynamicImage::from_decoder(decoder).map_err(|e| damaged(&e))?
    } else {
        drop(decoder);
        let grey = color == ColorType::L8;
        let mut data = vec![0; decoded as usize];
        jpeg::decode(&bytes, grey, &mut data).map_err(|e| damaged(&e))?;
        let image = match grey {
            true => GrayImage::from_raw(width, height, data).map(DynamicImage::from),
            false => RgbImage::from_raw(width, height, data).map(DynamicImage::from),
        };
        image.ok_or_else(|| damaged(&"its colours are of a kind that is not read"))?
    };
    if turned {
        image.apply_orientation(header.orientation);
    }
    let (width, height) = (image.width(), image.height());
    let (rgb, alpha) = composite(image, background);
    drop(lease);
    Ok((Photo { width, height, rgb }, alpha))
}

fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|source| Error::io(path, "read", source))
}

/// A decoder chosen by the content instead of the file's name, and the picture's size.
fn decoder<'a>(path: &Path, bytes: &'a [u8]) -> Result<(impl ImageDecoder + 'a, (u32, u32))> {
    let mut reader = ImageReader::new(Cursor::new(bytes));
    let format =
        image::guess_format(bytes).ok().filter(|f| matches!(f, ImageFormat::Png | ImageFormat::Jpeg));
    let Some(format) = format else {
        let (problem, remedy) = sniff::recognise(bytes.get(..512).unwrap_or(bytes))
            .unwrap_or(("is not a JPEG or PNG", "convert it"));
        return Err(Error::input(path, problem, remedy));
    };
    reader.set_format(format);
    let decoder = reader.into_decoder().map_err(|e| {
        Error::input(path, format!("cannot be decoded: {}", one_line(&e)), "copy or export the picture again")
    })?;
    let size = decoder.dimensions();
    Ok((decoder, size))
}

fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG")
}

/// The picture's opaque colours, blended over the background where it is transparent, and its alpha channel.
fn composite(image: DynamicImage, background: [f32; 3]) -> (Vec<u8>, Option<Vec<u8>>) {
    if !image.color().has_alpha() {
        return (image.into_rgb8().into_raw(), None);
    }
    let background = background.map(|c| 255.0 * c.clamp(0.0, 1.0));
    let pixels = image.width() as usize * image.height() as usize;
    let (mut rgb, mut alphas) = (Vec::with_capacity(3 * pixels), Vec::with_capacity(pixels));
    for &[r, g, b, alpha] in image.into_rgba8().into_raw().as_chunks::<4>().0 {
        alphas.push(alpha);
        let opacity = f32::from(alpha) / 255.0;
        for (color, behind) in [r, g, b].into_iter().zip(background) {
            rgb.push((f32::from(color) * opacity + behind * (1.0 - opacity)).round() as u8);
        }
    }
    (rgb, Some(alphas))
}

fn one_line(e: &dyn std::fmt::Display) -> String {
    e.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
