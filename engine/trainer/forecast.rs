//! Checks that a training fits the device and the memory before its photographs are read.

use super::budget::Before;
use super::checkpoint::Room;
use super::model::RowMemory;
use super::photos::{self, PhotoBytes, PhotoSize};
use super::poses;
use super::settings::TrainSettings;
use super::step_recorder::StepRecorder;
use super::strategy::Strategy;
use super::{InverseDepth, SparseDepth, TrainParts, TrainView, average, surroundings};
use crate::error::{Error, Result};
use crate::forward::Filter3d;
use crate::loss::{LossTerm, Photometric};
use crate::vk::Context;

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
    pub room: Option<&'a Room>,
}

impl Forecast<'_> {
    /// Refuses a training that [`Trainer::new`](super::Trainer::new) or [`Trainer::resume`](super::Trainer::resume) would
    /// refuse because of memory or a device limit.
    ///
    /// # Errors
    /// [`Error::TooLarge`](crate::Error::TooLarge) with the photograph and the needed bytes;
    /// [`Error::Vulkan`](crate::Error::Vulkan) from the device.
    pub fn check(&self, context: &Context) -> Result<()> {
        let Self { settings, photos, photo_memory, gaussians, frozen, room } = *self;
        settings.check()?;
        if photos.is_empty() {
            return Ok(());
        }
        let parts = TrainParts::of_settings(context, settings)?;
        parts.strategy.check(settings, gaussians)?;
        // The border of a block without frozen Gaussians is unknown here. The trainer checks it.
        surroundings::check_settings(settings, &*parts.strategy, false, frozen > 0)?;
        // The extent only scales a weight.
        let kit = Kit::new(context, (settings, 1.0), parts, photos)?;
        kit.capacity(context, settings, (photos, photo_memory), (gaussians, frozen), room).map(drop)
    }
}

/// Kernels of a run, and its memory per Gaussian.
pub(super) struct Kit {
    pub strategy: Box<dyn Strategy>,
    pub recorder: StepRecorder,
    pub rows: RowMemory,
}

impl Kit {
    pub fn new(
        context: &Context,
        (settings, scene_extent): (&TrainSettings, f32),
        parts: TrainParts,
        photos: &[PhotoSize],
    ) -> Result<Self> {
        let TrainParts { mut strategy, terms, block: _ } = parts;
        average::check(settings, &*strategy)?;
        let any_masked = photos.iter().any(|photo| photo.masked);
        let mut all: Vec<Box<dyn LossTerm>> =
            vec![Box::new(Photometric::new(context, any_masked, settings.lambda_dssim as f32)?)];
        if photos.iter().any(|photo| photo.inverse_depth) {
            all.push(Box::new(InverseDepth::new(context, settings)?));
        }
        if settings.depth_points > 0.0 {
            let most = photos.iter().map(|photo| photo.depth_points).max().unwrap_or(0);
            if most == 0 {
                let problem =
                    "needs sparse points that the views are known to show, and there are none: leave it at 0";
                return Err(Error::argument("depth_points", problem));
            }
            all.push(Box::new(SparseDepth::new(context, settings, scene_extent, most)?));
        }
        all.extend(terms);
        all.extend(strategy.loss_terms(context, settings)?);
        check_depths(&all)?;
        check_warm_up(settings, &all)?;
        let parameter_gradients = StepRecorder::targets_of(&all).parameters;
        let rows = RowMemory::new(strategy.statistics(), parameter_gradients, context.planes_memory());
        let recorder = StepRecorder::new(context, all, (settings, strategy.records().sums), rows.absolute())?;
        Ok(Self { strategy, recorder, rows })
    }

    /// Initial capacity in Gaussians, for `count` trained ones among `around` frozen ones. Also returns the capacities of an
    /// earlier run if they fit.
    ///
    /// # Errors
    /// [`Error::TooLarge`](crate::Error::TooLarge), before anything is allocated.
    pub fn capacity<'a>(
        &self,
        context: &Context,
        settings: &TrainSettings,
        (photos, photo_memory): (&[PhotoSize], Option<u64>),
        (count, around): (u32, u32),
        room: Option<&'a Room>,
    ) -> Result<(u32, Option<&'a Room>)> {
        let photo_bytes = photos::device_bytes(context, photos, photo_memory);
        let (photo_bytes, refused) = match photo_bytes {
            Ok(bytes) => (bytes, None),
            Err(Error::TooLarge { needed, .. }) => {
                (PhotoBytes::reading_ahead(context, photos, (needed, photo_memory)), photo_bytes.err())
            }
            Err(error) => return Err(error),
        };
        let before = Before {
            photos,
            photo_bytes,
            rows: &self.rows,
            loss: &|sizes| {
                let mut requests = self.recorder.device_requests(sizes);
                if settings.filter_3d {
                    requests.extend(Filter3d::requests(sizes.len()));
                }
                requests
            },
            losses: self.recorder.readback_request(),
            poses: poses::requests(settings, photos.len()),
            count,
            around,
            sh_degree: settings.sh_degree,
        };
        before.check_photos(context)?;
        if let Some(error) = refused {
            // If the whole training does not fit, that error matters more than the photographs'.
            before.initial_capacity(context)?;
            return Err(error);
        }
        match room.filter(|room| before.has_room(context, room)) {
            Some(room) => Ok((room.gaussians, Some(room))),
            None => Ok((before.initial_capacity(context)?, None)),
        }
    }
}

/// Refuses terms that need different kinds of depth in a frame.
fn check_depths(terms: &[Box<dyn LossTerm>]) -> Result<()> {
    let depths = terms.iter().filter(|term| term.targets().inverse_depth);
    let names: Vec<&str> = depths.map(|term| term.name()).collect();
    let linear = terms.iter().any(|term| term.targets().linear_depth);
    if !linear || names.len() < 2 {
        return Ok(());
    }
    let problem = format!(
        "does not go together with other depths ({}): take the sparse points or the maps (-d)",
        names.join(", ")
    );
    Err(Error::argument("depth_points", problem))
}

/// Refuses a warm-up with depth terms, because their depths belong to the photographs' full-size pixels.
fn check_warm_up(settings: &TrainSettings, terms: &[Box<dyn LossTerm>]) -> Result<()> {
    match terms.iter().find(|term| term.targets().inverse_depth) {
        Some(term) => settings.refuse_warm_up_with(&format!("depths ({})", term.name())),
        None => Ok(()),
    }
}

/// Sizes of the views' photographs, in the views' order.
pub(super) fn sizes_of(views: &[TrainView], settings: &TrainSettings) -> Vec<PhotoSize> {
    let points = |view: &TrainView| match settings.depth_points > 0.0 {
        true => view.depth_points.as_ref().map_or(0, |points| points.len() as u32),
        false => 0,
    };
    let size = |(index, view): (usize, &TrainView)| PhotoSize {
        name: format!("view {index}"),
        width: view.photo.width,
        height: view.photo.height,
        masked: view.photo.is_masked(),
        inverse_depth: view.inverse_depth.is_some(),
        depth_points: points(view),
    };
    views.iter().enumerate().map(size).collect()
}
