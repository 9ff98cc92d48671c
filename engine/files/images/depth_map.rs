//! Inverse-depth maps: PNGs with 16 bits per channel, as the reference implementation takes them from depth networks.

use std::path::Path;

use image::{ColorType, DynamicImage, ImageDecoder};

use super::decode::{UNREAD_KIND, cannot_hold, claims, damaged, decoder, limits};
use crate::host_memory::HostMemory;
use crate::{cost, regular_file};
use ashsplat::{Error, Result};

/// Number of steps of a 16-bit map from 0 to 1.
const STEPS: f32 = 65536.0;

/// An inverse-depth map, of any scale.
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
        cost::steps(bytes.len());
        let channels = usize::from(color.channel_count());
        let image = DynamicImage::from_decoder(decoder).map_err(|e| damaged(path, &e))?;
        let all = match image {
            DynamicImage::ImageLuma16(image) => image.into_raw(),
            DynamicImage::ImageLumaA16(image) => image.into_raw(),
            DynamicImage::ImageRgb16(image) => image.into_raw(),
            DynamicImage::ImageRgba16(image) => image.into_raw(),
            _ => return Err(damaged(path, &UNREAD_KIND)),
        };
        cost::steps(all.len());
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
            cost::steps(width as usize);
            let y = of(y, height, self.height);
            (0..width).map(move |x| self.sample(of(x, width, self.width), y) as f32)
        };
        Self { width, height, values: (0..height).flat_map(row).collect() }
    }
}
