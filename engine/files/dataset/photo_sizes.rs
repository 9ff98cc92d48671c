//! Cameras for photos that were made smaller or larger after the cameras were computed.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use super::mask::is_scaled;
use super::planned_view::PlannedView;
use ashsplat::scene::Intrinsics;
use ashsplat::scene::lens::Lens;
use ashsplat::{Error, Result};

/// Scales the cameras of views to their photos. Photos of other proportions, or of another size than other photos of
/// the same camera, become errors. Returns a warning, unless the photos' folder is named after the ratio (`divisor`).
pub(super) fn fit(views: &mut [Result<PlannedView>], list: &Path, divisor: u32) -> Option<String> {
    let key = |view: &PlannedView| format!("{} {:?}", view.camera_id, view.lens);
    let own_size = |view: &PlannedView| (view.lens.width, view.lens.height);
    let unscaled = views.iter().flatten().filter(|view| view.file_size == Some(own_size(view)));
    let unscaled: HashSet<String> = unscaled.map(key).collect();
    let mut known: HashMap<String, (Lens, Intrinsics)> = HashMap::new();
    let (mut first, mut count, mut as_named) = (None, 0, divisor > 1);
    for result in views {
        let Ok(view) = result else { continue };
        let own = own_size(view);
        let Some((width, height)) = view.file_size.filter(|&size| size != own) else { continue };
        let rounded = width.abs_diff(own.0) <= 1 && height.abs_diff(own.1) <= 1;
        if !is_scaled((width, height), own) || unscaled.contains(&key(view)) && !rounded {
            *result = Err(of_another_size(view, (width, height)));
            continue;
        }
        first.get_or_insert(((width, height), own));
        count += 1;
        let divided = |side: u32, own: u32| side == own / divisor || side == own.div_ceil(divisor);
        as_named &= divided(width, own.0) && divided(height, own.1);
        let lens = view.lens.scaled_to(width, height);
        // A lens that can be undistorted at one size can be at another.
        let fitted = || (lens, lens.inscribed_pinhole().unwrap_or(lens.intrinsics()));
        (view.lens, view.pinhole) = *known.entry(format!("{lens:?}")).or_insert_with(fitted);
    }
    let ((w, h), (width, height)) = first.filter(|_| !as_named)?;
    Some(format!(
        "{}: {count} photos are not of their camera's size, {w}x{h} and {width}x{height} for example: the cameras are scaled \
         to them",
        list.display()
    ))
}

fn of_another_size(view: &PlannedView, (width, height): (u32, u32)) -> Error {
    let (w, h) = (view.lens.width, view.lens.height);
    let how = if view.turned { " when turned as its metadata say" } else { "" };
    let problem = format!("is {width}x{height} pixels{how}, its camera {w}x{h}");
    let remedy = if is_scaled((width, height), (w, h)) {
        "scale all photos of this camera, or none"
    } else if is_scaled((height, width), (w, h)) {
        "turn it on its side, as it was when the cameras were computed"
    } else {
        "use the pictures that the cameras were computed from, or whole ones scaled"
    };
    Error::input(&view.photo_path, problem, remedy)
}
