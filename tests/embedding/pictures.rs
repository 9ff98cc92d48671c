//! The example's pictures, drawn with validation and synchronization validation.

use crate::guest::{PICTURES, SIZE, pictures};
use crate::stage::options;

#[test]
fn the_example_draws_its_pictures_in_silence() {
    let folder = tempfile::tempdir().expect("a folder");
    let report = pictures(folder.path(), &options()).expect("pictures");
    assert!(report.iter().all(|line| !line.contains("too few")), "{report:#?}");
    let read = |name: &str| {
        let path = folder.path().join(format!("embed_{name}.png"));
        image::open(path).expect("a picture").into_rgba8()
    };
    for picture in PICTURES {
        assert_eq!(read(picture.name).dimensions(), SIZE.into());
    }
    // Standard and reversed depth give the same picture; rounding may only change edges.
    let (standard, reversed) = (read("standard"), read("reversed"));
    let differs =
        |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| a.0.iter().zip(b.0).any(|(x, y)| x.abs_diff(y) > 2);
    let different = standard.pixels().zip(reversed.pixels()).filter(differs).count();
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    assert!(different < pixels / 500, "{different} of {pixels} pixels differ");
    // The second scene is visible.
    let changed = reversed.pixels().zip(read("two_scenes").pixels()).filter(|(a, b)| a != b).count();
    assert!(changed > pixels / 50, "{changed}");
    // The pass after the splats has drawn its background in the corner.
    assert_eq!(standard.get_pixel(2, 2).0, [26, 31, 41, 255]);
    // The ring in front hides the crate, and the crate hides the ring behind it: both kinds of pixel exist.
    let is_wood = |p: &&image::Rgba<u8>| p.0[0] > p.0[1] && p.0[1] > p.0[2] && p.0[0].abs_diff(p.0[2]) > 50;
    let wood = standard.pixels().filter(is_wood).count();
    assert!((pixels / 50..pixels / 3).contains(&wood), "{wood} pixels of the crate");
}

/// Writing a picture fails while another frame is in flight. The example waits, destroys everything and reports the
/// error.
#[test]
fn the_example_cleans_up_when_it_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    let error = pictures(&folder.path().join("none"), &options()).expect_err("no folder").to_string();
    assert!(!error.contains("validation"), "{error}");
}
