//! Tests during training. Pictures and results that the disk refuses do not end training.

use super::Run;
use super::prepared::stand_ins;
use super::saving::attempt;
use ashsplat::passes::lpips::Weights;
use ashsplat::scene::Camera;
use ashsplat::{Error, Renderer, Result};
use ashsplat_files::{Gallery, quoted};
use ashsplat_program::config::Settings;
use ashsplat_program::eval::{self, Evaluation, ExtraMeasures, LpipsNetworks, Pictures, Protocol, SceneSize};
use ashsplat_program::model::point_cloud_path;
use ashsplat_program::progress::thousands;
use std::path::PathBuf;

pub struct Tested {
    pub(super) iteration: u32,
    pub(super) gaussians: u32,
    pub evaluation: Evaluation,
}

/// Refuses test photos that are too small for LPIPS's networks: they would fail after all the work.
pub fn check_sizes(weights: &[Weights], gallery: &Gallery, settings: &Settings) -> Result<()> {
    let held_out = gallery.held_out();
    let mut tested: Vec<usize> = (0..held_out.len()).filter(|&index| held_out[index]).collect();
    if tested.is_empty() {
        tested = stand_ins(held_out.len()).collect();
    }
    eval::check_sizes(weights, gallery, &tested, settings.data.train_test_exp)
}

impl Run {
    /// Measures the test views and saves pictures of held-out ones. A failed save is an error if training ends, after some
    /// attempts, and otherwise a warning. The pictures are then not drawn again; the results are written later.
    pub(super) fn test(&mut self, iteration: u32, ends: bool) -> Result<f64> {
        let unsaved = |tested: &Result<(_, Result<()>)>| matches!(tested, Ok((_, Err(_))));
        let (evaluation, saved) = attempt(ends, || self.evaluate(iteration), unsaved)?;
        let psnr = evaluation.psnr();
        let tested = Tested { iteration, gaussians: self.gaussians, evaluation };
        // The results include the last test.
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

    /// The protocol of the test views: training views have their exposures, and all have their lens effects. Of views
    /// whose left half is trained on, the right half counts.
    pub(super) fn protocol(&self) -> Result<Protocol> {
        let halves = self.settings.data.train_test_exp && self.views.held_out;
        let names = self.views.test.iter().filter(|_| halves).map(|view| view.name.clone());
        Ok(Protocol { appearances: self.appearances()?, halves: names.collect() })
    }

    /// Measures the views, after the last iteration also LPIPS. Also returns the result of saving the pictures.
    fn evaluate(&mut self, iteration: u32) -> Result<(Evaluation, Result<()>)> {
        if iteration < self.settings.train.iterations || self.lpips.is_empty() {
            return self.evaluate_with(iteration, None);
        }
        let lpips = LpipsNetworks::new(self.trainer.context(), &self.lpips);
        let measured = lpips.and_then(|mut lpips| self.evaluate_with(iteration, lpips.as_mut()));
        match measured {
            // Training holds the memory. Its results must not be lost.
            Err(error @ (Error::TooLarge { .. } | Error::Vulkan { call: "vkAllocateMemory", .. })) => {
                let data = &self.settings.data;
                let typed = |path: &PathBuf| quoted(&path.to_string_lossy());
                let weights =
                    data.lpips_weights.iter().map(|path| format!(" --lpips-weights {}", typed(path)));
                let (model, weights) = (typed(&data.model_path), weights.collect::<String>());
                self.progress.warn(&format!(
                    "warning: LPIPS is not measured beside the training: {error}; measure it with: ashsplat eval {model}{weights}"
                ));
                self.evaluate_with(iteration, None)
            }
            measured => measured,
        }
    }

    fn evaluate_with(
        &mut self,
        iteration: u32,
        lpips: Option<&mut LpipsNetworks>,
    ) -> Result<(Evaluation, Result<()>)> {
        let folder = self.settings.data.model_path.join("test").join(format!("ours_{iteration}"));
        let mut pictures = self.views.held_out.then(|| Pictures::new(folder));
        let settings = self.trainer.render_settings();
        self.follow_cameras()?;
        let protocol = self.protocol()?;
        let trainer = &mut self.trainer;
        let more = ExtraMeasures {
            pictures: pictures.as_mut(),
            lpips,
            frame_times: iteration == self.settings.train.iterations,
        };
        let draw = |camera: &Camera| {
            let camera = trainer.with_trained_lens(camera);
            trainer.render(&camera, &settings)
        };
        let mut evaluation = eval::evaluate(self.views.test.iter().map(Ok), &protocol, more, draw)?;
        let file = std::fs::metadata(point_cloud_path(&self.settings.data.model_path, iteration)).ok();
        let bytes = file.filter(|_| self.saved == Some(iteration)).map(|file| file.len());
        evaluation.scene = Some(SceneSize { gaussians: u64::from(self.gaussians), bytes });
        if self.settings.train.pose_opt && self.views.held_out {
            let alignment = eval::alignment_of(&self.settings.train);
            let mut aligned = self.views.test.clone();
            let own = trainer.at_current_degree(&settings);
            for view in &mut aligned {
                view.camera = trainer.with_trained_lens(&view.camera);
                let align =
                    |renderer: &mut Renderer| renderer.align(&view.camera, &view.photo, &own, &alignment);
                view.camera = trainer.draw(align)?;
            }
            let draw = |camera: &Camera| trainer.render(camera, &settings);
            let aligned = eval::evaluate(aligned.iter().map(Ok), &protocol, ExtraMeasures::default(), draw)?;
            evaluation.aligned = Some(Box::new(aligned));
        }
        Ok((evaluation, pictures.map_or(Ok(()), Pictures::saved)))
    }

    /// Writes the results that are not in the files yet.
    fn write_results(&mut self) -> Result<()> {
        if self.views.held_out {
            for tested in &self.evaluations[self.results..] {
                eval::write_results(&self.settings.data.model_path, tested.iteration, &tested.evaluation)?;
                self.results += 1;
            }
        }
        Ok(())
    }

    pub(super) fn describe(&self, tested: &Tested) -> String {
        let Tested { iteration, gaussians, evaluation } = tested;
        let kind = if self.views.held_out { "held-out" } else { "training" };
        format!(
            "iteration {iteration}: {} on {} {kind} views, {} Gaussians",
            evaluation.describe(self.settings.train.exposure),
            evaluation.views.len(),
            thousands(u64::from(*gaussians)),
        )
    }
}
