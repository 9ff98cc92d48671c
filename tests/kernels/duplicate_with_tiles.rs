//! `forward/duplicate_with_tiles` against its twin.

use ashsplat::kernels::forward::duplicate_with_tiles::{Bind, Interface, Push, Spec};

use crate::common::frame::{Projected, shuffled, state, touched_at_most, visible_scene};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::extent_word;
use crate::common::scenes::small_view;
use crate::reference::count::ordered;
use crate::reference::scan_spine::scan_spine;
use crate::reference::tile_list::{LISTED, is_listed, tiles_met};
use crate::reference::tiles::{touched, touches_by_pixels};
use crate::reference::types::{Extent, Gaussian, Splat, View};

/// The counts and the kernel's outputs.
struct Expanded {
    counts: Vec<u32>,
    tiles: Vec<u32>,
    visible: Vec<u32>,
    first_instances: Vec<u32>,
}

/// Orders the counts, scans and expands them.
fn expanded(gpu: &Gpu, frame: &Projected, order: &[u32], view: &View) -> Expanded {
    let size = order.len();
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = Spec { workgroup_size, subgroup_size, items: 4, for_backward: true };
    let lists = ordered(order, &gpu.read::<[u32; 2]>(&frame.tile_lists, frame.expected.len()));
    let counts: Vec<u32> = lists.iter().copied().map(tiles_met).collect();
    let [heads, rows] = [0, 1].map(|word| lists.iter().map(|list| list[word]).collect::<Vec<u32>>());
    let mut offsets = counts.clone();
    let instances = scan_spine(&mut offsets) as usize;

    let (state, offsets) = (state(gpu, size, instances), gpu.buffer("instance_offsets", &offsets));
    let order = gpu.buffer("order", order);
    let tiles = gpu.untouched::<u32>("instance_tiles", instances + 2);
    let visible = gpu.untouched::<u32>("instance_visible", instances + 2);
    let first_instances = gpu.untouched::<u32>("first_instances", size);
    let bind = Bind {
        state: &state,
        order: &order,
        instance_offsets: &offsets,
        mean2d_extent: &frame.mean2d_extent,
        footprints: &frame.footprints,
        list_heads: &gpu.buffer("list_heads", &heads),
        list_rows: &gpu.buffer("list_rows", &rows),
        instance_tiles: &tiles,
        instance_visible: &visible,
        first_instances: &first_instances,
    };
    let [tiles_per_row, tile_rows] = view.tiles();
    let push = Push { extent: extent_word(view), tiles_per_row, tile_rows, splat_stride: 1 };
    let block = u64::from(workgroup_size * spec.items);
    gpu.dispatch::<Interface>(&spec, &bind, &push, instances as u64 / block + 1);
    let [mut tiles, mut visible] = [tiles, visible].map(|buffer| gpu.read::<u32>(&buffer, instances + 2));
    assert_eq!(
        (tiles.split_off(instances), visible.split_off(instances)),
        (vec![UNTOUCHED; 2], vec![UNTOUCHED; 2])
    );
    Expanded { counts, tiles, visible, first_instances: gpu.read(&first_instances, size) }
}

fn check(gpu: &Gpu, gaussians: &[Gaussian], view: &View) {
    let frame = Projected::new(gpu, gaussians, view);
    let splats = frame.splats(gpu, view);
    let order = shuffled(splats.len());
    let Expanded { counts, tiles, visible, first_instances } = expanded(gpu, &frame, &order, view);
    let columns = view.tiles()[0];
    let mut begin = 0;
    for (&gaussian, &count) in order.iter().zip(&counts) {
        let run = begin..begin + count as usize;
        let splat = &splats[gaussian as usize];
        assert!(visible[run.clone()].iter().all(|&v| v == gaussian), "instances of {gaussian}");
        if count > 0 {
            assert_eq!(first_instances[gaussian as usize], begin as u32);
        }
        let listed = &tiles[run];
        assert!(listed.is_sorted_by(|a, b| a < b), "row by row, none twice: {listed:?}");
        let allowed = match view.extent {
            Extent::Exact => touched_at_most(splat, view),
            Extent::Reference => touched(splat, view),
        };
        assert!(listed.iter().all(|tile| allowed.contains(tile)), "{listed:?} not within {allowed:?}");
        match view.extent {
            Extent::Reference => assert_eq!(listed, touched(splat, view)),
            Extent::Exact => {
                let surely = Splat { opacity: splat.opacity * (1.0 - 1e-5), ..splat.clone() };
                let lost = |tile: &u32| {
                    !listed.contains(tile) && touches_by_pixels(&surely, [tile % columns, tile / columns])
                };
                assert_eq!(allowed.iter().find(|tile| lost(tile)), None, "a tile of {splat:?} is lost");
            }
        }
        begin += count as usize;
    }
    assert_eq!(begin, tiles.len());
}

#[test]
pub fn expand_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, extent) in sizes(64).into_iter().flat_map(|n| [(n, Extent::Exact), (n, Extent::Reference)]) {
        let view = View { sh_degree: 0, extent, ..small_view([150, 90]) };
        check(&gpu, &visible_scene(size, &view), &view);
    }
}

/// Long thin ellipses in all directions, for which boxes and ellipses differ most.
#[test]
pub fn expand_of_needles() {
    let gpu = Gpu::new();
    let view = small_view([400, 300]);
    let needles: Vec<Gaussian> = (0..300)
        .map(|i| {
            let half_angle = f64::from(i) * 0.01045;
            let long = 0.02 + f64::from(i % 40) * 0.0125;
            let opacity: f64 = [0.9, 0.1, 0.005][i as usize % 3];
            Gaussian {
                mean: [f64::from(i % 23) * 0.2 - 2.2, f64::from(i % 17) * 0.2 - 1.6, 0.0],
                quat: [half_angle.cos(), 0.0, 0.0, half_angle.sin()],
                log_scale: [long.ln(), -9.0, -9.0],
                opacity_logit: (opacity / (1.0 - opacity)).ln(),
                sh: vec![[0.0; 3]],
            }
        })
        .collect();
    let view = View { sh_degree: 0, ..view };
    let lists = {
        let frame = Projected::new(&gpu, &needles, &view);
        gpu.read::<[u32; 2]>(&frame.tile_lists, frame.expected.len())
    };
    // Splats with and without a tile list side by side.
    let listed = lists.iter().filter(|&&list| is_listed(list)).count();
    assert!((50..lists.len() - 50).contains(&listed), "{listed} of {} are listed", lists.len());
    check(&gpu, &needles, &view);
}

/// Many Gaussians without a tile between others, and one with more tiles than a run has instances.
#[test]
pub fn expand_of_many_without_tiles() {
    let gpu = Gpu::new();
    let view = View { sh_degree: 0, ..small_view([640, 480]) };
    let small = |x: f64, log_scale: f64| Gaussian {
        mean: [x, 0.0, 0.0],
        quat: [1.0, 0.0, 0.0, 0.0],
        log_scale: [log_scale; 3],
        opacity_logit: 3.0,
        sh: vec![[0.0; 3]],
    };
    let gaussians: Vec<Gaussian> =
        (0..900).map(|i| small(f64::from(i % 30) * 0.05, if i == 450 { 2.0 } else { -9.0 })).collect();
    let frame = Projected::new(&gpu, &gaussians, &view);
    // Most ellipses seem to meet no row of their boxes.
    let mut lists = gpu.read::<[u32; 2]>(&frame.tile_lists, gaussians.len());
    for (i, list) in lists.iter_mut().enumerate().filter(|(i, _)| i % 300 != 150) {
        // Empty lists, and no lists.
        *list = [if i % 2 == 0 { LISTED } else { 0 }, 0];
    }
    let tiles: Vec<u32> = lists.iter().copied().map(tiles_met).collect();
    let frame = Projected { tile_lists: gpu.buffer("tile_lists", &lists), ..frame };
    let order: Vec<u32> = (0..gaussians.len() as u32).collect();
    let expanded = expanded(&gpu, &frame, &order, &view);
    let expected: Vec<u32> =
        order.iter().flat_map(|&i| std::iter::repeat_n(i, tiles[i as usize] as usize)).collect();
    assert!(tiles[450] > 500, "{} tiles", tiles[450]);
    assert_eq!(expanded.visible, expected);
}

/// A driver may round differently when it lists tiles than when it counts them. Each instance must still have a tile
/// of the Gaussian's box.
#[test]
pub fn expand_of_other_counts_stays_in_the_box() {
    let gpu = Gpu::new();
    for extent in [Extent::Exact, Extent::Reference] {
        let view = View { sh_degree: 0, extent, ..small_view([640, 480]) };
        let gaussians: Vec<Gaussian> = (0..20)
            .map(|i| Gaussian {
                mean: [f64::from(i) * 0.1 - 1.0, 0.0, 0.0],
                quat: [0.9, 0.0, 0.0, 0.1],
                log_scale: [-2.5 + f64::from(i) * 0.1, -2.0, -2.0],
                opacity_logit: 3.0,
                sh: vec![[0.0; 3]],
            })
            .collect();
        let frame = Projected::new(&gpu, &gaussians, &view);
        let splats = frame.splats(&gpu, &view);
        let mut lists = gpu.read::<[u32; 2]>(&frame.tile_lists, splats.len());
        let unlisted: Vec<usize> = (0..lists.len()).filter(|&i| !is_listed(lists[i])).collect();
        assert!(unlisted.len() > 5, "{} without a list", unlisted.len());
        for (k, &i) in unlisted.iter().enumerate() {
            lists[i][0] = if k % 2 == 0 { lists[i][0] + 3 } else { lists[i][0] - 3 };
        }
        let frame = Projected { tile_lists: gpu.buffer("tile_lists", &lists), ..frame };
        let order: Vec<u32> = (0..splats.len() as u32).collect();
        let Expanded { tiles, visible, .. } = expanded(&gpu, &frame, &order, &view);
        let columns = view.tiles()[0];
        for (tile, &gaussian) in tiles.iter().zip(&visible) {
            let allowed = match extent {
                Extent::Exact => touched_at_most(&splats[gaussian as usize], &view),
                Extent::Reference => touched(&splats[gaussian as usize], &view),
            };
            let column_of = |tile: &u32| tile % columns;
            let rows = allowed[0] / columns..=allowed[allowed.len() - 1] / columns;
            let columns_met = allowed.iter().map(column_of).min()..=allowed.iter().map(column_of).max();
            assert!(
                rows.contains(&(tile / columns)) && columns_met.contains(&Some(column_of(tile))),
                "tile {tile} of {gaussian}, which has {allowed:?}"
            );
        }
    }
}
