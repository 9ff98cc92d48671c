//! One instance per (Gaussian, tile touched), in the order of the Gaussians, the twin of `forward/duplicate_with_tiles`.

use super::tiles;
use super::types::{Splat, View};

/// A pair of tile and Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instance {
    /// Tile index, row-major.
    pub tile: u32,
    /// Bits of the float32 depth: positive, hence ordered as unsigned integers.
    pub depth_bits: u32,
    /// Gaussian.
    pub gaussian: u32,
}

/// Lists the instances.
pub fn expand(splats: &[Option<Splat>], view: &View) -> Vec<Instance> {
    let mut instances = Vec::new();
    for (gaussian, splat) in splats.iter().enumerate() {
        let Some(splat) = splat else { continue };
        for tile in tiles::touched(splat, view) {
            let depth_bits = (splat.depth as f32).to_bits();
            instances.push(Instance { tile, depth_bits, gaussian: gaussian as u32 });
        }
    }
    instances
}
