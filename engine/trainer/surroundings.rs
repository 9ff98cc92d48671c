//! Training of a block of a scene, whose surroundings are frozen.
//!
//! Frames show both, so that pictures are whole and photographs need no mask. Frozen Gaussians only have parameters on the
//! device: no moments, no statistics, no spare set.

use super::Trainer;
use super::block::{BlockState, SceneBlock};
use super::model::RowMemory;
use super::settings::TrainSettings;
use super::strategy::Strategy;
use super::work::Actions;
use crate::densify::MaskOutside;
use crate::error::{Error, Result};
use crate::forward::{Filter3d, SceneBuffers};
use crate::planes;
use crate::renderer::DeviceScene;
use crate::vk::Context;

/// A block on the device.
pub(super) struct Block {
    /// State for the checkpoint.
    pub state: BlockState,
    /// None if the core has no border.
    mask: Option<MaskOutside>,
    /// Frozen Gaussians; None if there are none.
    around: Option<SceneBuffers>,
}

impl Block {
    /// Refuses settings and strategies that exclude blocks.
    pub fn check(settings: &TrainSettings, strategy: &dyn Strategy, of: Option<&SceneBlock>) -> Result<()> {
        let Some(block) = of else { return Ok(()) };
        SceneBlock::check_box(block.core, 0.0)?;
        block.frozen.check_shapes()?;
        // Cameras that move may begin to see dropped Gaussians.
        let frozen = block.surroundings().count > 0;
        check_settings(settings, strategy, !SceneBlock::is_everything(block.core), frozen)
    }

    /// Uploads the frozen Gaussians. None if the block is the whole scene.
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
        let bordered = !SceneBlock::is_everything(block.core);
        let mask = bordered.then(|| MaskOutside::new(context, block.core, absolute)).transpose()?;
        let around = match block.frozen.len() {
            0 => None,
            _ => Some(planes::upload(context, ("surroundings", rows.planes()), &block.frozen, 0, sh_degree)?),
        };
        // Frozen Gaussians do not move, so once is enough.
        filter.zip(around.as_ref()).map_or(Ok(()), |(filter, around)| filter.run(context, around))?;
        Ok(Some(Self { state, mask, around }))
    }

    /// Frozen Gaussians, drawn with every frame.
    pub fn around(&self) -> Option<&SceneBuffers> {
        self.around.as_ref()
    }
}

/// Same as [`Block::check`]. `bordered`: density control has a border; `frozen`: there are frozen Gaussians.
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

impl Trainer {
    /// Frozen Gaussians around the [block](SceneBlock), which every picture of this trainer shows; None if there are none. In
    /// [`Trainer::inspect`] their indices follow those of the trained Gaussians.
    pub fn surroundings(&self) -> Option<DeviceScene> {
        let around = self.block.as_ref()?.around()?;
        Some(DeviceScene::of(&self.context, around.clone()))
    }

    /// Hides the statistics of Gaussians outside the core from a densification.
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
