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

/// Scales above this share of the scene's extent are pruned, once opacities have been reset (reference).
const LARGE_SCALE_SHARE: f64 = 0.1;

/// Planes and statistics for a set that has outgrown its own.
struct Fresh {
    plan: ScenePlan,
    sets: Vec<Vec<Buffer>>,
    statistics: Buffer,
}

impl Trainer {
    /// Decides, makes room, and gathers the new set. Where there is no room for all that the settings ask for, those with
    /// the largest gradients are added.
    pub(super) fn run_densification(&mut self, iteration: u32) -> Result<Densified> {
        let settings = self.densify_settings(iteration);
        let before = self.training.scene.count;
        self.pictures.release();
        let unchanged = Densified { before, kept: before, limited: true, ..Densified::default() };
        let Some(buffers) = self.decision_buffers()? else { return Ok(unchanged) };
        let wanted = self.classify(&buffers, &settings)?;
        let most = self.present().most_rows_by_instances(before, self.most_instances);
        let rows = wanted.rows().min(most);
        // Before there are two sets of planes. No other order in its place: the bits would go by what else takes memory.
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

    /// What deciding takes; None without memory for it: then all stay as they are.
    fn decision_buffers(&self) -> Result<Option<DensifyBuffers>> {
        let sizes = LaunchSizes::new(self.context.limits());
        let before = self.training.scene.count;
        // At most two rows per Gaussian: one stays and one is cloned, or it is split into two.
        let requests = DensifyBuffers::requests(&sizes, before, before.saturating_mul(2));
        let buffers = or_none(self.context.allocate("densify", &requests, MemoryKind::Device))?;
        Ok(buffers.map(DensifyBuffers::from_allocated))
    }

    /// What sorting so many rows along the curve takes; None without memory for it: then all stay as they are.
    fn order_buffers(&self, rows: u32) -> Result<Option<OrderBuffers>> {
        let requests = OrderBuffers::requests(&LaunchSizes::new(self.context.limits()), rows);
        let buffers = or_none(self.context.allocate("densify", &requests, MemoryKind::Device))?;
        Ok(buffers.map(OrderBuffers::from_allocated))
    }

    fn curve(&self) -> Curve {
        let middle = middle(self.cameras.iter().map(Camera::position)).unwrap_or_default();
        Curve { center: middle.as_vec3(), extent: self.scene_extent }
    }

    /// Planes, and a frame, for so many rows: with half as many again, with none to spare, or with as many as the memory
    /// has room for, if that is worth moving. None: there is no room to grow.
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
        // Also for views that have not been seen yet.
        let (width, height) = budget::largest_sides(&self.cameras);
        budget::Present {
            context: &self.context,
            plan: &self.training.scene.plan,
            frame: FrameCapacity { width: frame.width.max(width), height: frame.height.max(height), ..frame },
            frame_bytes: self.runner.frame_bytes(),
        }
    }

    /// Decides for the Gaussians with the largest gradients, as many as there is room for: by the threshold that lets them
    /// through, which is found by bisection. The room is at least that of those that are there.
    fn decide_within(
        &self,
        buffers: &DensifyBuffers,
        settings: &DensifySettings,
        room: u32,
    ) -> Result<Densified> {
        const ROUNDS: u32 = 24;
        // Numbers from 0 to infinity, which lets none through, have the order of their bits.
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

    /// Fills new planes with `rows` Gaussians and their moments: fresh ones, or those at hand.
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
        // Without growth the four sets of planes rotate: each is gathered into the one that was freed before it.
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
        // One submission: either all of it comes to pass or the old set stays.
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

    /// Planes for parameters, both moments and the spare set of up to `capacity` Gaussians, their statistics, and a frame for
    /// as many; an error where they do not fit the memory. What there was before is still there, but for the frame, which
    /// the next step makes anew.
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

    /// Lowers all opacities to 0.01 at most and forgets their moments.
    pub(super) fn run_opacity_reset(&mut self) -> Result<()> {
        self.context.run("reset opacity", |r| {
            self.densify.record_reset(r, &self.training.scene, &self.training.moments);
            Ok(())
        })?;
        Ok(())
    }
}

/// None where there was no room; an error where nobody knows what the device does.
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
