//! Optimised poses of training views: their files and a summary.

use super::{Run, refined};
use ashsplat::Result;
use ashsplat::scene::{Camera, PhotoLens, Twist};
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_program::config::CAMERAS_FILE;
use ashsplat_program::{eval, output};
use glam::DVec2;
use serde_json::{Map, json};
use std::collections::HashMap;

/// Folder of the cameras as data sets that other programs read.
pub const REFINED_FOLDER: &str = "refined";

/// File with the movement of each training view's camera.
pub const POSES_FILE: &str = "poses.json";

/// Movement of cameras: mean and largest, in degrees and as shares of the scene's extent.
pub struct PoseMovement {
    pub degrees: [f64; 2],
    pub shares: [f64; 2],
}

impl PoseMovement {
    fn of(changes: &[Twist], scene_extent: f32) -> PoseMovement {
        let mean_and_max = |values: &mut dyn Iterator<Item = f64>| -> [f64; 2] {
            let (mut sum, mut max) = (0.0, 0.0_f64);
            for value in values {
                sum += value;
                max = max.max(value);
            }
            [sum / changes.len().max(1) as f64, max]
        };
        PoseMovement {
            degrees: mean_and_max(&mut changes.iter().map(|change| change.omega.length().to_degrees())),
            shares: mean_and_max(
                &mut changes.iter().map(|change| change.exp().1.length() / f64::from(scene_extent)),
            ),
        }
    }

    pub fn describe(&self) -> String {
        let ([degrees, max_degrees], [share, max_share]) = (self.degrees, self.shares);
        format!(
            "poses turned by {degrees:.3} degrees on average, at most {max_degrees:.3}; moved by {:.3} % of the scene's \
             extent, at most {:.3} %",
            100.0 * share,
            100.0 * max_share
        )
    }
}

impl Run {
    /// Returns `None` unless poses are optimised.
    pub(super) fn pose_movement(&self) -> Result<Option<PoseMovement>> {
        match self.settings.train.pose_opt {
            false => Ok(None),
            true => Ok(Some(PoseMovement::of(&self.trainer.pose_changes()?, self.trainer.scene_extent()))),
        }
    }

    /// Describes how far the lenses moved. None unless they are optimised.
    pub(super) fn describe_lenses(&self) -> Option<String> {
        self.settings.train.lens_opt.then(|| {
            let [mut focal, mut moved] = [0.0_f64; 2];
            let mut given: Vec<PhotoLens> = Vec::new();
            for camera in &self.views.used {
                let lens = camera.photo_lens();
                if given.contains(&lens) {
                    continue;
                }
                given.push(lens);
                let now = self.trainer.with_trained_lens(camera).photo_lens();
                focal = focal.max((now.focal_px / lens.focal_px - 1.0).abs().max_element());
                let ray = lens.rays();
                let [width, height] = [camera.width, camera.height].map(f64::from);
                for place in [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]].map(DVec2::from) {
                    let there = ray(place).and_then(|ray| now.position(ray));
                    moved = moved.max(there.map_or(0.0, |there| there.distance(place)));
                }
            }
            format!(
                "{} {}: focal lengths changed by {:.3} % at most, the pictures' corners moved by {moved:.2} px at most{}",
                given.len(),
                if given.len() == 1 { "lens" } else { "lenses" },
                100.0 * focal,
                match self.trainer.refused_lens_steps() {
                    0 => String::new(),
                    refused => format!("; {refused} steps would have folded the picture and were not made: lower --lens-opt-lr"),
                }
            )
        })
    }

    /// All cameras at the size of their photos' files, with their current lenses, and training views at their current poses.
    fn cameras_now(&self) -> Result<Vec<NamedCamera>> {
        let moved = self.trainer.cameras()?;
        // With --train-test-exp, held-out views are also trained on, so only names identify the views.
        let moved: HashMap<&str, &Camera> =
            self.views.trained.iter().map(String::as_str).zip(&moved).collect();
        let now = |((name, camera), used): (&(String, Camera), &Camera)| {
            let mut camera = eval::with_changed_lens(camera, used, &self.trainer.with_trained_lens(used));
            if let Some(at) = moved.get(name.as_str()) {
                camera.camera_from_world = at.camera_from_world;
                camera.translation = at.translation;
            }
            NamedCamera { name: name.clone(), camera }
        };
        Ok(self.views.cameras.iter().zip(&self.views.used).map(now).collect())
    }

    /// Writes the cameras after an iteration, if their poses or lenses are optimised.
    pub(super) fn save_poses(&self, iteration: u32) -> Result<()> {
        let train = &self.settings.train;
        if !(train.pose_opt || train.lens_opt) {
            return Ok(());
        }
        let folder = &self.settings.data.model_path;
        let cameras = self.cameras_now()?;
        cameras_json::write(
            folder.join(CAMERAS_FILE),
            cameras.iter().map(|named| (named.name.as_str(), &named.camera)),
            &self.views.frame,
        )?;
        // Undistorted photographs are in no folder.
        if !self.settings.data.undistort {
            let dataset = &self.settings.data.source_path;
            let refined = folder.join(REFINED_FOLDER);
            for name in refined::write(&refined, dataset, &cameras, &self.views.frame)? {
                self.progress.warn(&format!(
                    "warning: {}: not written, because it cannot hold a camera's lens or rolling shutter; {} has them",
                    refined.join(name).display(),
                    folder.join(CAMERAS_FILE).display()
                ));
            }
        }
        if !train.pose_opt {
            return Ok(());
        }
        let changes = self.trainer.pose_changes()?;
        let PoseMovement { degrees, shares } = PoseMovement::of(&changes, self.trainer.scene_extent());
        let poses: Map<_, _> = (self.views.trained.iter().zip(&changes))
            .map(|(name, change)| {
                let Twist { nu, omega } = *change;
                (name.clone(), json!(Twist { nu: self.views.frame.unit * nu, omega }.to_array()))
            })
            .collect();
        let summary = json!({
            "iteration": iteration,
            "about": "exp(xi^) T: xi = (nu, omega) in the camera's frame (x right, y down, z forward), the data \
                      set's units and radians; T to the camera as given",
            "scene_extent": (self.views.frame.unit * f64::from(self.trainer.scene_extent())) as f32,
            "degrees": { "mean": degrees[0], "largest": degrees[1] },
            "share_of_extent": { "mean": shares[0], "largest": shares[1] },
            "xi": poses,
        });
        output::write_json(&folder.join(POSES_FILE), &summary)
    }

    /// Moves test views that are trained on to the current poses of their cameras: those that replace held-out ones,
    /// and held-out ones whose halves are trained on. Their lenses stay as given: see [`Trainer::with_trained_lens`].
    ///
    /// [`Trainer::with_trained_lens`]: ashsplat::Trainer::with_trained_lens
    pub(super) fn follow_cameras(&mut self) -> Result<()> {
        let trained_on = !self.views.held_out || self.settings.data.train_test_exp;
        if !(self.settings.train.pose_opt && trained_on) {
            return Ok(());
        }
        let cameras = eval::by_name(self.cameras_now()?);
        for view in &mut self.views.test {
            if let Some(at) = cameras.get(&view.name) {
                view.camera.camera_from_world = at.camera_from_world;
                view.camera.translation = at.translation;
            }
        }
        self.tracking.follow(&self.views.test);
        Ok(())
    }
}
