/* An engine around the guide's guest: guide SCENE.ply [wrong]
 *
 * Two frames are in flight. A wall hides a part of the scene. The first frames have too little room, and the window is resized while
 * frames are in flight. With "wrong", the engine says that an image is in a layout that it is not in.
 */
#include "host.h"
#include "included.c"

enum { WIDTH = 160, HEIGHT = 120, SLOTS = 2 };

typedef struct { HostTexture *color, *depth; } Images;

/* A frame in flight. */
typedef struct {
    void *commands;
    uint64_t fence;
    HostBuffer *pixels;
    uint32_t size;
} Flight;

typedef struct {
    Host host;
    Guest guest;
    Flight flights[SLOTS];
    bool is_wrong;
} Engine;

static Images make_images(Host *host, uint32_t width, uint32_t height) {
    uint32_t drawn = USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_TO | USAGE_IMAGE_COPY_FROM;
    uint32_t read = USAGE_IMAGE_DEPTH | USAGE_IMAGE_SAMPLED | USAGE_IMAGE_COPY_TO;
    Images images = {host_texture(host, FORMAT_RGBA16F, drawn, width, height), host_texture(host, FORMAT_D32, read, width, height)};
    return images;
}

static void open_flights(Engine *engine) {
    Host *host = &engine->host;
    for (Flight *flight = engine->flights; flight < engine->flights + SLOTS; ++flight) {
        AllocateInfo allocate_info = {40, NULL, host->pool, 0, 1};
        require(host->AllocateCommandBuffers(host->handles.device, &allocate_info, &flight->commands), "vkAllocateCommandBuffers");
        FenceInfo fence_info = {8, NULL, 0};
        require(host->CreateFence(host->handles.device, &fence_info, NULL, &flight->fence), "vkCreateFence");
        flight->pixels = host_buffer(host, 8 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    }
}

/* A frame of the engine: an empty room, a wall at this reversed depth, and the guest. It is submitted without waiting. */
static void draw(Engine *engine, uint32_t slot, const Images *images, float wall) {
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, -2.6667f, 0, 0, 0, 0, 0, -1, 0, 0, 0.1f, 0};
    const float black[4] = {0, 0, 0, 1};
    ClearDepth cleared = {wall, 0};
    Range whole[2] = {{ASPECT_COLOR, 0, 1, 0, 1}, {ASPECT_DEPTH, 0, 1, 0, 1}};
    AshsplatImageState drawn[2] = {
        {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE},
        {engine->is_wrong ? LAYOUT_COPY_FROM : LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE},
    };
    Host *host = &engine->host;
    Flight *flight = &engine->flights[slot];
    host->commands = flight->commands;
    void *commands = host_begin(host);
    host_transition(host, images->color, ASPECT_COLOR, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host_transition(host, images->depth, ASPECT_DEPTH, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host->CmdClearColorImage(commands, images->color->raw, LAYOUT_COPY_TO, black, 1, &whole[0]);
    host->CmdClearDepthStencilImage(commands, images->depth->raw, LAYOUT_COPY_TO, &cleared, 1, &whole[1]);
    AshsplatRelease left;
    check(guest_record(&engine->guest, commands, slot, view, projection, drawn, &left), "recording");
    EXPECT(left.stages != 0 && left.color.layout != LAYOUT_UNDEFINED && left.occluder.layout != LAYOUT_UNDEFINED);
    flight->size = images->color->description.width * images->color->description.height;
    host_read(host, images->color, left.color.layout, flight->pixels);
    require(host->EndCommandBuffer(commands), "vkEndCommandBuffer");
    SubmitInfo submit_info = {4, NULL, 0, NULL, NULL, 1, &flight->commands, 0, NULL};
    require(host->QueueSubmit(host->handles.queue, 1, &submit_info, flight->fence), "vkQueueSubmit");
}

/* Waits for the frame of a slot. Counts the pixels that are not black. */
static AshsplatSlotReport finish(Engine *engine, uint32_t slot, uint32_t *lit) {
    Flight *flight = &engine->flights[slot];
    void *device = engine->host.handles.device;
    require(engine->host.WaitForFences(device, 1, &flight->fence, 1, UINT64_MAX), "vkWaitForFences");
    require(engine->host.ResetFences(device, 1, &flight->fence), "vkResetFences");
    const uint16_t *halves = flight->pixels->mapped;
    *lit = 0;
    for (uint32_t i = 0; i < flight->size; ++i) {
        *lit += halves[4 * i] != 0 || halves[4 * i + 1] != 0 || halves[4 * i + 2] != 0;
    }
    AshsplatSlotReport report;
    check(guest_finish(&engine->guest, slot, &report), "finishing");
    EXPECT(report.finished);
    return report;
}

int main(int count, char **arguments) {
    EXPECT(count == 2 || count == 3);
    static Engine engine;
    engine.is_wrong = count == 3;
    Host *host = &engine.host;
    Guest *guest = &engine.guest;
    host_open(host);
    open_flights(&engine);
    check(guest_open(guest, &host->handles, arguments[1], SLOTS), "being a guest");
    Images small = make_images(host, WIDTH / 2, HEIGHT / 2), large = make_images(host, WIDTH, HEIGHT);
    AshsplatForeignImage unfit = large.color->description;
    unfit.format = FORMAT_D32;
    guest->reserved.instances = 4;
    /* A resize that fails changes nothing. */
    EXPECT(guest_resize(guest, &unfit, &large.depth->description) != AshsplatStatus_Ok && guest->color == NULL);
    check(guest_resize(guest, &small.color->description, &small.depth->description), "the first images");
    uint32_t lit = 0, few = 0;
    draw(&engine, 0, &small, 0);
    draw(&engine, 1, &small, 0);
    /* The reservation grows while the other frame is in flight. */
    EXPECT(finish(&engine, 0, &few).overflow);
    draw(&engine, 0, &small, 0);
    /* A window may also be resized while a frame is in flight; a refused resize changes nothing. */
    EXPECT(guest_resize(guest, &unfit, &large.depth->description) != AshsplatStatus_Ok);
    check(guest_resize(guest, &large.color->description, &large.depth->description), "the window grows");
    EXPECT(finish(&engine, 1, &few).overflow);
    draw(&engine, 1, &large, 0);
    AshsplatSlotReport all = finish(&engine, 0, &lit);
    EXPECT(!all.overflow && all.visible == all.gaussians && lit > few);
    host_free_texture(host, small.color);
    host_free_texture(host, small.depth);
    draw(&engine, 0, &large, 0);
    while (finish(&engine, 1, &lit).overflow) {
        draw(&engine, 1, &large, 0);
    }
    EXPECT(lit > WIDTH * HEIGHT / 10);
    finish(&engine, 0, &lit);
    /* Close to the eye, the wall hides everything. */
    draw(&engine, 0, &large, 0.09f);
    EXPECT(!finish(&engine, 0, &lit).overflow && lit == 0);
    printf("%u of %u Gaussians visible\n", all.visible, all.gaussians);
    guest_close(guest);
    for (int slot = 0; slot < SLOTS; ++slot) {
        host->DestroyFence(host->handles.device, engine.flights[slot].fence, NULL);
    }
    host_close(host);
    return 0;
}
