//! A host's images that a frame draws into or that hide splats: used repeatedly, and the buffers that read them.

use super::truth::WRITTEN;
use crate::host::{Host, InFlight};
use crate::memory::{HostBuffer, HostTexture, Use};
use crate::scenes::depth_image;
use ashsplat::ash::vk;
use ashsplat::scene::DepthMapping;
use ashsplat::vk::{Context, Image, ImageState, ImageUse};
use ashsplat::{Background, ColorEncoding, DepthTarget, HostImage, Occluder, RecordedFrame, Release, Target};

/// Outputs and inputs that a frame uses.
#[derive(Clone, Copy, Default)]
pub struct Wanted {
    /// The picture in an image.
    pub target: Option<(Background, ColorEncoding)>,
    /// Expected depth.
    pub depth: bool,
    /// The host's depth, which hides splats.
    pub occluder: Option<DepthMapping>,
}

/// Words of colours and of expected depth; empty unless requested.
pub type Seen = [Vec<u32>; 2];

pub struct Outputs<'a> {
    host: &'a Host,
    /// Colour, expected depth, the host's depth.
    textures: [HostTexture; 3],
    views: [Image; 3],
    staging: [HostBuffer; 2],
    last: [ImageState; 3],
}

fn of(ImageState { layout, stages, accesses }: ImageState) -> Use {
    (layout, stages, accesses)
}

fn state((layout, stages, accesses): Use) -> ImageState {
    ImageState { layout, stages, accesses }
}

impl<'a> Outputs<'a> {
    /// `hides` is the value of the host's depth everywhere.
    pub fn new(host: &'a Host, context: &Context, size: [u32; 2], hides: f32) -> Self {
        let usage = vk::ImageUsageFlags::STORAGE
            | vk::ImageUsageFlags::TRANSFER_SRC
            | vk::ImageUsageFlags::TRANSFER_DST;
        let [colors, distances] = [vk::Format::R32G32B32A32_SFLOAT, vk::Format::R32_SFLOAT]
            .map(|format| HostTexture::new(host, format, usage, size).expect("an image"));
        let (depth, written) = depth_image(host, size, hides);
        let textures = [colors, distances, depth];
        let purposes = [ImageUse::Target, ImageUse::Depth, ImageUse::Occluder];
        let views = [0, 1, 2].map(|which| {
            let purpose = purposes[which];
            // SAFETY: the descriptions match the images, which outlive the views.
            unsafe { Image::adopt(context, "output", &textures[which].foreign(), purpose) }.expect("adopted")
        });
        let pixels = u64::from(size[0] * size[1]);
        let staging = [16, 4].map(|bytes| HostBuffer::new(host, bytes * pixels).expect("memory"));
        Self { host, textures, views, staging, last: [ImageState::UNDEFINED, ImageState::UNDEFINED, written] }
    }

    /// Adds the wanted outputs and inputs to a frame.
    pub fn with<'b>(&'b self, frame: RecordedFrame<'b>, wanted: &Wanted) -> RecordedFrame<'b> {
        let to =
            |which: usize| HostImage { image: &self.views[which], from: self.last[which], offset: [0; 2] };
        let image = |(behind, encoding)| Target::Image { to: to(0), behind, encoding };
        RecordedFrame {
            target: wanted.target.map_or(frame.target, image),
            depth: wanted.depth.then(|| DepthTarget { to: to(1), min_weight: 0.5, empty: -1.0 }),
            occluder: wanted.occluder.map(|mapping| Occluder { depth: to(2), mapping }),
            ..frame
        }
    }

    /// Clears the target before the frame, in its command buffer, if the frame draws over it.
    pub fn record_clear(&mut self, in_flight: &InFlight, wanted: &Wanted) {
        if !matches!(wanted.target, Some((Background::Image, _))) {
            return;
        }
        let (texture, commands) = (&self.textures[0], in_flight.commands);
        let cleared = (
            vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            vk::PipelineStageFlags2::ALL_TRANSFER,
            vk::AccessFlags2::TRANSFER_WRITE,
        );
        texture.barrier(self.host, commands, of(self.last[0]), cleared);
        let color = vk::ClearColorValue { float32: [0.1, 0.3, 0.2, 1.0] };
        let all = vk::ImageSubresourceRange {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            level_count: 1,
            layer_count: 1,
            ..Default::default()
        };
        // SAFETY: recording state; the image has TRANSFER_DST and this layout.
        unsafe { self.host.device.cmd_clear_color_image(commands, texture.image, cleared.0, &color, &[all]) };
        self.last[0] = state(cleared);
    }

    /// Notes the host's depth's last use.
    pub fn note(&mut self, release: &Release) {
        self.last[2] = release.occluder.unwrap_or(self.last[2]);
    }

    /// Records the reads after the frame, in its command buffer.
    pub fn record_read(&mut self, in_flight: &InFlight, wanted: &Wanted, release: &Release) {
        self.note(release);
        for (which, used) in [release.color, release.depth].into_iter().enumerate() {
            let asked = [wanted.target.is_some(), wanted.depth][which];
            assert_eq!(used.is_some(), asked, "{release:?}");
            if let Some(used) = used {
                let (texture, to) = (&self.textures[which], &self.staging[which]);
                let last = texture.record_read(self.host, in_flight.commands, of(used), to);
                self.last[which] = ImageState { accesses: vk::AccessFlags2::NONE, ..state(last) };
            }
        }
    }

    /// Returns the texels; to be called after the fence.
    pub fn read(&self, wanted: &Wanted) -> Seen {
        let [width, height] = self.textures[0].size;
        let bytes = |which: usize, asked: bool, bytes: u32| match asked {
            true => {
                let read = self.staging[which].read(self.host, (bytes * width * height) as usize);
                bytemuck::pod_collect_to_vec(&read.expect("bytes"))
            }
            false => Vec::new(),
        };
        [bytes(0, wanted.target.is_some(), 16), bytes(1, wanted.depth, 4)]
    }

    /// Reads the expected depth after a frame that has finished and that recorded no reads.
    pub fn depths(&self) -> Vec<u32> {
        let copied = self.host.run(|commands| {
            self.textures[1].record_read(self.host, commands, of(WRITTEN), &self.staging[1]);
            Ok(())
        });
        copied.expect("copied");
        self.read(&Wanted { depth: true, ..Wanted::default() })[1].clone()
    }

    pub fn destroy(self) {
        drop(self.views);
        self.textures.into_iter().for_each(|texture| texture.destroy(self.host));
        self.staging.into_iter().for_each(|staging| staging.destroy(self.host));
    }
}
