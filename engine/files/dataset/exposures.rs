//! How much photographs of one scene differ in exposure.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use super::gallery::{Gallery, Track, depth_point};
use super::view::View;
use ashsplat::Result;

/// Most photographs that are looked at.
const VIEWS: usize = 64;
/// Number of photographs, those with the most common points, that a photograph is compared with.
const NEIGHBOURS: usize = 3;
/// Most points that are looked for in each photograph, without observations.
const POINTS: usize = 4000;
/// Least common points of a photograph with others.
const LEAST_POINTS: usize = 30;
/// Luminances that are neither black nor saturated.
const MEASURED: std::ops::Range<f32> = 0.04..0.96;

impl Gallery {
    /// Root mean square by which the training photographs' exposures differ from those of their neighbours, in stops of the stored
    /// values: 0.1 says that the same surface is 7 % brighter or darker than in photographs from nearby. Light that changes slowly
    /// along a path does not count: a scene without exposures reproduces it from the direction of view.
    ///
    /// Exposures are those by which the luminances at common sparse points differ least, in a sample of the photographs. Without
    /// observations, a photograph shows the points in its view that lie behind no others. `None` with too few common points.
    pub fn exposure_spread(&self) -> Result<Option<f64>> {
        let tracks = self.shown_points()?;
        let observed = tracks.iter().any(Option::is_some);
        let points = &self.points().positions;
        let sampled = points.iter().step_by(points.len().div_ceil(POINTS).max(1));
        let all: Track = sampled.copied().map(Vec3::from).collect();
        let trained: Vec<usize> = self.trained().collect();
        let measured = |&index: &usize| {
            let track = |view: &View| match observed {
                true => tracks[index].clone(),
                false => Some(in_front(view, &all)),
            };
            Some(self.view(index)?.and_then(|view| luminances(&view, &track(&view).unwrap_or_default())))
        };
        let sample: Vec<&usize> = trained.iter().step_by(trained.len().div_ceil(VIEWS).max(1)).collect();
        let measured: Vec<_> = sample.into_par_iter().filter_map(measured).collect::<Result<_>>()?;
        Ok(spread(&measured))
    }
}

/// The points in a view, except those that lie behind others in a coarse grid over the picture.
fn in_front(view: &View, points: &[Vec3]) -> Track {
    /// Cells along the picture's larger side.
    const CELLS: f32 = 32.0;
    /// Least ratio of a hidden point's depth to that of the nearest one.
    const BEHIND: f32 = 1.1;
    let cell_px = view.photo.width.max(view.photo.height) as f32 / CELLS;
    let placed = |&point: &Vec3| {
        let place = depth_point(view, None, point)?;
        Some((place.position_px.map(|at| (at / cell_px) as u32), place.inverse_z, point))
    };
    let placed: Vec<_> = points.iter().filter_map(placed).collect();
    let mut nearest: HashMap<[u32; 2], f32> = HashMap::new();
    for (cell, inverse_z, _) in &placed {
        let least = nearest.entry(*cell).or_default();
        *least = least.max(*inverse_z);
    }
    placed
        .into_iter()
        .filter(|(cell, inverse_z, _)| inverse_z * BEHIND >= nearest[cell])
        .map(|(.., point)| point)
        .collect()
}

/// Points of a view with the logarithm (base 2) of the mean luminance around them.
fn luminances(view: &View, track: &[Vec3]) -> Result<Vec<(Vec3, f64)>> {
    let photo = view.photo.photo()?;
    let (width, height) = (photo.width as usize, photo.height as usize);
    let rgb = photo.rgb.as_chunks::<3>().0;
    let luminance = |pixel: [u8; 3]| {
        let [r, g, b] = pixel.map(|value| f32::from(value) / 255.0);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let mask = view.photo.mask()?;
    let around = |&point: &Vec3| {
        let [x, y] = depth_point(view, mask.as_deref(), point)?.position_px.map(|at| at.round() as usize);
        let columns = || x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let pixels = rows.flat_map(|y| columns().map(move |x| y * width + x));
        let values: Vec<f32> = pixels.map(|at| luminance(rgb[at])).collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        MEASURED.contains(&mean).then_some((point, f64::from(mean).log2()))
    };
    Ok(track.iter().filter_map(around).collect())
}

/// Root mean square of the photographs' offsets from those of their neighbours, where each value is a point's plus its
/// photograph's.
fn spread(measured: &[Vec<(Vec3, f64)>]) -> Option<f64> {
    /// Both kinds of unknowns are found in turn.
    const ROUNDS: usize = 20;
    let mut observed: HashMap<[u32; 3], Vec<(usize, f64)>> = HashMap::new();
    for (view, points) in measured.iter().enumerate() {
        for (point, value) in points {
            observed.entry(point.to_array().map(f32::to_bits)).or_default().push((view, *value));
        }
    }
    observed.retain(|_, values| values.len() > 1);
    let mut offsets = vec![0.0; measured.len()];
    let mut counted = vec![false; measured.len()];
    for _ in 0..ROUNDS {
        let mut rests = vec![Vec::new(); measured.len()];
        for values in observed.values() {
            let mean =
                values.iter().map(|(view, value)| value - offsets[*view]).sum::<f64>() / values.len() as f64;
            values.iter().for_each(|(view, value)| rests[*view].push(value - mean));
        }
        for (view, rests) in rests.iter_mut().enumerate().filter(|(_, rests)| rests.len() >= LEAST_POINTS) {
            let middle = rests.len() / 2;
            offsets[view] = *rests.select_nth_unstable_by(middle, f64::total_cmp).1;
            counted[view] = true;
        }
    }
    // Each photograph's offset beside that of those with the most common points.
    let mut common = vec![vec![0u32; measured.len()]; measured.len()];
    for values in observed.values() {
        for (a, _) in values {
            values.iter().filter(|(b, _)| a != b && counted[*b]).for_each(|(b, _)| common[*a][*b] += 1);
        }
    }
    let beside = |view: usize| {
        let mut others: Vec<usize> = (0..measured.len()).filter(|&other| common[view][other] > 0).collect();
        others.sort_by_key(|&other| std::cmp::Reverse(common[view][other]));
        others.truncate(NEIGHBOURS);
        let mean = others.iter().map(|&other| offsets[other]).sum::<f64>() / others.len() as f64;
        (counted[view] && !others.is_empty()).then(|| offsets[view] - mean)
    };
    let differences: Vec<f64> = (0..measured.len()).filter_map(beside).collect();
    let squares: f64 = differences.iter().map(|difference| difference * difference).sum();
    (!differences.is_empty()).then(|| (squares / differences.len() as f64).sqrt())
}
