//! The kernels of `densify/` that change the set of Gaussians, against their twins: `densify/classify`,
//! `densify/scatter_sources`, `densify/gather`, `densify/relocate`, `densify/reset_opacity`, `densify/mask_outside` and
//! `densify/zorder`.

use super::draws::{in_chunks, uploaded};
use crate::common::prelude::*;
use crate::reference::classify::{Decision, GRADIENT_THRESHOLD, Statistic, decide, is_pruned, masked};
use crate::reference::filter_sizes::shrink;
use crate::reference::gather::{child_of, long_axis_child, random_normal};
use crate::reference::linear::sigmoid;
use crate::reference::relocate::relocate as relocate_twin;
use crate::reference::reset_opacity::reset_opacity as reset_opacity_twin;
use crate::reference::scan::scan_spine;
use crate::reference::scatter_sources::{Densify as DensifyTwin, Kind, place as place_twin};
use crate::reference::zorder::{cell, zorder as zorder_twin};
use ashsplat::frame::{self, LaunchSizes, SceneBuffers};
use ashsplat::kernels::constants::{
    GATHER_COPIES, GATHER_LOG_SCALE, GATHER_MEAN_OPACITY, GATHER_MOMENTS, PLANE_LOG_SCALE, PLANE_MEAN_OPACITY,
};
use ashsplat::kernels::densify::{classify, gather, mask_outside, relocate, reset_opacity, scatter_sources};
use ashsplat::passes::densify::{
    Curve, Densify, DensifyBuffers, DensifyForm, Gather, OrderBuffers, OrderInputs, RandomKey,
};

const SCENE_EXTENT: f64 = 40.0;

/// All parameters 0: the moments of a new Gaussian.
fn zero(coefficients: usize) -> Gaussian {
    Gaussian {
        mean: [0.0; 3],
        quat: [0.0; 4],
        log_scale: [0.0; 3],
        opacity_logit: 0.0,
        sh: vec![[0.0; 3]; coefficients],
    }
}

/// Bits of a decision: 1 keep, 2 clone, 4 split. `child` is a Gaussian's half after a split.
fn bits(gaussian: &Gaussian, child: &Gaussian, decision: Decision, prune_big: bool) -> u32 {
    let kept = |g: &Gaussian| u32::from(!is_pruned(g.opacity_logit, g.log_scale, SCENE_EXTENT, prune_big));
    match decision {
        Decision::Split => 4 * kept(child),
        Decision::Clone => 3 * kept(gaussian),
        Decision::Keep => kept(gaussian),
    }
}

fn decision_bits(gaussian: &Gaussian, statistic: Statistic, prune_big: bool) -> u32 {
    let child = Gaussian { log_scale: gaussian.log_scale.map(|s| s - 1.6_f64.ln()), ..gaussian.clone() };
    bits(gaussian, &child, decide(gaussian.log_scale, statistic, SCENE_EXTENT), prune_big)
}

/// Counts of each bit in each block: the first bit's blocks first.
fn counts_of_bits(decisions: &[u32], block: usize) -> [Vec<u32>; 3] {
    let count = |decisions: &[u32], bit: u32| decisions.iter().map(|bits| bits >> bit & 1).sum();
    [0, 1, 2].map(|bit| decisions.chunks(block).map(|own| count(own, bit)).collect())
}

/// Inputs of the decisions, and the expected ones.
struct Decisions {
    gaussians: Vec<Gaussian>,
    statistics: Vec<[f32; 2]>,
    /// Nonzero for a split; empty if the gradient decides.
    selected: Vec<u32>,
    expected: Vec<u32>,
}

impl Decisions {
    fn check(&self, gpu: &Gpu, long_axis: bool, prune_big: bool) {
        let selected = !self.selected.is_empty();
        let spec = classify::Spec {
            workgroup_size: gpu.workgroup(64),
            subgroup_size: gpu.subgroup(),
            long_axis,
            selected,
        };
        let (size, block) = (self.gaussians.len(), spec.workgroup_size as usize);
        let blocks = size.div_ceil(block);
        let decisions = gpu.untouched::<u32>("decisions", size + 1);
        let counts = gpu.untouched::<u32>("block_counts", 3 * blocks + 1);
        let statistics = gpu.buffer("statistics", &self.statistics);
        let bind = classify::Bind {
            parameters: &gpu.gaussians("parameters", &self.gaussians),
            statistics: &statistics,
            decisions: &decisions,
            block_counts: &counts,
            selected: &if selected { gpu.buffer("selected", &self.selected) } else { statistics.clone() },
        };
        let push = classify::Push {
            first: 0,
            count: size as u32,
            blocks: blocks as u32,
            gradient_threshold: GRADIENT_THRESHOLD as f32,
            clone_scale: (0.01 * SCENE_EXTENT) as f32,
            min_opacity: 0.005,
            max_scale: if prune_big { (0.1 * SCENE_EXTENT) as f32 } else { 0.0 },
        };
        gpu.dispatch::<classify::Interface>(&spec, &bind, &push, blocks as u64 + 1);
        let case = format!("{size}, {spec:?}, {prune_big}");
        gpu.assert_values(&decisions, &self.expected, &case);
        gpu.assert_values(&counts, &counts_of_bits(&self.expected, block).concat(), &case);
    }
}

#[test]
pub fn classify_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, prune_big) in
        sizes(gpu.workgroup(64) as usize).into_iter().flat_map(|n| [(n, false), (n, true)])
    {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 1);
        let mut statistic = || {
            let views = random.below(10) as f32;
            [views * random.between(0.0, 4e-4) as f32, views]
        };
        let statistics: Vec<[f32; 2]> = (0..size).map(|_| statistic()).collect();
        for gaussian in &mut gaussians {
            // Scales around the bounds of cloning (0.4) and pruning (4).
            gaussian.log_scale = [0; 3].map(|_| random.between(-3.0, 1.8));
        }
        let expected = (gaussians.iter().zip(&statistics))
            .map(|(gaussian, &[gradient, views])| {
                let statistic = Statistic { gradient: gradient.into(), views: views.into() };
                decision_bits(gaussian, statistic, prune_big)
            })
            .collect();
        Decisions { gaussians, statistics, selected: Vec::new(), expected }.check(&gpu, false, prune_big);
    }
}

/// Decisions with children along the long axis, by the gradient and by a selection.
#[test]
pub fn classify_along_the_long_axis_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, by_selection) in
        sizes(gpu.workgroup(64) as usize).into_iter().flat_map(|n| [(n, false), (n, true)])
    {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 1);
        for gaussian in &mut gaussians {
            gaussian.log_scale = [0; 3].map(|_| random.between(-3.0, 1.8));
            // Opacities around the limit at which a child is too faint.
            gaussian.opacity_logit = random.between(-6.0, -4.0);
            // Opacities so close to a bound that rounding may decide are replaced.
            let near = |g: &Gaussian| (sigmoid(g.opacity_logit) / 0.005 - 1.0).abs() <= 1e-4;
            if near(gaussian) || near(&long_axis_child(gaussian, 0)) {
                gaussian.opacity_logit = 1.0;
            }
        }
        let views: Vec<f32> = (0..size).map(|_| random.below(10) as f32).collect();
        let selected: Vec<u32> = (0..size).map(|_| random.below(2) * 7).collect();
        // A selection ignores the gradients.
        let mut sum = |views: f32| if by_selection { 1e9 } else { views * random.between(0.0, 4e-4) as f32 };
        let statistics: Vec<[f32; 2]> = views.into_iter().map(|views| [sum(views), views]).collect();
        let decision = |i: usize| match by_selection {
            true if selected[i] > 0 => Decision::Split,
            true => Decision::Keep,
            false => {
                let [sum, views] = statistics[i];
                let gradient = if views == 0.0 { 0.0 } else { sum / views };
                let statistic = Statistic { gradient: gradient.into(), views: 1.0 };
                decide(gaussians[i].log_scale, statistic, SCENE_EXTENT)
            }
        };
        let prune_big = !by_selection;
        let expected_of = |(i, g)| bits(g, &long_axis_child(g, 0), decision(i), prune_big);
        let expected = gaussians.iter().enumerate().map(expected_of).collect();
        let selected = if by_selection { selected } else { Vec::new() };
        Decisions { gaussians, statistics, selected, expected }.check(&gpu, true, prune_big);
    }
}

/// The order of the twin, which appends and then prunes as the reference implementation does. The kernel's decisions
/// already include the pruning.
#[test]
fn scatter_sources_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = scatter_sources::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let block = spec.workgroup_size as usize;
    for (size, dropped) in sizes(block).into_iter().flat_map(|n| [(n, 0), (n, 3)]) {
        let mut random = Random::new(size as u64);
        let gaussians = mixed_scene(&mut random, size, 1);
        let statistics: Vec<Statistic> =
            (0..size).map(|_| Statistic { gradient: random.between(0.0, 4e-4), views: 1.0 }).collect();
        let decisions: Vec<u32> =
            gaussians.iter().zip(&statistics).map(|(g, s)| decision_bits(g, *s, true)).collect();
        let blocks = size.div_ceil(block);
        let mut offsets = counts_of_bits(&decisions, block);
        let totals = offsets.each_mut().map(|counts| scan_spine(counts));
        let settings = DensifyTwin { scene_extent: SCENE_EXTENT, prune_big: true };
        let twin = place_twin(&gaussians, &statistics, settings, |_, _| [0.0; 3]);
        let mut halves = 0;
        let source = |placed: &crate::reference::scatter_sources::Placed| {
            let kind = match placed.kind {
                Kind::Kept => 0,
                Kind::Clone => 1,
                // All the first halves stand in front of all the second ones.
                Kind::Child => {
                    halves += 1;
                    if halves > totals[2] { 3 } else { 2 }
                }
            };
            placed.parent as u32 | kind << 30
        };
        let mut expected: Vec<u32> = twin.iter().map(source).collect();
        // A capacity below the need drops the last rows.
        expected.truncate(expected.len().saturating_sub(dropped));
        let sources = gpu.untouched::<u32>("sources", expected.len() + 2);
        let bind = scatter_sources::Bind {
            decisions: &gpu.buffer("decisions", &decisions),
            block_offsets: &gpu.buffer("block_offsets", &offsets.concat()),
            totals: &gpu.buffer("totals", &totals),
            sources: &sources,
        };
        let push = scatter_sources::Push {
            count: size as u32,
            blocks: blocks as u32,
            capacity: expected.len() as u32,
        };
        gpu.dispatch::<scatter_sources::Interface>(&spec, &bind, &push, blocks as u64);
        gpu.assert_values(&sources, &expected, &format!("size {size}"));
    }
}

const COEFFICIENTS: usize = 9;
const SEED: u32 = 42;
const ITERATION: u32 = 700;

struct Rows {
    gaussians: Vec<Gaussian>,
    sources: Vec<u32>,
}

impl Rows {
    fn random(count: usize) -> Rows {
        let mut random = Random::new(count as u64);
        let gaussians = mixed_scene(&mut random, 40, COEFFICIENTS);
        Rows { gaussians, sources: (0..count).map(|_| random.below(40) | random.below(4) << 30).collect() }
    }

    fn each(&self) -> impl Iterator<Item = (&Gaussian, u32, u32)> {
        self.sources.iter().map(|source| {
            let gaussian = source & 0x3FFF_FFFF;
            (&self.gaussians[gaussian as usize], gaussian, source >> 30)
        })
    }

    /// Runs the kernel for each plane.
    fn gathered(&self, gpu: &Gpu, spec: gather::Spec, moments: bool) -> Vec<Gaussian> {
        let (before, after) = (self.gaussians.len(), self.sources.len());
        let sources = gpu.buffer("sources", &self.sources);
        let from = gpu.gaussians("from", &self.gaussians);
        let (from_rows, to_rows) = (plane_capacity(before), plane_capacity(after) + 256);
        let words = planes(COEFFICIENTS) * to_rows;
        let to = gpu.untouched::<[f32; 4]>("to", words);
        let bind = gather::Bind { sources: &sources, from: &from, to: &to, noise: &sources };
        for plane in 0..planes(COEFFICIENTS) as u32 {
            let form = match plane {
                _ if moments => GATHER_MOMENTS,
                PLANE_MEAN_OPACITY => GATHER_MEAN_OPACITY,
                PLANE_LOG_SCALE => GATHER_LOG_SCALE,
                _ => GATHER_COPIES,
            };
            let push = gather::Push {
                from_first: 0,
                from_count: before as u32,
                to_first: 0,
                to_count: after as u32,
                from_place: plane_place(plane, from_rows),
                to_place: plane_place(plane, to_rows),
                form,
                noise_stride: before as u32,
                seed: SEED,
                iteration: ITERATION,
            };
            gpu.dispatch_over::<gather::Interface>(&spec, &bind, &push, after);
        }
        unpack(&gpu.read::<[f32; 4]>(&to, words), to_rows, after, COEFFICIENTS)
    }

    /// Compares the rows: copies are equal. `expected` makes a child of a Gaussian with its index and number. The
    /// tolerances of means depend on the largest scale.
    fn compare(
        &self,
        actual: &[Gaussian],
        expected: impl Fn(&Gaussian, u32, u32) -> Gaussian,
        error_per_scale: f64,
    ) {
        for ((source, gaussian, kind), actual) in self.each().zip(actual) {
            if kind < 2 {
                assert_eq!(actual, source, "row of {gaussian}");
                continue;
            }
            let expected = expected(source, gaussian, kind - 2);
            let largest = source.log_scale.iter().copied().fold(f64::NEG_INFINITY, f64::max).exp();
            let bound = 1e-6 + error_per_scale * largest;
            elementwise("mean", &actual.mean, &expected.mean, bound, 1e-6).expect("means");
            elementwise("log-scale", &actual.log_scale, &expected.log_scale, 2e-6, 1e-6).expect("log-scales");
            let [logit, expected_logit] = [actual, &expected].map(|g| [g.opacity_logit]);
            if expected_logit == [source.opacity_logit] {
                assert_eq!(logit, expected_logit, "row of {gaussian}");
            } else {
                // The twin's form loses digits for opacities near 1.
                elementwise("logit", &logit, &expected_logit, 3e-6, 1e-6).expect("logits");
            }
            assert_eq!((actual.quat, &actual.sh), (source.quat, &source.sh), "row of {gaussian}");
        }
    }
}

fn gather_spec(gpu: &Gpu) -> gather::Spec {
    gather::Spec { workgroup_size: gpu.workgroup(64), explicit_noise: false, long_axis: false }
}

#[test]
fn gather_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let rows = Rows::random(size);
        let actual = rows.gathered(&gpu, gather_spec(&gpu), false);
        // Logarithm, cosine and their arguments are float32. Vulkan requires a cosine within 2^-11; the radius is at
        // most 6.
        let error = if gpu.context.device_name().contains("llvmpipe") { 2e-4 } else { 6.0 / 2048.0 };
        let child = |source: &Gaussian, gaussian, child| {
            child_of(source, random_normal([SEED, ITERATION, gaussian, child]))
        };
        rows.compare(&actual, child, error + 2e-6);
    }
}

#[test]
fn gather_of_splits_along_the_long_axis() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let mut rows = Rows::random(size);
        // Ties, needles, and opacities that round to 0 and 1.
        for (gaussian, (logit, log_scale)) in rows.gaussians.iter_mut().zip([
            (-90.0, [0.5; 3]),
            (90.0, [-1.0, 0.5, 0.5]),
            (15.0, [-7.0, -7.0, 2.0]),
            (-15.0, [2.0, -7.0, 2.0]),
        ]) {
            (gaussian.opacity_logit, gaussian.log_scale) = (logit, log_scale);
        }
        let spec = gather::Spec { long_axis: true, ..gather_spec(&gpu) };
        let actual = rows.gathered(&gpu, spec, false);
        rows.compare(&actual, |source, _, child| long_axis_child(source, child), 4e-6);
    }
}

#[test]
fn gather_of_moments() {
    let gpu = Gpu::new();
    let rows = Rows::random(500);
    let actual = rows.gathered(&gpu, gather_spec(&gpu), true);
    let zero = zero(COEFFICIENTS);
    for ((source, gaussian, kind), actual) in rows.each().zip(&actual) {
        assert_eq!(actual, if kind == 0 { source } else { &zero }, "row of {gaussian}");
    }
}

#[test]
fn relocate_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = relocate::Spec { workgroup_size: gpu.workgroup(64) };
    const FIRST: usize = 3;
    for size in sizes(spec.workgroup_size as usize) {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 4);
        for (gaussian, logit) in gaussians.iter_mut().zip([-5.29, -5.3, 12.0, 20.0, 0.0]) {
            gaussian.opacity_logit = logit;
        }
        let draws: Vec<u32> =
            [1, 60, 1, 60, 50, 49].into_iter().chain((0..20).map(|_| random.below(6))).collect();
        let mut source = |row: usize| match row < FIRST + 6 {
            true => row.saturating_sub(FIRST) as u32,
            false => random.below(26) | 1 << 30,
        };
        let sources: Vec<u32> = (0..FIRST + size).map(&mut source).collect();
        let [parameters, moments_1, moments_2] =
            ["parameters", "moments_1", "moments_2"].map(|name| gpu.gaussians(name, &gaussians));
        let bind = relocate::Bind {
            sources: &gpu.buffer("sources", &sources),
            draws: &gpu.buffer("draws", &draws),
            parameters: &parameters,
            moments_1: &moments_1,
            moments_2: &moments_2,
        };
        let push = relocate::Push {
            first: FIRST as u32,
            count: size as u32,
            chunk_gaussians: plane_capacity(size) as u32,
            planes: planes(4) as u32,
            packed_moments: 0,
        };
        gpu.dispatch_over::<relocate::Interface>(&spec, &bind, &push, size);
        let [after, moments_1, moments_2] =
            [parameters, moments_1, moments_2].map(|buffer| gpu.read_gaussians(&buffer, size, 4));
        for (i, before) in gaussians.iter().enumerate() {
            let drawn = draws[(sources[FIRST + i] & 0x3FFF_FFFF) as usize];
            if drawn == 0 {
                assert_eq!([&after[i], &moments_1[i], &moments_2[i]], [before; 3], "{i}");
                continue;
            }
            let (logit, log_scale) = relocate_twin(before.opacity_logit, before.log_scale, drawn);
            // 1 - o has few digits for an opacity near 1.
            let digits = 1e-7 * (1.0 + logit.exp());
            elementwise("logit", &[after[i].opacity_logit], &[logit], 1e-5 + digits, 1e-6)
                .unwrap_or_else(|e| panic!("{i}, drawn {drawn}: {e}"));
            elementwise("log-scale", &after[i].log_scale, &log_scale, 1e-5, 1e-6)
                .unwrap_or_else(|e| panic!("{i}, drawn {drawn}: {e}"));
            let rest = |g: &Gaussian| (g.mean, g.quat, g.sh.clone());
            assert_eq!(rest(&after[i]), rest(before), "{i}");
            assert_eq!([&moments_1[i], &moments_2[i]], [&zero(4); 2], "{i}");
        }
    }
}

/// Packed moments have their own layout, in one buffer.
#[test]
fn relocation_and_reset_clear_packed_moments() {
    const PLANES: usize = 5;
    let (gpu, size) = (Gpu::new(), 70);
    let gaussians = mixed_scene(&mut Random::new(1), size, 4);
    let parameters = gpu.gaussians("parameters", &gaussians);
    let moments = gpu.buffer("moments", &vec![[u32::MAX; 4]; PLANES * plane_capacity(size)]);
    let words_of = |gaussian: usize| {
        let words = gpu.read::<[u32; 4]>(&moments, PLANES * plane_capacity(size));
        let own = |plane: usize| match plane {
            0..3 => place(plane as u32, gaussian, plane_capacity(size)),
            _ => plane * plane_capacity(size) + gaussian,
        };
        [0, 1, 2, 3, 4].map(|plane| words[own(plane)])
    };
    let (bind, push) = (
        reset_opacity::Bind { parameters: &parameters, moments_1: &moments, moments_2: &moments },
        reset_opacity::Push { count: size as u32, max_opacity: 0.01, max_logit: -4.6, packed_moments: 1 },
    );
    let spec = reset_opacity::Spec { workgroup_size: gpu.workgroup(64) };
    gpu.dispatch_over::<reset_opacity::Interface>(&spec, &bind, &push, size);
    let opacity_cleared = [u32::MAX, 0xFFFF, u32::MAX, 0xFFFF];
    let mut expected = [[u32::MAX; 4]; PLANES];
    expected[0] = opacity_cleared;
    assert!((0..size).all(|gaussian| words_of(gaussian) == expected));
    let bind = relocate::Bind {
        sources: &gpu.buffer("sources", &(0..size as u32).collect::<Vec<u32>>()),
        draws: &gpu.buffer("draws", &(0..size as u32).map(|gaussian| gaussian % 2).collect::<Vec<u32>>()),
        parameters: &parameters,
        moments_1: &moments,
        moments_2: &moments,
    };
    let push = relocate::Push {
        first: 0,
        count: size as u32,
        chunk_gaussians: plane_capacity(size) as u32,
        planes: PLANES as u32,
        packed_moments: 1,
    };
    let spec = relocate::Spec { workgroup_size: gpu.workgroup(64) };
    gpu.dispatch_over::<relocate::Interface>(&spec, &bind, &push, size);
    for gaussian in 0..size {
        let expected = if gaussian % 2 == 1 { [[0; 4]; PLANES] } else { expected };
        assert_eq!(words_of(gaussian), expected, "{gaussian}");
    }
}

/// A set that changes in place has the rows of a new one, also if it grows or lies in several buffers.
#[test]
fn gather_in_place_is_the_same_to_the_bit() {
    let (gpu, in_chunks) = (Gpu::new(), in_chunks());
    let mut random = Random::new(6);
    for (context, count, rows) in
        [(gpu.context, 300, 260), (gpu.context, 300, 411), (&in_chunks, 20_000, 22_000)]
    {
        let stored = gaussians(&mixed_scene(&mut random, count as usize, 4));
        let upload = || {
            frame::planes::upload(context, "scene", &stored, count.max(rows), stored.sh_degree)
                .expect("a scene")
        };
        let sources: Vec<u32> = (0..rows).map(|_| random.below(count) | random.below(4) << 30).collect();
        let buffer = context.allocate("sources", &[("sources", u64::from(rows) * 4)], MemoryKind::Device);
        let buffer = buffer.expect("memory").remove(0);
        context.upload(&buffer, bytemuck::cast_slice(&sources)).expect("uploaded");
        let densify = Densify::new(context, DensifyForm::default()).expect("kernels");
        let key = RandomKey { seed: 3, iteration: 9 };
        let gathered = |from: &SceneBuffers, to: SceneBuffers, scratch: &[Buffer], moments: bool| {
            let to = SceneBuffers { count: rows, ..to };
            let rows = Gather { from, to: &to, sources: &buffer, scratch };
            let recorded = context.run("gather", |r| match moments {
                true => densify.record_gather_moments(r, &rows),
                false => densify.record_gather_parameters(r, &rows, &key),
            });
            recorded.expect("gathered");
            frame::planes::download(context, &to).expect("downloaded")
        };
        let requests =
            vec![("scratch", u64::from(upload().plan.chunk_gaussians) * 16); upload().chunks.len()];
        let scratch = context.allocate("scratch", &requests, MemoryKind::Device).expect("memory");
        for moments in [false, true] {
            let own = upload();
            let new = gathered(&own, upload(), &[], moments);
            assert!(new.means != stored.means && new.len() == rows as usize);
            assert!(gathered(&own, own.clone(), &scratch, moments) == new, "{rows} of {count}, {moments}");
        }
    }
}

#[test]
fn reset_opacity_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = reset_opacity::Spec { workgroup_size: gpu.workgroup(64) };
    for (size, filters) in
        sizes(spec.workgroup_size as usize).into_iter().flat_map(|n| [(n, false), (n, true)])
    {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 4);
        if size > 2 {
            gaussians[1].opacity_logit = f64::INFINITY;
            gaussians[2].opacity_logit = f64::NEG_INFINITY;
        }
        // Every third of four has no filter.
        let filter = |i: usize| if filters { [0.25, 4.0, 0.0, 0.015625][i % 4] } else { 0.0 };
        let capacity = plane_capacity(size);
        let mut packed = pack(&gaussians, capacity);
        (0..size).for_each(|i| packed[place(PLANE_LOG_SCALE, i, capacity)][3] = filter(i) as f32);
        let [parameters, moments_1, moments_2] =
            ["parameters", "moments_1", "moments_2"].map(|name| gpu.buffer(name, &packed));
        let bind =
            reset_opacity::Bind { parameters: &parameters, moments_1: &moments_1, moments_2: &moments_2 };
        let max_logit = (0.01_f64 / 0.99).ln() as f32;
        let push =
            reset_opacity::Push { count: size as u32, max_opacity: 0.01, max_logit, packed_moments: 0 };
        gpu.dispatch_over::<reset_opacity::Interface>(&spec, &bind, &push, size);
        let [after, moments_1, moments_2] =
            [parameters, moments_1, moments_2].map(|buffer| gpu.read_gaussians(&buffer, size, 4));
        for (i, before) in gaussians.iter().enumerate() {
            let shrink = if filters { shrink(before, filter(i)) } else { 1.0 };
            let expected = reset_opacity_twin(before.opacity_logit, shrink);
            let actual = after[i].opacity_logit;
            let close = actual == expected || (actual - expected).abs() < 1e-5;
            assert!(close, "filters {filters}, {i}: {actual}, expected {expected}");
            let rest = |g: &Gaussian| Gaussian { opacity_logit: 0.0, ..g.clone() };
            assert_eq!([&rest(&after[i]), &moments_1[i], &moments_2[i]], [&rest(before); 3], "{i}");
        }
    }
}

#[test]
fn mask_outside_equals_its_twin() {
    // The box. Some sides are open.
    let [low, high] = [[-0.5, f32::MIN, -1.0], [0.75, 0.25, f32::MAX]];
    let gpu = Gpu::new();
    // The second of two chunks.
    const FIRST: usize = 5;
    let spec = mask_outside::Spec { workgroup_size: gpu.workgroup(64) };
    let mut found = [0; 2];
    for size in sizes(spec.workgroup_size as usize) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        // Means on a side, and just outside.
        for (gaussian, x) in gaussians.iter_mut().zip([-0.5, -0.500_000_06, 0.75, 0.750_000_06]) {
            gaussian.mean = [f64::from(x as f32), 0.25, -1.0];
        }
        let all = size + FIRST + 1;
        let before: Vec<[f32; 2]> = (0..all).map(|i| [i as f32 * 0.5, i as f32]).collect();
        let statistics = gpu.buffer("statistics", &before);
        let bind = mask_outside::Bind {
            parameters: &gpu.gaussians("parameters", &gaussians),
            statistics: &statistics,
        };
        let push =
            mask_outside::Push { first: FIRST as u32, count: size as u32, core_low: low, core_high: high };
        gpu.dispatch_over::<mask_outside::Interface>(&spec, &bind, &push, size);
        let after: Vec<[f32; 2]> = gpu.read(&statistics, all);
        let corners = [low, high].map(|corner| corner.map(f64::from));
        for i in 0..all {
            let mean = i.checked_sub(FIRST).and_then(|i| gaussians.get(i)).map(|gaussian| gaussian.mean);
            let expected = |sum: f32| match mean {
                Some(mean) => masked(f64::from(sum), mean.map(|x| f64::from(x as f32)), corners),
                None => f64::from(sum),
            };
            assert_eq!(f64::from(after[i][0]), expected(before[i][0]), "{i}");
            assert_eq!(after[i][1], before[i][1], "{i}");
            found[usize::from(after[i] == before[i])] += usize::from(mean.is_some());
        }
    }
    assert!(found[0] > 20 && found[1] > 20, "{found:?}");
}

const CENTER: [f64; 3] = [0.5, -1.25, 2.0];
const EXTENT: f64 = 3.0;

/// Gaussians all over space, some without a position on the curve. The others are at least a hundredth of a cell from
/// borders, where rounding decides.
fn inside_cells(count: usize) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    let mut scene = small_scene(&mut Random::new(7), count, 1);
    for gaussian in &mut scene {
        let far = 10f64.powf(4.0 * random.unit() - 2.0);
        gaussian.mean = gaussian.mean.map(|_| f64::from((far * random.normal()) as f32));
    }
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e38, -1e38, 0.0, -0.0];
    for (gaussian, odd) in scene.iter_mut().zip(odd) {
        gaussian.mean[1] = f64::from(odd as f32);
    }
    for gaussian in &mut scene {
        for (mean, center) in gaussian.mean.iter_mut().zip(CENTER) {
            while mean.abs() < 1e30 && !(0.01..0.99).contains(&cell(*mean, center, EXTENT).fract()) {
                *mean = f64::from((*mean + 1e-4 * (1.0 + mean.abs())) as f32);
            }
        }
    }
    scene
}

/// Rows are sorted by their keys, and rows of one key keep their order. There are more rows than one workgroup sorts
/// alone, and parameters in several buffers.
#[test]
fn zorder_puts_rows_into_the_curves_order() {
    let gpu = Gpu::new();
    let in_chunks = in_chunks();
    for (context, count, rows) in [
        (gpu.context, 8, 0),
        (gpu.context, 8, 1),
        (gpu.context, 8, 2),
        (gpu.context, 77, 77),
        (gpu.context, 3000, 200_000),
        (&in_chunks, 20_000, 30_000),
    ] {
        let scene = inside_cells(count);
        let count = scene.len() as u32;
        let uploaded = uploaded(context, &scene);
        let densify = Densify::new(context, DensifyForm::default()).expect("kernels");
        let sizes = LaunchSizes::new(context.limits());
        let allocate = |requests: &[(&'static str, u64)]| {
            context.allocate("densify", requests, MemoryKind::Device).expect("memory")
        };
        let buffers =
            DensifyBuffers::from_allocated(allocate(&DensifyBuffers::requests(&sizes, count, rows)));
        let order = OrderBuffers::from_allocated(allocate(&OrderBuffers::requests(&sizes, rows)));
        let mut random = Random::new(rows.into());
        let listed: Vec<u32> = (0..rows).map(|_| random.below(count) | random.below(4) << 30).collect();
        context.upload(&buffers.sources, bytemuck::cast_slice(&listed)).expect("uploaded");
        let curve = Curve { center: Vec3::from_array(CENTER.map(|x| x as f32)), extent: EXTENT as f32 };
        let mut sorted = None;
        let recorded = context.run("order", |recorder| {
            let DensifyBuffers { sources, totals, .. } = &buffers;
            let inputs = OrderInputs { scene: &uploaded, rows, sources, totals, curve };
            sorted = Some(densify.record_order(recorder, &inputs, &order).clone());
        });
        recorded.expect("sorted");
        let mut expected = listed;
        let keys: Vec<u32> = scene.iter().map(|g| zorder_twin(g.mean, CENTER, EXTENT)).collect();
        expected.sort_by_key(|source| keys[(source & 0x3FFF_FFFF) as usize]);
        let bytes = context.download(&sorted.expect("recorded")).expect("read");
        let actual: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        assert!(actual[..rows as usize] == expected, "{count} Gaussians, {rows} rows");
    }
}
