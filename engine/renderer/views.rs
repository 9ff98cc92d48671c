//! Frames of several views in one recording: the eyes of a headset, a split screen, a picture in a picture.
//!
//! Views run one after the other in the memory of one frame, separated by one barrier.

use super::Renderer;
use super::check::{check_capacity, check_views, in_view};
use super::record::{Earlier, RecordedFrame, Release, inputs_of, record_targets, release_images};
use super::slots::{Reservation, SlotMemory, SlotReport};
use crate::compose::Compose;
use crate::error::{Error, Result};
use crate::forward::{Forward, FrameInputs, PlacedScene, RenderSettings};
use crate::scene::Camera;
use crate::vk::{ForeignCommands, Recorder};

impl Renderer {
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
    /// - Their cameras are all pinholes or all orthographic.
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
        self.record_frames(commands, slot, (views, releases))
    }

    /// Records one view or several.
    pub(super) fn record_frames(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        views: (&[RecordedFrame<'_>], &mut [Release]),
    ) -> Result<()> {
        let mut placed = emptied(std::mem::take(&mut self.placed));
        let recorded = self.record_placed(commands, slot, views, &mut placed);
        self.placed = emptied(placed);
        recorded
    }

    /// Same as [`Self::record_frames`], with an empty list for the scenes of all views.
    fn record_placed<'a>(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        (views, releases): (&[RecordedFrame<'a>], &mut [Release]),
        placed: &mut Vec<PlacedScene<'a>>,
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
            let checked = self.check_frame((frame, &views[..index]), &reserved, placed);
            gaussians = checked.map_err(|error| in_view(error, index, views))?.max(gaussians);
        }
        let forward = &self.runner.forward;
        let slot = self.slots.get(slot)?;
        slot.record.check_free()?;
        let (mut rest, mut batched_scenes) = (placed.as_mut_slice(), 0);
        for (index, frame) in views.iter().enumerate() {
            let own = rest.split_off_mut(..frame.scenes.len()).unwrap_or_default();
            let checked = check_capacity((frame, own), &slot.upcoming().capacity, &reserved);
            checked.map_err(|error| in_view(error, index, views))?;
            // Motion needs a dispatch per scene, so its scenes are not batched.
            if reserved.has_batches() && frame.motion.is_none() {
                batched_scenes += forward.form_batches(own);
            }
        }
        let Some(compose) = &self.compose else { unreachable!("built by reserve") };
        slot.take_over();
        self.staged.stage(slot.memory.staging.as_ref(), views[0].updates)?;
        // At most the capacity, so the cast is exact.
        let mut recorder = slot.begin(commands, (gaussians as u32, views.len() as u32))?;
        let (r, memory) = (&mut recorder, &slot.memory);
        self.staged.record(r);
        let recording = Recording { forward, compose, memory };
        let (mut rest, mut sorts, mut first_of_order) = (placed.as_slice(), 0, 0..0);
        for (index, frame) in views.iter().enumerate() {
            if index > 0 {
                r.barrier();
            }
            if !first_of_order.contains(&index) {
                let own = &views[index..];
                let shared = if reserved.shared_sort { with_one_order(own, rest) } else { 1 };
                (first_of_order, sorts) = (index..index + shared, sorts + 1);
            }
            let order =
                Order { views: first_of_order.len() as u32, number: (index - first_of_order.start) as u32 };
            let earlier = Earlier { frames: &views[..index], releases: &releases[..index] };
            let release = recording.record(r, (frame, rest), (order, earlier));
            slot.record_counts(r, index as u32);
            releases[index] = release;
            rest = &rest[frame.scenes.len()..];
        }
        release_images(r, views, releases);
        (slot.sorts, slot.batched_scenes) = (sorts, batched_scenes);
        slot.end(recorder)
    }
}

/// Returns how many views, from the first on, can share one order. They have its scenes, its settings, and bit-identical
/// depths. `placed`: scenes of all views.
fn with_one_order(views: &[RecordedFrame<'_>], placed: &[PlacedScene<'_>]) -> usize {
    let Some((first, others)) = views.split_first() else { return 0 };
    let scenes = first.scenes.len();
    let has_order = |(frame, own): &(&RecordedFrame<'_>, &[PlacedScene<'_>])| {
        std::ptr::eq(frame.scenes, first.scenes)
            && frame.settings == first.settings
            && frame.camera.is_orthographic() == first.camera.is_orthographic()
            && own.iter().zip(placed).all(|(own, first)| depth_bits(own) == depth_bits(first))
    };
    // Views before the first that differs have as many scenes.
    let own = placed.chunks(scenes).skip(1);
    1 + others.iter().zip(own).take_while(has_order).count()
}

/// Returns the bits that determine the depth of a scene's Gaussians, beside the scene and its scale.
fn depth_bits(placed: &PlacedScene<'_>) -> [u32; 4] {
    let Camera { camera_from_world, translation, .. } = placed.camera;
    let row = camera_from_world.row(2);
    [row.x, row.y, row.z, translation.z].map(f32::to_bits)
}

/// Position of a view among views that share an order.
#[derive(Clone, Copy)]
struct Order {
    views: u32,
    number: u32,
}

/// Resources that the views of a recording share.
struct Recording<'a> {
    forward: &'a Forward,
    compose: &'a Compose,
    memory: &'a SlotMemory,
}

impl Recording<'_> {
    /// Records a frame, including its images. `placed` begins with its scenes, followed by those of the views with its
    /// order. Ends without a barrier.
    fn record(
        &self,
        r: &mut Recorder,
        (frame, placed): (&RecordedFrame<'_>, &[PlacedScene<'_>]),
        (order, earlier): (Order, Earlier<'_>),
    ) -> Release {
        let Self { forward, compose, memory } = *self;
        let settings = RenderSettings {
            inverse_depth: frame.settings.inverse_depth || frame.depth.is_some(),
            ..*frame.settings
        };
        let size = [frame.camera.width, frame.camera.height];
        let mut occluder = None;
        if let (Some(o), Some(limits)) = (&frame.occluder, &memory.depth_limits) {
            occluder = Some(earlier.acquire(r, &o.depth));
            r.scope("depth limits", |r| {
                compose.record_depth_limits(r, o.depth.region(), o.mapping, size, limits);
            });
        }
        let scenes = frame.scenes.len();
        let view = |number: u32| {
            let own = &placed[(number - order.number) as usize * scenes..][..scenes];
            FrameInputs {
                depth_limits: frame.occluder.as_ref().and(memory.depth_limits.as_ref()),
                linear_depth: frame.depth.is_some(),
                auxiliary: memory.auxiliary([frame.pick.is_some(), frame.motion.is_some()]),
                view: (order.views > 1).then_some(number),
                ..inputs_of(own, memory, &settings)
            }
        };
        let inputs = view(order.number);
        match order.number {
            0 => forward.record_first(r, order.views, view),
            _ => forward.record_next(r, &inputs),
        }
        r.barrier();
        let release = record_targets(r, (compose, &forward.sizes), &inputs, (frame, earlier));
        Release { occluder, ..release }
    }
}

/// Returns an empty list that reuses the memory of another one, whose scenes may be gone. Collecting into a list of the
/// same type reuses it; a test counts allocations.
fn emptied<'a>(mut placed: Vec<PlacedScene<'_>>) -> Vec<PlacedScene<'a>> {
    placed.clear();
    placed.into_iter().map(|_| unreachable!("it is empty")).collect()
}

// Reserves frame slots that are large enough for a host's first frame, before it is recorded.

impl Renderer {
    /// Same as [`Renderer::reserve`], but large enough for this frame. Without [`instances`](Reservation::instances) a
    /// reservation is an estimate, and a first frame that needs more lacks its farthest Gaussians. Counts the needs of the
    /// frame, without its targets, occluder and updates. If scenes are shown, hidden or cut at different times, give the
    /// frame that shows most. Submits to the context's queue, and waits. Returns the reservation.
    ///
    /// # Errors
    /// Errors of [`Renderer::reserve`] and [`Renderer::record`]; [`Error::Argument`] for a host's device without a queue.
    pub fn reserve_for(&mut self, wanted: &Reservation, frame: &RecordedFrame<'_>) -> Result<Reservation> {
        let mut reserved = *wanted;
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
        self.check_frame((frame, &[]), reserved, &mut placed)?;
        let forward = &self.runner.forward;
        let slot = self.slots.get(0)?;
        check_capacity((frame, &placed), &slot.upcoming().capacity, reserved)?;
        let settings = RenderSettings { inverse_depth: false, ..*frame.settings };
        let inputs = inputs_of(&placed, &slot.memory, &settings);
        self.context.run("count", |r| {
            forward.record(r, &inputs);
            r.barrier();
            slot.record_counts(r, 0);
            Ok(())
        })?;
        slot.counts(&forward.sizes, 1)
    }
}
