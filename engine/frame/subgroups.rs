//! Checks that subgroups have the size and order that the kernels assume.

use crate::error::{Error, Result};
use crate::frame::tuning::ELEMENTWISE_WORKGROUP;
use crate::kernels::subgroups::subgroup_probe;
use crate::vk::{Context, Kernel, Limits, MemoryKind};
use std::sync::atomic::Ordering;

/// Number of subgroups that the probe inspects.
const SUBGROUPS: u32 = 8;

/// Checks on the device that subgroups have the size that kernels are built for and hold neighbouring invocations. Subgroup
/// `k` of a workgroup must hold the invocations from `k` times the size on, in lane order. Kernels depend on that, and
/// Vulkan does not promise it. Does nothing on a host's device without a queue, or on a compile-only device.
///
/// If pipelines can require the size ([`Limits::subgroup_size_selectable`]), one small kernel runs for each size in use.
/// Otherwise kernels are built so that the size may not vary (SPIR-V below 1.6, Vulkan's
/// `VkPipelineShaderStageCreateFlagBits`). A few then run in workgroups of several sizes, to find drivers that vary it
/// nevertheless.
///
/// [`Renderer::new`](crate::Renderer::new) and [`Trainer::new`](crate::Trainer::new) call it once per device that ashsplat
/// opened. It submits and waits, so hosts call it themselves, as do callers that use only [`crate::passes::sort`] or
/// [`crate::passes::scan`]. It checks only its own kernel.
///
/// # Errors
/// [`Error::MissingFeature`] with the sizes; when the device refuses the pipeline.
pub fn check(context: &Context) -> Result<()> {
    let sound = context.subgroups_are_sound();
    if !context.can_run() || sound.load(Ordering::Relaxed) {
        return Ok(());
    }
    let limits = context.limits();
    probed(limits).into_iter().try_for_each(|shape| probe(context, shape))?;
    // Later renderers on this device skip the check.
    sound.store(true, Ordering::Relaxed);
    Ok(())
}

/// Returns the (subgroup size, workgroup size) pairs to probe.
fn probed(limits: &Limits) -> Vec<[u32; 2]> {
    let largest = |size: u32| {
        [size, Limits { subgroup_size: size, ..limits.clone() }.workgroup_size(ELEMENTWISE_WORKGROUP)]
    };
    let size = limits.subgroup_size;
    let mut shapes = match limits.subgroup_size_selectable {
        true => vec![largest(size), largest(limits.heavy_subgroup_size)],
        // Drivers may choose the subgroup size by the workgroup size.
        false => vec![[size, size], [size, limits.workgroup_size(SUBGROUPS * size)], largest(size)],
    };
    shapes.dedup();
    shapes
}

fn probe(context: &Context, [size, workgroup_size]: [u32; 2]) -> Result<()> {
    let kernel: Kernel<subgroup_probe::Interface> =
        Kernel::new(context, &subgroup_probe::Spec { workgroup_size, subgroup_size: size })?;
    let count = (SUBGROUPS * size).max(workgroup_size);
    let bytes = u64::from(16 * count);
    let found = context.allocate("subgroups", &[("found", bytes)], MemoryKind::Device)?.remove(0);
    context.run("subgroup size", |recorder| {
        let bind = subgroup_probe::Bind { found: &found };
        let push = subgroup_probe::Push { count };
        recorder.dispatch(&kernel, &bind, &push, count.div_ceil(workgroup_size).into());
    })?;
    let found: Vec<[u32; 4]> = bytemuck::pod_collect_to_vec(&context.download(&found.range(0, bytes))?);
    let as_expected = |(index, found): &(usize, &[u32; 4])| {
        let place = *index as u32 % workgroup_size;
        **found == [size, size, place, place / size * size]
    };
    let Some((index, [invocations, found, place, first])) =
        found.iter().enumerate().find(|found| !as_expected(found))
    else {
        return Ok(());
    };
    let required = match context.limits().subgroup_size_selectable {
        true => "which was required of the kernel",
        false => "which it reports, and the driver does not let the size be required",
    };
    Err(Error::MissingFeature {
        device: context.device_name().to_owned(),
        feature: format!(
            "subgroups of {size} neighbouring invocations, {required}: a kernel with workgroups of {workgroup_size} ran with \
             {invocations} of {found}; invocation {index} was at {place} of its workgroup, in a subgroup that begins at {first}"
        ),
    })
}
