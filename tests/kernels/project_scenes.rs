//! `forward/project_scenes` against `forward/project` to the bit; the latter has the twin.

use ashsplat::kernels::forward::project_scenes::{Bind, Interface, Push, Spec};

use super::cull_scenes::Batch;
use crate::common::frame::{Projected, state};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::layout::{antialias_word, extent_word, scene_blocks};
use crate::common::scenes::{rotation_about_y, small_view};
use crate::reference::cull::cull;
use crate::reference::types::{Drawn, Extent, Tint, View};

/// Words per visible Gaussian in each output.
const WORDS: [usize; 6] = [4, 4, 4, 1, 4, 2];

/// `too_few`: number of visible Gaussians beyond the capacity.
fn check(gpu: &Gpu, [all, unseen]: [bool; 2], too_few: usize, view: impl Fn(usize) -> View) {
    let block = gpu.workgroup(64) as usize;
    let batch = Batch::new(block, 16, view);
    let settings = batch.scenes[1].1.clone();
    let spec = Spec {
        workgroup_size: block as u32,
        sh_degree: settings.sh_degree,
        filter_3d: settings.filter_3d > 0.0,
        tinted: settings.drawn.tint.is_some(),
        orthographic: settings.drawn.orthographic,
        sh_loops: gpu.limits().tuning.sh_loops,
        may_be_unseen: unseen,
    };
    let count = batch.index_count();
    let mut shown = vec![false; count];
    for ((gaussians, view), first) in batch.scenes.iter().zip(&batch.firsts) {
        shown[*first..first + gaussians.len()].copy_from_slice(&cull(gaussians, view));
        shown[*first..first + gaussians.len()].iter_mut().for_each(|shown| *shown |= all);
    }
    let list: Vec<u32> = (0..count as u32).filter(|&i| shown[i as usize]).collect();
    let before = |index: usize| shown[..index].iter().filter(|shown| **shown).count();
    let offsets: Vec<u32> = (0..count.div_ceil(block)).map(|number| before(number * block) as u32).collect();
    let visible = list.len() - too_few;
    let outputs = WORDS.map(|words| gpu.untouched::<u32>("output", words * (list.len() + 1)));
    let [mean2d_extent, conic_opacity, color_inverse_depth, depth_keys, footprints, tile_lists] = &outputs;
    let bind = Bind {
        parameters: &gpu.buffer("parameters", &batch.parameters),
        block_offsets: &gpu.buffer("block_offsets", &offsets),
        visible_list: &gpu.buffer("visible_list", &list),
        mean2d_extent,
        conic_opacity,
        color_inverse_depth,
        depth_keys,
        footprints,
        tile_lists,
        state: &state(gpu, visible, 0),
        scene_blocks: &gpu.buffer("scene_blocks", &scene_blocks(&batch.table)),
    };
    let [first_block, end_block] = batch.blocks(block);
    let push = Push {
        first_block: first_block as u32,
        end_block: end_block as u32,
        scenes: batch.table.len() as u32,
        batch: 1,
        blocks: offsets.len() as u32,
        extent: extent_word(&settings),
        antialias: antialias_word(&settings),
        splat_stride: 1,
    };
    // More workgroups than blocks, as grids in two dimensions have.
    gpu.dispatch::<Interface>(&spec, &bind, &push, (end_block - first_block) as u64 + 3);
    let mut actual: Vec<Vec<u32>> =
        outputs.iter().zip(WORDS).map(|(output, words)| gpu.read(output, words * (list.len() + 1))).collect();
    let mut compared = 0;
    for (number, (gaussians, view)) in batch.scenes.iter().enumerate().filter(|(n, _)| batch.own[*n]) {
        let alone = match all {
            true => Projected::of_all(gpu, gaussians, view),
            false => Projected::new(gpu, gaussians, view),
        };
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
        check(&gpu, [false; 2], 0, |number| View { sh_degree, ..turned(number) });
    }
    check(&gpu, [false; 2], 150, turned);
    check(&gpu, [true; 2], 0, turned);
}

#[test]
fn project_scenes_equals_its_twin_in_every_variant() {
    let gpu = Gpu::new();
    check(&gpu, [false; 2], 0, |number| View {
        extent: Extent::Reference,
        antialias: true,
        ..turned(number)
    });
    check(&gpu, [false; 2], 0, |number| View { filter_3d: 0.125, ..turned(number) });
    check(&gpu, [false; 2], 0, |number| {
        let tint =
            Some(Tint { color: [0.25, 1.0, 0.125 * number as f64], opacity: 0.5 + 0.03125 * number as f64 });
        View { drawn: Drawn { tint, ..Drawn::AS_THEY_ARE }, ..turned(number) }
    });
    check(&gpu, [false; 2], 0, |number| {
        let drawn = Drawn { orthographic: true, ..Drawn::AS_THEY_ARE };
        View { drawn, focal_px: [13.0, 14.5], ..turned(number) }
    });
}
