//! Positions on the Z-order curve by which densification orders Gaussians: the twin of `densify/zorder`.

/// Number of cells per axis.
const CELLS: f64 = 1024.0;

/// Cell of a coordinate: space folded into (-1, 1) about the middle of the cameras, in scene extents.
pub fn cell(place: f64, center: f64, extent: f64) -> f64 {
    let distance = (place - center) / extent;
    let folded = distance / (1.0 + distance.abs());
    if !distance.is_finite() { 0.0 } else { ((0.5 + 0.5 * folded) * CELLS).min(CELLS - 1.0) }
}

/// Number of a position on the curve: the bits of its cells interleaved, x lowest.
pub fn zorder(place: [f64; 3], center: [f64; 3], extent: f64) -> u32 {
    let mut key = 0;
    for axis in 0..3 {
        let cell = cell(place[axis], center[axis], extent) as u32;
        for bit in 0..10 {
            key |= (cell >> bit & 1) << (3 * bit + axis as u32);
        }
    }
    key
}
