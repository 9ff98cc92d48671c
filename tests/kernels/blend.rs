//! The kernels that blend, `forward/blend`, `forward/blend_shared`, `forward/blend_auxiliary` and
//! `forward/blend_shared_auxiliary`, against one twin; and the pictures of the last three against the first two.

use crate::common::blending::{
    Auxiliary, Blended, CHAINED, Form, LOW, SHARED, UNCHAINED, assert_same, forms, forward,
    forward_auxiliary, forward_limited, has_strips, strips_of,
};
use crate::common::frame::Lists;
use crate::common::prelude::*;
use crate::reference::blend::{Pixel, before, beside, blend, is_surface_depth, samples};
use crate::reference::pipeline::{pixels_of, tile_of};
use ashsplat::frame::{LaunchSizes, Outputs};
use ashsplat::kernels::constants::{STATE_LONGEST_TILE, STATE_OVERFLOW};

const TOLERANCE: PixelTolerance = PixelTolerance { max: 5e-5, mean: 1e-6, unstable: 2e-2 };
const SIZE: [u32; 2] = [37, 21];

fn lists(gpu: &Gpu, entries: usize, opacity: [f64; 2]) -> Lists {
    Lists::long(gpu, entries, opacity, &small_view(SIZE))
}

fn everywhere(gpu: &Gpu, splats: Vec<Splat>, size: [u32; 2]) -> Lists {
    let view = small_view(size);
    let [columns, rows] = view.tiles();
    let lists = vec![(0..splats.len() as u32).collect(); (columns * rows) as usize];
    Lists::new(gpu, splats, lists, &view)
}

/// Number of regions that a subgroup may have.
fn region_counts(gpu: &Gpu) -> impl Iterator<Item = u32> + use<> {
    let max = if gpu.subgroup() <= 64 { 4 } else { 2 };
    [2, 4].into_iter().filter(move |&parts| parts <= max)
}

/// Compares stable pixels' colour and transmittance with the twin's. `visible` shortens a pixel's list.
fn assert_pixels<'a>(
    gpu: &Gpu,
    lists: &'a Lists,
    blended: &Blended,
    what: &str,
    visible: impl Fn(usize, Vec<&'a Splat>) -> Vec<&'a Splat>,
) {
    let accumulated = gpu.read::<[f32; 4]>(&blended.accumulated, lists.view.pixels());
    let unstable = lists.unstable();
    for (index, at) in pixels_of(&lists.view).enumerate().filter(|&(index, _)| !unstable[index]) {
        let expected = blend(&visible(index, lists.list_of(at)), at, [0.0; 3]);
        let [x, y, z] = expected.color;
        let pairs = accumulated[index].into_iter().zip([x, y, z, expected.transmittance]);
        for (actual, expected) in pairs {
            let close = (f64::from(actual) - expected).abs() < 5e-5;
            assert!(close, "{what}, pixel {index}: {actual}, expected {expected}");
        }
    }
}

fn assert_same_bits(gpu: &Gpu, [a, b]: [&Blended; 2], pixels: usize, what: &str) {
    for (a, b, words) in [
        (&a.accumulated, &b.accumulated, 4),
        (&a.depth_sums, &b.depth_sums, 1),
        (&a.last_entries, &b.last_entries, 1),
    ] {
        let [a, b] = [a, b].map(|buffer| gpu.read::<u32>(buffer, words * pixels));
        assert!(a == b, "{what}");
    }
}

/// Blends on the device in all forms and by the twin, and compares every output.
fn check(gpu: &Gpu, lists: &Lists, inverse_depth: bool, entries_per_pass: u32) {
    for form in forms(gpu).into_iter().map(|form| Form { inverse_depth, entries_per_pass, ..form }) {
        match form.strips {
            true => check_strips(gpu, lists, form),
            false => check_one(gpu, lists, form),
        }
    }
}

/// Checks the picture composited in strips against `accumulated`, and the other outputs against those without
/// strips, to the bit.
fn check_strips(gpu: &Gpu, lists: &Lists, form: Form) {
    let count = lists.view.pixels();
    let usual = forward(gpu, lists, Form { strips: false, ..form });
    let blended = forward(gpu, lists, form);
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
    equal(&usual.depth_sums, &blended.depth_sums, count);
    equal(&usual.last_entries, &blended.last_entries, count);
}

fn check_one(gpu: &Gpu, lists: &Lists, form: Form) {
    let blended = forward(gpu, lists, form);
    let count = lists.view.pixels();
    // The kernel does not add the background.
    let expected: Vec<Pixel> =
        pixels_of(&lists.view).map(|pixel| blend(&lists.list_of(pixel), pixel, [0.0; 3])).collect();
    let unstable = lists.unstable();
    let share = unstable.iter().filter(|&&unstable| unstable).count();
    assert!(share <= 1 + count / 10, "{share} of {count} pixels hang on rounding: the scene tests little");

    let actual = gpu.read_f64::<f32>(&blended.accumulated, 4 * count);
    let values: Vec<f64> =
        expected.iter().flat_map(|p| [p.color[0], p.color[1], p.color[2], p.transmittance]).collect();
    pixels("accumulated", &actual, &values, &unstable, TOLERANCE)
        .unwrap_or_else(|error| panic!("{form:?}: {error}"));

    if form.inverse_depth {
        let actual = gpu.read_f64::<f32>(&blended.depth_sums, count);
        let values: Vec<f64> = expected.iter().map(|p| p.inverse_depth).collect();
        pixels("inverse depth", &actual, &values, &unstable, TOLERANCE)
            .unwrap_or_else(|error| panic!("{form:?}: {error}"));
    } else {
        assert!(gpu.read::<u32>(&blended.depth_sums, count).iter().all(|&word| word == UNTOUCHED));
    }
    let last = gpu.read::<u32>(&blended.last_entries, count);
    for (index, (pixel, unstable)) in expected.iter().zip(&unstable).enumerate() {
        let agrees = *unstable || last[index] == pixel.last;
        assert!(agrees, "last of {index}: {}, expected {}", last[index], pixel.last);
    }
}

#[test]
pub fn blend_equals_its_twin_on_lists_of_all_lengths() {
    let gpu = Gpu::new();
    let subgroup = gpu.subgroup() as usize;
    for entries in [0, 1, subgroup - 1, subgroup, subgroup + 1, 31, 32, 33, gpu.sized(300, 130)] {
        let lists = lists(&gpu, entries, [0.02, 0.6]);
        check(&gpu, &lists, true, u32::MAX);
        let [longest, overflow] =
            [STATE_LONGEST_TILE, STATE_OVERFLOW].map(|word| gpu.read_state(&lists.state, word));
        assert_eq!((longest, overflow), (entries as u32, 0));
    }
}

#[test]
pub fn blend_equals_its_twin_on_images_of_all_sizes() {
    let gpu = Gpu::new();
    for &size in gpu.sized(&[[1, 1], [17, 5], [16, 16], [15, 33], [64, 48]][..], &[[1, 1], [17, 5], [15, 33]])
    {
        let lists = Lists::long(&gpu, 40, [0.02, 0.99], &small_view(size));
        check(&gpu, &lists, false, u32::MAX);
    }
}

#[test]
pub fn blend_in_passes_equals_blend_at_once() {
    let gpu = Gpu::new();
    for (opacity, form) in [([0.005, 0.03], CHAINED), ([0.5, 1.0], CHAINED), ([0.02, 1.0], UNCHAINED)] {
        let lists = lists(&gpu, 301, opacity);
        let at_once = forward(&gpu, &lists, form);
        for entries_per_pass in [64, 100, 300, 301] {
            check(&gpu, &lists, true, entries_per_pass);
            let passes = forward(&gpu, &lists, Form { entries_per_pass, ..form });
            let what = format!("{entries_per_pass} per pass");
            assert_same_bits(&gpu, [&at_once, &passes], lists.view.pixels(), &what);
        }
    }
}

/// Splats in all directions, of variances from the dilation's minimum to `longest` px².
fn needles(gpu: &Gpu, longest: f64) -> Lists {
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
    everywhere(gpu, splats, [64, 48])
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
        let [direct, chained] = [UNCHAINED, CHAINED].map(|form| {
            let blended = forward(&gpu, &lists, form);
            let accumulated = gpu.read::<[f32; 4]>(&blended.accumulated, lists.view.pixels());
            let stable = pixels_of(&lists.view).enumerate().filter(|&(index, _)| !unstable[index]);
            let error = |(index, pixel): (usize, [u32; 2])| {
                let expected = blend(&lists.list_of(pixel), pixel, [0.0; 3]).color[0];
                (f64::from(accumulated[index][0]) - expected).abs()
            };
            stable.map(error).fold(0.0, f64::max)
        });
        assert!(chained <= 1.5 * direct + 1e-5, "{chained:e} chained, {direct:e} direct");
    }
}

/// A tile that no pass finishes makes the frame invalid. The kernel reports it, so that the frame runs again with
/// more passes.
#[test]
pub fn blend_reports_tiles_that_no_pass_finishes() {
    let gpu = Gpu::new();
    // The lists fit several passes, fit the only pass, or exceed it.
    for (entries_per_pass, passes, overflow) in [(99, None, 0), (100, Some(1), 0), (99, Some(1), 1)] {
        let lists = lists(&gpu, 100, [0.02, 0.6]);
        forward(&gpu, &lists, Form { entries_per_pass, passes, ..UNCHAINED });
        let reported = gpu.read_state(&lists.state, STATE_OVERFLOW);
        assert_eq!(reported, overflow, "{entries_per_pass} entries per pass, {passes:?} passes");
    }
}

/// Splats behind a limit add nothing, nor do those after them if z orders them. Also checks the sum of weights * z.
#[test]
pub fn blend_stops_at_the_depth_limit() {
    let gpu = Gpu::new();
    let view = small_view(SIZE);
    check_limits(&gpu, &Lists::sorted(&gpu, 70, [0.02, 0.6], &view), false);
    check_limits(&gpu, &Lists::long(&gpu, 70, [0.02, 0.6], &view), true);
}

fn check_limits(gpu: &Gpu, lists: &Lists, distance_order: bool) {
    let count = lists.view.pixels();
    let unstable = lists.unstable();
    // Nothing hidden, everything hidden, and depths in between: the splats lie between 0.5 and 9.
    let limits: Vec<f32> =
        (0..count).map(|i| [0.0, 1.0 / 0.4, 1.0 / 8.9, 1.0 / 4.0][i % 4] * (1.0 + i as f32 * 1e-5)).collect();
    let buffer = gpu.buffer("depth_limits", &limits);
    let form = Form { entries_per_pass: 32, distance_order, ..CHAINED };
    for linear_depth in [false, true] {
        let blended = forward_limited(gpu, lists, form, linear_depth, Some(&buffer));
        let visible = |index: usize, list: Vec<_>| before(&list, limits[index].into());
        assert_pixels(gpu, lists, &blended, "with limits", visible);
        let depths = gpu.read_f64::<f32>(&blended.depth_sums, count);
        for (index, at) in pixels_of(&lists.view).enumerate().filter(|&(index, _)| !unstable[index]) {
            let list = visible(index, lists.list_of(at));
            let expected: f64 = match linear_depth {
                false => blend(&list, at, [0.0; 3]).inverse_depth,
                true => samples(&list, at).0.iter().map(|s| s.weight() * list[s.entry].depth).sum(),
            };
            let actual = depths[index];
            assert!(
                (actual - expected).abs() < 1e-3,
                "depth of pixel {index}: {actual}, expected {expected}"
            );
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
        let form =
            Form { parts, incremental_exp: blocks.tuning.incremental_exp, entries_per_pass, ..CHAINED };
        gpu.read::<[f32; 4]>(&forward(&gpu, &lists, form).accumulated, 256)
    };
    let chosen = blend(blocks.regions_per_subgroup, blocks.entries_per_pass);
    let [red, _, _, transmittance] = chosen[2 * 16 + 2];
    assert!(red > 0.8 && transmittance < 0.2, "the last entry is lost: {red}, {transmittance}");
    assert!(chosen == blend(1, 1000), "fewer entries per pass change the picture");
    // A driver that bounds loops would lose entries in one pass.
    let rounds = gpu.limits().max_loop_iterations.map_or(usize::MAX, |rounds| rounds as usize);
    if blocks.regions_per_subgroup as usize * ENTRIES > rounds {
        let at_once = blend(blocks.regions_per_subgroup, u32::MAX);
        assert!(chosen != at_once, "the driver has more rounds than it is said to");
    }
}

#[test]
pub fn blend_of_several_regions_per_subgroup_is_the_same() {
    let gpu = Gpu::new();
    let lists = lists(&gpu, 200, [0.02, 0.99]);
    let count = lists.view.pixels();
    let words = |form| {
        let blended = forward(&gpu, &lists, form);
        let accumulated = gpu.read::<u32>(&blended.accumulated, 4 * count);
        (accumulated, gpu.read::<u32>(&blended.last_entries, count))
    };
    let one = words(CHAINED);
    for parts in region_counts(&gpu) {
        assert!(words(Form { parts, ..CHAINED }) == one, "{parts} regions per subgroup");
    }
    // The height of regions changes nothing either, if each opacity is computed alone.
    assert!(words(LOW) == words(UNCHAINED), "low regions");
    assert!(words(SHARED) == words(UNCHAINED), "splats in shared memory");
}

/// `form` with a workgroup of this many invocations per tile.
fn shared(invocations: u32, form: Form) -> Form {
    Form { by_workgroup: Some(invocations), ..form }
}

fn check_shared(gpu: &Gpu, lists: &Lists, workgroup_size: u32, entries_per_pass: u32) {
    check_shared_form(gpu, lists, shared(workgroup_size, Form { entries_per_pass, ..UNCHAINED }));
    // Columns of up to 8 pixels.
    check_shared_form(gpu, lists, shared(workgroup_size.min(32), Form { entries_per_pass, ..CHAINED }));
}

fn assert_alike(gpu: &Gpu, [a, b]: [&Blended; 2], count: usize, what: &str) {
    for (a, b, values) in [(&a.accumulated, &b.accumulated, 4 * count), (&a.depth_sums, &b.depth_sums, count)]
    {
        let [a, b] = [a, b].map(|buffer| gpu.read::<f32>(buffer, values));
        assert_same(gpu.context, &a, &b, (what, 1e-5));
    }
}

fn check_shared_form(gpu: &Gpu, lists: &Lists, form: Form) {
    let both = |form: Form| {
        let regions = Form { by_workgroup: None, entries_per_pass: u32::MAX, ..form };
        [form, regions].map(|form| forward(gpu, lists, form))
    };
    let [shared, regions] = both(form);
    let count = lists.view.pixels();
    let what = format!("{form:?}");
    let words = |buffer, words: usize| gpu.read::<u32>(buffer, words);
    // Precise arithmetic decides everywhere which entries count.
    assert_eq!(words(&shared.last_entries, count), words(&regions.last_entries, count), "{what}");
    assert_alike(gpu, [&shared, &regions], count, &what);
    if has_strips(gpu) && form.incremental_exp {
        let [shared, regions] = both(Form { strips: true, ..form });
        let count = 3 * strips_of(lists).values() as usize;
        assert_eq!(words(&shared.composited, count), words(&regions.composited, count), "{what}");
    }

    assert_pixels(gpu, lists, &shared, &what, |_, list| list);
}

#[test]
fn blend_shared_equals_blend_on_lists_of_all_lengths() {
    let gpu = Gpu::new();
    let largest = gpu.context.limits().workgroup_size(256);
    for entries in [0, 1, 31, 32, 33, 127, 128, 129, 300] {
        let lists = lists(&gpu, entries, [0.02, 0.6]);
        for workgroup_size in [32, 64, largest] {
            check_shared(&gpu, &lists, workgroup_size, u32::MAX);
        }
    }
}

#[test]
fn blend_shared_equals_blend_on_images_of_all_sizes_and_opaque_layers() {
    let gpu = Gpu::new();
    let largest = gpu.context.limits().workgroup_size(256);
    for size in [[1, 1], [17, 5], [16, 16], [64, 48]] {
        check_shared(&gpu, &Lists::long(&gpu, 200, [0.9, 1.0], &small_view(size)), largest, u32::MAX);
    }
}

#[test]
fn blend_shared_in_passes_equals_blend_at_once() {
    let gpu = Gpu::new();
    for opacity in [[0.005, 0.03], [0.5, 1.0]] {
        let lists = lists(&gpu, 301, opacity);
        for entries_per_pass in [64, 100, 301] {
            check_shared(&gpu, &lists, 64, entries_per_pass);
        }
    }
}

#[test]
fn blend_shared_equals_blend_with_depth_limits() {
    let gpu = Gpu::new();
    let view = small_view(SIZE);
    let [sorted, unsorted] = [Lists::sorted, Lists::long].map(|make| make(&gpu, 90, [0.02, 0.6], &view));
    let count = view.pixels();
    let limits: Vec<f32> = (0..count).map(|i| (i % 9) as f32 / 5.0).collect();
    let buffer = gpu.buffer("depth_limits", &limits);
    for (form, workgroup_size, distance_order) in
        [(CHAINED, 32, false), (UNCHAINED, 64, false), (CHAINED, 32, true)]
    {
        let (form, lists) =
            (Form { distance_order, ..form }, if distance_order { &unsorted } else { &sorted });
        let in_passes = shared(workgroup_size, Form { entries_per_pass: 32, ..form });
        let shared = forward_limited(&gpu, lists, in_passes, false, Some(&buffer));
        let regions = forward_limited(&gpu, lists, form, false, Some(&buffer));
        let words = |buffer, words: usize| gpu.read::<u32>(buffer, words);
        assert!(words(&shared.last_entries, count) == words(&regions.last_entries, count));
        assert_alike(&gpu, [&shared, &regions], count, &format!("{workgroup_size} invocations"));
    }
}

/// Motions of splats, px.
fn motions(lists: &Lists) -> Vec<[f32; 2]> {
    (0..lists.frame.splats.len()).map(|i| [(i % 17) as f32 - 8.0, (i % 5) as f32 * 0.25]).collect()
}

const ALL: Outputs = Outputs { pick: true, motion: true, surface: true };

/// Compares the auxiliary values of stable pixels with the twin's.
fn assert_auxiliary(gpu: &Gpu, lists: &Lists, auxiliary: &Auxiliary, motions: &[[f32; 2]], what: &str) {
    let count = lists.view.pixels();
    let picks = gpu.read::<[u32; 2]>(&auxiliary.picks, count);
    let sums = gpu.read::<[f32; 2]>(&auxiliary.motion_sums, count);
    let surfaces = gpu.read::<[f32; 4]>(&auxiliary.surfaces, count);
    let unstable = lists.unstable();
    for (index, pixel) in pixels_of(&lists.view).enumerate().filter(|(index, _)| !unstable[*index]) {
        let list = &lists.lists[tile_of(&lists.view, pixel)];
        let own: Vec<[f64; 2]> = list.iter().map(|&i| motions[i as usize].map(f64::from)).collect();
        let normal = |motion: [f64; 2]| [motion[0], motion[1], motion[0] - motion[1]];
        let normals: Vec<[f64; 3]> = own.iter().map(|motion| normal(*motion)).collect();
        let slopes: Vec<[f64; 2]> = own.iter().map(|motion| motion.map(|x| x / 1024.0)).collect();
        let (expected, weights) = beside(&lists.list_of(pixel), (&own, &normals), pixel);
        let [place, bits] = picks[index];
        let weight = f64::from(f32::from_bits(bits));
        // Any of several almost equal weights may be the largest.
        let picked = match place {
            0 => expected.heaviest == 0.0 && bits == 0,
            _ => (weights[place as usize - 1] - weight).abs() < 2e-5 && weight > expected.heaviest - 2e-5,
        };
        let close = |axis: usize| (f64::from(sums[index][axis]) - expected.motion[axis]).abs() < 1e-3;
        assert!(picked && close(0) && close(1), "{what}, pixel {index}: {expected:?}, {:?}", picks[index]);
        let [x, y, z, median] = surfaces[index].map(f64::from);
        let close = [x, y, z].into_iter().zip(expected.normal).all(|(a, b)| (a - b).abs() < 2e-3);
        let surface = close && is_surface_depth(median, 0.5, (&lists.list_of(pixel), &slopes), pixel, 1e-4);
        assert!(surface, "{what}, pixel {index}: {expected:?}, {:?}", surfaces[index]);
    }
}

fn check_auxiliary(gpu: &Gpu, lists: &Lists, form: Form) {
    let motions = motions(lists);
    let both = forward_auxiliary(gpu, lists, form, &motions, ALL);
    let what = format!("{form:?}");
    assert_auxiliary(gpu, lists, &both, &motions, &what);
    // The picture of the kernel without auxiliary outputs, in one pass.
    let alone = forward(gpu, lists, Form { entries_per_pass: u32::MAX, ..form });
    assert_same_bits(gpu, [&both.blended, &alone], lists.view.pixels(), &what);
}

/// Each output alone equals that of all together, and the others stay untouched.
fn check_apart(gpu: &Gpu, lists: &Lists, form: Form) {
    let (motions, count) = (motions(lists), lists.view.pixels());
    let words = |buffer: &Buffer| gpu.read::<u32>(buffer, 2 * count);
    let all = forward_auxiliary(gpu, lists, form, &motions, ALL);
    for only in 0..3 {
        let outputs = Outputs { pick: only == 0, motion: only == 1, surface: only == 2 };
        let one = forward_auxiliary(gpu, lists, Form { inverse_depth: false, ..form }, &motions, outputs);
        for (on, buffer, other) in [
            (outputs.pick, &one.picks, &all.picks),
            (outputs.motion, &one.motion_sums, &all.motion_sums),
            (outputs.surface, &one.surfaces, &all.surfaces),
        ] {
            let own = words(buffer);
            assert!(if on { own == words(other) } else { own.iter().all(|&word| word == UNTOUCHED) });
        }
    }
}

/// The nearer of two splats with equal weights wins: 1/4 in front; behind it 3/4 of a third, which rounds to 1/4.
/// With a third plus one step, the farther one wins. The splats are so wide that alpha is their opacity at each
/// pixel.
fn check_ties(gpu: &Gpu, form: Form) {
    let third = 1.0f32 / 3.0;
    let more = f32::from_bits(third.to_bits() + 1);
    assert!(0.75 * third == 0.25 && 0.75 * more > 0.25);
    for (behind, place) in [(third, 2), (more, 3)] {
        let splat = |opacity: f32| Splat {
            depth: 2.0,
            mean2d_px: [18.0, 10.0],
            cov2d: [1e8, 0.0, 1e8],
            conic: [0.0; 3],
            opacity: f64::from(opacity),
            color: [0.5; 3],
            radius_px: 0,
        };
        // The first is too faint to be blended, the last too faint to win.
        let splats = [0.001, 0.25, behind, 0.125].map(splat).to_vec();
        let lists = everywhere(gpu, splats, SIZE);
        let beside = forward_auxiliary(
            gpu,
            &lists,
            form,
            &motions(&lists),
            Outputs { pick: true, ..Outputs::default() },
        );
        for [picked, weight] in gpu.read::<[u32; 2]>(&beside.picks, lists.view.pixels()) {
            assert_eq!((picked, f32::from_bits(weight) >= 0.25), (place, true), "{form:?}");
        }
    }
}

#[test]
fn blend_auxiliary_picks_the_nearest_of_equal_weights() {
    let gpu = Gpu::new();
    let in_passes = Form { entries_per_pass: 2, ..CHAINED };
    for form in [CHAINED, UNCHAINED, LOW, SHARED, in_passes] {
        check_ties(&gpu, form);
    }
    [CHAINED, UNCHAINED, in_passes].into_iter().for_each(|form| check_ties(&gpu, shared(32, form)));
}

#[test]
fn blend_auxiliary_equals_its_twin() {
    let gpu = Gpu::new();
    for form in [CHAINED, UNCHAINED, LOW, SHARED] {
        for entries in [0, 33, 300] {
            check_auxiliary(&gpu, &lists(&gpu, entries, [0.02, 0.6]), form);
        }
        check_auxiliary(&gpu, &Lists::long(&gpu, 40, [0.5, 1.0], &small_view([64, 48])), form);
    }
}

#[test]
fn blend_auxiliary_equals_its_twin_in_passes_and_regions() {
    let gpu = Gpu::new();
    let lists = lists(&gpu, 301, [0.005, 0.3]);
    check_apart(&gpu, &lists, Form { entries_per_pass: 64, ..CHAINED });
    for entries_per_pass in [100, 301] {
        check_auxiliary(&gpu, &lists, Form { entries_per_pass, ..CHAINED });
    }
    for parts in region_counts(&gpu) {
        check_auxiliary(&gpu, &lists, Form { parts, entries_per_pass: 128, ..CHAINED });
    }
}

#[test]
fn blend_shared_auxiliary_equals_its_twin() {
    let gpu = Gpu::new();
    let largest = gpu.context.limits().workgroup_size(256);
    for entries in [0, 33, 300] {
        let lists = lists(&gpu, entries, [0.02, 0.6]);
        check_auxiliary(&gpu, &lists, shared(32, CHAINED));
        check_auxiliary(&gpu, &lists, shared(largest, UNCHAINED));
        check_auxiliary(&gpu, &lists, shared(64, Form { entries_per_pass: 100, ..UNCHAINED }));
    }
    let lists = lists(&gpu, 301, [0.005, 0.3]);
    check_apart(&gpu, &lists, shared(32, Form { entries_per_pass: 64, ..CHAINED }));
}
