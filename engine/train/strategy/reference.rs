//! The reference's density control (Kerbl et al. 2023, section 5.2): clone and split where the gradient of the
//! 2D mean is large, prune what is transparent or too large, reset opacities.

use super::rebuild::{Decisions, reset_opacity};
use crate::error::Result;
use crate::passes::densify::{Densify, DensifyForm, DensifySettings, RESET_OPACITY};
use crate::train::population::Population;
use crate::train::settings::{SplitType, TrainSettings};
use crate::train::strategy::{Actions, Changes, Densified, StepWork, Strategy, unknown};
use crate::vk::Context;

/// Scales above this share of the scene's extent are pruned after the first opacity reset (reference).
const LARGE_SCALE_SHARE: f64 = 0.1;

/// Clone, split, prune and opacity reset of the reference implementation. Two parts are replaceable. [`TrainSettings::absgrad`]
/// densifies by absolute gradients (like gsplat, with one threshold for clones and splits), and [`TrainSettings::split`]
/// selects the split.
pub struct Reference {
    kernels: Densify,
    absolute: bool,
}

impl Reference {
    /// Builds the kernels with the reference's own parts.
    pub fn new(context: &Context) -> Result<Self> {
        Self::of_settings(context, &TrainSettings::reference())
    }

    /// Builds the kernels for these settings.
    pub fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let form = DensifyForm { long_axis: settings.split == SplitType::LongAxis, selected: false };
        Ok(Self { kernels: Densify::new(context, form)?, absolute: settings.absgrad })
    }
}

impl Strategy for Reference {
    fn name(&self) -> &'static str {
        "reference"
    }

    fn check(&self, settings: &TrainSettings, _: u32) -> Result<()> {
        settings
            .refuse(self.name(), &["cap_ratio", "importance", "growth_curve", "recovery", "late_min_opacity"])
    }

    fn work(&self, settings: &TrainSettings, iteration: u32) -> StepWork {
        let densifies = settings.densifies_at(iteration);
        let resets = settings.resets_opacity_at(iteration);
        StepWork {
            accumulates: settings.collects_statistics_at(iteration),
            // In the reference, densification replaces the parameters, so that they have no gradient. A reset does the same to
            // the opacities.
            optimizes: !densifies,
            optimizes_opacity: !resets,
            actions: Actions::DENSIFY.when(densifies).and(Actions::RESET_OPACITY.when(resets)),
        }
    }

    fn absolute_gradients(&self) -> bool {
        self.absolute
    }

    fn between_steps(&mut self, population: &mut Population, action: Actions) -> Result<Changes> {
        match action {
            Actions::DENSIFY => {
                Ok(Changes { densified: Some(self.densify(population)?), ..Changes::default() })
            }
            Actions::RESET_OPACITY => reset_opacity(population, &self.kernels, RESET_OPACITY),
            _ => Err(unknown(self.name(), action)),
        }
    }
}

impl Reference {
    /// Classifies, grows the capacity, and gathers the new set. If the capacity cannot grow enough, clones and splits only the
    /// Gaussians with the largest gradients.
    fn densify(&self, population: &mut Population) -> Result<Densified> {
        let settings = settings_of(population);
        let before = population.count();
        population.release_pictures();
        let unchanged = Densified { before, kept: before, limited: true, ..Densified::default() };
        // A Gaussian stays and is cloned, or is split into two.
        let max_rows = before.saturating_mul(2);
        let decisions = Decisions::new(population, max_rows, &self.kernels, settings)?;
        let Some(mut decisions) = decisions else { return Ok(unchanged) };
        let classified = decisions.classify(population, None)?;
        let limit = population.max_rows();
        let rows = classified.rows().min(limit);
        let Some(growth) = decisions.reserve_gaussians(population, rows)? else { return Ok(unchanged) };
        let capacity = population.capacity_with(&growth).min(limit);
        let densified = match classified.rows() <= capacity {
            true => classified,
            false => Densified { limited: true, ..self.decide_within(population, &mut decisions, capacity)? },
        };
        decisions.rebuild(population, densified, growth)?;
        Ok(densified)
    }

    /// Classifies with the lowest threshold that fits the capacity, found by bisection, so that the Gaussians with the largest
    /// gradients are cloned or split. The capacity is at least the current number of Gaussians.
    fn decide_within(
        &self,
        population: &Population,
        decisions: &mut Decisions,
        capacity: u32,
    ) -> Result<Densified> {
        const ROUNDS: u32 = 24;
        // Non-negative floats are ordered like their bits. No Gaussian passes a threshold of infinity.
        let min_gradient = decisions.settings.gradient_threshold.abs();
        let (mut low, mut high) = (min_gradient.to_bits(), f32::INFINITY.to_bits());
        let mut classify = |bits: u32| {
            decisions.settings.gradient_threshold = f32::from_bits(bits);
            decisions.classify(population, None)
        };
        for _ in 0..ROUNDS {
            let middle = low + (high - low) / 2;
            let densified = classify(middle)?;
            let rows = densified.rows();
            if rows <= capacity && rows >= capacity - capacity / 64 {
                return Ok(densified);
            }
            if rows <= capacity { high = middle } else { low = middle }
        }
        classify(high)
    }
}

fn settings_of(population: &Population) -> DensifySettings {
    let s = population.settings();
    let extent = f64::from(population.scene_extent());
    let prunes_large = s.prunes_large_at(population.iteration());
    DensifySettings {
        gradient_threshold: s.densify_grad_threshold as f32,
        clone_scale: (s.percent_dense * extent) as f32,
        min_opacity: s.min_opacity as f32,
        max_scale: if prunes_large { (LARGE_SCALE_SHARE * extent) as f32 } else { 0.0 },
    }
}
