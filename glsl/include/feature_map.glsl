// Maps of features of a convolutional network, four channels to a vec4: for each picture, block of four channels, row and
// column. A map holds a window of its rows, row y in slot y % slots: a network runs in bands of rows, and no map is ever
// whole. Behind the slots lies one row of zeros, and left and right of each row `margin` columns of zeros: what a convolution
// reads outside of a map.

// vec4s of one block of four channels.
uint map_plane(uint slots, uint pitch) {
    return (slots + 1) * pitch;
}

// Slot of a row; that of zeros above and below the map.
uint map_slot(int y, uint height, uint slots) {
    return y < 0 || y >= int(height) ? slots : uint(y) % slots;
}
