//! A host's images of frames in flight, which are used repeatedly, and the buffers that read them.

use super::truth::Screens;
use crate::cut_outs::mapping;
use crate::stage::*;

/// Texels of picks and of motion; empty unless requested.
pub type PickAndMotion = (Vec<[u32; 4]>, Vec<[u16; 2]>);

pub struct Flight<'a> {
    screens: Screens<'a>,
    staging: [Staging<'a>; 2],
    last: [ImageState; 2],
}

impl<'a> Flight<'a> {
    pub fn new(host: &'a Host, context: &Context, size: [u32; 2]) -> Self {
        let screens = Screens::new(host, context, size);
        let staging = screens.pictures.each_ref().map(|picture| picture.texture.staging());
        Self { screens, staging, last: [ImageState::UNDEFINED; 2] }
    }

    pub fn with<'b>(
        &'b self,
        frame: RecordedFrame<'b>,
        previous: &'b Camera,
        [pick, motion]: [bool; 2],
    ) -> RecordedFrame<'b> {
        let to = |which: usize| host_image(&self.screens.pictures[which].image, self.last[which]);
        let moved = MotionTarget { to: to(1), ..self.screens.motion(previous) };
        RecordedFrame { pick: pick.then(|| to(0)), motion: motion.then_some(moved), ..frame }
    }

    /// Records the reads after the frame, in its command buffer.
    pub fn record_read(&mut self, commands: &Commands<'_>, wanted: [bool; 2]) {
        for which in (0..2).filter(|&which| wanted[which]) {
            let (texture, staging) = (&self.screens.pictures[which].texture, &self.staging[which]);
            texture.record_read(commands.host, commands.commands, used(WRITTEN), staging);
            self.last[which] = READ;
        }
    }

    /// Returns the texels; to be called after the fence.
    pub fn read(&self, [pick, motion]: [bool; 2]) -> PickAndMotion {
        let (picks, motions) = (pick.then(|| self.staging[0].read()), motion.then(|| self.staging[1].read()));
        (picks.unwrap_or_default(), motions.unwrap_or_default())
    }

    /// Reads the images after a frame that has finished and that recorded no reads.
    pub fn now(&self, [pick, motion]: [bool; 2]) -> PickAndMotion {
        let motions = || self.screens.pictures[1].texture.read(WRITTEN);
        let (picks, motions) = (pick.then(|| self.screens.picks()), motion.then(motions));
        (picks.unwrap_or_default(), motions.unwrap_or_default())
    }
}

/// Outputs and inputs that a frame uses.
#[derive(Clone, Copy, Default)]
pub struct OutputRequest {
    /// The picture in an image.
    pub target: Option<(Background, ColorEncoding)>,
    /// Expected depth.
    pub depth: bool,
    /// The host's depth, which hides splats.
    pub occluder: Option<DepthMapping>,
}

impl OutputRequest {
    /// A picture in linear light, in which the host's depth hides splats.
    pub fn hidden(camera: &Camera) -> Self {
        let target = Some((Background::Nothing, ColorEncoding::LINEAR));
        Self { target, depth: false, occluder: Some(mapping(camera)) }
    }
}

pub type OutputPixels = [Vec<u32>; 2];

/// Images that frames of a slot draw into or that hide splats.
pub struct Outputs<'a> {
    /// Colour, expected depth, the host's depth.
    pictures: [Picture<'a>; 3],
    staging: [Staging<'a>; 2],
    last: [ImageState; 3],
}

impl<'a> Outputs<'a> {
    /// `hides` is the value of the host's depth everywhere.
    pub fn new(host: &'a Host, context: &Context, size: [u32; 2], hides: f32) -> Self {
        let new = |purpose, format| Picture::new(host, context, ("output", purpose), format, size);
        let colors = new(ImageUse::Target, vk::Format::R32G32B32A32_SFLOAT);
        let distances = new(ImageUse::Depth, vk::Format::R32_SFLOAT);
        let staging = [colors.texture.staging(), distances.texture.staging()];
        let pictures = [colors, distances, Picture::of_depth(host, context, size, hides)];
        Self { pictures, staging, last: [ImageState::UNDEFINED, ImageState::UNDEFINED, COPIED] }
    }

    pub fn with<'b>(&'b self, frame: RecordedFrame<'b>, wanted: &OutputRequest) -> RecordedFrame<'b> {
        let to = |which: usize| host_image(&self.pictures[which].image, self.last[which]);
        let image = |(behind, encoding)| Target::Image { to: to(0), behind, encoding };
        RecordedFrame {
            target: wanted.target.map_or(frame.target, image),
            depth: wanted.depth.then(|| DepthTarget { to: to(1), min_weight: 0.5, empty: -1.0 }),
            occluder: wanted.occluder.map(|mapping| Occluder { depth: to(2), mapping }),
            ..frame
        }
    }

    /// Clears the target before the frame, in its command buffer, if the frame draws over it.
    pub fn record_clear(&mut self, commands: &Commands<'_>, wanted: &OutputRequest) {
        if matches!(wanted.target, Some((Background::Image, _))) {
            self.pictures[0].texture.clear(commands.commands, self.last[0], [0.1, 0.3, 0.2, 1.0]);
            self.last[0] = COPIED;
        }
    }

    /// Remembers the last use of the host's depth image.
    pub fn note(&mut self, release: &Release) {
        self.last[2] = release.occluder.unwrap_or(self.last[2]);
    }

    /// Records the reads after the frame, in its command buffer.
    pub fn record_read(&mut self, commands: &Commands<'_>, wanted: &OutputRequest, release: &Release) {
        self.note(release);
        for (which, last) in [release.color, release.depth].into_iter().enumerate() {
            let asked = [wanted.target.is_some(), wanted.depth][which];
            assert_eq!(last.is_some(), asked, "{release:?}");
            if let Some(last) = last {
                let (texture, to) = (&self.pictures[which].texture, &self.staging[which]);
                texture.record_read(commands.host, commands.commands, used(last), to);
                self.last[which] = READ;
            }
        }
    }

    /// Returns the texels; to be called after the fence.
    pub fn read(&self, wanted: &OutputRequest) -> OutputPixels {
        let words = |which: usize, asked: bool| if asked { self.staging[which].read() } else { Vec::new() };
        [words(0, wanted.target.is_some()), words(1, wanted.depth)]
    }

    /// Reads the expected depth after a frame that has finished and that recorded no reads.
    pub fn depths(&self) -> Vec<u32> {
        self.pictures[1].texture.read(WRITTEN)
    }
}
