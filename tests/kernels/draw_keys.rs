//! `densify/draw_keys` against its twin.

use ashsplat::kernels::constants::{CHANCE_EQUAL, CHANCE_IMPORTANCE, CHANCE_STATISTIC, NOT_DRAWN};
use ashsplat::kernels::densify::draw_keys::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::draw_keys::{key, uniform};

const KEY: [u32; 2] = [42, 700];
const THRESHOLD: f32 = 0.5;

/// Inputs of the kernel for a Gaussian.
#[derive(Clone, Copy)]
struct Row {
    statistic: [f32; 2],
    absolute: f32,
    importance: f32,
    uniform: f32,
}

/// Variant of the kernel.
#[derive(Clone, Copy, Debug)]
struct How {
    absolute: bool,
    explicit: bool,
    chances: u32,
}

fn run(gpu: &Gpu, rows: &[Row], how: How) -> (Vec<u32>, u32) {
    let How { absolute, explicit, chances } = how;
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = Spec { workgroup_size, subgroup_size, absolute, explicit_uniforms: explicit };
    let column = |of: fn(&Row) -> f32| rows.iter().map(of).collect::<Vec<f32>>();
    let statistics: Vec<[f32; 2]> = rows.iter().map(|row| row.statistic).collect();
    let [keys, selected] = ["keys", "selected"].map(|name| gpu.untouched::<u32>(name, rows.len() + 1));
    let totals = gpu.buffer("totals", &[rows.len() as u32, 0, 0, 0]);
    let bind = Bind {
        statistics: &gpu.buffer("statistics", &statistics),
        absolute_statistics: &gpu.buffer("absolute_statistics", &column(|row| row.absolute)),
        importance: &gpu.buffer("importance", &column(|row| row.importance)),
        uniforms: &gpu.buffer("uniforms", &column(|row| row.uniform)),
        keys: &keys,
        selected: &selected,
        totals: &totals,
    };
    let [seed, iteration] = KEY;
    let push = Push { count: rows.len() as u32, threshold: THRESHOLD, chances, seed, iteration };
    gpu.dispatch::<Interface>(&spec, &bind, &push, rows.len() as u64 / u64::from(spec.workgroup_size) + 1);
    let selected = gpu.read::<u32>(&selected, rows.len() + 1);
    assert!(selected[..rows.len()].iter().all(|&selected| selected == 0));
    assert_eq!(selected[rows.len()], UNTOUCHED);
    (gpu.read(&keys, rows.len()), gpu.read::<u32>(&totals, 4)[1])
}

fn check(gpu: &Gpu, rows: &[Row], how: How) {
    let (keys, candidates) = run(gpu, rows, how);
    let mut expected_candidates = 0;
    for (i, (row, &actual)) in rows.iter().zip(&keys).enumerate() {
        let [sum, views] = row.statistic.map(f64::from);
        let sum = if how.absolute { f64::from(row.absolute) } else { sum };
        let mean = if views > 0.0 { sum / views } else { 0.0 };
        let chance = match how.chances {
            CHANCE_IMPORTANCE => f64::from(row.importance),
            CHANCE_STATISTIC => mean,
            _ => 1.0,
        };
        let chance = if views > 0.0 && mean >= f64::from(THRESHOLD) { chance } else { 0.0 };
        let u = if how.explicit { f64::from(row.uniform) } else { uniform(KEY, i as u32) };
        match key(chance, u) {
            None => assert_eq!(actual, NOT_DRAWN, "{how:?} {i}"),
            Some(key) => {
                expected_candidates += 1;
                let actual = f64::from(f32::from_bits(actual));
                assert!((actual - key).abs() <= 1e-6 * key, "{how:?} {i}: {actual}, expected {key}");
            }
        }
    }
    assert_eq!(candidates, expected_candidates, "{how:?}");
}

#[test]
pub fn draw_keys_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let mut random = Random::new(size as u64);
        let mut row = || Row {
            // Means on both sides of the threshold, none within rounding of it. Some Gaussians were never visible.
            statistic: [(random.below(16) * 2 + 1) as f32 / 8.0, random.below(4) as f32],
            absolute: (random.below(16) * 2 + 1) as f32 / 8.0,
            importance: if random.below(5) == 0 { 0.0 } else { random.unit() as f32 },
            uniform: 0.0,
        };
        let mut rows: Vec<Row> = (0..size).map(|_| row()).collect();
        // All magnitudes, especially near 1, where the largest keys are.
        let edges =
            [1e-37, 1e-7, 0.25, 0.5, f32::from_bits(0x3EFF_FFFF), 0.75, 0.999, f32::from_bits(0x3F7F_FFFF)];
        for (i, row) in rows.iter_mut().enumerate() {
            row.uniform = edges.get(i).copied().unwrap_or_else(|| (1e-6 + 0.999_99 * random.unit()) as f32);
        }
        for chances in [CHANCE_IMPORTANCE, CHANCE_STATISTIC, CHANCE_EQUAL] {
            for (absolute, explicit) in [(false, false), (false, true), (true, false), (true, true)] {
                check(&gpu, &rows, How { absolute, explicit, chances });
            }
        }
    }
}
