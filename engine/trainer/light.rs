//! Exposure of each photograph and effects of each lens, learned with the scene.

use super::checkpoint::{ExposureState, LightSums};
use super::iteration::IterationPlan;
use super::run::Run;
use super::settings::TrainSettings;
use super::{TrainView, Trainer};
use crate::error::{Error, Result};
use crate::exposure::{Exposing, LightBuffers, LightForm};
use crate::forward::FrameInputs;
use crate::lens_effects::{self, LensInputs, Lenses};
use crate::optimizer::{Averaging, MeanStep};
use crate::scene::{Exposure, LensEffects};
use crate::vk::{Buffer, Context, Recorder};
use std::collections::{BTreeMap, BTreeSet};

/// Kernels of exposures and of lens effects; None if not learned.
pub(super) struct Light {
    exposing: Option<Exposing>,
    lenses: Option<Lenses>,
}

/// Matrices and moments, which outlive an iteration, and scratch buffers.
pub(super) struct LightMemory {
    pub exposures: Option<LightBuffers>,
    pub lenses: Option<LightBuffers>,
}

/// Inputs of one iteration.
#[derive(Clone, Copy)]
pub(super) struct LightInputs<'a> {
    pub frame: &'a FrameInputs<'a>,
    /// Rendered picture in the native layout.
    pub rendered: &'a Buffer,
    pub memory: &'a LightMemory,
    pub plan: &'a IterationPlan,
    pub run: &'a Run,
}

impl LightInputs<'_> {
    fn view(&self) -> u32 {
        self.plan.view as u32
    }

    fn lens<'a>(&'a self, buffers: &'a LightBuffers) -> LensInputs<'a> {
        let picture = self.memory.exposures.as_ref().map_or(self.rendered, |exposures| &exposures.picture);
        LensInputs { frame: self.frame, picture, buffers, lens: self.run.lenses[self.plan.view] }
    }
}

impl Light {
    /// `sums`: true if steps may follow several views.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, settings: &TrainSettings, sums: bool) -> Result<Self> {
        let (shares, sparse) = (settings.exposure_shared, settings.exposure_sparsity > 0.0);
        let form = LightForm { center: true, sums, shares, sparse };
        Ok(Self {
            exposing: settings.exposure.then(|| Exposing::new(context, form)).transpose()?,
            lenses: settings.lens_effects.then(|| Lenses::new(context, sums)).transpose()?,
        })
    }

    /// Names and bytes of the buffers, for photographs of these sizes.
    pub fn requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        let exposures = self.exposing.iter().flat_map(|_| LightBuffers::requests(sizes));
        exposures.chain(self.lenses.iter().flat_map(|_| lens_effects::requests(sizes))).collect()
    }

    /// Takes the buffers of [`Light::requests`] from the allocated ones and clears them.
    pub fn allocated(
        &self,
        context: &Context,
        mut buffers: impl Iterator<Item = Buffer>,
    ) -> Result<LightMemory> {
        let mut next = || {
            let all: Vec<Buffer> = buffers.by_ref().take(LightBuffers::COUNT).collect();
            <[Buffer; LightBuffers::COUNT]>::try_from(all).ok().map(LightBuffers::from_allocated)
        };
        let exposures = self.exposing.as_ref().and_then(|_| next());
        let lenses = self.lenses.as_ref().and_then(|_| next());
        exposures.iter().try_for_each(|exposures| exposures.reset(context, Exposure::IDENTITY.rows))?;
        lenses.iter().try_for_each(|lenses| lenses.reset(context, [[0.0; 4]; 3]))?;
        Ok(LightMemory { exposures, lenses })
    }

    /// Records the exposure and lens effects, and returns the picture to compare with the photograph. None if nothing is
    /// learned: the rendered picture is compared. Ends with a barrier.
    pub fn record<'a>(&self, r: &mut Recorder, inputs: &LightInputs<'a>) -> Option<&'a Buffer> {
        let mut picture = None;
        if let Some((exposing, exposures)) = self.exposing.as_ref().zip(inputs.memory.exposures.as_ref()) {
            exposing.record(r, inputs.frame, exposures, inputs.view());
            r.barrier();
            picture = Some(&exposures.picture);
        }
        if let Some((lenses, buffers)) = self.lenses.as_ref().zip(inputs.memory.lenses.as_ref()) {
            lenses.record(r, &inputs.lens(buffers));
            r.barrier();
            picture = Some(&buffers.picture);
        }
        picture
    }

    /// Records the gradient's way back from that picture to the rendered one. Each part begins with a barrier.
    pub fn record_backward(&self, r: &mut Recorder, inputs: &LightInputs, gradient: &Buffer) {
        if let Some((lenses, buffers)) = self.lenses.as_ref().zip(inputs.memory.lenses.as_ref()) {
            r.barrier();
            lenses.record_backward(r, &inputs.lens(buffers), gradient);
        }
        if let Some((exposing, exposures)) = self.exposing.as_ref().zip(inputs.memory.exposures.as_ref()) {
            r.barrier();
            exposing.record_backward(r, inputs.frame, exposures, inputs.view(), gradient);
        }
    }

    /// Records the steps, or the additions to the gradient sums. Each part begins with a barrier.
    pub fn record_step(&self, r: &mut Recorder, inputs: &LightInputs) {
        let (plan, state) = (inputs.plan, &inputs.frame.frame.state);
        if let Some((exposing, exposures)) = self.exposing.as_ref().zip(inputs.memory.exposures.as_ref()) {
            r.barrier();
            exposing.record_step(r, (exposures, state), inputs.view(), &plan.exposure);
        }
        if let Some((lenses, buffers)) = self.lenses.as_ref().zip(inputs.memory.lenses.as_ref()) {
            r.barrier();
            lenses.record_step(r, (buffers, state), inputs.run.lenses[plan.view], &plan.lens_step);
        }
    }
}

impl LightMemory {
    /// Records the running means, which share the buffers of the gradient sums.
    pub fn record_means(&self, r: &mut Recorder, averaging: &Averaging, (state, step): (&Buffer, MeanStep)) {
        for buffers in self.exposures.iter().chain(&self.lenses) {
            averaging.record(r, [&buffers.values, &buffers.sums, state], step);
        }
    }

    /// Records copies of the means over the values.
    pub fn record_end(&self, r: &mut Recorder) {
        self.exposures.iter().chain(&self.lenses).for_each(|buffers| r.copy(&buffers.sums, &buffers.values));
    }

    /// Exposures of all views, and the effects of the first `lenses` lenses.
    pub fn states(&self, context: &Context, lenses: usize) -> Result<[ExposureState; 2]> {
        let state = |buffers: &Option<LightBuffers>, count: usize| -> Result<ExposureState> {
            let Some(buffers) = buffers else { return Ok(ExposureState::default()) };
            let mut sets = buffers.download(context)?;
            sets.iter_mut().for_each(|set| set.truncate(count));
            let [values, first_moments, second_moments] = sets;
            Ok(ExposureState { values, first_moments, second_moments })
        };
        Ok([state(&self.exposures, usize::MAX)?, state(&self.lenses, lenses)?])
    }

    /// Sums of gradients since the last step.
    pub fn sums(&self, context: &Context, lenses: usize) -> Result<LightSums> {
        let sums = |buffers: &Option<LightBuffers>| {
            buffers.as_ref().map_or(Ok(Vec::new()), |buffers| buffers.download_sums(context))
        };
        let mut of_lenses = sums(&self.lenses)?;
        of_lenses.truncate(lenses);
        Ok(LightSums { exposures: sums(&self.exposures)?, lenses: of_lenses })
    }

    /// Restores [`LightMemory::states`] and [`LightMemory::sums`].
    ///
    /// # Errors
    /// [`Error::Argument`] if there are more rows than views.
    pub fn restore(
        &self,
        context: &Context,
        [exposures, lenses]: [&ExposureState; 2],
        sums: &LightSums,
    ) -> Result<()> {
        let parts = [(&self.exposures, exposures, &sums.exposures), (&self.lenses, lenses, &sums.lenses)];
        for (buffers, state, sums) in parts {
            let Some(buffers) = buffers else { continue };
            // Views that share a lens leave rows unused.
            let padded = |rows: &Vec<[[f32; 4]; 3]>| -> Result<Vec<[[f32; 4]; 3]>> {
                if rows.len() > buffers.photographs() {
                    let problem = format!("has {} for {} views", rows.len(), buffers.photographs());
                    return Err(Error::argument("checkpoint", problem));
                }
                let mut rows = rows.clone();
                rows.resize(buffers.photographs(), [[0.0; 4]; 3]);
                Ok(rows)
            };
            let ExposureState { values, first_moments, second_moments } = state;
            let sets = [padded(values)?, padded(first_moments)?, padded(second_moments)?];
            buffers.upload(context, [&sets[0], &sets[1], &sets[2]])?;
            buffers.upload_sums(context, &padded(sums)?)?;
        }
        Ok(())
    }
}

/// Lens index of each view, counted from 0 in the order of the camera ids.
pub(super) fn lenses_of(views: &[TrainView]) -> Vec<u32> {
    let ids: BTreeSet<u32> = views.iter().map(|view| view.camera_id).collect();
    let numbers: BTreeMap<u32, u32> = ids.into_iter().zip(0..).collect();
    views.iter().map(|view| numbers[&view.camera_id]).collect()
}

impl Trainer {
    pub(super) fn light_states(&self) -> Result<[ExposureState; 2]> {
        self.losses.light.states(&self.context, self.run.lens_count())
    }

    pub(super) fn light_sums(&self) -> Result<LightSums> {
        self.losses.light.sums(&self.context, self.run.lens_count())
    }

    /// Exposures of the views' photographs in their order; empty unless they are learned ([`TrainSettings::exposure`]).
    ///
    /// # Errors
    /// Same as [`Trainer::checkpoint`].
    pub fn exposures(&self) -> Result<Vec<Exposure>> {
        self.check_readable()?;
        let [exposures, _] = self.light_states()?;
        Ok(exposures.values.into_iter().map(|rows| Exposure { rows }).collect())
    }

    /// Lens effects of the views' cameras in the views' order; empty unless they are learned ([`TrainSettings::lens_effects`]).
    ///
    /// # Errors
    /// Same as [`Trainer::checkpoint`].
    pub fn lens_effects(&self) -> Result<Vec<LensEffects>> {
        self.check_readable()?;
        let [_, lenses] = self.light_states()?;
        let of = |&lens: &u32| lenses.values.get(lens as usize).map(|&rows| LensEffects { rows });
        Ok(self.run.lenses.iter().filter_map(of).collect())
    }
}
