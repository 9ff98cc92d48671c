/* A host in C: the few declarations of vulkan_core.h that these programs need, so that no Vulkan headers have to be there,
 * and a device that ashsplat has opened, lent back to it as a host's. What matters here are the calls. */
#ifndef HOST_H
#define HOST_H

#include "../ashsplat.h"
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void (*Function)(void);
typedef Function (*GetProc)(void *, const char *);
typedef struct { int type; const void *next; uint32_t flags, queue_family; } PoolInfo;
typedef struct { int type; const void *next; uint64_t pool; int level; uint32_t count; } AllocateInfo;
typedef struct { int type; const void *next; uint32_t flags; const void *inheritance; } BeginInfo;
typedef struct { int type; const void *next; uint32_t flags; } FenceInfo;
typedef struct {
    int type; const void *next;
    uint32_t wait_count; const uint64_t *waits; const uint32_t *stages;
    uint32_t command_count; void *const *commands;
    uint32_t signal_count; const uint64_t *signals;
} SubmitInfo;
typedef struct {
    int type; const void *next; uint32_t flags; uint64_t bytes; uint32_t usage; int sharing;
    uint32_t family_count; const uint32_t *families;
} BufferInfo;
typedef struct {
    int type; const void *next; uint32_t flags; int kind, format; uint32_t width, height, depth, levels, layers;
    int samples, tiling; uint32_t usage; int sharing; uint32_t family_count; const uint32_t *families; int layout;
} ImageInfo;
typedef struct { uint64_t bytes, alignment; uint32_t types; } Needs;
typedef struct { int type; const void *next; uint64_t bytes; uint32_t kind; } MemoryInfo;
typedef struct { uint32_t type_count; struct { uint32_t flags, heap; } types[32]; uint8_t heaps[512]; } MemoryTypes;
typedef struct { uint32_t aspect, level, level_count, layer, layer_count; } Range;
typedef struct {
    int type; const void *next; uint32_t from_access, to_access; int from_layout, to_layout;
    uint32_t from_family, to_family; uint64_t image; Range range;
} ImageBarrier;
typedef struct { int type; const void *next; uint32_t from_access, to_access; } MemoryBarrier;
typedef struct { uint64_t from, to, bytes; } BufferCopy;
typedef struct {
    uint64_t offset; uint32_t row, rows; uint32_t aspect, level, layer, layer_count; int32_t x, y, z; uint32_t width, height, depth;
} ImageCopy;
typedef struct { float depth; uint32_t stencil; } ClearDepth;

enum {
    /* sType of VkPhysicalDeviceVulkan12Features and of VkPhysicalDeviceVulkan13Features. */
    FEATURES_12 = 51, FEATURES_13 = 53,
    FORMAT_RGBA8 = 37, FORMAT_RGBA8_SRGB = 43, FORMAT_RG16F = 83, FORMAT_RGBA16F = 97, FORMAT_R32F = 100, FORMAT_RGBA32UI = 107, FORMAT_D32 = 126,
    IMAGE_MUTABLE_FORMAT = 8, IMAGE_EXTENDED_USAGE = 256,
    USAGE_IMAGE_COPY_FROM = 1, USAGE_IMAGE_COPY_TO = 2, USAGE_IMAGE_SAMPLED = 4, USAGE_IMAGE_STORAGE = 8,
    USAGE_IMAGE_DEPTH = 32,
    USAGE_BUFFER_COPIES = 3, USAGE_BUFFER_STORAGE = 32,
    LAYOUT_UNDEFINED = 0, LAYOUT_COPY_FROM = 6, LAYOUT_COPY_TO = 7,
    ASPECT_COLOR = 1, ASPECT_DEPTH = 2,
    STAGE_TRANSFER = 0x1000, STAGE_HOST = 0x4000, STAGE_ALL = 0x10000,
    ACCESS_TRANSFER_READ = 0x800, ACCESS_TRANSFER_WRITE = 0x1000, ACCESS_HOST_READ = 0x2000, ACCESS_MEMORY_WRITE = 0x10000,
};

/* Vulkan's functions of the device, by their names without "vk". */
#define FUNCTIONS(F) \
    F(int, CreateCommandPool, (void *, const PoolInfo *, const void *, uint64_t *)) \
    F(void, DestroyCommandPool, (void *, uint64_t, const void *)) \
    F(int, AllocateCommandBuffers, (void *, const AllocateInfo *, void **)) \
    F(int, BeginCommandBuffer, (void *, const BeginInfo *)) \
    F(int, EndCommandBuffer, (void *)) \
    F(int, QueueSubmit, (void *, uint32_t, const SubmitInfo *, uint64_t)) \
    F(int, QueueWaitIdle, (void *)) \
    F(int, CreateFence, (void *, const FenceInfo *, const void *, uint64_t *)) \
    F(int, WaitForFences, (void *, uint32_t, const uint64_t *, uint32_t, uint64_t)) \
    F(int, ResetFences, (void *, uint32_t, const uint64_t *)) \
    F(void, DestroyFence, (void *, uint64_t, const void *)) \
    F(int, CreateBuffer, (void *, const BufferInfo *, const void *, uint64_t *)) \
    F(void, DestroyBuffer, (void *, uint64_t, const void *)) \
    F(int, CreateImage, (void *, const ImageInfo *, const void *, uint64_t *)) \
    F(void, DestroyImage, (void *, uint64_t, const void *)) \
    F(void, GetBufferMemoryRequirements, (void *, uint64_t, Needs *)) \
    F(void, GetImageMemoryRequirements, (void *, uint64_t, Needs *)) \
    F(int, AllocateMemory, (void *, const MemoryInfo *, const void *, uint64_t *)) \
    F(void, FreeMemory, (void *, uint64_t, const void *)) \
    F(int, BindBufferMemory, (void *, uint64_t, uint64_t, uint64_t)) \
    F(int, BindImageMemory, (void *, uint64_t, uint64_t, uint64_t)) \
    F(int, MapMemory, (void *, uint64_t, uint64_t, uint64_t, uint32_t, void **)) \
    F(void, CmdPipelineBarrier, (void *, uint32_t, uint32_t, uint32_t, uint32_t, const MemoryBarrier *, uint32_t, \
        const void *, uint32_t, const ImageBarrier *)) \
    F(void, CmdClearColorImage, (void *, uint64_t, int, const float *, uint32_t, const Range *)) \
    F(void, CmdClearDepthStencilImage, (void *, uint64_t, int, const ClearDepth *, uint32_t, const Range *)) \
    F(void, CmdCopyImageToBuffer, (void *, uint64_t, int, uint64_t, uint32_t, const ImageCopy *)) \
    F(void, CmdCopyBuffer, (void *, uint64_t, uint64_t, uint32_t, const BufferCopy *))

typedef struct { uint64_t raw, memory; void *mapped; } HostBuffer;
typedef struct { uint64_t raw, memory; AshsplatForeignImage description; } HostTexture;

enum { MOST = 16 };

#define DECLARE(result, name, arguments) result(*name) arguments;
typedef struct {
    AshsplatContext *owner;
    AshsplatForeignDevice handles;
    uint64_t vulkan12[64], vulkan13[64];
    uint64_t pool;
    void *commands;
    MemoryTypes memory;
    /* Freed when the host closes, unless freed before. */
    HostBuffer buffers[MOST];
    HostTexture textures[MOST];
    uint32_t buffer_count, texture_count;
    FUNCTIONS(DECLARE)
} Host;

static inline void check(AshsplatStatus status, const char *what) {
    if (status != AshsplatStatus_Ok) {
        fprintf(stderr, "error %d: %s: %s\n", (int)status, what, ashsplat_last_error());
        exit(2);
    }
}

static inline void require(int result, const char *what) {
    if (result != 0) {
        fprintf(stderr, "%s: %d\n", what, result);
        exit(3);
    }
}

/* Requires a condition; otherwise prints the line and ends the program. */
#define EXPECT(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "%s:%d: not so: %s (%s)\n", __FILE__, __LINE__, #condition, ashsplat_last_error()); \
            exit(4); \
        } \
    } while (0)

/* True if the last error has these words; with a leading '^', if it begins with them. */
static inline bool said(const char *words) {
    const char *error = ashsplat_last_error();
    return words[0] == '^' ? strncmp(error, words + 1, strlen(words) - 1) == 0 : strstr(error, words) != NULL;
}

/* Requires that a call refuses an argument with these words. */
#define REFUSED(call, words) EXPECT((call) == AshsplatStatus_Argument && said(words))

/* The same for a call while a variable has another value. */
#define REFUSED_WITH(variable, value, call, words) \
    do { \
        char kept[sizeof(variable)]; \
        memcpy(kept, &(variable), sizeof kept); \
        (variable) = (value); \
        REFUSED(call, words); \
        memcpy(&(variable), kept, sizeof kept); \
    } while (0)

/* Runs a function of this name if the program's first argument names it. */
#define TRIAL(name) \
    if (count > 1 && strcmp(arguments[1], #name) == 0) { \
        name(arguments + 2); \
        return 0; \
    }

static inline GetProc as_get_proc(void *symbol) {
    GetProc function = NULL;
    memcpy(&function, &symbol, sizeof function);
    return function;
}

static inline void host_open(Host *host) {
    memset(host, 0, sizeof *host);
    host->handles = ASHSPLAT_INIT(AshsplatForeignDevice);
    void *library = dlopen("libvulkan.so.1", RTLD_NOW);
    EXPECT(library != NULL);
    GetProc instance_proc = as_get_proc(dlsym(library, "vkGetInstanceProcAddr"));
    check(ashsplat_context_new(NULL, &host->owner), "opening a device");
    AshsplatForeignDevice *h = &host->handles;
    check(ashsplat_context_handles(host->owner, &h->instance, &h->physical_device, &h->device, &h->queue_family),
          "asking for the handles");
    memcpy(&h->get_instance_proc_addr, &instance_proc, sizeof instance_proc);
    host->vulkan12[0] = FEATURES_12;
    host->vulkan13[0] = FEATURES_13;
    check(ashsplat_merge_features(host->vulkan12, host->vulkan13), "merging the features");
    h->vulkan12_features = host->vulkan12;
    h->vulkan13_features = host->vulkan13;
    GetProc device_proc = (GetProc)instance_proc(h->instance, "vkGetDeviceProcAddr");
    void (*get_queue)(void *, uint32_t, uint32_t, void **) =
        (void (*)(void *, uint32_t, uint32_t, void **))device_proc(h->device, "vkGetDeviceQueue");
    get_queue(h->device, h->queue_family, 0, &h->queue);
    void (*get_memory)(void *, MemoryTypes *) =
        (void (*)(void *, MemoryTypes *))instance_proc(h->instance, "vkGetPhysicalDeviceMemoryProperties");
    get_memory(h->physical_device, &host->memory);
#define LOAD(result, name, arguments) host->name = (result(*) arguments)device_proc(h->device, "vk" #name);
    FUNCTIONS(LOAD)
    PoolInfo pool_info = {39, NULL, 2, h->queue_family};
    require(host->CreateCommandPool(h->device, &pool_info, NULL, &host->pool), "vkCreateCommandPool");
    AllocateInfo allocate_info = {40, NULL, host->pool, 0, 1};
    require(host->AllocateCommandBuffers(h->device, &allocate_info, &host->commands), "vkAllocateCommandBuffers");
}

static inline void *host_begin(Host *host) {
    BeginInfo begin_info = {42, NULL, 1, NULL};
    require(host->BeginCommandBuffer(host->commands, &begin_info), "vkBeginCommandBuffer");
    return host->commands;
}

static inline void host_submit_and_wait(Host *host) {
    require(host->EndCommandBuffer(host->commands), "vkEndCommandBuffer");
    SubmitInfo submit_info = {4, NULL, 0, NULL, NULL, 1, &host->commands, 0, NULL};
    require(host->QueueSubmit(host->handles.queue, 1, &submit_info, 0), "vkQueueSubmit");
    require(host->QueueWaitIdle(host->handles.queue), "vkQueueWaitIdle");
}

/* Memory of a type with these properties (2: the host sees it, 4: coherently). */
static inline uint64_t host_memory(Host *host, Needs needs, uint32_t properties) {
    for (uint32_t kind = 0; kind < host->memory.type_count; ++kind) {
        if ((needs.types >> kind & 1) && (host->memory.types[kind].flags & properties) == properties) {
            MemoryInfo info = {5, NULL, needs.bytes, kind};
            uint64_t memory = 0;
            require(host->AllocateMemory(host->handles.device, &info, NULL, &memory), "vkAllocateMemory");
            return memory;
        }
    }
    exit(5);
}

static inline HostBuffer *host_buffer(Host *host, uint64_t bytes, uint32_t usage) {
    EXPECT(host->buffer_count < MOST);
    HostBuffer *buffer = &host->buffers[host->buffer_count++];
    void *device = host->handles.device;
    BufferInfo info = {12, NULL, 0, bytes, usage, 0, 0, NULL};
    require(host->CreateBuffer(device, &info, NULL, &buffer->raw), "vkCreateBuffer");
    Needs needs;
    host->GetBufferMemoryRequirements(device, buffer->raw, &needs);
    buffer->memory = host_memory(host, needs, 2 | 4);
    require(host->BindBufferMemory(device, buffer->raw, buffer->memory, 0), "vkBindBufferMemory");
    require(host->MapMemory(device, buffer->memory, 0, bytes, 0, &buffer->mapped), "vkMapMemory");
    return buffer;
}

static inline void host_free_buffer(Host *host, HostBuffer *buffer) {
    host->DestroyBuffer(host->handles.device, buffer->raw, NULL);
    host->FreeMemory(host->handles.device, buffer->memory, NULL);
    buffer->raw = buffer->memory = 0;
}

static inline HostTexture *host_texture(Host *host, int format, uint32_t usage, uint32_t width, uint32_t height) {
    EXPECT(host->texture_count < MOST);
    HostTexture *texture = &host->textures[host->texture_count++];
    void *device = host->handles.device;
    /* Kernels see these images through another format. */
    bool seen = format == FORMAT_RGBA8_SRGB || format == FORMAT_RG16F;
    uint32_t flags = seen ? IMAGE_MUTABLE_FORMAT | IMAGE_EXTENDED_USAGE : 0;
    ImageInfo info = {14, NULL, flags, 1, format, width, height, 1, 1, 1, 1, 0, usage, 0, 0, NULL, LAYOUT_UNDEFINED};
    require(host->CreateImage(device, &info, NULL, &texture->raw), "vkCreateImage");
    Needs needs;
    host->GetImageMemoryRequirements(device, texture->raw, &needs);
    texture->memory = host_memory(host, needs, 0);
    require(host->BindImageMemory(device, texture->raw, texture->memory, 0), "vkBindImageMemory");
    AshsplatForeignImage *description = &texture->description;
    *description = ASHSPLAT_INIT(AshsplatForeignImage);
    description->image = texture->raw;
    description->format = format;
    description->usage = usage;
    description->width = width;
    description->height = height;
    description->flags = flags;
    return texture;
}

static inline void host_free_texture(Host *host, HostTexture *texture) {
    host->DestroyImage(host->handles.device, texture->raw, NULL);
    host->FreeMemory(host->handles.device, texture->memory, NULL);
    texture->raw = texture->memory = 0;
}

static inline void host_close(Host *host) {
    for (uint32_t i = 0; i < host->buffer_count; ++i) {
        host_free_buffer(host, &host->buffers[i]);
    }
    for (uint32_t i = 0; i < host->texture_count; ++i) {
        host_free_texture(host, &host->textures[i]);
    }
    host->DestroyCommandPool(host->handles.device, host->pool, NULL);
    ashsplat_context_free(host->owner);
}

/* Records a change of layout, waiting for everything before. */
static inline void host_transition(Host *host, HostTexture *texture, uint32_t aspect, int from, int to, uint32_t access) {
    ImageBarrier barrier = {45, NULL, ACCESS_MEMORY_WRITE, access, from, to, ~0u, ~0u, texture->raw, {aspect, 0, 1, 0, 1}};
    host->CmdPipelineBarrier(host->commands, STAGE_ALL, STAGE_TRANSFER, 0, 0, NULL, 0, NULL, 1, &barrier);
}

/* Records a barrier that makes writes of one stage visible to another. */
static inline void host_barrier(Host *host, uint32_t from, uint32_t written, uint32_t to, uint32_t used) {
    MemoryBarrier barrier = {46, NULL, written, used};
    host->CmdPipelineBarrier(host->commands, from, to, 0, 1, &barrier, 0, NULL, 0, NULL);
}

/* Records a copy of a texture, as the release has left it, to where the host can read it. */
static inline void host_read(Host *host, HostTexture *texture, int layout, HostBuffer *to) {
    host_transition(host, texture, ASPECT_COLOR, layout, LAYOUT_COPY_FROM, ACCESS_TRANSFER_READ);
    ImageCopy copy = {0, 0, 0, ASPECT_COLOR, 0, 0, 1, 0, 0, 0, texture->description.width, texture->description.height, 1};
    host->CmdCopyImageToBuffer(host->commands, texture->raw, LAYOUT_COPY_FROM, to->raw, 1, &copy);
    host_barrier(host, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE, STAGE_HOST, ACCESS_HOST_READ);
}

/* Same as host_read, but for a buffer of the guest. */
static inline void host_read_buffer(Host *host, uint64_t from, uint64_t offset, uint64_t bytes, HostBuffer *to) {
    host_barrier(host, STAGE_ALL, ACCESS_MEMORY_WRITE, STAGE_TRANSFER, ACCESS_TRANSFER_READ);
    BufferCopy copy = {offset, 0, bytes};
    host->CmdCopyBuffer(host->commands, from, to->raw, 1, &copy);
    host_barrier(host, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE, STAGE_HOST, ACCESS_HOST_READ);
}

static inline void write_file(const char *path, const void *data, size_t bytes) {
    FILE *out = fopen(path, "wb");
    EXPECT(out != NULL && fwrite(data, 1, bytes, out) == bytes && fclose(out) == 0);
}

/* Writes texels of four bytes as PNG, without their alpha. */
static inline void write_picture(const char *path, uint32_t width, uint32_t height, const uint8_t *texels) {
    float *rgb = malloc(sizeof(float) * 3 * width * height);
    EXPECT(rgb != NULL);
    for (uint32_t i = 0; i < 3 * width * height; ++i) {
        rgb[i] = (float)texels[i / 3 * 4 + i % 3] / 255.0f;
    }
    check(ashsplat_write_png(path, width, height, rgb), "writing a picture");
    free(rgb);
}

/* A camera that looks at a point from another one, with down as y. */
static inline AshsplatCamera look_at(float x, float y, float z, const float target[3], float fov_x, uint32_t width, uint32_t height) {
    const float eye[3] = {x, y, z}, up[3] = {0, -1, 0};
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    check(ashsplat_camera_look_at(eye, target, up, fov_x, width, height, &camera), "a camera");
    return camera;
}
static const float ORIGIN[3] = {0, 0, 0};

static inline AshsplatPlaced place(const AshsplatScene *scene) {
    AshsplatPlaced placed = ASHSPLAT_INIT(AshsplatPlaced);
    placed.scene = scene;
    return placed;
}

/* A guest with a scene and a frame that shows it. */
typedef struct {
    Host host;
    AshsplatContext *context;
    AshsplatScene *scene;
    AshsplatRenderer *renderer;
    AshsplatImage *images[MOST];
    uint32_t image_count;
    AshsplatReservation wanted;
    AshsplatCamera camera;
    AshsplatPlaced placed;
    AshsplatRecordedFrame frame;
    AshsplatRelease release;
    AshsplatSlotReport report;
} Stage;

/* Makes the guest of an open host and loads its scene. */
static inline void stage_load(Stage *stage, const char *scene, uint32_t width, uint32_t height) {
    check(ashsplat_context_from_foreign(&stage->host.handles, &stage->context), "being a guest");
    check(ashsplat_scene_load(stage->context, scene, &stage->scene), "loading the scene");
    stage->wanted = ASHSPLAT_INIT(AshsplatReservation);
    stage->wanted.width = width;
    stage->wanted.height = height;
    check(ashsplat_scene_size(stage->scene, &stage->wanted.gaussians, &stage->wanted.sh_degree), "asking for the scene's size");
    stage->camera = look_at(0, -1, -4, ORIGIN, 0.7f, width, height);
    stage->placed = place(stage->scene);
    stage->frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    stage->frame.camera = &stage->camera;
    stage->frame.scenes = &stage->placed;
    stage->frame.scene_count = 1;
    stage->release = ASHSPLAT_INIT(AshsplatRelease);
    stage->report = ASHSPLAT_INIT(AshsplatSlotReport);
}

/* Opens the host, makes its guest, loads the scene and builds a renderer. */
static inline void stage_open(Stage *stage, const char *scene, uint32_t width, uint32_t height) {
    host_open(&stage->host);
    stage_load(stage, scene, width, height);
    check(ashsplat_renderer_new(stage->context, &stage->renderer), "building the renderer");
}

/* An image of the frame, in a texture of its size that the host can read. */
static inline AshsplatImage *stage_image(Stage *stage, HostTexture *texture, AshsplatImageUse purpose) {
    EXPECT(stage->image_count < MOST);
    AshsplatImage **image = &stage->images[stage->image_count++];
    check(ashsplat_image_adopt(stage->context, &texture->description, purpose, image), "adopting an image");
    return *image;
}

static inline void stage_reserve(Stage *stage) {
    check(ashsplat_reserve(stage->renderer, &stage->wanted), "reserving");
}

/* Records the frame into slot 0. */
static inline AshsplatStatus stage_record(Stage *stage) {
    return ashsplat_record(stage->renderer, stage->host.commands, 0, &stage->frame, &stage->release);
}

/* Requires that the frame is refused with these words. */
#define REFUSED_FRAME(stage, words) REFUSED(stage_record(stage), words)

/* Submits the recorded commands, waits and reads the report. */
static inline void stage_finish(Stage *stage) {
    host_submit_and_wait(&stage->host);
    check(ashsplat_slot_report(stage->renderer, 0, &stage->report), "asking for the report");
    EXPECT(stage->report.finished);
}

static inline void stage_free(Stage *stage) {
    ashsplat_renderer_free(stage->renderer);
    for (uint32_t i = 0; i < stage->image_count; ++i) {
        ashsplat_image_free(stage->images[i]);
    }
    ashsplat_scene_free(stage->scene);
    ashsplat_context_free(stage->context);
}

static inline void stage_close(Stage *stage) {
    stage_free(stage);
    host_close(&stage->host);
}

#endif
