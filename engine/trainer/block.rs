//! A block of a scene: its trained core and the frozen Gaussians around it.

use super::settings::TrainSettings;
use super::unseen;
use crate::error::{Error, Result};
use crate::fingerprint::Fingerprint;
use crate::scene::{Bounds, Camera, Gaussians};
use glam::Vec3;

/// A block of a scene, with the frozen Gaussians around it.
///
/// All initial Gaussians are trained, also those outside the core. Only Gaussians in the core are cloned or split. Their halves
/// and later movement can cross its border.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneBlock {
    /// Box in which density control adds Gaussians, world units. Sides may be infinite.
    pub core: Bounds,
    /// Gaussians that are drawn but not trained; may be empty. SH coefficients above the settings' degree are dropped.
    pub frozen: Gaussians,
    /// Count and hash of all surroundings before [`SceneBlock::without_unseen`] dropped some. Checkpoints are compared by
    /// these.
    pub chosen_from: Option<Surroundings>,
}

/// Count and hash of the Gaussians around a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Surroundings {
    /// Number of Gaussians.
    pub count: u64,
    /// Hash of the Gaussians.
    pub fingerprint: u64,
}

impl SceneBlock {
    /// Divides a scene into the Gaussians to train and a block with all others. Trained are the means in the core, grown by
    /// `margin` (world units) on all sides. Both parts keep their order.
    ///
    /// # Errors
    /// [`Error::Argument`] if the core has no volume or a NaN side, if the margin is negative or not finite, or if no Gaussian
    /// is to be trained.
    pub fn divide(scene: &Gaussians, core: Bounds, margin: f32) -> Result<(Gaussians, Self)> {
        Self::check_box(core, margin)?;
        let inside = |&index: &usize| Self::contains(core, margin, scene.means[index]);
        let (trained, frozen): (Vec<usize>, Vec<usize>) = (0..scene.len()).partition(inside);
        if trained.is_empty() {
            return Err(Self::nothing_inside(scene.len()));
        }
        let frozen = scene.select(&frozen);
        Ok((scene.select(&trained), Self { core, frozen, chosen_from: None }))
    }

    /// True if [`SceneBlock::divide`] trains a Gaussian with this mean.
    pub fn contains(core: Bounds, margin: f32, mean: [f32; 3]) -> bool {
        let mean = Vec3::from_array(mean);
        mean.cmpge(core.min - margin).all() && mean.cmple(core.max + margin).all()
    }

    /// Drops the surroundings that no picture of these cameras can show, at any size at which a training with these settings
    /// draws them. The pictures keep their bits, and so does the training, with two exceptions.
    /// [Dropout](TrainSettings::dropout) draws its random numbers by row, and growth that memory limits gets more of it. A
    /// checkpoint of either block can be resumed with the other. With [the 3D filter](TrainSettings::filter_3d) nothing is
    /// dropped, because its sizes depend on all surroundings.
    #[must_use]
    pub fn without_unseen(self, cameras: &[Camera], settings: &TrainSettings) -> Self {
        if settings.filter_3d {
            return self;
        }
        let drawn: Vec<Camera> = cameras.iter().flat_map(|camera| settings.sizes_of_camera(camera)).collect();
        let seen = unseen::seen(&self.frozen, &drawn, settings.kernel_size);
        let rows: Vec<usize> = (0..seen.len()).filter(|&row| seen[row]).collect();
        if rows.len() == seen.len() {
            return self;
        }
        let chosen_from = Some(self.surroundings());
        Self { frozen: self.frozen.select(&rows), chosen_from, ..self }
    }

    /// Count and hash of all surroundings, drawn or dropped.
    pub fn surroundings(&self) -> Surroundings {
        let all =
            || Surroundings { count: self.frozen.len() as u64, fingerprint: fingerprint_of(&self.frozen) };
        self.chosen_from.unwrap_or_else(all)
    }

    /// True if the core has no border.
    pub fn is_everything(core: Bounds) -> bool {
        core.min == Vec3::NEG_INFINITY && core.max == Vec3::INFINITY
    }

    /// Checks a core and a margin as [`SceneBlock::divide`] does.
    ///
    /// # Errors
    /// [`Error::Argument`] if the core has no volume or a NaN side, or if the margin is negative or not finite.
    pub fn check_box(core: Bounds, margin: f32) -> Result<()> {
        // False for NaN.
        if !core.min.cmplt(core.max).all() {
            let problem =
                format!("from {} to {}: each least side must be below the greatest", core.min, core.max);
            return Err(Error::argument("block", problem));
        }
        if !(margin.is_finite() && margin >= 0.0) {
            return Err(Error::argument("margin", format!("is {margin}, must be 0 or more")));
        }
        Ok(())
    }

    /// Error for a block without a Gaussian to train.
    pub fn nothing_inside(of: usize) -> Error {
        let problem =
            format!("has none of the {of} Gaussians of the start in it; give another box or margin");
        Error::argument("block", problem)
    }

    /// Block of a checkpoint; None if it is the whole scene.
    pub(super) fn state(&self) -> Option<BlockState> {
        let Surroundings { count, fingerprint } = self.surroundings();
        let whole = count == 0 && Self::is_everything(self.core);
        let core = [self.core.min.to_array(), self.core.max.to_array()];
        (!whole).then_some(BlockState { core, frozen: count, fingerprint })
    }
}

/// Block of a checkpoint: see [`SceneBlock`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockState {
    /// The core's corners, world units.
    pub core: [[f32; 3]; 2],
    /// Number of frozen Gaussians around the core.
    pub frozen: u64,
    /// Hash of the frozen Gaussians.
    pub fingerprint: u64,
}

impl BlockState {
    /// Difference between the block of a checkpoint and that of a run; None if they are equal.
    pub(super) fn difference(there: Option<&Self>, here: Option<&Self>) -> Option<String> {
        let sides = |core: &[[f32; 3]; 2]| {
            let all: Vec<String> = core.as_flattened().iter().map(f32::to_string).collect();
            all.join(",")
        };
        match (there, here) {
            (None, None) => None,
            (Some(there), None) => Some(format!(
                "was made for the block {}, here the whole scene is trained",
                sides(&there.core)
            )),
            (None, Some(here)) => {
                Some(format!("was made for a whole scene, here the block {} is trained", sides(&here.core)))
            }
            (Some(there), Some(here)) if there.core != here.core => Some(format!(
                "was made for the block {}, here it is {}",
                sides(&there.core),
                sides(&here.core)
            )),
            (Some(there), Some(here)) if there != here => Some(format!(
                "was made among {} other Gaussians around the block, here are {} (of another scene or margin)",
                there.frozen, here.frozen
            )),
            _ => None,
        }
    }
}

fn fingerprint_of(gaussians: &Gaussians) -> u64 {
    let mut print = Fingerprint::new();
    print.add(bytemuck::cast_slice(&gaussians.means));
    print.add(bytemuck::cast_slice(&gaussians.quats));
    print.add(bytemuck::cast_slice(&gaussians.log_scales));
    print.add(bytemuck::cast_slice(&gaussians.opacity_logits));
    print.add(bytemuck::cast_slice(&gaussians.sh));
    print.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(xs: &[f32]) -> Gaussians {
        let count = xs.len();
        Gaussians {
            sh_degree: 0,
            means: xs.iter().map(|&x| [x, 0.0, 0.0]).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
            log_scales: vec![[0.0; 3]; count],
            opacity_logits: xs.to_vec(),
            sh: vec![[0.0; 3]; count],
        }
    }

    fn bounds(min: f32, max: f32) -> Bounds {
        Bounds { min: Vec3::splat(min), max: Vec3::splat(max) }
    }

    #[test]
    fn a_scene_is_divided_at_the_margin() -> Result<()> {
        let whole = scene(&[-3.0, 0.5, -1.5, 1.0, 9.0]);
        let (trained, block) = SceneBlock::divide(&whole, bounds(-1.0, 1.0), 0.5)?;
        assert_eq!(trained.opacity_logits, [0.5, -1.5, 1.0]);
        assert_eq!(block.frozen.opacity_logits, [-3.0, 9.0]);
        let state = block.state();
        assert_eq!(state.map(|state| state.frozen), Some(2));
        let (all, rest) = SceneBlock::divide(&whole, bounds(f32::NEG_INFINITY, f32::INFINITY), 2.0)?;
        assert!(all == whole && rest.frozen.is_empty() && rest.state().is_none());
        // A border counts even if nothing lies beyond it yet.
        assert!(SceneBlock::divide(&whole, bounds(-99.0, 99.0), 0.0)?.1.state().is_some());
        Ok(())
    }

    #[test]
    fn senseless_boxes_are_refused() {
        let whole = scene(&[0.0]);
        for (core, margin) in [
            (bounds(1.0, -1.0), 0.0),
            (bounds(0.0, 0.0), 0.0),
            (bounds(f32::NAN, 1.0), 0.0),
            (bounds(-1.0, 1.0), -0.1),
            (bounds(-1.0, 1.0), f32::NAN),
            (bounds(-1.0, 1.0), f32::INFINITY),
            (bounds(3.0, 4.0), 1.0),
        ] {
            assert!(SceneBlock::divide(&whole, core, margin).is_err(), "{core:?} {margin}");
        }
    }

    #[test]
    fn what_differs_is_named() {
        let state = BlockState { core: [[-1.0; 3], [1.0; 3]], frozen: 7, fingerprint: 3 };
        let differs =
            |here: Option<&BlockState>| BlockState::difference(Some(&state), here).unwrap_or_default();
        assert_eq!(differs(Some(&state)), "");
        assert!(differs(None).contains("-1,-1,-1,1,1,1"));
        assert!(differs(Some(&BlockState { core: [[-2.0; 3], [1.0; 3]], ..state })).contains("-2,-2,-2,1"));
        assert!(differs(Some(&BlockState { fingerprint: 4, ..state })).contains("7 other Gaussians"));
        assert!(BlockState::difference(None, Some(&state)).is_some());
        assert!(BlockState::difference(None, None).is_none());
    }
}
