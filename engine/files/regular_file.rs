//! Opens files for reading. It refuses pipes, which would make the reader wait, and devices, which may have no end.

use std::fs::{self, File, Metadata};
use std::io::Read;
use std::path::Path;

use super::host_memory::{self, HostMemory, Lease};
use ashsplat::{Error, Result};

/// Largest memory of a list, an object or an element, per comma or opening bracket of its JSON. A map with one key is
/// the worst: it reserves 630 bytes for three of these characters.
const JSON_ITEM_BYTES: u64 = 210;

/// Opens a regular file. Returns it with its length in bytes.
///
/// # Errors
/// [`Error::Io`]; [`Error::Input`] for a folder, a device, a pipe or a socket.
pub fn open(path: impl AsRef<Path>) -> Result<(File, u64)> {
    let path = path.as_ref();
    let io = |source| Error::io(path, "read", source);
    // Checked before opening, because opening a pipe waits for its writer.
    check_kind(path, &fs::metadata(path).map_err(io)?)?;
    let file = File::open(path).map_err(io)?;
    // Another file may have taken the name since the check.
    let metadata = file.metadata().map_err(io)?;
    check_kind(path, &metadata)?;
    Ok((file, metadata.len()))
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
///
/// # Errors
/// Same as [`open`]; [`Error::TooLarge`].
pub fn read(path: impl AsRef<Path>, growth: u64) -> Result<Vec<u8>> {
    let path = path.as_ref();
    let (file, length) = open(path)?;
    host_memory::check_free(path, length.saturating_mul(growth))?;
    contents(path, file, length)
}

/// Same as [`read`], within a memory budget. The lease holds the memory of the parsed contents.
pub(crate) fn read_within(path: &Path, growth: u64, memory: &HostMemory) -> Result<(Vec<u8>, Lease)> {
    let (file, length) = open(path)?;
    let lease = memory.take(path, length.saturating_mul(growth))?;
    Ok((contents(path, file, length)?, lease))
}

/// Reads the text of a JSON file, if the machine has free memory for it and for its parsed contents.
///
/// # Errors
/// Same as [`read`].
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

/// Reads a file; `None` if it has more than `most` bytes.
///
/// # Errors
/// Same as [`open`].
pub fn read_at_most(path: impl AsRef<Path>, most: u64) -> Result<Option<Vec<u8>>> {
    let path = path.as_ref();
    let (file, length) = open(path)?;
    (length <= most).then(|| contents(path, file, length)).transpose()
}

/// Reads no more than the length at opening: some system files have no length and never end.
fn contents(path: &Path, file: File, length: u64) -> Result<Vec<u8>> {
    let mut bytes = host_memory::reserved(path, length)?;
    file.take(length).read_to_end(&mut bytes).map_err(|source| Error::io(path, "read", source))?;
    Ok(bytes)
}
