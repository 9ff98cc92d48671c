//! Reading back what each tile blends: [`ashsplat::TileLists`].

use crate::common::prelude::*;

/// The lists have every instance once, front to back, in tiles that the Gaussian meets. A pixel's samples belong to
/// its tile.
#[test]
fn tile_lists_are_those_of_the_frame() {
    let scene = gaussians(&mixed_scene(&mut Random::new(17), 700, 16));
    let (camera, settings) = (camera(&small_view([75, 43])), RenderSettings::default());
    let mut renderer = renderer();
    renderer.upload(&scene).expect("a scene");
    let stats = renderer.render(&camera, &settings).expect("a picture").stats;
    let lists = renderer.tile_lists(&camera, &settings).expect("lists");
    assert_eq!((lists.tiles_per_row, lists.ranges.len()), (5, 15));
    assert_eq!(lists.splats.len(), stats.visible as usize);
    assert_eq!(lists.entries.len(), stats.instances as usize);
    assert!(lists.splats.is_sorted_by(|a, b| a.gaussian < b.gaussian), "the scene's order");
    let filled = lists.ranges.iter().filter(|[begin, end]| begin < end);
    assert_eq!(filled.clone().map(|[begin, end]| end - begin).sum::<u32>(), stats.instances);
    assert_eq!(filled.clone().map(|[begin, end]| end - begin).max(), Some(stats.longest_tile));
    for &[begin, end] in filled {
        let list = &lists.entries[begin as usize..end as usize];
        let depth = |visible: &u32| lists.splats[*visible as usize].depth;
        assert!(list.is_sorted_by(|a, b| depth(a) <= depth(b)), "{list:?}");
        let mut seen = list.to_vec();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), list.len(), "a Gaussian is twice in a tile");
    }
    let mut samples = 0;
    for pixel in [[37, 21], [20, 30], [60, 12]] {
        let report = renderer.inspect(&camera, &settings, pixel).expect("a report");
        let [begin, end] = lists.ranges[(pixel[1] / 16 * 5 + pixel[0] / 16) as usize];
        let mut list = lists.entries[begin as usize..end as usize].iter();
        for sample in &report.samples {
            let splat = list.find_map(|&visible| {
                let splat = &lists.splats[visible as usize];
                (splat.gaussian == sample.gaussian).then_some(splat)
            });
            let splat = splat.expect("it is in the tile's list, behind the one before");
            assert_eq!(splat.depth, sample.depth);
            let [dx, dy] = [0, 1].map(|axis| splat.mean2d_px[axis] - pixel[axis] as f32);
            let [a, b, c] = splat.conic;
            let alpha = splat.opacity * (-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy).exp();
            assert!((alpha.min(0.99) - sample.alpha).abs() < 1e-5, "{sample:?}");
            samples += 1;
        }
    }
    assert!(samples > 5, "{samples} samples");
}
