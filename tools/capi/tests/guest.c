/* What else a host in C may want: guest SCENE.ply PICTURE.png SUMS.bin
 *
 * Memory from its own allocator, settings, a frame in the corner of a larger picture, the sum of weights / z, recordings
 * that are thrown away, and numbers that stand for nothing.
 */
#include "host.h"

enum { WIDTH = 96, HEIGHT = 64, X = 20, Y = 8, WHOLE_WIDTH = 128, WHOLE_HEIGHT = 80 };

typedef struct { Host *host; int live, made; } Counter;

static bool allocate(void *user, const AshsplatMemoryRequest *request, AshsplatMemory *memory) {
    Counter *counter = user;
    Needs needs = {request->bytes, request->alignment, request->memory_types};
    if (request->bytes == 0 || request->name == NULL || request->name[0] == 0) {
        return false;
    }
    memory->memory = host_memory(counter->host, needs, request->host_visible ? 2 | 4 : 0);
    memory->offset = 0;
    memory->mapped = NULL;
    if (request->host_visible) {
        void *device = counter->host->handles.device;
        require(counter->host->MapMemory(device, memory->memory, 0, request->bytes, 0, &memory->mapped), "vkMapMemory");
    }
    memory->id = (uint64_t)counter->made + 7;
    ++counter->made;
    ++counter->live;
    return true;
}

static void release(void *user, AshsplatMemory memory) {
    Counter *counter = user;
    EXPECT(memory.id >= 7 && memory.id < (uint64_t)counter->made + 7);
    counter->host->FreeMemory(counter->host->handles.device, memory.memory, NULL);
    --counter->live;
}

static bool refuse(void *user, const AshsplatMemoryRequest *request, AshsplatMemory *memory) {
    (void)user, (void)request, (void)memory;
    return false;
}

int main(int count, char **arguments) {
    EXPECT(count == 4);
    static Host host;
    host_open(&host);
    Counter counter = {&host, 0, 0};
    AshsplatAllocator allocator = ASHSPLAT_INIT(AshsplatAllocator);
    allocator.user = &counter;
    allocator.allocate = allocate;
    allocator.free = release;
    AshsplatAllocator half = allocator, exhausted = allocator;
    half.free = NULL;
    exhausted.allocate = refuse;
    AshsplatContext *context = NULL, *none = NULL;
    host.handles.allocator = &half;
    EXPECT(ashsplat_context_from_foreign(&host.handles, &none) == AshsplatStatus_Argument && none == NULL);
    AshsplatScene *scene = NULL;
    host.handles.allocator = &exhausted;
    check(ashsplat_context_from_foreign(&host.handles, &none), "being a poor guest");
    EXPECT(ashsplat_scene_load(none, arguments[1], &scene) == AshsplatStatus_Vulkan && scene == NULL);
    ashsplat_context_free(none);
    host.handles.allocator = &allocator;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");
    int of_scene = counter.live;
    EXPECT(of_scene > 0);

    HostTexture color = host_texture(&host, FORMAT_RGBA8_SRGB, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM | USAGE_IMAGE_COPY_TO,
                                     WHOLE_WIDTH, WHOLE_HEIGHT);
    HostBuffer pixels = host_buffer(&host, 4 * WHOLE_WIDTH * WHOLE_HEIGHT, USAGE_BUFFER_COPIES);
    HostBuffer sums = host_buffer(&host, 4 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    /* Kernels would see its texels as another format, which its flags do not allow. */
    AshsplatImage *target = NULL;
    AshsplatForeignImage fixed = color.description;
    fixed.flags = 0;
    EXPECT(ashsplat_image_adopt(context, &fixed, AshsplatImageUse_Target, &target) == AshsplatStatus_Argument && target == NULL);
    EXPECT(strstr(ashsplat_last_error(), "MUTABLE_FORMAT") != NULL);
    check(ashsplat_image_adopt(context, &color.description, AshsplatImageUse_Target, &target), "adopting the target");
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.width = WIDTH;
    wanted.height = HEIGHT;
    wanted.blend_passes = 2;
    wanted.inverse_depth = true;
    check(ashsplat_scene_size(scene, &wanted.gaussians, &wanted.sh_degree), "asking for the scene's size");
    check(ashsplat_reserve(renderer, &wanted), "reserving");

    AshsplatRenderSettings settings = ASHSPLAT_INIT(AshsplatRenderSettings);
    EXPECT(settings.scale_modifier == 1 && settings.sh_degree == 3 && !settings.inverse_depth);
    settings.scale_modifier = 0.5f;
    settings.sh_degree = 0;
    settings.antialias = true;
    settings.inverse_depth = true;
    AshsplatPlaced placed = ASHSPLAT_INIT(AshsplatPlaced);
    placed.scene = scene;
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &camera;
    AshsplatTarget to = ASHSPLAT_INIT(AshsplatTarget);
    frame.scenes = &placed;
    frame.scene_count = 1;
    frame.settings = &settings;
    frame.target = &to;
    to.to.image = target;
    to.behind = AshsplatBackground_Color;
    to.background[1] = 0.5f;
    to.to.offset[0] = X;
    to.to.offset[1] = Y;
    const float eye[3] = {0, -1, -4}, at[3] = {0, 0, 0}, up[3] = {0, -1, 0};
    check(ashsplat_camera_look_at(eye, at, up, 0.7f, WIDTH, HEIGHT, &camera), "a camera");

    void *commands = host_begin(&host);
    to.behind = 3;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "target.behind: 3, there are 0 to 2") != NULL);
    to.behind = AshsplatBackground_Color;
    to.encoding = 2;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "target.encoding: 2, there are 0 to 1") != NULL);
    to.encoding = AshsplatColorEncoding_LinearSrgb;
    to.exposure = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "exposure") != NULL);
    /* Linear light, which an sRGB image encodes: on an opaque background the picture as trained. */
    to.exposure = 1;
    settings.shape = 0x7fffffff;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    settings.shape = AshsplatShape_Gaussian;
    to.to.offset[0] = WHOLE_WIDTH - WIDTH + 1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    to.to.offset[0] = X;

    /* Thrown away, and recorded again. */
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    bool finished = true;
    check(ashsplat_record(renderer, commands, 0, &frame, NULL), "recording");
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    check(ashsplat_slot_finished(renderer, 0, &finished), "asking");
    EXPECT(!finished && ashsplat_slot_release(renderer, 0) == AshsplatStatus_Argument);
    require(host.EndCommandBuffer(commands), "vkEndCommandBuffer");
    check(ashsplat_slot_discard(renderer, 0), "throwing away");
    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(!report.finished);

    /* All of the picture is black but for the frame. */
    int before = counter.made;
    commands = host_begin(&host);
    float black[4] = {0, 0, 0, 1};
    Range whole = {ASPECT_COLOR, 0, 1, 0, 1};
    host_transition(&host, &color, ASPECT_COLOR, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host.CmdClearColorImage(commands, color.raw, LAYOUT_COPY_TO, black, 1, &whole);
    AshsplatImageState cleared = {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE};
    to.to.from = cleared;
    AshsplatRelease left = ASHSPLAT_INIT(AshsplatRelease);
    check(ashsplat_record(renderer, commands, 0, &frame, &left), "recording again");
    EXPECT(counter.made == before);
    ashsplat_scene_free(scene);
    EXPECT(counter.live >= of_scene);
    host_read(&host, &color, left.color.layout, &pixels);
    uint64_t buffer = 0, offset = 0;
    check(ashsplat_slot_inverse_depth(renderer, 0, &buffer, &offset), "asking for the sums");
    BufferCopy copy = {offset, 0, 4 * WIDTH * HEIGHT};
    host.CmdCopyBuffer(commands, buffer, sums.raw, 1, &copy);
    MemoryBarrier barrier = {46, NULL, ACCESS_TRANSFER_WRITE, ACCESS_HOST_READ};
    host.CmdPipelineBarrier(commands, STAGE_TRANSFER, STAGE_HOST, 0, 1, &barrier, 0, NULL, 0, NULL);
    host_submit_and_wait(&host);
    check(ashsplat_slot_finished(renderer, 0, &finished), "asking");
    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(finished && report.finished && !report.overflow && report.blend_passes_needed == 1);
    int with_scene = counter.live;
    check(ashsplat_slot_release(renderer, 0), "letting go");
    EXPECT(counter.live < with_scene);

    static float rgb[3 * WHOLE_WIDTH * WHOLE_HEIGHT];
    const uint8_t *bytes = pixels.mapped;
    for (int i = 0; i < WHOLE_WIDTH * WHOLE_HEIGHT; ++i) {
        for (int channel = 0; channel < 3; ++channel) {
            rgb[3 * i + channel] = (float)bytes[4 * i + channel] / 255.0f;
        }
    }
    check(ashsplat_write_png(arguments[2], WHOLE_WIDTH, WHOLE_HEIGHT, rgb), "writing the picture");
    FILE *out = fopen(arguments[3], "wb");
    EXPECT(out != NULL && fwrite(sums.mapped, 4, WIDTH * HEIGHT, out) == WIDTH * HEIGHT && fclose(out) == 0);
    printf("%u of %u Gaussians visible, %d allocations\n", report.visible, report.gaussians, counter.made);

    ashsplat_renderer_free(renderer);
    ashsplat_image_free(target);
    ashsplat_context_free(context);
    EXPECT(counter.live == 0);
    host_free_texture(&host, &color);
    host_free_buffer(&host, &pixels);
    host_free_buffer(&host, &sums);
    host_close(&host);
    return 0;
}
