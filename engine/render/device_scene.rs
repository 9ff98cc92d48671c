//! A scene on the device that a host owns, changes and places in the world.

use crate::error::{Error, Result};
use crate::frame::{Parameters, SceneBuffers, ScenePlan, ShStorage, planes, to_u32};
use crate::scene::Gaussians;
use crate::vk::{Buffer, Context, MemoryKind};

/// Problem of a scene that does not belong to the renderer's context.
pub(super) const ELSEWHERE: &str =
    "it belongs to another context: on the same VkDevice, DeviceScene::in_context gives one of this";

/// Gaussians on the device, for [`super::Renderer::record`]. A frame can have any number of scenes.
///
/// The parameters are in chunks, one buffer each, as vec4 planes (`PLANE_*` in `glsl/include/constants.glsl`) in rows of
/// eight Gaussians. Geometry and each SH degree are separate. [`ScenePlan::place`] returns a plane's address; the plan's
/// fields give the numbers of chunks, planes and Gaussians.
#[derive(Clone)]
pub struct DeviceScene {
    context: Context,
    pub(super) buffers: SceneBuffers,
    pub(super) parameters: Parameters,
}

impl DeviceScene {
    /// Wraps a scene that is already on the device.
    pub(crate) fn new(context: &Context, buffers: SceneBuffers) -> Self {
        let parameters = Parameters::new(context, &buffers);
        Self { context: context.clone(), buffers, parameters }
    }

    /// Uploads a scene with a capacity of `capacity` Gaussians, but at least for the given ones. If the memory cannot be
    /// mapped, submits a copy and waits for it. The copy runs after the host's earlier submissions to the queue.
    ///
    /// # Errors
    /// [`Error::Argument`] when the vectors differ in length; allocation failures.
    pub fn upload(context: &Context, gaussians: &Gaussians, capacity: u32) -> Result<Self> {
        Self::upload_stored(context, gaussians, capacity, ShStorage::F32)
    }

    /// Same as [`DeviceScene::upload`], with this storage of SH coefficients: 240, 144 or 112 bytes per Gaussian of SH degree 3.
    /// Frames that are recorded need [`Reservation::half_sh`](super::Reservation::half_sh) or
    /// [`Reservation::byte_sh`](super::Reservation::byte_sh). A scene is drawn alike, to the bit, in its [`ShStorage::lossless`].
    ///
    /// # Errors
    /// Same as [`DeviceScene::upload`].
    pub fn upload_stored(
        context: &Context,
        gaussians: &Gaussians,
        capacity: u32,
        sh_storage: ShStorage,
    ) -> Result<Self> {
        gaussians.check_shapes().map_err(|error| error.within("gaussians"))?;
        let capacity = capacity.max(to_u32(gaussians.len() as u64)?);
        let plan = Self::plan_for(context, capacity, gaussians.sh_degree, sh_storage)?;
        let buffers = planes::upload_planned(context, "scene", MemoryKind::Device, gaussians, plan)?;
        Ok(Self::new(context, buffers))
    }

    /// Uploads several scenes into as few buffers as kernels can bind. The capacity of each is its number of Gaussians.
    /// Dropping the last scene of a buffer frees the buffer's memory.
    ///
    /// Frames cull and project small scenes of one buffer together, as a batch, with the same bits. A batch has 8 scenes or
    /// more, each of at most 16 culling blocks (4096 Gaussians on usual devices). Its scenes have the same evaluated SH
    /// degree, and all or none have a tint or opacity, and cut-outs. Scenes with a selection, with SH in halves or bytes, or of a frame with
    /// motion or a surface, are drawn alone. At most 32 culling blocks of other scenes may separate two scenes of a batch, so scenes ordered by
    /// kind need the fewest dispatches.
    /// To batch scenes in a host's buffer, adopt it once ([`Buffer::adopt`]) and give each scene a range of it. Scenes
    /// adopted one by one are drawn alone.
    ///
    /// # Errors
    /// Same as [`DeviceScene::upload`].
    pub fn upload_all(context: &Context, scenes: &[&Gaussians]) -> Result<Vec<Self>> {
        let plan = |(index, gaussians): (usize, &&Gaussians)| {
            gaussians.check_shapes().map_err(|error| error.within(format_args!("scenes[{index}]")))?;
            ScenePlan::new(
                context.limits(),
                to_u32(gaussians.len() as u64)?,
                gaussians.sh_degree,
                ShStorage::F32,
            )
        };
        let plans = scenes.iter().enumerate().map(plan).collect::<Result<Vec<_>>>()?;
        let requests: Vec<_> = plans.iter().flat_map(planes::requests).collect();
        let mut chunks = allocate_together(context, &requests)?.into_iter();
        let upload = |(gaussians, plan): (&&Gaussians, ScenePlan)| {
            let (own, count) = (chunks.by_ref().take(plan.chunks as usize), to_u32(gaussians.len() as u64)?);
            let buffers = SceneBuffers { chunks: own.collect(), plan, count };
            planes::fill(context, &buffers, gaussians)?;
            Ok(Self::new(context, buffers))
        };
        scenes.iter().zip(plans).map(upload).collect()
    }

    /// Returns the same scene for another context on the same VkDevice, with the same Gaussians in memory. Several parts of
    /// an engine, each with its own context, can draw it. It keeps the memory alive. Both contexts then use the same
    /// buffers, and the host orders the uses: within one queue they are in order, across queues by semaphores.
    ///
    /// # Errors
    /// [`Error::Argument`] for a context of another device, whose queues are of another family, whose limits give another
    /// plan, or whose kernels read texels.
    pub fn in_context(&self, context: &Context) -> Result<Self> {
        let plan = self.buffers.plan;
        let shared = |chunk: &Buffer| chunk.in_context(context).map_err(|error| error.of("scene"));
        let chunks = self.buffers.chunks.iter().map(shared).collect::<Result<_>>()?;
        if plan != Self::plan_for(context, plan.capacity, plan.sh_degree, plan.sh_storage)? {
            let problem = "the limits of the context ask for another plan of the scene's buffers";
            return Err(Error::argument("scene", problem));
        }
        Ok(Self::new(context, SceneBuffers { chunks, ..self.buffers }))
    }

    /// Allocates an empty scene with a capacity of `capacity` Gaussians with SH up to `sh_degree`. [`super::Update`]s fill
    /// it.
    ///
    /// # Errors
    /// [`Error::TooLarge`] or an allocation's failure.
    pub fn empty(context: &Context, capacity: u32, sh_degree: u32) -> Result<Self> {
        let plan = Self::plan_for(context, capacity, sh_degree, ShStorage::F32)?;
        let chunks = planes::allocate(context, "scene", MemoryKind::Device, &plan)?;
        Ok(Self::new(context, SceneBuffers { chunks, plan, count: 0 }))
    }

    /// Creates a scene in the host's own buffers ([`Buffer::adopt`]), one for each chunk of [`DeviceScene::plan_for`], with
    /// `count` Gaussians. Only the first [`ScenePlan::chunk_bytes`] of each buffer are used. A host that writes the buffers
    /// synchronises the writes as for any buffer that compute shaders read.
    ///
    /// # Errors
    /// [`Error::Argument`] for:
    /// - a plan that is not [`DeviceScene::plan_for`] this device;
    /// - too few or too small buffers;
    /// - buffers of another context, with an unaligned offset, or that overlap;
    /// - more Gaussians than the plan's capacity.
    pub fn from_buffers(context: &Context, plan: ScenePlan, chunks: Vec<Buffer>, count: u32) -> Result<Self> {
        let bad = |field: &str, problem: String| Err(Error::argument(field, problem));
        // A plan depends on the device's limits. Another device's plan would be bound and indexed wrongly.
        let own = Self::plan_for(context, plan.capacity, plan.sh_degree, plan.sh_storage);
        if plan != own.map_err(|error| error.within("plan"))? {
            return bad("plan", "it is not the one that DeviceScene::plan_for makes on this device".into());
        }
        if chunks.len() != plan.chunks as usize {
            return bad("chunks", format!("{} of them, the plan has {}", chunks.len(), plan.chunks));
        }
        if count > plan.capacity {
            return bad("count", format!("{count}, the plan's capacity is {}", plan.capacity));
        }
        let (chunk_bytes, alignment) = (plan.chunk_bytes(), context.limits().storage_alignment.max(16));
        for (index, chunk) in chunks.iter().enumerate() {
            let bad = |problem| bad(&format!("chunks[{index}] (buffer '{}')", chunk.name()), problem);
            if !chunk.belongs_to(context) {
                return bad("it belongs to another context".into());
            }
            if chunk.bytes() < chunk_bytes {
                return bad(format!("has {} bytes, not {chunk_bytes}", chunk.bytes()));
            }
            let begin = chunk.handle().1;
            if !begin.is_multiple_of(alignment) {
                return bad(format!("begins at byte {begin}, which is no multiple of {alignment}"));
            }
        }
        let mut places: Vec<_> = chunks.iter().map(Buffer::handle).collect();
        places.sort_unstable();
        if places.windows(2).any(|pair| pair[0].0 == pair[1].0 && pair[1].1 - pair[0].1 < chunk_bytes) {
            return bad("chunks", "they overlap".into());
        }
        let chunks = chunks.iter().map(|buffer| buffer.range(0, plan.chunk_bytes())).collect();
        Ok(Self::new(context, SceneBuffers { chunks, plan, count }))
    }

    /// Returns the layout of the parameters of `capacity` Gaussians on this device.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for a capacity above the range of indices, [`Error::Argument`] for an SH degree above 3.
    pub fn plan_for(
        context: &Context,
        capacity: u32,
        sh_degree: u32,
        sh_storage: ShStorage,
    ) -> Result<ScenePlan> {
        if sh_degree > 3 {
            return Err(Error::argument("sh_degree", format!("{sh_degree} is above 3")));
        }
        ScenePlan::new(context.limits(), capacity, sh_degree, sh_storage)
    }

    /// Returns the layout of the parameters.
    pub fn plan(&self) -> &ScenePlan {
        &self.buffers.plan
    }

    /// Number of Gaussians.
    pub fn count(&self) -> u32 {
        self.buffers.count
    }

    /// Renders only the first `count` Gaussians from the next recording on.
    ///
    /// # Errors
    /// [`Error::Argument`] for a count above the capacity.
    pub fn set_count(&mut self, count: u32) -> Result<()> {
        if count > self.buffers.plan.capacity {
            let problem = format!("{count}, the capacity is {}", self.buffers.plan.capacity);
            return Err(Error::argument("count", problem));
        }
        self.buffers.count = count;
        Ok(())
    }

    /// Reads the Gaussians back. Submits and waits if the memory cannot be mapped. No submission may write them meanwhile.
    pub fn download(&self) -> Result<Gaussians> {
        planes::download(&self.context, &self.buffers)
    }

    /// True if it belongs to this context.
    pub fn belongs_to(&self, context: &Context) -> bool {
        self.context.is(context)
    }
}

/// Allocates buffers in VkBuffers that kernels can bind as a whole.
fn allocate_together(context: &Context, requests: &[(&'static str, u64)]) -> Result<Vec<Buffer>> {
    let is_large = context.allocation_bytes(requests) > context.limits().max_storage_buffer_range;
    if requests.len() < 2 || !is_large {
        return context.allocate("scenes", requests, MemoryKind::Device);
    }
    let (first, rest) = requests.split_at(requests.len() / 2);
    Ok([allocate_together(context, first)?, allocate_together(context, rest)?].concat())
}
