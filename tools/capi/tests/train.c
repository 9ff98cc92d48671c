/* Training, and a renderer's gradients and measures: train TRIAL FILE... */
#include "host.h"

enum { WIDTH = 48, HEIGHT = 40, VIEWS = 3, COUNT = 200, STEPS = 30 };

static float means[COUNT][3], quats[COUNT][4], log_scales[COUNT][3], opacity_logits[COUNT], sh[COUNT][3];
static uint8_t photos[VIEWS][3 * WIDTH * HEIGHT];

/* A trainer that starts with grey points. */
static AshsplatStatus of_points(const AshsplatContext *context, const AshsplatTrainView *views, const char *settings, AshsplatTrainer **trainer) {
    static uint8_t colors[3 * COUNT];
    memset(colors, 150, sizeof colors);
    return ashsplat_trainer_new_from_points(context, views, VIEWS, means[0], colors, COUNT, 0, settings, trainer);
}

/* Trains exposure, lens, poses and depths from points by another strategy; stops and resumes. */
static void learns(const AshsplatContext *context, const AshsplatTrainView *plain, const char *path) {
    static uint8_t mask[WIDTH * HEIGHT];
    static float exposures[VIEWS][3][4], again[VIEWS][3][4], effects[VIEWS][3][4];
    const float depth_points[2][3] = {{10, 12, 0.25f}, {30.5f, 20, 0.2f}};
    char checkpoint[4096];
    snprintf(checkpoint, sizeof checkpoint, "%s.safetensors", path);
    AshsplatTrainView views[VIEWS];
    memcpy(views, plain, sizeof views);
    memset(mask, 1, sizeof mask);
    memset(mask, 0, WIDTH);
    views[0].mask = mask;
    views[1].depth_points = depth_points[0];
    views[1].depth_point_count = 2;
    views[2].camera_id = 1;
    const char *settings = "{\"few_photos\": true, \"strategy\": \"budget\", \"iterations\": 20, \"sh_degree\": 1, \"exposure\": true,"
                           " \"lens_effects\": true, \"pose_opt\": true, \"pose_lr\": 1e-3, \"depth_points\": 0.1}";
    AshsplatTrainer *whole = NULL, *first = NULL, *second = NULL, *none = NULL;
    AshsplatStep step = ASHSPLAT_INIT(AshsplatStep), last = ASHSPLAT_INIT(AshsplatStep);
    check(of_points(context, views, settings, &whole), "a trainer");
    check(of_points(context, views, settings, &first), "a trainer");
    for (int i = 0; i < 12; ++i) {
        check(ashsplat_trainer_step(whole, &last), "a step");
        if (i < 7) check(ashsplat_trainer_step(first, &step), "a step");
    }
    check(ashsplat_trainer_checkpoint(first, checkpoint), "a checkpoint");
    ashsplat_trainer_free(first);
    check(ashsplat_trainer_resume(context, views, VIEWS, checkpoint, 0, settings, &second), "going on");
    for (int i = 7; i < 12; ++i) check(ashsplat_trainer_step(second, &step), "a step");
    EXPECT(step.iteration == 12 && memcmp(&step.loss, &last.loss, sizeof step.loss) == 0);
    check(ashsplat_trainer_exposures(whole, exposures[0][0], VIEWS), "exposures");
    check(ashsplat_trainer_exposures(second, again[0][0], VIEWS), "exposures");
    EXPECT(memcmp(exposures, again, sizeof again) == 0 && exposures[0][0][3] != 0.0f);
    check(ashsplat_trainer_lens_effects(whole, effects[0][0], VIEWS), "lens effects");
    EXPECT(memcmp(effects[0], effects[1], sizeof effects[0]) == 0 && memcmp(effects[0], effects[2], sizeof effects[0]) != 0);
    AshsplatCamera moved[VIEWS];
    for (int v = 0; v < VIEWS; ++v) moved[v] = ASHSPLAT_INIT(AshsplatCamera);
    check(ashsplat_trainer_cameras(whole, moved, VIEWS), "cameras");
    EXPECT(moved[0].width == WIDTH && memcmp(moved[0].translation, views[0].camera->translation, sizeof moved[0].translation) != 0);
    /* Arrays that do not fit are refused by name. */
    REFUSED(ashsplat_trainer_exposures(whole, exposures[0][0], 2), "count: is 2, there are 3 views");
    REFUSED(ashsplat_trainer_cameras(whole, NULL, VIEWS), "cameras: ");
    REFUSED(ashsplat_trainer_resume(context, views, 2, checkpoint, 0, settings, &none), "views");
    REFUSED(ashsplat_trainer_new(context, views, VIEWS, NULL, 0, "{}", &none), "initial: ");
    const char *wrong[][2] = {{"[]", "is no object"}, {"{\"preset\": \"slow\"}", "preset: unknown variant `slow`"}, {"{\"preset\": 3}", "preset: invalid type"},
                              {"{\"few_photos\": 1}", "few_photos: invalid type"}, {"{\"preset\": \"fast\", \"strategy\": \"mcmc\"}", "strategy"}};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; ++i) {
        REFUSED(of_points(context, views, wrong[i][0], &none), wrong[i][1]);
    }
    ashsplat_trainer_free(second);
    /* The file has a filter and a mark; no exposure is learned. */
    const char *filtered = "{\"preset\": \"fast\", \"few_photos\": true, \"iterations\": 20, \"filter_3d\": true, \"antialiasing\": true}";
    check(of_points(context, plain, filtered, &second), "a trainer");
    check(ashsplat_trainer_step(second, &step), "a step");
    REFUSED(ashsplat_trainer_exposures(second, exposures[0][0], VIEWS), "exposure: is not set");
    const char *endings[] = {"filtered.ply", "filtered.spz"};
    for (int i = 0; i < 2; ++i) {
        snprintf(checkpoint, sizeof checkpoint, "%s.%s", path, endings[i]);
        check(ashsplat_trainer_save(second, checkpoint), "saving");
        EXPECT(!*ashsplat_last_loss());
        AshsplatScene *scene = NULL;
        bool antialiased = false;
        const char *warnings = NULL;
        check(ashsplat_scene_load(context, checkpoint, &scene), "loading");
        check(ashsplat_scene_notes(scene, &antialiased, &warnings), "what the file says");
        EXPECT(antialiased && warnings && !*warnings);
        ashsplat_scene_free(scene);
    }
    snprintf(checkpoint, sizeof checkpoint, "%s.filtered.splat", path);
    check(ashsplat_trainer_save(second, checkpoint), "saving");
    EXPECT(strstr(ashsplat_last_loss(), "cannot say that the Gaussians want antialiasing"));
    ashsplat_trainer_free(second);
    ashsplat_trainer_free(whole);
}

/* Losses of a training by 3DGS-MCMC on maps of inverse depth, with and without them. */
static void learns_of_depths(const AshsplatContext *context, const AshsplatTrainView *plain) {
    static float map[WIDTH * HEIGHT];
    const float point[3] = {10, 12, 0.25f};
    for (int k = 0; k < WIDTH * HEIGHT; ++k) map[k] = 0.2f + (float)(k % 17) / 100;
    AshsplatTrainView views[VIEWS];
    memcpy(views, plain, sizeof views);
    for (int v = 0; v < VIEWS; ++v) views[v].inverse_depth = map;
    const char *settings = "{\"strategy\": \"mcmc\", \"cap_max\": 300, \"iterations\": 20, \"densify_from_iter\": 2,"
                           " \"densification_interval\": 4}";
    AshsplatTrainer *none = NULL;
    float losses[2];
    for (int with = 0; with < 2; ++with) {
        const AshsplatTrainView *used = with ? views : plain;
        AshsplatTrainer *trainer = NULL;
        AshsplatStep step = ASHSPLAT_INIT(AshsplatStep);
        check(of_points(context, used, settings, &trainer), "a trainer");
        check(ashsplat_trainer_step(trainer, &step), "a step");
        losses[with] = step.loss;
        for (int i = 1; i < 12; ++i) check(ashsplat_trainer_step(trainer, &step), "a step");
        EXPECT(step.gaussians > COUNT && step.gaussians <= 300);
        ashsplat_trainer_free(trainer);
    }
    EXPECT(losses[1] > losses[0]);
    const char *few = "{\"strategy\": \"mcmc\", \"cap_max\": 7}";
    REFUSED(of_points(context, plain, few, &none), "cap_max: 7 is less");
    views[0].depth_points = point;
    views[0].depth_point_count = 1;
    const char *both = "{\"depth_points\": 0.1}";
    REFUSED(of_points(context, views, both, &none), "depth_points: ");
    EXPECT(none == NULL);
}

/* Two trainers of the same settings, one that submits and one that is recorded, agree to the bit: steps RESULT.ply */
static void steps(char **arguments) {
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    AshsplatTrainView views[VIEWS];
    AshsplatCamera cameras[VIEWS];
    for (int v = 0; v < VIEWS; ++v) {
        cameras[v] = look_at((float)v - 1.0f, -1.0f, -4.0f, ORIGIN, 0.8f, WIDTH, HEIGHT);
        for (int k = 0; k < 3 * WIDTH * HEIGHT; ++k) {
            photos[v][k] = (uint8_t)(k * (v + 2) / 5);
        }
        views[v] = ASHSPLAT_INIT(AshsplatTrainView);
        views[v].camera = &cameras[v];
        views[v].rgb = photos[v];
    }
    uint32_t random = 1;
    for (int i = 0; i < COUNT; ++i) {
        for (int k = 0; k < 3; ++k) {
            random = random * 1664525u + 1013904223u;
            means[i][k] = (float)(random >> 8) / 8388608.0f - 1.0f;
            log_scales[i][k] = -2.5f;
            sh[i][k] = means[i][k];
        }
        quats[i][0] = 1;
    }
    AshsplatGaussians start = ASHSPLAT_INIT(AshsplatGaussians);
    start.count = COUNT;
    start.means = means[0];
    start.quats = quats[0];
    start.log_scales = log_scales[0];
    start.opacity_logits = opacity_logits;
    start.sh = sh[0];
    const char *settings = "{\"iterations\": 100, \"sh_degree\": 1, \"sh_degree_interval\": 10, \"densify_from_iter\": 5,"
                           " \"densification_interval\": 8, \"densify_grad_threshold\": 1e-5}";
    AshsplatTrainer *own = NULL, *recorded = NULL, *none = NULL;
    REFUSED(ashsplat_trainer_new(context, views, VIEWS, &start, 0, "{\"iterations\": -1}", &none), "");
    REFUSED(ashsplat_trainer_new(context, NULL, VIEWS, &start, 0, settings, &none), "");
    REFUSED(ashsplat_trainer_new(context, views, 0, &start, 0, settings, &none), "");
    EXPECT(none == NULL);
    check(ashsplat_trainer_new(context, views, VIEWS, &start, 0, settings, &own), "a trainer");
    check(ashsplat_trainer_new(context, views, VIEWS, &start, 0, settings, &recorded), "a trainer");

    REFUSED(ashsplat_trainer_record(recorded, NULL, 0, NULL), "commands: ");
    REFUSED(ashsplat_trainer_record(recorded, host_begin(&host), 0, NULL), "trainer: its training steps are not reserved: call ashsplat_trainer_reserve");
    require(host.EndCommandBuffer(host.commands), "vkEndCommandBuffer");
    /* The capacity is too small at first: the first step changes nothing, and is recorded again. */
    check(ashsplat_trainer_reserve(recorded, 1, 10, 0), "reserving");
    /* A discarded step is recorded again. */
    AshsplatStep thrown = ASHSPLAT_INIT(AshsplatStep);
    check(ashsplat_trainer_record(recorded, host_begin(&host), 0, NULL), "recording a step");
    require(host.EndCommandBuffer(host.commands), "vkEndCommandBuffer");
    check(ashsplat_trainer_discard(recorded, 0), "throwing it away");
    check(ashsplat_trainer_outcome(recorded, 0, &thrown), "asking for the outcome");
    EXPECT(!thrown.finished && ashsplat_trainer_discard(recorded, 7) == AshsplatStatus_Argument);
    uint32_t densified = 0, overflowed = 0, iterations = 0;
    while (iterations < STEPS) {
        bool is_due = false;
        check(ashsplat_trainer_maintenance_is_due(recorded, &is_due), "asking for maintenance");
        AshsplatMaintenance done = ASHSPLAT_INIT(AshsplatMaintenance);
        if (is_due) {
            check(ashsplat_trainer_maintain(recorded, &done), "maintaining");
            densified += done.densified;
        }
        AshsplatRelease release = ASHSPLAT_INIT(AshsplatRelease);
        AshsplatStep step = ASHSPLAT_INIT(AshsplatStep), wanted = ASHSPLAT_INIT(AshsplatStep);
        check(ashsplat_trainer_record(recorded, host_begin(&host), 0, &release), "recording a step");
        REFUSED(ashsplat_trainer_record(recorded, host.commands, 0, &release), "slot: its last recording is still in flight");
        EXPECT(ashsplat_trainer_save(recorded, arguments[0]) == AshsplatStatus_Argument);
        check(ashsplat_trainer_outcome(recorded, 0, &step), "asking too early");
        EXPECT(!step.finished && release.stages != 0);
        host_submit_and_wait(&host);
        check(ashsplat_trainer_outcome(recorded, 0, &step), "asking for the outcome");
        EXPECT(step.finished && step.iteration == iterations + 1);
        if (step.overflow) {
            ++overflowed;
            continue;
        }
        check(ashsplat_trainer_step(own, &wanted), "a step");
        EXPECT(step.iteration == wanted.iteration && step.view == wanted.view && step.visible == wanted.visible);
        EXPECT(step.gaussians == wanted.gaussians && memcmp(&step.loss, &wanted.loss, sizeof step.loss) == 0);
        ++iterations;
    }
    EXPECT(densified >= 2 && overflowed >= 1);
    learns(context, views, arguments[0]);
    learns_of_depths(context, views);
    AshsplatScene *scene = NULL;
    uint32_t gaussians = 0;
    check(ashsplat_trainer_scene(recorded, &scene), "the trained scene");
    check(ashsplat_scene_size(scene, &gaussians, NULL), "its size");
    check(ashsplat_trainer_save(recorded, arguments[0]), "saving");
    printf("%u iterations, %u densifications, %u without room, %u Gaussians\n", iterations, densified, overflowed, gaussians);
    ashsplat_scene_free(scene);
    ashsplat_trainer_free(own);
    ashsplat_trainer_free(recorded);
    ashsplat_context_free(context);
    host_close(&host);
}

/* The 3D filter, settings of Mip-Splatting, gradients, an aligned camera, LPIPS, and their results one after another in a file:
 * measures SCENE.ply WEIGHTS.safetensors RESULTS.bin */
static void measures(char **arguments) {
    enum { W = 64, H = 48, PIXELS = W * H, N = 500, SH_FLOATS = 3 * 4 * N };
    /* One element more than needed; nothing may be written there. */
    static float by_means[3 * N + 1], by_quats[4 * N + 1], by_scales[3 * N + 1], by_logits[N + 1], by_sh[SH_FLOATS + 1];
    static float by_means2d[2 * N + 1], sizes[N + 1];
    static float rgb[3 * PIXELS], other[3 * PIXELS], of_image[3 * PIXELS], of_depth[PIXELS];
    static uint8_t photo[3 * PIXELS];
    static Stage stage;
    stage_open(&stage, arguments[0], W, H);
    AshsplatRenderer *renderer = stage.renderer;
    AshsplatScene *scene = stage.scene;
    const float background[3] = {0.1f, 0.2f, 0.3f};
    AshsplatCamera camera = stage.camera, cameras[2] = {camera, look_at(1, -1, -4, ORIGIN, 0.7f, W, H)};
    FILE *out = fopen(arguments[2], "wb");
    EXPECT(out != NULL);

    /* Settings of Mip-Splatting. Without sizes, the filter changes nothing. */
    AshsplatRenderSettings settings = ASHSPLAT_INIT(AshsplatRenderSettings);
    settings.antialias = true;
    settings.antialias_detached = 1;
    settings.kernel_size = 0.1f;
    check(ashsplat_render(renderer, scene, &camera, &settings, background, rgb), "rendering");
    settings.filter_3d = 1;
    check(ashsplat_render(renderer, scene, &camera, &settings, background, other), "rendering");
    EXPECT(memcmp(rgb, other, sizeof rgb) == 0);
    check(ashsplat_compute_filters(renderer, scene, cameras, 2), "the filter");
    check(ashsplat_filters(renderer, scene, sizes), "its sizes");
    check(ashsplat_render(renderer, scene, &camera, &settings, background, other), "rendering");
    EXPECT(memcmp(rgb, other, sizeof rgb) != 0);
    EXPECT(sizes[N - 1] > 0 && sizes[N] == 0);
    EXPECT(fwrite(sizes, 4, N, out) == N && fwrite(other, sizeof other, 1, out) == 1);
    REFUSED_WITH(settings.kernel_size, -1, ashsplat_render(renderer, scene, &camera, &settings, background, rgb),
                 "settings.kernel_size: is -1");
    REFUSED(ashsplat_compute_filters(renderer, scene, cameras, 0), "cameras");
    cameras[1].projection = AshsplatProjection_Orthographic;
    REFUSED(ashsplat_compute_filters(renderer, scene, cameras, 2), "cameras[1].projection: is orthographic");
    REFUSED(ashsplat_filters(renderer, scene, NULL), "sizes: ");

    /* The same filter in a recorded frame needs a reservation. */
    EXPECT(stage.wanted.gaussians == N && stage.wanted.sh_degree == 1);
    stage_reserve(&stage);
    stage.frame.settings = &settings;
    HostBuffer *pixels = host_buffer(&stage.host, 16 * PIXELS, USAGE_BUFFER_COPIES);
    host_begin(&stage.host);
    REFUSED_FRAME(&stage, "AshsplatReservation.filter_3d");
    stage.wanted.filter_3d = 1;
    stage_reserve(&stage);
    settings.distance_order = 1;
    REFUSED_FRAME(&stage, "AshsplatReservation.distance_order");
    settings.distance_order = 0;
    check(stage_record(&stage), "recording");
    uint64_t buffer = 0, offset = 0;
    check(ashsplat_slot_pixels(renderer, 0, &buffer, &offset), "asking for the pixels");
    host_read_buffer(&stage.host, buffer, offset, 16 * PIXELS, pixels);
    host_submit_and_wait(&stage.host);
    const float *texels = pixels->mapped;
    for (int i = 0; i < 3 * PIXELS; ++i) {
        const float *texel = texels + i / 3 * 4;
        const float error = texel[i % 3] + texel[3] * background[i % 3] - other[i];
        EXPECT(error < 1e-5f && error > -1e-5f);
    }

    /* Gradients of a function of picture and depths; a part of them has the same bits. */
    for (int i = 0; i < 3 * PIXELS; ++i) of_image[i] = (float)(i * 7 % 13 - 6) / 8.0f;
    for (int i = 0; i < PIXELS; ++i) of_depth[i] = (float)(i * 5 % 11 - 5) / 16.0f;
    settings.inverse_depth = true;
    float pose[7] = {0}, again[3 * N];
    AshsplatGradients gradients = {sizeof gradients, by_means, by_quats, by_scales, by_logits, by_sh, by_means2d, pose};
    check(ashsplat_gradients(renderer, scene, &camera, &settings, background, of_image, of_depth, &gradients), "gradients");
    AshsplatGradients some = ASHSPLAT_INIT(AshsplatGradients);
    some.means = again;
    check(ashsplat_gradients(renderer, scene, &camera, &settings, background, of_image, of_depth, &some), "gradients of means");
    EXPECT(memcmp(by_means, again, sizeof again) == 0);
    const struct { const float *from; size_t floats; } all[] = {{by_means, 3 * N}, {by_quats, 4 * N}, {by_scales, 3 * N}, {by_logits, N},
                                                                {by_sh, SH_FLOATS}, {by_means2d, 2 * N}, {pose, 6}};
    for (size_t i = 0; i < sizeof all / sizeof all[0]; ++i) {
        EXPECT(all[i].from[all[i].floats] == 0 && fwrite(all[i].from, 4, all[i].floats, out) == all[i].floats);
    }
    REFUSED(ashsplat_gradients(renderer, scene, &camera, &settings, background, NULL, NULL, &gradients), "image_gradient: ");
    REFUSED(ashsplat_gradients(renderer, scene, &camera, &settings, background, of_image, NULL, NULL), "gradients: ");
    REFUSED(ashsplat_gradients(renderer, scene, &camera, NULL, background, of_image, of_depth, &gradients), "inverse_depth_gradient: needs");
    REFUSED_WITH(settings.scale_modifier, 2, ashsplat_gradients(renderer, scene, &camera, &settings, background, of_image, NULL, &gradients),
                 "scale modifier");
    AshsplatCamera parallel = camera;
    parallel.projection = AshsplatProjection_Orthographic;
    REFUSED(ashsplat_gradients(renderer, scene, &parallel, &settings, background, of_image, NULL, &gradients), "orthographic");

    /* A moved camera is aligned with the photograph again. */
    AshsplatAlignment alignment = ASHSPLAT_INIT(AshsplatAlignment);
    EXPECT(alignment.steps == 100 && alignment.lr == 2e-3 && alignment.lambda_dssim == 0.2);
    check(ashsplat_render(renderer, scene, &camera, NULL, background, rgb), "rendering");
    for (int i = 0; i < 3 * PIXELS; ++i) photo[i] = (uint8_t)(255.0f * (rgb[i] > 1 ? 1 : rgb[i]) + 0.5f);
    EXPECT(fwrite(photo, sizeof photo, 1, out) == 1);
    AshsplatCamera moved = camera, aligned = ASHSPLAT_INIT(AshsplatCamera);
    moved.translation[0] += 0.03f;
    alignment.steps = 40;
    check(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, &aligned), "aligning");
    EXPECT(fwrite(aligned.camera_from_world, 4, 9, out) == 9 && fwrite(aligned.translation, 4, 3, out) == 3);
    check(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, &moved), "aligning in place");
    EXPECT(memcmp(&moved, &aligned, sizeof moved) == 0);
    REFUSED(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, NULL), "aligned: ");
    alignment.lambda_dssim = 2;
    REFUSED(ashsplat_align(renderer, scene, &moved, NULL, background, photo, NULL, &alignment, &aligned), "alignment: ");
    REFUSED(ashsplat_align(renderer, scene, &moved, NULL, background, NULL, NULL, NULL, &aligned), "rgb: ");

    /* LPIPS. */
    AshsplatLpips *lpips = NULL;
    const char *name = NULL;
    double distance = -1, none = -1;
    EXPECT(ashsplat_lpips_new(stage.context, arguments[0], &lpips) == AshsplatStatus_File && lpips == NULL);
    check(ashsplat_lpips_new(stage.context, arguments[1], &lpips), "a network");
    check(ashsplat_lpips_name(lpips, &name), "its name");
    EXPECT(strcmp(name, "lpips_alex") == 0);
    check(ashsplat_lpips_distance(lpips, rgb, rgb, W, H, &none), "a distance");
    check(ashsplat_lpips_distance(lpips, rgb, other, W, H, &distance), "a distance");
    EXPECT(none == 0 && distance > 0);
    EXPECT(fwrite(&distance, sizeof distance, 1, out) == 1);
    REFUSED(ashsplat_lpips_distance(lpips, rgb, other, 4, 4, &distance), "width, height: is 4x4 pixels, AlexNet needs");
    REFUSED(ashsplat_lpips_distance(lpips, rgb, other, UINT32_MAX, UINT32_MAX, &distance), "width, height: ");
    REFUSED(ashsplat_lpips_distance(lpips, rgb, other, W, H, NULL), "distance: ");
    EXPECT(fclose(out) == 0);
    printf("%s %g\n", name, distance);
    ashsplat_lpips_free(lpips);
    stage_close(&stage);
}

int main(int count, char **arguments) {
    TRIAL(steps)
    TRIAL(measures)
    return 1;
}
