//! What a training begins with: points, a scene, or a checkpoint.

use super::checkpoints::{AUTO, Start};
use crate::args::HostArguments;
use crate::config::Settings;
use crate::model;
use ashsplat::scene::{Gaussians, PointCloud};
use ashsplat::trainer::{Checkpoint, TrainSettings};
use ashsplat::{Error, Result};
use ashsplat_files::{Dataset, splats};
use std::path::Path;

fn is_auto(asked: Option<&Path>) -> bool {
    asked.is_some_and(|asked| asked.as_os_str() == AUTO)
}

/// What a training begins with.
pub enum Origin {
    /// The points of the data set, or what stands in for them.
    Points,
    /// The Gaussians of a file, `--init`.
    Scene(Gaussians),
    Checkpoint(Box<Start>),
}

impl Origin {
    /// What was asked for; a checkpoint comes before `--init`, with which its training may have begun. Warns where a scene was
    /// trained with another low-pass filter.
    pub fn read(asked: Option<&Path>, settings: &Settings, host: &HostArguments) -> Result<Origin> {
        let data = &settings.data;
        let start = asked.map(|asked| Start::find(asked, &data.model_path, host)).transpose()?.flatten();
        if let Some(start) = start {
            return Ok(Origin::Checkpoint(Box::new(start)));
        }
        if is_auto(asked) {
            tell!("{} has no checkpoint: training begins anew", data.model_path.display());
        }
        if data.init.as_os_str().is_empty() {
            return Ok(Origin::Points);
        }
        let scene = splats::read(&data.init, &host.reading(false))?;
        if scene.gaussians.is_empty() {
            let remedy = "give another file, or leave --init out and begin with points";
            return Err(Error::input(&data.init, "has no Gaussians to begin with", remedy));
        }
        if scene.header.antialiased != settings.train.antialiasing {
            let how = if scene.header.antialiased { "with" } else { "without" };
            tell!("warning: {}: was trained {how} --antialiasing; train {how} it, too", data.init.display());
        }
        for warning in &scene.warnings {
            tell!("warning: {warning}");
        }
        Ok(Origin::Scene(scene.gaussians))
    }

    /// The checkpoint, if it is one.
    pub fn start(&self) -> Option<&Start> {
        match self {
            Origin::Checkpoint(start) => Some(start),
            Origin::Points | Origin::Scene(_) => None,
        }
    }

    /// What was read of it.
    pub fn checkpoint(&self) -> Option<&Checkpoint> {
        self.start().map(Start::checkpoint)
    }

    /// How many Gaussians it has, as far as that is known before the data set is read.
    pub fn gaussians(&self) -> Option<usize> {
        match self {
            Origin::Points => None,
            Origin::Scene(gaussians) => Some(gaussians.len()),
            Origin::Checkpoint(start) => Some(start.checkpoint().gaussians.len()),
        }
    }

    /// Whether a scheduler asks once more for a training that has come to its end.
    pub fn is_complete(&self, asked: Option<&Path>, settings: &Settings) -> bool {
        let (folder, last) = (&settings.data.model_path, settings.train.iterations);
        let at_end = self.start().is_some_and(|start| start.iteration() == last && start.is_of(folder));
        is_auto(asked) && at_end && model::point_cloud_path(folder, last).is_file()
    }

    /// The settings of a training that begins so: the SH degree of a scene is in use from its start.
    pub fn settle(&self, settings: Settings) -> Settings {
        let degree = match self {
            Origin::Points => 0,
            Origin::Scene(gaussians) => gaussians.sh_degree,
            Origin::Checkpoint(start) => start.checkpoint().settings.sh_degree_start,
        };
        let train = settings.train;
        let sh_degree_start = train.sh_degree_start.max(degree).min(train.sh_degree);
        Settings { train: TrainSettings { sh_degree_start, ..train }, ..settings }
    }

    /// The first Gaussians, and the points that they were made of.
    pub fn first(&self, dataset: &Dataset, train: &TrainSettings) -> Result<(Gaussians, Option<PointCloud>)> {
        if let Origin::Scene(gaussians) = self {
            return Ok((gaussians.with_sh_degree(train.sh_degree), None));
        }
        let points = dataset.initial_points(u64::from(train.seed));
        let mut gaussians = ashsplat_files::initial_gaussians(&points, train.sh_degree)?;
        train.initialize(&mut gaussians);
        Ok((gaussians, Some(points)))
    }
}
