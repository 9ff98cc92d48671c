//! Relocation and growth of 3DGS-MCMC (Kheradmand et al. 2024, section 4): Gaussians are drawn in proportion to their opacity,
//! and each shares its place with its copies.

use super::RandomKey;
use crate::error::Result;
use crate::frame::{LaunchSizes, SceneBuffers, blocks, buffer_set};
use crate::kernels::constants::RELOCATION_LEAST_OPACITY;
use crate::kernels::densify::{draw_sources, draw_weights, relocate};
use crate::kernels::optimizer::add_noise;
use crate::passes::adam::Moments;
use crate::passes::scan::{Scan, ScanBuffers, Workgroups};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Largest weight of a Gaussian: the last integer up to which f32 counts in steps of one.
const MAX_WEIGHT: u32 = 1 << 24;

buffer_set! {
    /// Scratch of a draw, for up to `gaussians` before and `rows` after.
    pub struct DrawBuffers(sizes: &LaunchSizes, gaussians: u32, rows: u32) {}
    /// Weight of each Gaussian.
    pub weights as "draw_weights": u64::from(gaussians) * 4;
    /// Sum of the weights before each Gaussian.
    pub prefix as "draw_prefix": u64::from(gaussians) * 4;
    /// Number of draws of each Gaussian.
    pub draws: u64::from(gaussians) * 4;
    /// Number of Gaussians, sum of the weights, number of sorted rows.
    pub totals as "draw_totals": 16;
    /// Scratch of the prefix sum.
    pub block_sums as "draw_block_sums": blocks(gaussians.into(), sizes.scan_block.into()) * 4;
    /// Source of each row of the new set.
    pub sources: u64::from(rows) * 4;
}

impl DrawBuffers {
    const COUNT: u32 = 0;
    const TOTAL: u32 = 1;
}

/// A draw of the sources of a new set.
#[derive(Clone, Copy)]
pub struct Draw {
    /// Number of rows of the new set, at least that of the old one.
    pub rows: u32,
    /// True if Gaussians with an opacity of at most 0.005 are replaced.
    pub replaces_dead: bool,
    /// Seed of the run.
    pub seed: u32,
    /// Iteration of the draw.
    pub iteration: u32,
}

/// Kernels of relocation and noise.
pub struct Relocation {
    sizes: LaunchSizes,
    scan: Scan,
    weights: Kernel<draw_weights::Interface>,
    draw: Kernel<draw_sources::Interface>,
    relocate: Kernel<relocate::Interface>,
    noise: Kernel<add_noise::Interface>,
}

impl Relocation {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let workgroup_size = sizes.elementwise_workgroup;
        let draw = draw_sources::Spec { workgroup_size, explicit_uniforms: false };
        let noise = add_noise::Spec { workgroup_size, explicit_noise: false };
        Ok(Self {
            sizes,
            scan: Scan::new(context)?,
            weights: Kernel::new(context, &draw_weights::Spec { workgroup_size })?,
            draw: Kernel::new(context, &draw)?,
            relocate: Kernel::new(context, &relocate::Spec { workgroup_size })?,
            noise: Kernel::new(context, &noise)?,
        })
    }

    /// Records a draw into `buffers.sources` and `buffers.draws`. Ends with a barrier.
    pub fn record_draw(&self, r: &mut Recorder, scene: &SceneBuffers, draw: &Draw, buffers: &DrawBuffers) {
        let count = scene.count;
        r.scope("draw", |r| {
            r.fill(&buffers.totals, count);
            scene.record_chunks(r, |r, range, parameters| {
                let bind =
                    draw_weights::Bind { parameters, weights: &buffers.weights, draws: &buffers.draws };
                let push = draw_weights::Push {
                    first: range.first,
                    count: range.count,
                    unit: (u32::MAX / count.max(1)).min(MAX_WEIGHT) as f32,
                    least_opacity: if draw.replaces_dead { RELOCATION_LEAST_OPACITY } else { -1.0 },
                };
                r.dispatch(&self.weights, &bind, &push, self.sizes.groups(range.count));
            });
            r.barrier();
            let scan = ScanBuffers {
                counts: &buffers.totals,
                count_index: DrawBuffers::COUNT,
                total_index: DrawBuffers::TOTAL,
                values: &buffers.weights,
                prefix: &buffers.prefix,
                block_sums: &buffers.block_sums,
            };
            self.scan.record(r, &scan, Workgroups::Elements(count.into()));
            r.barrier();
            let bind = draw_sources::Bind {
                weights: &buffers.weights,
                prefix: &buffers.prefix,
                totals: &buffers.totals,
                // Only the kernel's form with explicit numbers reads this binding.
                uniforms: &buffers.weights,
                sources: &buffers.sources,
                draws: &buffers.draws,
            };
            let push = draw_sources::Push {
                count,
                rows: draw.rows,
                seed: draw.seed,
                iteration: draw.iteration,
                stream: if draw.replaces_dead { 2 } else { 3 },
            };
            r.dispatch(&self.draw, &bind, &push, self.sizes.groups(draw.rows));
            r.barrier();
        });
    }

    /// Records the new opacities and scales of the drawn Gaussians and their copies in the new set, and clears
    /// their moments.
    pub fn record_relocate(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        moments: &Moments,
        sources: &Buffer,
        draws: &Buffer,
    ) {
        r.scope("relocate", |r| {
            for range in scene.plan.ranges(scene.count) {
                let [moments_1, moments_2] = moments.chunk(range.chunk);
                let bind = relocate::Bind {
                    sources,
                    draws,
                    parameters: &scene.chunks[range.chunk],
                    moments_1,
                    moments_2,
                };
                let push = relocate::Push {
                    first: range.first,
                    count: range.count,
                    chunk_gaussians: scene.plan.chunk_gaussians,
                    planes: moments.plan.planes,
                    packed_moments: moments.packed.into(),
                };
                r.dispatch(&self.relocate, &bind, &push, self.sizes.groups(range.count));
            }
        });
    }

    /// Records the noise of an iteration. `state`: [`FrameBuffers::state`](crate::frame::FrameBuffers) of the scene's frame.
    /// `rate`: learning rate of the means (world units) times that of the noise.
    pub fn record_noise(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        state: &Buffer,
        key: &RandomKey,
        rate: f32,
    ) {
        let RandomKey { seed, iteration } = *key;
        r.scope("noise", |r| {
            for range in scene.plan.ranges(scene.count) {
                // Only the kernel's form with explicit noise reads that binding.
                let bind = add_noise::Bind { parameters: &scene.chunks[range.chunk], state, noise: state };
                let push = add_noise::Push { first: range.first, count: range.count, seed, iteration, rate };
                r.dispatch(&self.noise, &bind, &push, self.sizes.groups(range.count));
            }
        });
    }
}
