//! `forward/blend` against its twin.

use ashsplat::kernels::constants::{STATE_LONGEST_TILE, STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::forward::blend::{Bind, Interface, Push, Spec};
use ashsplat::plan::LaunchSizes;

use crate::common::blending::{
    CHAINED, How, LOW, SHARED, UNCHAINED, forms, forward, forward_limited, strips_of,
};
use crate::common::compare::{PixelTolerance, pixels};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::small_view;
use crate::common::tiles::Lists;
use crate::reference::blend::{Pixel, before, blend, samples};
use crate::reference::pipeline::pixels_of;
use crate::reference::types::Splat;

const TOLERANCE: PixelTolerance = PixelTolerance { max: 5e-5, mean: 1e-6, unstable: 2e-2 };

/// Blends on the device in all forms and by the twin, and compares every output.
fn check(gpu: &Gpu, lists: &Lists, inverse_depth: bool, entries_per_pass: u32) {
    for how in forms(gpu).into_iter().map(|how| How { inverse_depth, entries_per_pass, ..how }) {
        match how.strips {
            true => check_strips(gpu, lists, how),
            false => check_one(gpu, lists, how),
        }
    }
}

/// Checks the picture composited in strips against `accumulated`, and the other outputs against those without
/// strips, to the bit.
fn check_strips(gpu: &Gpu, lists: &Lists, how: How) {
    let count = lists.view.pixels();
    let usual = forward(gpu, lists, How { strips: false, ..how });
    let blended = forward(gpu, lists, how);
    let strips = strips_of(lists);
    let background = lists.view.background.map(|x| x as f32);
    let accumulated = gpu.read::<[f32; 4]>(&usual.accumulated, count);
    let composited =
        |[r, g, b, t]: &[f32; 4]| [r + t * background[0], g + t * background[1], b + t * background[2]];
    let expected = strips.planes(accumulated.iter().map(composited));
    let written = strips.planes(vec![[true; 3]; count]);
    let planes = gpu.read::<f32>(&blended.composited, expected.len());
    for (place, (&actual, &expected)) in planes.iter().zip(&expected).enumerate() {
        let (column, row) = (place as u64 / 8 % u64::from(strips.pitch()), place % 8);
        let beside = column >= u64::from(strips.width);
        match written[place] {
            true => assert!((actual - expected).abs() <= 1e-6, "{actual} for {expected} at {place}"),
            false if beside => assert_eq!(actual.to_bits(), UNTOUCHED, "beside the picture, at {place}"),
            false => assert_eq!(actual, 0.0, "below the picture, in row {row}"),
        }
    }
    let equal = |a, b, words: usize| assert_eq!(gpu.read::<u32>(a, words), gpu.read::<u32>(b, words));
    equal(&usual.inverse_depth, &blended.inverse_depth, count);
    equal(&usual.last_entries, &blended.last_entries, count);
}

fn check_one(gpu: &Gpu, lists: &Lists, how: How) {
    let blended = forward(gpu, lists, how);
    let count = lists.view.pixels();
    // The kernel does not add the background.
    let expected: Vec<Pixel> =
        pixels_of(&lists.view).map(|pixel| blend(&lists.list_of(pixel), pixel, [0.0; 3])).collect();
    let unstable = lists.unstable();
    let share = unstable.iter().filter(|&&unstable| unstable).count();
    assert!(share <= 1 + count / 10, "{share} of {count} pixels hang on rounding: the scene tests little");

    let accumulated = gpu.read::<[f32; 4]>(&blended.accumulated, count);
    let actual: Vec<f64> = accumulated.as_flattened().iter().map(|&x| f64::from(x)).collect();
    let values: Vec<f64> =
        expected.iter().flat_map(|p| [p.color[0], p.color[1], p.color[2], p.transmittance]).collect();
    pixels("accumulated", &actual, &values, &unstable, TOLERANCE)
        .unwrap_or_else(|error| panic!("{how:?}: {error}"));

    if how.inverse_depth {
        let actual: Vec<f64> =
            gpu.read::<f32>(&blended.inverse_depth, count).iter().map(|&x| f64::from(x)).collect();
        let values: Vec<f64> = expected.iter().map(|p| p.inverse_depth).collect();
        pixels("inverse depth", &actual, &values, &unstable, TOLERANCE)
            .unwrap_or_else(|error| panic!("{how:?}: {error}"));
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
pub fn blend_equals_its_twin_on_lists_of_all_lengths() {
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
pub fn blend_equals_its_twin_on_images_of_all_sizes() {
    let gpu = Gpu::new();
    for size in [[1, 1], [17, 5], [16, 16], [15, 33], [64, 48]] {
        let lists = Lists::long(&gpu, 40, [0.02, 0.99], &small_view(size));
        check(&gpu, &lists, false, u32::MAX);
    }
}

/// Opaque layers reach the clamp at 0.99 and the stop before transmittance 1e-4.
#[test]
pub fn blend_of_opaque_layers() {
    let gpu = Gpu::new();
    check(&gpu, &Lists::long(&gpu, 50, [0.98, 1.0], &small_view([37, 21])), true, u32::MAX);
}

/// Passes over parts of the lists give the same picture, to the bit.
#[test]
pub fn blend_in_passes_equals_blend_at_once() {
    let gpu = Gpu::new();
    for (opacity, how) in [([0.005, 0.03], CHAINED), ([0.5, 1.0], CHAINED), ([0.02, 1.0], UNCHAINED)] {
        let lists = Lists::long(&gpu, 301, opacity, &small_view([37, 21]));
        let at_once = forward(&gpu, &lists, how);
        let count = lists.view.pixels();
        for entries_per_pass in [64, 100, 300, 301] {
            check(&gpu, &lists, true, entries_per_pass);
            let passes = forward(&gpu, &lists, How { entries_per_pass, ..how });
            let equal = |a, b, words: usize| {
                assert_eq!(
                    gpu.read::<u32>(a, words),
                    gpu.read::<u32>(b, words),
                    "{entries_per_pass} per pass"
                );
            };
            equal(&at_once.accumulated, &passes.accumulated, 4 * count);
            equal(&at_once.inverse_depth, &passes.inverse_depth, count);
            equal(&at_once.last_entries, &passes.last_entries, count);
        }
    }
}

/// Splats in all directions, of variances from the dilation's minimum to `longest` px².
fn needles(gpu: &Gpu, longest: f64) -> Lists {
    let view = small_view([64, 48]);
    let splats: Vec<Splat> = (0..600)
        .map(|i| {
            let (sine, cosine) = (f64::from(i) * 0.0209).sin_cos();
            let (long, short) = (0.3 + f64::from(i % 40 * (i % 5)) / 156.0 * longest, 0.3);
            let xx = long * cosine * cosine + short * sine * sine;
            let yy = long * sine * sine + short * cosine * cosine;
            let xy = (long - short) * sine * cosine;
            let determinant = xx * yy - xy * xy;
            Splat {
                depth: 1.0,
                mean2d_px: [f64::from(i % 67) - 1.3, f64::from(i % 53) * 0.97 - 1.7],
                cov2d: [xx, xy, yy],
                conic: [yy / determinant, -xy / determinant, xx / determinant],
                opacity: [0.9, 0.1, 0.03][i as usize % 3],
                color: [1.0, 0.5, 0.25],
                radius_px: 0,
            }
        })
        .collect();
    let [columns, rows] = view.tiles();
    let lists = (0..columns * rows).map(|_| (0..splats.len() as u32).collect()).collect();
    Lists::new(gpu, splats, lists, &view)
}

/// The opacities of a column change fastest, and the chain starts far from the visible pixels.
#[test]
pub fn blend_of_needles() {
    let gpu = Gpu::new();
    check(&gpu, &needles(&gpu, 30.0), true, u32::MAX);
}

/// The form's terms cancel for needles so long that float32 itself misses the tolerance. Chained columns must not
/// add to that error.
#[test]
pub fn blend_of_long_needles_errs_no_more_in_chained_columns() {
    let gpu = Gpu::new();
    for longest in [300.0, 9000.0] {
        let lists = needles(&gpu, longest);
        let unstable = lists.unstable();
        let [direct, chained] = [UNCHAINED, CHAINED].map(|how| {
            let blended = forward(&gpu, &lists, how);
            let accumulated = gpu.read::<[f32; 4]>(&blended.accumulated, lists.view.pixels());
            let stable = pixels_of(&lists.view).enumerate().filter(|&(index, _)| !unstable[index]);
            let error = |(index, pixel): (usize, [u32; 2])| {
                let expected = blend(&lists.list_of(pixel), pixel, [0.0; 3]).color[0];
                (f64::from(accumulated[index][0]) - expected).abs()
            };
            stable.map(error).fold(0.0, f64::max)
        });
        println!("variance up to {longest} px²: largest error {direct:.2e} direct, {chained:.2e} chained");
        assert!(chained <= 1.5 * direct + 1e-5, "{chained:e} chained, {direct:e} direct");
    }
}

/// A tile that no pass finishes makes the frame invalid. The kernel reports it, so that the frame runs again with
/// more passes.
#[test]
pub fn blend_reports_tiles_that_no_pass_finishes() {
    let gpu = Gpu::new();
    let subgroup_size = gpu.subgroup();
    let workgroup_size = subgroup_size * if subgroup_size <= 64 { 4 } else { 2 };
    let spec = Spec { workgroup_size, subgroup_size, ..Spec::default() };
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
        composited: &accumulated,
    };
    let [tiles_per_row, rows] = lists.view.tiles();
    // The lists exceed the last pass, fit it, or another pass follows.
    for (max_entries, last_pass, overflow) in [(99, 0, 0), (100, 1, 0), (99, 1, 1)] {
        let push = Push {
            image_width: lists.view.size_px[0],
            image_height: lists.view.size_px[1],
            tiles_per_row,
            tile_count: tiles_per_row * rows,
            first_entry: 0,
            max_entries,
            first_instance: 0,
            max_instances: u32::MAX,
            tile_row_interleave: 2,
            last_pass,
            splat_stride: 1,
            background: [0.0; 3],
        };
        gpu.dispatch::<Interface>(&spec, &bind, &push, u64::from(tiles_per_row * rows));
        let state = gpu.read::<u32>(&lists.state, STATE_WORDS as usize);
        assert_eq!(state[STATE_OVERFLOW as usize], overflow, "{max_entries} entries, last pass {last_pass}");
    }
}

/// Splats behind a limit and those after them add nothing. Also checks the sum of weights * z.
#[test]
pub fn blend_stops_at_the_depth_limit() {
    let gpu = Gpu::new();
    let lists = Lists::sorted(&gpu, 70, [0.02, 0.6], &small_view([37, 21]));
    let count = lists.view.pixels();
    let unstable = lists.unstable();
    // Nothing hidden, everything hidden, and depths in between: the splats lie between 0.5 and 9.
    let limits: Vec<f32> =
        (0..count).map(|i| [0.0, 1.0 / 0.4, 1.0 / 8.9, 1.0 / 4.0][i % 4] * (1.0 + i as f32 * 1e-5)).collect();
    let buffer = gpu.buffer("depth_limits", &limits);
    for linear_depth in [false, true] {
        let blended = forward_limited(
            &gpu,
            &lists,
            How { entries_per_pass: 32, ..CHAINED },
            linear_depth,
            Some(&buffer),
        );
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

/// Each of many entries hits every region, and the last entry is visible. A driver that limits an invocation's loop
/// rounds stops silently before it.
#[test]
pub fn blend_of_more_hits_than_an_invocation_has_rounds() {
    const ENTRIES: usize = 20_000;
    let gpu = Gpu::new();
    let blocks = LaunchSizes::new(gpu.limits());
    let splat = |mean2d_px, variance: f64, opacity| Splat {
        depth: 1.0,
        mean2d_px,
        cov2d: [variance, 0.0, variance],
        conic: [1.0 / variance, 0.0, 1.0 / variance],
        opacity,
        color: [1.0, 0.5, 0.25],
        radius_px: 0,
    };
    let splats = vec![splat([7.5, 7.5], 2.0, 0.02), splat([2.0, 2.0], 1.0, 0.9)];
    let list = [vec![0; ENTRIES - 1], vec![1]].concat();
    let lists = Lists::new(&gpu, splats, vec![list], &small_view([16, 16]));
    let blend = |parts, entries_per_pass| {
        let how = How { parts, incremental_exp: blocks.incremental_exp, entries_per_pass, ..CHAINED };
        gpu.read::<[f32; 4]>(&forward(&gpu, &lists, how).accumulated, 256)
    };
    let chosen = blend(blocks.regions_per_subgroup, blocks.entries_per_pass);
    let [red, _, _, transmittance] = chosen[2 * 16 + 2];
    assert!(red > 0.8 && transmittance < 0.2, "the last entry is lost: {red}, {transmittance}");
    assert!(chosen == blend(1, 1000), "fewer entries per pass change the picture");
    // Proves that the test detects such a driver.
    let rounds = gpu.limits().max_loop_iterations().map_or(usize::MAX, |rounds| rounds as usize);
    if blocks.regions_per_subgroup as usize * ENTRIES > rounds {
        assert!(
            chosen != blend(blocks.regions_per_subgroup, u32::MAX),
            "the driver has more rounds than it is said to"
        );
    }
}

/// The number of regions per subgroup does not change the picture.
#[test]
pub fn blend_of_several_regions_per_subgroup_is_the_same() {
    let gpu = Gpu::new();
    let lists = Lists::long(&gpu, 200, [0.02, 0.99], &small_view([37, 21]));
    let count = lists.view.pixels();
    let regions = if gpu.subgroup() <= 64 { 4 } else { 2 };
    let words = |how| {
        let blended = forward(&gpu, &lists, how);
        let accumulated = gpu.read::<u32>(&blended.accumulated, 4 * count);
        (accumulated, gpu.read::<u32>(&blended.last_entries, count))
    };
    let one = words(CHAINED);
    for parts in [2, 4].into_iter().filter(|&parts| parts <= regions) {
        assert!(words(How { parts, ..CHAINED }) == one, "{parts} regions per subgroup");
    }
    // The height of regions does not, either, if each opacity is computed alone.
    assert!(words(LOW) == words(UNCHAINED), "low regions");
    assert!(words(SHARED) == words(UNCHAINED), "splats in shared memory");
}
