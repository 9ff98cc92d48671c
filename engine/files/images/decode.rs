//! Decoding JPEG and PNG files that may be damaged or lie about their size.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::ops::Range;
use std::path::Path;

use image::metadata::Orientation;
use image::{ColorType, DynamicImage, GrayImage, ImageDecoder, ImageFormat, ImageReader, Limits, RgbImage};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use super::{Photo, RowScaler};
use crate::cost;
use crate::host_memory::{self, HostMemory, Lease};
use crate::regular_file::{self, OnFile};
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};

/// Deflate's largest compression ratio. A PNG with less data is cut short or has a wrong size in its header.
const MAX_DEFLATE_RATIO: u64 = 1032;
pub(crate) const UNREAD_KIND: &str = "its colours are of a kind that is not read";
/// Bytes that usually hold everything before the pixels, including a preview in the metadata.
const HEADER_BYTES: u64 = 256 << 10;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PhotoHeader {
    /// Width and height as stored, pixels.
    stored: (u32, u32),
    /// The transformation from the stored to the displayed picture.
    orientation: Orientation,
}

impl PhotoHeader {
    /// Not rotated if the metadata cannot be read.
    fn of(decoder: &mut impl ImageDecoder) -> Self {
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        Self { stored: decoder.dimensions(), orientation }
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
pub(crate) fn photo_header(path: &Path) -> Result<PhotoHeader> {
    let start = regular_file::start(path, HEADER_BYTES)?;
    let of = |bytes: &[u8]| Ok(PhotoHeader::of(&mut decoder(path, bytes)?));
    match of(&start) {
        Err(_) if start.len() as u64 == HEADER_BYTES => of(&regular_file::read(path, 1)?),
        result => result,
    }
}

/// Width and height of a JPEG or PNG from its header, as stored, pixels.
pub fn photo_size(path: impl AsRef<Path>) -> Result<(u32, u32)> {
    Ok(photo_header(path.as_ref())?.stored)
}

#[derive(Clone, Copy)]
pub(crate) struct Request<'a> {
    /// Colour (r, g, b in [0, 1]) where the picture is transparent. `None` keeps the colours as stored.
    pub(crate) background: Option<[f32; 3]>,
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
    pub(crate) fn plain(background: Option<[f32; 3]>, memory: &'a HostMemory) -> Self {
        Self { background, turned: false, size: None, scaled: None, besides: 0, memory }
    }

    /// Target size for a picture of this size, if it is scaled.
    fn scaled_of(&self, size: (u32, u32)) -> Option<(u32, u32)> {
        self.scaled.filter(|&scaled| scaled != size)
    }
}

pub(crate) struct Decoded {
    pub(crate) photo: Photo,
    /// The alpha channel of a picture that has one, one byte per pixel, not scaled.
    pub(crate) alpha: Option<Vec<u8>>,
    /// Gamma exponent of the values, if a PNG names one and is not marked as sRGB. It is not applied.
    pub(crate) gamma: Option<f32>,
    /// Reserves the picture's memory while the caller works on it.
    pub(crate) lease: Lease,
}

/// Blends a picture over the background and scales it, row by row.
struct Rows {
    background: Option<[f32; 3]>,
    width: u32,
    to: (u32, u32),
    scaler: Option<RowScaler>,
    rgb: Vec<u8>,
    alpha: Option<Vec<u8>>,
}

impl Rows {
    fn bytes(request: &Request<'_>, size: (u32, u32), has_alpha: bool) -> u64 {
        let pixels = |(width, height): (u32, u32)| u64::from(width) * u64::from(height);
        let alpha = if has_alpha { pixels(size) } else { 0 };
        alpha
            + match request.scaled_of(size) {
                None => 3 * pixels(size),
                Some(to) => 3 * pixels(to) + RowScaler::bytes([size.0, size.1], [to.0, to.1]),
            }
    }

    fn new(path: &Path, request: &Request<'_>, size: (u32, u32), has_alpha: bool) -> Result<Self> {
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

    fn push(&mut self, rows: Vec<u8>, channels: usize) {
        let (rgb, alpha) = composite(rows, channels, self.background);
        match &mut self.scaler {
            Some(scaler) => rgb.chunks_exact(3 * self.width as usize).for_each(|row| scaler.push(row)),
            None => self.rgb.extend(rgb),
        }
        if let (Some(all), Some(alpha)) = (&mut self.alpha, alpha) {
            all.extend(alpha);
        }
    }

    fn finish(self, gamma: Option<f32>, lease: Lease) -> Decoded {
        let (width, height) = self.to;
        let rgb = self.scaler.map_or(self.rgb, RowScaler::finish);
        Decoded { photo: Photo { width, height, rgb }, alpha: self.alpha, gamma, lease }
    }
}

/// Reads a picture as `request` says: by rows where a decoder gives them, which is for PNGs that are not interlaced.
pub(crate) fn read(path: &Path, request: &Request<'_>) -> Result<Decoded> {
    let (mut file, file_bytes) = regular_file::open(path)?;
    let mut start = Vec::new();
    file.by_ref().take(8).read_to_end(&mut start).reading(path)?;
    let mut gamma = None;
    if is_png(&start) {
        file.rewind().reading(path)?;
        match read_png_rows(path, file, request)? {
            Ok(decoded) => return Ok(decoded),
            Err(named) => gamma = named,
        }
    }
    let (bytes, _) = regular_file::read_within(path, 1, request.memory)?;
    let mut decoder = decoder(path, &bytes)?;
    let header = PhotoHeader::of(&mut decoder);
    let size = header.size(request.turned);
    check_size(path, request, &header)?;
    let (width, height) = header.stored;
    let damaged = |e: &dyn std::fmt::Display| damaged(path, e);
    let (pixels, decoded) = (u64::from(width) * u64::from(height), decoder.total_bytes());
    let color = decoder.color_type();
    let png = is_png(&bytes);
    let outline = if png { JpegOutline::default() } else { JpegOutline::of(&bytes) };
    if png && cannot_hold(file_bytes, decoded) || !png && !outline.can_hold_its_size() {
        return Err(damaged(&claims(header.stored, file_bytes)));
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
    decoder.set_limits(limits(request.memory)).map_err(|e| damaged(&e))?;
    let mut image = if png {
        DynamicImage::from_decoder(decoder).map_err(|e| damaged(&e))?
    } else {
        drop(decoder);
        let grey = color == ColorType::L8;
        let mut data = host_memory::reserved(path, decoded)?;
        data.resize(decoded as usize, 0);
        decode_jpeg(&bytes, &outline, grey, &mut data).map_err(|e| damaged(&e))?;
        let image = match grey {
            true => GrayImage::from_raw(width, height, data).map(DynamicImage::from),
            false => RgbImage::from_raw(width, height, data).map(DynamicImage::from),
        };
        image.ok_or_else(|| damaged(&UNREAD_KIND))?
    };
    drop(bytes);
    if request.turned {
        image.apply_orientation(header.orientation);
    }
    let (values, channels) = match color.has_alpha() {
        true => (image.into_rgba8().into_raw(), 4),
        false => (image.into_rgb8().into_raw(), 3),
    };
    if request.scaled_of(size).is_none() {
        let (rgb, alpha) = composite(values, channels, request.background);
        return Ok(Decoded { photo: Photo { width: size.0, height: size.1, rgb }, alpha, gamma, lease });
    }
    let mut rows = Rows::new(path, request, size, color.has_alpha())?;
    rows.push(values, channels);
    Ok(rows.finish(gamma, lease))
}

pub(crate) fn limits(memory: &HostMemory) -> Limits {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    limits.max_alloc = Some(memory.limit());
    limits
}

/// Refuses a picture that has another size than requested.
fn check_size(path: &Path, request: &Request<'_>, header: &PhotoHeader) -> Result<()> {
    let (width, height) = header.size(request.turned);
    let Some((w, h)) = request.size.filter(|&size| size != (width, height)) else { return Ok(()) };
    let how =
        if request.turned && header.has_orientation() { " when turned as its metadata say" } else { "" };
    let problem = format!("is {width}x{height} pixels{how}, its camera {w}x{h}");
    Err(Error::input(path, problem, "use the pictures that the cameras were computed from"))
}

pub(crate) fn cannot_hold(file_bytes: u64, decoded: u64) -> bool {
    decoded / MAX_DEFLATE_RATIO > file_bytes
}

pub(crate) fn claims((width, height): (u32, u32), file_bytes: u64) -> String {
    format!("claims {width}x{height} pixels in {file_bytes} bytes")
}

pub(crate) fn damaged(path: &Path, problem: &dyn std::fmt::Display) -> Error {
    Error::input(path, format!("cannot be decoded: {problem}"), "copy or export the picture again")
}

/// Chooses a decoder by the content, not by the file's name.
pub(crate) fn decoder<'a>(path: &Path, bytes: &'a [u8]) -> Result<impl ImageDecoder + 'a> {
    let Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) = image::guess_format(bytes) else {
        let known = regular_file::recognise(bytes.get(..512).unwrap_or(bytes));
        let (problem, remedy) = known.unwrap_or(("is not a JPEG or PNG", "convert it"));
        return Err(Error::input(path, problem, remedy));
    };
    ImageReader::with_format(Cursor::new(bytes), format).into_decoder().map_err(|e| damaged(path, &e))
}

fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG")
}

/// Colours of 1 to 4 channels (grey, grey and alpha, r g b, r g b and alpha), blended over the background, and their alpha
/// channel.
fn composite(values: Vec<u8>, channels: usize, background: Option<[f32; 3]>) -> (Vec<u8>, Option<Vec<u8>>) {
    match channels {
        1 => return (values.iter().flat_map(|&grey| [grey; 3]).collect(), None),
        3 => return (values, None),
        _ => {}
    }
    let background = background.map(|color| color.map(|c| 255.0 * c.clamp(0.0, 1.0)));
    let pixels = values.len() / channels;
    let (mut rgb, mut alphas) = (Vec::with_capacity(3 * pixels), Vec::with_capacity(pixels));
    for pixel in values.chunks_exact(channels) {
        let alpha = pixel[channels - 1];
        alphas.push(alpha);
        let opacity = f32::from(alpha) / 255.0;
        for channel in 0..3 {
            let color = pixel[if channels == 2 { 0 } else { channel }];
            let over = |behind: [f32; 3]| f32::from(color) * opacity + behind[channel] * (1.0 - opacity);
            rgb.push(background.map_or(color, |behind| over(behind).round() as u8));
        }
    }
    (rgb, Some(alphas))
}

const BUFFER_BYTES: usize = 64 << 10;
/// Bytes that the decoder needs beside its rows, for reading ahead and unpacking.
const DECODER_BYTES: u64 = 1 << 20;
const DECODER_ROWS: u64 = 8;

fn png_reader(file: File, memory: &HostMemory) -> png::Decoder<BufReader<File>> {
    let limits = png::Limits { bytes: usize::try_from(memory.limit()).unwrap_or(usize::MAX) };
    let reader = BufReader::with_capacity(BUFFER_BYTES, file);
    let mut decoder = png::Decoder::new_with_limits(reader, limits);
    // Keeps the depth, so that 16 bits are rounded here, not cut.
    decoder.set_transformations(png::Transformations::EXPAND);
    // Unused chunks, which could unpack to a lot before their memory is counted.
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_ignore_text_chunk(true);
    decoder
}

/// Reads a picture as `request` says; only its gamma if it is interlaced or rotated.
fn read_png_rows(path: &Path, file: File, request: &Request<'_>) -> Result<Result<Decoded, Option<f32>>> {
    let damaged = |e: &dyn std::fmt::Display| damaged(path, e);
    let file_bytes = file.metadata().reading(path)?.len();
    let mut reader = png_reader(file, request.memory).read_info().map_err(|e| damaged(&e))?;
    let info = reader.info();
    // The decoder does not check the palette.
    let bytes = info.palette.as_ref().map_or(0, |palette| palette.len());
    if !bytes.is_multiple_of(3) || bytes > 3 * 256 {
        let problem = format!("its palette has {bytes} bytes; up to 256 entries of 3 are possible");
        return Err(damaged(&problem));
    }
    let gamma = info.gama_chunk.filter(|_| info.srgb.is_none()).map(png::ScaledFloat::into_value);
    let gamma = gamma.filter(|gamma| *gamma > 0.0);
    let (size, interlaced) = (info.size(), info.interlaced);
    if interlaced || request.turned && photo_header(path)?.has_orientation() {
        return Ok(Err(gamma));
    }
    check_size(path, request, &PhotoHeader { stored: size, orientation: Orientation::NoTransforms })?;
    if size.0.max(size.1) > MAX_IMAGE_SIDE {
        return Err(damaged(&format!("{}x{} pixels; {MAX_IMAGE_SIDE} a side are possible", size.0, size.1)));
    }
    let decoded = reader.output_buffer_size().filter(|&decoded| !cannot_hold(file_bytes, decoded as u64));
    let Some(row_bytes) = decoded.and_then(|_| reader.output_line_size(size.0)) else {
        return Err(damaged(&claims(size, file_bytes)));
    };
    let (color, depth) = reader.output_color_type();
    let has_alpha = matches!(color, png::ColorType::GrayscaleAlpha | png::ColorType::Rgba);
    let own = Rows::bytes(request, size, has_alpha) + DECODER_BYTES + DECODER_ROWS * row_bytes as u64;
    let lease = request.memory.take(path, own.saturating_add(request.besides))?;
    let mut rows = Rows::new(path, request, size, has_alpha)?;
    while let Some(row) = reader.next_row().map_err(|e| damaged(&e))? {
        cost::steps(row.data().len());
        let rounded = |&word: &[u8; 2]| ((u32::from(u16::from_be_bytes(word)) + 128) / 257) as u8;
        let values = match depth {
            png::BitDepth::Eight => row.data().to_vec(),
            png::BitDepth::Sixteen => row.data().as_chunks().0.iter().map(rounded).collect(),
            _ => return Err(damaged(&UNREAD_KIND)),
        };
        rows.push(values, color.samples());
    }
    Ok(Ok(rows.finish(gamma, lease)))
}

/// Entropy-coded bytes of ones, appended to the data. No code consists of ones only, so a decoder that needs a code
/// here reports an error. Without these bytes, it would take all missing data as zeros. In whole data, the decoder may
/// read ahead to these bits but never uses them.
const NO_CODE: [u8; 16] = [0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0];

/// Structure of a JPEG by its markers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct JpegOutline {
    /// True if it reaches its end-of-image marker. Decoders fill a truncated JPEG with grey.
    complete: bool,
    /// True if it is stored in passes. A decoder then holds all its coefficients.
    progressive: bool,
    /// Smallest number of 8×8 blocks of an image of the claimed size.
    blocks: u64,
    coded_bytes: u64,
    scans: u32,
    /// Byte ranges of its parts, between the first and the last marker. Some cameras write other bytes between them.
    parts: Vec<Range<usize>>,
}

impl JpegOutline {
    fn of(bytes: &[u8]) -> Self {
        const START_OF_SCAN: u8 = 0xda;
        const END_OF_IMAGE: u8 = 0xd9;
        let mut outline = Self::default();
        let mut at = 2;
        while let Some(&[first, marker]) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
            cost::step();
            match marker {
                // Only before the data: inside them, a marker may be damage.
                _ if first != 0xff && outline.scans == 0 => at += 1,
                _ if first != 0xff => break,
                END_OF_IMAGE => return Self { complete: true, ..outline },
                // Fill bytes, and markers without a length.
                0xff => at += 1,
                0x00 if outline.scans > 0 => break,
                0x00 | 0x01 | 0xd0..=0xd8 => at += 2,
                _ => {
                    let begin = at;
                    let Some(&length) = bytes.get(at + 2..).and_then(|rest| rest.first_chunk()) else {
                        break;
                    };
                    let start = at + 4;
                    at += 2 + usize::from(u16::from_be_bytes(length)).max(2);
                    match marker {
                        // A frame, not one of the tables with numbers in this range.
                        0xc0..=0xcf if ![0xc4, 0xc8, 0xcc].contains(&marker) => {
                            outline.progressive = marker == 0xc2;
                            outline.blocks = blocks(bytes.get(start..at).unwrap_or_default());
                        }
                        START_OF_SCAN => {
                            let end = end_of_scan(bytes, at);
                            outline.coded_bytes += (end - at.min(end)) as u64;
                            outline.scans += 1;
                            at = end;
                        }
                        _ => {}
                    }
                    outline.parts.push(begin..at.min(bytes.len()));
                }
            }
        }
        outline
    }

    /// True if the data can hold the blocks: each takes a bit at least.
    fn can_hold_its_size(&self) -> bool {
        self.blocks / 8 <= self.coded_bytes
    }
}

/// Number of blocks of all components of a frame, except blocks that the picture covers only in part.
fn blocks(frame: &[u8]) -> u64 {
    let Some((&[_, h1, h0, w1, w0, _], components)) = frame.split_first_chunk() else { return 0 };
    let [width, height] = [[w1, w0], [h1, h0]].map(|side| u64::from(u16::from_be_bytes(side)));
    let factors = components.as_chunks::<3>().0.iter().map(|c| [u64::from(c[1] >> 4), u64::from(c[1] & 15)]);
    let (max, sum) = factors.fold(([1, 1], 0), |([x, y], sum), [h, v]| ([x.max(h), y.max(v)], sum + h * v));
    width / (8 * max[0]) * (height / (8 * max[1])) * sum
}

/// End of the entropy-coded data from `at`: the next marker that is neither stuffing nor a restart.
fn end_of_scan(bytes: &[u8], mut at: usize) -> usize {
    while let Some(&[first, second]) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        cost::step();
        if first == 0xff && !matches!(second, 0x00 | 0xd0..=0xd7 | 0xff) {
            return at;
        }
        at += 1;
    }
    bytes.len()
}

/// The file without bytes between its parts and after its end, and with [`NO_CODE`] at the end of its data.
fn sealed(bytes: &[u8], outline: &JpegOutline) -> Vec<u8> {
    let mut sealed = Vec::with_capacity(bytes.len() + NO_CODE.len() + 4);
    sealed.extend([0xff, 0xd8]);
    outline.parts.iter().for_each(|part| sealed.extend_from_slice(&bytes[part.clone()]));
    // The decoder needs a marker directly after the first of several passes.
    if !outline.progressive || outline.scans > 1 {
        sealed.extend(NO_CODE);
    }
    sealed.extend([0xff, 0xd9]);
    sealed
}

/// Decodes a JPEG, grey or r, g, b, into `pixels`. Missing and invalid data are errors; the decoder's default is grey.
fn decode_jpeg(bytes: &[u8], outline: &JpegOutline, grey: bool, pixels: &mut [u8]) -> Result<(), String> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_IMAGE_SIDE as usize)
        .set_max_height(MAX_IMAGE_SIDE as usize)
        .jpeg_set_out_colorspace(if grey { ColorSpace::Luma } else { ColorSpace::RGB });
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(sealed(bytes, outline)), options);
    decoder.decode_into(pixels).map_err(|e| e.to_string())
}
