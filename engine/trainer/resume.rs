//! Conversion of a trainer to a [`Checkpoint`], and back.

use super::checkpoint::{Checkpoint, Room, Wanted};
use super::settings::TrainSettings;
use super::step::{Due, Progress};
use super::{TrainView, Trainer};
use crate::error::Result;
use crate::fingerprint::Fingerprint;
use crate::forward::SceneBuffers;
use crate::plan::FrameCapacity;
use crate::planes;
use crate::scene::Camera;
use crate::vk::Buffer;

impl Trainer {
    /// Downloads the state that [`Trainer::resume`] needs.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] while recorded steps are in flight, and after a step with an unknown
    /// outcome; when the device is lost.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        self.check_readable()?;
        let (training, progress) = (&self.training, &self.progress);
        let planes_of = |chunks: &[Buffer]| {
            planes::download(
                &self.context,
                &SceneBuffers { chunks: chunks.to_vec(), ..training.scene.clone() },
            )
        };
        let count = u64::from(training.scene.count);
        let statistics = match count {
            0 => Vec::new(),
            _ => {
                let bytes = self.context.download(&training.statistics.range(0, count * 8))?;
                bytemuck::pod_collect_to_vec(&bytes)
            }
        };
        Ok(Checkpoint {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            device: self.context.device_name().to_owned(),
            driver: self.context.description().driver.clone(),
            settings: self.settings.clone(),
            views: self.cameras.len() as u64,
            views_fingerprint: self.views_fingerprint,
            scene_extent: self.scene_extent,
            iteration: progress.iteration,
            optimizer_steps: progress.steps,
            opacity_steps: progress.opacity_steps,
            densification_due: progress.due.densifies,
            opacity_reset_due: progress.due.resets,
            gaussians: self.gaussians()?,
            first_moments: planes_of(&training.moments.first)?,
            second_moments: planes_of(&training.moments.second)?,
            statistics,
            skipped: self.skipped,
            room: self.room(),
        })
    }

    /// A trainer that continues from a checkpoint as if it had never stopped: the same views in the same
    /// order, and the same settings except for the number of iterations, which must not be reached yet. With
    /// another version, device or driver the bits differ: see [`Checkpoint::differences`].
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming what differs; as [`Trainer::new`].
    pub fn resume(
        context: &crate::vk::Context,
        views: Vec<TrainView>,
        scene_extent: f32,
        settings: TrainSettings,
        from: &Checkpoint,
    ) -> Result<Self> {
        from.check_shapes()?;
        from.check_fits(&Wanted {
            settings: &settings,
            views: views.len() as u64,
            views_fingerprint: fingerprint_of(&views),
            scene_extent,
        })?;
        let room = Some(&from.room);
        let mut trainer = Trainer::build(context, views, &from.gaussians, scene_extent, settings, room)?;
        trainer.progress = Progress {
            iteration: from.iteration,
            steps: from.optimizer_steps,
            opacity_steps: from.opacity_steps,
            due: Due { densifies: from.densification_due, resets: from.opacity_reset_due },
        };
        let training = &trainer.training;
        let moments = [
            (&training.moments.first, &from.first_moments),
            (&training.moments.second, &from.second_moments),
        ];
        for (chunks, values) in moments {
            planes::fill(
                context,
                &SceneBuffers { chunks: chunks.clone(), ..training.scene.clone() },
                values,
            )?;
        }
        context.upload(&training.statistics, bytemuck::cast_slice(&from.statistics))?;
        trainer.most_instances = from.room.most_instances;
        trainer.skipped = from.skipped;
        if from.iteration > 0 && from.iteration == from.settings.iterations {
            trainer.finish_last_iteration()?;
        }
        Ok(trainer)
    }
}

impl Trainer {
    fn room(&self) -> Room {
        let frame = self.runner.capacity();
        Room {
            gaussians: self.training.scene.plan.capacity,
            frame_gaussians: frame.gaussians,
            frame_instances: frame.instances,
            frame_width: frame.width,
            frame_height: frame.height,
            blend_passes: frame.blend_passes,
            backward: frame.backward.into(),
            most_instances: self.most_instances,
            max_memory: self.context.max_memory(),
        }
    }
}

impl Room {
    /// The capacity of a frame; None without a frame.
    pub(super) fn frame(&self) -> Option<FrameCapacity> {
        (self.frame_width > 0).then_some(FrameCapacity {
            gaussians: self.frame_gaussians,
            instances: self.frame_instances,
            scenes: 1,
            width: self.frame_width,
            height: self.frame_height,
            blend_passes: self.blend_passes.max(1),
            backward: self.backward != 0,
        })
    }
}

/// Identifies views, cameras and photographs in their order.
pub(super) fn fingerprint_of(views: &[TrainView]) -> u64 {
    let of_view = |view: &TrainView| {
        let Camera { camera_from_world, translation, fx, fy, cx, cy, width, height } = view.camera;
        let mut print = Fingerprint::new();
        print.add(bytemuck::cast_slice(&camera_from_world.to_cols_array()));
        print.add(bytemuck::cast_slice(&translation.to_array()));
        print.add(bytemuck::cast_slice(&[fx, fy, cx, cy]));
        print.add(bytemuck::cast_slice(&[width, height]));
        print.add(bytemuck::bytes_of(&view.photo.fingerprint()));
        print.finish()
    };
    // Photographs have many megabytes: each thread hashes a share of them.
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let share = views.len().div_ceil(threads).max(1);
    let mut each = vec![0; views.len()];
    std::thread::scope(|scope| {
        for (prints, views) in each.chunks_mut(share).zip(views.chunks(share)) {
            scope
                .spawn(move || prints.iter_mut().zip(views).for_each(|(print, view)| *print = of_view(view)));
        }
    });
    let mut all = Fingerprint::new();
    all.add(bytemuck::cast_slice(&each));
    all.finish()
}
