//! The splats' depth in a host's depth attachment: the example's pass, for each kind of projection.

use crate::passes::{DEPTH_WRITTEN, EMPTY, SplatDepth};
use crate::stage::*;
use ashsplat::glam::camera::rh::{proj::vulkan, view::look_at_mat4};
use ashsplat::glam::{Mat4, Vec4};
use ashsplat::scene::{ClipY, HostView};

const SIZE: [u32; 2] = [64, 48];

fn orthographic(reversed: bool) -> Mat4 {
    let (near, far) = (0.5, 9.5);
    let (d_near, d_far) = if reversed { (1.0, 0.0) } else { (0.0, 1.0) };
    let per_z = (d_far - d_near) / (far - near);
    Mat4::from_cols(
        Vec4::new(0.6, 0.0, 0.0, 0.0),
        Vec4::new(0.0, -0.8, 0.0, 0.0),
        Vec4::new(0.0, 0.0, -per_z, 0.0),
        Vec4::new(0.0, 0.0, d_near - per_z * near, 1.0),
    )
}

/// The depth attachment after the pass, and the expected depth that the pass read.
fn drawn(
    host: &Host,
    renderer: &mut Renderer,
    scene: &DeviceScene,
    view: &HostView,
    surface: f32,
) -> [Vec<f32>; 2] {
    let (camera, mapping) = view.camera().expect("a camera");
    let copies = vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST;
    let usage = vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::SAMPLED | copies;
    let expected = Texture::new(host, vk::Format::R32_SFLOAT, usage, SIZE);
    let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | copies;
    let depth = Texture::new(host, vk::Format::D32_SFLOAT, usage, SIZE);
    let image = expected.adopt(renderer.context(), "z", ImageUse::Depth);
    let pass = SplatDepth::new(host, &expected, depth.format).expect("a pass");
    let (read_depth, read_z) = (depth.staging(), expected.staging());
    let frame = Commands::new(host);
    let commands = frame.begun(renderer.context());
    depth.barrier(host, frame.commands, used(ImageState::UNDEFINED), used(COPIED));
    let value = vk::ClearDepthStencilValue { depth: surface, stencil: 0 };
    // SAFETY: recording state, outside of a pass.
    unsafe {
        host.device.cmd_clear_depth_stencil_image(
            frame.commands,
            depth.image,
            COPIED.layout,
            &value,
            &[whole(depth.aspect)],
        );
    }
    let placed = [Placed::from(scene)];
    let to = host_image(&image, ImageState::UNDEFINED);
    let target = Some(DepthTarget { to, min_weight: 0.5, empty: EMPTY });
    let recorded = RecordedFrame { depth: target, ..frame_of(&placed, &camera) };
    let left = renderer.record(commands, 0, &recorded).expect("a recording");
    let uses = [used(left.depth.expect("it was written")), used(COPIED)];
    let [sampled, tested] = pass.record(host, frame.commands, [&*expected, &*depth], uses, &mapping);
    assert_eq!(tested, DEPTH_WRITTEN);
    depth.record_read(host, frame.commands, tested, &read_depth);
    expected.record_read(host, frame.commands, sampled, &read_z);
    frame.finish();
    renderer.release_slot(0).expect("released");
    pass.destroy(host);
    [read_depth.read(), read_z.read()]
}

#[test]
fn splats_are_written_into_a_hosts_depth_attachment() {
    with_guest(|host, context| {
        let scene = uploaded(&context, &cloud(900, 5));
        let mut renderer = Renderer::new(&context).expect("kernels");
        let reserved = Reservation::new(900, 1, SIZE[0], SIZE[1]);
        renderer
            .reserve(&Reservation { expected_depth: true, orthographic: true, ..reserved })
            .expect("memory");
        let aspect = SIZE[0] as f32 / SIZE[1] as f32;
        for clip_from_view in [
            vulkan::perspective(0.7, aspect, 0.5, 30.0),
            vulkan::perspective_infinite_reverse(0.7, aspect, 0.1),
            orthographic(false),
            orthographic(true),
        ] {
            let view = HostView {
                view_from_world: look_at_mat4(Vec3::new(1.0, 0.5, 3.9), Vec3::ZERO, Vec3::Y),
                clip_from_view,
                clip_y: ClipY::Down,
                width: SIZE[0],
                height: SIZE[1],
            };
            let (_, mapping) = view.camera().expect("a camera");
            // The depth of a z by the host's own matrix, and a wall in the middle of the cloud.
            let host_depth = |z: f32| {
                let clip = clip_from_view * Vec4::new(0.0, 0.0, -z, 1.0);
                clip.z / clip.w
            };
            let wall = host_depth(3.8);
            for surface in [mapping.clear_value, wall] {
                let [depths, zs] = drawn(host, &mut renderer, &scene, &view, surface);
                let (mut splats, mut hidden) = (0, 0);
                for (depth, z) in depths.into_iter().zip(zs) {
                    let own = host_depth(z);
                    let nearer = if mapping.clear_value == 0.0 { own > surface } else { own < surface };
                    let wanted = if z != EMPTY && nearer { own } else { surface };
                    assert!((depth - wanted).abs() < 2e-6, "{clip_from_view}: {depth}, {wanted} at z {z}");
                    splats += u32::from(z != EMPTY && nearer);
                    hidden += u32::from(z != EMPTY && !nearer);
                }
                assert!(splats > 200 && (surface != wall || hidden > 100), "{splats}, {hidden}");
            }
        }
    });
}
