//! Scenes, batches and views of a recording.

use super::recorded_frame::RecordedFrame;
use crate::frame::{Batch, FrameBatches, PlacedScene};
use crate::scene::Camera;
use std::ops::Range;

/// Lists of a recording. The next one reuses their memory: a test counts allocations.
#[derive(Default)]
pub(super) struct RecordingLists<'a> {
    /// Scenes of all views.
    pub scenes: Vec<PlacedScene<'a>>,
    /// Batches of all views.
    pub batches: Vec<Batch>,
    pub views: Vec<ViewLists>,
}

/// Ranges of a view in the lists of a recording.
pub(super) struct ViewLists {
    pub scenes: Range<usize>,
    pub batches: Range<usize>,
    /// True if the batches draw all scenes.
    pub draw_all: bool,
}

impl<'a> RecordingLists<'a> {
    pub fn scenes_of(&self, view: usize) -> &[PlacedScene<'a>] {
        &self.scenes[self.views[view].scenes.clone()]
    }

    pub fn batches_of(&self, view: usize) -> FrameBatches<'_> {
        let ViewLists { batches, draw_all, .. } = &self.views[view];
        FrameBatches { list: &self.batches[batches.clone()], draw_all: *draw_all }
    }

    /// Returns how many views, from `first` on, can share one order. They have its scenes, its settings, and bit-identical depths.
    pub fn with_one_order(&self, views: &[RecordedFrame<'_>], first: usize) -> usize {
        let (frame, scenes) = (&views[first], self.scenes_of(first));
        let has_order = |view: &usize| {
            let own = &views[*view];
            std::ptr::eq(own.scenes, frame.scenes)
                && own.settings == frame.settings
                && own.camera.projection == frame.camera.projection
                && !frame.camera.projection.orders_by_distance()
                && !frame.variant().distance_order
                && [own, frame].iter().all(|view| view.camera.shutter.is_none())
                && self.scenes_of(*view).iter().map(depth_bits).eq(scenes.iter().map(depth_bits))
        };
        1 + (first + 1..views.len()).take_while(has_order).count()
    }

    /// Returns empty lists in the same memory, for scenes that live longer or shorter. Collecting into a list of the same type
    /// reuses it.
    pub fn emptied<'b>(self) -> RecordingLists<'b> {
        let Self { mut scenes, mut batches, mut views } = self;
        scenes.clear();
        batches.clear();
        views.clear();
        let scenes = scenes.into_iter().map(|_| unreachable!("it is empty")).collect();
        RecordingLists { scenes, batches, views }
    }
}

/// Returns the bits that determine the depth of a scene's Gaussians, beside the scene and its scale.
fn depth_bits(placed: &PlacedScene<'_>) -> [u32; 4] {
    let Camera { camera_from_world, translation, .. } = placed.camera;
    let row = camera_from_world.row(2);
    [row.x, row.y, row.z, translation.z].map(f32::to_bits)
}
