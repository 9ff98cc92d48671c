//! The guest's part: steps 2 to 8 of the guide's chapter `embedding`.

use crate::Result;
use crate::device::Host;
use ashsplat::ash::vk;
use ashsplat::vk::{Context, ForeignImage, Image, ImageState, ImageUse};
use ashsplat::{
    Background, Camera, ColorEncoding, DeviceScene, Gaussians, HostImage, Placed, RecordedFrame,
    RenderSettings, Renderer, Reservation, Target,
};
use wgpu::hal::api::Vulkan;

/// Format of the target, in wgpu's and in Vulkan's terms.
pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
const VK_FORMAT: vk::Format = vk::Format::R16G16B16A16_SFLOAT;
/// STORAGE_BINDING becomes VK_IMAGE_USAGE_STORAGE_BIT, which the guest needs; the others are the host's own.
pub const USAGES: wgpu::TextureUsages = wgpu::TextureUsages::RENDER_ATTACHMENT
    .union(wgpu::TextureUsages::TEXTURE_BINDING)
    .union(wgpu::TextureUsages::STORAGE_BINDING);
/// State in which the host leaves the target to the guest, and gets it back: wgpu's tracker sees no other use. Its layout is
/// GENERAL.
pub const STATE: wgpu::wgt::TextureUses = wgpu::wgt::TextureUses::STORAGE_READ_WRITE;

pub struct Guest {
    renderer: Renderer,
    scene: DeviceScene,
    target: Image,
}

impl Guest {
    /// # Safety
    /// The guest is dropped before the target and the context's device. The target is two-dimensional, with one level, layer and
    /// sample, of [`FORMAT`] and [`USAGES`], without further view formats.
    pub unsafe fn new(
        context: &Context,
        gaussians: &Gaussians,
        target: &wgpu::Texture,
        slots: u32,
    ) -> Result<Self> {
        // SAFETY: the image is not destroyed here.
        let image = unsafe { target.as_hal::<Vulkan>().ok_or("not a Vulkan texture")?.raw_handle() };
        let (width, height) = (target.width(), target.height());
        let foreign = ForeignImage {
            image,
            format: VK_FORMAT,
            // wgpu sets flags only for cube maps, 3D textures and view formats.
            flags: vk::ImageCreateFlags::empty(),
            usage: vk::ImageUsageFlags::COLOR_ATTACHMENT
                | vk::ImageUsageFlags::SAMPLED
                | vk::ImageUsageFlags::STORAGE,
            samples: vk::SampleCountFlags::TYPE_1,
            size: [width, height],
            mip_level: 0,
            layer: 0,
        };
        // SAFETY: the caller's texture is as described and outlives the guest.
        let target = unsafe { Image::adopt(context, "wgpu's texture", &foreign, ImageUse::Target)? };
        let scene = DeviceScene::upload(context, gaussians, 0)?;
        let mut renderer = Renderer::new(context)?;
        let wanted = Reservation {
            slots,
            images_only: true,
            ..Reservation::new(scene.count(), gaussians.sh_degree, width, height)
        };
        renderer.reserve(&wanted)?;
        Ok(Self { renderer, scene, target })
    }

    /// Records a frame, composed over the target's contents, into a command buffer of wgpu's.
    ///
    /// # Safety
    /// The slot's earlier command buffer has finished. This one is submitted once, between others that leave the target in
    /// [`STATE`].
    pub unsafe fn record(&mut self, host: &Host, slot: u32, camera: &Camera) -> Result<wgpu::CommandBuffer> {
        // A separate encoder: wgpu does not mix its own commands with raw ones.
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("splats") };
        let mut encoder = host.device.create_command_encoder(&descriptor);
        let record = |raw: Option<&mut wgpu::hal::vulkan::CommandEncoder>| -> Result<()> {
            // SAFETY: recording state, outside of a render pass; the caller keeps the rest.
            let commands = unsafe {
                let raw = raw.ok_or("not a Vulkan encoder")?.raw_handle();
                self.renderer.context().adopt_commands(raw)?
            };
            // wgpu's barrier into `STATE` has made this available.
            let from = ImageState {
                layout: vk::ImageLayout::GENERAL,
                stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
                accesses: vk::AccessFlags2::SHADER_READ | vk::AccessFlags2::SHADER_WRITE,
            };
            let to = HostImage { image: &self.target, from, offset: [0; 2] };
            let target = Target::Image { to, behind: Background::Image, encoding: ColorEncoding::AsTrained };
            let (scenes, settings) = ([Placed::from(&self.scene)], RenderSettings::default());
            let frame = RecordedFrame { target, ..RecordedFrame::new(&scenes, camera, &settings) };
            let release = self.renderer.record(commands, slot, &frame)?;
            // wgpu's next barrier waits for shaders that access the image in GENERAL, and so for this frame.
            let color = release.color.ok_or("the frame has a target")?;
            assert_eq!(color.layout, vk::ImageLayout::GENERAL);
            assert!(vk::PipelineStageFlags2::COMPUTE_SHADER.contains(color.stages));
            Ok(())
        };
        // SAFETY: nothing else is recorded into this encoder, and the raw handle is not ended or destroyed.
        unsafe { encoder.as_hal_mut::<Vulkan, _, _>(record)? };
        Ok(encoder.finish())
    }

    /// Checks a finished frame: an error if its reservation was too small.
    pub fn finish(&mut self, slot: u32) -> Result<()> {
        let report = self.renderer.slot_report(slot)?.ok_or("the slot has no frame")?;
        self.renderer.release_slot(slot)?;
        match report.overflow {
            true => Err(format!("{} instances are needed", report.instances_needed).into()),
            false => Ok(()),
        }
    }
}
