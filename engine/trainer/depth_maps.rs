//! The views' inverse-depth maps on the device.

use super::TrainView;
use super::photos::PhotoSize;
use crate::error::Result;
use crate::vk::{Buffer, Context, MemoryKind};

/// A buffer per view that has a map: a float per pixel, row by row.
pub(super) struct DepthMaps(Vec<Option<Buffer>>);

fn requests(photos: &[PhotoSize]) -> Vec<(&'static str, u64)> {
    let bytes = |photo: &PhotoSize| 4 * u64::from(photo.width) * u64::from(photo.height);
    let mapped = photos.iter().filter(|photo| photo.inverse_depth);
    mapped.map(|photo| ("inverse_depth_map", bytes(photo))).collect()
}

/// Bytes of device memory that the maps take.
pub(super) fn device_bytes(context: &Context, photos: &[PhotoSize]) -> u64 {
    match requests(photos) {
        none if none.is_empty() => 0,
        requests => context.allocation_bytes(&requests),
    }
}

impl DepthMaps {
    /// Uploads the views' maps; the photographs have these sizes.
    pub fn new(context: &Context, views: &[TrainView], sizes: &[PhotoSize]) -> Result<Self> {
        let requests = requests(sizes);
        if requests.is_empty() {
            return Ok(Self(vec![None; views.len()]));
        }
        let mut buffers = context.allocate("depth maps", &requests, MemoryKind::Device)?.into_iter();
        let each = views.iter().map(|view| {
            let Some(map) = &view.inverse_depth else { return Ok(None) };
            let buffer = buffers.next();
            buffer.iter().try_for_each(|buffer| context.upload(buffer, bytemuck::cast_slice(map)))?;
            Ok(buffer)
        });
        Ok(Self(each.collect::<Result<_>>()?))
    }

    /// The map of a view.
    pub fn of(&self, view: usize) -> Option<&Buffer> {
        self.0[view].as_ref()
    }
}
