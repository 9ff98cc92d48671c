//! Resamples photographs: for another size, and for a pinhole camera in place of their lens.
//!
//! Scales by rows: only the picture's rows under the filter are in memory.
//!
//! Kernel and arithmetic are those of `image::imageops::resize` with `CatmullRom`, in the same order, so the result has
//! the same bits. That function needs the whole picture, and 16 bytes for each of its columns at the new height.

use std::collections::VecDeque;

use glam::{DVec2, dvec2};
use rayon::prelude::*;

use super::Photo;
use crate::cost;
use ashsplat::scene::PhotoLens;

/// Radius of the kernel, in units of the larger of both pixel sizes.
const SUPPORT: f32 = 2.0;

/// The source pixels along an axis that make one pixel of the result.
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

impl Taps {
    /// Taps of pixel `place` of `to`, made of `from` pixels.
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
struct Open {
    taps: Taps,
    sums: Vec<f32>,
}

/// Scales a picture of r, g, b that arrives row by row.
pub(super) struct RowScaler {
    from: [u32; 2],
    to: [u32; 2],
    columns: Vec<Taps>,
    open: VecDeque<Open>,
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
            self.open.push_back(Open { taps, sums: vec![0.0; row.len()] });
            self.opened += 1;
        }
        for Open { taps, sums } in &mut self.open {
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
