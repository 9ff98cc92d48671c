// The host's own passes before and after the splats.

@vertex
fn full_screen(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(f32(4u * (i & 1u)) - 1.0, f32(2u * (i & 2u)) - 1.0, 0.0, 1.0);
}

// A vertical gradient, the same as `backdrop` in passes.rs.
@fragment
fn backdrop(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let below = at.y / HEIGHT;
    return vec4f(mix(vec3f(0.5, 0.6, 0.75), vec3f(0.15, 0.125, 0.1), below), 1.0);
}

@group(0) @binding(0) var picture: texture_2d<f32>;

@fragment
fn show(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return vec4f(textureLoad(picture, vec2i(at.xy), 0).rgb, 1.0);
}
