//! Scratch memory of the loss.

use super::{Loss, Windowing};
use crate::plan::{Strips, tile_grid};
use crate::vk::Limits;

/// Maximum number of columns per invocation of [`Windowing::Sweeps`], which reads ten more.
const SWEEP_COLUMNS: u32 = 160;

/// Division of an image into sweeps.
#[derive(Clone, Copy)]
pub(super) struct Sweeps {
    /// Number of columns per invocation.
    pub columns: u32,
    /// Number of invocations per channel.
    pub per_channel: u32,
}

impl Sweeps {
    pub fn new(width: u32, height: u32) -> Self {
        let columns = width.div_ceil(width.div_ceil(SWEEP_COLUMNS).max(1)).max(1);
        Self { columns, per_channel: Strips { width, height }.count() * width.div_ceil(columns) }
    }
}

/// Bytes of the scratch buffers of an image.
#[derive(Clone, Copy, Default)]
pub(super) struct ScratchBytes {
    partials: u64,
    /// Bytes of SSIM's derivatives for one channel.
    derivatives: u64,
}

impl ScratchBytes {
    pub fn of(loss: &Loss, width: u32, height: u32) -> Self {
        Self::new(loss.windows.windowing(), width, height)
    }

    /// The largest size of each buffer over images of these sizes.
    pub fn largest(loss: &Loss, sizes: impl IntoIterator<Item = (u32, u32)>) -> Self {
        Self::maximum(sizes.into_iter().map(|(width, height)| Self::of(loss, width, height)))
    }

    fn maximum(all: impl Iterator<Item = Self>) -> Self {
        all.reduce(|a, b| Self {
            partials: a.partials.max(b.partials),
            derivatives: a.derivatives.max(b.derivatives),
        })
        .unwrap_or_default()
    }

    fn new(windowing: Windowing, width: u32, height: u32) -> Self {
        match windowing {
            Windowing::Blocks => {
                // Window blocks have the size of tiles.
                let (columns, rows) = tile_grid(width, height);
                let pixels = u64::from(width) * u64::from(height);
                Self { partials: 3 * u64::from(columns * rows) * 8, derivatives: 12 * pixels }
            }
            Windowing::Sweeps => Self {
                partials: 3 * u64::from(Sweeps::new(width, height).per_channel) * 8,
                derivatives: 12 * Strips { width, height }.values(),
            },
        }
    }

    /// Number of partial sums.
    pub fn partials(&self) -> u32 {
        (self.partials / 8) as u32
    }

    /// Buffers of the partial sums and derivatives. The derivatives have one buffer for all channels, or one per channel if one
    /// would exceed the largest binding.
    pub fn requests(&self, limits: &Limits) -> Vec<(&'static str, u64)> {
        let mut requests = vec![("loss_partials", self.partials)];
        if 3 * self.derivatives <= limits.max_storage_buffer_range {
            requests.push(("ssim_derivatives", 3 * self.derivatives));
        } else {
            requests.extend([("ssim_derivatives", self.derivatives); 3]);
        }
        requests
    }
}
