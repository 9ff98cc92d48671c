//! The loss of an image against a photograph, and its gradient: (1 - λ) L1 + λ (1 - SSIM).

use crate::error::Result;
use crate::kernels::loss::{
    loss_reduce, ssim_backward, ssim_backward_sweep, ssim_forward, ssim_forward_sweep,
};
use crate::plan::{Blocks, blocks, tile_grid};
use crate::vk::{Buffer, Context, Kernel, Limits, Recorder, TexelFormat};

/// Most rows of one invocation of [`Windowing::Sweeps`]: it reads ten more.
const SWEEP_ROWS: u32 = 80;

/// How SSIM's window is computed: the same numbers but for rounding, at a cost that depends on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Windowing {
    /// Workgroups share blocks of 16×16 pixels through shared memory.
    Blocks,
    /// Each invocation goes down a strip of columns by itself, everything in registers.
    Sweeps,
}

impl Windowing {
    /// Processors have no use for shared memory: it is memory like any other there.
    pub fn for_device(limits: &Limits) -> Self {
        if limits.prefers_texels() { Self::Sweeps } else { Self::Blocks }
    }
}

/// The kernels of the loss.
pub struct Loss {
    limits: Limits,
    sizes: Blocks,
    windows: Windows,
    reduce: Kernel<loss_reduce::Interface>,
}

enum Windows {
    Blocks(Kernel<ssim_forward::Interface>, Kernel<ssim_backward::Interface>),
    Sweeps(Kernel<ssim_forward_sweep::Interface>, Kernel<ssim_backward_sweep::Interface>),
}

impl Windows {
    fn windowing(&self) -> Windowing {
        match self {
            Self::Blocks(..) => Windowing::Blocks,
            Self::Sweeps(..) => Windowing::Sweeps,
        }
    }
}

/// How a photograph lies in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotoFormat {
    /// Four bytes per pixel, (r, g, b, unused), 255 being 1.
    Rgba8,
    /// Four bytes per pixel, (r, g, b, mask), 255 being 1: where the mask is 0, the pixel does not count. The loss is that
    /// of both pictures times the mask (as in nerfstudio's Splatfacto; the reference implementation multiplies the
    /// rendered one), its means go over all pixels, and its gradient is exactly 0 where the mask is.
    MaskedRgba8,
    /// Three f32 per pixel: for targets that 8 bits cannot hold.
    Float,
}

/// What the loss works on.
#[derive(Clone, Copy)]
pub struct LossInputs<'a> {
    /// Per pixel: premultiplied colour without background, transmittance.
    pub accumulated: &'a Buffer,
    /// Per pixel: the photograph, in the format that [`Loss::new`] was told.
    pub photo: &'a Buffer,
    /// Scratch: [`Loss::derivative_requests`].
    pub derivatives: &'a [Buffer],
    /// Scratch: [`Loss::partials_bytes`].
    pub partials: &'a Buffer,
    /// Out: vec4 (loss, L1, SSIM, 0) per slot.
    pub losses: &'a Buffer,
    /// Which slot of `losses`.
    pub slot: u32,
    /// Out, per pixel: dL/d(r, g, b); the fourth component is not written.
    pub image_gradient: &'a Buffer,
    /// Size of the image, pixels.
    pub width: u32,
    /// Size of the image, pixels.
    pub height: u32,
    /// Background the image is composited on.
    pub background: [f32; 3],
    /// λ.
    pub lambda_dssim: f32,
}

/// Colour channels that one dispatch handles.
#[derive(Clone, Copy)]
struct Channels<'a> {
    first: u32,
    count: u32,
    derivatives: &'a Buffer,
}

/// How an image is cut into sweeps.
#[derive(Clone, Copy)]
struct Sweeps {
    rows: u32,
    per_channel: u32,
}

impl Sweeps {
    fn new(strip: u32, width: u32, height: u32) -> Self {
        let rows = height.div_ceil(height.div_ceil(SWEEP_ROWS).max(1)).max(1);
        Self { rows, per_channel: width.div_ceil(strip) * height.div_ceil(rows) }
    }
}

/// Bytes of scratch of [`Loss::new`] on a device for an image, all buffers together.
pub fn scratch_bytes(limits: &Limits, width: u32, height: u32) -> u64 {
    let windowing = Windowing::for_device(limits);
    let partials = partials(windowing, &Blocks::new(limits), width, height);
    3 * channel_bytes(windowing, width, height) + u64::from(partials) * 8
}

/// Bytes of SSIM's derivatives in one channel.
fn channel_bytes(windowing: Windowing, width: u32, height: u32) -> u64 {
    let bytes = match windowing {
        Windowing::Blocks => 12,
        Windowing::Sweeps => TexelFormat::Rgba32Float.bytes(),
    };
    u64::from(width) * u64::from(height) * bytes
}

/// Partial sums of an image.
fn partials(windowing: Windowing, sizes: &Blocks, width: u32, height: u32) -> u32 {
    let per_channel = match windowing {
        // Blocks of the window are as large as tiles.
        Windowing::Blocks => {
            let (columns, rows) = tile_grid(width, height);
            columns * rows
        }
        Windowing::Sweeps => Sweeps::new(sizes.loss_sweep_strip, width, height).per_channel,
    };
    3 * per_channel
}

impl Loss {
    /// Builds the kernels that suit the device.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, photos: PhotoFormat) -> Result<Self> {
        Self::with_windowing(context, photos, Windowing::for_device(context.limits()))
    }

    /// Builds the kernels of one kind.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn with_windowing(context: &Context, photos: PhotoFormat, windowing: Windowing) -> Result<Self> {
        let (float_photo, masked) = (photos == PhotoFormat::Float, photos == PhotoFormat::MaskedRgba8);
        let limits = context.limits();
        let subgroup_size = limits.subgroup_size;
        let sizes = Blocks::new(limits);
        let windows = match windowing {
            Windowing::Blocks => {
                let (workgroup_size, strip) = (sizes.loss, sizes.loss_strip);
                let forward =
                    ssim_forward::Spec { workgroup_size, subgroup_size, strip, float_photo, masked };
                let backward = ssim_backward::Spec { workgroup_size, strip, float_photo, masked };
                Windows::Blocks(Kernel::new(context, &forward)?, Kernel::new(context, &backward)?)
            }
            Windowing::Sweeps => {
                let (workgroup_size, strip) = (sizes.loss_sweep, sizes.loss_sweep_strip);
                let forward = ssim_forward_sweep::Spec { workgroup_size, strip, float_photo, masked };
                let backward = ssim_backward_sweep::Spec { workgroup_size, strip, float_photo, masked };
                Windows::Sweeps(Kernel::new(context, &forward)?, Kernel::new(context, &backward)?)
            }
        };
        let reduce = loss_reduce::Spec { workgroup_size: sizes.loss, subgroup_size };
        Ok(Self { limits: limits.clone(), sizes, windows, reduce: Kernel::new(context, &reduce)? })
    }

    /// The scratch buffers for the derivatives of SSIM in an image: one for all channels, or one for each where that
    /// would be more than a kernel may be given.
    pub fn derivative_requests(&self, width: u32, height: u32) -> Vec<(&'static str, u64)> {
        let channel = channel_bytes(self.windows.windowing(), width, height);
        if 3 * channel <= self.limits.max_storage_buffer_range {
            vec![("ssim_derivatives", 3 * channel)]
        } else {
            vec![("ssim_derivatives", channel); 3]
        }
    }

    /// Bytes of scratch for the partial sums of an image.
    pub fn partials_bytes(&self, width: u32, height: u32) -> u64 {
        u64::from(self.partials(width, height)) * 8
    }

    fn partials(&self, width: u32, height: u32) -> u32 {
        partials(self.windows.windowing(), &self.sizes, width, height)
    }

    /// Records loss and gradient. The caller places barriers before and after.
    pub fn record(&self, r: &mut Recorder, inputs: &LossInputs) {
        let i = inputs;
        let count = 3 / i.derivatives.len() as u32;
        let channels = || {
            let all = i.derivatives.iter().zip((0..3).step_by(count as usize));
            all.map(move |(derivatives, first)| Channels { first, count, derivatives })
        };
        r.scope("loss", |r| {
            for part in channels() {
                if part.first > 0 {
                    r.barrier();
                }
                self.record_forward(r, i, part);
            }
            r.barrier();
            for part in channels() {
                if part.first > 0 {
                    r.barrier();
                }
                self.record_backward(r, i, part);
            }
            r.dispatch(
                &self.reduce,
                &loss_reduce::Bind { loss_partials: i.partials, losses: i.losses },
                &loss_reduce::Push {
                    partials: self.partials(i.width, i.height),
                    slot: i.slot,
                    scale: 1.0 / (3.0 * i.width as f32 * i.height as f32),
                    lambda_dssim: i.lambda_dssim,
                },
                1,
            );
        });
    }

    fn record_forward(&self, r: &mut Recorder, i: &LossInputs, part: Channels) {
        let Channels { first: first_channel, count, derivatives } = part;
        let (accumulated, photo, loss_partials) = (i.accumulated, i.photo, i.partials);
        let (image_width, image_height, background) = (i.width, i.height, i.background);
        match &self.windows {
            Windows::Blocks(kernel, _) => {
                let (columns, rows) = tile_grid(i.width, i.height);
                let bind = ssim_forward::Bind { accumulated, photo, derivatives, loss_partials };
                let push = ssim_forward::Push { image_width, image_height, background, first_channel };
                r.dispatch_3d(kernel, &bind, &push, [columns, rows, count]);
            }
            Windows::Sweeps(kernel, _) => {
                let sweeps = Sweeps::new(self.sizes.loss_sweep_strip, i.width, i.height);
                let invocations = count * sweeps.per_channel;
                let bind = ssim_forward_sweep::Bind { accumulated, photo, derivatives, loss_partials };
                let push = ssim_forward_sweep::Push {
                    image_width,
                    image_height,
                    background,
                    first_channel,
                    invocations,
                    rows: sweeps.rows,
                    first_partial: first_channel * sweeps.per_channel,
                };
                r.dispatch(kernel, &bind, &push, blocks(invocations.into(), self.sizes.loss_sweep.into()));
            }
        }
    }

    fn record_backward(&self, r: &mut Recorder, i: &LossInputs, part: Channels) {
        let Channels { first: first_channel, count, derivatives } = part;
        let (accumulated, photo, image_gradient) = (i.accumulated, i.photo, i.image_gradient);
        let (image_width, image_height, background) = (i.width, i.height, i.background);
        let lambda_dssim = i.lambda_dssim;
        match &self.windows {
            Windows::Blocks(_, kernel) => {
                let (columns, rows) = tile_grid(i.width, i.height);
                let bind = ssim_backward::Bind { accumulated, photo, derivatives, image_gradient };
                let push = ssim_backward::Push {
                    image_width,
                    image_height,
                    background,
                    first_channel,
                    lambda_dssim,
                };
                r.dispatch_3d(kernel, &bind, &push, [columns, rows, count]);
            }
            Windows::Sweeps(_, kernel) => {
                let sweeps = Sweeps::new(self.sizes.loss_sweep_strip, i.width, i.height);
                let invocations = count * sweeps.per_channel;
                let bind = ssim_backward_sweep::Bind { accumulated, photo, derivatives, image_gradient };
                let push = ssim_backward_sweep::Push {
                    image_width,
                    image_height,
                    background,
                    first_channel,
                    invocations,
                    rows: sweeps.rows,
                    lambda_dssim,
                };
                r.dispatch(kernel, &bind, &push, blocks(invocations.into(), self.sizes.loss_sweep.into()));
            }
        }
    }
}
