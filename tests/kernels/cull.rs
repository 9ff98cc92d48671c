//! `forward/cull` against its twin.

use crate::common::prelude::*;
use crate::reference::cull::cull as cull_twin;
use crate::reference::linear::multiply;
use crate::reference::project::project;
use ashsplat::kernels::forward::cull;

/// View of all tests, with these shapes in place of Gaussians.
fn view_of(drawn: Style) -> View {
    View { drawn, ..small_view([53, 37]) }
}

fn scene(seed: u64, count: usize) -> Vec<Gaussian> {
    mixed_scene(&mut Random::new(seed), count, 1)
}

fn counted(flags: &[u32], block: usize) -> Vec<u32> {
    flags.chunks(block).map(|flags| flags.iter().sum()).collect()
}

/// True if a Gaussian's visibility may depend on float32 rounding, or on the margin that the kernel adds to exact
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

/// Culls Gaussians with a gap behind them, and adds them to the flags of an earlier view, if any. Returns their flags; the
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
        parameters: &gpu
            .buffer("parameters", &pack_filtered(gaussians, plane_capacity(size), view.filter_3d)),
        visible_flags: &flags,
        block_counts: &counts,
        cut_outs: &gpu.buffer("cut_outs", &words),
        camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
    };
    let push = cull::Push {
        first: 0,
        count: size as u32,
        flag_count: end as u32,
        chunk_gaussians: plane_capacity(size) as u32,
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

/// A second view adds its visible Gaussians to those of the first.
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
        let drawn = Style { orthographic: true, ..Style::AS_THEY_ARE };
        let view = View { extent, antialias, focal_px: [13.0, 14.5], ..view_of(drawn) };
        culled(&gpu, &view, &gaussians);
        let perspective = View { drawn: Style::AS_THEY_ARE, ..view.clone() };
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
        let drawn = Style { dilation_px2: f64::from(0.1_f32), ..Style::AS_THEY_ARE };
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
        let flags = culled(&gpu, &view_of(Style { cut, ..Style::AS_THEY_ARE }), &gaussians);
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
        let drawn = Style { dropout: Some(dropout), ..Style::AS_THEY_ARE };
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
    for (drawn, fades) in [(Style::AS_THEY_ARE, true), (drawn_shapes()[1], false), (drawn_shapes()[2], false)]
    {
        let view = |tint| View { antialias: true, ..view_of(Style { tint, ..drawn }) };
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
            let drawn = Style { cut_outs, ..Style::AS_THEY_ARE };
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
