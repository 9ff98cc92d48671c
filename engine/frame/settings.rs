//! Render settings of a frame.

use super::{Outputs, ShStorage};
use crate::error::{Error, Result};
use crate::kernels::constants::{self as c, DILATION_PX2, TINTED_COLOR_MAX};
use crate::scene::{Camera, Cut, CutOut, JacobianLimit, MAX_CUT_OUTS, Projection};
use crate::vk::{Buffer, Context};

/// Pixels at which a Gaussian counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Extent {
    /// All pixels where its alpha is at least 1/255.
    #[default]
    Exact,
    /// Pixels of the tiles that touch the reference implementation's square of three standard deviations, for parity with the
    /// reference.
    Reference,
}

/// Render settings of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels at which a Gaussian counts.
    pub extent: Extent,
    /// Blends Gaussians in the order of their means' distances to the camera instead of their z, the reference's order. When the
    /// camera turns, z changes and Gaussians swap places, so colours pop (Radl et al. 2024, StopThePop); distances do not change. A
    /// scene is drawn best in the order of its training. Orthographic cameras keep z, because their rays have no centre. Fisheyes and
    /// panoramas always order by distance.
    pub distance_order: bool,
    /// Limits of the projection's linearisation.
    pub jacobian_limit: JacobianLimit,
    /// Opacity compensation for the low-pass filter (Mip-Splatting's 2D filter).
    pub antialias: bool,
    /// True if gradients treat that compensation as a constant. The kernels of gsplat and Mip-Splatting differentiate it.
    pub antialias_detached: bool,
    /// Variance that the low-pass filter of the projection adds along both axes, square pixels. 0.3 in the reference, 0.1 in
    /// Mip-Splatting (its `kernel_size`).
    pub dilation_px2: f32,
    /// Draws Gaussians with Mip-Splatting's 3D filter. [`Renderer::compute_filters`](crate::Renderer::compute_filters) sets its
    /// sizes; Gaussians without a size are drawn unfiltered.
    pub filter_3d: bool,
    /// Background colour, display-encoded like the training photographs.
    pub background: [f32; 3],
    /// Highest evaluated SH degree; `None` for all stored degrees.
    pub sh_degree: Option<u32>,
    /// Also renders the sum of weights / z.
    pub inverse_depth: bool,
    /// Shape that represents each Gaussian.
    pub shape: Shape,
    /// Factor of all scales; 1 leaves the scene unchanged.
    pub scale_modifier: f32,
    /// Volume and limits that remove Gaussians.
    pub cut: Cut,
    /// Random omission of Gaussians, for training frames.
    pub dropout: Option<Dropout>,
    /// With `inverse_depth`: renders the sum of weights * z instead, which is also differentiable. Not for recorded frames,
    /// which have depth images of their own.
    pub linear_depth: bool,
    /// Also renders normals and this depth ([`Surface`](crate::Surface)). Not for gradients; recorded frames have
    /// [`RecordedFrame::surface`](crate::RecordedFrame::surface).
    pub surface: Option<SurfaceDepth>,
}

/// Depth at which a pixel's surface lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SurfaceDepth {
    /// The median depth: the transmittance falls below a half.
    #[default]
    Median,
    /// The transmittance falls below 0.7. Training on colours leaves Gaussians behind the surfaces that they show, because in front
    /// they would stick out. So this depth is nearer to the truth than the median (`engine/guide/formats.md`, Meshes).
    Front,
}

impl SurfaceDepth {
    /// Transmittance behind the surface.
    pub(crate) fn transmittance(self) -> f32 {
        match self {
            Self::Median => 0.5,
            Self::Front => 0.7,
        }
    }
}

/// Random omission of Gaussians, each with the same probability (DropGaussian, Park et al. 2025, section 3.2). The opacities of
/// the others are divided by the probability to stay. They may then exceed 1, but alpha stays below 0.99. The same key omits
/// the same Gaussians, by index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Probability of omission: 0 to below 1.
    pub share: f64,
    /// Key of the random numbers.
    pub seed: u32,
    /// Key of the random numbers, one per frame.
    pub iteration: u32,
}

impl Dropout {
    /// 24-bit random numbers below this omit a Gaussian.
    pub(super) fn below(self) -> u32 {
        (self.share * f64::from(1 << 24)).round() as u32
    }

    /// Factor of the opacities, from the rounded probability.
    pub(super) fn factor(self) -> f32 {
        (1.0 / (1.0 - f64::from(self.below()) / f64::from(1 << 24))) as f32
    }
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            extent: Extent::default(),
            distance_order: false,
            jacobian_limit: JacobianLimit::default(),
            antialias: false,
            antialias_detached: false,
            dilation_px2: DILATION_PX2,
            filter_3d: false,
            background: [0.0; 3],
            sh_degree: None,
            inverse_depth: false,
            shape: Shape::default(),
            scale_modifier: 1.0,
            cut: Cut::default(),
            dropout: None,
            linear_depth: false,
            surface: None,
        }
    }
}

impl RenderSettings {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Argument`] for a scale modifier that is negative or not finite, a dilation that is not positive and finite, a
    /// background that is not finite, a dropout of almost all, or an invalid cut.
    pub fn check(&self) -> Result<()> {
        if !(self.scale_modifier.is_finite() && self.scale_modifier >= 0.0) {
            let problem = format!("is {}, must be finite and not negative", self.scale_modifier);
            return Err(Error::argument("scale_modifier", problem));
        }
        if !(self.dilation_px2.is_finite() && self.dilation_px2 > 0.0) {
            let problem = format!("is {}, must be finite and positive", self.dilation_px2);
            return Err(Error::argument("dilation_px2", problem));
        }
        if let Some(degree) = self.sh_degree.filter(|degree| *degree > 3) {
            return Err(Error::argument("sh_degree", format!("{degree} is above 3")));
        }
        if self.background.iter().any(|channel| !channel.is_finite()) {
            return Err(Error::argument("background", format!("{:?} is not finite", self.background)));
        }
        if let Some(Dropout { share, .. }) =
            self.dropout.filter(|dropout| !(0.0..=0.99).contains(&dropout.share))
        {
            return Err(Error::argument("dropout.share", format!("is {share}, must be 0 to 0.99")));
        }
        self.cut.check().map_err(|error| error.within("cut"))
    }

    /// True if the settings draw the Gaussians themselves, so that the picture is differentiable.
    pub fn is_faithful(&self) -> bool {
        self.shape == Shape::Gaussian && self.scale_modifier == 1.0
    }

    /// True if splats may be steeper than the reference's low-pass filter allows.
    pub(crate) fn is_steep(&self) -> bool {
        self.shape == Shape::Ellipsoid || self.dilation_px2 < DILATION_PX2
    }

    /// True if the splats' records have z in place of 1/z.
    pub(crate) fn has_z_record(&self) -> bool {
        self.inverse_depth && self.linear_depth
    }

    /// Outputs besides the picture and its depth.
    pub(crate) fn outputs(&self) -> Outputs {
        Outputs { surface: self.surface.is_some(), ..Outputs::default() }
    }

    /// Values on which culling and projection branch: extent and antialias.
    pub(crate) fn modes(&self) -> [u32; 2] {
        [self.extent_word(), self.antialias_bits()]
    }

    pub(crate) fn antialias_bits(&self) -> u32 {
        let bit = |on: bool, bit: u32| if on { bit } else { 0 };
        bit(self.antialias, c::ANTIALIAS_COMPENSATED) | bit(self.antialias_detached, c::ANTIALIAS_DETACHED)
    }

    pub(crate) fn extent_word(&self) -> u32 {
        match self.extent {
            Extent::Exact => c::EXTENT_EXACT,
            Extent::Reference => c::EXTENT_REFERENCE,
        }
    }
}

// Shapes that represent Gaussians, and their scalars for the kernels.

/// Shape that represents each Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shape {
    /// The Gaussian itself.
    #[default]
    Gaussian,
    /// An opaque ellipsoid of the Gaussian's colour. Its surface lies at [`ELLIPSOID_SIGMAS`] standard deviations, with a soft
    /// rim of a few percent of that. Gaussians with an opacity below
    /// [`ELLIPSOID_LEAST_OPACITY`](crate::kernels::constants::ELLIPSOID_LEAST_OPACITY) are not drawn. Its depth is that of its
    /// mean, like a Gaussian's.
    Ellipsoid,
    /// An opaque dot of the Gaussian's colour at its mean, about [`POINT_RADIUS_PX`] pixels in radius.
    Point,
}

/// Distance of the surface of [`Shape::Ellipsoid`] from the mean, in standard deviations.
pub const ELLIPSOID_SIGMAS: f32 = 2.0;
/// Radius of [`Shape::Point`], pixels.
pub const POINT_RADIUS_PX: f32 = 1.5;

/// Logarithm of the opacity that turns a Gaussian into a disc. `exp(STEEPNESS - d²/2)` stays above 1 until d = √(2 STEEPNESS).
/// It is below 1/255 at √(2 (STEEPNESS + ln 255)), 7 % farther out. The value fits float32 well.
const STEEPNESS: f32 = 40.0;
/// Same as [`STEEPNESS`], but for points, whose rim is one pixel wide.
const POINT_STEEPNESS: f32 = 3.75;

/// Scalars of a shape in the camera block (camera_block.glsl).
pub(super) struct DrawnShape {
    /// Factor of the scales.
    pub scale: f32,
    /// Term added to both screen variances.
    pub dilation_px2: f32,
    /// Opacity override; 0 for none.
    pub opacity: f32,
}

impl DrawnShape {
    pub fn of(settings: &RenderSettings) -> Self {
        let RenderSettings { scale_modifier, dilation_px2, .. } = *settings;
        match settings.shape {
            Shape::Gaussian => Self { scale: scale_modifier, dilation_px2, opacity: 0.0 },
            Shape::Ellipsoid => {
                // Standard deviations at which alpha is about one half.
                let reach = (2.0 * (STEEPNESS + 0.5f32.recip().ln())).sqrt();
                let shrink = ELLIPSOID_SIGMAS / reach;
                Self {
                    scale: scale_modifier * shrink,
                    dilation_px2: dilation_px2 * shrink * shrink,
                    // A negative value excludes Gaussians of low opacity.
                    opacity: -STEEPNESS.exp(),
                }
            }
            Shape::Point => {
                let reach2 = 2.0 * (POINT_STEEPNESS + 0.5f32.recip().ln());
                Self {
                    scale: 0.0,
                    dilation_px2: POINT_RADIUS_PX * POINT_RADIUS_PX / reach2,
                    opacity: POINT_STEEPNESS.exp(),
                }
            }
        }
    }
}

// Settings of one scene of a frame, besides the frame's settings.

/// Settings of one scene of a frame. The default draws the scene unchanged, with the kernels of a frame without these settings.
#[derive(Clone, Copy, Debug)]
pub struct SceneSettings<'a> {
    /// True if the scene is drawn. A hidden scene takes no Gaussians of the reservation and no time on the device. It still
    /// counts as a scene, and the others keep their places in [`RecordedFrame::scenes`](crate::RecordedFrame::scenes).
    pub visible: bool,
    /// Factors of red, green and blue, each 0 to [`MAX_TINT`]. They multiply each Gaussian's colour after its spherical
    /// harmonics and their clamp at 0: display-encoded, as trained. The product is clamped to
    /// [`TINTED_COLOR_MAX`](crate::kernels::constants::TINTED_COLOR_MAX), the largest half float.
    pub tint: [f32; 3],
    /// Factor of each Gaussian's opacity after the sigmoid, 0 to 1. Other [shapes](crate::Shape) than Gaussians stay opaque. A
    /// factor of 0 hides the scene.
    pub opacity: f32,
    /// Highest evaluated SH degree, 0 to 3. `None` uses the frame's [`sh_degree`](crate::RenderSettings::sh_degree), which is
    /// also the upper limit.
    pub sh_degree: Option<u32>,
    /// Volumes that keep or remove Gaussians, in the scene's own coordinates: at most [`MAX_CUT_OUTS`].
    pub cut_outs: &'a [CutOut],
    /// Gaussians that are drawn in another colour.
    pub selection: Option<Selection<'a>>,
}

/// Gaussians of a scene that are drawn in another colour.
#[derive(Clone, Copy, Debug)]
pub struct Selection<'a> {
    /// A bit per Gaussian of the scene: bit i % 32 of word i / 32, set if selected. A host's buffer ([`Buffer::adopt`]) or the
    /// context's, with whole words for all Gaussians. The host synchronises its writes as for any buffer that compute shaders
    /// read.
    pub mask: &'a Buffer,
    /// Colour of the selection, display-encoded, 0 to [`TINTED_COLOR_MAX`] per channel.
    pub color: [f32; 3],
    /// Share of that colour, 0 to 1; the rest is the Gaussian's own colour with the tint.
    pub share: f32,
}

/// Largest factor of a [`SceneSettings::tint`].
pub const MAX_TINT: f32 = 1000.0;

impl Default for SceneSettings<'_> {
    fn default() -> Self {
        Self::USUAL
    }
}

impl<'a> SceneSettings<'a> {
    /// Draws the scene unchanged.
    pub const USUAL: Self =
        Self { visible: true, tint: [1.0; 3], opacity: 1.0, sh_degree: None, cut_outs: &[], selection: None };

    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Argument`] with the field's name for a tint, an opacity or a selection's colour that is NaN or out of range, an
    /// SH degree above 3, and too many cut-outs; errors of [`CutOut::check`].
    #[inline]
    pub fn check(&self) -> Result<()> {
        // Fast path for frames of thousands of scenes.
        let is_simple = self.sh_degree.is_none() & self.cut_outs.is_empty() & self.selection.is_none();
        match is_simple & self.has_possible_factors() {
            true => Ok(()),
            false => self.check_each(),
        }
    }

    /// True if the tint and the opacity are in their ranges.
    #[inline]
    fn has_possible_factors(&self) -> bool {
        let [r, g, b] = self.tint.map(|factor| (0.0..=MAX_TINT).contains(&factor));
        r & g & b & (0.0..=1.0).contains(&self.opacity)
    }

    fn check_each(&self) -> Result<()> {
        if !self.tint.iter().all(|factor| (0.0..=MAX_TINT).contains(factor)) {
            let problem = format!("{:?}, each factor may be 0 to {MAX_TINT}", self.tint);
            return Err(Error::argument("tint", problem));
        }
        if !(0.0..=1.0).contains(&self.opacity) {
            return Err(Error::argument("opacity", format!("{} is not between 0 and 1", self.opacity)));
        }
        if let Some(degree) = self.sh_degree.filter(|degree| *degree > 3) {
            return Err(Error::argument("sh_degree", format!("{degree}, it may be 0 to 3")));
        }
        if self.cut_outs.len() > MAX_CUT_OUTS {
            let problem = format!("{} of them, there may be {MAX_CUT_OUTS}", self.cut_outs.len());
            return Err(Error::argument("cut_outs", problem));
        }
        if let Some(Selection { color, share, .. }) = self.selection {
            if !color.iter().all(|channel| (0.0..=TINTED_COLOR_MAX).contains(channel)) {
                let problem = format!("{color:?}, each may be 0 to {TINTED_COLOR_MAX}");
                return Err(Error::argument("selection.color", problem));
            }
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::argument("selection.share", format!("{share} is not between 0 and 1")));
            }
        }
        self.cut_outs.iter().enumerate().try_for_each(|(index, cut_out)| {
            cut_out.check().map_err(|error| error.within(format_args!("cut_outs[{index}]")))
        })
    }

    /// True if any Gaussian is drawn.
    #[inline]
    pub fn draws(&self) -> bool {
        self.visible && self.opacity > 0.0
    }

    /// Number of cut-outs, 0 if the scene is hidden.
    #[inline]
    pub fn cut_out_count(&self) -> u32 {
        if self.draws() { self.cut_outs.len() as u32 } else { 0 }
    }

    /// Mask of the selection, if it is visible.
    #[inline]
    pub fn mask(&self) -> Option<&'a Buffer> {
        self.selection
            .filter(|selection| self.draws() && selection.share > 0.0)
            .map(|selection| selection.mask)
    }

    /// Checks that a visible selection's mask belongs to the context and has a bit for each of the scene's Gaussians.
    pub(crate) fn check_mask(&self, gaussians: u32, context: &Context) -> Result<()> {
        let Some(mask) = self.mask() else { return Ok(()) };
        let bad =
            |problem| Err(Error::argument(format!("selection.mask (buffer '{}')", mask.name()), problem));
        if !mask.belongs_to(context) {
            return bad("it belongs to another context".to_owned());
        }
        let bytes = 4 * u64::from(gaussians.div_ceil(32));
        match mask.bytes() < bytes {
            true => bad(format!("has {} bytes, {gaussians} Gaussians take {bytes}", mask.bytes())),
            false => Ok(()),
        }
    }

    /// Features that need kernel variants: a tint or an opacity, cut-outs, a selection.
    #[inline]
    pub(crate) fn kinds(&self) -> [bool; 3] {
        [self.is_tinted(), self.cut_out_count() > 0, self.mask().is_some()]
    }

    /// True if colours or opacities of a drawn scene are multiplied.
    #[inline]
    pub fn is_tinted(&self) -> bool {
        let [r, g, b] = self.tint;
        self.draws() && (r != 1.0 || g != 1.0 || b != 1.0 || self.opacity != 1.0)
    }
}

// Variants of a frame's kernels, which follow from the settings.

/// True if the setting decides, and not the projection, that distances order a frame's Gaussians.
pub(crate) fn may_order_by_distance(projection: Projection) -> bool {
    projection != Projection::Orthographic && !projection.orders_by_distance()
}

/// Form of the blending kernel: the picture is the same, the cost depends on the device. The pictures agree to the bit if the
/// driver's compiler fuses sums of products alike in both kernels, as llvmpipe's does. `precise` arithmetic decides which
/// Gaussians count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blending {
    /// Each subgroup culls against its own region of the tile and passes Gaussians on by shuffles or broadcasts. It is the
    /// faster form on all measured devices.
    #[default]
    Regions,
    /// The paper's form: batches in shared memory, and every invocation loops over the whole batch.
    SharedMemory,
}

impl Blending {
    /// Both forms.
    pub const ALL: [Self; 2] = [Self::Regions, Self::SharedMemory];
}

/// Variant of a frame's kernels: additional outputs of blending, and properties of the Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameVariant {
    /// Blends the sum of weights / z, or of weights * z with `expected_depth`.
    pub inverse_depth: bool,
    /// See `inverse_depth`.
    pub expected_depth: bool,
    /// Splats beyond the frame's depth limits do not count.
    pub depth_limit: bool,
    /// The picture is stored in the layout of the backward pass.
    pub backward: bool,
    /// Blending stores [`FrameBuffers::last_entries`](super::FrameBuffers::last_entries) also without `backward`.
    pub last_entries: bool,
    /// Splats may be steeper than [`DILATION_PX2`](crate::kernels::constants::DILATION_PX2) allows, like those of ellipsoids.
    /// The products of INCREMENTAL_EXP would underflow (glsl/include/blending.glsl).
    pub steep: bool,
    /// Gaussians have a 3D filter. Affects culling, projection and its backward pass.
    pub filter_3d: bool,
    /// The low-pass filter differs from the reference's. Affects the backward pass.
    pub own_dilation: bool,
    /// Random Gaussians are omitted. Affects culling, projection and its backward pass.
    pub dropout: bool,
    /// A scene has a tint or an opacity ([`SceneSettings`]). Affects culling and projection.
    pub tinted: bool,
    /// A scene has cut-outs. Affects culling.
    pub cut_outs: bool,
    /// A scene has a selection. Affects projection.
    pub selection: bool,
    /// Storage of a scene's SH. Affects projection, its backward pass and the optimiser.
    pub sh_storage: ShStorage,
    /// The splats' records have z in place of 1/z, so that the sum of weights * z is differentiable, unlike with
    /// `expected_depth`. Affects projection and its backward pass.
    pub z_record: bool,
    /// Outputs besides the picture. Motion and surface also affect projection.
    pub outputs: Outputs,
    /// Depth of an output surface.
    pub surface_depth: SurfaceDepth,
    /// Gaussians come by distance, while their records have z. Affects projection, and blending with `depth_limit`.
    pub distance_order: bool,
    /// Projection of the camera. Affects culling, projection and its backward pass.
    pub projection: Projection,
    /// The camera has a rolling shutter. Affects culling, projection, its backward pass and the optimiser.
    pub shutter: bool,
    /// Views share one order. Culling adds to the visible Gaussians of earlier views, and projection omits those that its view
    /// does not show.
    pub shared_order: bool,
}

impl FrameVariant {
    /// Returns the variant of a camera's frame of one scene, in a buffer of its own.
    pub fn of(settings: &RenderSettings, camera: &Camera, backward: bool) -> Self {
        Self {
            distance_order: settings.distance_order && may_order_by_distance(camera.projection),
            projection: camera.projection,
            shutter: camera.shutter.is_some(),
            inverse_depth: settings.inverse_depth,
            backward,
            steep: settings.is_steep(),
            filter_3d: settings.filter_3d,
            own_dilation: settings.dilation_px2 != DILATION_PX2,
            dropout: settings.dropout.is_some(),
            z_record: settings.has_z_record(),
            outputs: settings.outputs(),
            surface_depth: settings.surface.unwrap_or_default(),
            ..Self::default()
        }
    }

    /// Returns the different variants of frames of these cameras.
    pub(crate) fn of_cameras(settings: &RenderSettings, cameras: &[Camera], backward: bool) -> Vec<Self> {
        let kind = |camera: &Camera| (camera.projection, camera.shutter.is_some());
        let of = |own| cameras.iter().find(|camera| kind(camera) == own);
        let kinds =
            Projection::ALL.into_iter().flat_map(|projection| [false, true].map(|own| (projection, own)));
        kinds.filter_map(of).map(|camera| Self::of(settings, camera, backward)).collect()
    }

    /// Returns the variant of one of a frame's scenes, with this storage.
    pub(crate) fn of_scene(self, sh_storage: ShStorage, settings: &SceneSettings) -> Self {
        let [tinted, cut_outs, selection] = settings.kinds();
        Self { tinted, cut_outs, selection, sh_storage, ..self }
    }

    /// True if kernels of projection have their form for lenses.
    pub(crate) fn has_lens(self) -> bool {
        self.projection.is_lens() || self.shutter
    }

    /// Projection and form of kernels that only need the directions of the colours. Without a rolling shutter all projections have one.
    pub(crate) fn direction_form(self) -> (u32, bool) {
        let projection = if self.shutter { self.projection } else { Projection::Perspective };
        (projection as u32, self.shutter)
    }

    /// True if batches support the variant.
    pub(crate) fn may_be_batched(self) -> bool {
        self.sh_storage == ShStorage::F32
            && !(self.dropout || self.selection || self.z_record || self.backward)
    }
}
