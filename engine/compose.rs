//! Composites a frame into a host's picture: the host's depth image limits the blending, and the blended
//! pixels are written into the host's images.

use crate::error::{Error, Result};
use crate::kernels::compose::{compose_rgba8, compose_rgba16f, compose_rgba32f, depth_limit, expected_depth};
use crate::kernels::constants as c;
use crate::plan::blocks;
use crate::scene::DepthMapping;
use crate::vk::{Buffer, Context, Image, Kernel, Recorder};
use ash::vk;

/// What the splats are composited over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// A background of this colour; the result is opaque.
    Color([f32; 3]),
    /// Nothing: premultiplied colour with alpha 1 - T, for a host that composites it.
    Nothing,
    /// The image's content: out = C + T image, and the same for alpha.
    Image,
}

/// A part of an image, of the frame's size.
#[derive(Clone, Copy, Debug)]
pub struct Region<'a> {
    /// The image.
    pub image: &'a Image,
    /// Texel of the image that receives the frame's pixel (0, 0).
    pub offset: [u32; 2],
}

/// The kernels between a frame and a host's images.
pub struct Compose {
    workgroup: u32,
    rgba8: Kernel<compose_rgba8::Interface>,
    rgba16f: Kernel<compose_rgba16f::Interface>,
    rgba32f: Kernel<compose_rgba32f::Interface>,
    depth_limit: Kernel<depth_limit::Interface>,
    expected_depth: Kernel<expected_depth::Interface>,
}

fn check_format(image: &Image, possible: &[vk::Format]) -> Result<()> {
    if possible.contains(&image.format()) {
        return Ok(());
    }
    let problem = format!("format {:?} is not one of {possible:?}", image.format());
    Err(Error::argument(format!("image '{}'", image.name()), problem))
}

impl Compose {
    /// Formats of colour images.
    pub const COLOR_FORMATS: [vk::Format; 3] =
        [vk::Format::R8G8B8A8_UNORM, vk::Format::R16G16B16A16_SFLOAT, vk::Format::R32G32B32A32_SFLOAT];
    /// Formats of a host's depth image, each read as one float.
    pub const HOST_DEPTH_FORMATS: [vk::Format; 9] = [
        vk::Format::D16_UNORM,
        vk::Format::X8_D24_UNORM_PACK32,
        vk::Format::D32_SFLOAT,
        vk::Format::D16_UNORM_S8_UINT,
        vk::Format::D24_UNORM_S8_UINT,
        vk::Format::D32_SFLOAT_S8_UINT,
        vk::Format::R16_UNORM,
        vk::Format::R16_SFLOAT,
        vk::Format::R32_SFLOAT,
    ];
    /// Format of an image of expected depth.
    pub const DEPTH_FORMAT: vk::Format = vk::Format::R32_SFLOAT;

    /// Builds the kernels.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        let workgroup_size = context.limits().workgroup_size(256);
        Ok(Self {
            workgroup: workgroup_size,
            rgba8: Kernel::new(context, &compose_rgba8::Spec { workgroup_size })?,
            rgba16f: Kernel::new(context, &compose_rgba16f::Spec { workgroup_size })?,
            rgba32f: Kernel::new(context, &compose_rgba32f::Spec { workgroup_size })?,
            depth_limit: Kernel::new(context, &depth_limit::Spec { workgroup_size })?,
            expected_depth: Kernel::new(context, &expected_depth::Spec { workgroup_size })?,
        })
    }

    /// Checks that a colour image can be written.
    ///
    /// # Errors
    /// [`Error::Argument`] for another format than [`Compose::COLOR_FORMATS`].
    pub fn check_color(image: &Image) -> Result<()> {
        check_format(image, &Self::COLOR_FORMATS)
    }

    /// Checks that a host's depth image can be read.
    ///
    /// # Errors
    /// [`Error::Argument`] for a format without depth, or one that is not read as a float.
    pub fn check_depth(image: &Image) -> Result<()> {
        check_format(image, &Self::HOST_DEPTH_FORMATS)
    }

    fn workgroups(&self, [width, height]: [u32; 2]) -> u64 {
        blocks(u64::from(width) * u64::from(height), self.workgroup.into())
    }

    /// Records the colours of a frame into an image that [`Compose::check_color`] accepts. The image must be
    /// ready for kernels.
    pub fn record_color(
        &self,
        r: &mut Recorder,
        accumulated: &Buffer,
        size: [u32; 2],
        region: Region<'_>,
        behind: Background,
    ) {
        let (mode, background) = match behind {
            Background::Color(color) => (c::COMPOSE_BACKGROUND, color),
            Background::Nothing => (c::COMPOSE_PREMULTIPLIED, [0.0; 3]),
            Background::Image => (c::COMPOSE_OVER, [0.0; 3]),
        };
        let [image_width, image_height] = size;
        let [offset_x, offset_y] = region.offset;
        macro_rules! compose {
            ($interface:ident, $kernel:ident) => {{
                let bind = $interface::Bind { accumulated, target: region.image };
                let push =
                    $interface::Push { image_width, image_height, offset_x, offset_y, mode, background };
                r.dispatch(&self.$kernel, &bind, &push, self.workgroups(size));
            }};
        }
        match region.image.format() {
            vk::Format::R16G16B16A16_SFLOAT => compose!(compose_rgba16f, rgba16f),
            vk::Format::R32G32B32A32_SFLOAT => compose!(compose_rgba32f, rgba32f),
            _ => compose!(compose_rgba8, rgba8),
        }
    }

    /// Records the depth limit of each pixel from a host's depth image that is ready for kernels: 1/z, or 0
    /// for no surface.
    pub fn record_depth_limits(
        &self,
        r: &mut Recorder,
        region: Region<'_>,
        mapping: DepthMapping,
        size: [u32; 2],
        depth_limits: &Buffer,
    ) {
        let [image_width, image_height] = size;
        let [offset_x, offset_y] = region.offset;
        let DepthMapping { scale, offset, clear_value } = mapping;
        let bind = depth_limit::Bind { depth_limits, depth: region.image };
        let push =
            depth_limit::Push { image_width, image_height, offset_x, offset_y, scale, offset, clear_value };
        r.dispatch(&self.depth_limit, &bind, &push, self.workgroups(size));
    }

    /// Records the expected depth sum(w z) / sum(w) of a frame that was blended with `linear_depth`, into an
    /// r32f image that is ready for kernels. Pixels whose sum of weights is below `min_weight` receive
    /// `empty`.
    pub fn record_expected_depth(
        &self,
        r: &mut Recorder,
        [accumulated, depth_sums]: [&Buffer; 2],
        size: [u32; 2],
        region: Region<'_>,
        [min_weight, empty]: [f32; 2],
    ) {
        let [image_width, image_height] = size;
        let [offset_x, offset_y] = region.offset;
        let bind = expected_depth::Bind { accumulated, depth_sums, target: region.image };
        let push = expected_depth::Push { image_width, image_height, offset_x, offset_y, min_weight, empty };
        r.dispatch(&self.expected_depth, &bind, &push, self.workgroups(size));
    }
}
