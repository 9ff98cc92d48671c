//! Gradients, the 3D filter, alignment and LPIPS in C have the same bits as in Rust.

use crate::cloud;
use crate::hosts::host_in_c;
use crate::lpips_files;
use ashsplat::passes::lpips::Lpips;
use ashsplat::scene::{Camera, Intrinsics, Photo};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{Alignment, RenderSettings, Renderer};
use ashsplat_files::{HostMemory, lpips_weights, splats};
use glam::Vec3;

const SIZE: (u32, u32) = (64, 48);

/// Remaining results that the program has written.
struct Results(std::vec::IntoIter<u8>);

impl Results {
    fn floats(&mut self, count: usize) -> Vec<f32> {
        let bytes: Vec<u8> = self.0.by_ref().take(4 * count).collect();
        let floats = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect::<Vec<_>>();
        assert_eq!(floats.len(), count);
        floats
    }
}

#[test]
fn a_host_in_c_has_gradients_and_measures() {
    let folder = tempfile::tempdir().expect("a folder");
    let [scene, network, results] =
        ["scene.ply", "alex.safetensors", "results.bin"].map(|name| folder.path().join(name));
    splats::write(&scene, &cloud(), &Default::default()).expect("a PLY");
    lpips_files::write(&network, &lpips_files::alexnet(7));
    let said = host_in_c("train", "measures", &[&scene, &network, &results]);
    assert!(said.contains("lpips_alex 0."), "{said}");
    let mut results = Results(std::fs::read(&results).expect("results").into_iter());

    // Same as in a host's device, which has no texels.
    let context =
        Context::new(&ContextOptions { texels: false, ..ContextOptions::default() }).expect("a device");
    let mut renderer = Renderer::new(&context).expect("kernels");
    let read = splats::read(&scene, &splats::ReadOptions::default()).expect("a scene").gaussians;
    renderer.upload(&read).expect("uploaded");
    let intrinsics = Intrinsics::from_fov_x(0.7, SIZE.0, SIZE.1);
    let cameras =
        [0.0, 1.0].map(|x| Camera::look_at(Vec3::new(x, -1.0, -4.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics));
    let background = [0.1, 0.2, 0.3];
    let plain = RenderSettings { background, ..RenderSettings::default() };
    let settings = RenderSettings {
        antialias: true,
        antialias_detached: true,
        dilation_px2: 0.1,
        filter_3d: true,
        inverse_depth: true,
        ..plain
    };
    renderer.compute_filters(&cameras).expect("the filter");
    assert_eq!(results.floats(500), renderer.filters().expect("its sizes"));
    let frame = renderer.render(&cameras[0], &settings).expect("a frame");
    let pixels = frame.color.len();
    assert_eq!(results.floats(3 * pixels), frame.color.as_flattened());

    let of_image: Vec<[f32; 3]> = (0..pixels)
        .map(|p| [0, 1, 2].map(|c| ((3 * p + c) * 7 % 13) as f32 - 6.0).map(|x| x / 8.0))
        .collect();
    let of_depth: Vec<f32> = (0..pixels).map(|p| ((p * 5 % 11) as f32 - 5.0) / 16.0).collect();
    let gradients = renderer.gradients_with_pose(&cameras[0], &settings, &of_image, Some(&of_depth));
    let gradients = gradients.expect("gradients");
    let of = &gradients.parameters;
    let pose = gradients.pose.expect("the pose's");
    let all: [(&str, &[f32]); 7] = [
        ("means", of.means.as_flattened()),
        ("quats", of.quats.as_flattened()),
        ("log_scales", of.log_scales.as_flattened()),
        ("opacity_logits", &of.opacity_logits),
        ("sh", of.sh.as_flattened()),
        ("mean2d_px", gradients.mean2d_px.as_flattened()),
        ("pose", &pose),
    ];
    for (name, expected) in all {
        assert_eq!(results.floats(expected.len()), expected, "{name}");
        assert!(expected.iter().any(|x| *x != 0.0), "{name}");
    }

    let picture = renderer.render(&cameras[0], &plain).expect("a frame").color;
    let rgb: Vec<u8> = results.0.by_ref().take(3 * pixels).collect();
    let photo = Photo { width: SIZE.0, height: SIZE.1, rgb };
    let away = |(byte, x): (&u8, &f32)| (f32::from(*byte) - 255.0 * x.clamp(0.0, 1.0)).abs();
    assert!(photo.rgb.iter().zip(picture.as_flattened()).map(away).fold(0.0, f32::max) < 0.51);
    let mut moved = cameras[0];
    moved.translation.x += 0.03;
    let alignment = Alignment { steps: 40, ..Alignment::default() };
    let aligned = renderer.align(&moved, &photo.into(), &plain, &alignment).expect("aligned");
    let rows = aligned.camera_from_world.transpose().to_cols_array();
    assert_eq!(results.floats(9), rows);
    assert_eq!(results.floats(3), aligned.translation.to_array());
    let off = (aligned.translation - cameras[0].translation).length();
    assert!(off < 0.01, "{off} of 0.03 are left");

    let weights = lpips_weights::read(&network, &HostMemory::default()).expect("weights");
    let mut lpips = Lpips::new(&context, &weights).expect("a network");
    let expected = lpips.distance([&picture, &frame.color], SIZE).expect("a distance");
    let bytes: Vec<u8> = results.0.by_ref().collect();
    assert_eq!(bytes, expected.to_le_bytes(), "LPIPS {expected}");
}
