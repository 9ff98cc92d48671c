/* A host in C with a command buffer of its own: record SCENE.ply
 *
 * The device is one that ashsplat has opened, lent back as a host's: what matters here are the calls, and no Vulkan headers
 * are needed but for the few declarations below (they are those of vulkan_core.h).
 */
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
typedef struct {
    int type; const void *next;
    uint32_t wait_count; const uint64_t *waits; const uint32_t *stages;
    uint32_t command_count; void *const *commands;
    uint32_t signal_count; const uint64_t *signals;
} SubmitInfo;

static void check(AshsplatStatus status, const char *what) {
    if (status != AshsplatStatus_Ok) {
        fprintf(stderr, "error %d: %s: %s\n", (int)status, what, ashsplat_last_error());
        exit(2);
    }
}

static void require(int result, const char *what) {
    if (result != 0) {
        fprintf(stderr, "%s: %d\n", what, result);
        exit(3);
    }
}

static GetProc as_get_proc(void *symbol) {
    GetProc function = NULL;
    memcpy(&function, &symbol, sizeof function);
    return function;
}

int main(int count, char **arguments) {
    void *library = dlopen("libvulkan.so.1", RTLD_NOW);
    if (count != 2 || library == NULL) {
        fprintf(stderr, "usage: %s SCENE.ply, and a Vulkan loader\n", arguments[0]);
        return 2;
    }
    GetProc instance_proc = as_get_proc(dlsym(library, "vkGetInstanceProcAddr"));
    AshsplatContext *owner = NULL, *context = NULL;
    check(ashsplat_context_new(NULL, &owner), "opening a device");

    /* What a host knows of its own device. */
    AshsplatHost host;
    memset(&host, 0, sizeof host);
    check(ashsplat_context_handles(owner, &host.instance, &host.physical_device, &host.device, &host.queue_family),
          "asking for the handles");
    memcpy(&host.get_instance_proc_addr, &instance_proc, sizeof instance_proc);
    static uint64_t vulkan12[64], vulkan13[64];
    check(ashsplat_merge_features(vulkan12, vulkan13), "merging the features");
    host.vulkan12_features = vulkan12;
    host.vulkan13_features = vulkan13;
    GetProc device_proc = (GetProc)instance_proc(host.instance, "vkGetDeviceProcAddr");
    void (*get_queue)(void *, uint32_t, uint32_t, void **) =
        (void (*)(void *, uint32_t, uint32_t, void **))device_proc(host.device, "vkGetDeviceQueue");
    get_queue(host.device, host.queue_family, 0, &host.queue);
    check(ashsplat_context_from_host(&host, &context), "being a guest");

    AshsplatHost nobody = host;
    nobody.device = NULL;
    AshsplatContext *none = NULL;
    if (ashsplat_context_from_host(&nobody, &none) != AshsplatStatus_Argument || none != NULL) {
        return 4;
    }
    memset(vulkan13, 0, sizeof vulkan13);
    if (ashsplat_context_from_host(&host, &none) != AshsplatStatus_MissingFeature) {
        return 5;
    }

    AshsplatScene *scene = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatReservation wanted;
    memset(&wanted, 0, sizeof wanted);
    wanted.slots = 1;
    wanted.scenes = 1;
    wanted.width = 160;
    wanted.height = 120;
    check(ashsplat_scene_size(scene, &wanted.gaussians, &wanted.sh_degree), "asking for the scene's size");
    check(ashsplat_reserve(renderer, &wanted), "reserving");

    /* The host's command buffer. */
    int (*create_pool)(void *, const PoolInfo *, const void *, uint64_t *) =
        (int (*)(void *, const PoolInfo *, const void *, uint64_t *))device_proc(host.device, "vkCreateCommandPool");
    int (*allocate)(void *, const AllocateInfo *, void **) =
        (int (*)(void *, const AllocateInfo *, void **))device_proc(host.device, "vkAllocateCommandBuffers");
    int (*begin)(void *, const BeginInfo *) =
        (int (*)(void *, const BeginInfo *))device_proc(host.device, "vkBeginCommandBuffer");
    int (*end)(void *) = (int (*)(void *))device_proc(host.device, "vkEndCommandBuffer");
    int (*submit)(void *, uint32_t, const SubmitInfo *, uint64_t) =
        (int (*)(void *, uint32_t, const SubmitInfo *, uint64_t))device_proc(host.device, "vkQueueSubmit");
    int (*wait)(void *) = (int (*)(void *))device_proc(host.device, "vkQueueWaitIdle");
    void (*destroy_pool)(void *, uint64_t, const void *) =
        (void (*)(void *, uint64_t, const void *))device_proc(host.device, "vkDestroyCommandPool");
    PoolInfo pool_info = {39, NULL, 0, host.queue_family};
    uint64_t pool = 0;
    require(create_pool(host.device, &pool_info, NULL, &pool), "vkCreateCommandPool");
    AllocateInfo allocate_info = {40, NULL, pool, 0, 1};
    void *commands = NULL;
    require(allocate(host.device, &allocate_info, &commands), "vkAllocateCommandBuffers");
    BeginInfo begin_info = {42, NULL, 1, NULL};
    require(begin(commands, &begin_info), "vkBeginCommandBuffer");

    AshsplatPlaced placed = {scene, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
    AshsplatFrame frame;
    memset(&frame, 0, sizeof frame);
    frame.scenes = &placed;
    frame.scene_count = 1;
    /* A host's matrices, column by column: it looks along -z of its view space, depth reversed, no far plane. */
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, -2.6667f, 0, 0, 0, 0, 0, -1, 0, 0, 0.1f, 0};
    check(ashsplat_camera_from_matrices(view, projection, false, 160, 120, &frame.camera, &frame.depth_mapping),
          "understanding the matrices");
    if (ashsplat_record(renderer, NULL, 0, &frame, NULL) != AshsplatStatus_Argument ||
        ashsplat_record(renderer, commands, 7, &frame, NULL) != AshsplatStatus_Argument) {
        return 6;
    }
    AshsplatRelease release;
    check(ashsplat_record(renderer, commands, 0, &frame, &release), "recording");
    AshsplatReport report;
    check(ashsplat_slot_report(renderer, 0, &report), "asking too early");
    if (report.finished || release.stages == 0) {
        return 7;
    }
    require(end(commands), "vkEndCommandBuffer");
    SubmitInfo submit_info = {4, NULL, 0, NULL, NULL, 1, &commands, 0, NULL};
    require(submit(host.queue, 1, &submit_info, 0), "vkQueueSubmit");
    require(wait(host.queue), "vkQueueWaitIdle");

    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    if (!report.finished || report.overflow) {
        return 8;
    }
    printf("%u of %u Gaussians visible, scale %.1f, offset %.1f\n", report.visible, report.gaussians,
           (double)frame.depth_mapping.scale, (double)frame.depth_mapping.offset);
    ashsplat_renderer_free(renderer);
    ashsplat_scene_free(scene);
    destroy_pool(host.device, pool, NULL);
    ashsplat_context_free(context);
    ashsplat_context_free(owner);
    return 0;
}
