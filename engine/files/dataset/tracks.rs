//! The sparse points that a data set's photos show.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::{Gallery, View};
use crate::colmap::{self, Model};
use ashsplat::Result;
use ashsplat::loss::DepthPoint;

/// Positions of points, world.
pub(super) type Track = Arc<[Vec3]>;

impl Gallery {
    /// Reads the points that each photo shows, for [`View::depth_points`] of the training views. Returns their number
    /// over all views: 0 for `transforms.json` and for models without observations. A point's position alone does not
    /// tell if a photo shows it, because other surfaces may hide it.
    ///
    /// # Errors
    /// Same as [`Model::read`].
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

    /// Number of points that a training view shows.
    pub(super) fn track_length(&self, view: usize) -> u32 {
        let track = self.tracks.get(view).and_then(Option::as_ref);
        track.map_or(0, |track| u32::try_from(track.len()).unwrap_or(u32::MAX))
    }
}

/// The points of a track inside a view's picture, except those under its mask.
pub(super) fn depth_points(view: &View, track: &[Vec3]) -> Result<Arc<[DepthPoint]>> {
    let mask = view.photo.mask()?;
    let (width, height) = (view.photo.width, view.photo.height);
    // Points lie at least half a pixel within the edges, so that their depth can be interpolated.
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
