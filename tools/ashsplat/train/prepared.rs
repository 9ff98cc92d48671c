//! A data set as a run uses it.

use ashsplat::scene::Camera;
use ashsplat::trainer::TrainView;
use ashsplat::vk::Context;
use ashsplat_files::images::existing_folder;
use ashsplat_files::{Dataset, PhotoMemory, View};
use std::path::Path;

/// Views of the training set that stand in for a test set where none is held out.
const STAND_IN_VIEWS: usize = 5;

/// A data set taken apart.
pub struct Prepared {
    /// Held-out ones first.
    pub cameras: Vec<(String, Camera)>,
    pub train: Vec<TrainView>,
    pub test: Vec<View>,
    pub held_out: bool,
    pub scene_extent: f32,
}

impl Prepared {
    pub fn new(dataset: Dataset) -> Prepared {
        let Dataset { train, test, scene_extent, .. } = dataset;
        let own = |view: &View| (view.name.clone(), view.original_camera);
        let cameras = test.iter().chain(&train).map(own).collect();
        let held_out = !test.is_empty();
        let test = if held_out { test } else { sample(&train) };
        let train = train.into_iter().map(|view| TrainView::new(view.camera, view.photo));
        Prepared { cameras, train: train.collect(), test, held_out, scene_extent }
    }
}

/// A few of the training views, evenly spread.
fn sample(train: &[View]) -> Vec<View> {
    let step = train.len().div_ceil(STAND_IN_VIEWS).max(1);
    train.iter().step_by(step).cloned().collect()
}

/// What photos may take of the memory: what was asked for, or half of what there is, where that is known.
pub fn photo_memory(context: &Context, asked: Option<u64>, model: &Path) -> Option<PhotoMemory> {
    let bytes = asked.or_else(|| context.memory_limit().map(|(limit, _)| limit / 2))?;
    Some(PhotoMemory { bytes, folder: existing_folder(model) })
}
