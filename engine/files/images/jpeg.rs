//! Checks and decodes JPEGs that may be cut short, damaged, or claim a size that their data cannot hold.

use std::ops::Range;

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use crate::cost;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;

/// Entropy-coded bytes of ones, appended to the data. No code consists of ones only, so a decoder that needs a code
/// here reports an error. Without these bytes, it would take all missing data as zeros. In whole data, the decoder may
/// read ahead to these bits but never uses them.
const NO_CODE: [u8; 16] = [0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0];

/// Structure of a JPEG by its markers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Outline {
    /// True if it reaches its end-of-image marker. Decoders fill a truncated JPEG with grey.
    pub(super) complete: bool,
    /// True if it is stored in passes. A decoder then holds all its coefficients.
    pub(super) progressive: bool,
    /// Least number of blocks of 64 values for the size that it claims.
    blocks: u64,
    /// Bytes of entropy-coded data.
    coded_bytes: u64,
    /// Number of scans of entropy-coded data.
    scans: u32,
    /// Byte ranges of its parts, between the first and the last marker. Other bytes may lie between them, which some
    /// cameras write.
    parts: Vec<Range<usize>>,
}

impl Outline {
    pub(super) fn of(bytes: &[u8]) -> Self {
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
    pub(super) fn can_hold_its_size(&self) -> bool {
        self.blocks / 8 <= self.coded_bytes
    }
}

/// Number of blocks of all components of a frame, except blocks that the picture covers only in part.
fn blocks(frame: &[u8]) -> u64 {
    let Some((&[_, h1, h0, w1, w0, _], components)) = frame.split_first_chunk() else { return 0 };
    let [width, height] = [[w1, w0], [h1, h0]].map(|side| u64::from(u16::from_be_bytes(side)));
    let factors = components.as_chunks::<3>().0.iter().map(|c| [u64::from(c[1] >> 4), u64::from(c[1] & 15)]);
    let (most, sum) = factors.fold(([1, 1], 0), |([x, y], sum), [h, v]| ([x.max(h), y.max(v)], sum + h * v));
    width / (8 * most[0]) * (height / (8 * most[1])) * sum
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
fn sealed(bytes: &[u8], outline: &Outline) -> Vec<u8> {
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

/// Decodes a JPEG, grey or r, g, b, into `pixels`. Data that end early or are invalid are errors; by default the
/// decoder would fill them with grey.
pub(super) fn decode(bytes: &[u8], outline: &Outline, grey: bool, pixels: &mut [u8]) -> Result<(), String> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_IMAGE_SIDE as usize)
        .set_max_height(MAX_IMAGE_SIDE as usize)
        .jpeg_set_out_colorspace(if grey { ColorSpace::Luma } else { ColorSpace::RGB });
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(sealed(bytes, outline)), options);
    decoder.decode_into(pixels).map_err(|e| e.to_string())
}
