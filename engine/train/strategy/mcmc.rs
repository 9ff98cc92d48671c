//! Density control of 3DGS-MCMC (Kheradmand et al. 2024): transparent Gaussians move to the places of others, the set grows to
//! a bound, and noise explores.

use super::rebuild::{check_cap, order_buffers};
use crate::error::Result;
use crate::passes::densify::{Densify, DensifyForm, Draw, DrawBuffers, OrderInputs, RandomKey, Relocation};
use crate::train::population::Population;
use crate::train::settings::TrainSettings;
use crate::train::strategy::{Actions, Changes, Densified, NOT_IN_OTHERS, StepInputs, StepWork, Strategy};
use crate::vk::{Context, Recorder};

/// Size of the set after a densification (3dgs-mcmc, `add_new_gs`), in percent.
const GROWTH_PERCENT: u64 = 105;

/// Relocation, growth to [`TrainSettings::cap_max`], and noise on the means. Its regularisers are
/// [`TrainSettings::opacity_reg`] and [`TrainSettings::scale_reg`].
pub struct Mcmc {
    kernels: Densify,
    relocation: Relocation,
}

impl Mcmc {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self {
            kernels: Densify::new(context, DensifyForm::default())?,
            relocation: Relocation::new(context)?,
        })
    }
}

impl Strategy for Mcmc {
    fn name(&self) -> &'static str {
        "mcmc"
    }

    fn check(&self, settings: &TrainSettings, gaussians: u32) -> Result<()> {
        settings.refuse(self.name(), &NOT_IN_OTHERS)?;
        check_cap(settings.cap_max, gaussians)
    }

    fn work(&self, settings: &TrainSettings, iteration: u32) -> StepWork {
        let densifies = settings.densifies_at(iteration);
        StepWork {
            accumulates: false,
            optimizes: true,
            optimizes_opacity: true,
            actions: Actions::DENSIFY.when(densifies),
        }
    }

    fn grows_by_statistics(&self) -> bool {
        false
    }

    fn record_update(&self, r: &mut Recorder, step: &StepInputs) {
        let rate = (step.step.rates.mean * step.settings.noise_lr) as f32;
        if rate > 0.0 {
            r.barrier();
            let key = RandomKey { seed: step.settings.seed, iteration: step.iteration };
            self.relocation.record_noise(r, step.frame.scene(), &step.frame.buffers.state, &key, rate);
        }
    }

    fn between_steps(&mut self, population: &mut Population, _: Actions) -> Result<Changes> {
        population.release_pictures();
        let before = population.count();
        let wanted = (u64::from(before) * GROWTH_PERCENT / 100).min(population.settings().cap_max.into());
        let wanted = (wanted as u32).max(before);
        let rows = wanted.min(population.max_rows()).max(before);
        let relocated = self.rebuild(population, before, true)?;
        let grown = relocated && self.rebuild(population, rows, false)?;
        let after = population.count();
        let densified = Densified {
            before,
            kept: before,
            cloned: after - before,
            limited: !grown || after < wanted,
            ..Densified::default()
        };
        Ok(Changes { densified: Some(densified), ..Changes::default() })
    }
}

impl Mcmc {
    /// Draws a new set of up to `rows` rows, at least as many as now. Growth also orders it along the curve. Returns false if
    /// memory is short; the set then stays.
    fn rebuild(&self, population: &mut Population, rows: u32, replaces_dead: bool) -> Result<bool> {
        let before = population.count();
        let Some(buffers) = population.allocate(&DrawBuffers::requests(&population.sizes(), before, rows))?
        else {
            return Ok(false);
        };
        let buffers = DrawBuffers::from_allocated(buffers);
        let order = if replaces_dead { None } else { order_buffers(population, rows)? };
        if order.is_none() && !replaces_dead {
            return Ok(false);
        }
        let growth = population.reserve_gaussians(rows)?;
        let rows = rows.min(population.capacity_with(&growth));
        let (seed, iteration) = (population.settings().seed, population.iteration());
        let draw = Draw { rows, replaces_dead, seed, iteration };
        let (key, curve) = (population.random_key(), population.curve());
        population.rebuild(
            rows,
            growth,
            &self.kernels,
            &key,
            |r, scene| {
                self.relocation.record_draw(r, scene, &draw, &buffers);
                let DrawBuffers { sources, totals, .. } = &buffers;
                match &order {
                    None => sources,
                    Some(order) => {
                        let inputs = OrderInputs { scene, rows, sources, totals, curve };
                        self.kernels.record_order(r, &inputs, order)
                    }
                }
            },
            |r, scene, moments, sources| {
                self.relocation.record_relocate(r, scene, moments, sources, &buffers.draws);
            },
        )?;
        Ok(true)
    }
}
