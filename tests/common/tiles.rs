//! Tile lists on the device, and their reference in float64.

use ashsplat::vk::Buffer;

use super::gpu::Gpu;
use super::scenes::Random;
use crate::reference::blend::samples;
use crate::reference::pipeline::{pixels_of, tile_of};
use crate::reference::tiles::alpha_unclamped;
use crate::reference::types::{ALPHA_MAX, ALPHA_MIN, Splat, TRANSMITTANCE_MIN, View};

use super::frame::Splats;

/// Splats in tile lists: each tile has its own list of visible indices, front to back.
pub struct Lists {
    pub view: View,
    pub frame: Splats,
    pub lists: Vec<Vec<u32>>,
    pub tile_ranges: Buffer,
    pub sorted_visible: Buffer,
    /// Slot before the tile sort of each sorted instance.
    pub instances: Vec<u32>,
    pub sorted_instances: Buffer,
    pub state: Buffer,
}

impl Lists {
    /// Uploads lists. The instances are a random permutation.
    pub fn new(gpu: &Gpu, splats: Vec<Splat>, lists: Vec<Vec<u32>>, view: &View) -> Lists {
        let mut ranges = Vec::new();
        let mut sorted: Vec<u32> = Vec::new();
        for list in &lists {
            let begin = sorted.len() as u32;
            sorted.extend(list);
            ranges.push(if list.is_empty() { [0, 0] } else { [begin, sorted.len() as u32] });
        }
        let instances = super::frame::shuffled(sorted.len());
        let state = super::frame::state(gpu, splats.len(), sorted.len());
        Lists {
            view: view.clone(),
            frame: Splats::new(gpu, splats),
            lists,
            tile_ranges: gpu.buffer("tile_ranges", &ranges),
            sorted_visible: gpu.buffer("sorted_visible", &sorted),
            sorted_instances: gpu.buffer("sorted_instances", &instances),
            instances,
            state,
        }
    }

    /// `entries` splats per tile, so faint and small that every entry contributes.
    pub fn long(gpu: &Gpu, entries: usize, opacity: [f64; 2], view: &View) -> Lists {
        let mut random = Random::new(entries as u64);
        let tiles = view.tiles();
        let mut splats = Vec::new();
        let mut lists = Vec::new();
        for tile in 0..tiles[0] * tiles[1] {
            let corner = [tile % tiles[0], tile / tiles[0]].map(|t| f64::from(t * 16));
            let first = splats.len() as u32;
            splats.extend((0..entries).map(|_| random_splat(&mut random, corner, opacity)));
            lists.push((first..splats.len() as u32).collect());
        }
        Lists::new(gpu, splats, lists, view)
    }

    /// Same as [`Self::long`], but every list is in order of depth, as in a frame.
    pub fn sorted(gpu: &Gpu, entries: usize, opacity: [f64; 2], view: &View) -> Lists {
        let Lists { frame, mut lists, view, .. } = Lists::long(gpu, entries, opacity, view);
        for list in &mut lists {
            list.sort_by(|&a, &b| frame.splats[a as usize].depth.total_cmp(&frame.splats[b as usize].depth));
        }
        Lists::new(gpu, frame.splats, lists, &view)
    }

    /// The splats of the list of a pixel's tile.
    pub fn list_of(&self, pixel: [u32; 2]) -> Vec<&Splat> {
        self.lists[tile_of(&self.view, pixel)].iter().map(|&i| &self.frame.splats[i as usize]).collect()
    }

    /// Pixels at which float32 rounding may change a decision of the blending: exp is accurate to 17 ulp on
    /// lavapipe, and its argument is rounded too.
    pub fn unstable(&self) -> Vec<bool> {
        pixels_of(&self.view)
            .map(|pixel| {
                let list = self.list_of(pixel);
                is_unstable(&list, pixel, 2e-5)
            })
            .collect()
    }
}

/// A random splat near a tile.
fn random_splat(random: &mut Random, corner: [f64; 2], opacity: [f64; 2]) -> Splat {
    let [xx, yy] = [0; 2].map(|_| random.between(0.5, 60.0));
    let xy = random.between(-0.9, 0.9) * (xx * yy).sqrt();
    let determinant = xx * yy - xy * xy;
    Splat {
        depth: random.between(0.5, 9.0),
        mean2d_px: corner.map(|x| x + random.between(-8.0, 24.0)),
        cov2d: [xx, xy, yy],
        conic: [yy / determinant, -xy / determinant, xx / determinant],
        opacity: random.between(opacity[0], opacity[1]),
        color: [0; 3].map(|_| random.unit()),
        radius_px: 0,
    }
}

/// True if a relative error of α may change a decision at this pixel.
pub fn is_unstable(list: &[&Splat], pixel: [u32; 2], margin: f64) -> bool {
    let near = |x: f64, threshold: f64, margin: f64| (x / threshold - 1.0).abs() < margin;
    let (blended, _) = samples(list, pixel);
    let end = blended.last().map_or(0, |sample| sample.entry + 1);
    let mut transmittance = 1.0;
    let mut decided = blended.iter().peekable();
    for (entry, splat) in list.iter().enumerate() {
        let Some(alpha) = alpha_unclamped(splat, pixel) else { continue };
        if near(alpha, ALPHA_MIN, margin) || near(alpha, ALPHA_MAX, margin) {
            return true;
        }
        if alpha >= ALPHA_MIN {
            let next = transmittance * (1.0 - alpha.min(ALPHA_MAX));
            if near(next, TRANSMITTANCE_MIN, 10.0 * margin) {
                return true;
            }
        }
        if decided.peek().is_some_and(|sample| sample.entry == entry) {
            let sample = decided.next().expect("peeked");
            transmittance = sample.transmittance * (1.0 - sample.alpha);
        } else if entry > end && alpha >= ALPHA_MIN {
            break;
        }
    }
    false
}
