//! The whole trainer against the combined twins: losses, densification, opacity reset, order of the steps.

use crate::common::engine::{settings, twins};
use crate::common::prelude::*;
use crate::reference::adam::{Parameter, adam};
use crate::reference::blend_backward::PixelGradient;
use crate::reference::classify::Statistic;
use crate::reference::gather::random_normal;
use crate::reference::loss;
use crate::reference::pipeline::{backward, render};
use crate::reference::project_backward::mean2d_statistic;
use crate::reference::reset_opacity::reset_opacity;
use crate::reference::scatter_sources::{Densify, Kind, Placed, place};
use crate::reference::zorder::zorder;

const SIZE: [u32; 2] = [48, 36];
/// A hundredth of it lies between the Gaussians' scales, so that some are cloned and some split.
const SCENE_EXTENT: f64 = 30.0;
const SEED: u32 = 9;

fn training_settings() -> TrainSettings {
    TrainSettings {
        iterations: 1000,
        sh_degree: 1,
        sh_degree_interval: 4,
        densify_from_iter: 4,
        densification_interval: 6,
        densify_until_iter: 10,
        opacity_reset_interval: 9,
        seed: SEED,
        ..TrainSettings::reference()
    }
}

/// A view as the trainer renders it: black background, no inverse depth.
fn view(sh_degree: u32) -> View {
    View { background: [0.0; 3], sh_degree, ..small_view(SIZE) }
}

fn camera_position() -> [f64; 3] {
    camera(&view(0)).position().to_array().map(f64::from)
}

fn photo() -> Photo {
    let scene = small_scene(&mut Random::new(21), 60, 1);
    let frame = render(&scene, &view(0));
    let rgb = frame.pixels.iter().flat_map(|p| p.color).map(|x| (x * 255.0).round().clamp(0.0, 255.0) as u8);
    Photo { width: SIZE[0], height: SIZE[1], rgb: rgb.collect() }
}

const OPACITY: usize = 10;

/// The reference implementation's loop, built from the twins.
struct Twin {
    gaussians: Vec<Gaussian>,
    moments: Vec<Vec<Parameter>>,
    statistics: Vec<Statistic>,
    truth: Vec<f64>,
    steps: u32,
    opacity_steps: u32,
}

impl Twin {
    fn new(gaussians: Vec<Gaussian>, photo: &Photo) -> Twin {
        let moments = |g: &Gaussian| vec![Parameter::default(); scalars(&mut g.clone()).len()];
        Twin {
            moments: gaussians.iter().map(moments).collect(),
            statistics: vec![Statistic { gradient: 0.0, views: 0.0 }; gaussians.len()],
            truth: photo.rgb.iter().map(|&byte| f64::from(byte) / 255.0).collect(),
            gaussians,
            steps: 0,
            opacity_steps: 0,
        }
    }

    /// One iteration with its densification or reset; returns the loss.
    fn step(&mut self, iteration: u32, s: &TrainSettings) -> f64 {
        let view = view(s.sh_degree_at(iteration));
        let frame = render(&self.gaussians, &view);
        let image: Vec<f64> = frame.pixels.iter().flat_map(|p| p.color).collect();
        let loss = loss::loss(&image, &self.truth, SIZE[0] as usize, SIZE[1] as usize);
        let (colors, _) = loss.gradient.as_chunks();
        let d_pixels: Vec<PixelGradient> =
            colors.iter().map(|&color| PixelGradient { color, inverse_depth: 0.0 }).collect();
        let gradients = backward(&self.gaussians, &view, &frame, &d_pixels);
        if s.collects_statistics_at(iteration) {
            for (i, statistic) in self.statistics.iter_mut().enumerate() {
                if frame.splats[i].is_some() {
                    statistic.gradient += mean2d_statistic(&view, gradients.splats[i].mean2d_px);
                    statistic.views += 1.0;
                }
            }
        }
        if !s.densifies_at(iteration) {
            self.optimize(iteration, s, &gradients.parameters);
        } else {
            self.densify(iteration, s);
        }
        if s.resets_opacity_at(iteration) {
            for (gaussian, moments) in self.gaussians.iter_mut().zip(&mut self.moments) {
                gaussian.opacity_logit = reset_opacity(gaussian.opacity_logit, 1.0);
                moments[OPACITY] = Parameter::default();
            }
        }
        loss.loss
    }

    fn optimize(&mut self, iteration: u32, s: &TrainSettings, gradients: &[Gradient]) {
        let resets = s.resets_opacity_at(iteration);
        self.steps += 1;
        self.opacity_steps += u32::from(!resets);
        let position = s.position_lr(iteration) * SCENE_EXTENT;
        for ((gaussian, moments), gradient) in self.gaussians.iter_mut().zip(&mut self.moments).zip(gradients)
        {
            let values = scalars(gaussian).into_iter().zip(moments).zip(gradient_scalars(gradient));
            for (place, ((value, parameter), gradient)) in values.enumerate() {
                let (rate, steps) = match place {
                    0..3 => (position, self.steps),
                    3..7 => (s.rotation_lr, self.steps),
                    7..10 => (s.scaling_lr, self.steps),
                    // The reset replaces the logit, so its gradient is lost.
                    OPACITY if resets => continue,
                    OPACITY => (s.opacity_lr, self.opacity_steps),
                    11..14 => (s.feature_lr, self.steps),
                    _ => (s.feature_lr / 20.0, self.steps),
                };
                parameter.value = *value;
                adam(parameter, gradient, rate, steps);
                *value = parameter.value;
            }
        }
    }

    fn densify(&mut self, iteration: u32, s: &TrainSettings) {
        let densify = Densify { scene_extent: SCENE_EXTENT, prune_big: s.prunes_large_at(iteration) };
        let parents: Vec<usize> = place(&self.gaussians, &self.statistics, densify, |_, _| [0.0; 3])
            .iter()
            .filter(|placed| placed.kind == Kind::Child)
            .map(|placed| placed.parent)
            .collect();
        // No Gaussian was pruned since the splits were numbered: the first half are first children.
        let splits = &parents[..parents.len() / 2];
        let mut placed = place(&self.gaussians, &self.statistics, densify, |child, split| {
            random_normal([SEED, iteration, splits[split] as u32, child as u32])
        });
        // Ordered along the curve about the only camera, by the parents' positions.
        let parent = |p: &Placed| zorder(self.gaussians[p.parent].mean, camera_position(), SCENE_EXTENT);
        placed.sort_by_key(parent);
        let moments = |kind: Kind, parent: usize| match kind {
            Kind::Kept => self.moments[parent].clone(),
            _ => vec![Parameter::default(); self.moments[parent].len()],
        };
        self.moments = placed.iter().map(|p| moments(p.kind, p.parent)).collect();
        self.gaussians = placed.into_iter().map(|p| p.gaussian).collect();
        self.statistics = vec![Statistic { gradient: 0.0, views: 0.0 }; self.gaussians.len()];
    }
}

/// Gaussians well inside the view, on both sides of the bound between clones and splits, none to be pruned.
fn start() -> Vec<Gaussian> {
    let mut scene = small_scene(&mut Random::new(22), 120, 4);
    for (i, gaussian) in scene.iter_mut().enumerate() {
        gaussian.opacity_logit = gaussian.opacity_logit.max(-2.0);
        if i % 2 == 0 {
            gaussian.log_scale = gaussian.log_scale.map(|x| x - 0.5);
        }
    }
    scene
}

#[test]
fn training_follows_the_twin() {
    let gpu = Gpu::new();
    let s = training_settings();
    let mut twin = Twin::new(start(), &photo());
    let views = vec![TrainView::new(camera(&view(0)), photo())];
    let mut trainer =
        Trainer::new(gpu.context, views, &gaussians(&twin.gaussians), SCENE_EXTENT as f32, s.clone())
            .expect("a trainer");
    for iteration in 1..=14 {
        let count = twin.gaussians.len() as u32;
        let expected = twin.step(iteration, &s);
        let report = trainer.steps(1).remove(0);
        assert_eq!((report.iteration, report.gaussians), (iteration, count));
        let off = (f64::from(report.loss) / expected - 1.0).abs();
        assert!(off < 2e-4, "iteration {iteration}: loss {}, expected {expected}", report.loss);
        if let Some(densified) = report.densified {
            assert_eq!(iteration, 7, "after the step that collected the last statistics");
            assert!(densified.cloned > 5 && densified.split > 5, "{densified:?}");
        }
    }
    assert_ne!(twin.gaussians.len(), 120, "nothing was densified");
    compare_scenes(&twins(&trainer.trained()), &twin.gaussians);
}

/// Adam's first steps are the rate times a sign, which rounding may flip if a gradient is nearly zero. Few
/// parameters may differ by more, and the scenes must look the same.
fn compare_scenes(actual: &[Gaussian], expected: &[Gaussian]) {
    assert_eq!(actual.len(), expected.len());
    let values = |g: &Gaussian| scalars(&mut g.clone()).into_iter().map(|x| *x).collect::<Vec<f64>>();
    let flat = |scene: &[Gaussian]| scene.iter().flat_map(values).collect::<Vec<f64>>();
    let (a, e) = (flat(actual), flat(expected));
    let off = a.iter().zip(&e).filter(|(a, e)| (*a - *e).abs() > 2e-4 * (1.0 + e.abs())).count();
    assert!(off * 100 <= a.len(), "{off} of {} parameters are off", a.len());
    let pictures = [actual, expected].map(|scene| render(scene, &view(1)).pixels);
    let pixels = pictures[0].iter().zip(&pictures[1]);
    let squares: f64 = pixels.flat_map(|(a, e)| [0, 1, 2].map(|i| (a.color[i] - e.color[i]).powi(2))).sum();
    let psnr = -10.0 * (squares / (3.0 * pictures[0].len() as f64)).log10();
    assert!(psnr > 60.0, "the scenes look different: {psnr:.1} dB");
}

#[test]
fn training_step_that_overflows_is_run_again() {
    let view = View { background: [0.0; 3], ..small_view([320, 240]) };
    let mut scene = small_scene(&mut Random::new(23), 200, 1);
    for gaussian in &mut scene {
        // Each covers the screen: far more instances than the first estimate.
        gaussian.log_scale = [0.7; 3];
        gaussian.opacity_logit = -3.0;
    }
    let photo = || Photo { width: 320, height: 240, rgb: vec![127; 3 * 320 * 240] };
    let s = TrainSettings { sh_degree: 0, ..TrainSettings::reference() };
    let train = |room_first: bool| -> (Gaussians, Vec<f32>, u32) {
        let views = vec![TrainView::new(camera(&view), photo())];
        let mut trainer = Run::shared(views, s.clone()).starting_at(&gaussians(&scene)).begin();
        let mut retries = 0;
        if room_first {
            retries = trainer.render(&camera(&view), &settings(&view)).expect("a frame").stats.retries;
        }
        let losses = trainer.losses(3);
        (trainer.trained(), losses, retries)
    };
    let (roomy, roomy_losses, retries) = train(true);
    assert!(retries > 0, "the first guess sufficed: the test tests nothing");
    let (overflowed, losses, _) = train(false);
    assert_eq!(losses, roomy_losses);
    assert!(roomy == overflowed);
}
