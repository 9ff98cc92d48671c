/* Training in a command buffer of a host in C: train RESULT.ply
 *
 * Two trainers of the same settings: one submits by itself, one is recorded. They have to agree to the bit.
 */
#include "host.h"

enum { WIDTH = 48, HEIGHT = 40, VIEWS = 3, COUNT = 200, STEPS = 30 };

static float means[COUNT][3], quats[COUNT][4], log_scales[COUNT][3], opacity_logits[COUNT], sh[COUNT][3];
static uint8_t photos[VIEWS][3 * WIDTH * HEIGHT];

/* Refused, with these words in the message. */
static void refused(AshsplatStatus status, const char *words) {
    if (status != AshsplatStatus_Argument || !strstr(ashsplat_last_error(), words)) {
        fprintf(stderr, "'%s' is not in '%s'\n", words, ashsplat_last_error());
        exit(1);
    }
}

/* Light, lens, poses and depths by another strategy from points, stopped and gone on with. */
static void learns(const AshsplatContext *context, const AshsplatTrainView *plain, const char *path) {
    static uint8_t colors[COUNT][3], mask[WIDTH * HEIGHT];
    static float exposures[VIEWS][3][4], again[VIEWS][3][4], effects[VIEWS][3][4];
    const float depth_points[2][3] = {{10, 12, 0.25f}, {30.5f, 20, 0.2f}};
    char checkpoint[4096];
    snprintf(checkpoint, sizeof checkpoint, "%s.safetensors", path);
    AshsplatTrainView views[VIEWS];
    memcpy(views, plain, sizeof views);
    memset(colors, 150, sizeof colors);
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
    check(ashsplat_trainer_new_from_points(context, views, VIEWS, means[0], colors[0], COUNT, 0, settings, &whole), "a trainer");
    check(ashsplat_trainer_new_from_points(context, views, VIEWS, means[0], colors[0], COUNT, 0, settings, &first), "a trainer");
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
    /* What does not fit is refused by name. */
    refused(ashsplat_trainer_exposures(whole, exposures[0][0], 2), "count: is 2, there are 3 views");
    refused(ashsplat_trainer_cameras(whole, NULL, VIEWS), "cameras: ");
    refused(ashsplat_trainer_resume(context, views, 2, checkpoint, 0, settings, &none), "views");
    refused(ashsplat_trainer_new(context, views, VIEWS, NULL, 0, "{}", &none), "initial: ");
    const char *wrong[][2] = {{"[]", "is no object"}, {"{\"preset\": \"slow\"}", "'slow' is none of"}, {"{\"preset\": 3}", "preset: 3"},
                              {"{\"few_photos\": 1}", "few_photos: 1"}, {"{\"preset\": \"fast\", \"strategy\": \"mcmc\"}", "strategy"}};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; ++i) {
        AshsplatStatus status =
            ashsplat_trainer_new_from_points(context, views, VIEWS, means[0], colors[0], COUNT, 0, wrong[i][0], &none);
        refused(status, wrong[i][1]);
    }
    ashsplat_trainer_free(second);
    /* A filter and a mark, which the file has; nothing is learned of light. */
    const char *filtered = "{\"preset\": \"fast\", \"few_photos\": true, \"iterations\": 20, \"filter_3d\": true, \"antialiasing\": true}";
    check(ashsplat_trainer_new_from_points(context, plain, VIEWS, means[0], colors[0], COUNT, 0, filtered, &second), "a trainer");
    check(ashsplat_trainer_step(second, &step), "a step");
    refused(ashsplat_trainer_exposures(second, exposures[0][0], VIEWS), "exposure: is not set");
    const char *endings[] = {"filtered.ply", "filtered.spz"};
    for (int i = 0; i < 2; ++i) {
        snprintf(checkpoint, sizeof checkpoint, "%s.%s", path, endings[i]);
        check(ashsplat_trainer_save(second, checkpoint), "saving");
        EXPECT(!*ashsplat_last_loss());
        AshsplatScene *scene = NULL;
        bool antialiased = false;
        const char *warnings = NULL;
        check(ashsplat_scene_load(context, checkpoint, &scene), "loading");
        check(ashsplat_scene_told(scene, &antialiased, &warnings), "what the file says");
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
    static uint8_t colors[COUNT][3];
    static float map[WIDTH * HEIGHT];
    const float point[3] = {10, 12, 0.25f};
    memset(colors, 150, sizeof colors);
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
        check(ashsplat_trainer_new_from_points(context, used, VIEWS, means[0], colors[0], COUNT, 0, settings, &trainer), "a trainer");
        check(ashsplat_trainer_step(trainer, &step), "a step");
        losses[with] = step.loss;
        for (int i = 1; i < 12; ++i) check(ashsplat_trainer_step(trainer, &step), "a step");
        EXPECT(step.gaussians > COUNT && step.gaussians <= 300);
        ashsplat_trainer_free(trainer);
    }
    EXPECT(losses[1] > losses[0]);
    const char *few = "{\"strategy\": \"mcmc\", \"cap_max\": 7}";
    refused(ashsplat_trainer_new_from_points(context, plain, VIEWS, means[0], colors[0], COUNT, 0, few, &none), "cap_max: 7 is less");
    views[0].depth_points = point;
    views[0].depth_point_count = 1;
    const char *both = "{\"depth_points\": 0.1}";
    refused(ashsplat_trainer_new_from_points(context, views, VIEWS, means[0], colors[0], COUNT, 0, both, &none), "depth_points: ");
    EXPECT(none == NULL);
}

int main(int count, char **arguments) {
    EXPECT(count == 2);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    AshsplatTrainView views[VIEWS];
    AshsplatCamera cameras[VIEWS];
    for (int v = 0; v < VIEWS; ++v) {
        const float eye[3] = {(float)v - 1.0f, -1.0f, -4.0f}, target[3] = {0, 0, 0}, up[3] = {0, -1, 0};
        cameras[v] = ASHSPLAT_INIT(AshsplatCamera);
        check(ashsplat_camera_look_at(eye, target, up, 0.8f, WIDTH, HEIGHT, &cameras[v]), "a camera");
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
    EXPECT(ashsplat_trainer_new(context, views, VIEWS, &start, 0, "{\"iterations\": -1}", &none) == AshsplatStatus_Argument);
    EXPECT(ashsplat_trainer_new(context, NULL, VIEWS, &start, 0, settings, &none) == AshsplatStatus_Argument);
    EXPECT(ashsplat_trainer_new(context, views, 0, &start, 0, settings, &none) == AshsplatStatus_Argument && none == NULL);
    check(ashsplat_trainer_new(context, views, VIEWS, &start, 0, settings, &own), "a trainer");
    check(ashsplat_trainer_new(context, views, VIEWS, &start, 0, settings, &recorded), "a trainer");

    refused(ashsplat_trainer_record(recorded, NULL, 0, NULL), "commands: ");
    refused(ashsplat_trainer_record(recorded, host_begin(&host), 0, NULL), "trainer: its training steps are not reserved: call ashsplat_trainer_reserve");
    require(host.EndCommandBuffer(host.commands), "vkEndCommandBuffer");
    /* Too little room at first: the first step changes nothing, and is recorded again. */
    check(ashsplat_trainer_reserve(recorded, 1, 10, 0), "reserving");
    /* A step that is thrown away is recorded again. */
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
        refused(ashsplat_trainer_record(recorded, host.commands, 0, &release), "slot: its last recording is still in flight");
        EXPECT(ashsplat_trainer_save(recorded, arguments[1]) == AshsplatStatus_Argument);
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
    learns(context, views, arguments[1]);
    learns_of_depths(context, views);
    AshsplatScene *scene = NULL;
    uint32_t gaussians = 0;
    check(ashsplat_trainer_scene(recorded, &scene), "the trained scene");
    check(ashsplat_scene_size(scene, &gaussians, NULL), "its size");
    check(ashsplat_trainer_save(recorded, arguments[1]), "saving");
    printf("%u iterations, %u densifications, %u without room, %u Gaussians\n", iterations, densified, overflowed, gaussians);
    ashsplat_scene_free(scene);
    ashsplat_trainer_free(own);
    ashsplat_trainer_free(recorded);
    ashsplat_context_free(context);
    host_close(&host);
    return 0;
}
