//! The structs and codes of the C interface that several modules share. Enumerations arrive as numbers and are checked here,
//! because a C program may write any number.

use super::*;
use ashsplat::ash::vk;
use ashsplat::scene::{Camera, DepthMapping, Pose, Projection, Readout, Shutter};
use ashsplat::vk::ImageState;
use ashsplat::{Extent, JacobianLimit, Reservation, Shape};
use glam::{Mat3, Vec3};
use std::ffi::c_void;

/// The result of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatStatus {
    /// Success.
    Ok = 0,
    /// An argument is invalid.
    Argument = 1,
    /// A file cannot be read, written or understood.
    File = 2,
    /// There is no usable device.
    NoDevice = 3,
    /// The device lacks something, or the host has not enabled it.
    MissingFeature = 4,
    /// A limit or a capacity is exceeded.
    TooLarge = 5,
    /// A Vulkan call failed.
    Vulkan = 6,
    /// A defect of this library.
    Internal = 7,
    /// The device is lost, and its context is unusable.
    DeviceLost = 8,
    /// A submission has not finished within its timeout; it is still running.
    Timeout = 9,
}

/// A camera, x right, y down, z forward: x_camera = R x_world + t, pixel = (fx x/z + cx, fy y/z + cy), or (fx x + cx,
/// fy y + cy) if it is orthographic, where the centre of the first pixel is (0.5, 0.5).
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatCamera {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// R, row by row.
    pub camera_from_world: [f32; 9],
    /// t, world units.
    pub translation: [f32; 3],
    /// Focal length in x, pixels; pixels per world unit if it is orthographic.
    pub fx: f32,
    /// Focal length in y: as fx.
    pub fy: f32,
    /// Principal point in x, pixels.
    pub cx: f32,
    /// Principal point in y, pixels.
    pub cy: f32,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// An AshsplatProjection.
    pub projection: u32,
    /// Coefficients of the projection's lens, in COLMAP's order; zeros after the last, and for other projections.
    pub coefficients: [f32; 12],
    /// An AshsplatReadout: how a rolling shutter reads the picture. The pose is that halfway; row t, from -1/2 for the first to
    /// 1/2 for the last, shows a point of that camera's space at exp(t turn^) (x - t shift).
    pub readout: u32,
    /// Turn of the scene from the first row to the last: axis times angle, radians; at most half a circle.
    pub shutter_turn: [f32; 3],
    /// Way of the camera's centre from the first row to the last, world units, in the space of the camera halfway.
    pub shutter_shift: [f32; 3],
}

/// How a picture is read. Frames of cameras with a rolling shutter need AshsplatReservation.rolling_shutter.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatReadout {
    /// At once.
    Global = 0,
    /// Row by row, the uppermost first.
    Down = 1,
    /// Row by row, the lowest first.
    Up = 2,
    /// Column by column, the leftmost first.
    Right = 3,
    /// Column by column, the rightmost first.
    Left = 4,
}

/// How the directions of a camera reach its picture. Frames of cameras with a lens need AshsplatReservation.lens. (a, b) is
/// (x, y)/z, or for fisheyes (x, y) theta/rho, s = a^2 + b^2, and T the tangential term of p1, p2.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatProjection {
    /// Through one point: a pinhole.
    Perspective = 0,
    /// In parallel, along the camera's z axis. Frames of such cameras need AshsplatReservation.orthographic.
    Orthographic = 1,
    /// (a, b) (1 + k1 s + k2 s^2 + k3 s^3 + n4 s^4) / (1 + k4 s + k5 s^2 + k6 s^3) + T: k1 k2 p1 p2 k3 k4 k5 k6 n4.
    Brown = 2,
    /// (a, b) atan(2 r tan(omega/2)) / (r omega), r = sqrt(s): omega.
    Fov = 3,
    /// (a, b) 2 / (1 + sqrt(1 - 4 k s)): k.
    Division = 4,
    /// (a, b) / (alpha sqrt(beta s + 1) + 1 - alpha): alpha beta.
    Eucm = 5,
    /// (a, b) (1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4) + T + (sx1, sy1) s: k1 k2 p1 p2 k3 k4 sx1 sy1.
    Fisheye = 6,
    /// COLMAP's RAD_TAN_THIN_PRISM_FISHEYE: k0 to k5 p0 p1 s0 s1 s2 s3.
    ThinPrismFisheye = 7,
    /// Longitude and latitude: a panorama. fx is width/2pi, fy height/pi.
    Equirectangular = 8,
}
const _: () = assert!(AshsplatProjection::Equirectangular as usize + 1 == Projection::ALL.len());

impl From<Camera> for AshsplatCamera {
    fn from(c: Camera) -> Self {
        same_fields!(c => Self { fx, fy, cx, cy, width, height, coefficients } with {
            camera_from_world: c.camera_from_world.transpose().to_cols_array(),
            translation: c.translation.to_array(),
            projection: c.projection as u32,
            readout: c.shutter.map_or(0, |shutter| 1 + shutter.readout as u32),
            shutter_turn: c.shutter.unwrap_or_default().turn.to_array(),
            shutter_shift: c.shutter.unwrap_or_default().shift.to_array(),
            ..Self::default()
        })
    }
}

impl AshsplatCamera {
    /// Converts to the engine's camera. Errors call it by this name.
    pub(super) fn known(&self, name: &str) -> Result<Camera> {
        let [down, up, right, left] = Readout::ALL.map(Some);
        let readout = one_of(format_args!("{name}.readout"), self.readout, &[None, down, up, right, left])?;
        let (turn, shift) = (Vec3::from(self.shutter_turn), Vec3::from(self.shutter_shift));
        Ok(same_fields!(self => Camera { fx, fy, cx, cy, width, height, coefficients } with {
            camera_from_world: Mat3::from_cols_array(&self.camera_from_world).transpose(),
            translation: Vec3::from(self.translation),
            projection: one_of(format_args!("{name}.projection"), self.projection, &Projection::ALL)?,
            part: None,
            shutter: readout.map(|readout| Shutter { readout, turn, shift }),
        }))
    }

    /// Same as [`Self::known`], but the camera is also checked.
    pub(super) fn checked(&self, name: &str) -> Result<Camera> {
        let camera = self.known(name)?;
        camera.check().map_err(named(name))?;
        Ok(camera)
    }
}

/// Conversion of a depth buffer's value d: 1/z = scale d + offset, or z = scale d + offset if it is linear. clear_value marks
/// pixels without a surface.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatDepthMapping {
    /// See above.
    pub scale: f32,
    /// See above.
    pub offset: f32,
    /// See above.
    pub clear_value: f32,
    /// True if z itself is linear in d, as for an orthographic projection.
    pub linear: bool,
}

impl From<DepthMapping> for AshsplatDepthMapping {
    fn from(m: DepthMapping) -> Self {
        same_fields!(m => Self { scale, offset, clear_value, linear } with {})
    }
}

impl From<AshsplatDepthMapping> for DepthMapping {
    fn from(m: AshsplatDepthMapping) -> Self {
        same_fields!(m => Self { scale, offset, clear_value, linear } with {})
    }
}

/// A host's device, and what was enabled when it was created.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatForeignDevice {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// vkGetInstanceProcAddr of the host's loader.
    pub get_instance_proc_addr: *const c_void,
    /// VkInstance.
    pub instance: *mut c_void,
    /// VkPhysicalDevice.
    pub physical_device: *mut c_void,
    /// VkDevice.
    pub device: *mut c_void,
    /// The family of the queues that recordings are submitted to.
    pub queue_family: u32,
    /// VkQueue for functions that submit, or NULL. Without a queue a context only records, and functions that submit are
    /// refused: rendering and training always, uploads (ashsplat_scene_load, ashsplat_scene_new with Gaussians) on devices
    /// whose memory the host cannot write. A scene is then made empty (ashsplat_scene_new) and filled by recorded updates,
    /// or is in the host's buffers (ashsplat_scene_from_buffers).
    pub queue: *mut c_void,
    /// The VkPhysicalDeviceVulkan12Features that the device was created with.
    pub vulkan12_features: *const c_void,
    /// The VkPhysicalDeviceVulkan13Features that the device was created with.
    pub vulkan13_features: *const c_void,
    /// Names of the device extensions that were enabled.
    pub extensions: *const *const c_char,
    /// Number of extensions.
    pub extension_count: u32,
    /// True if VK_EXT_debug_utils was enabled.
    pub debug_utils: bool,
    /// The allocator of the buffers' memory, or NULL for the device itself. The struct is copied; its
    /// pointees are not.
    pub allocator: *const AshsplatAllocator,
    /// A VkPipelineCache that kernels are built with, or 0. The host keeps and destroys it.
    pub pipeline_cache: u64,
    /// The argument of both functions below.
    pub queue_user: *mut c_void,
    /// Takes the host's lock around `queue`, or NULL if no other thread of the host submits to it while a function of this
    /// library does. Called from any thread, around each vkQueueSubmit2, and around a vkQueueWaitIdle after a wait has
    /// failed. A thread that holds the lock calls nothing that submits. Recording never takes it.
    pub lock_queue: Option<unsafe extern "C" fn(user: *mut c_void)>,
    /// Releases the lock, on the same thread. NULL with `lock_queue`.
    pub unlock_queue: Option<unsafe extern "C" fn(user: *mut c_void)>,
    /// VkBool32: true if VK_KHR_shader_maximal_reconvergence is among `extensions` and its shaderMaximalReconvergence was
    /// enabled. Kernels then ask the driver for it. 0 if not, or if unknown.
    pub shader_maximal_reconvergence: u32,
    /// VkBool32: the same for VK_KHR_shader_subgroup_uniform_control_flow and shaderSubgroupUniformControlFlow, for devices
    /// that lack the other one.
    pub shader_subgroup_uniform_control_flow: u32,
}

/// An image of a host's and how it was created: two-dimensional, optimal tiling.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatForeignImage {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// VkFormat.
    pub format: i32,
    /// VkImageUsageFlags.
    pub usage: u32,
    /// Width of the mip level, pixels.
    pub width: u32,
    /// Height of the mip level, pixels.
    pub height: u32,
    /// Index of the mip level.
    pub mip_level: u32,
    /// Index of the layer.
    pub layer: u32,
    /// VkImageCreateFlags. A target needs MUTABLE_FORMAT in formats other than R8G8B8A8_UNORM and the floats of 16 and 32
    /// bits; also EXTENDED_USAGE if the device has no storage images of the format. 8 bits per channel are viewed as
    /// R8G8B8A8_UNORM; A2B10G10R10, B10G11R11 and R16G16 as R32_UINT. R32G32B32A32_UINT needs no flags.
    pub flags: u32,
    /// VkSampleCountFlagBits: 1. Images of more samples are refused: resolve them into one of one sample.
    pub samples: u32,
    /// VkImage.
    pub image: u64,
}

/// Role of an image in a frame: one value for each field of AshsplatRecordedFrame. Each has formats of its own; others are refused.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatImageUse {
    /// Colours are written into it. R8G8B8A8 or B8G8R8A8, UNORM or SRGB; A2B10G10R10_UNORM_PACK32, B10G11R11_UFLOAT_PACK32,
    /// R16G16B16A16_SFLOAT or R32G32B32A32_SFLOAT.
    Target = 0,
    /// The host's depth, which hides splats. D16_UNORM, X8_D24_UNORM_PACK32, D32_SFLOAT, D16_UNORM_S8_UINT, D24_UNORM_S8_UINT,
    /// D32_SFLOAT_S8_UINT, R16_UNORM, R16_SFLOAT or R32_SFLOAT.
    Occluder = 1,
    /// The expected depth is written into it. R32_SFLOAT.
    Depth = 2,
    /// The Gaussian picked at each pixel is written into it. R32G32B32A32_UINT.
    Pick = 3,
    /// The motion of each pixel is written into it. R16G16_SFLOAT.
    Motion = 4,
    /// The normal and the depth of the surface at each pixel are written into it. R16G16B16A16_SFLOAT or R32G32B32A32_SFLOAT.
    Surface = 5,
}

/// How an image is being used at some point of a command buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct AshsplatImageState {
    /// VkImageLayout.
    pub layout: i32,
    /// VkPipelineStageFlags2.
    pub stages: u64,
    /// VkAccessFlags2.
    pub accesses: u64,
}

/// An image of a frame, and its previous use by the host.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatHostImage {
    /// The image. NULL is an error: for a frame without it, the pointer to the struct that has this image is NULL.
    pub image: *const AshsplatImage,
    /// The host's use of it before the frame.
    pub from: AshsplatImageState,
    /// Texel of the image that belongs to the frame's pixel (0, 0).
    pub offset: [u32; 2],
}

/// Resources that are allocated in advance for recording.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatReservation {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Frames in flight.
    pub slots: u32,
    /// Gaussians of all scenes of a frame together.
    pub gaussians: u32,
    /// Scenes of a frame.
    pub scenes: u32,
    /// Highest degree of the scenes' spherical harmonics, by default 0: ashsplat_scene_size tells a scene's. Frames evaluate no higher
    /// one (AshsplatRenderSettings.sh_degree).
    pub sh_degree: u32,
    /// (tile, Gaussian) instances of a frame; 0 for an estimate. AshsplatSlotReport has the number that a frame
    /// needs.
    pub instances: u32,
    /// Width of the largest picture, pixels. Pictures of any shape fit that need no more pixels and no more tiles
    /// of 16x16 pixels, for example the same size turned by 90 degrees.
    pub width: u32,
    /// Height of the largest picture, pixels: see `width`.
    pub height: u32,
    /// Passes of blending; 0 for an estimate: 1, or 2 where the driver bounds loops and a tile may have more entries than a pass
    /// takes. AshsplatSlotReport has the number that a frame needs.
    pub blend_passes: u32,
    /// Cut-outs of all scenes of a frame together.
    pub cut_outs: u32,
    /// True if frames will render the sum of weights / z.
    pub inverse_depth: bool,
    /// True if frames will read a host's depth image.
    pub occlusion: bool,
    /// True if frames will render expected depth.
    pub expected_depth: bool,
    /// True if all frames go into images (AshsplatRecordedFrame.target). Slots then have no pixels of their own.
    pub images_only: bool,
    /// Number of queues that frames are submitted to. Memory that only a running frame needs exists once for each queue:
    /// slots with the same slot % queues share it. Their frames go to one queue, in any order, or are ordered by semaphores.
    /// With as many queues as slots nothing is shared.
    pub queues: u32,
    /// True if scenes of frames will have a tint or an opacity (AshsplatSceneSettings).
    pub tint: bool,
    /// True if scenes of frames will have a selection.
    pub selection: bool,
    /// True if frames will have orthographic cameras, beside pinholes; also those of the frame before, for motion.
    pub orthographic: bool,
    /// True if frames will have what is picked at each pixel: 8 bytes of memory per pixel.
    pub pick: bool,
    /// True if frames will have motion: 8 bytes of memory per pixel and 8 per Gaussian.
    pub motion: bool,
    /// Bytes of staging memory for a frame's updates: ashsplat_update_bytes.
    pub staging_bytes: u64,
    /// Views of a recording (ashsplat_record_views), which share the memory of one; 0 means 1.
    pub views: u32,
    /// Not 0: views whose depths are the same, as those of two eyes side by side, are culled and sorted once. Takes 256 bytes for each
    /// scene and view, and more kernels.
    pub shared_sort: u32,
    /// Not 0: frames will draw scenes with a 3D filter (AshsplatRenderSettings.filter_3d).
    pub filter_3d: u64,
    /// AshsplatProjection of a lens that cameras of frames may have, beside pinholes; 0 for none.
    pub lens: u64,
    /// Not 0: frames will have cameras with a rolling shutter (AshsplatCamera.readout), beside others.
    pub rolling_shutter: u64,
    /// Not 0: scenes of frames will store SH in halves (ashsplat_scene_half), beside others.
    pub half_sh: u64,
    /// 0: frames will have no surfaces. Else 1 + the AshsplatSurfaceDepth of all of them: 16 bytes of memory per pixel and 16 per
    /// Gaussian.
    pub surface: u64,
}

impl AshsplatReservation {
    /// Converts to the engine's reservation.
    pub(super) fn checked(&self) -> Result<Reservation> {
        let w = self;
        let unknown = |what: &str, number: u64, all: &str| {
            Error::argument(format!("wanted.{what}"), format!("{number} is none of {all}"))
        };
        let place = |number: u64| usize::try_from(number).unwrap_or(usize::MAX);
        let lens = Projection::ALL.get(place(w.lens)).copied().filter(|lens| w.lens == 0 || lens.is_lens());
        let lens = lens.ok_or_else(|| unknown("lens", w.lens, "AshsplatProjection's lenses"))?;
        let surface = match w.surface.checked_sub(1) {
            None => None,
            Some(depth) => {
                let depth = surface_depths().get(place(depth)).copied();
                Some(depth.ok_or_else(|| unknown("surface", w.surface, "1 + AshsplatSurfaceDepth"))?)
            }
        };
        Ok(same_fields!(w => Reservation {
            slots, queues, scenes, instances, blend_passes, inverse_depth, occlusion, expected_depth, images_only, tint,
            cut_outs, selection, pick, motion, orthographic, staging_bytes,
        } with {
            views: w.views.max(1),
            shared_sort: w.shared_sort != 0,
            filter_3d: w.filter_3d != 0,
            rolling_shutter: w.rolling_shutter != 0,
            half_sh: w.half_sh != 0,
            surface,
            lens: Some(lens).filter(|lens| lens.is_lens()),
            ..Reservation::new(w.gaussians, w.sh_degree, w.width, w.height)
        }))
    }
}

/// Gaussians in a host's arrays, each as long as the count says. All but `means` are as in the reference
/// implementation's files, before their activations.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatGaussians {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Number of Gaussians.
    pub count: u32,
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// x, y, z each, units of the scene.
    pub means: *const f32,
    /// w, x, y, z each, of any length but 0.
    pub quats: *const f32,
    /// Logarithms of the standard deviations, three each.
    pub log_scales: *const f32,
    /// Opacities before the sigmoid.
    pub opacity_logits: *const f32,
    /// Red, green and blue of (sh_degree + 1)^2 coefficients each.
    pub sh: *const f32,
}

/// The layout of the parameters in a host's own buffers: planes of four floats. Plane 0 is the mean and the
/// opacity logit, 1 the quaternion (w, x, y, z), 2 the log-scales and the size of the 3D filter, 0 without. The others are the SH
/// coefficients, red, green and blue one after the other, padded with zeros. The groups of planes are 0 to 2 (geometry), 3,
/// 4 and 5, 6 to 9, and 10 to 14 (one degree each). A group is contiguous for all Gaussians, in rows of
/// eight. In the group of planes `first` to `end` - 1, plane p of the i-th Gaussian of a chunk begins at byte
/// 16 * (first * chunk_gaussians + (i / 8 * (end - first) + p - first) * 8 + i % 8).
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatScenePlan {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Number of buffers.
    pub chunks: u32,
    /// Planes of a Gaussian: three, and those of the spherical harmonics.
    pub planes: u32,
    /// Gaussians per buffer.
    pub chunk_gaussians: u32,
    /// Bytes per buffer.
    pub chunk_bytes: u64,
}

/// A range of a host's buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct AshsplatHostBuffer {
    /// VkBuffer.
    pub buffer: u64,
    /// A multiple of 256.
    pub offset: u64,
    /// A multiple of 4.
    pub bytes: u64,
}

/// New parameters for some of a scene's Gaussians, copied before the frame is rendered.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatUpdate {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The scene.
    pub scene: *const AshsplatScene,
    /// Index of the first replaced Gaussian.
    pub first: u32,
    /// The new Gaussians. SH above the scene's degree is dropped, missing SH is zero. They have no 3D filter until
    /// ashsplat_compute_filters.
    pub gaussians: *const AshsplatGaussians,
}

/// A scene and its pose: x_world = scale rotation x_object + translation.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatPlaced {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The scene.
    pub scene: *const AshsplatScene,
    /// A rotation, row by row.
    pub world_from_object: [f32; 9],
    /// World units.
    pub translation: [f32; 3],
    /// World units per unit of the scene, the same in all directions: 1 for no scaling.
    pub scale: f32,
    /// How it is drawn, or NULL: as it is.
    pub settings: *const AshsplatSceneSettings,
    /// Its pose in the previous frame, for AshsplatRecordedFrame.motion. NULL: the same as now, for scenes that stand still
    /// and for new ones.
    pub previous_pose: *const AshsplatPose,
}

impl AshsplatPlaced {
    /// Pose of the scene.
    pub fn pose(&self) -> Pose {
        pose_of(&self.world_from_object, self.translation, self.scale)
    }
}

/// Converts a pose with a rotation row by row.
pub(super) fn pose_of(rows: &[f32; 9], translation: [f32; 3], scale: f32) -> Pose {
    Pose {
        world_from_object: Mat3::from_cols_array(rows).transpose(),
        translation: Vec3::from(translation),
        scale,
    }
}

impl From<ImageState> for AshsplatImageState {
    fn from(s: ImageState) -> Self {
        Self { layout: s.layout.as_raw(), stages: s.stages.as_raw(), accesses: s.accesses.as_raw() }
    }
}

impl From<AshsplatImageState> for ImageState {
    fn from(s: AshsplatImageState) -> Self {
        Self {
            layout: vk::ImageLayout::from_raw(s.layout),
            stages: vk::PipelineStageFlags2::from_raw(s.stages),
            accesses: vk::AccessFlags2::from_raw(s.accesses),
        }
    }
}

/// At which pixels a Gaussian counts.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatExtent {
    /// Wherever its alpha is at least 1/255.
    Exact = 0,
    /// In the tiles of the reference implementation's square of three standard deviations.
    Reference = 1,
}

/// Directions within which the projection is linearised at the Gaussian itself. Outside, it is linearised at
/// the limit.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatJacobianLimit {
    /// The picture's edges and 0.3 tan(fov/2) beyond.
    Edge = 0,
    /// 1.3 tan(fov/2) on either side of the optical axis, as the reference implementation does.
    Symmetric = 1,
}

/// How each Gaussian is drawn.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatShape {
    /// The Gaussian itself.
    Gaussian = 0,
    /// An opaque ellipsoid of two standard deviations.
    Ellipsoid = 1,
    /// An opaque dot.
    Point = 2,
}

/// How a frame is rendered; by default as scenes are trained and shown.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatRenderSettings {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// An AshsplatExtent.
    pub extent: u32,
    /// An AshsplatJacobianLimit.
    pub jacobian_limit: u32,
    /// An AshsplatShape.
    pub shape: u32,
    /// Highest evaluated SH degree: 3 for all stored degrees.
    pub sh_degree: u32,
    /// True if opacities are compensated for the low-pass filter.
    pub antialias: bool,
    /// True if the sum of weights / z is rendered as well: ashsplat_slot_inverse_depth.
    pub inverse_depth: bool,
    /// Factor of all scales: 1 for the scene as it is.
    pub scale_modifier: f32,
    /// The low-pass filter: variance that the projection adds along both axes, square pixels. 0 means 0.3, as in the
    /// reference implementation; Mip-Splatting uses 0.1.
    pub kernel_size: f32,
    /// Not 0: gradients take the compensation of `antialias` as a constant.
    pub antialias_detached: u32,
    /// Not 0: Gaussians are drawn with Mip-Splatting's 3D filter, whose sizes ashsplat_compute_filters gives them. Frames
    /// with it need AshsplatReservation.filter_3d.
    pub filter_3d: u32,
}

/// Returns the value of an enumeration's number.
pub(super) fn one_of<T: Copy>(what: impl std::fmt::Display, number: u32, values: &[T]) -> Result<T> {
    let found = values.get(number as usize).copied();
    found.ok_or_else(|| {
        Error::argument(what.to_string(), format!("{number}, there are 0 to {}", values.len() - 1))
    })
}

impl AshsplatRenderSettings {
    /// Converts to the engine's settings, with a black background.
    pub(super) fn checked(&self) -> Result<RenderSettings> {
        let standard = RenderSettings::default();
        let dilation_px2 = match self.kernel_size {
            0.0 => standard.dilation_px2,
            own if own.is_finite() && own > 0.0 => own,
            other => {
                let problem = format!("is {other}, must be finite and positive, or 0 for the default");
                return Err(Error::argument("settings.kernel_size", problem));
            }
        };
        Ok(RenderSettings {
            extent: one_of("settings.extent", self.extent, &[Extent::Exact, Extent::Reference])?,
            jacobian_limit: one_of(
                "settings.jacobian_limit",
                self.jacobian_limit,
                &[JacobianLimit::Edge, JacobianLimit::Symmetric],
            )?,
            shape: one_of("settings.shape", self.shape, &[Shape::Gaussian, Shape::Ellipsoid, Shape::Point])?,
            sh_degree: Some(self.sh_degree),
            scale_modifier: self.scale_modifier,
            antialias: self.antialias,
            inverse_depth: self.inverse_depth,
            dilation_px2,
            antialias_detached: self.antialias_detached != 0,
            filter_3d: self.filter_3d != 0,
            ..standard
        })
    }
}
