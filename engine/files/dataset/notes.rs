//! Notes and warnings about the lenses of photos, the size at which they are used, and their hidden pixels.

use std::path::Path;

use super::planned_view::{PhotoUse, PlannedView};
use super::{AlphaUse, DatasetOptions};
use crate::images::{AUTO_MAX_WIDTH, Resolution};
use crate::init::RANDOM_POINTS;
use crate::names::has_one_of;
use ashsplat::scene::{PhotoLens, Projection};

/// A width below this may have been meant as a divisor.
const SMALL_WIDTH: u32 = 100;

/// A warning about photos of these sizes, in pixels, if any is scaled in a way that was not explicitly requested.
pub(super) fn scaling_warning(sizes: &[(u32, u32)], resolution: Resolution) -> Option<String> {
    let surprises = |&&(width, _): &&(u32, u32)| match resolution {
        Resolution::Auto => width > AUTO_MAX_WIDTH,
        Resolution::Factor(_) => false,
        Resolution::Width(used) => used > width || used < SMALL_WIDTH && used < width,
    };
    let scaled: Vec<_> = sizes.iter().filter(surprises).copied().collect();
    let ((width, height), _) = largest(&scaled)?;
    let (used_width, used_height) = resolution.apply(width, height);
    let why = match resolution {
        Resolution::Width(used) if used > width => format!(
            "-r {used} is their width, which enlarges them without adding detail; -r 1 uses them as they are"
        ),
        Resolution::Width(used) => {
            format!("-r {used} is their width in pixels; only 1, 2, 4 and 8 divide their size")
        }
        _ => format!("what is wider than {AUTO_MAX_WIDTH} pixels is scaled down; -r 1 uses all pixels"),
    };
    let (count, all) = (scaled.len(), sizes.len());
    Some(format!(
        "{count} of {all} photos, of up to {width}x{height} pixels, are used at {used_width}x{used_height}: {why}"
    ))
}

/// The requested divisor of the photos, if it is above 1.
fn divisor(resolution: Resolution) -> Option<u32> {
    match resolution {
        Resolution::Factor(by) if by > 1 => Some(by),
        _ => None,
    }
}

/// The largest size, by area, then by width, and "up to " if not all are equal.
fn largest(sizes: &[(u32, u32)]) -> Option<((u32, u32), &'static str)> {
    let area_and_width = |&&(width, height): &&(u32, u32)| (u64::from(width) * u64::from(height), width);
    let largest = *sizes.iter().max_by_key(area_and_width)?;
    Some((largest, if sizes.iter().all(|&size| size == largest) { "" } else { "up to " }))
}

/// A note on the size at which photos of these sizes, in pixels, are used after the requested division.
pub(super) fn scaling_note(sizes: &[(u32, u32)], resolution: Resolution) -> Option<String> {
    let by = divisor(resolution)?;
    let ((width, height), up_to) = largest(sizes)?;
    let (used_width, used_height) = resolution.apply(width, height);
    Some(format!(
        "photos of {up_to}{width}x{height} pixels are used at {used_width}x{used_height} pixels (-r {by})"
    ))
}

/// Names the cameras with a lens, if any. Many data sets have one camera per photo.
pub(super) fn distorted_lenses<'a>(
    file: &Path,
    cameras: impl Iterator<Item = &'a PhotoLens>,
) -> Option<String> {
    let (mut all, mut distorted) = (0, 0);
    for lens in cameras {
        all += 1;
        distorted += u32::from(lens.projection != Projection::Perspective);
    }
    let which = match (distorted, all) {
        (0, _) => return None,
        (1, 1) => "the camera has".to_owned(),
        (some, all) if some == all => format!("all {all} cameras have"),
        (some, all) => format!("{some} of {all} cameras have"),
    };
    Some(format!("{}: {which} a lens", file.display()))
}

/// Note on the treatment of their photos, which have these sizes in pixels.
pub(super) fn distorted_photos(
    which: Option<&str>,
    sizes: &[(u32, u32)],
    options: &DatasetOptions,
) -> Option<String> {
    let (which, ((width, height), up_to)) = (which?, largest(sizes)?);
    let (width, height) = options.resolution.apply(width, height);
    let scaled = divisor(options.resolution).map_or_else(String::new, |by| format!(" (-r {by})"));
    let how = match options.undistort {
        true => "photos are undistorted as they are read, and used",
        false => "photos are used as they were taken,",
    };
    Some(format!("{which}: {how} at {up_to}{width}x{height} pixels{scaled}"))
}

/// Plausible angles of view from edge to edge, degrees: from long telephoto lenses to the widest pinhole.
const ANGLES: std::ops::RangeInclusive<f64> = 3.0..=150.0;
/// Largest plausible ratio of the focal lengths; pixels are square except with anamorphic lenses.
const ASPECT: f64 = 1.3;
/// Largest plausible offset of the principal point, in image sizes. A camera of photos of half the size is 0.25 off.
const OFF_CENTER: f64 = 0.2;

/// A warning about the named cameras if one is doubtful.
pub(super) fn lens_warning<'a>(
    file: &Path,
    lenses: impl Iterator<Item = (String, &'a PhotoLens)>,
) -> Option<String> {
    let mut doubts = lenses.filter_map(|(name, lens)| Some((name, doubt(lens)?)));
    let (name, what) = doubts.next()?;
    let others = match doubts.count() {
        0 => String::new(),
        others => format!(" (and {others} more)"),
    };
    let file = file.display();
    Some(format!("{file}: {name} has {what}{others}: is it of photos of another size, or in other units?"))
}

fn doubt(lens: &PhotoLens) -> Option<String> {
    let (focal, center) = (lens.focal_px.to_array(), lens.center_px.to_array());
    let sides = [lens.width, lens.height].map(f64::from);
    for axis in 0..2 {
        let angle = 2.0 * (0.5 * sides[axis] / focal[axis]).atan().to_degrees();
        if !lens.projection.orders_by_distance() && !ANGLES.contains(&angle) {
            return Some(format!(
                "a field of view of {angle:.1} degrees (focal length {} for {} pixels)",
                focal[axis], sides[axis]
            ));
        }
        if (center[axis] - 0.5 * sides[axis]).abs() > OFF_CENTER * sides[axis] {
            return Some(format!("its principal point at {} of {} pixels", center[axis], sides[axis]));
        }
    }
    let ratio = focal[0] / focal[1];
    let doubtful = !(ASPECT.recip()..=ASPECT).contains(&ratio);
    doubtful.then(|| format!("focal lengths of {} and {} pixels", focal[0], focal[1]))
}

pub(super) fn of_pixels<'v>(
    photos: impl Iterator<Item = (&'v PlannedView, PhotoUse)>,
    alpha: AlphaUse,
) -> (Vec<String>, Vec<String>) {
    /// 1 / 2.2 and the values of older screens, which look like sRGB.
    const USUAL_GAMMA: std::ops::RangeInclusive<f32> = 0.4..=0.6;
    let photos: Vec<(&PlannedView, PhotoUse)> = photos.collect();
    let all = photos.len();
    // Number of the photos with a finding, and the first of them.
    let found = |has: &dyn Fn(&PlannedView, &PhotoUse) -> bool| {
        let mut found = photos.iter().filter(|(view, photo)| has(view, photo));
        found.next().map(|first| (1 + found.count(), first))
    };
    // A block's own mask says nothing about the photo.
    let shows_through =
        |view: &PlannedView, photo: &PhotoUse| photo.is_transparent && view.coarse_mask.is_none();
    let (name, alone, beside) = match alpha {
        AlphaUse::Target => (
            "target",
            "{} photos have transparent pixels, which show the background (--alpha mask leaves them out)",
            "{} photos have a mask and an alpha channel: the mask says what counts, and what is transparent shows the \
             background",
        ),
        AlphaUse::Mask => (
            "mask",
            "the alpha channel of {} photos is taken as their mask: what is transparent there does not count",
            "{} photos have a mask and an alpha channel: what either hides does not count",
        ),
        AlphaUse::Ignore => {
            let ignored = "the alpha channel of {} photos is ignored: their colours count as stored";
            ("ignore", ignored, ignored)
        }
    };
    let notes = [
        (
            found(&|_, photo| photo.mask_is_cut_out),
            "the masks of {} photos are cut-outs of pictures: their alpha channels are the masks",
        ),
        (found(&|view, photo| shows_through(view, photo) && view.mask_path.is_none()), alone),
        (found(&|view, photo| shows_through(view, photo) && view.mask_path.is_some()), beside),
    ];
    let notes = notes.into_iter().filter_map(|(found, line)| Some(line.replace("{}", &found?.0.to_string())));
    let mut notes: Vec<String> = notes.collect();
    let all_opaque = found(&|_, photo| photo.is_transparent).is_none();
    if all_opaque && all > 0 && alpha != AlphaUse::default() {
        notes.push(format!("--alpha {name} changes nothing: no photo has transparent pixels"));
    }
    let hidden = found(&|_, photo| photo.is_hidden).map(|(count, (PlannedView { name, .. }, _))| {
        format!(
            "{count} of {all} photos, {name} for example, are hidden as a whole by their mask or alpha channel and teach nothing; \
             pixels count where a mask is brighter than half: is it inverted, or does it hold labels?"
        )
    });
    let is_unusual = |photo: &PhotoUse| photo.gamma.is_some_and(|gamma| !USUAL_GAMMA.contains(&gamma));
    let unusual = found(&|_, photo| is_unusual(photo)).map(|(count, (PlannedView { name, .. }, photo))| {
        let gamma = photo.gamma.unwrap_or_default();
        format!(
            "{count} photos are PNGs that name a gamma of {gamma}, {name} for example (linear light has 1, sRGB about 0.45): their \
             values are used as sRGB; convert them if they look too dark"
        )
    });
    let round = found(&|_, photo| photo.is_round).map(|(count, (PlannedView { name, .. }, _))| {
        format!(
            "{count} photos of fisheyes, {name} for example, have black corners and no masks: black is trained there; masks hide it"
        )
    });
    (notes, hidden.into_iter().chain(unusual).chain(round).collect())
}

/// True if the source may have no points: a file with cameras alone.
pub(super) fn may_lack_points(source: &Path) -> bool {
    has_one_of(source, &["json", "xml", "csv"])
}

pub(super) fn random_points_instead() -> String {
    format!("no points to start from; {RANDOM_POINTS} random ones stand in for them")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    #[test]
    fn surprises_are_told_with_the_size() {
        let _turn = turn();
        let sizes = [(1600, 1200), (4000, 3000), (3000, 4000)];
        let of = |resolution| scaling_warning(&sizes, resolution);
        let large = of(Resolution::Auto).expect("a warning");
        let expected = "2 of 3 photos, of up to 4000x3000 pixels, are used at 1600x1200: ";
        assert!(large.starts_with(expected), "{large}");
        assert!(large.ends_with("-r 1 uses all pixels"), "{large}");
        let small = of(Resolution::Width(16)).expect("a warning");
        assert!(small.contains("3 of 3") && small.contains("only 1, 2, 4 and 8 divide"), "{small}");
        let enlarged = of(Resolution::Width(3200)).expect("a warning");
        assert!(enlarged.starts_with("2 of 3 photos") && enlarged.contains("enlarges"), "{enlarged}");
        for asked in [Resolution::Factor(1), Resolution::Factor(8), Resolution::Width(800)] {
            assert_eq!(of(asked), None, "{asked}");
        }
        let note = scaling_note(&sizes, Resolution::Factor(8));
        assert_eq!(
            note.as_deref(),
            Some("photos of up to 4000x3000 pixels are used at 500x375 pixels (-r 8)")
        );
        assert_eq!(scaling_note(&sizes, Resolution::Factor(1)), None);
        assert_eq!(scaling_warning(&sizes[..1], Resolution::Auto), None);
        assert_eq!(scaling_warning(&[], Resolution::Auto), None);
    }
}
