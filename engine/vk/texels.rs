//! Buffers that kernels read as texels.
//!
//! A shader declares `uniform textureBuffer name;` (vec4 of f32) or `uniform utextureBuffer name;` (u32), reads with
//! `texelFetch(name, index)`, and is bound to an ordinary [`super::Buffer`]. On a GPU this is equivalent to a storage
//! buffer. llvmpipe fetches a texel for all lanes by vector instructions. It reads every component of a storage buffer in a
//! loop over the lanes: a vec4 by texel costs a quarter.

use super::debug::vk_error;
use super::raw_device::RawDevice;
use crate::Result;
use ash::vk;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Format of a texel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TexelFormat {
    /// Four f32: `textureBuffer`.
    Rgba32Float,
    /// One u32: `utextureBuffer`.
    R32Uint,
}

impl TexelFormat {
    /// Bytes of a texel.
    pub fn bytes(self) -> u64 {
        match self {
            Self::Rgba32Float => 16,
            Self::R32Uint => 4,
        }
    }

    fn raw(self) -> vk::Format {
        match self {
            Self::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
            Self::R32Uint => vk::Format::R32_UINT,
        }
    }
}

/// A range of a block, read as texels.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct TexelRange {
    pub offset: u64,
    pub bytes: u64,
    pub format: TexelFormat,
}

/// Texel views of a block, created on first use. The block calls [`TexelViews::destroy`] at its end.
#[derive(Default)]
pub(super) struct TexelViews(Mutex<HashMap<TexelRange, vk::BufferView>>);

impl TexelViews {
    /// Returns the view of a range of a buffer. Its offset must be aligned and its texels within the limit.
    pub fn of(&self, device: &RawDevice, buffer: vk::Buffer, range: TexelRange) -> Result<vk::BufferView> {
        let mut views = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(view) = views.get(&range) {
            return Ok(*view);
        }
        let bytes = range.bytes / range.format.bytes() * range.format.bytes();
        let info = vk::BufferViewCreateInfo::default()
            .buffer(buffer)
            .format(range.format.raw())
            .offset(range.offset)
            .range(bytes);
        // SAFETY: a range of a buffer with UNIFORM_TEXEL_BUFFER usage, checked by the recorder; every device has to
        // support both formats.
        let view = unsafe { device.create_buffer_view(&info, None) };
        let view = view.map_err(vk_error("vkCreateBufferView"))?;
        views.insert(range, view);
        Ok(view)
    }

    /// Destroys the views. No recording that uses one may be running.
    pub fn destroy(&mut self, device: &RawDevice) {
        for (_, view) in self.0.get_mut().unwrap_or_else(PoisonError::into_inner).drain() {
            // SAFETY: idle, as the caller sees to; destroyed once.
            unsafe { device.destroy_buffer_view(view, None) }
        }
    }
}
