//! How many tiles each splat touches, the twin of `forward/count`.

use super::tiles;
use super::types::{Splat, View};

/// Counts; 0 for what is culled.
pub fn count(splats: &[Option<Splat>], view: &View) -> Vec<u32> {
    splats
        .iter()
        .map(|splat| splat.as_ref().map_or(0, |splat| tiles::touched(splat, view).len() as u32))
        .collect()
}
