//! Decoding JPEG and PNG files that may be damaged or lie about their size.

use std::io::{Cursor, Read, Seek};
use std::path::Path;

use image::metadata::Orientation;
use image::{ColorType, DynamicImage, GrayImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbImage};

use super::scale::RowScaler;
use super::{Photo, jpeg, png_rows};
use crate::host_memory::{self, HostMemory, Lease};
use crate::{regular_file, sniff};
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};

/// Deflate's largest compression ratio. A PNG with less data per decoded byte is cut short or has a wrong size in
/// its header.
const MAX_DEFLATE_RATIO: u64 = 1032;

/// Bytes that usually hold everything before the pixels, including a preview in the metadata.
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
    /// Header of a picture that is not rotated.
    pub(super) fn upright(stored: (u32, u32)) -> Self {
        Self { stored, orientation: Orientation::NoTransforms }
    }

    fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (mut decoder, stored) = decoder(path, bytes)?;
        Ok(Self { stored, orientation: orientation(&mut decoder) })
    }

    /// True if the displayed picture differs from the stored one.
    pub(crate) fn has_orientation(&self) -> bool {
        self.orientation != Orientation::NoTransforms
    }

    /// True if the rotation swaps the sides.
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

/// Reads a picture's header, and as little of the file as possible.
pub(crate) fn header(path: &Path) -> Result<Header> {
    let mut start = Vec::new();
    let (file, _) = regular_file::open(path)?;
    file.take(HEADER_BYTES).read_to_end(&mut start).map_err(|source| Error::io(path, "read", source))?;
    match Header::of(path, &start) {
        Err(_) if start.len() as u64 == HEADER_BYTES => Header::of(path, &regular_file::read(path, 1)?),
        result => result,
    }
}

/// Width and height of a JPEG or PNG from its header, as stored, pixels.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Input`] when it is not such a picture.
pub fn photo_size(path: impl AsRef<Path>) -> Result<(u32, u32)> {
    Ok(header(path.as_ref())?.stored)
}

/// Returns [`Orientation::NoTransforms`] if the metadata cannot be read.
fn orientation(decoder: &mut impl ImageDecoder) -> Orientation {
    decoder.orientation().unwrap_or(Orientation::NoTransforms)
}

/// How a picture is to be read.
#[derive(Clone, Copy)]
pub(crate) struct Request<'a> {
    /// Colour (r, g, b in [0, 1]) where the picture is transparent.
    pub(crate) background: [f32; 3],
    /// True if it is rotated by its metadata.
    pub(crate) turned: bool,
    /// Required size after the rotation, checked before decoding. `None` for any size.
    pub(crate) size: Option<(u32, u32)>,
    /// The size to which it is scaled; `None` keeps its own.
    pub(crate) scaled: Option<(u32, u32)>,
    /// Bytes that the caller needs in addition.
    pub(crate) besides: u64,
    pub(crate) memory: &'a HostMemory,
}

impl<'a> Request<'a> {
    /// Reads the picture unchanged.
    pub(crate) fn plain(background: [f32; 3], memory: &'a HostMemory) -> Self {
        Self { background, turned: false, size: None, scaled: None, besides: 0, memory }
    }

    /// Target size for a picture of this size, if it is scaled.
    fn scaled_of(&self, size: (u32, u32)) -> Option<(u32, u32)> {
        self.scaled.filter(|&scaled| scaled != size)
    }
}

/// A decoded picture.
pub(crate) struct Decoded {
    /// The picture, scaled.
    pub(crate) photo: Photo,
    /// The alpha channel of a picture that has one, one byte per pixel, not scaled.
    pub(crate) alpha: Option<Vec<u8>>,
    /// Gamma exponent of the values, if a PNG names one and is not marked as sRGB. It is not applied.
    pub(crate) gamma: Option<f32>,
    /// Reserves the picture's memory while the caller works on it.
    pub(crate) lease: Lease,
}

/// Blends a picture over the background and scales it, row by row.
pub(super) struct Rows {
    background: [f32; 3],
    width: u32,
    /// Width and height of the result.
    to: (u32, u32),
    scaler: Option<RowScaler>,
    rgb: Vec<u8>,
    alpha: Option<Vec<u8>>,
}

impl Rows {
    /// Bytes needed for a picture of this size.
    pub(super) fn bytes(request: &Request<'_>, size: (u32, u32), has_alpha: bool) -> u64 {
        let pixels = |(width, height): (u32, u32)| u64::from(width) * u64::from(height);
        let alpha = if has_alpha { pixels(size) } else { 0 };
        alpha
            + match request.scaled_of(size) {
                None => 3 * pixels(size),
                Some(to) => 3 * pixels(to) + RowScaler::bytes([size.0, size.1], [to.0, to.1]),
            }
    }

    /// Reserves memory for the result.
    pub(super) fn new(path: &Path, request: &Request<'_>, size: (u32, u32), has_alpha: bool) -> Result<Self> {
        let reserved = |each: u64, (width, height): (u32, u32)| {
            host_memory::reserved(path, each * u64::from(width) * u64::from(height))
        };
        let to = request.scaled.unwrap_or(size);
        let rgb = reserved(3, to)?;
        let (rgb, scaler) = match to == size {
            true => (rgb, None),
            false => (Vec::new(), Some(RowScaler::new([size.0, size.1], [to.0, to.1], rgb))),
        };
        let alpha = has_alpha.then(|| reserved(1, size)).transpose()?;
        Ok(Self { background: request.background, width: size.0, to, scaler, rgb, alpha })
    }

    /// Adds the next rows.
    pub(super) fn push(&mut self, rows: DynamicImage) {
        let (rgb, alpha) = composite(rows, self.background);
        match &mut self.scaler {
            Some(scaler) => rgb.chunks_exact(3 * self.width as usize).for_each(|row| scaler.push(row)),
            None => self.rgb.extend(rgb),
        }
        if let (Some(all), Some(alpha)) = (&mut self.alpha, alpha) {
            all.extend(alpha);
        }
    }

    /// Returns the picture and its alpha channel after the last row.
    pub(super) fn finish(self) -> (Photo, Option<Vec<u8>>) {
        let rgb = self.scaler.map_or(self.rgb, RowScaler::finish);
        (Photo { width: self.to.0, height: self.to.1, rgb }, self.alpha)
    }
}

/// Reads a picture as `request` says. PNGs are decoded by rows unless they are interlaced; JPEGs as a whole, since no
/// decoder gives their rows.
pub(super) fn read(path: &Path, request: &Request<'_>) -> Result<Decoded> {
    let io = |source| Error::io(path, "read", source);
    let (mut file, file_bytes) = regular_file::open(path)?;
    let mut start = Vec::new();
    file.by_ref().take(8).read_to_end(&mut start).map_err(io)?;
    let mut gamma = None;
    if is_png(&start) {
        file.rewind().map_err(io)?;
        gamma = png_rows::checked_gamma(path, &file, request.memory)?;
    }
    if is_png(&start) && !(request.turned && header(path)?.has_orientation()) {
        file.rewind().map_err(io)?;
        if let Some(decoded) = png_rows::read(path, file, (gamma, request))? {
            return Ok(decoded);
        }
    }
    let (bytes, _) = regular_file::read_within(path, 1, request.memory)?;
    let (mut decoder, stored) = decoder(path, &bytes)?;
    let header = Header { stored, orientation: orientation(&mut decoder) };
    let size = header.size(request.turned);
    check_size(path, request, &header)?;
    let (width, height) = stored;
    let damaged = |e: &dyn std::fmt::Display| damaged(path, e);
    let (pixels, decoded) = (u64::from(width) * u64::from(height), decoder.total_bytes());
    let color = decoder.color_type();
    let png = is_png(&bytes);
    let outline = if png { jpeg::Outline::default() } else { jpeg::Outline::of(&bytes) };
    if png && cannot_hold(file_bytes, decoded) || !png && !outline.can_hold_its_size() {
        return Err(damaged(&claims(stored, file_bytes)));
    }
    if !png && !outline.complete {
        return Err(damaged(&"the data end before the picture does"));
    }
    // The decoded picture, the decoder's own memory, and the converted result.
    let coefficients = if outline.progressive { 2 * decoded } else { 0 };
    let converted = match color {
        ColorType::Rgb8 => 0,
        color if color.has_alpha() => 8 * pixels,
        _ => 3 * pixels,
    };
    let turned_copy = if request.turned && header.has_orientation() { decoded } else { 0 };
    let result = request.scaled_of(size).map_or(0, |_| Rows::bytes(request, size, color.has_alpha()));
    let own = 2 * file_bytes + decoded + coefficients + converted.max(turned_copy) + result;
    let lease = request.memory.take(path, own.saturating_add(request.besides))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    limits.max_alloc = Some(request.memory.limit());
    decoder.set_limits(limits).map_err(|e| damaged(&e))?;
    let mut image = if png {
        DynamicImage::from_decoder(decoder).map_err(|e| damaged(&e))?
    } else {
        drop(decoder);
        let grey = color == ColorType::L8;
        let mut data = host_memory::reserved(path, decoded)?;
        data.resize(decoded as usize, 0);
        jpeg::decode(&bytes, &outline, grey, &mut data).map_err(|e| damaged(&e))?;
        let image = match grey {
            true => GrayImage::from_raw(width, height, data).map(DynamicImage::from),
            false => RgbImage::from_raw(width, height, data).map(DynamicImage::from),
        };
        image.ok_or_else(|| damaged(&"its colours are of a kind that is not read"))?
    };
    drop(bytes);
    if request.turned {
        image.apply_orientation(header.orientation);
    }
    if request.scaled_of(size).is_none() {
        let (rgb, alpha) = composite(image, request.background);
        return Ok(Decoded { photo: Photo { width: size.0, height: size.1, rgb }, alpha, gamma, lease });
    }
    let mut rows = Rows::new(path, request, size, color.has_alpha())?;
    rows.push(image);
    let (photo, alpha) = rows.finish();
    Ok(Decoded { photo, alpha, gamma, lease })
}

/// Refuses a picture that has another size than requested.
pub(super) fn check_size(path: &Path, request: &Request<'_>, header: &Header) -> Result<()> {
    let (width, height) = header.size(request.turned);
    let Some((w, h)) = request.size.filter(|&size| size != (width, height)) else { return Ok(()) };
    let how =
        if request.turned && header.has_orientation() { " when turned as its metadata say" } else { "" };
    let problem = format!("is {width}x{height} pixels{how}, its camera {w}x{h}");
    Err(Error::input(path, problem, "use the pictures that the cameras were computed from"))
}

/// True if a PNG is too small for its pixels.
pub(super) fn cannot_hold(file_bytes: u64, decoded: u64) -> bool {
    decoded / MAX_DEFLATE_RATIO > file_bytes
}

/// The error text for a picture that is too small for its pixels.
pub(super) fn claims((width, height): (u32, u32), file_bytes: u64) -> String {
    format!("claims {width}x{height} pixels in {file_bytes} bytes")
}

/// The error for a picture that cannot be decoded.
pub(super) fn damaged(path: &Path, problem: &dyn std::fmt::Display) -> Error {
    Error::input(path, format!("cannot be decoded: {problem}"), "copy or export the picture again")
}

/// Chooses a decoder by the content, not by the file's name. Returns it with the picture's size.
pub(super) fn decoder<'a>(path: &Path, bytes: &'a [u8]) -> Result<(impl ImageDecoder + 'a, (u32, u32))> {
    let mut reader = ImageReader::new(Cursor::new(bytes));
    let format =
        image::guess_format(bytes).ok().filter(|f| matches!(f, ImageFormat::Png | ImageFormat::Jpeg));
    let Some(format) = format else {
        let (problem, remedy) = sniff::recognise(bytes.get(..512).unwrap_or(bytes))
            .unwrap_or(("is not a JPEG or PNG", "convert it"));
        return Err(Error::input(path, problem, remedy));
    };
    reader.set_format(format);
    let decoder = reader.into_decoder().map_err(|e| damaged(path, &e))?;
    let size = decoder.dimensions();
    Ok((decoder, size))
}

fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG")
}

/// The picture's colours, blended over the background, and its alpha channel.
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
