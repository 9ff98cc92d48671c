//! Splats of a random scene as inputs of the kernels that follow the projection.

use ashsplat::kernels::constants::{STATE_FIRST_SCENE_VISIBLE, STATE_INSTANCES, STATE_VISIBLE, STATE_WORDS};
use ashsplat::kernels::forward::project;
use ashsplat::vk::Buffer;

use super::gpu::{Gpu, UNTOUCHED};
use super::layout::{
    SplatPlanes, antialias_word, camera_block, extent_word, pack_filtered, pack_splats, room, rounded,
};
use super::scenes::{Random, mixed_scene};
use crate::reference::project as twin;
use crate::reference::tiles::{touched, touches_by_pixels};
use crate::reference::types::{ALPHA_MIN, Extent, Gaussian, Selection, Splat, View};

/// Visible splats: on the host with the blending's precision, and on the device.
pub struct Splats {
    pub splats: Vec<Splat>,
    pub mean2d_extent: Buffer,
    pub conic_opacity: Buffer,
    pub color_inverse_depth: Buffer,
}

impl Splats {
    pub fn new(gpu: &Gpu, splats: Vec<Splat>) -> Splats {
        let SplatPlanes { mean2d_extent, conic_opacity, color_inverse_depth } = pack_splats(&splats);
        Splats {
            mean2d_extent: gpu.buffer("mean2d_extent", &mean2d_extent),
            conic_opacity: gpu.buffer("conic_opacity", &conic_opacity),
            color_inverse_depth: gpu.buffer("color_inverse_depth", &color_inverse_depth),
            splats: rounded(&splats),
        }
    }
}

/// Output of `forward/project` for the visible Gaussians of a scene.
pub struct Projected {
    /// The twin's splats.
    pub expected: Vec<Splat>,
    pub mean2d_extent: Buffer,
    pub conic_opacity: Buffer,
    pub color_inverse_depth: Buffer,
    pub depth_keys: Buffer,
    pub footprints: Buffer,
    pub tile_lists: Buffer,
}

impl Projected {
    /// Projects a scene. Each output has one row more than there are visible Gaussians.
    pub fn new(gpu: &Gpu, gaussians: &[Gaussian], view: &View) -> Projected {
        Self::of(gpu, gaussians, view, false)
    }

    /// Same as [`Self::new`], but all Gaussians are listed as visible. `expected` has only those that are.
    pub fn of_all(gpu: &Gpu, gaussians: &[Gaussian], view: &View) -> Projected {
        Self::of(gpu, gaussians, view, true)
    }

    fn of(gpu: &Gpu, gaussians: &[Gaussian], view: &View, may_be_unseen: bool) -> Projected {
        // The view's degree may be lower than the stored one.
        let (sh_degree, filter_3d) = (view.sh_degree, view.filter_3d > 0.0);
        let (dropout, z_record, tinted) =
            (view.drawn.dropout.is_some(), view.drawn.z_record, view.drawn.tint.is_some());
        let workgroup_size = gpu.workgroup(64);
        let spec = project::Spec {
            workgroup_size,
            sh_degree,
            filter_3d,
            dropout,
            tinted,
            selection: view.drawn.selection.is_some(),
            z_record,
            orthographic: view.drawn.orthographic,
            sh_loops: gpu.limits().tuning.sh_loops,
            may_be_unseen,
        };
        let splat = |(i, gaussian): (usize, &Gaussian)| {
            let splat = twin::project(gaussian, view)?;
            Some(Splat { color: view.drawn.highlighted(i, splat.color), ..splat })
        };
        let splats: Vec<Option<Splat>> = gaussians.iter().enumerate().map(splat).collect();
        // The range begins with a later Gaussian of its scene.
        let first_of_scene = 37;
        let mut mask = vec![0; (gaussians.len() + first_of_scene).div_ceil(32).max(1)];
        for i in (0..gaussians.len()).filter(|&i| Selection::selects(i)) {
            mask[(first_of_scene + i) / 32] |= 1u32 << ((first_of_scene + i) % 32);
        }
        // Culling applies the dropout.
        let visible: Vec<u32> =
            (0..gaussians.len() as u32).filter(|&i| may_be_unseen || splats[i as usize].is_some()).collect();
        let (room, count) = (room(gaussians.len()), visible.len());
        let parameters = gpu.buffer("parameters", &pack_filtered(gaussians, room, view.filter_3d));
        // Two entries at the front belong to another range.
        let list = gpu.buffer("visible_list", &[&[UNTOUCHED; 2], visible.as_slice()].concat());
        let ranges = gpu.buffer("visible_ranges", &[[0; 4], [2, 2 + count as u32, 0, 0]]);
        let [mean2d_extent, conic_opacity, color_inverse_depth, footprints] =
            ["mean2d_extent", "conic_opacity", "color_inverse_depth", "footprints"]
                .map(|name| gpu.untouched::<[u32; 4]>(name, count + 3));
        let depth_keys = gpu.untouched::<u32>("depth_keys", count + 3);
        let tile_lists = gpu.untouched::<[u32; 2]>("tile_lists", count + 3);
        let bind = project::Bind {
            parameters: &parameters,
            visible_ranges: &ranges,
            visible_list: &list,
            mean2d_extent: &mean2d_extent,
            conic_opacity: &conic_opacity,
            color_inverse_depth: &color_inverse_depth,
            depth_keys: &depth_keys,
            footprints: &footprints,
            tile_lists: &tile_lists,
            selection: &gpu.buffer("selection", &mask),
            camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
        };
        let push = project::Push {
            first: 0,
            chunk_gaussians: room as u32,
            extent: extent_word(view),
            antialias: antialias_word(view),
            splat_stride: 1,
            first_of_scene: first_of_scene as u32,
        };
        let workgroups = count as u64 / u64::from(spec.workgroup_size) + 1;
        gpu.dispatch::<project::Interface>(&spec, &bind, &push, workgroups);
        let behind = |buffer: Buffer, bytes: u64| {
            let words = gpu.read::<u32>(&buffer, buffer.bytes() as usize / 4);
            let own = 2 * bytes as usize / 4..(2 + count) * bytes as usize / 4;
            let others = words[..own.start].iter().chain(&words[own.end..]);
            assert!(others.copied().all(|word| word == UNTOUCHED), "{} outside the range", buffer.name());
            // A buffer of its own, because devices align ranges to up to 256 bytes.
            gpu.buffer("own", &words[own.start..])
        };
        Projected {
            expected: splats.into_iter().flatten().collect(),
            mean2d_extent: behind(mean2d_extent, 16),
            conic_opacity: behind(conic_opacity, 16),
            color_inverse_depth: behind(color_inverse_depth, 16),
            depth_keys: behind(depth_keys, 4),
            footprints: behind(footprints, 16),
            tile_lists: behind(tile_lists, 8),
        }
    }

    /// Splats as the kernels after the projection read them: mean, conic, opacity and radius.
    pub fn splats(&self, gpu: &Gpu, view: &View) -> Vec<Splat> {
        let count = self.expected.len();
        let means = gpu.read::<[f32; 4]>(&self.mean2d_extent, count);
        let conics = gpu.read::<[f32; 4]>(&self.conic_opacity, count);
        let footprints = gpu.read::<[u32; 4]>(&self.footprints, count);
        let seen = |(place, splat): (usize, &Splat)| {
            let [x, y, _, _] = means[place].map(f64::from);
            let [a, b, c, opacity] = conics[place].map(f64::from);
            let radius_px = if view.extent == Extent::Reference { footprints[place][2] as i32 } else { 0 };
            Splat { mean2d_px: [x, y], conic: [a, b, c], opacity, radius_px, ..splat.clone() }
        };
        self.expected.iter().enumerate().map(seen).collect()
    }
}

/// About `count` visible Gaussians of a random scene.
pub fn visible_scene(count: usize, view: &View) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    let mut gaussians = Vec::new();
    while gaussians.len() < count {
        let scene = mixed_scene(&mut random, 4 * count, 1);
        gaussians.extend(scene.into_iter().filter(|gaussian| twin::project(gaussian, view).is_some()));
    }
    gaussians.truncate(count);
    gaussians
}

/// Fewest and most tiles that may be counted for a splat: those with a pixel of α ≥ 1/255, and those that a slightly
/// larger ellipse meets.
pub fn tile_bounds(splat: &Splat, view: &View) -> (u32, u32) {
    if view.extent == Extent::Reference {
        let exactly = touched(splat, view).len() as u32;
        return (exactly, exactly);
    }
    let most = touched_at_most(splat, view).len() as u32;
    let [columns, rows] = view.tiles();
    let tiles = (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y]));
    // Rounding decides about pixels at the threshold.
    let surely = Splat { opacity: splat.opacity * (1.0 - 1e-5), ..splat.clone() };
    (tiles.filter(|tile| touches_by_pixels(&surely, *tile)).count() as u32, most)
}

/// A splat enlarged by the projection's margins.
pub fn widened(splat: &Splat) -> Splat {
    let opacity = splat.opacity.max(ALPHA_MIN) * 1.005;
    Splat {
        opacity,
        cov2d: splat.cov2d.map(|c| c * 1.001),
        conic: splat.conic.map(|c| c / 1.001),
        ..splat.clone()
    }
}

/// All tiles whose lists may contain a splat, with the projection's margins and up to a tenth of a pixel of
/// displacement.
pub fn touched_at_most(splat: &Splat, view: &View) -> Vec<u32> {
    let mut tiles = Vec::new();
    for (dx, dy) in [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)] {
        let [x, y] = splat.mean2d_px;
        tiles.extend(touched(&Splat { mean2d_px: [x + dx, y + dy], ..widened(splat) }, view));
    }
    tiles.sort_unstable();
    tiles.dedup();
    tiles
}

/// Frame state of one scene with these counts.
pub fn state(gpu: &Gpu, visible: usize, instances: usize) -> Buffer {
    state_of_scenes(gpu, visible, visible, instances)
}

/// Frame state of several scenes. The first scene has `first_scene` of the visible Gaussians.
pub fn state_of_scenes(gpu: &Gpu, first_scene: usize, visible: usize, instances: usize) -> Buffer {
    let mut words = vec![0; STATE_WORDS as usize];
    words[STATE_VISIBLE as usize] = visible as u32;
    words[STATE_FIRST_SCENE_VISIBLE as usize] = first_scene as u32;
    words[STATE_INSTANCES as usize] = instances as u32;
    gpu.buffer("state", &words)
}

/// A random permutation, in place of a depth sort.
pub fn shuffled(count: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count as u32).collect();
    let mut random = Random::new(count as u64);
    for last in (1..count).rev() {
        order.swap(last, random.below(last as u32 + 1) as usize);
    }
    order
}
