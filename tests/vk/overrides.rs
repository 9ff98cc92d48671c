//! Overridden specialization constants, and the fill of tiles.

use crate::common::prelude::*;

fn scene() -> (Gaussians, Camera) {
    let scene = gaussians(&small_scene(&mut Random::new(3), 600, 4));
    (scene, camera(&small_view([120, 90])))
}

fn override_of(kernel: &str, constant: &str, bits: u32) -> SpecOverride {
    SpecOverride { kernel: kernel.to_owned(), constant: constant.to_owned(), bits }
}

fn render(overrides: Vec<SpecOverride>) -> Frame {
    let context = Context::new(&ContextOptions { overrides, ..crate::common::options() }).expect("a device");
    let mut renderer = Renderer::new(&context).expect("kernels");
    let (gaussians, camera) = scene();
    renderer.upload(&gaussians).expect("memory");
    let frame = renderer.render(&camera, &RenderSettings::default()).expect("a frame");
    crate::common::assert_silent(&context);
    frame
}

#[test]
fn block_sizes_change_no_pixel() {
    let usual = render(Vec::new());
    assert!(usual.stats.instances > 1000, "{:?}", usual.stats);
    for (kernel, constant, bits) in [
        ("sort", "ITEMS", 4),
        ("scan", "ITEMS", 2),
        ("", "WORKGROUP_SIZE", 64),
        ("sort", "WORKGROUP_SIZE", 32),
    ] {
        let other = render(vec![override_of(kernel, constant, bits)]);
        assert_eq!(other.color, usual.color, "{kernel} {constant} = {bits}");
    }
}

#[test]
fn a_constant_of_one_kernel_can_be_overridden() {
    let usual = render(Vec::new());
    let plain = render(vec![override_of("forward/project", "SH_DEGREE", 0)]);
    assert_ne!(plain.color, usual.color);
    assert_eq!(render(vec![override_of("sort/sort_upsweep", "SH_DEGREE", 0)]).color, usual.color);
}

#[test]
fn tiles_add_up_to_the_frame() {
    let context = crate::common::context();
    let mut renderer = Renderer::new(context).expect("kernels");
    let (gaussians, camera) = scene();
    renderer.upload(&gaussians).expect("memory");
    let stats = renderer.render(&camera, &RenderSettings::default()).expect("a frame").stats;
    let (_, tiles) = renderer.render_with_tiles(&camera, &RenderSettings::default()).expect("tiles");
    assert_eq!((tiles.columns, tiles.rows), (8, 6));
    assert_eq!(tiles.entries.iter().sum::<u32>(), stats.instances);
    assert_eq!(tiles.entries.iter().max(), Some(&stats.longest_tile));
    assert!(tiles.blended.iter().zip(&tiles.entries).all(|(blended, entries)| blended <= entries));
    assert!(tiles.blended.iter().any(|&blended| blended > 0));
}
