//! Properties of formats, and how kernels use images.

use ash::vk::{self, Format as F};

/// How a shader accesses a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Access {
    /// `readonly`.
    Read,
    /// `writeonly`.
    Write,
    /// Neither.
    ReadWrite,
}

impl Access {
    /// True if it writes.
    pub fn writes(self) -> bool {
        self != Self::Read
    }
}

/// Purpose of an image in a frame: one variant for each field of a recorded frame. Each has its own formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageUse {
    /// Kernels write colours.
    Target,
    /// A host's depth, which hides splats.
    Occluder,
    /// Kernels write the expected depth.
    Depth,
    /// Kernels write what is seen at each pixel.
    Pick,
    /// Kernels write the motion of each pixel.
    Motion,
    /// Kernels write the normal and the depth of the surface at each pixel.
    Surface,
}

/// How kernels bind an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ImageKind {
    /// Read and written as a storage image, in the layout GENERAL.
    Storage,
    /// Read by texel. The layout is DEPTH_STENCIL_READ_ONLY_OPTIMAL if the image is also a depth attachment,
    /// otherwise SHADER_READ_ONLY_OPTIMAL.
    Sampled,
}

impl ImageUse {
    /// All purposes.
    pub const ALL: [Self; 6] =
        [Self::Target, Self::Occluder, Self::Depth, Self::Pick, Self::Motion, Self::Surface];

    /// Returns the name of the field of a recorded frame.
    pub fn field(self) -> &'static str {
        match self {
            Self::Target => "target",
            Self::Occluder => "occluder",
            Self::Depth => "depth",
            Self::Pick => "pick",
            Self::Motion => "motion",
            Self::Surface => "surface",
        }
    }

    /// How kernels bind it.
    pub fn kind(self) -> ImageKind {
        match self {
            Self::Occluder => ImageKind::Sampled,
            _ => ImageKind::Storage,
        }
    }

    /// Returns the formats of images with this use.
    pub fn formats(self) -> &'static [F] {
        match self {
            Self::Target => &COLOR_FORMATS,
            Self::Occluder => &HOST_DEPTH_FORMATS,
            Self::Depth => &[DEPTH_FORMAT],
            Self::Pick => &[PICK_FORMAT],
            Self::Motion => &[MOTION_FORMAT],
            Self::Surface => &SURFACE_FORMATS,
        }
    }

    /// Returns the format in which kernels see an image's texels. If it differs from the image's, the image was created
    /// with MUTABLE_FORMAT.
    ///
    /// Shaders know few formats of storage images. All devices support those that are named here.
    pub fn seen_as(self, format: F) -> F {
        match (self.kind(), format) {
            (ImageKind::Sampled, _) => format,
            (_, F::R8G8B8A8_SRGB | F::B8G8R8A8_UNORM | F::B8G8R8A8_SRGB) => F::R8G8B8A8_UNORM,
            (_, F::A2B10G10R10_UNORM_PACK32 | F::B10G11R11_UFLOAT_PACK32 | MOTION_FORMAT) => F::R32_UINT,
            _ => format,
        }
    }
}

impl ImageKind {
    pub(super) fn usage(self) -> vk::ImageUsageFlags {
        match self {
            Self::Storage => vk::ImageUsageFlags::STORAGE,
            Self::Sampled => vk::ImageUsageFlags::SAMPLED,
        }
    }

    pub(super) fn descriptor_type(self) -> vk::DescriptorType {
        match self {
            Self::Storage => vk::DescriptorType::STORAGE_IMAGE,
            Self::Sampled => vk::DescriptorType::SAMPLED_IMAGE,
        }
    }

    pub(super) fn feature(self) -> vk::FormatFeatureFlags {
        match self {
            Self::Storage => vk::FormatFeatureFlags::STORAGE_IMAGE,
            Self::Sampled => vk::FormatFeatureFlags::SAMPLED_IMAGE,
        }
    }
}

/// Formats of a host's colour images that kernels write.
pub const COLOR_FORMATS: [F; 8] = [
    F::R8G8B8A8_UNORM,
    F::R8G8B8A8_SRGB,
    F::B8G8R8A8_UNORM,
    F::B8G8R8A8_SRGB,
    F::A2B10G10R10_UNORM_PACK32,
    F::B10G11R11_UFLOAT_PACK32,
    F::R16G16B16A16_SFLOAT,
    F::R32G32B32A32_SFLOAT,
];

/// Format of depth images that kernels write.
pub const DEPTH_FORMAT: F = F::R32_SFLOAT;

/// Format of pick images that kernels write.
pub const PICK_FORMAT: F = F::R32G32B32A32_UINT;

/// Format of motion images that kernels write.
pub const MOTION_FORMAT: F = F::R16G16_SFLOAT;

/// Formats of surface images that kernels write.
pub const SURFACE_FORMATS: [F; 2] = [F::R16G16B16A16_SFLOAT, F::R32G32B32A32_SFLOAT];

/// Formats of a host's depth image, each read as one float.
pub const HOST_DEPTH_FORMATS: [F; 9] = [
    F::D16_UNORM,
    F::X8_D24_UNORM_PACK32,
    F::D32_SFLOAT,
    F::D16_UNORM_S8_UINT,
    F::D24_UNORM_S8_UINT,
    F::D32_SFLOAT_S8_UINT,
    F::R16_UNORM,
    F::R16_SFLOAT,
    F::R32_SFLOAT,
];

/// Returns the aspect that kernels see.
pub(super) fn aspect(format: vk::Format) -> vk::ImageAspectFlags {
    match format {
        F::D16_UNORM | F::X8_D24_UNORM_PACK32 | F::D32_SFLOAT => vk::ImageAspectFlags::DEPTH,
        _ if has_stencil(format) => vk::ImageAspectFlags::DEPTH,
        _ => vk::ImageAspectFlags::COLOR,
    }
}

/// Returns the bytes per texel, in a copy, of the aspect that kernels see.
pub(super) fn texel_bytes(format: vk::Format) -> u64 {
    match format {
        F::D16_UNORM | F::D16_UNORM_S8_UINT | F::R16_UNORM | F::R16_SFLOAT => 2,
        F::R16G16B16A16_SFLOAT => 8,
        F::R32G32B32A32_SFLOAT | F::R32G32B32A32_UINT => 16,
        _ => 4,
    }
}

/// True if the format has both depth and stencil.
pub(super) fn has_stencil(format: vk::Format) -> bool {
    matches!(format, F::D16_UNORM_S8_UINT | F::D24_UNORM_S8_UINT | F::D32_SFLOAT_S8_UINT)
}

/// Format of the texels of a buffer that kernels read as texels.
///
/// A shader declares `uniform textureBuffer name;` (vec4 of f32) or `uniform utextureBuffer name;` (u32), reads with
/// `texelFetch(name, index)`, and is bound to an ordinary [`super::Buffer`]. On a GPU this is equivalent to a storage
/// buffer. llvmpipe fetches a texel for all lanes by vector instructions. It reads every component of a storage buffer in a
/// loop over the lanes: a vec4 by texel costs a quarter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TexelFormat {
    /// Four f32: `textureBuffer`.
    Rgba32Float,
    /// One u32: `utextureBuffer`.
    R32Uint,
}

impl TexelFormat {
    /// Bytes of a texel.
    pub fn bytes(self) -> u64 {
        match self {
            Self::Rgba32Float => 16,
            Self::R32Uint => 4,
        }
    }

    pub(super) fn raw(self) -> vk::Format {
        match self {
            Self::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
            Self::R32Uint => vk::Format::R32_UINT,
        }
    }
}
