//! PNG and JPEG files, as photographs and depth maps: chunks with valid checksums, segments with valid lengths, and
//! false headers.
#![no_main]

use arbitrary::Arbitrary;
use ashsplat_files::images::{DepthMap, photo_size};
use ashsplat_files::{HostMemory, Photo, PhotoFileFormat};
use ashsplat_fuzz::hostile::{Filling, MAX_BYTES, Number, Patch, patch};
use ashsplat_fuzz::{folder, in_one_line, within};
use flate2::{Compression, write::ZlibEncoder};
use image::codecs::jpeg::JpegEncoder;
use libfuzzer_sys::fuzz_target;
use std::io::Write;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("photo").join("input.png"));

#[derive(Arbitrary, Debug)]
enum Picture {
    Png(Png),
    Jpeg(Jpeg),
}

#[derive(Arbitrary, Debug)]
struct Png {
    sides: [u16; 2],
    claimed: [Number; 2],
    depth: u8,
    color: u8,
    interlaced: bool,
    data: Filling,
    data_bytes: Number,
    others: Vec<(u8, Filling, bool)>,
    pieces: u8,
    patches: Vec<Patch>,
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(bytes).expect("packed");
    packed.finish().expect("packed")
}

fn chunk(file: &mut Vec<u8>, kind: &[u8; 4], bytes: &[u8]) {
    file.extend((bytes.len() as u32).to_be_bytes());
    let start = file.len();
    file.extend(kind);
    file.extend(bytes);
    file.extend(crc32fast::hash(&file[start..]).to_be_bytes());
}

impl Png {
    fn file(&self) -> Vec<u8> {
        const KINDS: [&[u8; 4]; 10] =
            [b"iCCP", b"eXIf", b"tEXt", b"zTXt", b"PLTE", b"tRNS", b"acTL", b"fcTL", b"gAMA", b"fdAT"];
        let [width, height] = self.sides.map(|side| u64::from(side % 300) + 1);
        let depth = [8, 16, 1, 2, 4, self.depth][usize::from(self.depth) % 6];
        let color = [2, 6, 0, 3, 4, self.color][usize::from(self.color) % 6];
        let channels = [1, 1, 3, 1, 2, 1, 4][usize::from(color) % 7];
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        let mut header = Vec::new();
        header.extend((self.claimed[0].of(width) as u32).to_be_bytes());
        header.extend((self.claimed[1].of(height) as u32).to_be_bytes());
        header.extend([depth, color, 0, 0, u8::from(self.interlaced)]);
        chunk(&mut file, b"IHDR", &header);
        for (kind, filling, pack) in self.others.iter().take(6) {
            let bytes = filling.bytes(MAX_BYTES / 16);
            let bytes = if *pack { [b"name\0\0", &packed(&bytes)[..]].concat() } else { bytes };
            chunk(&mut file, KINDS[usize::from(*kind) % KINDS.len()], &bytes);
        }
        let row = 1 + (width * channels * u64::from(depth)).div_ceil(8);
        let length = self.data_bytes.of(row * height).min(self.data.max_packed() as u64) as usize;
        let mut rows = self.data.exactly(length);
        // Valid filters, except for the seeds that choose others.
        rows.iter_mut().step_by(row as usize).for_each(|filter| *filter %= 6);
        let data = packed(&rows);
        for piece in data.chunks(data.len().div_ceil(usize::from(self.pieces % 4) + 1).max(1)) {
            chunk(&mut file, b"IDAT", piece);
        }
        chunk(&mut file, b"IEND", &[]);
        patch(&mut file, &self.patches);
        file
    }
}

#[derive(Arbitrary, Debug)]
struct Jpeg {
    sides: [u8; 2],
    claimed: [Number; 2],
    grey: bool,
    /// Kind of frame header: baseline, progressive and so on.
    frame: Option<u8>,
    orientation: Option<(bool, [Number; 4])>,
    others: Vec<(u8, Filling, Number)>,
    data: Filling,
    cut: Option<u16>,
    patches: Vec<Patch>,
}

fn segment(file: &mut Vec<u8>, marker: u8, bytes: &[u8], length: Number) {
    file.extend([0xff, marker]);
    file.extend((length.of(bytes.len() as u64 + 2) as u16).to_be_bytes());
    file.extend(bytes);
}

/// A directory of one entry, the orientation.
fn exif(little: bool, [count, kind, length, next]: [Number; 4]) -> Vec<u8> {
    let short = |n: u16| if little { n.to_le_bytes() } else { n.to_be_bytes() };
    let long = |n: u32| if little { n.to_le_bytes() } else { n.to_be_bytes() };
    let mut bytes = b"Exif\0\0".to_vec();
    bytes.extend(if little { b"II" } else { b"MM" });
    bytes.extend(short(42));
    bytes.extend(long(8));
    bytes.extend(short(count.of(1) as u16));
    bytes.extend(short(0x112));
    bytes.extend(short(kind.of(3) as u16));
    bytes.extend(long(length.of(1) as u32));
    bytes.extend([short(6), [0; 2]].concat());
    bytes.extend(long(next.of(0) as u32));
    bytes
}

impl Jpeg {
    fn file(&self) -> Vec<u8> {
        let [width, height] = self.sides.map(|side| u32::from(side) + 1);
        let channels = if self.grey { 1 } else { 3 };
        let pixels = self.data.exactly((width * height * channels) as usize);
        let color = if self.grey { image::ExtendedColorType::L8 } else { image::ExtendedColorType::Rgb8 };
        let mut honest = Vec::new();
        JpegEncoder::new_with_quality(&mut honest, 50).encode(&pixels, width, height, color).expect("a JPEG");
        if let Some(at) = honest.windows(2).position(|w| w == [0xff, 0xc0]) {
            let [height, width] = [(1, height), (0, width)].map(|(i, n)| self.claimed[i].of(n.into()) as u16);
            honest[at + 5..at + 7].copy_from_slice(&height.to_be_bytes());
            honest[at + 7..at + 9].copy_from_slice(&width.to_be_bytes());
            honest[at + 1] = self.frame.map_or(0xc0, |frame| 0xc0 | frame % 16);
        }
        let mut file = honest[..2].to_vec();
        if let Some((little, numbers)) = self.orientation {
            segment(&mut file, 0xe1, &exif(little, numbers), Number::Honest);
        }
        for (marker, filling, length) in self.others.iter().take(6) {
            segment(&mut file, 0xc0 | marker % 64, &filling.bytes(65_533), *length);
        }
        file.extend(&honest[2..]);
        if let Some(cut) = self.cut {
            file.truncate(file.len() - usize::from(cut) % file.len());
        }
        patch(&mut file, &self.patches);
        file
    }
}

fuzz_target!(|picture: Picture| {
    let bytes = match picture {
        Picture::Png(png) => png.file(),
        Picture::Jpeg(jpeg) => jpeg.file(),
    };
    std::fs::write(&*FILE, &bytes).expect("written");
    within(bytes.len(), |bound| {
        let size = in_one_line(photo_size(&*FILE));
        let read = Photo::read_within(&*FILE, [0.0; 3], &HostMemory::new(bound));
        if let Some(photo) = in_one_line(read) {
            assert_eq!(Some((photo.width, photo.height)), size);
            assert_eq!(photo.rgb.len() as u64, 3 * u64::from(photo.width) * u64::from(photo.height));
        }
        if let Some(map) = in_one_line(DepthMap::read(&*FILE, &HostMemory::new(bound))) {
            assert_eq!(map.values.len() as u64, u64::from(map.width) * u64::from(map.height));
        }
    });
});
