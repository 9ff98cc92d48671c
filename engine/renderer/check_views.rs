//! Checks the views of a recording against each other, and names the view of an error.

use super::check::field_of;
use super::record::{RecordedFrame, Target};
use super::reservation::{RESERVATION, Reservation, field_name};
use crate::error::{Error, Result};

/// Checks views against each other, before each is checked alone.
pub(super) fn check_views(
    views: &[RecordedFrame<'_>],
    releases: usize,
    reserved: &Reservation,
) -> Result<()> {
    if views.is_empty() {
        return Err(Error::argument("views", "there are none"));
    }
    if views.len() > reserved.views as usize {
        let problem = format!("{} of them, Reservation::views is {}", views.len(), reserved.views);
        return Err(Error::argument("views", problem));
    }
    if releases != views.len() {
        let problem = format!("room for {releases}, there are {} views", views.len());
        return Err(Error::argument("releases", problem));
    }
    views.iter().enumerate().try_for_each(|(index, frame)| {
        let checked = check_beside(frame, (&views[..index], views.len()), reserved);
        checked.map_err(|error| in_view(error, index, views))
    })
}

fn check_beside(
    frame: &RecordedFrame<'_>,
    (earlier, views): (&[RecordedFrame<'_>], usize),
    reserved: &Reservation,
) -> Result<()> {
    if matches!(frame.target, Target::Slot) {
        if reserved.images_only {
            let problem = "is reserved, and the frame has no image as its target";
            return Err(Error::argument(field_name("images_only"), problem));
        }
        if views > 1 {
            let problem = "is the slot's own buffer, which holds one view: give an image";
            return Err(Error::argument("target", problem));
        }
    }
    if !earlier.is_empty() && !frame.updates.is_empty() {
        return Err(Error::argument("updates", "belong into views[0]: all views see them"));
    }
    let own = frame.images();
    for (field, host) in own.iter().filter_map(|(field, host)| host.map(|host| (*field, host))) {
        let others = earlier.iter().enumerate().flat_map(|(view, frame)| {
            frame.images().into_iter().map(move |(field, host)| (view, field, host))
        });
        for (view, other, theirs) in others {
            let same = theirs.filter(|theirs| theirs.image.is_same_as(host.image));
            let differs = match same.map(|theirs| theirs.image) {
                Some(image) if image.purpose() != host.image.purpose() => {
                    "one samples it and the other writes it"
                }
                Some(image) if image.other_family() != host.image.other_family() => {
                    "they say that other queue families own it"
                }
                _ => continue,
            };
            let problem = format!("is also views[{view}].{other}: {differs}");
            return Err(Error::argument(field_of(field, host), problem));
        }
    }
    Ok(())
}

/// Names the view of an error, if there are several views.
pub(super) fn in_view(error: Error, index: usize, views: &[RecordedFrame<'_>]) -> Error {
    if views.len() == 1 {
        return error;
    }
    let view = format!("views[{index}]");
    match error {
        // The field belongs to the reservation; the frame and its scenes belong to the view.
        Error::Argument { what, problem } if what.starts_with(RESERVATION) => {
            let problem = problem.replace("the frame", &view).replace("scenes[", &format!("{view}.scenes["));
            Error::argument(what, problem)
        }
        Error::TooLarge { what, needed, unit, limit, limit_name } => {
            Error::TooLarge { what: format!("{view}.{what}"), needed, unit, limit, limit_name }
        }
        other => other.within(&view),
    }
}
