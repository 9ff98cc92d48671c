//! How much photographs of one scene differ in exposure.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};

use glam::Vec3;
use rayon::prelude::*;

use super::View;
use super::gallery::{Gallery, depth_point};
use super::planned_view::Track;
use ashsplat::Result;
use ashsplat::scene::Camera;

/// Number of photographs up to which each is compared. A larger set is sampled.
const MAX_VIEWS: usize = 64;
/// Number of photographs that a photograph is compared with.
const NEIGHBOURS: usize = 3;
/// Most points that are looked for in each photograph, without observations.
const POINTS: usize = 4000;
/// Least common points of two photographs that are compared.
const MIN_POINTS: usize = 30;
/// Least cosine between the directions from a common point to both cameras. Farther apart, surfaces themselves look different.
const MIN_COSINE: f32 = 0.966;
/// Luminances that are neither black nor saturated.
const MEASURED: std::ops::Range<f32> = 0.04..0.96;
/// Longest file of observations that is read; reading a longer one would delay the training.
const MAX_BYTES: u64 = 256 << 20;

/// The points that a photograph shows.
struct PhotoLuminances {
    position: Vec3,
    /// Logarithm (base 2) of the mean luminance around each point, by the bits of its position.
    luminances: HashMap<[u32; 3], f64>,
}

impl Gallery {
    /// Root mean square by which the training photographs' exposures differ from those from nearby, in stops of the stored
    /// values: 0.1 says that the same surface is 7 % brighter or darker. Light that changes slowly along a path does not count: a
    /// scene without exposures reproduces it from the direction of view.
    ///
    /// The difference of two photographs is the median over their common sparse points that both show from about the same side.
    /// If the data set has no observations, a photograph shows the points in its view that lie behind no others. Returns `None` if
    /// too few photographs have such points in common.
    pub fn exposure_spread(&self) -> Result<Option<f64>> {
        let tracks = self.shown_points(MAX_BYTES)?;
        let observed = tracks.iter().any(Option::is_some);
        let points = &self.points().positions;
        let sampled = points.iter().step_by(points.len().div_ceil(POINTS).max(1));
        let all: Track = sampled.copied().map(Vec3::from).collect();
        let (compared, needed) = self.exposure_sample();
        let shown = |&index: &usize| {
            let view = self.view(index)?;
            Some(view.and_then(|view| {
                let track =
                    if observed { tracks[index].clone().unwrap_or_default() } else { in_front(&view, &all) };
                Ok((
                    index,
                    PhotoLuminances {
                        position: view.camera.position(),
                        luminances: luminances(&view, &track)?,
                    },
                ))
            }))
        };
        let shown: HashMap<usize, PhotoLuminances> =
            needed.par_iter().filter_map(shown).collect::<Result<_>>()?;
        let differences: Vec<f64> =
            compared.iter().filter_map(|view| difference_from_neighbours(*view, &shown)).collect();
        let squares: f64 = differences.iter().map(|difference| difference * difference).sum();
        let enough = 2 * differences.len() > compared.len();
        Ok(enough.then(|| (squares / differences.len() as f64).sqrt()))
    }

    /// The training views to compare, and those and their neighbours.
    fn exposure_sample(&self) -> (Vec<usize>, Vec<usize>) {
        let trained: Vec<usize> = self.trained().map(|(index, _)| index).collect();
        if trained.len() <= MAX_VIEWS {
            return (trained.clone(), trained);
        }
        let cameras: Vec<Camera> = self.cameras().iter().map(|named| named.camera).collect();
        let step = trained.len().div_ceil(MAX_VIEWS / (1 + NEIGHBOURS));
        let compared: Vec<usize> = trained.iter().copied().step_by(step).collect();
        let needed: BTreeSet<usize> =
            compared.iter().flat_map(|&view| nearest(view, &trained, &cameras)).collect();
        (compared, needed.into_iter().collect())
    }
}

/// A view and its neighbours by position and direction.
fn nearest(view: usize, views: &[usize], cameras: &[Camera]) -> Vec<usize> {
    let distances: Vec<f32> =
        views.iter().map(|&other| cameras[other].position().distance(cameras[view].position())).collect();
    let farthest = distances.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let axis = |view: usize| cameras[view].camera_from_world.row(2);
    let apart = |at: usize| distances[at] / farthest + 1.0 - axis(views[at]).dot(axis(view));
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|&a, &b| apart(a).total_cmp(&apart(b)));
    order.into_iter().take(1 + NEIGHBOURS).map(|at| views[at]).collect()
}

/// Mean by which a view is brighter than those with the most common points, stops; `None` if there are none.
fn difference_from_neighbours(view: usize, shown: &HashMap<usize, PhotoLuminances>) -> Option<f64> {
    let own = shown.get(&view)?;
    let mut compared: Vec<(usize, f64)> = Vec::new();
    for (_, other) in shown.iter().filter(|(other, _)| **other != view) {
        let towards = |from: Vec3, point: Vec3| (from - point).normalize_or_zero();
        let difference = |(key, luminance): (&[u32; 3], &f64)| {
            let point = Vec3::from_array(key.map(f32::from_bits));
            let cosine = towards(own.position, point).dot(towards(other.position, point));
            other.luminances.get(key).filter(|_| cosine >= MIN_COSINE).map(|theirs| luminance - theirs)
        };
        let mut all: Vec<f64> = own.luminances.iter().filter_map(difference).collect();
        if all.len() >= MIN_POINTS {
            let middle = all.len() / 2;
            compared.push((all.len(), *all.select_nth_unstable_by(middle, f64::total_cmp).1));
        }
    }
    compared.sort_by(|a, b| Reverse(a.0).cmp(&Reverse(b.0)).then(a.1.total_cmp(&b.1)));
    compared.truncate(NEIGHBOURS);
    let sum: f64 = compared.iter().map(|(_, difference)| difference).sum();
    (!compared.is_empty()).then(|| sum / compared.len() as f64)
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
        let cell_max = nearest.entry(*cell).or_default();
        *cell_max = cell_max.max(*inverse_z);
    }
    let in_front = placed.into_iter().filter(|(cell, inverse_z, _)| inverse_z * BEHIND >= nearest[cell]);
    in_front.map(|(.., point)| point).collect()
}

fn luminances(view: &View, track: &[Vec3]) -> Result<HashMap<[u32; 3], f64>> {
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
        MEASURED.contains(&mean).then_some((point.to_array().map(f32::to_bits), f64::from(mean).log2()))
    };
    Ok(track.iter().filter_map(around).collect())
}
