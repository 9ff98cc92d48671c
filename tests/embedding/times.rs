//! Times of stages in a command buffer that begins with the host's commands.

use crate::cube::{Cube, CubePass, UNUSED};
use crate::host::InFlight;
use crate::memory::HostTexture;
use crate::stage::{adopt, camera, cloud, guest, options, with_host};
use ashsplat::ash::vk;
use ashsplat::{DeviceScene, RecordedFrame, RenderSettings, Renderer, Reservation};

/// A driver that draws later, as llvmpipe does, may also write the timestamps after a render pass later. Blending
/// then had the time of the stage before.
#[test]
fn stages_behind_a_render_pass_have_times_of_their_own() {
    with_host(&options(), |host| {
        let context = guest(host);
        if context.limits().timestamp_period_ns == 0.0 {
            eprintln!("no timestamps on this device");
            return;
        }
        if context.device_name().contains("llvmpipe") && !context.limits().tuning.runs_in_order {
            eprintln!("skipped: a GPU's timestamps, which llvmpipe writes a stage late");
            return;
        }
        let size = [1024, 1024];
        let usage = vk::ImageUsageFlags::COLOR_ATTACHMENT;
        let color = HostTexture::new(host, vk::Format::R8G8B8A8_UNORM, usage, size).expect("an image");
        let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT;
        let depth = HostTexture::new(host, vk::Format::D32_SFLOAT, usage, size).expect("an image");
        let cube = Cube::new(host, color.format, depth.format).expect("a pipeline");
        let gaussians = cloud(2000, 3);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.reserve(&Reservation::new(2000, 1, 160, 120)).expect("memory");
        let (camera, settings, scenes) =
            (camera(0.4, 160, 120), RenderSettings::default(), [(&scene).into()]);
        let in_flight = InFlight::new(host).expect("a command buffer");
        let mut least = [f64::INFINITY; 2];
        for last in [UNUSED; 3] {
            in_flight.begin(host).expect("recording");
            let whole = glam::Mat4::from_scale(glam::Vec3::new(2.0, 2.0, 0.5));
            let pass = CubePass {
                color: &color,
                depth: &depth,
                last: [last; 2],
                background: [0.0; 4],
                clip_from_object: whole.to_cols_array(),
                reversed_depth: false,
            };
            cube.record(host, in_flight.commands, &pass);
            let frame = RecordedFrame::new(&scenes, &camera, &settings);
            renderer.record(adopt(&context, &in_flight), 0, &frame).expect("a recording");
            in_flight.submit(host).expect("a submission");
            in_flight.wait(host).expect("done");
            let report = renderer.slot_report(0).expect("a report").expect("finished");
            let time = |name: &str| {
                let scope = report.scopes.iter().find(|scope| scope.name == name);
                scope.expect("a stage").nanoseconds
            };
            least = [least[0].min(time("ranges")), least[1].min(time("blend"))];
        }
        // `ranges` finds the ends of lists; `blend` reads them all at each of 19,200 pixels.
        assert!(least[1] > least[0], "ranges {} ns, blend {} ns", least[0], least[1]);
        in_flight.destroy(host);
        cube.destroy(host);
        color.destroy(host);
        depth.destroy(host);
    });
}
