//! Memory of a training run, computed before anything is allocated.

use super::checkpoint::Room;
use super::model::{RowBytes, RowMemory};
use super::needs::Needs;
use super::photos::{self, PhotoBytes, PhotoSize};
use super::settings::TrainSettings;
use super::step_recorder::StepRecorder;
use super::strategy::Strategy;
use super::{InverseDepth, SparseDepth, TrainParts, TrainView, poses, step_recorder, surroundings};
use crate::error::{Error, Result};
use crate::forward::Filter3d;
use crate::loss::{LossTerm, Photometric};
use crate::plan::{
    FrameCapacity, LaunchSizes, PictureCapacity, ScenePlan, check_grids, frame_bytes, frame_fits_device,
    frame_requests, gaussians_with, initial_instances, initial_visible, max_trained_among,
    max_trained_gaussians, max_trained_instances,
};
use crate::planes;
use crate::renderer::FrameStore;
use crate::vk::Context;
use std::collections::HashMap;

/// Name and bytes of a buffer.
type Request = (&'static str, u64);
type Requests = Vec<Request>;
/// Width and height, pixels.
type Size = (u32, u32);
type LossRequests<'a> = dyn Fn(&[Size]) -> Requests + 'a;

/// Sizes of a training run before its allocation.
pub(super) struct Before<'a> {
    /// One per view.
    pub photos: &'a [PhotoSize],
    pub photo_bytes: PhotoBytes,
    pub rows: &'a RowMemory,
    /// Device buffers of the loss, for views of the given sizes.
    pub loss: &'a LossRequests<'a>,
    /// Host-readable copy of the losses.
    pub losses: Request,
    /// Buffers of the poses; empty unless they are optimised.
    pub poses: Requests,
    /// Initial number of trained Gaussians.
    pub count: u32,
    /// Number of frozen Gaussians around them.
    pub around: u32,
    pub sh_degree: u32,
}

impl Before<'_> {
    /// Bytes of all buffers, except those of the photographs, once the first iteration has fitted.
    fn buffer_bytes(&self, context: &Context, plan: &ScenePlan, frame: Option<FrameCapacity>) -> RowBytes {
        let limits = context.limits();
        let bytes = |requests: &[(&'static str, u64)]| context.allocation_bytes(requests);
        let scratch = (self.loss)(&self.sizes());
        // Counts of training frames and of drawn frames.
        let readback = 2 * bytes(&FrameStore::READBACK) + bytes(&[self.losses]);
        let frame = frame.map_or(0, |frame| bytes(&frame_requests(&frame, &LaunchSizes::new(limits))));
        let poses = if self.poses.is_empty() { 0 } else { bytes(&self.poses) };
        let around = self.rows.of_planes(self.around_bytes(context, plan));
        let others = RowBytes { device: bytes(&scratch) + readback + frame + poses, offloaded: 0 };
        self.rows.allocation_bytes(context, plan) + around + others
    }

    /// Bytes of the planes of the frozen Gaussians, with this plan's SH degree.
    fn around_bytes(&self, context: &Context, of: &ScenePlan) -> u64 {
        match ScenePlan::new(context.limits(), self.around, of.sh_degree) {
            Ok(plan) if self.around > 0 => context.allocation_bytes(&planes::requests(&plan)),
            _ => 0,
        }
    }

    fn sizes(&self) -> Vec<(u32, u32)> {
        self.photos.iter().map(|photo| (photo.width, photo.height)).collect()
    }

    /// Large enough for all views.
    fn pictures(&self) -> PictureCapacity {
        let each = self.photos.iter().map(|photo| PictureCapacity::of(photo.width, photo.height));
        each.fold(PictureCapacity::NONE, PictureCapacity::and)
    }

    /// Number of all initial Gaussians, trained and frozen.
    fn whole(&self) -> u32 {
        gaussians_with(self.count, self.around)
    }

    /// A frame of these pictures for `capacity` trained Gaussians, of which up to `visible` are visible.
    fn frame(
        &self,
        context: &Context,
        [capacity, visible]: [u32; 2],
        pictures: PictureCapacity,
    ) -> FrameCapacity {
        let gaussians = gaussians_with(capacity, self.around);
        let visible = visible.min(gaussians);
        FrameCapacity {
            gaussians,
            visible,
            instances: initial_instances(context.limits(), visible, &pictures),
            scenes: self.scenes(),
            pictures,
            blend_passes: 1,
            backward: true,
            absolute: self.rows.absolute().is_some(),
        }
    }

    /// Number of scenes in a frame.
    fn scenes(&self) -> u32 {
        1 + u32::from(self.around > 0)
    }

    /// Refuses photographs whose frames exceed a limit of the device, whatever the memory.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for the photograph with the largest need, with the size of its largest buffer.
    pub fn check_photos(&self, context: &Context) -> Result<()> {
        // The first photograph of each size, and the number of photographs with that size.
        let mut sizes: HashMap<Size, (&PhotoSize, usize)> = HashMap::new();
        for photo in self.photos {
            sizes.entry((photo.width, photo.height)).or_insert((photo, 0)).1 += 1;
        }
        let refused = sizes
            .into_iter()
            .filter_map(|(size, (photo, count))| Some((photo, self.check_size(context, size).err()?, count)));
        let refused: Vec<_> = refused.collect();
        let all: usize = refused.iter().map(|(.., count)| count).sum();
        let area = |photo: &PhotoSize| u64::from(photo.width) * u64::from(photo.height);
        let most = refused.into_iter().max_by_key(|(photo, ..)| (area(photo), photo.width));
        match most {
            None => Ok(()),
            Some((photo, Error::TooLarge { what, needed, unit, limit, limit_name }, _)) => {
                let others = match all - 1 {
                    0 => String::new(),
                    1 => " and 1 other".into(),
                    more => format!(" and {more} others"),
                };
                let what = format!(
                    "training on the photograph '{}' of {}x{} pixels{others} (-r scales photographs down): {what}",
                    photo.name, photo.width, photo.height
                );
                Err(Error::TooLarge { what, needed, unit, limit, limit_name })
            }
            Some((_, error, _)) => Err(error),
        }
    }

    /// Checks that the device supports the buffers and grids of a frame of this size.
    fn check_size(&self, context: &Context, size: (u32, u32)) -> Result<()> {
        let limits = context.limits();
        let count = self.count.min(max_trained_among(limits, self.around));
        let visible = initial_visible(gaussians_with(count, self.around));
        let frame = self.frame(context, [count, visible], PictureCapacity::of(size.0, size.1));
        let launches = LaunchSizes::new(limits);
        let named = |arena: &'static str, requests: Requests| {
            requests.into_iter().map(move |(name, bytes)| (arena, name, bytes))
        };
        let requests =
            named("frame", frame_requests(&frame, &launches)).chain(named("loss", (self.loss)(&[size])));
        let most = [
            (limits.max_storage_buffer_range, "maxStorageBufferRange"),
            (limits.max_allocation_bytes, "maxMemoryAllocationSize"),
        ];
        let (limit, limit_name) = if most[1].0 < most[0].0 { most[1] } else { most[0] };
        match requests.max_by_key(|(.., bytes)| *bytes) {
            Some((arena, name, needed)) if needed > limit => Err(Error::TooLarge {
                what: format!("buffer {arena}.{name}"),
                needed,
                unit: "bytes",
                limit,
                limit_name,
            }),
            _ => check_grids(limits, &frame, &launches),
        }
    }

    /// Initial capacity in Gaussians: half more than the initial ones, or just those if memory is short.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if even the initial Gaussians do not fit, with bytes that suffice if pictures show all of them.
    pub fn initial_capacity(&self, context: &Context) -> Result<u32> {
        let Self { photos: all, ref photo_bytes, count, sh_degree, .. } = *self;
        let most = max_trained_among(context.limits(), self.around);
        if count > most {
            return Err(Error::TooLarge {
                what: "the gradients of the scene".into(),
                needed: u64::from(count) + u64::from(self.around),
                unit: "Gaussians",
                limit: max_trained_gaussians(context.limits()).into(),
                limit_name: "what maxStorageBufferRange holds",
            });
        }
        // The reserve delays the first reallocation by densification.
        let wanted = count.saturating_add(count / 2).max(1 << 12).min(most);
        let (limit, limit_name) = context.memory_limit().unwrap_or((u64::MAX, "no limit"));
        let held = context.held_bytes();
        let free = limit.saturating_sub(held);
        let buffers = |capacity: u32, visible: u32| -> Result<RowBytes> {
            let plan = ScenePlan::new(context.limits(), capacity, sh_degree)?;
            let frame = self.frame(context, [capacity, visible], self.pictures());
            Ok(self.buffer_bytes(context, &plan, Some(frame)))
        };
        let photos = photo_bytes.held + photo_bytes.staging;
        let fits = |of: &RowBytes| of.device + photos <= free && of.is_offloadable(context);
        // A frame starts with a capacity for part of the Gaussians. The reserve must leave memory for a frame of all of them.
        let whole = self.whole();
        if fits(&buffers(wanted, whole)?) {
            return Ok(wanted);
        }
        let least = buffers(count, whole)?;
        // If a frame of all does not fit, pictures may still show fewer.
        if fits(&least) || fits(&buffers(count, initial_visible(whole))?) {
            return Ok(count);
        }
        if !least.is_offloadable(context) {
            return Err(Error::TooLarge {
                what: format!("training {count} Gaussians of SH degree {sh_degree} in the host's memory"),
                needed: least.offloaded,
                unit: "bytes",
                limit: context.offload().unwrap_or(0).saturating_sub(context.memory_offloaded().bytes),
                limit_name: "--offload",
            });
        }
        let least = least.device;
        // A photograph budget of half the limit follows the total: all photographs, or half of the requested bytes.
        let follow = photo_bytes.budget == Some(limit / 2);
        let with_more = if follow { photo_bytes.all.min(least) + photo_bytes.staging } else { photos };
        let largest = all.iter().max_by_key(|photo| u64::from(photo.width) * u64::from(photo.height));
        let largest = largest.map_or_else(String::new, |photo| {
            format!(", the largest '{}' of {}x{} pixels", photo.name, photo.width, photo.height)
        });
        let among = match self.around {
            0 => String::new(),
            around => format!(" among {around} others"),
        };
        let what = format!(
            "training {count} Gaussians{among} of SH degree {sh_degree} on {} photographs{largest} (fewer or smaller ones (-r) \
             need less, or --photo-memory)",
            all.len()
        );
        Err(Error::TooLarge {
            what,
            // Includes the bytes already held, so that a limit of this value suffices.
            needed: held + least + with_more.max(photos),
            unit: "bytes",
            limit,
            limit_name,
        })
    }

    /// True if the capacities of an earlier run hold the Gaussians and fit here.
    pub fn has_room(&self, context: &Context, room: &Room) -> bool {
        let limits = context.limits();
        let Ok(plan) = ScenePlan::new(limits, room.gaussians, self.sh_degree) else { return false };
        let sizes = LaunchSizes::new(limits);
        let frame = room.frame((self.pictures(), self.scenes()), self.rows.absolute().is_some());
        // No tile has more entries than the frame has instances.
        let passes = |frame: &FrameCapacity| frame.instances.div_ceil(sizes.entries_per_pass).max(1);
        let fits = frame.is_none_or(|frame| {
            frame.blend_passes <= passes(&frame) && frame_fits_device(limits, &frame, &sizes)
        });
        if !fits || !(self.count..=max_trained_among(limits, self.around)).contains(&room.gaussians) {
            return false;
        }
        let buffers = self.buffer_bytes(context, &plan, frame);
        let needed = buffers.device + self.photo_bytes.held;
        let free = |(limit, _): (u64, _)| limit.saturating_sub(context.held_bytes());
        buffers.is_offloadable(context) && context.memory_limit().is_none_or(|limit| needed <= free(limit))
    }
}

/// New capacity when `rows` do not fit: half more, up to the most that can be trained beside `around` frozen Gaussians.
pub(super) fn grown_capacity(context: &Context, rows: u32, around: u32) -> u32 {
    let most = max_trained_among(context.limits(), around);
    rows.saturating_add(rows / 2).min(most.max(rows))
}

/// Current sizes of a training run.
pub(super) struct Present<'a> {
    pub context: &'a Context,
    pub rows: &'a RowMemory,
    pub plan: &'a ScenePlan,
    pub frame: FrameCapacity,
    /// Current bytes of the frame buffers.
    pub frame_bytes: u64,
    /// Number of frozen Gaussians.
    pub around: u32,
}

impl Present<'_> {
    /// True if planes for `plan` and a frame of its capacity fit beside the current planes. Once those are freed, a frame with
    /// proportionally more visible Gaussians and instances must fit too.
    pub fn has_room(&self, plan: &ScenePlan) -> bool {
        let Self { context, rows, plan: old, frame, frame_bytes: old_frame, around } = self;
        let limits = context.limits();
        if plan.capacity > max_trained_among(limits, *around) {
            return false;
        }
        let (new, present) = (rows.bytes(plan), rows.bytes(old));
        if !new.is_offloadable(context) {
            return false;
        }
        let Some((limit, _)) = context.memory_limit() else { return true };
        let sizes = LaunchSizes::new(limits);
        let of = |plan: &ScenePlan| gaussians_with(plan.capacity, *around);
        let grown = FrameCapacity { gaussians: of(plan), ..*frame };
        // The visible Gaussians and instances grow with the number of Gaussians.
        let grow = |n: u32, most: u32| {
            let grown = u64::from(n) * u64::from(of(plan)) / u64::from(of(old).max(1));
            grown.min(most.into()) as u32
        };
        let full = FrameCapacity {
            visible: grow(frame.visible, of(plan)),
            instances: grow(frame.instances, max_trained_instances(limits)),
            ..grown
        };
        let beside = (context.held_bytes() + new.device).saturating_sub(*old_frame);
        let during = beside + frame_bytes(&grown, &sizes);
        let after = (beside + frame_bytes(&full, &sizes)).saturating_sub(present.device);
        during.max(after) <= limit
    }

    /// Largest number of rows, up to `rows`, that fits; at least the current capacity.
    pub fn most_with_room(&self, rows: u32) -> Result<u32> {
        let (mut fits, mut beyond) = (self.plan.capacity, rows);
        while beyond.saturating_sub(fits) > (self.plan.capacity / 64).max(1) {
            let middle = fits + (beyond - fits) / 2;
            let plan = ScenePlan::new(self.context.limits(), middle, self.plan.sh_degree)?;
            if self.has_room(&plan) { fits = middle } else { beyond = middle }
        }
        Ok(fits)
    }

    /// Maximum number of rows after a densification of `before` Gaussians. Later frames should stay within three quarters of
    /// the device's instance limit, because views differ. No row is added if memory cannot hold a frame with the peak counts so
    /// far.
    pub fn most_rows_by_frames(&self, before: u32, most: Needs) -> u32 {
        if !self.holds(most) {
            return before;
        }
        let instances = u64::from(max_trained_instances(self.context.limits())) * 3 / 4;
        let around = u64::from(self.around);
        let all = (u64::from(before) + around) * instances / u64::from(most.instances.max(1));
        all.saturating_sub(around).clamp(before.into(), u32::MAX.into()) as u32
    }

    /// True if memory holds a frame with these peak counts.
    fn holds(&self, most: Needs) -> bool {
        let Some((limit, _)) = self.context.memory_limit() else { return true };
        let visible = most.visible.min(self.frame.gaussians).max(self.frame.visible);
        let full =
            FrameCapacity { visible, instances: most.instances.max(self.frame.instances), ..self.frame };
        let beside = self.context.held_bytes().saturating_sub(self.frame_bytes);
        full == self.frame || beside + frame_bytes(&full, &LaunchSizes::new(self.context.limits())) <= limit
    }
}

// Checks that a training fits the device and the memory before its photographs are read.

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
        step_recorder::check(settings, &*strategy)?;
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
