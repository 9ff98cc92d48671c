//! Moves Gaussians between checkpoints of neighbouring blocks, with their moments and statistics.

use super::block::SceneBlock;
use super::checkpoint::{Checkpoint, Room, StrategyStatistic, difference};
use super::settings::TrainSettings;
use crate::error::{Error, Result};

impl Checkpoint {
    /// Keeps only these Gaussians, in this order, with their moments and statistics. The state of views and of the run stays.
    pub fn keep(&mut self, rows: &[usize]) {
        let sums = self.gradient_sums.iter_mut().map(|sums| &mut sums.sums);
        let sets = [&mut self.gaussians, &mut self.first_moments, &mut self.second_moments];
        sets.into_iter().chain(sums).for_each(|set| *set = set.select(rows));
        // Averaging starts again.
        self.means = None;
        self.statistics = rows.iter().map(|&row| self.statistics[row]).collect();
        // Empty without the 3D filter.
        self.filters = rows.iter().filter_map(|&row| self.filters.get(row).copied()).collect();
        for StrategyStatistic { floats, values, .. } in &mut self.strategy.statistics {
            let floats = *floats as usize;
            *values = rows.iter().flat_map(|row| &values[row * floats..][..floats]).copied().collect();
        }
    }

    /// Appends the Gaussians of another run with the same settings. The other run's state of views is dropped.
    ///
    /// # Errors
    /// [`Error::Argument`] if settings differ, naming them, or if the gradient sums of the two cover different numbers of
    /// views.
    pub fn append(&mut self, other: &Self) -> Result<()> {
        let refuse = |problem: String| Err(Error::argument("checkpoint", problem));
        if let Some(difference) = self.difference_of_settings(&other.settings) {
            return refuse(format!("was made with other settings: {difference}"));
        }
        let names = |of: &Self| -> Vec<(String, u32)> {
            of.strategy.statistics.iter().map(|own| (own.name.clone(), own.floats)).collect()
        };
        if self.strategy.name != other.strategy.name || names(self) != names(other) {
            return refuse("was made with another strategy".into());
        }
        let summed = |of: &Self| of.gradient_sums.as_ref().map_or(0, |sums| sums.views);
        if summed(self) != summed(other) {
            return refuse(format!("has gradients of {} views, not of {}", summed(other), summed(self)));
        }
        self.means = None;
        self.gaussians.append(&other.gaussians);
        self.first_moments.append(&other.first_moments);
        self.second_moments.append(&other.second_moments);
        self.statistics.extend_from_slice(&other.statistics);
        self.filters.extend_from_slice(&other.filters);
        for (own, others) in self.strategy.statistics.iter_mut().zip(&other.strategy.statistics) {
            own.values.extend_from_slice(&others.values);
        }
        if let (Some(own), Some(others)) = (&mut self.gradient_sums, &other.gradient_sums) {
            own.sums.append(&others.sums);
        }
        Ok(())
    }

    /// Settings in which another run differs, except the number of iterations; None if none differ.
    pub fn difference_of_settings(&self, others: &TrainSettings) -> Option<String> {
        let there = TrainSettings { iterations: self.settings.iterations, ..others.clone() };
        difference(&there, &self.settings)
    }

    /// Continues training in this block, with new frozen neighbours. The allocated capacities are reset to those of a start;
    /// only the expected counts of a frame stay.
    pub fn settle_in(&mut self, block: &SceneBlock) {
        self.block = block.state();
        let Room { frame_visible, most_visible, most_instances, max_memory, .. } = self.room;
        self.room = Room { frame_visible, most_visible, most_instances, max_memory, ..Room::default() };
    }
}
