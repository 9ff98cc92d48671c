//! Choice of the device, options, limits.

use crate::common;
use ashsplat::vk::{Context, ContextOptions, LimitsOverride, devices};

#[test]
fn devices_are_listed_with_their_limits() {
    let all = devices().expect("a list");
    let usable = all.iter().find(|d| d.problem.is_none()).expect("a usable device");
    assert!(!usable.name.is_empty() && !usable.driver.is_empty());
    assert!(usable.api_version.starts_with("1."));
    let limits = usable.limits.as_ref().expect("limits");
    assert!((limits.min_subgroup_size..=limits.max_subgroup_size).contains(&limits.subgroup_size));
    assert_eq!(all.iter().map(|d| d.index).collect::<Vec<_>>(), (0..all.len()).collect::<Vec<_>>());
}

#[test]
fn a_device_is_chosen_by_index_or_name() {
    let name = common::context().device_name().to_owned();
    let index = devices().expect("a list").iter().position(|d| d.name == name).expect("listed");
    for asked in [index.to_string(), name.to_lowercase()] {
        let options = ContextOptions { device: Some(asked), ..ContextOptions::default() };
        assert_eq!(Context::new(&options).expect("a context").device_name(), name);
    }
}

#[test]
fn a_subgroup_size_that_the_device_lacks_is_an_error() {
    let options = ContextOptions { subgroup_size: Some(1024), ..ContextOptions::default() };
    let error = Context::new(&options).err().expect("an error");
    assert!(error.to_string().contains("subgroup size 1024"), "{error}");
}

#[test]
fn an_override_lowers_limits_and_never_raises_them() {
    let device = common::context().limits();
    let override_ = LimitsOverride {
        max_workgroups_per_axis: Some(7),
        max_allocation_bytes: Some(u64::MAX),
        ..LimitsOverride::default()
    };
    let lowered = device.clone().lowered(&override_);
    assert_eq!(lowered.max_workgroups_per_axis, 7);
    assert_eq!(lowered.max_allocation_bytes, device.max_allocation_bytes);
    assert_eq!(device.clone().lowered(&LimitsOverride::default()), *device);
}
