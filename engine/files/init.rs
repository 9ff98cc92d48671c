//! The initial Gaussians of training.

use std::collections::HashMap;

use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use ashsplat::scene::camera::Camera;
use ashsplat::scene::gaussians::{Gaussians, MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::points::{Bounds, PointCloud};
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat::scene::{nearest_to_axes, without_strays};
use ashsplat::{Error, Result};

/// Number of random points that replace a missing point cloud (reference implementation).
pub const RANDOM_POINTS: usize = 100_000;

const INITIAL_OPACITY: f64 = 0.1;
/// Smallest mean squared distance to the neighbours, so that coincident points get a size, world units².
const MIN_SQUARED_DISTANCE: f64 = 1e-7;
/// Number of neighbours whose distance sets a Gaussian's size.
const NEIGHBOURS: usize = 3;

/// One isotropic Gaussian per point, as in the reference implementation: standard deviation = root of
/// [`mean_squared_neighbour_distances`], identity rotation, opacity 0.1, the point's colour, no view
/// dependence. `sh` has all coefficients of `sh_degree`.
pub fn initial_gaussians(points: &PointCloud, sh_degree: u32) -> Result<Gaussians> {
    if sh_degree > MAX_SH_DEGREE {
        return Err(Error::argument("sh_degree", format!("{sh_degree} is not between 0 and 3")));
    }
    if points.colors.len() != points.len() {
        let (p, c) = (points.len(), points.colors.len());
        return Err(Error::argument("points", format!("{p} positions but {c} colours")));
    }
    let dist2 = mean_squared_neighbour_distances(&points.positions)?;
    let logit = (INITIAL_OPACITY / (1.0 - INITIAL_OPACITY)).ln() as f32;
    let mut sh = Vec::with_capacity(points.len() * sh_coefficients(sh_degree));
    for color in &points.colors {
        sh.push(color.map(|c| rgb_to_sh_dc(f32::from(c) / 255.0)));
        sh.resize(sh.len() + sh_coefficients(sh_degree) - 1, [0.0; 3]);
    }
    Ok(Gaussians {
        sh_degree,
        means: points.positions.clone(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; points.len()],
        log_scales: dist2.iter().map(|&d| [(0.5 * d.ln()) as f32; 3]).collect(),
        opacity_logits: vec![logit; points.len()],
        sh,
    })
}

/// For each point the mean of the squared distances to its 3 nearest other points, at least 1e-7, world units².
///
/// Coincident points are neighbours at distance 0. Where there are fewer than 3 other points, the mean is over
/// those; a lone point gets the minimum.
pub fn mean_squared_neighbour_distances(positions: &[[f32; 3]]) -> Result<Vec<f64>> {
    // Coincident points are merged first: in a search tree they would degenerate to a list.
    let mut copies: HashMap<[u32; 3], usize> = HashMap::with_capacity(positions.len());
    let mut tree = KdTree::new(3);
    for (index, position) in positions.iter().enumerate() {
        // Adding 0 merges -0 and 0, which differ only in the sign bit.
        let key = position.map(|v| (v + 0.0).to_bits());
        let count = copies.entry(key).or_insert(0);
        *count += 1;
        if *count == 1 {
            tree.add(position.map(f64::from), key).map_err(|e| {
                Error::argument("points", format!("point {index} at {position:?} cannot be placed: {e}"))
            })?;
        }
    }
    let mean = |position: &[f32; 3]| {
        let nearest = tree.nearest(&position.map(f64::from), NEIGHBOURS + 1, &squared_euclidean);
        let nearest =
            nearest.map_err(|e| Error::argument("points", format!("no neighbours of {position:?}: {e}")))?;
        // Each position counts once per coincident point. The first count is the point itself.
        let distances = nearest.iter().flat_map(|&(d, key)| std::iter::repeat_n(d, copies[key]));
        let (sum, n) = distances.skip(1).take(NEIGHBOURS).fold((0.0, 0), |(s, n), d| (s + d, n + 1));
        Ok((sum / f64::from(n.max(1))).max(MIN_SQUARED_DISTANCE))
    };
    positions.par_iter().map(mean).collect()
}

/// Grey points, uniformly distributed in a box; the same ones for the same seed.
pub fn random_points(count: usize, bounds: Bounds, seed: u64) -> PointCloud {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (min, size) = (bounds.min.to_array(), bounds.size().to_array());
    let positions = (0..count)
        .map(|_| std::array::from_fn(|axis| min[axis] + size[axis] * random.random::<f32>()))
        .collect();
    PointCloud { positions, colors: vec![[128; 3]; count] }
}

/// Depths between which [`points_in_view`] places its points, in units of the cameras' spread.
const DEPTHS: [f32; 2] = [0.25, 16.0];

/// Grey points inside the cameras' views. Each camera's points are uniform in its picture and in the
/// logarithm of the depth, from a quarter to 16 times `spread`. The same seed gives the same points. Empty
/// without cameras.
pub fn points_in_view(count: usize, cameras: &[Camera], spread: f32, seed: u64) -> PointCloud {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let [near, far] = DEPTHS.map(|depth| (depth * spread).ln());
    let positions = cameras.iter().cycle().take(count).map(|camera| {
        let [u, v, t] = std::array::from_fn(|_| random.random::<f32>());
        let depth = (near + (far - near) * t).exp();
        camera.points()([u * camera.width as f32, v * camera.height as f32], depth).to_array()
    });
    let positions: Vec<[f32; 3]> = positions.collect();
    PointCloud { colors: vec![[128; 3]; positions.len()], positions }
}

/// Edge of the box as a share of the width that a typical camera sees.
const SEEN_SHARE: f32 = 0.9;

/// The cube that cameras around a scene look at. Its centre is the point nearest to all their axes. Its half edge is a
/// little less than what the typical camera sees to each side of the centre. Stray cameras are ignored. `None` if the
/// cameras do not look at one place: the centre is behind more than a tenth of them, or their axes are parallel.
pub fn seen_box(cameras: &[Camera]) -> Option<Bounds> {
    let cameras = &without_strays(cameras, Camera::position);
    let center = nearest_to_axes(cameras, 1e-6)?;
    let half_edge = |camera: &Camera| {
        let depth = camera.forward().dot(center - camera.position());
        let half = (0.5 * camera.width as f32 / camera.fx).min(0.5 * camera.height as f32 / camera.fy);
        // Fisheyes and panoramas see the cameras' surroundings beyond 45 degrees, not the place between the cameras.
        let half = if camera.projection.orders_by_distance() { half.min(1.0) } else { half };
        (depth > 0.0).then_some(depth * half)
    };
    let mut half_edges: Vec<f32> = cameras.iter().filter_map(half_edge).collect();
    if 10 * half_edges.len() < 9 * cameras.len() {
        return None;
    }
    half_edges.sort_unstable_by(f32::total_cmp);
    let half_edge = SEEN_SHARE * *half_edges.get(half_edges.len() / 2)?;
    (half_edge > 0.0).then(|| Bounds { min: center - half_edge, max: center + half_edge })
}
