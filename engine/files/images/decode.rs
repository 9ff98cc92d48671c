//! Decoding JPEG and PNG files that may be damaged or lie about their size.

use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::Photo;
use crate::sniff;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};

/// Most memory that decoding one picture may take.
const MAX_DECODE_BYTES: u64 = 2 << 30;

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
) -> Result<(Photo, Option<Vec<u8>>)> {
    let bytes = read_bytes(path)?;
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
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    decoder.set_limits(limits).map_err(|e| damaged(&e))?;
    if decoder.total_bytes() > MAX_DECODE_BYTES {
        return Err(damaged(&format!("{width}x{height} pixels need more than 2 GiB")));
    }
    if is_png(&bytes) && decoder.total_bytes() / MAX_DEFLATE_RATIO > bytes.len() as u64 {
        return Err(damaged(&format!("claims {width}x{height} pixels in {} bytes", bytes.len())));
    }
    if !is_png(&bytes) && !jpeg_is_complete(&bytes) {
        return Err(damaged(&"the data end before the picture does"));
    }
    let mut image = DynamicImage::from_decoder(decoder).map_err(|e| damaged(&e))?;
    if turned {
        image.apply_orientation(header.orientation);
    }
    let (width, height) = (image.width(), image.height());
    let (rgb, alpha) = composite(image, background);
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

/// Whether a JPEG reaches its end-of-image marker. Decoders fill a truncated one with grey without an error.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xda;
    const END_OF_IMAGE: u8 = 0xd9;
    let mut at = 2;
    while let Some(&[0xff, marker]) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        match marker {
            END_OF_IMAGE => return true,
            // Fill bytes, and markers without a length.
            0xff => at += 1,
            0x01 | 0xd0..=0xd8 => at += 2,
            _ => {
                let Some(&length) = bytes.get(at + 2..).and_then(|rest| rest.first_chunk()) else {
                    return false;
                };
                at += 2 + usize::from(u16::from_be_bytes(length)).max(2);
                if marker == START_OF_SCAN {
                    at = end_of_scan(bytes, at);
                }
            }
        }
    }
    false
}

/// End of the entropy-coded data from `at`: the next marker that is neither stuffing nor a restart.
fn end_of_scan(bytes: &[u8], mut at: usize) -> usize {
    while let Some(&[first, second]) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        if first == 0xff && !matches!(second, 0x00 | 0xd0..=0xd7 | 0xff) {
            return at;
        }
        at += 1;
    }
    bytes.len()
}

fn one_line(e: &dyn std::fmt::Display) -> String {
    e.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
