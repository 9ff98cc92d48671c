// Words of the lens, behind the members of a scene's camera block: see lens.glsl.
vec4 lens_a;
vec4 lens_b;
float lens_c;
