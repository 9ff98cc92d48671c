//! Densification and the opacity reset of a training run.

use super::{Densified, Trainer, Training, allocate_statistics, budget};
use crate::densify::{Curve, DensifyBuffers, DensifySettings, Gather, OrderBuffers, RandomKey};
use crate::error::{Error, Result};
use crate::forward::SceneBuffers;
use crate::optimizer::Moments;
use crate::plan::{FrameCapacity, LaunchSizes, ScenePlan};
use crate::planes;
use crate::scene::Camera;
use crate::scene::camera::middle;
use crate::vk::{Buffer, MemoryKind};

/// Scales above this share of the scene's extent are pruned after the first opacity reset (reference).
const LARGE_SCALE_SHARE: f64 = 0.1;

/// New planes and statistics for a set that exceeds its capacity.
struct Fresh {
    plan: ScenePlan,
    sets: Vec<Vec<Buffer>>,
    statistics: Buffer,
}

impl Trainer {
    /// Classifies, grows the capacity, and gathers the new set. If the capacity cannot grow enough, only the
    /// Gaussians with the largest gradients are cloned or split.
    pub(super) fn run_densification(&mut self, iteration: u32) -> Result<Densified> {
        let settings = self.densify_settings(iteration);
        let before = self.training.scene.count;
        self.pictures.release();
        let unchanged = Densified { before, kept: before, limited: true, ..Densified::default() };
        let Some(buffers) = self.decision_buffers()? else { return Ok(unchanged) };
        let wanted = self.classify(&buffers, &settings)?;
        let most = self.present().most_rows_by_instances(before, self.most_instances);
        let rows = wanted.rows().min(most);
        // Allocated before the second set of planes. There is no fallback to another order: the bits would
        // then depend on the free memory.
        let Some(order) = self.order_buffers(rows)? else { return Ok(unchanged) };
        let fresh = if rows > self.training.scene.plan.capacity { self.make_room(rows)? } else { None };
        let room = fresh.as_ref().map_or(self.training.scene.plan.capacity, |fresh| fresh.plan.capacity);
        let room = room.min(most);
        let densified = match wanted.rows() <= room {
            true => wanted,
            false => Densified { limited: true, ..self.decide_within(&buffers, &settings, room)? },
        };
        self.gather((densified.rows(), iteration), fresh, &buffers, &order)?;
        self.most_instances = budget::remembered_instances(self.most_instances, before, densified.rows());
        Ok(densified)
    }

    fn densify_settings(&self, iteration: u32) -> DensifySettings {
        let s = &self.settings;
        let extent = f64::from(self.scene_extent);
        DensifySettings {
            gradient_threshold: s.densify_grad_threshold as f32,
            clone_scale: (s.percent_dense * extent) as f32,
            min_opacity: s.min_opacity as f32,
            max_scale: if s.prunes_large_at(iteration) { (LARGE_SCALE_SHARE * extent) as f32 } else { 0.0 },
        }
    }

    /// Buffers of the classification. None without memory for them: the set then stays as it is.
    fn decision_buffers(&self) -> Result<Option<DensifyBuffers>> {
        let sizes = LaunchSizes::new(self.context.limits());
        let before = self.training.scene.count;
        // At most two rows per Gaussian: it stays and is cloned, or it is split into two.
        let requests = DensifyBuffers::requests(&sizes, before, before.saturating_mul(2));
        let buffers = or_none(self.context.allocate("densify", &requests, MemoryKind::Device))?;
        Ok(buffers.map(DensifyBuffers::from_allocated))
    }

    /// Buffers for sorting `rows` rows along the curve. None without memory for them: the set then stays as
    /// it is.
    fn order_buffers(&self, rows: u32) -> Result<Option<OrderBuffers>> {
        let requests = OrderBuffers::requests(&LaunchSizes::new(self.context.limits()), rows);
        let buffers = or_none(self.context.allocate("densify", &requests, MemoryKind::Device))?;
        Ok(buffers.map(OrderBuffers::from_allocated))
    }

    fn curve(&self) -> Curve {
        let middle = middle(self.cameras.iter().map(Camera::position)).unwrap_or_default();
        Curve { center: middle.as_vec3(), extent: self.scene_extent }
    }

    /// Planes and a frame for `rows` rows: with a reserve of half, without a reserve, or with the largest
    /// capacity that the memory holds, if the gain is worth the copy. None: the capacity cannot grow.
    fn make_room(&mut self, rows: u32) -> Result<Option<Fresh>> {
        let old = self.training.scene.plan.capacity;
        let most = self.present().most_with_room(rows)?;
        let worth_it = old + old / 16;
        for capacity in [budget::grown_capacity(&self.context, rows), rows, most] {
            if capacity <= worth_it && capacity < rows {
                continue;
            }
            if let Some(fresh) = or_none(self.allocate_fresh(capacity))? {
                return Ok(Some(fresh));
            }
        }
        Ok(None)
    }

    fn present(&self) -> budget::Present<'_> {
        let frame = self.runner.capacity();
        // For all views, including those that have not been used yet.
        let (width, height) = budget::largest_sides(&self.cameras);
        budget::Present {
            context: &self.context,
            plan: &self.training.scene.plan,
            frame: FrameCapacity { width: frame.width.max(width), height: frame.height.max(height), ..frame },
            frame_bytes: self.runner.frame_bytes(),
        }
    }

    /// Classifies with a threshold that fits the capacity: bisection finds the lowest one, so that the
    /// Gaussians with the largest gradients are cloned or split. The capacity is at least the current number
    /// of Gaussians.
    fn decide_within(
        &self,
        buffers: &DensifyBuffers,
        settings: &DensifySettings,
        room: u32,
    ) -> Result<Densified> {
        const ROUNDS: u32 = 24;
        // Non-negative floats have the order of their bits. At infinity no Gaussian passes.
        let (mut low, mut high) = (settings.gradient_threshold.abs().to_bits(), f32::INFINITY.to_bits());
        let classify = |bits: u32| {
            self.classify(buffers, &DensifySettings { gradient_threshold: f32::from_bits(bits), ..*settings })
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

    fn classify(&self, buffers: &DensifyBuffers, settings: &DensifySettings) -> Result<Densified> {
        self.context.run("densify: classify", |r| {
            let Training { scene, statistics, .. } = &self.training;
            self.densify.record_classify(r, scene, statistics, buffers, settings);
            Ok(())
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&self.context.download(&buffers.totals)?);
        let before = self.training.scene.count;
        Ok(Densified { before, kept: totals[0], cloned: totals[1], split: totals[2], limited: false })
    }

    /// Fills planes with `rows` Gaussians and their moments: new planes, or the existing ones.
    fn gather(
        &mut self,
        (rows, iteration): (u32, u32),
        fresh: Option<Fresh>,
        buffers: &DensifyBuffers,
        order: &OrderBuffers,
    ) -> Result<()> {
        let old = &self.training;
        let key = RandomKey { seed: self.settings.seed, iteration, explicit: None };
        let plan = fresh.as_ref().map_or(old.scene.plan, |fresh| fresh.plan);
        // Without growth the four sets of planes rotate: each is gathered into the set that the previous
        // gather freed.
        let sets = [&old.scene.chunks, &old.moments.first, &old.moments.second];
        let targets: [&Vec<Buffer>; 3] = match &fresh {
            Some(fresh) => [&fresh.sets[0], &fresh.sets[1], &fresh.sets[2]],
            None => [&old.spare, &old.scene.chunks, &old.moments.first],
        };
        let curve = self.curve();
        let (spare, statistics) = match &fresh {
            Some(fresh) => (&fresh.sets[3], &fresh.statistics),
            None => (&old.moments.second, &old.statistics),
        };
        // One submission: either all of it is executed or the old set stays.
        self.context.run("densify: gather", |r| {
            r.fill(statistics, 0);
            self.densify.record_scatter_sources(r, old.scene.count, rows, buffers);
            r.barrier();
            let sources = self.densify.record_order(r, (&old.scene, rows), buffers, order, &curve);
            for (set, (from, to)) in sets.iter().zip(targets).enumerate() {
                let from = SceneBuffers { chunks: from.to_vec(), ..old.scene.clone() };
                let to = SceneBuffers { chunks: to.clone(), plan, count: rows };
                let gather = Gather { from: &from, to: &to, sources };
                if set == 0 {
                    self.densify.record_gather_parameters(r, &gather, &key);
                } else {
                    r.barrier();
                    self.densify.record_gather_moments(r, &gather);
                }
            }
            Ok(())
        })?;
        let [parameters, first, second] = targets.map(Clone::clone);
        let (spare, statistics) = (spare.clone(), statistics.clone());
        let scene = SceneBuffers { chunks: parameters, plan, count: rows };
        self.training = Training { scene, moments: Moments { first, second }, spare, statistics };
        Ok(())
    }

    /// Planes for parameters, both moments and the spare set with the given capacity, their statistics, and a
    /// frame. An error if they do not fit the memory. The old planes then still exist. The old frame does
    /// not, and the next step allocates it again.
    fn allocate_fresh(&mut self, capacity: u32) -> Result<Fresh> {
        let plan = ScenePlan::new(self.context.limits(), capacity, self.training.scene.plan.sh_degree)?;
        if !self.present().has_room(&plan) {
            return Err(Error::argument("densification", "the memory does not suffice"));
        }
        let arenas = ["scene", "moments", "moments", "spare"];
        let sets: Result<_> =
            arenas.iter().map(|arena| planes::allocate(&self.context, arena, &plan)).collect();
        let fresh = Fresh { plan, sets: sets?, statistics: allocate_statistics(&self.context, capacity)? };
        self.runner.make_room(capacity)?;
        Ok(fresh)
    }

    /// Lowers all opacities to at most 0.01 and clears their moments.
    pub(super) fn run_opacity_reset(&mut self) -> Result<()> {
        self.context.run("reset opacity", |r| {
            self.densify.record_reset(r, &self.training.scene, &self.training.moments);
            Ok(())
        })?;
        Ok(())
    }
}

/// None if the memory does not suffice; an error if the state of the device is unknown.
fn or_none<T>(result: Result<T>) -> Result<Option<T>> {
    match result {
        Ok(done) => Ok(Some(done)),
        Err(error @ (Error::DeviceLost { .. } | Error::Timeout { .. })) => Err(error),
        Err(Error::Vulkan { call: call @ "vkWaitForFences", result, remedy }) => {
            Err(Error::Vulkan { call, result, remedy })
        }
        Err(_) => Ok(None),
    }
}
