/* Several scenes in one frame of a host in C: scenes SCENE.ply PICTURE.png DEPTH.bin
 *
 * The scene of the file stands there twice, once scaled; a third is the host's own buffers, written here; the first half
 * of the first is replaced by what an update says. All of it is hidden behind a wall in the host's depth image at z = 4.2.
 */
#include "host.h"

enum { WIDTH = 160, HEIGHT = 120, OWN = 64 };
static const float NEAR = 0.1f, WALL = 4.2f;

/* Gaussians in a grid, by arrays: red above, blue below. */
static float means[OWN][3], quats[OWN][4], log_scales[OWN][3], opacity_logits[OWN], sh[OWN][3];

static AshsplatGaussians grid(float z) {
    for (int i = 0; i < OWN; ++i) {
        float x = (float)(i % 8) / 4.0f - 0.875f, y = (float)(i / 8) / 4.0f - 0.875f;
        float mean[3] = {x, y, z}, quat[4] = {1, 0, 0, 0}, log_scale[3] = {-2.5f, -2.5f, -2.5f};
        float color[3] = {y < 0 ? 1.5f : -1.5f, -1.0f, y < 0 ? -1.5f : 1.5f};
        memcpy(means[i], mean, sizeof mean);
        memcpy(quats[i], quat, sizeof quat);
        memcpy(log_scales[i], log_scale, sizeof log_scale);
        memcpy(sh[i], color, sizeof color);
        opacity_logits[i] = 2.0f;
    }
    AshsplatGaussians gaussians = ASHSPLAT_INIT(AshsplatGaussians);
    gaussians.count = OWN;
    gaussians.means = means[0];
    gaussians.quats = quats[0];
    gaussians.log_scales = log_scales[0];
    gaussians.opacity_logits = opacity_logits;
    gaussians.sh = sh[0];
    return gaussians;
}

/* The same, as a scene in the host's own buffers expects it. */
static void fill_planes(float *floats, const AshsplatScenePlan *plan, uint32_t count) {
    for (uint32_t i = 0; i < count; ++i) {
        float planes[4][4] = {{means[i][0], means[i][1], means[i][2], opacity_logits[i]},
                              {quats[i][0], quats[i][1], quats[i][2], quats[i][3]},
                              {log_scales[i][0], log_scales[i][1], log_scales[i][2], 0},
                              {sh[i][0], sh[i][1], sh[i][2], 0}};
        for (uint32_t p = 0; p < 3; ++p) {
            memcpy(floats + 4 * ((i / 8 * 3 + p) * 8 + i % 8), planes[p], sizeof planes[p]);
        }
        memcpy(floats + 4 * (3 * plan->chunk_gaussians + i), planes[3], sizeof planes[3]);
    }
}

/* A half float that is finite. */
static float of_half(uint16_t bits) {
    int exponent = bits >> 10 & 31;
    float size = (float)(bits & 1023) / 1024 + (exponent > 0 ? 1 : 0);
    for (int at = exponent > 0 ? exponent : 1; at != 15; at += at < 15 ? 1 : -1) {
        size = at < 15 ? size / 2 : size * 2;
    }
    return bits >> 15 ? -size : size;
}

/* Scenes of one buffer are drawn together. */
static void draw_together(Host *host, AshsplatContext *context) {
    enum { TOGETHER = 9 };
    AshsplatGaussians all[TOGETHER];
    AshsplatScene *scenes[TOGETHER + 1] = {NULL};
    AshsplatPlaced placed[TOGETHER];
    for (int i = 0; i < TOGETHER; ++i) {
        all[i] = grid(0.1f);
    }
    all[5].sh = NULL;
    scenes[2] = (AshsplatScene *)context;
    EXPECT(ashsplat_scenes_new(context, all, TOGETHER, scenes) == AshsplatStatus_Argument && scenes[2] == NULL);
    EXPECT(strstr(ashsplat_last_error(), "gaussians[5].sh: the pointer is null") != NULL);
    EXPECT(ashsplat_scenes_new(context, all, TOGETHER, NULL) == AshsplatStatus_Argument);
    all[5] = all[4];
    check(ashsplat_scenes_new(context, all, TOGETHER, scenes), "uploading scenes together");
    EXPECT(scenes[TOGETHER - 1] != NULL && scenes[TOGETHER] == NULL);
    for (int i = 0; i < TOGETHER; ++i) {
        placed[i] = ASHSPLAT_INIT(AshsplatPlaced);
        placed[i].scene = scenes[i];
        placed[i].translation[0] = 0.1f * (float)i;
    }
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_renderer_new(context, &renderer), "building a renderer");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.scenes = TOGETHER;
    /* A scene begins at a block of culling. */
    wanted.gaussians = TOGETHER * 256;
    wanted.width = WIDTH;
    wanted.height = HEIGHT;
    check(ashsplat_reserve(renderer, &wanted), "reserving");
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    const float eye[3] = {0, 0, -4}, middle[3] = {0, 0, 0}, up[3] = {0, -1, 0};
    check(ashsplat_camera_look_at(eye, middle, up, 0.8f, WIDTH, HEIGHT, &camera), "a camera");
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &camera;
    frame.scenes = placed;
    frame.scene_count = TOGETHER;
    void *commands = host_begin(host);
    check(ashsplat_record(renderer, commands, 0, &frame, NULL), "recording scenes together");
    host_submit_and_wait(host);
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    check(ashsplat_slot_report(renderer, 0, &report), "asking for its report");
    EXPECT(report.finished && report.gaussians == TOGETHER * OWN && report.visible > OWN);
    EXPECT(report.batched_scenes == TOGETHER);
    ashsplat_renderer_free(renderer);
    for (int i = 0; i < TOGETHER; ++i) {
        ashsplat_scene_free(scenes[i]);
    }
}

int main(int count, char **arguments) {
    EXPECT(count == 4);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    AshsplatScene *file = NULL, *own = NULL, *made = NULL, *none = NULL;
    check(ashsplat_scene_load(context, arguments[1], &file), "loading the scene");
    uint32_t gaussians = 0, sh_degree = 0;
    check(ashsplat_scene_size(file, &gaussians, &sh_degree), "asking for the scene's size");

    /* A scene in the host's own buffer. */
    AshsplatScenePlan plan = ASHSPLAT_INIT(AshsplatScenePlan);
    check(ashsplat_scene_plan(context, OWN, 0, &plan), "planning");
    EXPECT(plan.chunks == 1 && plan.planes == 4 && plan.chunk_gaussians >= OWN);
    EXPECT(plan.chunk_bytes == 64u * plan.chunk_gaussians);
    HostBuffer planes = host_buffer(&host, plan.chunk_bytes, USAGE_BUFFER_COPIES | USAGE_BUFFER_STORAGE);
    grid(0.15f);
    fill_planes(planes.mapped, &plan, OWN);
    AshsplatHostBuffer chunk = {planes.raw, 0, plan.chunk_bytes};
    AshsplatHostBuffer bad = {0, 0, plan.chunk_bytes}, small = {planes.raw, 0, 256};
    EXPECT(ashsplat_scene_from_buffers(context, OWN, 0, OWN, &bad, 1, &none) == AshsplatStatus_Argument && none == NULL);
    EXPECT(ashsplat_scene_from_buffers(context, OWN, 0, OWN, &small, 1, &none) == AshsplatStatus_Argument);
    EXPECT(ashsplat_scene_from_buffers(context, OWN, 0, OWN + 1, &chunk, 1, &none) == AshsplatStatus_Argument);
    check(ashsplat_scene_from_buffers(context, OWN, 0, OWN, &chunk, 1, &own), "adopting the buffer");

    /* A scene of the host's arrays; its count changes later. */
    AshsplatGaussians arrays = grid(-0.9f);
    check(ashsplat_scene_new(context, &arrays, 100, &made), "uploading arrays");
    EXPECT(ashsplat_scene_set_count(made, 101) == AshsplatStatus_Argument);
    check(ashsplat_scene_set_count(made, OWN / 2), "fewer Gaussians");
    arrays.sh_degree = 4;
    EXPECT(ashsplat_scene_new(context, &arrays, 0, &none) == AshsplatStatus_Argument && none == NULL);
    arrays.sh_degree = 0;
    arrays.sh = NULL;
    EXPECT(ashsplat_scene_new(context, &arrays, 0, &none) == AshsplatStatus_Argument && none == NULL);

    HostTexture color = host_texture(&host, FORMAT_RGBA8, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM, WIDTH, HEIGHT);
    HostTexture depth =
        host_texture(&host, FORMAT_D32, USAGE_IMAGE_DEPTH | USAGE_IMAGE_SAMPLED | USAGE_IMAGE_COPY_TO, WIDTH, HEIGHT);
    HostTexture expected = host_texture(&host, FORMAT_R32F, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM, WIDTH, HEIGHT);
    HostBuffer pixels = host_buffer(&host, 4 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    HostBuffer depths = host_buffer(&host, 4 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    /* What lies beside the picture: who is seen, and how it moves. */
    HostTexture who = host_texture(&host, FORMAT_RGBA32UI, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM, WIDTH, HEIGHT);
    HostTexture speed = host_texture(&host, FORMAT_RG16F, USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM, WIDTH, HEIGHT);
    HostBuffer picks = host_buffer(&host, 16 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    HostBuffer motions = host_buffer(&host, 4 * WIDTH * HEIGHT, USAGE_BUFFER_COPIES);
    AshsplatImage *picked = NULL, *moved = NULL;
    check(ashsplat_image_adopt(context, &who.description, AshsplatImageUse_Pick, &picked), "adopting the picks");
    check(ashsplat_image_adopt(context, &speed.description, AshsplatImageUse_Motion, &moved), "adopting the motion");
    AshsplatImage *target = NULL, *walls = NULL, *distances = NULL, *wrong = NULL;
    EXPECT(ashsplat_image_adopt(context, &color.description, AshsplatImageUse_Occluder, &wrong) == AshsplatStatus_Argument && wrong == NULL);
    EXPECT(ashsplat_image_adopt(context, &color.description, 5, &wrong) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "purpose: 5, there are 0 to 4") != NULL);
    /* Depth of several samples is resolved first. */
    AshsplatForeignImage multisampled = depth.description;
    multisampled.samples = 4;
    EXPECT(ashsplat_image_adopt(context, &multisampled, AshsplatImageUse_Occluder, &wrong) == AshsplatStatus_Argument);
    EXPECT(wrong == NULL && strstr(ashsplat_last_error(), "'occluder': it has 4 samples per pixel") != NULL);
    check(ashsplat_image_adopt(context, &color.description, AshsplatImageUse_Target, &target), "adopting the target");
    check(ashsplat_image_adopt(context, &depth.description, AshsplatImageUse_Occluder, &walls), "adopting the depth");
    check(ashsplat_image_adopt(context, &expected.description, AshsplatImageUse_Depth, &distances), "adopting the expected depth");

    AshsplatRenderer *renderer = NULL;
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.scenes = 5;
    wanted.tint = true;
    wanted.cut_outs = 1;
    wanted.selection = true;
    wanted.gaussians = 2 * gaussians + 2 * OWN;
    wanted.sh_degree = sh_degree;
    wanted.width = WIDTH;
    wanted.height = HEIGHT;
    wanted.occlusion = true;
    wanted.expected_depth = true;
    wanted.pick = true;
    wanted.motion = true;
    wanted.staging_bytes = ashsplat_update_bytes(OWN, sh_degree);
    check(ashsplat_reserve(renderer, &wanted), "reserving");

    void *commands = host_begin(&host);
    /* The wall: reversed depth without a far plane, near / z. */
    ClearDepth wall = {NEAR / WALL, 0};
    Range whole = {ASPECT_DEPTH, 0, 1, 0, 1};
    host_transition(&host, &depth, ASPECT_DEPTH, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host.CmdClearDepthStencilImage(commands, depth.raw, LAYOUT_COPY_TO, &wall, 1, &whole);

    AshsplatSceneSettings hidden = ASHSPLAT_INIT(AshsplatSceneSettings), tinted, cut;
    EXPECT(hidden.visible && hidden.tint[2] == 1 && hidden.opacity == 1 && hidden.sh_degree == 3);
    tinted = cut = hidden;
    hidden.visible = false;
    tinted.tint[0] = 0.5f;
    tinted.opacity = 0.75f;
    /* What lies at x >= 0.55 in the world. */
    AshsplatCutOut half = ASHSPLAT_INIT(AshsplatCutOut);
    half.volume = AshsplatVolume_HalfSpace;
    half.size[0] = -1;
    half.offset = -0.55f;
    half.removes = true;
    cut.cut_outs = &half;
    cut.cut_out_count = 1;
    /* The first half of what is left of the grid. */
    HostBuffer bits = host_buffer(&host, 4, USAGE_BUFFER_COPIES | USAGE_BUFFER_STORAGE);
    const uint32_t selected = 0xffff;
    memcpy(bits.mapped, &selected, sizeof selected);
    AshsplatHostBuffer mask = {bits.raw, 0, 4};
    cut.selection = &mask;
    cut.selection_color[0] = 0;
    cut.selection_color[2] = 0.25f;
    cut.selection_share = 0.75f;
    AshsplatPlaced placed[5];
    const AshsplatScene *scenes[5] = {file, file, own, made, file};
    for (int i = 0; i < 5; ++i) {
        placed[i] = ASHSPLAT_INIT(AshsplatPlaced);
        placed[i].scene = scenes[i];
    }
    const float quarter[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1}, aside[3] = {-0.8f, 0.4f, -0.5f};
    memcpy(placed[1].world_from_object, quarter, sizeof quarter);
    memcpy(placed[1].translation, aside, sizeof aside);
    placed[1].scale = 0.25f;
    placed[2].settings = &tinted;
    placed[3].translation[0] = 0.3f;
    placed[3].scale = 0.5f;
    placed[3].settings = &cut;
    /* Half a unit further down in the frame before: it rises by that much of the screen at its z = 3.55. */
    AshsplatPose lower = ASHSPLAT_INIT(AshsplatPose);
    lower.translation[0] = 0.3f;
    lower.translation[1] = 0.5f;
    lower.scale = 0.5f;
    placed[3].previous_pose = &lower;
    const float rise = 160 * 0.5f / 3.55f;
    placed[4].settings = &hidden;
    check(ashsplat_cut_out_in_scene(&half, &placed[3], &half), "bringing a cut-out into a scene");
    EXPECT(half.scale == 2 && half.translation[0] < -0.599f && half.translation[0] > -0.601f && half.removes);
    AshsplatCutOut sheared = half, unchanged = half;
    sheared.scene_from_volume[0] = 2;
    EXPECT(ashsplat_cut_out_in_scene(&sheared, &placed[3], &unchanged) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "cut_out.pose: is not a rotation") != NULL);
    AshsplatPlaced nowhere = placed[3];
    nowhere.scale = 0;
    EXPECT(ashsplat_cut_out_in_scene(&half, &nowhere, &unchanged) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "placed.pose: a scale of 0") != NULL);
    EXPECT(memcmp(&unchanged, &half, sizeof half) == 0);
    arrays = grid(-0.4f);
    AshsplatUpdate update = ASHSPLAT_INIT(AshsplatUpdate);
    update.scene = file;
    update.first = 10;
    update.gaussians = &arrays;
    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &camera;
    AshsplatTarget to = ASHSPLAT_INIT(AshsplatTarget);
    AshsplatOccluder occluder = ASHSPLAT_INIT(AshsplatOccluder);
    AshsplatDepthTarget z = ASHSPLAT_INIT(AshsplatDepthTarget);
    frame.scenes = placed;
    frame.scene_count = 5;
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, 2.6666667f, 0, 0, 0, 0, 0, 1, 0, 0, NEAR, 0};
    check(ashsplat_camera_from_matrices(view, projection, false, WIDTH, HEIGHT, &camera, &occluder.mapping),
          "understanding the matrices");
    AshsplatImageState fresh = {LAYOUT_UNDEFINED, 0, 0}, cleared = {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE};
    frame.target = &to;
    to.to.image = target;
    to.to.from = fresh;
    to.behind = AshsplatBackground_Color;
    to.background[0] = 0.1f;
    to.background[1] = 0.2f;
    to.background[2] = 0.3f;
    frame.occluder = &occluder;
    occluder.depth.image = walls;
    occluder.depth.from = cleared;
    frame.depth = &z;
    z.to.image = distances;
    z.to.from = fresh;
    z.min_weight = 0.5f;
    z.empty = -1;
    AshsplatPickTarget pick = ASHSPLAT_INIT(AshsplatPickTarget);
    pick.to.image = picked;
    pick.to.from = fresh;
    frame.pick = &pick;
    /* The middle of the picture was three pixels further to the left, and lay as high: everything goes to the right. */
    AshsplatCamera before = camera;
    before.cx -= 3;
    AshsplatMotionTarget motion = ASHSPLAT_INIT(AshsplatMotionTarget);
    motion.to.image = moved;
    motion.to.from = fresh;
    motion.previous_camera = &before;
    motion.min_weight = 0.5f;
    motion.empty[1] = -1;
    frame.motion = &motion;
    frame.updates = &update;
    frame.update_count = 1;
    update.first = gaussians;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    update.first = 10;
    to.to.image = distances;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    to.to.image = target;
    camera.fx = -1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    camera.fx = 160;
    half.volume = 3;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.cut_outs[0].volume: 3, there are 0 to 2") != NULL);
    half.volume = AshsplatVolume_HalfSpace;
    half.size[0] = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.cut_outs[0].size: a normal") != NULL);
    half.size[0] = -1;
    cut.cut_outs = NULL;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.cut_outs: the pointer is null") != NULL);
    /* Nothing is read of too many. */
    cut.cut_outs = (const AshsplatCutOut *)sizeof(AshsplatCutOut);
    cut.cut_out_count = UINT32_MAX;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.cut_outs: 4294967295 of them, there may be 16") != NULL);
    cut.cut_out_count = 1;
    cut.cut_outs = &half;
    mask.buffer = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.selection: the handle is null") != NULL);
    mask.buffer = bits.raw;
    cut.selection_share = -1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.selection_share: -1") != NULL);
    cut.selection_share = 0.75f;
    tinted.opacity = 1.5f;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[2].settings.opacity: 1.5") != NULL);
    tinted.opacity = 0.75f;
    pick.to.image = NULL;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "pick.to.image: the pointer is null") != NULL);
    pick.to.image = moved;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "pick (image 'motion'): it was adopted for AshsplatImageUse_Motion, not for AshsplatImageUse_Pick") != NULL);
    pick.to.image = picked;
    motion.to.image = NULL;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "motion.to.image: the pointer is null") != NULL);
    motion.to.image = moved;
    motion.previous_camera = NULL;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "motion.previous_camera: the pointer is null") != NULL);
    motion.previous_camera = &before;
    before.projection = 2;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "motion.previous_camera.projection: 2, there are 0 to 1") != NULL);
    before.projection = AshsplatProjection_Perspective;
    before.width = 1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "motion.previous_camera: is of 1 x 120") != NULL);
    before.width = WIDTH;
    lower.scale = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].previous_pose: a scale of 0") != NULL);
    lower.scale = 0.5f;
    AshsplatRelease release = ASHSPLAT_INIT(AshsplatRelease);
    check(ashsplat_record(renderer, commands, 0, &frame, &release), "recording");
    host_read(&host, &color, release.color.layout, &pixels);
    host_read(&host, &expected, release.depth.layout, &depths);
    host_read(&host, &who, release.pick.layout, &picks);
    host_read(&host, &speed, release.motion.layout, &motions);
    host_submit_and_wait(&host);
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
    EXPECT(report.finished && !report.overflow && report.gaussians == 2 * gaussians + OWN + OWN / 2);

    static float rgb[3 * WIDTH * HEIGHT];
    const uint8_t *bytes = pixels.mapped;
    for (int i = 0; i < WIDTH * HEIGHT; ++i) {
        for (int channel = 0; channel < 3; ++channel) {
            rgb[3 * i + channel] = (float)bytes[4 * i + channel] / 255.0f;
        }
    }
    check(ashsplat_write_png(arguments[2], WIDTH, HEIGHT, rgb), "writing the picture");
    FILE *out = fopen(arguments[3], "wb");
    EXPECT(out != NULL && fwrite(depths.mapped, 4, WIDTH * HEIGHT, out) == WIDTH * HEIGHT && fclose(out) == 0);
    const uint32_t counts[5] = {gaussians, gaussians, OWN, OWN / 2, 0}, (*pixel)[4] = picks.mapped;
    const uint16_t(*half_floats)[2] = motions.mapped;
    const float *distance = depths.mapped;
    int somebody = 0, rising = 0;
    for (int i = 0; i < WIDTH * HEIGHT; ++i) {
        float z, weight;
        memcpy(&z, &pixel[i][2], sizeof z);
        memcpy(&weight, &pixel[i][3], sizeof weight);
        if (pixel[i][1] == UINT32_MAX) {
            EXPECT(pixel[i][0] == UINT32_MAX && z == 0 && weight == 0 && distance[i] == -1);
        } else {
            EXPECT(pixel[i][1] < 5 && pixel[i][0] < counts[pixel[i][1]]);
            EXPECT(z > 2 && z < WALL && weight > 0 && weight <= 1);
            ++somebody;
        }
        /* (0, -1) where less than half of the pixel is covered. */
        float right = of_half(half_floats[i][0]), down = of_half(half_floats[i][1]);
        if (distance[i] == -1) {
            EXPECT(right == 0 && down == -1);
            continue;
        }
        /* The scene that rises has at least the share of the weights that its Gaussian picked has, or at most what others leave. */
        float share = -down / rise;
        EXPECT(right > 2.99f && right < 3.01f && share > -0.01f && share < 1.01f);
        if (pixel[i][1] == 3) {
            EXPECT(share > weight - 0.01f);
            rising += weight > 0.25f;
        } else {
            EXPECT(share < 1 - weight + 0.01f);
        }
    }
    EXPECT(rising > 100);
    EXPECT(somebody > WIDTH * HEIGHT / 10);
    printf("%u of %u Gaussians visible\n", report.visible, report.gaussians);
    draw_together(&host, context);

    ashsplat_renderer_free(renderer);
    ashsplat_image_free(target);
    ashsplat_image_free(walls);
    ashsplat_image_free(distances);
    ashsplat_image_free(picked);
    ashsplat_image_free(moved);
    ashsplat_scene_free(file);
    ashsplat_scene_free(own);
    ashsplat_scene_free(made);
    host_free_texture(&host, &color);
    host_free_texture(&host, &depth);
    host_free_texture(&host, &expected);
    host_free_texture(&host, &who);
    host_free_texture(&host, &speed);
    host_free_buffer(&host, &planes);
    host_free_buffer(&host, &bits);
    host_free_buffer(&host, &pixels);
    host_free_buffer(&host, &depths);
    host_free_buffer(&host, &picks);
    host_free_buffer(&host, &motions);
    ashsplat_context_free(context);
    host_close(&host);
    return 0;
}
