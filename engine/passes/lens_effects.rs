//! Vignetting and response of the cameras, learned with the Gaussians: one of each per camera and channel.
//!
//! The loss compares a photograph with the rendered picture, under its [exposure](crate::passes::exposure) if that is learned. The
//! picture passes through the [`LensEffects`](crate::scene::LensEffects) of the photograph's camera. Parameters and moments are
//! laid out like those of exposures, and have the same Adam.

use crate::error::Result;
use crate::frame::{FrameInputs, LaunchSizes};
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::exposure::{lens_backward, lens_effects};
use crate::passes::exposure::{LightBuffers, LightForm, LightOptimizer, LightStep};
use crate::scene::LensPlane;
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Names and bytes of the [`LightBuffers`] of lenses, for photographs of these sizes (width, height). There is at most one lens
/// per photograph.
pub fn requests(sizes: &[(u32, u32)]) -> [(&'static str, u64); LightBuffers::COUNT] {
    let names =
        ["lenses", "lens_moments_1", "lens_moments_2", "shaded_picture", "lens_partials", "lens_means"];
    LightBuffers::named_requests(names, sizes)
}

/// Lens of a photograph, and the picture in front of it.
#[derive(Clone, Copy)]
pub struct LensInputs<'a> {
    /// Frame with backward.
    pub frame: &'a FrameInputs<'a>,
    /// Rendered or exposed picture, in the native layout.
    pub picture: &'a Buffer,
    /// Buffers of the lenses.
    pub buffers: &'a LightBuffers,
    /// Index of the lens.
    pub lens: u32,
}

/// Kernels of lens effects.
pub struct Lenses {
    sizes: LaunchSizes,
    forward: Kernel<lens_effects::Interface>,
    backward: Kernel<lens_backward::Interface>,
    step: LightOptimizer,
}

impl Lenses {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let subgroup_size = context.limits().subgroup_size;
        let backward = lens_backward::Spec { workgroup_size, subgroup_size, strips };
        Ok(Self {
            forward: Kernel::new(context, &lens_effects::Spec { workgroup_size, strips })?,
            backward: Kernel::new(context, &backward)?,
            step: LightOptimizer::new(context, LightForm::default())?,
            sizes,
        })
    }

    /// Records the picture behind the lens, into [`LightBuffers::picture`]. The caller places barriers before and after.
    pub fn record(&self, r: &mut Recorder, inputs: &LensInputs) {
        let LensInputs { frame, picture, buffers, lens } = *inputs;
        let bind =
            lens_effects::Bind { rendered: picture, lenses: &buffers.values, shaded: &buffers.picture };
        let LensPlane { center_px, inverse_square, .. } = LensPlane::of(frame.camera);
        let (width, height) = (frame.camera.width, frame.camera.height);
        let background = frame.settings.background;
        let push = lens_effects::Push {
            image_width: width,
            image_height: height,
            background,
            lens,
            center_px,
            inverse_square,
        };
        let groups = self.sizes.picture_groups(width, height);
        r.scope("lens effects", |r| r.dispatch(&self.forward, &bind, &push, groups));
    }

    /// Records the backward pass. It converts `image_gradient`, in the native layout, from that of the picture behind the lens
    /// to that of the picture in front of it. It also writes partial sums of the lens's gradient. The caller places barriers
    /// before and after.
    pub fn record_backward(&self, r: &mut Recorder, inputs: &LensInputs, image_gradient: &Buffer) {
        let LensInputs { frame, picture, buffers, lens } = *inputs;
        let bind = lens_backward::Bind {
            rendered: picture,
            lenses: &buffers.values,
            image_gradient,
            partials: &buffers.partials,
        };
        let LensPlane { center_px, inverse_square, .. } = LensPlane::of(frame.camera);
        let push = lens_backward::Push {
            image_width: frame.camera.width,
            image_height: frame.camera.height,
            background: frame.settings.background,
            lens,
            center_px,
            inverse_square,
        };
        r.scope("lens backward", |r| r.dispatch(&self.backward, &bind, &push, TERM_PARTIALS.into()));
    }

    /// Same as [`Exposing::record_step`](crate::passes::exposure::Exposing::record_step), for the lens of [`Lenses::record_backward`].
    pub fn record_step(&self, r: &mut Recorder, of: (&LightBuffers, &Buffer), lens: u32, step: &LightStep) {
        r.scope("lens step", |r| self.step.record(r, of, lens, step));
    }
}
