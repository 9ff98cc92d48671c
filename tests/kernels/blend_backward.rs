//! `backward/blend_backward` and `backward/blend_backward_subgroup_per_tile` against one twin.

use crate::common::blending::{
    Blended, CHAINED, Form, OtherSums, SlotSums, backward, backward_alone, forms, forward,
};
use crate::common::frame::{Lists, state};
use crate::common::machine::{Machine, current};
use crate::common::prelude::*;
use crate::reference::blend_backward::{PixelGradient, blend_backward};
use crate::reference::pipeline::{pixels_of, tile_of};

const TOLERANCE: GradientTolerance = GradientTolerance { relative_l2: 1e-4, max_over_max: 2e-4 };

/// Random dL/dpixel, zero where rounding may change a decision.
fn image_gradient(lists: &Lists) -> Vec<[f32; 4]> {
    let mut random = Random::new(17);
    let unstable = lists.unstable();
    unstable
        .iter()
        .map(|&unstable| [0; 4].map(|_| if unstable { 0.0 } else { random.signed() as f32 }))
        .collect()
}

/// The twin's gradient of each sorted instance.
fn expected(lists: &Lists, d_pixels: &[[f32; 4]]) -> Vec<SplatGradient> {
    let mut by_tile: Vec<Vec<SplatGradient>> =
        lists.lists.iter().map(|list| vec![SplatGradient::default(); list.len()]).collect();
    for (pixel, d) in pixels_of(&lists.view).zip(d_pixels) {
        let [r, g, b, inverse_depth] = d.map(f64::from);
        let d = PixelGradient { color: [r, g, b], inverse_depth };
        let gradients = &mut by_tile[tile_of(&lists.view, pixel)];
        blend_backward(&lists.list_of(pixel), pixel, lists.view.background, d, gradients);
    }
    by_tile.concat()
}

/// A splat's gradient from the moments of dL/dpower.
pub fn from_moments(splat: &Splat, sums: [f64; 10]) -> SplatGradient {
    let [one, x, y, xx, xy, yy, r, g, b, inverse_depth] = sums;
    let [conic_a, conic_b, conic_c] = splat.conic;
    SplatGradient {
        mean2d_px: [-(conic_a * x + conic_b * y), -(conic_b * x + conic_c * y)],
        conic: [-0.5 * xx, -xy, -0.5 * yy],
        opacity: one / splat.opacity,
        color: [r, g, b],
        inverse_depth,
        ..SplatGradient::default()
    }
}

/// The device's gradient of each sorted instance.
fn actual(lists: &Lists, sums: &SlotSums) -> Vec<SplatGradient> {
    let splats = lists.lists.iter().flatten().map(|&visible| &lists.frame.splats[visible as usize]);
    splats
        .zip(&lists.instances)
        .map(|(splat, &instance)| from_moments(splat, sums.sums[instance as usize]))
        .collect()
}

type Field = (&'static str, fn(&SplatGradient) -> Vec<f64>);

fn compare(kernel: &str, actual: &[SplatGradient], expected: &[SplatGradient]) {
    let skip = vec![false; expected.len()];
    let fields: [Field; 5] = [
        ("mean2d", |g| g.mean2d_px.to_vec()),
        ("conic", |g| g.conic.to_vec()),
        ("opacity", |g| vec![g.opacity]),
        ("colour", |g| g.color.to_vec()),
        ("inverse depth", |g| vec![g.inverse_depth]),
    ];
    for (name, field) in fields {
        let [actual, expected] = [actual, expected].map(|g| g.iter().flat_map(field).collect::<Vec<f64>>());
        gradient(name, &actual, &expected, &skip, TOLERANCE).unwrap_or_else(|e| panic!("{kernel}: {e}"));
    }
}

/// A kernel's name, and how it runs over lists.
type Kernel = (&'static str, fn(&Gpu, &Lists, &Blended, Option<&[[f32; 4]]>, Form) -> SlotSums);

/// Both kernels on a device; the interpreter runs only the first.
fn kernels() -> &'static [Kernel] {
    const KERNELS: [Kernel; 2] =
        [("blend_backward", backward), ("blend_backward_subgroup_per_tile", backward_alone)];
    if current() == Machine::Device { &KERNELS } else { &KERNELS[..1] }
}

fn check(gpu: &Gpu, lists: &Lists, entries_per_pass: u32) {
    let d_pixels = image_gradient(lists);
    let expected = expected(lists, &d_pixels);
    for form in forms(gpu).into_iter().map(|form| Form { entries_per_pass, ..form }) {
        let blended = forward(gpu, lists, form);
        for (name, kernel) in kernels() {
            let sums = kernel(gpu, lists, &blended, Some(&d_pixels), form);
            compare(name, &actual(lists, &sums), &expected);
        }
    }
}

#[test]
pub fn blend_backward_equals_its_twin_on_lists_of_all_lengths() {
    let gpu = Gpu::new();
    let subgroup = gpu.subgroup() as usize;
    for entries in [0, 1, subgroup - 1, subgroup, subgroup + 1, 31, 32, 33, gpu.sized(300, 130)] {
        check(&gpu, &Lists::long(&gpu, entries, [0.02, 0.6], &small_view([37, 21])), u32::MAX);
    }
}

#[test]
pub fn blend_backward_equals_its_twin_on_images_of_all_sizes() {
    let gpu = Gpu::new();
    for &size in gpu.sized(&[[1, 1], [17, 5], [16, 16], [15, 33], [64, 48]][..], &[[1, 1], [17, 5], [15, 33]])
    {
        check(&gpu, &Lists::long(&gpu, 40, [0.02, 0.9], &small_view(size)), u32::MAX);
    }
}

#[test]
pub fn blend_backward_in_passes() {
    let gpu = Gpu::new();
    for opacity in [[0.005, 0.03], [0.5, 1.0]] {
        let lists = Lists::long(&gpu, 301, opacity, &small_view([37, 21]));
        [64, 96, 320].into_iter().for_each(|entries_per_pass| check(&gpu, &lists, entries_per_pass));
    }
}

/// Every instance is written, even if no pixel has a gradient.
#[test]
pub fn blend_backward_of_nothing_is_zero() {
    let gpu = Gpu::new();
    let lists = Lists::long(&gpu, 70, [0.5, 1.0], &small_view([37, 21]));
    let blended = forward(&gpu, &lists, CHAINED);
    for (name, kernel) in kernels() {
        let sums = kernel(&gpu, &lists, &blended, None, CHAINED);
        assert!(sums.sums.iter().flatten().all(|&sum| sum == 0.0), "{name}");
    }
}

/// Variants with other sums: absolute gradients beside the usual sums, which keep their bits; and the weights alone.
#[test]
pub fn blend_backward_with_other_sums_equals_its_twin() {
    let gpu = Gpu::new();
    for (entries, size, entries_per_pass) in [(1, [17, 5], u32::MAX), (33, [37, 21], 64), (300, [37, 21], 96)]
    {
        let lists = Lists::long(&gpu, entries, [0.02, 0.9], &small_view(size));
        let d_pixels = image_gradient(&lists);
        let expected = expected(&lists, &d_pixels);
        // Only the weights of red.
        let edges: Vec<[f32; 4]> = d_pixels.iter().map(|d| [d[0].abs(), 0.0, 0.0, 0.0]).collect();
        let weights = self::expected(&lists, &edges);
        let ways =
            forms(&gpu).into_iter().flat_map(|form| kernels().iter().map(move |kernel| (form, kernel)));
        for (form, (name, kernel)) in ways {
            let form = Form { entries_per_pass, ..form };
            let blended = forward(&gpu, &lists, form);
            let usual = kernel(&gpu, &lists, &blended, Some(&d_pixels), form);
            let form = Form { sums: OtherSums::Absolute, ..form };
            let absolute = kernel(&gpu, &lists, &blended, Some(&d_pixels), form);
            assert!(usual.sums == absolute.sums, "{name}, {form:?}: other bits");
            let of_instances: Vec<f64> =
                lists.instances.iter().flat_map(|&at| absolute.absolute[at as usize]).collect();
            let twin: Vec<f64> = expected.iter().flat_map(|d| d.absolute_px).collect();
            let skip = vec![false; expected.len()];
            gradient("absolute", &of_instances, &twin, &skip, TOLERANCE)
                .unwrap_or_else(|e| panic!("{name}: {e}"));
            let form = Form { inverse_depth: false, sums: OtherSums::Weights, ..form };
            let sums = kernel(&gpu, &lists, &blended, Some(&edges), form);
            let of_instances: Vec<f64> =
                lists.instances.iter().map(|&at| sums.sums[at as usize][8]).collect();
            let twin: Vec<f64> = weights.iter().map(|d| d.color[0]).collect();
            gradient("weights", &of_instances, &twin, &skip, TOLERANCE)
                .unwrap_or_else(|e| panic!("{name}: {e}"));
        }
    }
}

/// The first scene has the same bits when the frame has other scenes. In a single pass, nothing a batch or more
/// behind it is blended.
#[test]
pub fn blend_backward_of_the_first_scene_alone() {
    let gpu = Gpu::new();
    let cases = [
        (7, [16, 16], u32::MAX, OtherSums::None),
        (300, [16, 16], 64, OtherSums::None),
        (300, [16, 16], u32::MAX, OtherSums::Absolute),
        (70, [37, 21], 96, OtherSums::Weights),
    ];
    let ways = cases.into_iter().flat_map(|case| kernels().iter().map(move |kernel| (case, kernel)));
    for ((entries, size, entries_per_pass, sums), (name, kernel)) in ways {
        let mut lists = Lists::sorted(&gpu, entries, [0.02, 0.2], &small_view(size));
        let d_pixels = image_gradient(&lists);
        let visible = lists.frame.splats.len();
        let (order, instances) = (lists.lists.clone(), lists.instances.clone());
        let form = Form { entries_per_pass, sums, inverse_depth: sums == OtherSums::None, ..CHAINED };
        let blended = forward(&gpu, &lists, form);
        // Only the weights are written.
        let first_sum = if sums == OtherSums::Weights { 8 } else { 0 };
        let mut of_scenes = |first_scene: usize| -> Vec<Vec<f64>> {
            lists.state = state(&gpu, [first_scene, visible, instances.len()]);
            let SlotSums { sums: own, absolute } = kernel(&gpu, &lists, &blended, Some(&d_pixels), form);
            let absolute = absolute
                .into_iter()
                .map(|own| own.map(|x| if sums == OtherSums::Absolute { x } else { 0.0 }));
            own.iter().zip(absolute).map(|(own, absolute)| [&own[first_sum..], &absolute].concat()).collect()
        };
        let all = of_scenes(visible);
        let is_nothing = |sums: &[f64]| sums.iter().all(|&sum| sum == 0.0);
        let batch = gpu.subgroup().max(32) as usize;
        let (single, mut spared) = (entries_per_pass == u32::MAX, 0);
        for first_scene in [0, 1, visible / 40, visible / 2, visible - 1] {
            let some = of_scenes(first_scene);
            let mut instances = instances.iter().map(|&at| at as usize);
            for list in &order {
                let is_of_first = |&visible: &u32| (visible as usize) < first_scene;
                let end = list.iter().rposition(is_of_first).map_or(0, |last| last + 1);
                for (entry, at) in instances.by_ref().take(list.len()).enumerate() {
                    let what =
                        format!("{name}, {form:?}, {first_scene} of {visible}, entry {entry}, {end} count");
                    assert!(entry >= end || some[at] == all[at], "{what}");
                    let is_behind = single && entry >= end + batch;
                    assert!(!is_behind || is_nothing(&some[at]), "{what}");
                    spared += usize::from(is_behind && !is_nothing(&all[at]));
                }
            }
        }
        assert!(!single || entries <= batch || spared > 0, "{name}, {form:?}: nothing to spare");
    }
}
