// The window by sweeps in registers: an invocation goes down STRIP columns of one channel. It windows each row along the
// row, and adds the result to the windows of the eleven rows around it, ten of which wait for more.
// Needs ssim.glsl, ssim_planes.glsl, dispatch.glsl, STRIP, SWEPT (vec3 or vec4: what is windowed together), and the push constants
// image_width, image_height, groups, first_channel, invocations, rows.

const uint SWEEP_ROW = STRIP + 2 * SSIM_RADIUS;
const uint SWEEP_WAITING = SSIM_TAPS - 1;
// Texels of a plane that a sweep reads of a row, and those of them that its own columns lie in, from the second on.
const uint SWEEP_TEXELS = (SWEEP_ROW + 3) / 4;
const uint OWN_TEXELS = (SSIM_RADIUS % 4 + STRIP + 3) / 4;

// Values of the current row, from SSIM_RADIUS columns left of the strip to SSIM_RADIUS right of it.
SWEPT sweep_row[SWEEP_ROW];
// Windows of the rows below the one that is complete next.
SWEPT sweep_waiting[SWEEP_WAITING][STRIP];

// The part of an invocation: `first` is its first pixel, rows `first.y` to `end_y` - 1 are its own.
struct Sweep {
    bool exists;
    uint channel;
    ivec2 first;
    int end_y;
};

Sweep sweep_of_invocation() {
    uint invocation = linear_invocation();
    uint strips = (image_width + STRIP - 1) / STRIP;
    uint per_channel = strips * ((image_height + rows - 1) / rows);
    Sweep sweep;
    sweep.exists = invocation < invocations;
    uint at = sweep.exists ? invocation : 0;
    sweep.channel = first_channel + at / per_channel;
    sweep.first = ivec2(at % strips * STRIP, at % per_channel / strips * rows);
    sweep.end_y = min(sweep.first.y + int(rows), int(image_height));
    [[unroll]] for (uint k = 0; k < SWEEP_WAITING; ++k) {
        [[unroll]] for (uint c = 0; c < STRIP; ++c) {
            sweep_waiting[k][c] = SWEPT(0.0);
        }
    }
    return sweep;
}

// Where texel t of those that a sweep reads of a row of a plane lies, see ssim_planes.glsl.
uint sweep_texel(Sweep sweep, uint plane, uint t, int y) {
    return plane_texel(plane, uint(sweep.first.x) / 4 + t) + uint(y) * GROUP_TEXELS;
}

// Takes the current row in, and returns the window of a column SSIM_RADIUS rows above it. Once per row and column.
SWEPT sweep_window(uint column) {
    SWEPT along_row = SSIM_WINDOW[SSIM_RADIUS] * sweep_row[column + SSIM_RADIUS];
    [[unroll]] for (uint tap = 0; tap < SSIM_RADIUS; ++tap) {
        along_row += SSIM_WINDOW[tap] * (sweep_row[column + tap] + sweep_row[column + 2 * SSIM_RADIUS - tap]);
    }
    SWEPT complete = sweep_waiting[0][column] + SSIM_WINDOW[0] * along_row;
    [[unroll]] for (uint k = 1; k < SWEEP_WAITING; ++k) {
        sweep_waiting[k - 1][column] = sweep_waiting[k][column] + SSIM_WINDOW[k] * along_row;
    }
    sweep_waiting[SWEEP_WAITING - 1][column] = SSIM_WINDOW[SWEEP_WAITING] * along_row;
    return complete;
}
