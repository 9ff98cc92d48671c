//! Checkpoints of neighbouring blocks exchange their Gaussians, with all that training keeps of each.

use super::block::SceneBlock;
use super::checkpoint::{Checkpoint, GradientSums, Room, StrategyStatistic, difference};
use super::settings::TrainSettings;
use crate::error::{Error, Result};

impl Checkpoint {
    /// The state with these Gaussians alone, in this order, with their moments and statistics. What is kept of views and of the
    /// run stays.
    pub fn select(&self, rows: &[usize]) -> Self {
        let of_statistic = |statistic: &StrategyStatistic| {
            let floats = statistic.floats as usize;
            let values = rows.iter().flat_map(|row| &statistic.values[row * floats..][..floats]);
            StrategyStatistic { values: values.copied().collect(), ..statistic.clone() }
        };
        let of_sums = |sums: &GradientSums| GradientSums { sums: sums.sums.select(rows), ..sums.clone() };
        Self {
            gaussians: self.gaussians.select(rows),
            first_moments: self.first_moments.select(rows),
            second_moments: self.second_moments.select(rows),
            statistics: rows.iter().map(|&row| self.statistics[row]).collect(),
            filters: rows.iter().filter_map(|&row| self.filters.get(row).copied()).collect(),
            strategy: super::checkpoint::StrategyState {
                statistics: self.strategy.statistics.iter().map(of_statistic).collect(),
                ..self.strategy.clone()
            },
            gradient_sums: self.gradient_sums.as_ref().map(of_sums),
            ..self.clone()
        }
    }

    /// Appends the Gaussians of another run with the same settings. What that run keeps of its views is left out.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the settings that differ, and where one of the two has added up gradients of more views.
    pub fn append(&mut self, other: &Self) -> Result<()> {
        let refuse = |problem: String| Err(Error::argument("checkpoint", problem));
        if let Some(difference) = self.difference_of_settings(other) {
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

    /// The settings in which another run differs, but for the number of iterations; None if there are none.
    pub fn difference_of_settings(&self, other: &Self) -> Option<String> {
        let there = TrainSettings { iterations: self.settings.iterations, ..other.settings.clone() };
        difference(&there, &self.settings)
    }

    /// Goes on in this block, among what lies around it. The room that was allocated for other Gaussians is forgotten; as much is
    /// allocated as at a start.
    pub fn settle_in(&mut self, block: &SceneBlock) {
        self.block = block.state();
        let Room { most_instances, max_memory, .. } = self.room;
        self.room = Room { most_instances, max_memory, ..Room::default() };
    }
}
