//! Edge-weighted blending importance (Improved-GS): the share of a view's edges that a Gaussian paints.
//!
//! A Gaussian's weight in a view is Σ e α T over its pixels, where e are the photograph's edges from 0 to 1. It equals the
//! gradient of the Gaussian's red, before the clamp of colours, if e is the gradient of the picture's red. So the backward
//! blending computes it, in a variant that adds up nothing else. The importance is the weight, scaled from 0 (smallest of all
//! Gaussians) to 1 (largest), averaged over views.

use crate::error::Result;
use crate::frame::{FrameInputs, FrameVariant, LaunchSizes, RenderSettings, buffer_set};
use crate::kernels::densify::{add_importance, edge_gradient, edge_response, sum_weights};
use crate::passes::backward::Backward;
use crate::passes::pixels::LayoutConverter;
use crate::vk::{Buffer, Context, Kernel, Recorder};

buffer_set! {
    /// Scratch for the importance of one view at a time, for this number of Gaussians and pictures of up to `pixels` pixels.
    pub struct ImportanceBuffers(gaussians: u32, pixels: u64) {}
    /// Per pixel: the photograph, see [`LayoutConverter::record_photo`].
    pub rows as "photo_rows": 4 * pixels;
    /// Per pixel: response of the edge filter, 0 to 255.
    pub responses as "edge_responses": 4 * pixels;
    /// Smallest and largest response and weight: see edges.glsl.
    pub ranges as "importance_ranges": 16;
    /// Per Gaussian: weight in the last view, f32.
    pub weights: 4 * u64::from(gaussians);
}

/// A photograph on the device.
#[derive(Clone, Copy)]
pub struct EdgePhoto<'a> {
    /// Texels, see [`crate::passes::loss::photo_on_device`].
    pub texels: &'a Buffer,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// True if it has masked pixels, which have no edges.
    pub masked: bool,
    /// True for sides where it is cut from a larger photograph: left, top, right, bottom. There it has no edges.
    pub cut_sides: [bool; 4],
}

/// Kernels of the importance.
pub struct Importance {
    sizes: LaunchSizes,
    layout: LayoutConverter,
    backward: Backward,
    response: Kernel<edge_response::Interface>,
    gradient: Kernel<edge_gradient::Interface>,
    sum: Kernel<sum_weights::Interface>,
    add: Kernel<add_importance::Interface>,
}

impl Importance {
    /// Builds the kernels for frames with these settings, but without inverse depth.
    pub fn new(context: &Context, settings: &RenderSettings) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let workgroup_size = sizes.elementwise_workgroup;
        let subgroup_size = context.limits().subgroup_size;
        let mut backward = Backward::new(context);
        // Weights depend on no other property of the frame.
        backward.prepare_weights(FrameVariant { steep: settings.is_steep(), ..FrameVariant::default() })?;
        let sum = sum_weights::Spec { workgroup_size, subgroup_size, ..sum_weights::Spec::default() };
        let strips = sizes.strips;
        Ok(Self {
            layout: LayoutConverter::new(context)?,
            backward,
            response: Kernel::new(context, &edge_response::Spec { workgroup_size, subgroup_size })?,
            gradient: Kernel::new(context, &edge_gradient::Spec { workgroup_size, strips })?,
            sum: Kernel::new(context, &sum)?,
            add: Kernel::new(context, &add_importance::Spec { workgroup_size })?,
            sizes,
        })
    }

    /// Records the edges e of a photograph as the gradient of a picture, dL/dred, in the native layout.
    pub fn record_edges(
        &self,
        r: &mut Recorder,
        photo: &EdgePhoto,
        buffers: &ImportanceBuffers,
        image_gradient: &Buffer,
    ) {
        let (image_width, image_height) = photo.size;
        let groups = self.sizes.groups(u64::from(image_width) * u64::from(image_height));
        r.scope("edges", |r| {
            r.fill(&buffers.ranges, 0);
            self.layout.record_photo(r, photo.size, photo.masked, photo.texels, &buffers.rows);
            r.barrier();
            let bind = edge_response::Bind {
                rows: &buffers.rows,
                responses: &buffers.responses,
                ranges: &buffers.ranges,
            };
            let cut_sides = (0..4).map(|side| u32::from(photo.cut_sides[side]) << side).sum();
            let push =
                edge_response::Push { image_width, image_height, masked: photo.masked.into(), cut_sides };
            r.dispatch(&self.response, &bind, &push, groups);
            r.barrier();
            let bind = edge_gradient::Bind {
                responses: &buffers.responses,
                ranges: &buffers.ranges,
                image_gradient,
            };
            r.dispatch(&self.gradient, &bind, &edge_gradient::Push { image_width, image_height }, groups);
        });
    }

    /// Records the weights of all Gaussians in the frame of the same buffers, from the edges in `image_gradient`. Adds `share`
    /// times their importance in this view to `importance`, f32 per Gaussian. The frame must have backward and no inverse depth,
    /// and `buffers.ranges` must be 0 before the edges. If the frame overflowed, `importance` stays.
    pub fn record_view(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        image_gradient: &Buffer,
        buffers: &ImportanceBuffers,
        importance: &Buffer,
        share: f32,
    ) {
        let (f, count) = (inputs.buffers, inputs.scene().count);
        let groups = self.sizes.groups(count);
        self.backward.record_weights(r, inputs, image_gradient);
        r.scope("importance", |r| {
            r.barrier();
            let splats = f.splats();
            let bind = sum_weights::Bind {
                state: &f.state,
                visible_index: &f.visible_index,
                footprints: splats.footprints,
                first_instances: &f.first_instances,
                instance_gradients_c: &f.instance_gradients_c,
                weights: &buffers.weights,
                ranges: &buffers.ranges,
            };
            let push = sum_weights::Push { count, splat_stride: splats.stride };
            r.dispatch(&self.sum, &bind, &push, groups);
            r.barrier();
            let bind = add_importance::Bind {
                state: &f.state,
                weights: &buffers.weights,
                ranges: &buffers.ranges,
                importance,
            };
            r.dispatch(&self.add, &bind, &add_importance::Push { count, share }, groups);
        });
    }
}
