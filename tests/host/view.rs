//! A host's matrices as a camera and a depth mapping, in all conventions.

use super::files::assert_says;
use ashsplat::scene::{ClipY, HostView, Pose};
use glam::camera::{lh, rh};
use glam::{Mat3, Mat4, Quat, Vec3, Vec4};

const SIZE: (u32, u32) = (640, 360);
const EYE: Vec3 = Vec3::new(1.0, 2.0, 5.0);
const NEAR: f32 = 0.25;
const FAR: f32 = 40.0;

/// Position at which the host itself draws a point: pixels and depth.
fn drawn(view: &HostView, world: Vec3) -> (Vec3, f32) {
    let clip = view.clip_from_view * view.view_from_world * world.extend(1.0);
    let ndc = clip / clip.w;
    let y = if view.clip_y == ClipY::Up { -ndc.y } else { ndc.y };
    let (width, height) = (view.width as f32, view.height as f32);
    (Vec3::new((ndc.x * 0.5 + 0.5) * width, (y * 0.5 + 0.5) * height, ndc.z), clip.w)
}

/// Conventions: name, view, and true if depth is reversed.
fn conventions() -> Vec<(&'static str, HostView, bool)> {
    let (fov, aspect) = (0.8, SIZE.0 as f32 / SIZE.1 as f32);
    let right = rh::view::look_at_mat4(EYE, Vec3::ZERO, Vec3::Y);
    // A left-handed world, into which the scene is mirrored.
    let mirror = Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0));
    let left = lh::view::look_at_mat4(mirror.transform_point3(EYE), Vec3::ZERO, Vec3::Y) * mirror;
    let down = rh::view::look_at_mat4(EYE, Vec3::ZERO, Vec3::NEG_Y);
    let host = |view_from_world, clip_from_view, clip_y| HostView {
        view_from_world,
        clip_from_view,
        clip_y,
        width: SIZE.0,
        height: SIZE.1,
    };
    let mut off_centre = rh::proj::vulkan::perspective(fov, aspect, NEAR, FAR);
    off_centre.z_axis.x = 0.3;
    off_centre.z_axis.y = -0.2;
    let reversed = |m: Mat4| {
        // z' = w - z.
        Mat4::from_cols(Vec4::X, Vec4::Y, Vec4::new(0.0, 0.0, -1.0, 0.0), Vec4::new(0.0, 0.0, 1.0, 1.0)) * m
    };
    let vulkan = rh::proj::vulkan::perspective(fov, aspect, NEAR, FAR);
    let infinite = rh::proj::vulkan::perspective_infinite(fov, aspect, NEAR);
    let infinite_reversed = rh::proj::vulkan::perspective_infinite_reverse(fov, aspect, NEAR);
    let left_handed = lh::proj::directx::perspective(fov, aspect, NEAR, FAR);
    let left_reversed = lh::proj::directx::perspective_infinite_reverse(fov, aspect, NEAR);
    let flipped = rh::proj::directx::perspective(fov, aspect, NEAR, FAR);
    vec![
        ("Vulkan", host(right, vulkan, ClipY::Down), false),
        ("Vulkan, infinite", host(right, infinite, ClipY::Down), false),
        ("Vulkan, reversed and infinite", host(right, infinite_reversed, ClipY::Down), true),
        ("Vulkan, reversed", host(right, reversed(vulkan), ClipY::Down), true),
        ("Direct3D, left-handed", host(left, left_handed, ClipY::Up), false),
        ("Direct3D, left-handed, reversed", host(left, left_reversed, ClipY::Up), true),
        ("flipped viewport", host(right, flipped, ClipY::Up), false),
        ("y down in the world", host(down, vulkan, ClipY::Down), false),
        ("off-centre", host(right, off_centre, ClipY::Down), false),
        ("scaled matrix", host(right, vulkan * 2.0, ClipY::Down), false),
    ]
}

#[test]
fn host_views_put_points_where_the_host_does() {
    for (name, view, reversed) in conventions() {
        let (camera, mapping) = view.camera().unwrap_or_else(|e| panic!("{name}: {e}"));
        camera.check().expect(name);
        assert!((camera.position() - EYE).length() < 1e-4, "{name}: {}", camera.position());
        assert_eq!(mapping.clear_value, if reversed { 0.0 } else { 1.0 }, "{name}");
        for point in
            [Vec3::ZERO, Vec3::new(0.7, -0.4, 0.9), Vec3::new(-1.0, 1.2, -3.0), Vec3::new(2.0, 0.5, -20.0)]
        {
            let (expected, w) = drawn(&view, point);
            let (x, y, z) = camera.project(point);
            let close = (x - expected.x).abs() < 2e-2 && (y - expected.y).abs() < 2e-2;
            assert!(close, "{name}: {point} at ({x}, {y}), the host draws it at {expected}");
            assert!(w > 0.0 && z > 0.0);
            let from_depth = mapping.z(expected.z);
            assert!((from_depth / z - 1.0).abs() < 1e-2, "{name}: {from_depth}, not {z}");
        }
        // The near plane, and the far plane or infinity.
        let near_value = if reversed { 1.0 } else { 0.0 };
        assert!((mapping.z(near_value) / NEAR - 1.0).abs() < 1e-3, "{name}: {}", mapping.z(near_value));
        let far = mapping.z(mapping.clear_value);
        assert!(far > 1e5 || (far / FAR - 1.0).abs() < 1e-2, "{name}: {far}");
    }
}

type Change = fn(&mut HostView);

#[test]
fn host_views_that_cannot_be_are_refused() {
    let good = conventions()[0].1;
    good.camera().expect("good");
    let changed = |change: Change| {
        let mut view = good;
        change(&mut view);
        view
    };
    // The rounding of an inverse is no error.
    changed(|view| view.view_from_world.w_axis.w = 0.999_999_9).camera().expect("as good");
    let bad: [(&str, Change); 12] = [
        ("view_from_world, clip_from_view, clip_y: together they mirror the picture", |view| {
            view.clip_y = ClipY::Up;
        }),
        ("view_from_world: row 0, column 0 is NaN", |view| view.view_from_world = Mat4::NAN),
        ("width: 0, it may be 1 to", |view| view.width = 0),
        ("height: 65536, it may be 1 to", |view| view.height = 65_536),
        (
            "clip_from_view: is neither perspective nor orthographic: its last row is [0, 0, 0, 0], it must",
            |view| view.clip_from_view = Mat4::ZERO,
        ),
        ("view_from_world: [[", |view| {
            view.view_from_world = Mat4::from_scale(Vec3::splat(2.0)) * view.view_from_world;
        }),
        ("view_from_world: its last row is [0, 0, 0.2, 1], not", |view| view.view_from_world.z_axis.w = 0.2),
        ("clip_from_view: row 1, column 2 is inf", |view| view.clip_from_view.z_axis.y = f32::INFINITY),
        ("clip_from_view: focal length (inf, ", |view| view.clip_from_view.x_axis.x = f32::MAX),
        ("clip_from_view: is skewed or degenerate: row 0, column 1 is 0.1", |view| {
            view.clip_from_view.y_axis.x = 0.1;
        }),
        ("clip_from_view: is skewed or degenerate: row 1, column 1 is 0", |view| {
            view.clip_from_view.y_axis.y = 0.0;
        }),
        // w of both kinds of projection.
        ("clip_from_view: is neither perspective nor orthographic", |view| {
            view.clip_from_view.w_axis.w = 1.0;
        }),
    ];
    for (expected, change) in bad {
        let view = changed(change);
        let error = view.camera().expect_err(expected).to_string();
        assert!(error.starts_with(expected) && !error.contains('\n'), "{error} (expected {expected})");
    }
}

#[test]
fn poses_come_from_matrices_that_scale_uniformly() {
    let (turn, shift) = (Quat::from_euler(glam::EulerRot::XYZ, 0.3, 1.2, -0.7), Vec3::new(1.0, -2.0, 3.0));
    for scale in [1e-3f32, 0.5, 1.0, 40.0] {
        let matrix = Mat4::from_scale_rotation_translation(Vec3::splat(scale), turn, shift);
        let pose = Pose::from_matrix(matrix).expect("a pose");
        assert!((pose.scale / scale - 1.0).abs() < 1e-6 && pose.translation == shift);
        assert!(pose.world_from_object.abs_diff_eq(Mat3::from_quat(turn), 1e-6));
    }
    let scaled = |x, y, z| Mat4::from_scale_rotation_translation(Vec3::new(x, y, z), turn, shift);
    let mut projective = Mat4::IDENTITY;
    projective.x_axis.w = 0.1;
    let bad = [
        ("a uniform scale", scaled(1.0, 2.0, 1.0)),
        ("a uniform scale", scaled(-1.0, 1.0, 1.0)),
        ("a uniform scale", scaled(1.0, 1.01, 1.0)),
        ("not finite", Mat4::from_translation(Vec3::NAN)),
        ("not finite", scaled(0.0, 0.0, 0.0)),
        ("last row", projective),
    ];
    for (expected, matrix) in bad {
        let error = Pose::from_matrix(matrix).expect_err(expected).to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error} (expected {expected})");
    }
    for scale in [0.0, -2.0, f32::NAN, f32::INFINITY, 1e-30, 1e30] {
        let error = Pose { scale, ..Pose::IDENTITY }.check().expect_err("no scale").to_string();
        assert_says(&error, &["a scale of"]);
    }
    // The scale's square and its inverse must be normal numbers.
    for (min, beyond) in [(2f32.powi(-63), f32::next_down as fn(f32) -> f32), (2f32.powi(63), f32::next_up)] {
        let is_possible = |scale: f32| Pose { scale, ..Pose::IDENTITY }.check().is_ok();
        assert!(is_possible(min) && !is_possible(beyond(min)));
    }
}
