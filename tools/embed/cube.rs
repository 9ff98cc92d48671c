//! The host's own picture: a textured cube with depth, lit in linear light, in a graphics pass with dynamic rendering.

use super::host::{Host, Result};
use super::memory::{HostBuffer, HostTexture, Use};
use super::pass::{Sampled, pipeline, spirv};
use ashsplat::ash::vk;

const TEXTURE_SIDE: u32 = 64;

/// Uses of the attachments after the pass.
pub const COLOR_WRITTEN: Use = (
    vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
    vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT,
    vk::AccessFlags2::COLOR_ATTACHMENT_WRITE,
);
pub const DEPTH_WRITTEN: Use = (
    vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL,
    vk::PipelineStageFlags2::LATE_FRAGMENT_TESTS,
    vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_WRITE,
);
/// The image is unused so far.
pub const UNUSED: Use = (vk::ImageLayout::UNDEFINED, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);
pub const SAMPLED: Use = (
    vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
    vk::PipelineStageFlags2::FRAGMENT_SHADER,
    vk::AccessFlags2::SHADER_SAMPLED_READ,
);

pub struct Cube {
    texture: HostTexture,
    sampled: Sampled,
    layout: vk::PipelineLayout,
    /// Variants for conventional and for reversed depth.
    pipelines: [vk::Pipeline; 2],
}

/// Parameters of one picture of the cube.
pub struct CubePass<'a> {
    pub color: &'a HostTexture,
    pub depth: &'a HostTexture,
    /// Last uses of colour and depth; the pass waits for them.
    pub last: [Use; 2],
    pub background: [f32; 4],
    /// Column-major.
    pub clip_from_object: [f32; 16],
    pub reversed_depth: bool,
}

impl Cube {
    pub fn new(host: &Host, color: vk::Format, depth: vk::Format) -> Result<Self> {
        let usage = vk::ImageUsageFlags::SAMPLED | vk::ImageUsageFlags::TRANSFER_DST;
        let side = TEXTURE_SIDE;
        let texture = HostTexture::new(host, vk::Format::R8G8B8A8_SRGB, usage, [side, side])?;
        upload(host, &texture)?;
        // SAFETY: valid create infos; handles come from the calls before.
        unsafe {
            let device = &host.device;
            let sampled = Sampled::new(host, &texture, vk::Filter::LINEAR)?;
            let ranges =
                [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::VERTEX).size(64)];
            let layouts = [sampled.set_layout];
            let info =
                vk::PipelineLayoutCreateInfo::default().set_layouts(&layouts).push_constant_ranges(&ranges);
            let layout = device.create_pipeline_layout(&info, None)?;
            let shaders: [&[u8]; 2] = [spirv!("cube.vert"), spirv!("cube.frag")];
            let standard = pipeline(host, layout, shaders, color, Some((depth, vk::CompareOp::LESS)))?;
            let reversed = pipeline(host, layout, shaders, color, Some((depth, vk::CompareOp::GREATER)))?;
            let pipelines = [standard, reversed];
            Ok(Self { texture, sampled, layout, pipelines })
        }
    }

    /// Records the pass: clears both attachments and draws the cube.
    pub fn record(&self, host: &Host, commands: vk::CommandBuffer, pass: &CubePass<'_>) {
        // The earlier contents are not needed, but the guest's compute shaders must have finished reading them.
        let [color_last, depth_last] =
            pass.last.map(|(_, stages, accesses)| (vk::ImageLayout::UNDEFINED, stages, accesses));
        pass.color.barrier(host, commands, color_last, COLOR_WRITTEN);
        let early = vk::PipelineStageFlags2::EARLY_FRAGMENT_TESTS | DEPTH_WRITTEN.1;
        let both = vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_READ | DEPTH_WRITTEN.2;
        pass.depth.barrier(host, commands, depth_last, (DEPTH_WRITTEN.0, early, both));
        let color = vk::ClearValue { color: vk::ClearColorValue { float32: pass.background } };
        let far = if pass.reversed_depth { 0.0 } else { 1.0 };
        let depth = vk::ClearValue { depth_stencil: vk::ClearDepthStencilValue { depth: far, stencil: 0 } };
        let attachment = |view, layout, clear| {
            vk::RenderingAttachmentInfo::default()
                .image_view(view)
                .image_layout(layout)
                .load_op(vk::AttachmentLoadOp::CLEAR)
                .store_op(vk::AttachmentStoreOp::STORE)
                .clear_value(clear)
        };
        let colors = [attachment(pass.color.view, COLOR_WRITTEN.0, color)];
        let depth = attachment(pass.depth.view, DEPTH_WRITTEN.0, depth);
        let [width, height] = pass.color.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let info = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(1)
            .color_attachments(&colors)
            .depth_attachment(&depth);
        let viewport =
            vk::Viewport { width: width as f32, height: height as f32, max_depth: 1.0, ..Default::default() };
        let matrix: Vec<u8> = pass.clip_from_object.iter().flat_map(|x| x.to_ne_bytes()).collect();
        // SAFETY: recording state; the pipeline's formats are the attachments'.
        unsafe {
            let device = &host.device;
            device.cmd_begin_rendering(commands, &info);
            let graphics = vk::PipelineBindPoint::GRAPHICS;
            device.cmd_bind_pipeline(commands, graphics, self.pipelines[usize::from(pass.reversed_depth)]);
            device.cmd_bind_descriptor_sets(commands, graphics, self.layout, 0, &[self.sampled.set], &[]);
            device.cmd_push_constants(commands, self.layout, vk::ShaderStageFlags::VERTEX, 0, &matrix);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_draw(commands, 36, 1, 0, 0);
            device.cmd_end_rendering(commands);
        }
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            self.pipelines.into_iter().for_each(|p| host.device.destroy_pipeline(p, None));
            host.device.destroy_pipeline_layout(self.layout, None);
        }
        self.sampled.destroy(host);
        self.texture.destroy(host);
    }
}

/// Planks of a crate.
fn texels() -> Vec<u8> {
    let side = TEXTURE_SIDE as i32;
    let mut bytes = Vec::new();
    for y in 0..side {
        for x in 0..side {
            let border = x.min(y).min(side - 1 - x).min(side - 1 - y) < 6;
            let brace = (x - y).abs() < 5 || (x + y - side).abs() < 5;
            let gap = y % 13 == 0;
            let grain = ((x * 7 + y * y * 13) % 17) as u8;
            let [r, g, b] = match (border || brace, gap) {
                (true, _) => [150, 98, 52],
                (false, true) => [70, 42, 22],
                (false, false) => [196, 142, 84],
            };
            bytes.extend([r - grain, g - grain, b - grain, 255]);
        }
    }
    bytes
}

fn upload(host: &Host, texture: &HostTexture) -> Result<()> {
    let texels = texels();
    let staging = HostBuffer::new(host, texels.len() as u64)?;
    staging.write(host, &texels)?;
    host.run(|commands| {
        let written = (
            vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            vk::PipelineStageFlags2::ALL_TRANSFER,
            vk::AccessFlags2::TRANSFER_WRITE,
        );
        let fresh = (vk::ImageLayout::UNDEFINED, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);
        texture.barrier(host, commands, fresh, written);
        // SAFETY: recording state; the staging buffer holds the whole image.
        unsafe {
            let regions = [texture.region()];
            host.device.cmd_copy_buffer_to_image(commands, staging.raw, texture.image, written.0, &regions);
        }
        texture.barrier(host, commands, written, SAMPLED);
        Ok(())
    })?;
    staging.destroy(host);
    Ok(())
}
