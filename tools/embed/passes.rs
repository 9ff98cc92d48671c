//! The host's own graphics passes, in the order of a frame: a textured crate with depth, lit in linear light; the splats' depth, written
//! into the depth attachment for later passes; and the tone curve, which converts the linear picture for a display.

use super::host::{Host, Result};
use super::memory::{HostBuffer, HostTexture, Use};
use ashsplat::ash::{util::read_spv, vk};
use ashsplat::scene::DepthMapping;

/// Uses of the attachments after a pass.
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
/// Use of an image without contents.
pub const UNUSED: Use = (vk::ImageLayout::UNDEFINED, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);
pub const SAMPLED: Use = (
    vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
    vk::PipelineStageFlags2::FRAGMENT_SHADER,
    vk::AccessFlags2::SHADER_SAMPLED_READ,
);

/// The expected depth of pixels without splats.
pub const EMPTY: f32 = -1.0;

const TEXTURE_SIDE: u32 = 64;

/// A SPIR-V module that build.rs compiled from a file in this folder.
macro_rules! spirv {
    ($name:literal) => {
        include_bytes!(concat!(env!("OUT_DIR"), "/embed_", $name, ".spv"))
    };
}

pub struct Cube {
    texture: HostTexture,
    pass: Pass,
}

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
        let texture = HostTexture::new(host, vk::Format::R8G8B8A8_SRGB, usage, [TEXTURE_SIDE; 2])?;
        upload(host, &texture, &planks())?;
        let info = PassInfo {
            shaders: [spirv!("cube.vert"), spirv!("cube.frag")],
            filter: vk::Filter::LINEAR,
            push: Some((vk::ShaderStageFlags::VERTEX, 64)),
            color: Some(color),
            depth: Some(depth),
        };
        let pass = Pass::new(host, &texture, &info)?;
        Ok(Self { texture, pass })
    }

    /// Records the pass: clears both attachments and draws the cube.
    pub fn record(&self, host: &Host, commands: vk::CommandBuffer, pass: &CubePass<'_>) {
        // The earlier contents are not needed, but the guest's compute shaders must have finished reading them.
        let [color_last, depth_last] =
            pass.last.map(|(_, stages, accesses)| (vk::ImageLayout::UNDEFINED, stages, accesses));
        pass.color.barrier(host, commands, color_last, COLOR_WRITTEN);
        pass.depth.barrier(host, commands, depth_last, depth_tested());
        let color = vk::ClearValue { color: vk::ClearColorValue { float32: pass.background } };
        let far = if pass.reversed_depth { 0.0 } else { 1.0 };
        let depth = vk::ClearValue { depth_stencil: vk::ClearDepthStencilValue { depth: far, stencil: 0 } };
        let clear = vk::AttachmentLoadOp::CLEAR;
        let draw = Draw {
            color: Some(attachment(pass.color, COLOR_WRITTEN, clear).clear_value(color)),
            depth: Some(attachment(pass.depth, DEPTH_WRITTEN, clear).clear_value(depth)),
            size: pass.color.size,
            reversed_depth: pass.reversed_depth,
            push: &pass.clip_from_object.map(f32::to_bits),
            vertices: 36,
        };
        self.pass.draw(host, commands, &draw);
    }

    pub fn destroy(self, host: &Host) {
        self.pass.destroy(host);
        self.texture.destroy(host);
    }
}

/// Planks of a crate.
fn planks() -> Vec<u8> {
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

fn upload(host: &Host, texture: &HostTexture, texels: &[u8]) -> Result<()> {
    let staging = HostBuffer::new(host, texels.len() as u64)?;
    staging.write(host, texels)?;
    host.run(|commands| {
        let written = (
            vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            vk::PipelineStageFlags2::ALL_TRANSFER,
            vk::AccessFlags2::TRANSFER_WRITE,
        );
        texture.barrier(host, commands, UNUSED, written);
        let regions = [texture.region()];
        // SAFETY: recording state; the staging buffer holds the whole image.
        unsafe {
            host.device.cmd_copy_buffer_to_image(commands, staging.raw, texture.image, written.0, &regions);
        }
        texture.barrier(host, commands, written, SAMPLED);
        Ok(())
    })?;
    staging.destroy(host);
    Ok(())
}

/// Writes the splats' depth, from their expected depth as its texture.
pub struct SplatDepth(Pass);

impl SplatDepth {
    pub fn new(host: &Host, expected: &HostTexture, depth: vk::Format) -> Result<Self> {
        let info = PassInfo {
            shaders: [spirv!("tonemap.vert"), spirv!("splat_depth.frag")],
            filter: vk::Filter::NEAREST,
            push: Some((vk::ShaderStageFlags::FRAGMENT, 20)),
            color: None,
            depth: Some(depth),
        };
        Ok(Self(Pass::new(host, expected, &info)?))
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
        depth.barrier(host, commands, depth_last, depth_tested());
        let [a, b] = mapping.coefficients().map(f32::to_bits);
        let draw = Draw {
            color: None,
            depth: Some(attachment(depth, DEPTH_WRITTEN, vk::AttachmentLoadOp::LOAD)),
            size: depth.size,
            reversed_depth: mapping.clear_value == 0.0,
            push: &[a, b, u32::from(mapping.linear), EMPTY.to_bits(), mapping.clear_value.to_bits()],
            vertices: 3,
        };
        self.0.draw(host, commands, &draw);
        [SAMPLED, DEPTH_WRITTEN]
    }

    pub fn destroy(self, host: &Host) {
        self.0.destroy(host);
    }
}

/// Applies the tone curve to a picture, its texture.
pub struct Tonemap(Pass);

impl Tonemap {
    pub fn new(host: &Host, picture: &HostTexture, display: vk::Format) -> Result<Self> {
        let info = PassInfo {
            shaders: [spirv!("tonemap.vert"), spirv!("tonemap.frag")],
            filter: vk::Filter::NEAREST,
            push: None,
            color: Some(display),
            depth: None,
        };
        Ok(Self(Pass::new(host, picture, &info)?))
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
        let draw = Draw {
            color: Some(attachment(display, COLOR_WRITTEN, vk::AttachmentLoadOp::DONT_CARE)),
            depth: None,
            size: display.size,
            reversed_depth: false,
            push: &[],
            vertices: 3,
        };
        self.0.draw(host, commands, &draw);
        [SAMPLED, COLOR_WRITTEN]
    }

    pub fn destroy(self, host: &Host) {
        self.0.destroy(host);
    }
}

/// Use of a depth attachment from the beginning of a pass.
fn depth_tested() -> Use {
    let (layout, late, write) = DEPTH_WRITTEN;
    let stages = vk::PipelineStageFlags2::EARLY_FRAGMENT_TESTS | late;
    (layout, stages, vk::AccessFlags2::DEPTH_STENCIL_ATTACHMENT_READ | write)
}

fn attachment(
    texture: &HostTexture,
    (layout, ..): Use,
    load: vk::AttachmentLoadOp,
) -> vk::RenderingAttachmentInfo<'static> {
    vk::RenderingAttachmentInfo::default()
        .image_view(texture.view)
        .image_layout(layout)
        .load_op(load)
        .store_op(vk::AttachmentStoreOp::STORE)
}

/// A graphics pass whose fragment shader samples one texture.
struct Pass {
    sampler: vk::Sampler,
    set_layout: vk::DescriptorSetLayout,
    pool: vk::DescriptorPool,
    set: vk::DescriptorSet,
    layout: vk::PipelineLayout,
    push_stage: vk::ShaderStageFlags,
    /// One pipeline without depth; with depth, for conventional and for reversed depth.
    pipelines: Vec<vk::Pipeline>,
}

struct PassInfo<'a> {
    /// SPIR-V of the vertex and of the fragment shader.
    shaders: [&'a [u8]; 2],
    filter: vk::Filter,
    /// Stage and bytes of the push constants.
    push: Option<(vk::ShaderStageFlags, u32)>,
    color: Option<vk::Format>,
    depth: Option<vk::Format>,
}

struct Draw<'a> {
    color: Option<vk::RenderingAttachmentInfo<'a>>,
    depth: Option<vk::RenderingAttachmentInfo<'a>>,
    size: [u32; 2],
    reversed_depth: bool,
    push: &'a [u32],
    vertices: u32,
}

impl Pass {
    fn new(host: &Host, texture: &HostTexture, info: &PassInfo<'_>) -> Result<Self> {
        let device = &host.device;
        let kind = vk::DescriptorType::COMBINED_IMAGE_SAMPLER;
        let bindings = [vk::DescriptorSetLayoutBinding::default()
            .descriptor_type(kind)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::FRAGMENT)];
        let sizes = [vk::DescriptorPoolSize::default().ty(kind).descriptor_count(1)];
        // SAFETY: valid create infos; handles come from the calls before; SPIR-V that build.rs compiled, matching this layout.
        unsafe {
            let create = vk::SamplerCreateInfo::default().mag_filter(info.filter).min_filter(info.filter);
            let sampler = device.create_sampler(&create, None)?;
            let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
            let set_layout = device.create_descriptor_set_layout(&create, None)?;
            let create = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
            let pool = device.create_descriptor_pool(&create, None)?;
            let layouts = [set_layout];
            let allocate =
                vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
            let set = device.allocate_descriptor_sets(&allocate)?[0];
            let image =
                vk::DescriptorImageInfo { sampler, image_view: texture.view, image_layout: SAMPLED.0 };
            let images = [image];
            let write =
                vk::WriteDescriptorSet::default().dst_set(set).descriptor_type(kind).image_info(&images);
            device.update_descriptor_sets(&[write], &[]);
            let push =
                info.push.map(|(stage_flags, size)| vk::PushConstantRange { stage_flags, offset: 0, size });
            let create = vk::PipelineLayoutCreateInfo::default()
                .set_layouts(&layouts)
                .push_constant_ranges(push.as_slice());
            let layout = device.create_pipeline_layout(&create, None)?;
            // The comparison has no effect without depth.
            let compares: &[_] = match info.depth {
                Some(_) => &[vk::CompareOp::LESS, vk::CompareOp::GREATER],
                None => &[vk::CompareOp::NEVER],
            };
            let pipelines = compares.iter().map(|&compare| pipeline(host, layout, info, compare));
            let pipelines = pipelines.collect::<Result<_>>()?;
            let push_stage = info.push.unwrap_or_default().0;
            Ok(Self { sampler, set_layout, pool, set, layout, push_stage, pipelines })
        }
    }

    /// Records the pass over the whole of its attachments.
    fn draw(&self, host: &Host, commands: vk::CommandBuffer, draw: &Draw<'_>) {
        let [width, height] = draw.size;
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent: vk::Extent2D { width, height } };
        let mut info = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(1)
            .color_attachments(draw.color.as_slice());
        if let Some(depth) = &draw.depth {
            info = info.depth_attachment(depth);
        }
        let viewport =
            vk::Viewport { width: width as f32, height: height as f32, max_depth: 1.0, ..Default::default() };
        let push: Vec<u8> = draw.push.iter().flat_map(|word| word.to_ne_bytes()).collect();
        // SAFETY: recording state; the pipelines' formats are the attachments'.
        unsafe {
            let (device, graphics) = (&host.device, vk::PipelineBindPoint::GRAPHICS);
            device.cmd_begin_rendering(commands, &info);
            device.cmd_bind_pipeline(commands, graphics, self.pipelines[usize::from(draw.reversed_depth)]);
            device.cmd_bind_descriptor_sets(commands, graphics, self.layout, 0, &[self.set], &[]);
            if !push.is_empty() {
                device.cmd_push_constants(commands, self.layout, self.push_stage, 0, &push);
            }
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_draw(commands, draw.vertices, 1, 0, 0);
            device.cmd_end_rendering(commands);
        }
    }

    fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            self.pipelines.into_iter().for_each(|p| host.device.destroy_pipeline(p, None));
            host.device.destroy_pipeline_layout(self.layout, None);
            host.device.destroy_descriptor_pool(self.pool, None);
            host.device.destroy_descriptor_set_layout(self.set_layout, None);
            host.device.destroy_sampler(self.sampler, None);
        }
    }
}

/// # Safety
/// The modules are valid, and match this layout.
unsafe fn pipeline(
    host: &Host,
    layout: vk::PipelineLayout,
    info: &PassInfo<'_>,
    compare: vk::CompareOp,
) -> Result<vk::Pipeline> {
    let [vertex, fragment] = info.shaders.map(|bytes| read_spv(&mut std::io::Cursor::new(bytes)));
    let (vertex, fragment) = (vertex?, fragment?);
    let device = &host.device;
    let module = |code: &[u32]| {
        let create = vk::ShaderModuleCreateInfo::default().code(code);
        // SAFETY: a valid module, as promised.
        unsafe { device.create_shader_module(&create, None) }
    };
    let modules = [module(&vertex)?, module(&fragment)?];
    let stage = |stage, module| {
        vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module).name(c"main")
    };
    let stages =
        [stage(vk::ShaderStageFlags::VERTEX, modules[0]), stage(vk::ShaderStageFlags::FRAGMENT, modules[1])];
    let input = vk::PipelineVertexInputStateCreateInfo::default();
    let assembly =
        vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
    let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
    let raster = vk::PipelineRasterizationStateCreateInfo::default().line_width(1.0);
    let samples =
        vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
    let depth_test = vk::PipelineDepthStencilStateCreateInfo::default()
        .depth_test_enable(info.depth.is_some())
        .depth_write_enable(info.depth.is_some())
        .depth_compare_op(compare);
    let opaque =
        vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA);
    let blends = info.color.map(|_| opaque);
    let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(blends.as_slice());
    let states = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
    let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&states);
    let mut rendering = vk::PipelineRenderingCreateInfo::default()
        .color_attachment_formats(info.color.as_slice())
        .depth_attachment_format(info.depth.unwrap_or_default());
    let create = vk::GraphicsPipelineCreateInfo::default()
        .stages(&stages)
        .vertex_input_state(&input)
        .input_assembly_state(&assembly)
        .viewport_state(&viewport)
        .rasterization_state(&raster)
        .multisample_state(&samples)
        .depth_stencil_state(&depth_test)
        .color_blend_state(&blend)
        .dynamic_state(&dynamic)
        .layout(layout)
        .push_next(&mut rendering);
    // SAFETY: valid modules that match the layout, as promised; every pointer lives through its call.
    unsafe {
        let made = device.create_graphics_pipelines(vk::PipelineCache::null(), &[create], None);
        modules.into_iter().for_each(|m| device.destroy_shader_module(m, None));
        Ok(made.map_err(|(_, error)| error)?[0])
    }
}
