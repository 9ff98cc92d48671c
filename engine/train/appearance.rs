//! Appearance of the photographs, learned with the scene: the exposure of each one, and the effects of each lens.

use super::checkpoint::{ExposureState, LightMeans};
use super::photos::TrainView;
use super::schedule::{IterationPlan, TrainingRun};
use super::settings::TrainSettings;
use crate::error::{Error, Result};
use crate::frame::FrameInputs;
use crate::passes::adam::{Averaging, MeanStep};
use crate::passes::exposure::{Exposing, LightBuffers, LightForm};
use crate::passes::lens_effects::{self, LensInputs, Lenses};
use crate::scene::Exposure;
use crate::vk::{Buffer, Context, Recorder};
use std::collections::{BTreeMap, BTreeSet};

/// Kernels of exposures and of lens effects; None if not learned.
pub(super) struct Appearance {
    exposing: Option<Exposing>,
    lenses: Option<Lenses>,
}

/// Matrices and moments, which outlive an iteration, and scratch buffers.
pub(super) struct AppearanceMemory {
    exposures: Option<LightBuffers>,
    lenses: Option<LightBuffers>,
}

/// Inputs of one iteration.
#[derive(Clone, Copy)]
pub(super) struct AppearanceInputs<'a> {
    pub frame: &'a FrameInputs<'a>,
    /// Rendered picture in the native layout.
    pub rendered: &'a Buffer,
    pub memory: &'a AppearanceMemory,
    pub plan: &'a IterationPlan,
    pub run: &'a TrainingRun,
}

impl Appearance {
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let (shares, sparse) = (settings.exposure_shared, settings.exposure_sparsity > 0.0);
        let form = LightForm { center: true, shares, sparse };
        Ok(Self {
            exposing: settings.exposure.then(|| Exposing::new(context, form)).transpose()?,
            lenses: settings.lens_effects.then(|| Lenses::new(context)).transpose()?,
        })
    }

    /// Names and bytes of the buffers, for photographs of these sizes.
    pub fn requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        let exposures = self.exposing.iter().flat_map(|_| LightBuffers::requests(sizes));
        exposures.chain(self.lenses.iter().flat_map(|_| lens_effects::requests(sizes))).collect()
    }

    /// Takes the buffers of [`Appearance::requests`] from the allocated ones and clears them.
    pub fn allocated(
        &self,
        context: &Context,
        mut buffers: impl Iterator<Item = Buffer>,
    ) -> Result<AppearanceMemory> {
        let mut next = |matrix| -> Result<Option<LightBuffers>> {
            let all: Vec<Buffer> = buffers.by_ref().take(LightBuffers::COUNT).collect();
            let Ok(all) = <[Buffer; LightBuffers::COUNT]>::try_from(all) else { return Ok(None) };
            let buffers = LightBuffers::from_allocated(all);
            buffers.reset(context, matrix)?;
            Ok(Some(buffers))
        };
        Ok(AppearanceMemory {
            exposures: if self.exposing.is_some() { next(Exposure::IDENTITY.rows)? } else { None },
            lenses: if self.lenses.is_some() { next([[0.0; 4]; 3])? } else { None },
        })
    }

    fn exposures<'a>(&self, inputs: &AppearanceInputs<'a>) -> Option<(&Exposing, &'a LightBuffers)> {
        self.exposing.as_ref().zip(inputs.memory.exposures.as_ref())
    }

    fn lenses<'a>(&self, inputs: &AppearanceInputs<'a>) -> Option<(&Lenses, LensInputs<'a>)> {
        let AppearanceInputs { frame, rendered, memory, plan, run } = *inputs;
        let picture = memory.exposures.as_ref().map_or(rendered, |exposures| &exposures.picture);
        let (lenses, buffers) = self.lenses.as_ref().zip(memory.lenses.as_ref())?;
        Some((lenses, LensInputs { frame, picture, buffers, lens: run.lenses[plan.view] }))
    }

    /// Records the exposure and lens effects, and returns the picture to compare with the photograph. None if nothing is
    /// learned: the rendered picture is compared. Ends with a barrier.
    pub fn record<'a>(&self, r: &mut Recorder, inputs: &AppearanceInputs<'a>) -> Option<&'a Buffer> {
        let mut picture = None;
        if let Some((exposing, exposures)) = self.exposures(inputs) {
            exposing.record(r, inputs.frame, exposures, inputs.plan.view as u32);
            r.barrier();
            picture = Some(&exposures.picture);
        }
        if let Some((lenses, lens)) = self.lenses(inputs) {
            lenses.record(r, &lens);
            r.barrier();
            picture = Some(&lens.buffers.picture);
        }
        picture
    }

    /// Records the gradient's way back from that picture to the rendered one. Each part begins with a barrier.
    pub fn record_backward(&self, r: &mut Recorder, inputs: &AppearanceInputs, gradient: &Buffer) {
        if let Some((lenses, lens)) = self.lenses(inputs) {
            r.barrier();
            lenses.record_backward(r, &lens, gradient);
        }
        if let Some((exposing, exposures)) = self.exposures(inputs) {
            r.barrier();
            exposing.record_backward(r, inputs.frame, exposures, inputs.plan.view as u32, gradient);
        }
    }

    /// Records the steps. Each part begins with a barrier.
    pub fn record_step(&self, r: &mut Recorder, inputs: &AppearanceInputs) {
        let (plan, state) = (inputs.plan, &inputs.frame.frame.state);
        if let Some((exposing, exposures)) = self.exposures(inputs) {
            r.barrier();
            exposing.record_step(r, (exposures, state), plan.view as u32, &plan.exposure);
        }
        if let Some((lenses, lens)) = self.lenses(inputs) {
            r.barrier();
            lenses.record_step(r, (lens.buffers, state), lens.lens, &plan.lens_step);
        }
    }
}

impl AppearanceMemory {
    fn all(&self) -> impl Iterator<Item = &LightBuffers> {
        self.exposures.iter().chain(&self.lenses)
    }

    /// Records the running means.
    pub fn record_means(&self, r: &mut Recorder, averaging: &Averaging, state: &Buffer, step: MeanStep) {
        self.all().for_each(|buffers| averaging.record(r, [&buffers.values, &buffers.means, state], step));
    }

    /// Records copies of the means over the values.
    pub fn record_end(&self, r: &mut Recorder) {
        self.all().for_each(|buffers| r.copy(&buffers.means, &buffers.values));
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

    /// Running means of the same matrices.
    pub fn means(&self, context: &Context, lenses: usize) -> Result<LightMeans> {
        let means = |buffers: &Option<LightBuffers>| {
            buffers.as_ref().map_or(Ok(Vec::new()), |buffers| buffers.download_means(context))
        };
        let mut of_lenses = means(&self.lenses)?;
        of_lenses.truncate(lenses);
        Ok(LightMeans { exposures: means(&self.exposures)?, lenses: of_lenses })
    }

    /// Restores [`AppearanceMemory::states`] and [`AppearanceMemory::means`].
    ///
    /// # Errors
    /// [`Error::Argument`] if there are more rows than views.
    pub fn restore(
        &self,
        context: &Context,
        [exposures, lenses]: [&ExposureState; 2],
        means: &LightMeans,
    ) -> Result<()> {
        let parts = [(&self.exposures, exposures, &means.exposures), (&self.lenses, lenses, &means.lenses)];
        for (buffers, state, means) in parts {
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
            buffers.upload_means(context, &padded(means)?)?;
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
