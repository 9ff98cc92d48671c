//! Chances and draws of Gaussians: the twins of `densify/draw_keys`, `densify/mark_drawn`, `densify/draw_weights`,
//! `densify/draw_sources`, `densify/opacity_keys`, `densify/edge_response`, `densify/edge_gradient`,
//! `densify/sum_weights` and `densify/add_importance`.

use super::gather::pcg4d;
use super::linear::sigmoid;

/// The generator's number for a Gaussian, within (0, 1).
pub fn uniform([seed, iteration]: [u32; 2], gaussian: u32) -> f64 {
    (f64::from(pcg4d([seed, iteration, gaussian, 5])[0] >> 9) + 0.5) / f64::from(1 << 23)
}

/// -ln(u) / chance; None if the chance is 0.
pub fn key(chance: f64, u: f64) -> Option<f64> {
    (chance > 0.0).then(|| -u.ln() / chance)
}

/// Returns 1 for the `wanted` smallest keys; among equal keys the first win.
pub fn mark(keys: &[Option<f64>], wanted: usize) -> Vec<u32> {
    let mut order: Vec<usize> = (0..keys.len()).filter(|&i| keys[i].is_some()).collect();
    order.sort_by(|&a, &b| keys[a].partial_cmp(&keys[b]).expect("no NaN"));
    let mut selected = vec![0; keys.len()];
    order.into_iter().take(wanted).for_each(|i| selected[i] = 1);
    selected
}

/// Weight of opacity 1, so that the sum of `count` weights fits 32 bits.
pub fn unit(count: usize) -> f64 {
    f64::from((u32::MAX / count.max(1) as u32).min(1 << 24))
}

/// Weight of a Gaussian with this logit; 0 for opacities up to `min`.
pub fn weight(logit: f64, unit: f64, min: f64) -> f64 {
    let opacity = sigmoid(logit);
    if opacity > min { (opacity * unit).floor().max(1.0) } else { 0.0 }
}

/// Returns source and kind (0: kept, 1: copy) of each row, and the number of draws of each Gaussian. `bits` gives a
/// row's random word.
pub fn draw(weights: &[u32], rows: usize, bits: impl Fn(usize) -> u32) -> (Vec<(usize, u32)>, Vec<u32>) {
    let total: u64 = weights.iter().map(|&w| u64::from(w)).sum();
    let mut draws = vec![0; weights.len()];
    let sources = (0..rows).map(|row| {
        if total == 0 || weights.get(row).is_some_and(|&weight| weight > 0) {
            return (row.min(weights.len() - 1), 0);
        }
        let place = (u64::from(bits(row)) * total) >> 32;
        // Number of inclusive prefix sums up to `place`.
        let mut sum = 0;
        let passed = weights.iter().take_while(|&&weight| {
            sum += u64::from(weight);
            sum <= place
        });
        let source = passed.count();
        draws[source] += 1;
        (source, 1)
    });
    (sources.collect(), draws)
}

/// The opacities in ascending order.
pub fn sorted(logits: &[f64]) -> Vec<f64> {
    let mut opacities: Vec<f64> = logits.iter().copied().map(sigmoid).collect();
    opacities.sort_by(f64::total_cmp);
    opacities
}

/// round((299 R + 587 G + 114 B) / 1000), halves to even.
pub fn gray([r, g, b]: [u8; 3]) -> i64 {
    let sum = 299 * i64::from(r) + 587 * i64::from(g) + 114 * i64::from(b);
    // A sum is either exactly a half or far from one.
    (sum as f64 / 1000.0).round_ties_even() as i64
}

/// 8 centre - 8 neighbours, 0 outside, limited to 0..=255. Row-major.
pub fn responses(gray: &[i64], [width, height]: [usize; 2]) -> Vec<i64> {
    let at = |x: i64, y: i64| {
        let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
        if inside { gray[y as usize * width + x as usize] } else { 0 }
    };
    let response = |i: usize| {
        let (x, y) = ((i % width) as i64, (i / width) as i64);
        let mut sum = 8 * at(x, y);
        for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
            sum -= at(x + dx, y + dy);
        }
        sum.clamp(0, 255)
    };
    (0..width * height).map(response).collect()
}

/// Maps the smallest response to 0 and the largest to 1; 0 if all are equal.
pub fn edges(responses: &[i64]) -> Vec<f64> {
    let low = responses.iter().copied().min().unwrap_or(0);
    let high = responses.iter().copied().max().unwrap_or(0);
    let span = if high > low { (high - low) as f64 } else { f64::INFINITY };
    responses.iter().map(|&response| (response - low) as f64 / span).collect()
}

/// Sum of the instances' weights of each Gaussian.
pub fn sum_weights(instances: &[Vec<f64>]) -> Vec<f64> {
    instances.iter().map(|own| own.iter().sum::<f64>().max(0.0)).collect()
}

/// The weights of a view from 0 (the smallest) to 1 (the largest); 0 if all are equal.
pub fn importance_in_view(weights: &[f64]) -> Vec<f64> {
    let low = weights.iter().copied().fold(f64::INFINITY, f64::min);
    let high = weights.iter().copied().fold(0.0, f64::max);
    weights.iter().map(|weight| if high > low { (weight - low) / (high - low) } else { 0.0 }).collect()
}

pub fn importance(views: &[Vec<f64>]) -> Vec<f64> {
    let mut mean = vec![0.0; views.first().map_or(0, Vec::len)];
    for weights in views {
        for (mean, own) in mean.iter_mut().zip(importance_in_view(weights)) {
            *mean += own / views.len() as f64;
        }
    }
    mean
}
