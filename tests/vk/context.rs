//! Choice of the device, options, limits.

use crate::common;
use ashsplat::Error;
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
fn an_unknown_device_is_an_error_that_lists_the_known_ones() {
    let options = ContextOptions { device: Some("voodoo 2".into()), ..ContextOptions::default() };
    let error = Context::new(&options).err().expect("an error");
    assert!(matches!(error, Error::UnknownDevice { .. }), "{error}");
    let first = &devices().expect("a list")[0];
    let message = error.to_string();
    assert!(!message.contains('\n'), "{message}");
    crate::common::assert_says(&message, &["voodoo 2", &first.name]);
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

#[test]
fn workgroup_sizes_are_whole_subgroups_within_all_limits() {
    let mut limits = common::context().limits().clone();
    (limits.subgroup_size, limits.max_workgroup_subgroups) = (8, 32);
    (limits.max_workgroup_invocations, limits.max_workgroup_size) = (1024, [1024; 3]);
    assert_eq!(limits.workgroup_size(256), 256);
    assert_eq!(limits.workgroup_size(512), 256, "32 subgroups of 8");
    assert_eq!(limits.workgroup_size(100), 96);
    assert_eq!(limits.workgroup_size(1), 8, "never less than a subgroup");
    limits.max_workgroup_invocations = 128;
    assert_eq!(limits.workgroup_size(256), 128);
}

#[test]
fn many_workgroups_become_a_grid_that_holds_them_all() {
    let mut limits = common::context().limits().clone();
    limits.max_workgroups_per_axis = 10;
    for (count, grid) in
        [(0, [0, 1, 1]), (1, [1, 1, 1]), (10, [10, 1, 1]), (11, [10, 2, 1]), (100, [10, 10, 1])]
    {
        assert_eq!(limits.grid(count), grid);
    }
}
