//! Depths of sparse points as a loss term (gsplat, `depth_loss` of its `simple_trainer.py`).

use crate::error::Result;
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::loss::{sparse_depth, sparse_depth_gather, term_reduce};
use crate::loss::{LossTerm, PixelLayout, Targets, TermInputs};
use crate::plan::{LaunchSizes, blocks};
use crate::trainer::settings::TrainSettings;
use crate::vk::{Context, Kernel, Recorder};

/// Mean of |1/Z - 1/z| over a view's sparse points, times [`TrainSettings::depth_points`], the scene's extent, and a decay. The
/// decay is log-linear from 1 to a hundredth over the run. Z is the expected depth at the point, bilinear: Σ w z / Σ w with the
/// blending weights w. z is the depth of the point. 0 for views without points. Reports the mean difference, 1 / world units.
pub struct SparseDepth {
    points: Kernel<sparse_depth::Interface>,
    gather: Kernel<sparse_depth_gather::Interface>,
    reduce: Kernel<term_reduce::Interface>,
    settings: TrainSettings,
    scene_extent: f32,
    sizes: LaunchSizes,
    most_points: u32,
}

impl SparseDepth {
    /// Builds the kernels for views of at most `most_points` points.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(
        context: &Context,
        settings: &TrainSettings,
        scene_extent: f32,
        most_points: u32,
    ) -> Result<Self> {
        let subgroup_size = context.limits().subgroup_size;
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        Ok(Self {
            points: Kernel::new(context, &sparse_depth::Spec { workgroup_size, subgroup_size })?,
            gather: Kernel::new(context, &sparse_depth_gather::Spec { workgroup_size, strips })?,
            reduce: Kernel::new(context, &term_reduce::Spec { workgroup_size, subgroup_size })?,
            settings: settings.clone(),
            scene_extent,
            sizes,
            most_points,
        })
    }
}

impl LossTerm for SparseDepth {
    fn name(&self) -> &'static str {
        "sparse_depth"
    }

    fn targets(&self) -> Targets {
        let picture = Some(PixelLayout::Native);
        Targets { picture, inverse_depth: true, linear_depth: true, ..Targets::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        vec![
            ("sparse_depth_partials", u64::from(TERM_PARTIALS) * 8),
            ("sparse_depth_gradients", u64::from(self.most_points.max(1)) * 4),
        ]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let ([partials, sample_gradients], frame) = (inputs.scratch, inputs.frame) else {
            panic!("two scratch buffers of the sparse depths");
        };
        let Some(view) = inputs.depth_points else {
            return r.fill(&inputs.losses.range(16 * u64::from(inputs.row), 16), 0);
        };
        let share = frame.camera.share_of_whole();
        let weight =
            share * self.settings.depth_points_weight(inputs.iteration) * f64::from(self.scene_extent);
        let (image_width, image_height) = (frame.camera.width, frame.camera.height);
        let (accumulated, depth_sums) = (&frame.frame.accumulated, &frame.frame.inverse_depth);
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
            let push = term_reduce::Push {
                row: inputs.row,
                values: [view.count as f32, 1.0],
                weights: [weight as f32, 0.0],
            };
            r.dispatch(&self.reduce, &term_reduce::Bind { partials, losses: inputs.losses }, &push, 1);
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
            let workgroups = blocks(view.pixel_count.into(), self.sizes.elementwise_workgroup.into());
            r.dispatch(&self.gather, &bind, &push, workgroups);
        });
    }
}
