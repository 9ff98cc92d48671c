//! The inputs of a frame: scenes with their transforms, a camera, settings.

use super::{Auxiliary, Before, BlendVariant, RenderSettings, SceneSettings, Seen};
use crate::kernels::constants::NO_BATCH;
use crate::plan::{FrameBuffers, FrameCapacity, GaussianRange, ScenePlan};
use crate::scene::Camera;
use crate::vk::{Buffer, Context};

/// The parameters of a scene on the device: planes split into chunks.
#[derive(Clone)]
pub struct SceneBuffers {
    /// One buffer per chunk of Gaussians.
    pub chunks: Vec<Buffer>,
    /// The layout of the planes.
    pub plan: ScenePlan,
    /// Number of Gaussians.
    pub count: u32,
}

impl SceneBuffers {
    /// The evaluated SH degree: the settings' degree, at most the stored one.
    #[inline]
    pub fn active_degree(&self, settings: &RenderSettings) -> u32 {
        settings.sh_degree.unwrap_or(self.plan.sh_degree).min(self.plan.sh_degree)
    }
}

/// One frame to record.
#[derive(Clone, Copy)]
pub struct FrameInputs<'a> {
    /// The scenes, one behind the other in the frame's index space; at least one. A backward pass differentiates the first.
    pub scenes: &'a [PlacedScene<'a>],
    /// The frame's buffers.
    pub frame: &'a FrameBuffers,
    /// Their capacity.
    pub capacity: &'a FrameCapacity,
    /// The camera in the axes of the first scene.
    pub camera: &'a Camera,
    /// Where the camera of the first scene is, if the device knows better than `camera` ([`POSE_BYTES`](super::POSE_BYTES)): the
    /// rows of the rotation from world to camera, then the translation, with the scale 1.
    pub pose: Option<&'a Buffer>,
    /// How to render.
    pub settings: &'a RenderSettings,
    /// Per pixel of the image: 1/z of the opaque surface that hides splats, 0 for none.
    pub depth_limits: Option<&'a Buffer>,
    /// Room for the cut-outs of all scenes, 64 bytes each; may be `None` if there are none.
    pub cut_outs: Option<&'a Buffer>,
    /// Sum weights * z instead of weights / z.
    pub linear_depth: bool,
    /// A backward pass follows: store the picture in its layout, see [`FrameBuffers::rendered`]. No scene has a tint, an opacity
    /// or a selection then.
    pub backward: bool,
    /// Keep the previous frame's STATE_OVERFLOW: all frames after one that overflowed are invalid too.
    pub keeps_overflow: bool,
    /// What is left beside the picture; nothing with `backward`.
    pub auxiliary: Auxiliary<'a>,
    /// Which of some views with one order it is ([`Forward::record_first`](super::Forward::record_first)); `None` alone.
    pub view: Option<u32>,
}

impl FrameInputs<'_> {
    /// The variant of blending that the frame needs.
    pub fn blend_variant(&self) -> BlendVariant {
        BlendVariant {
            linear_depth: self.linear_depth,
            depth_limit: self.depth_limits.is_some(),
            pick: self.auxiliary.picks.is_some(),
            motion: self.auxiliary.motion.is_some(),
            shared_order: self.view.is_some(),
            ..BlendVariant::of(self.settings, self.backward).of_camera(self.camera)
        }
    }
}

/// The batch of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Batch {
    /// The place of its first scene in the frame; [`NO_BATCH`] for a scene that is drawn alone.
    pub first: u32,
    /// Of its first scene: how many there are.
    pub(super) scenes: u32,
    /// Of its first scene: one past the last Gaussian of all, in the frame.
    pub(super) end: u32,
    /// Of its first scene: the place of the first scene of the frame's next batch; [`NO_BATCH`] for none.
    pub(super) next: u32,
    pub(super) parameters: Parameters,
    /// Of the frame's first scene.
    pub(super) frame: FrameBatches,
}

/// What a frame's batches draw, so that nobody looks through thousands of scenes for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FrameBatches {
    /// The place of the first scene of the first batch; [`NO_BATCH`] for none.
    pub(super) head: u32,
    /// Whether they draw all that is drawn.
    pub(super) all: bool,
}

/// Where a scene's parameters lie among those of others. A frame of thousands of scenes has it at hand, and does not fetch
/// each scene's list of buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Parameters {
    /// Their VkBuffer; 0 if there are several or kernels cannot bind it as a whole.
    pub(super) memory: u64,
    /// Where they begin in it, vec4.
    pub(super) begin: u32,
    /// Whether it has no room for others of their size.
    pub(super) alone: bool,
}

impl Parameters {
    pub fn new(context: &Context, scene: &SceneBuffers) -> Self {
        match &scene.chunks[..] {
            [own] if own.whole_is_bindable(context.limits()) => Self {
                memory: own.memory_id(),
                begin: (own.handle().1 / 16) as u32,
                alone: own.fills_its_memory(),
            },
            _ => Self { memory: 0, begin: 0, alone: true },
        }
    }
}

impl Batch {
    /// A scene that is drawn alone.
    pub const ALONE: Self = {
        let parameters = Parameters { memory: 0, begin: 0, alone: true };
        let frame = FrameBatches { head: NO_BATCH, all: false };
        Self { first: NO_BATCH, scenes: 0, end: 0, next: NO_BATCH, parameters, frame }
    };

    /// The same of a scene that may come into a batch.
    pub(crate) fn none_yet(parameters: Parameters) -> Self {
        Self { parameters, ..Self::ALONE }
    }
}

/// A scene of a frame. It is small, because a frame may have thousands: what it refers to is read where it is needed.
#[derive(Clone, Copy)]
pub struct PlacedScene<'a> {
    /// The scene.
    pub scene: &'a SceneBuffers,
    /// The frame's camera in the scene's own axes and origin, in world units.
    pub camera: Camera,
    /// World units per unit of the scene.
    pub scale: f32,
    /// Evaluated SH degree.
    pub sh_degree: u32,
    /// How it is drawn; its SH degree is in `sh_degree`.
    pub settings: &'a SceneSettings<'a>,
    /// Index of its first Gaussian among all of the frame. It comes after the previous scene, at a multiple
    /// of [`LaunchSizes::elementwise_workgroup`](crate::plan::LaunchSizes::elementwise_workgroup), so that a
    /// culling block belongs to one scene.
    pub first: u32,
    /// Index of its first cut-out among all of the frame.
    pub first_cut_out: u32,
    /// How it was seen in the frame before, for its motion; as now if `None`.
    pub previous: Option<Before<'a>>,
    /// Which others its dispatches draw, too.
    pub batch: Batch,
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
            batch: Batch::ALONE,
        }
    }

    /// Number of Gaussians that take part in the frame.
    #[inline]
    pub fn drawn(&self) -> u32 {
        if self.settings.draws() { self.scene.count } else { 0 }
    }

    /// Of the first scene of a batch: its first culling block and one past the last, of `block` Gaussians each.
    pub(super) fn batch_blocks(&self, block: u32) -> [u32; 2] {
        [self.first / block, self.batch.end.div_ceil(block)]
    }
}

/// The inputs of one dispatch over a scene's parameters.
#[derive(Clone, Copy)]
pub(super) struct Part<'a> {
    pub(super) scene: &'a SceneBuffers,
    /// The place of the scene's camera block.
    pub(super) block: usize,
    pub(super) sh_degree: u32,
    pub(super) settings: &'a SceneSettings<'a>,
    /// Of the frame.
    pub(super) first_cut_out: u32,
    /// First Gaussian of the range in its scene.
    pub(super) first_of_scene: u32,
    /// Of the frame: its first Gaussian counts among those of all scenes.
    pub(super) range: GaussianRange,
    /// Indices that the range takes in the frame: with the gap between its scene and the next one.
    pub(super) flags: u32,
    /// How the scene was seen in the frame before.
    pub(super) previous: Seen,
}

impl<'a> FrameInputs<'a> {
    /// The parameters of the first scene, which a backward pass differentiates.
    pub fn scene(&self) -> &'a SceneBuffers {
        self.scenes[0].scene
    }

    /// The evaluated SH degree of the first scene.
    pub fn sh_degree(&self) -> u32 {
        self.scenes[0].sh_degree
    }

    /// # Panics
    /// If a backward pass would have wrong gradients.
    pub(super) fn assert_differentiable(&self) {
        let colored = |own: &SceneSettings| own.is_tinted() || own.mask().is_some();
        assert!(
            !(self.backward && self.scenes.iter().any(|placed| colored(placed.settings))),
            "no backward pass can follow a frame with a tint, an opacity or a selection"
        );
        let Auxiliary { picks, motion } = self.auxiliary;
        assert!(
            !(self.backward && (picks.is_some() || motion.is_some())),
            "no backward pass can follow a frame with picks or motion"
        );
        assert!(
            !(self.backward && self.camera.is_orthographic()),
            "no backward pass can follow an orthographic camera's frame"
        );
    }

    /// The place of the camera block of its first scene. Views with one order have their blocks behind each other.
    pub(super) fn first_block(&self) -> usize {
        self.view.unwrap_or(0) as usize * self.scenes.len()
    }

    /// The first scenes of batches, with their places.
    pub(super) fn batches(&self) -> impl Iterator<Item = (u32, &'a PlacedScene<'a>)> + use<'a> {
        let scenes = self.scenes;
        let at = move |place: u32| Some((place, scenes.get(place as usize)?));
        std::iter::successors(at(scenes[0].batch.frame.head), move |(_, placed)| at(placed.batch.next))
    }

    /// The dispatches over parameters of scenes that are drawn alone: chunk by chunk, scene by scene.
    pub(super) fn parts(&self) -> impl Iterator<Item = Part<'a>> + use<'a> {
        let (first_block, end, scenes) = (self.first_block(), self.index_count(), self.scenes);
        // Where batches draw everything, nobody looks through thousands of scenes.
        let count = if scenes[0].batch.frame.all { 1 } else { scenes.len() };
        let alone = scenes[..count].iter().enumerate().filter(|(_, placed)| placed.batch.first == NO_BATCH);
        alone.flat_map(move |(place, placed)| {
            let block = first_block + place;
            let PlacedScene { scene, sh_degree, settings, first, first_cut_out, .. } = *placed;
            let next = scenes.get(place + 1).map_or(end, |next| next.first);
            let now = Seen { camera: placed.camera, scale: placed.scale };
            let previous = placed.previous.map_or(now, |before| before.seen());
            let ranges = scene.plan.ranges(placed.drawn());
            ranges.map(move |range| {
                let first_of_scene = range.first;
                let range = GaussianRange { first: first + range.first, ..range };
                let is_last = first_of_scene + range.count == placed.drawn();
                let flags = if is_last { next - range.first } else { range.count };
                Part {
                    scene,
                    block,
                    sh_degree,
                    settings,
                    first_cut_out,
                    first_of_scene,
                    range,
                    flags,
                    previous,
                }
            })
        })
    }

    /// Number of indices of all scenes together, including the gaps between them.
    pub(super) fn index_count(&self) -> u32 {
        self.scenes.last().map_or(0, |last| last.first + last.drawn())
    }
}
