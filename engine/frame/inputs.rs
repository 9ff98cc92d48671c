//! Inputs of a frame: scenes with their transforms, a camera, settings.

use super::{
    CAMERA_BLOCK_BYTES, FrameBatches, FrameBuffers, FrameCapacity, FrameVariant, GaussianRange, Outputs,
    RenderSettings, ScenePlan, SceneSettings,
};
use crate::kernels::constants::NO_BATCH;
use crate::scene::{Camera, Pose};
use crate::vk::{Buffer, Context, Recorder};

/// Parameters of a scene on the device: planes split into chunks.
#[derive(Clone)]
pub struct SceneBuffers {
    /// One buffer per chunk of Gaussians.
    pub chunks: Vec<Buffer>,
    /// Layout of the planes.
    pub plan: ScenePlan,
    /// Number of Gaussians.
    pub count: u32,
}

impl SceneBuffers {
    /// Returns the SH degree to evaluate: the settings' degree, at most the stored one.
    #[inline]
    pub fn active_degree(&self, settings: &RenderSettings) -> u32 {
        settings.sh_degree.unwrap_or(self.plan.sh_degree).min(self.plan.sh_degree)
    }

    /// Records a dispatch for each chunk of parameters, with barriers between them: they write common buffers.
    pub(crate) fn record_chunks(
        &self,
        r: &mut Recorder,
        mut record: impl FnMut(&mut Recorder, GaussianRange, &Buffer),
    ) {
        for range in self.plan.ranges(self.count) {
            if range.chunk > 0 {
                r.barrier();
            }
            record(r, range, &self.chunks[range.chunk]);
        }
    }
}

/// One frame to record.
#[derive(Clone, Copy)]
pub struct FrameInputs<'a> {
    /// The scenes, one behind the other in the frame's index space; at least one. A backward pass differentiates the first.
    pub scenes: &'a [PlacedScene<'a>],
    /// Batches of these scenes.
    pub batches: FrameBatches<'a>,
    /// The frame's buffers.
    pub buffers: &'a FrameBuffers,
    /// Capacity of the frame's buffers.
    pub capacity: &'a FrameCapacity,
    /// The camera in the axes of the first scene.
    pub camera: &'a Camera,
    /// Pose of the first scene's camera on the device, which replaces that of `camera` ([`POSE_BYTES`](super::POSE_BYTES)): the
    /// rows of the rotation from world to camera, then the translation, with the scale 1.
    pub pose: Option<&'a Buffer>,
    /// Render settings of the frame.
    pub settings: &'a RenderSettings,
    /// Per pixel of the image: 1/z of the opaque surface that hides splats, 0 for none.
    pub depth_limits: Option<&'a Buffer>,
    /// The masked photograph of a training view ([`photo_on_device`](crate::passes::loss::photo_on_device)), of the frame's size.
    /// Tiles that its mask hides altogether are neither blended nor differentiated. Needs `backward`.
    pub hidden_by: Option<&'a Buffer>,
    /// Buffer for the cut-outs of all scenes, 64 bytes each; may be `None` if there are none.
    pub cut_outs: Option<&'a Buffer>,
    /// Renders the sum of weights * z instead of weights / z.
    pub expected_depth: bool,
    /// A backward pass follows: store the picture in its layout, see [`FrameBuffers::rendered`]. No scene has a tint, an opacity
    /// or a selection then.
    pub backward: bool,
    /// Stores [`FrameBuffers::last_entries`] also without `backward`.
    pub last_entries: bool,
    /// True to keep the previous frame's STATE_OVERFLOW, because all frames after an overflow are invalid too.
    pub keeps_overflow: bool,
    /// Further outputs besides the picture; none with `backward`.
    pub outputs: Outputs,
    /// Buffers of the loss terms' scratch, in a training: [`LossTerm::scratch_requests`](crate::passes::loss::LossTerm::scratch_requests)
    /// of each in turn.
    pub loss_scratch: &'a [Buffer],
    /// Index among views that share one depth order ([`Forward::record_first`](crate::render::Forward::record_first)); `None` for a
    /// view with its own.
    pub view: Option<u32>,
}

impl<'a> FrameInputs<'a> {
    /// A frame of these scenes, without backward and without further inputs or outputs.
    pub fn new(
        scenes: &'a [PlacedScene<'a>],
        buffers: &'a FrameBuffers,
        capacity: &'a FrameCapacity,
        settings: &'a RenderSettings,
    ) -> Self {
        Self {
            scenes,
            batches: FrameBatches::default(),
            buffers,
            capacity,
            camera: &scenes[0].camera,
            pose: None,
            settings,
            depth_limits: None,
            hidden_by: None,
            cut_outs: None,
            expected_depth: false,
            backward: false,
            last_entries: false,
            keeps_overflow: false,
            outputs: settings.outputs(),
            loss_scratch: &[],
            view: None,
        }
    }

    /// Returns the variant of the frame's kernels, without what only its scenes have.
    pub fn variant(&self) -> FrameVariant {
        FrameVariant {
            expected_depth: self.expected_depth,
            depth_limit: self.depth_limits.is_some(),
            outputs: self.outputs,
            shared_order: self.view.is_some(),
            last_entries: self.last_entries,
            ..FrameVariant::of(self.settings, self.camera, self.backward)
        }
    }

    /// Returns the variant of the kernels that differentiate or optimise the first scene.
    pub(crate) fn trained_variant(&self) -> FrameVariant {
        FrameVariant { sh_storage: self.scene().plan.sh_storage, ..self.variant() }
    }

    /// True if the tile sort keeps the index of each instance: the buffers are those of [`FrameCapacity::backward`]. Otherwise it
    /// carries the visible Gaussian.
    pub(crate) fn keeps_instances(&self) -> bool {
        self.capacity.backward
    }

    /// The parameters of the first scene, which a backward pass differentiates.
    pub fn scene(&self) -> &'a SceneBuffers {
        self.scenes[0].scene
    }

    /// The evaluated SH degree of the first scene.
    pub fn sh_degree(&self) -> u32 {
        self.scenes[0].sh_degree
    }

    /// Checks that a backward pass, if any, has the right gradients.
    ///
    /// # Panics
    /// If it has not.
    pub(crate) fn assert_differentiable(&self) {
        if !self.backward {
            return;
        }
        let colored = |own: &SceneSettings| own.is_tinted() || own.mask().is_some();
        let obstacles = [
            (
                self.scenes.iter().any(|placed| colored(placed.settings)),
                "a frame with a tint, an opacity or a selection",
            ),
            (self.outputs.any(), "a frame with picks, motion or a surface"),
            (self.camera.is_orthographic(), "an orthographic camera's frame"),
        ];
        for (found, obstacle) in obstacles {
            assert!(!found, "no backward pass can follow {obstacle}");
        }
    }

    /// The place of the camera block of its first scene. Views with one order have their blocks behind each other.
    pub(super) fn first_block(&self) -> usize {
        self.view.unwrap_or(0) as usize * self.scenes.len()
    }

    /// Camera blocks of all scenes of the frame.
    pub(crate) fn camera_blocks(&self) -> Buffer {
        let first = self.first_block() as u64 * CAMERA_BLOCK_BYTES;
        self.buffers.camera_blocks.range(first, self.scenes.len() as u64 * CAMERA_BLOCK_BYTES)
    }

    /// Dispatches over the parameters of scenes outside batches: chunk by chunk, scene by scene.
    pub(crate) fn parts(&self) -> impl Iterator<Item = Part<'a>> + use<'a> {
        let (first_block, end, scenes) = (self.first_block(), self.index_count(), self.scenes);
        let count = if self.batches.draw_all { 0 } else { scenes.len() };
        let single = scenes[..count].iter().enumerate().filter(|(_, placed)| placed.batch == NO_BATCH);
        single.flat_map(move |(index, placed)| {
            let next = scenes.get(index + 1).map_or(end, |next| next.first);
            let now = SceneView { camera: placed.camera, scale: placed.scale };
            let previous = placed.previous.map_or(now, |previous| previous.view());
            placed.scene.plan.ranges(placed.drawn_gaussians()).map(move |range| {
                let first_in_frame = placed.first + range.first;
                let is_last = range.first + range.count == placed.drawn_gaussians();
                Part {
                    scene: placed.scene,
                    block: first_block + index,
                    sh_degree: placed.sh_degree,
                    settings: placed.settings,
                    first_cut_out: placed.first_cut_out,
                    chunk: range.chunk,
                    first_in_scene: range.first,
                    first_in_frame,
                    count: range.count,
                    flags: if is_last { next - first_in_frame } else { range.count },
                    previous,
                }
            })
        })
    }

    /// Number of indices of all scenes together, including the gaps between them.
    pub(crate) fn index_count(&self) -> u32 {
        self.scenes.last().map_or(0, |last| last.first + last.drawn_gaussians())
    }
}

/// Location of a scene's parameters. A frame of thousands of scenes need not fetch each scene's list of buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Parameters {
    /// VkBuffer of the parameters; 0 if there are several, or if kernels cannot bind it as a whole.
    pub(super) memory: u64,
    /// First vec4 of the parameters in that buffer.
    pub(super) begin: u32,
    /// True if the buffer has no space for other scenes of this size.
    pub(super) is_full: bool,
}

impl Parameters {
    /// Parameters of a scene that cannot be in a batch.
    const APART: Self = Self { memory: 0, begin: 0, is_full: true };

    pub fn new(context: &Context, scene: &SceneBuffers) -> Self {
        match &scene.chunks[..] {
            [own] if own.whole_is_bindable(context.limits()) => Self {
                memory: own.memory_id(),
                begin: (own.handle().1 / 16) as u32,
                is_full: own.fills_its_memory(),
            },
            _ => Self::APART,
        }
    }
}

/// A scene of a frame. It is small, because a frame may have thousands: what it refers to is read where it is needed.
#[derive(Clone, Copy)]
pub struct PlacedScene<'a> {
    /// Parameters of the scene.
    pub scene: &'a SceneBuffers,
    /// Camera of the frame in the scene's own axes and origin, in world units.
    pub camera: Camera,
    /// World units per unit of the scene.
    pub scale: f32,
    /// Evaluated SH degree.
    pub sh_degree: u32,
    /// Settings of the scene; its SH degree is in `sh_degree`.
    pub settings: &'a SceneSettings<'a>,
    /// Index of the scene's first Gaussian in the frame. It follows the previous scene, at a multiple of
    /// [`LaunchSizes::elementwise_workgroup`](crate::frame::LaunchSizes::elementwise_workgroup), so that a culling block belongs
    /// to one scene.
    pub first: u32,
    /// Index of the scene's first cut-out in the frame.
    pub first_cut_out: u32,
    /// View of the scene in the previous frame, for its motion; the current view if `None`.
    pub previous: Option<PreviousView<'a>>,
    /// Location of the parameters, for batches.
    pub(crate) parameters: Parameters,
    /// Index of the first scene of the scene's batch; [`NO_BATCH`] outside batches.
    pub(crate) batch: u32,
}

impl<'a> PlacedScene<'a> {
    /// The first scene of a frame, in the camera's axes, as it is.
    pub fn alone(scene: &'a SceneBuffers, camera: &Camera, sh_degree: u32) -> Self {
        Self {
            scene,
            camera: *camera,
            scale: 1.0,
            sh_degree,
            settings: &SceneSettings::USUAL,
            first: 0,
            first_cut_out: 0,
            previous: None,
            parameters: Parameters::APART,
            batch: NO_BATCH,
        }
    }

    /// Number of Gaussians that take part in the frame.
    #[inline]
    pub fn drawn_gaussians(&self) -> u32 {
        if self.settings.draws() { self.scene.count } else { 0 }
    }
}

/// Inputs of one dispatch over a scene's parameters.
#[derive(Clone, Copy)]
pub(crate) struct Part<'a> {
    pub scene: &'a SceneBuffers,
    /// Index of the scene's camera block.
    pub block: usize,
    pub sh_degree: u32,
    pub settings: &'a SceneSettings<'a>,
    /// Index of the scene's first cut-out in the frame.
    pub first_cut_out: u32,
    /// Index of the scene's buffer with the parameters.
    pub chunk: usize,
    /// Index of the first Gaussian in the scene.
    pub first_in_scene: u32,
    /// Index of the first Gaussian in the frame, counted over all scenes.
    pub first_in_frame: u32,
    pub count: u32,
    /// Number of the frame's indices for the part, including the gap before the next scene.
    pub flags: u32,
    /// View of the scene in the previous frame.
    pub previous: SceneView,
}

/// View of a scene in its own axes.
#[derive(Clone, Copy, Debug)]
pub struct SceneView {
    /// Camera relative to the scene's axes and origin. Its translation is in world units.
    pub camera: Camera,
    /// World units per unit of the scene.
    pub scale: f32,
}

/// View of a scene in the previous frame.
#[derive(Clone, Copy, Debug)]
pub struct PreviousView<'a> {
    /// Camera of the previous frame.
    pub camera: &'a Camera,
    /// Pose of the scene in the previous frame.
    pub pose: &'a Pose,
}

impl PreviousView<'_> {
    fn view(&self) -> SceneView {
        SceneView { camera: self.pose.camera_in_object(self.camera), scale: self.pose.scale }
    }
}
