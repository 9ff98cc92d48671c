//! Prepares a data set for a run.

use ashsplat::scene::{Camera, WorldFrame};
use ashsplat::train::TrainView;
use ashsplat::vk::Context;
use ashsplat_files::images::existing_folder;
use ashsplat_files::{Dataset, PhotoMemory, View};
use ashsplat_program::config::Settings;
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

/// Number of training views that replace a test set if none is held out.
const STAND_IN_VIEWS: usize = 5;

#[derive(Clone)]
pub struct Data {
    pub train: Vec<TrainView>,
    /// Extent of the scene, world units.
    pub scene_extent: f32,
}

/// Views that a run keeps.
pub struct Views {
    /// Names of the training views, in their order.
    pub trained: Vec<String>,
    pub test: Vec<View>,
    /// Original cameras, held-out ones first.
    pub cameras: Vec<(String, Camera)>,
    /// The same cameras at the photos' sizes in memory.
    pub used: Vec<Camera>,
    pub frame: WorldFrame,
    /// Camera ids by photo name.
    pub takers: BTreeMap<String, u32>,
    /// True if `test` was held out, false for a sample of the training views.
    pub held_out: bool,
}

/// Divides a data set into what the trainer needs and what the run keeps.
pub fn split(dataset: Dataset, settings: &Settings) -> (Data, Views) {
    let Dataset { frame, train, test, scene_extent, .. } = dataset;
    let scene_extent = settings.data.extent(scene_extent, &frame);
    let own = |view: &View| (view.name.clone(), view.original_camera);
    // A view may be trained on and held out, one half each.
    let held_out: HashSet<&str> = test.iter().map(|view| view.name.as_str()).collect();
    let others = train.iter().filter(|view| !held_out.contains(view.name.as_str()));
    let used = test.iter().chain(others.clone()).map(|view| view.camera).collect();
    let cameras = test.iter().chain(others).map(own).collect();
    let takers = test.iter().chain(&train).map(|view| (view.name.clone(), view.camera_id)).collect();
    let trained = train.iter().map(|view| view.name.clone()).collect();
    let held_out = !test.is_empty();
    let sample = || stand_ins(train.len()).map(|index| train[index].clone()).collect();
    let test = if held_out { test } else { sample() };
    let train = train.into_iter().map(train_view).collect();
    (Data { train, scene_extent }, Views { trained, test, cameras, used, frame, takers, held_out })
}

fn train_view(view: View) -> TrainView {
    let View { camera, photo, camera_id, inverse_depth, depth_points, .. } = view;
    TrainView { camera, photo, camera_id, inverse_depth, depth_points }
}

/// Indices of the training views that replace held-out ones.
pub fn stand_ins(views: usize) -> impl Iterator<Item = usize> {
    (0..views).step_by(views.div_ceil(STAND_IN_VIEWS).max(1))
}

/// Memory budget of photos: the requested one, or half of the device's limit. Where the device has none, half of the host's bounds them.
pub fn photo_memory(context: &Context, requested: Option<u64>, model: &Path) -> PhotoMemory {
    let of_device = || context.memory_limit().map_or(u64::MAX, |(limit, _)| limit / 2);
    PhotoMemory { bytes: requested.unwrap_or_else(of_device), folder: existing_folder(model) }
}
