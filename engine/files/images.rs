//! Photographs: decoding, checking, scaling, and pinholes in place of their lenses.

mod decode;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use glam::{DVec2, dvec2};
use rayon::prelude::*;

use crate::host_memory::HostMemory;
use crate::regular_file::OnFile;
use crate::{atomic, cost};
use ashsplat::scene::PhotoLens;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::{Error, Result};

pub use crate::depth_fit::DepthMap;
pub use ashsplat::scene::{Photo, PhotoFile, PhotoSource, StoredPhoto};
pub use decode::photo_size;
pub(crate) use decode::{
    Decoded, PhotoHeader, Request, UNREAD_KIND, cannot_hold, claims, damaged, decoder, limits, photo_header,
    read as read_as,
};

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
    /// Folder on a disk with free space for four bytes per pixel. Unscaled JPEGs to train on take none: they are decoded again.
    pub folder: PathBuf,
}

impl PhotoMemory {
    /// Creates a file without a name for photos; it is removed with the value.
    pub fn create_file(&self) -> Result<Arc<PhotoFile>> {
        let file = tempfile::tempfile_in(&self.folder).on(&self.folder, "create a file")?;
        Ok(PhotoFile::new(file, self.folder.clone(), self.bytes))
    }
}

/// A JPEG that stays compressed and is decoded when it is needed.
#[derive(Debug)]
pub(crate) struct JpegPhoto {
    pub(crate) path: PathBuf,
    pub(crate) turned: bool,
    /// Size after the rotation, pixels.
    pub(crate) size: (u32, u32),
    pub(crate) memory: HostMemory,
}

impl PhotoSource for JpegPhoto {
    fn path(&self) -> &Path {
        &self.path
    }

    fn read(&self) -> Result<Photo> {
        let Self { path, turned, size, memory } = self;
        let request = Request { turned: *turned, size: Some(*size), ..Request::plain(None, memory) };
        Ok(decode::read(path, &request)?.photo)
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

/// Radius of the kernel, in units of the larger of both pixel sizes.
const SUPPORT: f32 = 2.0;

/// The source pixels along an axis that make one pixel of the result.
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

impl Taps {
    fn of(place: u32, from: u32, to: u32) -> Self {
        let ratio = from as f32 / to as f32;
        let stretch = if ratio < 1.0 { 1.0 } else { ratio };
        let support = SUPPORT * stretch;
        let center = (place as f32 + 0.5) * ratio;
        let first = ((center - support).floor() as i64).clamp(0, i64::from(from) - 1);
        let end = ((center + support).ceil() as i64).clamp(first + 1, i64::from(from));
        let weight = |pixel: i64| catmull_rom((pixel as u32 as f32 - (center - 0.5)) / stretch);
        let mut weights: Vec<f32> = (first..end).map(weight).collect();
        // Summed in order: the result's bits depend on it.
        let sum = weights.iter().fold(0.0, |sum, weight| sum + weight);
        weights.iter_mut().for_each(|weight| *weight /= sum);
        Self { first: first as usize, weights }
    }

    fn end(&self) -> usize {
        self.first + self.weights.len()
    }
}

fn catmull_rom(x: f32) -> f32 {
    let a = x.abs();
    let six = if a < 1.0 {
        9.0 * a.powi(3) + -15.0 * a.powi(2) + 6.0
    } else if a < 2.0 {
        -3.0 * a.powi(3) + 15.0 * a.powi(2) + -24.0 * a + 12.0
    } else {
        0.0
    };
    six / 6.0
}

/// A row of the result that still needs rows of the picture.
struct OpenRow {
    taps: Taps,
    sums: Vec<f32>,
}

/// Scales a picture of r, g, b that arrives row by row. Only the rows under the filter are in memory.
///
/// Kernel and arithmetic are those of `image::imageops::resize` with `CatmullRom`, in the same order, so the result has
/// the same bits. That function needs the whole picture, and 16 bytes for each of its columns at the new height.
pub(super) struct RowScaler {
    from: [u32; 2],
    to: [u32; 2],
    columns: Vec<Taps>,
    open: VecDeque<OpenRow>,
    /// Number of result rows that have been opened.
    opened: u32,
    /// Number of source rows so far.
    rows: usize,
    rgb: Vec<u8>,
}

impl RowScaler {
    /// Takes widths and heights, all at least 1. `rgb` receives the result.
    pub(super) fn new(from: [u32; 2], to: [u32; 2], rgb: Vec<u8>) -> Self {
        let columns = (0..to[0]).map(|x| Taps::of(x, from[0], to[0])).collect();
        Self { from, to, columns, open: VecDeque::new(), opened: 0, rows: 0, rgb }
    }

    /// Largest memory of a scaler, beside the result, bytes.
    pub(super) fn bytes(from: [u32; 2], to: [u32; 2]) -> u64 {
        let taps = |axis: usize| {
            let stretch = u64::from(from[axis].div_ceil(to[axis].max(1)).max(1));
            4 * u64::from(to[axis]) * (4 * stretch + 2)
        };
        // Largest number of result rows that a source row is part of.
        let open = 6 * u64::from(to[1].div_ceil(from[1].max(1)).max(1));
        open * 12 * u64::from(from[0]) + taps(0) + taps(1) / u64::from(to[1].max(1)) * open
    }

    pub(super) fn push(&mut self, row: &[u8]) {
        while self.opened < self.to[1] {
            let taps = Taps::of(self.opened, self.from[1], self.to[1]);
            if taps.first > self.rows {
                break;
            }
            self.open.push_back(OpenRow { taps, sums: vec![0.0; row.len()] });
            self.opened += 1;
        }
        for OpenRow { taps, sums } in &mut self.open {
            if let Some(weight) = self.rows.checked_sub(taps.first).and_then(|tap| taps.weights.get(tap)) {
                cost::steps(row.len());
                sums.iter_mut().zip(row).for_each(|(sum, &value)| *sum += f32::from(value) * weight);
            }
        }
        self.rows += 1;
        while self.open.front().is_some_and(|open| open.taps.end() <= self.rows) {
            let Some(done) = self.open.pop_front() else { break };
            let pixels = done.sums.as_chunks::<3>().0;
            for taps in &self.columns {
                cost::steps(taps.weights.len());
                let mut sum = [0.0f32; 3];
                for (pixel, weight) in pixels[taps.first..taps.end()].iter().zip(&taps.weights) {
                    sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value * weight);
                }
                self.rgb.extend(sum.map(|value| value.clamp(0.0, 255.0).round() as u8));
            }
        }
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.rgb
    }
}

/// Resamples the photo of a lens for a pinhole camera: bilinear, black outside the photo.
///
/// `lens` has the photo's size. The rows are computed in parallel.
pub fn undistort(photo: &Photo, lens: &PhotoLens, pinhole: &PhotoLens) -> Photo {
    let (width, height) = (pinhole.width as usize, pinhole.height as usize);
    let mut rgb = vec![0; 3 * width * height];
    rgb.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let point = (dvec2(x as f64 + 0.5, y as f64 + 0.5) - pinhole.center_px) / pinhole.focal_px;
            let place = lens.position(point.extend(1.0)).unwrap_or(DVec2::NAN) - 0.5;
            *pixel = bilinear(photo, place.x, place.y).unwrap_or([0; 3]);
        }
    });
    Photo { width: pinhole.width, height: pinhole.height, rgb }
}

/// The colour at a place, with the first pixel's centre at 0; `None` outside the centres of the border.
fn bilinear(photo: &Photo, x: f64, y: f64) -> Option<[u8; 3]> {
    let (left, top) = (x.floor(), y.floor());
    let (last_x, last_y) = (f64::from(photo.width) - 1.0, f64::from(photo.height) - 1.0);
    // The comparison is false for NaN.
    if !(left >= 0.0 && top >= 0.0 && left <= last_x && top <= last_y) || x > last_x || y > last_y {
        return None;
    }
    let (dx, dy) = (x - left, y - top);
    let row_bytes = 3 * photo.width as usize;
    let at = 3 * left as usize + row_bytes * top as usize;
    let (right, below) = (if dx > 0.0 { 3 } else { 0 }, if dy > 0.0 { row_bytes } else { 0 });
    Some(std::array::from_fn(|channel| {
        let value = |offset: usize| f64::from(photo.rgb[at + offset + channel]);
        let upper = (1.0 - dx) * value(0) + dx * value(right);
        let lower = (1.0 - dx) * value(below) + dx * value(below + right);
        ((1.0 - dy) * upper + dy * lower).round() as u8
    }))
}
