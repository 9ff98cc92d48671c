//! Overridden specialization constants, and the fill of tiles.

use ashsplat::scene::{Camera, Gaussians, Intrinsics, PointCloud};
use ashsplat::vk::{Context, ContextOptions, SpecOverride};
use ashsplat::{Frame, RenderSettings, Renderer};
use glam::Vec3;

/// A curved wall of 3000 Gaussians with view-dependent colours, and a camera in front of it.
fn scene() -> (Gaussians, Camera) {
    let place =
        |i: u32| [(i % 60) as f32 / 30.0 - 1.0, (i / 60) as f32 / 25.0 - 1.0, ((i * i) % 7) as f32 * 0.02];
    let points = PointCloud {
        positions: (0..3000).map(place).collect(),
        colors: (0..3000u32).map(|i| [(i % 251) as u8, (i % 83) as u8, 120]).collect(),
    };
    let mut gaussians = ashsplat_files::initial_gaussians(&points, 1).expect("Gaussians");
    gaussians.opacity_logits.fill(1.0);
    for (index, color) in gaussians.sh.iter_mut().enumerate().filter(|(index, _)| index % 4 != 0) {
        *color = [0.1 * (index % 3) as f32, 0.2, 0.1];
    }
    let intrinsics = Intrinsics::from_fov_x(0.9, 120, 90);
    (gaussians, Camera::look_at(Vec3::new(0.3, 0.1, -2.2), Vec3::ZERO, Vec3::NEG_Y, intrinsics))
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
