//! The host's last pass: converts the linear picture for a display.

use super::cube::{COLOR_WRITTEN, SAMPLED, UNUSED};
use super::host::{Host, Result};
use super::memory::{HostTexture, Use};
use super::pass::{Sampled, pipeline, spirv};
use ashsplat::ash::vk;

/// The pipeline, and the picture as its texture.
pub struct Tonemap {
    sampled: Sampled,
    layout: vk::PipelineLayout,
    pipeline: vk::Pipeline,
}

impl Tonemap {
    pub fn new(host: &Host, picture: &HostTexture, display: vk::Format) -> Result<Self> {
        let sampled = Sampled::new(host, picture, vk::Filter::NEAREST)?;
        let layouts = [sampled.set_layout];
        let info = vk::PipelineLayoutCreateInfo::default().set_layouts(&layouts);
        // SAFETY: a valid create info; SPIR-V that build.rs compiled, matching this layout.
        unsafe {
            let layout = host.device.create_pipeline_layout(&info, None)?;
            let shaders: [&[u8]; 2] = [spirv!("tonemap.vert"), spirv!("tonemap.frag")];
            let pipeline = pipeline(host, layout, shaders, display, None)?;
            Ok(Self { sampled, layout, pipeline })
        }
    }

    /// Records the pass, from both images' last uses. Returns their new uses.
    pub fn record(
        &self,
        host: &Host,
        commands: vk::CommandBuffer,
        [picture, display]: [&HostTexture; 2],
        [picture_last, display_last]: [Use; 2],
    ) -> [Use; 2] {
        picture.barrier(host, commands, picture_last, SAMPLED);
        display.barrier(host, commands, (UNUSED.0, display_last.1, display_last.2), COLOR_WRITTEN);
        let colors = [vk::RenderingAttachmentInfo::default()
            .image_view(display.view)
            .image_layout(COLOR_WRITTEN.0)
            .load_op(vk::AttachmentLoadOp::DONT_CARE)
            .store_op(vk::AttachmentStoreOp::STORE)];
        let [width, height] = display.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let info = vk::RenderingInfo::default().render_area(area).layer_count(1).color_attachments(&colors);
        let viewport =
            vk::Viewport { width: width as f32, height: height as f32, max_depth: 1.0, ..Default::default() };
        // SAFETY: recording state; the pipeline's format is the attachment's.
        unsafe {
            let (device, graphics) = (&host.device, vk::PipelineBindPoint::GRAPHICS);
            device.cmd_begin_rendering(commands, &info);
            device.cmd_bind_pipeline(commands, graphics, self.pipeline);
            device.cmd_bind_descriptor_sets(commands, graphics, self.layout, 0, &[self.sampled.set], &[]);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_rendering(commands);
        }
        [SAMPLED, COLOR_WRITTEN]
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            host.device.destroy_pipeline(self.pipeline, None);
            host.device.destroy_pipeline_layout(self.layout, None);
        }
        self.sampled.destroy(host);
    }
}
