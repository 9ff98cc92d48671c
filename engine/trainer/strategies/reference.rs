//! The reference's density control (Kerbl et al. 2023, section 5.2): clone and split where the gradient of the
//! 2D mean is large, prune what is transparent or too large, reset opacities.

use crate::densify::{Densify, DensifyBuffers, DensifySettings, OrderBuffers, RandomKey};
use crate::error::Result;
use crate::plan::LaunchSizes;
use crate::trainer::population::{Population, or_none};
use crate::trainer::settings::TrainSettings;
use crate::trainer::strategy::Strategy;
use crate::trainer::work::{Actions, Changes, Densified, Work};
use crate::vk::{Context, MemoryKind};

/// Scales above this share of the scene's extent are pruned after the first opacity reset (reference).
const LARGE_SCALE_SHARE: f64 = 0.1;

/// Clone, split, prune and opacity reset, as the reference implementation does them.
pub struct Reference {
    kernels: Densify,
}

impl Reference {
    /// Builds the kernels.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernels: Densify::new(context)? })
    }
}

impl Strategy for Reference {
    fn name(&self) -> &'static str {
        "default"
    }

    fn work(&self, settings: &TrainSettings, iteration: u32) -> Work {
        let densifies = settings.densifies_at(iteration);
        let resets = settings.resets_opacity_at(iteration);
        Work {
            accumulates: settings.collects_statistics_at(iteration),
            // In the reference, densification replaces the parameters, which then have no gradient; a reset
            // does the same to the opacities.
            optimizes: !densifies,
            optimizes_opacity: !resets,
            actions: Actions::DENSIFY.when(densifies).and(Actions::RESET_OPACITY.when(resets)),
        }
    }

    fn between_steps(&mut self, population: &mut Population, action: Actions) -> Result<Changes> {
        if action == Actions::DENSIFY {
            return Ok(Changes { densified: Some(self.densify(population)?), ..Changes::default() });
        }
        population.context().run("reset opacity", |r| {
            self.kernels.record_reset(r, population.scene(), population.moments());
            Ok(())
        })?;
        Ok(Changes { opacities_reset: true, ..Changes::default() })
    }
}

impl Reference {
    /// Classifies, grows the capacity, and gathers the new set. If the capacity cannot grow enough, only the
    /// Gaussians with the largest gradients are cloned or split.
    fn densify(&self, population: &mut Population) -> Result<Densified> {
        let settings = settings_of(population);
        let before = population.count();
        population.release_pictures();
        let unchanged = Densified { before, kept: before, limited: true, ..Densified::default() };
        let Some(buffers) = decision_buffers(population)? else { return Ok(unchanged) };
        let wanted = self.classify(population, &buffers, &settings)?;
        let most = population.most_rows();
        let rows = wanted.rows().min(most);
        // Allocated before the second set of planes. There is no fallback to another order: the bits would
        // then depend on the free memory.
        let Some(order) = order_buffers(population, rows)? else { return Ok(unchanged) };
        let growth = population.make_room(rows)?;
        let room = population.capacity_with(&growth).min(most);
        let densified = match wanted.rows() <= room {
            true => wanted,
            false => {
                Densified { limited: true, ..self.decide_within(population, &buffers, &settings, room)? }
            }
        };
        let rows = densified.rows();
        let key =
            RandomKey { seed: population.settings().seed, iteration: population.iteration(), explicit: None };
        let curve = population.curve();
        population.rebuild(rows, growth, &self.kernels, &key, |r, scene| {
            self.kernels.record_scatter_sources(r, scene.count, rows, &buffers);
            r.barrier();
            self.kernels.record_order(r, (scene, rows), &buffers, &order, &curve)
        })?;
        Ok(densified)
    }

    /// Classifies with a threshold that fits the capacity: bisection finds the lowest one, so that the
    /// Gaussians with the largest gradients are cloned or split. The capacity is at least the current number
    /// of Gaussians.
    fn decide_within(
        &self,
        population: &Population,
        buffers: &DensifyBuffers,
        settings: &DensifySettings,
        room: u32,
    ) -> Result<Densified> {
        const ROUNDS: u32 = 24;
        // Non-negative floats have the order of their bits. At infinity no Gaussian passes.
        let (mut low, mut high) = (settings.gradient_threshold.abs().to_bits(), f32::INFINITY.to_bits());
        let classify = |bits: u32| {
            let gradient_threshold = f32::from_bits(bits);
            self.classify(population, buffers, &DensifySettings { gradient_threshold, ..*settings })
        };
        for _ in 0..ROUNDS {
            let middle = low + (high - low) / 2;
            let densified = classify(middle)?;
            let rows = densified.rows();
            if rows <= room && rows >= room - room / 64 {
                return Ok(densified);
            }
            if rows <= room { high = middle } else { low = middle }
        }
        classify(high)
    }

    fn classify(
        &self,
        population: &Population,
        buffers: &DensifyBuffers,
        settings: &DensifySettings,
    ) -> Result<Densified> {
        let context = population.context();
        context.run("densify: classify", |r| {
            let statistics = &population.statistics()[0];
            self.kernels.record_classify(r, population.scene(), statistics, buffers, settings);
            Ok(())
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&context.download(&buffers.totals)?);
        let before = population.count();
        Ok(Densified { before, kept: totals[0], cloned: totals[1], split: totals[2], limited: false })
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

/// Buffers of the classification. None without memory for them: the set then stays as it is.
fn decision_buffers(population: &Population) -> Result<Option<DensifyBuffers>> {
    let sizes = LaunchSizes::new(population.context().limits());
    let before = population.count();
    // At most two rows per Gaussian: it stays and is cloned, or it is split into two.
    let requests = DensifyBuffers::requests(&sizes, before, before.saturating_mul(2));
    let buffers = or_none(population.context().allocate("densify", &requests, MemoryKind::Device))?;
    Ok(buffers.map(DensifyBuffers::from_allocated))
}

/// Buffers for sorting `rows` rows along the curve. None without memory for them: the set then stays as it
/// is.
fn order_buffers(population: &Population, rows: u32) -> Result<Option<OrderBuffers>> {
    let requests = OrderBuffers::requests(&LaunchSizes::new(population.context().limits()), rows);
    let buffers = or_none(population.context().allocate("densify", &requests, MemoryKind::Device))?;
    Ok(buffers.map(OrderBuffers::from_allocated))
}
