//! Reads SPZ, versions 2 and 3 (one gzip stream) and 4 (a zstd stream for each attribute).

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::GzDecoder;

use super::spz_pack::{MIRRORED, PLANES, Packing};
use super::{BLOCK, Format, Header, Sink, Source, origin_file};
use crate::{cost, regular_file};
use ashsplat::{Error, Result};

/// "NGSP" as a little-endian number.
pub(super) const MAGIC: u32 = 0x5053_474e;
pub(super) const FLAG_ANTIALIASED: u8 = 1;
const FLAG_EXTENSIONS: u8 = 2;
/// Length of the header of version 4.
pub(super) const HEADER_BYTES: u64 = 32;
/// Length of the header of versions 2 and 3, inside the gzip stream.
const OLD_HEADER_BYTES: usize = 16;
/// Largest credible ratio of unpacked to packed size: deflate cannot exceed it, and zstd does not with splats.
const MAX_RATIO: u64 = 1032;
/// Bits of a coordinate, which its fractional bits cannot exceed.
const MAX_FRACTIONAL_BITS: u32 = 24;
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
    mirrored: [bool; 3],
    header: Header,
}

/// A reader that ends at the end of the SPZ.
type Bytes = BufReader<io::Take<File>>;

/// Location of the planes.
enum Layout {
    /// All planes in one gzip stream, followed by at most `extensions` bytes of extensions.
    Gzip { extensions: u64 },
    /// Offset and length of each plane's zstd stream; `None` for planes without data.
    Zstd([Option<(u64, u64)>; PLANES]),
}

/// The fields that both headers share.
struct Head {
    packing: Packing,
    count: u64,
    flags: u8,
}

impl Spz {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let (_, bytes) = regular_file::open(path)?;
        let mut spz = Self::inside(path, 0, bytes)?;
        spz.header.origin = origin_file::read(path)?;
        Ok(spz)
    }

    /// Opens an SPZ inside a file: `bytes` bytes from `offset`.
    pub(super) fn inside(path: &Path, offset: u64, bytes: u64) -> Result<Self> {
        let io = |source| Error::io(path, "read", source);
        let file = SpzFile { path: path.to_owned(), offset, bytes };
        let mut reader = file.from(0)?;
        let mut start = Vec::new();
        reader.by_ref().take(4).read_to_end(&mut start).map_err(io)?;
        let reader = file.from(0)?;
        match start.as_slice() {
            [0x1f, 0x8b, ..] => file.gzip(reader),
            b"NGSP" => file.zstd(reader),
            [] => Err(Error::input(path, "is empty", "download or copy it again")),
            _ => Err(file.damaged("is no SPZ: neither gzip nor an SPZ header")),
        }
    }

    /// The same SPZ without a conversion of axes: numbers are used as stored.
    pub(super) fn without_axes(self) -> Self {
        Self { mirrored: [false; 3], ..self }
    }

    /// Opens all planes at their beginning.
    fn planes(&self) -> Result<Vec<Plane<'_>>> {
        let mut before = OLD_HEADER_BYTES as u64;
        let mut planes = Vec::new();
        for (index, row_bytes) in self.packing.row_bytes().into_iter().enumerate() {
            let bytes = self.header.count * row_bytes as u64;
            let name = NAMES[index];
            let stream: Box<dyn Read> = match &self.layout {
                Layout::Zstd(places) => match places[index] {
                    None => Box::new(io::empty()),
                    Some((at, packed)) => {
                        let io = |source| Error::io(&self.file.path, "read", source);
                        let stream = self.file.from(at)?.take(packed);
                        let mut decoder = zstd::stream::read::Decoder::new(stream).map_err(io)?;
                        decoder.window_log_max(window_log(bytes)).map_err(io)?;
                        Box::new(decoder)
                    }
                },
                // The stream before a plane is unpacked again: in total up to four times the file's data, twice with
                // all harmonics.
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
        let limit = match self.layout {
            Layout::Gzip { extensions } => extensions,
            Layout::Zstd(_) => 0,
        };
        // Only the last plane's reader reaches the end of the gzip stream.
        let skipped = if matches!(self.layout, Layout::Gzip { .. }) { PLANES - 1 } else { 0 };
        for mut plane in planes.into_iter().skip(skipped) {
            let rest = io::copy(&mut (&mut plane.stream).take(limit + 1), &mut io::sink());
            let rest = rest.map_err(|e| plane.broken(&e))?;
            if rest > limit {
                let problem = match self.layout {
                    Layout::Gzip { .. } => {
                        format!("holds more data than its {} Gaussians need", self.header.count)
                    }
                    Layout::Zstd(_) => format!("{}: unpacks to more than {} bytes", plane.name, plane.bytes),
                };
                return Err(self.file.damaged(problem));
            }
        }
        Ok(())
    }
}

/// Largest window of a plane's decoder, as a power of two. All planes are decoded at once, and zstd's own bound would
/// be 128 MiB for each. The minimum suffices for its levels up to 19 at any length.
fn window_log(bytes: u64) -> u32 {
    bytes.max(1).next_power_of_two().trailing_zeros().clamp(23, 27)
}

impl Source for Spz {
    fn header(&self) -> &Header {
        &self.header
    }

    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()> {
        let count = self.header.count as usize;
        let row_bytes = self.packing.row_bytes();
        let mut planes = self.planes()?;
        let mut packed: [Vec<u8>; PLANES] = Default::default();
        for start in (0..count).step_by(BLOCK) {
            let rows = BLOCK.min(count - start);
            for ((plane, packed), row_bytes) in planes.iter_mut().zip(&mut packed).zip(row_bytes) {
                packed.resize(rows * row_bytes, 0);
                plane.fill(packed)?;
            }
            let mut block = self.packing.unpack(&packed, 0..rows);
            block.mirror(self.mirrored);
            sink(block)?;
        }
        self.finish(planes)
    }
}

/// One attribute of all Gaussians, while it is unpacked.
struct Plane<'a> {
    file: &'a SpzFile,
    name: &'static str,
    stream: Box<dyn Read>,
    /// Expected number of bytes.
    bytes: u64,
    /// Bytes read so far.
    read: u64,
}

impl Plane<'_> {
    fn fill(&mut self, packed: &mut [u8]) -> Result<()> {
        let mut rest = packed;
        while !rest.is_empty() {
            match self.stream.read(rest) {
                Ok(0) => {
                    let Self { name, bytes, read, .. } = self;
                    let problem = format!("{name}: {bytes} bytes are needed, the data end after {read}");
                    return Err(self.file.damaged(problem));
                }
                Ok(read) => {
                    self.read += read as u64;
                    rest = &mut rest[read..];
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.broken(&e)),
            }
        }
        Ok(())
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
        let io = |source| Error::io(&self.path, "read", source);
        let (mut file, _) = regular_file::open(&self.path)?;
        file.seek(SeekFrom::Start(self.offset + at)).map_err(io)?;
        Ok(BufReader::new(file.take(self.bytes.saturating_sub(at))))
    }

    fn damaged(&self, problem: impl Into<String>) -> Error {
        Error::input(&self.path, problem, "the file is damaged or cut short: write or download it again")
    }

    /// Checks the fields that both headers share.
    fn head(&self, bytes: &[u8]) -> Result<Head> {
        let number = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let (version, count) = (number(4), u64::from(number(8)));
        let (sh_degree, fractional_bits) = (u32::from(bytes[12]), u32::from(bytes[13]));
        if number(0) != MAGIC {
            return Err(self.damaged("is no SPZ: its header does not begin with NGSP"));
        }
        if !(2..=4).contains(&version) {
            let remedy = "write it again with a newer program";
            return Err(Error::input(
                &self.path,
                format!("is SPZ version {version}; 2, 3 and 4 are known"),
                remedy,
            ));
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
        if fractional_bits > MAX_FRACTIONAL_BITS {
            return Err(self.damaged(format!("the header says {fractional_bits} fractional bits")));
        }
        let packing = Packing { version, sh_degree, fractional_bits };
        let needed = count * packing.row_bytes().iter().sum::<usize>() as u64;
        if needed > self.bytes.saturating_mul(MAX_RATIO) {
            let problem =
                format!("the header says {count} Gaussians, which {} bytes cannot hold", self.bytes);
            return Err(self.damaged(problem));
        }
        Ok(Head { packing, count, flags: bytes[14] })
    }

    fn gzip(self, reader: Bytes) -> Result<Spz> {
        let mut stream = GzDecoder::new(reader);
        let mut start = [0; OLD_HEADER_BYTES];
        stream
            .read_exact(&mut start)
            .map_err(|e| self.damaged(format!("header: it cannot be unpacked: {e}")))?;
        let head = self.head(&start)?;
        if head.packing.version == 4 {
            return Err(self.damaged("is SPZ version 4 inside gzip, which the format does not have"));
        }
        let mut extensions = Vec::new();
        let mut limit = 0;
        if head.flags & FLAG_EXTENSIONS != 0 {
            // The extensions follow all planes, but the first Gaussians need them.
            limit = MAX_EXTENSION_BYTES;
            let planes = head.count * head.packing.row_bytes().iter().sum::<usize>() as u64;
            self.skip(&mut stream, planes, "planes")?;
            let read = stream.take(limit + 1).read_to_end(&mut extensions);
            read.map_err(|e| self.damaged(format!("the gzip stream is damaged: {e}")))?;
        }
        self.finish(head, Layout::Gzip { extensions: limit }, &extensions)
    }

    /// Unpacks and discards `bytes`.
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

    fn zstd(self, mut reader: Bytes) -> Result<Spz> {
        let io = |source| Error::io(&self.path, "read", source);
        if self.bytes < HEADER_BYTES {
            return Err(
                self.damaged(format!("ends after {} of the header's {HEADER_BYTES} bytes", self.bytes))
            );
        }
        let mut start = [0; HEADER_BYTES as usize];
        reader.read_exact(&mut start).map_err(io)?;
        let head = self.head(&start)?;
        if head.packing.version != 4 {
            return Err(self.damaged(format!("is SPZ version {} without gzip", head.packing.version)));
        }
        let expected: Vec<usize> =
            (0..PLANES).filter(|&plane| head.count * head.packing.row_bytes()[plane] as u64 > 0).collect();
        let table = u64::from(u32::from_le_bytes([start[16], start[17], start[18], start[19]]));
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
        reader.read_exact(&mut extensions).map_err(io)?;
        let mut sizes = vec![[0; 16]; expected.len()];
        reader.read_exact(sizes.as_flattened_mut()).map_err(io)?;
        let mut places = [None; PLANES];
        for (plane, size) in expected.into_iter().zip(sizes) {
            let [packed, unpacked] = [0, 8].map(|from| {
                size[from..from + 8].iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
            });
            let needed = head.count * head.packing.row_bytes()[plane] as u64;
            let end = at.checked_add(packed).filter(|&end| end <= self.bytes);
            let name = NAMES[plane];
            let Some(end) = end else {
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
        if head.flags & FLAG_EXTENSIONS == 0 {
            extensions.clear();
        }
        self.finish(head, Layout::Zstd(places), &extensions)
    }

    fn finish(self, head: Head, layout: Layout, extensions: &[u8]) -> Result<Spz> {
        let mut warnings = Vec::new();
        let mirrored =
            match axes(extensions) {
                Ok((mirrored, unused)) => {
                    warnings.extend(unused.into_iter().map(|kind| {
                        format!("{}: the extension {kind:#010x} is not used", self.path.display())
                    }));
                    mirrored
                }
                Err(problem) => {
                    let remedy = "write it again with the axes right, up, back";
                    return Err(Error::input(&self.path, problem, remedy));
                }
            };
        if head.packing.sh_degree > 3 {
            warnings
                .push(format!("{}: SH of degree 4 are left out, 3 is the highest here", self.path.display()));
        }
        let header = Header {
            antialiased: head.flags & FLAG_ANTIALIASED != 0,
            warnings,
            ..Header::new(Format::Spz, head.count, head.packing.sh_degree.min(3))
        };
        Ok(Spz { file: self, packing: head.packing, layout, mirrored, header })
    }
}

/// Names of the planes.
const NAMES: [&str; PLANES] = ["means", "opacities", "colours", "scales", "rotations", "spherical harmonics"];

/// The axes to mirror, those of the format unless an extension declares others; and the unknown extensions that change
/// the scene.
fn axes(mut extensions: &[u8]) -> Result<([bool; 3], Vec<u32>), String> {
    let (mut mirrored, mut unused) = (MIRRORED, Vec::new());
    while let Some((head, rest)) = extensions.split_first_chunk::<8>() {
        let [kind, length] =
            [0, 4].map(|at| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]));
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
