//! Frames in flight. The memory of each is planned and allocated in advance.

use super::frame_store::State;
use crate::error::{Error, Result};
use crate::forward::BlendVariant;
use crate::kernels::constants as c;
use crate::plan::{
    FrameBuffers, FrameCapacity, LaunchSizes, PictureCapacity, ScenePlan, check_grids, frame_requests,
    initial_instances,
};
use crate::vk::{Buffer, Context, ForeignCommands, MemoryKind, RecordSlot, Recorder, ScopeTime};

/// What is allocated in advance for recording: see [`super::Renderer::reserve`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reservation {
    /// Frames in flight.
    pub slots: u32,
    /// Gaussians of all scenes of a frame together.
    pub gaussians: u32,
    /// Scenes of a frame.
    pub scenes: u32,
    /// Highest SH degree of the scenes.
    pub sh_degree: u32,
    /// (tile, Gaussian) instances of a frame; 0 for an estimate. [`SlotReport`] has the number that a frame
    /// needs.
    pub instances: u32,
    /// Width of the largest picture, pixels. Pictures of any shape fit that need no more pixels and no more tiles
    /// of 16×16 pixels, for example the same size turned by 90 degrees.
    pub width: u32,
    /// Height of the largest picture, pixels: see [`Reservation::width`].
    pub height: u32,
    /// Passes of blending. More than one is only needed if a driver's limit on loops cuts off very long
    /// tiles.
    pub blend_passes: u32,
    /// Whether frames will render the sum of weights / z.
    pub inverse_depth: bool,
    /// Whether frames will render expected depth.
    pub expected_depth: bool,
    /// Whether frames will read a host's depth image.
    pub occlusion: bool,
    /// Whether frames will draw scenes with a 3D filter ([`RenderSettings::filter_3d`](crate::RenderSettings::filter_3d)).
    pub filter_3d: bool,
    /// Bytes of staging memory for the [`super::Update`]s of a frame: see [`Reservation::update_bytes`].
    pub staging_bytes: u64,
}

impl Reservation {
    /// A reservation for one frame in flight of one scene, with all options off.
    pub fn new(gaussians: u32, sh_degree: u32, width: u32, height: u32) -> Self {
        Self {
            slots: 1,
            gaussians,
            scenes: 1,
            sh_degree,
            instances: 0,
            width,
            height,
            blend_passes: 1,
            inverse_depth: false,
            expected_depth: false,
            occlusion: false,
            filter_3d: false,
            staging_bytes: 0,
        }
    }

    /// Staging bytes of an update of `gaussians` Gaussians of a scene of this degree.
    pub fn update_bytes(gaussians: u32, sh_degree: u32) -> u64 {
        u64::from(gaussians) * u64::from(crate::plan::parameter_planes(sh_degree)) * 16
    }

    /// A copy of the reservation that fits what a frame needed; unchanged if the frame fitted.
    pub fn grown(&self, report: &SlotReport) -> Self {
        let mut grown = *self;
        if report.instances_needed > report.instance_capacity {
            // With a reserve of half: the next frames will need a different number.
            grown.instances = report.instances_needed.saturating_add(report.instances_needed / 2);
        }
        grown.blend_passes = self.blend_passes.max(report.blend_passes_needed);
        grown
    }

    fn check(&self) -> Result<()> {
        let sides = 1..=crate::scene::camera::MAX_IMAGE_SIDE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            let problem = format!("a picture of {} x {} pixels", self.width, self.height);
            return Err(Error::argument("reservation", problem));
        }
        if self.slots == 0 || self.scenes == 0 || self.blend_passes == 0 {
            return Err(Error::argument("reservation", "no slots, scenes or blending passes"));
        }
        // Above the instances of any device.
        let most = [
            ("slots", self.slots, 1024),
            ("scenes", self.scenes, 65_536),
            ("blending passes", self.blend_passes, 65_536),
        ];
        if let Some((what, count, most)) = most.into_iter().find(|&(_, count, most)| count > most) {
            return Err(Error::argument("reservation", format!("{count} {what}, there may be {most}")));
        }
        if self.sh_degree > 3 {
            return Err(Error::argument("reservation", format!("SH degree {} is above 3", self.sh_degree)));
        }
        Ok(())
    }

    /// The variants of blending that frames may use.
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
        // Any frame may draw ellipsoids.
        let steep = variants.clone().into_iter();
        variants.extend(steep.map(|v| BlendVariant { steep: true, ..v }));
        if self.filter_3d {
            let filtered = variants.clone().into_iter();
            variants.extend(filtered.map(|v| BlendVariant { filter_3d: true, ..v }));
        }
        variants
    }

    /// Most dispatches of a frame.
    pub(super) fn dispatches(&self, context: &Context) -> Result<usize> {
        const PER_FRAME: u32 = 48;
        // Scenes may be stored at a higher degree than the evaluated one, in more chunks.
        let plan = ScenePlan::new(context.limits(), self.gaussians, 3)
            .or_else(|_| ScenePlan::new(context.limits(), self.gaussians, self.sh_degree))?;
        // Per chunk of parameters: culling and projection. Per scene: the ranges of its chunks.
        let projection = 2 * (plan.chunks + self.scenes) + self.scenes;
        let blending = LaunchSizes::new(context.limits()).blend_dispatches(self.instances, self.blend_passes);
        Ok((PER_FRAME + blending + projection) as usize)
    }
}

/// The counts of a recorded frame that has finished.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct SlotReport {
    /// Gaussians in the frame's scenes.
    pub gaussians: u32,
    /// Visible Gaussians.
    pub visible: u32,
    /// (tile, Gaussian) instances that the picture needs.
    pub instances_needed: u32,
    /// The frame's capacity in instances.
    pub instance_capacity: u32,
    /// Entries of the longest tile.
    pub longest_tile: u32,
    /// Passes of blending that the longest tile needs.
    pub blend_passes_needed: u32,
    /// Whether a capacity was too small. The picture then lacks the Gaussians farthest away, or all of them
    /// if `instances_needed` is `u32::MAX`. [`Reservation::grown`] fixes the first case.
    pub overflow: bool,
    /// Device time per stage; empty without timestamps.
    pub scopes: Vec<ScopeTime>,
}

/// The memory of one frame in flight.
pub(super) struct Slot {
    pub record: RecordSlot,
    pub frame: FrameBuffers,
    pub capacity: FrameCapacity,
    /// 1/z per pixel.
    pub depth_limits: Option<Buffer>,
    pub staging: Option<Buffer>,
    readback: Buffer,
    /// Gaussians of the last recording.
    gaussians: u32,
    /// The report of the last recording, once it has been requested.
    report: Option<SlotReport>,
}

/// All frames in flight.
#[derive(Default)]
pub(super) struct Slots {
    pub reserved: Option<Reservation>,
    pub slots: Vec<Slot>,
}

impl Slots {
    /// Allocates a reservation, which replaces the current one.
    pub fn reserve(&mut self, context: &Context, sizes: &LaunchSizes, wanted: &Reservation) -> Result<()> {
        wanted.check()?;
        for slot in &self.slots {
            if !slot.record.finished()? {
                return Err(Error::argument("frame slots", "one is still in flight: wait for it first"));
            }
        }
        let dispatches = wanted.dispatches(context)?;
        // The old memory is freed first: both at once might not fit.
        self.slots.clear();
        self.reserved = None;
        for _ in 0..wanted.slots {
            self.slots.push(Slot::new(context, sizes, wanted, dispatches)?);
        }
        self.reserved = Some(*wanted);
        Ok(())
    }

    /// The slot with an index.
    pub fn get(&mut self, index: u32) -> Result<&mut Slot> {
        let count = self.slots.len();
        self.slots.get_mut(index as usize).ok_or_else(|| {
            Error::argument("frame slot", format!("{index}: {count} are reserved; call Renderer::reserve"))
        })
    }
}

impl Slot {
    fn new(context: &Context, sizes: &LaunchSizes, wanted: &Reservation, dispatches: usize) -> Result<Self> {
        // Gaps between scenes are smaller than a block.
        let gaussians =
            wanted.gaussians.saturating_add((wanted.scenes - 1).saturating_mul(sizes.elementwise_workgroup));
        let pictures = PictureCapacity::of(wanted.width, wanted.height).without_backward();
        let instances = match wanted.instances {
            0 => initial_instances(context.limits(), gaussians, &pictures),
            instances => instances,
        };
        let capacity = FrameCapacity {
            gaussians,
            instances,
            scenes: wanted.scenes,
            pictures,
            blend_passes: wanted.blend_passes,
            backward: false,
            absolute: false,
        };
        check_grids(context.limits(), &capacity, sizes)?;
        let frame = context.allocate("frame slot", &frame_requests(&capacity, sizes), MemoryKind::Device)?;
        let limits = wanted.occlusion.then_some(("depth_limits", pictures.pixels * 4));
        let limits: Vec<_> = limits.into_iter().collect();
        let mut host = vec![("state_readback", u64::from(c::STATE_WORDS) * 4)];
        host.extend((wanted.staging_bytes > 0).then_some(("scene_updates", wanted.staging_bytes)));
        let depth_limits = context.allocate("frame slot", &limits, MemoryKind::Device)?.pop();
        let mut host = context.allocate("frame slot host", &host, MemoryKind::HostVisible)?.into_iter();
        let Some(readback) = host.next() else { unreachable!("one buffer per request") };
        let frame = FrameBuffers::from_allocated(frame);
        let (record, staging) = (RecordSlot::new(context, dispatches)?, host.next());
        Ok(Self { record, frame, capacity, depth_limits, staging, readback, gaussians: 0, report: None })
    }

    /// Begins a recording with `gaussians` Gaussians.
    pub fn begin(&mut self, commands: ForeignCommands, gaussians: u32) -> Result<Recorder> {
        let recorder = self.record.begin(commands, "ashsplat")?;
        (self.gaussians, self.report) = (gaussians, None);
        Ok(recorder)
    }

    /// Records the copy of the frame's counts to host-readable memory, and ends the recording.
    pub fn end(&mut self, mut recorder: Recorder) -> Result<()> {
        self.record_counts(&mut recorder);
        self.record.end(recorder)
    }

    /// The report of the last recording: None while it is in flight, and without a recording.
    pub fn report(&mut self, sizes: &LaunchSizes) -> Result<Option<SlotReport>> {
        if !self.record.is_recorded() || !self.record.finished()? {
            return Ok(None);
        }
        if self.report.is_some() || !self.record.has_times()? {
            return Ok(self.report.clone());
        }
        self.report = Some(SlotReport { scopes: self.record.times()?, ..self.counts(sizes)? });
        Ok(self.report.clone())
    }

    /// Records the copy of the frame's counts to host-readable memory.
    pub fn record_counts(&self, recorder: &mut Recorder) {
        recorder.copy(&self.frame.state, &self.readback);
    }

    /// The counts of a frame that has finished.
    pub fn counts(&self, sizes: &LaunchSizes) -> Result<SlotReport> {
        let mut bytes = [0u8; c::STATE_WORDS as usize * 4];
        self.readback.read(0, &mut bytes)?;
        let state = State::of(&bytes);
        Ok(SlotReport {
            gaussians: self.gaussians,
            visible: state.visible,
            instances_needed: state.instances,
            instance_capacity: self.capacity.instances,
            longest_tile: state.longest_tile,
            blend_passes_needed: state.longest_tile.div_ceil(sizes.entries_per_pass).max(1),
            overflow: state.overflow,
            scopes: Vec::new(),
        })
    }
}
