/* The C interface of ashsplat. Generated from the sources in tools/capi: do not edit. */

#ifndef ASHSPLAT_H
#define ASHSPLAT_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

// What came of a call.
typedef enum AshsplatStatus {
  // All is well.
  AshsplatStatus_Ok = 0,
  // An argument makes no sense.
  AshsplatStatus_Argument = 1,
  // A file cannot be read, written or understood.
  AshsplatStatus_File = 2,
  // There is no usable device.
  AshsplatStatus_NoDevice = 3,
  // The device lacks something, or the host has not enabled it.
  AshsplatStatus_MissingFeature = 4,
  // Something does not fit.
  AshsplatStatus_TooLarge = 5,
  // A Vulkan call failed.
  AshsplatStatus_Vulkan = 6,
  // A defect of this library.
  AshsplatStatus_Internal = 7,
} AshsplatStatus;

// What lies behind the splats.
typedef enum AshsplatBehind {
  // A background colour; the result is opaque.
  AshsplatBehind_Color = 0,
  // Nothing: premultiplied colour and alpha.
  AshsplatBehind_Nothing = 1,
  // What the image holds.
  AshsplatBehind_Image = 2,
} AshsplatBehind;

// A device that everything runs on.
typedef struct AshsplatContext AshsplatContext;

// A view of a host's image.
typedef struct AshsplatImage AshsplatImage;

// Renders scenes.
typedef struct AshsplatRenderer AshsplatRenderer;

// Gaussians on a device.
typedef struct AshsplatScene AshsplatScene;

// A pinhole camera, x right, y down, z forward: x_camera = R x_world + t, pixel = (fx x/z + cx, fy y/z + cy), where the
// centre of the first pixel is (0.5, 0.5).
typedef struct AshsplatCamera {
  // R, row by row.
  float camera_from_world[9];
  // t, world units.
  float translation[3];
  // Focal length in x, pixels.
  float fx;
  // Focal length in y, pixels.
  float fy;
  // Principal point in x, pixels.
  float cx;
  // Principal point in y, pixels.
  float cy;
  // Width of the picture, pixels.
  uint32_t width;
  // Height of the picture, pixels.
  uint32_t height;
} AshsplatCamera;

// A host's device, and what was enabled when it was created.
typedef struct AshsplatHost {
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
  // VkQueue for what submits by itself, or NULL: then only recording works.
  void *queue;
  // The VkPhysicalDeviceVulkan12Features that the device was created with.
  const void *vulkan12_features;
  // The VkPhysicalDeviceVulkan13Features that the device was created with.
  const void *vulkan13_features;
  // Names of the device extensions that were enabled.
  const char *const *extensions;
  // How many.
  uint32_t extension_count;
  // Whether VK_EXT_debug_utils was enabled.
  bool debug_utils;
} AshsplatHost;

// An image of a host's and how it was created: two-dimensional, one sample per pixel, optimal tiling.
typedef struct AshsplatHostImage {
  // VkImage.
  uint64_t image;
  // VkFormat.
  int32_t format;
  // VkImageUsageFlags.
  uint32_t usage;
  // Width of the mip level, pixels.
  uint32_t width;
  // Height of the mip level, pixels.
  uint32_t height;
  // Which mip level.
  uint32_t mip_level;
  // Which layer.
  uint32_t layer;
} AshsplatHostImage;

// How 1/z follows from a depth buffer's value d: 1/z = scale d + offset; nothing is where it holds clear_value.
typedef struct AshsplatDepthMapping {
  // See above.
  float scale;
  // See above.
  float offset;
  // See above.
  float clear_value;
} AshsplatDepthMapping;

// What is to be allocated ahead for recording.
typedef struct AshsplatReservation {
  // Frames in flight.
  uint32_t slots;
  // Gaussians of all scenes of a frame together.
  uint32_t gaussians;
  // Scenes of a frame.
  uint32_t scenes;
  // Highest degree of the scenes' spherical harmonics.
  uint32_t sh_degree;
  // (tile, Gaussian) instances of a frame; 0 for a guess. AshsplatReport says how many a frame needs.
  uint32_t instances;
  // Width of the largest picture, pixels.
  uint32_t width;
  // Height of the largest picture, pixels.
  uint32_t height;
  // Whether frames will be hidden behind a host's depth image.
  bool occlusion;
} AshsplatReservation;

// A scene and where it stands: x_world = rotation x_object + translation.
typedef struct AshsplatPlaced {
  // The scene.
  const struct AshsplatScene *scene;
  // A rotation, row by row.
  float world_from_object[9];
  // World units.
  float translation[3];
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

// A frame to record.
typedef struct AshsplatFrame {
  // The scenes, sorted together.
  const struct AshsplatPlaced *scenes;
  // How many: one at least.
  uint32_t scene_count;
  // The camera; its width and height are the frame's.
  struct AshsplatCamera camera;
  // The image that is written, or NULL: then the slot's own buffer, ashsplat_slot_pixels.
  const struct AshsplatImage *target;
  // What the host does with the target before.
  struct AshsplatImageState target_from;
  // What lies behind the splats in the target.
  enum AshsplatBehind behind;
  // Its colour, for AshsplatBehind_Color.
  float background[3];
  // The host's depth image, or NULL: splats behind it are hidden.
  const struct AshsplatImage *depth;
  // What the host does with the depth image before.
  struct AshsplatImageState depth_from;
  // How to read it.
  struct AshsplatDepthMapping depth_mapping;
} AshsplatFrame;

// What a recording leaves behind: what uses its results next waits for these stages and accesses, and finds the images
// in these layouts.
typedef struct AshsplatRelease {
  // VkPipelineStageFlags2 that write results.
  uint64_t stages;
  // VkAccessFlags2 that they write with.
  uint64_t accesses;
  // How the target was used last.
  struct AshsplatImageState target;
  // How the depth image was used last.
  struct AshsplatImageState depth;
} AshsplatRelease;

// What a recorded frame was made of.
typedef struct AshsplatReport {
  // Whether the frame has finished; nothing else is said before.
  bool finished;
  // Whether something did not fit: the picture lacks what lies farthest back.
  bool overflow;
  // Gaussians in the frame's scenes.
  uint32_t gaussians;
  // Visible ones.
  uint32_t visible;
  // (tile, Gaussian) instances that the picture needs.
  uint32_t instances_needed;
  // Instances that there was room for.
  uint32_t instance_capacity;
  // Entries of the fullest tile.
  uint32_t longest_tile;
  // Time on the device, nanoseconds; 0 where it has no clock.
  double nanoseconds;
} AshsplatReport;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The message of this thread's last failure: one line, valid until the next.
const char *ashsplat_last_error(void);

// The version of the library, "0.1.0".
const char *ashsplat_version(void);

// Opens a device of the library's own: the one of this number or part of a name, or for NULL what the environment
// variable ASHSPLAT_DEVICE says, else the best.
//
// # Safety
// `device` is NULL or a C string; `context` is valid for a write.
enum AshsplatStatus ashsplat_context_new(const char *device,
                                         struct AshsplatContext **context);

// Closes a context. The device stays open until all that was made from it is freed as well; one of the host's own is
// left alone.
//
// # Safety
// `context` is NULL or of this library and not used afterwards.
void ashsplat_context_free(struct AshsplatContext *context);

// Loads a scene from a PLY file.
//
// # Safety
// `context` is alive, `path` is a C string, `scene` is valid for a write.
enum AshsplatStatus ashsplat_scene_load(const struct AshsplatContext *context,
                                        const char *path,
                                        struct AshsplatScene **scene);

// Number of Gaussians of a scene, and the degree of its spherical harmonics. Either pointer may be NULL.
//
// # Safety
// `scene` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_scene_size(const struct AshsplatScene *scene,
                                        uint32_t *gaussians,
                                        uint32_t *sh_degree);

// Frees a scene. No recording that uses it may still be executed.
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

// A camera at `eye` that looks at `target`, with square pixels and `fov_x` radians from the left to the right edge.
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

// Renders a scene, submits and waits: `rgb` receives red, green and blue of each pixel, row by row, on a background.
//
// # Safety
// `renderer`, `scene` and `camera` are alive, `background` has three floats, `rgb` room for 3 * width * height.
enum AshsplatStatus ashsplat_render(struct AshsplatRenderer *renderer,
                                    const struct AshsplatScene *scene,
                                    const struct AshsplatCamera *camera,
                                    const float *background,
                                    float *rgb);

// Writes a picture as PNG: 8 bits per channel, from `rgb` between 0 and 1.
//
// # Safety
// `path` is a C string, `rgb` has 3 * width * height floats.
enum AshsplatStatus ashsplat_write_png(const char *path, uint32_t width, uint32_t height, const float *rgb);

// What a host has to enable, as text for people.
const char *ashsplat_requirements(void);

// Turns on what is required in the structs that a host is going to create its device with, and leaves the rest alone:
// VkPhysicalDeviceVulkan12Features and VkPhysicalDeviceVulkan13Features.
//
// # Safety
// Both pointers are valid for such structs.
enum AshsplatStatus ashsplat_merge_features(void *vulkan12,
                                            void *vulkan13);

// A context on a host's device, of which nothing is ever destroyed or waited for.
//
// # Safety
// - the instance and the device are alive, were created for Vulkan 1.3 or later, and outlive the context and all that
//   is made from it;
// - the device was created from the physical device, with the queue family, the features and the extensions;
// - while a queue is given, nobody else uses it during a call that submits;
// - `context` is valid for a write.
enum AshsplatStatus ashsplat_context_from_host(const struct AshsplatHost *host,
                                               struct AshsplatContext **context);

// A view of a host's image: as a target that kernels write (`sampled` false), or as a depth image that they read.
//
// # Safety
// The image is of the context's device, is what `host` says, is bound to memory, and outlives the view and the
// execution of all recordings that use it; `image` is valid for a write.
enum AshsplatStatus ashsplat_image_adopt(const struct AshsplatContext *context,
                                         const struct AshsplatHostImage *host,
                                         bool sampled,
                                         struct AshsplatImage **image);

// Frees a view. No recording that uses it may still be executed; the image itself stays.
//
// # Safety
// `image` is NULL or of this library and not used afterwards.
void ashsplat_image_free(struct AshsplatImage *image);

// A host's matrices as a camera, and how its depth is to be read: both column by column, clip = projection * view *
// world, depth from 0 to 1, standard or reversed. `clip_y_up`: clip space's +y is at the top of the picture.
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

// Allocates frame slots and builds all kernels that frames of this kind need, in place of those before.
//
// # Safety
// `renderer` and `wanted` are alive.
enum AshsplatStatus ashsplat_reserve(struct AshsplatRenderer *renderer,
                                     const struct AshsplatReservation *wanted);

// Records a frame into a VkCommandBuffer. Submits, waits for, allocates, maps and reads back nothing; what is wrong
// with the frame is said before anything is recorded. The slot is in flight until the device has executed it.
//
// # Safety
// - `commands` is of the context's device and queue family, in the recording state, outside of a render pass; it is
//   submitted at most once before it is recorded again;
// - renderer, scenes and images live until its execution is over;
// - `frame` is valid with all that it points to, `release` for a write, or NULL.
enum AshsplatStatus ashsplat_record(struct AshsplatRenderer *renderer,
                                    void *commands,
                                    uint32_t slot,
                                    const struct AshsplatFrame *frame,
                                    struct AshsplatRelease *release);

// What the last frame of a slot was made of, once it has finished. Never waits.
//
// # Safety
// `renderer` is alive, `report` valid for a write.
enum AshsplatStatus ashsplat_slot_report(struct AshsplatRenderer *renderer,
                                         uint32_t slot,
                                         struct AshsplatReport *report);

// The VkBuffer that a frame without target fills, and the bytes in front of it there: premultiplied red, green, blue
// and transmittance of each pixel, row by row, as floats.
//
// # Safety
// `renderer` is alive, `buffer` and `offset` are valid for a write.
enum AshsplatStatus ashsplat_slot_pixels(struct AshsplatRenderer *renderer,
                                         uint32_t slot,
                                         uint64_t *buffer,
                                         uint64_t *offset);

// The device of a context, for a host that lets this library open one: each pointer may be NULL.
//
// # Safety
// `context` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_context_handles(const struct AshsplatContext *context,
                                             void **instance,
                                             void **physical_device,
                                             void **device,
                                             uint32_t *queue_family);

// What a host has to enable, as text for people.
const char *ashsplat_requirements(void);

// Turns on what is required in the structs that a host is going to create its device with, and leaves the rest alone:
// VkPhysicalDeviceVulkan12Features and VkPhysicalDeviceVulkan13Features.
//
// # Safety
// Both pointers are valid for such structs.
enum AshsplatStatus ashsplat_merge_features(void *vulkan12,
                                            void *vulkan13);

// A context on a host's device, of which nothing is ever destroyed or waited for.
//
// # Safety
// - the instance and the device are alive, were created for Vulkan 1.3 or later, and outlive the context and all that
//   is made from it;
// - the device was created from the physical device, with the queue family, the features and the extensions;
// - while a queue is given, nobody else uses it during a call that submits;
// - `context` is valid for a write.
enum AshsplatStatus ashsplat_context_from_host(const struct AshsplatHost *host,
                                               struct AshsplatContext **context);

// A view of a host's image: as a target that kernels write (`sampled` false), or as a depth image that they read.
//
// # Safety
// The image is of the context's device, is what `host` says, is bound to memory, and outlives the view and the
// execution of all recordings that use it; `image` is valid for a write.
enum AshsplatStatus ashsplat_image_adopt(const struct AshsplatContext *context,
                                         const struct AshsplatHostImage *host,
                                         bool sampled,
                                         struct AshsplatImage **image);

// Frees a view. No recording that uses it may still be executed; the image itself stays.
//
// # Safety
// `image` is NULL or of this library and not used afterwards.
void ashsplat_image_free(struct AshsplatImage *image);

// A host's matrices as a camera, and how its depth is to be read: both column by column, clip = projection * view *
// world, depth from 0 to 1, standard or reversed. `clip_y_up`: clip space's +y is at the top of the picture.
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

// Allocates frame slots and builds all kernels that frames of this kind need, in place of those before.
//
// # Safety
// `renderer` and `wanted` are alive.
enum AshsplatStatus ashsplat_reserve(struct AshsplatRenderer *renderer,
                                     const struct AshsplatReservation *wanted);

// Records a frame into a VkCommandBuffer. Submits, waits for, allocates, maps and reads back nothing; what is wrong
// with the frame is said before anything is recorded. The slot is in flight until the device has executed it.
//
// # Safety
// - `commands` is of the context's device and queue family, in the recording state, outside of a render pass; it is
//   submitted at most once before it is recorded again;
// - renderer, scenes and images live until its execution is over;
// - `frame` is valid with all that it points to, `release` for a write, or NULL.
enum AshsplatStatus ashsplat_record(struct AshsplatRenderer *renderer,
                                    void *commands,
                                    uint32_t slot,
                                    const struct AshsplatFrame *frame,
                                    struct AshsplatRelease *release);

// What the last frame of a slot was made of, once it has finished. Never waits.
//
// # Safety
// `renderer` is alive, `report` valid for a write.
enum AshsplatStatus ashsplat_slot_report(struct AshsplatRenderer *renderer,
                                         uint32_t slot,
                                         struct AshsplatReport *report);

// The VkBuffer that a frame without target fills, and the bytes in front of it there: premultiplied red, green, blue
// and transmittance of each pixel, row by row, as floats.
//
// # Safety
// `renderer` is alive, `buffer` and `offset` are valid for a write.
enum AshsplatStatus ashsplat_slot_pixels(struct AshsplatRenderer *renderer,
                                         uint32_t slot,
                                         uint64_t *buffer,
                                         uint64_t *offset);

// The device of a context, for a host that lets this library open one: each pointer may be NULL.
//
// # Safety
// `context` is alive; the pointers are NULL or valid for a write.
enum AshsplatStatus ashsplat_context_handles(const struct AshsplatContext *context,
                                             void **instance,
                                             void **physical_device,
                                             void **device,
                                             uint32_t *queue_family);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* ASHSPLAT_H */
