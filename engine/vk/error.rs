//! Converts the result of a failed Vulkan call to an error.

use crate::Error;
use ash::vk::Result as R;

/// Returns the conversion for calls of this function.
pub(super) fn vk_error(call: &'static str) -> impl Fn(R) -> Error {
    move |result| {
        let remedy = match result {
            R::ERROR_DEVICE_LOST => return Error::DeviceLost { call },
            R::ERROR_OUT_OF_DEVICE_MEMORY => "free device memory, or use a smaller scene or resolution",
            R::ERROR_OUT_OF_HOST_MEMORY => "free memory, or use a smaller scene or resolution",
            _ => "",
        };
        Error::Vulkan { call, result: format!("{result:?} ({result})"), remedy: remedy.to_owned() }
    }
}
