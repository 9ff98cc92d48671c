//! Edge responses of a photograph in integers: the twin of `densify/edge_response`.

/// round((299 R + 587 G + 114 B) / 1000), halves to even.
pub fn gray([r, g, b]: [u8; 3]) -> i64 {
    let sum = 299 * i64::from(r) + 587 * i64::from(g) + 114 * i64::from(b);
    // A sum is either exactly a half or far from one.
    (sum as f64 / 1000.0).round_ties_even() as i64
}

/// 8 centre - 8 neighbours, 0 outside, limited to 0..=255. Row-major.
pub fn responses(gray: &[i64], [width, height]: [usize; 2]) -> Vec<i64> {
    let at = |x: i64, y: i64| {
        let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
        if inside { gray[y as usize * width + x as usize] } else { 0 }
    };
    let response = |i: usize| {
        let (x, y) = ((i % width) as i64, (i / width) as i64);
        let mut sum = 8 * at(x, y);
        for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
            sum -= at(x + dx, y + dy);
        }
        sum.clamp(0, 255)
    };
    (0..width * height).map(response).collect()
}
