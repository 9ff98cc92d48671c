//! Exposures of the photographs and effects of the cameras' lenses, learned with the Gaussians: a 3×4 matrix for each
//! photograph (the reference implementation's) or lens.
//!
//! The loss compares a photograph with the rendered picture under the photograph's [`Exposure`], and behind its lens
//! ([`LensEffects`](crate::scene::LensEffects)). So the Gaussians do not absorb a camera's automatic exposure, white balance,
//! vignetting and response. A separate Adam treats the matrices of all photographs, or lenses, as one tensor.

use crate::error::Result;
use crate::frame::{FrameInputs, LaunchSizes, Strips, array_of};
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::exposure::{expose, expose_backward, exposure_step};
use crate::passes::adam::{BETA_1, BETA_2};
use crate::scene::{Exposure, LensPlane};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Three rows of an exposure, or of lens effects.
pub(crate) type Matrix = [[f32; 4]; 3];

/// Bytes of a matrix.
const MATRIX_BYTES: u64 = size_of::<Matrix>() as u64;

/// Form of the optimiser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct AppearanceForm {
    /// True if each step brings the mean of all matrices back to the identity. Otherwise scene and exposures could drift
    /// against each other.
    pub center: bool,
    /// True if all photographs share the second moments.
    pub shares: bool,
    /// True if steps have a [`AppearanceStep::sparsity`].
    pub sparse: bool,
}

/// A step of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AppearanceStep {
    /// Learning rate.
    pub rate: f64,
    /// Number of steps including this one, counted from 1.
    pub count: u64,
    /// Factor of each value that adds to its gradient and pulls it to 0. Spares the diagonal of centred exposures.
    pub decay: f64,
    /// Distance by which a step brings a matrix closer to the identity, as a share of the rate. It decreases with the matrix's
    /// distance (root of the sum of squares) and is 0 from 0.05 on. Photographs without a clear change stay as they are: the
    /// minimax concave penalty (Zhang 2010).
    pub sparsity: f64,
}

/// Matrices, moments and scratch memory on the device.
pub(crate) struct AppearanceBuffers {
    pub values: Buffer,
    /// Adam's moments, laid out like the matrices.
    pub first_moments: Buffer,
    pub second_moments: Buffer,
    /// Resulting picture, laid out like the rendered one.
    pub picture: Buffer,
    /// Partial sums of a matrix's gradient.
    partials: Buffer,
}

impl AppearanceBuffers {
    /// Number of [`AppearancePass::requests`].
    pub const COUNT: usize = 5;

    /// Assigns the buffers that were allocated for [`AppearancePass::requests`].
    pub fn from_allocated(buffers: Vec<Buffer>) -> Self {
        let [values, first_moments, second_moments, picture, partials] = array_of(buffers);
        Self { values, first_moments, second_moments, picture, partials }
    }

    /// Number of matrices.
    pub fn count(&self) -> usize {
        (self.values.bytes() / MATRIX_BYTES) as usize
    }
}

/// A matrix, and the picture that it changes.
#[derive(Clone, Copy)]
pub(crate) struct AppearancePassInputs<'a> {
    /// Frame with backward.
    pub frame: &'a FrameInputs<'a>,
    /// Rendered or exposed picture, in the native layout.
    pub picture: &'a Buffer,
    pub buffers: &'a AppearanceBuffers,
    /// Index of the matrix.
    pub index: u32,
}

/// Kernels of exposures, or of lens effects.
pub(crate) struct AppearancePass {
    sizes: LaunchSizes,
    /// True for lens effects.
    pub is_lens_effects: bool,
    forward: Kernel<expose::Interface>,
    backward: Kernel<expose_backward::Interface>,
    step: Kernel<exposure_step::Interface>,
}

impl AppearancePass {
    /// Builds the kernels.
    pub fn new(context: &Context, lens: bool, form: AppearanceForm) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let subgroup_size = context.limits().subgroup_size;
        let AppearanceForm { center, shares, sparse } = form;
        let backward = expose_backward::Spec { workgroup_size, subgroup_size, strips, lens };
        let step = exposure_step::Spec { workgroup_size, subgroup_size, center, shares, sparse };
        Ok(Self {
            is_lens_effects: lens,
            forward: Kernel::new(context, &expose::Spec { workgroup_size, strips, lens })?,
            backward: Kernel::new(context, &backward)?,
            step: Kernel::new(context, &step)?,
            sizes,
        })
    }

    /// The matrix that changes nothing.
    pub fn identity(&self) -> Matrix {
        if self.is_lens_effects { [[0.0; 4]; 3] } else { Exposure::IDENTITY.rows }
    }

    /// Names and bytes of the buffers, for photographs of these sizes (width, height). There is at most one lens per
    /// photograph.
    pub fn requests(&self, sizes: &[(u32, u32)]) -> [(&'static str, u64); AppearanceBuffers::COUNT] {
        let [values, moments_1, moments_2, picture_name, partials] = match self.is_lens_effects {
            true => ["lenses", "lens_moments_1", "lens_moments_2", "shaded_picture", "lens_partials"],
            false => [
                "exposures",
                "exposure_moments_1",
                "exposure_moments_2",
                "exposed_picture",
                "exposure_partials",
            ],
        };
        let matrices = MATRIX_BYTES * sizes.len() as u64;
        // Strips have at least as many values as the picture has pixels.
        let picture = |&(width, height): &(u32, u32)| 16 * Strips { width, height }.values();
        [
            (values, matrices),
            (moments_1, matrices),
            (moments_2, matrices),
            (picture_name, sizes.iter().map(picture).max().unwrap_or(0)),
            (partials, MATRIX_BYTES * u64::from(TERM_PARTIALS)),
        ]
    }

    /// Records the changed picture, into [`AppearanceBuffers::picture`].
    pub fn record(&self, r: &mut Recorder, inputs: &AppearancePassInputs) {
        let AppearancePassInputs { frame, picture: rendered, buffers, index } = *inputs;
        let (image_width, image_height) = (frame.camera.width, frame.camera.height);
        let LensPlane { center_px, inverse_square, .. } = LensPlane::of(frame.camera);
        let bind = expose::Bind { rendered, matrices: &buffers.values, exposed: &buffers.picture };
        let push = expose::Push {
            image_width,
            image_height,
            background: frame.settings.background,
            matrix: index,
            center_px,
            inverse_square,
        };
        let scope = if self.is_lens_effects { "lens effects" } else { "exposure" };
        let groups = self.sizes.picture_groups(image_width, image_height);
        r.scope(scope, |r| r.dispatch(&self.forward, &bind, &push, groups));
    }

    /// Records the backward pass. It converts `image_gradient`, in the native layout, from that of the changed picture to that
    /// of the picture before. It also writes partial sums of the matrix's gradient.
    pub fn record_backward(&self, r: &mut Recorder, inputs: &AppearancePassInputs, image_gradient: &Buffer) {
        let AppearancePassInputs { frame, picture: rendered, buffers, index } = *inputs;
        let LensPlane { center_px, inverse_square, .. } = LensPlane::of(frame.camera);
        let (matrices, partials) = (&buffers.values, &buffers.partials);
        let bind = expose_backward::Bind { rendered, matrices, image_gradient, partials };
        let push = expose_backward::Push {
            image_width: frame.camera.width,
            image_height: frame.camera.height,
            background: frame.settings.background,
            matrix: index,
            center_px,
            inverse_square,
        };
        let scope = if self.is_lens_effects { "lens backward" } else { "exposure backward" };
        r.scope(scope, |r| r.dispatch(&self.backward, &bind, &push, TERM_PARTIALS.into()));
    }

    /// Records a step of the optimiser over all matrices. That of `inputs` has the gradient of [`AppearancePass::record_backward`]. If
    /// the frame overflowed, nothing changes.
    pub fn record_step(&self, r: &mut Recorder, inputs: &AppearancePassInputs, step: &AppearanceStep) {
        let AppearancePassInputs { frame, buffers, index, .. } = *inputs;
        let correction = |beta: f64| 1.0 - beta.powf(step.count as f64);
        let bind = exposure_step::Bind {
            partials: &buffers.partials,
            state: &frame.buffers.state,
            exposures: &buffers.values,
            moments_1: &buffers.first_moments,
            moments_2: &buffers.second_moments,
        };
        let push = exposure_step::Push {
            photographs: buffers.count() as u32,
            view: index,
            rate: (step.rate / correction(BETA_1)) as f32,
            inverse_bias_2: correction(BETA_2).sqrt().recip() as f32,
            decay: step.decay as f32,
            sparsity: step.sparsity as f32,
        };
        let scope = if self.is_lens_effects { "lens step" } else { "exposure step" };
        r.scope(scope, |r| r.dispatch(&self.step, &bind, &push, 1));
    }
}
