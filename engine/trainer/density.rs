//! Densification and the opacity reset of a training run.

use super::{Densified, Trainer, Training, allocate_statistics, budget};
use crate::densify::{DensifyBuffers, DensifySettings, Gather, RandomKey};
use crate::error::{Error, Result};
use crate::forward::SceneBuffers;
use crate::optimizer::Moments;
use crate::plan::{Blocks, ScenePlan};
use crate::planes;
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
    /// Decides, makes room, and gathers the new set.
    pub(super) fn run_densification(&mut self, iteration: u32) -> Result<Densified> {
        let s = &self.settings;
        let extent = f64::from(self.scene_extent);
        let settings = DensifySettings {
            gradient_threshold: s.densify_grad_threshold as f32,
            clone_scale: (s.percent_dense * extent) as f32,
            min_opacity: s.min_opacity as f32,
            max_scale: if s.prunes_large_at(iteration) { (LARGE_SCALE_SHARE * extent) as f32 } else { 0.0 },
        };
        let sizes = Blocks::new(self.context.limits());
        let before = self.training.scene.count;
        // At most two rows per Gaussian: one stays and one is cloned, or it is split into two.
        let requests = DensifyBuffers::requests(&sizes, before, before.saturating_mul(2));
        let allocated = match self.context.allocate("densify", &requests, MemoryKind::Device) {
            // Without memory to decide in, all stay as they are.
            Err(Error::TooLarge { .. }) => {
                return Ok(Densified { before, kept: before, limited: true, ..Densified::default() });
            }
            allocated => allocated?,
        };
        let Ok([decisions, blocks, totals, sources]) = <[Buffer; 4]>::try_from(allocated) else {
            unreachable!("one buffer per request")
        };
        let buffers = DensifyBuffers { decisions, blocks, totals, sources };
        let densified = self.decide(&buffers, &settings)?;
        let rows = densified.kept + densified.cloned + 2 * densified.split;
        if rows <= self.training.scene.plan.capacity {
            self.gather(rows, None, &buffers, iteration)?;
            return Ok(densified);
        }
        // Without room to grow further, if that does not fit beside the old planes.
        let fresh = match self.allocate_fresh(budget::grown_capacity(&self.context, rows)) {
            Ok(fresh) => Ok(fresh),
            Err(_) => self.allocate_fresh(rows),
        };
        match fresh {
            Ok(fresh) => {
                self.gather(rows, Some(fresh), &buffers, iteration)?;
                Ok(densified)
            }
            Err(Error::DeviceLost { call }) => Err(Error::DeviceLost { call }),
            // Those that are there go on without new ones.
            Err(_) => {
                let none = DensifySettings { gradient_threshold: f32::INFINITY, ..settings };
                let densified = self.decide(&buffers, &none)?;
                self.gather(densified.kept, None, &buffers, iteration)?;
                Ok(Densified { limited: true, ..densified })
            }
        }
    }

    fn decide(&self, buffers: &DensifyBuffers, settings: &DensifySettings) -> Result<Densified> {
        self.context.run("densify: decide", |r| {
            let Training { scene, statistics, .. } = &self.training;
            self.densify.record_decide(r, scene, statistics, buffers, settings);
            Ok(())
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&self.context.download(&buffers.totals)?);
        let before = self.training.scene.count;
        Ok(Densified { before, kept: totals[0], cloned: totals[1], split: totals[2], limited: false })
    }

    /// Fills new planes with `rows` Gaussians and their moments: fresh ones, or those at hand.
    fn gather(
        &mut self,
        rows: u32,
        fresh: Option<Fresh>,
        buffers: &DensifyBuffers,
        iteration: u32,
    ) -> Result<()> {
        let old = &self.training;
        let key = RandomKey { seed: self.settings.seed, iteration, explicit: None };
        let plan = fresh.as_ref().map_or(old.scene.plan, |fresh| fresh.plan);
        // Without growth the four sets of planes rotate: each is gathered into the one that was freed before it.
        let sources = [&old.scene.chunks, &old.moments.first, &old.moments.second];
        let targets: [&Vec<Buffer>; 3] = match &fresh {
            Some(fresh) => [&fresh.sets[0], &fresh.sets[1], &fresh.sets[2]],
            None => [&old.spare, &old.scene.chunks, &old.moments.first],
        };
        let (spare, statistics) = match &fresh {
            Some(fresh) => (&fresh.sets[3], &fresh.statistics),
            None => (&old.moments.second, &old.statistics),
        };
        // One submission: either all of it comes to pass or the old set stays.
        self.context.run("densify: gather", |r| {
            r.fill(statistics, 0);
            self.densify.record_place(r, old.scene.count, rows, buffers);
            r.barrier();
            for (set, (from, to)) in sources.iter().zip(targets).enumerate() {
                let from = SceneBuffers { chunks: from.to_vec(), ..old.scene.clone() };
                let to = SceneBuffers { chunks: to.clone(), plan, count: rows };
                let gather = Gather { from: &from, to: &to, sources: &buffers.sources };
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

    /// Planes for parameters, both moments and the spare set of up to `capacity` Gaussians, and their statistics; an
    /// error where they, or a frame of as many Gaussians, do not fit the memory.
    fn allocate_fresh(&self, capacity: u32) -> Result<Fresh> {
        let old = &self.training.scene.plan;
        let plan = ScenePlan::new(self.context.limits(), capacity, old.sh_degree)?;
        if !budget::has_room(&self.context, &plan, old, &self.runner.capacity()) {
            return Err(Error::argument("densification", "the memory does not suffice"));
        }
        let arenas = ["scene", "moments", "moments", "spare"];
        let sets: Result<_> =
            arenas.iter().map(|arena| planes::allocate(&self.context, arena, &plan)).collect();
        Ok(Fresh { plan, sets: sets?, statistics: allocate_statistics(&self.context, capacity)? })
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
