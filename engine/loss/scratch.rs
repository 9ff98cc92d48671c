//! What the loss needs of memory while it runs.

use super::{Loss, PhotoFormat, Windowing};
use crate::plan::{Blocks, tile_grid};
use crate::vk::Limits;

/// Most rows of one invocation of [`Windowing::Sweeps`]: it reads ten more.
const SWEEP_ROWS: u32 = 80;
/// Texels, four columns each, of a row in a group of columns (ssim_planes.glsl).
const GROUP_TEXELS: u32 = 16;
/// Texels of a row of a picture beyond those of its strips: the window reaches ten columns further. Of derivatives, whose rows
/// begin three columns earlier, it is one more.
const PICTURE_TEXELS_BESIDE_STRIPS: u32 = 3;

/// How an image is cut into sweeps, and its planes (ssim_planes.glsl).
#[derive(Clone, Copy)]
pub(super) struct Sweeps {
    /// Rows of an invocation.
    pub rows: u32,
    /// Invocations of a channel.
    pub per_channel: u32,
    /// Groups of columns of a plane.
    pub groups: u32,
    /// Texels of a row of the pictures' planes that are read.
    pub columns: u32,
}

impl Sweeps {
    pub fn new(strip: u32, width: u32, height: u32) -> Self {
        let rows = height.div_ceil(height.div_ceil(SWEEP_ROWS).max(1)).max(1);
        let strips = width.div_ceil(strip);
        let columns = strips * (strip / 4) + PICTURE_TEXELS_BESIDE_STRIPS;
        let groups = (columns + 1).div_ceil(GROUP_TEXELS);
        Self { rows, per_channel: strips * height.div_ceil(rows), groups, columns }
    }
}

/// Texels of a plane.
pub(super) fn plane_texels(groups: u32, height: u32) -> u64 {
    u64::from(groups * GROUP_TEXELS) * u64::from(height)
}

/// Bytes of the scratch buffers of an image.
#[derive(Clone, Copy, Default)]
pub(super) struct ScratchBytes {
    partials: u64,
    /// Of both pictures' planes; sweeps only.
    planes: Option<[u64; 2]>,
    /// Of SSIM's derivatives in one channel.
    derivatives: u64,
}

impl ScratchBytes {
    pub fn of(loss: &Loss, width: u32, height: u32) -> Self {
        Self::new(loss.windows.windowing(), &loss.sizes, loss.photos, width, height)
    }

    /// The largest of each buffer in images of these sizes.
    pub fn largest(loss: &Loss, sizes: impl IntoIterator<Item = (u32, u32)>) -> Self {
        Self::maximum(sizes.into_iter().map(|(width, height)| Self::of(loss, width, height)))
    }

    fn maximum(all: impl Iterator<Item = Self>) -> Self {
        all.reduce(|a, b| Self {
            partials: a.partials.max(b.partials),
            planes: a.planes.zip(b.planes).map(|(a, b)| [a[0].max(b[0]), a[1].max(b[1])]),
            derivatives: a.derivatives.max(b.derivatives),
        })
        .unwrap_or_default()
    }

    fn new(windowing: Windowing, sizes: &Blocks, photos: PhotoFormat, width: u32, height: u32) -> Self {
        let pixels = u64::from(width) * u64::from(height);
        match windowing {
            Windowing::Blocks => {
                // Blocks of the window are as large as tiles.
                let (columns, rows) = tile_grid(width, height);
                Self { partials: 3 * u64::from(columns * rows) * 8, planes: None, derivatives: 12 * pixels }
            }
            Windowing::Sweeps => {
                let sweeps = Sweeps::new(sizes.loss_sweep_strip, width, height);
                let texels = plane_texels(sweeps.groups, height);
                let photo = if photos == PhotoFormat::Float { 16 } else { 4 };
                Self {
                    partials: 3 * u64::from(sweeps.per_channel) * 8,
                    planes: Some([3 * 16 * texels, 3 * photo * texels]),
                    derivatives: 3 * 16 * texels,
                }
            }
        }
    }

    /// How many partial sums there are.
    pub fn partials(&self) -> u32 {
        (self.partials / 8) as u32
    }

    /// Partial sums, planes, and derivatives: one buffer for all channels, or one for each where that would be more than
    /// a kernel may be given.
    pub fn requests(&self, limits: &Limits) -> Vec<(&'static str, u64)> {
        let mut requests = vec![("loss_partials", self.partials)];
        if let Some([rendered, photo]) = self.planes {
            requests.extend([("rendered_planes", rendered), ("photo_planes", photo)]);
        }
        if 3 * self.derivatives <= limits.max_storage_buffer_range {
            requests.push(("ssim_derivatives", 3 * self.derivatives));
        } else {
            requests.extend([("ssim_derivatives", self.derivatives); 3]);
        }
        requests
    }
}

/// [`Loss::scratch_requests`] on a device for images of these sizes, with photographs of 8 bits.
pub fn scratch_requests(
    limits: &Limits,
    sizes: impl IntoIterator<Item = (u32, u32)>,
) -> Vec<(&'static str, u64)> {
    let (windowing, blocks) = (Windowing::for_device(limits), Blocks::new(limits));
    let of = |(width, height)| ScratchBytes::new(windowing, &blocks, PhotoFormat::Rgba8, width, height);
    ScratchBytes::maximum(sizes.into_iter().map(of)).requests(limits)
}
