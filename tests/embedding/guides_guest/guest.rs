use ashsplat::ash::vk;
use ashsplat::scene::{HostView, Pose};
use ashsplat::vk::{Context, Image, ImageState};
use ashsplat::{
    Background, ColorEncoding, DeviceScene, Gaussians, HostImage, Occluder, Placed, RecordedFrame, Release,
    RenderSettings, Renderer, Reservation, Result, Target,
};

/// Splats in an engine's frames. Device, images, command buffers and fences are the engine's.
struct Guest {
    renderer: Renderer,
    reserved: Reservation,
    scenes: Vec<(DeviceScene, Pose)>,
    /// The target and the depth that hides splats: `ImageUse::Target` and `ImageUse::Occluder`.
    images: [Image; 2],
}

impl Guest {
    /// Once. Kernels are built here.
    fn new(context: &Context, frames_in_flight: u32, images: [Image; 2]) -> Result<Self> {
        let mut renderer = Renderer::new(context)?;
        let [width, height] = images[0].size();
        let reserved = Reservation {
            slots: frames_in_flight,
            scenes: 16,
            occlusion: true,
            images_only: true,
            ..Reservation::new(100_000, 3, width, height)
        };
        renderer.reserve(&reserved)?;
        Ok(Self { renderer, reserved, scenes: Vec::new(), images })
    }

    /// For the frames that are recorded from now on. Frames in flight go on with what they have; nobody waits for them.
    fn grow(&mut self, wanted: Reservation) -> Result<()> {
        self.renderer.grow(&wanted)?;
        // Only now: after an error the old one counts.
        self.reserved = wanted;
        Ok(())
    }

    /// Uploads a scene. Where memory cannot be mapped it waits for the queue, and for the frames in it.
    fn add(&mut self, gaussians: &Gaussians, pose: Pose) -> Result<()> {
        let scene = DeviceScene::upload(self.renderer.context(), gaussians, 0)?;
        let all = scene.count() + self.scenes.iter().map(|(scene, _)| scene.count()).sum::<u32>();
        let reserved = self.reserved;
        let scenes = reserved.scenes.max(self.scenes.len() as u32 + 1);
        self.grow(Reservation { gaussians: all.max(reserved.gaussians), scenes, ..reserved })?;
        self.scenes.push((scene, pose));
        Ok(())
    }

    /// Slots in flight keep the scene alive until they are released.
    fn remove(&mut self, index: usize) {
        self.scenes.remove(index);
    }

    /// After a resize of the window: the engine has made and adopted new images, both of one size. It destroys the old ones once
    /// every slot that was recorded with them has been through [`Guest::finish`]. After an error the old ones stay in use.
    fn resize(&mut self, images: [Image; 2]) -> Result<()> {
        let [width, height] = images[0].size();
        self.grow(Reservation { width, height, ..self.reserved })?;
        self.images = images;
        Ok(())
    }

    /// Before a slot is recorded again, and at the end: after the fence of its last frame. A slot without a frame may be
    /// given, too. A frame that is never submitted is discarded first: `renderer.slot_recording(slot)?.discard()`.
    fn finish(&mut self, slot: u32) -> Result<()> {
        let report = self.renderer.slot_report(slot)?;
        self.renderer.release_slot(slot)?;
        match report.filter(|report| report.overflow) {
            Some(report) => self.grow(self.reserved.grown(&report)),
            None => Ok(()),
        }
    }

    /// Records the splats over what the engine has drawn. `drawn` says how it has used its images last; the release says how
    /// they are left, and what to wait for. None without scenes: nothing is recorded then.
    fn draw(
        &mut self,
        commands: vk::CommandBuffer,
        slot: u32,
        view: &HostView,
        drawn: [ImageState; 2],
    ) -> Result<Option<Release>> {
        if self.scenes.is_empty() {
            return Ok(None);
        }
        let (camera, mapping) = view.camera()?;
        let scenes: Vec<Placed> = self.scenes.iter().map(|(scene, pose)| Placed::at(scene, *pose)).collect();
        let used = |i: usize| HostImage { image: &self.images[i], from: drawn[i], offset: [0; 2] };
        let settings = RenderSettings::default();
        let frame = RecordedFrame {
            // The engine lights in linear light.
            target: Target::Image {
                to: used(0),
                behind: Background::Image,
                encoding: ColorEncoding::LINEAR,
            },
            occluder: Some(Occluder { depth: used(1), mapping }),
            ..RecordedFrame::new(&scenes, &camera, &settings)
        };
        // SAFETY: it is being recorded, outside of a render pass. It is submitted once, and its fence waited for before the
        // slot is recorded again.
        let commands = unsafe { self.renderer.context().adopt_commands(commands)? };
        self.renderer.record(commands, slot, &frame).map(Some)
    }
}
