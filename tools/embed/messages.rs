//! Messages of the validation layer.

use ashsplat::ash::{self, ext::debug_utils, vk};
use std::ffi::{CStr, c_void};
use std::sync::{Mutex, PoisonError};

pub struct Messages {
    loader: debug_utils::Instance,
    messenger: vk::DebugUtilsMessengerEXT,
    texts: Box<Mutex<Vec<String>>>,
}

impl Messages {
    /// # Safety
    /// The instance has VK_EXT_debug_utils and lives until [`Messages::finish`].
    pub unsafe fn new(entry: &ash::Entry, instance: &ash::Instance) -> Result<Self, vk::Result> {
        let loader = debug_utils::Instance::new(entry, instance);
        let texts = Box::new(Mutex::new(Vec::new()));
        type Severity = vk::DebugUtilsMessageSeverityFlagsEXT;
        let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(Severity::WARNING | Severity::ERROR)
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(collect))
            .user_data(std::ptr::from_ref(&*texts).cast_mut().cast());
        // SAFETY: `texts` keeps its address as long as the messenger lives.
        let messenger = unsafe { loader.create_debug_utils_messenger(&info, None)? };
        Ok(Self { loader, messenger, texts })
    }

    /// Returns all messages. Call it after the device is destroyed, so that leaks are reported too.
    pub fn finish(self) -> Vec<String> {
        // SAFETY: the messenger is of the instance, which is alive.
        unsafe { self.loader.destroy_debug_utils_messenger(self.messenger, None) };
        self.texts.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

unsafe extern "system" fn collect(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the contract of the callback; `user` is what `Messages::new` gave.
    unsafe {
        if let (Some(data), Some(texts)) = (data.as_ref(), user.cast::<Mutex<Vec<String>>>().as_ref()) {
            let text = CStr::from_ptr(data.p_message).to_string_lossy().into_owned();
            texts.lock().unwrap_or_else(PoisonError::into_inner).push(text);
        }
    }
    vk::FALSE
}
