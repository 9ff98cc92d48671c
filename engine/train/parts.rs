//! Replaceable parts of training, the kernels built from them, and whether a training with them fits the device and the memory.

use super::block::SceneBlock;
use super::checkpoint::Capacities;
use super::memory::{RowMemory, StartMemory};
use super::photos::{self, PhotoBytes, PhotoSize};
use super::settings::TrainSettings;
use super::step::StepRecorder;
use super::strategy::{self, Strategy};
use super::terms::{self, InverseDepth, SparseDepth, Surface};
use crate::error::{Error, Result};
use crate::frame::max_trained_among;
use crate::passes::loss::{LossTerm, Photometric};
use crate::vk::Context;

/// Replaceable parts of training. The photometric term of the loss always comes first.
pub struct TrainParts {
    /// Density control.
    pub strategy: Box<dyn Strategy>,
    /// Loss terms besides the photometric one.
    pub terms: Vec<Box<dyn LossTerm>>,
    /// Block that the initial Gaussians form; None if they are the whole scene.
    pub block: Option<SceneBlock>,
}

impl TrainParts {
    /// Returns the parts that the settings select.
    pub fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let terms = terms::of_settings(context, settings)?;
        Ok(Self { strategy: strategy::of_settings(context, settings)?, terms, block: None })
    }
}

/// Properties of a training that are known before its photographs are read.
#[derive(Clone, Copy, Debug)]
pub struct Forecast<'a> {
    /// Settings of the training.
    pub settings: &'a TrainSettings,
    /// The photographs to train on.
    pub photos: &'a [PhotoSize],
    /// Memory bound of the photographs in bytes, if they will be in a file
    /// ([`PhotoFile::memory_bytes`](crate::scene::PhotoFile::memory_bytes)).
    pub photo_memory: Option<u64>,
    /// Initial number of trained Gaussians; the checkpoint's when resuming.
    pub gaussians: u32,
    /// Number of frozen Gaussians: [`SceneBlock::frozen`](super::SceneBlock::frozen).
    pub frozen: u32,
    /// Capacities of the checkpoint.
    pub capacities: Option<&'a Capacities>,
}

impl Forecast<'_> {
    /// Refuses a training that [`Trainer::new`](super::Trainer::new) or [`Trainer::resume`](super::Trainer::resume) would
    /// refuse because of memory or a device limit.
    ///
    /// # Errors
    /// [`Error::TooLarge`](crate::Error::TooLarge) with the photograph and the needed bytes;
    /// [`Error::Vulkan`](crate::Error::Vulkan) from the device.
    pub fn check(&self, context: &Context) -> Result<()> {
        self.settings.check()?;
        if self.photos.is_empty() {
            return Ok(());
        }
        let parts = TrainParts::of_settings(context, self.settings)?;
        parts.strategy.check(self.settings, self.gaussians)?;
        // The border of a block without frozen Gaussians is unknown here. The trainer checks it.
        check_block_settings(self.settings, &*parts.strategy, false, self.frozen > 0)?;
        // The extent only scales a weight.
        let parts = BuiltParts::new(context, self.settings, 1.0, parts, self.photos)?;
        self.capacity(context, &parts).map(drop)
    }

    /// Most Gaussians with which such a training can begin; 0 if it cannot. Those of the forecast, and its checkpoint, do not count.
    ///
    /// # Errors
    /// [`Error::Argument`] for invalid settings and without photographs; [`Error::Vulkan`](crate::Error::Vulkan) from the device.
    pub fn max_gaussians(&self, context: &Context) -> Result<u32> {
        self.settings.check()?;
        if self.photos.is_empty() {
            return Err(Error::argument("photographs", "there are none to train on"));
        }
        let parts = TrainParts::of_settings(context, self.settings)?;
        let parts = BuiltParts::new(context, self.settings, 1.0, parts, self.photos)?;
        let (mut fits, mut beyond) = (0, max_trained_among(context.limits(), self.frozen).saturating_add(1));
        while beyond - fits > 1 {
            let gaussians = fits + (beyond - fits) / 2;
            match (Forecast { gaussians, capacities: None, ..*self }).capacity(context, &parts) {
                Ok(_) => fits = gaussians,
                Err(Error::TooLarge { .. }) => beyond = gaussians,
                Err(error) => return Err(error),
            }
        }
        Ok(fits)
    }

    /// Initial capacity in Gaussians, and true if it is the checkpoint's because all of its capacities fit.
    pub(super) fn capacity(&self, context: &Context, parts: &BuiltParts) -> Result<(u32, bool)> {
        let (photos, photo_memory) = (self.photos, self.photo_memory);
        let (photo_bytes, refused) = match photos::device_bytes(context, photos, photo_memory) {
            Ok(bytes) => (bytes, None),
            Err(error @ Error::TooLarge { needed, .. }) => {
                (PhotoBytes::reading_ahead(context, photos, needed, photo_memory), Some(error))
            }
            Err(error) => return Err(error),
        };
        let memory = StartMemory { of: *self, parts, photo_bytes };
        memory.check_photos(context)?;
        if let Some(error) = refused {
            // If the whole training does not fit, that error matters more than the photographs'.
            memory.initial_capacity(context)?;
            return Err(error);
        }
        match self.capacities.filter(|earlier| memory.holds(context, earlier)) {
            Some(earlier) => Ok((earlier.gaussians, true)),
            None => Ok((memory.initial_capacity(context)?, false)),
        }
    }
}

/// Kernels of a run, and its memory per Gaussian.
pub(super) struct BuiltParts {
    pub strategy: Box<dyn Strategy>,
    pub recorder: StepRecorder,
    pub rows: RowMemory,
}

impl BuiltParts {
    pub fn new(
        context: &Context,
        settings: &TrainSettings,
        scene_extent: f32,
        parts: TrainParts,
        photos: &[PhotoSize],
    ) -> Result<Self> {
        let TrainParts { strategy, terms, block: _ } = parts;
        let any_masked = photos.iter().any(|photo| photo.masked);
        let mut all: Vec<Box<dyn LossTerm>> =
            vec![Box::new(Photometric::new(context, any_masked, settings.lambda_dssim as f32)?)];
        if photos.iter().any(|photo| photo.inverse_depth) {
            all.push(Box::new(InverseDepth::new(context, settings)?));
        }
        if settings.depth_points > 0.0 {
            let max_points = photos.iter().map(|photo| photo.depth_points).max().unwrap_or(0);
            if max_points == 0 {
                let problem =
                    "needs sparse points that the views are known to show, and there are none: leave it at 0";
                return Err(Error::argument("depth_points", problem));
            }
            all.push(Box::new(SparseDepth::new(context, settings, scene_extent, max_points)?));
        }
        all.extend(terms);
        check_depths(settings, &all)?;
        let parameter_gradients = StepRecorder::term_data_of(&all).parameters;
        let rows = RowMemory::new(parameter_gradients, context.planes_memory(), settings);
        let recorder = StepRecorder::new(context, all, settings, strategy.absolute_gradients())?;
        Ok(Self { strategy, recorder, rows })
    }
}

/// Refuses terms that need different kinds of depth in a frame, and a warm-up with depth terms, because their depths belong to
/// the photographs' full-size pixels.
fn check_depths(settings: &TrainSettings, terms: &[Box<dyn LossTerm>]) -> Result<()> {
    let depths = terms.iter().filter(|term| term.data().inverse_depth);
    let names: Vec<&str> = depths.map(|term| term.name()).collect();
    if names.len() > 1 && terms.iter().any(|term| term.data().linear_depth) {
        let problem = format!(
            "does not go together with other depths ({}): take the sparse points or the maps (-d)",
            names.join(", ")
        );
        return Err(Error::argument("depth_points", problem));
    }
    // Surfaces are those of the frame, whatever its size.
    match names.iter().find(|name| **name != Surface::NAME) {
        Some(name) => settings.refuse_warm_up_with(&format!("depths ({name})")),
        None => Ok(()),
    }
}

/// Refuses settings and strategies that exclude blocks.
pub(super) fn check_block(
    settings: &TrainSettings,
    strategy: &dyn Strategy,
    block: &SceneBlock,
) -> Result<()> {
    SceneBlock::check_box(block.core, 0.0)?;
    block.frozen.check_shapes()?;
    // Cameras that move may begin to see dropped Gaussians.
    let frozen = block.surroundings().count > 0;
    check_block_settings(settings, strategy, !SceneBlock::is_everything(block.core), frozen)
}

/// Same as [`check_block`]. `bordered`: density control has a border; `frozen`: there are frozen Gaussians.
fn check_block_settings(
    settings: &TrainSettings,
    strategy: &dyn Strategy,
    bordered: bool,
    frozen: bool,
) -> Result<()> {
    if (bordered || frozen) && !strategy.grows_by_statistics() {
        let problem = format!(
            "the strategy '{}' adds Gaussians anywhere; take one that goes by gradients, or fixed",
            strategy.name()
        );
        return Err(Error::argument("block", problem));
    }
    for (name, is_on) in [("pose_opt", settings.pose_opt), ("lens_opt", settings.lens_opt)] {
        if frozen && is_on {
            let problem =
                "does not go together with a block of a scene: optimise the cameras with the whole of it";
            return Err(Error::argument(name, problem));
        }
    }
    Ok(())
}
