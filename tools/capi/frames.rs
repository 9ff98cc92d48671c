//! A frame to record, its outputs, and its report.

use super::settings::one_of;
use super::{
    AshsplatCamera, AshsplatDepthMapping, AshsplatHostImage, AshsplatImageState, AshsplatPlaced,
    AshsplatUpdate,
};
use ashsplat::vk::ImageState;
use ashsplat::{Background, ColorEncoding, Release, Result, SlotReport};

/// What the splats are composited over.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatBackground {
    /// A background colour; the result is opaque.
    Color = 0,
    /// Nothing: premultiplied colour and alpha.
    Nothing = 1,
    /// The image's content.
    Image = 2,
}

/// What the colours are that are written into a target.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatColorEncoding {
    /// The values that the splats were trained in: those of photographs, display-encoded by the curve of sRGB.
    AsTrained = 0,
    /// Linear light with the primaries of sRGB, decoded after blending; what is premultiplied is decoded before the product
    /// with alpha. A target of an sRGB format encodes it again.
    LinearSrgb = 1,
}

/// The image that a frame's colours are written to.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// What the splats are composited over: an AshsplatBackground.
    pub behind: u32,
    /// Its colour, for AshsplatBackground_Color: display-encoded, as trained.
    pub background: [f32; 3],
    /// What the target's colours are: an AshsplatColorEncoding.
    pub encoding: u32,
    /// Factor of linear light, finite and positive, for AshsplatColorEncoding_LinearSrgb: 1 by default.
    pub exposure: f32,
    /// The image.
    pub to: AshsplatHostImage,
}

/// A host's depth image. It hides the splats that are farther away.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatOccluder {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The depth image, adopted for AshsplatImageUse_Occluder.
    pub depth: AshsplatHostImage,
    /// How to read it: ashsplat_camera_from_matrices.
    pub mapping: AshsplatDepthMapping,
}

/// An image of expected depth: sum(w z) / sum(w), world units.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatDepthTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A pixel is empty if the splats' weights sum to less.
    pub min_weight: f32,
    /// The depth of empty pixels.
    pub empty: f32,
    /// The r32f image.
    pub to: AshsplatHostImage,
}

/// A frame to record.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatRecordedFrame {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Number of scenes, at least one.
    pub scene_count: u32,
    /// Number of updates.
    pub update_count: u32,
    /// The scenes, whose Gaussians are sorted together.
    pub scenes: *const AshsplatPlaced,
    /// The camera; its width and height are the frame's.
    pub camera: *const AshsplatCamera,
    /// How to render, or NULL for the defaults.
    pub settings: *const super::AshsplatRenderSettings,
    /// The image that is written, or NULL: then the slot's own buffer, ashsplat_slot_pixels.
    pub target: *const AshsplatTarget,
    /// The host's depth image, which hides splats that are farther away, or NULL.
    pub occluder: *const AshsplatOccluder,
    /// The image that expected depth is written to, or NULL.
    pub depth: *const AshsplatDepthTarget,
    /// Parameter updates before the frame.
    pub updates: *const AshsplatUpdate,
    /// The image that what is picked is written to, or NULL: nothing is noted then.
    pub pick: *const super::AshsplatPickTarget,
    /// The image that motion is written to, or NULL: then none is computed.
    pub motion: *const super::AshsplatMotionTarget,
}

/// Converts an AshsplatBackground's number.
pub(super) fn behind(number: u32, background: [f32; 3]) -> Result<Background> {
    one_of("target.behind", number, &[Background::Color(background), Background::Nothing, Background::Image])
}

/// Converts an AshsplatColorEncoding's number.
pub(super) fn encoding(number: u32, exposure: f32) -> Result<ColorEncoding> {
    one_of("target.encoding", number, &[ColorEncoding::AsTrained, ColorEncoding::LinearSrgb { exposure }])
}

/// The state after a recording. The next user of its results waits for these stages and accesses, and finds
/// the images in these layouts.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatRelease {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// VkPipelineStageFlags2 that write results.
    pub stages: u64,
    /// VkAccessFlags2 that they write with.
    pub accesses: u64,
    /// Last use of the target.
    pub color: AshsplatImageState,
    /// Last use of the host's depth image.
    pub occluder: AshsplatImageState,
    /// Last use of the image of expected depth.
    pub depth: AshsplatImageState,
    /// Last use of the image of what is picked.
    pub pick: AshsplatImageState,
    /// Last use of the image of motion.
    pub motion: AshsplatImageState,
}

impl From<&Release> for AshsplatRelease {
    fn from(r: &Release) -> Self {
        let state = |s: Option<ImageState>| s.map(AshsplatImageState::from).unwrap_or_default();
        Self {
            stages: r.stages.as_raw(),
            accesses: r.accesses.as_raw(),
            color: state(r.color),
            occluder: state(r.occluder),
            depth: state(r.depth),
            pick: state(r.pick),
            motion: state(r.motion),
            ..Self::default()
        }
    }
}

/// The report of a recorded frame.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatSlotReport {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether the frame has finished. The other fields are valid only then.
    pub finished: bool,
    /// Whether more instances (`instances_needed` for `instance_capacity`) or passes (`blend_passes_needed` for `blend_passes`) are
    /// needed than there were. The picture then lacks the Gaussians farthest away, or all of them if `instances_needed` is
    /// `UINT32_MAX`. ashsplat_reservation_grown makes room, but for the last case.
    pub overflow: bool,
    /// Gaussians in the frame's scenes, without those of scenes that are not drawn.
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
    /// Time on the device, nanoseconds; 0 without timestamps. Of a recording of many views, of its first 255 stages.
    pub nanoseconds: f64,
    /// How often the recording sorts by depth: once for each view, or for each run of views that share it
    /// (AshsplatReservation.shared_sort).
    pub sorts: u32,
    /// Scenes that were drawn together with others by one dispatch, in all views: scenes of ashsplat_scenes_new, or one scene that
    /// is placed many times.
    pub batched_scenes: u32,
    /// Passes of blending that the frame was recorded with.
    pub blend_passes: u32,
    /// Entries of a tile that a pass takes.
    pub entries_per_pass: u32,
}

impl From<&AshsplatSlotReport> for SlotReport {
    fn from(r: &AshsplatSlotReport) -> Self {
        let mut report = Self::default();
        (report.instances_needed, report.instance_capacity) = (r.instances_needed, r.instance_capacity);
        (report.blend_passes_needed, report.blend_passes) = (r.blend_passes_needed, r.blend_passes);
        report
    }
}

impl From<SlotReport> for AshsplatSlotReport {
    fn from(r: SlotReport) -> Self {
        Self {
            finished: true,
            overflow: r.overflow,
            gaussians: r.gaussians,
            visible: r.visible,
            instances_needed: r.instances_needed,
            instance_capacity: r.instance_capacity,
            longest_tile: r.longest_tile,
            blend_passes_needed: r.blend_passes_needed,
            nanoseconds: r.scopes.iter().filter(|s| s.depth == 0).map(|s| s.nanoseconds).sum(),
            sorts: r.sorts,
            batched_scenes: r.batched_scenes,
            blend_passes: r.blend_passes,
            entries_per_pass: r.entries_per_pass,
            ..Self::default()
        }
    }
}
