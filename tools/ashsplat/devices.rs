//! `ashsplat devices`.

use ashsplat::Result;
use ashsplat::vk::{self, Context, ContextOptions, DeviceDescription};
use clap::Args;

/// The Vulkan devices of this machine, with the limits that matter. Choose one with --device or ASHSPLAT_DEVICE.
#[derive(Args)]
pub struct Arguments {
    /// Print instead what a host engine has to enable on its own device to embed ashsplat
    #[arg(long)]
    requirements: bool,
    /// Measure, too, how fast the host writes and reads each kind of memory that it sees, and how fast the device copies
    #[arg(long, conflicts_with = "requirements")]
    measure: bool,
}

/// Size of a measured buffer.
const MEASURED_BYTES: u64 = 64 << 20;

pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.requirements {
        vk::Context::requirements().to_string().lines().for_each(|line| outln!("{line}"));
        return Ok(());
    }
    for device in vk::devices()? {
        print(&device);
        if arguments.measure && device.problem.is_none() {
            measure(&device).unwrap_or_else(|error| outln!("   cannot be measured: {error}"));
        }
    }
    Ok(())
}

/// Prints a line for each memory type that the host can access, GB/s.
fn measure(device: &DeviceDescription) -> Result<()> {
    let options = ContextOptions { device: Some(device.index.to_string()), ..ContextOptions::default() };
    let context = Context::new(&options)?;
    let ways = context.transfers();
    let to = match (ways.writes_directly, ways.copy_queue) {
        (true, _) => "written directly",
        (false, true) => "copied by a queue of their own",
        (false, false) => "copied",
    };
    outln!(
        "   uploads         {to}; downloads are {}",
        if ways.reads_directly { "read directly" } else { "copied" }
    );
    outln!(
        "   GB/s            {:>11} {:>11} {:>11} {:>11}",
        "host writes",
        "host reads",
        "to device",
        "from device"
    );
    for of in context.measure_memory(MEASURED_BYTES)? {
        let place = if of.device_local { "device" } else { "host" };
        let cached = if of.cached { ", cached" } else { "" };
        let [write, read, to, from] =
            [of.write, of.read, of.to_device, of.from_device].map(|rate| rate * 1e-9);
        let arenas = if of.holds_arenas { "  uploads write here" } else { "" };
        let name = format!("{place}{cached}");
        outln!(
            "   {:<2} {name:12} {write:>11.2} {read:>11.2} {to:>11.2} {from:>11.2}{arenas}",
            of.memory_type
        );
    }
    Ok(())
}

fn print(device: &DeviceDescription) {
    outln!("{}: {} ({})", device.index, device.name, device.kind);
    outln!("   driver          {}, Vulkan {}", device.driver, device.api_version);
    if let Some(limits) = &device.limits {
        let mib = |bytes: u64| format!("{} MiB", bytes >> 20);
        outln!(
            "   subgroups       {} invocations ({} to {})",
            limits.subgroup_size,
            limits.min_subgroup_size,
            limits.max_subgroup_size
        );
        outln!(
            "   workgroups      {} invocations, {} KiB shared memory, {} per axis",
            limits.max_workgroup_invocations,
            limits.shared_memory_bytes >> 10,
            limits.max_workgroups_per_axis
        );
        outln!(
            "   memory          {} heap, {} per allocation, {} per binding",
            mib(limits.heap_bytes),
            mib(limits.max_allocation_bytes),
            mib(limits.max_storage_buffer_range)
        );
    }
    match &device.problem {
        Some(problem) => outln!("   cannot be used: {problem}"),
        None => outln!("   usable"),
    }
}
