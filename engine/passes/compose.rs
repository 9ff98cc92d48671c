//! Composites a frame into a host's picture: the host's depth image limits the blending, and the kernels write the blended
//! pixels into the host's images.

use crate::error::{Error, Result};
use crate::frame::{FrameInputs, FrameVariant, Outputs, SurfaceDepth, tile_grid};
use crate::kernels::compose::{
    compose_bgra8, compose_r11g11b10f, compose_rgb10a2, compose_rgba8, compose_rgba16f, compose_rgba32f,
    depth_limit, expected_depth, mean_motion, picks, surface_rgba16f, surface_rgba32f,
};
use crate::kernels::constants as c;
use crate::scene::{ColorEncoding, DepthMapping};
use crate::vk::{Buffer, Context, Image, ImageUse, Kernel, KernelSet, Recorder};
use ash::vk;

/// Background behind the splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// This colour; the result is opaque. The colour is display-encoded, as trained, even if the picture is then decoded to
    /// linear light.
    Color([f32; 3]),
    /// None: premultiplied colour with alpha 1 - T, for a host that composites it. In linear light it is (1 - T) f(C / (1 - T))
    /// with the sRGB curve f: the colour that covers the pixel is decoded, and premultiplied again.
    Nothing,
    /// Content of the image: out = C + T image, and the same for alpha. In linear light the content is linear, and C is the
    /// colour of [`Background::Nothing`].
    Image,
}

/// The part of an image that receives a frame.
#[derive(Clone, Copy, Debug)]
pub struct Region<'a> {
    /// The image.
    pub image: &'a Image,
    /// Texel of the image that receives the frame's pixel (0, 0).
    pub offset: [u32; 2],
    /// Width and height of the frame, pixels.
    pub size: [u32; 2],
}

/// Contents that a frame writes into a host's image: the list of a frame's outputs. [`ImageUse`] has the name and the formats of each,
/// [`Contents::require`] the variant of blending, [`Compose::record`] the buffer and the kernel. Pixels with a sum of weights below
/// `min_weight` are empty.
#[derive(Clone, Copy)]
pub(crate) enum Contents {
    Color {
        behind: Background,
        encoding: ColorEncoding,
    },
    ExpectedDepth {
        min_weight: f32,
        empty: f32,
    },
    Picks,
    /// Empty pixels keep their texels without `empty`.
    MeanMotion {
        min_weight: f32,
        empty: Option<[f32; 2]>,
    },
    Surface(SurfaceDepth),
}

impl Contents {
    /// Returns the purpose of images with these contents.
    pub fn purpose(self) -> ImageUse {
        match self {
            Self::Color { .. } => ImageUse::Target,
            Self::ExpectedDepth { .. } => ImageUse::Depth,
            Self::Picks => ImageUse::Pick,
            Self::MeanMotion { .. } => ImageUse::Motion,
            Self::Surface(_) => ImageUse::Surface,
        }
    }

    /// Sets what blending computes for these contents.
    pub fn require(self, variant: &mut FrameVariant) {
        match self {
            Self::Color { .. } => {}
            Self::ExpectedDepth { .. } => (variant.inverse_depth, variant.expected_depth) = (true, true),
            Self::Picks => variant.outputs.pick = true,
            Self::MeanMotion { .. } => variant.outputs.motion = true,
            Self::Surface(depth) => (variant.outputs.surface, variant.surface_depth) = (true, depth),
        }
    }

    /// True if some texels of the frame's region may keep their values.
    pub fn keeps_texels(self) -> bool {
        matches!(self, Self::Color { behind: Background::Image, .. } | Self::MeanMotion { empty: None, .. })
    }

    /// Checks the numbers, and the format of an image with this purpose.
    pub fn check(self, image: &Image) -> Result<()> {
        match self {
            Self::Color { behind, encoding } => {
                encoding.check().map_err(|error| error.within("encoding"))?;
                check_background(behind, image)
            }
            Self::Picks | Self::Surface(_) => Ok(()),
            Self::ExpectedDepth { min_weight, .. } | Self::MeanMotion { min_weight, .. }
                if !min_weight.is_finite() =>
            {
                Err(Error::argument("min_weight", format!("{min_weight} is not finite")))
            }
            Self::MeanMotion { empty: Some(empty), .. }
                if !empty.iter().all(|x| x.abs() <= c::MOTION_MAX) =>
            {
                Err(Error::argument("empty", format!("{empty:?}, each may be -{0} to {0}", c::MOTION_MAX)))
            }
            Self::ExpectedDepth { .. } | Self::MeanMotion { .. } => Ok(()),
        }
    }
}

fn check_background(behind: Background, image: &Image) -> Result<()> {
    match behind {
        Background::Color(color) if color.iter().any(|channel| !channel.is_finite()) => {
            Err(Error::argument("behind", format!("{color:?} is not finite")))
        }
        Background::Nothing if image.format() == vk::Format::B10G11R11_UFLOAT_PACK32 => {
            let problem = format!("format {:?} has no alpha for premultiplied colours", image.format());
            Err(Error::argument(format!("image '{}'", image.name()), problem))
        }
        _ => Ok(()),
    }
}

/// Kernels between a frame and a host's images.
pub struct Compose {
    workgroup: u32,
    rgba8: ByEncoding<compose_rgba8::Interface>,
    bgra8: ByEncoding<compose_bgra8::Interface>,
    rgb10a2: ByEncoding<compose_rgb10a2::Interface>,
    r11g11b10f: ByEncoding<compose_r11g11b10f::Interface>,
    rgba16f: ByEncoding<compose_rgba16f::Interface>,
    rgba32f: ByEncoding<compose_rgba32f::Interface>,
    /// For perspective and for orthographic projections.
    depth_limits: [Kernel<depth_limit::Interface>; 2],
    expected_depth: Kernel<expected_depth::Interface>,
    /// Built on request.
    picks: KernelSet<picks::Interface>,
    /// Built on request.
    mean_motion: KernelSet<mean_motion::Interface>,
    /// Built on request, for images of halves.
    surfaces_16: KernelSet<surface_rgba16f::Interface>,
    /// Built on request, for images of floats.
    surfaces_32: KernelSet<surface_rgba32f::Interface>,
}

/// One kernel for each of `COMPOSE_AS_TRAINED`, `COMPOSE_LINEAR` and, if the format can be display-encoded,
/// `COMPOSE_LINEAR_IN_SRGB`.
type ByEncoding<I> = Vec<Kernel<I>>;

/// True if the texels of a format are display-encoded and a host reads them decoded.
fn is_srgb(format: vk::Format) -> bool {
    matches!(format, vk::Format::R8G8B8A8_SRGB | vk::Format::B8G8R8A8_SRGB)
}

/// Returns the encoding constant of a kernel for a format, and the factor of the light.
fn encoding_word(encoding: ColorEncoding, format: vk::Format) -> (u32, f32) {
    match encoding {
        ColorEncoding::AsTrained => (c::COMPOSE_AS_TRAINED, 1.0),
        ColorEncoding::LinearSrgb { exposure } if is_srgb(format) => (c::COMPOSE_LINEAR_IN_SRGB, exposure),
        ColorEncoding::LinearSrgb { exposure } => (c::COMPOSE_LINEAR, exposure),
    }
}

impl Compose {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let workgroup_size = context.limits().workgroup_size(256);
        macro_rules! by_encoding {
            ($interface:ident, $last:expr) => {
                (c::COMPOSE_AS_TRAINED..=$last)
                    .map(|encoding| Kernel::new(context, &$interface::Spec { workgroup_size, encoding }))
                    .collect::<Result<_>>()?
            };
        }
        let limits = |linear| Kernel::new(context, &depth_limit::Spec { workgroup_size, linear });
        Ok(Self {
            workgroup: workgroup_size,
            rgba8: by_encoding!(compose_rgba8, c::COMPOSE_LINEAR_IN_SRGB),
            bgra8: by_encoding!(compose_bgra8, c::COMPOSE_LINEAR_IN_SRGB),
            rgb10a2: by_encoding!(compose_rgb10a2, c::COMPOSE_LINEAR),
            r11g11b10f: by_encoding!(compose_r11g11b10f, c::COMPOSE_LINEAR),
            rgba16f: by_encoding!(compose_rgba16f, c::COMPOSE_LINEAR),
            rgba32f: by_encoding!(compose_rgba32f, c::COMPOSE_LINEAR),
            depth_limits: [limits(false)?, limits(true)?],
            expected_depth: Kernel::new(context, &expected_depth::Spec { workgroup_size })?,
            picks: KernelSet::default(),
            mean_motion: KernelSet::default(),
            surfaces_16: KernelSet::default(),
            surfaces_32: KernelSet::default(),
        })
    }

    fn workgroups(&self, [width, height]: [u32; 2]) -> u64 {
        (u64::from(width) * u64::from(height)).div_ceil(self.workgroup.into())
    }

    /// Records contents of a blended frame into an image that is ready for kernels. [`Contents::check`] must accept it.
    pub(crate) fn record(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        region: Region<'_>,
        contents: Contents,
    ) {
        let f = inputs.buffers;
        match contents {
            Contents::Color { behind, encoding } => {
                self.record_color(r, &f.accumulated, region, behind, encoding)
            }
            Contents::ExpectedDepth { min_weight, empty } => {
                self.record_expected_depth(r, &f.accumulated, &f.depth_sums, region, min_weight, empty);
            }
            Contents::Picks => self.record_picks(r, inputs, region),
            Contents::MeanMotion { min_weight, empty } => {
                self.record_motion(r, &f.accumulated, &f.motion_sums, region, min_weight, empty);
            }
            Contents::Surface(_) => self.record_surface(r, &f.surfaces, region),
        }
    }

    /// Records the colours of a frame into an image that is ready for kernels. A format without alpha excludes
    /// [`Background::Nothing`].
    pub fn record_color(
        &self,
        r: &mut Recorder,
        accumulated: &Buffer,
        region: Region<'_>,
        behind: Background,
        encoding: ColorEncoding,
    ) {
        let (mode, background) = match behind {
            Background::Color(color) => (c::COMPOSE_BACKGROUND, color),
            Background::Nothing => (c::COMPOSE_PREMULTIPLIED, [0.0; 3]),
            Background::Image => (c::COMPOSE_OVER, [0.0; 3]),
        };
        let ([image_width, image_height], [offset_x, offset_y]) = (region.size, region.offset);
        let (word, exposure) = encoding_word(encoding, region.image.format());
        macro_rules! compose {
            ($interface:ident, $kernels:ident) => {{
                let bind = $interface::Bind { accumulated, target: region.image };
                let push = $interface::Push {
                    image_width,
                    image_height,
                    offset_x,
                    offset_y,
                    mode,
                    background,
                    exposure,
                };
                r.dispatch(&self.$kernels[word as usize], &bind, &push, self.workgroups(region.size));
            }};
        }
        match region.image.format() {
            vk::Format::B8G8R8A8_UNORM | vk::Format::B8G8R8A8_SRGB => compose!(compose_bgra8, bgra8),
            vk::Format::A2B10G10R10_UNORM_PACK32 => compose!(compose_rgb10a2, rgb10a2),
            vk::Format::B10G11R11_UFLOAT_PACK32 => compose!(compose_r11g11b10f, r11g11b10f),
            vk::Format::R16G16B16A16_SFLOAT => compose!(compose_rgba16f, rgba16f),
            vk::Format::R32G32B32A32_SFLOAT => compose!(compose_rgba32f, rgba32f),
            _ => compose!(compose_rgba8, rgba8),
        }
    }

    /// Records the depth limit of each pixel from a host's depth image that is ready for kernels: 1/z, or 0 without a surface.
    pub fn record_depth_limits(
        &self,
        r: &mut Recorder,
        region: Region<'_>,
        mapping: DepthMapping,
        depth_limits: &Buffer,
    ) {
        let ([image_width, image_height], [offset_x, offset_y]) = (region.size, region.offset);
        let DepthMapping { scale, offset, clear_value, linear } = mapping;
        let bind = depth_limit::Bind { depth_limits, depth: region.image };
        let push =
            depth_limit::Push { image_width, image_height, offset_x, offset_y, scale, offset, clear_value };
        r.dispatch(&self.depth_limits[usize::from(linear)], &bind, &push, self.workgroups(region.size));
    }

    /// Records the expected depth sum(w z) / sum(w) of a frame that was blended with `expected_depth`, into an r32f image that is
    /// ready for kernels. Pixels with a sum of weights below `min_weight` receive `empty`.
    pub fn record_expected_depth(
        &self,
        r: &mut Recorder,
        accumulated: &Buffer,
        depth_sums: &Buffer,
        region: Region<'_>,
        min_weight: f32,
        empty: f32,
    ) {
        let ([image_width, image_height], [offset_x, offset_y]) = (region.size, region.offset);
        let bind = expected_depth::Bind { accumulated, depth_sums, target: region.image };
        let push = expected_depth::Push { image_width, image_height, offset_x, offset_y, min_weight, empty };
        r.dispatch(&self.expected_depth, &bind, &push, self.workgroups(region.size));
    }

    /// Builds the missing kernels of outputs besides the picture.
    pub fn prepare(&mut self, context: &Context, outputs: Outputs) -> Result<()> {
        let workgroup_size = self.workgroup;
        if outputs.pick {
            self.picks.prepare(context, picks::Spec { workgroup_size })?;
        }
        if outputs.motion {
            self.mean_motion.prepare(context, mean_motion::Spec { workgroup_size })?;
        }
        if outputs.surface {
            self.surfaces_16.prepare(context, surface_rgba16f::Spec { workgroup_size })?;
            self.surfaces_32.prepare(context, surface_rgba32f::Spec { workgroup_size })?;
        }
        Ok(())
    }

    /// Records the picks of a frame without backward.
    fn record_picks(&self, r: &mut Recorder, inputs: &FrameInputs, region: Region<'_>) {
        let spec = picks::Spec { workgroup_size: self.workgroup };
        let Some(kernel) = r.kernel(&self.picks, &spec) else { return };
        let f = inputs.buffers;
        let splats = f.splats();
        let ([image_width, image_height], [offset_x, offset_y]) = (region.size, region.offset);
        let bind = picks::Bind {
            picks: &f.picks,
            tile_ranges: &f.tile_ranges,
            sorted_visible: f.sorted_visible(inputs.keeps_instances()),
            visible_list: &f.visible_list,
            color_inverse_depth: splats.color_inverse_depth,
            scene_firsts: &f.scene_firsts,
            target: region.image,
        };
        let push = picks::Push {
            image_width,
            image_height,
            offset_x,
            offset_y,
            tiles_per_row: tile_grid(image_width, image_height).0,
            splat_stride: splats.stride,
            scenes: inputs.scenes.len() as u32,
        };
        r.dispatch(kernel, &bind, &push, self.workgroups(region.size));
    }

    /// Records the mean motion sum(w m) / sum(w), px, of a frame that was blended with motion, into an image of
    /// [`MOTION_FORMAT`](crate::vk::MOTION_FORMAT) that is ready for kernels. Pixels with a sum of weights below `min_weight`
    /// receive `empty`, or stay without it.
    pub fn record_motion(
        &self,
        r: &mut Recorder,
        accumulated: &Buffer,
        motion_sums: &Buffer,
        region: Region<'_>,
        min_weight: f32,
        empty: Option<[f32; 2]>,
    ) {
        let spec = mean_motion::Spec { workgroup_size: self.workgroup };
        let Some(kernel) = r.kernel(&self.mean_motion, &spec) else { return };
        let ([image_width, image_height], [offset_x, offset_y]) = (region.size, region.offset);
        let bind = mean_motion::Bind { accumulated, motion_sums, target: region.image };
        let push = mean_motion::Push {
            image_width,
            image_height,
            offset_x,
            offset_y,
            min_weight,
            empty: empty.unwrap_or_default(),
            keeps: empty.is_none().into(),
        };
        r.dispatch(kernel, &bind, &push, self.workgroups(region.size));
    }

    /// Records the surface of a frame that was blended with surfaces, into an image of one of
    /// [`SURFACE_FORMATS`](crate::vk::SURFACE_FORMATS) that is ready for kernels. Pixels without a surface receive zeros.
    fn record_surface(&self, r: &mut Recorder, surfaces: &Buffer, region: Region<'_>) {
        let ([image_width, image_height], [offset_x, offset_y]) = (region.size, region.offset);
        let workgroup_size = self.workgroup;
        macro_rules! compose {
            ($interface:ident, $kernels:ident) => {{
                let Some(kernel) = r.kernel(&self.$kernels, &$interface::Spec { workgroup_size }) else {
                    return;
                };
                let bind = $interface::Bind { surfaces, target: region.image };
                let push = $interface::Push { image_width, image_height, offset_x, offset_y };
                r.dispatch(kernel, &bind, &push, self.workgroups(region.size));
            }};
        }
        match region.image.format() {
            vk::Format::R16G16B16A16_SFLOAT => compose!(surface_rgba16f, surfaces_16),
            _ => compose!(surface_rgba32f, surfaces_32),
        }
    }
}
