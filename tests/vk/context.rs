//! Choice of the device, options, limits.

use crate::common;
use ashsplat::vk::{Context, ContextOptions, devices};

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
