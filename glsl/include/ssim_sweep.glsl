// Evaluates the window by sweeps in registers: an invocation moves along a strip of one channel (strips.glsl). It convolves
// each column vertically, and adds the result to the windows of the eleven columns around it. Ten of these windows are
// incomplete after each step.
// Needs ssim.glsl, strips.glsl, dispatch.glsl, SWEPT (vec3 or vec4: the values convolved together), and the push constants
// image_width, image_height, first_channel, invocations, columns.

const uint SWEEP_VALUES = STRIP_ROWS + 2 * SSIM_RADIUS;
const uint SWEEP_WAITING = SSIM_TAPS - 1;

// Values of the current column, from SSIM_RADIUS rows above the strip to SSIM_RADIUS below it.
SWEPT sweep_values[SWEEP_VALUES];
// Incomplete windows, for the columns to the right of the next complete one.
SWEPT sweep_waiting[SWEEP_WAITING][STRIP_ROWS];

// Work of one invocation: columns `first_x` to `end_x` - 1 of a strip.
struct Sweep {
    bool exists;
    uint channel;
    uint strip;
    int first_x;
    int end_x;
    bool has_above;
    bool has_below;
};

Sweep sweep_of_invocation() {
    uint invocation = linear_invocation();
    uint strips = strips_of_image();
    uint per_channel = strips * ((image_width + columns - 1) / columns);
    Sweep sweep;
    sweep.exists = invocation < invocations;
    uint at = sweep.exists ? invocation : 0;
    sweep.channel = first_channel + at / per_channel;
    sweep.strip = at % strips;
    sweep.first_x = int(at % per_channel / strips * columns);
    sweep.end_x = min(sweep.first_x + int(columns), int(image_width));
    sweep.has_above = sweep.strip > 0;
    sweep.has_below = sweep.strip + 1 < strips;
    [[unroll]] for (uint k = 0; k < SWEEP_WAITING; ++k) {
        [[unroll]] for (uint row = 0; row < STRIP_ROWS; ++row) {
            sweep_waiting[k][row] = SWEPT(0.0);
        }
    }
    return sweep;
}

// Indices of a plane's column in the strips above, at and below a sweep. A missing strip is replaced by a readable one.
uvec3 sweep_columns(Sweep sweep, uint plane, uint x) {
    uint own = strip_column(plane, sweep.strip, x);
    return uvec3(sweep.has_above ? own - strip_pitch() : own, own, sweep.has_below ? own + strip_pitch() : own);
}

// Adds the current column, and returns the window of a row SSIM_RADIUS columns to its left. Called once per column and row.
SWEPT sweep_window(uint row) {
    SWEPT along_column = SSIM_WINDOW[SSIM_RADIUS] * sweep_values[row + SSIM_RADIUS];
    [[unroll]] for (uint tap = 0; tap < SSIM_RADIUS; ++tap) {
        along_column += SSIM_WINDOW[tap] * (sweep_values[row + tap] + sweep_values[row + 2 * SSIM_RADIUS - tap]);
    }
    SWEPT complete = sweep_waiting[0][row] + SSIM_WINDOW[0] * along_column;
    [[unroll]] for (uint k = 1; k < SWEEP_WAITING; ++k) {
        sweep_waiting[k - 1][row] = sweep_waiting[k][row] + SSIM_WINDOW[k] * along_column;
    }
    sweep_waiting[SWEEP_WAITING - 1][row] = SSIM_WINDOW[SWEEP_WAITING] * along_column;
    return complete;
}
