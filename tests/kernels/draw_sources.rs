//! `densify/draw_sources` against its twin.

use ashsplat::kernels::densify::draw_sources::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, sizes};
use crate::common::scenes::Random;
use crate::reference::draw_sources::draw;
use crate::reference::gather::pcg4d;

const KEY: [u32; 3] = [42, 700, 3];

struct Drawn {
    sources: Vec<(usize, u32)>,
    draws: Vec<u32>,
}

fn drawn(gpu: &Gpu, weights: &[u32], rows: usize, uniforms: Option<&[f32]>) -> Drawn {
    let spec = Spec { workgroup_size: gpu.workgroup(64), explicit_uniforms: uniforms.is_some() };
    let kernel = gpu.kernel::<Interface>(&spec);
    let prefix: Vec<u32> = weights
        .iter()
        .scan(0, |sum, &weight| {
            *sum += weight;
            Some(*sum - weight)
        })
        .collect();
    let total: u32 = weights.iter().sum();
    let count = weights.len();
    let [weights, prefix, totals, uniforms] = [
        gpu.buffer("weights", weights),
        gpu.buffer("prefix", &prefix),
        gpu.buffer("totals", &[count as u32, total, 0, 0]),
        gpu.buffer("uniforms", uniforms.unwrap_or(&[0.0; 4])),
    ];
    let (sources, draws) = (gpu.untouched::<u32>("sources", rows), gpu.zeros::<u32>("draws", count));
    let bind = Bind {
        weights: &weights,
        prefix: &prefix,
        totals: &totals,
        uniforms: &uniforms,
        sources: &sources,
        draws: &draws,
    };
    let [seed, iteration, stream] = KEY;
    let push = Push { count: count as u32, rows: rows as u32, seed, iteration, stream };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, rows as u64 / u64::from(spec.workgroup_size) + 1));
    let sources = gpu.read::<u32>(&sources, rows).into_iter();
    Drawn {
        sources: sources.map(|source| ((source & 0x3FFF_FFFF) as usize, source >> 30)).collect(),
        draws: gpu.read(&draws, count),
    }
}

#[test]
fn draw_sources_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        let mut random = Random::new(size as u64);
        // Also sums near the end of 32 bits, and weights that allow no draw.
        for most in [5, u32::MAX / size as u32, 1] {
            let mut weight = || if random.below(3) == 0 { 0 } else { random.below(most) };
            let weights: Vec<u32> = (0..size).map(|_| weight()).collect();
            let rows = size + size / 3 + 1;
            let actual = drawn(&gpu, &weights, rows, None);
            let [seed, iteration, stream] = KEY;
            let (sources, draws) =
                draw(&weights, rows, |row| pcg4d([seed, iteration, row as u32, stream])[0]);
            assert_eq!(actual.sources, sources, "{size} up to {most}");
            assert_eq!(actual.draws, draws, "{size} up to {most}");
        }
    }
}

/// Draws are in proportion to the weights: 60,000 draws of three, within four standard deviations.
#[test]
fn draws_follow_the_weights() {
    let gpu = Gpu::new();
    let weights = [10, 0, 30, 60];
    let rows = 60_004;
    let Drawn { draws, .. } = drawn(&gpu, &weights, rows, None);
    // The second Gaussian cannot be drawn, and its row takes a draw as well.
    let all = f64::from(draws.iter().sum::<u32>());
    assert_eq!(all as usize, rows - 3);
    for (weight, drawn) in weights.into_iter().zip(draws) {
        let share = f64::from(weight) / 100.0;
        let deviation = (all * share * (1.0 - share)).sqrt();
        assert!((f64::from(drawn) - all * share).abs() <= 4.0 * deviation, "{weight}: {drawn} of {all}");
    }
}

#[test]
fn explicit_uniform_numbers_are_taken() {
    let gpu = Gpu::new();
    let uniforms = [0.0, 0.0, 0.0, 0.0, 0.24, 0.26, 0.999_999_9];
    let Drawn { sources, draws } = drawn(&gpu, &[1, 0, 2, 1], 7, Some(&uniforms));
    assert_eq!(sources, [(0, 0), (0, 1), (2, 0), (3, 0), (0, 1), (2, 1), (3, 1)]);
    assert_eq!(draws, [2, 0, 1, 1]);
}
