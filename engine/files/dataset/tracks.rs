//! The sparse points that a data set's photos are known to show.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::{Gallery, View};
use crate::colmap::{self, Model};
use ashsplat::Result;
use ashsplat::loss::DepthPoint;

/// Positions of points, world.
pub(super) type Track = Arc<[Vec3]>;

impl Gallery {
    /// Reads which of the model's points each photo shows, so that the views to train on have them
    /// ([`View::depth_points`]). Returns how many that are, in all views together: 0 where the data set does not say, as
    /// `transforms.json` and models without observations do not. Whether a photo shows a point cannot be told from the point's
    /// place: others may hide it.
    ///
    /// # Errors
    /// As [`Model::read`].
    pub fn read_tracks(&mut self) -> Result<usize> {
        let folder = self.unpacked.folder();
        if !colmap::exists(folder) || self.source.extension().is_some_and(|ending| ending == "json") {
            return Ok(0);
        }
        let read = || colmap::tracks(&Model::of_dataset(folder)?);
        let mut shown = read().map_err(|error| self.unpacked.name(error))?;
        let of_view = |(view, held_out): (&super::planned_view::PlannedView, &bool)| -> Option<Track> {
            let trained = self.is_trained(*held_out);
            let points = shown.remove(&view.image_id).filter(|points| trained && !points.is_empty())?;
            Some(points.into_iter().map(|point| self.frame.world(DVec3::from_array(point))).collect())
        };
        self.tracks = self.views.iter().zip(&self.held_out).map(of_view).collect();
        Ok(self.tracks.iter().flatten().map(|track| track.len()).sum())
    }

    /// Number of points that a view is known to show, if it is trained on.
    pub(super) fn track_length(&self, view: usize) -> u32 {
        let track = self.tracks.get(view).and_then(Option::as_ref);
        track.map_or(0, |track| u32::try_from(track.len()).unwrap_or(u32::MAX))
    }
}

/// The points of a track that a view has in its picture, where its mask hides none.
pub(super) fn depth_points(view: &View, track: &[Vec3]) -> Result<Arc<[DepthPoint]>> {
    let mask = view.photo.mask()?;
    let (width, height) = (view.photo.width, view.photo.height);
    // Half a pixel within the edges, so that there is something to interpolate between.
    let last = [width, height].map(|side| side as f32 - 1.0);
    let point = |&position: &Vec3| {
        let (x, y, z) = view.camera.project(position);
        let position_px = [x - 0.5, y - 0.5];
        let inside = (0..2).all(|axis| position_px[axis] >= 0.0 && position_px[axis] <= last[axis]);
        let inverse_z = 1.0 / z;
        if !(inside && inverse_z > 0.0 && inverse_z.is_finite()) {
            return None;
        }
        let [column, row] = position_px.map(|p| p.round() as usize);
        let counts = mask.as_ref().is_none_or(|mask| mask[row * width as usize + column] != 0);
        counts.then_some(DepthPoint { position_px, inverse_z })
    };
    Ok(track.iter().filter_map(point).collect())
}
