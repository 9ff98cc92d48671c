//! Appearance of the photographs, learned with the scene: the exposure of each one, and the effects of each lens.

use super::checkpoint::ExposureState;
use super::photos::TrainView;
use super::schedule::{IterationPlan, TrainingRun};
use super::settings::TrainSettings;
use crate::error::{Error, Result};
use crate::frame::FrameInputs;
use crate::passes::appearance::{
    AppearanceBuffers, AppearanceForm, AppearancePass, AppearancePassInputs, AppearanceStep, Matrix,
};
use crate::vk::{Buffer, Context, Recorder};
use std::collections::{BTreeMap, BTreeSet};

/// Kernels of exposures, of lens effects, or of both in this order.
pub(super) struct Appearance(Vec<AppearancePass>);

/// Buffers of exposures and of lens effects; None if not learned.
pub(super) struct AppearanceMemory([Option<AppearanceBuffers>; 2]);

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

/// Exposures or lens effects of an iteration.
struct Part<'a> {
    pass: &'a AppearancePass,
    /// Has the picture that it changes.
    inputs: AppearancePassInputs<'a>,
    step: &'a AppearanceStep,
}

impl Appearance {
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let (shares, sparse) = (settings.exposure_shared, settings.exposure_sparsity > 0.0);
        let form = AppearanceForm { center: true, shares, sparse };
        let exposures = settings.exposure.then(|| AppearancePass::new(context, false, form));
        let lenses =
            settings.lens_effects.then(|| AppearancePass::new(context, true, AppearanceForm::default()));
        Ok(Self(exposures.into_iter().chain(lenses).collect::<Result<_>>()?))
    }

    /// Names and bytes of the buffers, for photographs of these sizes.
    pub fn requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        self.0.iter().flat_map(|pass| pass.requests(sizes)).collect()
    }

    /// Takes the buffers of [`Appearance::requests`] from the allocated ones and clears them.
    pub fn allocated(
        &self,
        context: &Context,
        mut buffers: impl Iterator<Item = Buffer>,
    ) -> Result<AppearanceMemory> {
        let mut memory = AppearanceMemory([None, None]);
        for pass in &self.0 {
            let own =
                AppearanceBuffers::from_allocated(buffers.by_ref().take(AppearanceBuffers::COUNT).collect());
            upload(context, &own.values, &vec![pass.identity(); own.count()])?;
            let none = vec![[[0.0; 4]; 3]; own.count()];
            upload(context, &own.first_moments, &none)?;
            upload(context, &own.second_moments, &none)?;
            memory.0[usize::from(pass.is_lens_effects)] = Some(own);
        }
        Ok(memory)
    }

    /// The parts in order.
    fn parts<'a>(&'a self, inputs: &AppearanceInputs<'a>) -> Vec<Part<'a>> {
        let AppearanceInputs { frame, rendered, memory, plan, run } = *inputs;
        let own = [(plan.view as u32, &plan.exposure), (run.lens_of_view[plan.view], &plan.lens_effects)];
        let mut picture = rendered;
        let part = |(pass, buffers): (&'a AppearancePass, &'a AppearanceBuffers)| {
            let (index, step) = own[usize::from(pass.is_lens_effects)];
            let inputs = AppearancePassInputs { frame, picture, buffers, index };
            picture = &buffers.picture;
            Part { pass, inputs, step }
        };
        self.0.iter().zip(memory.all()).map(part).collect()
    }

    /// Records the exposure and lens effects, and returns the picture to compare with the photograph. None if nothing is
    /// learned: the rendered picture is compared. Ends with a barrier.
    pub fn record<'a>(&'a self, r: &mut Recorder, inputs: &AppearanceInputs<'a>) -> Option<&'a Buffer> {
        let parts = self.parts(inputs);
        for Part { pass, inputs, .. } in &parts {
            pass.record(r, inputs);
            r.barrier();
        }
        parts.last().map(|part| &part.inputs.buffers.picture)
    }

    /// Records the gradient's way back from that picture to the rendered one. Each part begins with a barrier.
    pub fn record_backward(&self, r: &mut Recorder, inputs: &AppearanceInputs, gradient: &Buffer) {
        for Part { pass, inputs, .. } in self.parts(inputs).iter().rev() {
            r.barrier();
            pass.record_backward(r, inputs, gradient);
        }
    }

    /// Records the steps. Each part begins with a barrier.
    pub fn record_step(&self, r: &mut Recorder, inputs: &AppearanceInputs) {
        for Part { pass, inputs, step } in self.parts(inputs) {
            r.barrier();
            pass.record_step(r, &inputs, step);
        }
    }
}

impl AppearanceMemory {
    fn all(&self) -> impl Iterator<Item = &AppearanceBuffers> {
        self.0.iter().flatten()
    }

    /// Exposures of all views, and the effects of their lenses.
    pub fn states(&self, context: &Context, lens_of_view: &[u32]) -> Result<[ExposureState; 2]> {
        let lenses = lens_of_view.iter().max().map_or(0, |&last| last as usize + 1);
        let [exposures, lens_effects] = &self.0;
        let state = |buffers: &Option<AppearanceBuffers>, count: usize| -> Result<ExposureState> {
            let Some(buffers) = buffers else { return Ok(ExposureState::default()) };
            Ok(ExposureState {
                values: download(context, &buffers.values, count)?,
                first_moments: download(context, &buffers.first_moments, count)?,
                second_moments: download(context, &buffers.second_moments, count)?,
            })
        };
        Ok([state(exposures, usize::MAX)?, state(lens_effects, lenses)?])
    }

    /// Restores [`AppearanceMemory::states`]; refuses more rows than views.
    pub fn restore(&self, context: &Context, states: [&ExposureState; 2]) -> Result<()> {
        for (buffers, state) in self.0.iter().zip(states) {
            let Some(buffers) = buffers else { continue };
            let AppearanceBuffers { values, first_moments, second_moments, .. } = buffers;
            let sets = [
                (values, &state.values),
                (first_moments, &state.first_moments),
                (second_moments, &state.second_moments),
            ];
            for (buffer, rows) in sets {
                if rows.len() > buffers.count() {
                    let problem = format!("has {} for {} views", rows.len(), buffers.count());
                    return Err(Error::argument("checkpoint", problem));
                }
                // Views that share a lens leave rows unused.
                let mut rows = rows.clone();
                rows.resize(buffers.count(), [[0.0; 4]; 3]);
                upload(context, buffer, &rows)?;
            }
        }
        Ok(())
    }
}

fn upload(context: &Context, buffer: &Buffer, rows: &[Matrix]) -> Result<()> {
    context.upload(buffer, bytemuck::cast_slice(rows))
}

/// Downloads the first `count` matrices, at most all.
fn download(context: &Context, buffer: &Buffer, count: usize) -> Result<Vec<Matrix>> {
    let mut rows: Vec<Matrix> = bytemuck::pod_collect_to_vec(&context.download(buffer)?);
    rows.truncate(count);
    Ok(rows)
}

/// Lens index of each view, counted from 0 in the order of the camera ids.
pub(super) fn lenses_of(views: &[TrainView]) -> Vec<u32> {
    let ids: BTreeSet<u32> = views.iter().map(|view| view.camera_id).collect();
    let numbers: BTreeMap<u32, u32> = ids.into_iter().zip(0..).collect();
    views.iter().map(|view| numbers[&view.camera_id]).collect()
}
