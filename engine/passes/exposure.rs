//! Exposures of the photographs, learned with the Gaussians: the reference implementation's 3×4 matrix per image.
//!
//! The loss compares a photograph with the rendered picture under the photograph's [`Exposure`](crate::scene::Exposure), so
//! that the Gaussians do not absorb a camera's automatic exposure and white balance. A separate Adam treats the matrices of all
//! photographs as one tensor.

use crate::error::{Error, Result};
use crate::frame::{FrameInputs, LaunchSizes, Strips};
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::exposure::{expose, expose_backward, exposure_step};
use crate::passes::adam::{BETA_1, BETA_2};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Adam's ε for exposures in the reference (the default of PyTorch).
pub const EPSILON: f64 = 1e-8;
/// Bytes of a matrix.
const MATRIX_BYTES: u64 = 48;

/// Form of the optimiser of exposures, or of [lenses](crate::passes::lens_effects).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightForm {
    /// True if each step brings the mean of all matrices back to the identity. Otherwise scene and exposures could drift
    /// against each other.
    pub center: bool,
    /// True if all photographs share the second moments.
    pub shares: bool,
    /// True if steps have a [`LightStep::sparsity`].
    pub sparse: bool,
}

/// A step of the optimiser of exposures, or of [lenses](crate::passes::lens_effects).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightStep {
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

/// Matrices, moments and scratch memory of photographs, or of [lenses](crate::passes::lens_effects), on the device. A matrix is three
/// rows of vec4.
pub struct LightBuffers {
    /// A matrix per photograph or lens.
    pub values: Buffer,
    /// Adam's first moments, laid out like the matrices.
    pub first_moments: Buffer,
    /// Adam's second moments.
    pub second_moments: Buffer,
    /// Resulting picture, laid out like the rendered one.
    pub picture: Buffer,
    /// Partial sums of a matrix's gradient.
    pub partials: Buffer,
    /// Means of the matrices over several steps ([`Averaging`](crate::passes::adam::Averaging)).
    pub means: Buffer,
}

impl LightBuffers {
    /// Number of [`LightBuffers::requests`].
    pub const COUNT: usize = 6;

    /// Names and bytes of the buffers of exposures, for photographs of these sizes (width, height).
    pub fn requests(sizes: &[(u32, u32)]) -> [(&'static str, u64); Self::COUNT] {
        let names = [
            "exposures",
            "exposure_moments_1",
            "exposure_moments_2",
            "exposed_picture",
            "exposure_partials",
            "exposure_means",
        ];
        Self::named_requests(names, sizes)
    }

    /// Same as [`LightBuffers::requests`], but with other names.
    pub(crate) fn named_requests(
        names: [&'static str; Self::COUNT],
        sizes: &[(u32, u32)],
    ) -> [(&'static str, u64); Self::COUNT] {
        let [values, moments_1, moments_2, picture_name, partials, means] = names;
        let matrices = MATRIX_BYTES * sizes.len() as u64;
        // Strips have at least as many values as the picture has pixels.
        let picture = |&(width, height): &(u32, u32)| 16 * Strips { width, height }.values();
        [
            (values, matrices),
            (moments_1, matrices),
            (moments_2, matrices),
            (picture_name, sizes.iter().map(picture).max().unwrap_or(0)),
            (partials, MATRIX_BYTES * u64::from(TERM_PARTIALS)),
            (means, matrices),
        ]
    }

    /// Assigns the buffers, in the order of [`LightBuffers::requests`].
    pub fn from_allocated(buffers: [Buffer; Self::COUNT]) -> Self {
        let [values, first_moments, second_moments, picture, partials, means] = buffers;
        Self { values, first_moments, second_moments, picture, partials, means }
    }

    /// Number of photographs or lenses.
    pub fn photographs(&self) -> usize {
        (self.values.bytes() / MATRIX_BYTES) as usize
    }

    /// Sets all matrices to the given one, and all moments to zero.
    pub fn reset(&self, context: &Context, matrix: [[f32; 4]; 3]) -> Result<()> {
        let (all, none) = (vec![matrix; self.photographs()], vec![[[0.0; 4]; 3]; self.photographs()]);
        self.upload(context, [&all, &none, &none])
    }

    /// Uploads matrices and both moments.
    ///
    /// # Errors
    /// [`Error::Argument`] when their number differs from that of the photographs; when the device is lost.
    pub fn upload(&self, context: &Context, from: [&[[[f32; 4]; 3]]; 3]) -> Result<()> {
        let buffers = [&self.values, &self.first_moments, &self.second_moments];
        let mut all = buffers.into_iter().zip(from);
        all.try_for_each(|(buffer, rows)| self.fill(context, buffer, rows, "exposures"))
    }

    /// Uploads the means.
    ///
    /// # Errors
    /// Same as [`LightBuffers::upload`].
    pub fn upload_means(&self, context: &Context, means: &[[[f32; 4]; 3]]) -> Result<()> {
        self.fill(context, &self.means, means, "means of exposures")
    }

    fn fill(&self, context: &Context, buffer: &Buffer, rows: &[[[f32; 4]; 3]], what: &str) -> Result<()> {
        if rows.len() != self.photographs() {
            let problem = format!("are {}, for {} photographs", rows.len(), self.photographs());
            return Err(Error::argument(what, problem));
        }
        context.upload(buffer, bytemuck::cast_slice(rows))
    }

    /// Downloads the means.
    pub fn download_means(&self, context: &Context) -> Result<Vec<[[f32; 4]; 3]>> {
        Ok(bytemuck::pod_collect_to_vec(&context.download(&self.means)?))
    }

    /// Downloads matrices and both moments.
    pub fn download(&self, context: &Context) -> Result<[Vec<[[f32; 4]; 3]>; 3]> {
        let rows = |buffer: &Buffer| Ok(bytemuck::pod_collect_to_vec(&context.download(buffer)?));
        Ok([rows(&self.values)?, rows(&self.first_moments)?, rows(&self.second_moments)?])
    }
}

/// Kernels of exposures.
pub struct Exposing {
    sizes: LaunchSizes,
    expose: Kernel<expose::Interface>,
    backward: Kernel<expose_backward::Interface>,
    step: LightOptimizer,
}

impl Exposing {
    /// Builds the kernels.
    pub fn new(context: &Context, form: LightForm) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let subgroup_size = context.limits().subgroup_size;
        let backward = expose_backward::Spec { workgroup_size, subgroup_size, strips };
        Ok(Self {
            expose: Kernel::new(context, &expose::Spec { workgroup_size, strips })?,
            backward: Kernel::new(context, &backward)?,
            step: LightOptimizer::new(context, form)?,
            sizes,
        })
    }

    /// Records the exposed picture of a frame, for a photograph's index. The frame must have backward. The caller places
    /// barriers before and after.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, buffers: &LightBuffers, view: u32) {
        let (width, height) = (inputs.camera.width, inputs.camera.height);
        let bind = expose::Bind {
            rendered: inputs.frame.rendered(&self.sizes),
            exposures: &buffers.values,
            exposed: &buffers.picture,
        };
        let background = inputs.settings.background;
        let push = expose::Push { image_width: width, image_height: height, background, view };
        let groups = self.sizes.picture_groups(width, height);
        r.scope("exposure", |r| r.dispatch(&self.expose, &bind, &push, groups));
    }

    /// Records the backward pass. It converts `image_gradient`, in the native layout, from that of the exposed picture to that
    /// of the rendered one. It also writes partial sums of the matrix's gradient. The caller places barriers before and after.
    pub fn record_backward(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        buffers: &LightBuffers,
        view: u32,
        image_gradient: &Buffer,
    ) {
        let bind = expose_backward::Bind {
            rendered: inputs.frame.rendered(&self.sizes),
            exposures: &buffers.values,
            image_gradient,
            partials: &buffers.partials,
        };
        let push = expose_backward::Push {
            image_width: inputs.camera.width,
            image_height: inputs.camera.height,
            background: inputs.settings.background,
            view,
        };
        r.scope("exposure backward", |r| r.dispatch(&self.backward, &bind, &push, TERM_PARTIALS.into()));
    }

    /// Records a step of the optimiser over all matrices. The matrix of `view` has the gradient of
    /// [`Exposing::record_backward`]. If the frame overflowed, nothing changes. The caller places barriers before and after.
    pub fn record_step(&self, r: &mut Recorder, of: (&LightBuffers, &Buffer), view: u32, step: &LightStep) {
        r.scope("exposure step", |r| self.step.record(r, of, view, step));
    }
}

/// Kernel of Adam over matrices.
pub(crate) struct LightOptimizer(Kernel<exposure_step::Interface>);

impl LightOptimizer {
    /// See [`Exposing::new`].
    pub(crate) fn new(context: &Context, form: LightForm) -> Result<Self> {
        let workgroup_size = LaunchSizes::new(context.limits()).elementwise_workgroup;
        let subgroup_size = context.limits().subgroup_size;
        let LightForm { center, shares, sparse } = form;
        let step = exposure_step::Spec { workgroup_size, subgroup_size, center, shares, sparse };
        Ok(Self(Kernel::new(context, &step)?))
    }

    /// See [`Exposing::record_step`]: `seen` is the index of the matrix with a gradient.
    pub(crate) fn record(
        &self,
        r: &mut Recorder,
        (buffers, state): (&LightBuffers, &Buffer),
        seen: u32,
        step: &LightStep,
    ) {
        let correction = |beta: f64| 1.0 - beta.powf(step.count as f64);
        let bind = exposure_step::Bind {
            partials: &buffers.partials,
            state,
            exposures: &buffers.values,
            moments_1: &buffers.first_moments,
            moments_2: &buffers.second_moments,
        };
        let push = exposure_step::Push {
            photographs: buffers.photographs() as u32,
            view: seen,
            beta_1: BETA_1 as f32,
            beta_2: BETA_2 as f32,
            one_minus_beta_1: (1.0 - BETA_1) as f32,
            one_minus_beta_2: (1.0 - BETA_2) as f32,
            epsilon: EPSILON as f32,
            rate: (step.rate / correction(BETA_1)) as f32,
            inverse_bias_2: correction(BETA_2).sqrt().recip() as f32,
            decay: step.decay as f32,
            sparsity: step.sparsity as f32,
        };
        r.dispatch(&self.0, &bind, &push, 1);
    }
}
