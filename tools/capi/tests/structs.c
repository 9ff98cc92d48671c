/* Hosts of older and of newer headers, and structs that nobody has begun: structs SCENE.ply
 *
 * The older structs end before fields of today's; what lies behind them is no value of those fields. The newer ones have
 * fields that the library does not know.
 */
#include "host.h"
/* A second time, as by a header of an engine. */
#include "ashsplat.h"

enum { WIDTH = 64, HEIGHT = 48, FLOATS = 3 * WIDTH * HEIGHT };

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

static bool said(const char *text) { return strstr(ashsplat_last_error(), text) != NULL; }

int main(int count, char **arguments) {
    EXPECT(count == 2);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    AshsplatScene *scene = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    check(ashsplat_scene_load(context, arguments[1], &scene), "loading the scene");
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    const float eye[3] = {0, -1, -4}, at[3] = {0, 0, 0}, up[3] = {0, -1, 0}, background[3] = {0, 0.5f, 0};
    static float rgb[FLOATS], again[FLOATS];

    /* Today's. */
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    EXPECT(camera.struct_size == sizeof camera && camera.camera_from_world[4] == 1 && camera.camera_from_world[1] == 0);
    check(ashsplat_camera_look_at(eye, at, up, 0.7f, WIDTH, HEIGHT, &camera), "a camera");
    EXPECT(camera.struct_size == sizeof camera && camera.width == WIDTH);
    check(ashsplat_render(renderer, scene, &camera, NULL, background, rgb), "rendering");

    /* An older camera is written and read without what is behind it. */
    OldCameraAndMore old;
    memset(&old, 0xff, sizeof old);
    old.camera.struct_size = sizeof old.camera;
    check(ashsplat_camera_look_at(eye, at, up, 0.7f, WIDTH, HEIGHT, (AshsplatCamera *)&old), "an older camera");
    EXPECT(old.behind == 0xffffffff && old.camera.struct_size == sizeof old.camera && old.camera.fx == camera.fx);
    check(ashsplat_render(renderer, scene, (const AshsplatCamera *)&old, NULL, background, again), "rendering");
    EXPECT(memcmp(rgb, again, sizeof rgb) == 0);
    /* As today's, it would be no camera. */
    old.camera.struct_size = sizeof old;
    EXPECT(ashsplat_render(renderer, scene, (const AshsplatCamera *)&old, NULL, background, again) == AshsplatStatus_Argument);
    EXPECT(said("camera.projection: 4294967295, there are 0 to 1"));

    /* A newer camera works while it says nothing new. */
    NewCamera new = {camera, {0, 0}};
    new.known.struct_size = sizeof new;
    memset(again, 0, sizeof again);
    check(ashsplat_render(renderer, scene, &new.known, NULL, background, again), "rendering");
    EXPECT(memcmp(rgb, again, sizeof rgb) == 0);
    new.unknown[1] = 2;
    EXPECT(ashsplat_render(renderer, scene, &new.known, NULL, background, again) == AshsplatStatus_Argument);
    EXPECT(said("camera: struct_size is 88, this version knows 80 bytes of AshsplatCamera") && said("at byte 87"));

    /* Nobody has begun these. */
    camera.struct_size = 0;
    EXPECT(ashsplat_render(renderer, scene, &camera, NULL, background, again) == AshsplatStatus_Argument);
    EXPECT(said("camera: struct_size is 0: begin with ASHSPLAT_INIT(AshsplatCamera)"));
    EXPECT(ashsplat_camera_look_at(eye, at, up, 0.7f, WIDTH, HEIGHT, &camera) == AshsplatStatus_Argument);
    /* 72 would be without a height: no header had such a camera. */
    const uint32_t senseless[] = {1, 4, 6, 8, 72, 83, 4100, 0xcccccccc};
    for (int i = 0; i < 8; ++i) {
        camera.struct_size = senseless[i];
        EXPECT(ashsplat_render(renderer, scene, &camera, NULL, background, again) == AshsplatStatus_Argument);
        EXPECT(said("AshsplatCamera has 80: begin with ASHSPLAT_INIT(AshsplatCamera)"));
    }
    camera.struct_size = sizeof camera;

    /* Older and newer arrays are as wide as their first struct says. */
    AshsplatReservation reservation = ASHSPLAT_INIT(AshsplatReservation);
    uint32_t gaussians = 0;
    check(ashsplat_scene_size(scene, &gaussians, &reservation.sh_degree), "asking for the scene's size");
    reservation.gaussians = 3 * gaussians;
    reservation.scenes = 3;
    reservation.width = WIDTH;
    reservation.height = HEIGHT;
    check(ashsplat_reserve(renderer, &reservation), "reserving");
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &camera;
    frame.scene_count = 3;
    OldPlaced narrow[3];
    NewPlaced wide[3];
    for (int i = 0; i < 3; ++i) {
        memset(&wide[i], 0, sizeof wide[i]);
        wide[i].known = ASHSPLAT_INIT(AshsplatPlaced);
        wide[i].known.struct_size = sizeof wide[i];
        wide[i].known.scene = scene;
        wide[i].known.translation[0] = (float)i - 1.0f;
        memset(&narrow[i], 0xff, sizeof narrow[i]);
        narrow[i].struct_size = sizeof narrow[i];
        narrow[i].scene = scene;
        memcpy(narrow[i].world_from_object, wide[i].known.world_from_object, sizeof narrow[i].world_from_object);
        memcpy(narrow[i].translation, wide[i].known.translation, sizeof narrow[i].translation);
        narrow[i].scale = 1;
    }
    EXPECT(sizeof narrow[0] < sizeof(AshsplatPlaced) && sizeof wide[0] > sizeof(AshsplatPlaced));
    uint32_t visible[2] = {0, 0};
    for (int older = 0; older < 2; ++older) {
        frame.scenes = older ? (const AshsplatPlaced *)narrow : &wide[0].known;
        check(ashsplat_record(renderer, host_begin(&host), 0, &frame, NULL), "recording");
        host_submit_and_wait(&host);
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
    frame.scenes = &wide[0].known;
    void *commands = host_begin(&host);
    wide[2].unknown = 1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(said("scenes[2]: struct_size is 96, this version knows 88 bytes of AshsplatPlaced"));
    wide[2].unknown = 0;
    wide[1].known.struct_size = sizeof(AshsplatPlaced);
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(said("scenes[1]: struct_size is 88, that of scenes[0] is 96"));
    wide[1].known.struct_size = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(said("scenes[1]: struct_size is 0: begin with ASHSPLAT_INIT(AshsplatPlaced)"));
    wide[1].known.struct_size = sizeof wide[1];
    AshsplatRelease nobody;
    memset(&nobody, 0, sizeof nobody);
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, &nobody) == AshsplatStatus_Argument);
    EXPECT(said("release: struct_size is 0"));
    frame.camera = NULL;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument && said("camera: the pointer is null"));

    /* Parallel rays are reserved. */
    frame.camera = &camera;
    camera.projection = AshsplatProjection_Orthographic;
    camera.fx = camera.fy = 20;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(said("orthographic: not reserved"));
    reservation.orthographic = true;
    check(ashsplat_reserve(renderer, &reservation), "reserving parallel rays");
    check(ashsplat_record(renderer, commands, 0, &frame, NULL), "recording parallel rays");
    host_submit_and_wait(&host);
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(report.finished && report.visible > 0);
    printf("%u of %u Gaussians visible\n", visible[0], 3 * gaussians);

    ashsplat_renderer_free(renderer);
    ashsplat_scene_free(scene);
    ashsplat_context_free(context);
    host_close(&host);
    return 0;
}
