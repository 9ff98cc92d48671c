//! Notes and warnings about the size at which photos are used.

use crate::images::{AUTO_MAX_WIDTH, Resolution};

/// A width below this may have been meant as a divisor.
const SMALL_WIDTH: u32 = 100;

/// A warning about photos of these sizes, in pixels, if any is scaled in a way that was not explicitly requested.
pub(super) fn warning(sizes: &[(u32, u32)], resolution: Resolution) -> Option<String> {
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
    Some(format!(
        "{} of {} photos, of up to {width}x{height} pixels, are used at {used_width}x{used_height}: {why}",
        scaled.len(),
        sizes.len()
    ))
}

/// The requested divisor of the photos, if it is above 1.
pub(super) fn divisor(resolution: Resolution) -> Option<u32> {
    match resolution {
        Resolution::Factor(by) if by > 1 => Some(by),
        _ => None,
    }
}

/// The largest size, by area, then by width, and "up to " if not all are equal.
pub(super) fn largest(sizes: &[(u32, u32)]) -> Option<((u32, u32), &'static str)> {
    let area_and_width = |&&(width, height): &&(u32, u32)| (u64::from(width) * u64::from(height), width);
    let largest = *sizes.iter().max_by_key(area_and_width)?;
    Some((largest, if sizes.iter().all(|&size| size == largest) { "" } else { "up to " }))
}

/// A note on the size at which photos of these sizes, in pixels, are used after the requested division.
pub(super) fn note(sizes: &[(u32, u32)], resolution: Resolution) -> Option<String> {
    let by = divisor(resolution)?;
    let ((width, height), up_to) = largest(sizes)?;
    let (used_width, used_height) = resolution.apply(width, height);
    Some(format!(
        "photos of {up_to}{width}x{height} pixels are used at {used_width}x{used_height} pixels (-r {by})"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    #[test]
    fn surprises_are_told_with_the_size() {
        let _turn = turn();
        let sizes = [(1600, 1200), (4000, 3000), (3000, 4000)];
        let of = |resolution| warning(&sizes, resolution);
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
        let said = note(&sizes, Resolution::Factor(8));
        assert_eq!(
            said.as_deref(),
            Some("photos of up to 4000x3000 pixels are used at 500x375 pixels (-r 8)")
        );
        assert_eq!(note(&sizes, Resolution::Factor(1)), None);
        assert_eq!(warning(&sizes[..1], Resolution::Auto), None);
        assert_eq!(warning(&[], Resolution::Auto), None);
    }
}
