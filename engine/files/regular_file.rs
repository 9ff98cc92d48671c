//! Opens files for reading. It refuses pipes, which would make the reader wait, and devices, which may have no end.
//! Recognises files whose content does not match their name.

use std::fs::{self, File, Metadata};
use std::io::{BufReader, Read, Seek, SeekFrom, Take};
use std::path::Path;

use crate::cost;
use crate::host_memory::{self, HostMemory, Lease};
use ashsplat::scene::Fingerprint;
use ashsplat::{Error, Result};

/// Largest memory of a list, an object or an element, per comma or opening bracket of its JSON. A map with one key is
/// the worst: it reserves 630 bytes for three of these characters.
const JSON_ITEM_BYTES: u64 = 210;

/// Names the file and the action in an error of the system.
pub(crate) trait OnFile<T>: Sized {
    fn on(self, path: impl AsRef<Path>, action: &'static str) -> Result<T>;

    fn reading(self, path: impl AsRef<Path>) -> Result<T> {
        self.on(path, "read")
    }

    fn writing(self, path: impl AsRef<Path>) -> Result<T> {
        self.on(path, "write")
    }
}

impl<T> OnFile<T> for std::io::Result<T> {
    fn on(self, path: impl AsRef<Path>, action: &'static str) -> Result<T> {
        self.map_err(|source| Error::io(path, action, source))
    }
}

/// Opens a regular file. Returns it with its length in bytes.
///
/// # Errors
/// [`Error::Io`]; [`Error::Input`] for a folder, a device, a pipe or a socket.
#[allow(clippy::disallowed_methods)]
pub fn open(path: impl AsRef<Path>) -> Result<(File, u64)> {
    let path = path.as_ref();
    cost::step();
    // Checked before opening, because opening a pipe waits for its writer.
    check_kind(path, &fs::metadata(path).reading(path)?)?;
    let file = File::open(path).reading(path)?;
    // Another file may have taken the name since the check.
    let metadata = file.metadata().reading(path)?;
    check_kind(path, &metadata)?;
    Ok((file, metadata.len()))
}

/// The first bytes of a regular file, `max_bytes` at most.
pub(crate) fn start(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let mut start = Vec::new();
    open(path)?.0.take(max_bytes).read_to_end(&mut start).reading(path)?;
    Ok(start)
}

/// The error of a file whose content contradicts itself.
pub(crate) fn damaged(path: &Path, problem: impl Into<String>) -> Error {
    Error::input(path, problem, "the file is damaged or cut short: write or download it again")
}

/// Opens `bytes` bytes of a regular file, from byte `at` on.
pub(crate) fn part(path: &Path, at: u64, bytes: u64) -> Result<BufReader<Take<File>>> {
    let (mut file, _) = open(path)?;
    file.seek(SeekFrom::Start(at)).reading(path)?;
    Ok(BufReader::new(file.take(bytes)))
}

/// Passes `count` rows of `row_bytes` bytes each to `row`, through a buffer.
pub(crate) fn rows(
    path: &Path,
    reader: &mut impl Read,
    (count, row_bytes): (u64, usize),
    mut row: impl FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    const BUFFER_BYTES: usize = 1 << 20;
    let buffer_rows = (BUFFER_BYTES / row_bytes).max(1) as u64;
    let mut buffer = vec![0; row_bytes * buffer_rows.min(count) as usize];
    let mut left = count;
    while left > 0 {
        let bytes = &mut buffer[..row_bytes * buffer_rows.min(left) as usize];
        reader.read_exact(bytes).reading(path)?;
        left -= buffer_rows.min(left);
        for bytes in bytes.chunks_exact(row_bytes) {
            cost::step();
            row(bytes)?;
        }
    }
    Ok(())
}

fn check_kind(path: &Path, metadata: &Metadata) -> Result<()> {
    if metadata.is_file() {
        return Ok(());
    }
    let (kind, remedy) = match metadata.is_dir() {
        true => ("a folder", "give the path of a file"),
        false => ("a device or a pipe", "save its contents to a file, and give that"),
    };
    Err(Error::input(path, format!("is not a file but {kind}"), remedy))
}

/// Reads a file, if the machine has free memory for `growth` times its size.
pub fn read(path: impl AsRef<Path>, growth: u64) -> Result<Vec<u8>> {
    let path = path.as_ref();
    let (file, length) = open(path)?;
    host_memory::check_free(path, length.saturating_mul(growth))?;
    contents(path, file, length)
}

/// Same as [`read`], within a memory budget. The lease counts `growth` times the file's size until it is dropped.
pub(crate) fn read_within(path: &Path, growth: u64, memory: &HostMemory) -> Result<(Vec<u8>, Lease)> {
    let (file, length) = open(path)?;
    let lease = memory.take(path, length.saturating_mul(growth))?;
    Ok((contents(path, file, length)?, lease))
}

/// Reads the text of a JSON file, if the machine has free memory for it and for its parsed contents.
pub fn read_json(path: impl AsRef<Path>) -> Result<Vec<u8>> {
    let text = read(&path, 1)?;
    check_json(path.as_ref(), &text, None)?;
    Ok(text)
}

/// Refuses a JSON text whose parsed contents would exceed the budget.
pub(crate) fn check_json(path: &Path, text: &[u8], limit: Option<u64>) -> Result<()> {
    let items = text.iter().filter(|byte| b",[{".contains(byte)).count() as u64;
    host_memory::check(path, 2 * text.len() as u64 + JSON_ITEM_BYTES * items, limit)
}

/// Reads a file; `None` if it has more than `max_bytes` bytes.
pub fn read_at_most(path: impl AsRef<Path>, max_bytes: u64) -> Result<Option<Vec<u8>>> {
    let path = path.as_ref();
    let (file, length) = open(path)?;
    (length <= max_bytes).then(|| contents(path, file, length)).transpose()
}

/// Reads no more than the length at opening: some system files have no length and never end.
fn contents(path: &Path, file: File, length: u64) -> Result<Vec<u8>> {
    let mut bytes = host_memory::reserved(path, length)?;
    file.take(length).read_to_end(&mut bytes).reading(path)?;
    Ok(bytes)
}

pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// The actual kind of a file by its first bytes, and the remedy; `None` if it is not recognised.
///
/// The problem is worded to follow "this ", e.g. "is a Git LFS pointer, not the file itself".
pub(crate) fn recognise(start: &[u8]) -> Option<(&'static str, &'static str)> {
    const BY_MAGIC: [(&[u8], &str, &str); 4] = [
        (
            b"version https://git-lfs",
            "is a Git LFS pointer, not the file itself",
            "run `git lfs pull` in its repository",
        ),
        (&[0x1f, 0x8b], "is compressed with gzip", "unpack it with `gunzip` first"),
        (b"PK\x03\x04", "is a ZIP archive", "unpack it first"),
        (&[0x28, 0xb5, 0x2f, 0xfd], "is compressed with zstd", "unpack it with `unzstd` first"),
    ];
    const TAGS: [&[u8]; 4] = [b"<!doctype", b"<html", b"<?xml", b"<head"];
    if start.is_empty() {
        return Some(("is empty", "download or copy it again"));
    }
    let by_magic = BY_MAGIC.iter().find(|(magic, ..)| start.starts_with(magic));
    let known = by_magic.map(|&(_, what, remedy)| (what, remedy)).or_else(|| picture(start));
    if let Some(kind) = known.or_else(|| utf16(start)) {
        return Some(kind);
    }
    if start.iter().all(|&byte| byte == 0) {
        return Some(("starts with nothing but zeros", "the download or copy was cut short: repeat it"));
    }
    let text = start.trim_ascii_start().to_ascii_lowercase();
    let is_page = TAGS.iter().any(|tag| text.starts_with(tag));
    is_page.then_some(("is a web page", "download the file itself (its raw or direct link)"))
}

/// Recognises UTF-16 text by its byte-order mark and a first letter of ASCII.
pub(crate) fn utf16(start: &[u8]) -> Option<(&'static str, &'static str)> {
    let is_text = matches!(start, [0xff, 0xfe, 1..=255, 0, ..] | [0xfe, 0xff, 0, 1..=255, ..]);
    is_text.then_some(("is text in UTF-16", "save it in UTF-8"))
}

/// Recognises pictures other than JPEG and PNG. The tools named here keep sizes and names, so that the cameras fit.
fn picture(start: &[u8]) -> Option<(&'static str, &'static str)> {
    const CONVERT: &str = "convert it to PNG or JPEG of the same size";
    let heic =
        "convert it to JPEG (`heif-convert a.heic a.jpg`, or sips on macOS) before the cameras are computed";
    let video = "`ashsplat poses VIDEO` takes frames from it and makes a data set of them";
    let brand = start.get(8..12).filter(|_| start.get(4..8) == Some(b"ftyp"));
    match brand {
        Some(b"heic" | b"heix" | b"heim" | b"heis" | b"hevc" | b"mif1" | b"msf1") => {
            Some(("is a HEIC photo, as iPhones take them", heic))
        }
        Some(b"avif" | b"avis") => Some(("is an AVIF picture", CONVERT)),
        Some(b"qt  " | b"isom" | b"mp41" | b"mp42" | b"M4V ") => Some(("is a video", video)),
        _ if start.starts_with(b"RIFF") && start.get(8..12) == Some(b"WEBP") => {
            Some(("is a WebP picture", CONVERT))
        }
        _ if start.starts_with(b"II*\0") || start.starts_with(b"MM\0*") => {
            Some(("is a TIFF or a raw photo", CONVERT))
        }
        _ => None,
    }
}

/// Bytes that are added at a time. The hash depends on this size.
const PIECE: usize = 1 << 20;

/// The hash of a file's bytes: [`Fingerprint`] of pieces of one mebibyte, 16 hexadecimal digits. It detects damage, not
/// forgery. Holds one piece in memory.
pub fn file_hash(path: impl AsRef<Path>) -> Result<String> {
    let path = path.as_ref();
    let (file, length) = open(path)?;
    let mut file = file.take(length);
    let mut print = Fingerprint::new();
    let mut piece = Vec::with_capacity(PIECE);
    loop {
        piece.clear();
        file.by_ref().take(PIECE as u64).read_to_end(&mut piece).reading(path)?;
        print.add(&piece);
        if piece.len() < PIECE {
            return Ok(format!("{:016x}", print.finish()));
        }
    }
}
