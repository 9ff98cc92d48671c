//! Images of the host's that a frame draws into or is hidden by, used again and again, and where their texels go.

use super::truth::WRITTEN;
use crate::host::{Host, InFlight};
use crate::memory::{HostBuffer, HostTexture, Use};
use crate::scenes::depth_image;
use ashsplat::ash::vk;
use ashsplat::scene::DepthMapping;
use ashsplat::vk::{Context, Image, ImageState, ImageUse};
use ashsplat::{Background, ColorEncoding, DepthTarget, HostImage, Occluder, RecordedFrame, Release, Target};

/// What a frame has of them.
#[derive(Clone, Copy, Default)]
pub struct Wanted {
    /// A picture in an image.
    pub target: Option<(Background, ColorEncoding)>,
    /// Expected depth.
    pub depth: bool,
    /// Depth of the host's that hides splats.
    pub occluder: Option<DepthMapping>,
}

/// Bits of texels: colours, expected depth; none where they were not asked for.
pub type Seen = [Vec<u32>; 2];

pub struct Outputs<'a> {
    host: &'a Host,
    /// Colour, expected depth, the host's depth.
    textures: [HostTexture; 3],
    views: [Image; 3],
    staging: [HostBuffer; 2],
    /// The last use of each image.
    last: [ImageState; 3],
}

fn of(ImageState { layout, stages, accesses }: ImageState) -> Use {
    (layout, stages, accesses)
}

fn state((layout, stages, accesses): Use) -> ImageState {
    ImageState { layout, stages, accesses }
}

impl<'a> Outputs<'a> {
    /// The host's depth is `hides` everywhere.
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
            // SAFETY: the images are as they say, and outlive the views.
            unsafe { Image::adopt(context, "output", &textures[which].foreign(), purpose) }.expect("adopted")
        });
        let pixels = u64::from(size[0] * size[1]);
        let staging = [16, 4].map(|bytes| HostBuffer::new(host, bytes * pixels).expect("memory"));
        Self { host, textures, views, staging, last: [ImageState::UNDEFINED, ImageState::UNDEFINED, written] }
    }

    /// A frame with what is wanted.
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

    /// Before the frame, in its command buffer: what it is drawn over.
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

    /// Notes the last use of the host's depth.
    pub fn note(&mut self, release: &Release) {
        self.last[2] = release.occluder.unwrap_or(self.last[2]);
    }

    /// Behind the frame, in its command buffer.
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

    /// After the fence.
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

    /// The expected depth after a frame that nobody else has read and that was waited for.
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
