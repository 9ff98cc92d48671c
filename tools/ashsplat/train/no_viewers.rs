//! In place of `live`, in a program without the feature `view`.

use super::Run;
use ashsplat::Result;
use ashsplat::train::StepReport;
use ashsplat::vk::Context;
use ashsplat_files::Gallery;
use ashsplat_program::measure::Stopwatch;
use clap::Args;
use std::sync::atomic::AtomicBool;

/// No options.
#[derive(Args, Clone, Debug)]
pub struct LiveArguments {}

impl LiveArguments {
    pub fn wants_photos(&self) -> bool {
        false
    }

    pub fn open(&self) -> Result<Option<Live>> {
        Ok(None)
    }
}

pub enum Live {}

impl Run {
    pub fn serve(&mut self, _: Option<Live>, _: &Context, _: Option<Gallery>) -> Result<()> {
        Ok(())
    }

    pub(super) fn show(&mut self, _: &StepReport, _: &AtomicBool, _: &mut Stopwatch) {}

    pub(super) fn has_viewers(&self) -> bool {
        self.live.is_some()
    }

    pub(super) fn show_psnr(&self, _: u32, _: f64) {}

    pub(super) fn end_show(&mut self, _: &AtomicBool) {}
}
