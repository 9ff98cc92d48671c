// Read-only buffers in two forms. A shader with this include is compiled twice: as it stands, and with TEXELS, which reads
// by texel: to a processor's driver a quarter of the work (engine/vk/texels.rs). A device gets the form that
// `Limits::prefers_texels` says; both have the same interface and give the same bits.
//
// VEC4_READS(binding, Block, name); declares a buffer, VEC4_AT(name, index) reads from it; likewise for other types.

#ifdef TEXELS
#extension GL_EXT_samplerless_texture_functions : require

#define VEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform textureBuffer NAME
#define UVEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform textureBuffer NAME
#define VEC2_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME
#define UINT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME
#define FLOAT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME

#define UINT_AT(NAME, INDEX) texelFetch(NAME, int(INDEX)).x
#define FLOAT_AT(NAME, INDEX) uintBitsToFloat(UINT_AT(NAME, INDEX))
#define VEC2_AT(NAME, INDEX) vec2(FLOAT_AT(NAME, 2 * (INDEX)), FLOAT_AT(NAME, 2 * (INDEX) + 1))
#define VEC4_AT(NAME, INDEX) texelFetch(NAME, int(INDEX))
#define UVEC4_AT(NAME, INDEX) floatBitsToUint(texelFetch(NAME, int(INDEX)))
#else
#define VEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { vec4 NAME[]; }
#define UVEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { uvec4 NAME[]; }
#define VEC2_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { vec2 NAME[]; }
#define UINT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { uint NAME[]; }
#define FLOAT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { float NAME[]; }

#define UINT_AT(NAME, INDEX) NAME[INDEX]
#define FLOAT_AT(NAME, INDEX) NAME[INDEX]
#define VEC2_AT(NAME, INDEX) NAME[INDEX]
#define VEC4_AT(NAME, INDEX) NAME[INDEX]
#define UVEC4_AT(NAME, INDEX) NAME[INDEX]
#endif
