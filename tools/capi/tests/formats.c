/* What files hold: formats FILE... prints the number of Gaussians, the degree and the sum of a picture of each. */
#include "host.h"

int main(int count, char **arguments) {
    AshsplatContext *context = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_new(NULL, &context), "opening a device");
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    const float eye[3] = {0, -1, -4}, at[3] = {0, 0, 0}, up[3] = {0, -1, 0}, background[3] = {0, 0, 0};
    check(ashsplat_camera_look_at(eye, at, up, 0.7f, 64, 48, &camera), "a camera");
    static float rgb[3 * 64 * 48];
    for (int i = 1; i < count; ++i) {
        AshsplatScene *scene = NULL;
        uint32_t gaussians = 0, sh_degree = 0;
        check(ashsplat_scene_load(context, arguments[i], &scene), "loading a scene");
        check(ashsplat_scene_size(scene, &gaussians, &sh_degree), "asking for its size");
        check(ashsplat_render(renderer, scene, &camera, NULL, background, rgb), "rendering");
        double sum = 0;
        for (int k = 0; k < 3 * 64 * 48; ++k) {
            sum += (double)rgb[k];
        }
        printf("%u %u %.9g\n", gaussians, sh_degree, sum);
        ashsplat_scene_free(scene);
    }
    ashsplat_renderer_free(renderer);
    ashsplat_context_free(context);
    return 0;
}
