//! Loss terms that the settings can add to the photometric one.

use super::settings::TrainSettings;
use crate::error::Result;
use crate::frame::{LaunchSizes, blocks};
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::loss::{
    inverse_depth_l1, regularize, sparse_depth, sparse_depth_gather, surface_alignment, surface_depth,
    surface_planarity, term_reduce,
};
use crate::passes::loss::{LossTerm, TermData, TermInputs};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Returns the terms with a weight above 0.
pub(super) fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Vec<Box<dyn LossTerm>>> {
    let mut terms: Vec<Box<dyn LossTerm>> = Vec::new();
    let (opacity, scale) = (settings.opacity_reg, settings.scale_reg);
    if opacity > 0.0 || scale > 0.0 {
        terms.push(Box::new(Regularizers::new(context, opacity, scale)?));
    }
    if settings.surface {
        terms.push(Box::new(Surface::new(context, settings)?));
    }
    Ok(terms)
}

/// Adds the partial sums of a term's kernel.
struct PartialSums(Kernel<term_reduce::Interface>);

impl PartialSums {
    /// Bytes of the buffer of partial sums.
    const BYTES: u64 = TERM_PARTIALS as u64 * 8;

    fn new(context: &Context) -> Result<Self> {
        let (workgroup_size, subgroup_size) = group_sizes(context);
        Ok(Self(Kernel::new(context, &term_reduce::Spec { workgroup_size, subgroup_size })?))
    }

    /// Records the term's row of losses: both sums, divided by `values` and weighted.
    fn record(
        &self,
        r: &mut Recorder,
        inputs: &TermInputs,
        partials: &Buffer,
        values: [f32; 2],
        weights: [f32; 2],
    ) {
        let push = term_reduce::Push { row: inputs.row, values, weights };
        r.dispatch(&self.0, &term_reduce::Bind { partials, losses: inputs.losses }, &push, 1);
    }
}

/// Invocations of a workgroup and of a subgroup.
fn group_sizes(context: &Context) -> (u32, u32) {
    (LaunchSizes::new(context.limits()).elementwise_workgroup, context.limits().subgroup_size)
}

/// Records a row of losses that is 0, for a view without the term's data.
fn record_none(r: &mut Recorder, inputs: &TermInputs) {
    r.fill(&inputs.losses.range(16 * u64::from(inputs.row), 16), 0);
}

/// The reference implementation's depth regularisation (gaussian-splatting, since October 2024): mean difference of the rendered
/// inverse depth (the sum of weights / z) from a view's map, times a weight that falls log-linearly over the run. 0 for views
/// without a map. Reports the mean difference.
pub struct InverseDepth {
    difference: Kernel<inverse_depth_l1::Interface>,
    sums: PartialSums,
    settings: TrainSettings,
}

impl InverseDepth {
    /// Builds the kernels. The weights are [`TrainSettings::depth_l1_weight`].
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let (workgroup_size, subgroup_size) = group_sizes(context);
        let strips = LaunchSizes::new(context.limits()).strips;
        let spec = inverse_depth_l1::Spec { workgroup_size, subgroup_size, strips };
        let (difference, sums) = (Kernel::new(context, &spec)?, PartialSums::new(context)?);
        Ok(Self { difference, sums, settings: settings.clone() })
    }
}

impl LossTerm for InverseDepth {
    fn name(&self) -> &'static str {
        "inverse_depth"
    }

    fn data(&self) -> TermData {
        TermData { picture: true, inverse_depth: true, ..TermData::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        vec![("inverse_depth_partials", PartialSums::BYTES)]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let ([partials], frame) = (inputs.scratch, inputs.frame) else {
            panic!("one scratch buffer of the inverse depth");
        };
        let Some(target_map) = inputs.inverse_depth_map else { return record_none(r, inputs) };
        let (image_width, image_height) = (frame.camera.width, frame.camera.height);
        let pixels = f64::from(image_width) * f64::from(image_height);
        let weight = frame.camera.share_of_whole() * self.settings.depth_l1_weight(inputs.iteration);
        r.scope("inverse depth", |r| {
            let bind = inverse_depth_l1::Bind {
                inverse_depth: &frame.buffers.depth_sums,
                target_map,
                image_gradient: inputs.image_gradient,
                partials,
            };
            let weight_of_pixel = (weight / pixels) as f32;
            let push = inverse_depth_l1::Push { image_width, image_height, weight: weight_of_pixel };
            r.dispatch(&self.difference, &bind, &push, TERM_PARTIALS.into());
            r.barrier();
            self.sums.record(r, inputs, partials, [pixels as f32, 1.0], [weight as f32, 0.0]);
        });
    }
}

/// Opacity and scale regularisers (3DGS-MCMC, Kheradmand et al. 2024, section 4): `opacity` times the mean opacity plus `scale`
/// times the mean scale (world units), over all Gaussians, also those out of view. Sparse Adam moves only the visible ones.
/// Reports both means.
pub struct Regularizers {
    regularize: Kernel<regularize::Interface>,
    sums: PartialSums,
    opacity: f64,
    scale: f64,
}

impl Regularizers {
    /// Builds the kernels. `opacity` and `scale` are the weights.
    pub fn new(context: &Context, opacity: f64, scale: f64) -> Result<Self> {
        let (workgroup_size, subgroup_size) = group_sizes(context);
        let regularize = Kernel::new(context, &regularize::Spec { workgroup_size, subgroup_size })?;
        Ok(Self { regularize, sums: PartialSums::new(context)?, opacity, scale })
    }
}

impl LossTerm for Regularizers {
    fn name(&self) -> &'static str {
        "regularizers"
    }

    fn data(&self) -> TermData {
        TermData { parameters: true, ..TermData::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        vec![("regularizer_partials", PartialSums::BYTES)]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let (scene, [partials]) = (inputs.frame.scene(), inputs.scratch) else {
            panic!("one scratch buffer of the regularisers");
        };
        let count = f64::from(scene.count.max(1));
        r.scope("regularizers", |r| {
            for range in scene.plan.ranges(scene.count) {
                if range.chunk > 0 {
                    r.barrier();
                }
                let bind = regularize::Bind {
                    parameters: &scene.chunks[range.chunk],
                    parameter_gradients: &inputs.parameter_gradients[range.chunk],
                    partials,
                };
                let push = regularize::Push {
                    count: range.count,
                    continues: u32::from(range.chunk > 0),
                    opacity_weight: (self.opacity / count) as f32,
                    scale_weight: (self.scale / (3.0 * count)) as f32,
                };
                r.dispatch(&self.regularize, &bind, &push, TERM_PARTIALS.into());
            }
            r.barrier();
            let values = [scene.count as f32, 3.0 * scene.count as f32];
            self.sums.record(r, inputs, partials, values, [self.opacity as f32, self.scale as f32]);
        });
    }
}

/// Depths of sparse points (gsplat, `depth_loss` of its `simple_trainer.py`): mean of |1/Z - 1/z| over a view's points, times
/// [`TrainSettings::depth_points`], the scene's extent, and a decay. The decay is log-linear from 1 to a hundredth over the run.
/// Z is the expected depth at the point, bilinear: Σ w z / Σ w with the blending weights w. z is the depth of the point. 0 for
/// views without points. Reports the mean difference, 1 / world units.
pub struct SparseDepth {
    points: Kernel<sparse_depth::Interface>,
    gather: Kernel<sparse_depth_gather::Interface>,
    sums: PartialSums,
    settings: TrainSettings,
    scene_extent: f32,
    workgroup_size: u32,
    max_points: u32,
}

impl SparseDepth {
    /// Builds the kernels for views of at most `max_points` points.
    pub fn new(
        context: &Context,
        settings: &TrainSettings,
        scene_extent: f32,
        max_points: u32,
    ) -> Result<Self> {
        let (workgroup_size, subgroup_size) = group_sizes(context);
        let strips = LaunchSizes::new(context.limits()).strips;
        Ok(Self {
            points: Kernel::new(context, &sparse_depth::Spec { workgroup_size, subgroup_size })?,
            gather: Kernel::new(context, &sparse_depth_gather::Spec { workgroup_size, strips })?,
            sums: PartialSums::new(context)?,
            settings: settings.clone(),
            scene_extent,
            workgroup_size,
            max_points,
        })
    }
}

impl LossTerm for SparseDepth {
    fn name(&self) -> &'static str {
        "sparse_depth"
    }

    fn data(&self) -> TermData {
        TermData { picture: true, inverse_depth: true, linear_depth: true, ..TermData::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        vec![
            ("sparse_depth_partials", PartialSums::BYTES),
            ("sparse_depth_gradients", u64::from(self.max_points.max(1)) * 4),
        ]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let ([partials, sample_gradients], frame) = (inputs.scratch, inputs.frame) else {
            panic!("two scratch buffers of the sparse depths");
        };
        let Some(view) = inputs.depth_points else { return record_none(r, inputs) };
        let share = frame.camera.share_of_whole();
        let weight =
            share * self.settings.depth_points_weight(inputs.iteration) * f64::from(self.scene_extent);
        let (image_width, image_height) = (frame.camera.width, frame.camera.height);
        let (accumulated, depth_sums) = (&frame.buffers.accumulated, &frame.buffers.depth_sums);
        r.scope("sparse depth", |r| {
            let bind = sparse_depth::Bind {
                points: &view.points,
                accumulated,
                depth_sums,
                sample_gradients,
                partials,
            };
            let push = sparse_depth::Push {
                image_width,
                image_height,
                count: view.count,
                weight: (weight / f64::from(view.count)) as f32,
            };
            r.dispatch(&self.points, &bind, &push, TERM_PARTIALS.into());
            r.barrier();
            self.sums.record(r, inputs, partials, [view.count as f32, 1.0], [weight as f32, 0.0]);
            let bind = sparse_depth_gather::Bind {
                points: &view.points,
                pixels: &view.pixels,
                entries: &view.entries,
                sample_gradients,
                accumulated,
                depth_sums,
                image_gradient: inputs.image_gradient,
            };
            let push = sparse_depth_gather::Push { image_width, image_height, count: view.pixel_count };
            let workgroups = blocks(view.pixel_count.into(), self.workgroup_size.into());
            r.dispatch(&self.gather, &bind, &push, workgroups);
        });
    }
}

/// Shapes the scene like surfaces: the rendered inverse depth becomes linear over the picture but for edges, and the visible
/// Gaussians turn to it and flatten (surface_planarity.comp, surface_alignment.comp). Takes part in the second and third quarter
/// of a run, because it needs a coarse scene first. Its weights fall linearly to 0, because the photographs decide about the
/// last details. Pinholes only. Pixels that a mask hides take part, too. Reports the mean bend of the picture; the weighted
/// value is without the alignment's.
pub struct Surface {
    depth: Kernel<surface_depth::Interface>,
    planarity: Kernel<surface_planarity::Interface>,
    alignment: Kernel<surface_alignment::Interface>,
    sums: PartialSums,
    sizes: LaunchSizes,
    iterations: u32,
}

impl Surface {
    /// Name of the term.
    pub const NAME: &'static str = "surface";
    /// Weights of the planarity, and of a pixel's share of the alignment, where they are largest: chosen on the demo's scene, for
    /// the best normals and depths within 0.3 dB of PSNR.
    const PLANARITY: f32 = 0.04;
    const TURN: f32 = 0.04;
    const FLATTEN: f32 = 0.024;

    /// Builds the kernels.
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let (workgroup_size, subgroup_size) = group_sizes(context);
        let sizes = LaunchSizes::new(context.limits());
        let planarity = surface_planarity::Spec { workgroup_size, subgroup_size, strips: sizes.strips };
        Ok(Self {
            depth: Kernel::new(context, &surface_depth::Spec { workgroup_size })?,
            planarity: Kernel::new(context, &planarity)?,
            alignment: Kernel::new(context, &surface_alignment::Spec { workgroup_size })?,
            sums: PartialSums::new(context)?,
            sizes,
            iterations: settings.iterations,
        })
    }
}

impl LossTerm for Surface {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn data(&self) -> TermData {
        TermData { picture: true, inverse_depth: true, parameters: true, ..TermData::default() }
    }

    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        let pixels = sizes.iter().map(|&(width, height)| u64::from(width) * u64::from(height));
        vec![("surface_partials", PartialSums::BYTES), ("surface_depths", 4 * pixels.max().unwrap_or(1))]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let ([partials, surface_depths], frame) = (inputs.scratch, inputs.frame) else {
            panic!("two scratch buffers of the surface");
        };
        let quarter = self.iterations / 4;
        if !(quarter..3 * quarter).contains(&inputs.iteration) {
            return record_none(r, inputs);
        }
        let (f, splats) = (frame.buffers, frame.buffers.splats());
        let (image_width, image_height) = (frame.camera.width, frame.camera.height);
        let pixels = image_width * image_height;
        let share = frame.camera.share_of_whole() as f32;
        let fade = (3 * quarter - inputs.iteration) as f32 / (2 * quarter) as f32;
        let weight = fade * share * Self::PLANARITY;
        let of_pixel = fade * share / pixels as f32;
        // Gaussians are wider than pixels, so differences over several pixels count, too.
        let stride_px = 1 << (inputs.iteration % 3);
        r.scope("surface", |r| {
            let bind = surface_depth::Bind {
                accumulated: &f.accumulated,
                depth_sums: &f.depth_sums,
                surface_depths,
            };
            let groups = self.sizes.groups(pixels);
            r.dispatch(&self.depth, &bind, &surface_depth::Push { pixels }, groups);
            r.barrier();
            let bind = surface_planarity::Bind {
                accumulated: &f.accumulated,
                surface_depths,
                image_gradient: inputs.image_gradient,
                partials,
            };
            let push = surface_planarity::Push {
                image_width,
                image_height,
                stride_px,
                weight: Self::PLANARITY * of_pixel,
            };
            r.dispatch(&self.planarity, &bind, &push, TERM_PARTIALS.into());
            frame.scene().record_chunks(r, |r, range, parameters| {
                let bind = surface_alignment::Bind {
                    parameters,
                    visible_ranges: &f.visible_ranges,
                    visible_list: &f.visible_list,
                    mean2d_extent: splats.mean2d_extent,
                    conic_opacity: splats.conic_opacity,
                    surface_depths,
                    parameter_gradients: &inputs.parameter_gradients[range.chunk],
                    camera_block: &f.camera_block(0),
                };
                let push = surface_alignment::Push {
                    first: range.first,
                    splat_stride: splats.stride,
                    stride_px: stride_px.min(2),
                    turn: Self::TURN * of_pixel,
                    flatten: Self::FLATTEN * of_pixel,
                };
                let at = f.range_arguments(&self.sizes, range.first);
                r.dispatch_indirect(&self.alignment, &bind, &push, &at);
            });
            r.barrier();
            self.sums.record(r, inputs, partials, [pixels as f32, 1.0], [weight, 0.0]);
        });
    }
}
