//! File formats of Gaussians.

use std::path::Path;

use super::{Outline, origin_file};
use ashsplat::{Error, Result};
use glam::DVec3;

/// Bound of log-scales in both directions, as in the format's first writer.
pub(crate) const MAX_COMPRESSED_LOG_SCALE: f32 = 20.0;

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
    /// All formats.
    pub const ALL: [Self; 6] =
        [Self::Ply, Self::CompressedPly, Self::Splat, Self::Spz, Self::Glb, Self::Gltf];

    /// Names what Gaussians of this SH degree and with these header marks lose in the format.
    pub(super) fn losses(
        self,
        sh_degree: u32,
        (antialiased, kernel_size, is_2dgs): (bool, Option<f32>, bool),
    ) -> Vec<String> {
        let mut losses = Vec::new();
        if sh_degree > self.max_sh_degree() {
            losses.push(format!("{self} holds no spherical harmonics: the view dependence is lost"));
        }
        if antialiased && !self.keeps_antialiased() {
            losses.push(format!("{self} cannot say that the Gaussians want antialiasing"));
        }
        if let (Some(size), Self::Splat | Self::Spz) = (kernel_size, self) {
            losses.push(format!("{self} cannot hold the kernel size: draw it with --kernel-size {size}"));
        }
        if is_2dgs && !matches!(self, Self::Ply | Self::CompressedPly) {
            losses.push(format!("{self} cannot say that this is a 2DGS scene"));
        }
        losses
    }

    /// True if a file beside it holds the origin of the positions, because the format has no field for it.
    pub(super) fn has_origin_file(self) -> bool {
        matches!(self, Self::Splat | Self::Spz)
    }

    /// A note on the origin of the positions, if programs that ignore it would place the scene elsewhere.
    pub(super) fn origin_note(self, path: &Path, outline: &Outline) -> Option<String> {
        let DVec3 { x, y, z } = outline.frame.origin;
        let place = match self {
            _ if outline.frame.origin == DVec3::ZERO => return None,
            Self::Ply if outline.double_positions => return None,
            Self::Glb | Self::Gltf => return None,
            Self::Ply | Self::CompressedPly => "a comment in its header".to_owned(),
            Self::Splat | Self::Spz => origin_file::path_of(path).display().to_string(),
        };
        Some(format!("positions are relative to {x},{y},{z}, which {place} names"))
    }

    /// The extension of a file's name, with the dot.
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

    /// The highest SH degree that the format can hold.
    pub fn max_sh_degree(self) -> u32 {
        if self == Self::Splat { 0 } else { 3 }
    }

    /// True if the format can mark Gaussians as trained with antialiasing.
    pub fn keeps_antialiased(self) -> bool {
        !matches!(self, Self::Splat)
    }

    /// The format by a file's name.
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

    pub(super) fn by_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        // The longest of several matching extensions counts.
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
