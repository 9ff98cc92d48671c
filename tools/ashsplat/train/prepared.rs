//! A data set as a run uses it.

use super::origin::Origin;
use crate::config::Settings;
use ashsplat::Result;
use ashsplat::plan::to_u32;
use ashsplat::scene::{Camera, WorldFrame};
use ashsplat::trainer::{Forecast, TrainView};
use ashsplat::vk::Context;
use ashsplat_files::images::existing_folder;
use ashsplat_files::{Dataset, Gallery, PhotoMemory, View};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

/// Views of the training set that stand in for a test set where none is held out.
const STAND_IN_VIEWS: usize = 5;

/// A data set taken apart.
pub struct Prepared {
    pub data: Data,
    pub views: Views,
}

/// What a trainer is given of it.
#[derive(Clone)]
pub struct Data {
    pub train: Vec<TrainView>,
    /// World units.
    pub scene_extent: f32,
}

/// What a run keeps of its views.
pub struct Views {
    /// The names of those that are trained on, in their order.
    pub trained: Vec<String>,
    pub test: Vec<View>,
    /// As they were given, held-out ones first.
    pub cameras: Vec<(String, Camera)>,
    /// The cameras' frame.
    pub frame: WorldFrame,
    /// By the names of the photos, the ids of the cameras that took them.
    pub takers: BTreeMap<String, u32>,
    /// Whether `test` was held out, or is a sample of the training views.
    pub held_out: bool,
}

impl Prepared {
    pub fn new(dataset: Dataset, settings: &Settings) -> Prepared {
        let Dataset { frame, train, test, scene_extent, .. } = dataset;
        let scene_extent = settings.data.extent(scene_extent, &frame);
        let own = |view: &View| (view.name.clone(), view.original_camera);
        // A view may be trained on and held out, each for one half.
        let held_out: HashSet<&str> = test.iter().map(|view| view.name.as_str()).collect();
        let others = train.iter().filter(|view| !held_out.contains(view.name.as_str()));
        let cameras = test.iter().chain(others).map(own).collect();
        let takers = test.iter().chain(&train).map(|view| (view.name.clone(), view.camera_id)).collect();
        let trained = train.iter().map(|view| view.name.clone()).collect();
        let held_out = !test.is_empty();
        let test = if held_out { test } else { sample(&train) };
        let train = train.into_iter().map(train_view).collect();
        let views = Views { trained, test, cameras, frame, takers, held_out };
        Prepared { data: Data { train, scene_extent }, views }
    }
}

/// A view as it is trained on.
pub fn train_view(view: View) -> TrainView {
    TrainView::new(view.camera, view.photo)
        .taken_by(view.camera_id)
        .with_inverse_depth(view.inverse_depth)
        .with_depth_points(view.depth_points)
}

/// A few of the training views, evenly spread.
fn sample(train: &[View]) -> Vec<View> {
    stand_ins(train.len()).map(|index| train[index].clone()).collect()
}

/// Which of so many training views stand in for held-out ones.
pub fn stand_ins(views: usize) -> impl Iterator<Item = usize> {
    (0..views).step_by(views.div_ceil(STAND_IN_VIEWS).max(1))
}

/// Refuses what cannot be trained here, from the sizes of the photos: before they are read.
pub fn check_fits(context: &Context, gallery: &Gallery, settings: &Settings, origin: &Origin) -> Result<()> {
    let [gaussians, frozen] = origin.counts(settings, (gallery.points(), gallery.frame()))?;
    Forecast {
        settings: &settings.train,
        photos: &gallery.train_photos(),
        photo_memory: gallery.file_memory(),
        gaussians: to_u32(gaussians as u64)?,
        frozen: to_u32(frozen as u64)?,
        room: origin.checkpoint().map(|checkpoint| &checkpoint.room),
    }
    .check(context)
}

/// What photos may take of the memory: what was asked for, or half of what there is, where that is known.
pub fn photo_memory(context: &Context, asked: Option<u64>, model: &Path) -> Option<PhotoMemory> {
    let bytes = asked.or_else(|| context.memory_limit().map(|(limit, _)| limit / 2))?;
    Some(PhotoMemory { bytes, folder: existing_folder(model) })
}
