//! `--blending`: the form of blending.

use ashsplat::Blending;
use clap::Args;

/// Form of blending.
#[derive(Args, Clone, Default)]
pub struct FormArguments {
    /// How tiles are blended: by subgroups that cull per region of a tile (regions), or by the paper's batches in shared memory (shared):
    /// the same picture, at a time that depends on the device [default: what was measured to be faster on such devices]
    #[arg(long, value_name = "FORM", value_parser = ["regions", "shared"])]
    blending: Option<String>,
}

impl FormArguments {
    pub fn get(&self) -> Option<Blending> {
        Blending::ALL.into_iter().find(|form| self.blending.as_deref() == Some(name(*form)))
    }
}

/// A form's name in results and on the command line.
pub fn name(blending: Blending) -> &'static str {
    match blending {
        Blending::Regions => "regions",
        Blending::SharedMemory => "shared",
    }
}
