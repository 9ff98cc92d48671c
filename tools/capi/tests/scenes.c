/* Scenes of a host: its files, arrays and buffers, and trees of tiles: scenes TRIAL FILE... */
#include "host.h"

enum { OWN = 64 };

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

/* The same grid in the layout of a scene in the host's own buffers. */
static void fill_planes(float *floats, const AshsplatScenePlan *plan) {
    for (uint32_t i = 0; i < OWN; ++i) {
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

/* Converts a half float that is finite. */
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
    REFUSED(ashsplat_scenes_new(context, all, TOGETHER, scenes), "gaussians[5].sh: the pointer is null");
    EXPECT(scenes[2] == NULL);
    REFUSED(ashsplat_scenes_new(context, all, TOGETHER, NULL), "");
    all[5] = all[4];
    check(ashsplat_scenes_new(context, all, TOGETHER, scenes), "uploading scenes together");
    EXPECT(scenes[TOGETHER - 1] != NULL && scenes[TOGETHER] == NULL);
    for (int i = 0; i < TOGETHER; ++i) {
        placed[i] = place(scenes[i]);
        placed[i].translation[0] = 0.1f * (float)i;
    }
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_renderer_new(context, &renderer), "building a renderer");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    wanted.scenes = TOGETHER;
    /* A scene begins at a block of culling. */
    wanted.gaussians = TOGETHER * 256;
    wanted.width = 160;
    wanted.height = 120;
    check(ashsplat_reserve(renderer, &wanted), "reserving");
    AshsplatCamera camera = look_at(0, 0, -4, ORIGIN, 0.8f, 160, 120);
    AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
    frame.camera = &camera;
    frame.scenes = placed;
    frame.scene_count = TOGETHER;
    check(ashsplat_record(renderer, host_begin(host), 0, &frame, NULL), "recording scenes together");
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

/* A scene in the host's own buffer. */
static AshsplatScene *scene_of_buffer(Host *host, const AshsplatContext *context) {
    AshsplatScene *own = NULL, *none = NULL;
    AshsplatScenePlan plan = ASHSPLAT_INIT(AshsplatScenePlan);
    check(ashsplat_scene_plan(context, OWN, 0, &plan), "planning");
    EXPECT(plan.chunks == 1 && plan.planes == 4 && plan.chunk_gaussians >= OWN);
    EXPECT(plan.chunk_bytes == 64u * plan.chunk_gaussians);
    HostBuffer *planes = host_buffer(host, plan.chunk_bytes, USAGE_BUFFER_COPIES | USAGE_BUFFER_STORAGE);
    grid(0.15f);
    fill_planes(planes->mapped, &plan);
    AshsplatHostBuffer chunk = {planes->raw, 0, plan.chunk_bytes};
    AshsplatHostBuffer bad = {0, 0, plan.chunk_bytes}, small = {planes->raw, 0, 256};
    REFUSED(ashsplat_scene_from_buffers(context, OWN, 0, OWN, &bad, 1, &none), "");
    REFUSED(ashsplat_scene_from_buffers(context, OWN, 0, OWN, &small, 1, &none), "");
    REFUSED(ashsplat_scene_from_buffers(context, OWN, 0, OWN + 1, &chunk, 1, &none), "");
    EXPECT(none == NULL);
    check(ashsplat_scene_from_buffers(context, OWN, 0, OWN, &chunk, 1, &own), "adopting the buffer");
    return own;
}

/* A scene of the host's arrays, whose count changes later. */
static AshsplatScene *scene_of_arrays(const AshsplatContext *context) {
    AshsplatScene *made = NULL, *none = NULL;
    AshsplatGaussians arrays = grid(-0.9f);
    check(ashsplat_scene_new(context, &arrays, 100, &made), "uploading arrays");
    REFUSED(ashsplat_scene_set_count(made, 101), "");
    check(ashsplat_scene_set_count(made, OWN / 2), "fewer Gaussians");
    REFUSED_WITH(arrays.sh_degree, 4, ashsplat_scene_new(context, &arrays, 0, &none), "");
    arrays.sh = NULL;
    REFUSED(ashsplat_scene_new(context, &arrays, 0, &none), "");
    EXPECT(none == NULL);
    return made;
}

/* Images in another role, of another number or with several samples are refused. */
static void refused_images(const AshsplatContext *context, const HostTexture *color, const HostTexture *depth) {
    AshsplatImage *wrong = NULL;
    REFUSED(ashsplat_image_adopt(context, &color->description, AshsplatImageUse_Occluder, &wrong), "");
    REFUSED(ashsplat_image_adopt(context, &color->description, 6, &wrong), "purpose: 6, there are 0 to 5");
    AshsplatForeignImage multisampled = depth->description;
    multisampled.samples = 4;
    REFUSED(ashsplat_image_adopt(context, &multisampled, AshsplatImageUse_Occluder, &wrong),
            "'occluder': it has 4 samples per pixel");
    EXPECT(wrong == NULL);
}

/* A cut-out in the world is converted to a scene that is placed there. */
static void cut_out_in_scene(AshsplatCutOut *half, const AshsplatPlaced *placed) {
    check(ashsplat_cut_out_in_scene(half, placed, half), "bringing a cut-out into a scene");
    EXPECT(half->scale == 2 && half->translation[0] < -0.599f && half->translation[0] > -0.601f && half->removes);
    AshsplatCutOut sheared = *half, unchanged = *half;
    sheared.scene_from_volume[0] = 2;
    REFUSED(ashsplat_cut_out_in_scene(&sheared, placed, &unchanged), "cut_out.pose: is not a rotation");
    AshsplatPlaced nowhere = *placed;
    nowhere.scale = 0;
    REFUSED(ashsplat_cut_out_in_scene(half, &nowhere, &unchanged), "placed.pose: a scale of 0");
    EXPECT(memcmp(&unchanged, half, sizeof unchanged) == 0);
}

/* Several scenes in one frame: own SCENE.ply PICTURE.png DEPTH.bin
 *
 * The scene of the file stands there twice, once scaled; a third is the host's own buffers, written here; the first half
 * of the first is replaced by what an update says. All of it is hidden behind a wall in the host's depth image at z = 4.2.
 */
static void own(char **arguments) {
    enum { WIDTH = 160, HEIGHT = 120, PIXELS = WIDTH * HEIGHT, USAGE = USAGE_IMAGE_STORAGE | USAGE_IMAGE_COPY_FROM };
    const float near = 0.1f, wall_z = 4.2f;
    static Stage stage;
    stage_open(&stage, arguments[0], WIDTH, HEIGHT);
    Host *host = &stage.host;
    AshsplatContext *context = stage.context;
    AshsplatScene *file = stage.scene, *adopted = scene_of_buffer(host, context), *made = scene_of_arrays(context);
    uint32_t gaussians = stage.wanted.gaussians;

    HostTexture *color = host_texture(host, FORMAT_RGBA8, USAGE, WIDTH, HEIGHT);
    HostTexture *depth =
        host_texture(host, FORMAT_D32, USAGE_IMAGE_DEPTH | USAGE_IMAGE_SAMPLED | USAGE_IMAGE_COPY_TO, WIDTH, HEIGHT);
    HostTexture *expected = host_texture(host, FORMAT_R32F, USAGE, WIDTH, HEIGHT);
    HostTexture *who = host_texture(host, FORMAT_RGBA32UI, USAGE, WIDTH, HEIGHT);
    HostTexture *speed = host_texture(host, FORMAT_RG16F, USAGE, WIDTH, HEIGHT);
    HostBuffer *pixels = host_buffer(host, 4 * PIXELS, USAGE_BUFFER_COPIES);
    HostBuffer *depths = host_buffer(host, 4 * PIXELS, USAGE_BUFFER_COPIES);
    HostBuffer *picks = host_buffer(host, 16 * PIXELS, USAGE_BUFFER_COPIES);
    HostBuffer *motions = host_buffer(host, 4 * PIXELS, USAGE_BUFFER_COPIES);
    HostTexture *shape = host_texture(host, FORMAT_RGBA16F, USAGE, WIDTH, HEIGHT);
    HostBuffer *surfaces = host_buffer(host, 8 * PIXELS, USAGE_BUFFER_COPIES);
    refused_images(context, color, depth);
    AshsplatImage *target = stage_image(&stage, color, AshsplatImageUse_Target);
    AshsplatImage *walls = stage_image(&stage, depth, AshsplatImageUse_Occluder);
    AshsplatImage *distances = stage_image(&stage, expected, AshsplatImageUse_Depth);
    AshsplatImage *picked = stage_image(&stage, who, AshsplatImageUse_Pick);
    AshsplatImage *moved = stage_image(&stage, speed, AshsplatImageUse_Motion);
    AshsplatImage *shaped = stage_image(&stage, shape, AshsplatImageUse_Surface);

    AshsplatReservation *wanted = &stage.wanted;
    wanted->scenes = 5;
    wanted->tint = true;
    wanted->cut_outs = 1;
    wanted->selection = true;
    wanted->gaussians = 2 * gaussians + 2 * OWN;
    wanted->occlusion = true;
    wanted->expected_depth = true;
    wanted->pick = true;
    wanted->motion = true;
    wanted->surface = 1 + AshsplatSurfaceDepth_Median;
    wanted->staging_bytes = ashsplat_update_bytes(OWN, wanted->sh_degree);
    stage_reserve(&stage);

    void *commands = host_begin(host);
    /* The wall: reversed depth without a far plane, near / z. */
    ClearDepth wall = {near / wall_z, 0};
    Range whole = {ASPECT_DEPTH, 0, 1, 0, 1};
    host_transition(host, depth, ASPECT_DEPTH, LAYOUT_UNDEFINED, LAYOUT_COPY_TO, ACCESS_TRANSFER_WRITE);
    host->CmdClearDepthStencilImage(commands, depth->raw, LAYOUT_COPY_TO, &wall, 1, &whole);

    AshsplatSceneSettings hidden = ASHSPLAT_INIT(AshsplatSceneSettings), tinted, cut;
    EXPECT(hidden.visible && hidden.tint[2] == 1 && hidden.opacity == 1 && hidden.sh_degree == 3);
    tinted = cut = hidden;
    hidden.visible = false;
    tinted.tint[0] = 0.5f;
    tinted.opacity = 0.75f;
    /* Removes what lies at x >= 0.55 in the world. */
    AshsplatCutOut half = ASHSPLAT_INIT(AshsplatCutOut);
    half.volume = AshsplatVolume_HalfSpace;
    half.size[0] = -1;
    half.offset = -0.55f;
    half.removes = true;
    cut.cut_outs = &half;
    cut.cut_out_count = 1;
    /* Selects the first 16 Gaussians of the grid. */
    HostBuffer *bits = host_buffer(host, 4, USAGE_BUFFER_COPIES | USAGE_BUFFER_STORAGE);
    const uint32_t selected = 0xffff;
    memcpy(bits->mapped, &selected, sizeof selected);
    AshsplatHostBuffer mask = {bits->raw, 0, 4};
    cut.selection = &mask;
    cut.selection_color[0] = 0;
    cut.selection_color[2] = 0.25f;
    cut.selection_share = 0.75f;
    AshsplatPlaced placed[5] = {place(file), place(file), place(adopted), place(made), place(file)};
    const float quarter[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1}, aside[3] = {-0.8f, 0.4f, -0.5f};
    memcpy(placed[1].world_from_object, quarter, sizeof quarter);
    memcpy(placed[1].translation, aside, sizeof aside);
    placed[1].scale = 0.25f;
    placed[2].settings = &tinted;
    placed[3].translation[0] = 0.3f;
    placed[3].scale = 0.5f;
    placed[3].settings = &cut;
    /* In the previous frame it was half a unit lower, so it rises by that much of the screen at its z = 3.55. */
    AshsplatPose lower = ASHSPLAT_INIT(AshsplatPose);
    lower.translation[0] = 0.3f;
    lower.translation[1] = 0.5f;
    lower.scale = 0.5f;
    placed[3].previous_pose = &lower;
    const float rise = 160 * 0.5f / 3.55f;
    placed[4].settings = &hidden;
    cut_out_in_scene(&half, &placed[3]);

    AshsplatGaussians arrays = grid(-0.4f);
    AshsplatUpdate update = ASHSPLAT_INIT(AshsplatUpdate);
    update.scene = file;
    update.first = 10;
    update.gaussians = &arrays;
    AshsplatTarget to = ASHSPLAT_INIT(AshsplatTarget);
    to.behind = AshsplatBackground_Color;
    const float background[3] = {0.1f, 0.2f, 0.3f};
    memcpy(to.background, background, sizeof background);
    AshsplatOccluder occluder = ASHSPLAT_INIT(AshsplatOccluder);
    const float view[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, 2.6666667f, 0, 0, 0, 0, 0, 1, 0, 0, near, 0};
    check(ashsplat_camera_from_matrices(view, projection, false, WIDTH, HEIGHT, &stage.camera, &occluder.mapping),
          "understanding the matrices");
    AshsplatImageState cleared = {LAYOUT_COPY_TO, STAGE_TRANSFER, ACCESS_TRANSFER_WRITE};
    occluder.depth.image = walls;
    occluder.depth.from = cleared;
    AshsplatDepthTarget z = ASHSPLAT_INIT(AshsplatDepthTarget);
    z.to.image = distances;
    z.min_weight = 0.5f;
    z.empty = -1;
    AshsplatPickTarget pick = ASHSPLAT_INIT(AshsplatPickTarget);
    /* The principal point was three pixels further left and equally high, so everything moves to the right. */
    AshsplatCamera before = stage.camera;
    before.cx -= 3;
    AshsplatMotionTarget motion = ASHSPLAT_INIT(AshsplatMotionTarget);
    motion.min_weight = 0.5f;
    motion.empty[1] = -1;
    AshsplatSurfaceTarget surface = ASHSPLAT_INIT(AshsplatSurfaceTarget);
    surface.depth = AshsplatSurfaceDepth_Median;
    AshsplatRecordedFrame *frame = &stage.frame;
    frame->scenes = placed;
    frame->scene_count = 5;
    frame->target = &to;
    frame->occluder = &occluder;
    frame->depth = &z;
    frame->pick = &pick;
    frame->motion = &motion;
    frame->surface = &surface;
    frame->updates = &update;
    frame->update_count = 1;

    to.to.image = target;
    pick.to.image = picked;
    motion.to.image = moved;
    motion.previous_camera = &before;
    surface.to.image = shaped;
    REFUSED_WITH(update.first, gaussians, stage_record(&stage), "");
    REFUSED_WITH(to.to.image, distances, stage_record(&stage), "");
    REFUSED_WITH(stage.camera.fx, -1, stage_record(&stage), "");
    REFUSED_WITH(half.volume, 3, stage_record(&stage), "scenes[3].settings.cut_outs[0].volume: 3, there are 0 to 2");
    REFUSED_WITH(half.size[0], 0, stage_record(&stage), "scenes[3].settings.cut_outs[0].size: a normal");
    REFUSED_WITH(cut.cut_outs, NULL, stage_record(&stage), "scenes[3].settings.cut_outs: the pointer is null");
    /* With too many cut-outs, none is read. */
    cut.cut_outs = (const AshsplatCutOut *)sizeof(AshsplatCutOut);
    REFUSED_WITH(cut.cut_out_count, UINT32_MAX, stage_record(&stage), "scenes[3].settings.cut_outs: 4294967295 of them, there may be 16");
    cut.cut_outs = &half;
    REFUSED_WITH(mask.buffer, 0, stage_record(&stage), "scenes[3].settings.selection: the handle is null");
    REFUSED_WITH(cut.selection_share, -1, stage_record(&stage), "scenes[3].settings.selection_share: -1");
    REFUSED_WITH(tinted.opacity, 1.5f, stage_record(&stage), "scenes[2].settings.opacity: 1.5");
    REFUSED_WITH(pick.to.image, NULL, stage_record(&stage), "pick.to.image: the pointer is null");
    REFUSED_WITH(pick.to.image, moved, stage_record(&stage),
                 "pick (image 'motion'): it was adopted for AshsplatImageUse_Motion, not for AshsplatImageUse_Pick");
    REFUSED_WITH(motion.to.image, NULL, stage_record(&stage), "motion.to.image: the pointer is null");
    REFUSED_WITH(motion.previous_camera, NULL, stage_record(&stage), "motion.previous_camera: the pointer is null");
    REFUSED_WITH(before.projection, 9, stage_record(&stage), "motion.previous_camera.projection: 9, there are 0 to 8");
    REFUSED_WITH(before.projection, AshsplatProjection_Brown, stage_record(&stage), "motion: takes pinholes");
    REFUSED_WITH(before.width, 1, stage_record(&stage), "motion.previous_camera: is of 1 x 120");
    REFUSED_WITH(surface.to.image, NULL, stage_record(&stage), "surface.to.image: the pointer is null");
    REFUSED_WITH(surface.depth, 2, stage_record(&stage), "surface.depth: 2, there are 0 to 1");
    REFUSED_WITH(surface.depth, AshsplatSurfaceDepth_Front, stage_record(&stage),
                 "surface.depth: is Front, and Median is reserved (AshsplatReservation.surface)");
    REFUSED_WITH(lower.scale, 0, stage_record(&stage), "scenes[3].previous_pose: a scale of 0");
    check(stage_record(&stage), "recording");
    host_read(host, color, stage.release.color.layout, pixels);
    host_read(host, expected, stage.release.depth.layout, depths);
    host_read(host, who, stage.release.pick.layout, picks);
    host_read(host, speed, stage.release.motion.layout, motions);
    host_read(host, shape, stage.release.surface.layout, surfaces);
    stage_finish(&stage);
    EXPECT(!stage.report.overflow && stage.report.gaussians == 2 * gaussians + OWN + OWN / 2);

    write_picture(arguments[1], WIDTH, HEIGHT, pixels->mapped);
    write_file(arguments[2], depths->mapped, 4 * PIXELS);
    const uint32_t counts[5] = {gaussians, gaussians, OWN, OWN / 2, 0}, (*pixel)[4] = picks->mapped;
    const uint16_t(*half_floats)[2] = motions->mapped, (*texel)[4] = surfaces->mapped;
    const float *distance = depths->mapped;
    int somebody = 0, rising = 0, solid = 0;
    for (int i = 0; i < PIXELS; ++i) {
        float pick_z, weight;
        memcpy(&pick_z, &pixel[i][2], sizeof pick_z);
        memcpy(&weight, &pixel[i][3], sizeof weight);
        if (pixel[i][1] == UINT32_MAX) {
            EXPECT(pixel[i][0] == UINT32_MAX && pick_z == 0 && weight == 0 && distance[i] == -1);
        } else {
            EXPECT(pixel[i][1] < 5 && pixel[i][0] < counts[pixel[i][1]]);
            EXPECT(pick_z > 2 && pick_z < wall_z && weight > 0 && weight <= 1);
            ++somebody;
        }
        /* A surface is where the splats cover half of the pixel. Its normal is a unit vector towards the camera. */
        float x = of_half(texel[i][0]), y = of_half(texel[i][1]), z = of_half(texel[i][2]), at = of_half(texel[i][3]);
        if (at > 0) {
            float squared = x * x + y * y + z * z;
            EXPECT(distance[i] > 0 && at > 2 && at < wall_z && squared > 0.99f && squared < 1.01f);
            ++solid;
        } else {
            EXPECT(x == 0 && y == 0 && z == 0 && at == 0);
        }
        /* The motion is (0, -1) where less than half of the pixel is covered. */
        float right = of_half(half_floats[i][0]), down = of_half(half_floats[i][1]);
        if (distance[i] == -1) {
            EXPECT(right == 0 && down == -1);
            continue;
        }
        /* The mean motion gives the rising scene's share of the weights, which the pick of this or another scene bounds. */
        float share = -down / rise;
        EXPECT(right > 2.99f && right < 3.01f && share > -0.01f && share < 1.01f);
        if (pixel[i][1] == 3) {
            EXPECT(share > weight - 0.01f);
            rising += weight > 0.25f;
        } else {
            EXPECT(share < 1 - weight + 0.01f);
        }
    }
    EXPECT(rising > 100 && somebody > PIXELS / 10 && solid > PIXELS / 20);
    printf("%u of %u Gaussians visible\n", stage.report.visible, stage.report.gaussians);
    draw_together(host, context);
    ashsplat_scene_free(adopted);
    ashsplat_scene_free(made);
    stage_close(&stage);
}

enum { TILES = 256, BUDGET = 200 };

/* FNV-1a of a tile's numbers. */
static uint32_t print_of(uint32_t print, const float *numbers, uint32_t count) {
    const unsigned char *bytes = (const unsigned char *)numbers;
    for (uint32_t i = 0; i < 4 * count; ++i) {
        print = (print ^ bytes[i]) * 16777619u;
    }
    return print;
}

static void refused_demands(const AshsplatTree *tree, const AshsplatDemand *good, uint32_t tile_count) {
    uint32_t chosen[TILES], chosen_count = 77;
    AshsplatTree *none = (AshsplatTree *)1;
    EXPECT(ashsplat_tree_open("/no/such/folder", &none) == AshsplatStatus_File && none == NULL && said("tileset.json"));
    REFUSED(ashsplat_tree_open(NULL, &none), "folder: the pointer is null");
    AshsplatTile properties = ASHSPLAT_INIT(AshsplatTile);
    REFUSED(ashsplat_tree_tile(tree, tile_count, &properties), "tile: ");
    REFUSED(ashsplat_tree_tile(tree, 0, NULL), "properties: the pointer is null");
    AshsplatTileGaussians *nothing = (AshsplatTileGaussians *)1;
    REFUSED(ashsplat_tree_read(tree, tile_count, &nothing), "tile: ");
    EXPECT(nothing == NULL);
    AshsplatDemand bad = *good;
    bad.camera_count = 0;
    REFUSED(ashsplat_tree_wanted(tree, &bad, NULL, chosen, &chosen_count), "demand.cameras: there are none");
    EXPECT(chosen_count == 77);
    bad = *good;
    bad.border = -1;
    REFUSED(ashsplat_tree_cut(tree, &bad, NULL, chosen, &chosen_count), "demand.border");
    AshsplatCamera camera = *good->cameras;
    camera.fx = 0;
    bad = *good;
    bad.cameras = &camera;
    REFUSED(ashsplat_tree_cut(tree, &bad, NULL, chosen, &chosen_count), "demand.cameras[0]: focal length");
    REFUSED(ashsplat_tree_cut(tree, NULL, NULL, chosen, &chosen_count), "demand: the pointer is null");
    REFUSED(ashsplat_tree_cut(tree, good, NULL, NULL, &chosen_count), "tiles: the pointer is null");
    ashsplat_tree_free(NULL);
    ashsplat_tile_gaussians_free(NULL);
}

/* A tree of tiles in a host's frames: tiles FOLDER
 *
 * Each tile that is wanted is read and written to a scene by a frame's update, one per frame; what is there is drawn. Prints the
 * tiles of the last frame, and how many Gaussians and instances it had.
 */
static void tiles(char **arguments) {
    enum { WIDTH = 110, HEIGHT = 70 };
    static AshsplatScene *scenes[TILES];
    static bool there[TILES];
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    AshsplatTree *tree = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    check(ashsplat_tree_open(arguments[0], &tree), "opening the tree");
    uint32_t tile_count = 0, most = 0, degree = 0;
    check(ashsplat_tree_size(tree, &tile_count), "asking for its size");
    EXPECT(tile_count > 20 && tile_count <= TILES);
    AshsplatTile root = ASHSPLAT_INIT(AshsplatTile);
    for (uint32_t tile = tile_count; tile-- > 0;) {
        check(ashsplat_tree_tile(tree, tile, &root), "asking for a tile");
        most = root.gaussians > most ? root.gaussians : most;
        EXPECT(root.gaussians > 0 && root.min[0] < root.max[0]);
    }
    EXPECT(root.error > 0);

    const float at[3] = {0, 0, -1};
    AshsplatCamera camera = look_at(0, 0, 0.2f, at, 1.2f, WIDTH, HEIGHT);
    AshsplatDemand demand = ASHSPLAT_INIT(AshsplatDemand);
    demand.cameras = &camera;
    demand.camera_count = 1;
    demand.budget = BUDGET;
    refused_demands(tree, &demand, tile_count);

    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);
    AshsplatSlotReport report = ASHSPLAT_INIT(AshsplatSlotReport);
    uint32_t drawn[TILES], drawn_count = 0, frames = 0, prints[TILES] = {0};
    for (bool all_there = false; !all_there; ++frames) {
        uint32_t chosen[TILES], chosen_count = 0, next = TILES;
        check(ashsplat_tree_wanted(tree, &demand, NULL, chosen, &chosen_count), "asking what is wanted");
        EXPECT(chosen_count > 0 && chosen[0] == 0);
        for (uint32_t i = 0; i < chosen_count && next == TILES; ++i) {
            next = there[chosen[i]] ? TILES : chosen[i];
        }
        all_there = next == TILES;
        AshsplatTileGaussians *read = NULL;
        AshsplatGaussians gaussians = ASHSPLAT_INIT(AshsplatGaussians);
        AshsplatUpdate update = ASHSPLAT_INIT(AshsplatUpdate);
        if (!all_there) {
            check(ashsplat_tree_read(tree, next, &read), "reading a tile");
            check(ashsplat_tile_gaussians(read, &gaussians), "its arrays");
            if (frames == 0) {
                degree = wanted.sh_degree = gaussians.sh_degree;
                wanted.gaussians = tile_count * most;
                wanted.scenes = tile_count;
                wanted.width = WIDTH;
                wanted.height = HEIGHT;
                wanted.staging_bytes = ashsplat_update_bytes(most, degree);
                check(ashsplat_reserve(renderer, &wanted), "reserving");
            }
            AshsplatGaussians empty = ASHSPLAT_INIT(AshsplatGaussians);
            empty.sh_degree = degree;
            check(ashsplat_scene_new(context, &empty, most, &scenes[next]), "an empty scene");
            check(ashsplat_scene_set_count(scenes[next], gaussians.count), "its number");
            update.scene = scenes[next];
            update.gaussians = &gaussians;
            there[next] = true;
            uint32_t n = gaussians.count, terms = 3 * (degree + 1) * (degree + 1), print = 2166136261u;
            print = print_of(print_of(print, gaussians.means, 3 * n), gaussians.quats, 4 * n);
            print = print_of(print_of(print, gaussians.log_scales, 3 * n), gaussians.opacity_logits, n);
            prints[next] = print_of(print, gaussians.sh, terms * n);
            bool antialiased = true;
            const char *warnings = NULL;
            check(ashsplat_tile_notes(read, &antialiased, &warnings), "what its file says");
            EXPECT(!antialiased && warnings != NULL && warnings[0] == 0);
            check(ashsplat_tile_notes(read, NULL, NULL), "nothing of it");
        }
        check(ashsplat_tree_cut(tree, &demand, there, drawn, &drawn_count), "asking what is drawn");
        EXPECT(drawn_count > 0);
        AshsplatPlaced placed[TILES];
        for (uint32_t i = 0; i < drawn_count; ++i) {
            placed[i] = place(scenes[drawn[i]]);
        }
        AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
        frame.camera = &camera;
        frame.scenes = placed;
        frame.scene_count = drawn_count;
        frame.updates = all_there ? NULL : &update;
        frame.update_count = all_there ? 0 : 1;
        check(ashsplat_record(renderer, host_begin(&host), 0, &frame, NULL), "recording");
        /* The recording has its own copy of the Gaussians. */
        ashsplat_tile_gaussians_free(read);
        host_submit_and_wait(&host);
        check(ashsplat_slot_report(renderer, 0, &report), "asking for the report");
        EXPECT(report.finished && !report.overflow);
    }
    /* Any number but 0 says that a tile is there. */
    unsigned char all[TILES];
    uint32_t again[TILES], again_count = 0;
    memset(all, 0xff, sizeof all);
    check(ashsplat_tree_cut(tree, &demand, (const bool *)all, again, &again_count), "asking with all there");
    EXPECT(again_count == drawn_count && memcmp(again, drawn, 4 * drawn_count) == 0);
    /* Without its children a tile is drawn itself, and nothing is wanted below one that cannot be loaded. */
    bool only_root[TILES] = {true};
    uint32_t coarse[TILES], coarse_count = 0;
    check(ashsplat_tree_cut(tree, &demand, only_root, coarse, &coarse_count), "asking with the coarsest alone");
    EXPECT(coarse_count == 1 && coarse[0] == 0);
    check(ashsplat_tree_wanted(tree, &demand, only_root, coarse, &coarse_count), "asking what is possible");
    EXPECT(coarse_count == 1);

    printf("%u frames %u %u", frames, report.visible, report.instances_needed);
    for (uint32_t i = 0; i < drawn_count; ++i) {
        printf(" %u %u", drawn[i], prints[drawn[i]]);
    }
    printf("\n");
    ashsplat_renderer_free(renderer);
    for (uint32_t tile = 0; tile < tile_count; ++tile) {
        ashsplat_scene_free(scenes[tile]);
    }
    ashsplat_tree_free(tree);
    ashsplat_context_free(context);
    host_close(&host);
}

/* Prints the number of Gaussians, the degree and the sum of a picture of each file: formats FILE... */
static void formats(char **arguments) {
    enum { WIDTH = 64, HEIGHT = 48, FLOATS = 3 * WIDTH * HEIGHT };
    AshsplatContext *context = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_new(NULL, &context), "opening a device");
    check(ashsplat_renderer_new(context, &renderer), "building the renderer");
    AshsplatCamera camera = look_at(0, -1, -4, ORIGIN, 0.7f, WIDTH, HEIGHT);
    static float rgb[FLOATS];
    for (; *arguments != NULL; ++arguments) {
        AshsplatScene *scene = NULL;
        uint32_t gaussians = 0, sh_degree = 0;
        check(ashsplat_scene_load(context, *arguments, &scene), "loading a scene");
        check(ashsplat_scene_size(scene, &gaussians, &sh_degree), "asking for its size");
        check(ashsplat_render(renderer, scene, &camera, NULL, ORIGIN, rgb), "rendering");
        double sum = 0;
        for (int k = 0; k < FLOATS; ++k) {
            sum += (double)rgb[k];
        }
        printf("%u %u %.9g\n", gaussians, sh_degree, sum);
        ashsplat_scene_free(scene);
    }
    ashsplat_renderer_free(renderer);
    ashsplat_context_free(context);
}

int main(int count, char **arguments) {
    TRIAL(own)
    TRIAL(tiles)
    TRIAL(formats)
    return 1;
}
