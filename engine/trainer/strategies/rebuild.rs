//! Shared parts of strategies that clone and split: decisions per Gaussian, memory, and the new set that follows.

use crate::densify::{ClassifyInputs, Densify, DensifyBuffers, DensifySettings, OrderBuffers, RandomKey};
use crate::error::Result;
use crate::plan::LaunchSizes;
use crate::trainer::population::{Growth, Population, or_none};
use crate::trainer::work::Densified;
use crate::vk::{Context, MemoryKind, Recorder};

/// Memory of a densification besides the planes.
pub(super) struct DecisionMemory {
    buffers: DensifyBuffers,
    order: Option<OrderBuffers>,
}

impl DecisionMemory {
    /// Memory for a set that at most doubles: a Gaussian stays and is cloned, or is split into two. None if memory is short;
    /// the set then stays.
    pub fn for_growth(population: &Population) -> Result<Option<Self>> {
        Self::allocate(population, population.count().saturating_mul(2))
    }

    /// Memory for a set that does not grow. None if memory is short; the set then stays.
    pub fn for_pruning(population: &Population) -> Result<Option<Self>> {
        Self::allocate(population, population.count())
    }

    fn allocate(population: &Population, rows: u32) -> Result<Option<Self>> {
        let sizes = LaunchSizes::new(population.context().limits());
        let requests = DensifyBuffers::requests(&sizes, population.count(), rows);
        let buffers = or_none(population.context().allocate("densify", &requests, MemoryKind::Device))?;
        Ok(buffers.map(|buffers| Self { buffers: DensifyBuffers::from_allocated(buffers), order: None }))
    }
}

/// A densification by decisions per Gaussian.
pub(super) struct Decisions<'a> {
    pub kernels: &'a Densify,
    pub memory: DecisionMemory,
    pub settings: DensifySettings,
}

impl Decisions<'_> {
    /// Decides what happens to each Gaussian.
    pub fn classify(&self, population: &Population, inputs: ClassifyInputs) -> Result<Densified> {
        let context = population.context();
        context.run("densify: classify", |r| {
            let scene = population.scene();
            self.kernels.record_classify_by(r, scene, inputs, &self.memory.buffers, &self.settings);
            Ok(())
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&context.download(&self.memory.buffers.totals)?);
        let before = population.count();
        Ok(Densified { before, kept: totals[0], cloned: totals[1], split: totals[2], limited: false })
    }

    /// Decides which Gaussians stay, without clones and splits, by
    /// [`Criterion::Selected`](crate::densify::Criterion::Selected).
    pub fn classify_kept(&self, population: &Population) -> Result<Densified> {
        // The buffer is zero until sources are written, so no Gaussian is selected.
        let none = &self.memory.buffers.sources;
        population.context().run("select none", |r| {
            r.fill(none, 0);
            Ok(())
        })?;
        let statistics = &population.statistics()[0];
        self.classify(population, ClassifyInputs { statistics, criteria: Some(none) })
    }

    /// Allocates memory for a new set of up to `rows` rows, and for its order along the curve. The capacity may be less
    /// ([`Population::capacity_with`]). None if memory for the order is short; the set then stays.
    pub fn make_room(&mut self, population: &mut Population, rows: u32) -> Result<Option<Growth>> {
        // The order comes before the second set of planes. There is no fallback to another order, because the bits would then
        // depend on the free memory.
        self.memory.order = order_buffers(population.context(), rows)?;
        match self.memory.order {
            Some(_) => Ok(Some(population.make_room(rows)?)),
            None => Ok(None),
        }
    }

    /// Replaces the set by the decisions, after [`Decisions::make_room`].
    pub fn rebuild(&self, population: &mut Population, densified: Densified, growth: Growth) -> Result<()> {
        let Some(order) = &self.memory.order else { unreachable!("room was made") };
        let (rows, buffers) = (densified.rows(), &self.memory.buffers);
        let key = random_key(population);
        let curve = population.curve();
        population.rebuild(rows, growth, self.kernels, &key, |r, scene| {
            self.record_sources(r, scene.count, rows);
            self.kernels.record_order(r, (scene, rows), buffers, order, &curve)
        })
    }

    /// Removes the Gaussians that do not stay, without clones and splits. The others keep their order.
    pub fn prune(&self, population: &mut Population, densified: Densified) -> Result<()> {
        let rows = densified.rows();
        let (key, room) = (random_key(population), population.make_room(rows)?);
        population.rebuild(rows, room, self.kernels, &key, |r, scene| {
            self.record_sources(r, scene.count, rows);
            &self.memory.buffers.sources
        })
    }

    /// Records the source of each row of the new set, among `count` Gaussians. Ends with a barrier.
    fn record_sources(&self, r: &mut Recorder, count: u32, rows: u32) {
        self.kernels.record_scatter_sources(r, count, rows, &self.memory.buffers);
        r.barrier();
    }
}

/// Key of the random numbers after an iteration.
fn random_key(population: &Population) -> RandomKey<'static> {
    RandomKey { seed: population.settings().seed, iteration: population.iteration(), explicit: None }
}

/// Buffers for sorting `rows` rows along the curve.
fn order_buffers(context: &Context, rows: u32) -> Result<Option<OrderBuffers>> {
    let requests = OrderBuffers::requests(&LaunchSizes::new(context.limits()), rows);
    let buffers = or_none(context.allocate("densify", &requests, MemoryKind::Device))?;
    Ok(buffers.map(OrderBuffers::from_allocated))
}
