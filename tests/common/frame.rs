//! Splats of a random scene as the kernels behind the projection find them.

use ashsplat::kernels::constants::{STATE_INSTANCES, STATE_VISIBLE, STATE_WORDS};
use ashsplat::vk::Buffer;

use super::gpu::Gpu;
use super::layout::{SplatPlanes, pack_splats, rounded};
use super::scenes::{Random, mixed_scene};
use crate::reference::project::project;
use crate::reference::tiles::{exact_box, reference_square, touched};
use crate::reference::types::{ALPHA_MIN, Extent, Splat, View};

/// Visible splats, in the precision that the kernels see, and on the device.
pub struct Splats {
    pub splats: Vec<Splat>,
    pub mean2d_extent: Buffer,
    pub conic_opacity: Buffer,
    pub color_inverse_depth: Buffer,
    pub footprints: Buffer,
}

impl Splats {
    /// About `count` visible splats of a random scene.
    pub fn random(gpu: &Gpu, count: usize, view: &View) -> Splats {
        let mut random = Random::new(count as u64);
        let mut splats = Vec::new();
        while splats.len() < count {
            let scene = mixed_scene(&mut random, 4 * count, 1);
            splats.extend(scene.iter().filter_map(|gaussian| project(gaussian, view)));
        }
        splats.truncate(count);
        Splats::new(gpu, splats, view)
    }

    /// Uploads splats.
    pub fn new(gpu: &Gpu, splats: Vec<Splat>, view: &View) -> Splats {
        let SplatPlanes { mean2d_extent, conic_opacity, color_inverse_depth } = pack_splats(&splats);
        let footprints: Vec<[u32; 4]> = splats
            .iter()
            .map(|splat| {
                let [x0, y0, x1, y1] = match view.extent {
                    Extent::Exact => exact_box(&widened(splat), view),
                    Extent::Reference => reference_square(splat, view),
                };
                [x0 | x1 << 16, y0 | y1 << 16, splat.radius_px as u32, 0]
            })
            .collect();
        Splats {
            mean2d_extent: gpu.buffer("mean2d_extent", &mean2d_extent),
            conic_opacity: gpu.buffer("conic_opacity", &conic_opacity),
            color_inverse_depth: gpu.buffer("color_inverse_depth", &color_inverse_depth),
            footprints: gpu.buffer("footprints", &footprints),
            splats: rounded(&splats),
        }
    }
}

/// A splat that reaches as far as the margins of the projection do.
pub fn widened(splat: &Splat) -> Splat {
    let opacity = splat.opacity.max(ALPHA_MIN) * 1.005;
    Splat {
        opacity,
        cov2d: splat.cov2d.map(|c| c * 1.001),
        conic: splat.conic.map(|c| c / 1.001),
        ..splat.clone()
    }
}

/// All the tiles that a splat may be listed in: where it reaches with the margins of the projection, up to a tenth of
/// a pixel away.
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

/// Frame state with these counts.
pub fn state(gpu: &Gpu, visible: usize, instances: usize) -> Buffer {
    let mut words = vec![0; STATE_WORDS as usize];
    words[STATE_VISIBLE as usize] = visible as u32;
    words[STATE_INSTANCES as usize] = instances as u32;
    gpu.buffer("state", &words)
}

/// A permutation, as a depth sort would give.
pub fn shuffled(count: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count as u32).collect();
    let mut random = Random::new(count as u64);
    for last in (1..count).rev() {
        order.swap(last, random.below(last as u32 + 1) as usize);
    }
    order
}
