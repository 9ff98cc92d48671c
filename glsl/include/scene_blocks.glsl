// Camera blocks of all scenes of a frame, scene by scene: the same bytes as the uniform blocks of camera_block.glsl.
// Needs constants.glsl, and SCENE_BLOCKS, the number of the binding.

struct SceneBlock {
#include "camera_members.glsl"
#ifdef LENSES
#include "lens_members.glsl"
#else
    // Padding to the device's alignment of uniform blocks. engine/kernels/compile.rs counts CAMERA_BLOCK_MEMBERS.
    uint unused[CAMERA_BLOCK_WORDS - CAMERA_BLOCK_MEMBERS];
#endif
};

layout(set = 0, binding = SCENE_BLOCKS, scalar) readonly buffer SceneBlocks { SceneBlock scene_blocks[]; };
