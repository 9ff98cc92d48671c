//! The arguments that all commands share.

use ashsplat::Result;
use ashsplat::vk::{Context, ContextOptions};
use clap::Args;

/// Which device, and how closely it is watched.
#[derive(Args, Clone, Default)]
pub struct DeviceArguments {
    /// Vulkan device: its number in `ashsplat devices` or a part of its name [default: $ASHSPLAT_DEVICE, else the best]
    #[arg(long, value_name = "N|NAME")]
    pub device: Option<String>,
    /// Run under the Khronos validation layer, with synchronisation validation; its messages go to stderr
    #[arg(long)]
    pub validation: bool,
    /// Most device memory to use, with a unit: 800M, 6G; densification stops growing there [default: what the device has]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub max_memory: Option<u64>,
}

/// Bytes of a number with a unit: K, M or G, powers of 1024.
pub fn bytes(text: &str) -> Result<u64, String> {
    let units = [('K', 10), ('M', 20), ('G', 30)];
    let upper = text.trim().to_uppercase();
    let unit = units.iter().find(|(unit, _)| upper.ends_with(*unit));
    let number: f64 =
        upper.trim_end_matches(['K', 'M', 'G']).parse().map_err(|_| "give a size such as 6G")?;
    let scale = f64::from(unit.map_or(1, |(_, bits)| 1u32 << bits));
    if number.is_finite() && number > 0.0 {
        Ok((number * scale) as u64)
    } else {
        Err("must be positive".into())
    }
}

impl DeviceArguments {
    /// Opens the device.
    pub fn context(&self) -> Result<Context> {
        self.context_with(|_| ())
    }

    /// Opens the device with other options than usual.
    pub fn context_with(&self, change: impl FnOnce(&mut ContextOptions)) -> Result<Context> {
        let mut options = ContextOptions {
            device: self.device.clone(),
            validation: self.validation,
            max_memory: self.max_memory,
            ..Default::default()
        };
        change(&mut options);
        Context::new(&options)
    }

    /// Prints what the validation layer said, if it was asked for.
    pub fn report_validation(&self, context: &Context) {
        for message in context.validation_messages() {
            tell!("validation: {message}");
        }
    }
}
