//! Adaptive density control, entirely on the device: classify, prefix sum, scatter sources, gather; and the opacity reset.
//!
//! The new set has the reference's order: first the Gaussians that stay, then the clones, then the first and the second halves
//! of split Gaussians. Training then sorts it along a space-filling curve ([`Densify::record_order`]). Random numbers are keyed
//! by (seed, iteration, Gaussian, half), so the result does not depend on scheduling.

use crate::error::Result;
use crate::frame::{GaussianRange, LaunchSizes, SORT_ARRIVAL_BYTES, SceneBuffers, buffer_set};
use crate::kernels::constants::{
    GATHER_COPIES, GATHER_LOG_SCALE, GATHER_MEAN_OPACITY, GATHER_MOMENTS, GATHER_PLACES, PLANE_LOG_SCALE,
    PLANE_MEAN_OPACITY, ZORDER_BITS,
};
use crate::kernels::densify::{classify, gather, mask_outside, reset_opacity, scatter_sources, zorder};
use crate::passes::adam::Moments;
use crate::passes::scan::{Scan, Workgroups};
use crate::passes::sort::{RadixSort, SortBuffers, Values};
use crate::scene::{Bounds, Cut, CutLimits};
use crate::vk::{Buffer, Context, Kernel, Recorder};
use glam::Vec3;
pub use importance::{EdgePhoto, Importance, ImportanceBuffers};
pub use relocation::{Draw, DrawBuffers, Relocation};
pub use unique_draw::{Candidates, Chances, UniqueDraw, UniqueDrawBuffers, UniqueDrawInputs};

mod importance;
mod relocation;
mod unique_draw;

/// Largest opacity after the reset.
pub const RESET_OPACITY: f64 = 0.01;

/// Forms of the densification kernels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DensifyForm {
    /// True if Gaussians are split along their longest axis (long_axis.glsl).
    pub long_axis: bool,
    /// True if a selection decides what is split, in place of the mean norm of the gradient. No Gaussian is then cloned.
    pub selected: bool,
}

/// Thresholds of a densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensifySettings {
    /// Mean norm of the 2D mean's gradient, NDC, from which a Gaussian is cloned or split.
    pub gradient_threshold: f32,
    /// Largest scale of a cloned Gaussian; larger ones are split. World units.
    pub clone_scale: f32,
    /// Opacity below which a Gaussian is removed.
    pub min_opacity: f32,
    /// Scale above which a Gaussian is removed, world units; 0 for no limit.
    pub max_scale: f32,
}

buffer_set! {
    /// Scratch of a densification of up to `gaussians` before and `rows` after.
    pub struct DensifyBuffers(sizes: &LaunchSizes, gaussians: u32, rows: u32) {}
    /// Per Gaussian: decision bits.
    pub decisions: u64::from(gaussians) * 4;
    /// Per block of Gaussians, three counts, then offsets.
    pub blocks as "densify_blocks": sizes.groups(gaussians) * 12;
    /// Number of Gaussians that stay, are cloned, are split; number of sorted rows.
    pub totals as "densify_totals": 16;
    /// Per row of the new set: its source.
    pub sources: u64::from(rows) * 4;
}

impl DensifyBuffers {
    /// Index in `totals` of the number of sorted rows.
    const ROWS: u64 = 3;
}

/// Key of the random numbers of a densification or of noise.
#[derive(Clone, Copy)]
pub struct RandomKey {
    /// Seed of the run.
    pub seed: u32,
    /// Iteration of the densification.
    pub iteration: u32,
}

/// Rows to copy from one set of planes to another.
#[derive(Clone, Copy)]
pub struct Gather<'a> {
    /// Old planes and their layout.
    pub from: &'a SceneBuffers,
    /// New planes and their layout; `count` rows are written.
    pub to: &'a SceneBuffers,
    /// Source of each row.
    pub sources: &'a Buffer,
    /// One plane per chunk for a set that changes in place; empty for a new set.
    pub scratch: &'a [Buffer],
}

/// Inputs of [`Densify::record_classify`].
#[derive(Clone, Copy)]
pub struct ClassifyInputs<'a> {
    /// vec2 per Gaussian: sum of gradient norms, number of views.
    pub statistics: &'a Buffer,
    /// u32 per Gaussian with [`DensifyForm::selected`]: nonzero for a split.
    pub selected: Option<&'a Buffer>,
}

/// The kernels of densification.
pub struct Densify {
    form: DensifyForm,
    sizes: LaunchSizes,
    scan: Scan,
    classify: Kernel<classify::Interface>,
    scatter_sources: Kernel<scatter_sources::Interface>,
    gather: Kernel<gather::Interface>,
    reset: Kernel<reset_opacity::Interface>,
    zorder: Kernel<zorder::Interface>,
    sort: RadixSort,
}

impl Densify {
    /// Builds the kernels.
    pub fn new(context: &Context, form: DensifyForm) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, subgroup_size) = (sizes.elementwise_workgroup, context.limits().subgroup_size);
        let long_axis = form.long_axis;
        let gather = gather::Spec { workgroup_size, explicit_noise: false, long_axis };
        let classify = classify::Spec { workgroup_size, subgroup_size, long_axis, selected: form.selected };
        Ok(Self {
            form,
            sizes,
            scan: Scan::new(context)?,
            classify: Kernel::new(context, &classify)?,
            scatter_sources: Kernel::new(context, &scatter_sources::Spec { workgroup_size, subgroup_size })?,
            gather: Kernel::new(context, &gather)?,
            reset: Kernel::new(context, &reset_opacity::Spec { workgroup_size })?,
            zorder: Kernel::new(context, &zorder::Spec { workgroup_size })?,
            sort: RadixSort::new(context)?,
        })
    }

    /// Records the classification: the decisions, and in `buffers.totals` the numbers of Gaussians that
    /// stay, are cloned and are split.
    ///
    /// # Panics
    /// If the selection is missing although the kernels were built for one, or the reverse.
    pub fn record_classify(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        inputs: ClassifyInputs,
        buffers: &DensifyBuffers,
        settings: &DensifySettings,
    ) {
        let ClassifyInputs { statistics, selected } = inputs;
        assert_eq!(selected.is_some(), self.form.selected, "the form that it was built for");
        let all_blocks = scene.count.div_ceil(self.sizes.elementwise_workgroup);
        r.scope("classify", |r| {
            scene.record_chunks(r, |r, range, parameters| {
                let bind = classify::Bind {
                    parameters,
                    statistics,
                    decisions: &buffers.decisions,
                    block_counts: &buffers.blocks,
                    selected: selected.unwrap_or(statistics),
                };
                let push = classify::Push {
                    first: range.first,
                    count: range.count,
                    blocks: all_blocks,
                    gradient_threshold: settings.gradient_threshold,
                    clone_scale: settings.clone_scale,
                    min_opacity: settings.min_opacity,
                    max_scale: settings.max_scale,
                };
                r.dispatch(&self.classify, &bind, &push, self.sizes.groups(range.count));
            });
            // Three rows of one buffer. Each row is one dispatch, because their offsets may break the device's alignment.
            for decision in 0..3 {
                r.barrier();
                let first = decision * all_blocks;
                self.scan.record_block_sums(r, &buffers.blocks, first, all_blocks, &buffers.totals, decision);
            }
        });
    }

    /// Records the source of each row of the new set, at most `rows` rows.
    pub fn record_scatter_sources(&self, r: &mut Recorder, count: u32, rows: u32, buffers: &DensifyBuffers) {
        let all_blocks = count.div_ceil(self.sizes.elementwise_workgroup);
        r.dispatch(
            &self.scatter_sources,
            &scatter_sources::Bind {
                decisions: &buffers.decisions,
                block_offsets: &buffers.blocks,
                totals: &buffers.totals,
                sources: &buffers.sources,
            },
            &scatter_sources::Push { count, blocks: all_blocks, capacity: rows },
            all_blocks.into(),
        );
    }

    /// Records the new rows of the parameters, with random means of split Gaussians. Ends with a barrier.
    pub fn record_gather_parameters(&self, r: &mut Recorder, rows: &Gather, key: &RandomKey) {
        self.record_gather(r, key, rows, GATHER_MEAN_OPACITY, PLANE_MEAN_OPACITY);
        self.record_gather(r, key, rows, GATHER_LOG_SCALE, PLANE_LOG_SCALE);
        let changed = [PLANE_MEAN_OPACITY, PLANE_LOG_SCALE];
        for plane in (0..rows.from.plan.planes).filter(|plane| !changed.contains(plane)) {
            self.record_gather(r, key, rows, GATHER_COPIES, plane);
        }
    }

    /// Records the new rows of a set of moments, which are zero for new Gaussians. Ends with a barrier.
    pub fn record_gather_moments(&self, r: &mut Recorder, rows: &Gather) {
        let key = RandomKey { seed: 0, iteration: 0 };
        for plane in 0..rows.from.plan.planes {
            self.record_gather(r, &key, rows, GATHER_MOMENTS, plane);
        }
    }

    fn record_gather(&self, r: &mut Recorder, key: &RandomKey, rows: &Gather, form: u32, plane: u32) {
        let Gather { from, to, sources, scratch } = *rows;
        let to_place = to.plan.plane_place(plane);
        let push = |from: (GaussianRange, [u32; 3]), to: (GaussianRange, [u32; 3]), form| gather::Push {
            from_first: from.0.first,
            from_count: from.0.count,
            to_first: to.0.first,
            to_count: to.0.count,
            from_place: from.1,
            to_place: to.1,
            form,
            noise_stride: 0,
            seed: key.seed,
            iteration: key.iteration,
        };
        // Scratch has one plane.
        let target_place = if scratch.is_empty() { to_place } else { [0, 1, 0] };
        let targets = if scratch.is_empty() { &to.chunks } else { scratch };
        for target in to.plan.ranges(to.count) {
            for source in from.plan.ranges(from.count) {
                if source.chunk > 0 {
                    r.barrier();
                }
                let (from_chunk, target_chunk) = (&from.chunks[source.chunk], &targets[target.chunk]);
                // Only the kernel's form with explicit noise reads that binding.
                let bind = gather::Bind { sources, from: from_chunk, to: target_chunk, noise: sources };
                let push = push((source, from.plan.plane_place(plane)), (target, target_place), form);
                r.dispatch(&self.gather, &bind, &push, self.sizes.groups(target.count));
            }
        }
        r.barrier();
        if scratch.is_empty() {
            return;
        }
        for target in to.plan.ranges(to.count) {
            let (from, to) = (&scratch[target.chunk], &to.chunks[target.chunk]);
            let bind = gather::Bind { sources, from, to, noise: sources };
            let push = push((target, target_place), (target, to_place), GATHER_PLACES);
            r.dispatch(&self.gather, &bind, &push, self.sizes.groups(target.count));
        }
        r.barrier();
    }

    /// Records an opacity reset: opacities above `max_opacity` become `max_opacity`, between 0 and 1.
    pub fn record_reset(&self, r: &mut Recorder, scene: &SceneBuffers, moments: &Moments, max_opacity: f64) {
        let max_logit = (max_opacity / (1.0 - max_opacity)).ln() as f32;
        r.scope("reset opacity", |r| {
            for range in scene.plan.ranges(scene.count) {
                let [moments_1, moments_2] = moments.chunk(range.chunk);
                let bind =
                    reset_opacity::Bind { parameters: &scene.chunks[range.chunk], moments_1, moments_2 };
                let push = reset_opacity::Push {
                    count: range.count,
                    max_opacity: max_opacity as f32,
                    max_logit,
                    packed_moments: moments.packed.into(),
                };
                r.dispatch(&self.reset, &bind, &push, self.sizes.groups(range.count));
            }
        });
    }
}

/// Frame of the curve: see zorder.comp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// Mean position of the cameras, world.
    pub center: Vec3,
    /// Extent of the scene, world units; positive.
    pub extent: f32,
}

buffer_set! {
    /// Scratch of the sort of `rows` rows along a curve.
    pub struct OrderBuffers(sizes: &LaunchSizes, rows: u32) {}
    /// Position of each row on the curve; sorting scratch.
    pub keys_a as "zorder_keys_a": u64::from(rows) * 4;
    /// Sorting scratch: keys.
    pub keys_b as "zorder_keys_b": u64::from(rows) * 4;
    /// Like [`DensifyBuffers::sources`].
    pub sources as "ordered_sources": u64::from(rows) * 4;
    /// Sorting scratch: counts per digit and block, and per digit and run.
    pub histogram as "zorder_histogram": sizes.sort_histogram_words(rows.into(), ZORDER_BITS) * 4;
    /// Sorting scratch: keys per digit.
    pub digit_totals as "zorder_digit_totals": (1 << sizes.sort_digit_bits()) * 4;
    /// Sorting scratch: zeros.
    pub arrivals as "zorder_arrivals": SORT_ARRIVAL_BYTES;
}

/// Rows of a new set to sort along a curve.
#[derive(Clone, Copy)]
pub struct OrderInputs<'a, 'b> {
    /// Old set, to which the sources refer.
    pub scene: &'b SceneBuffers,
    /// Number of rows.
    pub rows: u32,
    /// Source of each row; scratch of the sort.
    pub sources: &'a Buffer,
    /// Buffer whose fourth word is scratch.
    pub totals: &'b Buffer,
    /// The curve.
    pub curve: Curve,
}

impl Densify {
    /// Records the sort of the sources and returns the buffer with the result. A barrier must precede it; it ends with one. Rows in
    /// the same cell of the curve keep their order.
    pub fn record_order<'a>(
        &self,
        r: &mut Recorder,
        inputs: &OrderInputs<'a, '_>,
        order: &'a OrderBuffers,
    ) -> &'a Buffer {
        let OrderInputs { scene, rows, totals, curve, .. } = *inputs;
        let sources = [inputs.sources, &order.sources];
        r.scope("order", |r| {
            r.fill(&totals.range(DensifyBuffers::ROWS * 4, 4), rows);
            r.fill(&order.arrivals, 0);
            scene.record_chunks(r, |r, range, parameters| {
                let bind = zorder::Bind { sources: sources[0], parameters, keys: &order.keys_a };
                let push = zorder::Push {
                    first: range.first,
                    count: range.count,
                    rows,
                    center: curve.center.to_array(),
                    extent: curve.extent,
                };
                r.dispatch(&self.zorder, &bind, &push, self.sizes.groups(rows));
            });
            r.barrier();
            let pairs = SortBuffers {
                counts: totals,
                count_index: DensifyBuffers::ROWS as u32,
                keys: [&order.keys_a, &order.keys_b],
                values: sources,
                histogram: &order.histogram,
                digit_totals: &order.digit_totals,
                arrivals: &order.arrivals,
            };
            let elements = Workgroups::Elements(rows.into());
            let end = self.sort.record(r, &pairs, Values::Given, ZORDER_BITS, elements);
            r.barrier();
            sources[end]
        })
    }
}

/// Kernel that masks statistics outside a box.
pub struct MaskOutside {
    sizes: LaunchSizes,
    mask: Kernel<mask_outside::Interface>,
    core: CutLimits,
}

impl MaskOutside {
    /// Builds the kernel for a box, whose sides may be infinite.
    pub fn new(context: &Context, core: Bounds) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let mask = mask_outside::Spec { workgroup_size: sizes.elementwise_workgroup };
        let core = Cut { bounds: Some(core), ..Cut::default() }.limits();
        Ok(Self { mask: Kernel::new(context, &mask)?, sizes, core })
    }

    /// Records the mask, which sets the sums of Gaussians with means outside the box below every threshold. The sums lie in
    /// `statistics` (vec2 per Gaussian: sum of norms, number of views).
    pub fn record(&self, r: &mut Recorder, scene: &SceneBuffers, statistics: &Buffer) {
        scene.record_chunks(r, |r, range, parameters| {
            let bind = mask_outside::Bind { parameters, statistics };
            let push = mask_outside::Push {
                first: range.first,
                count: range.count,
                core_low: self.core.low.to_array(),
                core_high: self.core.high.to_array(),
            };
            r.dispatch(&self.mask, &bind, &push, self.sizes.groups(range.count));
        });
    }
}
