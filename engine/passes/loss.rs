//! Training loss and its gradient: a sum of terms ([`LossTerm`]). The first compares an image with a photograph: (1 - λ) L1 + λ
//! (1 - SSIM).

use crate::error::Result;
pub use crate::frame::NativeLayout;
use crate::frame::{LaunchSizes, Strips, blocks, tile_grid};
use crate::kernels::loss::{ssim_backward, ssim_backward_sweep, ssim_forward, ssim_forward_sweep};
use crate::vk::{Buffer, Context, Kernel, Limits, Recorder};
pub(crate) use term::check_depth_points;
pub use term::{DepthPoint, DepthPointBuffers, LossTerm, TermData, TermInputs};

mod term;

/// Kernels of the loss.
pub struct Loss {
    limits: Limits,
    sizes: LaunchSizes,
    layout: NativeLayout,
    windows: Windows,
}

/// Kernels that evaluate SSIM's window. The results of both forms agree except for rounding.
enum Windows {
    /// Workgroups load blocks of 16×16 pixels into shared memory.
    Blocks { forward: Kernel<ssim_forward::Interface>, backward: Kernel<ssim_backward::Interface> },
    /// Each invocation moves along a strip of eight rows, with all values in registers.
    Sweeps {
        forward: Kernel<ssim_forward_sweep::Interface>,
        backward: Kernel<ssim_backward_sweep::Interface>,
    },
}

/// Format of a photograph. [`photo_on_device`] converts it to the device's layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotoFormat {
    /// Four bytes per pixel, (r, g, b, unused), 255 being 1.
    Rgba8,
    /// Four bytes per pixel, (r, g, b, mask), 255 being 1. A pixel with mask 0 does not count: both pictures are multiplied by
    /// the mask (like nerfstudio's Splatfacto; the reference implementation only multiplies the rendered one). Means are over
    /// all pixels, and the gradient is exactly 0 where the mask is 0.
    MaskedRgba8,
    /// Three f32 per pixel, for targets that 8 bits cannot hold.
    Float,
}

/// Inputs and outputs of the loss, in the device's native layout. [`LayoutConverter`](crate::passes::pixels::LayoutConverter)
/// converts them to rows and back.
///
/// # Examples
/// Loss and gradient of a picture and a photograph by rows, with [`NativeLayout::Rows`].
/// ```no_run
/// use ashsplat::passes::loss::{Loss, LossInputs, PhotoFormat, NativeLayout, photo_bytes};
/// use ashsplat::vk::{Context, MemoryKind};
///
/// fn loss(context: &Context, picture: &[u8], photo: &[u8], (width, height): (u32, u32)) -> ashsplat::Result<[f32; 4]> {
///     let layout = NativeLayout::Rows;
///     let loss = Loss::with_layout(context, PhotoFormat::Rgba8, layout)?;
///     let texels = 16 * u64::from(width) * u64::from(height);
///     let mut requests = vec![
///         ("picture", texels),
///         ("photograph", photo_bytes(layout, width, height, false)),
///         ("losses", 16),
///         ("gradient", texels),
///     ];
///     requests.extend(loss.scratch_requests([(width, height)]));
///     let buffers = context.allocate("loss", &requests, MemoryKind::Device)?;
///     let [rendered, target, losses, image_gradient, scratch @ ..] = &buffers[..] else { unreachable!() };
///     context.upload(rendered, picture)?;
///     context.upload(target, photo)?;
///     let inputs = LossInputs {
///         rendered,
///         photo: target,
///         scratch,
///         losses,
///         row: 0,
///         image_gradient,
///         width,
///         height,
///         background: [0.0; 3],
///         lambda_dssim: 0.2,
///         weight: 1.0,
///     };
///     context.run("loss", |recorder| {
///         loss.record(recorder, &inputs);
///     })?;
///     Ok(bytemuck::pod_read_unaligned(&context.download(losses)?))
/// }
/// ```
#[derive(Clone, Copy)]
pub struct LossInputs<'a> {
    /// Blended picture of a frame with backward. [`NativeLayout::Rows`]: per pixel, premultiplied colour without background,
    /// transmittance. [`NativeLayout::Strips`]: composited, three planes in [`Strips`], 0 below the picture.
    pub rendered: &'a Buffer,
    /// Photograph in the format given to [`Loss::new`]. [`NativeLayout::Rows`]: per pixel. [`NativeLayout::Strips`]: planes in
    /// [`Strips`], see [`photo_on_device`].
    pub photo: &'a Buffer,
    /// Buffers of [`Loss::scratch_requests`], in their order.
    pub scratch: &'a [Buffer],
    /// Out: vec4 (weighted loss, L1, SSIM, 0) per row.
    pub losses: &'a Buffer,
    /// Index of the row of `losses` to write.
    pub row: u32,
    /// Out: dL/d(r, g, b). [`NativeLayout::Rows`]: per pixel, with a fourth component that is not written.
    /// [`NativeLayout::Strips`]: three planes in [`Strips`].
    pub image_gradient: &'a Buffer,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Background over which [`NativeLayout::Rows`] composites the image.
    pub background: [f32; 3],
    /// Weight λ of 1 - SSIM.
    pub lambda_dssim: f32,
    /// Factor of the loss and its gradient, but not of the two means. 1, or the share of a part in its whole picture
    /// ([`Camera::share_of_whole`](crate::scene::Camera::share_of_whole)).
    pub weight: f32,
}

/// Records a pass over all channels: in one dispatch, or in one per channel if each channel has its own buffer. `record`
/// receives the first channel, the number of channels and their derivatives.
fn by_channels(r: &mut Recorder, derivatives: &[Buffer], record: impl Fn(&mut Recorder, u32, u32, &Buffer)) {
    let count = 3 / derivatives.len() as u32;
    for (derivatives, first) in derivatives.iter().zip((0..3).step_by(count as usize)) {
        if first > 0 {
            r.barrier();
        }
        record(r, first, count, derivatives);
    }
}

impl Loss {
    /// Builds the kernels for the device.
    pub fn new(context: &Context, photos: PhotoFormat) -> Result<Self> {
        Self::with_layout(context, photos, NativeLayout::of(context.limits()))
    }

    /// Builds the kernels with the given layout.
    pub fn with_layout(context: &Context, photos: PhotoFormat, layout: NativeLayout) -> Result<Self> {
        let (float_photo, masked) = (photos == PhotoFormat::Float, photos == PhotoFormat::MaskedRgba8);
        let limits = context.limits();
        let subgroup_size = limits.subgroup_size;
        let sizes = LaunchSizes::new(limits);
        let windows = match layout {
            NativeLayout::Rows => {
                let (workgroup_size, strip) = (sizes.loss_workgroup, sizes.loss_strip);
                let forward =
                    ssim_forward::Spec { workgroup_size, subgroup_size, strip, float_photo, masked };
                let backward = ssim_backward::Spec { workgroup_size, strip, float_photo, masked };
                Windows::Blocks {
                    forward: Kernel::new(context, &forward)?,
                    backward: Kernel::new(context, &backward)?,
                }
            }
            NativeLayout::Strips => {
                let workgroup_size = sizes.loss_sweep_workgroup;
                let forward = ssim_forward_sweep::Spec { workgroup_size, float_photo, masked };
                let backward =
                    ssim_backward_sweep::Spec { workgroup_size, subgroup_size, float_photo, masked };
                Windows::Sweeps {
                    forward: Kernel::new(context, &forward)?,
                    backward: Kernel::new(context, &backward)?,
                }
            }
        };
        Ok(Self { limits: limits.clone(), sizes, layout, windows })
    }

    /// Scratch buffers of the loss, for images of these sizes (width, height).
    pub fn scratch_requests(&self, sizes: impl IntoIterator<Item = (u32, u32)>) -> Vec<(&'static str, u64)> {
        let all = sizes.into_iter().map(|(width, height)| ScratchBytes::of(self.layout, width, height));
        let ScratchBytes { partials, derivatives } = all.fold(ScratchBytes::default(), |a, b| ScratchBytes {
            partials: a.partials.max(b.partials),
            derivatives: a.derivatives.max(b.derivatives),
        });
        let mut requests = vec![("loss_partials", partials)];
        // The derivatives have one buffer for all channels, or one per channel if it would exceed the largest binding.
        if 3 * derivatives <= self.limits.max_storage_buffer_range {
            requests.push(("ssim_derivatives", 3 * derivatives));
        } else {
            requests.extend([("ssim_derivatives", derivatives); 3]);
        }
        requests
    }

    /// Records loss and gradient.
    ///
    /// # Panics
    /// If there are fewer scratch buffers than [`Loss::scratch_requests`] returns.
    pub fn record(&self, r: &mut Recorder, inputs: &LossInputs) {
        let LossInputs { rendered, photo, losses, image_gradient, background, .. } = *inputs;
        let LossInputs { width: image_width, height: image_height, row: loss_row, .. } = *inputs;
        let LossInputs { lambda_dssim, weight, .. } = *inputs;
        let [loss_partials, derivatives @ ..] = inputs.scratch else {
            panic!("no scratch buffers of the loss");
        };
        r.scope("loss", |r| match &self.windows {
            Windows::Blocks { forward, backward } => {
                let (columns, rows) = tile_grid(image_width, image_height);
                by_channels(r, derivatives, |r, first_channel, channels, derivatives| {
                    let bind =
                        ssim_forward::Bind { accumulated: rendered, photo, derivatives, loss_partials };
                    let push = ssim_forward::Push { image_width, image_height, background, first_channel };
                    r.dispatch_3d(forward, &bind, &push, [columns, rows, channels]);
                });
                r.barrier();
                let partials = (ScratchBytes::of(self.layout, image_width, image_height).partials / 8) as u32;
                by_channels(r, derivatives, |r, first_channel, channels, derivatives| {
                    let bind = ssim_backward::Bind {
                        accumulated: rendered,
                        photo,
                        derivatives,
                        image_gradient,
                        loss_partials,
                        losses,
                    };
                    let push = ssim_backward::Push {
                        image_width,
                        image_height,
                        background,
                        first_channel,
                        lambda_dssim,
                        weight,
                        // The first dispatch adds the sums of all channels.
                        partials: if first_channel == 0 { partials } else { 0 },
                        loss_row,
                    };
                    r.dispatch_3d(backward, &bind, &push, [columns, rows, channels]);
                });
            }
            Windows::Sweeps { forward, backward } => {
                let Sweeps { columns, per_channel } = Sweeps::new(image_width, image_height);
                let groups =
                    |invocations: u32| blocks(invocations.into(), self.sizes.loss_sweep_workgroup.into());
                by_channels(r, derivatives, |r, first_channel, channels, derivatives| {
                    let bind = ssim_forward_sweep::Bind { rendered, photo, derivatives, loss_partials };
                    let invocations = channels * per_channel;
                    let push = ssim_forward_sweep::Push {
                        image_width,
                        image_height,
                        first_channel,
                        invocations,
                        columns,
                        first_partial: first_channel * per_channel,
                    };
                    r.dispatch(forward, &bind, &push, groups(invocations));
                });
                r.barrier();
                by_channels(r, derivatives, |r, first_channel, channels, derivatives| {
                    // The first dispatch adds the sums of all channels, in an additional workgroup.
                    let adds = first_channel == 0;
                    let invocations = channels * per_channel;
                    let bind = ssim_backward_sweep::Bind {
                        rendered,
                        photo,
                        derivatives,
                        image_gradient,
                        loss_partials,
                        losses,
                    };
                    let push = ssim_backward_sweep::Push {
                        image_width,
                        image_height,
                        first_channel,
                        invocations,
                        columns,
                        lambda_dssim,
                        weight,
                        partials: if adds { 3 * per_channel } else { 0 },
                        loss_row,
                    };
                    r.dispatch(backward, &bind, &push, groups(invocations) + u64::from(adds));
                });
            }
        });
    }
}

/// Bytes of a texel of planes in strips.
const TEXEL_BYTES: u64 = 16;

/// Device bytes of a photograph with 8 bits per channel. `masked` is true for [`PhotoFormat::MaskedRgba8`].
pub fn photo_bytes(layout: NativeLayout, width: u32, height: u32, masked: bool) -> u64 {
    match layout {
        NativeLayout::Rows => 4 * u64::from(width) * u64::from(height),
        NativeLayout::Strips => {
            let planes = if masked { 4 } else { 3 };
            (planes * Strips { width, height }.values()).next_multiple_of(TEXEL_BYTES)
        }
    }
}

/// Converts a photograph with 8 bits per channel, (r, g, b, mask) per pixel, to the device's layout: unchanged, or planes in
/// [`Strips`]. The planes are 0 where the mask is 0. With `masked`, a further plane holds the mask, for
/// [`PhotoFormat::MaskedRgba8`](PhotoFormat).
///
/// # Panics
/// If the number of pixels differs from the image's.
pub fn photo_on_device(
    layout: NativeLayout,
    width: u32,
    height: u32,
    masked: bool,
    rgbm: Vec<u8>,
) -> Vec<u8> {
    if layout == NativeLayout::Rows {
        return rgbm;
    }
    let strips = Strips { width, height };
    let pixels = rgbm.as_chunks::<4>().0.iter();
    let mut planes = match masked {
        true => strips.planes(pixels.map(|&pixel| if pixel[3] == 0 { [0; 4] } else { pixel })),
        false => strips.planes(pixels.map(|&[r, g, b, _]| [r, g, b])),
    };
    planes.resize(photo_bytes(layout, width, height, masked) as usize, 0);
    planes
}

/// L1 and D-SSIM against the view's photograph (Kerbl et al. 2023, equation 7). Reports L1 and SSIM.
pub struct Photometric {
    plain: Loss,
    /// For photographs with masks.
    masked: Option<Loss>,
    lambda_dssim: f32,
}

impl Photometric {
    /// Builds the kernels; `any_masked`: also those for photographs with masks.
    pub fn new(context: &Context, any_masked: bool, lambda_dssim: f32) -> Result<Self> {
        let masked = any_masked.then(|| Loss::new(context, PhotoFormat::MaskedRgba8)).transpose()?;
        Ok(Self { plain: Loss::new(context, PhotoFormat::Rgba8)?, masked, lambda_dssim })
    }
}

impl LossTerm for Photometric {
    fn name(&self) -> &'static str {
        "photometric"
    }

    fn data(&self) -> TermData {
        TermData { picture: true, ..TermData::default() }
    }

    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        self.plain.scratch_requests(sizes.iter().copied())
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let loss = self.masked.as_ref().filter(|_| inputs.photo_is_masked).unwrap_or(&self.plain);
        let camera = inputs.frame.camera;
        loss.record(
            r,
            &LossInputs {
                rendered: inputs.picture,
                photo: inputs.photo,
                scratch: inputs.scratch,
                losses: inputs.losses,
                row: inputs.row,
                image_gradient: inputs.image_gradient,
                width: camera.width,
                height: camera.height,
                background: inputs.frame.settings.background,
                lambda_dssim: self.lambda_dssim,
                weight: camera.share_of_whole() as f32,
            },
        );
    }
}

/// Maximum number of columns per invocation of [`NativeLayout::Strips`], which reads ten more.
const SWEEP_COLUMNS: u32 = 160;

/// Division of an image into sweeps.
struct Sweeps {
    /// Number of columns per invocation.
    columns: u32,
    /// Number of invocations per channel.
    per_channel: u32,
}

impl Sweeps {
    fn new(width: u32, height: u32) -> Self {
        let columns = width.div_ceil(width.div_ceil(SWEEP_COLUMNS).max(1)).max(1);
        Self { columns, per_channel: Strips { width, height }.count() * width.div_ceil(columns) }
    }
}

/// Bytes of the scratch buffers of an image.
#[derive(Default)]
struct ScratchBytes {
    /// Bytes of partial sums, 8 each.
    partials: u64,
    /// Bytes of SSIM's derivatives for one channel.
    derivatives: u64,
}

impl ScratchBytes {
    fn of(layout: NativeLayout, width: u32, height: u32) -> Self {
        match layout {
            NativeLayout::Rows => {
                // Window blocks have the size of tiles.
                let (columns, rows) = tile_grid(width, height);
                let pixels = u64::from(width) * u64::from(height);
                Self { partials: 3 * u64::from(columns * rows) * 8, derivatives: 12 * pixels }
            }
            NativeLayout::Strips => Self {
                partials: 3 * u64::from(Sweeps::new(width, height).per_channel) * 8,
                derivatives: 12 * Strips { width, height }.values(),
            },
        }
    }
}
