//! Whether subgroups are what the kernels take them for, on devices whose subgroup size cannot be required.

use crate::error::{Error, Result};
use crate::kernels::subgroups::subgroup_probe;
use crate::tuning::ELEMENTWISE_WORKGROUP;
use crate::vk::{Context, Kernel, MemoryKind};
use std::sync::atomic::Ordering;

/// Subgroups that are looked at.
const SUBGROUPS: u32 = 8;

/// Checks on the device that subgroups have the size it reports and hold neighbouring invocations. Where the size can be
/// required ([`Limits::subgroup_size_selectable`](crate::vk::Limits::subgroup_size_selectable)), on a host's device without a
/// queue, and where nothing runs, nothing is done.
///
/// Kernels are built so that the size may not vary (SPIR-V below 1.6, Vulkan's `VkPipelineShaderStageCreateFlagBits`). This
/// finds drivers that choose another one all the same. [`Renderer::new`](crate::Renderer::new) and
/// [`Trainer::new`](crate::Trainer::new) call it on devices of our own. It submits and waits: hosts call it themselves, and who uses
/// [`crate::sort`] or [`crate::scan`] alone calls it once. It looks at its own kernel only.
///
/// # Errors
/// [`Error::MissingFeature`] with the sizes; when the device refuses the pipeline.
pub fn check(context: &Context) -> Result<()> {
    let limits = context.limits();
    let sound = context.subgroups_are_sound();
    if limits.subgroup_size_selectable || !context.can_run() || sound.load(Ordering::Relaxed) {
        return Ok(());
    }
    let size = limits.subgroup_size;
    // Drivers may choose by the workgroup.
    let mut workgroups =
        [size, limits.workgroup_size(SUBGROUPS * size), limits.workgroup_size(ELEMENTWISE_WORKGROUP)]
            .to_vec();
    workgroups.dedup();
    workgroups.into_iter().try_for_each(|workgroup_size| probe(context, size, workgroup_size))?;
    // Not again for every renderer.
    sound.store(true, Ordering::Relaxed);
    Ok(())
}

fn probe(context: &Context, size: u32, workgroup_size: u32) -> Result<()> {
    let kernel: Kernel<subgroup_probe::Interface> =
        Kernel::new(context, &subgroup_probe::Spec { workgroup_size, subgroup_size: size })?;
    let count = (SUBGROUPS * size).max(workgroup_size);
    let bytes = u64::from(12 * count);
    let found = context.allocate("subgroups", &[("found", bytes)], MemoryKind::Device)?.remove(0);
    context.run("subgroup size", |recorder| {
        let bind = subgroup_probe::Bind { found: &found };
        let push = subgroup_probe::Push { count };
        recorder.dispatch(&kernel, &bind, &push, count.div_ceil(workgroup_size).into());
        Ok(())
    })?;
    let found: Vec<[u32; 3]> = bytemuck::pod_collect_to_vec(&context.download(&found.range(0, bytes))?);
    let as_reported = |(index, found): &(usize, &[u32; 3])| **found == [size, size, *index as u32 % size];
    let Some((_, [invocations, found, lane])) = found.iter().enumerate().find(|found| !as_reported(found))
    else {
        return Ok(());
    };
    Err(Error::MissingFeature {
        device: context.device_name().to_owned(),
        feature: format!(
            "subgroups of {size} neighbouring invocations, which it reports: a kernel ran with {invocations} of {found} (lane \
             {lane}), and the driver does not let the size be required"
        ),
    })
}
