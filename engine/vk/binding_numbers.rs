//! Binding numbers in set 0, for shaders and host. build.rs checks the shaders' numbers. Images and uniform blocks have
//! their own numbers, so that a few layouts fit every kernel on devices without push descriptors.

/// Most storage buffers of a kernel: bindings 0 to 15.
pub const BUFFERS: u32 = 16;
/// Binding of a kernel's storage image.
pub const STORAGE_IMAGE: u32 = 16;
/// Binding of a kernel's sampled image.
pub const SAMPLED_IMAGE: u32 = 17;
/// Binding of a kernel's uniform block.
pub const UNIFORM_BLOCK: u32 = 18;
