// Rolling shutter: a camera moves while its rows or columns are read. The camera block has the pose halfway. At time t, from -1/2
// at the first row to 1/2 at the last, a point x in that camera's space is at exp(t turn^) (x - t shift): the camera turns about
// one axis, and its centre moves along a line.
// Needs lens.glsl, SHUTTER, and the push constants of shutter_push.glsl: the turn (axis times angle, at most pi), the shift
// (world units, in the space of the camera halfway), and the row (a, b, c) of the time a x + b y + c of a picture position.

// A point in the space of the camera that reads it, and the time.
struct Reading {
    vec3 at;
    float time;
};

// v turned as the camera turns until a time. The series of sin(w)/w and (1 - cos(w))/w^2 avoid sines, because drivers' sines
// have 11 bits. Their next terms are below float32 up to a quarter turn.
vec3 turned(vec3 v, float time) {
    if (!SHUTTER) {
        return v;
    }
    const uint TERMS = 7;
    vec3 turn = time * shutter_turn;
    float square = dot(turn, turn);
    vec2 c = vec2(1.0);
    for (uint k = TERMS; k > 0; --k) {
        float n = 2.0 * float(k);
        c = 1.0 - c * square / vec2(n * (n + 1.0), (n + 1.0) * (n + 2.0));
    }
    vec3 across = cross(turn, v);
    return v + c.x * across + 0.5 * c.y * cross(turn, across);
}

mat3 turned_columns(mat3 columns, float time) {
    return mat3(turned(columns[0], time), turned(columns[1], time), turned(columns[2], time));
}

// Reading of a point in the space of the camera halfway. The time depends on where the point appears, so it is iterated; the
// six steps are part of the definition. Returns the origin, which no lens shows, if the point is not shown at one of them.
Reading reading_of(vec3 at) {
    Reading reading = Reading(at, 0.0);
    if (SHUTTER) {
        bool shown = true;
        for (uint step = 0; step < 6; ++step) {
            shown = shown && IS_SHOWN(reading.at);
            vec2 screen = screen_of(PROJECTION, reading.at, focal_px, center_px);
            reading.time = clamp(dot(shutter_rows.xy, screen) + shutter_rows.z, -0.5, 0.5);
            reading.at = turned(at - reading.time * shutter_shift, reading.time);
        }
        reading.at = shown ? reading.at : vec3(0.0);
    }
    return reading;
}

// World position of the camera's centre when the shutter reads a point.
vec3 position_reading(vec3 world) {
    if (!SHUTTER) {
        return camera_position();
    }
    float time = reading_of(to_camera(world) + camera_translation).time;
    return from_camera(time * shutter_shift - camera_translation) * inverse_scale_squared;
}
