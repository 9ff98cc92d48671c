//! Everything that a training run is at between two steps: to disk, and back.
//!
//! A checkpoint is a safetensors file: parameters, Adam's moments and the statistics of densification as named tensors,
//! everything else as metadata. A run that goes on from one ends with the same bits as a run that was never interrupted:
//! what is random is keyed by seed and iteration, so no generator has a state of its own.

mod file;

use super::settings::TrainSettings;
use super::step::{Due, Progress};
use super::{TrainView, Trainer};
use crate::error::{Error, Result};
use crate::fingerprint::Fingerprint;
use crate::forward::SceneBuffers;
use crate::planes;
use crate::scene::{Camera, Gaussians};
use crate::vk::Buffer;
use rayon::prelude::*;

/// The state of a training run after an iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Version of ashsplat that made it.
    pub version: String,
    /// Device that made it: on another, the bits differ.
    pub device: String,
    /// The run's settings.
    pub settings: TrainSettings,
    /// Number of views.
    pub views: u64,
    /// Tells the views (cameras and photographs, in their order) from others.
    pub views_fingerprint: u64,
    /// The scene's extent, world units.
    pub scene_extent: f32,
    /// Iterations done.
    pub iteration: u32,
    /// Steps of the optimiser so far.
    pub optimizer_steps: u64,
    /// Steps of the opacities' optimiser so far.
    pub opacity_steps: u64,
    /// Whether the next step begins with a densification.
    pub densification_due: bool,
    /// Whether the next step begins with an opacity reset.
    pub opacity_reset_due: bool,
    /// The parameters.
    pub gaussians: Gaussians,
    /// Adam's first moments, shaped like the parameters.
    pub first_moments: Gaussians,
    /// Adam's second moments, shaped like the parameters.
    pub second_moments: Gaussians,
    /// Per Gaussian: sum of the 2D mean's gradient norms (NDC), number of views.
    pub statistics: Vec<[f32; 2]>,
}

/// What a checkpoint must have been made with to go on from it.
struct Wanted<'a> {
    settings: &'a TrainSettings,
    views: u64,
    views_fingerprint: u64,
    scene_extent: f32,
}

impl Trainer {
    /// Downloads everything that [`Trainer::resume`] needs to go on from here.
    ///
    /// # Errors
    /// [`Error::Argument`] while recorded steps are in flight, and after a step of which nobody knows whether it came to
    /// pass; when the device is lost.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        self.check_settled()?;
        self.check_whole()?;
        let (training, progress) = (&self.training, &self.progress);
        let planes_of = |chunks: &[Buffer]| {
            planes::download(
                &self.context,
                &SceneBuffers { chunks: chunks.to_vec(), ..training.scene.clone() },
            )
        };
        let count = u64::from(training.scene.count);
        let statistics = match count {
            0 => Vec::new(),
            _ => {
                let bytes = self.context.download(&training.statistics.range(0, count * 8))?;
                bytemuck::pod_collect_to_vec(&bytes)
            }
        };
        Ok(Checkpoint {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            device: self.context.device_name().to_owned(),
            settings: self.settings.clone(),
            views: self.cameras.len() as u64,
            views_fingerprint: self.views_fingerprint,
            scene_extent: self.scene_extent,
            iteration: progress.iteration,
            optimizer_steps: progress.steps,
            opacity_steps: progress.opacity_steps,
            densification_due: progress.due.densifies,
            opacity_reset_due: progress.due.resets,
            gaussians: self.gaussians()?,
            first_moments: planes_of(&training.moments.first)?,
            second_moments: planes_of(&training.moments.second)?,
            statistics,
        })
    }

    /// A trainer that goes on from a checkpoint as if it had never stopped: same views in the same order, same settings
    /// but for the number of iterations, which must lie ahead.
    ///
    /// # Errors
    /// [`Error::Argument`] naming what differs; as [`Trainer::new`].
    pub fn resume(
        context: &crate::vk::Context,
        views: Vec<TrainView>,
        scene_extent: f32,
        settings: TrainSettings,
        from: &Checkpoint,
    ) -> Result<Self> {
        from.check_shapes()?;
        from.check_fits(&Wanted {
            settings: &settings,
            views: views.len() as u64,
            views_fingerprint: fingerprint_of(&views),
            scene_extent,
        })?;
        let mut trainer = Trainer::new(context, views, &from.gaussians, scene_extent, settings)?;
        trainer.progress = Progress {
            iteration: from.iteration,
            steps: from.optimizer_steps,
            opacity_steps: from.opacity_steps,
            due: Due { densifies: from.densification_due, resets: from.opacity_reset_due },
        };
        let training = &trainer.training;
        let moments = [
            (&training.moments.first, &from.first_moments),
            (&training.moments.second, &from.second_moments),
        ];
        for (chunks, values) in moments {
            planes::fill(
                context,
                &SceneBuffers { chunks: chunks.clone(), ..training.scene.clone() },
                values,
            )?;
        }
        context.upload(&training.statistics, bytemuck::cast_slice(&from.statistics))?;
        Ok(trainer)
    }
}

impl Checkpoint {
    fn check_shapes(&self) -> Result<()> {
        self.gaussians.check_shapes()?;
        for moments in [&self.first_moments, &self.second_moments] {
            moments.check_shapes()?;
            if (moments.len(), moments.sh_degree) != (self.gaussians.len(), self.gaussians.sh_degree) {
                return Err(Error::argument("moments", "are of another number or degree than the Gaussians"));
            }
        }
        if self.statistics.len() != self.gaussians.len() {
            return Err(Error::argument("statistics", "are of another number than the Gaussians"));
        }
        if self.gaussians.sh_degree != self.settings.sh_degree {
            return Err(Error::argument("sh_degree", "of the Gaussians and of the settings differ"));
        }
        Ok(())
    }

    /// Whether a run with these settings and views could have made the checkpoint.
    fn check_fits(&self, wanted: &Wanted) -> Result<()> {
        let refuse = |problem: String| Err(Error::argument("checkpoint", problem));
        let settings = TrainSettings { iterations: wanted.settings.iterations, ..self.settings.clone() };
        if let Some(difference) = difference(&settings, wanted.settings)? {
            return refuse(format!("was made with other settings: {difference}"));
        }
        if self.iteration >= wanted.settings.iterations {
            return refuse(format!(
                "is of iteration {} already, the training ends at {}; raise iterations to go on",
                self.iteration, wanted.settings.iterations
            ));
        }
        if self.views != wanted.views {
            return refuse(format!("was made with {} training views, here are {}", self.views, wanted.views));
        }
        if self.views_fingerprint != wanted.views_fingerprint {
            return refuse(
                "was made with other photographs or cameras (of another data set, resolution, background or split)"
                    .into(),
            );
        }
        if self.scene_extent.to_bits() != wanted.scene_extent.to_bits() {
            return refuse(format!(
                "was made with a scene extent of {}, here it is {}",
                self.scene_extent, wanted.scene_extent
            ));
        }
        Ok(())
    }
}

/// The settings that differ, "name there, here".
fn difference(there: &TrainSettings, here: &TrainSettings) -> Result<Option<String>> {
    let fields = |settings: &TrainSettings| {
        serde_json::to_value(settings).map_err(|e| Error::argument("settings", e.to_string()))
    };
    let (there, here) = (fields(there)?, fields(here)?);
    let Some(names) = there.as_object() else { return Ok(None) };
    let differing = names.iter().filter(|(name, value)| here[name.as_str()] != **value);
    let list: Vec<String> =
        differing.map(|(name, value)| format!("{name} was {value}, is {}", here[name.as_str()])).collect();
    Ok((!list.is_empty()).then(|| list.join("; ")))
}

/// Tells views, cameras and photographs in their order, from others.
pub(super) fn fingerprint_of(views: &[TrainView]) -> u64 {
    let of_view = |view: &TrainView| {
        let Camera { camera_from_world, translation, fx, fy, cx, cy, width, height } = view.camera;
        let mut print = Fingerprint::new();
        print.add(bytemuck::cast_slice(&camera_from_world.to_cols_array()));
        print.add(bytemuck::cast_slice(&translation.to_array()));
        print.add(bytemuck::cast_slice(&[fx, fy, cx, cy]));
        print.add(bytemuck::cast_slice(&[width, height]));
        print.add(bytemuck::bytes_of(&view.photo.fingerprint()));
        print.finish()
    };
    let each: Vec<u64> = views.par_iter().map(of_view).collect();
    let mut all = Fingerprint::new();
    all.add(bytemuck::cast_slice(&each));
    all.finish()
}
