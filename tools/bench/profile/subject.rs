//! The subject of a profile, which is run repeatedly: a frame or a training step.

use super::{Arguments, What};
use crate::frames;
use crate::measure::{Iteration, Measured};
use crate::workload::Scene;
use ashsplat::vk::{Context, Profile};
use ashsplat::{RenderSettings, Renderer, Result, Trainer};
use std::time::Instant;

/// A frame or a step on a device.
pub struct Subject<'a> {
    context: &'a Context,
    scene: &'a Scene,
    work: Work,
    profile: Profile,
}

enum Work {
    Frame(Box<Renderer>),
    Step(Box<Trainer>),
}

impl<'a> Subject<'a> {
    /// Builds the kernels and loads the scene.
    pub fn new(context: &'a Context, scene: &'a Scene, arguments: &Arguments) -> Result<Self> {
        let form = arguments.form.get();
        let work = match arguments.what() {
            What::Render => Work::Frame(Box::new(frames::renderer(context, scene, form)?)),
            What::TrainStep => Work::Step(Box::new(frames::trainer(context, scene, form, arguments.seed())?)),
        };
        let profile = context.profile();
        context.set_profile(None);
        Ok(Self { context, scene, work, profile })
    }

    fn iterate(&mut self) -> Result<()> {
        match &mut self.work {
            Work::Frame(renderer) => {
                renderer.render(&self.scene.camera, &RenderSettings::default()).map(drop)
            }
            Work::Step(trainer) => trainer.step().map(drop),
        }
    }

    /// Runs unmeasured iterations, in which buffers grow and caches fill.
    pub fn warm_up(&mut self, iterations: u32) -> Result<()> {
        (0..iterations).try_for_each(|_| self.iterate())
    }

    /// Runs one iteration between the marks of a capture.
    pub fn captured(&mut self) -> Result<()> {
        let context = self.context;
        context.capture(|| self.iterate())
    }

    /// Runs one timed iteration.
    pub fn timed(&mut self) -> Result<Iteration> {
        self.context.set_profile(Some(&self.profile));
        let begun = Instant::now();
        self.iterate()?;
        let wall = begun.elapsed();
        self.context.set_profile(None);
        Ok(Iteration { begun, wall, submissions: self.profile.take() })
    }

    /// The picture of the scene in its current state.
    pub fn picture(&mut self) -> Result<Vec<[f32; 3]>> {
        let settings = RenderSettings::default();
        let frame = match &mut self.work {
            Work::Frame(renderer) => renderer.render(&self.scene.camera, &settings)?,
            Work::Step(trainer) => trainer.render(&self.scene.camera, &settings)?,
        };
        Ok(frame.color)
    }
}

/// Wraps iterations that were timed elsewhere.
pub fn measured(iterations: Vec<Iteration>) -> Measured {
    Measured { iterations, untimed_ms: None, cpu_seconds: None, cost: None }
}

/// Largest difference of any channel of any pixel; NaN counts as infinite.
pub fn largest_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    let differences = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| {
        let difference = (a - b).abs();
        if difference.is_nan() { f32::INFINITY } else { difference }
    });
    differences.fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::largest_difference;

    #[test]
    fn pictures_are_compared_by_their_worst_channel() {
        let a = [[0.0, 0.5, 1.0], [0.2, 0.2, 0.2]];
        assert_eq!(largest_difference(&a, &a), 0.0);
        assert_eq!(largest_difference(&a, &[[0.0, 0.5, 1.0], [0.2, 0.7, 0.2]]), 0.5);
        assert_eq!(largest_difference(&a, &[[0.0, f32::NAN, 1.0], [0.2; 3]]), f32::INFINITY);
    }
}
