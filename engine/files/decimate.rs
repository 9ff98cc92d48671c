//! Reduces the number of Gaussians: merges neighbours into one Gaussian of the same moments.

use glam::{DMat3, DQuat, DVec3};
use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use rayon::prelude::*;

use ashsplat::scene::gaussians::{Gaussians, sh_coefficients};
use ashsplat::scene::sh::C0;

/// Neighbours that each Gaussian may be merged with.
const NEIGHBOURS: usize = 8;
/// Bytes per Gaussian that a round needs beside the Gaussians. Pairs are in memory three times while they are collected
/// and sorted; the tree has 64 bytes per Gaussian.
pub(crate) const BYTES: u64 = (3 * NEIGHBOURS * size_of::<Pair>() + size_of::<Summary>() + 64) as u64;
/// Largest share of the Gaussians that one round removes: later rounds see the merged ones.
const SHARE_PER_ROUND: f64 = 0.2;
/// Weight of a difference in colour (0 to 1) beside one of place, in units of the Gaussians' size.
const COLOR_WEIGHT: f64 = 20.0;
/// Weight of the distance in place and colour against the difference of pictures. Pictures of single pairs do not show
/// their surroundings, and later rounds merge Gaussians that earlier ones have mixed. From 0 to 0.2 coarse levels gain
/// 0.6 dB (tools/experiments.md).
const APART_WEIGHT: f64 = 0.2;
/// Weight of a difference in opacity against one in a channel's colour: other Gaussians may lie behind.
const OPACITY_WEIGHT: f64 = 0.5;
/// Largest opacity of a merged Gaussian: the rasterizer's largest alpha.
const MAX_OPACITY: f64 = 0.99;
/// Largest growth of a merged Gaussian's covariance in place of its opacity. Two Gaussians side by side, which cover
/// twice the area of one, need 2.
const MAX_GROWTH: f64 = 4.0;
/// Least flatness of a Gaussian's picture, as the square of its axes' ratio. The determinant of a flatter one is a
/// rounding error of two equal products, and areas of such needles would differ by a hundred powers of ten.
const FLATTEST: f64 = 1e-12;

/// Merges pairs of neighbours until at most `target` are left (at least 1).
///
/// The cheapest pairs go first: those that change pictures least, near to each other for their size and alike in
/// colour. A merged Gaussian has the mean, covariance and colour of both, weighted by opacity times area, and the sum
/// of their opacity times area. If its opacity would exceed the largest, it grows instead, so that opaque surfaces get
/// no holes.
pub fn decimate(gaussians: &mut Gaussians, target: usize) {
    let target = target.max(1);
    while gaussians.len() > target {
        let excess = gaussians.len() - target;
        let largest_step = (SHARE_PER_ROUND * gaussians.len() as f64).ceil() as usize;
        let pairs = disjoint(candidates(gaussians), gaussians.len(), excess.min(largest_step));
        if pairs.is_empty() {
            // No Gaussian has a neighbour at a finite distance.
            *gaussians = gaussians.select(&(0..target).collect::<Vec<_>>());
            return;
        }
        *gaussians = merged(gaussians, &pairs);
    }
}

struct Pair {
    cost: f64,
    first: usize,
    second: usize,
}

/// Properties of a Gaussian that the cost depends on.
struct Summary {
    mean: DVec3,
    covariance: DMat3,
    opacity: f64,
    /// Opacity times area.
    mass: f64,
    size2: f64,
    /// Colour at SH degree 0, from 0 to 1.
    color: DVec3,
}

struct MergedPair {
    mean: DVec3,
    covariance: DMat3,
    opacity: f64,
    /// Share of each in the mass.
    share: [f64; 2],
}

/// Axes of the pictures along the three coordinate directions.
const PICTURES: [[usize; 2]; 3] = [[0, 1], [1, 2], [2, 0]];

fn summary(gaussians: &Gaussians, index: usize) -> Summary {
    let covariance = covariance_of(gaussians, index);
    let opacity = f64::from(gaussians.opacity(index));
    Summary {
        mean: DVec3::from_array(gaussians.means[index].map(f64::from)),
        covariance,
        opacity,
        mass: opacity * area(&covariance),
        size2: (0..3).map(|axis| covariance.col(axis)[axis]).sum::<f64>() / 3.0,
        color: DVec3::from_array(gaussians.sh_of(index)[0].map(f64::from)) * C0 + 0.5,
    }
}

/// Projected area over 2π: the mean of three pictures.
fn area(covariance: &DMat3) -> f64 {
    PICTURES.iter().map(|&picture| determinant(covariance, picture).sqrt()).sum::<f64>() / 3.0
}

fn determinant(covariance: &DMat3, [x, y]: [usize; 2]) -> f64 {
    let (xx, yy, xy) = (covariance.col(x)[x], covariance.col(y)[y], covariance.col(x)[y]);
    (xx * yy - xy * xy).max(FLATTEST * xx * yy).max(f64::MIN_POSITIVE)
}

/// Integral over a picture of the product of two Gaussians of opacity 1 with means `apart` from each other, divided by 2π.
fn overlap(a: &DMat3, b: &DMat3, apart: DVec3, picture: [usize; 2]) -> f64 {
    let sum = *a + *b;
    let [x, y] = picture;
    let (xx, yy, xy) = (sum.col(x)[x], sum.col(y)[y], sum.col(x)[y]);
    let (dx, dy, both) = (apart[x], apart[y], determinant(&sum, picture));
    let distance2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / both;
    let areas = determinant(a, picture).sqrt() * determinant(b, picture).sqrt();
    areas / both.sqrt() * libm::exp(-0.5 * distance2)
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

fn merged_pair(a: &Summary, b: &Summary) -> MergedPair {
    let mass = a.mass + b.mass;
    let share = if mass > 0.0 { [a.mass / mass, b.mass / mass] } else { [0.5; 2] };
    let mean = share[0] * a.mean + share[1] * b.mean;
    let spread = |own: &Summary| own.covariance + outer(own.mean - mean);
    let covariance = share[0] * spread(a) + share[1] * spread(b);
    let opacity = mass / area(&covariance);
    let growth = (opacity / MAX_OPACITY).clamp(1.0, MAX_GROWTH);
    let (covariance, opacity) = (covariance * growth, (opacity / growth).clamp(1e-6, MAX_OPACITY));
    MergedPair { mean, covariance, opacity, share }
}

/// The squared difference between the pictures of two Gaussians and the picture of the merged one, over 2π. It is
/// integrated over the picture and summed over three directions of view, in closed form. Each Gaussian adds its opacity
/// times its colour, without occlusion.
fn picture_difference(a: &Summary, b: &Summary) -> f64 {
    let one = merged_pair(a, b);
    let of = |own: &Summary| own.color.extend(OPACITY_WEIGHT) * own.opacity;
    let color = one.share[0] * a.color + one.share[1] * b.color;
    let terms = [
        (of(a), a.mean, &a.covariance),
        (of(b), b.mean, &b.covariance),
        (-one.opacity * color.extend(OPACITY_WEIGHT), one.mean, &one.covariance),
    ];
    let mut sum = 0.0;
    for (i, (own, mean, covariance)) in terms.iter().enumerate() {
        for (j, (other, other_mean, other_covariance)) in terms.iter().enumerate().skip(i) {
            let overlaps = PICTURES.map(|p| overlap(covariance, other_covariance, *mean - *other_mean, p));
            let times = if i == j { 1.0 } else { 2.0 };
            sum += times * own.dot(*other) * overlaps.iter().sum::<f64>();
        }
    }
    // Rounding may make the sum negative.
    sum.max(0.0)
}

fn cost(a: &Summary, b: &Summary) -> f64 {
    let apart = a.mean.distance_squared(b.mean) / (a.size2 + b.size2).max(f64::MIN_POSITIVE);
    let mass = a.mass * b.mass / (a.mass + b.mass).max(f64::MIN_POSITIVE);
    let differs = apart + COLOR_WEIGHT * a.color.distance_squared(b.color);
    picture_difference(a, b) + APART_WEIGHT * mass * differs
}

fn candidates(gaussians: &Gaussians) -> Vec<Pair> {
    let mut tree = KdTree::new(3);
    for (index, mean) in gaussians.means.iter().enumerate() {
        // A position that is not finite has no neighbours.
        let _ = tree.add(mean.map(f64::from), index);
    }
    let summaries: Vec<Summary> = (0..gaussians.len()).map(|index| summary(gaussians, index)).collect();
    let pairs_of = |first: usize| {
        let place = gaussians.means[first].map(f64::from);
        let nearest = tree.nearest(&place, NEIGHBOURS + 1, &squared_euclidean).unwrap_or_default();
        let others = nearest.into_iter().map(|(_, &second)| second).filter(|&second| second != first);
        let pair = |second: usize| {
            // Ordered indices, so that the cost is the same from either side.
            let (first, second) = (first.min(second), first.max(second));
            Pair { cost: cost(&summaries[first], &summaries[second]), first, second }
        };
        others.map(pair).collect::<Vec<_>>()
    };
    let mut pairs: Vec<Pair> = (0..gaussians.len()).into_par_iter().flat_map_iter(pairs_of).collect();
    pairs.par_sort_by(|a, b| a.cost.total_cmp(&b.cost).then((a.first, a.second).cmp(&(b.first, b.second))));
    pairs
}

/// The cheapest pairs, at most `max`, of which no two share a Gaussian.
fn disjoint(pairs: Vec<Pair>, count: usize, max: usize) -> Vec<(usize, usize)> {
    let mut taken = vec![false; count];
    let free = pairs.into_iter().filter(|pair| {
        let free = !taken[pair.first] && !taken[pair.second];
        taken[pair.first] |= free;
        taken[pair.second] |= free;
        free
    });
    free.take(max).map(|pair| (pair.first, pair.second)).collect()
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
    let [a, b] = pair.map(|index| summary(all, index));
    let MergedPair { mean, covariance, opacity, share } = merged_pair(&a, &b);
    let (axes, variances) = eigen(covariance);
    let scales = variances.map(|v| v.max(f64::MIN_POSITIVE).sqrt());
    let rotation = DQuat::from_mat3(&axes).normalize();
    left.means.push(mean.as_vec3().to_array());
    left.quats.push([rotation.w, rotation.x, rotation.y, rotation.z].map(|q| q as f32));
    left.log_scales.push(scales.map(|s| libm::log(s) as f32));
    left.opacity_logits.push(libm::log(opacity / (1.0 - opacity)) as f32);
    let [first, second] = pair.map(|index| all.sh_of(index));
    for k in 0..sh_coefficients(all.sh_degree) {
        left.sh.push(std::array::from_fn(|channel| {
            (share[0] * f64::from(first[k][channel]) + share[1] * f64::from(second[k][channel])) as f32
        }));
    }
}

/// Covariance of a Gaussian, world units squared.
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
            let theta = 0.5 * libm::atan2(2.0 * off, a.col(q)[q] - a.col(p)[p]);
            let (sin, cos) = libm::sincos(theta);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    fn of(mean: DVec3, sigmas: DVec3, opacity: f64) -> Summary {
        let covariance = DMat3::from_diagonal(sigmas * sigmas);
        let (mass, size2) = (opacity * area(&covariance), sigmas.length_squared() / 3.0);
        Summary { mean, covariance, opacity, mass, size2, color: DVec3::splat(0.5) }
    }

    /// Compares with sums over the pixels of three pictures.
    #[test]
    fn differences_of_pictures_are_those_of_sums() {
        let _turn = turn();
        let a =
            Summary { color: DVec3::new(0.9, 0.2, 0.4), ..of(DVec3::ZERO, DVec3::new(0.5, 0.3, 0.4), 0.8) };
        let b = of(DVec3::new(0.6, -0.3, 0.2), DVec3::new(0.2, 0.6, 0.3), 0.5);
        let one = merged_pair(&a, &b);
        let color = one.share[0] * a.color + one.share[1] * b.color;
        let terms = [
            (a.opacity * a.color.extend(OPACITY_WEIGHT), a.mean, a.covariance),
            (b.opacity * b.color.extend(OPACITY_WEIGHT), b.mean, b.covariance),
            (-one.opacity * color.extend(OPACITY_WEIGHT), one.mean, one.covariance),
        ];
        let (mut sum, step) = (0.0, 0.05);
        for [x, y] in PICTURES {
            for (i, j) in (-80..=80).flat_map(|i| (-80..=80).map(move |j| (i, j))) {
                let at = [i, j].map(|k| f64::from(k) * step);
                let value = terms.iter().map(|(value, mean, covariance)| {
                    let (dx, dy) = (at[0] - mean[x], at[1] - mean[y]);
                    let (xx, yy, xy) = (covariance.col(x)[x], covariance.col(y)[y], covariance.col(x)[y]);
                    let distance2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
                    *value * libm::exp(-0.5 * distance2)
                });
                sum += value.sum::<glam::DVec4>().length_squared() * step * step;
            }
        }
        let (found, expected) = (picture_difference(&a, &b), sum / std::f64::consts::TAU);
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        // Two identical faint Gaussians merge exactly, but for their mutual occlusion, which the measure ignores.
        let faint = || of(DVec3::ONE, DVec3::splat(0.3), 0.1);
        assert!(picture_difference(&faint(), &faint()) < 1e-12);
    }

    #[test]
    fn opaque_ones_keep_what_they_cover() {
        let _turn = turn();
        let [a, b] = [-0.4, 0.4].map(|x| of(DVec3::X * x, DVec3::splat(0.5), 0.98));
        let near = merged_pair(&a, &b);
        assert!((near.opacity * area(&near.covariance) / (a.mass + b.mass) - 1.0).abs() < 1e-9);
        assert!(near.opacity == MAX_OPACITY && near.covariance.col(1)[1] > 1.2 * 0.25, "{}", near.covariance);
        // A faint Gaussian keeps its size.
        let [a, b] = [-0.4, 0.4].map(|x| of(DVec3::X * x, DVec3::splat(0.5), 0.3));
        let faint = merged_pair(&a, &b);
        assert!((faint.covariance.col(1)[1] - 0.25).abs() < 1e-12 && faint.opacity < 0.6);
    }

    /// The determinant of a needle's picture is a rounding error, which must not make a Gaussian enormous.
    #[test]
    fn needles_do_not_grow() {
        let _turn = turn();
        for index in 0..200 {
            let angle = 0.01 + 0.03 * f64::from(index);
            let along = DVec3::new(angle.cos(), (0.7 * angle).sin(), angle.sin()).normalize();
            let needle = |mean: DVec3| {
                let covariance = outer(along) + DMat3::from_diagonal(DVec3::splat(1e-20));
                let color = DVec3::splat(0.5);
                Summary { mean, covariance, opacity: 0.9, mass: 0.9 * area(&covariance), size2: 1.0, color }
            };
            let (a, b) = (needle(DVec3::ZERO), needle(0.3 * along));
            let one = merged_pair(&a, &b);
            let max = one.covariance.to_cols_array().into_iter().fold(0.0, |max: f64, x| max.max(x.abs()));
            assert!(max < 5.0 && one.opacity <= MAX_OPACITY, "{along}: {max} {}", one.opacity);
        }
    }
}
