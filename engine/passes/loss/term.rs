//! The loss as a sum of terms, and the sparse points of known depth that a term may read.

use crate::error::{Error, Result};
use crate::frame::{FrameInputs, array_of};
use crate::vk::{Buffer, Context, MemoryKind, Recorder};

/// Inputs and outputs of a term in one iteration.
#[derive(Clone, Copy)]
pub struct TermInputs<'a> {
    /// Frame whose forward pass precedes.
    pub frame: &'a FrameInputs<'a>,
    /// Picture of the frame: see [`super::LossInputs::rendered`].
    pub picture: &'a Buffer,
    /// Photograph of the view: see [`super::LossInputs::photo`].
    pub photo: &'a Buffer,
    /// In and out: the gradient, see [`super::LossInputs::image_gradient`].
    pub image_gradient: &'a Buffer,
    /// True if the photograph has a mask.
    pub photo_is_masked: bool,
    /// Inverse-depth map of the view ([`TrainView::inverse_depth`](crate::TrainView::inverse_depth)), if any: a float per
    /// pixel, row by row.
    pub inverse_depth_map: Option<&'a Buffer>,
    /// Sparse points of the view ([`TrainView::depth_points`](crate::TrainView::depth_points)), if any.
    pub depth_points: Option<&'a DepthPointBuffers>,
    /// Iteration, counted from 1.
    pub iteration: u32,
    /// Per chunk of the scene: dL/d(mean, opacity logit), dL/d(quaternion), dL/d(log-scale), laid out like the
    /// scene's first three planes. Empty unless a term has [`TermData::parameters`].
    pub parameter_gradients: &'a [Buffer],
    /// Buffers of [`LossTerm::scratch_requests`].
    pub scratch: &'a [Buffer],
    /// Out: vec4 (weighted value of the term, up to three further values) per term.
    pub losses: &'a Buffer,
    /// Row of the term in `losses`.
    pub row: u32,
}

/// Data that a term reads and adds to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TermData {
    /// True if the term uses the picture, the photograph or the picture's gradient.
    pub picture: bool,
    /// True if the term writes the fourth component of the picture's gradient: dL/d(inverse depth). In the native layout of
    /// processors it is a fourth plane. `frame.buffers.depth_sums` is the sum of weights / z per pixel, row by row.
    pub inverse_depth: bool,
    /// True if `frame.buffers.depth_sums` is the sum of weights * z, and the gradient is with respect to that sum. Only with
    /// `inverse_depth`. The term may overwrite the value that the backward pass takes for the sum. Excludes other terms with
    /// `inverse_depth`.
    pub linear_depth: bool,
    /// True if the term adds to [`TermInputs::parameter_gradients`].
    pub parameters: bool,
}

impl TermData {
    /// Returns the union of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            picture: self.picture || other.picture,
            inverse_depth: self.inverse_depth || other.inverse_depth,
            linear_depth: self.linear_depth || other.linear_depth,
            parameters: self.parameters || other.parameters,
        }
    }
}

/// A term of the training loss.
///
/// The first term of a loss writes the gradient of the picture; later ones add to it. Gradients of parameters are zero before the
/// first term, and all terms add to them. Pictures have the device's layout, which a
/// [`LayoutConverter`](crate::passes::pixels::LayoutConverter) converts to rows and back.
pub trait LossTerm: Send {
    /// Name in reports and profiles.
    fn name(&self) -> &'static str;

    /// Data that the term reads and adds to.
    fn data(&self) -> TermData {
        TermData::default()
    }

    /// Names and bytes of the scratch buffers, for views of these sizes (width, height). Other passes overwrite them after the loss.
    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)>;

    /// Records the value and the gradient. A frame that overflowed is repeated, so the term must not change anything that
    /// outlives the iteration.
    fn record(&self, r: &mut Recorder, inputs: &TermInputs);
}

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
    pub fn new(context: &Context, all: &[DepthPoint], size: (u32, u32)) -> Result<Self> {
        let requests = Self::requests(all.len() as u32);
        let buffers = context.allocate("depth points", &requests, MemoryKind::Device)?;
        Self::upload(context, array_of(buffers), all, size)
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
