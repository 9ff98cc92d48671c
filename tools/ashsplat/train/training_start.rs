//! The start of a training: points, a scene, or a checkpoint; and the block that is trained.

use super::checkpoints::{ResumePoint, StartFrom};
use super::prepared::Data;
use ashsplat::frame::to_u32;
use ashsplat::scene::{Gaussians, PointCloud, WorldFrame};
use ashsplat::train::{Checkpoint, Forecast, SceneBlock, TrainParts, TrainSettings, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_files::splats::Scene;
use ashsplat_files::{Dataset, Gallery, splats};
use ashsplat_program::args::HostArguments;
use ashsplat_program::config::Settings;
use ashsplat_program::model;
use ashsplat_program::progress::thousands;
use glam::Vec3;
use std::path::Path;

/// The start of a training: a checkpoint, else a scene, else the points of the data set or their substitute. A
/// checkpoint of a block lacks its surroundings, which come from the scene or the points.
#[derive(Default)]
pub struct RunStart {
    start: Option<Box<ResumePoint>>,
    scene: Option<Scene>,
    /// The scene after an exchange of blocks, if the depths of the first scene are needed too.
    exchanged: Option<Scene>,
    /// The trained Gaussians and the block, after the scene was divided.
    divided: Option<(Gaussians, SceneBlock)>,
    /// True if the data set's points are needed, even for a checkpoint of a block among them.
    pub needs_points: bool,
}

#[derive(Clone)]
pub struct InitialGaussians {
    /// The trained Gaussians; `None` if they come from a checkpoint.
    pub trained: Option<Gaussians>,
    pub block: Option<SceneBlock>,
    pub points: Option<PointCloud>,
}

impl RunStart {
    /// Reads the requested start. A checkpoint precedes `--init`, with which its training may have begun. Warns if a
    /// scene was trained with another low-pass filter. `exchanged` is the scene around a block after an exchange.
    pub fn read(
        from: Option<&StartFrom>,
        settings: &Settings,
        exchanged: Option<&Path>,
        host: &HostArguments,
    ) -> Result<RunStart> {
        let data = &settings.data;
        let start = from.map(|from| ResumePoint::find(from, &data.model_path, host)).transpose()?.flatten();
        let start = start.map(Box::new);
        if start.is_none() && from.is_some() {
            errln!("{} has no checkpoint: training begins anew", data.model_path.display());
        }
        if let Some(start) = &start {
            let (iteration, last) = (start.iteration(), settings.train.iterations);
            // A scheduler may retry a training that is complete.
            if iteration == last && start.from != StartFrom::Auto {
                let problem = format!("is of iteration {iteration} already, the last one");
                return Err(Error::argument("checkpoint", problem + "; raise --iterations to go on"));
            }
        }
        let (continues, has_block) = (start.is_some(), data.block(&WorldFrame::default())?.is_some());
        if data.init.as_os_str().is_empty() || continues && !has_block {
            return Ok(RunStart { start, needs_points: !continues || has_block, ..RunStart::default() });
        }
        let whole = |path: &Path| path.canonicalize().ok();
        let (init, model) = (whole(&data.init), whole(&data.model_path));
        if !continues && init.zip(model).is_some_and(|(init, model)| init.starts_with(model)) {
            let problem = "lies in the model folder (-m), from where an earlier training is moved";
            return Err(Error::input(&data.init, problem, "choose another model folder"));
        }
        let read = |path: &Path| scene_of(path, settings, host);
        let (scene, exchanged) = match exchanged {
            Some(exchanged) if data.looks_at_depths()? => (read(&data.init)?, Some(read(exchanged)?)),
            other => (read(other.unwrap_or(&data.init))?, None),
        };
        Ok(RunStart { start, scene: Some(scene), exchanged, ..RunStart::default() })
    }

    /// A training that begins with the data set's points.
    pub fn points() -> RunStart {
        RunStart { needs_points: true, ..RunStart::default() }
    }

    /// Divides a scene into the block's trained Gaussians and the visible rest. Returns a note if some of the rest is
    /// out of view.
    pub fn divide(&mut self, settings: &Settings, gallery: &Gallery) -> Result<Option<String>> {
        let (train, block) = (&settings.train, settings.data.block(gallery.frame())?);
        let Some(((core, margin), scene)) = block.zip(self.exchanged.as_ref().or(self.scene.as_ref())) else {
            return Ok(None);
        };
        let (trained, block) =
            SceneBlock::divide(&scene.gaussians.with_sh_degree(train.sh_degree), core, margin)?;
        let block = settings.data.outside.leave(block, self.exchanged.is_some());
        let frozen = block.frozen.len();
        let block = block.without_invisible(&gallery.used_cameras()?, train);
        let out_of_view = frozen - block.frozen.len();
        // Frees the whole scenes, to save memory.
        (self.scene, self.exchanged) = (None, None);
        self.divided = Some((trained, block));
        let [left_out, all] = [out_of_view, frozen].map(|count| thousands(count as u64));
        let line = || {
            format!("Gaussians around the block: {left_out} of {all} left out, which no photo of it shows")
        };
        Ok((out_of_view > 0).then(line))
    }

    /// The scene with which training begins or began, unless it begins with points.
    pub fn scene(&self) -> Option<&Gaussians> {
        self.scene.as_ref().map(|scene| &scene.gaussians)
    }

    /// Moves the scenes to the frame of the data set.
    pub fn express_in(&mut self, frame: &WorldFrame) {
        self.scene.iter_mut().chain(&mut self.exchanged).for_each(|scene| scene.express_in(frame));
    }

    /// Warns if no photo shows a Gaussian of the initial scene.
    pub fn warn_if_out_of_view(&self, settings: &Settings, gallery: &Gallery) -> Result<()> {
        const SAMPLE: usize = 4096;
        let Some(scene) = self.scene().filter(|_| self.start.is_none()) else { return Ok(()) };
        let cameras = gallery.used_cameras()?;
        let mut sample = scene.means.iter().step_by(scene.len().div_ceil(SAMPLE).max(1));
        if !sample.any(|&mean| cameras.iter().any(|camera| camera.sees(Vec3::from_array(mean)))) {
            errln!(
                "warning: {}: no photograph shows a Gaussian of it (a sample): do scene and data set have the same coordinates?",
                settings.data.init.display()
            );
        }
        Ok(())
    }

    pub fn start(&self) -> Option<&ResumePoint> {
        self.start.as_deref()
    }

    pub fn checkpoint(&self) -> Option<&Checkpoint> {
        self.start().map(|start| &start.checkpoint)
    }

    /// Number of trained Gaussians and of those around them, as far as it is known before photos are read. It counts
    /// `points`, or their substitute if there are none.
    pub fn counts(
        &self,
        settings: &Settings,
        (points, frame): (&PointCloud, &WorldFrame),
    ) -> Result<[usize; 2]> {
        if let Some((trained, block)) = &self.divided {
            let trained = self.checkpoint().map_or(trained, |checkpoint| &checkpoint.gaussians);
            return Ok([trained.len(), block.frozen.len()]);
        }
        let means = match self.scene() {
            Some(scene) => &scene.means,
            None => &points.positions,
        };
        let all = if means.is_empty() { settings.missing_points() } else { means.len() };
        let inside = match settings.data.block(frame)? {
            Some((core, margin)) if !means.is_empty() => {
                means.iter().filter(|&&mean| SceneBlock::contains(core, margin, mean)).count()
            }
            _ => all,
        };
        let is_drawn = settings.data.outside.is_drawn(false);
        let drawn = if is_drawn { all - inside } else { 0 };
        match self.checkpoint() {
            Some(checkpoint) => Ok([checkpoint.gaussians.len(), drawn]),
            None if inside == 0 => Err(SceneBlock::nothing_inside(all)),
            None => Ok([inside, drawn]),
        }
    }

    /// True if the training is complete and saved; only a scheduler may start it again.
    pub fn is_complete(&self, settings: &Settings) -> bool {
        let (folder, last) = (&settings.data.model_path, settings.train.iterations);
        let at_end = self.start().is_some_and(|start| start.iteration() == last);
        at_end && model::point_cloud_path(folder, last).is_file()
    }

    /// SH degree of the start, which is used from the beginning.
    pub fn sh_degree(&self) -> u32 {
        match self.checkpoint() {
            Some(checkpoint) => checkpoint.settings.sh_degree_start,
            None => self.scene().map_or(0, |scene| scene.sh_degree),
        }
    }

    pub fn initial_gaussians(&self, dataset: &Dataset, settings: &Settings) -> Result<InitialGaussians> {
        let (train, block) = (&settings.train, settings.data.block(&dataset.frame)?);
        let continues = self.start.is_some();
        if continues && block.is_none() {
            return Ok(InitialGaussians { trained: None, block: None, points: None });
        }
        if let Some((trained, block)) = &self.divided {
            let trained = (!continues).then(|| trained.clone());
            return Ok(InitialGaussians { trained, block: Some(block.clone()), points: None });
        }
        let (whole, points) = match self.scene() {
            Some(gaussians) => (gaussians.with_sh_degree(train.sh_degree), None),
            None => {
                let points = dataset.initial_points(u64::from(train.seed));
                let mut gaussians = ashsplat_files::initial_gaussians(&points, train.sh_degree)?;
                train.initialize(&mut gaussians);
                (gaussians, Some(points))
            }
        };
        let (trained, block) = match block {
            None => (whole, None),
            Some((core, margin)) => {
                let (trained, block) = SceneBlock::divide(&whole, core, margin)?;
                (trained, Some(settings.data.outside.leave(block, false)))
            }
        };
        let beginning = (Some(trained), points);
        let (trained, points) = if continues { (None, None) } else { beginning };
        Ok(InitialGaussians { trained, block, points })
    }

    pub fn trainer(
        &self,
        context: &Context,
        data: Data,
        first: InitialGaussians,
        settings: &TrainSettings,
    ) -> Result<Trainer> {
        let Data { train, scene_extent } = data;
        settings.check()?;
        let parts = TrainParts { block: first.block, ..TrainParts::of_settings(context, settings)? };
        match (&self.start, &first.trained) {
            (Some(start), _) => start.trainer(context, train, (settings, scene_extent), parts),
            (None, Some(initial)) => {
                Trainer::with_parts(context, train, initial, scene_extent, settings.clone(), parts)
            }
            (None, None) => unreachable!("without a checkpoint there are first Gaussians"),
        }
    }
}

/// Reads the initial Gaussians of a file, with warnings.
fn scene_of(path: &Path, settings: &Settings, host: &HostArguments) -> Result<Scene> {
    let scene = splats::read(path, &host.reading(false))?;
    if scene.gaussians.is_empty() {
        let remedy = "give another file, or leave --init out and begin with points";
        return Err(Error::input(path, "has no Gaussians to begin with", remedy));
    }
    // Formats without the mark read as trained without antialiasing.
    if scene.header.antialiased && !settings.train.antialiasing {
        errln!("warning: {}: was trained with --antialiasing; train with it, too", path.display());
    }
    if let Some(size) = scene.header.kernel_size.filter(|size| *size != settings.train.kernel_size as f32) {
        errln!("warning: {}: was trained with --kernel-size {size}; train with it, too", path.display());
    }
    if scene.header.distance_order && !settings.train.distance_order {
        errln!("warning: {}: was trained with --distance-order; train with it, too", path.display());
    }
    for warning in &scene.warnings {
        errln!("warning: {warning}");
    }
    Ok(scene)
}

/// Refuses a training that does not fit, by the sizes of the photos, before they are read.
pub fn check_fits(context: &Context, gallery: &Gallery, settings: &Settings, start: &RunStart) -> Result<()> {
    let [gaussians, frozen] = start.counts(settings, (gallery.points(), gallery.frame()))?;
    settings.train.check_cameras(gallery.used_cameras()?.iter())?;
    Forecast {
        settings: &settings.train,
        photos: &gallery.train_photos(),
        photo_memory: gallery.file_memory(),
        gaussians: to_u32(gaussians as u64)?,
        frozen: to_u32(frozen as u64)?,
        capacities: start.checkpoint().map(|checkpoint| &checkpoint.capacities),
    }
    .check(context)
}
