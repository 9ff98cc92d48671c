/* Two eyes side by side in one recording, in C: views SCENE.ply
 *
 * The same picture as of two recordings, with one sort; and a host's lock around its queue.
 */
#include "host.h"

enum { WIDTH = 96, HEIGHT = 64 };

typedef struct { int held, taken; } Lock;

static void take(void *user) {
    Lock *lock = user;
    EXPECT(lock->held == 0);
    lock->held = 1;
    ++lock->taken;
}

static void give(void *user) {
    Lock *lock = user;
    EXPECT(lock->held == 1);
    lock->held = 0;
}

int main(int count, char **arguments) {
    EXPECT(count == 2);
    static Host host;
    host_open(&host);
    Lock lock = {0, 0};
    AshsplatContext *context = NULL;
    host.handles.queue_user = &lock;
    host.handles.lock_queue = take;
    EXPECT(ashsplat_context_from_foreign(&host.handles, &context) == AshsplatStatus_Argument && context == NULL);
    EXPECT(strstr(ashsplat_last_error(), "unlock_queue: is NULL") != NULL);
    host.handles.unlock_queue = give;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    AshsplatScene *scene = NULL;
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");

    HostTexture color = host_texture(&host, FORMAT_RGBA8_SRGB, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM, 2 * WIDTH, HEIGHT);
    HostBuffer pixels = host_buffer(&host, 4 * 2 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    AshsplatImage *target = NULL;
    check(ashsplat_image_adopt(context, &color.description, AshsplatImageUse_Target, &target), "adopting the target");
    /* The device has this family alone, which owns the image as it is. */
    int32_t layout = 0;
    EXPECT(ashsplat_image_of_family(target, 1000, &layout) == AshsplatStatus_Argument);
    check(ashsplat_image_of_family(target, host.handles.queue_family, &layout), "naming the owner");
    EXPECT(layout == 1);
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.width = WIDTH;
    wanted.height = HEIGHT;
    wanted.slots = 2;
    wanted.images_only = true;
    check(ashsplat_scene_size(scene, &wanted.gaussians, &wanted.sh_degree), "asking for the scene's size");
    check(ashsplat_reserve(renderer, &wanted), "reserving");

    AshsplatPlaced placed = ASHSPLAT_INIT(AshsplatPlaced);
    placed.scene = scene;
    AshsplatCamera eyes[2] = {ASHSPLAT_INIT(AshsplatCamera), ASHSPLAT_INIT(AshsplatCamera)};
    const float eye[3] = {0, -1, -4}, at[3] = {0, 0, 0}, up[3] = {0, -1, 0};
    check(ashsplat_camera_look_at(eye, at, up, 0.7f, WIDTH, HEIGHT, &eyes[0]), "a camera");
    eyes[1] = eyes[0];
    eyes[1].translation[0] -= 0.25f;
    AshsplatTarget to[2] = {ASHSPLAT_INIT(AshsplatTarget), ASHSPLAT_INIT(AshsplatTarget)};
    AshsplatRecordedFrame views[2] = {ASHSPLAT_INIT(AshsplatRecordedFrame), ASHSPLAT_INIT(AshsplatRecordedFrame)};
    AshsplatRelease left[2] = {ASHSPLAT_INIT(AshsplatRelease), ASHSPLAT_INIT(AshsplatRelease)};
    for (int i = 0; i < 2; ++i) {
        to[i].to.image = target;
        to[i].to.offset[0] = (uint32_t)(i * WIDTH);
        to[i].behind = AshsplatBackground_Color;
        views[i].camera = &eyes[i];
        views[i].scenes = &placed;
        views[i].scene_count = 1;
        views[i].target = &to[i];
    }

    /* What submits takes the lock. */
    static float rgb[3 * WIDTH * HEIGHT];
    const float black[3] = {0, 0, 0};
    check(ashsplat_render(renderer, scene, &eyes[0], NULL, black, rgb), "rendering");
    EXPECT(lock.taken > 0 && lock.held == 0);

    /* One by one, the second into what the first has left. */
    static uint8_t expected[4 * 2 * WIDTH * HEIGHT];
    void *commands = host_begin(&host);
    int before = lock.taken;
    check(ashsplat_record_views(renderer, commands, 0, &views[0], 1, &left[0]), "recording the left eye");
    to[1].to.from = left[0].color;
    check(ashsplat_record(renderer, commands, 1, &views[1], &left[1]), "recording the right eye");
    EXPECT(lock.taken == before && lock.held == 0);
    host_read(&host, &color, left[1].color.layout, &pixels);
    host_submit_and_wait(&host);
    memcpy(expected, pixels.mapped, sizeof expected);
    memset(pixels.mapped, 0, sizeof expected);

    commands = host_begin(&host);
    EXPECT(ashsplat_record_views(renderer, commands, 0, views, 2, left) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "frames: 2 of them, AshsplatReservation.views is 1") != NULL);
    EXPECT(ashsplat_record_views(renderer, commands, 0, views, 0, left) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "frames: there are none") != NULL);
    wanted.views = 2;
    wanted.shared_sort = 1;
    check(ashsplat_reserve(renderer, &wanted), "reserving for two");
    views[1].camera = NULL;
    EXPECT(ashsplat_record_views(renderer, commands, 0, views, 2, left) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "frames[1].camera: the pointer is null") != NULL);
    views[1].camera = &eyes[1];
    left[1].struct_size = 0;
    EXPECT(ashsplat_record_views(renderer, commands, 0, views, 2, left) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "releases[1]: struct_size is 0") != NULL);
    left[1] = left[0];
    to[1].to.offset[0] = WIDTH + 1;
    EXPECT(ashsplat_record_views(renderer, commands, 0, views, 2, left) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "frames[1].target (image 'target'): 96 x 64 pixels at (97, 0)") != NULL);
    to[1].to.offset[0] = WIDTH;
    check(ashsplat_record_views(renderer, commands, 0, views, 2, left), "recording both eyes");
    EXPECT(left[0].color.layout == left[1].color.layout && left[1].struct_size == sizeof left[1]);
    host_read(&host, &color, left[1].color.layout, &pixels);
    host_submit_and_wait(&host);
    EXPECT(memcmp(expected, pixels.mapped, sizeof expected) == 0);
    int lit = 0, differ = 0;
    for (int i = 0; i < 2 * WIDTH * HEIGHT; ++i) {
        lit += expected[4 * i] > 32;
        differ += i % (2 * WIDTH) < WIDTH && expected[4 * i] != expected[4 * (i + WIDTH)];
    }
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(report.finished && !report.overflow);
    EXPECT(report.sorts == 1);
    printf("%u Gaussians visible, %d pixels lit, %d differ, %d locks\n", report.visible, lit, differ, lock.taken);

    ashsplat_renderer_free(renderer);
    ashsplat_scene_free(scene);
    ashsplat_image_free(target);
    ashsplat_context_free(context);
    host_free_texture(&host, &color);
    host_free_buffer(&host, &pixels);
    host_close(&host);
    return 0;
}
