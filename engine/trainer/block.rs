//! Training of a block of a scene: some Gaussians are trained, those around are drawn as they are.
//!
//! Frames have both, so that pictures are whole and photographs need no mask. What lies around has parameters on the device and
//! nothing else: no moments, no statistics, no spare set.

use super::Trainer;
use super::model::RowMemory;
use super::settings::TrainSettings;
use super::strategy::Strategy;
use super::work::Actions;
use crate::densify::MaskOutside;
use crate::error::{Error, Result};
use crate::fingerprint::Fingerprint;
use crate::forward::{Filter3d, SceneBuffers};
use crate::planes;
use crate::renderer::DeviceScene;
use crate::scene::{Bounds, Gaussians};
use crate::vk::Context;
use glam::Vec3;

/// A block of a scene, and what lies around it.
///
/// Every Gaussian that a trainer begins with is trained, in the core or not; those that are cloned or split lie in the core at
/// that time. (The halves of one near its border may come to lie beyond it, and means move as in any training.)
#[derive(Clone, Debug, PartialEq)]
pub struct SceneBlock {
    /// Where density control adds Gaussians, world units. Sides may be infinite.
    pub core: Bounds,
    /// Gaussians that are drawn and stay as they are; there may be none. Degrees of SH above [`TrainSettings::sh_degree`] are
    /// left out.
    pub frozen: Gaussians,
}

impl SceneBlock {
    /// Divides a scene: the Gaussians with means in the core grown by `margin` on all sides, which are to be trained, and the
    /// block with all others. Both keep their order. `margin` is in world units.
    ///
    /// # Errors
    /// [`Error::Argument`] for a core without volume or with sides that are no numbers, a margin that is negative or no number,
    /// and where no Gaussian is to be trained.
    pub fn divide(scene: &Gaussians, core: Bounds, margin: f32) -> Result<(Gaussians, Self)> {
        Self::check_box(core, margin)?;
        let inside = |&index: &usize| Self::contains(core, margin, scene.means[index]);
        let (trained, frozen): (Vec<usize>, Vec<usize>) = (0..scene.len()).partition(inside);
        if trained.is_empty() {
            return Err(Self::nothing_inside(scene.len()));
        }
        Ok((scene.select(&trained), Self { core, frozen: scene.select(&frozen) }))
    }

    /// Whether [`SceneBlock::divide`] trains a Gaussian with this mean.
    pub fn contains(core: Bounds, margin: f32, mean: [f32; 3]) -> bool {
        let mean = Vec3::from_array(mean);
        mean.cmpge(core.min - margin).all() && mean.cmple(core.max + margin).all()
    }

    /// Checks a core and a margin as [`SceneBlock::divide`] does.
    ///
    /// # Errors
    /// [`Error::Argument`] for a core without volume or with sides that are no numbers, and a margin that is negative or no
    /// number.
    pub fn check_box(core: Bounds, margin: f32) -> Result<()> {
        // False for what is no number.
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

    /// The error of a block in which there is nothing to train.
    pub fn nothing_inside(of: usize) -> Error {
        let problem =
            format!("has none of the {of} Gaussians of the start in it; give another box or margin");
        Error::argument("block", problem)
    }

    /// What a checkpoint says of it; None if it is the whole scene.
    pub(super) fn state(&self) -> Option<BlockState> {
        let whole = self.frozen.is_empty() && is_everything(self.core);
        (!whole).then(|| BlockState {
            core: [self.core.min.to_array(), self.core.max.to_array()],
            frozen: self.frozen.len() as u64,
            fingerprint: fingerprint_of(&self.frozen),
        })
    }
}

/// The block of a checkpoint: see [`SceneBlock`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockState {
    /// The core's corners, world units.
    pub core: [[f32; 3]; 2],
    /// Number of the Gaussians around.
    pub frozen: u64,
    /// Their hash.
    pub fingerprint: u64,
}

impl BlockState {
    /// What differs between the block of a checkpoint and the one of a run; None if nothing does.
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

/// A block as training keeps it.
pub(super) struct Block {
    /// For the checkpoint.
    pub state: BlockState,
    /// None without borders.
    mask: Option<MaskOutside>,
    /// None where nothing lies around.
    around: Option<SceneBuffers>,
}

impl Block {
    /// Refuses what blocks do not go together with.
    pub fn check(settings: &TrainSettings, strategy: &dyn Strategy, of: Option<&SceneBlock>) -> Result<()> {
        let Some(block) = of else { return Ok(()) };
        SceneBlock::check_box(block.core, 0.0)?;
        block.frozen.check_shapes()?;
        check_settings(settings, strategy, !is_everything(block.core), !block.frozen.is_empty())
    }

    /// Uploads what lies around. None of a block that is the whole scene.
    pub fn new(
        context: &Context,
        block: Option<SceneBlock>,
        (rows, sh_degree): (&RowMemory, u32),
        filter: Option<&Filter3d>,
    ) -> Result<Option<Self>> {
        let Some((block, state)) = block.and_then(|block| block.state().map(|state| (block, state))) else {
            return Ok(None);
        };
        let absolute = rows.absolute().is_some();
        let bordered = !is_everything(block.core);
        let mask = bordered.then(|| MaskOutside::new(context, block.core, absolute)).transpose()?;
        let around = match block.frozen.len() {
            0 => None,
            _ => Some(planes::upload(context, "surroundings", &block.frozen, 0, sh_degree)?),
        };
        // They do not move: once is enough.
        filter.zip(around.as_ref()).map_or(Ok(()), |(filter, around)| filter.run(context, around))?;
        Ok(Some(Self { state, mask, around }))
    }

    /// What is drawn with every frame.
    pub fn around(&self) -> Option<&SceneBuffers> {
        self.around.as_ref()
    }
}

/// As [`Block::check`]. `bordered`: density control has a border; `frozen`: something lies around, so that it should have one.
pub(super) fn check_settings(
    settings: &TrainSettings,
    strategy: &dyn Strategy,
    bordered: bool,
    frozen: bool,
) -> Result<()> {
    if (bordered || frozen) && !strategy.grows_by_statistics() {
        let problem = format!(
            "the strategy '{}' adds Gaussians anywhere; take one that goes by gradients, or fixed",
            strategy.name()
        );
        return Err(Error::argument("block", problem));
    }
    if frozen && settings.pose_opt {
        let problem = "does not go together with a block of a scene: optimise the poses with the whole of it";
        return Err(Error::argument("pose_opt", problem));
    }
    Ok(())
}

fn is_everything(core: Bounds) -> bool {
    core.min == Vec3::NEG_INFINITY && core.max == Vec3::INFINITY
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

impl Trainer {
    /// The Gaussians around the [block](SceneBlock), which every picture of this trainer has; None if there are none. In
    /// [`Trainer::inspect`] they have the indices behind those that are trained.
    pub fn surroundings(&self) -> Option<DeviceScene> {
        let around = self.block.as_ref()?.around()?;
        Some(DeviceScene::of(&self.context, around.clone()))
    }

    /// Before a densification: hides the statistics of Gaussians outside of the core from it.
    pub(super) fn mask_outside(&self, action: Actions) -> Result<()> {
        let mask = self.block.as_ref().and_then(|block| block.mask.as_ref());
        let Some(mask) = mask.filter(|_| action == Actions::DENSIFY) else { return Ok(()) };
        let model = &self.state.model;
        let absolute = self.rows.absolute().map(|place| &model.statistics[place]);
        self.context.run("mask statistics", |r| {
            mask.record(r, &model.scene, &model.statistics[0], absolute);
            Ok(())
        })?;
        Ok(())
    }
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
        let differs = |here| BlockState::difference(Some(&state), here).unwrap_or_default();
        assert_eq!(differs(Some(&state)), "");
        assert!(differs(None).contains("-1,-1,-1,1,1,1"));
        assert!(differs(Some(&BlockState { core: [[-2.0; 3], [1.0; 3]], ..state })).contains("-2,-2,-2,1"));
        assert!(differs(Some(&BlockState { fingerprint: 4, ..state })).contains("7 other Gaussians"));
        assert!(BlockState::difference(None, Some(&state)).is_some());
        assert!(BlockState::difference(None, None).is_none());
    }
}
