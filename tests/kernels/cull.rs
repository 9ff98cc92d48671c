//! `forward/cull` against its twin, and `forward/cull_scenes` against both: to the bit with `forward/cull`.

use crate::common::prelude::*;
use crate::reference::cull::cull as cull_twin;
use crate::reference::linear::multiply;
use crate::reference::project::project;
use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants::NO_BATCH;
use ashsplat::kernels::forward::{cull, cull_scenes};

/// View of all tests, with this in place of Gaussians.
fn view_of(drawn: Drawn) -> View {
    View { drawn, ..small_view([53, 37]) }
}

fn scene(seed: u64, count: usize) -> Vec<Gaussian> {
    mixed_scene(&mut Random::new(seed), count, 1)
}

fn counted(flags: &[u32], block: usize) -> Vec<u32> {
    flags.chunks(block).map(|flags| flags.iter().sum()).collect()
}

/// True if a Gaussian's visibility may depend on float32 rounding, or on the margin that the kernel shared_order to exact
/// extents. A splat that touches only the margin costs time, but nothing is wrong.
fn may_differ(gaussian: &Gaussian, view: &View) -> bool {
    let nudged = [-1.0, 1.0].map(|by: f64| {
        let larger = Gaussian {
            log_scale: gaussian.log_scale.map(|s| s + 2e-3 * by),
            opacity_logit: gaussian.opacity_logit + 5e-3 * by,
            ..gaussian.clone()
        };
        project(&larger, view).is_some()
    });
    nudged[0] != nudged[1]
}

/// Culls Gaussians with a gap behind them, and shared_order to the flags of an earlier view, if any. Returns their flags; the
/// blocks' counts must be their sums.
fn culled_behind(gpu: &Gpu, view: &View, gaussians: &[Gaussian], earlier: Option<&[u32]>) -> Vec<u32> {
    let (words, [first_cut_out, cut_out_count]) = cut_outs(view);
    let spec = cull::Spec {
        workgroup_size: gpu.workgroup(64),
        subgroup_size: gpu.subgroup(),
        filter_3d: view.filter_3d > 0.0,
        dropout: view.drawn.dropout.is_some(),
        tinted: view.drawn.tint.is_some(),
        cut_outs: cut_out_count > 0,
        projection: view.drawn.projection(),
        lenses: false,
        shared_order: earlier.is_some(),
        shutter: false,
    };
    let (size, block) = (gaussians.len(), spec.workgroup_size as usize);
    // The gap includes all of another block.
    let end = size + block + 1;
    let blocks = end.div_ceil(block);
    let flags = match earlier {
        None => gpu.untouched::<u32>("visible_flags", end + 2),
        Some(earlier) => gpu.buffer("visible_flags", &[earlier, &vec![UNTOUCHED; end + 2 - size]].concat()),
    };
    let counts = gpu.untouched::<u32>("block_counts", blocks + 2);
    let bind = cull::Bind {
        parameters: &gpu.buffer("parameters", &pack_filtered(gaussians, room(size), view.filter_3d)),
        visible_flags: &flags,
        block_counts: &counts,
        cut_outs: &gpu.buffer("cut_outs", &words),
        camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
    };
    let push = cull::Push {
        first: 0,
        count: size as u32,
        flag_count: end as u32,
        chunk_gaussians: room(size) as u32,
        extent: extent_word(view),
        antialias: antialias_word(view),
        first_cut_out,
        cut_out_count,
        ..cull::Push::default()
    };
    gpu.dispatch::<cull::Interface>(&spec, &bind, &push, blocks as u64 + 1);
    let own = gpu.read::<u32>(&flags, size);
    let mut expected_counts = counted(&own, block);
    expected_counts.resize(blocks, 0);
    gpu.assert_values(&flags, &[own.as_slice(), &vec![0; end - size]].concat(), "in the gap");
    gpu.assert_values(&counts, &expected_counts, "sums of flags");
    own
}

/// Culls, and compares with the twin where rounding does not decide. Returns the flags.
fn culled(gpu: &Gpu, view: &View, gaussians: &[Gaussian]) -> Vec<u32> {
    let flags = culled_behind(gpu, view, gaussians, None);
    for ((i, gaussian), expected) in gaussians.iter().enumerate().zip(cull_twin(gaussians, view)) {
        let agrees = flags[i] == u32::from(expected) || may_differ(gaussian, view);
        assert!(agrees, "Gaussian {i} of {}: {}, {view:?}", gaussians.len(), flags[i]);
    }
    flags
}

fn shown(flags: &[u32]) -> u32 {
    flags.iter().sum()
}

#[test]
pub fn cull_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, (extent, antialias)) in sizes(gpu.workgroup(64) as usize)
        .into_iter()
        .flat_map(|n| [(n, (Extent::Exact, false)), (n, (Extent::Reference, true))])
    {
        let view = View { extent, antialias, ..small_view([53, 37]) };
        let gaussians = scene(size as u64, size);
        let flags = culled(&gpu, &view, &gaussians);
        let pairs = flags.iter().zip(cull_twin(&gaussians, &view));
        let borderline = pairs.filter(|&(flag, expected)| *flag != u32::from(expected)).count();
        assert!(borderline <= 1 + size / 50, "{borderline} of {size} differ");
    }
}

/// A second view shared_order its visible Gaussians to those of the first.
#[test]
pub fn cull_equals_its_twin_behind_an_earlier_view() {
    let gpu = Gpu::new();
    let block = gpu.workgroup(64) as usize;
    for size in [1, block, block + 1, 5 * block + 3] {
        let gaussians = scene(size as u64, size);
        let views =
            [0.0, 1.5].map(|turn| View { camera_from_world: rotation_about_y(turn), ..small_view([53, 37]) });
        let alone = views.each_ref().map(|view| culled(&gpu, view, &gaussians));
        let flags = culled_behind(&gpu, &views[1], &gaussians, Some(&alone[0]));
        let expected: Vec<u32> = alone[0].iter().zip(&alone[1]).map(|(a, b)| a | b).collect();
        assert_eq!(flags, expected);
        if size > block + 1 {
            assert!(expected != alone[0] && expected != alone[1], "each view shows others");
        }
    }
}

/// With parallel rays the picture's edges are planes, and only the near plane has a z.
#[test]
pub fn cull_equals_its_twin_with_parallel_rays() {
    let gpu = Gpu::new();
    let gaussians = scene(17, 700);
    for (extent, antialias) in [(Extent::Exact, false), (Extent::Reference, true)] {
        let drawn = Drawn { orthographic: true, ..Drawn::AS_THEY_ARE };
        let view = View { extent, antialias, focal_px: [13.0, 14.5], ..view_of(drawn) };
        culled(&gpu, &view, &gaussians);
        let perspective = View { drawn: Drawn::AS_THEY_ARE, ..view.clone() };
        let [parallel, perspective] = [view, perspective].map(|view| cull_twin(&gaussians, &view));
        assert_ne!(parallel, perspective, "other rays see others");
    }
}

/// The filter makes Gaussians fainter and wider, with a narrower low-pass filter.
#[test]
pub fn cull_equals_its_twin_with_a_3d_filter() {
    let gpu = Gpu::new();
    let gaussians = scene(13, 700);
    let unfiltered = cull_twin(&gaussians, &small_view([53, 37]));
    for filter_3d in [0.0078125, 0.125] {
        let drawn = Drawn { dilation_px2: f64::from(0.1_f32), ..Drawn::AS_THEY_ARE };
        let view = View { filter_3d, antialias: true, ..view_of(drawn) };
        culled(&gpu, &view, &gaussians);
        assert_ne!(cull_twin(&gaussians, &view), unfiltered, "it changes what is visible");
    }
}

/// A faint Gaussian draws no ellipsoid, but a dot.
#[test]
pub fn cull_equals_its_twin_for_what_is_drawn_in_place_of_gaussians() {
    let gpu = Gpu::new();
    let gaussians = scene(11, 700);
    let [_, ellipsoids, dots] = drawn_shapes().map(|drawn| shown(&culled(&gpu, &view_of(drawn), &gaussians)));
    assert!(0 < ellipsoids && ellipsoids < dots, "{ellipsoids}, {dots}");
}

/// Cuts are exact: the limits are values of single Gaussians, which stay.
#[test]
pub fn cull_equals_its_twin_where_a_part_is_cut() {
    let gpu = Gpu::new();
    let gaussians = scene(12, 700);
    let one = &gaussians[5];
    let [x, y, _] = one.mean;
    let next = f64::from((x as f32).next_up());
    let log_density = |g: &Gaussian| {
        let [a, b, c] = g.log_scale;
        f64::from(g.opacity_logit as f32 - a.max(b).max(c) as f32)
    };
    let [low, high] = Limits::NONE.mean;
    let cuts = [
        Limits::NONE,
        Limits { mean: [[x, low[1], low[2]], high], ..Limits::NONE },
        Limits { mean: [[next, low[1], low[2]], high], ..Limits::NONE },
        Limits { mean: [low, [high[0], y, high[2]]], ..Limits::NONE },
        Limits { opacity_logit: one.opacity_logit, ..Limits::NONE },
        Limits { log_density: log_density(one), ..Limits::NONE },
        Limits { mean: [[0.0, 0.0, low[2]], high], opacity_logit: -1.0, log_density: 0.5 },
    ];
    let seen = cuts.map(|cut| {
        let flags = culled(&gpu, &view_of(Drawn { cut, ..Drawn::AS_THEY_ARE }), &gaussians);
        // A cut Gaussian is never visible, wherever it projects to.
        let lost = (0..gaussians.len()).find(|&i| flags[i] == 1 && !cut.keep(&gaussians[i]));
        assert_eq!(lost, None, "{cut:?}");
        shown(&flags)
    });
    assert!(seen[1..].iter().all(|count| 0 < *count && *count < seen[0]), "{seen:?}");
    assert!(seen[2] <= seen[1], "{seen:?}");
}

/// NaN and infinities are culled. Opacity logits of ±∞ are valid.
#[test]
pub fn cull_of_non_finite_parameters() {
    let gpu = Gpu::new();
    let plain = Gaussian {
        mean: [0.0; 3],
        quat: [1.0, 0.0, 0.0, 0.0],
        log_scale: [-1.0; 3],
        opacity_logit: 0.0,
        sh: vec![[0.0; 3]],
    };
    let cases = [
        (plain.clone(), 1),
        (Gaussian { mean: [f64::NAN, 0.0, 0.0], ..plain.clone() }, 0),
        (Gaussian { mean: [0.0, f64::INFINITY, 0.0], ..plain.clone() }, 0),
        (Gaussian { mean: [0.0, 0.0, f64::NAN], ..plain.clone() }, 0),
        (Gaussian { quat: [f64::NAN; 4], ..plain.clone() }, 0),
        (Gaussian { quat: [0.0; 4], ..plain.clone() }, 1),
        (Gaussian { log_scale: [f64::NAN, 0.0, 0.0], ..plain.clone() }, 0),
        (Gaussian { log_scale: [f64::INFINITY; 3], ..plain.clone() }, 0),
        (Gaussian { log_scale: [f64::NEG_INFINITY; 3], ..plain.clone() }, 1),
        (Gaussian { opacity_logit: f64::NAN, ..plain.clone() }, 0),
        (Gaussian { opacity_logit: f64::INFINITY, ..plain.clone() }, 1),
        (Gaussian { opacity_logit: f64::NEG_INFINITY, ..plain.clone() }, 0),
    ];
    let (gaussians, expected): (Vec<Gaussian>, Vec<u32>) = cases.into_iter().unzip();
    assert_eq!(culled_behind(&gpu, &small_view([53, 37]), &gaussians, None), expected);
}

/// The dropout depends on seed, iteration and Gaussian alone, bit for bit.
#[test]
pub fn cull_equals_its_twin_under_dropout() {
    let gpu = Gpu::new();
    let size = 900;
    let gaussians = scene(14, size);
    let keys = [(0, 0, 1), (1 << 22, 0, 1), (1 << 22, 0, 2), (1 << 22, 1, 1), (3 << 22, 0, 1)];
    let left_out = keys.map(|(below, seed, iteration)| {
        let dropout = Dropout { below, seed, iteration };
        let drawn = Drawn { dropout: Some(dropout), ..Drawn::AS_THEY_ARE };
        let flags = culled(&gpu, &view_of(drawn), &gaussians);
        assert_eq!((0..size).find(|&i| flags[i] == 1 && dropout.drops(i)), None, "{dropout:?}");
        (0..size).filter(|&i| dropout.drops(i)).collect::<Vec<_>>()
    });
    // The number matches the share within three standard deviations, and another key omits other Gaussians.
    let counts = left_out.each_ref().map(Vec::len);
    assert!(counts[0] == 0 && counts[1].abs_diff(225) < 40 && counts[4].abs_diff(675) < 40, "{counts:?}");
    assert!(left_out[1] != left_out[2] && left_out[1] != left_out[3] && left_out[2] != left_out[3]);
    // A larger share omits those of the smaller one, and more.
    assert!(left_out[1].iter().all(|i| left_out[4].contains(i)));
}

/// A scene's opacity culls Gaussians that it makes faint, but no ellipsoid or dot. A factor of 1 changes nothing.
#[test]
pub fn cull_equals_its_twin_under_a_scenes_opacity() {
    let gpu = Gpu::new();
    let gaussians = scene(15, 700);
    for (drawn, fades) in [(Drawn::AS_THEY_ARE, true), (drawn_shapes()[1], false), (drawn_shapes()[2], false)]
    {
        let view = |tint| View { antialias: true, ..view_of(Drawn { tint, ..drawn }) };
        let seen = [1.0, 0.5, 0.0625]
            .map(|opacity| culled(&gpu, &view(Some(Tint { color: [1.0; 3], opacity })), &gaussians));
        assert_eq!(seen[0], culled(&gpu, &view(None), &gaussians));
        let counts = seen.map(|flags| shown(&flags));
        assert!(counts[2] > 0 && (counts[2] < counts[1] && counts[1] < counts[0]) == fades, "{counts:?}");
        assert!(fades || counts[0] == counts[2], "{counts:?}");
    }
}

/// A turned volume of each shape, with Gaussians within a few roundings of its surface.
fn at_the_surface(shape: u32, count: usize) -> (CutOut, Vec<Gaussian>) {
    let mut random = Random::new(shape.into());
    // No element is 0: the order of the sums matters.
    let about_z = [[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]];
    let rotation = multiply(&multiply(&rotation_about_y(0.7), &about_z), &rotation_about_y(-0.4));
    let center = [0.1f32, -0.2, 0.3];
    let radius = [0.75, 0.375, 0.5];
    let scale = |axis: usize| if shape == 1 { 1.0 / radius[axis] } else { 1.0 };
    let rows = [0, 1, 2].map(|axis| rotation[axis].map(|x| (x * scale(axis)) as f32));
    let cut_out = CutOut { center, rows, bounds: radius.map(|x| x as f32), shape, removes: false };
    let plain = mixed_scene(&mut random, 1, 1).remove(0);
    let near = |_| {
        let direction = [0; 3].map(|_| random.normal());
        let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        let on_surface = match shape {
            1 => [0, 1, 2].map(|i| radius[i] * direction[i] / length),
            _ => [radius[0], radius[1] * random.signed(), radius[2] * random.signed()],
        };
        let off = 1.0 + 3e-7 * random.signed();
        let mean = [0, 1, 2].map(|i| {
            let turned: f64 = (0..3).map(|axis| rotation[axis][i] * on_surface[axis] * off).sum();
            f64::from((f64::from(center[i]) + turned) as f32)
        });
        Gaussian { mean, log_scale: [-1.5; 3], opacity_logit: 2.0, ..plain.clone() }
    };
    (cut_out, (0..count).map(near).collect())
}

/// Volumes keep exactly the twin's Gaussians, even where the last rounding decides.
#[test]
pub fn cull_equals_its_twin_with_cut_outs() {
    let gpu = Gpu::new();
    let size = 900;
    let scenes = [0, 1, 2].map(|shape| at_the_surface(shape, size));
    let [boxes, balls, halves] = [0, 1, 2].map(|shape| scenes[shape].0);
    let removes = |cut_out: CutOut| Some(CutOut { removes: true, ..cut_out });
    let sets = [
        [Some(boxes), None, None],
        [Some(balls), None, None],
        [Some(halves), None, None],
        [removes(boxes), None, None],
        [removes(balls), None, None],
        [removes(halves), Some(balls), None],
        [Some(boxes), removes(balls), Some(balls)],
        [Some(balls), Some(CutOut { center: [-0.5, 0.0, 0.0], ..boxes }), removes(halves)],
    ];
    let mixed = scene(16, size);
    for gaussians in scenes.iter().map(|(_, gaussians)| gaussians).chain([&mixed]) {
        let all = culled_behind(&gpu, &small_view([53, 37]), gaussians, None);
        for cut_outs in sets {
            let drawn = Drawn { cut_outs, ..Drawn::AS_THEY_ARE };
            let flags = culled_behind(&gpu, &view_of(drawn), gaussians, None);
            let expected = |i: usize| all[i] * u32::from(drawn.keeps(&gaussians[i]));
            assert_eq!((0..size).find(|&i| flags[i] != expected(i)), None, "{cut_outs:?}");
        }
    }
    // Each shape has Gaussians of its scene on either side.
    for (cut_out, gaussians) in &scenes {
        let inside = gaussians.iter().filter(|gaussian| cut_out.contains(gaussian.mean)).count();
        assert!((size / 5..4 * size / 5).contains(&inside), "{inside} inside of {cut_out:?}");
    }
}

/// Scenes of a batch and others between them, in one buffer.
pub struct Batch {
    pub scenes: Vec<(Vec<Gaussian>, View)>,
    /// True if the scene belongs to the batch.
    pub own: Vec<bool>,
    /// Index of the first Gaussian of each scene.
    pub firsts: Vec<usize>,
    pub parameters: Vec<[f32; 4]>,
    pub table: Vec<CameraBlock>,
}

impl Batch {
    /// `view` makes the view of scene `number`. The batch begins with scene 1.
    pub fn new(block: usize, coefficients: usize, view: impl Fn(usize) -> View) -> Batch {
        // Scenes without Gaussians are not drawn.
        let counts = [block, 3, 0, block, 2 * block + 2, 0, 1, block + 1, 5 * block + 3, 0, 7, 0];
        // Scenes of others, at both ends and in between.
        let foreign = [0, 4, 7, 10];
        let (mut scenes, mut firsts, mut parameters, mut table) = (vec![], vec![], vec![], vec![]);
        let mut first = 0;
        for (number, count) in counts.into_iter().enumerate() {
            let gaussians = mixed_scene(&mut Random::new(number as u64), count, coefficients);
            let view = view(number);
            let own = !foreign.contains(&number);
            table.push(CameraBlock {
                scene_first: first as u32,
                scene_count: count as u32,
                scene_chunk_gaussians: room(count) as u32,
                scene_batch: if own && count > 0 { 1 } else { NO_BATCH },
                // Parameters of another buffer, far outside this one.
                scene_parameters: if own { parameters.len() as u32 } else { 1 << 26 },
                ..camera_block(&view)
            });
            if own {
                parameters.extend(pack_filtered(&gaussians, room(count), view.filter_3d));
                // A gap between scenes.
                parameters.extend(vec![[f32::NAN; 4]; 16 * number]);
            }
            scenes.push((gaussians, view));
            firsts.push(first);
            first = (first + count).next_multiple_of(block);
        }
        let own = table.iter().map(|block| block.scene_batch == 1).collect();
        Batch { scenes, own, firsts, parameters, table }
    }

    /// Number of the frame's indices, up to the last Gaussian.
    pub fn index_count(&self) -> usize {
        self.ends().max().unwrap_or(0)
    }

    /// One past the last Gaussian of each scene.
    fn ends(&self) -> impl Iterator<Item = usize> + '_ {
        self.firsts.iter().zip(&self.scenes).map(|(first, (gaussians, _))| first + gaussians.len())
    }

    /// First and last culling block of the batch.
    pub fn blocks(&self, block: usize) -> [usize; 2] {
        let ends = self.ends().zip(&self.own).filter(|(_, own)| **own).map(|(end, _)| end);
        [self.firsts[1] / block, ends.max().unwrap_or(0).div_ceil(block)]
    }
}

fn check_scenes(gpu: &Gpu, shared_order: bool, view: impl Fn(usize) -> View) {
    let block = gpu.workgroup(64) as usize;
    let mut batch = Batch::new(block, 1, view);
    let (mut volumes, settings) = (Vec::new(), batch.scenes[1].1.clone());
    for (block, (_, view)) in batch.table.iter_mut().zip(&batch.scenes) {
        let (words, [skipped, count]) = cut_outs(view);
        block.scene_first_cut_out = volumes.len() as u32 / 4 + skipped;
        block.scene_cut_outs = count;
        volumes.extend(words);
    }
    let spec = cull_scenes::Spec {
        workgroup_size: block as u32,
        subgroup_size: gpu.subgroup(),
        filter_3d: settings.filter_3d > 0.0,
        tinted: settings.drawn.tint.is_some(),
        cut_outs: settings.drawn.cut_outs.iter().flatten().count() > 0,
        projection: settings.drawn.projection(),
        lenses: false,
        shared_order,
        shutter: false,
    };
    let count = batch.index_count();
    let blocks = count.div_ceil(block);
    // An earlier view shows every third Gaussian.
    let seen = |i: usize| if shared_order && i < count { u32::from(i.is_multiple_of(3)) } else { UNTOUCHED };
    let before: Vec<u32> = (0..count + 2).map(seen).collect();
    let flags = gpu.buffer("visible_flags", &before);
    let counts = gpu.untouched::<u32>("block_counts", blocks + 2);
    let bind = cull_scenes::Bind {
        parameters: &gpu.buffer("parameters", &batch.parameters),
        visible_flags: &flags,
        block_counts: &counts,
        cut_outs: &gpu.buffer("cut_outs", &volumes),
        scene_blocks: &gpu.buffer("scene_blocks", &scene_blocks(&batch.table)),
    };
    let [first_block, end_block] = batch.blocks(block);
    let push = cull_scenes::Push {
        first_block: first_block as u32,
        end_block: end_block as u32,
        scenes: batch.table.len() as u32,
        batch: 1,
        index_count: count as u32,
        extent: extent_word(&settings),
        antialias: antialias_word(&settings),
        ..cull_scenes::Push::default()
    };
    // More workgroups than blocks, as grids in two dimensions have.
    gpu.dispatch::<cull_scenes::Interface>(&spec, &bind, &push, (end_block - first_block) as u64 + 3);
    let mut flags = gpu.read::<u32>(&flags, count + 2);
    let mut counts = gpu.read::<u32>(&counts, blocks + 2);
    for (number, (gaussians, view)) in batch.scenes.iter().enumerate().filter(|(n, _)| batch.own[*n]) {
        let (first, size) = (batch.firsts[number], gaussians.len());
        let mut alone = culled(gpu, view, gaussians);
        if shared_order {
            alone.iter_mut().zip(&before[first..]).for_each(|(flag, before)| *flag |= before);
        }
        assert_eq!(flags[first..first + size], alone, "scene {number}");
        // Includes the gap behind the scene.
        let end = (first + size).next_multiple_of(block).min(count);
        assert!(flags[first + size..end].iter().all(|flag| *flag == 0), "behind scene {number}");
        for (own, flags) in counts[first / block..].iter_mut().zip(alone.chunks(block)) {
            assert_eq!(*own, flags.iter().sum::<u32>(), "scene {number}");
            *own = UNTOUCHED;
        }
        flags[first..end].copy_from_slice(&before[first..end]);
    }
    assert!(counts.iter().all(|count| *count == UNTOUCHED), "counts of others");
    assert!(flags == before, "flags of others");
}

/// Each scene has its own pose.
fn turned(number: usize) -> View {
    let turn = 0.3 * number as f64;
    View { camera_from_world: rotation_about_y(turn), ..small_view([53, 37]) }
}

#[test]
fn cull_scenes_equals_its_twin() {
    let gpu = Gpu::new();
    check_scenes(&gpu, false, turned);
    check_scenes(&gpu, true, turned);
    check_scenes(&gpu, false, |number| View { extent: Extent::Reference, antialias: true, ..turned(number) });
}

#[test]
fn cull_scenes_equals_its_twin_in_every_variant() {
    let gpu = Gpu::new();
    let drawn = |number: usize, drawn| View { drawn, ..turned(number) };
    check_scenes(&gpu, false, |number| {
        let opacity = 0.125 * (1 + number % 8) as f64;
        drawn(number, Drawn { tint: Some(Tint { color: [1.0; 3], opacity }), ..Drawn::AS_THEY_ARE })
    });
    check_scenes(&gpu, false, |number| {
        let view = drawn(number, Drawn { orthographic: true, ..Drawn::AS_THEY_ARE });
        View { focal_px: [13.0, 14.5], ..view }
    });
    check_scenes(&gpu, false, |number| View { filter_3d: 0.125, ..turned(number) });
    check_scenes(&gpu, false, |number| {
        let removes = CutOut {
            center: [0.25 * number as f32 - 1.5, 0.0, 0.0],
            rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            bounds: [0.75, 1.5, 4.0],
            shape: 0,
            removes: true,
        };
        let half = CutOut { shape: 2, removes: false, ..removes };
        let cut_outs = [Some(removes), (number % 2 == 0).then_some(half), None];
        drawn(number, Drawn { cut_outs, ..Drawn::AS_THEY_ARE })
    });
}
