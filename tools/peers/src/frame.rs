//! wgpu-3dgs-viewer 0.8.0 beside ashsplat: the same file, camera and size, sorted anew in each frame, read back.

use crate::measure::{self, Result, Run};
use ashsplat::scene::Camera;
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{RenderSettings, Renderer};
use ashsplat_files::{Photo, PhotoFileFormat, metrics, splats};
use std::path::Path;
use wgpu_3dgs_viewer as peer;

/// Cutoff of the peer's quads. With this value it draws Gaussians exp(-d^2 / 2) of the file's shape, out to d = 4.
const MAX_STD_DEV: f32 = 2.828_427;

pub fn run(scene: &Path, camera: &Camera, runs: usize, folder: &Path) -> Result<()> {
    let context = Context::new(&ContextOptions::default())?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(&splats::read(scene, &Default::default())?.gaussians)?;
    let mut theirs = Theirs::new(scene, camera)?;
    let settings = RenderSettings::default();
    // The peer widens no splat; ashsplat's dilation must be above 0.
    let sharp = RenderSettings { dilation_px2: 1e-4, ..settings.clone() };
    let frame = |renderer: &mut Renderer, settings: &RenderSettings| -> Result<Photo> {
        let frame = renderer.render(camera, settings)?;
        Ok(Photo::from_f32(frame.width, frame.height, &frame.color)?)
    };
    let medians = measure::in_turn(
        runs,
        || measure::time(|| Ok(drop(renderer.render(camera, &settings)?))),
        || theirs.draw(),
    )?;
    let picture = theirs.picture(camera);
    let ours = [frame(&mut renderer, &settings)?, frame(&mut renderer, &sharp)?];
    let psnr = |ours: &Photo| metrics::psnr(&ours.to_f32(), &picture.to_f32(), None);
    let likeness = format!("{:.1} dB, both without dilation {:.1} dB", psnr(&ours[0])?, psnr(&ours[1])?);
    ours[0].write_png(&folder.join("ours.png"))?;
    picture.write_png(&folder.join("wgpu_3dgs_viewer.png"))?;
    let what = format!("frame of {}×{}: wgpu-3dgs-viewer 0.8.0", camera.width, camera.height);
    measure::print(&what, medians, &likeness);
    Ok(())
}

/// ashsplat's frame alone, for programs that cannot run in this process.
pub fn ours(scene: &Path, camera: &Camera, runs: usize, folder: &Path) -> Result<()> {
    let context = Context::new(&ContextOptions::default())?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(&splats::read(scene, &Default::default())?.gaussians)?;
    let settings = RenderSettings::default();
    let run = measure::alone(runs, || measure::time(|| Ok(drop(renderer.render(camera, &settings)?))))?;
    let frame = renderer.render(camera, &settings)?;
    Photo::from_f32(frame.width, frame.height, &frame.color)?.write_png(&folder.join("ours.png"))?;
    println!("{run}");
    Ok(())
}

/// Prints the PSNR of two pictures.
pub fn alike(a: &Path, b: &Path) -> Result<()> {
    let [a, b] = [Photo::read(a, [0.0; 3])?, Photo::read(b, [0.0; 3])?];
    println!("{:.1} dB", metrics::psnr(&a.to_f32(), &b.to_f32(), None)?);
    Ok(())
}

struct Theirs {
    device: wgpu::Device,
    queue: wgpu::Queue,
    viewer: peer::Viewer,
    texture: wgpu::Texture,
    pixels: wgpu::Buffer,
    bytes: Vec<u8>,
}

impl Theirs {
    fn new(scene: &Path, camera: &Camera) -> Result<Self> {
        let backends = wgpu::Backends::VULKAN;
        let descriptor =
            wgpu::InstanceDescriptor { backends, ..wgpu::InstanceDescriptor::new_without_display_handle() };
        let instance = wgpu::Instance::new(descriptor);
        let adapters = pollster::block_on(instance.enumerate_adapters(backends));
        let adapter = adapters.into_iter().next().ok_or("no Vulkan adapter")?;
        let descriptor = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))?;
        let format = wgpu::TextureFormat::Rgba8Unorm;
        let source = peer::core::GaussiansSource::Ply;
        let gaussians = peer::core::Gaussians::read_from_file(scene, source)?;
        let mut viewer = peer::Viewer::new(&device, format, &gaussians)?;
        viewer.update_camera_with_pod(&queue, &camera_pod(camera));
        viewer.update_gaussian_transform(
            &queue,
            1.0,
            peer::core::GaussianDisplayMode::Splat,
            peer::core::GaussianShDegree::new(3).ok_or("degree 3")?,
            false,
            peer::core::GaussianMaxStdDev::new(MAX_STD_DEV).ok_or("deviations")?,
        );
        let size = wgpu::Extent3d { width: camera.width, height: camera.height, depth_or_array_layers: 1 };
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let pixels = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pixels"),
            size: u64::from(row_bytes(camera)) * u64::from(camera.height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Ok(Self { device, queue, viewer, texture, pixels, bytes: Vec::new() })
    }

    fn draw(&mut self) -> Result<Run> {
        measure::time(|| {
            let view = self.texture.create_view(&Default::default());
            let mut encoder = self.device.create_command_encoder(&Default::default());
            self.viewer.render(&mut encoder, &view);
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some((4 * self.texture.width()).next_multiple_of(256)),
                rows_per_image: None,
            };
            let to = wgpu::TexelCopyBufferInfo { buffer: &self.pixels, layout };
            encoder.copy_texture_to_buffer(self.texture.as_image_copy(), to, self.texture.size());
            self.queue.submit([encoder.finish()]);
            self.pixels.map_async(wgpu::MapMode::Read, .., |_| ());
            self.device.poll(wgpu::PollType::wait_indefinitely())?;
            self.bytes = self.pixels.get_mapped_range(..)?.to_vec();
            self.pixels.unmap();
            Ok(())
        })
    }

    fn picture(&self, camera: &Camera) -> Photo {
        let rows = self.bytes.chunks_exact(row_bytes(camera) as usize);
        let pixels = rows.flat_map(|row| row.as_chunks::<4>().0.iter().take(camera.width as usize));
        let rgb = pixels.flat_map(|p| [p[0], p[1], p[2]]).collect();
        Photo { width: camera.width, height: camera.height, rgb }
    }
}

fn row_bytes(camera: &Camera) -> u32 {
    (4 * camera.width).next_multiple_of(256)
}

/// The peer's uniform: a view with y up and z backward, a projection to depths from 0 to 1, and the size.
fn camera_pod(camera: &Camera) -> peer::CameraPod {
    use ashsplat::glam::{Mat4, Vec3, camera::rh::proj::directx};
    let flip = Mat4::from_scale(Vec3::new(1.0, -1.0, -1.0));
    let view = flip * Mat4::from_mat3_translation(camera.camera_from_world, camera.translation);
    let size = [camera.width as f32, camera.height as f32];
    let fov_y = 2.0 * (0.5 * size[1] / camera.fy).atan();
    let projection = directx::perspective(fov_y, size[0] / size[1], 0.2, 1000.0);
    let mut floats = [0.0; 36];
    floats[..16].copy_from_slice(&view.to_cols_array());
    floats[16..32].copy_from_slice(&projection.to_cols_array());
    floats[32..34].copy_from_slice(&size);
    bytemuck::pod_read_unaligned(bytemuck::bytes_of(&floats))
}
