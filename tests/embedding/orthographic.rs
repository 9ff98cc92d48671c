//! Hosts with orthographic projections: pictures, occlusion and expected depth.

use crate::scenes::assert_nearly_equal;
use crate::stage::*;
use ashsplat::glam;
use ashsplat::glam::camera::rh::view::look_at_mat4;
use ashsplat::glam::{Mat4, Vec4};
use ashsplat::scene::{ClipY, HostView};

pub const SIZE: [u32; 2] = [110, 70];

/// A view of the cloud whose near plane is behind the eye, with standard or reversed depth.
pub fn view(reversed: bool) -> HostView {
    let (near, far) = (-3.0, 9.0);
    let (d_near, d_far) = if reversed { (1.0, 0.0) } else { (0.0, 1.0) };
    let per_z = (d_far - d_near) / (far - near);
    HostView {
        view_from_world: look_at_mat4(Vec3::new(0.5, -0.25, 3.0), Vec3::ZERO, Vec3::Y),
        clip_from_view: Mat4::from_cols(
            Vec4::new(0.6, 0.0, 0.0, 0.0),
            Vec4::new(0.0, -0.9, 0.0, 0.0),
            Vec4::new(0.0, 0.0, -per_z, 0.0),
            Vec4::new(0.0, 0.0, d_near - per_z * near, 1.0),
        ),
        clip_y: ClipY::Down,
        width: SIZE[0],
        height: SIZE[1],
    }
}

fn with_scene(test: impl Fn(&Host, &mut Renderer, &DeviceScene, &Gaussians)) {
    with_guest(|host, context| {
        let gaussians = cloud(600, 11);
        let scene = uploaded(&context, &gaussians);
        let wanted = Reservation {
            occlusion: true,
            expected_depth: true,
            orthographic: true,
            ..Reservation::new(600, 1, SIZE[0], SIZE[1])
        };
        let mut renderer = reserved(&context, &wanted);
        test(host, &mut renderer, &scene, &gaussians);
    });
}

/// The depth of a wall hides Gaussians behind it. A frame without a wall equals [`Renderer::render`] to the bit,
/// beside a pinhole view of the scene in the same reservation.
#[test]
fn an_orthographic_hosts_depth_hides_what_lies_behind_it() {
    with_scene(|host, renderer, scene, gaussians| {
        let placed = [Placed::from(scene)];
        let mut pictures = Vec::new();
        for reversed in [false, true] {
            let (camera, mapping) = view(reversed).camera().expect("a camera");
            assert!(mapping.linear && camera.is_orthographic());
            let plain = frame_of(&placed, &camera);
            assert_drawn(host, renderer, &plain, gaussians);
            let depth = |g: usize| camera.project(Vec3::from(gaussians.means[g])).2;
            // A wall in the middle, by the host's own matrix: z_view = -3.
            let clip = view(reversed).clip_from_view * Vec4::new(0.0, 0.0, -3.0, 1.0);
            let wall = mapping.z(clip.z);
            let mut kept = gaussians.clone();
            kept.retain(|_, g| depth(g) < wall);
            assert!((100..500).contains(&kept.len()), "{}", kept.len());
            // No wall, the wall, and one before everything.
            let none = Gaussians { sh_degree: 1, ..Gaussians::default() };
            let nearest = if reversed { 1.0 } else { 0.0 };
            for (value, expected) in [(mapping.clear_value, gaussians), (clip.z, &kept), (nearest, &none)] {
                let picture = Picture::of_depth(host, renderer.context(), SIZE, value);
                let depth = host_image(&picture.image, COPIED);
                let occluder = Some(Occluder { depth, mapping });
                let pixels = rendered(host, renderer, &RecordedFrame { occluder, ..plain });
                if expected.is_empty() {
                    assert!(pixels.iter().all(|pixel| *pixel == [0.0, 0.0, 0.0, 1.0]));
                } else {
                    assert_same(&pixels, &owned(expected, &camera, &SETTINGS));
                }
                pictures.push(pixels);
                // The slot's next recording releases the image.
                rendered(host, renderer, &plain);
            }
            let pinhole = Camera { projection: ashsplat::scene::Projection::Perspective, ..camera };
            let frame = frame_of(&placed, &pinhole);
            assert_same(&rendered(host, renderer, &frame), &owned(gaussians, &pinhole, &SETTINGS));
        }
        assert_eq!(pictures[..3], pictures[3..], "depth is reversed, the picture is not");
    });
}

/// Parallel rays see a scene that is turned, moved and twice as large with view-dependent colours. The picture
/// equals that of the scene itself through the inversely transformed camera.
#[test]
fn parallel_rays_see_a_turned_scene_from_its_own_side() {
    with_scene(|host, renderer, scene, gaussians| {
        let (camera, _) = view(false).camera().expect("a camera");
        let (turn, shift) =
            (Quat::from_euler(glam::EulerRot::XYZ, 0.4, 1.5, -0.7), Vec3::new(0.2, -0.1, 0.3));
        let rotation = Mat3::from_quat(turn);
        let pose = Pose { world_from_object: rotation, translation: shift, scale: 2.0 };
        let placed = [Placed::at(scene, pose)];
        let pixels = rendered(host, renderer, &frame_of(&placed, &camera));
        // x_camera = 2 R_c R (x + Rᵀ shift / 2) + t_c: half as many units, each of twice as many pixels.
        let camera_from_world = camera.camera_from_world * rotation;
        let own = Camera {
            camera_from_world,
            translation: 0.5 * (camera.translation + camera.camera_from_world * shift),
            fx: 2.0 * camera.fx,
            fy: 2.0 * camera.fy,
            ..camera
        };
        assert_nearly_equal(&pixels, &owned(gaussians, &own, &SETTINGS));
        // The scene shows the difference: without view-dependent colours the picture is another one.
        let plain = gaussians.with_sh_degree(0);
        let differs = owned(&plain, &own, &SETTINGS);
        let far = pixels.iter().zip(&differs.color).filter(|(p, c)| (p[0] - c[0]).abs() > 0.02).count();
        assert!(far > pixels.len() / 20, "{far}");
    });
}
