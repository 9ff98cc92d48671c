//! Detects the format of a file.

use std::path::Path;

use super::foreign::{first_bytes, foreign};
use super::format::Format;
use crate::{ply, sniff};
use ashsplat::{Error, Result};

impl Format {
    /// The format of a file by its first bytes, or by its name if they are ambiguous.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read, [`Error::Input`] when it has none of the formats.
    pub fn of_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let start = first_bytes(path)?;
        if let Some(error) = foreign(path) {
            return Err(error);
        }
        let by_name = Self::by_name(path);
        let by_content = match start.as_slice() {
            [b'p', b'l', b'y', b'\n' | b'\r', ..] => Some(ply_kind(path)?),
            [b'N', b'G', b'S', b'P', ..] => Some(Self::Spz),
            [b'g', b'l', b'T', b'F', ..] => Some(Self::Glb),
            [0x1f, 0x8b, ..] if by_name.is_none() => Some(Self::Spz),
            _ => None,
        };
        if let Some(format) = by_content.or(by_name) {
            return Ok(format);
        }
        let known = Self::ALL.map(Self::extension).join(" ");
        let (problem, remedy) =
            sniff::recognise(&start).unwrap_or(("is no file of Gaussians that is known", ""));
        let remedy = if remedy.is_empty() { format!("known are {known}") } else { remedy.to_owned() };
        Err(Error::input(path, problem, remedy))
    }
}

fn ply_kind(path: &Path) -> Result<Format> {
    Ok(if ply::is_compressed(path)? { Format::CompressedPly } else { Format::Ply })
}
