//! Records frames into a host's command buffer; never submits, waits, allocates, maps or reads back.
//!
//! A recording may have several views: the eyes of a headset, a split screen, a picture in a picture. They run one after the other
//! in the memory of one frame, separated by one barrier.

use super::check::{check_capacity, check_views, in_view};
use super::forward::Forward;
use super::recorded_frame::{
    DepthTarget, HostImage, MotionTarget, PickTarget, RecordedFrame, Release, Target,
};
use super::renderer::Renderer;
use super::reservation::{Reservation, SlotReport};
use super::slots::SlotMemory;
use crate::error::{Error, Result};
use crate::frame::{FrameInputs, PlacedScene, RenderSettings, form_batches};
use crate::passes::compose::Compose;
use crate::scene::Camera;
use crate::vk::{ForeignCommands, Image, ImageState, Recorder};
use ash::vk;
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
        let mut placed = emptied(std::mem::take(&mut self.placed));
        let recorded = self.record_checked(commands, slot, views, releases, &mut placed);
        self.placed = emptied(placed);
        recorded
    }

    /// Same as [`Self::record_views`], with an empty list for the scenes of all views.
    fn record_checked<'a>(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        views: &[RecordedFrame<'a>],
        releases: &mut [Release],
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
            let checked = self.check_frame(frame, &views[..index], &reserved, placed);
            gaussians = checked.map_err(|error| in_view(error, index, views))?.max(gaussians);
        }
        let forward = &self.runner.forward;
        let slot = self.slots.get(slot)?;
        slot.recording.check_free()?;
        let (mut unchecked, mut batched_scenes) = (placed.as_mut_slice(), 0);
        for (index, frame) in views.iter().enumerate() {
            let own = unchecked.split_off_mut(..frame.scenes.len()).unwrap_or_default();
            let checked = check_capacity(frame, own, &slot.upcoming().capacity, &reserved);
            checked.map_err(|error| in_view(error, index, views))?;
            // Motion needs a dispatch per scene, so its scenes are not batched.
            if reserved.has_batches() && frame.motion.is_none() {
                batched_scenes += form_batches(forward.sizes.elementwise_workgroup, own);
            }
        }
        let Some(compose) = &self.compose else { unreachable!("built by reserve") };
        slot.take_over();
        self.staged.stage(slot.memory.staging.as_ref(), views[0].updates)?;
        // At most the capacity, so the cast is exact.
        let mut recorder = slot.begin(commands, gaussians as u32, views.len() as u32)?;
        let (r, memory) = (&mut recorder, &slot.memory);
        self.staged.record(r);
        let recording = Recording { forward, compose, memory };
        let (mut unrecorded, mut sorts, mut sharing) = (placed.as_slice(), 0, 0..0);
        for (index, frame) in views.iter().enumerate() {
            if index > 0 {
                r.barrier();
            }
            if !sharing.contains(&index) {
                let shared =
                    if reserved.shared_sort { with_one_order(&views[index..], unrecorded) } else { 1 };
                (sharing, sorts) = (index..index + shared, sorts + 1);
            }
            let order = Order { views: sharing.len() as u32, number: (index - sharing.start) as u32 };
            let earlier = Earlier { frames: &views[..index], releases: &releases[..index] };
            releases[index] = recording.record(r, frame, unrecorded, order, earlier);
            slot.record_counts(r, index as u32);
            unrecorded = &unrecorded[frame.scenes.len()..];
        }
        release_images(r, views, releases);
        (slot.host_report.sorts, slot.host_report.batched_scenes) = (sorts, batched_scenes);
        slot.recording.end(recorder)
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
            && frame.camera.projection == first.camera.projection
            && !first.camera.projection.orders_by_distance()
            && [frame, first].iter().all(|view| view.camera.shutter.is_none())
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
        frame: &RecordedFrame<'_>,
        placed: &[PlacedScene<'_>],
        order: Order,
        earlier: Earlier<'_>,
    ) -> Release {
        let Self { forward, compose, memory } = *self;
        let settings = frame.blended_settings();
        let mut occluder = None;
        if let (Some(o), Some(limits)) = (&frame.occluder, &memory.depth_limits) {
            occluder = Some(earlier.acquire(r, &o.depth));
            let size = [frame.camera.width, frame.camera.height];
            r.scope("depth limits", |r| {
                compose.record_depth_limits(r, o.depth.region(size), o.mapping, limits);
            });
        }
        let scenes = frame.scenes.len();
        let view = |number: u32| {
            let own = &placed[(number - order.number) as usize * scenes..][..scenes];
            FrameInputs {
                depth_limits: frame.occluder.as_ref().and(memory.depth_limits.as_ref()),
                expected_depth: frame.depth.is_some(),
                outputs: frame.outputs(),
                view: (order.views > 1).then_some(number),
                ..memory.inputs(own, &settings)
            }
        };
        let inputs = view(order.number);
        match order.number {
            0 => forward.record_first(r, order.views, view),
            _ => forward.record_next(r, &inputs),
        }
        r.barrier();
        Release { occluder, ..self.record_targets(r, &inputs, frame, earlier) }
    }

    /// Records the writes of a frame into the host's images.
    fn record_targets(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs<'_>,
        frame: &RecordedFrame<'_>,
        earlier: Earlier<'_>,
    ) -> Release {
        let (compose, f) = (self.compose, inputs.frame);
        let size = [frame.camera.width, frame.camera.height];
        let mut release = Release {
            stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
            accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
            ..Release::default()
        };
        r.scope("compose", |r| {
            if let Target::Image { to, behind, encoding } = &frame.target {
                release.color = Some(earlier.acquire(r, to));
                compose.record_color(r, &f.accumulated, to.region(size), *behind, *encoding);
            }
            if let Some(depth) = &frame.depth {
                release.depth = Some(earlier.acquire(r, &depth.to));
                let DepthTarget { to, min_weight, empty } = depth;
                let (accumulated, sums) = (&f.accumulated, &f.depth_sums);
                compose.record_expected_depth(r, accumulated, sums, to.region(size), *min_weight, *empty);
            }
            if let Some(PickTarget { to }) = &frame.pick {
                release.pick = Some(earlier.acquire(r, to));
                let scenes = frame.scenes.len() as u32;
                let sizes = &self.forward.sizes;
                compose.record_picks(r, f, sizes, frame.camera, scenes, to.region(size));
            }
            if let Some(motion) = &frame.motion {
                release.motion = Some(earlier.acquire(r, &motion.to));
                let MotionTarget { to, min_weight, empty, .. } = motion;
                let (accumulated, sums) = (&f.accumulated, &f.motion_sums);
                compose.record_motion(r, accumulated, sums, to.region(size), *min_weight, *empty);
            }
        });
        release
    }
}

/// The earlier views of a recording, and the last uses of their images.
#[derive(Clone, Copy)]
struct Earlier<'a> {
    frames: &'a [RecordedFrame<'a>],
    releases: &'a [Release],
}

impl Earlier<'_> {
    /// Returns the last use of an image in the recording.
    fn last_use(&self, image: &Image) -> Option<ImageState> {
        let views = self.frames.iter().zip(self.releases).rev();
        views
            .flat_map(|(frame, release)| frame.images().into_iter().zip(release.last_uses()))
            .find_map(|((_, host), last)| host.filter(|host| host.image.is_same_as(image)).and(last))
    }

    /// Makes an image ready for kernels. An image of an earlier view is already ready: the barrier between two views orders
    /// all kernels.
    fn acquire(&self, r: &mut Recorder, host: &HostImage<'_>) -> ImageState {
        self.last_use(host.image).unwrap_or_else(|| r.acquire_image(host.image, host.from))
    }
}

/// Releases images to the queue families that own them, each after its last use.
fn release_images(r: &mut Recorder, frames: &[RecordedFrame<'_>], releases: &mut [Release]) {
    for (index, (frame, release)) in frames.iter().zip(releases).enumerate() {
        for ((_, host), used) in frame.images().into_iter().zip(release.last_uses_mut()) {
            let (Some(host), Some(used)) = (host, used) else { continue };
            if !frames[..index].iter().any(|earlier| earlier.has_image(host.image)) {
                r.release_image(host.image, *used);
            }
            *used = host.image.left(*used);
        }
    }
}

/// Returns an empty list that reuses the memory of another one, whose scenes may be gone. Collecting into a list of the
/// same type reuses it; a test counts allocations.
fn emptied<'a>(mut placed: Vec<PlacedScene<'_>>) -> Vec<PlacedScene<'a>> {
    placed.clear();
    placed.into_iter().map(|_| unreachable!("it is empty")).collect()
}

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
        self.check_frame(frame, &[], reserved, &mut placed)?;
        let forward = &self.runner.forward;
        let slot = self.slots.get(0)?;
        check_capacity(frame, &placed, &slot.upcoming().capacity, reserved)?;
        let settings = RenderSettings { inverse_depth: false, ..*frame.settings };
        let inputs = slot.memory.inputs(&placed, &settings);
        self.context.run_commands("count", |r| {
            forward.record(r, &inputs);
            r.barrier();
            slot.record_counts(r, 0);
        })?;
        slot.counts(&forward.sizes, 1)
    }
}
