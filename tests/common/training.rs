//! Trainings of small scenes, which tests interrupt, bound and compare.

use super::device::{assert_silent, context};
use super::engine::{camera, gaussians};
use super::scenes::{Random, rotation_about_y, small_scene, small_view};
use crate::reference::types::View;
use ashsplat::train::{Checkpoint, Forecast, PhotoSize, StepReport, TrainParts, TrainView, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Camera, Error, Gaussians, Result, TrainSettings};
use ashsplat_files::{CheckpointFile, Photo, metrics};

pub const EXTENT: f32 = 5.0;

/// Densifies after 15 and 30, resets opacities after 20.
pub fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 40,
        sh_degree: 2,
        sh_degree_interval: 12,
        densify_from_iter: 10,
        densification_interval: 15,
        densify_until_iter: 38,
        opacity_reset_interval: 20,
        densify_grad_threshold: 2e-5,
        random_background: true,
        seed: 6,
        ..TrainSettings::reference()
    }
}

/// Settings whose steps move nothing.
pub fn without_rates(settings: TrainSettings) -> TrainSettings {
    TrainSettings {
        position_lr_init: 1e-30,
        position_lr_final: 1e-30,
        feature_lr: 0.0,
        opacity_lr: 0.0,
        scaling_lr: 0.0,
        rotation_lr: 0.0,
        ..settings
    }
}

/// Mean PSNR of a trainer's pictures against photographs, dB.
pub fn psnr(trainer: &mut Trainer, shown: impl ExactSizeIterator<Item = (Camera, Photo)>) -> f64 {
    let (settings, count) = (trainer.render_settings(), shown.len());
    let each = shown.map(|(camera, photo)| {
        let frame = trainer.render(&camera, &settings).expect("a frame");
        metrics::psnr(&frame.color, &photo.to_f32(), None).expect("equal sizes")
    });
    each.sum::<f64>() / count as f64
}

/// Grey views: the result of the training does not matter.
pub fn views(count: u32, gray: u8) -> Vec<TrainView> {
    (0..count)
        .map(|i| {
            let turned = View { camera_from_world: rotation_about_y(f64::from(i)), ..small_view([40, 30]) };
            let rgb = (0..40 * 30 * 3).map(|k| gray.wrapping_add((k * (i + 3)) as u8)).collect();
            TrainView::new(camera(&turned), Photo { width: 40, height: 30, rgb })
        })
        .collect()
}

pub fn view_of(size: [u32; 2]) -> TrainView {
    let [width, height] = size;
    let rgb = (0..width * height * 3).map(|k| (k * 7) as u8).collect();
    TrainView::new(camera(&small_view(size)), Photo { width, height, rgb })
}

pub fn start() -> Gaussians {
    gaussians(&small_scene(&mut Random::new(31), 150, 9))
}

pub struct Run<'a> {
    pub context: &'a Context,
    pub views: Vec<TrainView>,
    pub start: Gaussians,
    pub settings: TrainSettings,
    /// Strategy, loss terms and block, if they are not those of the settings.
    pub parts: Option<&'a dyn Fn() -> TrainParts>,
}

impl<'a> Run<'a> {
    /// On the device that tests share.
    pub fn shared(views: Vec<TrainView>, settings: TrainSettings) -> Run<'static> {
        Run::new(context(), views, settings)
    }

    /// Begins with [`start`].
    pub fn new(context: &'a Context, views: Vec<TrainView>, settings: TrainSettings) -> Run<'a> {
        Run { context, views, start: start(), settings, parts: None }
    }

    pub fn starting_at(self, start: &Gaussians) -> Run<'a> {
        Run { start: start.clone(), ..self }
    }

    pub fn with_parts(self, parts: &'a dyn Fn() -> TrainParts) -> Run<'a> {
        Run { parts: Some(parts), ..self }
    }

    pub fn try_begin(&self) -> Result<Trainer> {
        let (views, settings) = (self.views.clone(), self.settings.clone());
        match self.parts {
            Some(parts) => Trainer::with_parts(self.context, views, &self.start, EXTENT, settings, parts()),
            None => Trainer::new(self.context, views, &self.start, EXTENT, settings),
        }
    }

    pub fn begin(&self) -> Trainer {
        self.try_begin().expect("a trainer")
    }

    pub fn try_resume(&self, from: &Checkpoint) -> Result<Trainer> {
        let (views, settings) = (self.views.clone(), self.settings.clone());
        match self.parts {
            Some(parts) => Trainer::resume_with_parts(self.context, views, EXTENT, settings, parts(), from),
            None => Trainer::resume(self.context, views, EXTENT, settings, from),
        }
    }

    pub fn resume(&self, from: &Checkpoint) -> Trainer {
        self.try_resume(from).expect("resumed")
    }

    /// The end of the run, which is resumed from a file after each of `stops`.
    pub fn end(&self, stops: &[u32]) -> Checkpoint {
        self.until(self.settings.iterations, stops)
    }

    /// Same as [`Self::end`], for the first iterations of the run.
    pub fn until(&self, last: u32, stops: &[u32]) -> Checkpoint {
        let mut trainer = self.begin();
        for iteration in 0..last {
            if stops.contains(&iteration) {
                let from = through_a_file(&trainer.state());
                drop(trainer);
                trainer = self.resume(&from);
            }
            trainer.steps(1);
        }
        trainer.state()
    }

    /// Checks that the run ends with the same bits each time, also if it is interrupted. Returns its end.
    pub fn check_stops(&self, interruptions: &[&[u32]]) -> Checkpoint {
        let whole = self.end(&[]);
        for stops in interruptions {
            assert!(self.end(stops) == whole, "interrupted after {stops:?}: other bits");
        }
        whole
    }
}

/// Calls of a trainer that must succeed, without validation messages.
pub trait Succeeds {
    fn steps(&mut self, count: u32) -> Vec<StepReport>;
    fn losses(&mut self, count: u32) -> Vec<f32>;
    /// Steps until the last iteration of its settings.
    fn finish(&mut self) -> Vec<StepReport>;
    fn state(&self) -> Checkpoint;
    fn trained(&self) -> Gaussians;
}

impl Succeeds for Trainer {
    fn steps(&mut self, count: u32) -> Vec<StepReport> {
        let reports = (0..count).map(|_| self.step().expect("a step")).collect();
        assert_silent(self.context());
        reports
    }

    fn losses(&mut self, count: u32) -> Vec<f32> {
        self.steps(count).iter().map(|report| report.loss).collect()
    }

    fn finish(&mut self) -> Vec<StepReport> {
        self.steps(self.settings().iterations - self.iteration())
    }

    fn state(&self) -> Checkpoint {
        self.checkpoint().expect("a checkpoint")
    }

    fn trained(&self) -> Gaussians {
        self.gaussians().expect("Gaussians")
    }
}

/// Returns the error's text. Fails without an error.
#[track_caller]
pub fn refusal<T>(result: Result<T>) -> String {
    result.err().expect("refused").to_string()
}

pub fn through_a_file(checkpoint: &Checkpoint) -> Checkpoint {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.safetensors");
    checkpoint.write(&path).expect("written");
    let read = Checkpoint::read(&path).expect("read back");
    assert!(read == *checkpoint, "a checkpoint changes on disk");
    read
}

pub fn photo_size(name: &str, [width, height]: [u32; 2]) -> PhotoSize {
    let (masked, inverse_depth, depth_points) = (false, false, 0);
    PhotoSize { name: name.into(), width, height, masked, inverse_depth, depth_points }
}

pub fn forecast_of<'a>(
    settings: &'a TrainSettings,
    photos: &'a [PhotoSize],
    [gaussians, frozen]: [u32; 2],
) -> Forecast<'a> {
    Forecast { settings, photos, photo_memory: None, gaussians, frozen, capacities: None }
}

/// The memory that a training needs and what for, from the error of a device that has less.
pub fn forecast(
    settings: &TrainSettings,
    photos: &[PhotoSize],
    gaussians: [u32; 2],
    context: &Context,
) -> (u64, String) {
    match forecast_of(settings, photos, gaussians).check(context) {
        Err(Error::TooLarge { needed, what, .. }) => (needed, what),
        other => panic!("{other:?}"),
    }
}
