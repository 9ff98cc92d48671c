//! What is said of lenses that distort.

use ashsplat::scene::Intrinsics;
use ashsplat::scene::lens::Lens;
use std::path::Path;

/// One line for all of a data set's cameras: many have one camera for each photo.
pub(super) fn of<'a>(
    file: &Path,
    cameras: impl Iterator<Item = (&'a Lens, Option<Intrinsics>)>,
) -> Option<String> {
    let (mut all, mut distorted, mut size) = (0, 0, None);
    for (lens, pinhole) in cameras {
        all += 1;
        if let Some(pinhole) = pinhole.filter(|_| lens.is_distorted()) {
            distorted += 1;
            size.get_or_insert([pinhole.width, pinhole.height]);
        }
    }
    let [width, height] = size?;
    let which = match (distorted, all) {
        (1, 1) => "the camera has".to_owned(),
        (some, all) if some == all => format!("all {all} cameras have"),
        (some, all) => format!("{some} of {all} cameras have"),
    };
    let example = if distorted > 1 { ", for example" } else { "" };
    let file = file.display();
    Some(format!(
        "{file}: {which} lens distortion: photos are undistorted as they are read, to {width}x{height} pixels{example}"
    ))
}
