//! `forward/project` against its twin, and `forward/project_scenes` against `forward/project` to the bit.

use super::cull::Batch;
use crate::common::frame::{Projected, state, tile_bounds, touched_at_most, visible_scene};
use crate::common::prelude::*;
use crate::reference::cull::cull;
use crate::reference::lists::{is_listed, listed_tiles, tiles_met};
use crate::reference::project::radius_px;
use crate::reference::tiles::{half_extent_px, reference_square, touched};
use ashsplat::kernels::forward::project_scenes;

struct Output {
    mean2d_extent: Vec<[f32; 4]>,
    conic_opacity: Vec<[f32; 4]>,
    color_inverse_depth: Vec<[f32; 4]>,
    depth_keys: Vec<u32>,
    footprints: Vec<[u32; 4]>,
}

fn check(gpu: &Gpu, size: usize, view: &View) {
    let gaussians = mixed_scene(&mut Random::new(size as u64), size, 16);
    let projected = Projected::new(gpu, &gaussians, view);
    let count = projected.expected.len();
    let output = Output {
        mean2d_extent: gpu.read(&projected.mean2d_extent, count),
        conic_opacity: gpu.read(&projected.conic_opacity, count),
        color_inverse_depth: gpu.read(&projected.color_inverse_depth, count),
        depth_keys: gpu.read(&projected.depth_keys, count),
        footprints: gpu.read(&projected.footprints, count),
    };
    for (place, splat) in projected.expected.iter().enumerate() {
        compare(&output, place, splat, view);
    }
    check_tiles(gpu, &projected, &output.footprints, view);
}

fn check_tiles(gpu: &Gpu, projected: &Projected, footprints: &[[u32; 4]], view: &View) {
    let lists = gpu.read::<[u32; 2]>(&projected.tile_lists, projected.expected.len());
    let (mut counted, mut exact) = (0, 0);
    for (place, splat) in projected.splats(gpu, view).iter().enumerate() {
        let (fewest, most) = tile_bounds(splat, view);
        let count = tiles_met(lists[place]);
        assert!(fewest <= count && count <= most, "{count} not in {fewest}..={most}, {splat:?}");
        assert_eq!(footprints[place][3], count);
        let within = match view.extent {
            Extent::Exact => touched_at_most(splat, view),
            Extent::Reference => touched(splat, view),
        };
        if is_listed(lists[place]) {
            let tiles = listed_tiles(lists[place], view.tiles()[0]);
            assert_eq!(tiles.len(), count as usize);
            let in_order = tiles.is_sorted_by(|a, b| a < b);
            assert!(in_order && tiles.iter().all(|t| within.contains(t)), "{tiles:?}");
        } else {
            assert!(within.len() > 6, "{within:?} would do in a list");
        }
        counted += count;
        exact += touched(splat, view).len() as u32;
    }
    // The margins add few tiles.
    assert!(f64::from(counted) <= 1.02 * f64::from(exact) + 2.0, "{counted}, {exact}");
}

fn compare(output: &Output, place: usize, splat: &Splat, view: &View) {
    let close = |what: &str, actual: f32, expected: f64, absolute: f64, relative: f64| {
        let error = (f64::from(actual) - expected).abs();
        let close = error <= absolute + relative * expected.abs();
        assert!(close, "{what} of {place}: {actual:e}, {expected:e}, {view:?}");
    };
    let [x, y, hx, hy] = output.mean2d_extent[place];
    // Cancellation between the terms of the camera's transform, magnified by f/z.
    let pixel = 2e-6 * (64.0 + 1.0 / splat.depth * 256.0);
    close("x", x, splat.mean2d_px[0], pixel, 2e-6);
    close("y", y, splat.mean2d_px[1], pixel, 2e-6);
    if splat.opacity >= 1.0 / 254.0 {
        // Never narrower than the ellipse of 1/255, and hardly wider.
        for (actual, half) in [hx, hy].into_iter().zip(half_extent_px(splat)) {
            let wide = f64::from(actual);
            assert!(wide >= half && wide <= 1.01 * half + 0.5, "half extent of {place}: {actual}, {half}");
        }
    }
    let [a, b, c, opacity] = output.conic_opacity[place];
    let largest = splat.conic[0].max(splat.conic[2]);
    for (actual, expected) in [a, b, c].into_iter().zip(splat.conic) {
        close("conic", actual, expected, 2e-5 * largest, 1e-4);
    }
    close("opacity", opacity, splat.opacity, 1e-7, 2e-4);
    let [red, green, blue, inverse_depth] = output.color_inverse_depth[place];
    let factors = view.drawn.tint.map_or([1.0; 3], |tint| tint.color);
    for (channel, actual) in [red, green, blue].into_iter().enumerate() {
        close("colour", actual, splat.color[channel], 3e-6 * factors[channel].max(1.0), 1e-6);
    }
    let blended = if view.drawn.z_record { splat.depth } else { 1.0 / splat.depth };
    close("blended depth", inverse_depth, blended, 0.0, 1e-5);
    close("depth", depth_of_key(output.depth_keys[place]), splat.depth, 2e-6, 1e-6);
    if view.extent == Extent::Reference {
        compare_square(output.footprints[place], place, splat, view);
    }
}

/// Radius and tiles are equal unless rounding may change them.
fn compare_square(footprint: [u32; 4], place: usize, splat: &Splat, view: &View) {
    let moved = |by: f64| {
        let cov2d = splat.cov2d.map(|x| x * (1.0 + by));
        let radius_px = radius_px(cov2d);
        let mean2d_px = splat.mean2d_px.map(|x| x + 1e3 * by);
        (radius_px, reference_square(&Splat { radius_px, mean2d_px, ..splat.clone() }, view))
    };
    if moved(-3e-5) != moved(3e-5) {
        return;
    }
    let [x0, y0, x1, y1] = reference_square(splat, view);
    let expected = [x0 | x1 << 16, y0 | y1 << 16, splat.radius_px as u32];
    assert_eq!(footprint[..3], expected, "footprint of {place}");
}

#[test]
fn project_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        check(&gpu, size, &small_view([53, 37]));
    }
}

#[test]
fn project_equals_its_twin_in_every_mode() {
    let (as_they_are, usual) = (Drawn::AS_THEY_ARE, small_view([53, 37]));
    let [smaller, ellipsoids, dots] = drawn_shapes();
    let mut views = Vec::new();
    for sh_degree in 0..=3 {
        let view = View {
            sh_degree,
            antialias: sh_degree % 2 == 1,
            symmetric_limit: sh_degree >= 2,
            extent: if sh_degree == 0 { Extent::Exact } else { Extent::Reference },
            center_px: [31.0, 11.0],
            ..usual.clone()
        };
        views.push((500, view));
    }
    for drawn in [smaller, ellipsoids, dots] {
        for (extent, antialias) in [(Extent::Exact, false), (Extent::Exact, true), (Extent::Reference, true)]
        {
            views.push((500, View { drawn, extent, antialias, ..usual.clone() }));
        }
    }
    let mut draw = |drawn, antialias| views.push((500, View { drawn, antialias, ..usual.clone() }));
    // Opacities under dropout, some above 1; and z as the blended depth.
    let dropout = Some(Dropout { below: 1 << 22, seed: 3, iteration: 9 });
    for (antialias, z_record) in [(false, true), (true, false), (true, true)] {
        draw(Drawn { dropout, z_record, ..as_they_are }, antialias);
    }
    // A scene's factors, also for colours that are clamped and for other shapes.
    for (color, opacity) in [([1.0; 3], 1.0), ([0.5, 0.0, 1.75], 0.375), ([65536.0, 1.0, 0.25], 1.0)] {
        for shape in [as_they_are, ellipsoids, dots] {
            let drawn = Drawn { tint: Some(Tint { color, opacity }), ..shape };
            draw(drawn, false);
            draw(drawn, true);
        }
    }
    // A selection in another colour, to which the tint does not apply.
    for (share, tint) in [(0.75, None), (1.0, Some(Tint { color: [0.5, 1.5, 1.0], opacity: 0.5 }))] {
        let selection = Some(Selection { color: [1.0, 0.25, 0.0], share });
        let drawn = Drawn { selection, tint, ..as_they_are };
        views.extend([1, 33, 500].map(|size| (size, View { drawn, ..usual.clone() })));
    }
    // Mip-Splatting's filters.
    for (filter_3d, dilation) in [(0.0, 0.1_f32), (0.0078125, 0.1), (0.125, 0.3)] {
        let drawn = Drawn { dilation_px2: dilation.into(), ..as_they_are };
        for antialias in [false, true] {
            views.push((500, View { filter_3d, antialias, drawn, ..usual.clone() }));
        }
    }
    // Parallel rays, together with features that share their code. The picture is as large as a pinhole camera's at the middle of
    // the scene.
    for (drawn, antialias, extent) in [
        (as_they_are, false, Extent::Exact),
        (as_they_are, true, Extent::Reference),
        (ellipsoids, false, Extent::Exact),
        (Drawn { z_record: true, ..as_they_are }, true, Extent::Exact),
    ] {
        let drawn = Drawn { orthographic: true, ..drawn };
        for (sh_degree, size) in [(3, 500), (0, 33), (1, 1)] {
            let focal_px = [13.0, 14.5];
            views.push((size, View { drawn, antialias, extent, sh_degree, focal_px, ..usual.clone() }));
        }
    }
    let gpu = Gpu::new();
    views.iter().for_each(|(size, view)| check(&gpu, *size, view));
}

/// Among Gaussians that only other views show, the visible ones have the same outputs as alone. The others meet no
/// tile, even if their numbers are not finite.
#[test]
fn project_leaves_out_what_other_views_show() {
    let gpu = Gpu::new();
    let size = 500;
    for extent in [Extent::Exact, Extent::Reference] {
        let view = View { extent, ..small_view([53, 37]) };
        let mut gaussians = mixed_scene(&mut Random::new(31), size, 16);
        let (usual, places) = (gaussians[0].clone(), [0, 1, 2]);
        for (place, axis) in places.into_iter().zip([0, 1, 0]) {
            gaussians[place] = usual.clone();
            gaussians[place].mean[axis] = [3e38, -3e38, 1e30][place];
            gaussians[place].mean[2] = 1.0;
            gaussians[place].log_scale[axis] = 80.0;
        }
        let shown = cull(&gaussians, &view);
        let [alone, all] = [false, true].map(|all| Projected::listing(&gpu, &gaussians, &view, all));
        let count = alone.expected.len();
        let lists = gpu.read::<[u32; 2]>(&all.tile_lists, size);
        let own_lists = gpu.read::<[u32; 2]>(&alone.tile_lists, count);
        let outputs = |of: &Projected, count| {
            (gpu.read::<u32>(&of.depth_keys, count), gpu.read::<[u32; 4]>(&of.mean2d_extent, count))
        };
        let ((keys, means), (own_keys, own_means)) = (outputs(&all, size), outputs(&alone, count));
        let (mut next, mut borderline) = (0, 0);
        for i in 0..size {
            if shown[i] {
                // Rounding may hide a Gaussian that the twin shows.
                let own = (own_keys[next], own_means[next]);
                assert_eq!((keys[i], means[i]), own, "{extent:?}: Gaussian {i}");
                let left_out = lists[i] == [0; 2] && tiles_met(own_lists[next]) == 0;
                assert!(left_out || lists[i] == own_lists[next] || places.contains(&i), "Gaussian {i}");
                next += 1;
            } else if lists[i] != [0; 2] {
                borderline += 1;
            }
        }
        assert!(places.iter().all(|&i| lists[i] == [0; 2]), "{:?}", &lists[..3]);
        assert!(borderline <= 1 + size / 50 && count > size / 10, "{borderline} of {size}, {count} seen");
    }
}

#[test]
fn project_counts_the_tiles_of_its_twin() {
    let gpu = Gpu::new();
    for extent in [Extent::Exact, Extent::Reference] {
        let view = View { extent, ..small_view([150, 90]) };
        let projected = Projected::new(&gpu, &visible_scene(600, &view), &view);
        let footprints = gpu.read(&projected.footprints, projected.expected.len());
        check_tiles(&gpu, &projected, &footprints, &view);
    }
}

/// Words per visible Gaussian in each output.
const WORDS: [usize; 6] = [4, 4, 4, 1, 4, 2];

/// `too_few`: number of visible Gaussians beyond the capacity.
fn check_scenes(gpu: &Gpu, [all, unseen]: [bool; 2], too_few: usize, view: impl Fn(usize) -> View) {
    let block = gpu.workgroup(64) as usize;
    let batch = Batch::new(block, 16, view);
    let settings = batch.scenes[1].1.clone();
    let spec = project_scenes::Spec {
        workgroup_size: block as u32,
        sh_degree: settings.sh_degree,
        filter_3d: settings.filter_3d > 0.0,
        tinted: settings.drawn.tint.is_some(),
        projection: settings.drawn.projection(),
        lenses: false,
        sh_loops: gpu.limits().tuning.sh_loops,
        shared_order: unseen,
        shutter: false,
    };
    let count = batch.index_count();
    let mut shown = vec![false; count];
    for ((gaussians, view), first) in batch.scenes.iter().zip(&batch.firsts) {
        let own = cull(gaussians, view).into_iter().map(|shown| shown || all);
        shown[*first..].iter_mut().zip(own).for_each(|(shown, own)| *shown = own);
    }
    let list: Vec<u32> = (0..count as u32).filter(|&i| shown[i as usize]).collect();
    let before = |index: usize| shown[..index].iter().filter(|shown| **shown).count();
    let offsets: Vec<u32> = (0..count.div_ceil(block)).map(|number| before(number * block) as u32).collect();
    let visible = list.len() - too_few;
    let outputs = WORDS.map(|words| gpu.untouched::<u32>("output", words * (list.len() + 1)));
    let [mean2d_extent, conic_opacity, color_inverse_depth, depth_keys, footprints, tile_lists] = &outputs;
    let bind = project_scenes::Bind {
        parameters: &gpu.buffer("parameters", &batch.parameters),
        block_offsets: &gpu.buffer("block_offsets", &offsets),
        visible_list: &gpu.buffer("visible_list", &list),
        mean2d_extent,
        conic_opacity,
        color_inverse_depth,
        depth_keys,
        footprints,
        tile_lists,
        state: &state(gpu, [visible, visible, 0]),
        scene_blocks: &gpu.buffer("scene_blocks", &scene_blocks(&batch.table)),
    };
    let [first_block, end_block] = batch.blocks(block);
    let push = project_scenes::Push {
        first_block: first_block as u32,
        end_block: end_block as u32,
        scenes: batch.table.len() as u32,
        batch: 1,
        blocks: offsets.len() as u32,
        extent: extent_word(&settings),
        antialias: antialias_word(&settings),
        splat_stride: 1,
        ..project_scenes::Push::default()
    };
    // More workgroups than blocks, as grids in two dimensions have.
    gpu.dispatch::<project_scenes::Interface>(&spec, &bind, &push, (end_block - first_block) as u64 + 3);
    let mut actual: Vec<Vec<u32>> =
        outputs.iter().zip(WORDS).map(|(output, words)| gpu.read(output, words * (list.len() + 1))).collect();
    let mut compared = 0;
    for (number, (gaussians, view)) in batch.scenes.iter().enumerate().filter(|(n, _)| batch.own[*n]) {
        let alone = Projected::listing(gpu, gaussians, view, all);
        let first = before(batch.firsts[number]);
        let end = before(batch.firsts[number] + gaussians.len()).min(visible).max(first);
        let alone = [
            &alone.mean2d_extent,
            &alone.conic_opacity,
            &alone.color_inverse_depth,
            &alone.depth_keys,
            &alone.footprints,
            &alone.tile_lists,
        ];
        for ((actual, alone), words) in actual.iter_mut().zip(alone).zip(WORDS) {
            let own = &mut actual[words * first..words * end];
            assert!(own == gpu.read::<u32>(alone, own.len()), "'{}' of scene {number}", alone.name());
            own.fill(UNTOUCHED);
        }
        compared += end - first;
    }
    assert!(compared > 2 * block || too_few > 0, "{compared} are visible");
    assert!(actual.iter().flatten().all(|word| *word == UNTOUCHED), "of others");
}

fn turned(number: usize) -> View {
    View { camera_from_world: rotation_about_y(0.05 * number as f64), ..small_view([53, 37]) }
}

#[test]
fn project_scenes_equals_its_twin() {
    let gpu = Gpu::new();
    for sh_degree in 0..4 {
        check_scenes(&gpu, [false; 2], 0, |number| View { sh_degree, ..turned(number) });
    }
    check_scenes(&gpu, [false; 2], 150, turned);
    check_scenes(&gpu, [true; 2], 0, turned);
}

#[test]
fn project_scenes_equals_its_twin_in_every_variant() {
    let gpu = Gpu::new();
    check_scenes(&gpu, [false; 2], 0, |number| View {
        extent: Extent::Reference,
        antialias: true,
        ..turned(number)
    });
    check_scenes(&gpu, [false; 2], 0, |number| View { filter_3d: 0.125, ..turned(number) });
    check_scenes(&gpu, [false; 2], 0, |number| {
        let tint =
            Some(Tint { color: [0.25, 1.0, 0.125 * number as f64], opacity: 0.5 + 0.03125 * number as f64 });
        View { drawn: Drawn { tint, ..Drawn::AS_THEY_ARE }, ..turned(number) }
    });
    check_scenes(&gpu, [false; 2], 0, |number| {
        let drawn = Drawn { orthographic: true, ..Drawn::AS_THEY_ARE };
        View { drawn, focal_px: [13.0, 14.5], ..turned(number) }
    });
}
