//! Cameras of the training views, and alignment of other cameras to the scene.

use super::Trainer;
use crate::error::{Error, Result};
use crate::forward::RenderSettings;
use crate::renderer::{AlignRequest, Aligner, Alignment};
use crate::scene::{Camera, StoredPhoto, Twist};

impl Trainer {
    /// Current cameras of the training views, in the views' order. [`pose_opt`](super::TrainSettings::pose_opt) moves them away
    /// from the given ones.
    ///
    /// # Errors
    /// [`Error::Argument`] while recorded steps are in flight, and after a step with an unknown
    /// outcome; when the device is lost.
    pub fn cameras(&self) -> Result<Vec<Camera>> {
        self.check_readable()?;
        match &self.poses {
            None => Ok(self.run.cameras.clone()),
            Some(poses) => poses.moved(&self.context, &self.run.cameras),
        }
    }

    /// Total movement of each training view's camera, in the views' order; 0 without
    /// [`pose_opt`](super::TrainSettings::pose_opt).
    ///
    /// # Errors
    /// Same as [`Trainer::cameras`].
    pub fn pose_changes(&self) -> Result<Vec<Twist>> {
        self.check_readable()?;
        let Some(poses) = &self.poses else { return Ok(vec![Twist::default(); self.run.cameras.len()]) };
        let parameters = poses.state(&self.context)?.parameters;
        Ok(parameters.iter().map(|xi| Twist::from_array(xi.map(f64::from))).collect())
    }

    /// Extent of the scene as given to training, world units.
    pub fn scene_extent(&self) -> f32 {
        self.run.scene_extent
    }

    /// Same as [`Renderer::align`](crate::Renderer::align), with the current scene. If `settings.sh_degree` is None, it uses
    /// the SH degree of this iteration. The result of training does not depend on alignments.
    ///
    /// # Errors
    /// Same as [`Renderer::align`](crate::Renderer::align) and [`Trainer::render`]; [`Error::Argument`] if a
    /// [block](super::SceneBlock) has frozen Gaussians.
    pub fn align(
        &mut self,
        camera: &Camera,
        photo: &StoredPhoto,
        settings: &RenderSettings,
        alignment: &Alignment,
    ) -> Result<Camera> {
        if self.runner.around() > 0 {
            let problem = "cameras are aligned to whole scenes, and this is a block of one";
            return Err(Error::argument("trainer", problem));
        }
        let settings = self.at_present_degree(settings);
        let mut aligner = match self.aligner.take() {
            Some(aligner) => aligner,
            None => Aligner::new(&self.context)?,
        };
        let aligned = self.drawing(|runner, scene| {
            let sh_degree = scene.active_degree(&settings);
            let request = AlignRequest { scene, camera, photo, settings: &settings, sh_degree, alignment };
            aligner.align(runner, &request)
        });
        self.aligner = Some(aligner);
        aligned
    }
}
