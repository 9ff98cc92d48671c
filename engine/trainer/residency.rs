//! Selection of the photographs on the device if only some of them fit.

use super::random::ViewOrder;

/// Photograph of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Use {
    pub view: usize,
    /// Index of its place on the device.
    pub place: usize,
    /// True if it must be loaded into the place.
    pub load: bool,
}

/// Belady's algorithm: the order is known, so a load replaces the photograph whose next use is last.
#[derive(Clone)]
pub(super) struct Residency {
    order: ViewOrder,
    /// Next iteration, counted from 1.
    iteration: u32,
    /// View in each place.
    places: Vec<Option<usize>>,
    /// Iterations at which each view is next used: in this epoch and in the next.
    uses: Vec<[u32; 2]>,
    /// Iteration from which `uses` must be recomputed.
    epoch_end: u32,
}

impl Residency {
    /// Starts at an iteration with empty places.
    pub fn new(order: ViewOrder, places: usize, iteration: u32) -> Self {
        let uses = vec![[0; 2]; order.views()];
        Self { order, iteration, places: vec![None; places], uses, epoch_end: 0 }
    }

    /// Photograph of the next iteration.
    pub fn advance(&mut self) -> Use {
        let iteration = self.iteration;
        self.iteration += 1;
        if iteration >= self.epoch_end {
            self.look_ahead(iteration);
        }
        let view = self.order.view(iteration);
        if let Some(place) = self.places.iter().position(|&held| held == Some(view)) {
            return Use { view, place, load: false };
        }
        let farthest =
            |&place: &usize| self.places[place].map_or(u32::MAX, |held| self.next_use(held, iteration));
        let place = (0..self.places.len()).max_by_key(farthest).unwrap_or(0);
        self.places[place] = Some(view);
        Use { view, place, load: true }
    }

    /// Notes the iteration of each view, in the epoch of the given iteration and in the next.
    fn look_ahead(&mut self, iteration: u32) {
        let views = self.uses.len() as u32;
        let first = (iteration - 1) / views * views + 1;
        for epoch in [1, 0] {
            for at in first + epoch * views..first + (epoch + 1) * views {
                self.uses[self.order.view(at)][epoch as usize] = at;
            }
        }
        self.epoch_end = first + views;
    }

    fn next_use(&self, view: usize, iteration: u32) -> u32 {
        let [this, next] = self.uses[view];
        if this > iteration { this } else { next }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of loads in `epochs` epochs.
    fn loads(views: usize, places: usize, epochs: u32) -> u32 {
        let mut schedule = Residency::new(ViewOrder::new(3, views), places, 1);
        let mut order = ViewOrder::new(3, views);
        let mut held = vec![None; places];
        let mut loads = 0;
        for iteration in 1..=epochs * views as u32 {
            let at = schedule.advance();
            assert_eq!(at.view, order.view(iteration));
            if at.load {
                assert!(!held.contains(&Some(at.view)), "it was there");
                held[at.place] = Some(at.view);
                loads += 1;
            }
            assert_eq!(held[at.place], Some(at.view));
        }
        loads
    }

    #[test]
    fn what_fits_is_loaded_once() {
        assert_eq!(loads(17, 17, 10), 17);
        assert_eq!(loads(17, 1, 10), 170 - repeats(17, 10));
    }

    /// Number of views that come last in an epoch and first in the next.
    fn repeats(views: usize, epochs: u32) -> u32 {
        let mut order = ViewOrder::new(3, views);
        let ends = (1..epochs).map(|epoch| epoch * views as u32);
        ends.filter(|&at| order.view(at) == order.view(at + 1)).count() as u32
    }

    /// Least-recently-used replacement would load nearly all in every epoch.
    #[test]
    fn half_the_room_saves_half_the_loads() {
        let of_all = f64::from(loads(40, 20, 20)) / 800.0;
        // All in the first epoch, half in each of the others.
        assert!(of_all <= (40.0 + 19.0 * 20.0) / 800.0, "{of_all}");
    }

    /// A resumed run has the same views.
    #[test]
    fn it_begins_anywhere() {
        let mut schedule = Residency::new(ViewOrder::new(3, 9), 4, 14);
        let mut order = ViewOrder::new(3, 9);
        for iteration in 14..60 {
            assert_eq!(schedule.advance().view, order.view(iteration));
        }
    }
}
