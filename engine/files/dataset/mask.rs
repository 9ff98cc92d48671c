//! The mask of a photo.

use std::path::Path;

use super::crop::cut;
use crate::host_memory::HostMemory;
use crate::images::{Decoded, Photo, Request, header, read_as, undistort};
use ashsplat::scene::PhotoLens;
use ashsplat::{Error, Result};

/// One value per pixel, row-major. A pixel counts if its value is at least [`COUNTS`].
#[derive(Clone)]
pub(super) struct Mask {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) values: Vec<u8>,
}

/// Least mask value of a pixel that counts.
const COUNTS: u8 = 128;

impl Mask {
    /// A mask of any size, to be stretched to its photo: see [`Mask::stretched_to`].
    pub(super) fn coarse(width: u32, height: u32, counts: &[bool]) -> Result<Self> {
        if counts.is_empty() || counts.len() as u64 != u64::from(width) * u64::from(height) {
            let problem = format!("has {} values for {width}x{height} pixels", counts.len());
            return Err(Error::argument("mask", problem));
        }
        let values = counts.iter().map(|&counts| if counts { 255 } else { 0 }).collect();
        Ok(Self { width, height, values })
    }

    /// The mask at another size, with the nearest value for each pixel.
    pub(super) fn stretched_to(&self, width: u32, height: u32) -> Self {
        let nearest = |at: u32, to: u32, from: u32| {
            ((2 * u64::from(at) + 1) * u64::from(from) / (2 * u64::from(to))) as usize
        };
        let row = |y: u32| nearest(y, height, self.height) * self.width as usize;
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let values = pixels.map(|(x, y)| self.values[row(y) + nearest(x, width, self.width)]).collect();
        Self { width, height, values }
    }

    /// Reads the mask of a photo of this size. A mask of a larger version of the photo is scaled down. The flag is true for a
    /// cut-out: a picture with transparent surroundings, whose alpha channel is the mask.
    pub(super) fn read(
        path: &Path,
        turned: bool,
        (width, height): (u32, u32),
        memory: &HostMemory,
    ) -> Result<(Self, bool)> {
        let size = header(path)?.size(turned);
        if !is_enlarged(size, (width, height)) {
            let problem = format!("is {}x{} pixels, its photo {width}x{height}", size.0, size.1);
            let remedy = "masks must have their photo's size, or be larger with the same proportions";
            return Err(Error::input(path, problem, remedy));
        }
        // The mask's own values, and the scaled ones.
        let besides = 2 * u64::from(size.0) * u64::from(size.1);
        let request = Request { turned, size: Some(size), besides, ..Request::plain(Some([0.0; 3]), memory) };
        let Decoded { photo, alpha, .. } = read_as(path, &request)?;
        let cut_out = alpha.filter(|alpha| is_cut_out(&photo, alpha));
        let is_cut_out = cut_out.is_some();
        let mask = match cut_out {
            Some(values) => Self { width: size.0, height: size.1, values },
            None => Self::of_grey(photo).of_bits(),
        };
        Ok((mask.scaled_to(width, height), is_cut_out))
    }

    fn of_grey(grey: Photo) -> Self {
        let values = grey.rgb.chunks_exact(3).map(|rgb| rgb[0]).collect();
        Self { width: grey.width, height: grey.height, values }
    }

    /// Converts a mask that marks pixels with 1 instead of 255.
    fn of_bits(mut self) -> Self {
        if self.values.iter().all(|&value| value <= 1) {
            self.values.iter_mut().for_each(|value| *value *= 255);
        }
        self
    }

    /// A mask of the pixels whose centres lie within a radius (pixels) around the picture's middle.
    pub(super) fn disc((width, height): (u32, u32), radius: f64) -> Self {
        let off = |at: u32, side: u32| f64::from(at) + 0.5 - 0.5 * f64::from(side);
        let value = |x: u32, y: u32| {
            if off(x, width).powi(2) + off(y, height).powi(2) <= radius * radius { 255 } else { 0 }
        };
        let values = (0..height).flat_map(|y| (0..width).map(move |x| value(x, y))).collect();
        Self { width, height, values }
    }

    /// A mask of the pixels that count in both masks, which have the same size. A missing mask hides nothing.
    pub(super) fn of_both(one: Option<Self>, other: Option<Self>) -> Option<Self> {
        let (mut both, other) = match (one, other) {
            (Some(one), Some(other)) => (one, other),
            (one, other) => return one.or(other),
        };
        both.values.iter_mut().zip(&other.values).for_each(|(a, &b)| *a = (*a).min(b));
        Some(both)
    }

    /// The mask for the pinhole camera that replaces a lens.
    pub(super) fn undistorted(&self, lens: &PhotoLens, pinhole: &PhotoLens) -> Self {
        Self::of_grey(undistort(&grey((self.width, self.height), &self.values), lens, pinhole))
    }

    /// Scales the mask. A pixel counts if all pixels that it covers count, since its colour is their mean.
    pub(super) fn scaled_to(self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self;
        }
        let covered = |at: u32, to: u32, from: u32| {
            let [at, to, from] = [at, to, from].map(u64::from);
            (at * from / to) as usize..((at + 1) * from).div_ceil(to) as usize
        };
        let least = |x: u32, y: u32| {
            let columns = covered(x, width, self.width);
            let rows = covered(y, height, self.height).map(|row| row * self.width as usize);
            rows.flat_map(|row| &self.values[row + columns.start..row + columns.end]).min().copied()
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let values = pixels.map(|(x, y)| least(x, y).unwrap_or_default()).collect();
        Self { width, height, values }
    }

    pub(super) fn cut(&self, corner: [u32; 2], size: [u32; 2]) -> Self {
        let values = cut(&self.values, (self.width, 1), corner, size);
        Self { width: size[0], height: size[1], values }
    }

    /// 255 for pixels that count, otherwise 0; `None` if all pixels count.
    pub(super) fn into_values(self) -> Option<Vec<u8>> {
        let value_of = |value: &u8| if *value >= COUNTS { 255 } else { 0 };
        self.hides().then(|| self.values.iter().map(value_of).collect())
    }

    pub(super) fn hides_all(&self) -> bool {
        self.values.iter().all(|&value| value < COUNTS)
    }

    pub(super) fn hides(&self) -> bool {
        self.values.iter().any(|&value| value < COUNTS)
    }
}

/// True if some pixels are transparent, and many others are neither black nor white.
fn is_cut_out(photo: &Photo, alpha: &[u8]) -> bool {
    const BLACK_OR_WHITE: [u8; 2] = [32, 223];
    let opaque = photo.rgb.as_chunks::<3>().0.iter().zip(alpha).filter(|(_, alpha)| **alpha >= COUNTS);
    let is_between = |value: &u8| (BLACK_OR_WHITE[0]..BLACK_OR_WHITE[1]).contains(value);
    let (mut count, mut between) = (0, 0);
    for (rgb, _) in opaque {
        count += 1;
        between += usize::from(rgb.iter().any(is_between));
    }
    count < alpha.len() && 10 * between > count
}

pub(super) fn grey((width, height): (u32, u32), values: &[u8]) -> Photo {
    Photo { width, height, rgb: values.iter().flat_map(|&value| [value; 3]).collect() }
}

/// True if one size is the other one scaled, with rounded sides.
pub(super) fn is_scaled(one: (u32, u32), other: (u32, u32)) -> bool {
    is_enlarged(one, other) || is_enlarged(other, one)
}

/// True if a picture has the size of another one, or of a larger version that was scaled down to rounded sides.
fn is_enlarged(size: (u32, u32), of: (u32, u32)) -> bool {
    let [a, b] = [(size.0, of.0), (size.1, of.1)].map(|(larger, side)| {
        let [larger, side] = [larger, side].map(f64::from);
        // Range of factors by which the side may have been divided.
        (larger / (side + 1.0), if side > 1.0 { larger / (side - 1.0) } else { f64::INFINITY })
    });
    size == of || (size.0 >= of.0 && size.1 >= of.1 && a.0 < b.1 && b.0 < a.1)
}
