//! Reading SPZ, versions 2 and 3 (one gzip stream) and 4 (a zstd stream for each attribute).

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::GzDecoder;

use super::spz_pack::{MIRRORED, PLANES, Packing};
use super::{BLOCK, Format, Header, Sink, Source};
use crate::host_memory;
use ashsplat::{Error, Result};

/// "NGSP" as a little-endian number.
pub(super) const MAGIC: u32 = 0x5053_474e;
pub(super) const FLAG_ANTIALIASED: u8 = 1;
const FLAG_EXTENSIONS: u8 = 2;
/// Length of the header of version 4.
pub(super) const HEADER_BYTES: u64 = 32;
/// Length of the header of versions 2 and 3, inside the gzip stream.
const OLD_HEADER_BYTES: usize = 16;
/// No valid file unpacks to more than this many times its size (deflate cannot; zstd does not with splats).
const MAX_RATIO: u64 = 1032;
/// A coordinate cannot have more fractional bits than bits.
const MAX_FRACTIONAL_BITS: u32 = 24;
/// Extensions are a few numbers.
const MAX_EXTENSION_BYTES: u64 = 1 << 20;
/// The extension that names the axes (Adobe).
const EXTENSION_AXES: u32 = 0xadbe_0003;

/// An SPZ in memory, packed.
pub(super) struct Spz {
    packing: Packing,
    planes: [Vec<u8>; PLANES],
    /// Axes to mirror after unpacking.
    mirrored: [bool; 3],
    header: Header,
}

/// The fields that both headers have.
struct Head {
    packing: Packing,
    count: u64,
    flags: u8,
}

impl Spz {
    pub(super) fn open(path: &Path, max_host_memory: Option<u64>) -> Result<Self> {
        let io = |source| Error::io(path, "read", source);
        let file = File::open(path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let mut open = Open { path: path.to_owned(), bytes, reader: BufReader::new(file), max_host_memory };
        let mut start = Vec::new();
        open.reader.by_ref().take(4).read_to_end(&mut start).map_err(io)?;
        open.reader.rewind().map_err(io)?;
        match start.as_slice() {
            [0x1f, 0x8b, ..] => open.gzip(),
            b"NGSP" => open.zstd(),
            [] => Err(Error::input(path, "is empty", "download or copy it again")),
            _ => Err(open.damaged("is no SPZ: neither gzip nor an SPZ header")),
        }
    }
}

impl Source for Spz {
    fn header(&self) -> &Header {
        &self.header
    }

    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()> {
        let count = self.header.count as usize;
        for start in (0..count).step_by(BLOCK) {
            let mut block = self.packing.unpack(&self.planes, start..(start + BLOCK).min(count));
            block.mirror(self.mirrored);
            sink(block)?;
        }
        Ok(())
    }

    fn held_bytes(&self) -> u64 {
        self.planes.iter().map(|plane| plane.len() as u64).sum()
    }
}

struct Open {
    path: PathBuf,
    bytes: u64,
    reader: BufReader<File>,
    max_host_memory: Option<u64>,
}

impl Open {
    fn damaged(&self, problem: impl Into<String>) -> Error {
        Error::input(&self.path, problem, "the file is damaged or cut short: write or download it again")
    }

    /// Checks the fields that both kinds of header have.
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
        host_memory::check(&self.path, needed, self.max_host_memory)?;
        Ok(Head { packing, count, flags: bytes[14] })
    }

    fn gzip(mut self) -> Result<Spz> {
        let file = std::mem::replace(
            &mut self.reader,
            BufReader::new(File::open(&self.path).map_err(|e| Error::io(&self.path, "read", e))?),
        );
        let mut stream = GzDecoder::new(file);
        let start = self.unpacked(&mut stream, OLD_HEADER_BYTES as u64, "header")?;
        let head = self.head(&start)?;
        if head.packing.version == 4 {
            return Err(self.damaged("is SPZ version 4 inside gzip, which the format does not have"));
        }
        let mut planes: [Vec<u8>; PLANES] = Default::default();
        for (plane, (row, name)) in planes.iter_mut().zip(head.packing.row_bytes().into_iter().zip(NAMES)) {
            *plane = self.unpacked(&mut stream, head.count * row as u64, name)?;
        }
        // Reading to the end checks the stream's checksum.
        let mut rest = Vec::new();
        let limit = if head.flags & FLAG_EXTENSIONS == 0 { 0 } else { MAX_EXTENSION_BYTES };
        (&mut stream)
            .take(limit + 1)
            .read_to_end(&mut rest)
            .map_err(|e| self.damaged(format!("the gzip stream is damaged: {e}")))?;
        if rest.len() as u64 > limit {
            return Err(self.damaged(format!("holds more data than its {} Gaussians need", head.count)));
        }
        self.finish(head, planes, &rest)
    }

    /// Reads exactly this many bytes. Memory grows with the data received, not with the header's count.
    fn unpacked(&self, stream: &mut impl Read, bytes: u64, what: &str) -> Result<Vec<u8>> {
        let mut data = Vec::new();
        let read = stream.take(bytes).read_to_end(&mut data);
        read.map_err(|e| self.damaged(format!("{what}: the compressed data are damaged: {e}")))?;
        if (data.len() as u64) < bytes {
            return Err(
                self.damaged(format!("{what}: {bytes} bytes are needed, the data end after {}", data.len()))
            );
        }
        data.shrink_to_fit();
        Ok(data)
    }

    fn zstd(mut self) -> Result<Spz> {
        let io_path = self.path.clone();
        let io = |source| Error::io(&io_path, "read", source);
        if self.bytes < HEADER_BYTES {
            return Err(
                self.damaged(format!("ends after {} of the header's {HEADER_BYTES} bytes", self.bytes))
            );
        }
        let mut start = [0; HEADER_BYTES as usize];
        self.reader.read_exact(&mut start).map_err(io)?;
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
        self.reader.read_exact(&mut extensions).map_err(io)?;
        let mut sizes = vec![[0; 16]; expected.len()];
        self.reader.read_exact(sizes.as_flattened_mut()).map_err(io)?;
        let mut planes: [Vec<u8>; PLANES] = Default::default();
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
            self.reader.seek(SeekFrom::Start(at)).map_err(io)?;
            let file = &mut self.reader;
            let mut stream = zstd::stream::read::Decoder::new(Read::take(file, packed)).map_err(io)?;
            let mut data = Vec::new();
            let read = Read::take(&mut stream, needed + 1).read_to_end(&mut data);
            drop(stream);
            read.map_err(|e| self.damaged(format!("{name}: the compressed data are damaged: {e}")))?;
            if data.len() as u64 != needed {
                return Err(
                    self.damaged(format!("{name}: unpacks to {} bytes instead of {needed}", data.len()))
                );
            }
            planes[plane] = data;
            at = end;
        }
        if at != self.bytes {
            return Err(self.damaged(format!("has {} bytes after its last stream", self.bytes - at)));
        }
        if head.flags & FLAG_EXTENSIONS == 0 {
            extensions.clear();
        }
        self.finish(head, planes, &extensions)
    }

    fn finish(self, head: Head, planes: [Vec<u8>; PLANES], extensions: &[u8]) -> Result<Spz> {
        let mut warnings = Vec::new();
        let mirrored = match axes(extensions) {
            Ok(mirrored) => mirrored,
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
            format: Format::Spz,
            count: head.count,
            sh_degree: head.packing.sh_degree.min(3),
            antialiased: head.flags & FLAG_ANTIALIASED != 0,
            warnings,
        };
        Ok(Spz { packing: head.packing, planes, mirrored, header })
    }
}

/// Names of the planes.
const NAMES: [&str; PLANES] = ["means", "opacities", "colours", "scales", "rotations", "spherical harmonics"];

/// The axes to mirror: those of the format, unless an extension declares others.
fn axes(mut extensions: &[u8]) -> Result<[bool; 3], String> {
    while let Some((head, rest)) = extensions.split_first_chunk::<8>() {
        let [kind, length] =
            [0, 4].map(|at| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]));
        let Some((value, rest)) = rest.split_at_checked(length as usize) else {
            return Err("an extension in its header is longer than the header".into());
        };
        if kind == EXTENSION_AXES {
            // 1 to 8 are {left, right} × {down, up} × {back, forward}; 0 is unspecified; others exchange axes.
            return match *value {
                [0, 0, 0, 0] => Ok(MIRRORED),
                [code @ 1..=8, 0, 0, 0] => {
                    Ok([(code - 1) & 1 == 0, (code - 1) & 2 != 0, (code - 1) & 4 == 0])
                }
                _ => Err("its axes are exchanged (extension SPZ_ADOBE_coordinate_system)".into()),
            };
        }
        extensions = rest;
    }
    Ok(MIRRORED)
}
