//! Reads compiler statistics of pipelines: VK_KHR_pipeline_executable_properties.

use super::debug::vk_error;
use crate::Result;
use ash::vk;
use std::ffi::{CStr, c_char};

/// Options of [`ContextOptions::compile_only`](super::ContextOptions::compile_only).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CompileOnly {
    /// True to collect the compilers' texts, which include machine code.
    pub texts: bool,
}

/// One program of a pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct Executable {
    /// The driver's name for it.
    pub name: String,
    /// Its subgroup size; 0: unknown to the driver.
    pub subgroup_size: u32,
    /// Its statistics, in the driver's order and words.
    pub statistics: Vec<Statistic>,
    /// With [`CompileOnly::texts`]: (name, text), including machine code.
    pub texts: Vec<(String, String)>,
}

/// A statistic of a compiler.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistic {
    /// The driver's name for it.
    pub name: String,
    /// Its meaning, in the driver's words.
    pub description: String,
    /// Value. Drivers give integers, except for estimates.
    pub value: f64,
}

/// The extension's functions.
pub(super) struct Executables {
    functions: ash::khr::pipeline_executable_properties::Device,
    asked: CompileOnly,
}

impl Executables {
    pub(super) fn new(instance: &ash::Instance, device: &ash::Device, asked: CompileOnly) -> Self {
        Self { functions: ash::khr::pipeline_executable_properties::Device::new(instance, device), asked }
    }

    /// Returns the flags for the creation of pipelines.
    pub(super) fn flags(&self) -> vk::PipelineCreateFlags {
        let texts = match self.asked.texts {
            true => vk::PipelineCreateFlags::CAPTURE_INTERNAL_REPRESENTATIONS_KHR,
            false => vk::PipelineCreateFlags::empty(),
        };
        vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR | texts
    }

    pub(super) fn of(&self, pipeline: vk::Pipeline) -> Result<Vec<Executable>> {
        let info = vk::PipelineInfoKHR::default().pipeline(pipeline);
        // SAFETY: the pipeline lives as long as the device, and was created with the flags.
        let properties = unsafe { self.functions.get_pipeline_executable_properties(&info) }
            .map_err(vk_error("vkGetPipelineExecutablePropertiesKHR"))?;
        let each = properties.iter().enumerate().map(|(index, properties)| {
            let info =
                vk::PipelineExecutableInfoKHR::default().pipeline(pipeline).executable_index(index as u32);
            Ok(Executable {
                name: text(&properties.name),
                subgroup_size: properties.subgroup_size,
                statistics: self.statistics(&info)?,
                texts: if self.asked.texts { self.texts(&info)? } else { Vec::new() },
            })
        });
        each.collect()
    }

    fn statistics(&self, info: &vk::PipelineExecutableInfoKHR<'_>) -> Result<Vec<Statistic>> {
        // SAFETY: as above.
        let statistics = unsafe { self.functions.get_pipeline_executable_statistics(info) }
            .map_err(vk_error("vkGetPipelineExecutableStatisticsKHR"))?;
        let of = |statistic: &vk::PipelineExecutableStatisticKHR<'_>| {
            use vk::PipelineExecutableStatisticFormatKHR as Format;
            // SAFETY: the format says which member the driver has written.
            let value = unsafe {
                match statistic.format {
                    Format::BOOL32 => f64::from(statistic.value.b32),
                    Format::INT64 => statistic.value.i64 as f64,
                    Format::UINT64 => statistic.value.u64 as f64,
                    _ => statistic.value.f64,
                }
            };
            Statistic { name: text(&statistic.name), description: text(&statistic.description), value }
        };
        Ok(statistics.iter().map(of).collect())
    }

    fn texts(&self, info: &vk::PipelineExecutableInfoKHR<'_>) -> Result<Vec<(String, String)>> {
        let failed = vk_error("vkGetPipelineExecutableInternalRepresentationsKHR");
        // SAFETY: as above. The first call gives the sizes, the second one writes into memory of these.
        unsafe {
            let get = self.functions.fp().get_pipeline_executable_internal_representations_khr;
            let mut all =
                self.functions.get_pipeline_executable_internal_representations(info).map_err(failed)?;
            let mut bytes: Vec<Vec<u8>> = all.iter().map(|one| vec![0; one.data_size]).collect();
            for (one, bytes) in all.iter_mut().zip(&mut bytes) {
                one.p_data = bytes.as_mut_ptr().cast();
            }
            let mut count = all.len() as u32;
            let result = get(self.functions.device(), info, &mut count, all.as_mut_ptr());
            result.result().map_err(vk_error("vkGetPipelineExecutableInternalRepresentationsKHR"))?;
            let is_text = |(one, _): &(&vk::PipelineExecutableInternalRepresentationKHR<'_>, &Vec<u8>)| {
                one.is_text != 0
            };
            let named = |(one, bytes): (&vk::PipelineExecutableInternalRepresentationKHR<'_>, &Vec<u8>)| {
                let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
                (text(&one.name), String::from_utf8_lossy(&bytes[..end]).into_owned())
            };
            Ok(all.iter().zip(&bytes).filter(is_text).map(named).collect())
        }
    }
}

/// Returns a driver's text up to its first zero.
fn text(characters: &[c_char]) -> String {
    let bytes: Vec<u8> = characters.iter().map(|&c| c as u8).collect();
    CStr::from_bytes_until_nul(&bytes).unwrap_or_default().to_string_lossy().into_owned()
}
