//! Settings of a block that is trained in place of the whole scene.

use super::{AutoSwitch, DataSettings, Outside};
use ashsplat::scene::{Bounds, WorldFrame};
use ashsplat::train::SceneBlock;
use ashsplat::{Error, Result};
use glam::DVec3;

impl DataSettings {
    /// The block's core and margin in the world coordinates of a frame; `None` for the whole scene.
    pub fn block(&self, frame: &WorldFrame) -> Result<Option<(Bounds, f32)>> {
        let [min, max] = match self.block[..] {
            [] if self.margin == 0.0 => return Ok(None),
            [] => return Err(Error::argument("margin", "is that of a block: give --block as well")),
            [a, b, c, x, y, z] => [DVec3::new(a, b, c), DVec3::new(x, y, z)],
            _ => return Err(Error::argument("block", "expected six numbers with commas between them")),
        };
        // Compared in double precision: single precision may not distinguish the sides of a box far from the origin.
        if !min.cmplt(max).all() {
            let problem = format!("from {min} to {max}: each least side must be below the greatest");
            return Err(Error::argument("block", problem));
        }
        let margin = (self.margin / frame.unit) as f32;
        if !(margin.is_finite() && margin >= 0.0) {
            return Err(Error::argument("margin", format!("is {}, must be 0 or more", self.margin)));
        }
        Ok(Some((Bounds { min: frame.world(min), max: frame.world(max) }, margin)))
    }

    /// The scene's extent in the world units of a frame; `of_cameras` unless a setting overrides it.
    pub fn extent(&self, of_cameras: f32, frame: &WorldFrame) -> f32 {
        if self.scene_extent > 0.0 { (self.scene_extent / frame.unit) as f32 } else { of_cameras }
    }

    /// Same as [`DataSettings::block`], but only if the rest of the scene is masked.
    ///
    /// # Errors
    /// [`Error::Argument`] without a block, and without a scene whose depths show which pixels to mask.
    pub fn masked_block(&self, frame: &WorldFrame) -> Result<Option<(Bounds, f32)>> {
        let block = self.block(frame)?;
        if self.outside == Outside::Drawn {
            return Ok(None);
        }
        let problem = match block {
            None => "masked is for a block: give --block or --job as well",
            Some(_) if self.init.as_os_str().is_empty() => {
                "masked goes by the depths of a scene: give one to begin with (--init)"
            }
            Some(_) => return Ok(block),
        };
        Err(Error::argument("outside", problem))
    }

    /// Same as [`DataSettings::block`], but only if the depths of a scene determine the used parts of photos.
    ///
    /// # Errors
    /// [`Error::Argument`] if that was requested without a block, or without such a scene.
    pub fn block_of_parts(&self, frame: &WorldFrame) -> Result<Option<(Bounds, f32)>> {
        if self.photo_parts != AutoSwitch::On || self.uses_parts_of_job() {
            return Ok(None);
        }
        let problem = match self.block(frame)? {
            None => "are those that show a block: give --block or --job as well",
            Some(_) if self.init.as_os_str().is_empty() => {
                "are found by the depths of a scene: give one to begin with (--init)"
            }
            block => return Ok(block.filter(|(core, _)| !SceneBlock::is_everything(*core))),
        };
        Err(Error::argument("photo_parts", problem))
    }

    /// True if the division's file names the used parts of photos.
    pub fn uses_parts_of_job(&self) -> bool {
        self.photo_parts != AutoSwitch::Off && !self.job.is_empty()
    }

    /// True if the depths of the initial scene determine what photos show of a block.
    pub fn looks_at_depths(&self) -> Result<bool> {
        let frame = WorldFrame::default();
        Ok(self.masked_block(&frame)?.or(self.block_of_parts(&frame)?).is_some())
    }

    pub fn check_block(&self) -> Result<()> {
        if !(self.scene_extent.is_finite() && self.scene_extent >= 0.0) {
            let problem = format!("is {}, must be positive, or 0 for that of the cameras", self.scene_extent);
            return Err(Error::argument("scene_extent", problem));
        }
        if self.train_test_exp
            && (self.uses_parts_of_job() || self.block_of_parts(&WorldFrame::default())?.is_some())
        {
            let problem = "takes halves of whole photos: give --photo-parts off as well";
            return Err(Error::argument("train_test_exp", problem));
        }
        self.looks_at_depths().map(drop)
    }
}
