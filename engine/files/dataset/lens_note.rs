//! Notes on lenses that distort.

use super::scaling;
use crate::images::Resolution;
use ashsplat::scene::Intrinsics;
use ashsplat::scene::lens::Lens;
use std::path::Path;

/// Names the cameras with lens distortion, if any. Many data sets have one camera per photo.
pub(super) fn of<'a>(
    file: &Path,
    cameras: impl Iterator<Item = (&'a Lens, Option<Intrinsics>)>,
) -> Option<String> {
    let (mut all, mut distorted) = (0, 0);
    for (lens, pinhole) in cameras {
        all += 1;
        distorted += u32::from(pinhole.is_some() && lens.is_distorted());
    }
    let which = match (distorted, all) {
        (0, _) => return None,
        (1, 1) => "the camera has".to_owned(),
        (some, all) if some == all => format!("all {all} cameras have"),
        (some, all) => format!("{some} of {all} cameras have"),
    };
    Some(format!("{}: {which} lens distortion", file.display()))
}

/// Note on the treatment of their photos, which have these sizes in pixels.
pub(super) fn line(which: Option<&str>, sizes: &[(u32, u32)], resolution: Resolution) -> Option<String> {
    let (which, ((width, height), up_to)) = (which?, scaling::largest(sizes)?);
    let (width, height) = resolution.apply(width, height);
    let scaled = scaling::divisor(resolution).map_or_else(String::new, |by| format!(" (-r {by})"));
    Some(format!(
        "{which}: photos are undistorted as they are read, and used at {up_to}{width}x{height} pixels{scaled}"
    ))
}
