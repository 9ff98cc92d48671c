//! Tests while training runs. What they measure counts; pictures and results that the disk refuses end no training.

use super::Run;
use super::saving::attempt;
use crate::eval::{self, Evaluation, Pictures};
use crate::progress::thousands;
use crate::render;
use ashsplat::Result;
use ashsplat::scene::Camera;

/// The test after an iteration.
pub struct Tested {
    pub(super) iteration: u32,
    pub(super) gaussians: u32,
    pub evaluation: Evaluation,
}

impl Run {
    /// Measures the test views; those that were held out are also saved. What cannot be saved is an error where training
    /// ends, after some attempts, and else a warning. Pictures of such a test are not made again; its results are.
    pub(super) fn test(&mut self, iteration: u32, ends: bool) -> Result<f64> {
        let unsaved = |tested: &Result<(_, Result<()>)>| matches!(tested, Ok((_, Err(_))));
        let (evaluation, saved) = attempt(ends, || self.evaluate(iteration), unsaved)?;
        let psnr = evaluation.psnr();
        let tested = Tested { iteration, gaussians: self.gaussians, evaluation };
        // The last one is among the results.
        if !ends {
            self.progress.note(&self.describe(&tested));
        }
        self.evaluations.push(tested);
        let results = attempt(ends, || self.write_results(), Result::is_err);
        match saved.and(results) {
            Err(error) if !ends => {
                let warning = format!(
                    "warning: the test of iteration {iteration} is not saved: {error}; training goes on"
                );
                self.progress.warn(&warning);
            }
            saved => saved?,
        }
        Ok(psnr)
    }

    /// Measures, and whether the pictures were saved.
    fn evaluate(&mut self, iteration: u32) -> Result<(Evaluation, Result<()>)> {
        let folder = self.settings.data.model_path.join("test").join(format!("ours_{iteration}"));
        let mut pictures = self.held_out.then(|| Pictures::new(folder));
        let settings = render::settings_of(&self.settings);
        self.follow_cameras()?;
        let trainer = &mut self.trainer;
        let mut evaluation = eval::evaluate(self.test.iter().map(Ok), pictures.as_mut(), |camera| {
            trainer.render(camera, &settings)
        })?;
        if self.settings.train.pose_opt && self.held_out {
            let alignment = eval::alignment_of(&self.settings.train);
            let mut aligned = self.test.clone();
            for view in &mut aligned {
                view.camera = trainer.align(&view.camera, &view.photo, &settings, &alignment)?;
            }
            let draw = |camera: &Camera| trainer.render(camera, &settings);
            evaluation.aligned = Some(Box::new(eval::evaluate(aligned.iter().map(Ok), None, draw)?));
        }
        Ok((evaluation, pictures.map_or(Ok(()), Pictures::saved)))
    }

    /// Writes the results that have not been written yet.
    fn write_results(&mut self) -> Result<()> {
        if self.held_out {
            for tested in &self.evaluations[self.results..] {
                eval::write_results(&self.settings.data.model_path, tested.iteration, &tested.evaluation)?;
                self.results += 1;
            }
        }
        Ok(())
    }

    pub(super) fn describe(&self, tested: &Tested) -> String {
        let Tested { iteration, gaussians, evaluation } = tested;
        let kind = if self.held_out { "held-out" } else { "training" };
        format!(
            "iteration {iteration}: {} on {} {kind} views, {} Gaussians",
            evaluation.describe(),
            evaluation.views.len(),
            thousands(u64::from(*gaussians)),
        )
    }
}
