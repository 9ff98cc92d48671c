//! Reads single photos of a data set, for applications that need only a few.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::plan::{Level, Plan};
use super::planned_view::{Crop, Mask, PlannedView, Track};
use super::unpacked::Unpacked;
use super::{AlphaUse, DatasetOptions, View, reader};
use crate::cameras_json::NamedCamera;
use crate::colmap::{self, Model};
use crate::progress::Progress;
use ashsplat::passes::loss::DepthPoint;
use ashsplat::scene::{Camera, PointCloud, WorldFrame, scene_extent};
use ashsplat::train::PhotoSize;
use ashsplat::{Error, Result};

/// The views of a data set. Their photos are read on request.
pub struct Gallery {
    pub(super) unpacked: Unpacked,
    pub(super) options: DatasetOptions,
    pub(super) plan: Plan,
}

impl Gallery {
    /// Opens a data set. A ZIP stays unpacked as long as this value lives. The photos are not decoded.
    pub fn open(path: impl AsRef<Path>, options: &DatasetOptions, progress: Progress<'_>) -> Result<Self> {
        let unpacked = Unpacked::open(path.as_ref(), progress)?;
        let open = || {
            let mut plan = reader::plan(&unpacked.folder, options)?;
            plan.take_problems().into_iter().next().map_or(Ok(()), Err)?;
            plan.check_views()?;
            plan.find_depth_maps(&unpacked.folder, options)?;
            Ok(plan)
        };
        let mut plan = open().map_err(|error| unpacked.name(error))?;
        plan.name_paths(&unpacked);
        Ok(Self { unpacked, options: options.clone(), plan })
    }

    /// Removes all views except those with these names. The choice of held-out views stays as it was.
    pub fn keep(&mut self, names: &BTreeSet<String>) -> Result<()> {
        let known: BTreeSet<&str> = self.plan.views.iter().map(|view| view.name.as_str()).collect();
        if let Some(missing) = names.iter().find(|name| !known.contains(name.as_str())) {
            let problem = format!("has no photo {missing}, which is to be used");
            let remedy = "give the data set that the list of photos was made for";
            return Err(self.unpacked.name(Error::input(&self.plan.list, problem, remedy)));
        }
        self.plan.views.retain(|view| names.contains(&view.name));
        Ok(())
    }

    /// Hides further pixels of a view, where `counts` is false: a coarse picture of this size over the whole view.
    pub fn hide(&mut self, index: usize, (width, height): (u32, u32), counts: &[bool]) -> Result<()> {
        let mask = Mask::coarse(width, height, counts)?;
        self.planned(index)?.coarse_mask = Some(mask);
        Ok(())
    }

    /// Uses a part of a view's photo in place of the whole. The part covers these columns and rows of a coarse picture
    /// of this width and height, the border that their gradients depend on, and the rest of whole 16-pixel tiles.
    /// Camera, masks, inverse-depth maps and points are cut to it
    /// ([`Camera::part()`](ashsplat::scene::Camera::part())).
    pub fn use_part(
        &mut self,
        index: usize,
        coarse: (u32, u32),
        columns: Range<u32>,
        rows: Range<u32>,
    ) -> Result<()> {
        let part = Crop::of(coarse, columns, rows)?;
        self.planned(index)?.crop = Some(part);
        Ok(())
    }

    /// Share of a view's photo that is used; 1 without [`Gallery::use_part`]. `None` for an index out of range.
    pub fn share_used(&self, index: usize) -> Option<f64> {
        self.plan.views.get(index).map(PlannedView::share_used)
    }

    /// Undoes [`Gallery::use_part`] for all views.
    #[must_use]
    pub fn with_whole_photos(mut self) -> Self {
        self.plan.views.iter_mut().for_each(|view| view.crop = None);
        self
    }

    /// Cameras of the used parts of the photos, at the sizes that the photos will have when they are read.
    pub fn used_cameras(&self) -> Result<Vec<Camera>> {
        let used =
            |view: &PlannedView| view.used_camera(&self.options).map_err(|error| self.unpacked.name(error));
        self.plan.views.iter().map(used).collect()
    }

    /// The views that are trained on, as a whole or as a half, with their indices.
    pub(super) fn trained(&self) -> impl Iterator<Item = (usize, &PlannedView)> {
        self.plan.views.iter().enumerate().filter(|(_, view)| view.is_trained(&self.options))
    }

    fn planned(&mut self, index: usize) -> Result<&mut PlannedView> {
        let count = self.plan.views.len();
        let problem = || format!("is {index}, there are {count}");
        self.plan.views.get_mut(index).ok_or_else(|| Error::argument("view", problem()))
    }

    /// The cameras by name, at the photos' own sizes.
    pub fn cameras(&self) -> Vec<NamedCamera> {
        self.cameras_in(&self.plan.frame)
    }

    /// The cameras by name, at the photos' own sizes, in the world coordinates of another frame.
    pub fn cameras_in(&self, frame: &WorldFrame) -> Vec<NamedCamera> {
        let named =
            |view: &PlannedView| NamedCamera { name: view.name.clone(), camera: view.camera_in(frame) };
        self.plan.views.iter().map(named).collect()
    }

    /// The training photos with the sizes that they will have. Masks and transparency are known once they are read.
    pub fn train_photos(&self) -> Vec<PhotoSize> {
        let size = |(_, view): (usize, &PlannedView)| {
            let (width, height) = view.size(&self.options);
            let points = view.track.as_ref().map_or(0, |track| track.len());
            PhotoSize {
                name: view.name.clone(),
                width,
                height,
                masked: view.held_out || view.coarse_mask.is_some(),
                inverse_depth: view.map.is_some(),
                depth_points: u32::try_from(points).unwrap_or(u32::MAX),
            }
        };
        self.trained().map(size).collect()
    }

    /// 1.1 × the largest distance of a training camera to their mean, world units; 0 if all are at one place.
    pub fn scene_extent(&self) -> f32 {
        scene_extent(self.trained().map(|(_, view)| view.camera().position()))
    }

    /// The photos' memory budget, if they exceed it and will be kept in a file.
    pub fn file_memory(&self) -> Option<u64> {
        self.options.beyond_memory(self.texel_bytes()).map(|memory| memory.bytes)
    }

    /// Estimated bytes of the kept inverse-depth maps.
    pub(super) fn map_bytes(&self) -> u64 {
        // A map's float per pixel takes the four bytes of a texel.
        let kept = self.trained().filter(|(_, view)| view.map.is_some());
        kept.map(|(_, view)| view.texel_bytes(&self.options)).sum()
    }

    /// Estimated bytes of all kept photos.
    pub(super) fn texel_bytes(&self) -> u64 {
        let copies = |view: &PlannedView| if view.held_out && self.options.train_test_exp { 2 } else { 1 };
        self.plan.views.iter().map(|view| copies(view) * view.texel_bytes(&self.options)).sum()
    }

    /// True for each held-out view, by name; all false without [`DatasetOptions::eval`].
    pub fn held_out(&self) -> Vec<bool> {
        self.plan.views.iter().map(|view| view.held_out).collect()
    }

    /// True if the data set says itself which views are held out.
    pub fn has_split(&self) -> bool {
        self.plan.has_split
    }

    /// Warnings that do not prevent the use of the photos.
    pub fn warnings(&self) -> &[String] {
        &self.plan.warnings
    }

    /// Harmless notes on the treatment of the photos, one line each.
    pub fn notes(&self) -> &[String] {
        &self.plan.notes
    }

    /// The frame of cameras and points.
    pub fn frame(&self) -> &WorldFrame {
        &self.plan.frame
    }

    /// The rotation with which the data set was read; never [`Level::On`].
    pub fn level(&self) -> Level {
        self.plan.level
    }

    /// The data set's points. There may be none.
    pub fn points(&self) -> &PointCloud {
        &self.plan.points
    }

    /// Width and height in pixels that a photo will have when it is read; `None` for an index out of range.
    pub fn size(&self, index: usize) -> Option<(u32, u32)> {
        Some(self.plan.views.get(index)?.size(&self.options))
    }

    /// False if no mask hides pixels of a photo, which is known before it is read.
    pub fn may_be_masked(&self, index: usize) -> bool {
        let masked = |view: &PlannedView| {
            let named = view.mask_path.is_some() || view.coarse_mask.is_some() || view.rim.is_some();
            named || self.options.alpha == AlphaUse::Mask
        };
        self.plan.views.get(index).is_some_and(masked)
    }

    /// Reads a photo as the options say; `None` for an index out of range.
    pub fn view(&self, index: usize) -> Option<Result<View>> {
        let view = self.plan.views.get(index)?;
        let loaded = view.load(&self.options).map_err(|error| self.unpacked.name(error));
        Some(loaded.map(|(view, _)| view))
    }
}

impl Gallery {
    /// Reads the points that each photo shows, for [`View::depth_points`] of the training views. Returns their number
    /// over all views: 0 for `transforms.json` and for models without observations. A point's position alone does not
    /// tell if a photo shows it, because other surfaces may hide it.
    pub fn read_tracks(&mut self) -> Result<usize> {
        let tracks = self.shown_points(u64::MAX)?;
        let count = tracks.iter().flatten().map(|track| track.len()).sum();
        self.plan.views.iter_mut().zip(tracks).for_each(|(view, track)| view.track = track);
        Ok(count)
    }

    /// The points that each training view shows; empty for data sets that do not say so, and for longer files of observations.
    pub(super) fn shown_points(&self, max_bytes: u64) -> Result<Vec<Option<Track>>> {
        let folder = &self.unpacked.folder;
        if !colmap::exists(folder) || self.plan.source.extension().is_some_and(|ending| ending == "json") {
            return Ok(Vec::new());
        }
        let model = Model::of_dataset(folder).map_err(|error| self.unpacked.name(error))?;
        if std::fs::metadata(model.file("images")).is_ok_and(|file| file.len() > max_bytes) {
            return Ok(Vec::new());
        }
        let mut shown = colmap::tracks(&model).map_err(|error| self.unpacked.name(error))?;
        let mut tracks = vec![None; self.plan.views.len()];
        for (index, view) in self.trained() {
            let points = shown.remove(&view.image_id).filter(|points| !points.is_empty());
            let world = |point| self.plan.frame.world(self.plan.level.turned(DVec3::from_array(point)));
            tracks[index] = points.map(|points| points.into_iter().map(world).collect::<Track>());
        }
        Ok(tracks)
    }
}

/// The points of a track inside a view's picture, except those under its mask.
pub(super) fn depth_points(view: &View, track: &[Vec3]) -> Result<Arc<[DepthPoint]>> {
    let mask = view.photo.mask()?;
    Ok(track.iter().filter_map(|&position| depth_point(view, mask.as_deref(), position)).collect())
}

/// A point's place in a view's picture; `None` beyond its edges and under its mask.
pub(super) fn depth_point(view: &View, mask: Option<&[u8]>, position: Vec3) -> Option<DepthPoint> {
    let (width, height) = (view.photo.width, view.photo.height);
    // Points lie at least half a pixel within the edges, so that their depth can be interpolated.
    let last = [width, height].map(|side| side as f32 - 1.0);
    let (x, y, z) = view.camera.project(position);
    let position_px = [x - 0.5, y - 0.5];
    let inside = (0..2).all(|axis| position_px[axis] >= 0.0 && position_px[axis] <= last[axis]);
    let inverse_z = 1.0 / z;
    if !(inside && inverse_z > 0.0 && inverse_z.is_finite()) {
        return None;
    }
    let [column, row] = position_px.map(|p| p.round() as usize);
    let counts = mask.is_none_or(|mask| mask[row * width as usize + column] != 0);
    counts.then_some(DepthPoint { position_px, inverse_z })
}
