//! `forward/cull_scenes` against `forward/cull` to the bit, and against its twin.

use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants::NO_BATCH;
use ashsplat::kernels::forward::cull_scenes::{Bind, Interface, Push, Spec};

use super::cull::{culled, may_differ};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::layout::{
    antialias_word, camera_block, cut_outs, extent_word, pack_filtered, room, scene_blocks,
};
use crate::common::scenes::{Random, mixed_scene, rotation_about_y, small_view};
use crate::reference::cull::cull;
use crate::reference::types::{CutOut, Drawn, Extent, Gaussian, Tint, View};

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

fn check(gpu: &Gpu, adds: bool, view: impl Fn(usize) -> View) {
    let block = gpu.workgroup(64) as usize;
    let mut batch = Batch::new(block, 1, view);
    let (mut volumes, settings) = (Vec::new(), batch.scenes[1].1.clone());
    for (block, (_, view)) in batch.table.iter_mut().zip(&batch.scenes) {
        let (words, [skipped, count]) = cut_outs(view);
        block.scene_first_cut_out = volumes.len() as u32 / 4 + skipped;
        block.scene_cut_outs = count;
        volumes.extend(words);
    }
    let spec = Spec {
        workgroup_size: block as u32,
        subgroup_size: gpu.subgroup(),
        filter_3d: settings.filter_3d > 0.0,
        tinted: settings.drawn.tint.is_some(),
        cut_outs: settings.drawn.cut_outs.iter().flatten().count() > 0,
        orthographic: settings.drawn.orthographic,
        adds,
    };
    let count = batch.index_count();
    let blocks = count.div_ceil(block);
    // An earlier view shows every third Gaussian.
    let seen = |i: usize| if adds && i < count { u32::from(i.is_multiple_of(3)) } else { UNTOUCHED };
    let before: Vec<u32> = (0..count + 2).map(seen).collect();
    let flags = gpu.buffer("visible_flags", &before);
    let counts = gpu.untouched::<u32>("block_counts", blocks + 2);
    let bind = Bind {
        parameters: &gpu.buffer("parameters", &batch.parameters),
        visible_flags: &flags,
        block_counts: &counts,
        cut_outs: &gpu.buffer("cut_outs", &volumes),
        scene_blocks: &gpu.buffer("scene_blocks", &scene_blocks(&batch.table)),
    };
    let [first_block, end_block] = batch.blocks(block);
    let push = Push {
        first_block: first_block as u32,
        end_block: end_block as u32,
        scenes: batch.table.len() as u32,
        batch: 1,
        index_count: count as u32,
        extent: extent_word(&settings),
        antialias: antialias_word(&settings),
    };
    // More workgroups than blocks, as grids in two dimensions have.
    gpu.dispatch::<Interface>(&spec, &bind, &push, (end_block - first_block) as u64 + 3);
    let mut flags = gpu.read::<u32>(&flags, count + 2);
    let mut counts = gpu.read::<u32>(&counts, blocks + 2);
    for (number, (gaussians, view)) in batch.scenes.iter().enumerate().filter(|(n, _)| batch.own[*n]) {
        let (first, size) = (batch.firsts[number], gaussians.len());
        let parameters = gpu.buffer("parameters", &pack_filtered(gaussians, room(size), view.filter_3d));
        let mut alone = culled(gpu, view, &parameters, size)[0].clone();
        let expected = cull(gaussians, view);
        let differ = |&i: &usize| alone[i] != u32::from(expected[i]) && !may_differ(&gaussians[i], view);
        assert_eq!((0..size).find(differ), None, "scene {number}");
        if adds {
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
    check(&gpu, false, turned);
    check(&gpu, true, turned);
    check(&gpu, false, |number| View { extent: Extent::Reference, antialias: true, ..turned(number) });
}

#[test]
fn cull_scenes_equals_its_twin_in_every_variant() {
    let gpu = Gpu::new();
    let drawn = |number: usize, drawn| View { drawn, ..turned(number) };
    check(&gpu, false, |number| {
        let opacity = 0.125 * (1 + number % 8) as f64;
        drawn(number, Drawn { tint: Some(Tint { color: [1.0; 3], opacity }), ..Drawn::AS_THEY_ARE })
    });
    check(&gpu, false, |number| {
        let view = drawn(number, Drawn { orthographic: true, ..Drawn::AS_THEY_ARE });
        View { focal_px: [13.0, 14.5], ..view }
    });
    check(&gpu, false, |number| View { filter_3d: 0.125, ..turned(number) });
    check(&gpu, false, |number| {
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
