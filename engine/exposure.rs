//! Exposures of the photographs, learned beside the Gaussians: the reference implementation's 3×4 matrix per image.
//!
//! The loss compares a photograph with the rendered picture under the photograph's [`Exposure`](crate::scene::Exposure), so that a
//! camera's automatic exposure and white balance do not end up in the Gaussians. Its own Adam treats the
//! matrices of all photographs as one tensor.

use crate::error::{Error, Result};
use crate::forward::FrameInputs;
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::exposure::{expose, expose_backward, exposure_step};
use crate::optimizer::{BETA_1, BETA_2, ViewSum};
use crate::plan::{LaunchSizes, STRIP_ROWS, Strips, blocks};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Adam's ε for exposures in the reference (the default of its library).
pub const EPSILON: f64 = 1e-8;
/// Bytes of a matrix.
const MATRIX_BYTES: u64 = 48;

/// Which optimiser of exposures, or of [lenses](crate::lens_effects).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightForm {
    /// Whether each step brings the mean of all matrices back to the identity: otherwise scene and exposures could drift against
    /// each other.
    pub center: bool,
    /// Whether steps may follow several views ([`ViewSum`]).
    pub sums: bool,
    /// Whether the second moments are those of all photographs together.
    pub shares: bool,
    /// Whether steps have a [`LightStep::sparsity`].
    pub sparse: bool,
}

/// One step of the optimiser of exposures, or of [lenses](crate::lens_effects).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightStep {
    /// Learning rate.
    pub rate: f64,
    /// Number of steps including this one, from 1.
    pub count: u64,
    /// Where the view is among those whose gradients add up.
    pub sum: ViewSum,
    /// Times each value, a part of its gradient: pulls it to 0. Of exposures that are centred, not the diagonal.
    pub decay: f64,
    /// How far a matrix comes closer to the identity after its step, as a share of the rate; less the farther it is away, nothing
    /// at 0.05 (root of the sum of squares). Photographs without a clear change stay as they are: the minimax concave penalty (Zhang 2010).
    pub sparsity: f64,
}

/// Matrices and moments of some photographs, or [lenses](crate::lens_effects), on the device, and scratch memory. A matrix is
/// three rows of vec4.
pub struct LightBuffers {
    /// A matrix per photograph or lens.
    pub values: Buffer,
    /// Adam's first moments, laid out like the matrices.
    pub first_moments: Buffer,
    /// Adam's second moments.
    pub second_moments: Buffer,
    /// The picture that they make, laid out like the rendered one.
    pub picture: Buffer,
    /// Parts of the gradient of a matrix.
    pub partials: Buffer,
    /// Gradients of the views since the last step, laid out like the matrices: of steps of several views only.
    pub sums: Buffer,
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
            "exposure_sums",
        ];
        Self::named_requests(names, sizes)
    }

    /// As [`LightBuffers::requests`], under other names.
    pub(crate) fn named_requests(
        names: [&'static str; Self::COUNT],
        sizes: &[(u32, u32)],
    ) -> [(&'static str, u64); Self::COUNT] {
        let [values, moments_1, moments_2, picture_name, partials, sums] = names;
        let matrices = MATRIX_BYTES * sizes.len() as u64;
        // Strips have at least as many values as the picture has pixels.
        let picture = |&(width, height): &(u32, u32)| 16 * Strips { width, height }.values();
        [
            (values, matrices),
            (moments_1, matrices),
            (moments_2, matrices),
            (picture_name, sizes.iter().map(picture).max().unwrap_or(0)),
            (partials, MATRIX_BYTES * u64::from(TERM_PARTIALS)),
            (sums, matrices),
        ]
    }

    /// The buffers, in the order of [`LightBuffers::requests`].
    pub fn from_allocated(buffers: [Buffer; Self::COUNT]) -> Self {
        let [values, first_moments, second_moments, picture, partials, sums] = buffers;
        Self { values, first_moments, second_moments, picture, partials, sums }
    }

    /// Number of photographs or lenses.
    pub fn photographs(&self) -> usize {
        (self.values.bytes() / MATRIX_BYTES) as usize
    }

    /// The same matrix for all, with no moments.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn reset(&self, context: &Context, matrix: [[f32; 4]; 3]) -> Result<()> {
        let identity = vec![matrix; self.photographs()];
        let none = vec![[[0.0; 4]; 3]; self.photographs()];
        self.upload_sums(context, &[])?;
        self.upload(context, [&identity, &none, &none])
    }

    /// Uploads matrices and both moments.
    ///
    /// # Errors
    /// [`Error::Argument`] when they are not of the number of the photographs; when the device is lost.
    pub fn upload(&self, context: &Context, from: [&[[[f32; 4]; 3]]; 3]) -> Result<()> {
        for (buffer, rows) in [&self.values, &self.first_moments, &self.second_moments].into_iter().zip(from)
        {
            if rows.len() != self.photographs() {
                let problem = format!("are {}, for {} photographs", rows.len(), self.photographs());
                return Err(Error::argument("exposures", problem));
            }
            context.upload(buffer, bytemuck::cast_slice(rows))?;
        }
        Ok(())
    }

    /// Uploads the sums of gradients; none are zeros.
    ///
    /// # Errors
    /// [`Error::Argument`] when they are not of the number of the photographs; when the device is lost.
    pub fn upload_sums(&self, context: &Context, sums: &[[[f32; 4]; 3]]) -> Result<()> {
        let none = vec![[[0.0; 4]; 3]; self.photographs()];
        let sums = if sums.is_empty() { &none } else { sums };
        if sums.len() != self.photographs() {
            let problem = format!("are {}, for {} photographs", sums.len(), self.photographs());
            return Err(Error::argument("gradient sums of exposures", problem));
        }
        context.upload(&self.sums, bytemuck::cast_slice(sums))
    }

    /// Downloads the sums of gradients.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn download_sums(&self, context: &Context) -> Result<Vec<[[f32; 4]; 3]>> {
        Ok(bytemuck::pod_collect_to_vec(&context.download(&self.sums)?))
    }

    /// Downloads matrices and both moments.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn download(&self, context: &Context) -> Result<[Vec<[[f32; 4]; 3]>; 3]> {
        let rows = |buffer: &Buffer| Ok(bytemuck::pod_collect_to_vec(&context.download(buffer)?));
        Ok([rows(&self.values)?, rows(&self.first_moments)?, rows(&self.second_moments)?])
    }
}

/// The kernels.
pub struct Exposing {
    sizes: LaunchSizes,
    expose: Kernel<expose::Interface>,
    backward: Kernel<expose_backward::Interface>,
    step: LightOptimizer,
}

impl Exposing {
    /// Builds the kernels.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
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

    /// Records the exposed picture of a frame, for a photograph's index. The frame must be one with backward.
    /// The caller places barriers before and after.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, buffers: &LightBuffers, view: u32) {
        let (width, height) = (inputs.camera.width, inputs.camera.height);
        let bind = expose::Bind {
            rendered: inputs.frame.rendered(&self.sizes),
            exposures: &buffers.values,
            exposed: &buffers.picture,
        };
        let background = inputs.settings.background;
        let push = expose::Push { image_width: width, image_height: height, background, view };
        let rows = if self.sizes.strips { height.next_multiple_of(STRIP_ROWS) } else { height };
        let pixels = u64::from(width) * u64::from(rows);
        r.scope("exposure", |r| {
            r.dispatch(&self.expose, &bind, &push, blocks(pixels, self.sizes.elementwise_workgroup.into()));
        });
    }

    /// Records the backward pass: `image_gradient`, in the native layout, is that of the exposed picture
    /// before and that of the rendered one afterwards; the gradient of the matrix stays in parts. The caller
    /// places barriers before and after.
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

    /// Records a step of the optimiser over all matrices, of which that of `view` has the gradient of
    /// [`Exposing::record_backward`], or the addition to the sums: [`ViewSum`]. If the frame overflowed, nothing
    /// changes. The caller places barriers before and after.
    pub fn record_step(&self, r: &mut Recorder, of: (&LightBuffers, &Buffer), view: u32, step: &LightStep) {
        r.scope("exposure step", |r| self.step.record(r, of, view, step));
    }
}

/// The kernel of Adam over matrices.
pub(crate) struct LightOptimizer(Kernel<exposure_step::Interface>);

impl LightOptimizer {
    /// See [`Exposing::new`].
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub(crate) fn new(context: &Context, form: LightForm) -> Result<Self> {
        let workgroup_size = LaunchSizes::new(context.limits()).elementwise_workgroup;
        let subgroup_size = context.limits().subgroup_size;
        let LightForm { center, sums, shares, sparse } = form;
        let step = exposure_step::Spec { workgroup_size, subgroup_size, center, sums, shares, sparse };
        Ok(Self(Kernel::new(context, &step)?))
    }

    /// See [`Exposing::record_step`]: `seen` is the matrix that has a gradient.
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
            sums: &buffers.sums,
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
            makes_step: step.sum.makes_step.into(),
            starts: step.sum.starts.into(),
            decay: step.decay as f32,
            sparsity: step.sparsity as f32,
        };
        r.dispatch(&self.0, &bind, &push, 1);
    }
}
