/* A host in C with a command buffer of its own: record SCENE.ply */
#include "host.h"

int main(int count, char **arguments) {
    EXPECT(count == 2);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL, *none = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");

    AshsplatForeignDevice nobody = host.handles;
    nobody.device = NULL;
    EXPECT(ashsplat_context_from_foreign(&nobody, &none) == AshsplatStatus_Argument && none == NULL);
    static uint64_t nothing[64];
    nobody = host.handles;
    nobody.vulkan13_features = nothing;
    EXPECT(ashsplat_context_from_foreign(&nobody, &none) == AshsplatStatus_Argument && none == NULL);
    EXPECT(strstr(ashsplat_last_error(), "vulkan13_features: sType is 0, it must be 53") == ashsplat_last_error());
    nothing[0] = FEATURES_13;
    EXPECT(ashsplat_context_from_foreign(&nobody, &none) == AshsplatStatus_MissingFeature);

    /* What a host merges into its own features is all that is asked for. */
    static uint64_t merged[2][64];
    EXPECT(ashsplat_merge_features(NULL, merged[1]) == AshsplatStatus_Argument);
    EXPECT(ashsplat_merge_features(merged[0], NULL) == AshsplatStatus_Argument);
    merged[0][0] = FEATURES_13;
    EXPECT(ashsplat_merge_features(merged[0], merged[1]) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "vulkan12: sType is 53, it must be 51") == ashsplat_last_error());
    merged[0][0] = FEATURES_12;
    merged[1][0] = FEATURES_13;
    check(ashsplat_merge_features(merged[0], merged[1]), "merging features");
    AshsplatForeignDevice merging = host.handles;
    merging.vulkan12_features = merged[0];
    merging.vulkan13_features = merged[1];
    check(ashsplat_context_from_foreign(&merging, &none), "being a guest with merged features");
    ashsplat_context_free(none);

    AshsplatScene *scene = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.width = 160;
    wanted.height = 120;
    check(ashsplat_scene_size(scene, &wanted.gaussians, &wanted.sh_degree), "asking for the scene's size");
    /* Kernels may be built ahead, by any thread. */
    AshsplatKernels *kernels = NULL;
    uint32_t kernel_count = 0;
    check(ashsplat_kernels_new(context, &wanted, &kernels, &kernel_count), "listing the kernels");
    EXPECT(kernel_count > 20);
    for (uint32_t kernel = 0; kernel < kernel_count; ++kernel) {
        check(ashsplat_kernels_build(kernels, kernel), "building a kernel");
    }
    EXPECT(ashsplat_kernels_build(kernels, kernel_count) == AshsplatStatus_Argument);
    ashsplat_kernels_free(kernels);
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    EXPECT(ashsplat_grow(renderer, &wanted) == AshsplatStatus_Argument);
    /* All frames in one buffer of the host's, behind something else of the host's. */
    uint64_t bytes = 0;
    wanted.instances = 4;
    check(ashsplat_reservation_bytes(renderer, &wanted, &bytes), "asking for the size");
    HostBuffer frames = host_buffer(&host, 256 + bytes, 1 | 2 | 16 | 32 | 256);
    AshsplatHostBuffer block = {frames.raw, 256, bytes - 256};
    EXPECT(ashsplat_reserve_in(renderer, &wanted, &block, false) == AshsplatStatus_TooLarge);
    block.bytes = bytes;
    check(ashsplat_reserve_in(renderer, &wanted, &block, false), "reserving in a block");

    void *commands = host_begin(&host);
    AshsplatPlaced placed = ASHSPLAT_INIT(AshsplatPlaced);
    placed.scene = scene;
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &camera;
    AshsplatDepthMapping mapping;
    frame.scenes = &placed;
    frame.scene_count = 1;
    /* A host's matrices, column by column: it looks along -z of its view space, depth reversed, no far plane. */
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, -2.6667f, 0, 0, 0, 0, 0, -1, 0, 0, 0.1f, 0};
    check(ashsplat_camera_from_matrices(view, projection, false, 160, 120, &camera, &mapping),
          "understanding the matrices");
    EXPECT(ashsplat_record(renderer, NULL, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "commands: ") == ashsplat_last_error());
    EXPECT(ashsplat_record(renderer, commands, 7, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "slot: 7: 1 are reserved; call ashsplat_reserve") == ashsplat_last_error());
    EXPECT(ashsplat_record(NULL, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(ashsplat_record(renderer, commands, 0, NULL, NULL) == AshsplatStatus_Argument);
    placed.scale = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[0]: a scale of 0 is not possible") == ashsplat_last_error());
    placed.scale = 1;
    AshsplatRenderSettings settings = ASHSPLAT_INIT(AshsplatRenderSettings);
    settings.shape = 9;
    frame.settings = &settings;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "settings.shape: 9, there are 0 to 2") == ashsplat_last_error());
    frame.settings = NULL;
    AshsplatCamera mirrored;
    EXPECT(ashsplat_camera_from_matrices(view, projection, true, 160, 120, &mirrored, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "check clip_y_up;") != NULL);
    AshsplatPlaced twice[2] = {placed, placed};
    frame.scenes = twice;
    frame.scene_count = 2;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes: 2 of them, AshsplatReservation.scenes is 1") == ashsplat_last_error());
    frame.scenes = &placed;
    frame.scene_count = 1;
    AshsplatRelease release = ASHSPLAT_INIT(AshsplatRelease);
    check(ashsplat_record(renderer, commands, 0, &frame, &release), "recording");
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, &release) == AshsplatStatus_Argument);
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    check(ashsplat_slot_report(renderer, 0, &report), "asking too early");
    EXPECT(!report.finished && release.stages != 0);
    /* More room, while the frame is in flight. */
    wanted.instances = 0;
    check(ashsplat_grow(renderer, &wanted), "growing");
    host_submit_and_wait(&host);
    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(report.finished && report.overflow && report.instance_capacity == 4 && report.blend_passes == 1);
    EXPECT(report.entries_per_pass >= report.longest_tile);
    AshsplatReservation grown = ASHSPLAT_INIT(AshsplatReservation);
    check(ashsplat_reservation_grown(&wanted, &report, &grown), "asking for room");
    EXPECT(grown.instances > report.instances_needed && grown.blend_passes == 0 && grown.width == wanted.width);
    check(ashsplat_reservation_grown(&grown, &report, &grown), "asking again");
    EXPECT(grown.instances < 2 * report.instances_needed);
    commands = host_begin(&host);
    check(ashsplat_record(renderer, commands, 0, &frame, &release), "recording with more room");
    host_submit_and_wait(&host);
    host_free_buffer(&host, &frames);

    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(report.finished && !report.overflow);
    uint64_t buffer = 0, offset = 1;
    check(ashsplat_slot_pixels(renderer, 0, &buffer, &offset), "asking for the pixels");
    EXPECT(buffer != 0 && offset % 256 == 0);
    EXPECT(strstr(ashsplat_requirements(), "subgroupSizeControl") != NULL);
    /* A second guest on the device shows the same scene. */
    AshsplatContext *other = NULL;
    AshsplatScene *shared = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &other), "being a guest twice");
    check(ashsplat_scene_in_context(scene, other, &shared), "sharing the scene");
    uint32_t gaussians = 0, degree = 0;
    check(ashsplat_scene_size(shared, &gaussians, &degree), "asking for its size");
    EXPECT(gaussians == wanted.gaussians && degree == wanted.sh_degree);
    placed.scene = shared;
    commands = host_begin(&host);
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[0].scene: it belongs to another context") == ashsplat_last_error());
    placed.scene = scene;
    require(host.EndCommandBuffer(commands), "vkEndCommandBuffer");
    ashsplat_scene_free(shared);
    ashsplat_context_free(other);
    wanted.images_only = true;
    check(ashsplat_reserve(renderer, &wanted), "reserving without pixels");
    commands = host_begin(&host);
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "AshsplatReservation.images_only: ") == ashsplat_last_error());
    printf("%u of %u Gaussians visible, scale %.1f, offset %.1f\n", report.visible, report.gaussians,
           (double)mapping.scale, (double)mapping.offset);
    ashsplat_renderer_free(renderer);
    ashsplat_scene_free(scene);
    ashsplat_context_free(context);
    host_close(&host);
    return 0;
}
