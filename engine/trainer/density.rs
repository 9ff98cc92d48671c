//! Densification and the opacity reset of a training run.

use super::{Densified, Trainer, Training, allocate_statistics};
use crate::densify::{DensifyBuffers, DensifySettings, Gather, RandomKey};
use crate::error::Result;
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
        let allocated = self.context.allocate("densify", &requests, MemoryKind::Device)?;
        let Ok([decisions, blocks, totals, sources]) = <[Buffer; 4]>::try_from(allocated) else {
            unreachable!("one buffer per request")
        };
        let buffers = DensifyBuffers { decisions, blocks, totals, sources };
        self.context.run("densify: decide", |r| {
            let Training { scene, statistics, .. } = &self.training;
            self.densify.record_decide(r, scene, statistics, &buffers, &settings);
            Ok(())
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&self.context.download(&buffers.totals)?);
        let densified = Densified { before, kept: totals[0], cloned: totals[1], split: totals[2] };
        let rows = densified.kept + densified.cloned + 2 * densified.split;
        self.gather(rows, &buffers, iteration)?;
        Ok(densified)
    }

    /// Fills new planes with `rows` Gaussians and their moments.
    fn gather(&mut self, rows: u32, buffers: &DensifyBuffers, iteration: u32) -> Result<()> {
        let old = &self.training;
        let key = RandomKey { seed: self.settings.seed, iteration, explicit: None };
        let (plan, fresh) = if rows <= old.scene.plan.capacity {
            (old.scene.plan, None)
        } else {
            // Without room to grow further, if that does not fit beside the old planes.
            let fresh =
                self.allocate_fresh(rows.saturating_add(rows / 2)).or_else(|_| self.allocate_fresh(rows))?;
            (fresh.plan, Some(fresh))
        };
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

    /// Planes for parameters, both moments and the spare set of up to `capacity` Gaussians, and their statistics.
    fn allocate_fresh(&self, capacity: u32) -> Result<Fresh> {
        let plan = ScenePlan::new(self.context.limits(), capacity, self.training.scene.plan.sh_degree)?;
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
