//! Program, machine and device of a measurement.

use super::schema::{Device, Host, Program};
use ashsplat::vk::Context;
use std::collections::BTreeMap;
use std::process::Command;
use std::time::{Duration, UNIX_EPOCH};

/// Variables that change what the common drivers do.
const VARIABLES: [&str; 6] = [
    "LP_NATIVE_VECTOR_WIDTH",
    "LP_NUM_THREADS",
    "MESA_SHADER_CACHE_DISABLE",
    "RADV_PERFTEST",
    "VK_ICD_FILENAMES",
    "VK_DRIVER_FILES",
];

pub fn program() -> Program {
    Program {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: commit(),
        build: if cfg!(debug_assertions) { "debug" } else { "release" }.to_owned(),
    }
}

/// Current commit of the checkout in which the program was built; none if the program is older than the commit.
fn commit() -> Option<String> {
    // tools/release names it, because a program that is handed on has no sources beside it.
    if let Some(commit) = option_env!("ASHSPLAT_COMMIT") {
        return Some(commit.to_owned());
    }
    let git = |arguments: &[&str]| {
        let output = Command::new("git").arg("-C").arg(env!("CARGO_MANIFEST_DIR")).args(arguments).output();
        let output = output.ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let committed = git(&["log", "-1", "--format=%ct"])?.parse::<u64>().ok()?;
    let built = std::fs::metadata(std::env::current_exe().ok()?).ok()?.modified().ok()?;
    if built < UNIX_EPOCH + Duration::from_secs(committed) {
        return None;
    }
    let dirty = git(&["status", "--porcelain", "--untracked-files=no"])?;
    Some(if dirty.is_empty() { commit } else { format!("{commit}-dirty") })
}

pub fn host() -> Host {
    let mut machine = sysinfo::System::new();
    machine.refresh_cpu_list(sysinfo::CpuRefreshKind::nothing());
    let processor = machine.cpus().first().map(|cpu| cpu.brand().trim().to_owned());
    Host {
        system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        processor: processor.filter(|name| !name.is_empty()),
        threads: std::thread::available_parallelism().map_or(1, |n| n.get()),
    }
}

pub fn device(context: &Context) -> Device {
    let (description, l) = (context.description(), context.limits());
    let limits = [
        ("maxComputeWorkGroupInvocations", f64::from(l.max_workgroup_invocations)),
        ("maxComputeWorkgroupSubgroups", f64::from(l.max_workgroup_subgroups)),
        ("maxComputeWorkGroupCount", f64::from(l.max_workgroups_per_axis)),
        ("maxComputeSharedMemorySize", f64::from(l.shared_memory_bytes)),
        ("maxStorageBufferRange", l.max_storage_buffer_range as f64),
        ("maxMemoryAllocationSize", l.max_allocation_bytes as f64),
        ("deviceLocalHeapSize", l.heap_bytes as f64),
        ("timestampPeriod", l.timestamp_period_ns),
    ];
    Device {
        name: description.name.clone(),
        kind: description.kind.to_owned(),
        driver: description.driver.clone(),
        api_version: description.api_version.clone(),
        subgroup_size: l.subgroup_size,
        heavy_subgroup_size: Some(l.heavy_subgroup_size),
        backend: Some(l.tuning.backend.to_string()),
        // A software driver gives a timestamp period that is no number.
        limits: (limits.into_iter().filter(|(_, value)| value.is_finite()))
            .map(|(name, value)| (name.to_owned(), value))
            .collect(),
    }
}

pub fn environment() -> BTreeMap<String, String> {
    let set = |name: &&str| Some(((*name).to_owned(), std::env::var(name).ok()?));
    VARIABLES.iter().filter_map(set).collect()
}
