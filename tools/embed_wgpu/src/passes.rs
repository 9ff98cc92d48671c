//! The host's own passes in wgpu: a backdrop before the splats, and the displayed copy after them.

use crate::Result;
use crate::device::Host;
use crate::guest::{FORMAT, STATE};

const SHOWN: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Colour of the backdrop in a row of pixels; the shader computes the same.
pub fn backdrop(y: u32, height: u32) -> [f32; 3] {
    let below = (y as f32 + 0.5) / height as f32;
    let (top, bottom) = ([0.5, 0.6, 0.75], [0.15, 0.125, 0.1]);
    [0, 1, 2].map(|i| top[i] + below * (bottom[i] - top[i]))
}

pub struct Passes {
    target: wgpu::Texture,
    shown: wgpu::Texture,
    /// Rows have the width that wgpu's copies require.
    pixels: wgpu::Buffer,
    row_bytes: u32,
    backdrop: wgpu::RenderPipeline,
    show: wgpu::RenderPipeline,
    picture: wgpu::BindGroup,
}

impl Passes {
    pub fn new(host: &Host, target: &wgpu::Texture) -> Self {
        let device = &host.device;
        let text = include_str!("passes.wgsl").replace("HEIGHT", &format!("{}.0", target.height()));
        let source = wgpu::ShaderSource::Wgsl(text.into());
        let shaders =
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("passes"), source });
        let backdrop = pipeline(device, &shaders, "backdrop", FORMAT);
        let show = pipeline(device, &shaders, "show", SHOWN);
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let shown = texture(host, "shown", SHOWN, usage, [target.width(), target.height()]);
        let row_bytes = (4 * target.width()).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let pixels = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pixels"),
            size: u64::from(row_bytes) * u64::from(target.height()),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        let picture = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &show.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&view),
            }],
        });
        Self { target: target.clone(), shown, pixels, row_bytes, backdrop, show, picture }
    }

    /// Draws what is behind the splats, and leaves the target in the state that the guest expects. wgpu clears an unwritten
    /// texture at its first use, which would be after the splats: the host must always draw or clear first.
    pub fn before(&self, host: &Host) -> wgpu::CommandBuffer {
        let mut encoder = host.device.create_command_encoder(&Default::default());
        draw(&mut encoder, &self.target, &self.backdrop, None);
        let transition = wgpu::wgt::TextureTransition { texture: &self.target, selector: None, state: STATE };
        encoder.transition_resources(std::iter::empty(), std::iter::once(transition));
        encoder.finish()
    }

    /// Displays the picture with the splats, and copies it to the host's buffer.
    pub fn behind(&self, host: &Host) -> wgpu::CommandBuffer {
        let mut encoder = host.device.create_command_encoder(&Default::default());
        draw(&mut encoder, &self.shown, &self.show, Some(&self.picture));
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(self.row_bytes),
            rows_per_image: None,
        };
        let to = wgpu::TexelCopyBufferInfo { buffer: &self.pixels, layout };
        encoder.copy_texture_to_buffer(self.shown.as_image_copy(), to, self.shown.size());
        encoder.finish()
    }

    /// The pixels of the last picture, r, g, b, row by row.
    pub fn read(&self, host: &Host) -> Result<Vec<u8>> {
        let slice = self.pixels.slice(..);
        let (sender, receiver) = std::sync::mpsc::channel();
        slice.map_async(wgpu::MapMode::Read, move |mapped| drop(sender.send(mapped)));
        host.device.poll(wgpu::PollType::wait_indefinitely())?;
        receiver.recv()??;
        let bytes = slice.get_mapped_range()?;
        let rows = bytes.chunks_exact(self.row_bytes as usize);
        let rgb = rows.flat_map(|row| {
            row.as_chunks::<4>().0.iter().take(self.target.width() as usize).flat_map(|p| [p[0], p[1], p[2]])
        });
        let rgb = rgb.collect();
        drop(bytes);
        self.pixels.unmap();
        Ok(rgb)
    }
}

/// A texture of one level, layer and sample.
pub fn texture(
    host: &Host,
    label: &str,
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
    [width, height]: [u32; 2],
) -> wgpu::Texture {
    host.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

fn pipeline(
    device: &wgpu::Device,
    shaders: &wgpu::ShaderModule,
    name: &str,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let compilation_options = wgpu::PipelineCompilationOptions::default();
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(name),
        layout: None,
        vertex: wgpu::VertexState {
            module: shaders,
            entry_point: Some("full_screen"),
            compilation_options: compilation_options.clone(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: shaders,
            entry_point: Some(name),
            compilation_options,
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A triangle over the whole texture.
fn draw(
    encoder: &mut wgpu::CommandEncoder,
    to: &wgpu::Texture,
    pipeline: &wgpu::RenderPipeline,
    picture: Option<&wgpu::BindGroup>,
) {
    let view = to.create_view(&wgpu::TextureViewDescriptor::default());
    let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store };
    let color = wgpu::RenderPassColorAttachment { view: &view, depth_slice: None, resolve_target: None, ops };
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("full screen"),
        color_attachments: &[Some(color)],
        ..Default::default()
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, picture, &[]);
    pass.draw(0..3, 0..1);
}
