//! `forward/blend` against its twin.

use ashsplat::kernels::constants::{STATE_LONGEST_TILE, STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::forward::blend::{Bind, Interface, Push, Spec};

use crate::common::blending::{forward, forward_limited};
use crate::common::compare::{PixelTolerance, pixels};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::small_view;
use crate::common::tiles::Lists;
use crate::reference::blend::{Pixel, before, blend, samples};
use crate::reference::pipeline::pixels_of;

const TOLERANCE: PixelTolerance = PixelTolerance { max: 5e-5, mean: 1e-6, unstable: 2e-2 };

/// Blends on the device and by the twin, and compares every output.
fn check(gpu: &Gpu, lists: &Lists, inverse_depth: bool, entries_per_pass: u32) {
    let blended = forward(gpu, lists, inverse_depth, entries_per_pass);
    let count = lists.view.pixels();
    // The kernel leaves the background to others.
    let expected: Vec<Pixel> =
        pixels_of(&lists.view).map(|pixel| blend(&lists.list_of(pixel), pixel, [0.0; 3])).collect();
    let unstable = lists.unstable();
    let share = unstable.iter().filter(|&&unstable| unstable).count();
    assert!(share <= 1 + count / 10, "{share} of {count} pixels hang on rounding: the scene tests little");

    let accumulated = gpu.read::<[f32; 4]>(&blended.accumulated, count);
    let actual: Vec<f64> = accumulated.as_flattened().iter().map(|&x| f64::from(x)).collect();
    let values: Vec<f64> =
        expected.iter().flat_map(|p| [p.color[0], p.color[1], p.color[2], p.transmittance]).collect();
    pixels("accumulated", &actual, &values, &unstable, TOLERANCE).expect("accumulated");

    if inverse_depth {
        let actual: Vec<f64> =
            gpu.read::<f32>(&blended.inverse_depth, count).iter().map(|&x| f64::from(x)).collect();
        let values: Vec<f64> = expected.iter().map(|p| p.inverse_depth).collect();
        pixels("inverse depth", &actual, &values, &unstable, TOLERANCE).expect("inverse depth");
    } else {
        assert!(gpu.read::<u32>(&blended.inverse_depth, count).iter().all(|&word| word == UNTOUCHED));
    }
    let last = gpu.read::<u32>(&blended.last_entries, count);
    for (index, (pixel, unstable)) in expected.iter().zip(&unstable).enumerate() {
        assert!(
            *unstable || last[index] == pixel.last,
            "last of {index}: {}, expected {}",
            last[index],
            pixel.last
        );
    }
}

#[test]
fn blend_equals_its_twin_on_lists_of_all_lengths() {
    let gpu = Gpu::new();
    let subgroup = gpu.subgroup() as usize;
    for entries in [0, 1, subgroup - 1, subgroup, subgroup + 1, 31, 32, 33, 300] {
        let lists = Lists::long(&gpu, entries, [0.02, 0.6], &small_view([37, 21]));
        check(&gpu, &lists, true, u32::MAX);
        let state = gpu.read::<u32>(&lists.state, STATE_WORDS as usize);
        assert_eq!(state[STATE_LONGEST_TILE as usize], entries as u32);
        assert_eq!(state[STATE_OVERFLOW as usize], 0);
    }
}

#[test]
fn blend_equals_its_twin_on_images_of_all_sizes() {
    let gpu = Gpu::new();
    for size in [[1, 1], [17, 5], [16, 16], [15, 33], [64, 48]] {
        let lists = Lists::long(&gpu, 40, [0.02, 0.99], &small_view(size));
        check(&gpu, &lists, false, u32::MAX);
    }
}

/// Opaque layers: the clamp at 0.99 and the stop before transmittance 1e-4.
#[test]
fn blend_of_opaque_layers() {
    let gpu = Gpu::new();
    check(&gpu, &Lists::long(&gpu, 50, [0.98, 1.0], &small_view([37, 21])), true, u32::MAX);
}

/// Passes over parts of the lists give the same picture to the bit.
#[test]
fn blend_in_passes_equals_blend_at_once() {
    let gpu = Gpu::new();
    for opacity in [[0.005, 0.03], [0.5, 1.0]] {
        let lists = Lists::long(&gpu, 301, opacity, &small_view([37, 21]));
        let at_once = forward(&gpu, &lists, true, u32::MAX);
        let count = lists.view.pixels();
        for entries_per_pass in [64, 100, 300, 301] {
            check(&gpu, &lists, true, entries_per_pass);
            let passes = forward(&gpu, &lists, true, entries_per_pass);
            let equal = |a, b, words: usize| gpu.read::<u32>(a, words) == gpu.read::<u32>(b, words);
            assert!(
                equal(&at_once.accumulated, &passes.accumulated, 4 * count),
                "{entries_per_pass} per pass"
            );
            assert!(
                equal(&at_once.inverse_depth, &passes.inverse_depth, count),
                "{entries_per_pass} per pass"
            );
            assert!(equal(&at_once.last_entries, &passes.last_entries, count), "{entries_per_pass} per pass");
        }
    }
}

/// A tile that no pass finishes makes the frame invalid: said, so that it is run again with more passes.
#[test]
fn blend_reports_tiles_that_no_pass_finishes() {
    let gpu = Gpu::new();
    let subgroup_size = gpu.subgroup();
    let workgroup_size = subgroup_size * if subgroup_size <= 64 { 4 } else { 2 };
    let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size, subgroup_size, ..Spec::default() });
    let lists = Lists::long(&gpu, 100, [0.02, 0.6], &small_view([37, 21]));
    let pixels = lists.view.pixels();
    let accumulated = gpu.zeros::<[f32; 4]>("accumulated", pixels);
    let inverse_depth = gpu.zeros::<f32>("inverse_depth", pixels);
    let last_entries = gpu.zeros::<u32>("last_entries", pixels);
    let bind = Bind {
        tile_ranges: &lists.tile_ranges,
        sorted_visible: &lists.sorted_visible,
        mean2d_extent: &lists.frame.mean2d_extent,
        conic_opacity: &lists.frame.conic_opacity,
        color_inverse_depth: &lists.frame.color_inverse_depth,
        accumulated: &accumulated,
        inverse_depth: &inverse_depth,
        last_entries: &last_entries,
        state: &lists.state,
        depth_limits: &lists.tile_ranges,
    };
    let [tiles_per_row, rows] = lists.view.tiles();
    // Whether the last pass ends within the lists, at their end, or another follows.
    for (max_entries, last_pass, overflow) in [(99, 0, 0), (100, 1, 0), (99, 1, 1)] {
        let push = Push {
            image_width: lists.view.size_px[0],
            image_height: lists.view.size_px[1],
            tiles_per_row,
            tile_count: tiles_per_row * rows,
            first_entry: 0,
            max_entries,
            last_pass,
        };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, u64::from(tiles_per_row * rows)));
        let state = gpu.read::<u32>(&lists.state, STATE_WORDS as usize);
        assert_eq!(state[STATE_OVERFLOW as usize], overflow, "{max_entries} entries, last pass {last_pass}");
    }
}

/// Splats behind a limit do not count, nor does anything that follows them; and the sum of weights * z.
#[test]
fn blend_stops_at_the_depth_limit() {
    let gpu = Gpu::new();
    let lists = Lists::sorted(&gpu, 70, [0.02, 0.6], &small_view([37, 21]));
    let count = lists.view.pixels();
    let unstable = lists.unstable();
    // Nothing, everything hidden, and depths in between: the splats lie between 0.5 and 9.
    let limits: Vec<f32> =
        (0..count).map(|i| [0.0, 1.0 / 0.4, 1.0 / 8.9, 1.0 / 4.0][i % 4] * (1.0 + i as f32 * 1e-5)).collect();
    let buffer = gpu.buffer("depth_limits", &limits);
    for linear_depth in [false, true] {
        let blended = forward_limited(&gpu, &lists, [true, linear_depth], 32, Some(&buffer));
        let accumulated = gpu.read::<[f32; 4]>(&blended.accumulated, count);
        let depths = gpu.read::<f32>(&blended.inverse_depth, count);
        for (index, at) in pixels_of(&lists.view).enumerate().filter(|&(index, _)| !unstable[index]) {
            let list = lists.list_of(at);
            let list = before(&list, limits[index].into());
            let expected = blend(list, at, [0.0; 3]);
            let [x, y, z] = expected.color;
            let actual = accumulated[index].map(f64::from);
            for (actual, expected) in actual.into_iter().zip([x, y, z, expected.transmittance]) {
                assert!((actual - expected).abs() < 5e-5, "pixel {index}: {actual}, expected {expected}");
            }
            let depth = match linear_depth {
                false => expected.inverse_depth,
                true => {
                    samples(list, at).0.iter().map(|s| s.alpha * s.transmittance * list[s.entry].depth).sum()
                }
            };
            let actual = f64::from(depths[index]);
            assert!((actual - depth).abs() < 1e-3, "depth of pixel {index}: {actual}, expected {depth}");
        }
    }
}
