//! `bench train`: training of a data set from its points, measured in windows of iterations.

use super::measure::{Iterations, measure};
use super::schema::{CopyBandwidth, Run, Workload};
use super::workload::Fnv;
use super::{forms, frames};
use ashsplat::vk::Context;
use ashsplat::{Error, Gaussians, Result, StepReport, TrainSettings, TrainView, Trainer};
use ashsplat_files::{Dataset, DatasetOptions, Progress};
use ashsplat_program::args::HostArguments;
use std::path::Path;

/// Iterations of a window. Every second one is timed kernel by kernel.
const WINDOW: u32 = 100;
/// One more step precedes them, in which the profile allocates its memory.
pub const ITERATIONS: Iterations = Iterations { measured: (WINDOW - 1) / 2, warmup: 0, timed: true };

/// A data set to train with the reference's settings; every eighth view is held out.
pub struct Training {
    source: String,
    views: Vec<TrainView>,
    initial: Gaussians,
    scene_extent: f32,
    /// Iterations at which windows end, ascending.
    ends: Vec<u32>,
}

impl Training {
    /// Reads the photos. `ends`: iterations at which the windows end.
    pub fn load(dataset: &Path, ends: &[u32], sh_degree: u32, host: &HostArguments) -> Result<Self> {
        let mut ends = ends.to_vec();
        ends.sort_unstable();
        ends.dedup();
        let mut begin = 0;
        for &end in &ends {
            if end < begin + WINDOW {
                let problem = format!("a window has {WINDOW} iterations, and windows must not overlap");
                return Err(Error::argument(format!("--windows {end}"), problem));
            }
            begin = end;
        }
        let options = DatasetOptions { eval: true, host_memory: host.memory(), ..DatasetOptions::default() };
        let loaded = Dataset::load(dataset, &options, Progress::default())?;
        let points = loaded.initial_points(0);
        if points.is_empty() {
            return Err(Error::input(
                dataset,
                "has no points to start from",
                "give a data set with points3D",
            ));
        }
        let views = loaded.train.into_iter();
        Ok(Self {
            source: dataset.display().to_string(),
            views: views.map(|view| TrainView::new(view.camera, view.photo)).collect(),
            initial: ashsplat_files::initial_gaussians(&points, sh_degree)?,
            scene_extent: loaded.scene_extent,
            ends,
        })
    }

    pub fn measure(&self, context: &Context, copy: Option<&CopyBandwidth>, seed: u64) -> Result<Vec<Run>> {
        let settings = TrainSettings {
            sh_degree: self.initial.sh_degree,
            seed: seed as u32,
            ..TrainSettings::reference()
        };
        let mut trainer =
            Trainer::new(context, self.views.clone(), &self.initial, self.scene_extent, settings)?;
        let mut runs = Vec::new();
        for &end in &self.ends {
            while trainer.iteration() + WINDOW < end {
                trainer.step()?;
            }
            let mut last = StepReport::default();
            let iterate = || {
                last = trainer.step()?;
                Ok(())
            };
            let measured = measure(context, ITERATIONS, || Ok(()), iterate)?;
            let workload = self.workload(end, &last, &trainer);
            let size = (workload.width.unwrap_or(0), workload.height.unwrap_or(0));
            let counts = frames::step_counts(context, &last, trainer.settings().sh_degree, size)?;
            runs.push(frames::result(context, "train", workload, &measured, counts, copy));
        }
        Ok(runs)
    }

    fn workload(&self, end: u32, last: &StepReport, trainer: &Trainer) -> Workload {
        let settings = trainer.settings();
        let mut hash = Fnv::default();
        hash.gaussians(&self.initial);
        for view in &self.views {
            hash.camera(&view.camera);
            // The photo is in memory, so this cannot fail.
            if let Ok(photo) = view.photo.photo() {
                hash.add(&photo.rgb);
            }
        }
        hash.add(format!("{settings:?} {} {end}", self.scene_extent).as_bytes());
        let camera = self.views.first().map(|view| view.camera);
        Workload {
            source: format!("{}, iterations {} to {end}", self.source, end - WINDOW + 1),
            hash: hash.hex(),
            gaussians: Some(last.gaussians),
            sh_degree: Some(settings.sh_degree),
            width: camera.map(|camera| camera.width),
            height: camera.map(|camera| camera.height),
            longest_tile: Some(last.longest_tile),
            blending: Some(forms::name(trainer.blending()).to_owned()),
            ..Workload::default()
        }
    }
}
