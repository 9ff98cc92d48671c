//! The frame in which a data set is trained.

use glam::DVec3;

use super::planned_view::PlannedView;
use ashsplat::scene::median_ball;
use ashsplat::scene::{SourcePoints, WorldFrame};

/// Most points and views that are sampled.
const SAMPLE: usize = 2000;
const VIEWS: usize = 200;

/// The near depth is the depth below which one in this many visible points lies.
const NEAR_SHARE: usize = 20;

/// Near depths, source units, at which the unit stays 1. Below, the near limit of 0.2 hides Gaussians: at 0.2 the demo
/// loses 3 dB. Above, inverse depths are too small for the losses that compare them.
const KEPT: std::ops::Range<f64> = 0.3..1000.0;

/// Distance from a frame's origin, in radii of the data set, at which single precision resolves a 16,000th of the
/// radius. Nearer data sets keep the origin of their files, so that a model's PLY has their coordinates.
const FAR: f64 = 1000.0;

/// The frame of a data set. Its origin is the default, or the middle of points and cameras if they are far from that.
/// Its unit brings the near depth to between 1 and 10.
///
/// Without visible points, the cameras' median distance from their middle replaces the near depth.
pub(super) fn frame_of(views: &[&PlannedView], points: &SourcePoints) -> WorldFrame {
    let mut depths: Vec<f64> = Vec::new();
    for view in views.iter().step_by(views.len().div_ceil(VIEWS).max(1)) {
        depths.extend(sample(points).filter_map(|point| view.depth_of(point)));
    }
    let near = match depths.len() / NEAR_SHARE {
        0 => median_ball(&centers(views)).map_or(0.0, |(_, radius)| radius),
        rank => *depths.select_nth_unstable_by(rank, f64::total_cmp).1,
    };
    let decade = 10f64.powi(near.log10().floor() as i32);
    let keeps = KEPT.contains(&near) || !(decade > 0.0 && decade.is_finite());
    let usual = WorldFrame::default();
    let is_far = is_far(views, points, &usual);
    let around = if is_far { WorldFrame::around(&all(views, points)) } else { usual };
    WorldFrame { unit: if keeps { 1.0 } else { decade }, ..around }
}

/// True if single precision rounds a data set in a frame that was not chosen for it, such as the frame of another scene
/// or of a checkpoint older than frames.
pub(super) fn is_far(views: &[&PlannedView], points: &SourcePoints, frame: &WorldFrame) -> bool {
    median_ball(&all(views, points))
        .is_some_and(|(center, radius)| center.distance(frame.origin) > FAR * radius)
}

fn sample(points: &SourcePoints) -> impl Iterator<Item = DVec3> {
    points.positions.iter().copied().step_by(points.len().div_ceil(SAMPLE).max(1))
}

fn centers(views: &[&PlannedView]) -> Vec<DVec3> {
    views.iter().map(|view| view.source_position()).collect()
}

/// A sample of the points, and all cameras.
fn all(views: &[&PlannedView], points: &SourcePoints) -> Vec<DVec3> {
    sample(points).chain(centers(views)).collect()
}
