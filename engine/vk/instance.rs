//! The loader and the Vulkan instance.

use super::debug::Messenger;
use super::debug::vk_error;
use crate::{Error, Result};
use ash::vk;
use std::ffi::{CStr, c_char};

pub(super) const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// An instance of Vulkan 1.3 and the loader that it came from.
pub(super) struct Instance {
    pub(super) messenger: Option<Messenger>,
    pub(super) has_debug_utils: bool,
    /// Vulkan version of the validation layer, if it is on.
    layer: Option<u32>,
    pub(super) raw: ash::Instance,
    // Unloads the library when dropped: keep it last.
    _entry: ash::Entry,
}

impl Instance {
    /// With `validation`, turns on the Khronos layer with synchronization validation, and collects its messages. With
    /// `printf`, turns on the layer for shader output. Also enables all `extensions`.
    pub(super) fn new(validation: bool, printf: bool, extensions: &[&CStr]) -> Result<Self> {
        // SAFETY: loading the system's Vulkan loader runs its initialisers, which are sound for a proper install.
        let entry = unsafe { ash::Entry::load() }
            .map_err(|e| Error::NoLoader { reason: one_line(&e.to_string()) })?;
        let wanted = validation || printf;
        let version = if wanted { layer_version(&entry)? } else { None };
        let layer = version.is_some();
        if wanted && !layer {
            return Err(Error::MissingFeature {
                device: "this machine".into(),
                feature: "VK_LAYER_KHRONOS_validation (Debian: vulkan-validationlayers)".into(),
            });
        }
        let (has_debug_utils, has_portability) = (
            has_extension(&entry, None, ash::ext::debug_utils::NAME)?,
            has_extension(&entry, None, ash::khr::portability_enumeration::NAME)?,
        );
        let mut enabled = Vec::new();
        for &name in extensions {
            if !has_extension(&entry, None, name)? {
                let feature = name.to_string_lossy().into_owned();
                return Err(Error::MissingFeature { device: "this machine".into(), feature });
            }
            enabled.push(name.as_ptr());
        }
        if has_debug_utils {
            enabled.push(ash::ext::debug_utils::NAME.as_ptr());
        }
        let raw = create(&entry, &checks(layer, validation, printf), enabled, has_portability)?;
        let messenger = (layer && has_debug_utils).then(|| Messenger::new(&entry, &raw, printf)).transpose();
        match messenger {
            Ok(messenger) => Ok(Self { messenger, has_debug_utils, layer: version, raw, _entry: entry }),
            Err(error) => {
                // SAFETY: nothing was created from the instance.
                unsafe { raw.destroy_instance(None) };
                Err(vk_error("vkCreateDebugUtilsMessengerEXT")(error))
            }
        }
    }
}

impl Instance {
    /// True if VK_KHR_shader_maximal_reconvergence can be used: older validation layers reject its SPIR-V.
    pub(super) fn knows_reconvergence(&self) -> bool {
        self.layer.is_none_or(|version| version >= vk::make_api_version(0, 1, 3, 280))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.messenger = None;
        // SAFETY: the messenger is gone, and the owner of this struct has destroyed its device before.
        unsafe { self.raw.destroy_instance(None) }
    }
}

/// True if the Khronos validation layer is installed; false without a loader.
pub fn validation_available() -> bool {
    // SAFETY: as in `Instance::new`.
    unsafe { ash::Entry::load() }.is_ok_and(|entry| layer_version(&entry).is_ok_and(|v| v.is_some()))
}

/// Returns the checks of the layer; None without the layer.
fn checks(layer: bool, validation: bool, printf: bool) -> Option<Vec<vk::ValidationFeatureEnableEXT>> {
    let wanted = [
        (validation, vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION),
        (printf, vk::ValidationFeatureEnableEXT::DEBUG_PRINTF),
    ];
    layer.then(|| wanted.into_iter().filter(|(wanted, _)| *wanted).map(|(_, check)| check).collect())
}

fn create(
    entry: &ash::Entry,
    checks: &Option<Vec<vk::ValidationFeatureEnableEXT>>,
    mut extensions: Vec<*const c_char>,
    portability: bool,
) -> Result<ash::Instance> {
    let application = vk::ApplicationInfo::default()
        .application_name(c"ashsplat")
        .engine_name(c"ashsplat")
        .api_version(vk::API_VERSION_1_3);
    let mut flags = vk::InstanceCreateFlags::empty();
    if portability {
        extensions.push(ash::khr::portability_enumeration::NAME.as_ptr());
        flags |= vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR;
    }
    let layers = if checks.is_some() { vec![VALIDATION_LAYER.as_ptr()] } else { Vec::new() };
    let enabled = checks.as_deref().unwrap_or_default();
    let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(enabled);
    let mut info = vk::InstanceCreateInfo::default()
        .flags(flags)
        .application_info(&application)
        .enabled_extension_names(&extensions)
        .enabled_layer_names(&layers);
    if checks.is_some() {
        info = info.push_next(&mut features);
    }
    // SAFETY: every pointer in `info` outlives the call.
    unsafe { entry.create_instance(&info, None) }.map_err(|error| match error {
        vk::Result::ERROR_INCOMPATIBLE_DRIVER => {
            Error::NoDevice { reason: "the loader found no driver for Vulkan 1.3".into() }
        }
        error => vk_error("vkCreateInstance")(error),
    })
}

fn layer_version(entry: &ash::Entry) -> Result<Option<u32>> {
    // SAFETY: a plain query.
    let layers = unsafe { entry.enumerate_instance_layer_properties() };
    let layers = layers.map_err(vk_error("vkEnumerateInstanceLayerProperties"))?;
    let layer = layers.iter().find(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER));
    Ok(layer.map(|layer| layer.spec_version))
}

fn has_extension(entry: &ash::Entry, layer: Option<&CStr>, name: &CStr) -> Result<bool> {
    // SAFETY: a plain query; `layer` is a C string.
    let extensions = unsafe { entry.enumerate_instance_extension_properties(layer) };
    let extensions = extensions.map_err(vk_error("vkEnumerateInstanceExtensionProperties"))?;
    Ok(extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name)))
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
