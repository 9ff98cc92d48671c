//! State that a training run changes: Gaussians, moments and statistics on the device, progress on the host.

use super::checkpoint::Checkpoint;
use super::iteration::Progress;
use super::needs::Needs;
use super::work::{ABSOLUTE_STATISTIC, GRADIENT_STATISTIC, Statistic};
use crate::error::{Error, Result};
use crate::forward::SceneBuffers;
use crate::kernels::constants::PLANE_SH;
use crate::optimizer::Moments;
use crate::plan::ScenePlan;
use crate::planes;
use crate::vk::{Buffer, Context, MemoryKind};

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
    statistics: Vec<Statistic>,
    parameter_gradients: bool,
    planes: MemoryKind,
}

impl RowMemory {
    /// `own`: statistics of the strategy. `planes`: memory of planes that a step reads sparsely.
    pub fn new(own: Vec<Statistic>, parameter_gradients: bool, planes: MemoryKind) -> Self {
        Self { statistics: [vec![GRADIENT_STATISTIC], own].concat(), parameter_gradients, planes }
    }

    /// Memory kind of parameters, moments and the spare set.
    pub fn planes(&self) -> MemoryKind {
        self.planes
    }

    /// All statistics, the gradient's first.
    pub fn statistics(&self) -> &[Statistic] {
        &self.statistics
    }

    /// Index of [`ABSOLUTE_STATISTIC`] among the statistics.
    pub fn absolute(&self) -> Option<usize> {
        self.statistics.iter().position(|statistic| *statistic == ABSOLUTE_STATISTIC)
    }

    fn statistics_requests(&self, capacity: u32) -> Vec<(&'static str, u64)> {
        let bytes = |statistic: &Statistic| u64::from(capacity) * u64::from(statistic.floats) * 4;
        self.statistics.iter().map(|statistic| (statistic.name, bytes(statistic))).collect()
    }

    fn gradient_requests(&self, plan: &ScenePlan) -> Vec<(&'static str, u64)> {
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
        let bytes = |requests: &[(&'static str, u64)]| context.allocation_bytes(requests);
        let gradients = self.gradient_requests(plan);
        let others = bytes(&self.statistics_requests(plan.capacity))
            + if gradients.is_empty() { 0 } else { bytes(&gradients) };
        self.placed(PLANE_SETS * bytes(&planes::requests(plan)), others)
    }

    /// Bytes of further planes: those of frozen Gaussians.
    pub fn of_planes(&self, bytes: u64) -> RowBytes {
        self.placed(bytes, 0)
    }

    fn placed(&self, planes: u64, others: u64) -> RowBytes {
        match self.planes {
            MemoryKind::Offloaded => RowBytes { device: others, offloaded: planes },
            _ => RowBytes { device: planes + others, offloaded: 0 },
        }
    }

    /// One buffer per statistic.
    pub fn allocate_statistics(&self, context: &Context, capacity: u32) -> Result<Vec<Buffer>> {
        context.allocate("statistics", &self.statistics_requests(capacity), MemoryKind::Device)
    }

    /// One buffer per chunk; none without terms that depend on the parameters directly.
    pub fn allocate_parameter_gradients(&self, context: &Context, plan: &ScenePlan) -> Result<Vec<Buffer>> {
        let requests = self.gradient_requests(plan);
        match requests.is_empty() {
            true => Ok(Vec::new()),
            false => context.allocate("gradients", &requests, MemoryKind::Device),
        }
    }
}

/// Gaussians on the device, with their moments and statistics.
pub(super) struct Model {
    pub scene: SceneBuffers,
    pub moments: Moments,
    /// Fourth set of planes: the target of densification's gather. Between changes of the set it holds the gradient sums
    /// ([`super::work::Work::sums_gradients`]).
    pub spare: Vec<Buffer>,
    /// Per Gaussian: see [`super::strategy::StepInputs::statistics`].
    pub statistics: Vec<Buffer>,
    /// Per chunk: see [`crate::loss::TermInputs::parameter_gradients`].
    pub parameter_gradients: Vec<Buffer>,
}

impl Model {
    /// Allocates the buffers that belong to a scene, and clears them.
    pub fn new(context: &Context, scene: SceneBuffers, rows: &RowMemory) -> Result<Self> {
        let planes = |arena| planes::allocate(context, (arena, rows.planes), &scene.plan);
        let moments = Moments { first: planes("moments")?, second: planes("moments")? };
        let spare = planes("spare")?;
        let statistics = rows.allocate_statistics(context, scene.plan.capacity)?;
        let parameter_gradients = rows.allocate_parameter_gradients(context, &scene.plan)?;
        context.run("clear moments", |r| {
            for buffer in moments.first.iter().chain(&moments.second).chain(&statistics) {
                r.fill(buffer, 0);
            }
            Ok(())
        })?;
        Ok(Self { scene, moments, spare, statistics, parameter_gradients })
    }

    /// Frees all memory and becomes empty; the caller replaces the model.
    pub fn release(&mut self) {
        self.scene.count = 0;
        let Moments { first, second } = &mut self.moments;
        for buffers in [
            &mut self.scene.chunks,
            first,
            second,
            &mut self.spare,
            &mut self.statistics,
            &mut self.parameter_gradients,
        ] {
            buffers.clear();
        }
    }
}

/// The state of a run between two steps.
pub(super) struct State {
    pub model: Model,
    pub progress: Progress,
    pub most: Needs,
    /// Number of consecutive skipped iterations.
    pub skipped: u32,
    /// True if a submission that changes the scene has an unknown outcome.
    pub broken: bool,
    /// State saved before memory was freed that could not be allocated again.
    pub rescued: Option<Box<Checkpoint>>,
}

impl State {
    pub fn new(model: Model) -> Self {
        Self {
            model,
            progress: Progress::default(),
            most: Needs::default(),
            skipped: 0,
            broken: false,
            rescued: None,
        }
    }

    /// Notes that an iteration's step has executed.
    pub fn done(&mut self, after: Progress, needs: Needs) {
        self.progress = after;
        self.skipped = 0;
        self.most = self.most.max(needs);
    }

    /// Checks that the state of the scene is known.
    pub fn check_whole(&self) -> Result<()> {
        if self.broken {
            let problem = "an earlier step was not finished; go on from a checkpoint, or anew";
            return Err(Error::argument("trainer", problem));
        }
        Ok(())
    }

    /// Notes a submission whose wait failed: it may or may not have executed.
    pub fn note_failure<T>(&mut self, result: &Result<T>) {
        self.broken |= match result {
            Err(Error::DeviceLost { .. } | Error::Timeout { .. }) => true,
            Err(Error::Vulkan { call, .. }) => *call == "vkWaitForFences",
            _ => false,
        };
    }
}
