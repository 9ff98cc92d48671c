//! Notes and warnings about pixels that masks and alpha channels hide.

use super::mask::Mask;
use super::planned_view::{PlannedView, ReadPhoto};

/// Findings in the pixels of a photo.
pub(super) struct PhotoUse {
    /// True if no pixel counts.
    is_hidden: bool,
    mask_is_cut_out: bool,
    is_transparent: bool,
    gamma: Option<f32>,
}

impl PhotoUse {
    pub(super) fn of(photo: &ReadPhoto) -> Self {
        let is_hidden = photo.mask.as_ref().is_some_and(Mask::hides_all);
        let ReadPhoto { mask_is_cut_out, is_transparent, gamma, .. } = *photo;
        Self { is_hidden, mask_is_cut_out, is_transparent, gamma }
    }
}

/// Returns the notes and the warnings about photos.
pub(super) fn lines<'v>(
    photos: impl Iterator<Item = (&'v PlannedView, PhotoUse)>,
) -> (Vec<String>, Vec<String>) {
    /// 1 / 2.2 and the values of older screens, which look like sRGB.
    const USUAL_GAMMA: std::ops::RangeInclusive<f32> = 0.4..=0.6;
    let (mut all, mut cut_outs, mut by_alpha, mut by_both, mut beside_mask) = (0, 0, 0, 0, 0);
    let mut hidden: Vec<&PlannedView> = Vec::new();
    let mut unusual: Vec<(&PlannedView, f32)> = Vec::new();
    for (view, photo) in photos {
        all += 1;
        cut_outs += usize::from(photo.mask_is_cut_out);
        unusual.extend(photo.gamma.filter(|gamma| !USUAL_GAMMA.contains(gamma)).map(|gamma| (view, gamma)));
        if photo.is_hidden {
            hidden.push(view);
        }
        // A block's own mask says nothing about the photo.
        if photo.is_transparent && view.coarse_mask.is_none() {
            *match (view.mask_path.is_some(), view.alpha_is_mask) {
                (true, true) => &mut by_both,
                (true, false) => &mut beside_mask,
                (false, true) => &mut by_alpha,
                (false, false) => continue,
            } += 1;
        }
    }
    let notes = [
        (cut_outs, "the masks of {} photos are cut-outs of pictures: their alpha channels are the masks"),
        (
            by_alpha,
            "the alpha channel of {} photos is taken as their mask: what is transparent there does not count (with a \
             transforms.json it shows the background)",
        ),
        (by_both, "{} photos have a mask and an alpha channel: what either hides does not count"),
        (
            beside_mask,
            "{} photos have a mask and an alpha channel: the mask says what counts, and what is transparent shows the \
             background",
        ),
    ];
    let notes = notes.into_iter().filter(|(count, _)| *count > 0);
    let notes = notes.map(|(count, line)| line.replace("{}", &count.to_string())).collect();
    let hidden = hidden.first().map(|view| {
        format!(
            "{} of {all} photos, {} for example, are hidden as a whole by their mask or alpha channel and teach nothing; pixels \
             count where a mask is brighter than half: is it inverted, or does it hold labels?",
            hidden.len(),
            view.name
        )
    });
    let unusual = unusual.first().map(|(view, gamma)| {
        format!(
            "{} photos are PNGs that name a gamma of {gamma}, {} for example (linear light has 1, sRGB about 0.45): their values are \
             used as sRGB; convert them if they look too dark",
            unusual.len(),
            view.name
        )
    });
    (notes, hidden.into_iter().chain(unusual).collect())
}
