//! Decides which photos are rotated by their metadata (Exif).
//!
//! COLMAP, nerfstudio (Pillow), instant-ngp (stb_image) and the reference use pixels as they are stored.
//! OpenCV, and programs that use it, rotate them first. For a photo on its side, the camera's size shows which was
//! done. That result applies to the data set's other photos too, whose size shows nothing: square ones, those upside
//! down or mirrored, and those whose cameras have no size.

use std::path::Path;

use rayon::prelude::*;

use crate::images::{Header, PhotoOrientation, header};

/// The decision for all photos of a data set.
pub(super) struct Turned {
    /// True for each photo that is rotated.
    pub(super) photos: Vec<bool>,
    /// Photo sizes after the rotation, pixels; `None` for unreadable photos.
    pub(super) sizes: Vec<Option<(u32, u32)>>,
    /// Number of photos that are used as stored, although their metadata ask for a rotation, because no size
    /// decides it.
    pub(super) untold: usize,
}

/// Width and height of a camera, or values in proportion to them.
pub(super) type Sides = [f64; 2];

impl Turned {
    /// Takes photos (if they exist) and the sides of their cameras (if they are known).
    pub(super) fn of(photos: &[(Option<&Path>, Option<Sides>)], choice: PhotoOrientation) -> Self {
        // A photo that cannot be read is reported when it is loaded.
        let asked = |&(path, sides): &(Option<&Path>, Option<Sides>)| Some((header(path?).ok()?, sides));
        let headers: Vec<Option<(Header, Option<Sides>)>> = photos.par_iter().map(asked).collect();
        let with = |photos: Vec<bool>, untold: usize| {
            let size = |(photo, &turned): (&Option<(Header, _)>, &bool)| Some(photo.as_ref()?.0.size(turned));
            let sizes = headers.iter().zip(&photos).map(size).collect();
            Self { photos, sizes, untold }
        };
        let oriented: Vec<Option<(Header, Option<Sides>)>> =
            headers.iter().map(|photo| photo.filter(|(header, _)| header.has_orientation())).collect();
        match choice {
            PhotoOrientation::Stored => return with(vec![false; photos.len()], 0),
            PhotoOrientation::Upright => return with(oriented.iter().map(Option::is_some).collect(), 0),
            PhotoOrientation::Auto => {}
        }
        let told = |photo: &Option<(Header, Option<Sides>)>| photo.and_then(|(h, sides)| told_by(h, sides?));
        let [stored, turned] =
            [false, true].map(|turned| oriented.iter().any(|photo| told(photo) == Some(turned)));
        let (tells, others) = (stored != turned, turned && !stored);
        let untold = oriented.iter().filter(|photo| photo.is_some() && told(photo).is_none()).count();
        let turned = oriented.iter().map(|photo| photo.is_some() && told(photo).unwrap_or(others));
        with(turned.collect(), if tells { 0 } else { untold })
    }

    /// A warning if no size decides the rotation.
    pub(super) fn warning(&self, list: &Path) -> Option<String> {
        let Self { untold, .. } = self;
        let photos = if *untold == 1 { "1 photo is" } else { &format!("{untold} photos are") };
        (*untold > 0).then(|| {
            format!(
                "{}: {photos} to be turned by their metadata (Exif), and no size of a camera tells whether that was done \
                 before the cameras were computed: taken as stored, as COLMAP, nerfstudio and instant-ngp take them; \
                 --orientation upright turns them",
                list.display()
            )
        })
    }
}

/// True if a camera has the size of the rotated photo; `None` if its sides fit both.
fn told_by(header: Header, [width, height]: Sides) -> Option<bool> {
    let (stored_width, stored_height) = header.size(false);
    let tells = header.lies_on_its_side() && stored_width != stored_height && width != height;
    tells.then_some((width > height) != (stored_width > stored_height))
}
