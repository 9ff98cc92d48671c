//! `ashsplat devices`.

use ashsplat::Result;
use ashsplat::vk::{self, DeviceDescription};
use clap::Args;

/// The Vulkan devices of this machine, with the limits that matter. Choose one with --device or ASHSPLAT_DEVICE.
#[derive(Args)]
pub struct Arguments {
    /// Print instead what a host engine has to enable on its own device to embed ashsplat
    #[arg(long)]
    requirements: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.requirements {
        vk::Context::requirements().to_string().lines().for_each(|line| say!("{line}"));
        return Ok(());
    }
    for device in vk::devices()? {
        print(&device);
    }
    Ok(())
}

fn print(device: &DeviceDescription) {
    say!("{}: {} ({})", device.index, device.name, device.kind);
    say!("   driver          {}, Vulkan {}", device.driver, device.api_version);
    if let Some(limits) = &device.limits {
        let mib = |bytes: u64| format!("{} MiB", bytes >> 20);
        say!(
            "   subgroups       {} invocations ({} to {})",
            limits.subgroup_size,
            limits.min_subgroup_size,
            limits.max_subgroup_size
        );
        say!(
            "   workgroups      {} invocations, {} KiB shared memory, {} per axis",
            limits.max_workgroup_invocations,
            limits.shared_memory_bytes >> 10,
            limits.max_workgroups_per_axis
        );
        say!(
            "   memory          {} heap, {} per allocation, {} per binding",
            mib(limits.heap_bytes),
            mib(limits.max_allocation_bytes),
            mib(limits.max_storage_buffer_range)
        );
    }
    match &device.problem {
        Some(problem) => say!("   cannot be used: {problem}"),
        None => say!("   usable"),
    }
}
