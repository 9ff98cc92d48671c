//! Views whose cameras were moved: those of the training where its poses were optimised, others by alignment to the scene.

use super::{Evaluation, More, Protocol, evaluate};
use ashsplat::trainer::TrainSettings;
use ashsplat::{Alignment, Camera, RenderSettings, Renderer, Result};
use ashsplat_files::View;
use ashsplat_files::cameras_json::NamedCamera;
use std::cell::RefCell;

/// How cameras are aligned to a scene: with training's loss.
pub fn alignment_of(settings: &TrainSettings) -> Alignment {
    Alignment { lambda_dssim: settings.lambda_dssim as f32, ..Alignment::default() }
}

/// A view with the pose that a list of cameras has for it, if any.
pub fn at_its_place(view: View, cameras: &[NamedCamera]) -> View {
    match cameras.iter().find(|named| named.name == view.name) {
        None => view,
        Some(NamedCamera { camera: at, .. }) => {
            let camera = Camera::with_pose(at.camera_from_world, at.translation, view.camera.intrinsics());
            View { camera, ..view }
        }
    }
}

/// Measures views after their cameras were aligned, those that `(view, held out)` says were held out.
pub fn evaluate_aligned(
    views: impl Iterator<Item = (Result<View>, bool)>,
    protocol: &Protocol,
    renderer: Renderer,
    (settings, alignment): (&RenderSettings, &Alignment),
) -> Result<Evaluation> {
    let renderer = RefCell::new(renderer);
    let aligned = views.map(|(view, held_out)| {
        let view = view?;
        if !held_out {
            return Ok(view);
        }
        let camera = renderer.borrow_mut().align(&view.camera, &view.photo, settings, alignment)?;
        Ok(View { camera, ..view })
    });
    evaluate(aligned, protocol, More::default(), |camera| renderer.borrow_mut().render(camera, settings))
}
