//! Known depths of the views on the device: inverse-depth maps and sparse points.

use super::TrainView;
use super::photos::PhotoSize;
use crate::error::Result;
use crate::loss::DepthPointBuffers;
use crate::vk::{Buffer, Context, MemoryKind};

/// Per view: its inverse-depth map (a float per pixel, row by row) and its sparse points, if it has them.
pub(super) struct DepthMaps(Vec<(Option<Buffer>, Option<DepthPointBuffers>)>);

/// Buffers of all views in order, each view's map before its points.
fn requests(photos: &[PhotoSize]) -> Vec<(&'static str, u64)> {
    let of_photo = |photo: &PhotoSize| {
        let pixels = u64::from(photo.width) * u64::from(photo.height);
        let map = photo.inverse_depth.then_some(("inverse_depth_map", 4 * pixels));
        let points = Some(photo.depth_points).filter(|&count| count > 0).map(DepthPointBuffers::requests);
        map.into_iter().chain(points.into_iter().flatten())
    };
    photos.iter().flat_map(of_photo).collect()
}

/// Bytes of device memory for all maps and points.
pub(super) fn device_bytes(context: &Context, photos: &[PhotoSize]) -> u64 {
    match requests(photos) {
        none if none.is_empty() => 0,
        requests => context.allocation_bytes(&requests),
    }
}

impl DepthMaps {
    /// Uploads the maps and points of the views, whose photographs have these sizes.
    pub fn new(context: &Context, views: &[TrainView], sizes: &[PhotoSize]) -> Result<Self> {
        let requests = requests(sizes);
        let buffers = match requests.is_empty() {
            true => Vec::new(),
            false => context.allocate("depth maps", &requests, MemoryKind::Device)?,
        };
        let mut buffers = buffers.into_iter();
        let each = views.iter().zip(sizes).map(|(view, size)| {
            let map = view.inverse_depth.as_ref().and_then(|map| Some((map, buffers.next()?)));
            if let Some((map, buffer)) = &map {
                context.upload(buffer, bytemuck::cast_slice(map))?;
            }
            let points = match &view.depth_points {
                Some(points) if size.depth_points > 0 => {
                    let size = (view.photo.width, view.photo.height);
                    let own = <[Buffer; 3]>::try_from(buffers.by_ref().take(3).collect::<Vec<_>>());
                    let Ok(own) = own else { unreachable!("one buffer per request") };
                    Some(DepthPointBuffers::upload(context, own, points, size)?)
                }
                _ => None,
            };
            Ok((map.map(|(_, buffer)| buffer), points))
        });
        Ok(Self(each.collect::<Result<_>>()?))
    }

    pub fn of(&self, view: usize) -> Option<&Buffer> {
        self.0[view].0.as_ref()
    }

    pub fn points_of(&self, view: usize) -> Option<&DepthPointBuffers> {
        self.0[view].1.as_ref()
    }
}
