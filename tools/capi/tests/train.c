/* Training in a command buffer of a host in C: train RESULT.ply
 *
 * Two trainers of the same settings: one submits by itself, one is recorded. They have to agree to the bit.
 */
#include "host.h"

enum { WIDTH = 48, HEIGHT = 40, VIEWS = 3, COUNT = 200, STEPS = 30 };

static float means[COUNT][3], quats[COUNT][4], log_scales[COUNT][3], opacity_logits[COUNT], sh[COUNT][3];
static uint8_t photos[VIEWS][3 * WIDTH * HEIGHT];

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

    EXPECT(ashsplat_trainer_record(recorded, NULL, 0, NULL) == AshsplatStatus_Argument);
    /* Too little room at first: the first step changes nothing, and is recorded again. */
    check(ashsplat_trainer_reserve(recorded, 1, 10), "reserving");
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
        EXPECT(ashsplat_trainer_record(recorded, host.commands, 0, &release) == AshsplatStatus_Argument);
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
