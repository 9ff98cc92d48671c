/* An engine around the guide's guest: guide SCENE.ply
 *
 * A wall hides a part of the scene; the window is resized in the middle, and the first frame has too little room.
 */
#include "host.h"
#include "included.c"

enum { WIDTH = 160, HEIGHT = 120 };

typedef struct { HostTexture color, depth; } Images;

static Images make_images(Host *host, uint32_t width, uint32_t height) {
    Images images;
    images.color = host_texture(host, FORMAT_RGBA16F, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_TO | USAGE_IMAGE_COPY_FROM, width, height);
    images.depth = host_texture(host, FORMAT_D32, USAGE_IMAGE_DEPTH | USAGE_IMAGE_SAMPLED | USAGE_IMAGE_COPY_TO, width, height);
    return images;
}

static void free_images(Host *host, Images *images) {
    host_free_texture(host, &images->color);
    host_free_texture(host, &images->depth);
}

/* A frame of the engine: an empty room, a wall at this reversed depth, and the guest. Counts the pixels that are not black. */
static AshsplatSlotReport draw(Host *host, Guest *guest, Images *images, float wall, uint32_t *lit) {
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, -2.6667f, 0, 0, 0, 0, 0, -1, 0, 0, 0.1f, 0};
    const float black[4] = {0, 0, 0, 1};
    ClearDepth cleared = {wall, 0};
    Range whole[2] = {{ASPECT_COLOR, 0, 1, 0, 1}, {ASPECT_DEPTH, 0, 1, 0, 1}};
    AshsplatImageState drawn[2] = {
        {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE},
        {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE},
    };
    void *commands = host_begin(host);
    host_transition(host, &images->color, ASPECT_COLOR, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host_transition(host, &images->depth, ASPECT_DEPTH, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host->CmdClearColorImage(commands, images->color.raw, LAYOUT_COPY_TO, black, 1, &whole[0]);
    host->CmdClearDepthStencilImage(commands, images->depth.raw, LAYOUT_COPY_TO, &cleared, 1, &whole[1]);
    AshsplatRelease left;
    check(guest_record(guest, commands, 0, view, projection, drawn, &left), "recording");
    EXPECT(left.stages != 0 && left.color.layout != LAYOUT_UNDEFINED && left.occluder.layout != LAYOUT_UNDEFINED);
    uint32_t size = images->color.description.width * images->color.description.height;
    HostBuffer pixels = host_buffer(host, 8 * size, USAGE_BUFFER_COPIES);
    host_read(host, &images->color, left.color.layout, &pixels);
    host_submit_and_wait(host);
    const uint16_t *halves = pixels.mapped;
    *lit = 0;
    for (uint32_t i = 0; i < size; ++i) {
        *lit += halves[4 * i] != 0 || halves[4 * i + 1] != 0 || halves[4 * i + 2] != 0;
    }
    host_free_buffer(host, &pixels);
    AshsplatSlotReport report;
    check(guest_finish(guest, 0, &report), "finishing");
    EXPECT(report.finished);
    return report;
}

int main(int count, char **arguments) {
    EXPECT(count == 2);
    static Host host;
    host_open(&host);
    Guest guest = {NULL, NULL, NULL, ASHSPLAT_INIT(AshsplatReservation), NULL, NULL};
    check(guest_open(&guest, &host.handles, arguments[1], 2), "being a guest");
    Images small = make_images(&host, WIDTH / 2, HEIGHT / 2), large = make_images(&host, WIDTH, HEIGHT);
    guest.reserved.instances = 4;
    check(guest_resize(&guest, &small.color.description, &small.depth.description), "the first images");
    uint32_t lit = 0, few = 0;
    EXPECT(draw(&host, &guest, &small, 0, &few).overflow);
    AshsplatSlotReport all = draw(&host, &guest, &small, 0, &lit);
    EXPECT(!all.overflow && all.visible == all.gaussians && lit > few);
    check(guest_resize(&guest, &large.color.description, &large.depth.description), "the window grows");
    free_images(&host, &small);
    while ((all = draw(&host, &guest, &large, 0, &lit)).overflow) {}
    EXPECT(lit > WIDTH * HEIGHT / 10);
    /* Close to the eye, the wall hides everything. */
    EXPECT(!draw(&host, &guest, &large, 0.09f, &lit).overflow && lit == 0);
    printf("%u of %u Gaussians visible\n", all.visible, all.gaussians);
    guest_close(&guest);
    free_images(&host, &large);
    host_close(&host);
    return 0;
}
