//! The kernels of `forward/` that list visible Gaussians and tiles, against their twins: `forward/compact`, `forward/count`,
//! `forward/duplicate_with_tiles`, `forward/ranges` and `backward/hide_tiles`.

use crate::common::frame::{Projected, shuffled, state, touched_at_most, visible_scene};
use crate::common::prelude::*;
use crate::reference::lists::{self as twin, LISTED, is_listed, tiles_met};
use crate::reference::scan::{scan_apply, scan_reduce, scan_spine};
use crate::reference::tiles::{touched, touches_by_pixels};
use ashsplat::kernels::backward::hide_tiles;
use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants::STATE_FIRST_SCENE_VISIBLE;
use ashsplat::kernels::forward::{compact, count, duplicate_with_tiles, ranges};
use ashsplat::passes::loss::{NativeLayout, photo_on_device};
use std::ops::Range;

#[test]
pub fn compact_equals_its_twin() {
    let gpu = Gpu::new();
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = compact::Spec { workgroup_size, subgroup_size, block: workgroup_size };
    let block = spec.block as usize;
    // One in `share` is flagged: all, some, hardly any.
    for (size, share) in sizes(block).into_iter().flat_map(|n| [(n, 1), (n, 3), (n, 500)]) {
        let mut random = Random::new(size as u64);
        let flags: Vec<bool> = (0..size).map(|_| random.below(share) == 0).collect();
        let words: Vec<u32> = flags.iter().map(|&flag| u32::from(flag)).collect();
        let mut offsets = scan_reduce(&words, block);
        let total = scan_spine(&mut offsets) as usize;
        // Capacity for all, and for half.
        for capacity in [total, total / 2] {
            let list = gpu.untouched::<u32>("visible_list", total + 2);
            let places = gpu.untouched::<u32>("visible_index", size + 2);
            let bind = compact::Bind {
                visible_flags: &gpu.buffer("visible_flags", &words),
                block_offsets: &gpu.buffer("block_offsets", &offsets),
                visible_list: &list,
                visible_index: &places,
                state: &state(&gpu, [total, capacity, 0]),
                visible_ranges: &gpu.untouched::<[u32; 4]>("visible_ranges", 2),
                scene_blocks: &gpu.buffer("scene_blocks", &scene_blocks(&[CameraBlock::default()])),
            };
            let [count, capacity] = [size as u32, capacity as u32];
            let push = compact::Push { count, capacity, scenes: 0, max_workgroups_per_axis: 7 };
            gpu.dispatch::<compact::Interface>(&spec, &bind, &push, size.div_ceil(block) as u64 + 1);
            let (expected_list, expected_places) = twin::compact(&flags, capacity as usize);
            gpu.assert_values(&list, &expected_list, &format!("size {size} of {capacity}"));
            gpu.assert_values(&places, &expected_places, &format!("size {size} of {capacity}"));
        }
    }
}

/// Gaussians of a culling block.
const BLOCK: u32 = 64;

/// A frame of `blocks` blocks; each scene has its own blocks and a number of blocks per range.
fn check_visible_ranges(gpu: &Gpu, blocks: usize, scenes: &[(Range<usize>, usize)], max: u32) {
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = compact::Spec { workgroup_size, subgroup_size, block: BLOCK };
    let mut random = Random::new(blocks as u64);
    let mut offsets: Vec<u32> = (0..blocks).map(|_| random.below(max)).collect();
    let visible = scan_spine(&mut offsets);
    let table = scenes.iter().map(|(own, blocks_per_range)| CameraBlock {
        scene_first: own.start as u32 * BLOCK,
        // The last block need not be full.
        scene_count: (own.len() as u32 * BLOCK).saturating_sub(random.below(BLOCK)),
        scene_chunk_gaussians: *blocks_per_range as u32 * BLOCK,
        ..CameraBlock::default()
    });
    let table = scene_blocks(&table.collect::<Vec<_>>());
    let state = state(gpu, [visible as usize, visible as usize, 0]);
    let visible_ranges = gpu.untouched::<[u32; 4]>("visible_ranges", 2 * blocks + 1);
    let count = blocks as u32 * BLOCK;
    let bind = compact::Bind {
        visible_flags: &gpu.buffer("visible_flags", &vec![0; count as usize]),
        block_offsets: &gpu.buffer("block_offsets", &offsets),
        visible_list: &gpu.untouched::<u32>("visible_list", 1),
        visible_index: &gpu.untouched::<u32>("visible_index", count as usize),
        state: &state,
        visible_ranges: &visible_ranges,
        scene_blocks: &gpu.buffer("scene_blocks", &table),
    };
    let push = compact::Push { count, capacity: 0, scenes: scenes.len() as u32, max_workgroups_per_axis: 7 };
    gpu.dispatch_over::<compact::Interface>(&spec, &bind, &push, scenes.len());
    let (first_scene, blocks_per_range) = &scenes[0];
    let last = twin::visible_ranges(&offsets, visible, first_scene.clone(), *blocks_per_range).pop();
    let first_scene_visible = gpu.read_state(&state, STATE_FIRST_SCENE_VISIBLE);
    assert_eq!(first_scene_visible, last.map_or(0, |[_, end]| end), "{first_scene:?}");
    let mut actual = gpu.read::<[u32; 4]>(&visible_ranges, 2 * blocks + 1);
    for (own, blocks_per_range) in scenes {
        let expected = twin::visible_ranges(&offsets, visible, own.clone(), *blocks_per_range);
        for (range, &[begin, end]) in expected.iter().enumerate() {
            let what = format!("range {range} of blocks {own:?} of {blocks}, {blocks_per_range} each");
            let block = own.start + range * blocks_per_range;
            assert_eq!(actual[2 * block][..3], twin::workgroups(end - begin, BLOCK, 7), "{what}");
            assert_eq!(actual[2 * block + 1], [begin, end, 0, 0], "{what}");
            actual[2 * block] = [UNTOUCHED; 4];
            actual[2 * block + 1] = [UNTOUCHED; 4];
        }
    }
    assert!(actual.iter().all(|words| *words == [UNTOUCHED; 4]), "more was written");
}

#[test]
fn compact_writes_the_ranges_of_all_scenes() {
    let gpu = Gpu::new();
    // One scene, alone and among others.
    let alone =
        [(1, 0..1, 1), (1, 0..1, 5), (5, 0..5, 5), (6, 0..6, 5), (300, 0..300, 3), (1000, 0..1000, 1)];
    let one_of_some = [(20, 3..9, 4), (20, 7..20, 4), (20, 0..8, 4)];
    for max in [1, 300] {
        for (blocks, own, blocks_per_range) in alone.iter().chain(&one_of_some).cloned() {
            check_visible_ranges(&gpu, blocks, &[(own, blocks_per_range)], max);
        }
        // Scenes that are not drawn: between two others, and behind all.
        check_visible_ranges(&gpu, 20, &[(0..5, 2), (5..5, 1), (5..6, 3), (6..20, 4), (20..20, 1)], max);
        let many: Vec<_> = (0..200).map(|scene| (2 * scene..2 * scene + 2, 1 + scene % 3)).collect();
        check_visible_ranges(&gpu, 400, &many, max);
    }
}

#[test]
pub fn count_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = count::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items: 4 };
    let block = (spec.workgroup_size * spec.items) as usize;
    for size in sizes(block) {
        let mut random = Random::new(size as u64);
        let lists: Vec<[u32; 2]> = (0..size)
            .map(|_| match random.below(2) {
                0 => [random.below(5000), 0],
                _ => [LISTED | random.below(32) << 26 | random.below(1 << 26), random.below(u32::MAX)],
            })
            .collect();
        let order = shuffled(size);
        let (counts, [heads, rows]) = in_order(&order, &lists);
        let sums = scan_reduce(&counts, block);
        let before = scan_apply(&counts, &vec![0; sums.len()], block);
        let [block_instances, list_heads, list_rows] =
            ["block_instances", "list_heads", "list_rows"].map(|name| gpu.untouched::<u32>(name, size + 2));
        let block_sums = gpu.untouched::<u32>("block_sums", sums.len() + 1);
        let bind = count::Bind {
            state: &state(&gpu, [size, size, 0]),
            order: &gpu.buffer("order", &order),
            tile_lists: &gpu.buffer("tile_lists", &lists),
            list_heads: &list_heads,
            list_rows: &list_rows,
            block_instances: &block_instances,
            block_sums: &block_sums,
        };
        let push = count::Push::default();
        gpu.dispatch::<count::Interface>(&spec, &bind, &push, (size / block) as u64 + 1);
        for (buffer, expected) in
            [(block_instances, before), (list_heads, heads), (list_rows, rows), (block_sums, sums)]
        {
            gpu.assert_values(&buffer, &expected, &format!("size {size}"));
        }
    }
}

/// Numbers of tiles, and first and second words of lists, in this order.
fn in_order(order: &[u32], lists: &[[u32; 2]]) -> (Vec<u32>, [Vec<u32>; 2]) {
    let lists: Vec<[u32; 2]> = order.iter().map(|&visible| lists[visible as usize]).collect();
    let words = [0, 1].map(|word| lists.iter().map(|list| list[word]).collect());
    (lists.into_iter().map(tiles_met).collect(), words)
}

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
    let spec = duplicate_with_tiles::Spec {
        workgroup_size,
        subgroup_size,
        items: 4,
        for_backward: true,
        lenses: false,
        scan_block: 32,
    };
    let lists = gpu.read::<[u32; 2]>(&frame.tile_lists, frame.expected.len());
    let (counts, [heads, rows]) = in_order(order, &lists);
    let mut offsets = scan_reduce(&counts, 32);
    let before = scan_apply(&counts, &vec![0; offsets.len()], 32);
    let instances = scan_spine(&mut offsets) as usize;
    let [tiles, visible] =
        ["instance_tiles", "instance_visible"].map(|name| gpu.untouched::<u32>(name, instances + 2));
    let first_instances = gpu.untouched::<u32>("first_instances", size);
    let bind = duplicate_with_tiles::Bind {
        state: &state(gpu, [size, size, instances]),
        order: &gpu.buffer("order", order),
        block_instances: &gpu.buffer("block_instances", &before),
        block_offsets: &gpu.buffer("block_offsets", &offsets),
        mean2d_extent: &frame.mean2d_extent,
        footprints: &frame.footprints,
        list_heads: &gpu.buffer("list_heads", &heads),
        list_rows: &gpu.buffer("list_rows", &rows),
        instance_tiles: &tiles,
        instance_visible: &visible,
        first_instances: &first_instances,
    };
    let [tiles_per_row, tile_rows] = view.tiles();
    let push = duplicate_with_tiles::Push {
        extent: extent_word(view),
        tiles_per_row,
        tile_rows,
        splat_stride: 1,
        image_width: 0,
        whole_width: 0,
    };
    let block = u64::from(workgroup_size * spec.items);
    gpu.dispatch::<duplicate_with_tiles::Interface>(&spec, &bind, &push, instances as u64 / block + 1);
    let [tiles, visible] = [tiles, visible].map(|buffer| {
        let mut own = gpu.read::<u32>(&buffer, instances + 2);
        assert_eq!(own.split_off(instances), [UNTOUCHED; 2], "{}", buffer.name());
        own
    });
    Expanded { counts, tiles, visible, first_instances: gpu.read(&first_instances, size) }
}

/// Tiles that may list a splat.
fn allowed(splat: &Splat, view: &View) -> Vec<u32> {
    match view.extent {
        Extent::Exact => touched_at_most(splat, view),
        Extent::Reference => touched(splat, view),
    }
}

fn check_expanded(gpu: &Gpu, gaussians: &[Gaussian], view: &View) {
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
        let allowed = allowed(splat, view);
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
pub fn duplicate_with_tiles_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, extent) in sizes(64).into_iter().flat_map(|n| [(n, Extent::Exact), (n, Extent::Reference)]) {
        let view = View { sh_degree: 0, extent, ..small_view([150, 90]) };
        check_expanded(&gpu, &visible_scene(size, &view), &view);
    }
}

/// Long thin ellipses in all directions, for which boxes and ellipses differ most.
#[test]
pub fn duplicate_with_tiles_of_needles() {
    let gpu = Gpu::new();
    let view = View { sh_degree: 0, ..small_view([400, 300]) };
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
    let frame = Projected::new(&gpu, &needles, &view);
    let lists = gpu.read::<[u32; 2]>(&frame.tile_lists, frame.expected.len());
    // Splats with and without a tile list side by side.
    let listed = lists.iter().filter(|&&list| is_listed(list)).count();
    assert!((50..lists.len() - 50).contains(&listed), "{listed} of {} are listed", lists.len());
    check_expanded(&gpu, &needles, &view);
}

/// An opaque Gaussian on the x axis, turned about z.
fn on_the_axis(x: f64, log_scale: [f64; 3], turn: f64) -> Gaussian {
    let (mean, quat) = ([x, 0.0, 0.0], [1.0 - turn, 0.0, 0.0, turn]);
    Gaussian { mean, quat, log_scale, opacity_logit: 3.0, sh: vec![[0.0; 3]] }
}

/// Many Gaussians without a tile between others, and one with more tiles than a run has instances.
#[test]
pub fn duplicate_with_tiles_of_many_without_tiles() {
    let gpu = Gpu::new();
    let view = View { sh_degree: 0, ..small_view([640, 480]) };
    let gaussians: Vec<Gaussian> = (0..900)
        .map(|i| on_the_axis(f64::from(i % 30) * 0.05, [if i == 450 { 2.0 } else { -9.0 }; 3], 0.0))
        .collect();
    let frame = Projected::new(&gpu, &gaussians, &view);
    // Most lists become empty, as if the ellipses met no tile of their boxes.
    let mut lists = gpu.read::<[u32; 2]>(&frame.tile_lists, gaussians.len());
    for (i, list) in lists.iter_mut().enumerate().filter(|(i, _)| i % 300 != 150) {
        // An empty list, or a count of 0 without a list.
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
pub fn duplicate_with_tiles_of_other_counts_stays_in_the_box() {
    let gpu = Gpu::new();
    for extent in [Extent::Exact, Extent::Reference] {
        let view = View { sh_degree: 0, extent, ..small_view([640, 480]) };
        let gaussians: Vec<Gaussian> = (0..20)
            .map(|i| on_the_axis(f64::from(i) * 0.1 - 1.0, [-2.5 + f64::from(i) * 0.1, -2.0, -2.0], 0.1))
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
            let allowed = allowed(&splats[gaussian as usize], &view);
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

#[test]
fn ranges_equal_their_twin() {
    let gpu = Gpu::new();
    let block = gpu.workgroup(64) as usize;
    // All in one tile, a few per tile, most tiles empty.
    for (size, tile_count) in sizes(block).into_iter().flat_map(|n| [(n, 1), (n, 20), (n, 5000)]) {
        let mut random = Random::new(size as u64);
        let mut tiles: Vec<u32> = (0..size).map(|_| random.below(tile_count)).collect();
        tiles.sort_unstable();
        let instances = shuffled(size);
        let visible: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        let sorted_visible = gpu.untouched::<u32>("sorted_visible", size + 2);
        for for_backward in [true, false] {
            let tile_ranges = gpu.zeros::<[u32; 2]>("tile_ranges", tile_count as usize);
            let bind = ranges::Bind {
                state: &state(&gpu, [0, 0, size]),
                sorted_tiles: &gpu.buffer("sorted_tiles", &tiles),
                sorted_instances: &gpu.buffer("sorted_instances", &instances),
                instance_visible: &gpu.buffer("instance_visible", &visible),
                tile_ranges: &tile_ranges,
                sorted_visible: &sorted_visible,
            };
            let spec = ranges::Spec { workgroup_size: gpu.workgroup(64), for_backward };
            gpu.dispatch_over::<ranges::Interface>(&spec, &bind, &ranges::Push::default(), size);
            let expected = twin::ranges(&tiles, tile_count);
            assert_eq!(gpu.read::<[u32; 2]>(&tile_ranges, tile_count as usize), expected, "size {size}");
        }
        let expected: Vec<u32> = instances.iter().map(|&instance| visible[instance as usize]).collect();
        gpu.assert_values(&sorted_visible, &expected, &format!("size {size}"));
    }
}

/// Tiles in which no pixel counts lose their instances.
#[test]
fn hide_tiles_empties_what_a_mask_hides() {
    let gpu = Gpu::new();
    let [width, height] = [70, 35];
    // The last pixel of some tiles counts, at their corner or at the picture's border; others are hidden.
    let shown = |x: u32, y: u32| {
        (x / 16 + y / 16).is_multiple_of(3)
            && (x % 16 == 15 || x == width - 1)
            && (y % 16 == 15 || y == height - 1)
    };
    let texels = (0..height).flat_map(|y| (0..width).map(move |x| [9, 9, 9, u8::from(shown(x, y))]));
    let texels = texels.collect::<Vec<_>>().into_flattened();
    let [columns, rows] = [5, 3];
    // Tiles have 0, 8, 16 or 24 instances.
    let mut ranges: Vec<[u32; 2]> =
        (0..columns * rows).map(|tile| [tile * 26, tile * 26 + tile % 4 * 8]).collect();
    ranges[4] = [0, 0];
    for strips in [false, true] {
        let layout = if strips { NativeLayout::Strips } else { NativeLayout::Rows };
        let photo = photo_on_device(layout, width, height, true, texels.clone());
        let tile_ranges = gpu.buffer("tile_ranges", &ranges);
        let bind = hide_tiles::Bind { photo: &gpu.buffer("photo", &photo), tile_ranges: &tile_ranges };
        let (workgroup_size, subgroup_size) = (gpu.subgroup(), gpu.subgroup());
        let spec = hide_tiles::Spec { workgroup_size, subgroup_size, strips };
        let (image_width, image_height, tile_count) = (width, height, columns * rows);
        let push = hide_tiles::Push { image_width, image_height, tiles_per_row: columns, tile_count };
        gpu.dispatch::<hide_tiles::Interface>(&spec, &bind, &push, u64::from(tile_count) + 1);
        let mut left = ranges.clone();
        for (tile, [begin, end]) in ranges.iter().copied().enumerate() {
            if !(tile % 5 + tile / 5).is_multiple_of(3) && begin < end {
                left[tile] = [0, 0];
            }
        }
        assert_ne!(left, ranges);
        assert_eq!(gpu.read::<[u32; 2]>(&tile_ranges, ranges.len()), left);
    }
}
