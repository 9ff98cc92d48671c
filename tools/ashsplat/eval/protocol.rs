//! The measured part of a view, and its exposure and lens effects.

use crate::light::Lights;
use ashsplat::scene::{Photo, StoredPhoto};
use ashsplat::{Frame, Result};
use ashsplat_files::View;
use std::borrow::Cow;
use std::collections::HashSet;

/// The default measures whole views without exposure and lens effects.
#[derive(Default)]
pub struct Protocol {
    /// Exposures of the training photos, and lens effects of all photos.
    pub lights: Lights,
    /// Names of the views whose left half was trained on: only the right half counts.
    pub halves: HashSet<String>,
}

impl Protocol {
    /// Prepares a view and its frame for comparison.
    pub fn prepared<'a>(&self, view: &'a View, mut frame: Frame) -> Result<(Cow<'a, View>, Frame)> {
        self.lights.of(&view.name).apply(&view.camera, &mut frame);
        if !self.halves.contains(&view.name) {
            return Ok((Cow::Borrowed(view), frame));
        }
        let mut half = view.clone();
        let (width, height) = (view.photo.width, view.photo.height);
        let photo = view.photo.photo()?;
        let rgb = right(photo.rgb.as_chunks::<3>().0, width).as_flattened().to_vec();
        let mask = view.photo.mask()?.map(|mask| right(&mask, width));
        let kept = width - width / 2;
        half.photo = StoredPhoto::new(Photo { width: kept, height, rgb }, mask);
        half.camera.width = kept;
        half.camera.cx -= (width / 2) as f32;
        frame.color = right(&frame.color, width);
        frame.transmittance = right(&frame.transmittance, width);
        frame.inverse_depth = frame.inverse_depth.map(|depth| right(&depth, width));
        frame.width = kept;
        Ok((Cow::Owned(half), frame))
    }
}

/// The right half of rows of `width` values.
fn right<T: Copy>(values: &[T], width: u32) -> Vec<T> {
    let width = width.max(1) as usize;
    values.chunks(width).flat_map(|row| &row[width / 2..]).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::right;

    #[test]
    fn the_middle_column_belongs_to_the_right_half() {
        assert_eq!(right(&[1, 2, 3, 4, 5, 6], 3), [2, 3, 5, 6]);
        assert_eq!(right(&[1, 2, 3, 4], 4), [3, 4]);
        assert_eq!(right(&[1, 2], 1), [1, 2]);
    }
}
