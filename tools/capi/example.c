/* Renders a scene to a PNG through the C interface: example SCENE.ply PICTURE.png
 *
 *     cargo build --release
 *     cc -I tools/capi tools/capi/example.c -L target/release -lashsplat_c -o example
 */
#include "ashsplat.h"
#include <stdio.h>
#include <stdlib.h>

enum { WIDTH = 320, HEIGHT = 240 };

static void check(AshsplatStatus status, const char *what) {
    if (status != AshsplatStatus_Ok) {
        fprintf(stderr, "error %d: %s: %s\n", (int)status, what, ashsplat_last_error());
        exit(2);
    }
}

int main(int count, char **arguments) {
    if (count != 3) {
        fprintf(stderr, "usage: %s SCENE.ply PICTURE.png\n", arguments[0]);
        return 2;
    }
    AshsplatContext *context = NULL;
    AshsplatScene *scene = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_new(NULL, &context), "opening a device");
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");

    uint32_t gaussians = 0, sh_degree = 0;
    check(ashsplat_scene_size(scene, &gaussians, &sh_degree), "asking for the scene's size");

    const float eye[3] = {0.0f, -1.0f, -4.0f}, target[3] = {0.0f, 0.0f, 0.0f}, up[3] = {0.0f, -1.0f, 0.0f};
    const float background[3] = {0.1f, 0.2f, 0.3f};
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    check(ashsplat_camera_look_at(eye, target, up, 0.7f, WIDTH, HEIGHT, &camera), "looking at the scene");

    float *rgb = malloc(sizeof(float) * 3 * WIDTH * HEIGHT);
    if (rgb == NULL) {
        return 2;
    }
    check(ashsplat_render(renderer, scene, &camera, NULL, background, rgb), "rendering");
    /* No other picture of this size follows. */
    check(ashsplat_shrink(renderer), "giving memory back");
    check(ashsplat_write_png(arguments[2], WIDTH, HEIGHT, rgb), "writing the picture");
    printf("ashsplat %s: %u Gaussians of degree %u -> %s\n", ashsplat_version(), gaussians, sh_degree, arguments[2]);

    free(rgb);
    ashsplat_renderer_free(renderer);
    ashsplat_scene_free(scene);
    ashsplat_context_free(context);
    return 0;
}
