//! The splats' depth in a host's depth attachment: the example's pass, for each kind of projection.

use ashsplat::ash::vk;
use ashsplat::glam::camera::rh::{proj::vulkan, view::look_at_mat4};
use ashsplat::glam::{Mat4, Vec3, Vec4};
use ashsplat::scene::{ClipY, HostView};
use ashsplat::vk::{Image, ImageState, ImageUse};
use ashsplat::{
    DepthTarget, DeviceScene, HostImage, Placed, RecordedFrame, RenderSettings, Renderer, Reservation,
};

use crate::cube::DEPTH_WRITTEN;
use crate::host::{Host, InFlight};
use crate::memory::{HostBuffer, HostTexture};
use crate::splat_depth::{EMPTY, SplatDepth};
use crate::stage::{adopt, cloud, guest, options, with_host};

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
    let expected = HostTexture::new(host, vk::Format::R32_SFLOAT, usage, SIZE).expect("an image");
    let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | copies;
    let depth = HostTexture::new(host, vk::Format::D32_SFLOAT, usage, SIZE).expect("an image");
    // SAFETY: the description matches the image, which outlives the frame.
    let image = unsafe { Image::adopt(renderer.context(), "z", &expected.foreign(), ImageUse::Depth) };
    let image = image.expect("adopted");
    let pass = SplatDepth::new(host, &expected, depth.format).expect("a pass");
    let [read_depth, read_z] =
        [(); 2].map(|()| HostBuffer::new(host, 4 * u64::from(SIZE[0] * SIZE[1])).expect("memory"));
    let frame = InFlight::new(host).expect("a command buffer");
    frame.begin(host).expect("recording");
    let fresh = (vk::ImageLayout::UNDEFINED, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);
    let written = (
        vk::ImageLayout::TRANSFER_DST_OPTIMAL,
        vk::PipelineStageFlags2::ALL_TRANSFER,
        vk::AccessFlags2::TRANSFER_WRITE,
    );
    depth.barrier(host, frame.commands, fresh, written);
    let ranges = [vk::ImageSubresourceRange {
        aspect_mask: vk::ImageAspectFlags::DEPTH,
        level_count: 1,
        layer_count: 1,
        ..Default::default()
    }];
    let value = vk::ClearDepthStencilValue { depth: surface, stencil: 0 };
    // SAFETY: recording state, outside of a pass.
    unsafe {
        host.device.cmd_clear_depth_stencil_image(frame.commands, depth.image, written.0, &value, &ranges);
    }
    let (placed, settings) = ([Placed::from(scene)], RenderSettings::default());
    let to = HostImage { image: &image, from: ImageState::UNDEFINED, offset: [0; 2] };
    let target = Some(DepthTarget { to, min_weight: 0.5, empty: EMPTY });
    let recorded = RecordedFrame { depth: target, ..RecordedFrame::new(&placed, &camera, &settings) };
    let left = renderer.record(adopt(renderer.context(), &frame), 0, &recorded).expect("a recording");
    let state = left.depth.expect("it was written");
    let uses = [(state.layout, state.stages, state.accesses), written];
    let images = [&expected, &depth];
    let [sampled, tested] = pass.record(host, frame.commands, images, uses, &mapping);
    assert_eq!(tested, DEPTH_WRITTEN);
    depth.record_read(host, frame.commands, tested, &read_depth);
    expected.record_read(host, frame.commands, sampled, &read_z);
    frame.submit(host).expect("a submission");
    frame.wait(host).expect("done");
    let bytes = 4 * (SIZE[0] * SIZE[1]) as usize;
    let read = [&read_depth, &read_z]
        .map(|buffer| bytemuck::pod_collect_to_vec(&buffer.read(host, bytes).expect("bytes")));
    renderer.release_slot(0).expect("released");
    drop(image);
    frame.destroy(host);
    pass.destroy(host);
    read_depth.destroy(host);
    read_z.destroy(host);
    expected.destroy(host);
    depth.destroy(host);
    read
}

#[test]
fn splats_are_written_into_a_hosts_depth_attachment() {
    with_host(&options(), |host| {
        let context = guest(host);
        let scene = DeviceScene::upload(&context, &cloud(900, 5), 0).expect("a scene");
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
