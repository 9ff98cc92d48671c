//! The frame in which a data set is trained.

use glam::DVec3;

use super::planned_view::PlannedView;
use ashsplat::scene::world_frame::median_ball;
use ashsplat::scene::{NEAR_PLANE, SourcePoints, WorldFrame};

/// Points and views that are looked at, at most.
const SAMPLE: usize = 2000;
const VIEWS: usize = 200;

/// Depth below which a 20th of the points that the photos show lie.
const NEAR_SHARE: usize = 20;

/// Depths of the near points, source units, at which the unit stays 1. Below, the near limit hides some of them. Above, inverse
/// depths are too small for the losses that compare them.
const KEPT: std::ops::Range<f64> = NEAR_PLANE as f64..1000.0;

/// The frame of a data set: its origin is that of points and cameras, and its unit puts the near points between 1 and 10.
///
/// Without points in view, the median distance of the cameras from their middle takes the place of the near points' depth.
pub(super) fn frame_of(views: &[&PlannedView], points: &SourcePoints) -> WorldFrame {
    let sample = |count: usize, most: usize| count.div_ceil(most).max(1);
    let points: Vec<DVec3> = points.positions.iter().copied().step_by(sample(points.len(), SAMPLE)).collect();
    let centers: Vec<DVec3> = views.iter().map(|view| view.source_position()).collect();
    let all: Vec<DVec3> = points.iter().chain(&centers).copied().collect();
    let mut depths: Vec<f64> = Vec::new();
    for view in views.iter().step_by(sample(views.len(), VIEWS)) {
        depths.extend(points.iter().filter_map(|&point| view.depth_of(point)));
    }
    let near = match depths.len() / NEAR_SHARE {
        0 => median_ball(&centers).map_or(0.0, |(_, radius)| radius),
        rank => *depths.select_nth_unstable_by(rank, f64::total_cmp).1,
    };
    let decade = 10f64.powi(near.log10().floor() as i32);
    let keeps = KEPT.contains(&near) || !(decade > 0.0 && decade.is_finite());
    WorldFrame { unit: if keeps { 1.0 } else { decade }, ..WorldFrame::around(&all) }
}
