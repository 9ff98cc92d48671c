//! `forward/blend_shared` against the twin of `forward/blend`, and against `forward/blend` itself: to the bit on
//! CPUs.

use crate::common::blending::{
    Blended, CHAINED, How, UNCHAINED, assert_same, forward, forward_limited, forward_shared,
    forward_shared_limited, has_strips, strips_of,
};
use crate::common::gpu::Gpu;
use crate::common::scenes::small_view;
use crate::common::tiles::Lists;
use crate::reference::blend::blend;
use crate::reference::pipeline::pixels_of;

/// Blends by both kernels and by the twin.
fn check(gpu: &Gpu, lists: &Lists, workgroup_size: u32, entries_per_pass: u32) {
    check_one(gpu, lists, workgroup_size, How { entries_per_pass, ..UNCHAINED });
    // Columns of up to 8 pixels.
    check_one(gpu, lists, workgroup_size.min(32), How { entries_per_pass, ..CHAINED });
}

/// Compares colours, transmittances and inverse depths.
fn assert_alike(gpu: &Gpu, [a, b]: [&Blended; 2], count: usize, what: &str) {
    for (a, b, values) in
        [(&a.accumulated, &b.accumulated, 4 * count), (&a.inverse_depth, &b.inverse_depth, count)]
    {
        let [a, b] = [a, b].map(|buffer| gpu.read::<f32>(buffer, values));
        assert_same(gpu.context, &a, &b, (what, 1e-5));
    }
}

fn check_one(gpu: &Gpu, lists: &Lists, workgroup_size: u32, how: How) {
    let shared = forward_shared(gpu, lists, workgroup_size, how);
    let regions = forward(gpu, lists, How { entries_per_pass: u32::MAX, ..how });
    let count = lists.view.pixels();
    let what = format!("{workgroup_size} invocations, {how:?}");
    let words = |buffer, words: usize| gpu.read::<u32>(buffer, words);
    // Precise arithmetic decides everywhere which entries count.
    assert_eq!(words(&shared.last_entries, count), words(&regions.last_entries, count), "{what}");
    assert_alike(gpu, [&shared, &regions], count, &what);
    if has_strips(gpu) && how.incremental_exp {
        let how = How { strips: true, ..how };
        let shared = forward_shared(gpu, lists, workgroup_size, how);
        let regions = forward(gpu, lists, How { entries_per_pass: u32::MAX, ..how });
        let count = 3 * strips_of(lists).values() as usize;
        assert_eq!(words(&shared.composited, count), words(&regions.composited, count), "{what}");
    }

    let accumulated = gpu.read::<[f32; 4]>(&shared.accumulated, count);
    let unstable = lists.unstable();
    for (index, pixel) in pixels_of(&lists.view).enumerate().filter(|&(index, _)| !unstable[index]) {
        let expected = blend(&lists.list_of(pixel), pixel, [0.0; 3]);
        let [r, g, b, transmittance] = accumulated[index].map(f64::from);
        let [x, y, z] = expected.color;
        for (actual, expected) in [(r, x), (g, y), (b, z), (transmittance, expected.transmittance)] {
            assert!((actual - expected).abs() < 5e-5, "{what}, pixel {index}: {actual}, expected {expected}");
        }
    }
}

#[test]
fn blend_shared_equals_blend_on_lists_of_all_lengths() {
    let gpu = Gpu::new();
    let largest = gpu.context.limits().workgroup_size(256);
    for entries in [0, 1, 31, 32, 33, 127, 128, 129, 300] {
        let lists = Lists::long(&gpu, entries, [0.02, 0.6], &small_view([37, 21]));
        for workgroup_size in [32, 64, largest] {
            check(&gpu, &lists, workgroup_size, u32::MAX);
        }
    }
}

#[test]
fn blend_shared_equals_blend_on_images_of_all_sizes_and_opaque_layers() {
    let gpu = Gpu::new();
    let largest = gpu.context.limits().workgroup_size(256);
    for size in [[1, 1], [17, 5], [16, 16], [64, 48]] {
        check(&gpu, &Lists::long(&gpu, 200, [0.9, 1.0], &small_view(size)), largest, u32::MAX);
    }
}

#[test]
fn blend_shared_in_passes_equals_blend_at_once() {
    let gpu = Gpu::new();
    for opacity in [[0.005, 0.03], [0.5, 1.0]] {
        let lists = Lists::long(&gpu, 301, opacity, &small_view([37, 21]));
        for entries_per_pass in [64, 100, 301] {
            check(&gpu, &lists, 64, entries_per_pass);
        }
    }
}

#[test]
fn blend_shared_equals_blend_with_depth_limits() {
    let gpu = Gpu::new();
    let lists = Lists::sorted(&gpu, 90, [0.02, 0.6], &small_view([37, 21]));
    let count = lists.view.pixels();
    let limits: Vec<f32> = (0..count).map(|i| (i % 9) as f32 / 5.0).collect();
    let buffer = gpu.buffer("depth_limits", &limits);
    for (how, workgroup_size) in [(CHAINED, 32), (UNCHAINED, 64)] {
        let in_passes = How { entries_per_pass: 32, ..how };
        let shared = forward_shared_limited(&gpu, &lists, workgroup_size, in_passes, Some(&buffer));
        let regions = forward_limited(&gpu, &lists, how, false, Some(&buffer));
        let words = |buffer, words: usize| gpu.read::<u32>(buffer, words);
        assert!(words(&shared.last_entries, count) == words(&regions.last_entries, count));
        assert_alike(&gpu, [&shared, &regions], count, &format!("{workgroup_size} invocations"));
    }
}
