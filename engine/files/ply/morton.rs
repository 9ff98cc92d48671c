//! Orders points along a space-filling curve.

/// Bits per axis in a code.
const BITS: u32 = 21;

/// Indices of points along the Z-order (Morton) curve through the cube around them; coincident points keep their order. Its cells
/// are cubes: those of a long, flat scene would otherwise be as long as the scene.
pub(super) fn order(points: &[[f32; 3]]) -> Vec<usize> {
    let corner = |start: f32, pick: fn(f32, f32) -> f32| {
        points.iter().fold([start; 3], |corner, p| std::array::from_fn(|axis| pick(corner[axis], p[axis])))
    };
    let (min, max): ([f32; 3], [f32; 3]) =
        (corner(f32::INFINITY, f32::min), corner(f32::NEG_INFINITY, f32::max));
    let size = (0..3).map(|axis| f64::from(max[axis]) - f64::from(min[axis])).fold(0.0, f64::max);
    let code = |point: &[f32; 3]| {
        (0..3).fold(0, |code, axis| {
            let share = if size > 0.0 { (f64::from(point[axis]) - f64::from(min[axis])) / size } else { 0.0 };
            let cell = (share * f64::from((1u32 << BITS) - 1)) as u64;
            code | spread(cell) << axis
        })
    };
    let codes: Vec<u64> = points.iter().map(code).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&index| codes[index]);
    order
}

/// Inserts two zero bits after each of the lower 21 bits.
fn spread(value: u64) -> u64 {
    let mut v = value & 0x1f_ffff;
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}
