//! Conversion of a trainer to a [`Checkpoint`], and back.

use super::block::SceneBlock;
use super::checkpoint::{Capacities, Checkpoint, ExpectedRun, MomentState, StrategyState};
use super::lens_opt::LensOptimizer;
use super::memory::STATISTICS_BYTES;
use super::parts::TrainParts;
use super::photos::{TrainView, fingerprint_of};
use super::schedule::{Actions, Progress};
use super::settings::TrainSettings;
use super::trainer::Trainer;
use crate::error::{Error, Result};
use crate::frame::{array_of, planes};
use crate::scene::WorldFrame;
use crate::vk::Context;

impl Trainer {
    /// Downloads the state that [`Trainer::resume`] needs.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        if let Some(rescued) = &self.state.rescued {
            return Ok((**rescued).clone());
        }
        self.check_readable()?;
        let (model, progress) = (&self.state.model, &self.state.progress);
        let statistics = match model.scene.count {
            0 => Vec::new(),
            count => {
                self.context.download(&model.statistics[0].range(0, u64::from(count) * STATISTICS_BYTES))?
            }
        };
        let [exposures, lens_effects] = self.appearance_states()?;
        Ok(Checkpoint {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            device: self.context.device_name().to_owned(),
            driver: self.context.description().driver.clone(),
            kernels: self.context.limits().kernel_forms(),
            settings: self.run.settings.clone(),
            views: self.run.cameras.len() as u64,
            views_fingerprint: self.run.views_fingerprint,
            scene_extent: self.run.scene_extent,
            frame: WorldFrame::default(),
            iteration: progress.iteration,
            optimizer_steps: progress.steps,
            opacity_steps: progress.opacity_steps,
            due: progress.due,
            gaussians: self.gaussians()?,
            moments: self.moment_state()?,
            statistics: bytemuck::pod_collect_to_vec(&statistics),
            filters: self.filters()?,
            strategy: StrategyState {
                name: self.strategy.name().to_owned(),
                terms: self.recorder.terms().map(str::to_owned).collect(),
                values: self.strategy.state(),
            },
            exposures,
            lens_effects,
            poses: self.poses.as_ref().map(|poses| poses.state(&self.context)).transpose()?,
            lens_opt: self.lens_opt.as_ref().map(LensOptimizer::state).unwrap_or_default(),
            skipped: self.state.skipped,
            block: self.block.as_ref().map(|block| block.state),
            capacities: self.capacities(),
        })
    }

    /// Creates a trainer that continues from a checkpoint as if it had never stopped. It needs the same views in the same
    /// order, and the same settings. Only the number of iterations may differ, if it is not reached yet. With another version,
    /// device or driver the bits differ: see [`Checkpoint::differences`].
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming what differs; same as [`Trainer::new`].
    pub fn resume(
        context: &Context,
        views: Vec<TrainView>,
        scene_extent: f32,
        settings: TrainSettings,
        from: &Checkpoint,
    ) -> Result<Self> {
        settings.check()?;
        let parts = TrainParts::of_settings(context, &settings)?;
        Self::resume_with_parts(context, views, scene_extent, settings, parts, from)
    }

    /// Same as [`Trainer::resume`], for a run of [`Trainer::with_parts`].
    pub fn resume_with_parts(
        context: &Context,
        views: Vec<TrainView>,
        scene_extent: f32,
        settings: TrainSettings,
        mut parts: TrainParts,
        from: &Checkpoint,
    ) -> Result<Self> {
        from.check()?;
        from.check_fits(&ExpectedRun {
            settings: &settings,
            views: views.len() as u64,
            views_fingerprint: fingerprint_of(&views, settings.lens_effects),
            scene_extent,
            block: parts.block.as_ref().and_then(SceneBlock::state),
        })?;
        let (there, here) = (from.strategy.name.as_str(), parts.strategy.name());
        if there != here {
            let problem = format!("was made with the strategy '{there}', here it is '{here}'");
            return Err(Error::argument("checkpoint", problem));
        }
        parts.strategy.restore(&from.strategy.values)?;
        let sh_degree_start = settings.sh_degree_start_after(&from.settings, from.iteration);
        let settings = TrainSettings { sh_degree_start, ..settings };
        let earlier = Some(&from.capacities);
        let mut trainer =
            Trainer::build(context, views, &from.gaussians, scene_extent, settings, parts, earlier)?;
        let here: Vec<&str> = trainer.recorder.terms().collect();
        if from.strategy.terms != here {
            let problem = format!(
                "was made with the terms {:?} of the loss, here they are {here:?}",
                from.strategy.terms
            );
            return Err(Error::argument("checkpoint", problem));
        }
        trainer.restore_rows(from)?;
        trainer.losses.appearance.restore(context, [&from.exposures, &from.lens_effects])?;
        if let Some(poses) = &trainer.poses {
            let lacks = || Error::argument("checkpoint", "lacks the poses of its views");
            poses.restore(context, from.poses.as_ref().ok_or_else(lacks)?)?;
        }
        if let Some(lenses) = &mut trainer.lens_opt {
            lenses.restore(&mut trainer.run.cameras, &from.lens_opt)?;
        }
        // The shorter run omitted a reset that this run makes.
        let recovery = from.settings.reset_recovery();
        let made_up = (from.iteration.saturating_sub(recovery) + 1..=from.iteration).any(|iteration| {
            let here = trainer.actions_at(iteration).contains(Actions::RESET_OPACITY);
            here && from.settings.left_out_reset_at(iteration)
        });
        let state = &mut trainer.state;
        state.progress = Progress {
            iteration: from.iteration,
            steps: from.optimizer_steps,
            opacity_steps: from.opacity_steps,
            due: from.due.and(Actions::RESET_OPACITY.when(made_up)),
        };
        state.peak = from.capacities.peak();
        state.skipped = from.skipped;
        if from.iteration > 0 && from.iteration == from.settings.iterations {
            trainer.finish_last_iteration()?;
        }
        Ok(trainer)
    }

    fn moment_state(&self) -> Result<MomentState> {
        let model = &self.state.model;
        if model.moments.packed {
            let words = model.moment_planes().map(|planes| planes::download_words(&self.context, &planes));
            return Ok(MomentState::Packed(words.collect::<Result<Vec<_>>>()?.concat()));
        }
        let sets = model.moment_planes().map(|planes| planes::download(&self.context, &planes));
        Ok(MomentState::F32(array_of(sets.collect::<Result<Vec<_>>>()?)))
    }

    /// Uploads the state of each Gaussian besides its parameters.
    pub(super) fn restore_rows(&self, from: &Checkpoint) -> Result<()> {
        let (context, model) = (&self.context, &self.state.model);
        context.upload(&model.statistics[0], bytemuck::cast_slice(&from.statistics))?;
        if self.filter.is_some() {
            planes::upload_filters(context, &model.scene, &from.filters)?;
        }
        for (set, planes) in model.moment_planes().enumerate() {
            match &from.moments {
                MomentState::F32(sets) => planes::fill(context, &planes, &sets[set])?,
                MomentState::Packed(words) => planes::fill_words(context, &planes, words)?,
            }
        }
        Ok(())
    }

    fn capacities(&self) -> Capacities {
        let frame = self.runner.store.capacity();
        Capacities {
            gaussians: self.state.model.scene.plan.capacity,
            frame_gaussians: frame.gaussians,
            frame_visible: frame.visible,
            frame_instances: frame.instances,
            blend_passes: frame.blend_passes,
            most_visible: self.state.peak.visible,
            most_instances: self.state.peak.instances,
            max_memory: self.context.max_memory(),
        }
    }
}
