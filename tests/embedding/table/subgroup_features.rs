//! The subgroup features that a host has enabled reach the driver's compiler.

use super::instrumented;
use crate::stage::*;
use std::sync::Mutex;

static MODULES: Mutex<Vec<Vec<u32>>> = Mutex::new(Vec::new());

/// Keeps the code of a module's create info.
pub fn note(info: *const c_void) {
    // SAFETY: a valid create info of the guest's, whose code outlives the call.
    let words = unsafe {
        let it = &*info.cast::<vk::ShaderModuleCreateInfo<'_>>();
        std::slice::from_raw_parts(it.p_code, it.code_size / 4)
    };
    MODULES.lock().expect("no panic while held").push(words.to_vec());
}

/// Subgroup features appear in the driver's modules if and only if the host enables them.
pub fn that_a_host_has_enabled() {
    // OpExecutionMode of an entry point, SubgroupUniformControlFlowKHR; OpGroupNonUniformBroadcast.
    let has_mode = |module: &[u32]| module.windows(3).any(|w| w[0] == 3 << 16 | 16 && w[2] == 4421);
    let broadcasts = |module: &[u32]| module.contains(&(6 << 16 | 337));
    for subgroup_features in [false, true] {
        with_host(&HostOptions { subgroup_features, ..options() }, |host| {
            let (device, _) = instrumented(host);
            let blending = |foreign: &ForeignDevice<'_>| {
                MODULES.lock().expect("no panic while held").clear();
                // SAFETY: as in `guest`.
                let context = unsafe { Context::from_foreign(foreign, &ContextOptions::default()) };
                let jobs =
                    Renderer::kernel_jobs(&context.expect("a context"), &Reservation::new(9, 1, 96, 64));
                let jobs = jobs.expect("a list").into_iter().filter(|job| job.name() == "forward/blend");
                jobs.for_each(|job| job.build().expect("built"));
                let modules = std::mem::take(&mut *MODULES.lock().expect("no panic while held"));
                assert!(!modules.is_empty());
                [modules.iter().all(|m| has_mode(m)), modules.iter().all(|m| broadcasts(m))]
            };
            let foreign = ForeignDevice { device: &device, ..host.foreign() };
            let enabled = host.features;
            let told = [enabled.shader_subgroup_uniform_control_flow, enabled.subgroup_broadcast_dynamic_id];
            eprintln!("the host's control flow and broadcasts: {told:?}");
            assert_eq!(blending(&foreign), told);
            // A feature without its extension is not used.
            assert_eq!(blending(&ForeignDevice { extensions: &[], ..foreign }), [false, told[1]]);
        });
    }
}
