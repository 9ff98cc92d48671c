//! Planes of one value per pixel in strips of [`STRIP_ROWS`] rows: the layout in which blending, the loss and the
//! backward pass exchange data on processors (glsl/include/strips.glsl).

pub use crate::kernels::constants::STRIP_ROWS;
use crate::vk::Limits;

/// Layout of pictures, photographs and picture gradients in blending, the loss and the backward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NativeLayout {
    /// Row by row, pixel by pixel.
    Rows,
    /// Planes in [`Strips`], on processors whose subgroups are small: their shared memory is ordinary memory and saves nothing.
    Strips,
}

impl NativeLayout {
    /// Returns the layout of a device.
    pub fn of(limits: &Limits) -> Self {
        let lanes = limits.tuning.strips_up_to_lanes;
        match limits.prefers_texels() && lanes.is_some_and(|lanes| limits.subgroup_size <= lanes) {
            true => Self::Strips,
            false => Self::Rows,
        }
    }
}

/// Layout of an image's planes. The values of a strip's column are contiguous; columns, strips and planes follow in this
/// order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strips {
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
}

impl Strips {
    /// Number of strips of the image.
    pub fn count(self) -> u32 {
        self.height.div_ceil(STRIP_ROWS)
    }

    /// Columns from one strip to the next. Same as `strip_pitch` in strips.glsl.
    pub fn pitch(self) -> u32 {
        self.width.saturating_add(1) / 4 * 4 + 2
    }

    /// Number of values of a plane.
    pub fn values(self) -> u64 {
        u64::from(STRIP_ROWS) * u64::from(self.pitch()) * u64::from(self.count())
    }

    /// Index of a pixel's value in the planes.
    pub fn index(self, plane: u32, x: u32, y: u32) -> usize {
        let strip = u64::from(plane) * u64::from(self.count()) + u64::from(y / STRIP_ROWS);
        let column = strip * u64::from(self.pitch()) + u64::from(x);
        (column * u64::from(STRIP_ROWS) + u64::from(y % STRIP_ROWS)) as usize
    }

    /// Converts the image's pixels, row by row, to planes. Padding is `T::default()`.
    ///
    /// # Panics
    /// If the number of pixels differs from the image's.
    pub fn planes<T: Copy + Default, const N: usize>(
        self,
        pixels: impl IntoIterator<Item = [T; N]>,
    ) -> Vec<T> {
        let mut planes = vec![T::default(); N * self.values() as usize];
        let mut pixels = pixels.into_iter();
        for (x, y) in (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y))) {
            let Some(pixel) = pixels.next() else {
                panic!("fewer pixels than {}x{}", self.width, self.height)
            };
            for (plane, value) in (0..).zip(pixel) {
                planes[self.index(plane, x, y)] = value;
            }
        }
        assert!(pixels.next().is_none(), "more pixels than {}x{}", self.width, self.height);
        planes
    }
}
