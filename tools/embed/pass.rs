//! Shared by the host's graphics passes: a pipeline of two shaders, and a texture for the fragment shader.

use super::cube::SAMPLED;
use super::host::{Host, Result};
use super::memory::HostTexture;
use ashsplat::ash::vk;

/// A SPIR-V module that build.rs compiled from a file in this folder.
macro_rules! spirv {
    ($name:literal) => {
        include_bytes!(concat!(env!("OUT_DIR"), "/embed_", $name, ".spv"))
    };
}
pub(crate) use spirv;

/// A descriptor set with one texture for a fragment shader.
pub struct Sampled {
    sampler: vk::Sampler,
    pub set_layout: vk::DescriptorSetLayout,
    pool: vk::DescriptorPool,
    pub set: vk::DescriptorSet,
}

impl Sampled {
    pub fn new(host: &Host, texture: &HostTexture, filter: vk::Filter) -> Result<Self> {
        // SAFETY: valid create infos; handles come from the calls before.
        unsafe {
            let device = &host.device;
            let info = vk::SamplerCreateInfo::default().mag_filter(filter).min_filter(filter);
            let sampler = device.create_sampler(&info, None)?;
            let kind = vk::DescriptorType::COMBINED_IMAGE_SAMPLER;
            let bindings = [vk::DescriptorSetLayoutBinding::default()
                .descriptor_type(kind)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::FRAGMENT)];
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
            let set_layout = device.create_descriptor_set_layout(&info, None)?;
            let sizes = [vk::DescriptorPoolSize::default().ty(kind).descriptor_count(1)];
            let info = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
            let pool = device.create_descriptor_pool(&info, None)?;
            let layouts = [set_layout];
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
            let set = device.allocate_descriptor_sets(&info)?[0];
            let images = [vk::DescriptorImageInfo::default()
                .sampler(sampler)
                .image_view(texture.view)
                .image_layout(SAMPLED.0)];
            let write =
                vk::WriteDescriptorSet::default().dst_set(set).descriptor_type(kind).image_info(&images);
            device.update_descriptor_sets(&[write], &[]);
            Ok(Self { sampler, set_layout, pool, set })
        }
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            host.device.destroy_descriptor_pool(self.pool, None);
            host.device.destroy_descriptor_set_layout(self.set_layout, None);
            host.device.destroy_sampler(self.sampler, None);
        }
    }
}

/// A pipeline of two SPIR-V modules, with a depth test if `depth` is given, and without colours if their format is UNDEFINED.
///
/// # Safety
/// The modules are valid, and match this layout.
pub unsafe fn pipeline(
    host: &Host,
    layout: vk::PipelineLayout,
    shaders: [&[u8]; 2],
    color: vk::Format,
    depth: Option<(vk::Format, vk::CompareOp)>,
) -> Result<vk::Pipeline> {
    let [vertex, fragment] = shaders.map(super::host::words);
    let (depth, compare) = depth.unwrap_or_default();
    let tested = depth != vk::Format::UNDEFINED;
    let colors = usize::from(color != vk::Format::UNDEFINED);
    // SAFETY: valid modules, as promised; every pointer lives through its call.
    unsafe {
        let device = &host.device;
        let module = |code: &[u32]| {
            device.create_shader_module(&vk::ShaderModuleCreateInfo::default().code(code), None)
        };
        let modules = [module(&vertex)?, module(&fragment)?];
        let stage = |stage, module| {
            vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module).name(c"main")
        };
        let stages = [
            stage(vk::ShaderStageFlags::VERTEX, modules[0]),
            stage(vk::ShaderStageFlags::FRAGMENT, modules[1]),
        ];
        let input = vk::PipelineVertexInputStateCreateInfo::default();
        let assembly = vk::PipelineInputAssemblyStateCreateInfo::default()
            .topology(vk::PrimitiveTopology::TRIANGLE_LIST);
        let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        let raster = vk::PipelineRasterizationStateCreateInfo::default().line_width(1.0);
        let samples = vk::PipelineMultisampleStateCreateInfo::default()
            .rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let depth_test = vk::PipelineDepthStencilStateCreateInfo::default()
            .depth_test_enable(tested)
            .depth_write_enable(tested)
            .depth_compare_op(compare);
        let blends =
            [vk::PipelineColorBlendAttachmentState::default()
                .color_write_mask(vk::ColorComponentFlags::RGBA)];
        let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends[..colors]);
        let states = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&states);
        let formats = [color];
        let mut rendering = vk::PipelineRenderingCreateInfo::default()
            .color_attachment_formats(&formats[..colors])
            .depth_attachment_format(depth);
        let info = vk::GraphicsPipelineCreateInfo::default()
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
        let made = device.create_graphics_pipelines(vk::PipelineCache::null(), &[info], None);
        modules.into_iter().for_each(|m| device.destroy_shader_module(m, None));
        Ok(made.map_err(|(_, error)| error)?[0])
    }
}
