//! Finds points in posed photographs, to start training if a data set has none.
//!
//! A plane sweep (Collins: *A space-sweep approach to true multi-image matching*, CVPR 1996) over small copies of the
//! photographs: a pixel gets the depth at which its surroundings look most alike in the neighbouring views. Depths that
//! two other views confirm are kept. World coordinates, as in the cameras.

use std::f32::consts::FRAC_PI_2;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::dataset::{Dataset, View};
use crate::host_memory::HostMemory;
use crate::images::{Photo, PhotoFileFormat, undistort};
use crate::init::seen_box;
use crate::progress::Progress;
use ashsplat::Result;
use ashsplat::scene::points::PointCloud;
use ashsplat::scene::{Camera, Intrinsics, PhotoLens};

impl Dataset {
    /// Up to 20,000 points at which the training photographs agree: [`photo_points`]. The inner error is their number
    /// if it is below 1000: random points are the better start then.
    ///
    /// `memory` is the budget with which the data set was loaded: [`DatasetOptions::host_memory`](crate::DatasetOptions::host_memory).
    pub fn points_in_photos(
        &self,
        seed: u64,
        memory: &HostMemory,
        progress: Progress<'_>,
    ) -> Result<Result<PointCloud, usize>> {
        let kept = |view: &View| {
            let photo = view.photo.file().map_or(view.photo.bytes(), |_| 0);
            photo + view.inverse_depth.as_ref().map_or(0, |map| size_of_val(&**map) as u64)
        };
        let memory = memory.beside_photos(self.train.iter().chain(&self.test).map(kept).sum());
        let found = photo_points(&self.train, self.scene_extent, PHOTO_POINTS, seed, &memory, progress)?;
        Ok(if found.len() < MIN_PHOTO_POINTS { Err(found.len()) } else { Ok(found) })
    }
}

/// Least number of points in the photographs; with fewer, random points are the better start.
const MIN_PHOTO_POINTS: usize = 1000;
/// Largest number of kept points.
pub const PHOTO_POINTS: usize = 20_000;

/// Largest number of views that are used, evenly spread.
const MAX_VIEWS: usize = 256;
/// Longer side of the small copies, pixels.
const LONG_SIDE: u32 = 128;
/// Number of candidate depths, evenly spread in inverse depth.
const PLANES: usize = 96;
/// Nearest and farthest depth, as shares of the depth of the cameras' common centre.
const AROUND_MIDDLE: [f32; 2] = [0.25, 6.0];
/// Nearest and farthest depth without a common centre, as shares of the scene extent.
const AROUND_CAMERAS: [f32; 2] = [0.25, 16.0];
/// Number of views that a view is compared with.
const COMPARED: usize = 4;
/// Best distance of compared views, by the depths' geometric mean: nearer ones show no depth, farther ones differ.
const BASELINE: f32 = 0.2;
/// Radius of the windows, pixels.
const RADIUS: usize = 3;
/// Least correlation of windows: the mean of the two best views.
const MIN_CORRELATION: f32 = 0.6;
/// Least correlation at a witness: its depth must not be random. With [`MIN_CORRELATION`], surfaces with little texture
/// lose their points: 1.5 dB less on the demo's scene (three seeds).
const WITNESS_CORRELATION: f32 = 0.0;
/// Number of views that check a depth, and how many of them must agree.
const WITNESSES: usize = 8;
const AGREEING: usize = 2;
/// Largest relative difference of equal depths.
const SAME_DEPTH: f32 = 0.03;

/// At most `count` points at which the views agree, with their colours, in arbitrary order. The same views and seed
/// give the same points. There are few or none if photographs show no texture, hardly overlap, or are taken from one
/// place.
pub fn photo_points(
    views: &[View],
    scene_extent: f32,
    count: usize,
    seed: u64,
    memory: &HostMemory,
    progress: Progress<'_>,
) -> Result<PointCloud> {
    let some = views.len().min(MAX_VIEWS);
    let chosen: Vec<&View> = (0..some).map(|i| &views[i * views.len() / some]).collect();
    let done = AtomicUsize::new(0);
    // One step for each photograph read, and one for each compared.
    let step = || progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, 2 * some);
    let read = |view| {
        progress.check()?;
        let small = SmallView::new(view, memory)?;
        step();
        Ok(small)
    };
    let small = chosen.into_par_iter().map(read).collect::<Result<Vec<_>>>()?;
    let cameras: Vec<Camera> = small.iter().map(|view| view.camera).collect();
    let middle = seen_box(&cameras).map(|bounds| (bounds.min + bounds.max) / 2.0);
    let range_of = |index: usize| depth_range(&cameras[index], middle, scene_extent);
    let sweep = |index: usize| {
        progress.check()?;
        let range = range_of(index);
        let compared: Vec<&SmallView> =
            neighbours(&cameras, index, range).map(|other| &small[other]).collect();
        let depths = small[index].sweep(&compared, range);
        step();
        Ok(depths)
    };
    let depths = (0..small.len()).into_par_iter().map(sweep).collect::<Result<Vec<_>>>()?;
    let agreed = |index| agreed(&small, &depths, index, &witnesses(&cameras, index, range_of(index)));
    let found: Vec<(Vec3, [u8; 3])> = (0..small.len()).into_par_iter().flat_map_iter(agreed).collect();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut kept: Vec<usize> = match found.len() {
        all if all > count => rand::seq::index::sample(&mut random, all, count).into_vec(),
        all => (0..all).collect(),
    };
    kept.sort_unstable();
    let (positions, colors) = kept.iter().map(|&i| (found[i].0.to_array(), found[i].1)).unzip();
    Ok(PointCloud { positions, colors })
}

/// Nearest and farthest candidate depth of a view, world units.
fn depth_range(camera: &Camera, middle: Option<Vec3>, scene_extent: f32) -> [f32; 2] {
    let depth = middle.map(|middle| camera.forward().dot(middle - camera.position()));
    depth.map_or(AROUND_CAMERAS.map(|share| share * scene_extent), |depth| {
        AROUND_MIDDLE.map(|share| share * depth)
    })
}

/// The views that face the same way from another place, with their distances as shares of the depths' geometric mean. A
/// picture from the same place has no parallax and would confirm any depth.
fn overlapping(
    cameras: &[Camera],
    of: usize,
    [near, far]: [f32; 2],
) -> impl Iterator<Item = (f32, usize)> + '_ {
    let (own, typical) = (&cameras[of], (near * far).sqrt());
    (cameras.iter().enumerate())
        .filter(|(_, other)| other.forward().dot(own.forward()) > 0.5)
        .map(move |(index, other)| (other.position().distance(own.position()) / typical, index))
        .filter(|&(distance, _)| distance > 0.01)
}

/// The views that a view is compared with: those nearest to the best distance.
fn neighbours(cameras: &[Camera], of: usize, range: [f32; 2]) -> impl Iterator<Item = usize> {
    let rated = overlapping(cameras, of, range).map(|(distance, index)| ((distance - BASELINE).abs(), index));
    first(rated.collect(), COMPARED)
}

/// The views that check the depths of a view: the nearest.
fn witnesses(cameras: &[Camera], of: usize, range: [f32; 2]) -> Vec<usize> {
    first(overlapping(cameras, of, range).collect(), WITNESSES).collect()
}

/// Indices of the `count` smallest values.
fn first(mut rated: Vec<(f32, usize)>, count: usize) -> impl Iterator<Item = usize> {
    rated.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    rated.into_iter().take(count).map(|(_, index)| index)
}

/// Points at the pixels of a view whose depth other views confirm.
fn agreed(views: &[SmallView], depths: &[Depths], of: usize, witnesses: &[usize]) -> Vec<(Vec3, [u8; 3])> {
    let (view, own) = (&views[of], &depths[of]);
    let agrees = |point: Vec3, witness: usize| {
        let (x, y, depth) = views[witness].camera.project(point);
        let at = (depth > 0.0).then(|| views[witness].pixel_at(x, y)).flatten();
        at.is_some_and(|at| {
            let there = &depths[witness];
            there.correlation[at] > WITNESS_CORRELATION
                && views[witness].counts[at]
                && (there.depth[at] - depth).abs() < SAME_DEPTH * depth
        })
    };
    let mut found = Vec::new();
    for at in 0..own.depth.len() {
        if own.correlation[at] < MIN_CORRELATION || !view.counts[at] {
            continue;
        }
        let there = own.depth[at] * view.ray(at) - view.camera.translation;
        let point = view.camera.camera_from_world.transpose() * there;
        if witnesses.iter().filter(|&&witness| agrees(point, witness)).count() >= AGREEING {
            found.push((point, view.colors[at]));
        }
    }
    found
}

/// A small copy of a view.
struct SmallView {
    camera: Camera,
    width: usize,
    height: usize,
    colors: Vec<[u8; 3]>,
    /// Mean of the colours, 0 to 1.
    gray: Vec<f32>,
    /// False for pixels that a mask hides.
    counts: Vec<bool>,
}

/// A pinhole that sees what a lens sees best, without blank pixels: all that a pinhole can see of it, or a right angle ahead.
fn straight(camera: &Camera) -> PhotoLens {
    let lens = camera.photo_lens();
    let side = (camera.width.min(camera.height) / 2).max(1);
    let ahead = || Intrinsics::from_fov_x(FRAC_PI_2, side, side);
    PhotoLens::pinhole(lens.inscribed_pinhole().unwrap_or_else(ahead))
}

/// The best depth of each pixel, world units, and its correlation, -1 to 1.
struct Depths {
    depth: Vec<f32>,
    correlation: Vec<f32>,
}

impl SmallView {
    fn new(view: &View, memory: &HostMemory) -> Result<Self> {
        let (full_width, full_height) = (view.photo.width, view.photo.height);
        let share = (LONG_SIDE as f32 / full_width.max(full_height) as f32).min(1.0);
        let [width, height] =
            [full_width, full_height].map(|side| ((side as f32 * share).round() as u32).max(1));
        // Four bytes per texel, and its three colours.
        let _lease =
            memory.take(Path::new(&view.name), 7 * u64::from(full_width) * u64::from(full_height))?;
        let texels = view.photo.texels()?;
        let texels = texels.as_chunks::<4>().0;
        // Hidden pixels must not influence points: they may be held out.
        let rgb = texels.iter().flat_map(|&[r, g, b, seen]| if seen == 0 { [128; 3] } else { [r, g, b] });
        let photo = Photo { width: full_width, height: full_height, rgb: rgb.collect() };
        let mut photo = photo.scaled_to(width, height)?;
        // The pose halfway through a rolling shutter is near enough for points to start from.
        let mut camera = Camera { shutter: None, ..view.camera.scaled_to(width, height) };
        let [w, h] = [width, height].map(|side| side as usize);
        let counts = |at: usize| {
            let across = |i: usize, small: usize, full: u32| (2 * i + 1) * full as usize / (2 * small);
            let (x, y) = (across(at % w, w, full_width), across(at / w, h, full_height));
            texels.get(y * full_width as usize + x).is_some_and(|texel| texel[3] != 0)
        };
        let mut counts: Vec<bool> = (0..w * h).map(counts).collect();
        if camera.projection.is_lens() {
            let (lens, pinhole) = (camera.photo_lens(), straight(&camera));
            let grey = counts.iter().flat_map(|&counts| if counts { [255; 3] } else { [0; 3] }).collect();
            let shown = undistort(&Photo { width, height, rgb: grey }, &lens, &pinhole);
            counts = shown.rgb.iter().step_by(3).map(|&value| value == 255).collect();
            photo = undistort(&photo, &lens, &pinhole);
            camera = pinhole.camera(camera.camera_from_world, camera.translation);
        }
        let colors = photo.rgb.as_chunks::<3>().0.to_vec();
        let gray = colors.iter().map(|c| c.iter().map(|&v| f32::from(v)).sum::<f32>() / 765.0).collect();
        Ok(Self {
            width: camera.width as usize,
            height: camera.height as usize,
            camera,
            colors,
            gray,
            counts,
        })
    }

    /// Direction of a pixel's centre in the camera's frame, scaled to depth 1.
    fn ray(&self, at: usize) -> Vec3 {
        self.camera.rays()([(at % self.width) as f32 + 0.5, (at / self.width) as f32 + 0.5])
    }

    fn pixel_at(&self, x: f32, y: f32) -> Option<usize> {
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// Grey value at a place by linear interpolation; the border is repeated.
    fn gray_at(&self, x: f32, y: f32) -> f32 {
        let [x, y] = [(x, self.width), (y, self.height)].map(|(v, n)| (v - 0.5).clamp(0.0, (n - 1) as f32));
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let (across, down) = (x - left as f32, y - top as f32);
        let row = |y: usize| {
            let (a, b) = (self.gray[y * self.width + left], self.gray[y * self.width + right]);
            a + (b - a) * across
        };
        row(top) + (row(bottom) - row(top)) * down
    }

    fn sweep(&self, others: &[&SmallView], [near, far]: [f32; 2]) -> Depths {
        let pixels = self.gray.len();
        let mut best = Depths { depth: vec![0.0; pixels], correlation: vec![-1.0; pixels] };
        // Two views must agree: a single one resembles any window somewhere.
        if others.len() < 2 {
            return best;
        }
        let mut windows = Windows::new(self.width, self.height);
        let mean = windows.means(|at| self.gray[at]);
        let mean_square = windows.means(|at| self.gray[at] * self.gray[at]);
        let mut warped = vec![None; pixels];
        for plane in 0..PLANES {
            let share = plane as f32 / (PLANES - 1) as f32;
            let depth = 1.0 / (1.0 / near + (1.0 / far - 1.0 / near) * share);
            let mut two_best = vec![[-1.0_f32; 2]; pixels];
            for other in others {
                self.warp(other, depth, &mut warped);
                let value = |at: usize| warped[at].unwrap_or(0.0);
                let other_mean = windows.means(value);
                let other_square = windows.means(|at| value(at) * value(at));
                let product = windows.means(|at| value(at) * self.gray[at]);
                for at in (0..pixels).filter(|&at| warped[at].is_some()) {
                    let variance = mean_square[at] - mean[at] * mean[at];
                    let other_variance = other_square[at] - other_mean[at] * other_mean[at];
                    let covariance = product[at] - mean[at] * other_mean[at];
                    let correlation = covariance / (variance * other_variance).max(1e-10).sqrt();
                    let [first, second] = &mut two_best[at];
                    if correlation > *first {
                        (*first, *second) = (correlation, *first);
                    } else if correlation > *second {
                        *second = correlation;
                    }
                }
            }
            for (at, [first, second]) in two_best.into_iter().enumerate() {
                let correlation = 0.5 * (first + second);
                if correlation > best.correlation[at] {
                    (best.correlation[at], best.depth[at]) = (correlation, depth);
                }
            }
        }
        best
    }

    /// Warps another view to this one for pixels at depth `depth`; `None` outside the other view.
    fn warp(&self, other: &SmallView, depth: f32, warped: &mut [Option<f32>]) {
        let turn = other.camera.camera_from_world * self.camera.camera_from_world.transpose();
        let shift = other.camera.translation - turn * self.camera.translation;
        for (at, value) in warped.iter_mut().enumerate() {
            let there = turn * (depth * self.ray(at)) + shift;
            let x = other.camera.fx * there.x / there.z + other.camera.cx;
            let y = other.camera.fy * there.y / there.z + other.camera.cy;
            let inside = there.z > 0.0 && other.pixel_at(x, y).is_some_and(|at| other.counts[at]);
            *value = inside.then(|| other.gray_at(x, y));
        }
    }
}

/// Means over the square windows of a picture, cut at its border.
struct Windows {
    width: usize,
    rows: Vec<f32>,
    values: Vec<f32>,
    /// 1 / number of pixels of each window.
    shares: Vec<f32>,
}

impl Windows {
    fn new(width: usize, height: usize) -> Self {
        let within = |i: usize, n: usize| (i + RADIUS).min(n - 1) - i.saturating_sub(RADIUS) + 1;
        let share = |at: usize| 1.0 / (within(at % width, width) * within(at / width, height)) as f32;
        let pixels = width * height;
        let shares = (0..pixels).map(share).collect();
        Self { width, rows: vec![0.0; pixels], values: vec![0.0; pixels], shares }
    }

    fn means(&mut self, value: impl Fn(usize) -> f32) -> Vec<f32> {
        let Self { width, rows, values, shares } = self;
        values.iter_mut().enumerate().for_each(|(at, v)| *v = value(at));
        for (sums, values) in rows.chunks_mut(*width).zip(values.chunks(*width)) {
            add_around(sums, values, 1);
        }
        let mut means = vec![0.0; rows.len()];
        add_around(&mut means, rows, *width);
        means.iter_mut().zip(shares).for_each(|(mean, share)| *mean *= *share);
        means
    }
}

/// Sets each sum to the sum of the values at up to [`RADIUS`] strides before and after.
fn add_around(sums: &mut [f32], values: &[f32], stride: usize) {
    sums.copy_from_slice(values);
    for shift in (1..=RADIUS).map(|n| n * stride).filter(|&shift| shift < values.len()) {
        let kept = values.len() - shift;
        sums[..kept].iter_mut().zip(&values[shift..]).for_each(|(sum, value)| *sum += value);
        sums[shift..].iter_mut().zip(&values[..kept]).for_each(|(sum, value)| *sum += value);
    }
}
