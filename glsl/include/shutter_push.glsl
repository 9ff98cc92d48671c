#ifdef LENSES
    // Motion of the camera, zeros without SHUTTER: see shutter.glsl.
    vec3 shutter_turn;
    vec3 shutter_shift;
    vec3 shutter_rows;
#endif
