//! Which format a file has.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::{ply, sniff};
use ashsplat::{Error, Result};

/// A format of files of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// PLY in the layout of the reference implementation: all parameters as floats.
    Ply,
    /// PlayCanvas' compressed PLY: 16 bytes and a byte for each higher SH value, in chunks of 256.
    CompressedPly,
    /// `.splat`: 32 bytes, no view dependence.
    Splat,
    /// Niantic's SPZ: packed attributes, compressed.
    Spz,
    /// Binary glTF with `KHR_gaussian_splatting`.
    Glb,
    /// glTF as JSON, with `KHR_gaussian_splatting` and a `.bin` beside it.
    Gltf,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Ply, Self::CompressedPly, Self::Splat, Self::Spz, Self::Glb, Self::Gltf];

    /// The ending of a file's name, with the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => ".ply",
            Self::CompressedPly => ".compressed.ply",
            Self::Splat => ".splat",
            Self::Spz => ".spz",
            Self::Glb => ".glb",
            Self::Gltf => ".gltf",
        }
    }

    /// The highest SH degree that it can hold.
    pub fn max_sh_degree(self) -> u32 {
        if self == Self::Splat { 0 } else { 3 }
    }

    /// Whether it can say that the Gaussians want antialiasing.
    pub fn keeps_antialiased(self) -> bool {
        !matches!(self, Self::Splat)
    }

    /// The format that a file's name promises.
    ///
    /// # Errors
    /// [`Error::Input`] for an unknown extension.
    pub fn of_extension(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::by_name(path).ok_or_else(|| {
            let known = Self::ALL.map(Self::extension).join(" ");
            Error::input(path, "has no extension of a known format", format!("give it one of {known}"))
        })
    }

    /// The format that a file has: by its first bytes, and where they say nothing, by its name.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read, [`Error::Input`] when it is in none of the formats.
    pub fn of_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let start = first_bytes(path)?;
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

    fn by_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        // The longer of two that fit.
        Self::ALL.into_iter().filter(|f| name.ends_with(f.extension())).max_by_key(|f| f.extension().len())
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Splat => ".splat",
            Self::Spz => "SPZ",
            Self::Glb => "GLB",
            Self::Gltf => "glTF",
        })
    }
}

fn ply_kind(path: &Path) -> Result<Format> {
    Ok(if ply::is_compressed(path)? { Format::CompressedPly } else { Format::Ply })
}

fn first_bytes(path: &Path) -> Result<Vec<u8>> {
    let io = |source| Error::io(path, "read", source);
    let file = File::open(path).map_err(io)?;
    if !file.metadata().map_err(io)?.is_file() {
        return Err(Error::input(path, "is not a file", "give the path of a file of Gaussians"));
    }
    let mut start = Vec::new();
    file.take(512).read_to_end(&mut start).map_err(io)?;
    Ok(start)
}
