//! `forward/project` against its twin.

use crate::common::frame::{Projected, tile_bounds, touched_at_most};
use crate::common::prelude::*;
use crate::reference::cull::cull;
use crate::reference::lists::{is_listed, listed_tiles, tiles_met};
use crate::reference::project::radius_px;
use crate::reference::tiles::{half_extent_px, reference_square, touched};

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
        let (min, max) = tile_bounds(splat, view);
        let count = tiles_met(lists[place]);
        assert!(min <= count && count <= max, "{count} not in {min}..={max}, {splat:?}");
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
        // At least as wide as the ellipse α = 1/255, and hardly wider.
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
    close("depth", depth_of_key(output.depth_keys[place]), view.order_of(splat), 2e-6, 1e-6);
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
    let (as_they_are, usual) = (Style::AS_THEY_ARE, small_view([53, 37]));
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
        draw(Style { dropout, z_record, ..as_they_are }, antialias);
    }
    // A scene's tint, also where colours are clamped, and for other shapes.
    for (color, opacity) in [([1.0; 3], 1.0), ([0.5, 0.0, 1.75], 0.375), ([65536.0, 1.0, 0.25], 1.0)] {
        for shape in [as_they_are, ellipsoids, dots] {
            let drawn = Style { tint: Some(Tint { color, opacity }), ..shape };
            draw(drawn, false);
            draw(drawn, true);
        }
    }
    // The order of distances, with z as the blended depth too.
    for z_record in [false, true] {
        draw(Style { distance_order: true, z_record, ..as_they_are }, false);
    }
    // A selection in another colour, to which the tint does not apply.
    for (share, tint) in [(0.75, None), (1.0, Some(Tint { color: [0.5, 1.5, 1.0], opacity: 0.5 }))] {
        let selection = Some(Selection { color: [1.0, 0.25, 0.0], share });
        let drawn = Style { selection, tint, ..as_they_are };
        views.extend([1, 33, 500].map(|size| (size, View { drawn, ..usual.clone() })));
    }
    // Mip-Splatting's filters.
    for (filter_3d, dilation) in [(0.0, 0.1_f32), (0.0078125, 0.1), (0.125, 0.3)] {
        let drawn = Style { dilation_px2: dilation.into(), ..as_they_are };
        for antialias in [false, true] {
            views.push((500, View { filter_3d, antialias, drawn, ..usual.clone() }));
        }
    }
    // Parallel rays, together with features that share their code. The picture shows as much as a pinhole camera's at the
    // middle of the scene.
    for (drawn, antialias, extent) in [
        (as_they_are, false, Extent::Exact),
        (as_they_are, true, Extent::Reference),
        (ellipsoids, false, Extent::Exact),
        (Style { z_record: true, ..as_they_are }, true, Extent::Exact),
    ] {
        let drawn = Style { orthographic: true, ..drawn };
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
