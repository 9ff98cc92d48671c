//! The Vulkan layer on the device at hand.
