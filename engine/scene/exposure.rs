//! Exposure of a photograph: the relation of its colours to those of the scene.

/// An affine change of colours: `out[c] = Σ_k in[k] * rows[k][c] + rows[c][3]`, with colours as in photographs (sRGB, 0 to 1).
/// It is the reference implementation's exposure matrix, 3 rows of 4 numbers, whose last column is added. Nothing is clamped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// The matrix, row by row.
    pub rows: [[f32; 4]; 3],
}

impl Default for Exposure {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Exposure {
    /// Leaves colours unchanged.
    pub const IDENTITY: Self =
        Self { rows: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]] };

    /// Returns the colour under this exposure.
    pub fn of(&self, color: [f32; 3]) -> [f32; 3] {
        let sum = |c: usize| (0..3).map(|k| color[k] * self.rows[k][c]).sum::<f32>() + self.rows[c][3];
        [sum(0), sum(1), sum(2)]
    }

    /// Changes the colours of a picture.
    pub fn apply(&self, picture: &mut [[f32; 3]]) {
        picture.iter_mut().for_each(|color| *color = self.of(*color));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_of_the_incoming_channels_and_the_last_column_is_added() {
        let rows = [[1.0, 2.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 3.0, -1.0]];
        assert_eq!(Exposure { rows }.of([0.25, 0.5, 1.0]), [0.75, 1.0, 2.0]);
        let mut picture = [[0.1, 0.2, 0.3]];
        Exposure::IDENTITY.apply(&mut picture);
        assert_eq!(picture, [[0.1, 0.2, 0.3]]);
    }
}
