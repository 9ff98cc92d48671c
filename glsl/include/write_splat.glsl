// Attributes of a visible Gaussian, for projection of one scene and of a batch. Needs the requirements of project_gaussian.glsl with
// DRAWS_SHAPES; sh_planes.glsl, splat_record.glsl; the buffers of project.comp; Z_RECORD, SHARED_ORDER and DISTANCE_ORDER; and
// `highlighted`, which gives a selected Gaussian its colour.

vec3 tinted(vec3 color) {
    return TINTED ? min(color * scene_tint, vec3(TINTED_COLOR_MAX)) : color;
}

// `index` is the index of the Gaussian in its range of parameters.
void write_splat(uint visible, uint index) {
    vec4 mean_opacity = VEC4_AT(parameters, plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians));
    vec4 quat = VEC4_AT(parameters, plane_at(PLANE_QUAT, index, chunk_gaussians));
    vec4 log_scale = VEC4_AT(parameters, plane_at(PLANE_LOG_SCALE, index, chunk_gaussians));
    Filtered filtered = filter_3d(log_scale, mean_opacity.w);
    ProjectedGaussian p = project_gaussian(mean_opacity.xyz, quat, filtered.log_scale);
    Footprint f = footprint_of(p, filtered.opacity_logit);

    vec3 direction = direction_to(PROJECTION, mean_opacity.xyz);
    vec3 color = sh_color(index, direction);
    // A coefficient that is not finite must not reach the pixels.
    bool valid = is_finite(color.x) && is_finite(color.y) && is_finite(color.z);
    color = valid ? color : vec3(0.0);

    vec4 mean2d = vec4(f.mean2d_px, f.half_extent_px);
    vec4 conic = vec4(vec3(p.cov2d.z, -p.cov2d.y, p.cov2d.x) / p.det, f.opacity);
    uvec3 shape = extent == EXTENT_REFERENCE ? uvec3(pack_tiles(f.tiles), f.radius_px) : row_shape(mean2d, conic);
    uvec2 list = list_tiles(mean2d, shape, f.tiles, (image_width + TILE_SIZE - 1) / TILE_SIZE);
    if (SHARED_ORDER) {
        list = f.visible ? list : uvec2(0);
    }
    mean2d_extent[splat_at(visible, SPLAT_MEAN2D_EXTENT)] = mean2d;
    conic_opacity[splat_at(visible, SPLAT_CONIC_OPACITY)] = conic;
    color_inverse_depth[splat_at(visible, SPLAT_COLOR_INVERSE_DEPTH)] =
        vec4(highlighted(tinted(max(color, vec3(0.0))), index), Z_RECORD ? DEPTH_OF(p.mean_camera) : 1.0 / DEPTH_OF(p.mean_camera));
    // Culling may have rounded differently, so the depth may lie slightly before the near plane.
    float depth = max(DISTANCE_ORDER ? length(p.mean_camera) : DEPTH_OF(p.mean_camera), NEAR_PLANE);
    uint depth_key = floatBitsToUint(depth) - floatBitsToUint(NEAR_PLANE);
    depth_keys[visible] = min(depth_key, (1u << DEPTH_KEY_BITS) - 1);
    footprints[splat_at(visible, SPLAT_FOOTPRINT)] = uvec4(shape, tiles_met(list));
    tile_lists[visible] = list;
}
