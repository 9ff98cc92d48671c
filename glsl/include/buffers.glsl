// Each buffer has two forms. A shader with this include is compiled twice: unchanged, and with TEXELS for drivers of
// processors. The TEXELS form reads by texel, a quarter of the work there (engine/vk/format.rs), and can write 64 bits at once.
// On a processor each store is a loop over the lanes, and each lane recomputes its address unless stores share it. The wide
// store pays if a kernel mostly stores. `Limits::prefers_texels` selects the form for a device. Both forms have the same
// interface and give the same bits.
//
// VEC4_READS(binding, Block, name); declares a buffer, VEC4_AT(name, index) reads from it; likewise for other types.
// VEC4_WRITES and VEC4_PUT(name, index, value) write, likewise for uvec4.
//
// ALIASED marks each of two buffers that may be bound to the same memory, if one of them is written. It is SPIR-V's decoration,
// without which a compiler assumes different memory. The hazard checker finds missing ones.
#extension GL_EXT_spirv_intrinsics : require
#define ALIASED spirv_decorate(20)

#ifdef TEXELS
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require

#define VEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform textureBuffer NAME
#define UVEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform textureBuffer NAME
#define VEC2_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME
#define UVEC2_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME
#define UINT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME
#define FLOAT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING) uniform utextureBuffer NAME

#define UINT_AT(NAME, INDEX) texelFetch(NAME, int(INDEX)).x
#define FLOAT_AT(NAME, INDEX) uintBitsToFloat(UINT_AT(NAME, INDEX))
#define VEC2_AT(NAME, INDEX) vec2(FLOAT_AT(NAME, 2 * (INDEX)), FLOAT_AT(NAME, 2 * (INDEX) + 1))
#define UVEC2_AT(NAME, INDEX) uvec2(UINT_AT(NAME, 2 * (INDEX)), UINT_AT(NAME, 2 * (INDEX) + 1))
#define VEC4_AT(NAME, INDEX) texelFetch(NAME, int(INDEX))
#define UVEC4_AT(NAME, INDEX) floatBitsToUint(texelFetch(NAME, int(INDEX)))

#define VEC4_WRITES(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) writeonly buffer BLOCK { u64vec2 NAME[]; }

#define UVEC4_WRITES(BINDING, BLOCK, NAME) VEC4_WRITES(BINDING, BLOCK, NAME)

// With a value that is computed within the store, Adam takes 1.5 times as long on llvmpipe.
#define UVEC4_PUT(NAME, INDEX, VALUE) \
    { \
        uvec4 words_ = VALUE; \
        u64vec2 stored_ = u64vec2(packUint2x32(words_.xy), packUint2x32(words_.zw)); \
        NAME[INDEX] = stored_; \
    }
#define VEC4_PUT(NAME, INDEX, VALUE) UVEC4_PUT(NAME, INDEX, floatBitsToUint(VALUE))
#else
#define VEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { vec4 NAME[]; }
#define UVEC4_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { uvec4 NAME[]; }
#define VEC2_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { vec2 NAME[]; }
#define UVEC2_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { uvec2 NAME[]; }
#define UINT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { uint NAME[]; }
#define FLOAT_READS(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) readonly buffer BLOCK { float NAME[]; }

#define UINT_AT(NAME, INDEX) NAME[INDEX]
#define FLOAT_AT(NAME, INDEX) NAME[INDEX]
#define VEC2_AT(NAME, INDEX) NAME[INDEX]
#define UVEC2_AT(NAME, INDEX) NAME[INDEX]
#define VEC4_AT(NAME, INDEX) NAME[INDEX]
#define UVEC4_AT(NAME, INDEX) NAME[INDEX]

#define VEC4_WRITES(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) writeonly buffer BLOCK { vec4 NAME[]; }
#define UVEC4_WRITES(BINDING, BLOCK, NAME) layout(set = 0, binding = BINDING, scalar) writeonly buffer BLOCK { uvec4 NAME[]; }

#define UVEC4_PUT(NAME, INDEX, VALUE) NAME[INDEX] = VALUE
#define VEC4_PUT(NAME, INDEX, VALUE) NAME[INDEX] = VALUE
#endif
