/* The C interface of ashsplat. Generated from the sources in tools/capi: do not edit.
 * Structs that have struct_size begin with ASHSPLAT_INIT, which sets it and the defaults:
 *
 *     AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
 *     wanted.gaussians = 100000;
 *
 * New fields come at their ends. A host that was compiled with an older header works with this library: the
 * fields that it does not know have their defaults. So does one with a newer header as long as it sets
 * nothing that this library does not know. All other structs and the functions stay as they are. */

#ifndef ASHSPLAT_H
#define ASHSPLAT_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

// The result of a call.
typedef enum AshsplatStatus {
  // Success.
  AshsplatStatus_Ok = 0,
  // An argument is invalid.
  AshsplatStatus_Argument = 1,
  // A file cannot be read, written or understood.
  AshsplatStatus_File = 2,
  // There is no usable device.
  AshsplatStatus_NoDevice = 3,
  // The device lacks something, or the host has not enabled it.
  AshsplatStatus_MissingFeature = 4,
  // A limit or a capacity is exceeded.
  AshsplatStatus_TooLarge = 5,
  // A Vulkan call failed.
  AshsplatStatus_Vulkan = 6,
  // A defect of this library.
  AshsplatStatus_Internal = 7,
  // The device is lost, and its context is unusable.
  AshsplatStatus_DeviceLost = 8,
  // A submission has not finished within its timeout; it is still running.
  AshsplatStatus_Timeout = 9,
} AshsplatStatus;

// The background that the splats are composited over.
typedef enum AshsplatBackground {
  // A background colour; the result is opaque.
  AshsplatBackground_Color = 0,
  // Nothing: premultiplied colour and alpha.
  AshsplatBackground_Nothing = 1,
  // The image's content.
  AshsplatBackground_Image = 2,
} AshsplatBackground;

// Meaning of the colours that are written into a target.
typedef enum AshsplatColorEncoding {
  // The values that the splats were trained in: those of photographs, display-encoded by the curve of sRGB.
  AshsplatColorEncoding_AsTrained = 0,
  // Linear light with the primaries of sRGB, decoded after blending. Premultiplied colours are decoded before the product
  // with alpha. A target of an sRGB format encodes them again.
  AshsplatColorEncoding_LinearSrgb = 1,
} AshsplatColorEncoding;

// At which pixels a Gaussian counts.
typedef enum AshsplatExtent {
  // Wherever its alpha is at least 1/255.
  AshsplatExtent_Exact = 0,
  // In the tiles of the reference implementation's square of three standard deviations.
  AshsplatExtent_Reference = 1,
} AshsplatExtent;

// Role of an image in a frame: one value for each field of AshsplatRecordedFrame. Each has formats of its own; others are refused.
typedef enum AshsplatImageUse {
  // Colours are written into it. R8G8B8A8 or B8G8R8A8, UNORM or SRGB; A2B10G10R10_UNORM_PACK32, B10G11R11_UFLOAT_PACK32,
  // R16G16B16A16_SFLOAT or R32G32B32A32_SFLOAT.
  AshsplatImageUse_Target = 0,
  // The host's depth, which hides splats. D16_UNORM, X8_D24_UNORM_PACK32, D32_SFLOAT, D16_UNORM_S8_UINT, D24_UNORM_S8_UINT,
  // D32_SFLOAT_S8_UINT, R16_UNORM, R16_SFLOAT or R32_SFLOAT.
  AshsplatImageUse_Occluder = 1,
  // The expected depth is written into it. R32_SFLOAT.
  AshsplatImageUse_Depth = 2,
  // The Gaussian picked at each pixel is written into it. R32G32B32A32_UINT.
  AshsplatImageUse_Pick = 3,
  // The motion of each pixel is written into it. R16G16_SFLOAT.
  AshsplatImageUse_Motion = 4,
  // The normal and the depth of the surface at each pixel are written into it. R16G16B16A16_SFLOAT or R32G32B32A32_SFLOAT.
  AshsplatImageUse_Surface = 5,
} AshsplatImageUse;

// Directions within which the projection is linearised at the Gaussian itself. Outside, it is linearised at
// the limit.
typedef enum AshsplatJacobianLimit {
  // The picture's edges and 0.3 tan(fov/2) beyond.
  AshsplatJacobianLimit_Edge = 0,
  // 1.3 tan(fov/2) on either side of the optical axis, as the reference implementation does.
  AshsplatJacobianLimit_Symmetric = 1,
} AshsplatJacobianLimit;

// How the directions of a camera reach its picture. Frames of cameras with a lens need AshsplatReservation.lens. (a, b) is
// (x, y)/z, or for fisheyes (x, y) theta/rho, s = a^2 + b^2, and T the tangential term of p1, p2.
typedef enum AshsplatProjection {
  // Through one point: a pinhole.
  AshsplatProjection_Perspective = 0,
  // In parallel, along the camera's z axis. Frames of such cameras need AshsplatReservation.orthographic.
  AshsplatProjection_Orthographic = 1,
  // (a, b) (1 + k1 s + k2 s^2 + k3 s^3 + n4 s^4) / (1 + k4 s + k5 s^2 + k6 s^3) + T: k1 k2 p1 p2 k3 k4 k5 k6 n4.
  AshsplatProjection_Brown = 2,
  // (a, b) atan(2 r tan(omega/2)) / (r omega), r = sqrt(s): omega.
  AshsplatProjection_Fov = 3,
  // (a, b) 2 / (1 + sqrt(1 - 4 k s)): k.
  AshsplatProjection_Division = 4,
  // (a, b) / (alpha sqrt(beta s + 1) + 1 - alpha): alpha beta.
  AshsplatProjection_Eucm = 5,
  // (a, b) (1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4) + T + (sx1, sy1) s: k1 k2 p1 p2 k3 k4 sx1 sy1.
  AshsplatProjection_Fisheye = 6,
  // COLMAP's RAD_TAN_THIN_PRISM_FISHEYE: k0 to k5 p0 p1 s0 s1 s2 s3.
  AshsplatProjection_ThinPrismFisheye = 7,
  // Longitude and latitude: a panorama. fx is width/2pi, fy height/pi.
  AshsplatProjection_Equirectangular = 8,
} AshsplatProjection;

// How a picture is read. Frames of cameras with a rolling shutter need AshsplatReservation.rolling_shutter.
typedef enum AshsplatReadout {
  // At once.
  AshsplatReadout_Global = 0,
  // Row by row, the uppermost first.
  AshsplatReadout_Down = 1,
  // Row by row, the lowest first.
  AshsplatReadout_Up = 2,
  // Column by column, the leftmost first.
  AshsplatReadout_Right = 3,
  // Column by column, the rightmost first.
  AshsplatReadout_Left = 4,
} AshsplatReadout;

// How each Gaussian is drawn.
typedef enum AshsplatShape {
  // The Gaussian itself.
  AshsplatShape_Gaussian = 0,
  // An opaque ellipsoid of two standard deviations.
  AshsplatShape_Ellipsoid = 1,
  // An opaque dot.
  AshsplatShape_Point = 2,
} AshsplatShape;

// Storage of a scene's SH coefficients on the device.
typedef enum AshsplatShStorage {
  // Floats: a Gaussian of SH degree 3 takes 240 bytes with its other parameters.
  AshsplatShStorage_F32 = 0,
  // Halves, each rounded to the nearest: 144 bytes. Frames that are recorded need AshsplatReservation.half_sh.
  AshsplatShStorage_Half = 1,
  // Bytes, but floats for the base colour: 112 bytes. Exact where all other coefficients of a Gaussian are multiples of 1/128 from -1
  // to below 1, or from above -1 to 1, as in SPZ files, otherwise rounded to steps of the largest / 127. Frames that are recorded need
  // AshsplatReservation.byte_sh.
  AshsplatShStorage_Bytes = 2,
} AshsplatShStorage;

// Depth at which a pixel's surface lies.
typedef enum AshsplatSurfaceDepth {
  // The transmittance falls below a half.
  AshsplatSurfaceDepth_Median = 0,
  // The transmittance falls below 0.7, which is nearer to the surfaces of scenes that were trained on colours alone.
  AshsplatSurfaceDepth_Front = 1,
} AshsplatSurfaceDepth;

// The shape of a volume.
typedef enum AshsplatVolume {
  // A box around the origin of its own axes.
  AshsplatVolume_Box = 0,
  // An ellipsoid around the origin.
  AshsplatVolume_Ellipsoid = 1,
  // The points x with normal x <= offset.
  AshsplatVolume_HalfSpace = 2,
} AshsplatVolume;

// A device that everything runs on.
typedef struct AshsplatContext AshsplatContext;

// A view of a host's image.
typedef struct AshsplatImage AshsplatImage;

// The kernels of a reservation, to be built on threads of the host's choice.
typedef struct AshsplatKernels AshsplatKernels;

// A network of LPIPS with its weights on a device.
typedef struct AshsplatLpips AshsplatLpips;

// Renders scenes.
typedef struct AshsplatRenderer AshsplatRenderer;

// Gaussians on a device.
typedef struct AshsplatScene AshsplatScene;

// The Gaussians of a tile, in the host's memory.
typedef struct AshsplatTileGaussians AshsplatTileGaussians;

// Trains Gaussians on photographs.
typedef struct AshsplatTrainer AshsplatTrainer;

// A tree of tiles in a folder, as `ashsplat tiles` writes it. It does not change: all threads may use it at once.
typedef struct AshsplatTree AshsplatTree;

// A camera, x right, y down, z forward: x_camera = R x_world + t, pixel = (fx x/z + cx, fy y/z + cy), or (fx x + cx,
// fy y + cy) if it is orthographic, where the centre of the first pixel is (0.5, 0.5).
typedef struct AshsplatCamera {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // R, row by row.
  float camera_from_world[9];
  // t, world units.
  float translation[3];
  // Focal length in x, pixels; pixels per world unit if it is orthographic.
  float fx;
  // Focal length in y: as fx.
  float fy;
  // Principal point in x, pixels.
  float cx;
  // Principal point in y, pixels.
  float cy;
  // Width of the picture, pixels.
  uint32_t width;
  // Height of the picture, pixels.
  uint32_t height;
  // An AshsplatProjection.
  uint32_t projection;
  // Coefficients of the projection's lens, in COLMAP's order; zeros after the last, and for other projections.
  float coefficients[12];
  // An AshsplatReadout: how a rolling shutter reads the picture. The pose is that halfway; row t, from -1/2 for the first to
  // 1/2 for the last, shows a point of that camera's space at exp(t turn^) (x - t shift).
  uint32_t readout;
  // Turn of the scene from the first row to the last: axis times angle, radians; at most half a circle.
  float shutter_turn[3];
  // Way of the camera's centre from the first row to the last, world units, in the space of the camera halfway.
  float shutter_shift[3];
} AshsplatCamera;

// How a frame is rendered; by default as scenes are trained and shown.
typedef struct AshsplatRenderSettings {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // An AshsplatExtent.
  uint32_t extent;
  // An AshsplatJacobianLimit.
  uint32_t jacobian_limit;
  // An AshsplatShape.
  uint32_t shape;
  // Highest evaluated SH degree: 3 for all stored degrees.
  uint32_t sh_degree;
  // True if opacities are compensated for the low-pass filter.
  bool antialias;
  // True if the sum of weights / z is rendered as well: ashsplat_slot_inverse_depth.
  bool inverse_depth;
  // Factor of all scales: 1 for the scene as it is.
  float scale_modifier;
  // The low-pass filter: variance that the projection adds along both axes, square pixels. 0 means 0.3, as in the
  // reference implementation; Mip-Splatting uses 0.1.
  float kernel_size;
  // Not 0: gradients take the compensation of `antialias` as a constant.
  uint32_t antialias_detached;
  // Not 0: Gaussians are drawn with Mip-Splatting's 3D filter, whose sizes ashsplat_compute_filters gives them. Frames
  // with it need AshsplatReservation.filter_3d.
  uint32_t filter_3d;
  // Not 0: Gaussians are blended in the order of their distances instead of their z, so that none swap places when the camera
  // turns. Frames with it need AshsplatReservation.distance_order.
  uint32_t distance_order;
} AshsplatRenderSettings;

// Arrays of the host that receive gradients, each as long as the scene and shaped as in AshsplatGaussians. NULL leaves a
// gradient out.
typedef struct AshsplatGradients {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // By the means: three each, 1 / units of the scene.
  float *means;
  // By the quaternions as they are stored: four each.
  float *quats;
  // By the logarithms of the standard deviations: three each.
  float *log_scales;
  // By the opacities before the sigmoid.
  float *opacity_logits;
  // By the coefficients of all stored degrees: three for each of (sh_degree + 1)^2. Those of degrees that are not evaluated are 0.
  float *sh;
  // By the centres in the picture: two each, 1 / pixels. 0 for Gaussians that are not visible.
  float *mean2d_px;
  // By the camera's pose T, from world to camera: six floats dL/dδ at δ = 0 of exp(δ^) T. The first three are
  // displacements of the scene along the camera's axes (x right, y down, z forward), 1 / world units; the others are
  // turns of it about these axes, 1 / radians.
  float *pose;
} AshsplatGradients;

// How ashsplat_align moves a camera: by Adam.
typedef struct AshsplatAlignment {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Number of steps; 100 reach about 2.5 degrees.
  uint32_t steps;
  // Initial learning rate of turns, radians; of displacements, times the mean depth. It falls log-linearly to a
  // hundredth.
  double lr;
  // Weight of 1 - SSIM in the loss, 0 to 1; L1 takes the rest.
  double lambda_dssim;
} AshsplatAlignment;

// A request for a buffer's memory.
typedef struct AshsplatMemoryRequest {
  // The buffer's name, for debugging; valid during the call.
  const char *name;
  // Bytes.
  uint64_t bytes;
  // The piece begins at a multiple of this in its memory.
  uint64_t alignment;
  // Bit i: memory type i is allowed.
  uint32_t memory_types;
  // True if it must be mapped; otherwise it should be device-local.
  bool host_visible;
} AshsplatMemoryRequest;

// A piece of device memory.
typedef struct AshsplatMemory {
  // VkDeviceMemory.
  uint64_t memory;
  // Byte offset of the piece in the memory object.
  uint64_t offset;
  // Host address of the piece if it is mapped, otherwise NULL.
  void *mapped;
  // An identifier for the allocator's own use.
  uint64_t id;
} AshsplatMemory;

// A host's allocator, which provides the memory of all buffers. Functions that allocate or free call it, also from other
// threads. Recording never allocates, but frees memory that only the slot's last frame used, unless ashsplat_slot_release
// has done so.
typedef struct AshsplatAllocator {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // The first argument of both functions.
  void *user;
  // Allocates a piece; false when it cannot. Mapped memory has to be host-coherent.
  bool (*allocate)(void *user, const struct AshsplatMemoryRequest *request, struct AshsplatMemory *memory);
  // Frees a piece that is not in use any more.
  void (*free)(void *user, struct AshsplatMemory memory);
} AshsplatAllocator;

// A host's device, and what was enabled when it was created.
typedef struct AshsplatForeignDevice {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // vkGetInstanceProcAddr of the host's loader.
  const void *get_instance_proc_addr;
  // VkInstance.
  void *instance;
  // VkPhysicalDevice.
  void *physical_device;
  // VkDevice.
  void *device;
  // The family of the queues that recordings are submitted to.
  uint32_t queue_family;
  // VkQueue for functions that submit, or NULL. Without a queue a context only records, and functions that submit are
  // refused: rendering and training always, uploads (ashsplat_scene_load, ashsplat_scene_new with Gaussians) on devices
  // whose memory the host cannot write. A scene is then made empty (ashsplat_scene_new) and filled by recorded updates,
  // or is in the host's buffers (ashsplat_scene_from_buffers).
  void *queue;
  // The VkPhysicalDeviceVulkan12Features that the device was created with.
  const void *vulkan12_features;
  // The VkPhysicalDeviceVulkan13Features that the device was created with.
  const void *vulkan13_features;
  // Names of the device extensions that were enabled.
  const char *const *extensions;
  // Number of extensions.
  uint32_t extension_count;
  // True if VK_EXT_debug_utils was enabled.
  bool debug_utils;
  // The allocator of the buffers' memory, or NULL for the device itself. The struct is copied; its
  // pointees are not.
  const struct AshsplatAllocator *allocator;
  // A VkPipelineCache that kernels are built with, or 0. The host keeps and destroys it.
  uint64_t pipeline_cache;
  // The argument of both functions below.
  void *queue_user;
  // Takes the host's lock around `queue`, or NULL if no other thread of the host submits to it while a function of this
  // library does. Called from any thread, around each vkQueueSubmit2, and around a vkQueueWaitIdle after a wait has
  // failed. A thread that holds the lock calls nothing that submits. Recording never takes it.
  void (*lock_queue)(void *user);
  // Releases the lock, on the same thread. NULL with `lock_queue`.
  void (*unlock_queue)(void *user);
  // VkBool32: true if VK_KHR_shader_maximal_reconvergence is among `extensions` and its shaderMaximalReconvergence was
  // enabled. Kernels then ask the driver for it. 0 if not, or if unknown.
  uint32_t shader_maximal_reconvergence;
  // VkBool32: the same for VK_KHR_shader_subgroup_uniform_control_flow and shaderSubgroupUniformControlFlow, for devices
  // that lack the other one.
  uint32_t shader_subgroup_uniform_control_flow;
} AshsplatForeignDevice;

// An image of a host's and how it was created: two-dimensional, optimal tiling.
typedef struct AshsplatForeignImage {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // VkFormat.
  int32_t format;
  // VkImageUsageFlags.
  uint32_t usage;
  // Width of the mip level, pixels.
  uint32_t width;
  // Height of the mip level, pixels.
  uint32_t height;
  // Index of the mip level.
  uint32_t mip_level;
  // Index of the layer.
  uint32_t layer;
  // VkImageCreateFlags. A target needs MUTABLE_FORMAT in formats other than R8G8B8A8_UNORM and the floats of 16 and 32
  // bits; also EXTENDED_USAGE if the device has no storage images of the format. 8 bits per channel are viewed as
  // R8G8B8A8_UNORM; A2B10G10R10, B10G11R11 and R16G16 as R32_UINT. R32G32B32A32_UINT needs no flags.
  uint32_t flags;
  // VkSampleCountFlagBits: 1. Images of more samples are refused: resolve them into one of one sample.
  uint32_t samples;
  // VkImage.
  uint64_t image;
} AshsplatForeignImage;

// Conversion of a depth buffer's value d: 1/z = scale d + offset, or z = scale d + offset if it is linear. clear_value marks
// pixels without a surface.
typedef struct AshsplatDepthMapping {
  // See above.
  float scale;
  // See above.
  float offset;
  // See above.
  float clear_value;
  // True if z itself is linear in d, as for an orthographic projection.
  bool linear;
} AshsplatDepthMapping;

// A volume that keeps or removes the Gaussians whose means lie inside. A Gaussian is drawn if it lies in some volume that keeps
// (when there are any) and in none that removes.
typedef struct AshsplatCutOut {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // True if what lies inside is removed, instead of kept.
  bool removes;
  // An AshsplatVolume.
  uint32_t volume;
  // Half of the size along each of its axes, positive; of a half-space the normal, out of it, of any length but 0.
  float size[3];
  // A half-space's plane is normal x = offset. It lies at offset / |normal| along the normal: a distance in units of
  // the volume if the normal has length 1.
  float offset;
  // From its axes to the scene's own, before the scene's pose: a rotation, row by row.
  float scene_from_volume[9];
  // Its origin, units of the scene.
  float translation[3];
  // Units of the scene per unit of the volume: 1 for no scaling.
  float scale;
} AshsplatCutOut;

// A range of a host's buffer.
typedef struct AshsplatHostBuffer {
  // VkBuffer.
  uint64_t buffer;
  // A multiple of 256.
  uint64_t offset;
  // A multiple of 4.
  uint64_t bytes;
} AshsplatHostBuffer;

// How one scene of a frame is drawn; by default as it is.
typedef struct AshsplatSceneSettings {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // True if it is drawn. An invisible scene takes no Gaussians of the reservation and no time on the device. It counts
  // among its scenes, and the others keep their indices.
  bool visible;
  // Factors of red, green and blue, 0 to 1000 each, of the colours as trained. The product is at most 65504.
  float tint[3];
  // Factor of the opacities, 0 to 1. 0 hides the scene.
  float opacity;
  // Highest evaluated SH degree: 3 for all stored degrees.
  uint32_t sh_degree;
  // Number of cut-outs, at most 16.
  uint32_t cut_out_count;
  // Volumes that keep or remove Gaussians.
  const struct AshsplatCutOut *cut_outs;
  // Mask of selected Gaussians, or NULL: bit i % 32 of word i / 32 for Gaussian i. The buffer has whole words for all
  // Gaussians and the usages STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST. It is destroyed after ashsplat_slot_release
  // of every slot that was recorded with it.
  const struct AshsplatHostBuffer *selection;
  // Colour of selected Gaussians, as trained, 0 to 65504 each.
  float selection_color[3];
  // Its share in the drawn colour, 0 to 1.
  float selection_share;
} AshsplatSceneSettings;

// A pose in the world: x_world = scale rotation x_object + translation.
typedef struct AshsplatPose {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // A rotation, row by row.
  float world_from_object[9];
  // World units.
  float translation[3];
  // World units per unit of the scene, the same in all directions: 1 for no scaling.
  float scale;
} AshsplatPose;

// A scene and its pose: x_world = scale rotation x_object + translation.
typedef struct AshsplatPlaced {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // The scene.
  const struct AshsplatScene *scene;
  // A rotation, row by row.
  float world_from_object[9];
  // World units.
  float translation[3];
  // World units per unit of the scene, the same in all directions: 1 for no scaling.
  float scale;
  // How it is drawn, or NULL: as it is.
  const struct AshsplatSceneSettings *settings;
  // Its pose in the previous frame, for AshsplatRecordedFrame.motion. NULL: the same as now, for scenes that stand still
  // and for new ones.
  const struct AshsplatPose *previous_pose;
} AshsplatPlaced;

// How an image is being used at some point of a command buffer.
typedef struct AshsplatImageState {
  // VkImageLayout.
  int32_t layout;
  // VkPipelineStageFlags2.
  uint64_t stages;
  // VkAccessFlags2.
  uint64_t accesses;
} AshsplatImageState;

// An image of a frame, and its previous use by the host.
typedef struct AshsplatHostImage {
  // The image. NULL is an error: for a frame without it, the pointer to the struct that has this image is NULL.
  const struct AshsplatImage *image;
  // The host's use of it before the frame.
  struct AshsplatImageState from;
  // Texel of the image that belongs to the frame's pixel (0, 0).
  uint32_t offset[2];
} AshsplatHostImage;

// The image that a frame's colours are written to.
typedef struct AshsplatTarget {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // The background: an AshsplatBackground.
  uint32_t behind;
  // Its colour, for AshsplatBackground_Color: display-encoded, as trained.
  float background[3];
  // Meaning of the target's colours: an AshsplatColorEncoding.
  uint32_t encoding;
  // Factor of linear light, finite and positive, for AshsplatColorEncoding_LinearSrgb: 1 by default.
  float exposure;
  // The image.
  struct AshsplatHostImage to;
} AshsplatTarget;

// A host's depth image. It hides the splats that are farther away.
typedef struct AshsplatOccluder {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // The depth image, adopted for AshsplatImageUse_Occluder.
  struct AshsplatHostImage depth;
  // How to read it: ashsplat_camera_from_matrices.
  struct AshsplatDepthMapping mapping;
} AshsplatOccluder;

// An image of expected depth: sum(w z) / sum(w), world units.
typedef struct AshsplatDepthTarget {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // A pixel is empty if the splats' weights sum to less.
  float min_weight;
  // The depth of empty pixels.
  float empty;
  // The r32f image.
  struct AshsplatHostImage to;
} AshsplatDepthTarget;

// Gaussians in a host's arrays, each as long as the count says. All but `means` are as in the reference
// implementation's files, before their activations.
typedef struct AshsplatGaussians {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Number of Gaussians.
  uint32_t count;
  // Degree of the spherical harmonics, 0 to 3.
  uint32_t sh_degree;
  // x, y, z each, units of the scene.
  const float *means;
  // w, x, y, z each, of any length but 0.
  const float *quats;
  // Logarithms of the standard deviations, three each.
  const float *log_scales;
  // Opacities before the sigmoid.
  const float *opacity_logits;
  // Red, green and blue of (sh_degree + 1)^2 coefficients each.
  const float *sh;
} AshsplatGaussians;

// New parameters for some of a scene's Gaussians, copied before the frame is rendered.
typedef struct AshsplatUpdate {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // The scene.
  const struct AshsplatScene *scene;
  // Index of the first replaced Gaussian.
  uint32_t first;
  // The new Gaussians. SH above the scene's degree is dropped, missing SH is zero. They have no 3D filter until
  // ashsplat_compute_filters.
  const struct AshsplatGaussians *gaussians;
} AshsplatUpdate;

// An image of what is picked at each pixel: the Gaussian with the largest blending weight alpha T, the nearest of equal ones.
typedef struct AshsplatPickTarget {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // A storage image of format R32G32B32A32_UINT. A texel is the index of the Gaussian in its scene, the index of the scene in
  // AshsplatRecordedFrame.scenes, the bits of the float of its depth z (world units), and the bits of the float of its weight.
  // Where nothing is blended, the first two are UINT32_MAX, the others 0. Its image is never NULL: AshsplatRecordedFrame.pick
  // is NULL in a frame without picks.
  struct AshsplatHostImage to;
} AshsplatPickTarget;

// An image of motion: for each pixel the mean motion on the screen of the blended Gaussians, from the previous frame to
// this one, weighted as in blending. A Gaussian moves as its mean does, at most by the picture's width and height. Its
// motion is 0 if its earlier place is unknown: its mean was not in front of the earlier camera (z above 0.2), or too far
// away for a float. Motion by updates is not included.
typedef struct AshsplatMotionTarget {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // A pixel is empty if the splats' weights sum to less.
  float min_weight;
  // The motion of empty pixels, pixels.
  float empty[2];
  // True if empty pixels keep the image's contents instead of `empty`.
  bool keeps_empty;
  // The camera of the previous frame, of the same width and height. Motion is measured from its own principal point to
  // that of the frame's camera. Earlier poses are in AshsplatPlaced.
  const struct AshsplatCamera *previous_camera;
  // A storage image of format R16G16_SFLOAT, with MUTABLE_FORMAT (AshsplatForeignImage.flags): the place now minus the
  // place before, pixels, x right, y down. A point at pixel p was at p - motion. Its image is never NULL:
  // AshsplatRecordedFrame.motion is NULL in a frame without motion.
  struct AshsplatHostImage to;
} AshsplatMotionTarget;

// An image of surfaces: for each pixel the normal and the depth of the surface.
typedef struct AshsplatSurfaceTarget {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Kind of the surface's depth, an AshsplatSurfaceDepth: the same as AshsplatReservation.surface.
  uint32_t depth;
  // A storage image of format R16G16B16A16_SFLOAT or R32G32B32A32_SFLOAT. A texel is the mean of the Gaussians' normals, weighted
  // as in blending, of unit length in the camera's frame (x right, y down, z forward), and the surface's depth z there, world
  // units. All are 0 without a surface, and the normal is 0 where normals cancel out. A Gaussian's normal is its shortest
  // axis, turned towards the camera. Halves store depths below 65504, to 1 in 2000. Fisheyes and panoramas have the
  // distance from the camera instead of z, all lenses that of the Gaussian's mean. Rolling shutters have the normals of
  // the pose halfway. Its image is never NULL: AshsplatRecordedFrame.surface is NULL in a frame without surfaces.
  struct AshsplatHostImage to;
} AshsplatSurfaceTarget;

// A frame to record.
typedef struct AshsplatRecordedFrame {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Number of scenes, at least one.
  uint32_t scene_count;
  // Number of updates.
  uint32_t update_count;
  // The scenes, whose Gaussians are sorted together.
  const struct AshsplatPlaced *scenes;
  // The camera; its width and height are the frame's.
  const struct AshsplatCamera *camera;
  // How to render, or NULL for the defaults.
  const struct AshsplatRenderSettings *settings;
  // The image that receives the colours, or NULL for the slot's own buffer (ashsplat_slot_pixels).
  const struct AshsplatTarget *target;
  // The host's depth image, which hides splats that are farther away, or NULL.
  const struct AshsplatOccluder *occluder;
  // The image that receives expected depth, or NULL.
  const struct AshsplatDepthTarget *depth;
  // Parameter updates before the frame.
  const struct AshsplatUpdate *updates;
  // The image that receives picks, or NULL: none are computed then.
  const struct AshsplatPickTarget *pick;
  // The image that receives motion, or NULL: none is computed then.
  const struct AshsplatMotionTarget *motion;
  // The image that receives normals and depths of the surface, or NULL: none are computed then.
  const struct AshsplatSurfaceTarget *surface;
} AshsplatRecordedFrame;

// The state after a recording. The next user of its results waits for these stages and accesses, and finds
// the images in these layouts.
typedef struct AshsplatRelease {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // VkPipelineStageFlags2 that write results.
  uint64_t stages;
  // VkAccessFlags2 that they write with.
  uint64_t accesses;
  // Last use of the target.
  struct AshsplatImageState color;
  // Last use of the host's depth image.
  struct AshsplatImageState occluder;
  // Last use of the image of expected depth.
  struct AshsplatImageState depth;
  // Last use of the image of what is picked.
  struct AshsplatImageState pick;
  // Last use of the image of motion.
  struct AshsplatImageState motion;
  // Last use of the image of surfaces.
  struct AshsplatImageState surface;
} AshsplatRelease;

// Resources that are allocated in advance for recording.
typedef struct AshsplatReservation {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Frames in flight.
  uint32_t slots;
  // Gaussians of all scenes of a frame together.
  uint32_t gaussians;
  // Scenes of a frame.
  uint32_t scenes;
  // Highest degree of the scenes' spherical harmonics, by default 0: ashsplat_scene_size tells a scene's. Frames evaluate no higher
  // one (AshsplatRenderSettings.sh_degree).
  uint32_t sh_degree;
  // (tile, Gaussian) instances of a frame; 0 for an estimate. AshsplatSlotReport has the number that a frame
  // needs.
  uint32_t instances;
  // Width of the largest picture, pixels. Pictures of any shape fit that need no more pixels and no more tiles
  // of 16x16 pixels, for example the same size turned by 90 degrees.
  uint32_t width;
  // Height of the largest picture, pixels: see `width`.
  uint32_t height;
  // Passes of blending; 0 for an estimate: 1, or 2 where the driver bounds loops and a tile may have more entries than a pass
  // takes. AshsplatSlotReport has the number that a frame needs.
  uint32_t blend_passes;
  // Cut-outs of all scenes of a frame together.
  uint32_t cut_outs;
  // True if frames will render the sum of weights / z.
  bool inverse_depth;
  // True if frames will read a host's depth image.
  bool occlusion;
  // True if frames will render expected depth.
  bool expected_depth;
  // True if all frames go into images (AshsplatRecordedFrame.target). Slots then have no pixels of their own.
  bool images_only;
  // Number of queues that frames are submitted to. Memory that only a running frame needs exists once for each queue:
  // slots with the same slot % queues share it. Their frames go to one queue, in any order, or are ordered by semaphores.
  // With as many queues as slots nothing is shared.
  uint32_t queues;
  // True if scenes of frames will have a tint or an opacity (AshsplatSceneSettings).
  bool tint;
  // True if scenes of frames will have a selection.
  bool selection;
  // True if frames will have orthographic cameras, beside pinholes; also those of the frame before, for motion.
  bool orthographic;
  // True if frames will have what is picked at each pixel: 8 bytes of memory per pixel.
  bool pick;
  // True if frames will have motion: 8 bytes of memory per pixel and 8 per Gaussian.
  bool motion;
  // Bytes of staging memory for a frame's updates: ashsplat_update_bytes.
  uint64_t staging_bytes;
  // Views of a recording (ashsplat_record_views), which share the memory of one; 0 means 1.
  uint32_t views;
  // Not 0: views whose depths are the same, as those of two eyes side by side, are culled and sorted once. Takes 256 bytes for each
  // scene and view, and more kernels.
  uint32_t shared_sort;
  // Not 0: frames will draw scenes with a 3D filter (AshsplatRenderSettings.filter_3d).
  uint64_t filter_3d;
  // AshsplatProjection of a lens that cameras of frames may have, beside pinholes; 0 for none.
  uint64_t lens;
  // Not 0: frames will have cameras with a rolling shutter (AshsplatCamera.readout), beside others.
  uint64_t rolling_shutter;
  // Not 0: scenes of frames will store SH in halves (ashsplat_scene_stored), beside others.
  uint64_t half_sh;
  // Not 0: scenes of frames will store SH in bytes, beside others.
  uint64_t byte_sh;
  // 0: frames will have no surfaces. Else 1 + the AshsplatSurfaceDepth of all of them: 16 bytes of memory per pixel and 16 per
  // Gaussian.
  uint64_t surface;
  // Not 0: frames will be blended in the order of distances (AshsplatRenderSettings.distance_order).
  uint64_t distance_order;
} AshsplatReservation;

// The layout of the parameters in a host's own buffers: planes of four floats. Plane 0 is the mean and the
// opacity logit, 1 the quaternion (w, x, y, z), 2 the log-scales and the size of the 3D filter, 0 without. The others are the SH
// coefficients, red, green and blue one after the other, padded with zeros. The groups of planes are 0 to 2 (geometry), 3,
// 4 and 5, 6 to 9, and 10 to 14 (one degree each). A group is contiguous for all Gaussians, in rows of
// eight. In the group of planes `first` to `end` - 1, plane p of the i-th Gaussian of a chunk begins at byte
// 16 * (first * chunk_gaussians + (i / 8 * (end - first) + p - first) * 8 + i % 8).
typedef struct AshsplatScenePlan {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Number of buffers.
  uint32_t chunks;
  // Planes of a Gaussian: three, and those of the spherical harmonics.
  uint32_t planes;
  // Gaussians per buffer.
  uint32_t chunk_gaussians;
  // Bytes per buffer.
  uint64_t chunk_bytes;
} AshsplatScenePlan;

// The report of a recorded frame.
typedef struct AshsplatSlotReport {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // True if the frame has finished. The other fields are valid only then.
  bool finished;
  // True if more instances (`instances_needed` for `instance_capacity`) or passes (`blend_passes_needed` for
  // `blend_passes`) are needed than there were. The picture then lacks the Gaussians farthest away, or all of them if
  // `instances_needed` is `UINT32_MAX`. ashsplat_reservation_grown enlarges the reservation, except in the last case.
  bool overflow;
  // Gaussians in the frame's scenes, without those of scenes that are not drawn.
  uint32_t gaussians;
  // Visible Gaussians.
  uint32_t visible;
  // (tile, Gaussian) instances that the picture needs.
  uint32_t instances_needed;
  // The frame's capacity in instances.
  uint32_t instance_capacity;
  // Entries of the longest tile.
  uint32_t longest_tile;
  // Passes of blending that the longest tile needs.
  uint32_t blend_passes_needed;
  // Time on the device, nanoseconds; 0 without timestamps. With many views, only the recording's first 255 stages count.
  double nanoseconds;
  // How often the recording sorts by depth: once for each view, or for each run of views that share it
  // (AshsplatReservation.shared_sort).
  uint32_t sorts;
  // Scenes that were drawn together with others by one dispatch, in all views: scenes of ashsplat_scenes_new, or one scene that
  // is placed many times.
  uint32_t batched_scenes;
  // Passes of blending that the frame was recorded with.
  uint32_t blend_passes;
  // Entries of a tile that a pass takes.
  uint32_t entries_per_pass;
} AshsplatSlotReport;

// A photograph to train on, and its camera.
typedef struct AshsplatTrainView {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // The camera; its size is the photograph's.
  const struct AshsplatCamera *camera;
  // Red, green and blue of each pixel, a byte each, row by row.
  const uint8_t *rgb;
  // A byte per pixel, row by row: those with 0 do not count. NULL: all count.
  const uint8_t *mask;
  // The inverse depth that pixels should have, row by row, 1 / world units; infinite where it is not known. NULL: none.
  const float *inverse_depth;
  // Sparse points that the photograph shows, for the setting depth_points; not together with inverse_depth. Three floats
  // each: where the photograph shows it, pixels, x to the right and y down, the first pixel's centre at 0, 0; and 1 / z
  // in the camera's frame, 1 / world units. May be NULL.
  const float *depth_points;
  // Number of depth points.
  uint32_t depth_point_count;
  // Id of the camera that took the photograph. Views with the same id share lens effects.
  uint32_t camera_id;
} AshsplatTrainView;

// The report of a training step.
typedef struct AshsplatStep {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // True if the step has finished. The other fields are valid only then.
  bool finished;
  // True if it changed nothing, because a capacity was too small. ashsplat_trainer_maintain grows it. Then
  // the iteration is recorded again.
  bool overflow;
  // Its iteration, from 1.
  uint32_t iteration;
  // The loss before it; NaN if the iteration was skipped, because its frame exceeds the largest possible
  // capacity.
  float loss;
  // Number of Gaussians.
  uint32_t gaussians;
  // Gaussians visible in its view.
  uint32_t visible;
  // (tile, Gaussian) instances that its view needs; after an overflow those of the visible Gaussians that there was room for.
  uint32_t instances;
  // Index of its view.
  uint32_t view;
} AshsplatStep;

// The report of ashsplat_trainer_maintain.
typedef struct AshsplatMaintenance {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // True if Gaussians were added and removed.
  bool densified;
  // True if opacities were reset.
  bool opacities_reset;
  // True if the capacity has grown.
  bool grown;
  // The iteration that was skipped, because its frame exceeds the largest possible capacity; 0 for none.
  // The next step is the iteration after it.
  uint32_t skipped;
} AshsplatMaintenance;

// A tree's description of a tile.
typedef struct AshsplatTile {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Its Gaussians.
  uint32_t gaussians;
  // Error of the tile against the finest tiles, units of the scene. (error / size of a pixel)² is the sum of squared colour
  // differences over the picture.
  double error;
  // Least corner of the bounds of the tile and its descendants, units of the scene.
  float min[3];
  // The greatest corner.
  float max[3];
} AshsplatTile;

// Views and budget that tiles are chosen for.
typedef struct AshsplatDemand {
  // Set by ASHSPLAT_INIT.
  uint32_t struct_size;
  // Number of cameras, for example 2 for two eyes.
  uint32_t camera_count;
  // The cameras. A tile is chosen if some camera sees it; its largest error in any picture decides.
  const struct AshsplatCamera *cameras;
  // Most Gaussians of all drawn tiles.
  uint64_t budget;
  // Border around each picture, in picture sizes, whose Gaussians are drawn too, so that a turning camera finds them. They are
  // refined after those in the picture. 0: none.
  double border;
} AshsplatDemand;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The message of this thread's last failure: one line, valid until the next.
const char *ashsplat_last_error(void);

// Lists what the file of this thread's last ashsplat_trainer_save cannot hold, one per line; empty if it holds everything.
// The text is valid until the next save.
const char *ashsplat_last_loss(void);

// The version of the library, MAJOR.MINOR.PATCH.
const char *ashsplat_version(void);

// Opens a device by its number or part of its name. For NULL, the environment variable ASHSPLAT_DEVICE
// selects the device, otherwise the best one is opened. The context and everything made from it may be used
// by any thread, one at a time.
//
// # Safety
// `device` is NULL or a C string; `context` is valid for a write.
enum AshsplatStatus ashsplat_context_new(const char *device, struct AshsplatContext **context);

// Closes a context. The device stays open until everything made from it is freed as well. A host's device is
// never closed.
//
// # Safety
// `context` is NULL or of this library and not used afterwards.
void ashsplat_context_free(struct AshsplatContext *context);

// Loads a scene from a file: PLY, compressed PLY, .splat, SPZ, SOG, or glTF and GLB with KHR_gaussian_splatting. Its first bytes or
// its name's ending select the format. ashsplat_scene_notes gives the file's notes.
//
// # Safety
// `context` is alive, `path` is a C string, `scene` is valid for a write.
enum AshsplatStatus ashsplat_scene_load(const struct AshsplatContext *context,
                                        const char *path,
                                        struct AshsplatScene **scene);

// Notes of a scene's file. `antialiased`: whether it was trained with antialiasing, and is to be rendered with it
// (AshsplatRenderSettings.antialias). `warnings`: one line each, an empty text without; it lives as long as the scene. Either pointer
// may be NULL.
//
// # Safety
// `scene` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_scene_notes(const struct AshsplatScene *scene,
                                         bool *antialiased,
                                         const char **warnings);

// Number of Gaussians of a scene, and the degree of its spherical harmonics. Either pointer may be NULL.
//
// # Safety
// `scene` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_scene_size(const struct AshsplatScene *scene,
                                        uint32_t *gaussians,
                                        uint32_t *sh_degree);

// Frees a scene; slots keep it as long as their recordings use it.
//
// # Safety
// `scene` is NULL or of this library and not used afterwards.
void ashsplat_scene_free(struct AshsplatScene *scene);

// Builds a renderer.
//
// # Safety
// `context` is alive, `renderer` is valid for a write.
enum AshsplatStatus ashsplat_renderer_new(const struct AshsplatContext *context,
                                          struct AshsplatRenderer **renderer);

// Frees a renderer. No recording of it may still be executed.
//
// # Safety
// `renderer` is NULL or of this library and not used afterwards.
void ashsplat_renderer_free(struct AshsplatRenderer *renderer);

// A camera at `eye` that looks at `target`, with square pixels and `fov_x` radians from the left to the
// right edge.
//
// # Safety
// The three vectors have three floats each; `camera` is valid for a write.
enum AshsplatStatus ashsplat_camera_look_at(const float *eye,
                                            const float *target,
                                            const float *up,
                                            float fov_x,
                                            uint32_t width,
                                            uint32_t height,
                                            struct AshsplatCamera *camera);

// Renders a scene, submits and waits: `rgb` receives red, green and blue of each pixel, row by row, on a
// background.
//
// # Safety
// `renderer`, `scene` and `camera` are alive, `settings` too, or NULL for the defaults; `background` has
// three floats, `rgb` room for 3 * width * height.
enum AshsplatStatus ashsplat_render(struct AshsplatRenderer *renderer,
                                    const struct AshsplatScene *scene,
                                    const struct AshsplatCamera *camera,
                                    const struct AshsplatRenderSettings *settings,
                                    const float *background,
                                    float *rgb);

// Frees the memory of pictures, which otherwise stays as large as the largest one needed. The next picture
// takes what it needs. Reserved slots and scenes stay.
//
// # Safety
// `renderer` is alive.
enum AshsplatStatus ashsplat_shrink(struct AshsplatRenderer *renderer);

// Writes a picture as PNG: 8 bits per channel, from `rgb` between 0 and 1.
//
// # Safety
// `path` is a C string, `rgb` has 3 * width * height floats.
enum AshsplatStatus ashsplat_write_png(const char *path, uint32_t width, uint32_t height, const float *rgb);

// Renders a scene and gives the gradient of L by all parameters, for a given dL/dimage (paper, appendix A). It is exact, but for
// AshsplatRenderSettings.antialias_detached. `image_gradient`: red, green and blue of each pixel, row by row. `inverse_depth_gradient`: a
// float of each pixel, by the sum of weights / z (AshsplatRenderSettings.inverse_depth), or NULL. Submits and waits. Settings with
// another shape or a scale modifier, and orthographic cameras, are refused.
//
// # Safety
// `renderer`, `scene` and `camera` are alive, `settings` too, or NULL for the defaults; `background` has three floats,
// `image_gradient` 3 width height, `inverse_depth_gradient` width height or is NULL; `gradients` is valid with arrays as long as the
// scene (ashsplat_scene_size).
enum AshsplatStatus ashsplat_gradients(struct AshsplatRenderer *renderer,
                                       const struct AshsplatScene *scene,
                                       const struct AshsplatCamera *camera,
                                       const struct AshsplatRenderSettings *settings,
                                       const float *background,
                                       const float *image_gradient,
                                       const float *inverse_depth_gradient,
                                       const struct AshsplatGradients *gradients);

// Moves a camera until the picture of a fixed scene agrees with a photograph, for example before a held-out view is
// measured. Submits and waits. `rgb`: red, green and blue of each pixel, a byte each, row by row. `mask`: a byte per pixel,
// those with 0 do not count, or NULL. `aligned` may be `camera`. Refuses what ashsplat_gradients refuses.
//
// # Safety
// `renderer`, `scene` and `camera` are alive; `settings` and `alignment` too, or NULL for the defaults; `background` has three floats,
// `rgb` 3 width height bytes, `mask` width height or is NULL; `aligned` is valid for a write.
enum AshsplatStatus ashsplat_align(struct AshsplatRenderer *renderer,
                                   const struct AshsplatScene *scene,
                                   const struct AshsplatCamera *camera,
                                   const struct AshsplatRenderSettings *settings,
                                   const float *background,
                                   const uint8_t *rgb,
                                   const uint8_t *mask,
                                   const struct AshsplatAlignment *alignment,
                                   struct AshsplatCamera *aligned);

// Gives a scene's Gaussians the sizes of Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1), which follow from the cameras that
// the scene was trained with: AshsplatRenderSettings.filter_3d draws with them. Submits and waits. Orthographic cameras are refused.
// Not for a PLY whose scales and opacities contain the filter already, nor for a trainer's scene, which keeps its own
// sizes. Updates and Gaussians that are added later have none.
//
// # Safety
// `renderer` and `scene` are alive, `cameras` is valid for `count` structs of one size. No recorded frame may use the scene meanwhile.
enum AshsplatStatus ashsplat_compute_filters(struct AshsplatRenderer *renderer,
                                             struct AshsplatScene *scene,
                                             const struct AshsplatCamera *cameras,
                                             uint32_t count);

// The sizes of the 3D filter, world units, one for each Gaussian; 0 where there is none. Submits and waits.
//
// # Safety
// `renderer` and `scene` are alive, `sizes` has room for the scene's Gaussians.
enum AshsplatStatus ashsplat_filters(struct AshsplatRenderer *renderer,
                                     const struct AshsplatScene *scene,
                                     float *sizes);

// The features and extensions that a host has to enable, as readable text.
const char *ashsplat_requirements(void);

// Sets the required features in the structs with which a host will create its device: VkPhysicalDeviceVulkan12Features and
// VkPhysicalDeviceVulkan13Features, with their sType set. Other features stay as the host has set them.
//
// # Safety
// Both pointers are valid for such structs.
enum AshsplatStatus ashsplat_merge_features(void *vulkan12,
                                            void *vulkan13);

// A context on a host's device. It never destroys objects of the host. Only the given queue is waited for,
// and only by functions that submit.
//
// # Safety
// - the instance and the device are alive, were created for Vulkan 1.3 or later, and outlive the context and
//   all that is made from it;
// - the device was created from the physical device, with the queue family, the features and the extensions;
// - a queue, if given, is one of the device and of that family, and has no other user during a call that
//   submits, or only under `lock_queue`;
// - `lock_queue` and `unlock_queue` may be called from any thread, with `queue_user`, until everything made from the
//   context is freed: scenes, images and renderers with their slots too;
// - the functions of an allocator may be called from any thread until everything made from the context is
//   freed, and return memory as requested, without another user;
// - `context` is valid for a write.
enum AshsplatStatus ashsplat_context_from_foreign(const struct AshsplatForeignDevice *host,
                                                  struct AshsplatContext **context);

// A view of a host's image for kernels: `purpose` is an AshsplatImageUse. Messages and debuggers name it after the field of
// AshsplatRecordedFrame: 'target', 'occluder' and so on.
//
// # Safety
// The image is of the context's device, is what `host` says, is bound to memory, and outlives the view and
// the execution of all recordings that use it; `image` is valid for a write.
enum AshsplatStatus ashsplat_image_adopt(const struct AshsplatContext *context,
                                         const struct AshsplatForeignImage *host,
                                         uint32_t purpose,
                                         struct AshsplatImage **image);

// Declares that queues of another family own the image between recordings. A recording acquires it and releases it again.
// The host records the matching barriers in a queue of that family, ordered by semaphores in all stages. Its barrier before
// the recording goes from the layout of AshsplatHostImage.from to `layout`, and from that family to the context's. The one
// after it goes back, from `layout` to `layout`. VK_IMAGE_LAYOUT_UNDEFINED discards the contents, without a barrier before.
// With the context's own family, the host records neither, and a barrier after the recording is as AshsplatRelease says.
//
// # Safety
// `image` is alive, `layout` is valid for a write, or NULL: it receives the VkImageLayout.
enum AshsplatStatus ashsplat_image_of_family(struct AshsplatImage *image,
                                             uint32_t queue_family,
                                             int32_t *layout);

// Frees a view. Slots keep it as long as their recordings use it, and the host's image must live until they
// have released it: ashsplat_slot_release.
//
// # Safety
// `image` is NULL or of this library and not used afterwards.
void ashsplat_image_free(struct AshsplatImage *image);

// Converts a host's matrices to a camera and a depth mapping. Both matrices are column-major, clip =
// projection * view * world, depth from 0 to 1, standard or reversed. `clip_y_up`: clip space's +y is at the
// top of the picture (Direct3D's way, or a viewport of negative height). View space may be right- or left-handed, its z forward or
// backward. The world is right-handed, as the scenes are: matrices that together mirror the picture are refused. A host
// with a left-handed world gives view * M, where M maps the scene's axes to its own, for example diag(1, 1, -1, 1).
//
// # Safety
// Both matrices have 16 floats; `camera` and `mapping` are valid for a write, or `mapping` is NULL.
enum AshsplatStatus ashsplat_camera_from_matrices(const float *view_from_world,
                                                  const float *clip_from_view,
                                                  bool clip_y_up,
                                                  uint32_t width,
                                                  uint32_t height,
                                                  struct AshsplatCamera *camera,
                                                  struct AshsplatDepthMapping *mapping);

// Records a frame into a VkCommandBuffer. It never submits, waits, allocates, maps or reads back. Errors of
// the frame are reported before anything is recorded. The slot is in flight until the device has executed
// the frame.
//
// # Safety
// - `commands` is of the context's device and queue family, in the recording state, outside of a render
//   pass; it is submitted at most once before it is recorded again;
// - before the slot is recorded again or released, and before the renderer reserves again or is freed, the
//   execution of the whole command buffer has finished: its fence was waited for; or the slot is discarded.
//   ashsplat_slot_finished is not enough. Scenes and views of images may be freed earlier: the slot keeps
//   the ones that it uses;
// - the host assumes afterwards that the command buffer's compute pipeline, descriptor sets and push
//   constants have changed;
// - the host synchronises accesses of other queues by semaphores; images of another queue family were
//   released there and acquired here;
// - `frame` is valid with all that it points to, `release` for a write, or NULL.
enum AshsplatStatus ashsplat_record(struct AshsplatRenderer *renderer,
                                    void *commands,
                                    uint32_t slot,
                                    const struct AshsplatRecordedFrame *frame,
                                    struct AshsplatRelease *release);

// Records several frames in one slot, one after the other: views of the same moment, as for the eyes of a headset or a split screen.
// Each goes into images: a layer of an array for each, or rectangles of one image. AshsplatReservation.views says how many there may be.
// With `shared_sort`, eyes side by side are sorted once if their frames have the same `scenes` pointer. An image may be used by several
// views: only the first one's `from` counts. The updates are those of the first frame. Otherwise as ashsplat_record for each.
//
// # Safety
// Same as for ashsplat_record, for each; `frames` has `frame_count` elements, `releases` as many for a write, or is NULL.
enum AshsplatStatus ashsplat_record_views(struct AshsplatRenderer *renderer,
                                          void *commands,
                                          uint32_t slot,
                                          const struct AshsplatRecordedFrame *frames,
                                          uint32_t frame_count,
                                          struct AshsplatRelease *releases);

// The device of a context, for a host that lets this library open one: each pointer may be NULL.
//
// # Safety
// `context` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_context_handles(const struct AshsplatContext *context,
                                             void **instance,
                                             void **physical_device,
                                             void **device,
                                             uint32_t *queue_family);

// Lists the kernels that ashsplat_renderer_new and ashsplat_reserve build, with their number. Once they are built, these
// build none. Free the list with ashsplat_kernels_free.
//
// # Safety
// `context` and `wanted` are alive, `kernels` and `count` are valid for a write.
enum AshsplatStatus ashsplat_kernels_new(const struct AshsplatContext *context,
                                         const struct AshsplatReservation *wanted,
                                         struct AshsplatKernels **kernels,
                                         uint32_t *count);

// Builds one of the kernels, `index` below their number. Any number of threads may do so at once.
//
// # Safety
// `kernels` is alive, and so is its context.
enum AshsplatStatus ashsplat_kernels_build(const struct AshsplatKernels *kernels, uint32_t index);

// Frees the list. Built kernels stay.
//
// # Safety
// `kernels` is NULL or of this library and not used afterwards.
void ashsplat_kernels_free(struct AshsplatKernels *kernels);

// Reads the weights of LPIPS 0.1 with AlexNet or VGG16 from a safetensors file, which the caller has; tools/lpips_weights.py writes
// it. The tensors' shapes say which network it is.
//
// # Safety
// `context` is alive, `weights` is a C string, `lpips` is valid for a write.
enum AshsplatStatus ashsplat_lpips_new(const struct AshsplatContext *context,
                                       const char *weights,
                                       struct AshsplatLpips **lpips);

// Frees a network.
//
// # Safety
// `lpips` is NULL or of this library and not used afterwards.
void ashsplat_lpips_free(struct AshsplatLpips *lpips);

// Name of the measure of ashsplat_lpips_distance: "lpips_alex" on values from -1 to 1, as in gsplat; or
// "lpips_vgg_unscaled" on values from 0 to 1, as in the reference implementation. The name lives as long as `lpips`.
//
// # Safety
// `lpips` is alive, `name` is valid for a write.
enum AshsplatStatus ashsplat_lpips_name(const struct AshsplatLpips *lpips,
                                        const char **name);

// LPIPS of two pictures of one size, from red, green and blue of each pixel between 0 and 1, row by row: 0 for equal ones. Values
// outside are clamped. Submits and waits.
//
// # Safety
// `lpips` is alive, `a` and `b` have 3 width height floats, `distance` is valid for a write.
enum AshsplatStatus ashsplat_lpips_distance(struct AshsplatLpips *lpips,
                                            const float *a,
                                            const float *b,
                                            uint32_t width,
                                            uint32_t height,
                                            double *distance);

// Converts a cut-out with a pose in the world to the axes of a scene that is placed there: `placed` needs no scene.
//
// # Safety
// `cut_out` and `placed` are alive, `in_scene` is valid for a write; it may be `cut_out`.
enum AshsplatStatus ashsplat_cut_out_in_scene(const struct AshsplatCutOut *cut_out,
                                              const struct AshsplatPlaced *placed,
                                              struct AshsplatCutOut *in_scene);

// Uploads a scene from a host's arrays, with a capacity of at least `capacity` Gaussians: AshsplatUpdate and
// ashsplat_scene_set_count change it later. Without Gaussians the scene is empty, and nothing is submitted. Values are not
// checked:
// Gaussians with a NaN, or an infinite position, size or quaternion, are not drawn. Quaternions are normalised.
//
// # Safety
// `context` is alive, `gaussians` is valid with arrays as long as it says, `scene` is valid for a write.
enum AshsplatStatus ashsplat_scene_new(const struct AshsplatContext *context,
                                       const struct AshsplatGaussians *gaussians,
                                       uint32_t capacity,
                                       struct AshsplatScene **scene);

// Same as ashsplat_scene_new, with an AshsplatShStorage. Only a scene of floats can be differentiated.
//
// # Safety
// As ashsplat_scene_new.
enum AshsplatStatus ashsplat_scene_stored(const struct AshsplatContext *context,
                                          const struct AshsplatGaussians *gaussians,
                                          uint32_t capacity,
                                          uint32_t sh_storage,
                                          struct AshsplatScene **scene);

// Uploads `count` scenes from a host's arrays into as few buffers as kernels can bind, each with room for its own Gaussians: frames
// draw small scenes of one buffer by one dispatch in place of one each (AshsplatSlotReport.batched_scenes). `scenes` has room for
// `count` pointers; all are NULL after an error. Each scene is freed by itself, and the memory with the last one.
//
// # Safety
// `context` is alive, `gaussians` is valid for `count` structs of one size with arrays as long as they say, `scenes` is valid for
// `count` writes.
enum AshsplatStatus ashsplat_scenes_new(const struct AshsplatContext *context,
                                        const struct AshsplatGaussians *gaussians,
                                        uint32_t count,
                                        struct AshsplatScene **scenes);

// The same scene in another context on the same VkDevice, with the same Gaussians in memory. It keeps the memory alive. Uses in both
// contexts are uses of the same buffers, which the host orders.
//
// # Safety
// `scene` and `context` are alive, `shared` is valid for a write.
enum AshsplatStatus ashsplat_scene_in_context(const struct AshsplatScene *scene,
                                              const struct AshsplatContext *context,
                                              struct AshsplatScene **shared);

// The layout of the parameters of `capacity` Gaussians in a host's own buffers.
//
// # Safety
// `context` is alive, `plan` is valid for a write.
enum AshsplatStatus ashsplat_scene_plan(const struct AshsplatContext *context,
                                        uint32_t capacity,
                                        uint32_t sh_degree,
                                        struct AshsplatScenePlan *plan);

// A scene of `count` Gaussians in the host's own buffers, one for each chunk of ashsplat_scene_plan for the
// same capacity and degree. A host that writes them synchronises the writes as for any buffer that compute
// shaders read.
//
// # Safety
// - `context` is alive, `buffers` has `buffer_count` elements, `scene` is valid for a write;
// - each buffer is of the context's device, bound to memory, of the given size, and has the usages
//   STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST; it lives until the scene is freed and the last recording
//   that uses it has been executed; no two overlap.
enum AshsplatStatus ashsplat_scene_from_buffers(const struct AshsplatContext *context,
                                                uint32_t capacity,
                                                uint32_t sh_degree,
                                                uint32_t count,
                                                const struct AshsplatHostBuffer *buffers,
                                                uint32_t buffer_count,
                                                struct AshsplatScene **scene);

// Renders only the first `count` Gaussians of a scene from the next recording on.
//
// # Safety
// `scene` is alive.
enum AshsplatStatus ashsplat_scene_set_count(struct AshsplatScene *scene, uint32_t count);

// Staging bytes of an update of `gaussians` Gaussians of a scene of this degree, for AshsplatReservation.
uint64_t ashsplat_update_bytes(uint32_t gaussians, uint32_t sh_degree);

// Allocates frame slots and builds all kernels that frames of this kind need. Replaces the previous slots,
// whose command buffers must have finished.
//
// # Safety
// `renderer` and `wanted` are alive.
enum AshsplatStatus ashsplat_reserve(struct AshsplatRenderer *renderer,
                                     const struct AshsplatReservation *wanted);

// Same as ashsplat_reserve, but while frames are in flight, without waiting. Every slot changes to the new memory at its
// next recording, with images_only also at its release; until then both memories exist. The numbers of slots and of views
// stay. The new reservation replaces the earlier one: a smaller one gives memory back.
//
// # Safety
// `renderer` and `wanted` are alive.
enum AshsplatStatus ashsplat_grow(struct AshsplatRenderer *renderer,
                                  const struct AshsplatReservation *wanted);

// Enlarges a reservation to what a frame needed, with half as many instances again; unchanged if the frame fitted. For
// ashsplat_grow or ashsplat_reserve. `grown` may be `reservation`.
//
// # Safety
// `reservation` and `report` are valid, `grown` is valid for a write.
enum AshsplatStatus ashsplat_reservation_grown(const struct AshsplatReservation *reservation,
                                               const struct AshsplatSlotReport *report,
                                               struct AshsplatReservation *grown);

// Bytes of the block that a reservation takes: ashsplat_reserve_in. Allocates nothing.
//
// # Safety
// `renderer` and `wanted` are alive, `bytes` is valid for a write.
enum AshsplatStatus ashsplat_reservation_bytes(const struct AshsplatRenderer *renderer,
                                               const struct AshsplatReservation *wanted,
                                               uint64_t *bytes);

// Same as ashsplat_reserve, or with `grow` as ashsplat_grow, with all memory of the device in one buffer of the host's.
// Besides it, each slot takes 36 bytes for each view that the host can read, and `staging_bytes`.
//
// # Safety
// `renderer`, `wanted` and `block` are alive. The buffer is of the context's device, bound to memory, has the usages
// STORAGE_BUFFER, UNIFORM_BUFFER, INDIRECT_BUFFER, TRANSFER_SRC and TRANSFER_DST, no other user, and lives until all slots
// use another reservation or the renderer is freed, and their frames have finished.
enum AshsplatStatus ashsplat_reserve_in(struct AshsplatRenderer *renderer,
                                        const struct AshsplatReservation *wanted,
                                        const struct AshsplatHostBuffer *block,
                                        bool grow);

// The report of a slot's last frame, once it has finished. Never waits, except on llvmpipe, where reading
// the time waits.
//
// # Safety
// `renderer` is alive, `report` valid for a write.
enum AshsplatStatus ashsplat_slot_report(struct AshsplatRenderer *renderer,
                                         uint32_t slot,
                                         struct AshsplatSlotReport *report);

// The VkBuffer that a frame without target fills, and the byte offset in it: premultiplied red, green, blue
// (display-encoded, as trained) and transmittance of each pixel, row by row, as floats. Usable as a storage buffer and a source of
// transfers, until the renderer reserves again or, after ashsplat_grow, the slot is recorded again. The host may use it after the
// frame, behind a barrier from AshsplatRelease's stages and accesses, until the slot is recorded again. A host that reads it in
// other stages than compute and transfer, in a later command buffer, must wait for those stages before the next
// recording.
//
// # Safety
// `renderer` is alive, `buffer` and `offset` are valid for a write.
enum AshsplatStatus ashsplat_slot_pixels(struct AshsplatRenderer *renderer,
                                         uint32_t slot,
                                         uint64_t *buffer,
                                         uint64_t *offset);

// The VkBuffer with the sum of weights / z (AshsplatRenderSettings), and the byte offset in it: a float for
// each pixel, row by row.
//
// # Safety
// Same as for ashsplat_slot_pixels.
enum AshsplatStatus ashsplat_slot_inverse_depth(struct AshsplatRenderer *renderer,
                                                uint32_t slot,
                                                uint64_t *buffer,
                                                uint64_t *offset);

// Says whether the last frame of a slot has finished. Commands that the host has recorded after it may
// still run. Never waits.
//
// # Safety
// `renderer` is alive, `finished` valid for a write.
enum AshsplatStatus ashsplat_slot_finished(struct AshsplatRenderer *renderer, uint32_t slot, bool *finished);

// Releases what the last frame of a slot used. Scenes and views that were freed meanwhile are destroyed now
// instead of at the slot's next recording.
//
// # Safety
// `renderer` is alive; the frame's command buffer has finished: its fence was waited for.
enum AshsplatStatus ashsplat_slot_release(struct AshsplatRenderer *renderer, uint32_t slot);

// Forgets the last recording of a slot, whose command buffer was thrown away.
//
// # Safety
// `renderer` is alive; the command buffer was not submitted and never will be, or its execution has
// finished.
enum AshsplatStatus ashsplat_slot_discard(struct AshsplatRenderer *renderer, uint32_t slot);

// Reads the Gaussians back and writes them, in the format that the name's ending says: PLY in the reference implementation's layout,
// .compressed.ply, .splat, SPZ, SOG or GLB. The sizes of the 3D filter are in PLY only; in other formats they are a part of scales and
// opacities. ashsplat_last_loss says what the format does not hold. Submits and waits.
//
// # Safety
// `trainer` is alive, `path` is a C string.
enum AshsplatStatus ashsplat_trainer_save(const struct AshsplatTrainer *trainer,
                                          const char *path);

// Writes all that ashsplat_trainer_resume needs. Submits and waits.
//
// # Safety
// `trainer` is alive, `path` is a C string.
enum AshsplatStatus ashsplat_trainer_checkpoint(const struct AshsplatTrainer *trainer, const char *path);

// The cameras of the views in their order, as the setting pose_opt has moved them. `cameras` has room for `count`, which must be the
// number of views. Submits and waits.
//
// # Safety
// `trainer` is alive, `cameras` is valid for `count` structs initialised with ASHSPLAT_INIT.
enum AshsplatStatus ashsplat_trainer_cameras(const struct AshsplatTrainer *trainer,
                                             struct AshsplatCamera *cameras,
                                             uint32_t count);

// The exposures of the views in their order, with the setting exposure: three rows E of four floats each. A photograph's colour is
// out_c = sum over k of in_k E[k][c] + E[c][3] of the rendered one. `exposures` has room for 12 `count` floats; `count` must be
// the number of views. Submits and waits.
//
// # Safety
// `trainer` is alive, `exposures` is valid for 12 `count` floats.
enum AshsplatStatus ashsplat_trainer_exposures(const struct AshsplatTrainer *trainer,
                                               float *exposures,
                                               uint32_t count);

// The lens effects of the views in their order, with the setting lens_effects: for red, green and blue a_1, a_2, a_3 of the vignetting
// 1 + a_1 r^2 + a_2 r^4 + a_3 r^6 and the logarithm of the response's exponent. `effects` has room for 12 `count` floats; `count` must be
// the number of views. Submits and waits.
//
// # Safety
// `trainer` is alive, `effects` is valid for 12 `count` floats.
enum AshsplatStatus ashsplat_trainer_lens_effects(const struct AshsplatTrainer *trainer,
                                                  float *effects,
                                                  uint32_t count);

// Uploads photographs and initial Gaussians, which are taken as they are: the settings initial_opacity and initial_scale are for
// ashsplat_trainer_new_from_points. The context needs a queue. `scene_extent` is 1.1 times the largest distance of a camera to their
// mean, or 0 to have it computed. `settings_json`: an object with the names of the reference implementation's settings,
// `{"iterations": 7000}`. It may have `"preset": "fast"`, `"default"`, `"quality"` or `"reference"`, and `"few_photos": true`,
// which adapts them to the number of views, if it is below 32. Missing settings are those of the preset; without one, those of the
// strategy if it is given, else of the preset default. NULL has all settings of the preset default.
//
// # Safety
// `context` is alive, `views` has `view_count` elements with arrays as the cameras say, `initial` is valid
// with arrays as long as it says, `settings_json` is NULL or a C string, `trainer` is valid for a write.
enum AshsplatStatus ashsplat_trainer_new(const struct AshsplatContext *context,
                                         const struct AshsplatTrainView *views,
                                         uint32_t view_count,
                                         const struct AshsplatGaussians *initial,
                                         float scene_extent,
                                         const char *settings_json,
                                         struct AshsplatTrainer **trainer);

// Same as ashsplat_trainer_new, with Gaussians made of points: `positions` has three floats of each, world units, `colors` red, green and
// blue, a byte each. Their scales follow from the distances of the nearest neighbours, as in the reference implementation; the
// settings initial_opacity and initial_scale change them.
//
// # Safety
// Same as for ashsplat_trainer_new; `positions` and `colors` have three elements for each of `point_count` points.
enum AshsplatStatus ashsplat_trainer_new_from_points(const struct AshsplatContext *context,
                                                     const struct AshsplatTrainView *views,
                                                     uint32_t view_count,
                                                     const float *positions,
                                                     const uint8_t *colors,
                                                     uint32_t point_count,
                                                     float scene_extent,
                                                     const char *settings_json,
                                                     struct AshsplatTrainer **trainer);

// Continues from a file of ashsplat_trainer_checkpoint or of the program, to the same bits as a training that was never
// stopped. The other arguments are those of the training that wrote it, except for the number of iterations. `trainer` is
// NULL after an error.
//
// # Safety
// Same as for ashsplat_trainer_new; `path` is a C string.
enum AshsplatStatus ashsplat_trainer_resume(const struct AshsplatContext *context,
                                            const struct AshsplatTrainView *views,
                                            uint32_t view_count,
                                            const char *path,
                                            float scene_extent,
                                            const char *settings_json,
                                            struct AshsplatTrainer **trainer);

// Frees a trainer. None of its recorded steps may be pending or running.
//
// # Safety
// `trainer` is NULL or of this library and not used afterwards.
void ashsplat_trainer_free(struct AshsplatTrainer *trainer);

// Runs one iteration: submits and waits. Iterations after the last of the settings change nothing.
//
// # Safety
// `trainer` is alive, `step` is NULL or valid for a write.
enum AshsplatStatus ashsplat_trainer_step(struct AshsplatTrainer *trainer, struct AshsplatStep *step);

// Builds all kernels and allocates everything that recorded steps need. `slots` steps may be in flight, with
// a capacity of at least `instances` (tile, Gaussian) pairs and `visible` Gaussians that a view shows, or 0 for estimates. Submits
// and waits.
//
// # Safety
// `trainer` is alive; the whole command buffers of all recorded steps have finished: their fences were
// waited for. A result of ashsplat_trainer_outcome is not enough.
enum AshsplatStatus ashsplat_trainer_reserve(struct AshsplatTrainer *trainer,
                                             uint32_t slots,
                                             uint32_t instances,
                                             uint32_t visible);

// Records the next iteration into a VkCommandBuffer. It never submits, waits, allocates, maps or reads back.
// Errors are reported before anything is recorded, including that maintenance is due. The slot is in flight
// until the device has executed the step.
//
// # Safety
// - `commands` is of the context's device and queue family, in the recording state, outside of a render
//   pass; it is submitted at most once before it is recorded again, and steps in the order in which they
//   were recorded;
// - the trainer lives until the execution has finished, and the slot is recorded again only then: its fence
//   was waited for;
// - the host assumes afterwards that the command buffer's compute pipeline, descriptor sets and push
//   constants have changed;
// - `release` is NULL or valid for a write.
enum AshsplatStatus ashsplat_trainer_record(struct AshsplatTrainer *trainer,
                                            void *commands,
                                            uint32_t slot,
                                            struct AshsplatRelease *release);

// Forgets the last recorded step of a slot, whose command buffer was discarded. The command buffers of all
// steps recorded after it must then be discarded as well.
//
// # Safety
// `trainer` is alive; the command buffer was not submitted and is not going to be.
enum AshsplatStatus ashsplat_trainer_discard(struct AshsplatTrainer *trainer, uint32_t slot);

// The outcome of the last recorded step of a slot. Never waits, except on llvmpipe, where reading the time
// waits.
//
// # Safety
// `trainer` is alive, `step` valid for a write.
enum AshsplatStatus ashsplat_trainer_outcome(struct AshsplatTrainer *trainer,
                                             uint32_t slot,
                                             struct AshsplatStep *step);

// Says whether ashsplat_trainer_maintain must be called before another step can be recorded. Never waits.
//
// # Safety
// `trainer` is alive, `is_due` valid for a write.
enum AshsplatStatus ashsplat_trainer_maintenance_is_due(struct AshsplatTrainer *trainer, bool *is_due);

// Does what recorded steps cannot: densifies and resets opacities if that is due, and grows the capacity
// after a step that overflowed. Submits, waits and allocates; no recorded step may be in flight. Scenes of
// ashsplat_trainer_scene are out of date afterwards.
//
// # Safety
// `trainer` is alive, `done` is NULL or valid for a write; the whole command buffers of all recorded steps
// have finished: their fences were waited for. A result of ashsplat_trainer_outcome is not enough.
enum AshsplatStatus ashsplat_trainer_maintain(struct AshsplatTrainer *trainer,
                                              struct AshsplatMaintenance *done);

// The Gaussians on the device, for ashsplat_record after recorded steps. Each call makes a scene that the host frees
// (ashsplat_scene_free), before or after the trainer: it keeps the memory alive. It shows the trainer's Gaussians until the next
// ashsplat_trainer_maintain or ashsplat_trainer_step: ask again then. With the setting sh_storage "half" frames that are recorded
// need AshsplatReservation.half_sh.
//
// # Safety
// `trainer` is alive, `scene` is valid for a write.
enum AshsplatStatus ashsplat_trainer_scene(const struct AshsplatTrainer *trainer,
                                           struct AshsplatScene **scene);

// Reads the description of a tree, but no tiles: `folder` has its tileset.json.
//
// # Safety
// `folder` is a C string, `tree` is valid for a write.
enum AshsplatStatus ashsplat_tree_open(const char *folder, struct AshsplatTree **tree);

// Frees a tree. Tiles that were read stay.
//
// # Safety
// `tree` is NULL or of this library and not used afterwards.
void ashsplat_tree_free(struct AshsplatTree *tree);

// The number of its tiles. They are numbered from 0, and tile 0 is the coarsest.
//
// # Safety
// `tree` is alive, `tiles` is valid for a write.
enum AshsplatStatus ashsplat_tree_size(const struct AshsplatTree *tree, uint32_t *tiles);

// Writes the description of a tile.
//
// # Safety
// `tree` is alive, `properties` begins with its size.
enum AshsplatStatus ashsplat_tree_tile(const struct AshsplatTree *tree,
                                       uint32_t tile,
                                       struct AshsplatTile *properties);

// The tiles to load for a demand, most urgent first: those that ashsplat_tree_cut would draw, and their ancestors. A tile
// follows its parent, and comes sooner if its parent's error is larger in pixels. `possible` has a value per tile, false if
// it cannot be loaded, for example because its file is damaged; NULL: all can. Tiles that could only be drawn beside or
// below such a tile are left out. `tiles` has room for as many numbers as the tree has tiles.
//
// # Safety
// `tree` is alive, `demand` begins with its size and has as many cameras as it says, `possible` is NULL or has one value per tile,
// `tiles` is valid for as many writes, `count` for one.
enum AshsplatStatus ashsplat_tree_wanted(const struct AshsplatTree *tree,
                                         const struct AshsplatDemand *demand,
                                         const bool *possible,
                                         uint32_t *tiles,
                                         uint32_t *count);

// Tiles to draw, ascending: among those in `there`, the finest that the budget allows, refined first where the error in pixels is
// largest. While one of the tiles that would replace a tile is not there, the tile itself is drawn. `there` has a value for each
// tile of the tree; NULL: all are there. The coarsest tile is drawn however many Gaussians it has; nothing is drawn if it
// is out of view or not there. `tiles` has room for as many numbers as the tree has tiles.
//
// # Safety
// Same as for ashsplat_tree_wanted.
enum AshsplatStatus ashsplat_tree_cut(const struct AshsplatTree *tree,
                                      const struct AshsplatDemand *demand,
                                      const bool *there,
                                      uint32_t *tiles,
                                      uint32_t *count);

// Reads a tile's file: call it on a thread that may wait for a disk. AshsplatUpdate copies the Gaussians to the device in a
// frame.
//
// # Safety
// `tree` is alive, `gaussians` is valid for a write.
enum AshsplatStatus ashsplat_tree_read(const struct AshsplatTree *tree,
                                       uint32_t tile,
                                       struct AshsplatTileGaussians **gaussians);

// The arrays of a tile's Gaussians, which live as long as `of` does.
//
// # Safety
// `of` is alive, `gaussians` begins with its size.
enum AshsplatStatus ashsplat_tile_gaussians(const struct AshsplatTileGaussians *of,
                                            struct AshsplatGaussians *gaussians);

// Notes of a tile's file, as ashsplat_scene_notes; all tiles of a tree say the same of antialiasing. `warnings` lives as long as `of`
// does. Either pointer may be NULL.
//
// # Safety
// `of` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_tile_notes(const struct AshsplatTileGaussians *of,
                                        bool *antialiased,
                                        const char **warnings);

// Frees a tile's Gaussians, once the call that has recorded their update has returned.
//
// # Safety
// `gaussians` is NULL or of this library and not used afterwards.
void ashsplat_tile_gaussians_free(struct AshsplatTileGaussians *gaussians);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

/* A struct that knows its size, with the defaults of its fields. */
#define ASHSPLAT_INIT(Type) Type##_init()

static inline AshsplatAlignment AshsplatAlignment_init(void) {
  AshsplatAlignment it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.steps = 100;
  it.lr = 2e-3;
  it.lambda_dssim = 2e-1;
  return it;
}

static inline AshsplatAllocator AshsplatAllocator_init(void) {
  AshsplatAllocator it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatCamera AshsplatCamera_init(void) {
  AshsplatCamera it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.camera_from_world[0] = it.camera_from_world[4] = it.camera_from_world[8] = 1.0f;
  return it;
}

static inline AshsplatCutOut AshsplatCutOut_init(void) {
  AshsplatCutOut it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.scene_from_volume[0] = it.scene_from_volume[4] = it.scene_from_volume[8] = 1.0f;
  it.scale = 1.0f;
  return it;
}

static inline AshsplatDemand AshsplatDemand_init(void) {
  AshsplatDemand it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatDepthTarget AshsplatDepthTarget_init(void) {
  AshsplatDepthTarget it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatForeignDevice AshsplatForeignDevice_init(void) {
  AshsplatForeignDevice it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatForeignImage AshsplatForeignImage_init(void) {
  AshsplatForeignImage it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.samples = 1;
  return it;
}

static inline AshsplatGaussians AshsplatGaussians_init(void) {
  AshsplatGaussians it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatGradients AshsplatGradients_init(void) {
  AshsplatGradients it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatMaintenance AshsplatMaintenance_init(void) {
  AshsplatMaintenance it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatMotionTarget AshsplatMotionTarget_init(void) {
  AshsplatMotionTarget it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatOccluder AshsplatOccluder_init(void) {
  AshsplatOccluder it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatPickTarget AshsplatPickTarget_init(void) {
  AshsplatPickTarget it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatPlaced AshsplatPlaced_init(void) {
  AshsplatPlaced it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.world_from_object[0] = it.world_from_object[4] = it.world_from_object[8] = 1.0f;
  it.scale = 1.0f;
  return it;
}

static inline AshsplatPose AshsplatPose_init(void) {
  AshsplatPose it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.world_from_object[0] = it.world_from_object[4] = it.world_from_object[8] = 1.0f;
  it.scale = 1.0f;
  return it;
}

static inline AshsplatRecordedFrame AshsplatRecordedFrame_init(void) {
  AshsplatRecordedFrame it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatRelease AshsplatRelease_init(void) {
  AshsplatRelease it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatRenderSettings AshsplatRenderSettings_init(void) {
  AshsplatRenderSettings it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.sh_degree = 3;
  it.scale_modifier = 1.0f;
  return it;
}

static inline AshsplatReservation AshsplatReservation_init(void) {
  AshsplatReservation it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.slots = 1;
  it.queues = 1;
  it.scenes = 1;
  return it;
}

static inline AshsplatScenePlan AshsplatScenePlan_init(void) {
  AshsplatScenePlan it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatSceneSettings AshsplatSceneSettings_init(void) {
  AshsplatSceneSettings it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.visible = true;
  it.tint[0] = 1.0f;
  it.tint[1] = 1.0f;
  it.tint[2] = 1.0f;
  it.opacity = 1.0f;
  it.sh_degree = 3;
  it.selection_color[0] = 1.0f;
  it.selection_color[1] = 1.0f;
  it.selection_color[2] = 1.0f;
  it.selection_share = 0.5f;
  return it;
}

static inline AshsplatSlotReport AshsplatSlotReport_init(void) {
  AshsplatSlotReport it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatStep AshsplatStep_init(void) {
  AshsplatStep it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatSurfaceTarget AshsplatSurfaceTarget_init(void) {
  AshsplatSurfaceTarget it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatTarget AshsplatTarget_init(void) {
  AshsplatTarget it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  it.exposure = 1.0f;
  return it;
}

static inline AshsplatTile AshsplatTile_init(void) {
  AshsplatTile it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatTrainView AshsplatTrainView_init(void) {
  AshsplatTrainView it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

static inline AshsplatUpdate AshsplatUpdate_init(void) {
  AshsplatUpdate it;
  memset(&it, 0, sizeof it);
  it.struct_size = (uint32_t)sizeof it;
  return it;
}

#endif /* ASHSPLAT_H */
