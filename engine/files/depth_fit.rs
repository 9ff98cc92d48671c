//! Inverse-depth maps, and their scale and offset, which monocular depth networks leave open. They are fitted to the sparse
//! points, as in the reference implementation's `make_depth_scale.py`.

use std::collections::BTreeMap;
use std::path::Path;

use image::{ColorType, DynamicImage, ImageDecoder};
use serde::Deserialize;

use crate::host_memory::HostMemory;
use crate::images::{UNREAD_KIND, cannot_hold, claims, damaged, decoder, limits};
use crate::{regular_file, text};
use ashsplat::{Error, Result};

/// Name of the file with the parameters, beside a COLMAP model.
pub const DEPTH_PARAMS_FILE: &str = "depth_params.json";

/// A fit needs more than this many points.
const FEWEST: usize = 10;
/// Least range of the points' inverse depths, 1 / world units.
const MIN_RANGE: f64 = 1e-3;
/// A map is skipped if its scale is outside of this range, times the median.
const RELIABLE: [f64; 2] = [0.2, 5.0];

/// Inverse depth of a map's value, 1 / world units: `scale * value + offset`. Both are 0 if the map cannot be fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct DepthFit {
    /// Factor.
    pub scale: f64,
    /// Summand.
    pub offset: f64,
}

/// A sparse point and its place in a photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedPoint {
    /// Position in the photo, pixels of its camera.
    pub position_px: [f64; 2],
    /// 1 / z in the camera's frame, 1 / world units.
    pub inverse_z: f64,
}

impl DepthFit {
    /// Fits a map to its photo's points, so that medians and mean absolute deviations agree. `camera_size` is that of the
    /// points' pixels. The flag is true if the map's values fall as points come nearer: it then holds depths.
    pub fn of(map: &DepthMap, camera_size: (u32, u32), points: &[ObservedPoint]) -> (Self, bool) {
        let ratio = f64::from(map.height) / f64::from(camera_size.1.max(1));
        let ends = [camera_size.0, camera_size.1].map(|side| f64::from(side) * ratio);
        let mut pairs = Vec::new();
        for point in points {
            let [x, y] = point.position_px.map(|place| f64::from((place * ratio) as f32));
            let inside = x >= 0.0 && y >= 0.0 && x < ends[0] && y < ends[1];
            if inside && point.inverse_z > 0.0 {
                pairs.push((point.inverse_z, map.sample(x, y)));
            }
        }
        let all = points.iter().map(|point| point.inverse_z);
        let range = all.clone().fold(f64::NEG_INFINITY, f64::max) - all.fold(f64::INFINITY, f64::min);
        if pairs.len() <= FEWEST || range.is_nan() || range <= MIN_RANGE {
            return (Self::default(), false);
        }
        let (depths, values): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        let (middle, middle_of_map) = (median(depths.clone()), median(values.clone()));
        let deviation = |all: &[f64], middle: f64| {
            all.iter().map(|value| (value - middle).abs()).sum::<f64>() / all.len() as f64
        };
        let scale = deviation(&depths, middle) / deviation(&values, middle_of_map);
        let together: f64 =
            depths.iter().zip(&values).map(|(depth, value)| (depth - middle) * (value - middle_of_map)).sum();
        let fit = match scale.is_finite() {
            true => Self { scale, offset: middle - scale * middle_of_map },
            // A map with a single value cannot be fitted.
            false => Self::default(),
        };
        (fit, together < 0.0)
    }

    /// The median of all positive scales; 0 if there are none.
    pub fn median_scale<'a>(fits: impl IntoIterator<Item = &'a Self>) -> f64 {
        median(fits.into_iter().map(|fit| fit.scale).filter(|&scale| scale > 0.0).collect())
    }

    /// True if a map may be used beside others of this median scale.
    pub fn is_reliable(&self, median_scale: f64) -> bool {
        let [low, high] = RELIABLE;
        self.scale > 0.0 && self.scale >= low * median_scale && self.scale <= high * median_scale
    }

    /// Reads `depth_params.json`: an object from photos' names without extension to scale and offset.
    pub fn read_all(path: impl AsRef<Path>) -> Result<BTreeMap<String, Self>> {
        let path = path.as_ref();
        let remedy =
            "expected {\"photo\": {\"scale\": 1.5, \"offset\": 0.1}, …}; without the file, they are fitted";
        let fits: BTreeMap<String, Self> = text::json(path, "a list of depth parameters", remedy)?;
        let is_finite = |fit: &Self| (fit.scale as f32).is_finite() && (fit.offset as f32).is_finite();
        match fits.iter().find(|(_, fit)| !is_finite(fit)) {
            None => Ok(fits),
            Some((name, _)) => {
                Err(Error::input(path, format!("{name} has a number that is too large"), remedy))
            }
        }
    }
}

/// The middle value, or the mean of the two middle ones; 0 without values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        odd if odd % 2 == 1 => values[odd / 2],
        even => 0.5 * (values[even / 2 - 1] + values[even / 2]),
    }
}

/// Number of steps of a 16-bit map from 0 to 1.
const STEPS: f32 = 65536.0;

/// An inverse-depth map, of any scale: a PNG with 16 bits per channel, as the reference implementation takes it from depth
/// networks.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row by row, in [0, 1).
    pub values: Vec<f32>,
}

impl DepthMap {
    /// Reads the first channel of a 16-bit PNG: its value / 65536.
    pub fn read(path: impl AsRef<Path>, memory: &HostMemory) -> Result<Self> {
        let path = path.as_ref();
        let bytes = regular_file::read(path, 1)?;
        let mut decoder = decoder(path, &bytes)?;
        let ((width, height), color) = (decoder.dimensions(), decoder.color_type());
        if !matches!(color, ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16) {
            let problem = "has 8 bits per channel, too few for depths";
            return Err(Error::input(path, problem, "write the inverse depth as a 16-bit PNG"));
        }
        let decoded = decoder.total_bytes();
        if cannot_hold(bytes.len() as u64, decoded) {
            return Err(damaged(path, &claims((width, height), bytes.len() as u64)));
        }
        let _lease =
            memory.take(path, bytes.len() as u64 + 2 * decoded + 4 * u64::from(width) * u64::from(height))?;
        decoder.set_limits(limits(memory)).map_err(|e| damaged(path, &e))?;
        let channels = usize::from(color.channel_count());
        let image = DynamicImage::from_decoder(decoder).map_err(|e| damaged(path, &e))?;
        let all = match image {
            DynamicImage::ImageLuma16(image) => image.into_raw(),
            DynamicImage::ImageLumaA16(image) => image.into_raw(),
            DynamicImage::ImageRgb16(image) => image.into_raw(),
            DynamicImage::ImageRgba16(image) => image.into_raw(),
            _ => return Err(damaged(path, &UNREAD_KIND)),
        };
        let values = all.chunks_exact(channels).map(|pixel| f32::from(pixel[0]) / STEPS).collect();
        Ok(Self { width, height, values })
    }

    /// The value at a place by linear interpolation. Pixel centres are at whole numbers; the border extends outside.
    pub fn sample(&self, x: f64, y: f64) -> f64 {
        let between = |place: f64, size: u32| {
            let place = place.clamp(0.0, f64::from(size - 1));
            let low = place.floor();
            (low as usize, (low as usize + 1).min(size as usize - 1), place - low)
        };
        let ((x0, x1, u), (y0, y1, v)) = (between(x, self.width), between(y, self.height));
        let at = |x: usize, y: usize| f64::from(self.values[y * self.width as usize + x]);
        let row = |y: usize| at(x0, y) * (1.0 - u) + at(x1, y) * u;
        row(y0) * (1.0 - v) + row(y1) * v
    }

    /// The map at another size by linear interpolation. Pixel centres are at halves.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let of =
            |at: u32, size: u32, own: u32| (f64::from(at) + 0.5) * f64::from(own) / f64::from(size) - 0.5;
        let row = |y: u32| {
            let y = of(y, height, self.height);
            (0..width).map(move |x| self.sample(of(x, width, self.width), y) as f32)
        };
        Self { width, height, values: (0..height).flat_map(row).collect() }
    }
}
