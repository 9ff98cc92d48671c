//! Memory of a training run: its Gaussians, and what fits beside a frame, computed before anything is allocated.

use super::checkpoint::Capacities;
use super::photos::{PhotoBytes, PhotoSize};
use super::schedule::{IterationPlan, TrainingRun, whole_instances};
use super::work::{ABSOLUTE_STATISTIC, GRADIENT_STATISTIC, Statistic};
use crate::error::{Error, Result};
use crate::frame::{
    FrameCapacity, LEAST_INSTANCES, LaunchSizes, PictureCapacity, SceneBuffers, ScenePlan, check_grids,
    frame_bytes, frame_fits_device, frame_requests, gaussians_with, initial_instances, initial_visible,
    max_trained_among, max_trained_gaussians, max_trained_instances, planes,
};
use crate::kernels::constants::PLANE_SH;
use crate::passes::adam::Moments;
use crate::render::{FrameStore, State};
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
    pub fn of_whole_frame(plan: &IterationPlan, run: &TrainingRun, drawn: &State) -> Self {
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
        let scaled = |most: u32| {
            let per_gaussian = u64::from(most) * u64::from(rows) / u64::from(before.max(1));
            (per_gaussian * 19 / 20).min(u32::MAX.into()) as u32
        };
        Self { visible: scaled(self.visible), instances: scaled(self.instances) }
    }
}

/// Sets of planes: parameters, two sets of moments, and the target of densification's gather.
const PLANE_SETS: u64 = 4;

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

/// Memory for the Gaussians of a run, apart from frames.
pub(super) struct RowMemory {
    /// All statistics, the gradient's first.
    pub statistics: Vec<Statistic>,
    parameter_gradients: bool,
    /// Memory kind of parameters, moments and the spare set.
    pub planes: MemoryKind,
}

impl RowMemory {
    /// `own`: statistics of the strategy. `planes`: memory of planes that a step reads sparsely.
    pub fn new(own: Vec<Statistic>, parameter_gradients: bool, planes: MemoryKind) -> Self {
        Self { statistics: [vec![GRADIENT_STATISTIC], own].concat(), parameter_gradients, planes }
    }

    /// Index of [`ABSOLUTE_STATISTIC`] among the statistics.
    pub fn absolute(&self) -> Option<usize> {
        self.statistics.iter().position(|statistic| *statistic == ABSOLUTE_STATISTIC)
    }

    fn statistics_requests(&self, capacity: u32) -> Requests {
        let bytes = |statistic: &Statistic| u64::from(capacity) * u64::from(statistic.floats) * 4;
        self.statistics.iter().map(|statistic| (statistic.name, bytes(statistic))).collect()
    }

    /// One buffer per chunk; none without terms that depend on the parameters directly.
    fn gradient_requests(&self, plan: &ScenePlan) -> Requests {
        let chunks = if self.parameter_gradients { plan.chunks as usize } else { 0 };
        // Geometry planes only: means with opacities, quaternions, scales.
        let bytes = u64::from(plan.chunk_gaussians) * u64::from(PLANE_SH) * 16;
        vec![("parameter_gradients", bytes); chunks]
    }

    /// Bytes of the buffers for a plan's capacity, without allocation padding: the cost of one capacity beside another.
    pub fn bytes(&self, plan: &ScenePlan) -> RowBytes {
        let others = self.statistics_requests(plan.capacity).into_iter().chain(self.gradient_requests(plan));
        let planes = PLANE_SETS * plan.chunk_bytes() * u64::from(plan.chunks);
        self.placed(planes, others.map(|(_, bytes)| bytes).sum())
    }

    /// Bytes of the buffers with allocation padding: the cost of a run before it starts.
    pub fn allocation_bytes(&self, context: &Context, plan: &ScenePlan) -> RowBytes {
        let statistics = context.allocation_bytes(&self.statistics_requests(plan.capacity));
        let gradients = context.allocation_bytes(&self.gradient_requests(plan));
        self.placed(PLANE_SETS * context.allocation_bytes(&planes::requests(plan)), statistics + gradients)
    }

    fn placed(&self, planes: u64, others: u64) -> RowBytes {
        match self.planes {
            MemoryKind::Offloaded => RowBytes { device: others, offloaded: planes },
            _ => RowBytes { device: planes + others, offloaded: 0 },
        }
    }
}

/// Gaussians on the device, with their moments and statistics.
pub(super) struct Model {
    pub scene: SceneBuffers,
    pub moments: Moments,
    /// Fourth set of planes: the target of densification's gather. Between changes of the set it holds the running means of the
    /// parameters.
    pub spare: Vec<Buffer>,
    /// Per Gaussian: see [`super::strategy::StepInputs::statistics`].
    pub statistics: Vec<Buffer>,
    /// Per chunk: see [`crate::passes::loss::TermInputs::parameter_gradients`].
    pub parameter_gradients: Vec<Buffer>,
}

impl Model {
    /// Allocates the buffers that belong to a scene, without clearing them.
    pub fn allocate(context: &Context, scene: SceneBuffers, rows: &RowMemory) -> Result<Self> {
        let planes = |arena| planes::allocate(context, (arena, rows.planes), &scene.plan);
        let moments = Moments { first: planes("moments")?, second: planes("moments")? };
        let spare = planes("spare")?;
        let statistics = rows.statistics_requests(scene.plan.capacity);
        let statistics = context.allocate("statistics", &statistics, MemoryKind::Device)?;
        let gradients = rows.gradient_requests(&scene.plan);
        let parameter_gradients = match gradients.is_empty() {
            true => Vec::new(),
            false => context.allocate("gradients", &gradients, MemoryKind::Device)?,
        };
        Ok(Self { scene, moments, spare, statistics, parameter_gradients })
    }

    /// Same as [`Model::allocate`], and clears moments and statistics.
    pub fn new(context: &Context, scene: SceneBuffers, rows: &RowMemory) -> Result<Self> {
        let model = Self::allocate(context, scene, rows)?;
        let Moments { first, second } = &model.moments;
        context.run_commands("clear moments", |r| {
            first.iter().chain(second).chain(&model.statistics).for_each(|buffer| r.fill(buffer, 0))
        })?;
        Ok(model)
    }

    /// The scene with other planes: moments, or means of parameters.
    pub fn with_planes(&self, chunks: &[Buffer]) -> SceneBuffers {
        SceneBuffers { chunks: chunks.to_vec(), ..self.scene.clone() }
    }

    /// Frees all memory and becomes empty; the caller replaces the model.
    pub fn release(&mut self) {
        self.scene.count = 0;
        let Self { scene, moments: Moments { first, second }, spare, statistics, parameter_gradients } = self;
        [&mut scene.chunks, first, second, spare, statistics, parameter_gradients]
            .into_iter()
            .for_each(Vec::clear);
    }
}

/// Properties of a training's frames that do not depend on the counts of Gaussians.
#[derive(Clone, Copy)]
pub(super) struct FrameShape {
    /// Large enough for all views.
    pub pictures: PictureCapacity,
    /// 2 with frozen Gaussians.
    pub scenes: u32,
    /// True if the backward pass accumulates absolute gradients.
    pub absolute: bool,
}

impl FrameShape {
    fn with_counts(self, gaussians: u32, visible: u32, instances: u32) -> FrameCapacity {
        let Self { pictures, scenes, absolute } = self;
        let backward = true;
        FrameCapacity {
            gaussians,
            visible,
            instances,
            scenes,
            pictures,
            backward,
            absolute,
            ..FrameCapacity::default()
        }
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
        shape: FrameShape,
    ) -> Option<FrameCapacity> {
        let visible = match self.frame_visible {
            0 => initial_visible(gaussians),
            before => before.min(gaussians),
        };
        let usual = initial_instances(context.limits(), gaussians, &shape.pictures);
        let instances = self.most_instances.saturating_mul(2).max(LEAST_INSTANCES).min(usual);
        (self.most_instances > 0).then(|| shape.with_counts(gaussians, visible, instances))
    }

    /// Frame capacity for a shape; None without a frame.
    pub(super) fn frame(&self, shape: FrameShape) -> Option<FrameCapacity> {
        let backward = self.backward != 0;
        (self.frame_width > 0).then(|| FrameCapacity {
            blend_passes: self.blend_passes.max(1),
            backward,
            absolute: shape.absolute && backward,
            ..shape.with_counts(self.frame_gaussians, self.frame_visible, self.frame_instances)
        })
    }
}

/// New capacity when `rows` do not fit: half more, up to the most that can be trained beside this many frozen
/// Gaussians.
pub(super) fn grown_capacity(context: &Context, rows: u32, frozen: u32) -> u32 {
    let most = max_trained_among(context.limits(), frozen);
    rows.saturating_add(rows / 2).min(most.max(rows))
}

/// Sizes of a training run whose Gaussians need more rows.
pub(super) struct RowGrowth<'a> {
    pub context: &'a Context,
    pub rows: &'a RowMemory,
    pub plan: &'a ScenePlan,
    pub frame: FrameCapacity,
    /// Current bytes of the frame buffers.
    pub frame_bytes: u64,
    /// Number of frozen Gaussians.
    pub frozen: u32,
}

impl RowGrowth<'_> {
    /// True if planes for `plan` and a frame of its capacity fit beside the current planes. Once those are freed, a frame with
    /// proportionally more visible Gaussians and instances must fit too.
    pub fn has_room(&self, plan: &ScenePlan) -> bool {
        let Self { context, rows, plan: old, frame, frame_bytes: old_frame, frozen } = self;
        let limits = context.limits();
        if plan.capacity > max_trained_among(limits, *frozen) {
            return false;
        }
        let (new, present) = (rows.bytes(plan), rows.bytes(old));
        if !new.is_offloadable(context) {
            return false;
        }
        let Some((limit, _)) = context.memory_limit() else { return true };
        let sizes = LaunchSizes::new(limits);
        let of = |plan: &ScenePlan| gaussians_with(plan.capacity, *frozen);
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
    pub fn most_rows_by_frames(&self, before: u32, peak: PeakCounts) -> u32 {
        if !self.holds(peak) {
            return before;
        }
        let instances = u64::from(max_trained_instances(self.context.limits())) * 3 / 4;
        let frozen = u64::from(self.frozen);
        let all = (u64::from(before) + frozen) * instances / u64::from(peak.instances.max(1));
        all.saturating_sub(frozen).clamp(before.into(), u32::MAX.into()) as u32
    }

    /// True if memory holds a frame with these peak counts.
    fn holds(&self, peak: PeakCounts) -> bool {
        let Some((limit, _)) = self.context.memory_limit() else { return true };
        let visible = peak.visible.min(self.frame.gaussians).max(self.frame.visible);
        let full =
            FrameCapacity { visible, instances: peak.instances.max(self.frame.instances), ..self.frame };
        let beside = self.context.held_bytes().saturating_sub(self.frame_bytes);
        full == self.frame || beside + frame_bytes(&full, &LaunchSizes::new(self.context.limits())) <= limit
    }
}

/// Sizes of a training run before its allocation.
pub(super) struct StartMemory<'a> {
    /// One per view.
    pub photos: &'a [PhotoSize],
    pub photo_bytes: PhotoBytes,
    pub rows: &'a RowMemory,
    /// Device buffers of the loss, for views of the given sizes.
    pub loss: &'a dyn Fn(&[Size]) -> Requests,
    /// Host-readable copy of the losses.
    pub losses: Request,
    /// Buffers of the poses; empty unless they are optimised.
    pub poses: Requests,
    /// Initial number of trained Gaussians.
    pub count: u32,
    /// Number of frozen Gaussians.
    pub frozen: u32,
    pub sh_degree: u32,
}

impl StartMemory<'_> {
    /// Bytes of all buffers, except those of the photographs, once the first iteration has fitted.
    fn buffer_bytes(&self, context: &Context, plan: &ScenePlan, frame: Option<FrameCapacity>) -> RowBytes {
        let limits = context.limits();
        let bytes = |requests: &[Request]| context.allocation_bytes(requests);
        // Counts of training frames and of drawn frames.
        let readback = 2 * bytes(&FrameStore::READBACK) + bytes(&[self.losses]);
        let frame = frame.map_or(0, |frame| bytes(&frame_requests(&frame, &LaunchSizes::new(limits))));
        let device = bytes(&(self.loss)(&self.sizes())) + readback + frame + bytes(&self.poses);
        // Frozen Gaussians have the plan's SH degree.
        let frozen = match ScenePlan::new(limits, self.frozen, plan.sh_degree) {
            Ok(plan) if self.frozen > 0 => bytes(&planes::requests(&plan)),
            _ => 0,
        };
        let others = RowBytes { device, offloaded: 0 };
        self.rows.allocation_bytes(context, plan) + self.rows.placed(frozen, 0) + others
    }

    fn sizes(&self) -> Vec<Size> {
        self.photos.iter().map(PhotoSize::size).collect()
    }

    /// Number of all initial Gaussians, trained and frozen.
    fn whole(&self) -> u32 {
        gaussians_with(self.count, self.frozen)
    }

    /// Shape of frames that are large enough for photographs of these sizes.
    fn shape(&self, sizes: &[Size]) -> FrameShape {
        let each = sizes.iter().map(|&(width, height)| PictureCapacity::of(width, height));
        FrameShape {
            pictures: each.fold(PictureCapacity::NONE, PictureCapacity::and),
            scenes: 1 + u32::from(self.frozen > 0),
            absolute: self.rows.absolute().is_some(),
        }
    }

    /// A frame for `capacity` trained Gaussians, of which up to `visible` are visible.
    fn frame(&self, context: &Context, capacity: u32, visible: u32, shape: FrameShape) -> FrameCapacity {
        let gaussians = gaussians_with(capacity, self.frozen);
        let visible = visible.min(gaussians);
        let instances = initial_instances(context.limits(), visible, &shape.pictures);
        shape.with_counts(gaussians, visible, instances)
    }

    /// Refuses photographs whose frames exceed a limit of the device, whatever the memory.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for the photograph with the largest need, with the size of its largest buffer.
    pub fn check_photos(&self, context: &Context) -> Result<()> {
        // The first photograph of each size, and the number of photographs with that size.
        let mut sizes: HashMap<Size, (&PhotoSize, usize)> = HashMap::new();
        for photo in self.photos {
            sizes.entry(photo.size()).or_insert((photo, 0)).1 += 1;
        }
        let refused = |(size, (photo, count))| Some((photo, self.check_size(context, size).err()?, count));
        let refused: Vec<(&PhotoSize, Error, usize)> = sizes.into_iter().filter_map(refused).collect();
        let all: usize = refused.iter().map(|(.., count)| count).sum();
        let most = refused.into_iter().max_by_key(|(photo, ..)| (photo.pixels(), photo.width));
        match most {
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
        let count = self.count.min(max_trained_among(limits, self.frozen));
        let visible = initial_visible(gaussians_with(count, self.frozen));
        let frame = self.frame(context, count, visible, self.shape(&[size]));
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
        let limit = if most[1].0 < most[0].0 { most[1] } else { most[0] };
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
        let Self { photos: all, ref photo_bytes, count, sh_degree, .. } = *self;
        let most = max_trained_among(context.limits(), self.frozen);
        if count > most {
            let needed = u64::from(count) + u64::from(self.frozen);
            let limit = (max_trained_gaussians(context.limits()).into(), "what maxStorageBufferRange holds");
            return Err(Error::too_large("the gradients of the scene", (needed, "Gaussians"), limit));
        }
        // The reserve delays the first reallocation by densification.
        let wanted = count.saturating_add(count / 2).max(1 << 12).min(most);
        let (limit, limit_name) = context.memory_limit().unwrap_or((u64::MAX, "no limit"));
        let held = context.held_bytes();
        let free = limit.saturating_sub(held);
        let shape = self.shape(&self.sizes());
        let buffers = |capacity: u32, visible: u32| -> Result<RowBytes> {
            let plan = ScenePlan::new(context.limits(), capacity, sh_degree)?;
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
        let least = buffers(count, whole)?;
        // If a frame of all does not fit, pictures may still show fewer.
        if fits(&least) || fits(&buffers(count, initial_visible(whole))?) {
            return Ok(count);
        }
        if !least.is_offloadable(context) {
            let what = format!("training {count} Gaussians of SH degree {sh_degree} in the host's memory");
            let limit = context.offload().unwrap_or(0).saturating_sub(context.memory_offloaded().bytes);
            return Err(Error::too_large(what, (least.offloaded, "bytes"), (limit, "--offload")));
        }
        let least = least.device;
        // A photograph budget of half the limit follows the total: all photographs, or half of the requested bytes.
        let follow = photo_bytes.budget == Some(limit / 2);
        let with_more = if follow { photo_bytes.all.min(least) + photo_bytes.staging } else { photos };
        let largest = all.iter().max_by_key(|photo| photo.pixels());
        let largest = largest.map_or_else(String::new, |photo| {
            format!(", the largest '{}' of {}x{} pixels", photo.name, photo.width, photo.height)
        });
        let among = match self.frozen {
            0 => String::new(),
            frozen => format!(" among {frozen} others"),
        };
        let what = format!(
            "training {count} Gaussians{among} of SH degree {sh_degree} on {} photographs{largest} (fewer or smaller ones (-r) \
             need less, or --photo-memory)",
            all.len()
        );
        // Includes the bytes already held, so that a limit of this value suffices.
        let needed = held + least + with_more.max(photos);
        Err(Error::too_large(what, (needed, "bytes"), (limit, limit_name)))
    }

    /// True if the capacities of an earlier run hold the Gaussians and fit here.
    pub fn holds(&self, context: &Context, earlier: &Capacities) -> bool {
        let limits = context.limits();
        let Ok(plan) = ScenePlan::new(limits, earlier.gaussians, self.sh_degree) else { return false };
        let sizes = LaunchSizes::new(limits);
        let frame = earlier.frame(self.shape(&self.sizes()));
        // No tile has more entries than the frame has instances.
        let passes = |frame: &FrameCapacity| frame.instances.div_ceil(sizes.entries_per_pass).max(1);
        let fits = frame.is_none_or(|frame| {
            frame.blend_passes <= passes(&frame) && frame_fits_device(limits, &frame, &sizes)
        });
        if !fits || !(self.count..=max_trained_among(limits, self.frozen)).contains(&earlier.gaussians) {
            return false;
        }
        let buffers = self.buffer_bytes(context, &plan, frame);
        let needed = buffers.device + self.photo_bytes.held;
        let free = |(limit, _): (u64, _)| limit.saturating_sub(context.held_bytes());
        buffers.is_offloadable(context) && context.memory_limit().is_none_or(|limit| needed <= free(limit))
    }
}

#[cfg(test)]
mod tests {
    use super::PeakCounts;

    #[test]
    fn what_frames_needed_before_a_reset_is_remembered_for_a_while() {
        // Five densifications while opacities recover lose a twentieth each: three quarters remain.
        let (mut most, mut rows) = (PeakCounts { visible: 50_000, instances: 1_000_000 }, 100_000);
        for _ in 0..5 {
            most = most.remembered(rows, rows / 20 * 21);
            rows = rows / 20 * 21;
        }
        for (most, range) in [(most.instances, 7.5..8.0), (most.visible, 0.375..0.4)] {
            let per_gaussian = f64::from(most) / f64::from(rows);
            assert!(range.contains(&per_gaussian), "{per_gaussian}");
        }
        let [least, largest] = [7, u32::MAX].map(|n| PeakCounts { visible: n, instances: n });
        assert_eq!(largest.remembered(1, 2), largest);
        assert_eq!(least.remembered(0, 0), PeakCounts::default());
    }
}
