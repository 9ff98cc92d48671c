//! Draws Gaussians without replacement, in proportion to their chances (Efraimidis and Spirakis 2006): each gets a random key,
//! and the first of the sorted keys are drawn. Random numbers are keyed by (seed, iteration, Gaussian), so the result does not
//! depend on scheduling.

use crate::error::Result;
use crate::frame::{LaunchSizes, SORT_ARRIVAL_BYTES, SceneBuffers, buffer_set};
use crate::kernels::constants as c;
use crate::kernels::densify::{draw_keys, mark_drawn, opacity_keys};
use crate::passes::scan::Workgroups;
use crate::passes::sort::{RadixSort, SortBuffers, Values};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Gaussians that may be drawn: those that any view showed, with a mean statistic of at least `threshold`.
#[derive(Clone, Copy)]
pub struct Candidates<'a> {
    /// vec2 per Gaussian: sum of gradient norms, number of views.
    pub statistics: &'a Buffer,
    /// Minimum mean over the views.
    pub threshold: f32,
}

/// Weights of the draw. A Gaussian without a positive weight is never drawn.
#[derive(Clone, Copy)]
pub enum Chances<'a> {
    /// The given weights, f32 per Gaussian.
    Importance(&'a Buffer),
    /// The mean statistic of [`Candidates`].
    Statistic,
    /// The same weight for all candidates.
    Equal,
}

/// Parameters of a draw.
#[derive(Clone, Copy)]
pub struct UniqueDrawInputs<'a> {
    /// Number of Gaussians.
    pub count: u32,
    /// Number of Gaussians to draw; all candidates if there are fewer.
    pub wanted: u32,
    /// Gaussians that may be drawn.
    pub candidates: Candidates<'a>,
    /// Weights of the draw.
    pub chances: Chances<'a>,
    /// Seed of the run.
    pub seed: u32,
    /// Iteration of the draw.
    pub iteration: u32,
}

buffer_set! {
    /// Scratch and result of a draw among this number of Gaussians.
    pub struct UniqueDrawBuffers(sizes: &LaunchSizes, gaussians: u32) {
        let words = u64::from(gaussians) * 4;
    }
    /// Per Gaussian: 1 if it was drawn, otherwise 0.
    pub selected: words;
    /// Numbers of Gaussians, of candidates with a positive chance, and of drawn Gaussians: TOTAL_* of the constants.
    pub totals as "unique_draw_totals": 16;
    /// Sorting scratch: keys.
    keys_a as "unique_draw_keys_a": words;
    /// Sorting scratch: keys, in turn with the above.
    keys_b as "unique_draw_keys_b": words;
    /// Sorting scratch: Gaussians.
    gaussians_a as "unique_draw_gaussians_a": words;
    /// Sorting scratch: Gaussians, in turn with the above.
    gaussians_b as "unique_draw_gaussians_b": words;
    /// Sorting scratch: counts per digit and block, and per digit and run.
    histogram as "unique_draw_histogram": sizes.sort_histogram_words(gaussians.into(), u32::BITS) * 4;
    /// Sorting scratch: keys per digit.
    digit_totals as "unique_draw_digit_totals": (1 << sizes.sort_digit_bits()) * 4;
    /// Sorting scratch: zeros.
    arrivals as "unique_draw_arrivals": SORT_ARRIVAL_BYTES;
}

impl UniqueDrawBuffers {
    /// Returns one of the totals. Each can be filled in the same step as another.
    fn total(&self, word: u32) -> Buffer {
        self.totals.range(u64::from(word) * 4, 4)
    }

    /// Returns the keys and their Gaussians for the sort.
    fn pairs(&self) -> SortBuffers<'_> {
        SortBuffers {
            counts: &self.totals,
            count_index: c::TOTAL_GAUSSIANS,
            keys: [&self.keys_a, &self.keys_b],
            values: [&self.gaussians_a, &self.gaussians_b],
            histogram: &self.histogram,
            digit_totals: &self.digit_totals,
            arrivals: &self.arrivals,
        }
    }
}

/// Kernels of draws and of sorted opacities.
pub struct UniqueDraw {
    sizes: LaunchSizes,
    sort: RadixSort,
    opacity_keys: Kernel<opacity_keys::Interface>,
    keys: Kernel<draw_keys::Interface>,
    mark: Kernel<mark_drawn::Interface>,
}

impl UniqueDraw {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, subgroup_size) = (sizes.elementwise_workgroup, context.limits().subgroup_size);
        let keys = draw_keys::Spec { workgroup_size, subgroup_size, explicit_uniforms: false };
        Ok(Self {
            sort: RadixSort::new(context)?,
            keys: Kernel::new(context, &keys)?,
            mark: Kernel::new(context, &mark_drawn::Spec { workgroup_size })?,
            opacity_keys: Kernel::new(context, &opacity_keys::Spec { workgroup_size })?,
            sizes,
        })
    }

    /// Records a draw: the `wanted` largest ln(u) / chance. A barrier must precede it; it ends with one.
    pub fn record(&self, r: &mut Recorder, draw: &UniqueDrawInputs, buffers: &UniqueDrawBuffers) {
        let UniqueDrawInputs { count, candidates, chances, .. } = *draw;
        let groups = self.sizes.groups(count);
        r.scope("select", |r| {
            r.fill(&buffers.total(c::TOTAL_GAUSSIANS), count);
            r.fill(&buffers.arrivals, 0);
            r.fill(&buffers.totals.range(u64::from(c::TOTAL_CANDIDATES) * 4, 3 * 4), 0);
            r.barrier();
            let (chances, importance) = match chances {
                Chances::Importance(importance) => (c::CHANCE_IMPORTANCE, importance),
                Chances::Statistic => (c::CHANCE_STATISTIC, candidates.statistics),
                Chances::Equal => (c::CHANCE_EQUAL, candidates.statistics),
            };
            let bind = draw_keys::Bind {
                statistics: candidates.statistics,
                importance,
                // Only the kernel's form with explicit numbers reads this binding.
                uniforms: candidates.statistics,
                keys: &buffers.keys_a,
                selected: &buffers.selected,
                totals: &buffers.totals,
            };
            let push = draw_keys::Push {
                count,
                threshold: candidates.threshold,
                chances,
                seed: draw.seed,
                iteration: draw.iteration,
            };
            r.dispatch(&self.keys, &bind, &push, groups);
            r.barrier();
            let elements = Workgroups::Elements(count.into());
            let end = self.sort.record(r, &buffers.pairs(), Values::Positions, u32::BITS, elements);
            r.barrier();
            let bind = mark_drawn::Bind {
                sorted: buffers.pairs().values[end],
                totals: &buffers.totals,
                selected: &buffers.selected,
            };
            r.dispatch(&self.mark, &bind, &mark_drawn::Push { count, wanted: draw.wanted }, groups);
            r.barrier();
        });
    }

    /// Records a sort of all opacities, for pruning the faintest share of a set. A barrier must precede it; it ends with one.
    /// Returns the buffer with the result: f32 per Gaussian, the faintest first.
    pub fn record_opacities<'a>(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        buffers: &'a UniqueDrawBuffers,
    ) -> &'a Buffer {
        r.scope("order opacities", |r| {
            r.fill(&buffers.total(c::TOTAL_GAUSSIANS), scene.count);
            r.fill(&buffers.arrivals, 0);
            scene.record_chunks(r, |r, range, parameters| {
                let bind = opacity_keys::Bind { parameters, keys: &buffers.keys_a };
                let push = opacity_keys::Push { first: range.first, count: range.count };
                r.dispatch(&self.opacity_keys, &bind, &push, self.sizes.groups(range.count));
            });
            r.barrier();
            let elements = Workgroups::Elements(scene.count.into());
            let end = self.sort.record(r, &buffers.pairs(), Values::Positions, u32::BITS, elements);
            r.barrier();
            buffers.pairs().keys[end]
        })
    }
}
