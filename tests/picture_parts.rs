//! Parts of pictures are rendered, differentiated and trained like the whole.

use crate::common::prelude::*;
use crate::common::splats::{ball, camera};
use ashsplat::scene::{Intrinsics, StoredPhoto};

/// Corners and sizes: aligned to tiles, across them, at the far edges, a single pixel.
const PARTS: [([u32; 2], [u32; 2]); 4] =
    [([16, 16], [48, 32]), ([13, 7], [50, 41]), ([70, 40], [26, 24]), ([48, 30], [1, 1])];

fn cut<T: Copy>(pixels: &[T], whole: u32, [left, top]: [u32; 2], [width, height]: [u32; 2]) -> Vec<T> {
    let rows = (top..top + height).map(|y| (y * whole + left) as usize);
    rows.flat_map(|first| &pixels[first..first + width as usize]).copied().collect()
}

fn farthest(one: &[[f32; 3]], other: &[[f32; 3]]) -> f32 {
    assert_eq!(one.len(), other.len());
    let pairs = one.as_flattened().iter().zip(other.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Adds large Gaussians beside the view: the picture's edges determine where their projection is linearised.
fn with_large_ones(mut scene: Gaussians) -> Gaussians {
    for (row, x) in [(0, -1.9), (1, 1.9), (2, 1.4), (3, -1.4)] {
        scene.means[row] = [x, 0.2, -1.2];
        scene.log_scales[row] = [-0.4, -1.2, -0.2];
        scene.opacity_logits[row] = 0.0;
    }
    scene
}

#[test]
fn a_part_has_the_pixels_of_the_whole() {
    let mut renderer = renderer();
    renderer.upload(&with_large_ones(ball(700))).expect("uploaded");
    let (camera, settings) = (camera(0.3), RenderSettings { inverse_depth: true, ..Default::default() });
    let whole = renderer.render(&camera, &settings).expect("a frame");
    assert!(whole.transmittance.iter().any(|&t| t < 0.1));
    let mut differs = 0.0_f32;
    for (corner, size) in PARTS {
        let part = camera.part(corner, size).expect("a part");
        let frame = renderer.render(&part, &settings).expect("a frame");
        let expected = cut(&whole.color, whole.width, corner, size);
        assert!(farthest(&frame.color, &expected) < 2e-5, "{corner:?} {size:?}");
        let [ours, theirs] = [&frame, &whole].map(|frame| frame.inverse_depth.as_ref().expect("depths"));
        let depths = ours.iter().zip(cut(theirs, whole.width, corner, size));
        assert!(depths.fold(0.0, |max: f32, (a, b)| max.max((a - b).abs())) < 2e-5);
        let alone = renderer.render(&Camera { part: None, ..part }, &settings).expect("a frame");
        differs = differs.max(farthest(&alone.color, &expected));
    }
    assert!(differs > 1e-3, "a picture of its own is linearised within its own edges: {differs}");
}

#[test]
fn gradients_of_parts_add_up_to_those_of_the_whole() {
    let mut renderer = renderer();
    renderer.upload(&with_large_ones(ball(300))).expect("uploaded");
    let (camera, settings) = (camera(0.3), RenderSettings::default());
    let gradient: Vec<[f32; 3]> =
        (0..96 * 64).map(|i| [0, 1, 2].map(|c| ((i * 7 + c * 13) % 17) as f32 / 8.0 - 1.0)).collect();
    let whole = renderer.gradients(&camera, &settings, &gradient, None).expect("gradients");
    let mut sums = vec![[0.0_f32; 3]; 300];
    for corner in [[0, 0], [40, 0], [0, 30], [40, 30]] {
        let size = [if corner[0] == 0 { 40 } else { 56 }, if corner[1] == 0 { 30 } else { 34 }];
        let part = camera.part(corner, size).expect("a part");
        let own = cut(&gradient, 96, corner, size);
        let of_part = renderer.gradients(&part, &settings, &own, None).expect("gradients");
        for (sum, own) in sums.iter_mut().zip(&of_part.parameters.means) {
            *sum = [0, 1, 2].map(|axis| sum[axis] + own[axis]);
        }
    }
    let size = whole.parameters.means.as_flattened().iter().fold(0.0, |max: f32, g| max.max(g.abs()));
    assert!(size > 1.0);
    assert!(farthest(&sums, &whole.parameters.means) < 1e-4 * size);
}

/// The ball from afar, and its photograph, which is black around it.
fn views(part: Option<([u32; 2], [u32; 2])>, depths: bool) -> Vec<TrainView> {
    let view = |turn: u32| {
        let eye = Vec3::new(7.0 * (turn as f32).sin(), -1.0, -7.0 * (turn as f32).cos());
        let camera = Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.9, 96, 64));
        let near = |pixel: u32| {
            let [x, y] = [(pixel % 96) as f32 - 47.5, (pixel / 96) as f32 - 31.5];
            x.hypot(y) < 10.0
        };
        let color =
            |pixel: u32| if near(pixel) { [(40 * turn) as u8, 90, (pixel % 200) as u8] } else { [0; 3] };
        let rgb: Vec<[u8; 3]> = (0..96 * 64).map(color).collect();
        let map: Vec<f32> =
            (0..96 * 64).map(|pixel| if near(pixel) { 0.16 } else { f32::INFINITY }).collect();
        let (corner, size) = part.unwrap_or(([0, 0], [96, 64]));
        let rgb = cut(&rgb, 96, corner, size).into_flattened();
        let photo = StoredPhoto::from(Photo { width: size[0], height: size[1], rgb });
        let map = depths.then(|| cut(&map, 96, corner, size).into());
        TrainView { inverse_depth: map, ..TrainView::new(camera.part(corner, size).expect("a part"), photo) }
    };
    (0..3).map(view).collect()
}

fn trained(views: Vec<TrainView>, settings: &TrainSettings) -> (Checkpoint, f32) {
    let mut start = ball(400);
    start.means.as_flattened_mut().iter_mut().for_each(|v| *v *= 0.5);
    let mut trainer = Run { start, ..Run::shared(views, settings.clone()) }.begin();
    let reports = trainer.steps(settings.iterations - 1);
    (trainer.state(), reports.last().expect("steps").loss)
}

/// Up to rounding, results and counts do not depend on the black pixels around the part.
#[test]
fn training_on_a_part_is_that_on_the_whole() {
    let part = ([24, 8], [48, 48]);
    for (depths, lens_effects, antialiasing) in
        [(false, false, false), (true, false, true), (false, true, false)]
    {
        let settings =
            TrainSettings { iterations: 13, sh_degree: 1, lens_effects, antialiasing, ..Default::default() };
        let (whole, loss) = trained(views(None, depths), &settings);
        let (of_part, of_part_loss) = trained(views(Some(part), depths), &settings);
        let first = trained(views(None, depths), &TrainSettings { iterations: 2, ..settings.clone() }).0;
        let moved = farthest(&whole.gaussians.means, &first.gaussians.means);
        let apart = farthest(&of_part.gaussians.means, &whole.gaussians.means);
        assert!(apart < 0.02 * moved, "{depths} {lens_effects}: {apart} of {moved}");
        assert!((loss - of_part_loss).abs() < 1e-4 * loss, "{loss} {of_part_loss}");
        let norms = |state: &Checkpoint| state.statistics.iter().map(|row| f64::from(row[0])).sum::<f64>();
        let (ours, theirs) = (norms(&of_part), norms(&whole));
        assert!(theirs > 0.0 && (ours / theirs - 1.0).abs() < 1e-3, "{ours} {theirs}");
        // Without its position in the whole, a part is an independent picture.
        let mut own = views(Some(part), depths);
        own.iter_mut().for_each(|view| view.camera.part = None);
        assert!((norms(&trained(own, &settings).0) / theirs - 1.0).abs() > 0.5);
    }
}

#[test]
fn a_run_does_not_go_on_with_other_parts() {
    let settings = TrainSettings { iterations: 4, sh_degree: 1, ..Default::default() };
    let (checkpoint, _) = trained(views(Some(([24, 8], [48, 48])), false), &settings);
    for (part, accepted) in [(([24, 8], [48, 48]), true), (([20, 8], [48, 48]), false)] {
        let run = Run::shared(views(Some(part), false), settings.clone());
        assert_eq!(run.try_resume(&checkpoint).is_ok(), accepted, "{part:?}");
    }
}
