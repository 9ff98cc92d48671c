//! A view of a data set with its photograph.

use std::sync::Arc;

use crate::images::StoredPhoto;
use ashsplat::Result;
use ashsplat::passes::loss::DepthPoint;
use ashsplat::scene::Camera;

/// One photograph and its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Path below the images folder.
    pub name: String,
    /// Id in the COLMAP model, or index in the order of names.
    pub image_id: u32,
    /// Id of the camera that took it, in the COLMAP model; 0 for all views of a transforms.json.
    pub camera_id: u32,
    /// The camera at the photo's size in memory.
    pub camera: Camera,
    /// The camera at the photo's size in its file.
    pub original_camera: Camera,
    /// The photo, undistorted and scaled by [`DatasetOptions::resolution`](super::DatasetOptions::resolution), and its mask.
    pub photo: StoredPhoto,
    /// Inverse depth of each pixel: [`TrainView::inverse_depth`](ashsplat::TrainView::inverse_depth). Present only with
    /// [`DatasetOptions::depths`](super::DatasetOptions::depths), for training views.
    pub inverse_depth: Option<Arc<[f32]>>,
    /// Sparse points that the photo shows: [`TrainView::depth_points`](ashsplat::TrainView::depth_points). Present only
    /// after [`Gallery::read_tracks`](super::Gallery::read_tracks), for training views.
    pub depth_points: Option<Arc<[DepthPoint]>>,
}

impl View {
    /// The view with a mask on its right half, the columns from ⌊width / 2⌋.
    pub(super) fn left_half(&self) -> Result<Self> {
        let width = self.photo.width as usize;
        let photo = self.photo.hiding(|pixel| pixel % width >= width / 2)?;
        Ok(Self { photo, ..self.clone() })
    }
}
