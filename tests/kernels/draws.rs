//! The kernels of `densify/` that draw Gaussians and compute their chances, against their twins: `densify/draw_keys`,
//! `densify/mark_drawn`, `densify/draw_weights`, `densify/draw_sources`, `densify/opacity_keys`,
//! `densify/edge_response`, `densify/edge_gradient`, `densify/sum_weights` and `densify/add_importance`.

use super::pixels::{SIZES, layouts};
use crate::common::prelude::*;
use crate::reference::draws as twin;
use crate::reference::gather::pcg4d;
use crate::reference::linear::wide;
use ashsplat::frame::{LaunchSizes, SceneBuffers, Strips, planes};
use ashsplat::kernels::constants::{
    CHANCE_EQUAL, CHANCE_IMPORTANCE, CHANCE_STATISTIC, NOT_DRAWN, NOT_VISIBLE, STATE_OVERFLOW,
};
use ashsplat::kernels::densify::{
    add_importance, draw_keys, draw_sources, draw_weights, edge_gradient, edge_response, sum_weights,
};
use ashsplat::passes::densify::{Candidates, Chances, UniqueDraw, UniqueDrawBuffers, UniqueDrawInputs};

const KEY: [u32; 2] = [42, 700];
const THRESHOLD: f32 = 0.5;

#[derive(Clone, Copy)]
struct Row {
    statistic: [f32; 2],
    importance: f32,
    uniform: f32,
}

fn check_keys(gpu: &Gpu, rows: &[Row], explicit_uniforms: bool, chances: u32) {
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = draw_keys::Spec { workgroup_size, subgroup_size, explicit_uniforms };
    let column = |of: fn(&Row) -> f32| rows.iter().map(of).collect::<Vec<f32>>();
    let statistics: Vec<[f32; 2]> = rows.iter().map(|row| row.statistic).collect();
    let [keys, selected] = ["keys", "selected"].map(|name| gpu.untouched::<u32>(name, rows.len() + 1));
    let totals = gpu.buffer("totals", &[rows.len() as u32, 0, 0, 0]);
    let bind = draw_keys::Bind {
        statistics: &gpu.buffer("statistics", &statistics),
        importance: &gpu.buffer("importance", &column(|row| row.importance)),
        uniforms: &gpu.buffer("uniforms", &column(|row| row.uniform)),
        keys: &keys,
        selected: &selected,
        totals: &totals,
    };
    let [seed, iteration] = KEY;
    let push = draw_keys::Push { count: rows.len() as u32, threshold: THRESHOLD, chances, seed, iteration };
    gpu.dispatch_over::<draw_keys::Interface>(&spec, &bind, &push, rows.len());
    let case = format!("{spec:?}, chances {chances}");
    gpu.assert_values(&selected, &vec![0_u32; rows.len()], &case);
    let mut expected_candidates = 0;
    for (i, (row, actual)) in rows.iter().zip(gpu.read::<u32>(&keys, rows.len())).enumerate() {
        let [sum, views] = row.statistic.map(f64::from);
        let mean = if views > 0.0 { sum / views } else { 0.0 };
        let chance = match chances {
            CHANCE_IMPORTANCE => f64::from(row.importance),
            CHANCE_STATISTIC => mean,
            _ => 1.0,
        };
        let chance = if views > 0.0 && mean >= f64::from(THRESHOLD) { chance } else { 0.0 };
        let u = if explicit_uniforms { f64::from(row.uniform) } else { twin::uniform(KEY, i as u32) };
        match twin::key(chance, u) {
            None => assert_eq!(actual, NOT_DRAWN, "{case}, {i}"),
            Some(key) => {
                expected_candidates += 1;
                let actual = f64::from(f32::from_bits(actual));
                assert!((actual - key).abs() <= 1e-6 * key, "{case}, {i}: {actual}, expected {key}");
            }
        }
    }
    assert_eq!(gpu.read::<u32>(&totals, 4)[1], expected_candidates, "{case}");
}

#[test]
pub fn draw_keys_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let mut random = Random::new(size as u64);
        let mut row = || Row {
            // Means on both sides of the threshold, none within rounding of it. Some Gaussians were never visible.
            statistic: [(random.below(16) * 2 + 1) as f32 / 8.0, random.below(4) as f32],
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
            for explicit in [false, true] {
                check_keys(&gpu, &rows, explicit, chances);
            }
        }
    }
}

fn unique_draw_buffers(context: &Context, count: u32) -> UniqueDrawBuffers {
    let requests = UniqueDrawBuffers::requests(&LaunchSizes::new(context.limits()), count);
    let buffers = context.allocate("test", &requests, MemoryKind::Device);
    UniqueDrawBuffers::from_allocated(buffers.expect("memory"))
}

#[test]
fn unique_draw_is_that_of_the_twins() {
    let gpu = Gpu::new();
    let draws = UniqueDraw::new(gpu.context).expect("kernels");
    for size in [1, 700, 5000] {
        // Every fifth Gaussian has no chance.
        let mut random = Random::new(size as u64);
        let mut any = || if random.below(5) == 0 { 0.0 } else { 0.1 + random.unit() as f32 };
        let chances: Vec<f32> = (0..size).map(|_| any()).collect();
        let candidates = chances.iter().filter(|&&chance| chance > 0.0).count();
        let statistics = gpu.buffer("statistics", &vec![[1.0_f32, 1.0]; size]);
        let importance = gpu.buffer("importance", &chances);
        for wanted in [0, 1, size / 3, candidates, size, usize::MAX >> 32] {
            let buffers = unique_draw_buffers(gpu.context, size as u32);
            let draw = UniqueDrawInputs {
                count: size as u32,
                wanted: wanted as u32,
                candidates: Candidates { statistics: &statistics, threshold: 0.5 },
                chances: Chances::Importance(&importance),
                seed: 3,
                iteration: 11,
            };
            gpu.run(|r| draws.record(r, &draw, &buffers));
            let keys: Vec<_> = (chances.iter().zip(0..))
                .map(|(&chance, i)| twin::key(chance.into(), twin::uniform([3, 11], i)))
                .collect();
            let selected = gpu.read::<u32>(&buffers.selected, size);
            assert!(selected == twin::mark(&keys, wanted), "{size}, {wanted}");
            let totals = gpu.read::<u32>(&buffers.totals, 3);
            assert_eq!(totals, [size as u32, candidates as u32, candidates.min(wanted) as u32]);
        }
    }
}

#[test]
fn draw_weights_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = draw_weights::Spec { workgroup_size: gpu.workgroup(64) };
    // The second of two chunks.
    const FIRST: usize = 5;
    for (size, min) in sizes(spec.workgroup_size as usize).into_iter().flat_map(|n| [(n, 0.005), (n, -1.0)]) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        for (gaussian, logit) in gaussians.iter_mut().zip([-80.0, -5.3, -5.29, 80.0]) {
            gaussian.opacity_logit = logit;
        }
        let unit = twin::unit(size + FIRST);
        let [weights, draws] = ["weights", "draws"].map(|name| gpu.untouched::<u32>(name, size + FIRST + 1));
        let parameters = gpu.gaussians("parameters", &gaussians);
        let bind = draw_weights::Bind { parameters: &parameters, weights: &weights, draws: &draws };
        let push = draw_weights::Push {
            first: FIRST as u32,
            count: size as u32,
            unit: unit as f32,
            least_opacity: min as f32,
        };
        gpu.dispatch_over::<draw_weights::Interface>(&spec, &bind, &push, size);
        let weights = gpu.read::<u32>(&weights, size + FIRST + 1);
        for (i, gaussian) in gaussians.iter().enumerate() {
            let expected = twin::weight(gaussian.opacity_logit, unit, min);
            let actual = f64::from(weights[FIRST + i]);
            let close = (actual - expected).abs() <= 1.0 + 1e-6 * expected;
            assert!(close && (actual > 0.0) == (expected > 0.0), "{i}: {actual}, expected {expected}");
        }
        assert_eq!((&weights[..FIRST], weights[FIRST + size]), (&[UNTOUCHED; FIRST][..], UNTOUCHED));
        gpu.assert_values(&draws, &[vec![UNTOUCHED; FIRST], vec![0; size]].concat(), "draws");
    }
}

/// Sources with their kinds, and the number of draws of each Gaussian.
type DrawResult = (Vec<(usize, u32)>, Vec<u32>);

/// Stream of the random numbers of [`KEY`].
const STREAM: u32 = 3;

fn drawn(gpu: &Gpu, weights: &[u32], rows: usize) -> DrawResult {
    let spec = draw_sources::Spec { workgroup_size: gpu.workgroup(64), explicit_uniforms: false };
    let count = weights.len();
    let mut prefix = weights.to_vec();
    let total = crate::reference::scan::scan_spine(&mut prefix);
    let (sources, draws) = (gpu.untouched::<u32>("sources", rows), gpu.zeros::<u32>("draws", count));
    let bind = draw_sources::Bind {
        weights: &gpu.buffer("weights", weights),
        prefix: &gpu.buffer("prefix", &prefix),
        totals: &gpu.buffer("totals", &[count as u32, total, 0, 0]),
        uniforms: &gpu.buffer("uniforms", &[0.0_f32; 4]),
        sources: &sources,
        draws: &draws,
    };
    let [seed, iteration] = KEY;
    let push = draw_sources::Push { count: count as u32, rows: rows as u32, seed, iteration, stream: STREAM };
    gpu.dispatch_over::<draw_sources::Interface>(&spec, &bind, &push, rows);
    let sources = gpu.read::<u32>(&sources, rows).into_iter();
    (sources.map(|s| ((s & 0x3FFF_FFFF) as usize, s >> 30)).collect(), gpu.read(&draws, count))
}

#[test]
fn draw_sources_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        let mut random = Random::new(size as u64);
        // Also sums near the end of 32 bits, and weights that allow no draw.
        for max in [5, u32::MAX / size as u32, 1] {
            let mut weight = || if random.below(3) == 0 { 0 } else { random.below(max) };
            let weights: Vec<u32> = (0..size).map(|_| weight()).collect();
            let rows = size + size / 3 + 1;
            let bits = |row: usize| pcg4d([KEY[0], KEY[1], row as u32, STREAM])[0];
            let expected = twin::draw(&weights, rows, bits);
            assert_eq!(drawn(&gpu, &weights, rows), expected, "{size} up to {max}");
        }
    }
}

/// Gaussians of all opacities, some of them equal, some extreme.
fn scene(count: usize) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    let mut scene = mixed_scene(&mut Random::new(9), count, 1);
    for gaussian in &mut scene {
        let logit = random.between(-12.0, 12.0);
        gaussian.opacity_logit = f64::from(if random.below(4) > 0 { logit } else { logit.round() } as f32);
    }
    for (gaussian, logit) in scene.iter_mut().zip([-100.0, 100.0, 0.0, -0.0]) {
        gaussian.opacity_logit = logit;
    }
    scene
}

/// Compares opacities within Vulkan's bound for an exponential: 3 + 2 |x| units in the last place.
#[track_caller]
fn assert_opacities(actual: &[f32], expected: &[f64]) {
    elementwise("opacity", &wide(actual), expected, 1e-37, 4e-6).expect("opacities");
}

/// A device on which scenes lie in several buffers.
pub fn in_chunks() -> Context {
    let limits = LimitsOverride { max_storage_buffer_range: Some(1 << 20), ..LimitsOverride::default() };
    Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).expect("a device")
}

/// Uploads a scene, in several chunks on a device of [`in_chunks`].
pub fn uploaded(context: &Context, scene: &[Gaussian]) -> SceneBuffers {
    let stored = gaussians(scene);
    let uploaded = planes::upload(context, "scene", &stored, scene.len() as u32, stored.sh_degree);
    let uploaded = uploaded.expect("a scene");
    assert_eq!(uploaded.plan.chunks > 1, context.limits().max_storage_buffer_range == 1 << 20);
    uploaded
}

/// With more opacities than one workgroup sorts alone, and with parameters in several buffers.
#[test]
fn opacity_keys_put_opacities_into_their_order() {
    let gpu = Gpu::new();
    let in_chunks = in_chunks();
    for (context, count) in [(gpu.context, 1), (gpu.context, 77), (gpu.context, 9000), (&in_chunks, 20_000)] {
        let scene = scene(count);
        let uploaded = uploaded(context, &scene);
        let draws = UniqueDraw::new(context).expect("kernels");
        let buffers = unique_draw_buffers(context, count as u32);
        let mut recorded = None;
        let ran = context.run("order opacities", |r| {
            recorded = Some(draws.record_opacities(r, &uploaded, &buffers).clone())
        });
        ran.expect("sorted");
        let bytes = context.download(&recorded.expect("recorded")).expect("read");
        let actual: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        assert!(actual[..count].is_sorted(), "{count}");
        let logits: Vec<f64> = scene.iter().map(|gaussian| gaussian.opacity_logit).collect();
        assert_opacities(&actual[..count], &twin::sorted(&logits));
    }
}

/// Random colours, flat ones, and ones whose gray is a half, with a mask; and random ones again, for parts. Each with
/// `masked` and `cut_sides`.
fn photos(pixels: usize) -> Vec<(Vec<[u8; 4]>, bool, u32)> {
    let mut random = Random::new(pixels as u64);
    let colors: Vec<[u8; 3]> = (0..pixels).map(|_| [0; 3].map(|_| (random.unit() * 256.0) as u8)).collect();
    let photo = |mask: fn(usize) -> u8, color: &dyn Fn(usize) -> [u8; 3]| {
        let pixel = |i: usize| {
            let [r, g, b] = color(i);
            [r, g, b, mask(i)]
        };
        (0..pixels).map(pixel).collect::<Vec<_>>()
    };
    // 299 r + 587 g + 114 b = 500 modulo 1000.
    let halves: Vec<[u8; 3]> = (0..=255_u8)
        .flat_map(|r| (0..=255_u8).map(move |g| [r, g, 11]))
        .filter(|[r, g, b]| (299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b)) % 1000 == 500)
        .collect();
    assert!(halves.len() > 20);
    vec![
        (photo(|_| 255, &|i| colors[i]), false, 0),
        (photo(|i| if i % 3 == 0 { 0 } else { 200 }, &|i| colors[i]), true, 0),
        (photo(|_| 255, &|_| [7; 3]), false, 0),
        (photo(|_| 255, &|i| halves[i % halves.len()]), false, 0),
        (photo(|i| if i % 5 == 0 { 0 } else { 200 }, &|i| colors[i]), true, 0b0001),
        (photo(|_| 255, &|i| colors[i]), false, 0b1110),
    ]
}

#[test]
fn edge_response_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = edge_response::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    for [width, height] in SIZES {
        let pixels = (width * height) as usize;
        for (rgbm, masked, cut_sides) in photos(pixels) {
            let out = gpu.untouched::<u32>("responses", pixels + 1);
            let ranges = gpu.zeros::<u32>("ranges", 4);
            let bind =
                edge_response::Bind { rows: &gpu.buffer("rows", &rgbm), responses: &out, ranges: &ranges };
            let push = edge_response::Push {
                image_width: width,
                image_height: height,
                masked: masked.into(),
                cut_sides,
            };
            gpu.dispatch_over::<edge_response::Interface>(&spec, &bind, &push, pixels);
            let grays: Vec<i64> = rgbm.iter().map(|&[r, g, b, _]| twin::gray([r, g, b])).collect();
            let mut expected = twin::responses(&grays, [width as usize, height as usize]);
            for (pixel, value) in expected.iter_mut().enumerate() {
                let (x, y) = (pixel as u32 % width, pixel as u32 / width);
                let at_side = [x == 0, y == 0, x + 1 == width, y + 1 == height];
                let is_cut = (0..4).any(|side| at_side[side] && cut_sides >> side & 1 == 1);
                if is_cut || (masked && rgbm[pixel][3] == 0) {
                    *value = 0;
                }
            }
            let actual: Vec<i64> = gpu.read::<u32>(&out, pixels).into_iter().map(i64::from).collect();
            assert_eq!(actual, expected);
            let range = [expected.iter().min(), expected.iter().max()].map(|end| *end.expect("a pixel"));
            let [low, high] = gpu.read::<[u32; 2]>(&ranges, 1)[0];
            assert_eq!([!low, high].map(i64::from), range);
        }
    }
}

#[test]
fn edge_gradient_equals_its_twin() {
    let gpu = Gpu::new();
    for ([width, height], strips) in layouts(SIZES) {
        let spec = edge_gradient::Spec { workgroup_size: gpu.workgroup(64), strips };
        let pixels = (width * height) as usize;
        let mut random = Random::new(u64::from(width));
        let any: Vec<u32> = (0..pixels).map(|_| 20 + random.below(200)).collect();
        for responses in [any, vec![31; pixels]] {
            let [low, high] =
                [responses.iter().min(), responses.iter().max()].map(|end| *end.expect("a pixel"));
            let planes = Strips { width, height };
            let out = gpu.untouched::<f32>("image_gradient", 4 * planes.values() as usize);
            let bind = edge_gradient::Bind {
                responses: &gpu.buffer("responses", &responses),
                ranges: &gpu.buffer("ranges", &[!low, high, 0, 0]),
                image_gradient: &out,
            };
            let push = edge_gradient::Push { image_width: width, image_height: height };
            gpu.dispatch_over::<edge_gradient::Interface>(&spec, &bind, &push, pixels);
            let values = gpu.read::<f32>(&out, 4 * planes.values() as usize);
            let plane = |plane: u32| {
                let place = |i: u32| match strips {
                    true => planes.index(plane, i % width, i / width),
                    false => 4 * i as usize + plane as usize,
                };
                (0..pixels as u32).map(|i| values[place(i)]).collect::<Vec<f32>>()
            };
            let expected = twin::edges(&responses.into_iter().map(i64::from).collect::<Vec<i64>>());
            elementwise("edges", &wide(&plane(0)), &expected, 1e-7, 1e-7).expect("edges");
            assert!([1, 2].into_iter().flat_map(plane).all(|value| value == 0.0));
        }
    }
}

/// Returns the kernel's weights and ranges. `visible` has the index of each visible Gaussian, below `size`, and its instances'
/// weights.
fn summed(gpu: &Gpu, visible: &[(u32, Vec<f32>)], size: usize, overflow: bool) -> (Vec<f32>, Vec<u32>) {
    let spec = sum_weights::Spec {
        workgroup_size: gpu.workgroup(64),
        subgroup_size: gpu.subgroup(),
        ..sum_weights::Spec::default()
    };
    let mut index = vec![NOT_VISIBLE; size];
    let (mut footprints, mut begins, mut flat) = (vec![], vec![], vec![]);
    for (row, (gaussian, own)) in visible.iter().enumerate() {
        index[*gaussian as usize] = row as u32;
        footprints.push([0, 0, 0, own.len() as u32]);
        begins.push(flat.len() as u32);
        flat.extend(own.iter().map(|&weight| [weight, f32::NAN]));
    }
    let (weights, ranges) = (gpu.untouched::<f32>("weights", size + 1), gpu.zeros::<u32>("ranges", 4));
    let bind = sum_weights::Bind {
        state: &gpu.frame_state(&[(STATE_OVERFLOW, overflow.into())]),
        visible_index: &gpu.buffer("visible_index", &index),
        footprints: &gpu.buffer("footprints", &footprints),
        first_instances: &gpu.buffer("first_instances", &begins),
        instance_gradients_c: &gpu.buffer("instance_gradients_c", &flat),
        weights: &weights,
        ranges: &ranges,
    };
    let push = sum_weights::Push { count: size as u32, splat_stride: 1 };
    gpu.dispatch_over::<sum_weights::Interface>(&spec, &bind, &push, size);
    let mut weights = gpu.read::<f32>(&weights, size + 1);
    assert_eq!(weights.pop().map(f32::to_bits), Some(UNTOUCHED));
    (weights, gpu.read(&ranges, 4))
}

fn extent(weights: &[f32]) -> [f32; 2] {
    let low = weights.iter().copied().fold(f32::INFINITY, f32::min);
    [low, weights.iter().copied().fold(0.0, f32::max)]
}

#[test]
pub fn sum_weights_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        // All visible, most, and none.
        let kinds: [fn(u32) -> bool; 3] = [|_| true, |i| i % 3 > 0, |_| false];
        for is_visible in kinds {
            let mut random = Random::new(size as u64);
            let mut weights = |gaussian: u32| {
                let instances = if gaussian % 11 == 3 { 64 + gaussian % 150 } else { gaussian % 5 };
                (0..instances).map(|_| random.unit() as f32).collect::<Vec<f32>>()
            };
            let visible: Vec<(u32, Vec<f32>)> =
                (0..size as u32).filter(|&i| is_visible(i)).map(|i| (i, weights(i))).collect();
            let mut instances = vec![vec![]; size];
            for (gaussian, own) in &visible {
                instances[*gaussian as usize] = wide(own);
            }
            let (weights, ranges) = summed(&gpu, &visible, size, false);
            let expected = twin::sum_weights(&instances);
            elementwise("weights", &wide(&weights), &expected, 1e-7, 1e-6).expect("weights");
            if size > 0 {
                assert_eq!([!ranges[2], ranges[3]].map(f32::from_bits), extent(&weights));
            }
        }
    }
}

#[test]
pub fn sum_weights_of_a_frame_that_overflowed_are_none() {
    let visible: Vec<(u32, Vec<f32>)> = (0..9).map(|i| (i, vec![1.0; 3])).collect();
    let (weights, ranges) = summed(&Gpu::new(), &visible, 9, true);
    assert!(weights.iter().all(|weight| weight.to_bits() == UNTOUCHED));
    assert_eq!(ranges, [0; 4]);
}

/// Adds the importance in one view after another, starting from 0.
fn importance(gpu: &Gpu, views: &[Vec<f32>], overflow: bool) -> Vec<f64> {
    let spec = add_importance::Spec { workgroup_size: gpu.workgroup(64) };
    let size = views[0].len();
    let importance: Buffer = gpu.zeros::<f32>("importance", size);
    for weights in views {
        let [low, high] = extent(weights).map(f32::to_bits);
        let bind = add_importance::Bind {
            state: &gpu.frame_state(&[(STATE_OVERFLOW, overflow.into())]),
            weights: &gpu.buffer("weights", weights),
            ranges: &gpu.buffer("ranges", &[0, 0, !low, high]),
            importance: &importance,
        };
        let push = add_importance::Push { count: size as u32, share: 1.0 / views.len() as f32 };
        gpu.dispatch_over::<add_importance::Interface>(&spec, &bind, &push, size);
    }
    gpu.read_f64::<f32>(&importance, size)
}

#[test]
fn add_importance_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        let mut random = Random::new(size as u64);
        let mut of = |low: f64| (0..size).map(|_| (low + 9.0 * random.unit()) as f32).collect::<Vec<f32>>();
        // The third view has equal weights.
        let views = [of(0.0), of(2.0), vec![4.0; size]];
        let expected = twin::importance(&views.each_ref().map(|view| wide(view)));
        let actual = importance(&gpu, &views, false);
        elementwise("importance", &actual, &expected, 1e-6, 1e-6).expect("importance");
        assert!(importance(&gpu, &views, true).iter().all(|&value| value == 0.0));
    }
}
