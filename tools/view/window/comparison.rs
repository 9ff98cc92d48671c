//! A photo over the left part of its view.

use super::navigation::Navigation;
use super::text::{Overlay, Text};
use ashsplat::scene::Camera;
use ashsplat_files::{Photo, PhotoFileFormat};

pub struct Comparison {
    photo: Photo,
    /// The visible part, scaled to the window.
    shown: Text,
    corner: [u32; 2],
    /// Size of the window and visible share of the photo's width, for which `shown` was made.
    made_for: Option<([u32; 2], f64)>,
}

impl Comparison {
    pub fn new(photo: Photo) -> Comparison {
        Comparison { photo, shown: Text::default(), corner: [0; 2], made_for: None }
    }

    /// Makes the visible part for a window of this size.
    pub fn fit(&mut self, lens: &Camera, size: [u32; 2], share: f64) {
        if self.made_for == Some((size, share)) {
            return;
        }
        let (scale, corner) = Navigation::frame(lens, size);
        let side = |length: u32, max: u32| ((f64::from(length) * scale).round() as u32).clamp(1, max);
        let scaled = [side(lens.width, size[0]), side(lens.height, size[1])];
        let Ok(photo) = self.photo.clone().scaled_to(scaled[0], scaled[1]) else { return };
        let columns = (f64::from(photo.width) * share) as u32;
        let texel = |rgb: &[u8]| {
            let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(|channel| f32::from(channel) / 255.0);
            [r, g, b, 0.0]
        };
        let rows = photo.rgb.chunks_exact(3 * photo.width as usize);
        let texels = rows.flat_map(|row| row.chunks_exact(3).take(columns as usize).map(texel)).collect();
        self.shown = Text { width: columns, height: photo.height, texels };
        self.corner = [0, 1].map(|i| (corner[i].round() as u32).min(size[i] - scaled[i]));
        self.made_for = Some((size, share));
    }

    pub fn overlay(&self) -> Overlay<'_> {
        Overlay { picture: &self.shown, corner: self.corner }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::scene::Intrinsics;
    use glam::{Mat3, Vec3};

    #[test]
    fn the_left_of_a_photo_is_shown_where_it_lies() {
        let lens = Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, Intrinsics::from_fov_x(1.0, 8, 4));
        let photo = Photo { width: 8, height: 4, rgb: [255, 51, 0].repeat(32) };
        let mut comparison = Comparison::new(photo);
        comparison.fit(&lens, [40, 30], 0.25);
        let Overlay { picture, corner } = comparison.overlay();
        assert_eq!((picture.width, picture.height, corner), (10, 20, [0, 5]));
        assert_eq!(picture.texels, [[1.0, 0.2, 0.0, 0.0]; 200]);
        comparison.fit(&lens, [40, 30], 0.0);
        assert!(comparison.overlay().picture.texels.is_empty());
    }
}
