//! Times of stages in a command buffer that begins with the host's commands.

use crate::passes::{Cube, CubePass, UNUSED};
use crate::stage::*;

/// A driver that defers draws, as llvmpipe does, may write timestamps late after a render pass. Blending then got the time
/// of the previous stage.
#[test]
fn stages_behind_a_render_pass_have_times_of_their_own() {
    with_guest(|host, context| {
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
        let color = Texture::new(host, vk::Format::R8G8B8A8_UNORM, usage, size);
        let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT;
        let depth = Texture::new(host, vk::Format::D32_SFLOAT, usage, size);
        let cube = Cube::new(host, color.format, depth.format).expect("a pipeline");
        let gaussians = cloud(2000, 3);
        let scene = uploaded(&context, &gaussians);
        let mut renderer = reserved(&context, &Reservation::new(2000, 1, 160, 120));
        let (camera, scenes) = (camera(0.4, 160, 120), [(&scene).into()]);
        let in_flight = Commands::new(host);
        let mut fastest = [f64::INFINITY; 2];
        for last in [UNUSED; 3] {
            in_flight.begin();
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
            let frame = frame_of(&scenes, &camera);
            renderer.record(in_flight.adopt(&context), 0, &frame).expect("a recording");
            in_flight.finish();
            let report = report_of(&mut renderer, 0);
            let time = |name: &str| {
                let scope = report.scopes.iter().find(|scope| scope.name == name);
                scope.expect("a stage").nanoseconds
            };
            fastest = [fastest[0].min(time("ranges")), fastest[1].min(time("blend"))];
        }
        // `ranges` finds the ends of lists; `blend` reads them all at each of 19,200 pixels.
        assert!(fastest[1] > fastest[0], "ranges {} ns, blend {} ns", fastest[0], fastest[1]);
        cube.destroy(host);
    });
}
