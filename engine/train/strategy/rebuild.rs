//! Shared parts of strategies: decisions per Gaussian, memory, and the new set that follows.

use crate::error::{Error, Result};
use crate::frame::SceneBuffers;
use crate::passes::densify::{
    ClassifyInputs, Densify, DensifyBuffers, DensifySettings, OrderBuffers, OrderInputs,
};
use crate::train::population::{Growth, Population};
use crate::train::strategy::{Changes, Densified};
use crate::vk::{Buffer, Recorder};

/// A densification by decisions per Gaussian.
pub(super) struct Decisions<'a> {
    kernels: &'a Densify,
    pub settings: DensifySettings,
    buffers: DensifyBuffers,
    order: Option<OrderBuffers>,
}

impl<'a> Decisions<'a> {
    /// Decisions for a new set of at most `max_rows` rows. None if memory is short; the set then stays.
    pub fn new(
        population: &Population,
        max_rows: u32,
        kernels: &'a Densify,
        settings: DensifySettings,
    ) -> Result<Option<Self>> {
        let requests = DensifyBuffers::requests(&population.sizes(), population.count(), max_rows);
        let buffers = population.allocate(&requests)?;
        let buffers = buffers.map(DensifyBuffers::from_allocated);
        Ok(buffers.map(|buffers| Self { kernels, settings, buffers, order: None }))
    }

    /// Decides what happens to each Gaussian. `selected`: see [`ClassifyInputs::selected`].
    pub fn classify(&self, population: &Population, selected: Option<&Buffer>) -> Result<Densified> {
        let context = population.context();
        let inputs = ClassifyInputs { statistics: population.statistics(), selected };
        context.run("densify: classify", |r| {
            let scene = population.scene();
            self.kernels.record_classify(r, scene, inputs, &self.buffers, &self.settings);
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&context.download(&self.buffers.totals)?);
        let before = population.count();
        Ok(Densified { before, kept: totals[0], cloned: totals[1], split: totals[2], limited: false })
    }

    /// Decides which Gaussians stay, without clones and splits, with [`DensifyForm::selected`](crate::passes::densify::DensifyForm::selected).
    pub fn classify_kept(&self, population: &Population) -> Result<Densified> {
        // The buffer is zero until sources are written, so no Gaussian is selected.
        let none = &self.buffers.sources;
        population.context().run("select none", |r| r.fill(none, 0))?;
        self.classify(population, Some(none))
    }

    /// Allocates memory for a new set of up to `rows` rows, and for its order along the curve. The capacity may be less
    /// ([`Population::capacity_with`]). None if memory for the order is short; the set then stays.
    pub fn reserve_gaussians(&mut self, population: &mut Population, rows: u32) -> Result<Option<Growth>> {
        // The order comes before new planes. There is no fallback to another order, because the bits would then depend on the
        // free memory.
        self.order = order_buffers(population, rows)?;
        self.order.is_some().then(|| population.reserve_gaussians(rows)).transpose()
    }

    /// Replaces the set by the decisions. [`Decisions::reserve_gaussians`] orders the new set along the curve. Without it the
    /// Gaussians keep their order.
    pub fn rebuild(&self, population: &mut Population, densified: Densified, growth: Growth) -> Result<()> {
        let (rows, key, curve) = (densified.rows(), population.random_key(), population.curve());
        let sources = |r: &mut Recorder, scene: &SceneBuffers| {
            self.kernels.record_scatter_sources(r, scene.count, rows, &self.buffers);
            r.barrier();
            let DensifyBuffers { sources, totals, .. } = &self.buffers;
            match &self.order {
                Some(order) => {
                    let inputs = OrderInputs { scene, rows, sources, totals, curve };
                    self.kernels.record_order(r, &inputs, order)
                }
                None => sources,
            }
        };
        population.rebuild(rows, growth, self.kernels, &key, sources, |_, _, _, _| {})
    }
}

/// Buffers for sorting `rows` rows along the curve. None if memory is short.
pub(super) fn order_buffers(population: &Population, rows: u32) -> Result<Option<OrderBuffers>> {
    let buffers = population.allocate(&OrderBuffers::requests(&population.sizes(), rows))?;
    Ok(buffers.map(OrderBuffers::from_allocated))
}

/// Lowers all opacities to at most this one.
pub(super) fn reset_opacity(population: &Population, kernels: &Densify, max_opacity: f64) -> Result<Changes> {
    population.context().run("reset opacity", |r| {
        kernels.record_reset(r, population.scene(), population.moments(), max_opacity)
    })?;
    Ok(Changes { opacities_reset: true, ..Changes::default() })
}

/// Refuses a cap below the number of Gaussians of the start.
pub(super) fn check_cap(cap: u32, gaussians: u32) -> Result<()> {
    if gaussians <= cap {
        return Ok(());
    }
    let problem =
        format!("{cap} is less than the {gaussians} Gaussians of the start; raise it, or start from fewer");
    Err(Error::argument("cap_max", problem))
}
