//! Compares a model's renders with the photographs: a model of another scene may fill the cameras' pictures just as
//! well.

use ashsplat::{RenderSettings, Renderer, Result};
use ashsplat_files::{Gallery, PhotoFileFormat};
use ashsplat_program::blocks::parts::small;
use std::sync::Arc;

const VIEWS: usize = 5;

/// Mean correlation of brightness between photographs and renders, both small, -1 to 1. `None` if the photographs are
/// uniform.
pub fn with_photos(renderer: &mut Renderer, gallery: &Gallery, look: &RenderSettings) -> Result<Option<f64>> {
    let views = gallery.cameras().len();
    let mut found = Vec::new();
    for index in (0..views).step_by(views.div_ceil(VIEWS).max(1)) {
        let Some(view) = gallery.view(index).transpose()? else { continue };
        let camera = small(&view.camera);
        let frame = renderer.render(&camera, look)?;
        let photo = Arc::unwrap_or_clone(view.photo.photo()?);
        let photo = photo.scaled_to(camera.width, camera.height)?.to_f32();
        let brightness = |pixels: &[[f32; 3]]| -> Vec<f64> {
            pixels.iter().map(|rgb| rgb.iter().map(|&c| f64::from(c.clamp(0.0, 1.0))).sum()).collect()
        };
        found.extend(correlated(&brightness(&photo), &brightness(&frame.color)));
    }
    Ok((!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64))
}

/// Pearson's correlation; `None` if all values of `a` are equal.
fn correlated(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        aa += a * a;
        bb += b * b;
        ab += a * b;
    }
    let flat = 1e-6 * a.len() as f64;
    // A uniform render resembles nothing.
    (aa > flat).then(|| if bb > flat { ab / (aa * bb).sqrt() } else { 0.0 })
}
