//! Sparse points of known depth in a view, on the device.

use crate::error::{Error, Result};
use crate::vk::{Buffer, Context, MemoryKind};

/// A point of the scene from structure from motion that a photograph shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthPoint {
    /// Position in the photograph, pixels, x to the right and y down, with pixel centres at the integers. From 0 to width - 1
    /// and height - 1.
    pub position_px: [f32; 2],
    /// 1 / z in the camera's frame, 1 / world units; positive.
    pub inverse_z: f32,
}

/// Sparse points of a view: see `glsl/loss/sparse_depth.comp` and `sparse_depth_gather.comp`.
pub struct DepthPointBuffers {
    /// vec3 per point: position, 1/z.
    pub points: Buffer,
    /// uvec2 per sampled pixel: its index, and the end of its entries.
    pub pixels: Buffer,
    /// u32 per entry: 4 point + corner.
    pub entries: Buffer,
    /// Number of points.
    pub count: u32,
    /// Number of sampled pixels.
    pub pixel_count: u32,
}

impl DepthPointBuffers {
    /// Names and bytes of the buffers for `count` points, in the order of [`DepthPointBuffers::upload`].
    pub fn requests(count: u32) -> [(&'static str, u64); 3] {
        let count = u64::from(count);
        // Each point has four corners, which may all be different pixels.
        [("depth_points", 12 * count), ("depth_pixels", 8 * 4 * count), ("depth_entries", 4 * 4 * count)]
    }

    /// Uploads the points of a picture of this size into the buffers of [`DepthPointBuffers::requests`].
    ///
    /// # Errors
    /// When the device is lost.
    pub fn upload(
        context: &Context,
        [points, pixels, entries]: [Buffer; 3],
        all: &[DepthPoint],
        (width, height): (u32, u32),
    ) -> Result<Self> {
        let lists = PointLists::of(all, width, height);
        let words: Vec<[f32; 3]> =
            all.iter().map(|&DepthPoint { position_px: [x, y], inverse_z }| [x, y, inverse_z]).collect();
        let put = |buffer: &Buffer, bytes: &[u8]| context.upload(&buffer.range(0, bytes.len() as u64), bytes);
        put(&points, bytemuck::cast_slice(&words))?;
        put(&pixels, bytemuck::cast_slice(&lists.pixels))?;
        put(&entries, bytemuck::cast_slice(&lists.entries))?;
        let (count, pixel_count) = (all.len() as u32, lists.pixels.len() as u32);
        Ok(Self { points, pixels, entries, count, pixel_count })
    }

    /// Allocates buffers and uploads the points of a picture of this size. At least one point is necessary.
    ///
    /// # Errors
    /// Memory or device failures.
    pub fn new(context: &Context, all: &[DepthPoint], size: (u32, u32)) -> Result<Self> {
        let requests = Self::requests(all.len() as u32);
        let buffers = context.allocate("depth points", &requests, MemoryKind::Device)?;
        let Ok(buffers) = <[Buffer; 3]>::try_from(buffers) else { unreachable!("one buffer per request") };
        Self::upload(context, buffers, all, size)
    }
}

/// Refuses points outside a picture of this size.
///
/// # Errors
/// [`Error::Argument`] with `name` for the points.
pub(crate) fn check_depth_points(
    name: &str,
    points: &[DepthPoint],
    (width, height): (u32, u32),
) -> Result<()> {
    let inside = |x: f32, side: u32| x >= 0.0 && f64::from(x) <= f64::from(side) - 1.0;
    let fits = |point: &&DepthPoint| {
        let [x, y] = point.position_px;
        inside(x, width) && inside(y, height) && point.inverse_z > 0.0 && point.inverse_z.is_finite()
    };
    match points.iter().find(|point| !fits(point)) {
        None => Ok(()),
        Some(point) => {
            let problem =
                format!("{point:?} is no point in front of the camera in a picture of {width}x{height}");
            Err(Error::argument(name, problem))
        }
    }
}

/// Pixels that the points sample, in ascending order.
struct PointLists {
    pixels: Vec<[u32; 2]>,
    entries: Vec<u32>,
}

impl PointLists {
    fn of(points: &[DepthPoint], width: u32, height: u32) -> Self {
        // Same as corner_pixel in depth_points.glsl.
        let pixel = |point: &DepthPoint, corner: u32| {
            let [x, y] = point.position_px;
            let column = (x as u32 + (corner & 1)).min(width - 1);
            let row = (y as u32 + (corner >> 1)).min(height - 1);
            row * width + column
        };
        let corners =
            |(index, point): (u32, _)| (0..4).map(move |corner| (pixel(point, corner), 4 * index + corner));
        let mut all: Vec<(u32, u32)> = (0..).zip(points).flat_map(corners).collect();
        all.sort_unstable();
        let mut pixels: Vec<[u32; 2]> = Vec::new();
        for (end, &(pixel, _)) in (1..).zip(&all) {
            match pixels.last_mut() {
                Some(last) if last[0] == pixel => last[1] = end,
                _ => pixels.push([pixel, end]),
            }
        }
        Self { pixels, entries: all.into_iter().map(|(_, entry)| entry).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_corner_is_listed_once() {
        let at = |x: f32, y: f32| DepthPoint { position_px: [x, y], inverse_z: 1.0 };
        // Two points that share two pixels, and the last pixel of the picture.
        let lists = PointLists::of(&[at(1.5, 0.25), at(2.0, 0.0), at(4.0, 2.0)], 5, 3);
        assert_eq!(lists.pixels, [[1, 1], [2, 3], [3, 4], [6, 5], [7, 7], [8, 8], [14, 12]]);
        let mut sorted = lists.entries.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..12).collect::<Vec<u32>>());
        assert_eq!(lists.entries[8..], [8, 9, 10, 11]);
    }

    #[test]
    fn points_outside_are_refused() {
        let check = |x: f32, inverse_z: f32| {
            check_depth_points("view 3", &[DepthPoint { position_px: [x, 0.0], inverse_z }], (5, 3))
        };
        assert!(check(4.0, 1.0).is_ok());
        for (x, inverse_z) in [(4.1, 1.0), (-0.1, 1.0), (f32::NAN, 1.0), (1.0, 0.0), (1.0, f32::INFINITY)] {
            let message = check(x, inverse_z).expect_err("refused").to_string();
            assert!(message.starts_with("view 3") && message.contains("5x3"), "{message}");
        }
    }
}
