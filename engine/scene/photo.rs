//! Pictures in memory.

use crate::error::{Error, Result};

/// A picture in memory: 8 bits per channel, as stored in the file (no colour management).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Photo {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `[row][column][r, g, b]`, `3 * width * height` bytes.
    pub rgb: Vec<u8>,
}

impl Photo {
    /// Returns the pixels (r, g, b) in [0, 1], row-major.
    pub fn to_f32(&self) -> Vec<[f32; 3]> {
        self.rgb.as_chunks::<3>().0.iter().map(|pixel| pixel.map(|c| f32::from(c) / 255.0)).collect()
    }

    /// Creates a picture from pixels (r, g, b), row-major, clamped to [0, 1] and rounded to 8 bits.
    ///
    /// # Errors
    /// [`Error::Argument`] when the number of pixels does not fit the size.
    pub fn from_f32(width: u32, height: u32, pixels: &[[f32; 3]]) -> Result<Self> {
        let byte = |c: &f32| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
        let photo = Self { width, height, rgb: pixels.as_flattened().iter().map(byte).collect() };
        photo.check_shape()?;
        Ok(photo)
    }

    /// Refuses a picture whose number of bytes does not match its size.
    pub fn check_shape(&self) -> Result<()> {
        let needs = 3 * u64::from(self.width) * u64::from(self.height);
        if self.rgb.len() as u64 == needs {
            return Ok(());
        }
        let Self { width, height, rgb } = self;
        Err(Error::argument("photo", format!("{width}x{height} needs {needs} bytes, has {}", rgb.len())))
    }
}
