//! Memory of a training run: its Gaussians, and what fits beside a frame, computed before anything is allocated.

use super::checkpoint::Capacities;
use super::parts::{BuiltParts, Forecast};
use super::photos::{PhotoBytes, PhotoSize};
use super::poses;
use super::schedule::{IterationPlan, TrainingRun, whole_instances};
use super::settings::{MomentsType, TrainSettings};
use super::step::StepRecorder;
use crate::error::{Error, Result};
use crate::frame::{
    FrameBuffers, FrameCapacity, LaunchSizes, MIN_INSTANCES, PictureCapacity, SceneBuffers, ScenePlan,
    ShStorage, check_grids, frame_fits_device, gaussians_with, initial_instances, initial_visible,
    max_trained_among, max_trained_gaussians, planes,
};
use crate::kernels::constants::PLANE_SH;
use crate::passes::adam::Moments;
use crate::passes::filter_3d::Filter3d;
use crate::render::{FrameCounts, FrameStore};
use crate::vk::{Buffer, Context, MemoryKind};
use std::collections::HashMap;

/// Name and bytes of a buffer.
type Request = (&'static str, u64);
type Requests = Vec<Request>;
/// Width and height, pixels.
type Size = (u32, u32);

/// Peak counts of the frames so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PeakCounts {
    pub visible: u32,
    /// (tile, Gaussian) pairs.
    pub instances: u32,
}

impl PeakCounts {
    /// Estimates the counts of a full-size frame from those of the drawn frame.
    pub fn of_whole_frame(plan: &IterationPlan, run: &TrainingRun, drawn: &FrameCounts) -> Self {
        let (visible, instances) = (drawn.visible_needed, drawn.all_instances());
        let camera = &run.cameras[plan.view];
        Self { visible, instances: whole_instances(camera, &plan.camera, instances, visible) }
    }

    pub fn max(self, other: Self) -> Self {
        Self { visible: self.visible.max(other.visible), instances: self.instances.max(other.instances) }
    }

    /// Peak counts to keep after a densification from `before` to `rows` Gaussians: the same per Gaussian, less a twentieth.
    /// Frames after an opacity reset have few instances for a while, then as many as before.
    pub fn remembered(self, before: u32, rows: u32) -> Self {
        let scaled = |max: u32| {
            let per_gaussian = u64::from(max) * u64::from(rows) / u64::from(before.max(1));
            (per_gaussian * 19 / 20).min(u32::MAX.into()) as u32
        };
        Self { visible: scaled(self.visible), instances: scaled(self.instances) }
    }
}

/// Bytes on the device and offloaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowBytes {
    pub device: u64,
    pub offloaded: u64,
}

impl RowBytes {
    /// True if the offloaded bytes fit beside those already offloaded.
    pub fn is_offloadable(&self, context: &Context) -> bool {
        let there = context.memory_offloaded().bytes;
        context.offload().is_none_or(|bound| there + self.offloaded <= bound)
    }
}

impl std::ops::Add for RowBytes {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { device: self.device + other.device, offloaded: self.offloaded + other.offloaded }
    }
}

/// Bytes per Gaussian of [`Model::statistics`].
pub(super) const STATISTICS_BYTES: u64 = 8;

/// Memory for the Gaussians of a run, apart from frames.
pub(super) struct RowMemory {
    parameter_gradients: bool,
    /// Memory kind of parameters and moments.
    pub planes: MemoryKind,
    packed_moments: bool,
    sh_storage: ShStorage,
}

impl RowMemory {
    /// `planes`: memory of planes that a step reads sparsely.
    pub fn new(parameter_gradients: bool, planes: MemoryKind, settings: &TrainSettings) -> Self {
        Self {
            parameter_gradients,
            planes,
            packed_moments: settings.moments == MomentsType::Packed,
            sh_storage: settings.sh_storage,
        }
    }

    /// Plan of a set of Gaussians.
    pub fn plan(&self, context: &Context, capacity: u32, sh_degree: u32) -> Result<ScenePlan> {
        ScenePlan::new(context.limits(), capacity, sh_degree, self.sh_storage)
    }

    /// One buffer per chunk; none without terms that depend on the parameters directly.
    fn gradient_requests(&self, plan: &ScenePlan) -> Requests {
        let chunks = if self.parameter_gradients { plan.chunks as usize } else { 0 };
        // Geometry planes only: means with opacities, quaternions, scales.
        let bytes = u64::from(plan.chunk_gaussians) * u64::from(PLANE_SH) * 16;
        vec![("parameter_gradients", bytes); chunks]
    }

    /// Parameters and the sets of moments: each is an allocation.
    fn plane_requests(&self, plan: &ScenePlan) -> Vec<Requests> {
        let (moments, sets) = Moments::sets_of(plan, self.packed_moments);
        let moments = std::iter::repeat_n(planes::requests(&moments), sets);
        std::iter::once(planes::requests(plan)).chain(moments).collect()
    }

    /// Bytes of the buffers for a plan's capacity, without allocation padding: the cost of one capacity beside another.
    pub fn bytes(&self, plan: &ScenePlan) -> RowBytes {
        let sum = |requests: Requests| requests.iter().map(|(_, bytes)| bytes).sum::<u64>();
        let others = sum(statistics_request(plan).into()) + sum(self.gradient_requests(plan));
        self.placed(sum(self.plane_requests(plan).concat()), others)
    }

    /// Bytes of the buffers with allocation padding: the cost of a run before it starts.
    pub fn allocation_bytes(&self, context: &Context, plan: &ScenePlan) -> RowBytes {
        let statistics = context.allocation_bytes(&statistics_request(plan));
        let gradients = context.allocation_bytes(&self.gradient_requests(plan));
        let planes = self.plane_requests(plan);
        let planes = planes.iter().map(|requests| context.allocation_bytes(requests)).sum();
        self.placed(planes, statistics + gradients)
    }

    fn placed(&self, planes: u64, others: u64) -> RowBytes {
        match self.planes {
            MemoryKind::Offloaded => RowBytes { device: others, offloaded: planes },
            _ => RowBytes { device: planes + others, offloaded: 0 },
        }
    }
}

fn statistics_request(plan: &ScenePlan) -> [Request; 1] {
    [("statistics", u64::from(plan.capacity) * STATISTICS_BYTES)]
}

/// Gaussians on the device, with their moments and statistics.
#[derive(Clone)]
pub(super) struct Model {
    pub scene: SceneBuffers,
    pub moments: Moments,
    /// One buffer, none once released: see [`Population::statistics`](super::Population::statistics).
    pub statistics: Vec<Buffer>,
    /// Per chunk: see [`crate::passes::loss::TermInputs::parameter_gradients`].
    pub parameter_gradients: Vec<Buffer>,
}

impl Model {
    /// Allocates the buffers that belong to a scene, without clearing them.
    pub fn allocate(context: &Context, scene: SceneBuffers, rows: &RowMemory) -> Result<Self> {
        let (plan, sets) = Moments::sets_of(&scene.plan, rows.packed_moments);
        let sets = (0..sets).map(|_| planes::allocate(context, "moments", rows.planes, &plan));
        let moments = Moments { packed: rows.packed_moments, plan, sets: sets.collect::<Result<_>>()? };
        let statistics = statistics_request(&scene.plan);
        let statistics = context.allocate("statistics", &statistics, MemoryKind::Device)?;
        let gradients = rows.gradient_requests(&scene.plan);
        let parameter_gradients = match gradients.is_empty() {
            true => Vec::new(),
            false => context.allocate("gradients", &gradients, MemoryKind::Device)?,
        };
        Ok(Self { scene, moments, statistics, parameter_gradients })
    }

    /// Same as [`Model::allocate`], and clears moments and statistics.
    pub fn new(context: &Context, scene: SceneBuffers, rows: &RowMemory) -> Result<Self> {
        let model = Self::allocate(context, scene, rows)?;
        let moments = model.moments.sets.iter().flatten();
        context.run("clear moments", |r| {
            moments.chain(&model.statistics).for_each(|buffer| r.fill(buffer, 0))
        })?;
        Ok(model)
    }

    /// The sets of moments, each like a scene.
    pub fn moment_planes(&self) -> impl Iterator<Item = SceneBuffers> {
        let (plan, count) = (self.moments.plan, self.scene.count);
        self.moments.sets.iter().map(move |chunks| SceneBuffers { chunks: chunks.clone(), plan, count })
    }

    /// Frees all memory and becomes empty; the caller replaces the model.
    pub fn release(&mut self) {
        self.scene.count = 0;
        let Self { scene, moments, statistics, parameter_gradients } = self;
        let others = [&mut scene.chunks, statistics, parameter_gradients];
        others.into_iter().chain(&mut moments.sets).for_each(Vec::clear);
    }
}

/// Returns the capacity of a training's frames, except for the counts. `scenes`: 2 with frozen Gaussians.
pub(super) fn frame_shape(pictures: PictureCapacity, scenes: u32, recorder: &StepRecorder) -> FrameCapacity {
    FrameCapacity {
        pictures,
        scenes,
        backward: true,
        absolute: recorder.absolute,
        camera_sums: recorder.differentiates_cameras(),
        depth: recorder.base_settings().inverse_depth,
        trained: true,
        ..FrameCapacity::default()
    }
}

impl Capacities {
    /// Peak counts of the run's frames.
    pub(super) fn peak(&self) -> PeakCounts {
        PeakCounts { visible: self.most_visible, instances: self.most_instances }
    }

    /// Initial frame capacity when the checkpoint's does not apply, as after an exchange of blocks. Holds twice the peak number
    /// of instances, and the earlier capacity of visible Gaussians. None if there was no frame.
    pub(super) fn first_frame(
        &self,
        context: &Context,
        gaussians: u32,
        shape: FrameCapacity,
    ) -> Option<FrameCapacity> {
        let visible = match self.frame_visible {
            0 => initial_visible(gaussians),
            before => before.min(gaussians),
        };
        let usual = initial_instances(context.limits(), gaussians, &shape.pictures);
        let instances = self.most_instances.saturating_mul(2).max(MIN_INSTANCES).min(usual);
        (self.most_instances > 0).then_some(FrameCapacity { gaussians, visible, instances, ..shape })
    }

    /// Frame capacity for a shape; None without a frame.
    pub(super) fn frame(&self, shape: FrameCapacity) -> Option<FrameCapacity> {
        (self.frame_instances > 0).then(|| FrameCapacity {
            gaussians: self.frame_gaussians,
            visible: self.frame_visible,
            instances: self.frame_instances,
            blend_passes: self.blend_passes.max(1),
            ..shape
        })
    }
}

/// Memory of a training run before its allocation.
#[derive(Clone, Copy)]
pub(super) struct StartMemory<'a> {
    pub of: Forecast<'a>,
    pub parts: &'a BuiltParts,
    pub photo_bytes: PhotoBytes,
}

impl StartMemory<'_> {
    /// Bytes of all buffers, except those of the photographs, once the first iteration has fitted.
    fn buffer_bytes(&self, context: &Context, plan: &ScenePlan, frame: Option<FrameCapacity>) -> RowBytes {
        let limits = context.limits();
        let bytes = |requests: &[Request]| context.allocation_bytes(requests);
        // Counts of training frames and of drawn frames.
        let readback = 2 * bytes(&FrameStore::READBACK) + bytes(&[self.parts.recorder.readback_request()]);
        let scratch = self.parts.recorder.scratch_requests(&self.sizes());
        let frame = frame.map_or(0, |frame| {
            let (requests, lives) = FrameBuffers::requests_with(&frame, &LaunchSizes::new(limits), &scratch);
            context.shared_bytes(&requests, &lives)
        });
        let poses = poses::requests(self.of.settings, self.of.photos.len());
        let device = bytes(&self.loss_requests(&self.sizes())) + readback + frame + bytes(&poses);
        // Frozen Gaussians have the plan's SH degree.
        let frozen = match self.parts.rows.plan(context, self.of.frozen, plan.sh_degree) {
            Ok(plan) if self.of.frozen > 0 => bytes(&planes::requests(&plan)),
            _ => 0,
        };
        let others = RowBytes { device, offloaded: 0 };
        self.parts.rows.allocation_bytes(context, plan) + self.parts.rows.placed(frozen, 0) + others
    }

    /// Device buffers of the loss and of the 3D filter, for views of these sizes.
    fn loss_requests(&self, sizes: &[Size]) -> Requests {
        let filter = self.of.settings.filter_3d.then(|| Filter3d::requests(sizes.len()));
        self.parts.recorder.device_requests(sizes).into_iter().chain(filter.into_iter().flatten()).collect()
    }

    fn sizes(&self) -> Vec<Size> {
        self.of.photos.iter().map(PhotoSize::size).collect()
    }

    /// Number of all initial Gaussians, trained and frozen.
    fn whole(&self) -> u32 {
        gaussians_with(self.of.gaussians, self.of.frozen)
    }

    /// Shape of frames that are large enough for photographs of these sizes.
    fn shape(&self, sizes: &[Size]) -> FrameCapacity {
        let each = sizes.iter().map(|&(width, height)| PictureCapacity::of(width, height));
        let pictures = each.fold(PictureCapacity::NONE, PictureCapacity::and);
        frame_shape(pictures, 1 + u32::from(self.of.frozen > 0), &self.parts.recorder)
    }

    /// A frame for `capacity` trained Gaussians, of which up to `visible` are visible.
    fn frame(&self, context: &Context, capacity: u32, visible: u32, shape: FrameCapacity) -> FrameCapacity {
        let gaussians = gaussians_with(capacity, self.of.frozen);
        let visible = visible.min(gaussians);
        let instances = initial_instances(context.limits(), visible, &shape.pictures);
        FrameCapacity { gaussians, visible, instances, ..shape }
    }

    /// Refuses photographs whose frames exceed a limit of the device, whatever the memory. Names the one with the largest need.
    pub fn check_photos(&self, context: &Context) -> Result<()> {
        // The first photograph of each size, and the number of photographs with that size.
        let mut sizes: HashMap<Size, (&PhotoSize, usize)> = HashMap::new();
        for photo in self.of.photos {
            sizes.entry(photo.size()).or_insert((photo, 0)).1 += 1;
        }
        let refused = |(size, (photo, count))| Some((photo, self.check_size(context, size).err()?, count));
        let refused: Vec<(&PhotoSize, Error, usize)> = sizes.into_iter().filter_map(refused).collect();
        let all: usize = refused.iter().map(|(.., count)| count).sum();
        let largest = refused.into_iter().max_by_key(|(photo, ..)| (photo.pixels(), photo.width));
        match largest {
            None => Ok(()),
            Some((photo, error, _)) => {
                let others = match all - 1 {
                    0 => String::new(),
                    1 => " and 1 other".into(),
                    more => format!(" and {more} others"),
                };
                let PhotoSize { name, width, height, .. } = photo;
                Err(error.of_field(format!(
                    "training on the photograph '{name}' of {width}x{height} pixels{others} (-r scales photographs down)"
                )))
            }
        }
    }

    /// Checks that the device supports the buffers and grids of a frame of this size.
    fn check_size(&self, context: &Context, size: Size) -> Result<()> {
        let limits = context.limits();
        let count = self.of.gaussians.min(max_trained_among(limits, self.of.frozen));
        let visible = initial_visible(gaussians_with(count, self.of.frozen));
        let frame = self.frame(context, count, visible, self.shape(&[size]));
        let launches = LaunchSizes::new(limits);
        let named = |arena: &'static str, requests: Requests| {
            requests.into_iter().map(move |(name, bytes)| (arena, name, bytes))
        };
        let requests = named("frame", FrameBuffers::requests(&frame, &launches))
            .chain(named("frame", self.parts.recorder.scratch_requests(&[size])))
            .chain(named("loss", self.loss_requests(&[size])));
        let bounds = [
            (limits.max_storage_buffer_range, "maxStorageBufferRange"),
            (limits.max_allocation_bytes, "maxMemoryAllocationSize"),
        ];
        let limit = if bounds[1].0 < bounds[0].0 { bounds[1] } else { bounds[0] };
        match requests.max_by_key(|(.., bytes)| *bytes) {
            Some((arena, name, needed)) if needed > limit.0 => {
                Err(Error::too_large(format!("buffer {arena}.{name}"), (needed, "bytes"), limit))
            }
            _ => check_grids(limits, &frame, &launches),
        }
    }

    /// Initial capacity in Gaussians: half more than the initial ones, or just those if memory is short.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if even the initial Gaussians do not fit, with bytes that suffice if pictures show all of them.
    pub fn initial_capacity(&self, context: &Context) -> Result<u32> {
        let Self { of: Forecast { photos: all, gaussians: count, settings, .. }, photo_bytes, .. } = *self;
        let sh_degree = settings.sh_degree;
        let max = max_trained_among(context.limits(), self.of.frozen);
        if count > max {
            let needed = u64::from(count) + u64::from(self.of.frozen);
            let limit = (max_trained_gaussians(context.limits()).into(), "what maxStorageBufferRange holds");
            return Err(Error::too_large("the gradients of the scene", (needed, "Gaussians"), limit));
        }
        // The reserve delays the first reallocation by densification.
        let wanted = count.saturating_add(count / 2).max(1 << 12).min(max);
        let (limit, limit_name) = context.memory_limit().unwrap_or((u64::MAX, "no limit"));
        let held = context.held_bytes();
        let free = limit.saturating_sub(held);
        let shape = self.shape(&self.sizes());
        let buffers = |capacity: u32, visible: u32| -> Result<RowBytes> {
            let plan = self.parts.rows.plan(context, capacity, sh_degree)?;
            let frame = self.frame(context, capacity, visible, shape);
            Ok(self.buffer_bytes(context, &plan, Some(frame)))
        };
        let photos = photo_bytes.held + photo_bytes.staging;
        let fits = |of: &RowBytes| of.device + photos <= free && of.is_offloadable(context);
        // A frame starts with a capacity for part of the Gaussians. The reserve must leave memory for a frame of all of them.
        let whole = self.whole();
        if fits(&buffers(wanted, whole)?) {
            return Ok(wanted);
        }
        let minimal = buffers(count, whole)?;
        // If a frame of all does not fit, pictures may still show fewer.
        if fits(&minimal) || fits(&buffers(count, initial_visible(whole))?) {
            return Ok(count);
        }
        if !minimal.is_offloadable(context) {
            let what = format!("training {count} Gaussians of SH degree {sh_degree} in the host's memory");
            let limit = context.offload().unwrap_or(0).saturating_sub(context.memory_offloaded().bytes);
            return Err(Error::too_large(what, (minimal.offloaded, "bytes"), (limit, "--offload")));
        }
        let minimal = minimal.device;
        // A photograph budget of half the limit follows the total: all photographs, or half of the requested bytes.
        let follow = photo_bytes.budget == Some(limit / 2);
        let with_more = if follow { photo_bytes.all.min(minimal) + photo_bytes.staging } else { photos };
        let largest = all.iter().max_by_key(|photo| photo.pixels());
        let largest = largest.map_or_else(String::new, |photo| {
            format!(", the largest '{}' of {}x{} pixels", photo.name, photo.width, photo.height)
        });
        let among = match self.of.frozen {
            0 => String::new(),
            frozen => format!(" among {frozen} others"),
        };
        let what = format!(
            "training {count} Gaussians{among} of SH degree {sh_degree} on {} photographs{largest} (fewer or smaller ones (-r) \
             need less, or --photo-memory)",
            all.len()
        );
        // Includes the bytes already held, so that a limit of this value suffices.
        let needed = held + minimal + with_more.max(photos);
        Err(Error::too_large(what, (needed, "bytes"), (limit, limit_name)))
    }

    /// True if the capacities of an earlier run hold the Gaussians and fit here.
    pub fn holds(&self, context: &Context, earlier: &Capacities) -> bool {
        let limits = context.limits();
        let Ok(plan) = self.parts.rows.plan(context, earlier.gaussians, self.of.settings.sh_degree) else {
            return false;
        };
        let sizes = LaunchSizes::new(limits);
        let frame = earlier.frame(self.shape(&self.sizes()));
        // No tile has more entries than the frame has instances.
        let passes = |frame: &FrameCapacity| frame.instances.div_ceil(sizes.entries_per_pass).max(1);
        let fits = frame.is_none_or(|frame| {
            frame.blend_passes <= passes(&frame) && frame_fits_device(limits, &frame, &sizes)
        });
        if !fits
            || !(self.of.gaussians..=max_trained_among(limits, self.of.frozen)).contains(&earlier.gaussians)
        {
            return false;
        }
        let buffers = self.buffer_bytes(context, &plan, frame);
        let needed = buffers.device + self.photo_bytes.held;
        let free = |(limit, _): (u64, _)| limit.saturating_sub(context.held_bytes());
        buffers.is_offloadable(context) && context.memory_limit().is_none_or(|limit| needed <= free(limit))
    }
}
