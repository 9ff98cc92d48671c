//! Fewer Gaussians that look alike: neighbours are merged into one of the same moments.

use glam::{DMat3, DQuat, DVec3};
use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use rayon::prelude::*;

use ashsplat::scene::gaussians::{Gaussians, sh_coefficients};
use ashsplat::scene::sh::C0;

/// Neighbours that each Gaussian may be merged with.
const NEIGHBOURS: usize = 8;

/// Share of the Gaussians that one round takes away at most: later rounds see the merged ones.
const SHARE_PER_ROUND: f64 = 0.2;

/// Weight of a difference in colour (0 to 1) beside one of place, in units of the Gaussians' size.
const COLOR_WEIGHT: f64 = 20.0;

/// Largest opacity of a merged Gaussian, as the rasterizer's largest alpha.
const MAX_OPACITY: f64 = 0.99;

/// Merges pairs of neighbours until at most `target` are left (at least 1).
///
/// The cheapest pairs go first: near to each other for their size, alike in colour, and faint or small. A merged
/// Gaussian has the mean, the covariance and the colour of the two together, weighted by opacity times area, and as
/// much opacity times area as both.
pub fn decimate(gaussians: &mut Gaussians, target: usize) {
    let target = target.max(1);
    while gaussians.len() > target {
        let excess = gaussians.len() - target;
        let largest_step = (SHARE_PER_ROUND * gaussians.len() as f64).ceil() as usize;
        let pairs = disjoint(candidates(gaussians), gaussians.len(), excess.min(largest_step));
        if pairs.is_empty() {
            // Nothing has a neighbour at a finite distance.
            *gaussians = gaussians.select(&(0..target).collect::<Vec<_>>());
            return;
        }
        *gaussians = merged(gaussians, &pairs);
    }
}

/// Two Gaussians and what merging them costs.
struct Pair {
    cost: f64,
    first: usize,
    second: usize,
}

/// What of a Gaussian enters the cost.
struct Brief {
    mass: f64,
    size2: f64,
    color: DVec3,
}

fn brief(gaussians: &Gaussians, index: usize) -> Brief {
    let scales = gaussians.log_scales[index].map(|s| f64::from(s).exp());
    Brief {
        mass: f64::from(gaussians.opacity(index)) * area(scales),
        size2: scales.iter().map(|s| s * s).sum::<f64>() / 3.0,
        color: DVec3::from_array(gaussians.sh_of(index)[0].map(f64::from)) * C0,
    }
}

/// About the area that is seen of it, up to a constant.
fn area([x, y, z]: [f64; 3]) -> f64 {
    (x * y + y * z + z * x) / 3.0
}

fn candidates(gaussians: &Gaussians) -> Vec<Pair> {
    let mut tree = KdTree::new(3);
    for (index, mean) in gaussians.means.iter().enumerate() {
        // A position that is not finite has no neighbours.
        let _ = tree.add(mean.map(f64::from), index);
    }
    let briefs: Vec<Brief> = (0..gaussians.len()).map(|index| brief(gaussians, index)).collect();
    let pairs_of = |first: usize| {
        let place = gaussians.means[first].map(f64::from);
        let nearest = tree.nearest(&place, NEIGHBOURS + 1, &squared_euclidean).unwrap_or_default();
        let a = &briefs[first];
        nearest
            .into_iter()
            .filter(|&(_, &second)| second != first)
            .map(|(distance2, &second)| {
                let b = &briefs[second];
                let apart = distance2 / (a.size2 + b.size2).max(f64::MIN_POSITIVE);
                let weight = a.mass * b.mass / (a.mass + b.mass).max(f64::MIN_POSITIVE);
                let cost = weight * (apart + COLOR_WEIGHT * a.color.distance_squared(b.color));
                Pair { cost, first: first.min(second), second: first.max(second) }
            })
            .collect::<Vec<_>>()
    };
    let mut pairs: Vec<Pair> = (0..gaussians.len()).into_par_iter().flat_map_iter(pairs_of).collect();
    pairs.par_sort_by(|a, b| a.cost.total_cmp(&b.cost).then((a.first, a.second).cmp(&(b.first, b.second))));
    pairs
}

/// The cheapest pairs of which no two share a Gaussian; `most` at most.
fn disjoint(pairs: Vec<Pair>, count: usize, most: usize) -> Vec<(usize, usize)> {
    let mut taken = vec![false; count];
    let free = pairs.into_iter().filter(|pair| {
        let free = !taken[pair.first] && !taken[pair.second];
        taken[pair.first] |= free;
        taken[pair.second] |= free;
        free
    });
    free.take(most).map(|pair| (pair.first, pair.second)).collect()
}

/// All Gaussians in their order, with the second of each pair merged into the first.
fn merged(gaussians: &Gaussians, pairs: &[(usize, usize)]) -> Gaussians {
    let mut partner: Vec<Option<usize>> = vec![None; gaussians.len()];
    let mut gone = vec![false; gaussians.len()];
    for &(first, second) in pairs {
        partner[first] = Some(second);
        gone[second] = true;
    }
    let mut left = Gaussians::with_capacity(gaussians.sh_degree, gaussians.len() - pairs.len());
    for index in (0..gaussians.len()).filter(|&index| !gone[index]) {
        match partner[index] {
            None => left.push_from(gaussians, index),
            Some(other) => push_merged(gaussians, [index, other], &mut left),
        }
    }
    left
}

fn push_merged(all: &Gaussians, pair: [usize; 2], left: &mut Gaussians) {
    let masses = pair.map(|index| brief(all, index).mass);
    let total = masses[0] + masses[1];
    let share = if total > 0.0 { masses.map(|mass| mass / total) } else { [0.5; 2] };
    let means = pair.map(|index| DVec3::from_array(all.means[index].map(f64::from)));
    let mean = share[0] * means[0] + share[1] * means[1];
    let mut covariance = DMat3::ZERO;
    for (index, (share, own_mean)) in pair.into_iter().zip(share.into_iter().zip(means)) {
        let off = own_mean - mean;
        covariance +=
            share * (covariance_of(all, index) + DMat3::from_cols(off * off.x, off * off.y, off * off.z));
    }
    let (axes, variances) = eigen(covariance);
    let scales = variances.map(|v| v.max(f64::MIN_POSITIVE).sqrt());
    let rotation = DQuat::from_mat3(&axes).normalize();
    let opacity = (total / area(scales).max(f64::MIN_POSITIVE)).clamp(1e-6, MAX_OPACITY);
    left.means.push(mean.as_vec3().to_array());
    left.quats.push([rotation.w, rotation.x, rotation.y, rotation.z].map(|q| q as f32));
    left.log_scales.push(scales.map(|s| s.ln() as f32));
    left.opacity_logits.push((opacity / (1.0 - opacity)).ln() as f32);
    let [first, second] = pair.map(|index| all.sh_of(index));
    for k in 0..sh_coefficients(all.sh_degree) {
        left.sh.push(std::array::from_fn(|channel| {
            (share[0] * f64::from(first[k][channel]) + share[1] * f64::from(second[k][channel])) as f32
        }));
    }
}

/// Covariance of one of all, world units squared.
pub(crate) fn covariance_of(all: &Gaussians, index: usize) -> DMat3 {
    let [w, x, y, z] = all.quats[index].map(f64::from);
    let quat = DQuat::from_xyzw(x, y, z, w);
    let rotation =
        DMat3::from_quat(if quat.length_squared() > 0.0 { quat.normalize() } else { DQuat::IDENTITY });
    let variances = all.log_scales[index].map(|s| (2.0 * f64::from(s)).exp());
    rotation * DMat3::from_diagonal(DVec3::from_array(variances)) * rotation.transpose()
}

/// Axes (a rotation) and variances along them of a symmetric matrix, by Jacobi's method.
fn eigen(matrix: DMat3) -> (DMat3, [f64; 3]) {
    const SWEEPS: usize = 12;
    let (mut a, mut axes) = (matrix, DMat3::IDENTITY);
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = a.col(q)[p];
            if off.abs() <= f64::EPSILON * (a.col(p)[p].abs() + a.col(q)[q].abs()) {
                continue;
            }
            // The rotation in the plane of p and q that makes this element 0.
            let theta = 0.5 * (2.0 * off).atan2(a.col(q)[q] - a.col(p)[p]);
            let (sin, cos) = theta.sin_cos();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = cos;
            turn.col_mut(q)[q] = cos;
            turn.col_mut(q)[p] = sin;
            turn.col_mut(p)[q] = -sin;
            a = turn.transpose() * a * turn;
            axes *= turn;
        }
    }
    (axes, [0, 1, 2].map(|axis| a.col(axis)[axis]))
}
