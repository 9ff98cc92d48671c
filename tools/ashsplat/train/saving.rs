//! Saves during training. If the disk refuses, training continues and saving is tried again: hours of training are
//! worth more than one file.

use super::Run;
use ashsplat::scene::LensEffects;
use ashsplat::{Error, Result};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::lens_json::{LENS_FILE, LensFile};
use ashsplat_files::{ply, splats};
use ashsplat_program::appearance::Appearances;
use ashsplat_program::measure::Stopwatch;
use ashsplat_program::{model, output};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Time until a failed save is tried again, during training.
const AGAIN: Duration = Duration::from_secs(5);
/// Number of attempts when training ends, and the pause between them.
const ATTEMPTS: u32 = 3;
const PAUSE: Duration = Duration::from_millis(300);

/// Attempts something; if training `ends`, repeats a refused attempt after a pause, since there is no later.
pub(super) fn attempt<T>(ends: bool, mut attempt: impl FnMut() -> T, refused: impl Fn(&T) -> bool) -> T {
    let mut result = attempt();
    for _ in 1..if ends { ATTEMPTS } else { 1 } {
        if !refused(&result) {
            break;
        }
        std::thread::sleep(PAUSE);
        result = attempt();
    }
    result
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Scene,
    Checkpoint,
}

/// Times at which failed saves are tried again.
#[derive(Default)]
pub struct SaveRetries {
    scene: Option<Instant>,
    checkpoint: Option<Instant>,
}

impl SaveRetries {
    fn when(&mut self, kind: Kind) -> &mut Option<Instant> {
        match kind {
            Kind::Scene => &mut self.scene,
            Kind::Checkpoint => &mut self.checkpoint,
        }
    }

    /// Notes that the scene a page requested could not be saved.
    #[cfg(feature = "view")]
    pub fn retry_scene(&mut self) {
        self.scene = Some(Instant::now() + AGAIN);
    }

    fn is_due(&mut self, kind: Kind) -> bool {
        self.when(kind).is_some_and(|when| when <= Instant::now())
    }
}

impl Run {
    /// Tests and saves if it is time, off the clock. Returns the PSNR if it was tested.
    pub(super) fn keep(
        &mut self,
        iteration: u32,
        stopping: bool,
        watch: &mut Stopwatch,
    ) -> Result<Option<f64>> {
        let last = iteration == self.settings.train.iterations;
        let data = &self.settings.data;
        let requested = data.save_iterations.contains(&iteration);
        let tests = last || data.test_iterations.contains(&iteration);
        let saves = last || stopping || requested || self.retries.is_due(Kind::Scene);
        if !saves && !tests {
            return Ok(None);
        }
        watch.paused(|| {
            if saves {
                let reason = if stopping && !last { "interrupted: " } else { "" };
                self.persist(Kind::Scene, last || stopping, |run| run.save(iteration, reason))?;
            }
            match tests.then(|| self.test(iteration, last || stopping)).transpose() {
                // Training continues if the frame of a test view is too large.
                Err(error @ Error::TooLarge { .. }) if !last && !stopping => {
                    self.progress.warn(&format!("warning: iteration {iteration} is not tested: {error}"));
                    Ok(None)
                }
                tested => tested,
            }
        })
    }

    /// True if a checkpoint is due after an iteration, also one that could not be written before.
    pub(super) fn checkpoint_is_due(&mut self, iteration: u32, stopping: bool) -> bool {
        let last = iteration == self.settings.train.iterations;
        let requested = self.settings.data.checkpoints_at(iteration, self.settings.train.iterations);
        let late = last && self.retries.checkpoint.is_some();
        stopping || requested || late || self.ends_round(iteration) || self.retries.is_due(Kind::Checkpoint)
    }

    /// Writes a checkpoint now, or notes that it must be written later.
    pub(super) fn keep_checkpoint(&mut self, stopping: bool) -> Result<()> {
        let iteration = self.trainer.iteration();
        let ends = stopping || iteration == self.settings.train.iterations || self.ends_round(iteration);
        self.persist(Kind::Checkpoint, ends, Run::write_checkpoint)
    }

    /// Writes a file. If the disk refuses, it is tried again later, or is an error if training ends.
    fn persist(&mut self, kind: Kind, ends: bool, write: impl Fn(&mut Run) -> Result<()>) -> Result<()> {
        match attempt(ends, || write(self), |written| matches!(written, Err(Error::Io { .. }))) {
            Err(error @ Error::Io { .. }) if !ends => {
                if self.retries.when(kind).replace(Instant::now() + AGAIN).is_none() {
                    let warning = format!("warning: {error}; training goes on, and it is tried again");
                    self.progress.warn(&warning);
                }
                Ok(())
            }
            written => {
                if written.is_ok() {
                    *self.retries.when(kind) = None;
                }
                written
            }
        }
    }

    /// The learned exposures and lens effects. Held-out photographs have their cameras' lens effects too.
    pub(super) fn appearances(&self) -> Result<Appearances> {
        let exposures = self.views.trained.iter().cloned().zip(self.trainer.exposures()?).collect();
        let of_views = self.views.trained.iter().zip(self.trainer.lens_effects()?);
        let cameras: BTreeMap<u32, LensEffects> =
            of_views.filter_map(|(name, effects)| Some((*self.views.takers.get(name)?, effects))).collect();
        let known = self.views.takers.iter().filter(|(_, camera)| cameras.contains_key(camera));
        let photos = known.map(|(name, camera)| (name.clone(), *camera)).collect();
        Ok(Appearances { exposures, lenses: LensFile { cameras, photos } })
    }

    /// Saves the scene after an iteration, and notes that it is the newest.
    pub(super) fn save(&mut self, iteration: u32, reason: &str) -> Result<()> {
        let folder = &self.settings.data.model_path;
        let path = model::point_cloud_path(folder, iteration);
        let gaussians = self.trainer.gaussians()?;
        let marks = splats::WriteOptions::marking(&self.settings.train.render_settings());
        let options = splats::WriteOptions { frame: self.views.frame, ..marks };
        let filters = self.trainer.filters()?;
        output::in_folder(&path, |path| match filters.is_empty() {
            true => splats::write(path, &gaussians, &options).map(drop),
            false => ply::write_filtered(path, &gaussians, &filters, &options),
        })?;
        let appearances = self.appearances()?;
        if !appearances.exposures.is_empty() {
            let named = appearances.exposures.iter().map(|(name, exposure)| (name.as_str(), exposure));
            exposure_json::write(folder.join(EXPOSURE_FILE), named)?;
        }
        if !appearances.lenses.cameras.is_empty() {
            appearances.lenses.write(folder.join(LENS_FILE))?;
        }
        self.save_poses(iteration)?;
        model::note_saved(folder, iteration)?;
        self.saved = Some(iteration);
        self.progress.note(&format!("{reason}saved {}", path.display()));
        if let Some(reset) = self.trainer.recent_reset() {
            self.progress.warn(&format!(
                "warning: {}: saved {} iterations after an opacity reset, from which a scene takes up to {} to recover",
                path.display(),
                iteration - reset,
                self.settings.train.reset_recovery()
            ));
        }
        Ok(())
    }
}
