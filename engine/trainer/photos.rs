//! Photographs on the device, 8 bits per channel.

use super::TrainView;
use crate::error::{Error, Result};
use crate::vk::{Buffer, Context, MemoryKind};

/// One buffer of RGBA8 texels per view.
pub(super) struct Photos(Vec<Buffer>);

impl Photos {
    /// Uploads the views' photographs.
    pub fn upload(context: &Context, views: &[TrainView]) -> Result<Self> {
        for (index, TrainView { camera, photo }) in views.iter().enumerate() {
            camera.check()?;
            if (photo.width, photo.height) != (camera.width, camera.height) {
                let problem = format!(
                    "the photo has {}x{} pixels, its camera {}x{}; they must agree",
                    photo.width, photo.height, camera.width, camera.height
                );
                return Err(Error::argument(format!("view {index}"), problem));
            }
            if photo.rgb.len() != photo.width as usize * photo.height as usize * 3 {
                let problem = format!("the photo has {} bytes, not three per pixel", photo.rgb.len());
                return Err(Error::argument(format!("view {index}"), problem));
            }
        }
        let bytes = |view: &TrainView| u64::from(view.photo.width) * u64::from(view.photo.height) * 4;
        let requests: Vec<(&'static str, u64)> = views.iter().map(|view| ("photo", bytes(view))).collect();
        let buffers = context.allocate("photos", &requests, MemoryKind::Device)?;
        for (buffer, view) in buffers.iter().zip(views) {
            let texels: Vec<u8> =
                view.photo.rgb.chunks_exact(3).flat_map(|rgb| [rgb[0], rgb[1], rgb[2], 255]).collect();
            context.upload(buffer, &texels)?;
        }
        Ok(Self(buffers))
    }

    /// The texels of a view.
    pub fn of(&self, view: usize) -> &Buffer {
        &self.0[view]
    }
}
