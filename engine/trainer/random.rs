//! Random numbers of a run on the host: the order of its views, and its backgrounds.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random streams of a run; the seed determines them all.
const STREAM_VIEWS: u64 = 1;
const STREAM_BACKGROUND: u64 = 2;
const STREAM_POOL: u64 = 3;

/// Order of views: each view once per epoch, in random order.
#[derive(Clone)]
pub(super) struct ViewOrder {
    seed: u32,
    views: usize,
    epoch: u64,
    order: Vec<usize>,
}

impl ViewOrder {
    pub fn new(seed: u32, views: usize) -> Self {
        Self { seed, views, epoch: u64::MAX, order: Vec::new() }
    }

    pub fn views(&self) -> usize {
        self.views
    }

    /// View of an iteration, counted from 1. It depends only on the seed and the iteration.
    pub fn view(&mut self, iteration: u32) -> usize {
        let index = iteration as usize - 1;
        let epoch = (index / self.views) as u64;
        if epoch != self.epoch {
            let mut rng = generator(self.seed, STREAM_VIEWS, epoch);
            self.order = (0..self.views).collect();
            self.order.shuffle(&mut rng);
            self.epoch = epoch;
        }
        self.order[index % self.views]
    }
}

fn generator(seed: u32, stream: u64, counter: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(seed));
    rng.set_stream(stream);
    // Each counter has 2^20 words of its own, far more than an iteration draws.
    rng.set_word_pos(u128::from(counter) << 20);
    rng
}

/// Returns the views at these places of an endless sequence. Each epoch of it has all views, in a new random order.
pub(super) fn pool_views(seed: u32, views: usize, places: std::ops::Range<u64>) -> Vec<usize> {
    let views = views as u64;
    let mut order: Option<(u64, Vec<usize>)> = None;
    let view = |place: u64| {
        let epoch = place / views;
        if order.as_ref().is_none_or(|(of, _)| *of != epoch) {
            let mut rng = generator(seed, STREAM_POOL, epoch);
            let mut all: Vec<usize> = (0..views as usize).collect();
            all.shuffle(&mut rng);
            order = Some((epoch, all));
        }
        order.as_ref().map_or(0, |(_, order)| order[(place % views) as usize])
    };
    places.map(view).collect()
}

/// Random background of an iteration: r, g, b.
pub(super) fn background(seed: u32, iteration: u32) -> [f32; 3] {
    let mut rng = generator(seed, STREAM_BACKGROUND, iteration.into());
    [rng.random(), rng.random(), rng.random()]
}

#[cfg(test)]
mod tests {
    use super::pool_views;

    #[test]
    fn a_pool_is_used_up_before_it_is_refilled() {
        let drawn = pool_views(7, 6, 0..18);
        for epoch in drawn.chunks(6) {
            let mut sorted = epoch.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2, 3, 4, 5]);
        }
        assert!(drawn[..6] != drawn[6..12] || drawn[..6] != drawn[12..]);
        assert_eq!(pool_views(7, 6, 4..9), drawn[4..9]);
        assert!(pool_views(8, 6, 0..18) != drawn);
        assert_eq!(pool_views(7, 1, 3..5), [0, 0]);
    }
}
