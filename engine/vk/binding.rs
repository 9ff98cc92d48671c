//! Resources of a shader.

use super::format::ImageKind;
use super::hazard::Access;
use super::texels::TexelFormat;
use ash::vk;

/// A buffer of a shader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BindingInfo {
    /// Its name, and the name of the field in `Bind`.
    pub name: &'static str,
    /// Its number in set 0.
    pub binding: u32,
    /// How the shader accesses it.
    pub access: Access,
    /// True if another binding of the shader may be the same memory while one of them is written.
    pub aliased: bool,
    /// How it is bound.
    pub kind: BindingKind,
}

/// How a buffer is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// Storage buffer.
    Storage,
    /// Texel buffer.
    Texels(TexelFormat),
    /// Uniform block.
    Uniform {
        /// Size of the block.
        bytes: u32,
    },
}

impl BindingKind {
    pub(super) fn descriptor_type(self) -> vk::DescriptorType {
        match self {
            Self::Storage => vk::DescriptorType::STORAGE_BUFFER,
            Self::Texels(_) => vk::DescriptorType::UNIFORM_TEXEL_BUFFER,
            Self::Uniform { .. } => vk::DescriptorType::UNIFORM_BUFFER,
        }
    }

    /// Returns the size of the uniform block; 0 for other buffers.
    pub(super) fn uniform_bytes(self) -> u64 {
        match self {
            Self::Uniform { bytes } => bytes.into(),
            _ => 0,
        }
    }
}

/// An image of a shader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageInfo {
    /// Its name, and the name of the field in `Bind`.
    pub name: &'static str,
    /// Its number in set 0.
    pub binding: u32,
    /// How the shader accesses it.
    pub access: Access,
    /// How it is bound.
    pub kind: ImageKind,
}
