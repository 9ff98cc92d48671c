//! Binding numbers in set 0, for shaders and host: build.rs checks those of the shaders. What is no storage
//! buffer has a number of its own, so that a few layouts fit every kernel on devices without push
//! descriptors.

/// Most storage buffers of a kernel: bindings 0 to 15.
pub const BUFFERS: u32 = 16;
/// The binding of a kernel's storage image.
pub const STORAGE_IMAGE: u32 = 16;
/// The binding of a kernel's sampled image.
pub const SAMPLED_IMAGE: u32 = 17;
/// The binding of a kernel's uniform block.
pub const UNIFORM_BLOCK: u32 = 18;
