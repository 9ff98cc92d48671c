//! The PlayCanvas engine in headless Chromium draws our files as we do.

use super::{compare, compare_at_least, once_more_with_patience, read, run_script};
use crate::common::engine::renderer;
use crate::common::splats::scene;
use ashsplat::RenderSettings;
use ashsplat::scene::{Camera, Gaussians, Intrinsics};
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, Format, WriteOptions};
use ashsplat_files::tiles;
use ashsplat_files::{Photo, PhotoFileFormat};
use glam::{Mat3, Quat, Vec3};
use std::path::Path;

const MIN_PSNR: f64 = 30.0;
/// Number of frames to wait, a fifth of a second each.
const STILL_FRAMES: u32 = 3;

pub fn shows_the_same(modules: &Path, format: Format) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("scene{}", format.extension()));
    splats::write(&path, &ball(), &WriteOptions::default()).unwrap();
    let camera = camera();
    let picture = folder.path().join("playcanvas.png");
    let ours = render(&read(&path), &camera);
    let name = format!("playcanvas{}", format.extension());
    once_more_with_patience(STILL_FRAMES, |still_frames| {
        draw(modules, &path, &camera, &picture, (false, still_frames));
        compare_at_least(MIN_PSNR, &name, &ours, &Photo::read(&picture, [0.0; 3]).unwrap())
    });
    let bright = ours.rgb.iter().filter(|&&v| v > 60).count();
    assert!(bright > ours.rgb.len() / 4, "an empty picture proves nothing");
}

/// PlayCanvas streams our levels of detail. Near the scene it draws the finest.
pub fn shows_our_streamed_sog(modules: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ply");
    splats::write(&scene, &ball(), &WriteOptions::default()).unwrap();
    let tree = folder.path().join("tree");
    tiles::write_streamed_sog(&scene, &tree, 1000, &Default::default(), &Progress::NONE).unwrap();
    let (camera, picture) = (camera(), folder.path().join("playcanvas.png"));
    let ours = render(&read(&tree), &camera);
    once_more_with_patience(STILL_FRAMES, |still_frames| {
        draw(modules, &tree.join("lod-meta.json"), &camera, &picture, (false, still_frames));
        let theirs = Photo::read(&picture, [0.0; 3]).unwrap();
        compare_at_least(MIN_PSNR, "playcanvas_streamed_sog", &ours, &theirs)
    });
}

/// Gaussians that fill the picture, with soft colours, because clamping differs at the limits of 8 bits.
pub fn ball() -> Gaussians {
    let mut gaussians = scene(6000, 3);
    gaussians.means.as_flattened_mut().iter_mut().for_each(|v| *v *= 0.12);
    gaussians.log_scales.as_flattened_mut().iter_mut().for_each(|s| *s = 0.5 * *s - 2.2);
    gaussians.sh.as_flattened_mut().iter_mut().for_each(|c| *c *= 0.4);
    gaussians
}

/// A camera that looks at the ball along no axis.
pub fn camera() -> Camera {
    let intrinsics = Intrinsics::from_fov_x(0.8, 400, 300);
    Camera::look_at(Vec3::new(1.5, -1.0, -3.5), Vec3::new(0.1, 0.0, 0.0), Vec3::NEG_Y, intrinsics)
}

/// A trained scene from outside. Most of its Gaussians are about as large as a pixel, so the engine's smaller
/// dilation shows (26.6 dB). Its 0.3 are in squares of half pixels. Our picture at twice the size has that dilation,
/// and its pixels at the engine's pixel centres form the expected picture. The reference's dilation in the engine's
/// shader is compared, too.
pub fn shows_a_trained_scene(modules: &Path, scene: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    std::fs::copy(scene, &path).unwrap();
    let camera = Camera::look_at(
        Vec3::new(-0.4, -1.0, -4.5),
        Vec3::new(-0.4, 0.15, 0.2),
        Vec3::NEG_Y,
        Intrinsics::from_fov_x(60f32.to_radians(), 640, 360),
    );
    let gaussians = read(&path);
    let (ours, in_half_pixels) = (render(&gaussians, &camera), render_in_half_pixels(&gaussians, &camera));
    once_more_with_patience(STILL_FRAMES, |still_frames| {
        let theirs = [false, true].map(|reference_dilation| {
            let picture = folder.path().join("playcanvas.png");
            draw(modules, &path, &camera, &picture, (reference_dilation, still_frames));
            Photo::read(&picture, [0.0; 3]).unwrap()
        });
        compare_dilations([&ours, &in_half_pixels], &theirs)
    });
}

/// Compares ashsplat's pictures with those of PlayCanvas. Each has two dilations: one in pixels, the reference's, and one in
/// half pixels, PlayCanvas's own.
fn compare_dilations(
    [ours, in_half_pixels]: [&Photo; 2],
    [own, reference]: &[Photo; 2],
) -> Result<(), String> {
    let unlike = compare("playcanvas_trained_own", ours, own);
    let theirs = compare("playcanvas_trained_half_pixels", in_half_pixels, own);
    let references = compare("playcanvas_trained_reference", ours, reference);
    let min_psnr = MIN_PSNR.max(unlike + 5.0);
    if theirs >= min_psnr && references >= min_psnr {
        return Ok(());
    }
    Err(format!("{theirs:.2} dB, {references:.2} dB, and {unlike:.2} dB without either"))
}

/// Our picture with a dilation of 0.3 squares of half pixels.
fn render_in_half_pixels(gaussians: &Gaussians, camera: &Camera) -> Photo {
    let large = Camera {
        fx: 2.0 * camera.fx,
        fy: 2.0 * camera.fy,
        // The centre of each pixel becomes that of its upper left quarter.
        cx: 2.0 * camera.cx - 0.5,
        cy: 2.0 * camera.cy - 0.5,
        width: 2 * camera.width,
        height: 2 * camera.height,
        ..*camera
    };
    let photo = render(gaussians, &large);
    let pixels = photo.rgb.as_chunks::<3>().0;
    let rows = pixels.chunks(large.width as usize).step_by(2);
    let rgb = rows.flat_map(|row| row.iter().step_by(2).copied()).flatten().collect();
    Photo { width: camera.width, height: camera.height, rgb }
}

pub fn render(gaussians: &Gaussians, camera: &Camera) -> Photo {
    let mut renderer = renderer();
    renderer.upload(gaussians).unwrap();
    let frame = renderer.render(camera, &RenderSettings::default()).unwrap();
    Photo::from_f32(frame.width, frame.height, &frame.color).unwrap()
}

fn draw(
    modules: &Path,
    scene: &Path,
    camera: &Camera,
    output: &Path,
    (reference_dilation, still_frames): (bool, u32),
) {
    let r = camera.camera_from_world;
    // From y up and z backward to the world.
    let world_from_camera = Mat3::from_cols(r.row(0), -r.row(1), -r.row(2));
    let description = serde_json::json!({
        "width": camera.width,
        "height": camera.height,
        "fov_y_degrees": 2.0 * (0.5 * camera.height as f32 / camera.fy).atan().to_degrees(),
        "eye": camera.position().to_array(),
        "quat": Quat::from_mat3(&world_from_camera).to_array(),
        "reference_dilation": reference_dilation,
        "still_frames": still_frames,
    });
    let file = output.with_extension("json");
    std::fs::write(&file, description.to_string()).unwrap();
    run_script("playcanvas.mjs", &[modules, scene, &file, output]);
}
