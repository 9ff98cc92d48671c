//! Feature maps as the kernels of LPIPS store them: feature_map.glsl.

use std::ops::Range;

use crate::reference::convolve::Features;

/// Shape of a map of two pictures.
pub struct MapShape {
    pub channels: usize,
    pub height: usize,
    pub width: usize,
    /// Number of rows stored; row y lies in slot y modulo this number.
    pub slots: usize,
    /// Columns of zeros on each side.
    pub margin: usize,
}

impl MapShape {
    pub fn blocks(&self) -> usize {
        self.channels.div_ceil(4)
    }

    pub fn pitch(&self) -> usize {
        self.width + 2 * self.margin
    }

    pub fn texels(&self) -> usize {
        2 * self.blocks() * (self.slots + 1) * self.pitch()
    }

    fn texel(&self, picture: usize, block: usize, slot: usize, x: usize) -> usize {
        ((picture * self.blocks() + block) * (self.slots + 1) + slot) * self.pitch() + self.margin + x
    }

    /// Indices of all texels beside the columns, and of the row of zeros.
    pub fn margins(&self) -> impl Iterator<Item = usize> {
        let (pitch, width, margin, rows) = (self.pitch(), self.width, self.margin, self.slots + 1);
        (0..self.texels()).filter(move |at| {
            let (x, slot) = (at % pitch, at / pitch % rows);
            x < margin || x >= margin + width || slot == rows - 1
        })
    }
}

/// Packs the last rows of two pictures.
pub fn pack(shape: &MapShape, pictures: &[Features; 2]) -> Vec<[f32; 4]> {
    let mut texels = vec![[0.0; 4]; shape.texels()];
    for (picture, features) in pictures.iter().enumerate() {
        for y in shape.height.saturating_sub(shape.slots)..shape.height {
            for (c, x) in (0..shape.channels).flat_map(|c| (0..shape.width).map(move |x| (c, x))) {
                let at = shape.texel(picture, c / 4, y % shape.slots, x);
                texels[at][c % 4] = features.at(c, y, x) as f32;
            }
        }
    }
    texels
}

/// Unpacks some rows of a picture: channel by channel, row by row.
pub fn unpack(shape: &MapShape, texels: &[[f32; 4]], picture: usize, rows: Range<usize>) -> Vec<f64> {
    let mut values = vec![];
    for c in 0..shape.channels {
        for (y, x) in rows.clone().flat_map(|y| (0..shape.width).map(move |x| (y, x))) {
            values.push(f64::from(texels[shape.texel(picture, c / 4, y % shape.slots, x)][c % 4]));
        }
    }
    values
}
