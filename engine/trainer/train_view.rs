//! What is trained on.

use crate::loss::DepthPoint;
use crate::scene::{Camera, StoredPhoto};
use std::sync::Arc;

/// A photograph and its camera.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TrainView {
    /// The camera; its size is the photo's.
    pub camera: Camera,
    /// The photo, kept on the device with 8 bits per channel. Masked pixels carry no loss. Photos in a file
    /// are read ahead of the iterations that need them.
    pub photo: StoredPhoto,
    /// The inverse depth that the photo's pixels should have, row by row: the sum of blending weights / z, 1 / world
    /// units. Pixels from [`MAP_NOTHING`](crate::kernels::constants::MAP_NOTHING) on, as infinity, do not count. A view
    /// with one adds [`InverseDepth`](super::InverseDepth) to the loss.
    pub inverse_depth: Option<Arc<[f32]>>,
    /// Sparse points that the photo shows. With [`TrainSettings::depth_points`](super::TrainSettings::depth_points) a view with some adds [`SparseDepth`](super::SparseDepth) to the
    /// loss. Not beside inverse-depth maps.
    pub depth_points: Option<Arc<[DepthPoint]>>,
    /// Which camera took it, by any number: views of one share its [`LensEffects`](crate::scene::LensEffects).
    pub camera_id: u32,
}

impl TrainView {
    /// A view to train on.
    pub fn new(camera: Camera, photo: impl Into<StoredPhoto>) -> Self {
        Self { camera, photo: photo.into(), inverse_depth: None, depth_points: None, camera_id: 0 }
    }

    /// The view with an inverse-depth map: [`TrainView::inverse_depth`].
    #[must_use]
    pub fn with_inverse_depth(self, map: Option<Arc<[f32]>>) -> Self {
        Self { inverse_depth: map, ..self }
    }

    /// The view with sparse points: [`TrainView::depth_points`].
    #[must_use]
    pub fn with_depth_points(self, points: Option<Arc<[DepthPoint]>>) -> Self {
        Self { depth_points: points, ..self }
    }

    /// The view as taken by a camera: [`TrainView::camera_id`].
    #[must_use]
    pub fn taken_by(self, camera_id: u32) -> Self {
        Self { camera_id, ..self }
    }
}
