//! Orthographic cameras: pictures of known Gaussians by formula, and of random ones by the twin.

use crate::common::engine::settings;
use crate::common::prelude::*;
use crate::reference::pipeline;
use ashsplat::passes::filter_3d::Filter3d;
use ashsplat::scene::{ClipY, HostView, Intrinsics, Projection, WorldFrame};
use ashsplat_files::cameras_json;
use glam::camera::rh::view::look_at_mat4;
use glam::{Mat3, Mat4, Vec4};

const SIZE: [u32; 2] = [64, 48];
/// Pixels per unit.
const SCALE: [f32; 2] = [8.0, 6.0];

/// Looks along the world's z axis, with the origin in the middle of the picture.
fn along_z() -> Camera {
    let [fx, fy] = SCALE;
    let [width, height] = SIZE;
    let intrinsics = Intrinsics { fx, fy, cx: 32.5, cy: 24.5, width, height };
    Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, intrinsics).orthographic()
}

/// One Gaussian along the axes: SH degree 1, red when seen along +z.
fn one(mean: [f32; 3], sigmas: [f32; 3], logit: f32) -> Gaussians {
    Gaussians {
        sh_degree: 1,
        means: vec![mean],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![sigmas.map(f32::ln)],
        opacity_logits: vec![logit],
        sh: vec![[0.0; 3], [0.0, 0.25, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.75]],
    }
}

/// Depth order, spherical harmonics, turned cameras and antialiasing equal the twin's blending.
#[test]
fn orthographic_pictures_equal_the_twins() {
    let _gpu = Gpu::new();
    for (seed, antialias, sh_degree) in [(1, false, 3), (2, true, 1), (3, false, 0)] {
        let scene = small_scene(&mut Random::new(seed), 120, 16);
        let drawn = Style { orthographic: true, ..Style::AS_THEY_ARE };
        let center_px = [30.0, 17.0];
        let view =
            View { drawn, antialias, sh_degree, center_px, focal_px: [14.0, 15.5], ..small_view([53, 37]) };
        let expected = pipeline::render(&scene, &view);
        let mut renderer = renderer();
        renderer.upload(&gaussians(&scene)).expect("a scene");
        let frame = renderer.render(&camera(&view), &settings(&view)).expect("a frame");
        let mut off = 0;
        for (index, pixel) in expected.pixels.iter().enumerate() {
            let actual = frame.color[index];
            let near = |channel: usize| (f64::from(actual[channel]) - pixel.color[channel]).abs();
            let worst = (0..3).map(near).fold(0.0, f64::max);
            assert!(worst < 2e-2, "{seed}, pixel {index}: {actual:?}, {:?}", pixel.color);
            off += usize::from(worst > 5e-5);
        }
        // Decisions that depend on rounding.
        assert!(off <= expected.pixels.len() / 100, "{off} pixels");
        assert!(frame.stats.visible > 60, "{}", frame.stats.visible);
        // A pinhole gives another picture.
        let pinhole = Camera { projection: Projection::Perspective, ..camera(&view) };
        assert_ne!(renderer.render(&pinhole, &settings(&view)).expect("a frame").color, frame.color);
    }
}

/// Errors name the field of features that only pinholes support.
#[test]
fn orthographic_cameras_have_no_gradients() {
    let mut renderer = renderer();
    renderer.upload(&one([0.0, 0.0, 3.0], [0.5; 3], 1.0)).expect("a scene");
    let ones = vec![[1.0; 3]; (SIZE[0] * SIZE[1]) as usize];
    let refused = renderer.gradients(&along_z(), &RenderSettings::default(), &ones, None);
    assert_says(refusal(refused), &["camera.projection", "orthographic"]);
    drop(renderer);
    assert_says(refusal(Filter3d::new(context(), &[along_z()], None)), &["camera.projection"]);
    let [width, height] = SIZE;
    let photo = Photo { width, height, rgb: vec![128; 3 * (width * height) as usize] };
    let run = Run::shared(vec![TrainView::new(along_z(), photo)], TrainSettings::reference());
    let run = run.starting_at(&one([0.0, 0.0, 3.0], [0.5; 3], 1.0));
    assert_says(refusal(run.try_begin()), &["view 0.camera.projection: is orthographic"]);
}

/// A host's matrices with standard and reversed depth, y up and down, off-centre, near planes before and behind the
/// eye: pixels and depths of points equal those of the matrices.
#[test]
fn orthographic_matrices_become_a_camera() {
    let view_from_world = look_at_mat4(Vec3::new(1.0, 2.0, 5.0), Vec3::new(0.0, 0.5, 0.0), Vec3::Y);
    let host = |clip_from_view, clip_y| HostView {
        view_from_world,
        clip_from_view,
        clip_y,
        width: 640,
        height: 480,
    };
    for (near, far) in [(0.5_f32, 20.0_f32), (-10.0, 30.0), (0.0, 8.0)] {
        for (reversed, clip_y) in
            [(false, ClipY::Down), (true, ClipY::Down), (false, ClipY::Up), (true, ClipY::Up)]
        {
            let up = if clip_y == ClipY::Up { 1.0 } else { -1.0 };
            // The view looks along -z: z = -z_view.
            let (d_near, d_far) = if reversed { (1.0, 0.0) } else { (0.0, 1.0) };
            let per_z = (d_far - d_near) / (far - near);
            let clip_from_view = Mat4::from_cols(
                Vec4::new(0.25, 0.0, 0.0, 0.0),
                Vec4::new(0.0, up / 3.0, 0.0, 0.0),
                Vec4::new(0.0, 0.0, -per_z, 0.0),
                Vec4::new(0.125, -0.0625, d_near - per_z * near, 1.0),
            );
            let (camera, mapping) = host(clip_from_view, clip_y).camera().expect("a camera");
            assert!(camera.is_orthographic() && mapping.linear);
            assert_eq!(mapping.clear_value, d_far);
            for point in [Vec3::ZERO, Vec3::new(1.0, -0.5, 0.25), Vec3::new(-2.0, 1.5, 1.0)] {
                let clip = clip_from_view * view_from_world * point.extend(1.0);
                let (x, y, z) = camera.project(point);
                let down = if clip_y == ClipY::Up { -clip.y } else { clip.y };
                assert!((x - 320.0 * (1.0 + clip.x)).abs() < 1e-3, "{x}");
                assert!((y - 240.0 * (1.0 + down)).abs() < 1e-3, "{y}");
                assert!((mapping.z(clip.z) - z).abs() < 1e-4, "{} {z}", mapping.z(clip.z));
                assert!((mapping.depth(z) - clip.z).abs() < 1e-5, "{} {}", mapping.depth(z), clip.z);
            }
            // Drawing starts at the near plane, or farther if the host says so.
            let at_near = mapping.z(d_near);
            assert!((at_near - near.max(0.2)).abs() < 1e-5, "{at_near}");
        }
    }
    // Around the eye, a mirrored view with standard depth equals a backward view with reversed depth.
    let around = |y: f32| {
        let third = Vec4::new(0.0, 0.0, -1.0 / 40.0, 0.0);
        let clip_from_view =
            Mat4::from_cols(Vec4::X * 0.25, Vec4::Y * y, third, Vec4::new(0.0, 0.0, 0.25, 1.0));
        host(clip_from_view, ClipY::Up).camera().expect("a camera")
    };
    let ((camera, standard), (back, reversed)) = (around(0.25), around(-0.25));
    assert_eq!((standard.clear_value, reversed.clear_value), (1.0, 0.0));
    let opposite = camera.camera_from_world.row(2) + back.camera_from_world.row(2);
    assert!(opposite.length() < 1e-6, "{opposite}");
    let wrong = Mat4::from_cols(Vec4::X, Vec4::Y, Vec4::new(0.0, 0.1, 1.0, 0.0), Vec4::W);
    let mirrored = Mat4::from_cols(Vec4::X, Vec4::Y, -Vec4::Z * 0.1, Vec4::W);
    for (clip_from_view, clip_y, expected) in
        [(wrong, ClipY::Up, "skewed"), (mirrored, ClipY::Down, "mirror the picture")]
    {
        assert_says(refusal(host(clip_from_view, clip_y).camera()), &[expected]);
    }
}

/// `cameras.json` keeps the projection, and omits it for pinholes.
#[test]
fn cameras_of_all_projections_come_back_from_their_file() {
    let (_folder, [path]) = new_paths(["cameras.json"]);
    let pinhole = Camera { projection: Projection::Perspective, ..along_z() };
    let fisheye = pinhole.with_lens(Projection::Fisheye, &[-0.02, 0.003, 0.001]);
    let all = [("parallel", &along_z()), ("pinhole", &pinhole), ("fisheye", &fisheye)];
    let world = WorldFrame::default();
    cameras_json::write(&path, all, &world).expect("written");
    let read = cameras_json::read(&path, &world).expect("cameras");
    assert_eq!([0, 1, 2].map(|index: usize| read[index].camera), [along_z(), pinhole, fisheye]);
    let text = std::fs::read_to_string(&path).expect("text");
    assert_eq!(text.matches("projection").count(), 2);
    std::fs::write(&path, text.replace("orthographic", "conic")).expect("written");
    assert_says(
        refusal(cameras_json::read(&path, &world)),
        &["cameras.json", "camera 0", "'conic'", "fisheye"],
    );
}
