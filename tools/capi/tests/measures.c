/* What a renderer has besides pictures, in C: measures SCENE.ply WEIGHTS.safetensors RESULTS.bin
 *
 * The 3D filter, settings of Mip-Splatting, gradients, an aligned camera, LPIPS. RESULTS.bin has them one after another, for the
 * test to compare with those of Rust.
 */
#include "host.h"

enum { WIDTH = 64, HEIGHT = 48, PIXELS = WIDTH * HEIGHT, COUNT = 500, COEFFICIENTS = 4 };

/* One more than there is: nothing is written there. */
static float means[3 * COUNT + 1], quats[4 * COUNT + 1], log_scales[3 * COUNT + 1], logits[COUNT + 1], sh[3 * COEFFICIENTS * COUNT + 1];
static float means2d[2 * COUNT + 1], sizes[COUNT + 1];
static float rgb[3 * PIXELS], other[3 * PIXELS], of_image[3 * PIXELS], of_depth[PIXELS];
static uint8_t photo[3 * PIXELS];

/* Refused, with these words in the message. */
static void refused(AshsplatStatus status, const char *words) {
    if (status != AshsplatStatus_Argument || !strstr(ashsplat_last_error(), words)) {
        fprintf(stderr, "'%s' is not in '%s'\n", words, ashsplat_last_error());
        exit(1);
    }
}

int main(int count, char **arguments) {
    EXPECT(count == 4);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    AshsplatScene *scene = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    const float at[3] = {0, 0, 0}, up[3] = {0, -1, 0}, background[3] = {0.1f, 0.2f, 0.3f};
    AshsplatCamera cameras[2] = {ASHSPLAT_INIT(AshsplatCamera), ASHSPLAT_INIT(AshsplatCamera)};
    for (int i = 0; i < 2; ++i) {
        const float eye[3] = {(float)i, -1, -4};
        check(ashsplat_camera_look_at(eye, at, up, 0.7f, WIDTH, HEIGHT, &cameras[i]), "a camera");
    }
    FILE *out = fopen(arguments[3], "wb");
    EXPECT(out != NULL);

    /* Settings of Mip-Splatting. Without sizes the filter changes nothing. */
    AshsplatRenderSettings settings = ASHSPLAT_INIT(AshsplatRenderSettings);
    settings.antialias = true;
    settings.antialias_detached = 1;
    settings.kernel_size = 0.1f;
    check(ashsplat_render(renderer, scene, &cameras[0], &settings, background, rgb), "rendering");
    settings.filter_3d = 1;
    check(ashsplat_render(renderer, scene, &cameras[0], &settings, background, other), "rendering");
    EXPECT(memcmp(rgb, other, sizeof rgb) == 0);
    check(ashsplat_compute_filters(renderer, scene, cameras, 2), "the filter");
    check(ashsplat_filters(renderer, scene, sizes), "its sizes");
    check(ashsplat_render(renderer, scene, &cameras[0], &settings, background, other), "rendering");
    EXPECT(memcmp(rgb, other, sizeof rgb) != 0);
    EXPECT(sizes[COUNT - 1] > 0 && sizes[COUNT] == 0);
    EXPECT(fwrite(sizes, 4, COUNT, out) == COUNT && fwrite(other, sizeof other, 1, out) == 1);
    settings.kernel_size = -1;
    refused(ashsplat_render(renderer, scene, &cameras[0], &settings, background, rgb), "settings.kernel_size: is -1");
    settings.kernel_size = 0.1f;
    refused(ashsplat_compute_filters(renderer, scene, cameras, 0), "cameras");
    cameras[1].projection = AshsplatProjection_Orthographic;
    refused(ashsplat_compute_filters(renderer, scene, cameras, 2), "cameras[1].projection: is orthographic");
    refused(ashsplat_filters(renderer, scene, NULL), "sizes: ");

    /* The same filter in a recorded frame: it is reserved. */
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.width = WIDTH;
    wanted.height = HEIGHT;
    check(ashsplat_scene_size(scene, &wanted.gaussians, &wanted.sh_degree), "asking for the scene's size");
    EXPECT(wanted.gaussians == COUNT && wanted.sh_degree == 1);
    check(ashsplat_reserve(renderer, &wanted), "reserving");
    AshsplatPlaced placed = ASHSPLAT_INIT(AshsplatPlaced);
    placed.scene = scene;
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &cameras[0];
    frame.scenes = &placed;
    frame.scene_count = 1;
    frame.settings = &settings;
    HostBuffer pixels = host_buffer(&host, 16 * PIXELS, USAGE_BUFFER_COPIES);
    void *commands = host_begin(&host);
    refused(ashsplat_record(renderer, commands, 0, &frame, NULL), "AshsplatReservation.filter_3d");
    wanted.filter_3d = 1;
    check(ashsplat_reserve(renderer, &wanted), "reserving the filter");
    check(ashsplat_record(renderer, commands, 0, &frame, NULL), "recording");
    uint64_t buffer = 0, offset = 0;
    check(ashsplat_slot_pixels(renderer, 0, &buffer, &offset), "asking for the pixels");
    MemoryBarrier written = {46, NULL, ACCESS_MEMORY_WRITE, ACCESS_TRANSFER_READ};
    host.CmdPipelineBarrier(commands, STAGE_ALL, STAGE_TRANSFER, 0, 1, &written, 0, NULL, 0, NULL);
    BufferCopy copy = {offset, 0, 16 * PIXELS};
    host.CmdCopyBuffer(commands, buffer, pixels.raw, 1, &copy);
    MemoryBarrier barrier = {46, NULL, ACCESS_TRANSFER_WRITE, ACCESS_HOST_READ};
    host.CmdPipelineBarrier(commands, STAGE_TRANSFER, STAGE_HOST, 0, 1, &barrier, 0, NULL, 0, NULL);
    host_submit_and_wait(&host);
    const float *texels = pixels.mapped;
    for (int i = 0; i < PIXELS; ++i) {
        for (int channel = 0; channel < 3; ++channel) {
            const float value = texels[4 * i + channel] + texels[4 * i + 3] * background[channel];
            const float error = value - other[3 * i + channel];
            EXPECT(error < 1e-5f && error > -1e-5f);
        }
    }

    /* Gradients of a function of the picture and of the depths; of some alone the same bits. */
    for (int i = 0; i < 3 * PIXELS; ++i) of_image[i] = (float)(i * 7 % 13 - 6) / 8.0f;
    for (int i = 0; i < PIXELS; ++i) of_depth[i] = (float)(i * 5 % 11 - 5) / 16.0f;
    settings.inverse_depth = true;
    float pose[7] = {0}, again[3 * COUNT];
    AshsplatGradients gradients = ASHSPLAT_INIT(AshsplatGradients);
    gradients.means = means;
    gradients.quats = quats;
    gradients.log_scales = log_scales;
    gradients.opacity_logits = logits;
    gradients.sh = sh;
    gradients.mean2d_px = means2d;
    gradients.pose = pose;
    check(ashsplat_gradients(renderer, scene, &cameras[0], &settings, background, of_image, of_depth, &gradients), "gradients");
    AshsplatGradients some = ASHSPLAT_INIT(AshsplatGradients);
    some.means = again;
    check(ashsplat_gradients(renderer, scene, &cameras[0], &settings, background, of_image, of_depth, &some), "gradients of means");
    EXPECT(memcmp(means, again, sizeof again) == 0);
    const struct { const float *from; size_t floats; } all[] = {{means, 3 * COUNT}, {quats, 4 * COUNT}, {log_scales, 3 * COUNT}, {logits, COUNT},
                                                                {sh, 3 * COEFFICIENTS * COUNT}, {means2d, 2 * COUNT}, {pose, 6}};
    for (size_t i = 0; i < sizeof all / sizeof all[0]; ++i) {
        EXPECT(all[i].from[all[i].floats] == 0 && fwrite(all[i].from, 4, all[i].floats, out) == all[i].floats);
    }
    refused(ashsplat_gradients(renderer, scene, &cameras[0], &settings, background, NULL, NULL, &gradients), "image_gradient: ");
    refused(ashsplat_gradients(renderer, scene, &cameras[0], &settings, background, of_image, NULL, NULL), "gradients: ");
    refused(ashsplat_gradients(renderer, scene, &cameras[0], NULL, background, of_image, of_depth, &gradients), "inverse_depth_gradient: needs");
    settings.scale_modifier = 2;
    refused(ashsplat_gradients(renderer, scene, &cameras[0], &settings, background, of_image, NULL, &gradients), "scale modifier");
    settings.scale_modifier = 1;
    AshsplatCamera parallel = cameras[0];
    parallel.projection = AshsplatProjection_Orthographic;
    refused(ashsplat_gradients(renderer, scene, &parallel, &settings, background, of_image, NULL, &gradients), "orthographic");

    /* A camera that was moved fits the photograph again. */
    AshsplatAlignment alignment = ASHSPLAT_INIT(AshsplatAlignment);
    EXPECT(alignment.steps == 100 && alignment.lr == 2e-3 && alignment.lambda_dssim == 0.2);
    check(ashsplat_render(renderer, scene, &cameras[0], NULL, background, rgb), "rendering");
    for (int i = 0; i < 3 * PIXELS; ++i) photo[i] = (uint8_t)(255.0f * (rgb[i] > 1 ? 1 : rgb[i]) + 0.5f);
    EXPECT(fwrite(photo, sizeof photo, 1, out) == 1);
    AshsplatCamera moved = cameras[0], aligned = ASHSPLAT_INIT(AshsplatCamera);
    moved.translation[0] += 0.03f;
    alignment.steps = 40;
    check(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, &aligned), "aligning");
    EXPECT(fwrite(aligned.camera_from_world, 4, 9, out) == 9 && fwrite(aligned.translation, 4, 3, out) == 3);
    check(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, &moved), "aligning in place");
    EXPECT(memcmp(&moved, &aligned, sizeof moved) == 0);
    refused(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, NULL), "aligned: ");
    alignment.lambda_dssim = 2;
    refused(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, &aligned), "alignment: ");
    refused(ashsplat_align(renderer, scene, &moved, NULL, background, NULL, NULL, NULL, &aligned), "rgb: ");

    /* LPIPS. */
    AshsplatLpips *lpips = NULL;
    const char *name = NULL;
    double distance = -1, none = -1;
    EXPECT(ashsplat_lpips_new(context, arguments[1], &lpips) == AshsplatStatus_File && lpips == NULL);
    check(ashsplat_lpips_new(context, arguments[2], &lpips), "a network");
    check(ashsplat_lpips_name(lpips, &name), "its name");
    EXPECT(strcmp(name, "lpips_alex") == 0);
    check(ashsplat_lpips_distance(lpips, rgb, rgb, WIDTH, HEIGHT, &none), "a distance");
    check(ashsplat_lpips_distance(lpips, rgb, other, WIDTH, HEIGHT, &distance), "a distance");
    EXPECT(none == 0 && distance > 0);
    EXPECT(fwrite(&distance, sizeof distance, 1, out) == 1);
    refused(ashsplat_lpips_distance(lpips, rgb, other, 4, 4, &distance), "width, height: is 4x4 pixels, AlexNet needs");
    refused(ashsplat_lpips_distance(lpips, rgb, other, UINT32_MAX, UINT32_MAX, &distance), "width, height: ");
    refused(ashsplat_lpips_distance(lpips, rgb, other, WIDTH, HEIGHT, NULL), "distance: ");
    EXPECT(fclose(out) == 0);
    printf("%s %g\n", name, distance);

    ashsplat_lpips_free(lpips);
    ashsplat_renderer_free(renderer);
    ashsplat_scene_free(scene);
    ashsplat_context_free(context);
    host_free_buffer(&host, &pixels);
    host_close(&host);
    return 0;
}
