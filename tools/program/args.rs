//! Arguments that all commands share.

use crate::pipeline_cache;
use ashsplat::Result;
use ashsplat::frame::tuning::Backend;
use ashsplat::vk::{Context, ContextOptions};
use ashsplat_files::splats::ReadOptions;
use ashsplat_files::{HostMemory, quoted};
use clap::Args;

/// Device options that all commands share.
#[derive(Args, Clone, Default)]
pub struct DeviceArguments {
    /// Vulkan device: its number in `ashsplat devices` or a part of its name [default: $ASHSPLAT_DEVICE, else the best]
    #[arg(long, value_name = "N|NAME")]
    pub device: Option<String>,
    /// Run under the Khronos validation layer, with synchronisation validation; its messages go to stderr
    #[arg(long)]
    pub validation: bool,
    /// Most device memory to use, with a unit: 800M, 6G; work that needs more is refused, and a training adds no Gaussians
    /// beyond it [default: what the device has]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub max_memory: Option<u64>,
    /// Invocations of a subgroup, where the device lets them be chosen [default: by a table, else the device's own]
    #[arg(long, value_name = "N")]
    pub subgroup_size: Option<u32>,
    /// Treat the device as a gpu or a processor, whatever it is: kernels, sizes and layouts [default: $ASHSPLAT_BACKEND, else what
    /// it is]
    #[arg(long, value_name = "NAME", value_parser = str::parse::<Backend>)]
    pub backend: Option<Backend>,
    #[command(flatten)]
    pub host: HostArguments,
}

/// Budget of the machine's own memory.
#[derive(Args, Clone, Copy, Default)]
pub struct HostArguments {
    /// Most host memory for reading a file, and for photos while they are decoded or kept, with a unit: 800M, 6G; work that
    /// needs more is refused beforehand [default: three quarters of what is free]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub max_host_memory: Option<u64>,
}

impl HostArguments {
    pub fn reading(&self, drop_invalid: bool) -> ReadOptions {
        ReadOptions { drop_invalid, max_host_memory: self.max_host_memory }
    }

    /// Host memory budget of photos.
    pub fn memory(&self) -> HostMemory {
        self.max_host_memory.map(HostMemory::new).unwrap_or_default()
    }
}

/// Parses a number of bytes with a unit: K, M or G, powers of 1024.
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

/// Writes a size for [`bytes`], in the largest unit without a fraction.
pub fn size(bytes: u64) -> String {
    let units = [("G", 30), ("M", 20), ("K", 10)];
    let unit = units.into_iter().find(|(_, bits)| bytes.is_multiple_of(1 << bits));
    let (unit, bits) = unit.unwrap_or(("", 0));
    format!("{}{unit}", bytes >> bits)
}

impl DeviceArguments {
    /// The arguments that determine a result's bits, for a command line that repeats it.
    pub fn repeated(&self) -> String {
        // Another shell may not have the environment variable.
        self.repeated_for(self.options().asked_backend().ok().flatten())
    }

    fn repeated_for(&self, backend: Option<Backend>) -> String {
        let device = self.device.iter().map(|device| format!(" --device {}", quoted(device)));
        let memory = self.max_memory.iter().map(|bytes| format!(" --max-memory {}", size(*bytes)));
        let lanes = self.subgroup_size.iter().map(|lanes| format!(" --subgroup-size {lanes}"));
        let backend = backend.map(|backend| format!(" --backend {backend}"));
        device.chain(memory).chain(lanes).chain(backend).collect()
    }

    pub fn context(&self) -> Result<Context> {
        self.context_with(|_| ())
    }

    /// Same as [`DeviceArguments::context`], with changed options.
    pub fn context_with(&self, change: impl FnOnce(&mut ContextOptions)) -> Result<Context> {
        let mut options = ContextOptions { pipeline_cache: pipeline_cache::kept(), ..self.options() };
        change(&mut options);
        Context::new(&options)
    }

    fn options(&self) -> ContextOptions {
        ContextOptions {
            device: self.device.clone(),
            validation: self.validation,
            max_memory: self.max_memory,
            subgroup_size: self.subgroup_size,
            backend: self.backend,
            ..Default::default()
        }
    }

    /// Prints the messages of the validation layer, if it was requested.
    pub fn report_validation(&self, context: &Context) {
        for message in context.validation_messages() {
            errln!("validation: {message}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_repeated_is_read_back() {
        for (typed, said) in
            [("6G", "6G"), ("1536m", "1536M"), ("2048K", "2M"), ("0.5K", "512"), ("1000001", "1000001")]
        {
            let size = size(bytes(typed).expect("a size"));
            assert_eq!(size, said);
            assert_eq!(bytes(&size), bytes(typed));
        }
        let device = Some("it's (256 bits)".to_owned());
        let arguments = DeviceArguments { device, max_memory: Some(6 << 30), ..Default::default() };
        let quoted = if cfg!(windows) { r#""it's (256 bits)""# } else { r"'it'\''s (256 bits)'" };
        assert_eq!(arguments.repeated_for(None), format!(" --device {quoted} --max-memory 6G"));
        let arguments =
            DeviceArguments { subgroup_size: Some(16), backend: Some(Backend::Gpu), ..Default::default() };
        // Arguments override the environment.
        assert_eq!(arguments.repeated(), " --subgroup-size 16 --backend gpu");
        let processor = DeviceArguments::default().repeated_for(Some(Backend::Processor));
        assert_eq!([processor, DeviceArguments::default().repeated_for(None)], [" --backend processor", ""]);
    }
}
