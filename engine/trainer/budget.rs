//! Memory of a training run, computed before anything is allocated.

use super::checkpoint::Room;
use super::model::{RowBytes, RowMemory};
use super::needs::Needs;
use super::photos::{PhotoBytes, PhotoSize};
use crate::error::{Error, Result};
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
