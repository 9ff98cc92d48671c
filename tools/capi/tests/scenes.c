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
    AshsplatGaussians gaussians = {OWN, 0, means[0], quats[0], log_scales[0], opacity_logits, sh[0]};
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

int main(int count, char **arguments) {
    EXPECT(count == 4);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    check(ashsplat_context_from_host(&host.handles, &context), "being a guest");
    AshsplatScene *file = NULL, *own = NULL, *made = NULL, *none = NULL;
    check(ashsplat_scene_load(context, arguments[1], &file), "loading the scene");
    uint32_t gaussians = 0, sh_degree = 0;
    check(ashsplat_scene_size(file, &gaussians, &sh_degree), "asking for the scene's size");

    /* A scene in the host's own buffer. */
    AshsplatScenePlan plan;
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
    check(ashsplat_image_adopt(context, &who.description, false, &picked), "adopting the picks");
    check(ashsplat_image_adopt(context, &speed.description, false, &moved), "adopting the motion");
    AshsplatImage *target = NULL, *walls = NULL, *distances = NULL, *wrong = NULL;
    EXPECT(ashsplat_image_adopt(context, &color.description, true, &wrong) == AshsplatStatus_Argument && wrong == NULL);
    check(ashsplat_image_adopt(context, &color.description, false, &target), "adopting the target");
    check(ashsplat_image_adopt(context, &depth.description, true, &walls), "adopting the depth");
    check(ashsplat_image_adopt(context, &expected.description, false, &distances), "adopting the expected depth");

    AshsplatRenderer *renderer = NULL;
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatReservation wanted;
    memset(&wanted, 0, sizeof wanted);
    wanted.slots = 1;
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

    AshsplatSceneSettings hidden, tinted, cut;
    check(ashsplat_scene_settings(&hidden), "the defaults");
    EXPECT(hidden.visible && hidden.tint[2] == 1 && hidden.opacity == 1 && hidden.sh_degree == 3);
    tinted = cut = hidden;
    hidden.visible = false;
    tinted.tint[0] = 0.5f;
    tinted.opacity = 0.75f;
    /* What lies at x >= 0.55 in the world. */
    AshsplatCutOut half = {AshsplatVolume_HalfSpace, {-1, 0, 0}, -0.55f, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1, true};
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
    AshsplatPose still = {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1};
    AshsplatPlaced placed[5] = {
        {file, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1, NULL, NULL},
        {file, {0, -1, 0, 1, 0, 0, 0, 0, 1}, {-0.8f, 0.4f, -0.5f}, 0.25f, NULL, NULL},
        {own, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1, &tinted, &still},
        {made, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0.3f, 0, 0}, 0.5f, &cut, NULL},
        {file, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1, &hidden, NULL},
    };
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
    AshsplatUpdate update = {file, 10, arrays};
    AshsplatFrame frame;
    memset(&frame, 0, sizeof frame);
    frame.scenes = placed;
    frame.scene_count = 5;
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, 2.6666667f, 0, 0, 0, 0, 0, 1, 0, 0, NEAR, 0};
    check(ashsplat_camera_from_matrices(view, projection, false, WIDTH, HEIGHT, &frame.camera, &frame.depth_mapping),
          "understanding the matrices");
    AshsplatImageState fresh = {LAYOUT_UNDEFINED, 0, 0}, cleared = {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE};
    frame.target = target;
    frame.target_from = fresh;
    frame.behind = AshsplatBackground_Color;
    frame.background[0] = 0.1f;
    frame.background[1] = 0.2f;
    frame.background[2] = 0.3f;
    frame.depth = walls;
    frame.depth_from = cleared;
    frame.expected_depth = distances;
    frame.expected_depth_from = fresh;
    frame.min_weight = 0.5f;
    frame.empty_depth = -1;
    AshsplatPickTarget pick = {picked, fresh, {0, 0}};
    frame.pick = &pick;
    /* The middle of the picture was three pixels further to the left, and lay as high: everything goes to the right. */
    AshsplatMotionTarget motion = {moved, fresh, {0, 0}, frame.camera, 0.5f, {0, -1}, false};
    motion.previous_camera.cx -= 3;
    frame.motion = &motion;
    frame.updates = &update;
    frame.update_count = 1;
    update.first = gaussians;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    update.first = 10;
    frame.target = distances;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    frame.target = target;
    frame.camera.fx = -1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    frame.camera.fx = 160;
    half.volume = 3;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.cut_outs[0].volume: 3, there are 0 to 2") != NULL);
    half.volume = AshsplatVolume_HalfSpace;
    half.size[0] = 0;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.cut_outs[0].volume: a normal") != NULL);
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
    mask.buffer = bits.raw;
    cut.selection_share = -1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[3].settings.selection.share: -1") != NULL);
    cut.selection_share = 0.75f;
    tinted.opacity = 1.5f;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "scenes[2].settings.opacity: 1.5") != NULL);
    tinted.opacity = 0.75f;
    pick.image = NULL;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    pick.image = moved;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "pick.image (image 'target'): format R16G16_SFLOAT is not") != NULL);
    pick.image = picked;
    motion.previous_camera.width = 1;
    EXPECT(ashsplat_record(renderer, commands, 0, &frame, NULL) == AshsplatStatus_Argument);
    EXPECT(strstr(ashsplat_last_error(), "motion.previous_camera: is of 1 x 120") != NULL);
    motion.previous_camera.width = WIDTH;
    AshsplatRelease release;
    check(ashsplat_record(renderer, commands, 0, &frame, &release), "recording");
    host_read(&host, &color, release.target.layout, &pixels);
    host_read(&host, &expected, release.expected_depth.layout, &depths);
    host_read(&host, &who, release.pick.layout, &picks);
    host_read(&host, &speed, release.motion.layout, &motions);
    host_submit_and_wait(&host);
    AshsplatReport report;
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
    int somebody = 0;
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
        /* As half floats 3 and 0, or 0 and -1 where less than half of the pixel is covered; 3 may be rounded. */
        int right = half_floats[i][0], down = half_floats[i][1] & 0x7fff;
        if (distance[i] == -1) {
            EXPECT(right == 0 && half_floats[i][1] == 0xbc00);
        } else {
            EXPECT(right >= 0x41fe && right <= 0x4202 && down < 0x1000);
        }
    }
    EXPECT(somebody > WIDTH * HEIGHT / 10);
    printf("%u of %u Gaussians visible\n", report.visible, report.gaussians);

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
