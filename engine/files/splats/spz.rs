//! Reads SPZ, versions 2 and 3 (one gzip stream) and 4 (a zstd stream for each attribute); writes the same.
//!
//! Format: github.com/nianticlabs/spz (Niantic). Axes are right, up, back: y and z are opposite to this crate's.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

use flate2::bufread::GzDecoder;
use flate2::write::GzEncoder;

use super::{BLOCK, Format, Header, Opened, Outline, Produce, Sink};
use crate::regular_file::{self, OnFile, u32_at};
use crate::{atomic, cost};
use ashsplat::scene::Gaussians;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::{Error, Result};

/// "NGSP" as a little-endian number.
const MAGIC: u32 = 0x5053_474e;
const FLAG_ANTIALIASED: u8 = 1;
const FLAG_EXTENSIONS: u8 = 2;
const HEADER_BYTES: u64 = 32;
/// Length of the header of versions 2 and 3, inside the gzip stream.
const OLD_HEADER_BYTES: usize = 16;
/// Largest credible ratio of unpacked to packed size: deflate cannot exceed it, and zstd does not with splats.
const MAX_RATIO: u64 = 1032;
/// Largest size of all extensions, which are a few numbers.
const MAX_EXTENSION_BYTES: u64 = 1 << 20;
/// The extension that declares the axes (Adobe).
const EXTENSION_AXES: u32 = 0xadbe_0003;
/// The extension with limits of a viewer's orbit, which changes no picture.
const EXTENSION_ORBIT: u32 = 0xadbe_0002;

/// An open SPZ. Each plane has its own stream, so that only one block is in memory.
pub(super) struct Spz {
    file: SpzFile,
    packing: Packing,
    layout: Layout,
    /// Axes to mirror after unpacking.
    pub(super) mirrored: [bool; 3],
    count: u64,
}

/// A reader that ends at the end of the SPZ.
type Bytes = BufReader<io::Take<File>>;

enum Layout {
    /// All planes in one gzip stream, followed by at most `extensions` bytes of extensions.
    Gzip { extensions: u64 },
    /// Offset and length of each plane's zstd stream; `None` for planes without data.
    Zstd([Option<(u64, u64)>; PLANES]),
}

pub(super) fn open(path: &Path) -> Result<Opened<'static>> {
    let (_, bytes) = regular_file::open(path)?;
    let (header, spz) = Spz::inside(path, 0, bytes)?;
    Ok((header, Box::new(move |sink| spz.read(sink))))
}

impl Spz {
    /// Opens an SPZ inside a file: `bytes` bytes from `offset`.
    pub(super) fn inside(path: &Path, offset: u64, bytes: u64) -> Result<(Header, Self)> {
        let file = SpzFile { path: path.to_owned(), offset, bytes };
        let mut reader = file.from(0)?;
        let mut start = Vec::new();
        reader.by_ref().take(4).read_to_end(&mut start).reading(path)?;
        let reader = file.from(0)?;
        match start.as_slice() {
            [0x1f, 0x8b, ..] => file.gzip(reader),
            b"NGSP" => file.zstd(reader),
            [] => Err(Error::input(path, "is empty", "download or copy it again")),
            _ => Err(file.damaged("is no SPZ: neither gzip nor an SPZ header")),
        }
    }

    /// Opens all planes at their beginning.
    fn planes(&self) -> Result<Vec<Plane<'_>>> {
        let mut before = OLD_HEADER_BYTES as u64;
        let mut planes = Vec::new();
        for (index, row_bytes) in self.packing.row_bytes().into_iter().enumerate() {
            let bytes = self.count * row_bytes as u64;
            let name = NAMES[index];
            let stream: Box<dyn Read> = match &self.layout {
                Layout::Zstd(places) => match places[index] {
                    None => Box::new(io::empty()),
                    Some((at, packed)) => {
                        let stream = self.file.from(at)?.take(packed);
                        let mut decoder =
                            zstd::stream::read::Decoder::new(stream).reading(&self.file.path)?;
                        decoder.window_log_max(window_log(bytes)).reading(&self.file.path)?;
                        Box::new(decoder)
                    }
                },
                // The stream before a plane is unpacked again: up to four times the data, twice with all harmonics.
                Layout::Gzip { .. } => {
                    let mut stream = GzDecoder::new(self.file.from(0)?);
                    self.file.skip(&mut stream, before, name)?;
                    Box::new(stream)
                }
            };
            before += bytes;
            planes.push(Plane { file: &self.file, name, stream, bytes, read: 0 });
        }
        Ok(planes)
    }

    /// Reads the data after the planes. Reading a stream to its end verifies its checksum.
    fn finish(&self, planes: Vec<Plane<'_>>) -> Result<()> {
        // Only the last plane's reader reaches the end of the gzip stream.
        let (limit, skipped) = match self.layout {
            Layout::Gzip { extensions } => (extensions, PLANES - 1),
            Layout::Zstd(_) => (0, 0),
        };
        for mut plane in planes.into_iter().skip(skipped) {
            let rest = io::copy(&mut (&mut plane.stream).take(limit + 1), &mut io::sink());
            let rest = rest.map_err(|e| plane.broken(&e))?;
            if rest > limit {
                let (name, bytes, count) = (plane.name, plane.bytes, self.count);
                return Err(self.file.damaged(match self.layout {
                    Layout::Gzip { .. } => format!("holds more data than its {count} Gaussians need"),
                    Layout::Zstd(_) => format!("{name}: unpacks to more than {bytes} bytes"),
                }));
            }
        }
        Ok(())
    }

    pub(super) fn read(&self, sink: &mut Sink<'_>) -> Result<()> {
        let count = self.count as usize;
        let row_bytes = self.packing.row_bytes();
        let mut planes = self.planes()?;
        let mut packed: [Vec<u8>; PLANES] = Default::default();
        for start in (0..count).step_by(BLOCK) {
            let rows = BLOCK.min(count - start);
            for ((plane, packed), row_bytes) in planes.iter_mut().zip(&mut packed).zip(row_bytes) {
                plane.fill(packed, rows * row_bytes)?;
            }
            let mut block = self.packing.unpack(&packed, 0..rows);
            block.mirror(self.mirrored);
            sink(block)?;
        }
        self.finish(planes)
    }
}

/// Largest window of a plane's decoder, as a power of two. All planes are decoded at once, and zstd's own bound would
/// be 128 MiB for each. The minimum suffices for its levels up to 19 at any length.
fn window_log(bytes: u64) -> u32 {
    bytes.max(1).next_power_of_two().trailing_zeros().clamp(23, 27)
}

/// One attribute of all Gaussians, while it is unpacked.
struct Plane<'a> {
    file: &'a SpzFile,
    name: &'static str,
    stream: Box<dyn Read>,
    bytes: u64,
    read: u64,
}

impl Plane<'_> {
    fn fill(&mut self, packed: &mut Vec<u8>, needed: usize) -> Result<()> {
        packed.clear();
        let read = (&mut self.stream).take(needed as u64).read_to_end(packed);
        self.read += read.map_err(|e| self.broken(&e))? as u64;
        if packed.len() == needed {
            return Ok(());
        }
        let Self { name, bytes, read, .. } = self;
        Err(self.file.damaged(format!("{name}: {bytes} bytes are needed, the data end after {read}")))
    }

    fn broken(&self, e: &io::Error) -> Error {
        self.file.damaged(format!("{}: the compressed data are damaged: {e}", self.name))
    }
}

/// A file, or a part of one.
struct SpzFile {
    path: PathBuf,
    offset: u64,
    bytes: u64,
}

impl SpzFile {
    /// Reader from byte `at` on.
    fn from(&self, at: u64) -> Result<Bytes> {
        regular_file::part(&self.path, self.offset + at, self.bytes.saturating_sub(at))
    }

    fn damaged(&self, problem: impl Into<String>) -> Error {
        regular_file::damaged(&self.path, problem)
    }

    /// Reads the fields that both headers share. The last value is true if there are extensions.
    fn head(&self, bytes: &[u8]) -> Result<(Packing, Header, bool)> {
        let (version, count) = (u32_at(bytes, 4), u64::from(u32_at(bytes, 8)));
        let (sh_degree, fractional_bits) = (u32::from(bytes[12]), u32::from(bytes[13]));
        if u32_at(bytes, 0) != MAGIC {
            return Err(self.damaged("is no SPZ: its header does not begin with NGSP"));
        }
        if !(2..=4).contains(&version) {
            let problem = format!("is SPZ version {version}; 2, 3 and 4 are known");
            return Err(Error::input(&self.path, problem, "write it again with a newer program"));
        }
        if sh_degree > 4 {
            return Err(self.damaged(format!("the header says SH degree {sh_degree}; 0 to 4 are possible")));
        }
        let unknown = bytes[14] & !(FLAG_ANTIALIASED | FLAG_EXTENSIONS);
        if unknown != 0 {
            let problem = format!("has flags that are not known ({unknown:#04x})");
            let remedy = "save it as plain SPZ, without levels of detail";
            return Err(Error::input(&self.path, problem, remedy));
        }
        if fractional_bits > COORDINATE_BITS {
            return Err(self.damaged(format!("the header says {fractional_bits} fractional bits")));
        }
        let packing = Packing { version, sh_degree, fractional_bits };
        let needed = count * packing.bytes();
        if needed > self.bytes.saturating_mul(MAX_RATIO) {
            let bytes = self.bytes;
            let problem = format!("the header says {count} Gaussians, which {bytes} bytes cannot hold");
            return Err(self.damaged(problem));
        }
        let mut header = Header::new(Format::Spz, count, sh_degree.min(3));
        header.antialiased = bytes[14] & FLAG_ANTIALIASED != 0;
        if sh_degree > 3 {
            let path = self.path.display();
            header.warnings.push(format!("{path}: SH of degree 4 are left out, 3 is the highest here"));
        }
        Ok((packing, header, bytes[14] & FLAG_EXTENSIONS != 0))
    }

    fn gzip(self, reader: Bytes) -> Result<(Header, Spz)> {
        let mut stream = GzDecoder::new(reader);
        let mut start = [0; OLD_HEADER_BYTES];
        let read = stream.read_exact(&mut start);
        read.map_err(|e| self.damaged(format!("header: it cannot be unpacked: {e}")))?;
        let (packing, header, has_extensions) = self.head(&start)?;
        if packing.version == 4 {
            return Err(self.damaged("is SPZ version 4 inside gzip, which the format does not have"));
        }
        let mut extensions = Vec::new();
        let mut limit = 0;
        if has_extensions {
            // The extensions follow all planes, but the first Gaussians need them.
            limit = MAX_EXTENSION_BYTES;
            self.skip(&mut stream, header.count * packing.bytes(), "planes")?;
            let read = stream.take(limit + 1).read_to_end(&mut extensions);
            read.map_err(|e| self.damaged(format!("the gzip stream is damaged: {e}")))?;
        }
        self.finish(packing, header, Layout::Gzip { extensions: limit }, &extensions)
    }

    fn skip(&self, stream: &mut impl Read, bytes: u64, what: &str) -> Result<()> {
        let skipped = io::copy(&mut stream.take(bytes), &mut io::sink());
        let skipped =
            skipped.map_err(|e| self.damaged(format!("{what}: the compressed data are damaged: {e}")))?;
        cost::steps(skipped as usize);
        if skipped == bytes {
            return Ok(());
        }
        Err(self.damaged(format!("{what}: the data end after {skipped} bytes, where {bytes} are needed")))
    }

    fn zstd(self, mut reader: Bytes) -> Result<(Header, Spz)> {
        if self.bytes < HEADER_BYTES {
            let bytes = self.bytes;
            return Err(self.damaged(format!("ends after {bytes} of the header's {HEADER_BYTES} bytes")));
        }
        let mut start = [0; HEADER_BYTES as usize];
        reader.read_exact(&mut start).reading(&self.path)?;
        let (packing, header, has_extensions) = self.head(&start)?;
        if packing.version != 4 {
            return Err(self.damaged(format!("is SPZ version {} without gzip", packing.version)));
        }
        let expected: Vec<usize> =
            (0..PLANES).filter(|&plane| header.count * packing.row_bytes()[plane] as u64 > 0).collect();
        let table = u64::from(u32_at(&start, 16));
        let streams = u64::from(start[15]);
        if streams != expected.len() as u64 {
            let problem = format!("has {streams} streams, {} were expected", expected.len());
            return Err(self.damaged(problem));
        }
        let mut at = table + 16 * streams;
        if table < HEADER_BYTES || at > self.bytes || table - HEADER_BYTES > MAX_EXTENSION_BYTES {
            return Err(self.damaged(format!("its table of streams lies at byte {table} of {}", self.bytes)));
        }
        let mut extensions = vec![0; (table - HEADER_BYTES) as usize];
        reader.read_exact(&mut extensions).reading(&self.path)?;
        let mut sizes = vec![[0; 16]; expected.len()];
        reader.read_exact(sizes.as_flattened_mut()).reading(&self.path)?;
        let mut places = [None; PLANES];
        for (plane, size) in expected.into_iter().zip(sizes) {
            let [packed, unpacked] = bytemuck::cast::<[u8; 16], [[u8; 8]; 2]>(size).map(u64::from_le_bytes);
            let needed = header.count * packing.row_bytes()[plane] as u64;
            let name = NAMES[plane];
            let Some(end) = at.checked_add(packed).filter(|&end| end <= self.bytes) else {
                return Err(self.damaged(format!("{name}: the stream ends behind the file")));
            };
            if unpacked != needed {
                return Err(self.damaged(format!("{name}: {unpacked} bytes instead of {needed}")));
            }
            places[plane] = Some((at, packed));
            at = end;
        }
        if at != self.bytes {
            return Err(self.damaged(format!("has {} bytes after its last stream", self.bytes - at)));
        }
        if !has_extensions {
            extensions.clear();
        }
        self.finish(packing, header, Layout::Zstd(places), &extensions)
    }

    fn finish(
        self,
        packing: Packing,
        mut header: Header,
        layout: Layout,
        extensions: &[u8],
    ) -> Result<(Header, Spz)> {
        let (mirrored, unused) = axes(extensions).map_err(|problem| {
            Error::input(&self.path, problem, "write it again with the axes right, up, back")
        })?;
        let shown = self.path.display();
        let unused = unused.iter().map(|kind| format!("{shown}: the extension {kind:#010x} is not used"));
        header.warnings.extend(unused);
        let spz = Spz { file: self, packing, layout, mirrored, count: header.count };
        Ok((header, spz))
    }
}

const NAMES: [&str; PLANES] = ["means", "opacities", "colours", "scales", "rotations", "spherical harmonics"];

/// The axes to mirror, by the format or by an extension; and the unknown extensions that change the scene.
fn axes(mut extensions: &[u8]) -> Result<([bool; 3], Vec<u32>), String> {
    let (mut mirrored, mut unused) = (MIRRORED, Vec::new());
    while let Some((head, rest)) = extensions.split_first_chunk::<8>() {
        let [kind, length] = [0, 4].map(|at| u32_at(head, at));
        let Some((value, rest)) = rest.split_at_checked(length as usize) else {
            return Err("an extension in its header is longer than the header".into());
        };
        if kind == EXTENSION_AXES {
            // 1 to 8 are {left, right} × {down, up} × {back, forward}; 0 is unspecified; others exchange axes.
            mirrored = match *value {
                [0, 0, 0, 0] => MIRRORED,
                [code @ 1..=8, 0, 0, 0] => [(code - 1) & 1 == 0, (code - 1) & 2 != 0, (code - 1) & 4 == 0],
                _ => return Err("its axes are exchanged (extension SPZ_ADOBE_coordinate_system)".into()),
            };
        } else if kind != EXTENSION_ORBIT {
            unused.push(kind);
        }
        extensions = rest;
    }
    Ok((mirrored, unused))
}

/// Factor of the constant SH term in a colour byte.
const COLOR_SCALE: f32 = 0.15;
/// Bits of SH values that the reference keeps, for degree 1 and for higher degrees.
const SH_BITS: [u32; 2] = [5, 4];
/// Axes that are opposite in this crate and in SPZ.
const MIRRORED: [bool; 3] = [false, true, true];
const PLANES: usize = 6;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Packing {
    /// 2, 3 or 4.
    version: u32,
    /// Stored degree, 0 to 4.
    sh_degree: u32,
    fractional_bits: u32,
}

impl Packing {
    /// Bytes of one Gaussian in each plane: means, opacities, colours, scales, rotations, higher SH.
    fn row_bytes(&self) -> [usize; PLANES] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, 3 * (sh_coefficients(self.sh_degree) - 1)]
    }

    fn bytes(&self) -> u64 {
        self.row_bytes().iter().sum::<usize>() as u64
    }

    /// Unpacks the Gaussians from `start` to `end` at an SH degree of at most 3.
    fn unpack(&self, planes: &[Vec<u8>; PLANES], rows: std::ops::Range<usize>) -> Gaussians {
        let bytes = self.row_bytes();
        let row =
            |plane: usize, index: usize| &planes[plane][index * bytes[plane]..(index + 1) * bytes[plane]];
        let sh_degree = self.sh_degree.min(3);
        let unit = (-(self.fractional_bits as f32)).exp2();
        let mut block = Gaussians::with_capacity(sh_degree, rows.len());
        for index in rows {
            cost::step();
            let mean = row(0, index);
            block.means.push(std::array::from_fn(|axis| fixed_24(&mean[3 * axis..]) as f32 * unit));
            let opacity = (f64::from(row(1, index)[0]) / 255.0).clamp(1.0 / 255.0, 254.0 / 255.0);
            block.opacity_logits.push((opacity / (1.0 - opacity)).ln() as f32);
            let color = row(2, index);
            block.sh.push(std::array::from_fn(|c| (f32::from(color[c]) / 255.0 - 0.5) / COLOR_SCALE));
            let scale = row(3, index);
            block.log_scales.push(std::array::from_fn(|axis| f32::from(scale[axis]) / 16.0 - 10.0));
            block.quats.push(match *row(4, index) {
                [x, y, z] => first_three([x, y, z]),
                [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
                _ => [1.0, 0.0, 0.0, 0.0],
            });
            let sh = row(5, index).as_chunks::<3>().0.iter().take(sh_coefficients(sh_degree) - 1);
            block.sh.extend(sh.map(|rgb| rgb.map(|byte| (f32::from(byte) - 128.0) / 128.0)));
        }
        block
    }

    fn pack(&self, block: &Gaussians) -> [Vec<u8>; PLANES] {
        let mut planes: [Vec<u8>; PLANES] = Default::default();
        let factor = (self.fractional_bits as f32).exp2();
        for index in 0..block.len() {
            for value in block.means[index] {
                let fixed = (value * factor).round().clamp(-8_388_608.0, 8_388_607.0) as i32;
                planes[0].extend_from_slice(&fixed.to_le_bytes()[..3]);
            }
            planes[1].push(byte(255.0 * block.opacity(index)));
            let sh = block.sh_of(index);
            planes[2].extend(sh[0].map(|dc| byte(dc * (COLOR_SCALE * 255.0) + 0.5 * 255.0)));
            planes[3].extend(block.log_scales[index].map(|s| byte((s + 10.0) * 16.0)));
            match self.version {
                2 => planes[4].extend(pack_first_three(block.quats[index])),
                _ => planes[4].extend(pack_smallest_three(block.quats[index]).to_le_bytes()),
            }
            for (k, rgb) in sh[1..].iter().enumerate() {
                let bits = if k < 3 { SH_BITS[0] } else { SH_BITS[1] };
                planes[5].extend(rgb.map(|value| pack_sh(value, 1 << (8 - bits))));
            }
        }
        planes
    }
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

fn fixed_24(bytes: &[u8]) -> i32 {
    // The arithmetic shift extends the sign of the top byte.
    i32::from_le_bytes([0, bytes[0], bytes[1], bytes[2]]) >> 8
}

/// Rotation of version 2: x, y, z as bytes; w is positive.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f32::from(b) / 127.5 - 1.0);
    let w = (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt();
    [w, x, y, z]
}

fn pack_first_three(quat: [f32; 4]) -> [u8; 3] {
    let [w, x, y, z] = unit(quat);
    [x, y, z].map(|v| byte(127.5 + 127.5 * v * w.signum()))
}

/// Normalises a quaternion; one of length 0 becomes the identity.
pub(super) fn unit([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let length = (w * w + x * x + y * y + z * z).sqrt();
    if length > 0.0 { [w, x, y, z].map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Rotation from version 3 on: the index of the largest of x, y, z, w, and the others as sign and 9 bits.
fn smallest_three(packed: u32) -> [f32; 4] {
    const MAGNITUDE: u32 = (1 << 9) - 1;
    let largest = (packed >> 30) as usize;
    let mut rest = packed;
    let mut xyzw = [0.0f32; 4];
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = (rest & MAGNITUDE) as f32 / MAGNITUDE as f32 * std::f32::consts::FRAC_1_SQRT_2;
        xyzw[i] = if rest & (1 << 9) == 0 { magnitude } else { -magnitude };
        rest >>= 10;
    }
    xyzw[largest] = (1.0 - xyzw.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

fn pack_smallest_three(quat: [f32; 4]) -> u32 {
    let [w, x, y, z] = unit(quat);
    let xyzw = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| if xyzw[i].abs() > xyzw[best].abs() { i } else { best });
    let others = (0..4).filter(|&i| i != largest);
    others.fold(largest as u32, |packed, i| {
        let negative = (xyzw[i] < 0.0) != (xyzw[largest] < 0.0);
        let magnitude = (511.0 * (xyzw[i].abs() * std::f32::consts::SQRT_2) + 0.5) as u32;
        packed << 10 | u32::from(negative) << 9 | magnitude.min(511)
    })
}

/// Rounds to multiples of `step`, so that it compresses better; 0 stays 0.
fn pack_sh(value: f32, step: i32) -> u8 {
    // Values outside the range end at the nearest byte. The clamp prevents overflow.
    let fine = (value * 128.0).round().clamp(-256.0, 256.0) as i32 + 128;
    ((fine + step / 2).div_euclid(step) * step).clamp(0, 255) as u8
}

const VERSION: u32 = 4;
/// zstd level of the format's first implementation.
const LEVEL: i32 = 12;
/// Largest number of fractional bits. The first implementation always writes 12, and reads any number below 24.
pub(super) const MAX_FRACTIONAL_BITS: u32 = 23;
/// Bits of a coordinate, including the sign; its fractional bits cannot exceed them.
const COORDINATE_BITS: u32 = 24;

/// Writes Gaussians block by block, version 4. Memory holds a block and one encoder; temporary files hold the rest.
///
/// Versions 2 and 3 are for programs that know no other.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    if let Some(version @ ..VERSION) = outline.options.spz_version {
        let mut stream = old(path, version, MIRRORED, outline, produce)?;
        return atomic::write(path, |writer| io::copy(&mut stream, writer).map(drop));
    }
    let (packing, files) = packed(path, VERSION, MIRRORED, outline, produce)?;
    let mut streams = Vec::new();
    for (mut file, row_bytes) in files.into_iter().zip(packing.row_bytes()) {
        // Planes without data have no stream.
        if outline.count * row_bytes as u64 == 0 {
            continue;
        }
        let mut encoder = zstd::stream::write::Encoder::new(temporary_file()?, LEVEL).map_err(temporary)?;
        io::copy(&mut file, &mut encoder).map_err(temporary)?;
        let packed = rewound(encoder.finish().map_err(temporary)?)?;
        let packed_bytes = packed.metadata().map_err(temporary)?.len();
        streams.push((packed, packed_bytes, outline.count * row_bytes as u64));
    }
    atomic::write(path, |writer| {
        writer.write_all(&head(packing, outline, streams.len() as u8))?;
        writer.write_all(&(HEADER_BYTES as u32).to_le_bytes())?;
        writer.write_all(&[0; 12])?;
        for (_, packed_bytes, unpacked_bytes) in &streams {
            writer.write_all(&packed_bytes.to_le_bytes())?;
            writer.write_all(&unpacked_bytes.to_le_bytes())?;
        }
        streams.iter_mut().try_for_each(|(packed, ..)| io::copy(packed, writer).map(drop))
    })
}

/// Makes a file of version 2 or 3 in which some axes are mirrored, ready to be read from its start. `path` is for messages.
pub(super) fn old(
    path: &Path,
    version: u32,
    mirrored: [bool; 3],
    outline: &Outline,
    produce: &mut Produce<'_>,
) -> Result<File> {
    let (packing, files) = packed(path, version, mirrored, outline, produce)?;
    let mut encoder = GzEncoder::new(temporary_file()?, flate2::Compression::default());
    encoder.write_all(&head(packing, outline, 0)).map_err(temporary)?;
    for mut file in files {
        io::copy(&mut file, &mut encoder).map_err(temporary)?;
    }
    rewound(encoder.finish().map_err(temporary)?)
}

/// The header that all versions begin with. The last byte is the number of streams, 0 if there is only one.
fn head(packing: Packing, outline: &Outline, streams: u8) -> [u8; 16] {
    let flags = if outline.options.antialiased { FLAG_ANTIALIASED } else { 0 };
    let mut head = [0; 16];
    head[..12]
        .copy_from_slice([MAGIC, packing.version, outline.count as u32].map(u32::to_le_bytes).as_flattened());
    head[12..].copy_from_slice(&[packing.sh_degree as u8, packing.fractional_bits as u8, flags, streams]);
    head
}

/// The packed planes, each in a file, to be encoded one by one: an encoder needs far more memory than its output.
fn packed(
    path: &Path,
    version: u32,
    mirrored: [bool; 3],
    outline: &Outline,
    produce: &mut Produce<'_>,
) -> Result<(Packing, Vec<File>)> {
    if u32::try_from(outline.count).is_err() {
        let limit = (u32::MAX.into(), "its format");
        return Err(Error::too_large("an SPZ", (outline.count, "Gaussians"), limit));
    }
    let fractional_bits = fractional_bits(outline).ok_or_else(|| {
        let problem = format!("a mean lies at {}, too far out for SPZ", farthest(outline));
        let remedy = "crop (--crop-box) or shrink (--scale) the scene, or choose another format";
        Error::input(path, problem, remedy)
    })?;
    let packing = Packing { version, sh_degree: outline.sh_degree, fractional_bits };
    let files = spooled(produce, |mut block| {
        block.mirror(mirrored);
        packing.pack(&block)
    })?;
    Ok((packing, files))
}

/// Temporary files with what `parts` makes of each block, ready to be read from their start.
pub(super) fn spooled<const N: usize>(
    produce: &mut Produce<'_>,
    mut parts: impl FnMut(Gaussians) -> [Vec<u8>; N],
) -> Result<Vec<File>> {
    let mut files = (0..N).map(|_| temporary_file()).collect::<Result<Vec<_>>>()?;
    produce(&mut |block| {
        let mut pairs = files.iter_mut().zip(parts(block));
        pairs.try_for_each(|(file, part)| file.write_all(&part).map_err(temporary))
    })?;
    files.into_iter().map(rewound).collect()
}

fn temporary_file() -> Result<BufWriter<File>> {
    tempfile::tempfile().map(BufWriter::new).map_err(temporary)
}

fn temporary(source: io::Error) -> Error {
    Error::io(std::env::temp_dir(), "write a temporary file", source)
}

fn rewound(file: BufWriter<File>) -> Result<File> {
    let mut file = file.into_inner().map_err(|e| temporary(e.into_error()))?;
    file.rewind().map_err(temporary)?;
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
