//! The example's pictures, drawn with validation and synchronisation validation.

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
    // Standard and reversed depth show the same: only edges may hang on rounding.
    let (standard, reversed) = (read("standard"), read("reversed"));
    let differs =
        |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| a.0.iter().zip(b.0).any(|(x, y)| x.abs_diff(y) > 2);
    let different = standard.pixels().zip(reversed.pixels()).filter(differs).count();
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    assert!(different < pixels / 500, "{different} of {pixels} pixels differ");
    // The second scene is seen.
    let changed = reversed.pixels().zip(read("two_scenes").pixels()).filter(|(a, b)| a != b).count();
    assert!(changed > pixels / 50, "{changed}");
    // The pass behind the splats has left its background in the corner, at the usual place.
    assert_eq!(standard.get_pixel(2, 2).0, [26, 31, 41, 255]);
    // The ring before the crate hides it, the crate the ring behind it: both kinds of pixel are there.
    let is_wood = |p: &&image::Rgba<u8>| p.0[0] > p.0[1] && p.0[1] > p.0[2] && p.0[0].abs_diff(p.0[2]) > 50;
    let wood = standard.pixels().filter(is_wood).count();
    assert!((pixels / 50..pixels / 3).contains(&wood), "{wood} pixels of the crate");
}

/// A picture that cannot be written, while another frame is in flight: everything is over before it goes, and gone.
#[test]
fn the_example_cleans_up_when_it_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    let error = pictures(&folder.path().join("none"), &options()).expect_err("no folder").to_string();
    assert!(!error.contains("validation"), "{error}");
}
