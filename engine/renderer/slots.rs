//! Frames in flight. Their memory is planned and allocated in advance.

use super::Renderer;
use super::frame_store::State;
use crate::compose::Compose;
use crate::error::{Error, Result};
use crate::forward::{
    Auxiliary, BlendVariant, CUT_OUT_BYTES, Forward, LEAST_SCENES, MotionBuffers, PickBuffers, SceneSettings,
};
use crate::kernels::constants as c;
use crate::plan::{
    FrameBuffers, FrameCapacity, LaunchSizes, PictureCapacity, ScenePlan, check_grids, frame_requests,
    initial_instances,
};
use crate::scene::MAX_CUT_OUTS;
use crate::vk::{
    Buffer, Context, ForeignCommands, KernelJob, MemoryKind, PLACEMENT_ALIGNMENT, RecordSlot, Recorder,
    ScopeTime, SlotRecording, pack,
};

/// Bytes of a view's counts.
const STATE_BYTES: u64 = c::STATE_WORDS as u64 * 4;

/// Counts of a recorded frame that has finished. For several views
/// ([`Renderer::record_views`](super::Renderer::record_views)), the largest of each count.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct SlotReport {
    /// Gaussians in the frame's scenes, without hidden scenes.
    pub gaussians: u32,
    /// Visible Gaussians. If views share a sort, those that any of them shows.
    pub visible: u32,
    /// (tile, Gaussian) instances that the picture needs.
    pub instances_needed: u32,
    /// Capacity in instances.
    pub instance_capacity: u32,
    /// Entries of the longest tile.
    pub longest_tile: u32,
    /// Passes of blending that the longest tile needs.
    pub blend_passes_needed: u32,
    /// Passes of blending with which the frame was recorded.
    pub blend_passes: u32,
    /// Entries of a tile that a pass of blending handles.
    pub entries_per_pass: u32,
    /// True if the frame needed more instances or passes of blending than it had. The picture then lacks the farthest
    /// Gaussians, or all of them if `instances_needed` is `u32::MAX`. [`Reservation::grown`] fixes the first case.
    pub overflow: bool,
    /// Number of depth sorts of the recording: one per view, or per run of views that share one
    /// ([`Reservation::shared_sort`]).
    pub sorts: u32,
    /// Scenes, of all views, that are drawn in batches, by shared dispatches (see
    /// [`DeviceScene::upload_all`](super::DeviceScene::upload_all)).
    pub batched_scenes: u32,
    /// Device time per stage, view by view; empty without timestamps. A recording of many views has only its first 255
    /// stages.
    pub scopes: Vec<ScopeTime>,
}

/// One frame in flight.
pub(super) struct Slot {
    pub record: RecordSlot,
    pub memory: SlotMemory,
    /// Memory reserved since the last recording.
    next: Option<SlotMemory>,
    readback: Buffer,
    /// Gaussians of the last recording.
    gaussians: u32,
    /// Views of the last recording.
    views: u32,
    /// Depth sorts of the last recording.
    pub sorts: u32,
    /// Scenes of the last recording drawn in batches.
    pub batched_scenes: u32,
    /// Capacity of the last recording.
    capacity: FrameCapacity,
    /// Report of the last recording, once it has been requested.
    report: Option<SlotReport>,
}

/// All frames in flight.
#[derive(Default)]
pub(super) struct Slots {
    pub reserved: Option<Reservation>,
    pub slots: Vec<Slot>,
}

impl Slots {
    /// Returns an error while a frame is in flight.
    pub fn check_free(&self) -> Result<()> {
        for slot in &self.slots {
            if !slot.record.finished()? {
                return Err(Error::argument("frame slots", "one is still in flight: wait for it first"));
            }
        }
        Ok(())
    }

    /// Allocates a reservation, which replaces the current one. No frame may be in flight.
    pub fn reserve(&mut self, plan: &Plan<'_>) -> Result<()> {
        // The old memory is freed first: both at once might not fit.
        self.slots.clear();
        self.reserved = None;
        let numbers = (plan.dispatches, plan.wanted.views);
        for memory in plan.allocate()? {
            self.slots.push(Slot::new(plan.context, memory, numbers)?);
        }
        self.reserved = Some(*plan.wanted);
        Ok(())
    }

    /// Returns an error for a reservation to which the current one cannot grow.
    pub fn check_growth(&self, wanted: &Reservation) -> Result<()> {
        let slots = self.slots.len();
        if slots == 0 {
            return Err(Error::argument(
                "slots",
                "none are reserved that could grow: call Renderer::reserve",
            ));
        }
        if wanted.slots as usize != slots {
            let problem =
                format!("slots is {}, {slots} are reserved: growth keeps their number", wanted.slots);
            return Err(Error::argument("reservation", problem));
        }
        let views = self.reserved.map_or(0, |reserved| reserved.views);
        if wanted.views != views {
            let problem =
                format!("views is {}, {views} are reserved: growth keeps their number", wanted.views);
            return Err(Error::argument("reservation", problem));
        }
        Ok(())
    }

    /// Allocates another reservation with as many slots. Each slot switches to it with its next recording.
    pub fn grow(&mut self, plan: &Plan<'_>) -> Result<()> {
        let memory = plan.allocate()?;
        for slot in &mut self.slots {
            slot.record.reserve(plan.dispatches)?;
        }
        for (slot, memory) in self.slots.iter_mut().zip(memory) {
            slot.next = Some(memory);
        }
        self.reserved = Some(*plan.wanted);
        Ok(())
    }

    /// Returns the slot with an index.
    pub fn get(&mut self, index: u32) -> Result<&mut Slot> {
        let count = self.slots.len();
        self.slots.get_mut(index as usize).ok_or_else(|| {
            Error::argument("slot", format!("{index}: {count} are reserved; call Renderer::reserve"))
        })
    }
}

impl Slot {
    fn new(context: &Context, memory: SlotMemory, (dispatches, views): (usize, u32)) -> Result<Self> {
        let host = [("state_readback", u64::from(views) * STATE_BYTES)];
        let mut host = context.allocate("frame slot host", &host, MemoryKind::HostVisible)?;
        let Some(readback) = host.pop() else { unreachable!("one buffer per request") };
        let record = RecordSlot::new(context, dispatches)?;
        let capacity = memory.capacity;
        Ok(Self {
            record,
            memory,
            next: None,
            readback,
            gaussians: 0,
            views: 0,
            sorts: 0,
            batched_scenes: 0,
            capacity,
            report: None,
        })
    }

    /// Returns the memory of the next recording.
    pub fn upcoming(&self) -> &SlotMemory {
        self.next.as_ref().unwrap_or(&self.memory)
    }

    /// Switches to the memory reserved since the last recording, whose command buffer has finished.
    pub fn take_over(&mut self) {
        if let Some(next) = self.next.take() {
            self.memory = next;
        }
    }

    /// Begins a recording of `views` views with up to `gaussians` Gaussians.
    pub fn begin(&mut self, commands: ForeignCommands, (gaussians, views): (u32, u32)) -> Result<Recorder> {
        let recorder = self.record.begin(commands, "ashsplat")?;
        (self.gaussians, self.views, self.sorts) = (gaussians, views, 0);
        self.batched_scenes = 0;
        (self.capacity, self.report) = (self.memory.capacity, None);
        Ok(recorder)
    }

    /// Ends the recording.
    pub fn end(&mut self, recorder: Recorder) -> Result<()> {
        self.record.end(recorder)
    }

    /// Returns the report of the last recording. None while it is in flight, or without a recording.
    pub fn report(&mut self, sizes: &LaunchSizes) -> Result<Option<SlotReport>> {
        if !self.record.is_recorded() || !self.record.finished()? {
            return Ok(None);
        }
        if self.report.is_some() || !self.record.has_times()? {
            return Ok(self.report.clone());
        }
        self.report = Some(SlotReport { scopes: self.record.times()?, ..self.counts(sizes, self.views)? });
        Ok(self.report.clone())
    }

    /// Records the copy of a view's counts to host-readable memory.
    pub fn record_counts(&self, recorder: &mut Recorder, view: u32) {
        let to = self.readback.range(u64::from(view) * STATE_BYTES, STATE_BYTES);
        recorder.copy(&self.memory.frame.state, &to);
    }

    /// Returns the counts of `views` finished views, the largest of each count.
    pub fn counts(&self, sizes: &LaunchSizes, views: u32) -> Result<SlotReport> {
        let mut state = State::default();
        for view in 0..views {
            let mut bytes = [0u8; STATE_BYTES as usize];
            self.readback.read(u64::from(view) * STATE_BYTES, &mut bytes)?;
            let own = State::of(&bytes);
            state = State {
                visible: state.visible.max(own.visible),
                instances: state.instances.max(own.instances),
                longest_tile: state.longest_tile.max(own.longest_tile),
                overflow: state.overflow || own.overflow,
                ..state
            };
        }
        Ok(SlotReport {
            gaussians: self.gaussians,
            visible: state.visible,
            instances_needed: state.instances,
            instance_capacity: self.capacity.instances,
            longest_tile: state.longest_tile,
            blend_passes: self.capacity.blend_passes,
            entries_per_pass: sizes.entries_per_pass,
            blend_passes_needed: state.longest_tile.div_ceil(sizes.entries_per_pass).max(1),
            overflow: state.overflow,
            sorts: self.sorts,
            batched_scenes: self.batched_scenes,
            scopes: Vec::new(),
        })
    }
}

// Reservations of a host for frames in flight.

/// Memory and kernels to prepare for recording: see [`super::Renderer::reserve`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reservation {
    /// Frames in flight.
    pub slots: u32,
    /// Queues to which frames are submitted. Scratch memory of a frame exists once for each queue: slots with the same
    /// `slot % queues` share it. Submit their frames to one queue, in any order, or order them by semaphores. With as many
    /// queues as slots nothing is shared.
    pub queues: u32,
    /// Views per recording ([`Renderer::record_views`](super::Renderer::record_views)): they share the memory of one. At
    /// most 255 stages of a recording are timed ([`SlotReport::scopes`]).
    pub views: u32,
    /// True if views with the same depths, such as two eyes side by side, are culled and sorted once: see
    /// [`Renderer::record_views`](super::Renderer::record_views). Costs 256 bytes for each scene and view, and more
    /// kernels.
    pub shared_sort: bool,
    /// Gaussians drawn in all scenes of a frame together ([`DeviceScene::count`](super::DeviceScene::count)).
    pub gaussians: u32,
    /// Scenes per frame.
    pub scenes: u32,
    /// Highest SH degree that frames evaluate. A frame with a higher one is refused.
    pub sh_degree: u32,
    /// (tile, Gaussian) instances of a frame; 0 for an estimate. [`SlotReport`] reports how many a frame needs.
    pub instances: u32,
    /// Width of the largest picture, pixels. Pictures of any shape fit if they have no more pixels and no more tiles of
    /// 16×16 pixels; for example, the same size turned by 90 degrees.
    pub width: u32,
    /// Height of the largest picture, pixels: see [`Reservation::width`].
    pub height: u32,
    /// Passes of blending. 0 for an estimate: 2 if the driver bounds loops and a tile may have more entries than a pass
    /// handles, otherwise 1. [`SlotReport`] reports how many a frame needs.
    pub blend_passes: u32,
    /// True if frames will render the sum of weights / z.
    pub inverse_depth: bool,
    /// True if frames will render expected depth.
    pub expected_depth: bool,
    /// True if frames will read a host's depth image.
    pub occlusion: bool,
    /// True if frames will draw scenes with a 3D filter ([`RenderSettings::filter_3d`](crate::RenderSettings::filter_3d)).
    pub filter_3d: bool,
    /// True if scenes of frames will have a tint or an opacity ([`SceneSettings`](crate::SceneSettings)).
    pub tint: bool,
    /// Cut-outs of all scenes of a frame together ([`SceneSettings::cut_outs`](crate::SceneSettings::cut_outs)).
    pub cut_outs: u32,
    /// True if scenes of frames will have a selection ([`SceneSettings::selection`](crate::SceneSettings::selection)).
    pub selection: bool,
    /// True if frames will write picks ([`RecordedFrame::pick`](super::RecordedFrame::pick)), which take 8 bytes per pixel.
    pub pick: bool,
    /// True if frames will write motion ([`RecordedFrame::motion`](super::RecordedFrame::motion)), which takes 8 bytes per
    /// pixel and 8 per Gaussian.
    pub motion: bool,
    /// True if frames will have orthographic cameras
    /// ([`Projection::Orthographic`](crate::scene::Projection::Orthographic)), beside pinholes. Includes previous cameras
    /// ([`MotionTarget::previous_camera`](super::MotionTarget::previous_camera)).
    pub orthographic: bool,
    /// True if all frames render into images, and none into its slot ([`Target::Slot`](super::Target::Slot)). Slots then
    /// have no pixels of their own ([`Renderer::slot_pixels`](super::Renderer::slot_pixels), `slot_inverse_depth`).
    pub images_only: bool,
    /// Bytes of staging memory for the [`super::Update`]s of a frame: see [`Reservation::update_bytes`].
    pub staging_bytes: u64,
}

impl Reservation {
    /// Largest value of [`Reservation::scenes`].
    pub const MAX_SCENES: u32 = 65_536;

    /// A reservation for one frame in flight of one scene, for one queue, with all options off.
    pub fn new(gaussians: u32, sh_degree: u32, width: u32, height: u32) -> Self {
        Self {
            slots: 1,
            queues: 1,
            views: 1,
            shared_sort: false,
            gaussians,
            scenes: 1,
            sh_degree,
            instances: 0,
            width,
            height,
            blend_passes: 0,
            inverse_depth: false,
            expected_depth: false,
            occlusion: false,
            filter_3d: false,
            tint: false,
            cut_outs: 0,
            selection: false,
            pick: false,
            motion: false,
            orthographic: false,
            images_only: false,
            staging_bytes: 0,
        }
    }

    /// Returns the staging bytes of an update of `gaussians` Gaussians of a scene with this SH degree.
    pub fn update_bytes(gaussians: u32, sh_degree: u32) -> u64 {
        u64::from(gaussians) * u64::from(crate::plan::parameter_planes(sh_degree)) * 16
    }

    /// Returns a copy that fits the needs of a frame. Unchanged if the frame fitted, or if it needs more than can be
    /// counted (`instances_needed` is `u32::MAX`). Keep the copy only after [`super::Renderer::grow`] has succeeded;
    /// otherwise continue with the old one.
    pub fn grown(&self, report: &SlotReport) -> Self {
        let mut grown = *self;
        // The frame may have been recorded before the reservation grew.
        let counted = report.instances_needed != u32::MAX;
        if counted && report.instances_needed > report.instance_capacity.max(self.instances) {
            // With a reserve of half, because later frames will need other numbers.
            grown.instances = report.instances_needed.saturating_add(report.instances_needed / 2);
        }
        if report.blend_passes_needed > report.blend_passes.max(self.blend_passes) {
            grown.blend_passes = report.blend_passes_needed;
        }
        grown
    }

    /// True if frames may have enough scenes for batches, which one dispatch draws.
    pub(super) fn has_batches(&self) -> bool {
        self.scenes >= LEAST_SCENES
    }

    pub(super) fn check(&self) -> Result<()> {
        let sides = 1..=crate::scene::camera::MAX_IMAGE_SIDE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            let problem = format!(
                "width and height are {} x {}, each may be 1 to {}",
                self.width,
                self.height,
                sides.end()
            );
            return Err(Error::argument("reservation", problem));
        }
        // The upper bounds exceed what any device can hold.
        let counts = [
            ("slots", self.slots, 1..=1024),
            ("queues", self.queues, 1..=1024),
            ("views", self.views, 1..=1024),
            ("scenes", self.scenes, 1..=Self::MAX_SCENES),
            ("blend_passes", self.blend_passes, 0..=65_536),
            ("sh_degree", self.sh_degree, 0..=3),
            ("cut_outs", self.cut_outs, 0..=Self::MAX_SCENES * MAX_CUT_OUTS as u32),
        ];
        match counts.into_iter().find(|(_, count, range)| !range.contains(count)) {
            Some((field, count, range)) => {
                let problem = format!("{field} is {count}, it may be {} to {}", range.start(), range.end());
                Err(Error::argument("reservation", problem))
            }
            None => Ok(()),
        }
    }

    /// Returns the variants of blending that frames may use.
    pub(super) fn variants(&self) -> Vec<BlendVariant> {
        let mut variants = vec![BlendVariant::default()];
        if self.inverse_depth {
            variants.push(BlendVariant { inverse_depth: true, ..BlendVariant::default() });
        }
        if self.expected_depth {
            variants.push(BlendVariant {
                inverse_depth: true,
                linear_depth: true,
                ..BlendVariant::default()
            });
        }
        if self.occlusion {
            let hidden = variants.clone().into_iter();
            variants.extend(hidden.map(|v| BlendVariant { depth_limit: true, ..v }));
        }
        if self.pick {
            let picked = variants.clone().into_iter();
            variants.extend(picked.map(|v| BlendVariant { pick: true, ..v }));
        }
        if self.motion {
            let moving = variants.clone().into_iter();
            variants.extend(moving.map(|v| BlendVariant { motion: true, ..v }));
        }
        // Any frame may draw ellipsoids.
        let steep = variants.clone().into_iter();
        variants.extend(steep.map(|v| BlendVariant { steep: true, ..v }));
        if self.filter_3d {
            let filtered = variants.clone().into_iter();
            variants.extend(filtered.map(|v| BlendVariant { filter_3d: true, ..v }));
        }
        if self.tint {
            let tinted = variants.clone().into_iter();
            variants.extend(tinted.map(|v| BlendVariant { tinted: true, ..v }));
        }
        if self.cut_outs > 0 {
            let cut = variants.clone().into_iter();
            variants.extend(cut.map(|v| BlendVariant { cut_outs: true, ..v }));
        }
        if self.selection {
            let selected = variants.clone().into_iter();
            variants.extend(selected.map(|v| BlendVariant { selection: true, ..v }));
        }
        if self.orthographic {
            let parallel = variants.clone().into_iter();
            variants.extend(parallel.map(|v| BlendVariant { orthographic: true, ..v }));
        }
        if self.shared_sort {
            let shared = variants.clone().into_iter();
            variants.extend(shared.map(|v| BlendVariant { shared_order: true, ..v }));
        }
        variants
    }

    /// Returns the fields that a frame of this variant needs and that are not set, with commas; None if there are none.
    pub(super) fn lacks(&self, frame: BlendVariant) -> Option<String> {
        let needs = [
            ("occlusion", frame.depth_limit, self.occlusion),
            ("expected_depth", frame.linear_depth, self.expected_depth),
            ("inverse_depth", frame.inverse_depth && !frame.linear_depth, self.inverse_depth),
            ("filter_3d", frame.filter_3d, self.filter_3d),
            ("pick", frame.pick, self.pick),
            ("motion", frame.motion, self.motion),
            ("orthographic", frame.orthographic, self.orthographic),
        ];
        let lacking = needs.into_iter().filter(|(_, needed, set)| *needed && !set).map(|(field, ..)| field);
        // Allocates no list, so that the usual case costs nothing.
        lacking.map(field_name).reduce(|all, field| all + ", " + &field)
    }

    /// Checks that the features of a frame's scene are reserved.
    #[inline]
    pub(super) fn check_scene(&self, index: usize, own: &SceneSettings) -> Result<()> {
        let lacks = |field: &str, what: &str| {
            Err(Error::argument(field_name(field), format!("not reserved, and scenes[{index}] has {what}")))
        };
        match () {
            () if own.is_tinted() && !self.tint => lacks("tint", "a tint or an opacity"),
            () if own.mask().is_some() && !self.selection => lacks("selection", "a selection"),
            () => Ok(()),
        }
    }

    /// Returns the passes of blending of each frame. A tile has no more entries than there are Gaussians.
    fn passes(&self, sizes: &LaunchSizes) -> u32 {
        match self.blend_passes {
            0 => self.gaussians.div_ceil(sizes.entries_per_pass).clamp(1, 2),
            passes => passes,
        }
    }

    /// Returns the most dispatches of a recording of frames of this capacity.
    pub(super) fn dispatches(&self, context: &Context, capacity: &FrameCapacity) -> Result<usize> {
        const PER_FRAME: u32 = 48;
        // Scenes may be stored with a higher degree than the evaluated one, in more chunks.
        let plan = ScenePlan::new(context.limits(), self.gaussians, 3)
            .or_else(|_| ScenePlan::new(context.limits(), self.gaussians, self.sh_degree))
            .map_err(|error| error.of_field(field_name("gaussians")))?;
        // Per chunk of parameters: culling, projection and motion. Per scene: the ranges of its chunks.
        let of_chunk = 2 + u32::from(self.motion);
        let projection = of_chunk * (plan.chunks + self.scenes) + self.scenes;
        let sizes = LaunchSizes::new(context.limits());
        let blending = sizes.blend_dispatches(capacity.instances, capacity.blend_passes);
        Ok((PER_FRAME + blending + projection) as usize * self.views as usize)
    }

    /// Returns the capacity of each frame, if it fits the device's grids.
    pub(super) fn capacity(&self, context: &Context, sizes: &LaunchSizes) -> Result<FrameCapacity> {
        // Gaps between scenes are smaller than a block.
        let gaps = (self.scenes - 1).saturating_mul(sizes.elementwise_workgroup);
        let gaussians = self.gaussians.saturating_add(gaps);
        let pictures = PictureCapacity::of(self.width, self.height).without_backward();
        let capacity = FrameCapacity {
            gaussians,
            // A recorded frame cannot be run again.
            visible: gaussians,
            instances: match self.instances {
                0 => initial_instances(context.limits(), gaussians, &pictures),
                instances => instances,
            },
            scenes: self.scenes * if self.shared_sort { self.views } else { 1 },
            pictures,
            blend_passes: self.passes(sizes),
            backward: false,
            absolute: false,
        };
        check_grids(context.limits(), &capacity, sizes)
            .map_err(|error| error.of_field(field_name("width, height, gaussians, instances")))?;
        Ok(capacity)
    }
}

/// Names a field in messages about frames.
pub(super) fn field_name(field: &str) -> String {
    format!("{RESERVATION}{field}")
}

/// Prefix of field names.
pub(super) const RESERVATION: &str = "Reservation::";

// Reserves frame slots, and answers a host's queries about them.

impl Renderer {
    /// Allocates frame slots and builds all kernels that frames of this kind need. Replaces the previous
    /// slots, whose command buffers must have finished
    /// ([`Context::adopt_commands`](crate::vk::Context::adopt_commands)). Neither submits nor waits.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid reservation or while a slot is in flight. [`Error::TooLarge`] if the reservation
    /// exceeds the device; it names the field. Memory or device failures. The slots stay as before, except after a lack of
    /// device or host memory: then none is reserved.
    pub fn reserve(&mut self, wanted: &Reservation) -> Result<()> {
        self.reserve_by(wanted, None)
    }

    /// Same as [`Renderer::reserve`], but all device memory comes from one block of the host ([`Buffer::adopt`]), of at
    /// least [`Renderer::reservation_bytes`]. In addition, each slot allocates [`Reservation::staging_bytes`] and 36
    /// host-readable bytes for each view. The block has the usages STORAGE_BUFFER, UNIFORM_BUFFER, INDIRECT_BUFFER,
    /// TRANSFER_SRC and TRANSFER_DST.
    ///
    /// # Errors
    /// Same as [`Renderer::reserve`]; also for a block of another context, or one that is too small.
    pub fn reserve_in(&mut self, wanted: &Reservation, block: &Buffer) -> Result<()> {
        self.reserve_by(wanted, Some(block))
    }

    fn reserve_by(&mut self, wanted: &Reservation, block: Option<&Buffer>) -> Result<()> {
        // Refuses before kernels are built, which may take seconds.
        wanted.check()?;
        self.slots.check_free()?;
        let context = self.context.clone();
        let plan = Plan::new(&context, &self.runner.forward.sizes, wanted, block)?;
        self.prepare(wanted)?;
        self.slots.reserve(&plan)
    }

    /// Same as [`Renderer::reserve`], but allowed while frames are in flight, and without waiting. Every slot switches to
    /// the new memory with its next recording; with [`Reservation::images_only`] also when it is released. The old memory
    /// is freed when the last slot has switched, so until then both exist. The numbers of slots and of views must stay the
    /// same. An unchanged reservation allocates nothing; a smaller one frees memory.
    /// # Errors
    /// Same as [`Renderer::reserve`]; [`Error::Argument`] without slots, or for another number of slots or views. The slots
    /// then stay as before.
    pub fn grow(&mut self, wanted: &Reservation) -> Result<()> {
        self.grow_by(wanted, None)
    }

    /// Same as [`Renderer::grow`], but in a block of the host, as for [`Renderer::reserve_in`]. The old block is unused
    /// once every slot has switched to the new one, and earlier frames have finished.
    ///
    /// # Errors
    /// Same as [`Renderer::grow`] and [`Renderer::reserve_in`].
    pub fn grow_in(&mut self, wanted: &Reservation, block: &Buffer) -> Result<()> {
        self.grow_by(wanted, Some(block))
    }

    fn grow_by(&mut self, wanted: &Reservation, block: Option<&Buffer>) -> Result<()> {
        wanted.check()?;
        self.slots.check_growth(wanted)?;
        if block.is_none() && self.slots.reserved == Some(*wanted) {
            return self.prepare(wanted);
        }
        let context = self.context.clone();
        let plan = Plan::new(&context, &self.runner.forward.sizes, wanted, block)?;
        self.prepare(wanted)?;
        self.slots.grow(&plan)
    }

    /// Returns the bytes of a reservation's block for [`Renderer::reserve_in`].
    ///
    /// # Errors
    /// Same as [`Renderer::reserve`], without allocating anything.
    pub fn reservation_bytes(&self, wanted: &Reservation) -> Result<u64> {
        let plan = Plan::new(&self.context, &self.runner.forward.sizes, wanted, None)?;
        Ok(plan.block_bytes())
    }

    /// Returns the kernels that [`Renderer::new`] and [`Renderer::reserve`] build. A host can build them ahead on its own
    /// threads; both then build none. Assumes the device's default form of blending.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid reservation; [`Error::TooLarge`] for kernels that exceed the device.
    pub fn kernel_jobs(context: &Context, wanted: &Reservation) -> Result<Vec<KernelJob>> {
        wanted.check()?;
        context.kernel_jobs(|context| {
            prepare_variants(&mut Forward::new(context)?, wanted)?;
            Compose::new(context)?.prepare(context, [wanted.pick, wanted.motion])
        })
    }

    /// Builds the kernels of a reservation.
    fn prepare(&mut self, wanted: &Reservation) -> Result<()> {
        let compose = match self.compose.take() {
            Some(compose) => compose,
            None => Compose::new(&self.context)?,
        };
        self.compose.insert(compose).prepare(&self.context, [wanted.pick, wanted.motion])?;
        prepare_variants(&mut self.runner.forward, wanted)
    }

    /// Returns the report of a slot's last frame. None while it is in flight, or without a frame. Never waits, except on
    /// llvmpipe, where reading timestamps waits for the whole device
    /// ([`ContextOptions::timestamps`](crate::vk::ContextOptions::timestamps)).
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved; when the device is lost.
    pub fn slot_report(&mut self, slot: u32) -> Result<Option<SlotReport>> {
        let sizes = self.runner.forward.sizes;
        self.slots.get(slot)?.report(&sizes)
    }

    /// True if the last frame of a slot has finished. Never waits. Commands that the host recorded after the frame may
    /// still run: see [`Context::adopt_commands`](crate::vk::Context::adopt_commands).
    ///
    /// # Errors
    /// Same as [`Renderer::slot_report`].
    pub fn slot_finished(&mut self, slot: u32) -> Result<bool> {
        self.slots.get(slot)?.record.finished()
    }

    /// Releases the resources of a slot's last frame, once its command buffer has finished. Scenes and image views dropped
    /// meanwhile are destroyed now, not at the slot's next recording.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved or still in flight.
    pub fn release_slot(&mut self, slot: u32) -> Result<()> {
        let slot = self.slots.get(slot)?;
        slot.record.release()?;
        // The host may still read pixels of the last frame.
        if !slot.memory.keeps_pixels {
            slot.take_over();
        }
        Ok(())
    }

    /// Returns the buffer that [`Target::Slot`](super::Target::Slot) fills. Per pixel, row by row, f32: premultiplied r, g,
    /// b (display-encoded, as trained) and transmittance. Usable as a storage buffer and a source of transfers.
    /// [`Renderer::reserve`] replaces it; after [`Renderer::grow`], the slot's next recording replaces it.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved, or with [`Reservation::images_only`].
    pub fn slot_pixels(&mut self, slot: u32) -> Result<Buffer> {
        Ok(self.slot_with_pixels(slot)?.memory.frame.accumulated.clone())
    }

    /// Returns the buffer of [`RenderSettings::inverse_depth`](crate::RenderSettings::inverse_depth): the sum of weights /
    /// z per pixel, row by row, f32. With an expected depth ([`RecordedFrame::depth`](super::RecordedFrame::depth)) it
    /// holds the sum of weights * z. Otherwise same as [`Renderer::slot_pixels`].
    ///
    /// # Errors
    /// Same as [`Renderer::slot_pixels`].
    pub fn slot_inverse_depth(&mut self, slot: u32) -> Result<Buffer> {
        let memory = &self.slot_with_pixels(slot)?.memory;
        match memory.keeps_depth {
            true => Ok(memory.frame.inverse_depth.clone()),
            false => Err(Error::argument("inverse_depth", "not reserved")),
        }
    }

    /// Returns the slot's recording state, for a host that has discarded its command buffer or caught a panic: see
    /// [`SlotRecording::discard`].
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved.
    pub fn slot_recording(&mut self, slot: u32) -> Result<SlotRecording<'_>> {
        Ok(SlotRecording::new(&mut self.slots.get(slot)?.record))
    }

    fn slot_with_pixels(&mut self, slot: u32) -> Result<&mut Slot> {
        let slot = self.slots.get(slot)?;
        match slot.memory.keeps_pixels {
            true => Ok(slot),
            false => Err(Error::argument("images_only", "is reserved: slots have no pixels of their own")),
        }
    }
}

fn prepare_variants(forward: &mut Forward, wanted: &Reservation) -> Result<()> {
    for variant in wanted.variants() {
        for sh_degree in 0..=wanted.sh_degree.min(3) {
            forward.prepare_variant(sh_degree, variant)?;
            if wanted.has_batches() {
                forward.prepare_batches(sh_degree, variant)?;
            }
        }
    }
    Ok(())
}

// Device memory of frames in flight.
//
// A frame begins with a barrier after all earlier commands of its queue. So scratch memory, used only within a frame,
// exists once for each queue, in any order of recording and submission. Memory used before or after the frame exists once
// for each slot: pixels that the host reads, staging memory that it writes, the counts.

type Requests = Vec<(&'static str, u64)>;

/// Memory with which the frames of a slot are recorded.
#[derive(Clone)]
pub(super) struct SlotMemory {
    pub frame: FrameBuffers,
    pub capacity: FrameCapacity,
    /// 1/z per pixel.
    pub depth_limits: Option<Buffer>,
    pub cut_outs: Option<Buffer>,
    /// Per pixel, and per scene: see [`PickBuffers`].
    picks: Option<[Buffer; 2]>,
    /// Per visible Gaussian, and per pixel: see [`MotionBuffers`].
    motion: Option<[Buffer; 2]>,
    pub staging: Option<Buffer>,
    /// True if the pixels of a frame stay until the slot is recorded again.
    pub keeps_pixels: bool,
    /// True if the inverse or expected depth stays too.
    pub keeps_depth: bool,
}

impl SlotMemory {
    /// Returns the buffers of picks and of motion, if the frame writes them.
    pub fn auxiliary(&self, [pick, motion]: [bool; 2]) -> Auxiliary<'_> {
        let picks = self.picks.as_ref().filter(|_| pick);
        let motion = self.motion.as_ref().filter(|_| motion);
        Auxiliary {
            picks: picks.map(|[picks, scene_firsts]| PickBuffers { picks, scene_firsts }),
            motion: motion.map(|[motions, sums]| MotionBuffers { motions, sums }),
        }
    }
}

/// Requests of a reservation, in a host's block if there is one.
pub(super) struct Plan<'a> {
    pub context: &'a Context,
    pub wanted: &'a Reservation,
    block: Option<&'a Buffer>,
    /// Most dispatches of a recording.
    pub dispatches: usize,
    capacity: FrameCapacity,
    /// Once for each queue: the frame's requests, then optional ones.
    scratch: Requests,
    /// Number of the optional ones.
    extra: usize,
    /// For each slot except the first of a queue, which keeps its pixels in the scratch.
    pixels: Requests,
    /// True if they include a depth.
    has_depth: bool,
}

impl<'a> Plan<'a> {
    /// Returns the errors of [`Plan::allocate`] in advance, except a lack of memory.
    pub fn new(
        context: &'a Context,
        sizes: &LaunchSizes,
        wanted: &'a Reservation,
        block: Option<&'a Buffer>,
    ) -> Result<Self> {
        wanted.check()?;
        let capacity = wanted.capacity(context, sizes)?;
        let dispatches = wanted.dispatches(context, &capacity)?;
        let scratch = scratch_requests(wanted, &capacity, sizes);
        check_bindings(context, &scratch, (wanted, &capacity), sizes)?;
        let frame = frame_requests(&capacity, sizes).len();
        let pixels = capacity.pictures.pixels;
        let has_depth = !wanted.images_only && (wanted.inverse_depth || wanted.expected_depth);
        let mut own = Vec::new();
        if !wanted.images_only {
            own.push(("accumulated", pixels * 16));
            own.extend(has_depth.then_some(("inverse_depth", pixels * 4)));
        }
        let extra = scratch.len() - frame;
        let plan =
            Self { context, wanted, block, dispatches, capacity, scratch, extra, pixels: own, has_depth };
        block.map_or(Ok(()), |block| check_block(context, block, plan.block_bytes()))?;
        Ok(plan)
    }

    /// Returns the groups to allocate, in order.
    fn groups(&self) -> impl Iterator<Item = &Requests> {
        let wanted = self.wanted;
        let queues = wanted.queues.min(wanted.slots);
        let own = if self.pixels.is_empty() { 0 } else { wanted.slots - queues };
        let scratch = std::iter::repeat_n(&self.scratch, queues as usize);
        scratch.chain(std::iter::repeat_n(&self.pixels, own as usize))
    }

    /// Returns the bytes of a block for all groups.
    pub fn block_bytes(&self) -> u64 {
        self.groups().map(group_bytes).fold(0, u64::saturating_add)
    }

    /// Allocates the memory of all slots.
    pub fn allocate(&self) -> Result<Vec<SlotMemory>> {
        let Self { context, wanted, block, .. } = *self;
        let mut at = 0;
        let mut groups = Vec::new();
        for requests in self.groups() {
            groups.push(match block {
                None => context.allocate("frame slot", requests, MemoryKind::Device)?.into_iter(),
                Some(block) => {
                    let bytes = group_bytes(requests);
                    let group = block.range(at, bytes).split(requests);
                    at += bytes;
                    group.into_iter()
                }
            });
        }
        let mut groups = groups.into_iter();
        let queues = wanted.queues.min(wanted.slots) as usize;
        let mut memory: Vec<SlotMemory> = Vec::new();
        for slot in 0..wanted.slots as usize {
            let mut own = match memory.get(slot % queues) {
                Some(shared) if slot >= queues => shared.clone(),
                _ => {
                    let mut scratch = groups.next().unwrap_or_default();
                    let own = scratch.len() - self.extra;
                    let frame = FrameBuffers::from_allocated(scratch.by_ref().take(own).collect());
                    let mut next = |reserved: bool| reserved.then(|| scratch.next()).flatten();
                    let (depth_limits, cut_outs) = (next(wanted.occlusion), next(wanted.cut_outs > 0));
                    let picks = next(wanted.pick).zip(next(wanted.pick)).map(<[_; 2]>::from);
                    let motion = next(wanted.motion).zip(next(wanted.motion)).map(<[_; 2]>::from);
                    let capacity = self.capacity;
                    let keeps_pixels = !wanted.images_only;
                    let keeps_depth = self.has_depth;
                    SlotMemory {
                        frame,
                        capacity,
                        depth_limits,
                        cut_outs,
                        picks,
                        motion,
                        staging: None,
                        keeps_pixels,
                        keeps_depth,
                    }
                }
            };
            if slot >= queues && !self.pixels.is_empty() {
                let mut pixels = groups.next().unwrap_or_default();
                if let Some(accumulated) = pixels.next() {
                    own.frame.accumulated = accumulated;
                }
                if let Some(inverse_depth) = pixels.next() {
                    own.frame.inverse_depth = inverse_depth;
                }
            }
            if wanted.staging_bytes > 0 {
                let request = [("scene_updates", wanted.staging_bytes)];
                own.staging = context.allocate("frame slot host", &request, MemoryKind::HostVisible)?.pop();
            }
            memory.push(own);
        }
        Ok(memory)
    }
}

/// Returns the scratch requests of a frame of this capacity; those of [`frame_requests`] come first.
fn scratch_requests(wanted: &Reservation, capacity: &FrameCapacity, sizes: &LaunchSizes) -> Requests {
    let pixels = capacity.pictures.pixels;
    let mut scratch = frame_requests(capacity, sizes);
    scratch.extend(wanted.occlusion.then_some(("depth_limits", pixels * 4)));
    scratch.extend((wanted.cut_outs > 0).then_some(("cut_outs", u64::from(wanted.cut_outs) * CUT_OUT_BYTES)));
    if wanted.pick {
        scratch.extend([("picks", pixels * 8), ("scene_firsts", u64::from(capacity.scenes) * 4)]);
    }
    if wanted.motion {
        scratch.extend([("motions", u64::from(capacity.visible) * 8), ("motion_sums", pixels * 8)]);
    }
    scratch
}

/// Refuses a buffer that kernels cannot bind, and names the field that makes it too large. Runs before any memory is freed.
fn check_bindings(
    context: &Context,
    requests: &Requests,
    (wanted, capacity): (&Reservation, &FrameCapacity),
    sizes: &LaunchSizes,
) -> Result<()> {
    let limit = context.limits().max_storage_buffer_range;
    let too_large = |field: String, needed| {
        Err(Error::TooLarge {
            what: field,
            needed,
            unit: "bytes",
            limit,
            limit_name: "maxStorageBufferRange",
        })
    };
    if wanted.staging_bytes > limit {
        return too_large(field_name("staging_bytes"), wanted.staging_bytes);
    }
    let Some(place) = requests.iter().position(|(_, bytes)| *bytes > limit) else { return Ok(()) };
    let (name, needed) = requests[place];
    if name == "cut_outs" {
        return too_large(field_name("cut_outs"), needed);
    }
    // Names the field that would shrink the buffer most at its smallest value.
    let pictures = PictureCapacity::of(1, 1).without_backward();
    let without = [
        ("width, height", FrameCapacity { pictures, ..*capacity }),
        ("instances", FrameCapacity { instances: 1, ..*capacity }),
        ("gaussians", FrameCapacity { gaussians: 1, visible: 1, ..*capacity }),
        ("scenes, views", FrameCapacity { scenes: 1, ..*capacity }),
    ];
    let bytes = |(_, less): &(_, FrameCapacity)| scratch_requests(wanted, less, sizes)[place].1;
    let field = without.iter().min_by_key(|less| bytes(less)).map_or("gaussians", |(field, _)| field);
    too_large(format!("{}: buffer '{name}'", field_name(field)), needed)
}

/// Returns the bytes of a group in one block.
fn group_bytes(requests: &Requests) -> u64 {
    let sizes: Vec<u64> = requests.iter().map(|(_, bytes)| *bytes).collect();
    let bytes: u64 = pack(&sizes, u64::MAX).map_or(u64::MAX, |packing| packing.blocks.iter().sum());
    bytes.checked_next_multiple_of(PLACEMENT_ALIGNMENT).unwrap_or(u64::MAX)
}

fn check_block(context: &Context, block: &Buffer, needed: u64) -> Result<()> {
    let what = || format!("block '{}' for frame slots", block.name());
    if !block.belongs_to(context) {
        return Err(Error::argument(what(), "it belongs to another context"));
    }
    if !block.handle().1.is_multiple_of(PLACEMENT_ALIGNMENT) {
        let problem = format!("begins at byte {}, no multiple of {PLACEMENT_ALIGNMENT}", block.handle().1);
        return Err(Error::argument(what(), problem));
    }
    if block.bytes() < needed {
        let (limit, limit_name) = (block.bytes(), "its size");
        return Err(Error::TooLarge { what: what(), needed, unit: "bytes", limit, limit_name });
    }
    Ok(())
}
