//! The Vulkan layer on the present device.

mod context;
mod kernels;
mod memory;
mod overrides;
mod profile;
mod recorder;

use ashsplat::vk::{Buffer, Context, MemoryKind, Recorder, RunReport};

fn run(context: &Context, record: impl FnOnce(&mut Recorder)) -> RunReport {
    let report = context.run("test", |r| record(r));
    report.expect("a run")
}

/// Buffers of one arena of the device.
fn allocate<const N: usize>(context: &Context, requests: [(&'static str, u64); N]) -> [Buffer; N] {
    let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
    buffers.try_into().expect("as many as requested")
}

fn words(context: &Context, buffer: &Buffer) -> Vec<u32> {
    bytemuck::pod_collect_to_vec(&context.download(buffer).expect("download"))
}
