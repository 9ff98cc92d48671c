//! Views of a training.

use crate::loss::DepthPoint;
use crate::scene::{Camera, StoredPhoto};
use std::sync::Arc;

/// A photograph and its camera.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TrainView {
    /// Camera of the photograph, with its size.
    pub camera: Camera,
    /// Photograph, kept on the device with 8 bits per channel. Masked pixels carry no loss. Photographs in a file are read
    /// ahead of the iterations that need them.
    pub photo: StoredPhoto,
    /// Inverse depth that the photograph's pixels should have, row by row: the sum of blending weights / z, 1 / world units.
    /// Pixels of [`MAP_NOTHING`](crate::kernels::constants::MAP_NOTHING) and above, like infinity, do not count. A view with a
    /// map adds [`InverseDepth`](super::InverseDepth) to the loss.
    pub inverse_depth: Option<Arc<[f32]>>,
    /// Any id of the camera that took the photograph. Views with the same id share [`LensEffects`](crate::scene::LensEffects).
    pub camera_id: u32,
    /// Sparse points that the photograph shows. With [`TrainSettings::depth_points`](super::TrainSettings::depth_points) a view
    /// with points adds [`SparseDepth`](super::SparseDepth) to the loss. Excludes inverse-depth maps.
    pub depth_points: Option<Arc<[DepthPoint]>>,
}

impl TrainView {
    /// Creates a view to train on.
    pub fn new(camera: Camera, photo: impl Into<StoredPhoto>) -> Self {
        Self { camera, photo: photo.into(), inverse_depth: None, camera_id: 0, depth_points: None }
    }

    /// Returns the view with an inverse-depth map: [`TrainView::inverse_depth`].
    #[must_use]
    pub fn with_inverse_depth(self, map: Option<Arc<[f32]>>) -> Self {
        Self { inverse_depth: map, ..self }
    }

    /// Returns the view with the id of its camera: [`TrainView::camera_id`].
    #[must_use]
    pub fn taken_by(self, camera_id: u32) -> Self {
        Self { camera_id, ..self }
    }

    /// Returns the view with sparse points: [`TrainView::depth_points`].
    #[must_use]
    pub fn with_depth_points(self, points: Option<Arc<[DepthPoint]>>) -> Self {
        Self { depth_points: points, ..self }
    }
}
