/* A tree of tiles in a host's frames, in C: tiles FOLDER
 *
 * Each tile that is wanted is read and written to a scene by a frame's update, one per frame; what is there is drawn. Prints the
 * tiles of the last frame, and how many Gaussians and instances it had.
 */
#include "host.h"

enum { WIDTH = 110, HEIGHT = 70, TILES = 256, BUDGET = 200 };

static AshsplatScene *scenes[TILES];
static bool there[TILES];

static AshsplatDemand demand_of(const AshsplatCamera *camera, uint64_t budget) {
    AshsplatDemand demand = ASHSPLAT_INIT(AshsplatDemand);
    demand.cameras = camera;
    demand.camera_count = 1;
    demand.budget = budget;
    return demand;
}

/* FNV-1a of a tile's numbers. */
static uint32_t print_of(uint32_t print, const float *numbers, uint32_t count) {
    const unsigned char *bytes = (const unsigned char *)numbers;
    for (uint32_t i = 0; i < 4 * count; ++i) {
        print = (print ^ bytes[i]) * 16777619u;
    }
    return print;
}

static bool said(const char *text) { return strstr(ashsplat_last_error(), text) != NULL; }

static void refusals(const AshsplatTree *tree, const AshsplatDemand *good, uint32_t tile_count) {
    uint32_t chosen[TILES], chosen_count = 77;
    AshsplatTree *none = (AshsplatTree *)1;
    EXPECT(ashsplat_tree_open("/no/such/folder", &none) == AshsplatStatus_File && none == NULL && said("tileset.json"));
    EXPECT(ashsplat_tree_open(NULL, &none) == AshsplatStatus_Argument && said("folder: the pointer is null"));
    AshsplatTile told = ASHSPLAT_INIT(AshsplatTile);
    EXPECT(ashsplat_tree_tile(tree, tile_count, &told) == AshsplatStatus_Argument && said("tile: "));
    EXPECT(ashsplat_tree_tile(tree, 0, NULL) == AshsplatStatus_Argument && said("told: the pointer is null"));
    AshsplatTileGaussians *nothing = (AshsplatTileGaussians *)1;
    EXPECT(ashsplat_tree_read(tree, tile_count, &nothing) == AshsplatStatus_Argument && nothing == NULL && said("tile: "));
    AshsplatDemand bad = *good;
    bad.camera_count = 0;
    EXPECT(ashsplat_tree_wanted(tree, &bad, NULL, chosen, &chosen_count) == AshsplatStatus_Argument);
    EXPECT(said("demand.cameras: there are none") && chosen_count == 77);
    bad = *good;
    bad.border = -1;
    EXPECT(ashsplat_tree_cut(tree, &bad, NULL, chosen, &chosen_count) == AshsplatStatus_Argument && said("demand.border"));
    AshsplatCamera camera = *good->cameras;
    camera.fx = 0;
    bad = *good;
    bad.cameras = &camera;
    EXPECT(ashsplat_tree_cut(tree, &bad, NULL, chosen, &chosen_count) == AshsplatStatus_Argument);
    EXPECT(said("demand.cameras[0]: focal length"));
    EXPECT(ashsplat_tree_cut(tree, NULL, NULL, chosen, &chosen_count) == AshsplatStatus_Argument && said("demand: the pointer is null"));
    EXPECT(ashsplat_tree_cut(tree, good, NULL, NULL, &chosen_count) == AshsplatStatus_Argument && said("tiles: the pointer is null"));
    ashsplat_tree_free(NULL);
    ashsplat_tile_gaussians_free(NULL);
}

int main(int count, char **arguments) {
    EXPECT(count == 2);
    static Host host;
    host_open(&host);
    AshsplatContext *context = NULL;
    AshsplatTree *tree = NULL;
    AshsplatRenderer *renderer = NULL;
    check(ashsplat_context_from_foreign(&host.handles, &context), "being a guest");
    check(ashsplat_tree_open(arguments[1], &tree), "opening the tree");
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

    AshsplatCamera camera = ASHSPLAT_INIT(AshsplatCamera);
    const float eye[3] = {0, 0, 0.2f}, at[3] = {0, 0, -1}, up[3] = {0, -1, 0};
    check(ashsplat_camera_look_at(eye, at, up, 1.2f, WIDTH, HEIGHT, &camera), "a camera");
    AshsplatDemand demand = demand_of(&camera, BUDGET);
    refusals(tree, &demand, tile_count);

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
            check(ashsplat_tile_told(read, &antialiased, &warnings), "what its file says");
            EXPECT(!antialiased && warnings != NULL && warnings[0] == 0);
            check(ashsplat_tile_told(read, NULL, NULL), "nothing of it");
        }
        check(ashsplat_tree_cut(tree, &demand, there, drawn, &drawn_count), "asking what is drawn");
        EXPECT(drawn_count > 0);
        AshsplatPlaced placed[TILES];
        for (uint32_t i = 0; i < drawn_count; ++i) {
            placed[i] = ASHSPLAT_INIT(AshsplatPlaced);
            placed[i].scene = scenes[drawn[i]];
        }
        AshsplatRecordedFrame frame = ASHSPLAT_INIT(AshsplatRecordedFrame);
        frame.camera = &camera;
        frame.scenes = placed;
        frame.scene_count = drawn_count;
        frame.updates = all_there ? NULL : &update;
        frame.update_count = all_there ? 0 : 1;
        void *commands = host_begin(&host);
        check(ashsplat_record(renderer, commands, 0, &frame, NULL), "recording");
        /* The recording has a copy. */
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
    /* Without the tiles below it, a tile is drawn itself; nothing is wanted below one that cannot be there. */
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
    return 0;
}
