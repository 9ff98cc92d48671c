//! Which photos are turned as their metadata (Exif) say.
//!
//! COLMAP, nerfstudio (Pillow), instant-ngp (stb_image) and the reference take pixels as they are stored; OpenCV and what
//! is built on it turn them first. Where a photo lies on its side, the size of its camera tells which it was; what holds
//! for those photos of a data set holds for the others, of which no size tells: square ones, those upside down or
//! mirrored, and those whose cameras have no size.

use std::path::Path;

use rayon::prelude::*;

use crate::images::{Header, PhotoOrientation, header};

/// The decision for all photos of a data set.
pub(super) struct Turned {
    /// Whether each is turned.
    pub(super) photos: Vec<bool>,
    /// How many stay as they are stored though their metadata say otherwise, and nothing tells.
    pub(super) untold: usize,
}

/// Width and height of a camera, or what is in proportion to them.
pub(super) type Sides = [f64; 2];

impl Turned {
    /// Photos (where there is one) and the sides of their cameras (where they are known).
    pub(super) fn of(photos: &[(Option<&Path>, Option<Sides>)], choice: PhotoOrientation) -> Self {
        if choice == PhotoOrientation::Stored {
            return Self { photos: vec![false; photos.len()], untold: 0 };
        }
        // Why one cannot be read is said when it is.
        let asked = |&(path, sides): &(Option<&Path>, Option<Sides>)| Some((header(path?).ok()?, sides));
        let photos: Vec<Option<(Header, Option<Sides>)>> = photos.par_iter().map(asked).collect();
        let oriented: Vec<Option<(Header, Option<Sides>)>> =
            photos.into_iter().map(|photo| photo.filter(|(header, _)| header.has_orientation())).collect();
        if choice == PhotoOrientation::Upright {
            return Self { photos: oriented.iter().map(Option::is_some).collect(), untold: 0 };
        }
        let told = |photo: &Option<(Header, Option<Sides>)>| photo.and_then(|(h, sides)| told_by(h, sides?));
        let [stored, turned] =
            [false, true].map(|turned| oriented.iter().any(|photo| told(photo) == Some(turned)));
        let (tells, others) = (stored != turned, turned && !stored);
        let untold = oriented.iter().filter(|photo| photo.is_some() && told(photo).is_none()).count();
        let turned = oriented.iter().map(|photo| photo.is_some() && told(photo).unwrap_or(others));
        Self { photos: turned.collect(), untold: if tells { 0 } else { untold } }
    }

    /// What to say where nothing tells.
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

/// Whether a camera is that of the turned photo; none where its sides are as good for the one as for the other.
fn told_by(header: Header, [width, height]: Sides) -> Option<bool> {
    let (stored_width, stored_height) = header.size(false);
    let tells = header.lies_on_its_side() && stored_width != stored_height && width != height;
    tells.then_some((width > height) != (stored_width > stored_height))
}
