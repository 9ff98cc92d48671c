//! The generated interfaces and pipelines of all kernels.

use crate::common;
use ashsplat::Error;
use ashsplat::kernels::{self, scan::scan_reduce};
use ashsplat::vk::{Context, Kernel, KernelInterface, KernelVisitor, Limits, LimitsOverride};

#[test]
fn what_exceeds_the_device_is_refused_before_the_driver_sees_it() {
    let limits = common::context().limits();
    let fits = scan_reduce::Spec::for_device(limits);
    let refused =
        |spec| Kernel::<scan_reduce::Interface>::new(common::context(), &spec).err().expect("refused");
    let max = limits.max_workgroup_invocations.max(limits.max_workgroup_subgroups * limits.subgroup_size);
    let error = refused(scan_reduce::Spec { workgroup_size: max * 2, ..fits });
    assert!(matches!(&error, Error::TooLarge { what, .. } if what.contains("scan/scan_reduce")), "{error}");
    let error = refused(scan_reduce::Spec { workgroup_size: fits.subgroup_size + 1, ..fits });
    assert!(error.to_string().contains("no multiple"), "{error}");
    let error = refused(scan_reduce::Spec { subgroup_size: limits.max_subgroup_size * 2, ..fits });
    assert!(error.to_string().contains("subgroup size"), "{error}");
    let error = refused(scan_reduce::Spec { workgroup_size: 0, ..fits });
    assert!(error.to_string().contains("no invocations"), "{error}");
    common::assert_silent(common::context());
}

/// Checks whether kernels fit a device with these limits, apart from their workgroups.
struct Fit<'a> {
    limits: &'a Limits,
    largest: u32,
}

impl KernelVisitor for Fit<'_> {
    fn visit<K: KernelInterface>(&mut self) {
        let (spec, limits) = (K::spec_for(self.limits), self.limits);
        let [shared, max] = [K::shared_bytes(&spec), limits.shared_memory_bytes];
        assert!(shared <= max, "{}, subgroups of {}: {shared} bytes", K::NAME, limits.subgroup_size);
        assert!(K::FORMS[0].push_bytes <= limits.push_constant_bytes, "{}", K::NAME);
        self.largest = self.largest.max(shared);
    }
}

/// The required limits suffice for every kernel, even if a vec3 of shared memory takes 16 bytes.
#[test]
fn kernels_fit_into_what_is_asked_of_devices() {
    let required = |name: &str| {
        let (_, required) = Context::requirements().limits.into_iter().find(|(n, _)| *n == name).expect(name);
        Some(u32::try_from(required).expect("a u32"))
    };
    let lowered = LimitsOverride {
        shared_memory_bytes: required("maxComputeSharedMemorySize"),
        push_constant_bytes: required("maxPushConstantsSize"),
        ..LimitsOverride::default()
    };
    for lanes in [4, 8, 16, 32, 64, 128] {
        let to = LimitsOverride { fixed_subgroup_size: Some(lanes), ..lowered };
        let limits = common::context().limits().clone().lowered(&to);
        let mut fit = Fit { limits: &limits, largest: 0 };
        kernels::visit_all(&mut fit);
        assert!(fit.largest > 12 << 10, "{lanes}: most bytes are {}", fit.largest);
    }
    let spec = kernels::poses::pose_gradient::Spec { workgroup_size: 256, subgroup_size: 32 };
    assert_eq!(kernels::poses::pose_gradient::Interface::shared_bytes(&spec), 2 * 8 * 16);
}
