//! A pass that writes the splats' depth into the host's depth attachment, for later passes.

use super::cube::{DEPTH_WRITTEN, SAMPLED};
use super::host::{Host, Result};
use super::memory::{HostTexture, Use};
use super::pass::{Sampled, pipeline, spirv};
use ashsplat::ash::vk;
use ashsplat::scene::DepthMapping;

/// The expected depth of pixels without splats.
pub const EMPTY: f32 = -1.0;

/// The pipelines, and the expected depth as their texture.
pub struct SplatDepth {
    sampled: Sampled,
    layout: vk::PipelineLayout,
    /// Variants for conventional and for reversed depth.
    pipelines: [vk::Pipeline; 2],
}

impl SplatDepth {
    pub fn new(host: &Host, expected: &HostTexture, depth: vk::Format) -> Result<Self> {
        let sampled = Sampled::new(host, expected, vk::Filter::NEAREST)?;
        let layouts = [sampled.set_layout];
        let ranges = [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::FRAGMENT).size(20)];
        let info =
            vk::PipelineLayoutCreateInfo::default().set_layouts(&layouts).push_constant_ranges(&ranges);
        // SAFETY: a valid create info; SPIR-V that build.rs compiled, matching this layout.
        unsafe {
            let layout = host.device.create_pipeline_layout(&info, None)?;
            let shaders: [&[u8]; 2] = [spirv!("tonemap.vert"), spirv!("splat_depth.frag")];
            let of = |compare| pipeline(host, layout, shaders, vk::Format::UNDEFINED, Some((depth, compare)));
            let pipelines = [of(vk::CompareOp::LESS)?, of(vk::CompareOp::GREATER)?];
            Ok(Self { sampled, layout, pipelines })
        }
    }

    /// Records the pass, from both images' last uses. Returns their new uses.
    pub fn record(
        &self,
        host: &Host,
        commands: vk::CommandBuffer,
        [expected, depth]: [&HostTexture; 2],
        [expected_last, depth_last]: [Use; 2],
        mapping: &DepthMapping,
    ) -> [Use; 2] {
        expected.barrier(host, commands, expected_last, SAMPLED);
        let early = vk::PipelineStageFlags2::EARLY_FRAGMENT_TESTS | DEPTH_WRITTEN.1;
        let both = vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_READ | DEPTH_WRITTEN.2;
        depth.barrier(host, commands, depth_last, (DEPTH_WRITTEN.0, early, both));
        let attachment = vk::RenderingAttachmentInfo::default()
            .image_view(depth.view)
            .image_layout(DEPTH_WRITTEN.0)
            .load_op(vk::AttachmentLoadOp::LOAD)
            .store_op(vk::AttachmentStoreOp::STORE);
        let [width, height] = depth.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let info =
            vk::RenderingInfo::default().render_area(area).layer_count(1).depth_attachment(&attachment);
        let viewport =
            vk::Viewport { width: width as f32, height: height as f32, max_depth: 1.0, ..Default::default() };
        let [a, b] = mapping.coefficients().map(f32::to_bits);
        let push = [a, b, u32::from(mapping.linear), EMPTY.to_bits(), mapping.clear_value.to_bits()];
        let push: Vec<u8> = push.iter().flat_map(|word| word.to_ne_bytes()).collect();
        let reversed = mapping.clear_value == 0.0;
        // SAFETY: recording state; the pipelines' format is the attachment's.
        unsafe {
            let (device, graphics) = (&host.device, vk::PipelineBindPoint::GRAPHICS);
            device.cmd_begin_rendering(commands, &info);
            device.cmd_bind_pipeline(commands, graphics, self.pipelines[usize::from(reversed)]);
            device.cmd_bind_descriptor_sets(commands, graphics, self.layout, 0, &[self.sampled.set], &[]);
            device.cmd_push_constants(commands, self.layout, vk::ShaderStageFlags::FRAGMENT, 0, &push);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_draw(commands, 3, 1, 0, 0);
            device.cmd_end_rendering(commands);
        }
        [SAMPLED, DEPTH_WRITTEN]
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            self.pipelines.into_iter().for_each(|p| host.device.destroy_pipeline(p, None));
            host.device.destroy_pipeline_layout(self.layout, None);
        }
        self.sampled.destroy(host);
    }
}
