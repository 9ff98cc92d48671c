//! Hosts with orthographic projections: pictures, occlusion and expected depth.

use ashsplat::ash::vk;
use ashsplat::glam::{self, Mat3, Mat4, Quat, Vec3, Vec4, camera::rh::view::look_at_mat4};
use ashsplat::scene::{ClipY, DepthMapping, Gaussians, HostView, Pose};
use ashsplat::vk::{Image, ImageState, ImageUse};
use ashsplat::{
    Camera, DepthTarget, DeviceScene, HostImage, Occluder, Placed, RecordedFrame, RenderSettings, Renderer,
    Reservation,
};

use crate::cost::{in_turn, median, ratio};
use crate::host::{Host, HostOptions};
use crate::memory::HostTexture;
use crate::scenes::{assert_nearly_equal, depth_image};
use crate::stage::{assert_same, camera, cloud, guest, options, owned, read_texture, rendered, with_host};

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
    with_host(&options(), |host| {
        let context = guest(host);
        let gaussians = cloud(600, 11);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation {
            occlusion: true,
            expected_depth: true,
            orthographic: true,
            ..Reservation::new(600, 1, SIZE[0], SIZE[1])
        };
        renderer.reserve(&wanted).expect("memory");
        test(host, &mut renderer, &scene, &gaussians);
    });
}

/// The depth of a wall hides Gaussians behind it. A frame without a wall equals [`Renderer::render`] to the bit,
/// beside a pinhole view of the scene in the same reservation.
#[test]
fn an_orthographic_hosts_depth_hides_what_lies_behind_it() {
    with_scene(|host, renderer, scene, gaussians| {
        let settings = RenderSettings::default();
        let placed = [Placed::from(scene)];
        let mut pictures = Vec::new();
        for reversed in [false, true] {
            let (camera, mapping) = view(reversed).camera().expect("a camera");
            assert!(mapping.linear && camera.is_orthographic());
            let plain = RecordedFrame::new(&placed, &camera, &settings);
            assert_same(&rendered(host, renderer, &plain), &owned(gaussians, &camera, &settings), [0.0; 3]);
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
                let (texture, state) = depth_image(host, SIZE, value);
                // SAFETY: the description matches the image, which outlives the frame.
                let image = unsafe {
                    Image::adopt(renderer.context(), "depth", &texture.foreign(), ImageUse::Occluder)
                };
                let image = image.expect("adopted");
                let depth = HostImage { image: &image, from: state, offset: [0; 2] };
                let occluder = Some(Occluder { depth, mapping });
                let pixels = rendered(host, renderer, &RecordedFrame { occluder, ..plain });
                if expected.is_empty() {
                    assert!(pixels.iter().all(|pixel| *pixel == [0.0, 0.0, 0.0, 1.0]));
                } else {
                    assert_same(&pixels, &owned(expected, &camera, &settings), [0.0; 3]);
                }
                pictures.push(pixels);
                // The slot's next recording releases the image.
                rendered(host, renderer, &plain);
                drop(image);
                texture.destroy(host);
            }
            let pinhole = Camera { projection: ashsplat::scene::Projection::Perspective, ..camera };
            let frame = RecordedFrame::new(&placed, &pinhole, &settings);
            assert_same(&rendered(host, renderer, &frame), &owned(gaussians, &pinhole, &settings), [0.0; 3]);
        }
        assert_eq!(pictures[..3], pictures[3..], "depth is reversed, the picture is not");
    });
}

/// Parallel rays see a scene that is turned, moved and twice as large with view-dependent colours. The picture
/// equals that of the scene itself through the inversely transformed camera.
#[test]
fn parallel_rays_see_a_turned_scene_from_its_own_side() {
    with_scene(|host, renderer, scene, gaussians| {
        let settings = RenderSettings::default();
        let (camera, _) = view(false).camera().expect("a camera");
        let (turn, shift) =
            (Quat::from_euler(glam::EulerRot::XYZ, 0.4, 1.5, -0.7), Vec3::new(0.2, -0.1, 0.3));
        let rotation = Mat3::from_quat(turn);
        let pose = Pose { world_from_object: rotation, translation: shift, scale: 2.0 };
        let placed = [Placed::at(scene, pose)];
        let pixels = rendered(host, renderer, &RecordedFrame::new(&placed, &camera, &settings));
        // x_camera = 2 R_c R (x + Rᵀ shift / 2) + t_c: half as many units, each of twice as many pixels.
        let camera_from_world = camera.camera_from_world * rotation;
        let own = Camera {
            camera_from_world,
            translation: 0.5 * (camera.translation + camera.camera_from_world * shift),
            fx: 2.0 * camera.fx,
            fy: 2.0 * camera.fy,
            ..camera
        };
        assert_nearly_equal(&pixels, &owned(gaussians, &own, &settings));
        // Colours that do not depend on the direction would hide the difference.
        let plain = gaussians.with_sh_degree(0);
        let differs = owned(&plain, &own, &settings);
        let far = pixels.iter().zip(&differs.color).filter(|(p, c)| (p[0] - c[0]).abs() > 0.02).count();
        assert!(far > pixels.len() / 20, "{far}");
    });
}

/// Expected depth is z in the camera's frame. Its conversion equals the depth of the host's own matrices.
#[test]
fn expected_depth_of_parallel_rays_is_z() {
    with_scene(|host, renderer, _, _| {
        let context = renderer.context().clone();
        // A sheet of opaque Gaussians, half as large in the file, across the view at one z.
        let mut sheet = Gaussians { sh_degree: 0, ..Gaussians::default() };
        let (camera, mapping): (_, DepthMapping) = view(true).camera().expect("a camera");
        let right = camera.camera_from_world.row(0);
        let down = camera.camera_from_world.row(1);
        for i in 0..100 {
            let (x, y) = ((i % 10) as f32 * 0.2 - 0.9, (i / 10) as f32 * 0.2 - 0.9);
            let mean = right * x + down * y;
            sheet.means.push((0.5 * mean).to_array());
            sheet.quats.push([1.0, 0.0, 0.0, 0.0]);
            sheet.log_scales.push([-2.7; 3]);
            sheet.opacity_logits.push(4.0);
            sheet.sh.push([0.5; 3]);
        }
        let scene = DeviceScene::upload(&context, &sheet, 0).expect("a scene");
        let usage = vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::TRANSFER_SRC;
        let texture = HostTexture::new(host, vk::Format::R32_SFLOAT, usage, SIZE).expect("an image");
        // SAFETY: the description matches the image, which outlives the frame.
        let image = unsafe { Image::adopt(&context, "expected", &texture.foreign(), ImageUse::Depth) };
        let image = image.expect("adopted");
        let placed = [Placed::at(&scene, Pose { scale: 2.0, ..Pose::IDENTITY })];
        let settings = RenderSettings::default();
        let depth = Some(DepthTarget {
            to: HostImage { image: &image, from: ImageState::UNDEFINED, offset: [0; 2] },
            min_weight: 0.5,
            empty: -1.0,
        });
        let frame = RecordedFrame { depth, ..RecordedFrame::new(&placed, &camera, &settings) };
        let pixels = rendered(host, renderer, &frame);
        let from = (
            vk::ImageLayout::GENERAL,
            vk::PipelineStageFlags2::COMPUTE_SHADER,
            vk::AccessFlags2::SHADER_STORAGE_WRITE,
        );
        let depths: Vec<f32> = bytemuck::pod_collect_to_vec(&read_texture(host, &texture, from));
        let host_view = view(true);
        let clip = host_view.clip_from_view * host_view.view_from_world * Vec4::W;
        let mut covered = 0;
        for ([.., transmittance], z) in pixels.into_iter().zip(depths) {
            if (transmittance - 0.5).abs() < 1e-3 {
                continue;
            }
            assert_eq!(z == -1.0, transmittance > 0.5, "{z}");
            if z != -1.0 {
                covered += 1;
                assert!((mapping.depth(z) - clip.z).abs() < 1e-5, "{} {}", mapping.depth(z), clip.z);
            }
        }
        assert!(covered > 1000, "{covered}");
        // The slot's next recording releases the image.
        rendered(host, renderer, &RecordedFrame::new(&placed, &camera, &settings));
        drop(image);
        texture.destroy(host);
    });
}

/// A frame without reserved kernels is refused before its first command.
#[test]
fn an_orthographic_camera_is_reserved() {
    with_host(&options(), |host| {
        let context = guest(host);
        let scene = DeviceScene::upload(&context, &cloud(50, 1), 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.reserve(&Reservation::new(50, 1, SIZE[0], SIZE[1])).expect("memory");
        let (camera, _) = view(false).camera().expect("a camera");
        let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
        let in_flight = crate::host::InFlight::new(host).expect("a command buffer");
        in_flight.begin(host).expect("recording");
        let commands = crate::stage::adopt(&context, &in_flight);
        let refused = renderer.record(commands, 0, &RecordedFrame::new(&placed, &camera, &settings));
        let error = refused.map_or_else(|error| error.to_string(), |_| "accepted".into());
        assert!(error.contains("Reservation::orthographic: not reserved"), "{error}");
        in_flight.submit(host).expect("submitted");
        in_flight.wait(host).expect("done");
        in_flight.destroy(host);
    });
}

/// Prints milliseconds of a frame with parallel rays and through a pinhole, measured in turn.
#[test]
#[ignore = "prints numbers of the guide"]
fn costs() {
    with_host(&HostOptions::default(), |host| {
        let context = crate::cost::shipped(host, true);
        let scene = DeviceScene::upload(&context, &cloud(200_000, 1), 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation { orthographic: true, ..Reservation::new(200_000, 1, 640, 480) };
        renderer.reserve(&wanted).expect("memory");
        let pinhole = camera(0.7, 640, 480);
        // The pixel scale of the pinhole at the middle of the cloud.
        let distance = pinhole.project(Vec3::ZERO).2;
        let parallel =
            Camera { fx: pinhole.fx / distance, fy: pinhole.fy / distance, ..pinhole.orthographic() };
        let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
        let frames = [&pinhole, &parallel].map(|camera| RecordedFrame::new(&placed, camera, &settings));
        let stages = ["cull", "project", "blend", ""];
        let times = in_turn(host, &mut renderer, &frames, stages, 30);
        for frame in &frames {
            in_turn(host, &mut renderer, std::slice::from_ref(frame), stages, 0);
            let report = renderer.slot_report(0).expect("a report").expect("finished");
            println!("{} visible, {} instances", report.visible, report.instances_needed);
        }
        println!("of | pinhole, ms | orthographic, ms | ratio of pairs");
        for (stage, name) in ["cull", "project", "blend", "frame"].into_iter().enumerate() {
            let [one, other] = [0, 1].map(|case| &times[case][stage]);
            let medians = [one, other].map(|times| median(times.iter().copied()));
            println!("{name} | {:.1} | {:.1} | {:.3}", medians[0], medians[1], ratio(other, one));
        }
    });
}
