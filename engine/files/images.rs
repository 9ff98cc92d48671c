//! Photographs: decoding, checking, scaling.

mod decode;
mod depth_map;
mod scale;

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use super::atomic;
use super::host_memory::HostMemory;
use crate::regular_file::OnFile;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};
use scale::RowScaler;

pub use ashsplat::scene::{Photo, PhotoFile, StoredPhoto};
pub use decode::photo_size;
pub(crate) use decode::{Decoded, Header, Request, header, read as read_as};
pub use depth_map::DepthMap;
pub use scale::undistort;

/// Widest picture that [`Resolution::Auto`] does not scale, pixels.
pub const AUTO_MAX_WIDTH: u32 = 1600;

/// Reads, writes and scales a [`Photo`].
pub trait PhotoFileFormat: Sized {
    /// Reads a JPEG or PNG of any colour type; transparent pixels show `background` (r, g, b in [0, 1]).
    ///
    /// Ignores the orientation in a photo's metadata, as COLMAP, Pillow and stb_image do. Data sets may apply it if
    /// their cameras have the size of the rotated photos: see
    /// [`super::dataset::DatasetOptions::orientation`].
    fn read(path: impl AsRef<Path>, background: [f32; 3]) -> Result<Self> {
        Self::read_within(path, background, &HostMemory::default())
    }

    /// Same as [`PhotoFileFormat::read`], within a memory budget.
    fn read_within(path: impl AsRef<Path>, background: [f32; 3], memory: &HostMemory) -> Result<Self>;

    /// Writes a PNG.
    fn write_png(&self, path: impl AsRef<Path>) -> Result<()>;

    /// The picture at another size, by bicubic interpolation over the covered area (the filter of the reference
    /// implementation, which scales with Pillow's default).
    fn scaled_to(self, width: u32, height: u32) -> Result<Self>;
}

impl PhotoFileFormat for Photo {
    fn read_within(path: impl AsRef<Path>, background: [f32; 3], memory: &HostMemory) -> Result<Self> {
        Ok(decode::read(path.as_ref(), &Request::plain(Some(background), memory))?.photo)
    }

    fn write_png(&self, path: impl AsRef<Path>) -> Result<()> {
        use image::ImageEncoder;
        self.check_shape()?;
        atomic::write(path, |writer| {
            let encoder = image::codecs::png::PngEncoder::new(writer);
            let color = image::ExtendedColorType::Rgb8;
            encoder.write_image(&self.rgb, self.width, self.height, color).map_err(std::io::Error::other)
        })
    }

    fn scaled_to(self, width: u32, height: u32) -> Result<Self> {
        self.check_shape()?;
        if (width, height) == (self.width, self.height) {
            return Ok(self);
        }
        for [width, height] in [[width, height], [self.width, self.height]] {
            let sides = 1..=MAX_IMAGE_SIDE;
            if !sides.contains(&width) || !sides.contains(&height) {
                let problem = format!("{width}x{height} is outside 1x1 to {MAX_IMAGE_SIDE} a side");
                return Err(Error::argument("image size", problem));
            }
        }
        let rgb = Vec::with_capacity(3 * width as usize * height as usize);
        let mut scaler = RowScaler::new([self.width, self.height], [width, height], rgb);
        self.rgb.chunks_exact(3 * self.width as usize).for_each(|row| scaler.push(row));
        Ok(Self { width, height, rgb: scaler.finish() })
    }
}

/// Memory budget of photos, and the folder for photos that exceed it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhotoMemory {
    /// Budget of all photos held at a time, in host and device memory together, while training, bytes.
    pub bytes: u64,
    /// Folder on a disk with free space for four bytes per pixel.
    pub folder: PathBuf,
}

impl PhotoMemory {
    /// Creates a file without a name for photos; it is removed with the value.
    pub fn create_file(&self) -> Result<Arc<PhotoFile>> {
        let file = tempfile::tempfile_in(&self.folder).on(&self.folder, "create a file")?;
        Ok(PhotoFile::new(file, self.folder.clone(), self.bytes))
    }
}

/// The folder, or its nearest parent that exists.
pub fn existing_folder(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    absolute.ancestors().find(|folder| folder.is_dir()).map_or_else(std::env::temp_dir, Path::to_owned)
}

/// Rotation of photos by their metadata (Exif).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PhotoOrientation {
    /// Photos are used as stored, unless their cameras have the sizes of the rotated photos.
    #[default]
    Auto,
    /// Photos are used as stored.
    Stored,
    /// Rotated by the metadata.
    Upright,
}

impl FromStr for PhotoOrientation {
    type Err = Error;

    /// `auto`, `stored` or `upright`.
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "auto" => Ok(Self::Auto),
            "stored" => Ok(Self::Stored),
            "upright" => Ok(Self::Upright),
            _ => Err(Error::argument("orientation", format!("'{text}' is not auto, stored or upright"))),
        }
    }
}

/// The size at which photos are used (`-r`, `--resolution`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resolution {
    /// Unchanged up to a width of 1600 pixels; wider photos are scaled to 1600 (`-1`).
    #[default]
    Auto,
    /// Both sides divided by 1, 2, 4 or 8.
    Factor(u32),
    /// Scaled to this width in pixels.
    Width(u32),
}

impl Resolution {
    /// The size of a photo of `width` × `height` pixels under this setting; at least 1×1.
    ///
    /// Rounds like the reference implementation: factors to the nearest, ties to even; widths down.
    pub fn apply(self, width: u32, height: u32) -> (u32, u32) {
        let to_width = |target: u32| {
            let scale = f64::from(width) / f64::from(target.max(1));
            (target.max(1), ((f64::from(height) / scale) as u32).max(1))
        };
        match self {
            Self::Auto if width > AUTO_MAX_WIDTH => to_width(AUTO_MAX_WIDTH),
            Self::Auto => (width, height),
            Self::Factor(factor) => {
                let divided = |side: u32| {
                    ((f64::from(side) / f64::from(factor.max(1))).round_ties_even() as u32).max(1)
                };
                (divided(width), divided(height))
            }
            Self::Width(target) => to_width(target),
        }
    }
}

impl FromStr for Resolution {
    type Err = Error;

    /// `-1` or `auto`, `1`, `2`, `4`, `8`, or a width in pixels.
    fn from_str(text: &str) -> Result<Self> {
        match text.parse::<i64>() {
            Ok(-1) => Ok(Self::Auto),
            Ok(factor @ (1 | 2 | 4 | 8)) => Ok(Self::Factor(factor as u32)),
            Ok(width) if (9..=i64::from(MAX_IMAGE_SIDE)).contains(&width) => Ok(Self::Width(width as u32)),
            Err(_) if text == "auto" => Ok(Self::Auto),
            _ => {
                let problem =
                    format!("'{text}' is not -1 (auto), 1, 2, 4, 8 or a width of 9 to {MAX_IMAGE_SIDE}");
                Err(Error::argument("resolution", problem))
            }
        }
    }
}

impl std::fmt::Display for Resolution {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("-1"),
            Self::Factor(number) | Self::Width(number) => write!(f, "{number}"),
        }
    }
}
