//! Kernels that are built ahead, in C.

use super::*;
use ashsplat::vk::KernelJob;

/// The kernels of a reservation, to be built on threads of the host's choice.
pub struct AshsplatKernels(Vec<KernelJob>);

/// Lists the kernels that ashsplat_renderer_new and ashsplat_reserve build, with their number. Once they are built, these
/// build none. Free the list with ashsplat_kernels_free.
///
/// # Safety
/// `context` and `wanted` are alive, `kernels` and `count` are valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_kernels_new(
    context: *const AshsplatContext,
    wanted: *const AshsplatReservation,
    kernels: *mut *mut AshsplatKernels,
    count: *mut u32,
) -> AshsplatStatus {
    guarded!({
        let (context, wanted) = (borrowed(context, "context")?, read(wanted, "wanted")?);
        let count = borrowed_mut(count, "count")?;
        give(kernels, "kernels", || {
            let jobs = Renderer::kernel_jobs(&context.0, &wanted.checked()?)?;
            *count = jobs.len() as u32;
            Ok(AshsplatKernels(jobs))
        })
    })
}

/// Builds one of the kernels, `index` below their number. Any number of threads may do so at once.
///
/// # Safety
/// `kernels` is alive, and so is its context.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_kernels_build(
    kernels: *const AshsplatKernels,
    index: u32,
) -> AshsplatStatus {
    guarded!({
        let jobs = &borrowed(kernels, "kernels")?.0;
        let job = jobs.get(index as usize);
        let missing = || Error::argument("index", format!("{index}, there are {} kernels", jobs.len()));
        job.ok_or_else(missing)?.clone().build()
    })
}

/// Frees the list. Built kernels stay.
///
/// # Safety
/// `kernels` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_kernels_free(kernels: *mut AshsplatKernels) {
    // SAFETY: as promised.
    unsafe { take(kernels) }
}
