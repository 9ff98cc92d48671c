//! Pictures after Gaussians are moved, decimated and stored.

use crate::common::prelude::*;
use crate::common::splats::scene;
use ashsplat::scene::{Intrinsics, Similarity};
use ashsplat_files::decimate::decimate;
use ashsplat_files::metrics;
use ashsplat_files::splats::{self, Format, WriteOptions};
use glam::{DQuat, DVec3, EulerRot};

/// A ball that fills the picture, with strongly view-dependent colours.
fn ball() -> Gaussians {
    let mut gaussians = scene(4000, 3);
    gaussians.means.as_flattened_mut().iter_mut().for_each(|v| *v *= 0.1);
    gaussians.log_scales.as_flattened_mut().iter_mut().for_each(|s| *s = 0.5 * *s - 2.5);
    gaussians
}

fn camera() -> Camera {
    let eye = Vec3::new(1.5, -1.0, -3.5);
    Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.7, 160, 120))
}

fn render(gaussians: &Gaussians, camera: &Camera) -> Vec<[f32; 3]> {
    let mut renderer = renderer();
    renderer.upload(gaussians).expect("upload");
    renderer.render(camera, &RenderSettings::default()).expect("a frame").color
}

fn psnr(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    metrics::psnr(a, b, None).expect("one size")
}

/// The camera that sees the moved scene as `camera` sees the original.
fn moved(camera: &Camera, similarity: &Similarity) -> Camera {
    let back = similarity.rotation.inverse();
    let rotation = camera.camera_from_world.as_dmat3() * glam::DMat3::from_quat(back);
    let translation = similarity.scale * camera.translation.as_dvec3() - rotation * similarity.translation;
    Camera { camera_from_world: rotation.as_mat3(), translation: translation.as_vec3(), ..*camera }
}

/// A similarity applies to means, shapes and spherical harmonics: the moved camera sees the same picture.
#[test]
fn splats_moved_with_their_camera_look_the_same() {
    let _gpu = Gpu::new();
    let before = render(&ball(), &camera());
    for (x, y, z, scale) in
        [(0.4, -1.2, 2.5, 1.0), (0.0, 0.0, std::f64::consts::PI, 3.0), (-2.0, 0.3, 0.1, 0.7)]
    {
        let similarity = Similarity {
            rotation: DQuat::from_euler(EulerRot::ZYX, z, y, x),
            scale,
            translation: DVec3::new(3.0, -5.0, 1.0),
        };
        let mut gaussians = ball();
        gaussians.transform(&similarity);
        let psnr = |gaussians: &Gaussians| psnr(&before, &render(gaussians, &moved(&camera(), &similarity)));
        let right = psnr(&gaussians);
        assert!(right > 60.0, "{similarity:?}: {right:.1} dB");
        // Without the rotation of the spherical harmonics the picture differs.
        gaussians.sh = ball().sh;
        let wrong = psnr(&gaussians);
        assert!(wrong < 40.0, "{wrong:.1} dB");
    }
}

/// Merging half of the Gaussians resembles the whole more than keeping the most opaque or largest half.
#[test]
fn splats_decimated_look_alike() {
    let _gpu = Gpu::new();
    let mut all = ball();
    // Neighbours have similar colours, as in real scenes.
    for (sh, mean) in all.sh.chunks_exact_mut(16).zip(&all.means) {
        sh.fill([0.0; 3]);
        sh[0] = [0, 1, 2].map(|i| (4.0 * mean[i] + mean[(i + 1) % 3]).sin());
    }
    let before = render(&all, &camera());
    let mut merged = all.clone();
    decimate(&mut merged, all.len() / 2);
    let psnr = |gaussians: &Gaussians| psnr(&before, &render(gaussians, &camera()));
    let merged = psnr(&merged);
    let best = |key: &dyn Fn(usize) -> f32| {
        let mut order: Vec<usize> = (0..all.len()).collect();
        order.sort_by(|&a, &b| key(b).total_cmp(&key(a)));
        psnr(&all.select(&order[..all.len() / 2]))
    };
    let opaque = best(&|i| all.opacity(i));
    let large = best(&|i| all.opacity(i) * all.log_scales[i].iter().sum::<f32>().exp());
    assert!(merged > opaque && merged > large, "merged {merged:.1}, opaque {opaque:.1}, large {large:.1} dB");
    assert!(merged > 20.0, "{merged:.1} dB");
}

/// Loss of each format's quantisation, in dB, for an unordered scene.
#[test]
fn splats_stored_in_any_format_look_alike() {
    let _gpu = Gpu::new();
    let folder = tempfile::tempdir().expect("a temporary folder");
    for format in Format::WRITTEN {
        // A SOG's palette has too few vectors for random spherical harmonics.
        let sh_degree = if format == Format::Sog { 0 } else { format.max_sh_degree() };
        let original = ball().with_sh_degree(sh_degree);
        let path = folder.path().join(format!("ball{}", format.extension()));
        splats::write(&path, &original, &WriteOptions::default()).expect("written");
        let read = splats::read(&path, &Default::default()).expect("read").gaussians;
        let psnr = psnr(&render(&original, &camera()), &render(&read, &camera()));
        let min_psnr = match format {
            Format::Ply => f64::INFINITY,
            Format::Glb | Format::Gltf | Format::Usda => 90.0,
            Format::CompressedPly | Format::Splat => 38.0,
            Format::Spz => 30.0,
            Format::Sog => 36.0,
            Format::Ksplat => unreachable!("it is not written"),
        };
        assert!(psnr >= min_psnr, "{format}: {psnr:.1} dB");
    }
}
