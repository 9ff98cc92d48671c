// Feature maps of a convolutional network, four channels per vec4: for each picture, block of four channels, row and column. A
// network runs in bands of rows, so a map only holds a window of its rows, row y in slot y % slots. One row of zeros follows
// the slots, and `margin` columns of zeros lie left and right of each row: the values that a convolution reads outside a map.

// Number of vec4 in one block of four channels.
uint map_plane(uint slots, uint pitch) {
    return (slots + 1) * pitch;
}

// Slot of a row; the slot of zeros for rows above and below the map.
uint map_slot(int y, uint height, uint slots) {
    return y < 0 || y >= int(height) ? slots : uint(y) % slots;
}
