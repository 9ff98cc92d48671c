//! JPEGs that are cut short, damaged, or claim a size that their data cannot hold.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use ashsplat::scene::camera::MAX_IMAGE_SIDE;

/// What the markers of a JPEG say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Outline {
    /// Whether it reaches its end-of-image marker. Decoders fill one that is cut short with grey.
    pub(super) complete: bool,
    /// Whether it is stored in passes: a decoder holds all its coefficients.
    pub(super) progressive: bool,
    /// Blocks of 64 values that its size claims, at least.
    blocks: u64,
    /// Bytes of entropy-coded data.
    coded_bytes: u64,
}

impl Outline {
    pub(super) fn of(bytes: &[u8]) -> Self {
        const START_OF_SCAN: u8 = 0xda;
        const END_OF_IMAGE: u8 = 0xd9;
        let mut outline = Self::default();
        let mut at = 2;
        while let Some(&[0xff, marker]) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
            match marker {
                END_OF_IMAGE => return Self { complete: true, ..outline },
                // Fill bytes, and markers without a length.
                0xff => at += 1,
                0x01 | 0xd0..=0xd8 => at += 2,
                _ => {
                    let Some(&length) = bytes.get(at + 2..).and_then(|rest| rest.first_chunk()) else {
                        break;
                    };
                    let start = at + 4;
                    at += 2 + usize::from(u16::from_be_bytes(length)).max(2);
                    match marker {
                        // A frame, and not the tables with numbers among them.
                        0xc0..=0xcf if ![0xc4, 0xc8, 0xcc].contains(&marker) => {
                            outline.progressive = marker == 0xc2;
                            outline.blocks = blocks(bytes.get(start..at).unwrap_or_default());
                        }
                        START_OF_SCAN => {
                            let end = end_of_scan(bytes, at);
                            outline.coded_bytes += (end - at.min(end)) as u64;
                            at = end;
                        }
                        _ => {}
                    }
                }
            }
        }
        outline
    }

    /// Whether the data can hold as many blocks: each takes a bit at least.
    pub(super) fn can_hold_its_size(&self) -> bool {
        self.blocks / 8 <= self.coded_bytes
    }
}

/// Blocks of all components of a frame, without those that only a part of the picture touches.
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
        if first == 0xff && !matches!(second, 0x00 | 0xd0..=0xd7 | 0xff) {
            return at;
        }
        at += 1;
    }
    bytes.len()
}

/// The pixels of a JPEG, grey or r, g, b, into memory of their size. Data that end early or make no sense are errors, which
/// the decoder would fill with grey otherwise.
pub(super) fn decode(bytes: &[u8], grey: bool, pixels: &mut [u8]) -> Result<(), String> {
    let result = decode_as(bytes, grey, pixels, true);
    // Bytes between the parts of a file do no harm, and cameras leave some.
    match result {
        Err(e) if e.contains("Extra bytes between headers") => decode_as(bytes, grey, pixels, false),
        result => result,
    }
}

fn decode_as(bytes: &[u8], grey: bool, pixels: &mut [u8], strict: bool) -> Result<(), String> {
    let options = DecoderOptions::default()
        .set_strict_mode(strict)
        .set_max_width(MAX_IMAGE_SIDE as usize)
        .set_max_height(MAX_IMAGE_SIDE as usize)
        .jpeg_set_out_colorspace(if grey { ColorSpace::Luma } else { ColorSpace::RGB });
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_into(pixels).map_err(|e| e.to_string())
}
