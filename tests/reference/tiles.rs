//! Which tiles a splat touches.

use super::types::{ALPHA_MIN, Extent, Splat, TILE, View};

/// Tile columns [x0, x1) and rows [y0, y1), as [x0, y0, x1, y1].
pub type TileBox = [u32; 4];

pub fn is_empty([x0, y0, x1, y1]: TileBox) -> bool {
    x0 >= x1 || y0 >= y1
}

/// The reference implementation's tiles: those of the square around the radius.
pub fn reference_square(splat: &Splat, view: &View) -> TileBox {
    let tile = f64::from(TILE);
    let radius = f64::from(splat.radius_px);
    let [columns, rows] = view.tiles().map(f64::from);
    let [x, y] = splat.mean2d_px;
    // Conversion to integer truncates, as C does.
    let first = |center: f64, limit: f64| ((center - radius) / tile).trunc().clamp(0.0, limit) as u32;
    let last =
        |center: f64, limit: f64| ((center + radius + tile - 1.0) / tile).trunc().clamp(0.0, limit) as u32;
    [first(x, columns), first(y, rows), last(x, columns), last(y, rows)]
}

/// The value of xᵀ conic x at which α falls to 1/255; negative if α never reaches it.
pub fn level(splat: &Splat) -> f64 {
    2.0 * (splat.opacity / ALPHA_MIN).ln()
}

/// Half the sides of the box around the ellipse α ≥ 1/255.
pub fn half_extent_px(splat: &Splat) -> [f64; 2] {
    let level = level(splat).max(0.0);
    [(level * splat.cov2d[0]).sqrt(), (level * splat.cov2d[2]).sqrt()]
}

/// Tiles whose rectangle of pixel centres, [16 t, 16 t + 15] on each axis, meets the box around the ellipse α ≥
/// 1/255. Border tiles count as whole tiles.
pub fn exact_box(splat: &Splat, view: &View) -> TileBox {
    let half = half_extent_px(splat);
    let tile = f64::from(TILE);
    let mut tiles = [0; 4];
    for axis in 0..2 {
        let count = f64::from(view.tiles()[axis]);
        let (low, high) = (splat.mean2d_px[axis] - half[axis], splat.mean2d_px[axis] + half[axis]);
        tiles[axis] = ((low - (tile - 1.0)) / tile).ceil().clamp(0.0, count) as u32;
        tiles[axis + 2] = ((high / tile).floor() + 1.0).clamp(0.0, count) as u32;
    }
    tiles
}

/// True if α ≥ 1/255 at some pixel centre of the tile; tries all 256.
pub fn touches_by_pixels(splat: &Splat, tile: [u32; 2]) -> bool {
    (0..TILE * TILE).any(|i| {
        let pixel = [tile[0] * TILE + i % TILE, tile[1] * TILE + i / TILE];
        alpha_unclamped(splat, pixel).is_some_and(|alpha| alpha >= ALPHA_MIN)
    })
}

/// o·exp(power) at a pixel, `None` where power > 0.
pub fn alpha_unclamped(splat: &Splat, pixel: [u32; 2]) -> Option<f64> {
    let dx = splat.mean2d_px[0] - f64::from(pixel[0]);
    let dy = splat.mean2d_px[1] - f64::from(pixel[1]);
    let [a, b, c] = splat.conic;
    let power = -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy;
    (power <= 0.0).then(|| splat.opacity * power.exp())
}

/// The smallest value of xᵀ conic x over the continuous rectangle spanned by the tile's pixel centres.
pub fn smallest_form_over_tile(splat: &Splat, tile: [u32; 2]) -> f64 {
    let low = tile.map(|t| f64::from(t * TILE));
    let high = low.map(|x| x + f64::from(TILE - 1));
    let center = splat.mean2d_px;
    let inside = (0..2).all(|i| center[i] >= low[i] && center[i] <= high[i]);
    if inside {
        return 0.0;
    }
    let [a, b, c] = splat.conic;
    let form = |x: f64, y: f64| a * x * x + 2.0 * b * x * y + c * y * y;
    // The form is convex. Its minimum over a rectangle without the centre lies on the border, a parabola per side.
    let mut smallest = f64::INFINITY;
    for x in [low[0] - center[0], high[0] - center[0]] {
        let y = (-b * x / c).clamp(low[1] - center[1], high[1] - center[1]);
        smallest = smallest.min(form(x, y));
    }
    for y in [low[1] - center[1], high[1] - center[1]] {
        let x = (-b * y / a).clamp(low[0] - center[0], high[0] - center[0]);
        smallest = smallest.min(form(x, y));
    }
    smallest
}

/// True if the ellipse α ≥ 1/255 meets the continuous rectangle of the tile's pixel centres. Implied by
/// [`touches_by_pixels`].
pub fn touches_rectangle(splat: &Splat, tile: [u32; 2]) -> bool {
    smallest_form_over_tile(splat, tile) <= level(splat)
}

pub fn touched(splat: &Splat, view: &View) -> Vec<u32> {
    let [x0, y0, x1, y1] = match view.extent {
        Extent::Exact => exact_box(splat, view),
        Extent::Reference => reference_square(splat, view),
    };
    let tiles = (y0..y1).flat_map(|y| (x0..x1).map(move |x| [x, y]));
    let met = tiles.filter(|tile| view.extent == Extent::Reference || touches_rectangle(splat, *tile));
    met.map(|[x, y]| y * view.tiles()[0] + x).collect()
}
