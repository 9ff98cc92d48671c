/* Frames of a guest in a host's command buffer: record TRIAL SCENE.ply [FILE...] */
#include "host.h"
/* Included a second time, as an engine's header might. */
#include "ashsplat.h"

/* Column by column: the host looks along -z of its view space, depth reversed, no far plane. */
static const float VIEW[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -4, 1};
static const float PROJECTION[16] = {2, 0, 0, 0, 0, -2.6667f, 0, 0, 0, 0, 0, -1, 0, 0, 0.1f, 0};

/* The host enables only the features that the guest merges into its own. */
static void merged_features(Host *host) {
    AshsplatContext *none = NULL;
    AshsplatForeignDevice nobody = host->handles;
    nobody.device = NULL;
    EXPECT(ashsplat_context_from_foreign(&nobody, &none) == AshsplatStatus_Argument && none == NULL);
    static uint64_t nothing[64], merged[2][64];
    nobody = host->handles;
    nobody.vulkan13_features = nothing;
    REFUSED(ashsplat_context_from_foreign(&nobody, &none), "^vulkan13_features: sType is 0, it must be 53");
    EXPECT(none == NULL);
    nothing[0] = FEATURES_13;
    EXPECT(ashsplat_context_from_foreign(&nobody, &none) == AshsplatStatus_MissingFeature);

    REFUSED(ashsplat_merge_features(NULL, merged[1]), "");
    REFUSED(ashsplat_merge_features(merged[0], NULL), "");
    merged[0][0] = FEATURES_12;
    REFUSED_WITH(merged[0][0], FEATURES_13, ashsplat_merge_features(merged[0], merged[1]), "^vulkan12: sType is 53, it must be 51");
    merged[1][0] = FEATURES_13;
    check(ashsplat_merge_features(merged[0], merged[1]), "merging features");
    AshsplatForeignDevice merging = host->handles;
    merging.vulkan12_features = merged[0];
    merging.vulkan13_features = merged[1];
    check(ashsplat_context_from_foreign(&merging, &none), "being a guest with merged features");
    ashsplat_context_free(none);
}

/* Kernels may be built ahead, by any thread. */
static void build_ahead(Stage *stage) {
    AshsplatKernels *kernels = NULL;
    uint32_t count = 0;
    check(ashsplat_kernels_new(stage->context, &stage->wanted, &kernels, &count), "listing the kernels");
    EXPECT(count > 20);
    for (uint32_t kernel = 0; kernel < count; ++kernel) {
        check(ashsplat_kernels_build(kernels, kernel), "building a kernel");
    }
    REFUSED(ashsplat_kernels_build(kernels, count), "");
    ashsplat_kernels_free(kernels);
}

/* A second guest on the same device shows the same scene. */
static void share_scene(Stage *stage) {
    AshsplatContext *other = NULL;
    AshsplatScene *shared = NULL;
    check(ashsplat_context_from_foreign(&stage->host.handles, &other), "being a guest twice");
    check(ashsplat_scene_in_context(stage->scene, other, &shared), "sharing the scene");
    uint32_t gaussians = 0, degree = 0;
    check(ashsplat_scene_size(shared, &gaussians, &degree), "asking for its size");
    EXPECT(gaussians == stage->wanted.gaussians && degree == stage->wanted.sh_degree);
    stage->placed.scene = shared;
    host_begin(&stage->host);
    REFUSED_FRAME(stage, "^scenes[0].scene: it belongs to another context");
    stage->placed.scene = stage->scene;
    require(stage->host.EndCommandBuffer(stage->host.commands), "vkEndCommandBuffer");
    ashsplat_scene_free(shared);
    ashsplat_context_free(other);
}

/* Frames in a block of the host's memory, which is too small at first. */
static void plain(char **arguments) {
    static Stage stage;
    Host *host = &stage.host;
    host_open(host);
    merged_features(host);
    stage_load(&stage, arguments[0], 160, 120);
    build_ahead(&stage);
    check(ashsplat_renderer_new(stage.context, &stage.renderer), "building the renderer");
    AshsplatRenderer *renderer = stage.renderer;
    AshsplatReservation *wanted = &stage.wanted;
    REFUSED(ashsplat_grow(renderer, wanted), "");
    /* The block begins behind other data of the host. */
    uint64_t bytes = 0;
    wanted->instances = 4;
    check(ashsplat_reservation_bytes(renderer, wanted, &bytes), "asking for the size");
    HostBuffer *frames = host_buffer(host, 256 + bytes, 1 | 2 | 16 | 32 | 256);
    AshsplatHostBuffer block = {frames->raw, 256, bytes - 256};
    EXPECT(ashsplat_reserve_in(renderer, wanted, &block, false) == AshsplatStatus_TooLarge);
    block.bytes = bytes;
    check(ashsplat_reserve_in(renderer, wanted, &block, false), "reserving in a block");

    void *commands = host_begin(host);
    AshsplatDepthMapping mapping;
    check(ashsplat_camera_from_matrices(VIEW, PROJECTION, false, 160, 120, &stage.camera, &mapping),
          "understanding the matrices");
    REFUSED(ashsplat_record(renderer, NULL, 0, &stage.frame, NULL), "^commands: ");
    REFUSED(ashsplat_record(renderer, commands, 7, &stage.frame, NULL), "^slot: 7: 1 are reserved; call ashsplat_reserve");
    REFUSED(ashsplat_record(NULL, commands, 0, &stage.frame, NULL), "");
    REFUSED(ashsplat_record(renderer, commands, 0, NULL, NULL), "");
    REFUSED_WITH(stage.placed.scale, 0, stage_record(&stage), "^scenes[0]: a scale of 0 is not possible");
    AshsplatRenderSettings settings = ASHSPLAT_INIT(AshsplatRenderSettings);
    settings.shape = 9;
    REFUSED_WITH(stage.frame.settings, &settings, stage_record(&stage), "^settings.shape: 9, there are 0 to 2");
    AshsplatCamera mirrored;
    REFUSED(ashsplat_camera_from_matrices(VIEW, PROJECTION, true, 160, 120, &mirrored, NULL), "check clip_y_up;");
    AshsplatPlaced twice[2] = {stage.placed, stage.placed};
    stage.frame.scenes = twice;
    stage.frame.scene_count = 2;
    REFUSED_FRAME(&stage, "^scenes: 2 of them, AshsplatReservation.scenes is 1");
    stage.frame.scenes = &stage.placed;
    stage.frame.scene_count = 1;
    check(stage_record(&stage), "recording");
    REFUSED_FRAME(&stage, "");
    AshsplatSlotReport *report = &stage.report;
    check(ashsplat_slot_report(renderer, 0, report), "asking too early");
    EXPECT(!report->finished && stage.release.stages != 0);
    /* The block grows while the frame is in flight. */
    wanted->instances = 0;
    check(ashsplat_grow(renderer, wanted), "growing");
    stage_finish(&stage);
    EXPECT(report->overflow && report->instance_capacity == 4 && report->blend_passes == 1);
    EXPECT(report->entries_per_pass >= report->longest_tile);
    AshsplatReservation grown = ASHSPLAT_INIT(AshsplatReservation);
    check(ashsplat_reservation_grown(wanted, report, &grown), "asking for room");
    EXPECT(grown.instances > report->instances_needed && grown.blend_passes == 0 && grown.width == wanted->width);
    check(ashsplat_reservation_grown(&grown, report, &grown), "asking again");
    EXPECT(grown.instances < 2 * report->instances_needed);
    host_begin(host);
    check(stage_record(&stage), "recording with more room");
    host_submit_and_wait(host);
    host_free_buffer(host, frames);
    check(ashsplat_slot_report(renderer, 0, report), "asking for the report");
    EXPECT(report->finished && !report->overflow);
    uint64_t buffer = 0, offset = 1;
    check(ashsplat_slot_pixels(renderer, 0, &buffer, &offset), "asking for the pixels");
    EXPECT(buffer != 0 && offset % 256 == 0);
    EXPECT(strstr(ashsplat_requirements(), "subgroupSizeControl") != NULL);
    share_scene(&stage);
    wanted->images_only = true;
    stage_reserve(&stage);
    host_begin(host);
    REFUSED_FRAME(&stage, "^AshsplatReservation.images_only: ");
    printf("%u of %u Gaussians visible, scale %.1f, offset %.1f\n", report->visible, report->gaussians,
           (double)mapping.scale, (double)mapping.offset);
    stage_close(&stage);
}

/* A host's own memory, which counts its pieces. */
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

static void free_memory(void *user, AshsplatMemory memory) {
    Counter *counter = user;
    EXPECT(memory.id >= 7 && memory.id < (uint64_t)counter->made + 7);
    counter->host->FreeMemory(counter->host->handles.device, memory.memory, NULL);
    --counter->live;
}

static bool refuse(void *user, const AshsplatMemoryRequest *request, AshsplatMemory *memory) {
    (void)user, (void)request, (void)memory;
    return false;
}

/* Makes the guest with the counting allocator, after allocators that lack a function or memory. */
static void count_memory(Stage *stage, Counter *counter, const char *scene) {
    static AshsplatAllocator allocator;
    allocator = ASHSPLAT_INIT(AshsplatAllocator);
    allocator.user = counter;
    allocator.allocate = allocate;
    allocator.free = free_memory;
    AshsplatAllocator half = allocator, exhausted = allocator;
    half.free = NULL;
    exhausted.allocate = refuse;
    AshsplatContext *none = NULL;
    const AshsplatForeignDevice *handles = &stage->host.handles;
    stage->host.handles.allocator = &half;
    EXPECT(ashsplat_context_from_foreign(handles, &none) == AshsplatStatus_Argument && none == NULL);
    stage->host.handles.allocator = &exhausted;
    check(ashsplat_context_from_foreign(handles, &none), "being a poor guest");
    EXPECT(ashsplat_scene_load(none, scene, &stage->scene) == AshsplatStatus_Vulkan && stage->scene == NULL);
    ashsplat_context_free(none);
    stage->host.handles.allocator = &allocator;
}

/* Memory of the host, settings, a frame in the corner of a larger picture, the sum of weights / z, discarded recordings,
 * invalid numbers of enumerations: memory SCENE.ply PICTURE.png SUMS.bin */
static void memory(char **arguments) {
    enum { WIDTH = 96, HEIGHT = 64, X = 20, Y = 8, WHOLE_WIDTH = 128, WHOLE_HEIGHT = 80 };
    static Stage stage;
    Host *host = &stage.host;
    host_open(host);
    Counter counter = {host, 0, 0};
    count_memory(&stage, &counter, arguments[0]);
    stage_load(&stage, arguments[0], WIDTH, HEIGHT);
    int of_scene = counter.live;
    EXPECT(of_scene > 0);

    uint32_t usage = USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM | USAGE_IMAGE_COPY_TO;
    HostTexture *color = host_texture(host, FORMAT_RGBA8_SRGB, usage, WHOLE_WIDTH, WHOLE_HEIGHT);
    HostBuffer *pixels = host_buffer(host, 4 * WHOLE_WIDTH * WHOLE_HEIGHT, USAGE_BUFFER_COPIES);
    HostBuffer *sums = host_buffer(host, 4 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    /* Its flags do not allow the other format in which kernels would see its texels. */
    AshsplatImage *none = NULL;
    AshsplatForeignImage fixed = color->description;
    fixed.flags = 0;
    REFUSED(ashsplat_image_adopt(stage.context, &fixed, AshsplatImageUse_Target, &none), "MUTABLE_FORMAT");
    EXPECT(none == NULL);
    check(ashsplat_renderer_new(stage.context, &stage.renderer), "building the renderer");
    AshsplatRenderer *renderer = stage.renderer;
    stage.wanted.blend_passes = 2;
    stage.wanted.inverse_depth = true;
    stage_reserve(&stage);

    AshsplatRenderSettings settings = ASHSPLAT_INIT(AshsplatRenderSettings);
    EXPECT(settings.scale_modifier == 1 && settings.sh_degree == 3 && !settings.inverse_depth);
    settings.scale_modifier = 0.5f;
    settings.sh_degree = 0;
    settings.antialias = true;
    settings.inverse_depth = true;
    AshsplatTarget to = ASHSPLAT_INIT(AshsplatTarget);
    stage.frame.settings = &settings;
    stage.frame.target = &to;
    to.to.image = stage_image(&stage, color, AshsplatImageUse_Target);
    to.background[1] = 0.5f;
    to.to.offset[0] = X;
    to.to.offset[1] = Y;

    void *commands = host_begin(host);
    REFUSED_WITH(to.behind, 3, stage_record(&stage), "target.behind: 3, there are 0 to 2");
    REFUSED_WITH(to.encoding, 2, stage_record(&stage), "target.encoding: 2, there are 0 to 1");
    /* Linear light, which an sRGB image encodes: on an opaque background the picture as trained. */
    to.encoding = AshsplatColorEncoding_LinearSrgb;
    REFUSED_WITH(to.exposure, 0, stage_record(&stage), "exposure");
    REFUSED_WITH(settings.shape, 0x7fffffff, stage_record(&stage), "");
    REFUSED_WITH(to.to.offset[0], WHOLE_WIDTH - WIDTH + 1, stage_record(&stage), "");

    /* The recording is discarded and made again. */
    bool finished = true;
    check(stage_record(&stage), "recording");
    REFUSED_FRAME(&stage, "");
    check(ashsplat_slot_finished(renderer, 0, &finished), "asking");
    EXPECT(!finished && ashsplat_slot_release(renderer, 0) == AshsplatStatus_Argument);
    require(host->EndCommandBuffer(commands), "vkEndCommandBuffer");
    check(ashsplat_slot_discard(renderer, 0), "throwing away");
    check(ashsplat_slot_report(renderer, 0, &stage.report), "asking for the report");
    EXPECT(!stage.report.finished);

    /* Outside the frame's rectangle, the picture stays black. */
    int before = counter.made;
    commands = host_begin(host);
    float black[4] = {0, 0, 0, 1};
    Range whole = {ASPECT_COLOR, 0, 1, 0, 1};
    host_transition(host, color, ASPECT_COLOR, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host->CmdClearColorImage(commands, color->raw, LAYOUT_COPY_TO, black, 1, &whole);
    AshsplatImageState cleared = {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE};
    to.to.from = cleared;
    check(stage_record(&stage), "recording again");
    EXPECT(counter.made == before);
    ashsplat_scene_free(stage.scene);
    stage.scene = NULL;
    EXPECT(counter.live >= of_scene);
    host_read(host, color, stage.release.color.layout, pixels);
    uint64_t buffer = 0, offset = 0;
    check(ashsplat_slot_inverse_depth(renderer, 0, &buffer, &offset), "asking for the sums");
    host_read_buffer(host, buffer, offset, 4 * WIDTH * HEIGHT, sums);
    stage_finish(&stage);
    check(ashsplat_slot_finished(renderer, 0, &finished), "asking");
    EXPECT(finished && !stage.report.overflow && stage.report.blend_passes_needed == 1);
    int with_scene = counter.live;
    check(ashsplat_slot_release(renderer, 0), "letting go");
    EXPECT(counter.live < with_scene);
    write_picture(arguments[1], WHOLE_WIDTH, WHOLE_HEIGHT, pixels->mapped);
    write_file(arguments[2], sums->mapped, 4 * WIDTH * HEIGHT);
    printf("%u of %u Gaussians visible, %d allocations\n", stage.report.visible, stage.report.gaussians, counter.made);
    stage_free(&stage);
    EXPECT(counter.live == 0);
    host_close(host);
}

/* A host's lock around its queue. */
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

/* Two eyes side by side in one recording: the same picture as of two recordings, with one sort. */
static void views(char **arguments) {
    enum { WIDTH = 96, HEIGHT = 64, BYTES = 4 * 2 * WIDTH * HEIGHT };
    static Stage stage;
    Host *host = &stage.host;
    host_open(host);
    Lock lock = {0, 0};
    host->handles.queue_user = &lock;
    host->handles.lock_queue = take;
    REFUSED(ashsplat_context_from_foreign(&host->handles, &stage.context), "unlock_queue: is NULL");
    EXPECT(stage.context == NULL);
    host->handles.unlock_queue = give;
    stage_load(&stage, arguments[0], WIDTH, HEIGHT);
    HostTexture *color = host_texture(host, FORMAT_RGBA8_SRGB, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM, 2 * WIDTH, HEIGHT);
    HostBuffer *pixels = host_buffer(host, BYTES, USAGE_BUFFER_COPIES);
    AshsplatImage *target = stage_image(&stage, color, AshsplatImageUse_Target);
    /* The device has only this family, which keeps the image. */
    int32_t layout = 0;
    REFUSED(ashsplat_image_of_family(target, 1000, &layout), "");
    check(ashsplat_image_of_family(target, host->handles.queue_family, &layout), "naming the owner");
    EXPECT(layout == 1);
    check(ashsplat_renderer_new(stage.context, &stage.renderer), "building the renderer");
    AshsplatRenderer *renderer = stage.renderer;
    stage.wanted.slots = 2;
    stage.wanted.images_only = true;
    stage_reserve(&stage);

    AshsplatCamera eyes[2] = {stage.camera, stage.camera};
    eyes[1].translation[0] -= 0.25f;
    AshsplatTarget to[2];
    AshsplatRecordedFrame frames[2];
    AshsplatRelease left[2];
    for (int i = 0; i < 2; ++i) {
        to[i] = ASHSPLAT_INIT(AshsplatTarget);
        to[i].to.image = target;
        to[i].to.offset[0] = (uint32_t)(i * WIDTH);
        to[i].behind = AshsplatBackground_Color;
        frames[i] = stage.frame;
        frames[i].camera = &eyes[i];
        frames[i].target = &to[i];
        left[i] = ASHSPLAT_INIT(AshsplatRelease);
    }

    /* Functions that submit take the lock. */
    static float rgb[3 * WIDTH * HEIGHT];
    const float black[3] = {0, 0, 0};
    check(ashsplat_render(renderer, stage.scene, &eyes[0], NULL, black, rgb), "rendering");
    EXPECT(lock.taken > 0 && lock.held == 0);

    /* The views one by one; the second draws over the first one's result. */
    static uint8_t expected[BYTES];
    void *commands = host_begin(host);
    int before = lock.taken;
    check(ashsplat_record_views(renderer, commands, 0, &frames[0], 1, &left[0]), "recording the left eye");
    to[1].to.from = left[0].color;
    check(ashsplat_record(renderer, commands, 1, &frames[1], &left[1]), "recording the right eye");
    EXPECT(lock.taken == before && lock.held == 0);
    host_read(host, color, left[1].color.layout, pixels);
    host_submit_and_wait(host);
    memcpy(expected, pixels->mapped, BYTES);
    memset(pixels->mapped, 0, BYTES);

    commands = host_begin(host);
    REFUSED(ashsplat_record_views(renderer, commands, 0, frames, 2, left), "frames: 2 of them, AshsplatReservation.views is 1");
    REFUSED(ashsplat_record_views(renderer, commands, 0, frames, 0, left), "frames: there are none");
    stage.wanted.views = 2;
    stage.wanted.shared_sort = 1;
    stage_reserve(&stage);
    REFUSED_WITH(frames[1].camera, NULL, ashsplat_record_views(renderer, commands, 0, frames, 2, left),
                 "frames[1].camera: the pointer is null");
    REFUSED_WITH(left[1].struct_size, 0, ashsplat_record_views(renderer, commands, 0, frames, 2, left),
                 "releases[1]: struct_size is 0");
    REFUSED_WITH(to[1].to.offset[0], WIDTH + 1, ashsplat_record_views(renderer, commands, 0, frames, 2, left),
                 "frames[1].target (image 'target'): 96 x 64 pixels at (97, 0)");
    check(ashsplat_record_views(renderer, commands, 0, frames, 2, left), "recording both eyes");
    EXPECT(left[0].color.layout == left[1].color.layout && left[1].struct_size == sizeof left[1]);
    host_read(host, color, left[1].color.layout, pixels);
    stage_finish(&stage);
    EXPECT(memcmp(expected, pixels->mapped, BYTES) == 0);
    int lit = 0, differ = 0;
    for (int i = 0; i < 2 * WIDTH * HEIGHT; ++i) {
        lit += expected[4 * i] > 32;
        differ += i % (2 * WIDTH) < WIDTH && expected[4 * i] != expected[4 * (i + WIDTH)];
    }
    EXPECT(!stage.report.overflow && stage.report.sorts == 1);
    printf("%u Gaussians visible, %d pixels lit, %d differ, %d locks\n", stage.report.visible, lit, differ, lock.taken);
    stage_close(&stage);
}

/* Structs of older headers lack the last fields of today's; the bytes behind them are other data. Structs of newer
 * headers have fields that the library does not know. */
typedef struct {
    uint32_t struct_size;
    float camera_from_world[9], translation[3], fx, fy, cx, cy;
    uint32_t width, height;
} OldCamera;
typedef struct { OldCamera camera; uint32_t behind; } OldCameraAndMore;
typedef struct { AshsplatCamera known; float unknown[2]; } NewCamera;

typedef struct {
    uint32_t struct_size;
    const AshsplatScene *scene;
    float world_from_object[9], translation[3], scale;
} OldPlaced;
typedef struct { AshsplatPlaced known; uint64_t unknown; } NewPlaced;

typedef struct { uint32_t struct_size; bool finished, overflow; uint32_t gaussians, visible; } OldReport;
typedef struct { OldReport report; uint32_t behind[8]; } OldReportAndMore;
typedef struct { AshsplatSlotReport known; uint32_t unknown[2]; } NewReport;

static void other_cameras(Stage *stage) {
    enum { WIDTH = 64, HEIGHT = 48, FLOATS = 3 * WIDTH * HEIGHT };
    const float eye[3] = {0, -1, -4}, up[3] = {0, -1, 0}, background[3] = {0, 0.5f, 0};
    static float rgb[FLOATS], again[FLOATS];
    AshsplatRenderer *renderer = stage->renderer;
    const AshsplatScene *scene = stage->scene;

    /* Structs of today's header. */
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    EXPECT(camera.struct_size == sizeof camera && camera.camera_from_world[4] == 1 && camera.camera_from_world[1] == 0);
    check(ashsplat_camera_look_at(eye, ORIGIN, up, 0.7f, WIDTH, HEIGHT, &camera), "a camera");
    EXPECT(camera.struct_size == sizeof camera && camera.width == WIDTH);
    check(ashsplat_render(renderer, scene, &camera, NULL, background, rgb), "rendering");

    /* Fields behind an older camera's end are neither read nor written. */
    OldCameraAndMore old;
    AshsplatCamera *as_today = (AshsplatCamera *)&old;
    memset(&old, 0xff, sizeof old);
    old.camera.struct_size = sizeof old.camera;
    check(ashsplat_camera_look_at(eye, ORIGIN, up, 0.7f, WIDTH, HEIGHT, as_today), "an older camera");
    EXPECT(old.behind == 0xffffffff && old.camera.struct_size == sizeof old.camera && old.camera.fx == camera.fx);
    check(ashsplat_render(renderer, scene, as_today, NULL, background, again), "rendering");
    EXPECT(memcmp(rgb, again, sizeof rgb) == 0);
    /* With today's size it would be no camera. */
    old.camera.struct_size = sizeof old;
    REFUSED(ashsplat_render(renderer, scene, as_today, NULL, background, again), "camera.projection: 4294967295, there are 0 to 8");

    /* A newer camera works as long as its new fields are 0. */
    NewCamera new = {camera, {0, 0}};
    new.known.struct_size = sizeof new;
    memset(again, 0, sizeof again);
    check(ashsplat_render(renderer, scene, &new.known, NULL, background, again), "rendering");
    EXPECT(memcmp(rgb, again, sizeof rgb) == 0);
    new.unknown[1] = 2;
    REFUSED(ashsplat_render(renderer, scene, &new.known, NULL, background, again),
            "camera: struct_size is 164, this version knows 156 bytes of AshsplatCamera");
    EXPECT(said("at byte 163"));

    /* These structs were never initialised. */
    camera.struct_size = 0;
    REFUSED(ashsplat_render(renderer, scene, &camera, NULL, background, again),
            "camera: struct_size is 0: begin with ASHSPLAT_INIT(AshsplatCamera)");
    REFUSED(ashsplat_camera_look_at(eye, ORIGIN, up, 0.7f, WIDTH, HEIGHT, &camera), "");
    /* A size of 72 would lack the height, and no header had such a camera. */
    const uint32_t senseless[] = {1, 4, 6, 8, 72, 83, 4100, 0xcccccccc};
    for (int i = 0; i < 8; ++i) {
        camera.struct_size = senseless[i];
        REFUSED(ashsplat_render(renderer, scene, &camera, NULL, background, again),
                "AshsplatCamera has 156: begin with ASHSPLAT_INIT(AshsplatCamera)");
    }
}

/* Structs smaller and larger than today's. */
static void structs(char **arguments) {
    static Stage stage;
    stage_open(&stage, arguments[0], 64, 48);
    Host *host = &stage.host;
    AshsplatRenderer *renderer = stage.renderer;
    other_cameras(&stage);

    /* Older and newer arrays are as wide as their first struct says. */
    uint32_t gaussians = stage.wanted.gaussians;
    stage.wanted.gaussians = 3 * gaussians;
    stage.wanted.scenes = 3;
    stage_reserve(&stage);
    stage.frame.scene_count = 3;
    OldPlaced narrow[3];
    NewPlaced wide[3];
    for (int i = 0; i < 3; ++i) {
        memset(&wide[i], 0, sizeof wide[i]);
        wide[i].known = place(stage.scene);
        wide[i].known.struct_size = sizeof wide[i];
        wide[i].known.translation[0] = (float)i - 1.0f;
        memset(&narrow[i], 0xff, sizeof narrow[i]);
        narrow[i].struct_size = sizeof narrow[i];
        narrow[i].scene = stage.scene;
        memcpy(narrow[i].world_from_object, wide[i].known.world_from_object, sizeof narrow[i].world_from_object);
        memcpy(narrow[i].translation, wide[i].known.translation, sizeof narrow[i].translation);
        narrow[i].scale = 1;
    }
    EXPECT(sizeof narrow[0] < sizeof(AshsplatPlaced) && sizeof wide[0] > sizeof(AshsplatPlaced));
    uint32_t visible[2] = {0, 0};
    for (int older = 0; older < 2; ++older) {
        stage.frame.scenes = older ? (const AshsplatPlaced *)narrow : &wide[0].known;
        check(ashsplat_record(renderer, host_begin(host), 0, &stage.frame, NULL), "recording");
        host_submit_and_wait(host);
        OldReportAndMore few;
        NewReport many = {ASHSPLAT_INIT(AshsplatSlotReport), {7, 7}};
        memset(&few, 0xff, sizeof few);
        few.report.struct_size = sizeof few.report;
        many.known.struct_size = sizeof many;
        check(ashsplat_slot_report(renderer, 0, (AshsplatSlotReport *)&few), "asking for an older report");
        check(ashsplat_slot_report(renderer, 0, &many.known), "asking for a newer report");
        EXPECT(few.report.finished && few.report.gaussians == 3 * gaussians && few.behind[0] == 0xffffffff);
        EXPECT(many.known.finished && many.known.visible == few.report.visible && many.known.instances_needed > 0);
        EXPECT(many.known.struct_size == sizeof many && many.unknown[0] == 7);
        visible[older] = few.report.visible;
    }
    EXPECT(visible[0] == visible[1] && visible[0] > 0);
    stage.frame.scenes = &wide[0].known;
    host_begin(host);
    REFUSED_WITH(wide[2].unknown, 1, stage_record(&stage), "scenes[2]: struct_size is 96, this version knows 88 bytes of AshsplatPlaced");
    REFUSED_WITH(wide[1].known.struct_size, sizeof(AshsplatPlaced), stage_record(&stage),
                 "scenes[1]: struct_size is 88, that of scenes[0] is 96");
    REFUSED_WITH(wide[1].known.struct_size, 0, stage_record(&stage),
                 "scenes[1]: struct_size is 0: begin with ASHSPLAT_INIT(AshsplatPlaced)");
    REFUSED_WITH(stage.release.struct_size, 0, stage_record(&stage), "release: struct_size is 0");
    REFUSED_WITH(stage.frame.camera, NULL, stage_record(&stage), "camera: the pointer is null");

    /* Orthographic cameras need a reservation. */
    stage.camera.projection = AshsplatProjection_Orthographic;
    stage.camera.fx = stage.camera.fy = 20;
    REFUSED_FRAME(&stage, "orthographic: not reserved");
    stage.wanted.orthographic = true;
    stage_reserve(&stage);
    check(stage_record(&stage), "recording parallel rays");
    stage_finish(&stage);
    EXPECT(stage.report.visible > 0);

    /* A rolling shutter needs a reservation; a camera that moves during the readout draws another picture. */
    stage.camera.projection = AshsplatProjection_Perspective;
    stage.camera.fx = stage.camera.fy = 150;
    REFUSED_WITH(stage.camera.readout, 5, stage_record(&stage), "camera.readout: 5, there are 0 to 4");
    stage.camera.readout = AshsplatReadout_Down;
    REFUSED_FRAME(&stage, "rolling_shutter: not reserved");
    stage.wanted.rolling_shutter = true;
    stage_reserve(&stage);
    uint32_t seen[2];
    for (int moves = 0; moves < 2; ++moves) {
        stage.camera.shutter_shift[0] = moves ? 4 : 0;
        host_begin(host);
        check(stage_record(&stage), "recording a rolling shutter");
        stage_finish(&stage);
        seen[moves] = stage.report.instances_needed;
    }
    EXPECT(seen[0] > 0 && seen[1] != seen[0]);
    REFUSED_WITH(stage.camera.shutter_turn[1], 4, stage_record(&stage), "beyond half a circle");

    /* Scenes with SH in halves need a reservation too. An update fills this one. */
    stage.camera.readout = AshsplatReadout_Global;
    const float mean[3] = {0, 0, 0}, quat[4] = {1, 0, 0, 0}, log_scales[3] = {-1, -1, -1}, logit = 2, sh[3] = {1, 1, 1};
    AshsplatGaussians one = ASHSPLAT_INIT(AshsplatGaussians);
    AshsplatScene *halves = NULL;
    REFUSED(ashsplat_scene_stored(stage.context, &one, 1, 3, &halves), "sh_storage: 3 is none of AshsplatShStorage");
    check(ashsplat_scene_stored(stage.context, &one, 1, AshsplatShStorage_Half, &halves), "an empty scene of halves");
    check(ashsplat_scene_set_count(halves, 1), "its number");
    one.count = 1;
    one.means = mean;
    one.quats = quat;
    one.log_scales = log_scales;
    one.opacity_logits = &logit;
    one.sh = sh;
    AshsplatUpdate update = ASHSPLAT_INIT(AshsplatUpdate);
    update.scene = halves;
    update.gaussians = &one;
    AshsplatPlaced placed = place(halves);
    stage.frame.scenes = &placed;
    stage.frame.scene_count = 1;
    stage.frame.updates = &update;
    stage.frame.update_count = 1;
    stage.wanted.staging_bytes = 4096;
    stage_reserve(&stage);
    REFUSED_FRAME(&stage, "half_sh: not reserved");
    stage.wanted.half_sh = true;
    stage_reserve(&stage);
    host_begin(host);
    check(stage_record(&stage), "recording halves");
    stage_finish(&stage);
    EXPECT(stage.report.visible == 1);
    ashsplat_scene_free(halves);
    printf("%u of %u Gaussians visible\n", visible[0], 3 * gaussians);
    stage_close(&stage);
}

int main(int count, char **arguments) {
    TRIAL(plain)
    TRIAL(memory)
    TRIAL(views)
    TRIAL(structs)
    return 1;
}
