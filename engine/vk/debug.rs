//! Names and labels for tools, and messages of the validation layers.

use super::lock::lock;
use crate::error::Error;
use ash::vk;
use ash::vk::Result as R;
use std::ffi::{CStr, CString, c_void};
use std::sync::{Arc, Mutex};

/// All messages of the layers, oldest first.
#[derive(Default)]
pub(super) struct Messages {
    validation: Mutex<Vec<String>>,
    printed: Mutex<Vec<String>>,
}

const PRINTF_ID: &str = "UNASSIGNED-DEBUG-PRINTF";

impl Messages {
    fn push(&self, severity: vk::DebugUtilsMessageSeverityFlagsEXT, text: &str) {
        let (list, message) = match printed(text) {
            Some(printed) => (&self.printed, printed.to_owned()),
            None if severity > vk::DebugUtilsMessageSeverityFlagsEXT::INFO => {
                (&self.validation, format!("{severity:?}: {text}"))
            }
            None => return,
        };
        lock(list).push(message);
    }

    pub(super) fn all(&self) -> Vec<String> {
        lock(&self.validation).clone()
    }

    pub(super) fn take_printed(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.printed))
    }
}

/// Returns the shader's output in a message, if any. The layer puts its own text and a number before it, each followed by a
/// bar.
fn printed(message: &str) -> Option<&str> {
    let own = message.contains(PRINTF_ID) || message.contains("DEBUG-PRINTF");
    own.then(|| message.splitn(3, " | ").last().unwrap_or(message).trim())
}

/// A messenger of VK_EXT_debug_utils that collects warnings and errors of the validation layers.
pub(super) struct Messenger {
    loader: ash::ext::debug_utils::Instance,
    raw: vk::DebugUtilsMessengerEXT,
    pub(super) messages: Arc<Messages>,
}

impl Messenger {
    /// The instance must have been created with VK_EXT_debug_utils and must outlive the messenger. `printf` also collects
    /// shader output.
    pub(super) fn new(
        entry: &ash::Entry,
        instance: &ash::Instance,
        printf: bool,
    ) -> Result<Self, vk::Result> {
        let loader = ash::ext::debug_utils::Instance::new(entry, instance);
        let messages = Arc::<Messages>::default();
        type Severity = vk::DebugUtilsMessageSeverityFlagsEXT;
        let information = if printf { Severity::INFO } else { Severity::empty() };
        let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(Severity::WARNING | Severity::ERROR | information)
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(collect))
            .user_data(Arc::as_ptr(&messages).cast_mut().cast());
        // SAFETY: `messages` lives as long as the messenger (same struct), and `collect` only reads through the
        // pointer as the `Messages` that it is.
        let raw = unsafe { loader.create_debug_utils_messenger(&info, None)? };
        Ok(Self { loader, raw, messages })
    }
}

impl Drop for Messenger {
    fn drop(&mut self) {
        // SAFETY: created by this loader, destroyed once.
        unsafe { self.loader.destroy_debug_utils_messenger(self.raw, None) }
    }
}

/// Called by the layers, on any thread.
///
/// # Safety
/// `data` is null or valid for the call, `user` points to the [`Messages`] given at creation.
unsafe extern "system" fn collect(
    severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the contract of the callback; the message is a C string or null.
    let (messages, text) = unsafe {
        let message = data.as_ref().map_or(std::ptr::null(), |d| d.p_message);
        let text = (!message.is_null()).then(|| CStr::from_ptr(message).to_string_lossy().into_owned());
        (user.cast::<Messages>().as_ref(), text)
    };
    if let (Some(messages), Some(text)) = (messages, text) {
        messages.push(severity, &text);
    }
    vk::FALSE
}

/// Names objects and labels ranges of commands, if VK_EXT_debug_utils is present.
pub(super) struct Names(Option<ash::ext::debug_utils::Device>);

impl Names {
    pub(super) fn new(instance: &ash::Instance, device: &ash::Device, present: bool) -> Self {
        Self(present.then(|| ash::ext::debug_utils::Device::new(instance, device)))
    }

    /// Gives a Vulkan object its name in tools and messages.
    pub(super) fn name<T: vk::Handle>(&self, object: T, name: &str) {
        let Some(loader) = &self.0 else { return };
        let name = c_string(name);
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // SAFETY: the object belongs to this device and is alive: callers name what they have just created. A
        // failure only costs the name.
        let _ = unsafe { loader.set_debug_utils_object_name(&info) };
    }

    pub(super) fn begin_label(&self, commands: vk::CommandBuffer, name: &str) {
        let Some(loader) = &self.0 else { return };
        with_c_string(name, |name| {
            let label = vk::DebugUtilsLabelEXT::default().label_name(name);
            // SAFETY: `commands` is in the recording state, held by the recorder that calls.
            unsafe { loader.cmd_begin_debug_utils_label(commands, &label) }
        });
    }

    pub(super) fn end_label(&self, commands: vk::CommandBuffer) {
        let Some(loader) = &self.0 else { return };
        // SAFETY: as above, and every end follows its begin (`Recorder::scope`).
        unsafe { loader.cmd_end_debug_utils_label(commands) }
    }

    /// Puts a label between submissions; false without VK_EXT_debug_utils.
    pub(super) fn insert_queue_label(&self, queue: vk::Queue, name: &str) -> bool {
        let Some(loader) = &self.0 else { return false };
        let name = c_string(name);
        let label = vk::DebugUtilsLabelEXT::default().label_name(&name);
        // SAFETY: the queue belongs to this device, and the caller holds its lock.
        unsafe { loader.queue_insert_debug_utils_label(queue, &label) }
        true
    }
}

/// Calls `f` with a label. Short labels need no allocation: recordings have many.
fn with_c_string(text: &str, f: impl FnOnce(&CStr)) {
    let mut bytes = [0; 64];
    match bytes.get_mut(..text.len()).filter(|bytes| bytes.len() < 64) {
        Some(start) => start.copy_from_slice(text.as_bytes()),
        None => return f(&c_string(text)),
    }
    match CStr::from_bytes_until_nul(&bytes) {
        Ok(short) => f(short),
        Err(_) => f(&c_string(text)),
    }
}

fn c_string(text: &str) -> CString {
    CString::new(text.replace('\0', "")).unwrap_or_default()
}

// Converts the result of a failed Vulkan call to an error.

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
