//! Near plane and projection validity: which Gaussians may be visible, the twin of `forward/cull`.

use super::linear::apply;
use super::project;
use super::types::{Gaussian, View};

pub fn camera_position(gaussian: &Gaussian, view: &View) -> [f64; 3] {
    let rotated = apply(&view.camera_from_world, gaussian.mean);
    [0, 1, 2].map(|i| rotated[i] + view.translation[i])
}

/// One flag per Gaussian: true if it is kept and projects to a splat.
pub fn cull(gaussians: &[Gaussian], view: &View) -> Vec<bool> {
    let drawn = |(index, gaussian): (usize, &Gaussian)| {
        let kept = view.drawn.cut.keep(gaussian) && view.drawn.keeps(gaussian) && !view.drawn.drops(index);
        kept && project::project(gaussian, view).is_some()
    };
    gaussians.iter().enumerate().map(drawn).collect()
}
