//! Records frames into a host's command buffer; never submits, waits, allocates, maps or reads back.
//!
//! A recording may have several views: the eyes of a headset, a split screen, a picture in a picture. They run one after the other
//! in the memory of one frame, separated by one barrier.

use super::check::{check_capacity, check_views, in_view};
use super::forward::Forward;
use super::recorded_frame::{HostImage, RecordedFrame, Release};
use super::recording_lists::{RecordingLists, ViewLists};
use super::renderer::Renderer;
use super::reservation::{Reservation, SlotReport};
use super::slots::SlotMemory;
use crate::error::{Error, Result};
use crate::frame::{FrameInputs, FrameVariant, RenderSettings, form_batches};
use crate::passes::compose::Compose;
use crate::vk::{ForeignCommands, Recorder};
use ash::vk;
use std::ops::Range;
use std::slice;

impl Renderer {
    /// Records a frame into a host's command buffer.
    ///
    /// It only records: it neither submits nor waits, allocates or maps device memory, or reads anything back. Everything
    /// is checked before the first command is recorded. The slot is then in flight until the device has executed the
    /// recording. It may be recorded again once the whole command buffer has finished, as
    /// [`Context::adopt_commands`](crate::vk::Context::adopt_commands) requires. The slot keeps scenes and image views
    /// alive that are dropped meanwhile. [`Renderer::release_slot`] or the next recording destroys them.
    ///
    /// Updates are applied in order: where two overlap, the later one wins.
    ///
    /// Before its first command the recording waits for earlier compute and transfer commands in the queue,
    /// and for the previous uses in [`HostImage::from`](super::HostImage::from).
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) for:
    /// - a slot that is not reserved or still in flight;
    /// - commands, scenes or images of another context;
    /// - an invalid camera or pose, or numbers that are not finite;
    /// - images with a wrong format, usage, size or layout;
    /// - kernels that [`Renderer::reserve`] has not built.
    ///
    /// [`Error::TooLarge`](crate::Error::TooLarge) for a frame that exceeds the reservation.
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) after a loss that the context has noticed.
    pub fn record(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        frame: &RecordedFrame<'_>,
    ) -> Result<Release> {
        let mut release = Release::default();
        self.record_views(commands, slot, slice::from_ref(frame), slice::from_mut(&mut release))?;
        Ok(release)
    }

    /// Records several frames, one after the other, in one slot: views of the same moment, each with its own camera,
    /// scenes, settings and images. Same bits as [`Renderer::record`] for each, but with one recording's barriers,
    /// timestamps and event, and one slot's memory and report. `releases` has an element for each view, which is
    /// overwritten.
    ///
    /// Each view's pixels go into an image: a layer of an array ([`ForeignImage::layer`](crate::vk::ForeignImage::layer)),
    /// or a rectangle of a shared image ([`HostImage::offset`](super::HostImage::offset)). Texels outside a rectangle do
    /// not change. Several views may use an image; they write it in order, which matters if rectangles overlap.
    /// [`HostImage::from`](super::HostImage::from) is the host's use before the recording; only the first view's value
    /// counts.
    ///
    /// The first view holds the [`RecordedFrame::updates`], and all views see them.
    ///
    /// With [`Reservation::shared_sort`](super::Reservation::shared_sort), consecutive views are culled and sorted once if:
    ///
    /// - They have the same slice of scenes and equal settings. Targets may differ.
    /// - Their cameras are all pinholes without [`distance_order`](crate::RenderSettings::distance_order), or all orthographic.
    /// - Their depths are bit-identical: the third row of `camera_from_world` and `translation.z`, under each scene's pose.
    ///
    /// So create the second eye from the first by [`Camera::moved_aside`](crate::Camera::moved_aside). View matrices that
    /// are multiplied separately for each eye differ in their last bits. Other views sort alone.
    ///
    /// # Errors
    /// Same as [`Renderer::record`], with `views[i]` before the field. Also [`Error::Argument`] for:
    /// - no views, or more than [`Reservation::views`](super::Reservation::views);
    /// - another number of releases;
    /// - several views without images;
    /// - updates in another view than the first;
    /// - an image that one view samples and another one writes.
    pub fn record_views(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        views: &[RecordedFrame<'_>],
        releases: &mut [Release],
    ) -> Result<()> {
        let mut lists = std::mem::take(&mut self.lists).emptied();
        let recorded = self.record_checked(commands, slot, views, releases, &mut lists);
        self.lists = lists.emptied();
        recorded
    }

    /// Same as [`Self::record_views`], with empty lists.
    fn record_checked<'a>(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        views: &[RecordedFrame<'a>],
        releases: &mut [Release],
        lists: &mut RecordingLists<'a>,
    ) -> Result<()> {
        self.context.check_alive()?;
        let Some(reserved) = self.slots.reserved else {
            return Err(Error::argument("slot", "none is reserved: call Renderer::reserve"));
        };
        if !commands.belongs_to(&self.context) {
            return Err(Error::argument("commands", "it belongs to another context"));
        }
        check_views(views, releases.len(), &reserved)?;
        let mut gaussians = 0;
        for (index, frame) in views.iter().enumerate() {
            let checked = self.check_frame(frame, &views[..index], &reserved, &mut lists.scenes);
            gaussians = checked.map_err(|error| in_view(error, index, views))?.max(gaussians);
        }
        let forward = &self.runner.forward;
        let slot = self.slots.get(slot)?;
        slot.recording.check_free()?;
        for (index, frame) in views.iter().enumerate() {
            let first = lists.views.last().map_or(0, |view| view.scenes.end);
            let scenes = first..first + frame.scenes.len();
            let own = &mut lists.scenes[scenes.clone()];
            let checked = check_capacity(frame, own, &slot.upcoming().capacity, &reserved);
            checked.map_err(|error| in_view(error, index, views))?;
            // Motion and surfaces need a dispatch per scene, so their scenes are not batched.
            let single = frame.motion.is_some() || frame.surface.is_some();
            let (first, has_batches) = (lists.batches.len(), reserved.has_batches() && !single);
            let draw_all =
                has_batches && form_batches(forward.sizes.elementwise_workgroup, own, &mut lists.batches);
            lists.views.push(ViewLists { scenes, batches: first..lists.batches.len(), draw_all });
        }
        let Some(compose) = &self.compose else { unreachable!("built by reserve") };
        slot.take_over();
        self.staged.stage(slot.memory.staging.as_ref(), views[0].updates)?;
        // At most the capacity, so the cast is exact.
        let mut recorder = slot.begin(commands, gaussians as u32, views.len() as u32)?;
        let (r, memory) = (&mut recorder, &slot.memory);
        self.staged.record(r);
        let recording = Recording { forward, compose, memory, views, lists };
        let (mut sorts, mut sharing) = (0, 0..0);
        for index in 0..views.len() {
            if index > 0 {
                r.barrier();
            }
            if !sharing.contains(&index) {
                let shared = if reserved.shared_sort { lists.with_one_order(views, index) } else { 1 };
                (sharing, sorts) = (index..index + shared, sorts + 1);
            }
            releases[index] = recording.record(r, index, &sharing, &releases[..index]);
            slot.record_counts(r, index as u32);
        }
        release_images(r, views, releases);
        slot.host_report.sorts = sorts;
        slot.host_report.batched_scenes = lists.batches.iter().map(|batch| batch.scenes).sum();
        slot.recording.end(recorder)
    }
}

/// Resources that the views of a recording share.
struct Recording<'a> {
    forward: &'a Forward,
    compose: &'a Compose,
    memory: &'a SlotMemory,
    views: &'a [RecordedFrame<'a>],
    lists: &'a RecordingLists<'a>,
}

impl Recording<'_> {
    /// Records a view, including its images. `sharing`: the views that share its order. `releases`: those of earlier views. Ends
    /// without a barrier.
    fn record(
        &self,
        r: &mut Recorder,
        index: usize,
        sharing: &Range<usize>,
        releases: &[Release],
    ) -> Release {
        let Self { forward, compose, memory, views, lists } = *self;
        let frame = &views[index];
        // The barrier between two views orders all kernels, so an image of an earlier view is ready.
        let acquire = |r: &mut Recorder, host: &HostImage<'_>| {
            let mut earlier = views.iter().zip(releases.iter().copied()).rev();
            let used =
                earlier.find_map(|(frame, mut release)| *release.last_use(frame.purpose_of(host.image)?));
            used.unwrap_or_else(|| r.acquire_image(host.image, host.from))
        };
        let size = [frame.camera.width, frame.camera.height];
        let mut release = Release {
            stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
            accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
            ..Release::default()
        };
        let depth_limits = frame.occluder.as_ref().and(memory.depth_limits.as_ref());
        if let (Some(occluder), Some(limits)) = (&frame.occluder, depth_limits) {
            release.occluder = Some(acquire(r, &occluder.depth));
            let region = occluder.depth.region(size);
            r.scope("depth limits", |r| compose.record_depth_limits(r, region, occluder.mapping, limits));
        }
        let FrameVariant { inverse_depth, expected_depth, outputs, .. } = frame.variant();
        let surface = frame.surface.map(|target| target.depth);
        let settings = RenderSettings { inverse_depth, linear_depth: false, surface, ..*frame.settings };
        let inputs_of = |number: u32| {
            let view = sharing.start + number as usize;
            FrameInputs {
                batches: lists.batches_of(view),
                depth_limits,
                expected_depth,
                outputs,
                view: (sharing.len() > 1).then_some(number),
                ..memory.inputs(lists.scenes_of(view), &settings)
            }
        };
        let number = (index - sharing.start) as u32;
        let inputs = inputs_of(number);
        match number {
            0 => forward.record_first(r, sharing.len() as u32, inputs_of),
            _ => forward.record_next(r, &inputs),
        }
        r.barrier();
        r.scope("compose", |r| {
            for (host, contents) in frame.written() {
                *release.last_use(contents.purpose()) = Some(acquire(r, &host));
                compose.record(r, &inputs, host.region(size), contents);
            }
        });
        release
    }
}

/// Releases images to the queue families that own them, each after its last use.
fn release_images(r: &mut Recorder, frames: &[RecordedFrame<'_>], releases: &mut [Release]) {
    for (index, (frame, release)) in frames.iter().zip(releases).enumerate() {
        for (purpose, host) in frame.images() {
            let Some(used) = release.last_use(purpose) else { continue };
            if frames[..index].iter().all(|earlier| earlier.purpose_of(host.image).is_none()) {
                r.release_image(host.image, *used);
            }
            *used = host.image.left(*used);
        }
    }
}

impl Renderer {
    /// Same as [`Renderer::reserve`], but large enough for this frame. Without [`instances`](Reservation::instances) a
    /// reservation is an estimate, and a first frame that needs more lacks its farthest Gaussians. Counts the needs of the
    /// frame, without its targets, occluder and updates. If scenes are shown, hidden or cut at different times, give the
    /// frame that shows most. Submits to the context's queue, and waits. Returns the reservation.
    ///
    /// # Errors
    /// Errors of [`Renderer::reserve`] and [`Renderer::record`]; [`Error::Argument`] for a host's device without a queue.
    pub fn reserve_for(&mut self, request: &Reservation, frame: &RecordedFrame<'_>) -> Result<Reservation> {
        let mut reserved = *request;
        self.reserve(&reserved)?;
        loop {
            let report = self.count(frame, &reserved)?;
            let grown = reserved.grown(&report);
            if grown == reserved {
                return Ok(reserved);
            }
            // The reserve of half may be what does not fit.
            let exact = Reservation { instances: grown.instances.min(report.instances_needed), ..grown };
            reserved = match self.reserve(&grown) {
                Err(Error::TooLarge { .. } | Error::Vulkan { .. }) if exact != grown => {
                    self.reserve(&exact)?;
                    exact
                }
                done => done.map(|()| grown)?,
            };
        }
    }

    /// Runs a frame, up to its counts, in the first slot, which must be free.
    fn count(&mut self, frame: &RecordedFrame<'_>, reserved: &Reservation) -> Result<SlotReport> {
        let mut placed = Vec::new();
        self.check_frame(frame, &[], reserved, &mut placed)?;
        let forward = &self.runner.forward;
        let slot = self.slots.get(0)?;
        check_capacity(frame, &placed, &slot.upcoming().capacity, reserved)?;
        let settings = RenderSettings { inverse_depth: false, ..*frame.settings };
        let inputs = slot.memory.inputs(&placed, &settings);
        self.context.run("count", |r| {
            forward.record(r, &inputs);
            r.barrier();
            slot.record_counts(r, 0);
        })?;
        slot.counts(&forward.sizes, 1)
    }
}
