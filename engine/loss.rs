//! The loss of an image against a photograph, and its gradient: (1 - λ) L1 + λ (1 - SSIM).

use crate::error::Result;
use crate::kernels::loss::{loss_reduce, ssim_backward, ssim_forward};
use crate::plan::{Blocks, tile_grid};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// The kernels of the loss.
pub struct Loss {
    forward: Kernel<ssim_forward::Interface>,
    backward: Kernel<ssim_backward::Interface>,
    reduce: Kernel<loss_reduce::Interface>,
}

/// How a photograph lies in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotoFormat {
    /// Four bytes per pixel, (r, g, b, unused), 255 being 1.
    Rgba8,
    /// Three f32 per pixel: for targets that 8 bits cannot hold.
    Float,
}

/// Derivatives of SSIM by the windowed x, x² and x y, per pixel and channel: scratch between the loss' kernels, of
/// [`ssim_map_bytes`] each.
#[derive(Clone, Copy)]
pub struct SsimMaps<'a> {
    /// By the windowed x.
    pub by_mean: &'a Buffer,
    /// By the windowed x².
    pub by_square: &'a Buffer,
    /// By the windowed x y.
    pub by_product: &'a Buffer,
}

impl<'a> SsimMaps<'a> {
    /// The three of a slice, in the fields' order.
    pub fn new([by_mean, by_square, by_product]: &'a [Buffer; 3]) -> Self {
        Self { by_mean, by_square, by_product }
    }
}

/// What the loss works on.
#[derive(Clone, Copy)]
pub struct LossInputs<'a> {
    /// Per pixel: premultiplied colour without background, transmittance.
    pub accumulated: &'a Buffer,
    /// Per pixel: the photograph, in the format that [`Loss::new`] was told.
    pub photo: &'a Buffer,
    /// Scratch.
    pub ssim_maps: SsimMaps<'a>,
    /// Scratch: [`partials_bytes`].
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

/// Bytes of one of the three maps for an image.
pub fn ssim_map_bytes(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height) * 3 * 4
}

/// Bytes of scratch for an image.
pub fn partials_bytes(width: u32, height: u32) -> u64 {
    let (columns, rows) = tile_grid(width, height);
    u64::from(columns) * u64::from(rows) * 3 * 8
}

impl Loss {
    /// Builds the kernels.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, photos: PhotoFormat) -> Result<Self> {
        let float_photo = photos == PhotoFormat::Float;
        let subgroup_size = context.limits().subgroup_size;
        let sizes = Blocks::new(context.limits());
        let (workgroup_size, strip) = (sizes.loss, sizes.loss_strip);
        Ok(Self {
            forward: Kernel::new(
                context,
                &ssim_forward::Spec { workgroup_size, subgroup_size, strip, float_photo },
            )?,
            backward: Kernel::new(context, &ssim_backward::Spec { workgroup_size, strip, float_photo })?,
            reduce: Kernel::new(context, &loss_reduce::Spec { workgroup_size, subgroup_size })?,
        })
    }

    /// Records loss and gradient. The caller places barriers before and after.
    pub fn record(&self, r: &mut Recorder, inputs: &LossInputs) {
        let i = inputs;
        // Blocks of the window are as large as tiles; one layer of workgroups per colour channel.
        let (columns, rows) = tile_grid(i.width, i.height);
        r.scope("loss", |r| {
            r.dispatch_3d(
                &self.forward,
                &ssim_forward::Bind {
                    accumulated: i.accumulated,
                    photo: i.photo,
                    by_mean: i.ssim_maps.by_mean,
                    by_square: i.ssim_maps.by_square,
                    by_product: i.ssim_maps.by_product,
                    loss_partials: i.partials,
                },
                &ssim_forward::Push {
                    image_width: i.width,
                    image_height: i.height,
                    background: i.background,
                },
                [columns, rows, 3],
            );
            r.barrier();
            r.dispatch_3d(
                &self.backward,
                &ssim_backward::Bind {
                    accumulated: i.accumulated,
                    photo: i.photo,
                    by_mean: i.ssim_maps.by_mean,
                    by_square: i.ssim_maps.by_square,
                    by_product: i.ssim_maps.by_product,
                    image_gradient: i.image_gradient,
                },
                &ssim_backward::Push {
                    image_width: i.width,
                    image_height: i.height,
                    background: i.background,
                    lambda_dssim: i.lambda_dssim,
                },
                [columns, rows, 3],
            );
            r.dispatch(
                &self.reduce,
                &loss_reduce::Bind { loss_partials: i.partials, losses: i.losses },
                &loss_reduce::Push {
                    partials: columns * rows * 3,
                    slot: i.slot,
                    scale: 1.0 / (3.0 * i.width as f32 * i.height as f32),
                    lambda_dssim: i.lambda_dssim,
                },
                1,
            );
        });
    }
}
