//! The complete state of a training run between two steps, and its exchange between neighbouring blocks.
//!
//! The crate `ashsplat-files` reads and writes it as a file: parameters, Adam's moments and the statistics of
//! densification as named tensors, the rest as metadata. A resumed run ends with the same bits as an uninterrupted run: random
//! numbers are keyed by seed and iteration, so no generator has state.

use super::block::{BlockState, SceneBlock};
use super::lens_opt::{LENS_STATE_VALUES, LensState, ZoomState};
use super::schedule::Actions;
use super::settings::{MomentsType, TrainSettings};
use crate::error::{Error, Result};
use crate::frame::ShStorage;
use crate::kernels::constants::{PLANE_LOG_SCALE, PLANE_SH};
use crate::scene::gaussians::sh_coefficients;
use crate::scene::{Fingerprint, Gaussians, WorldFrame};

/// Upper limit of [`Capacities::blend_passes`].
const MAX_BLEND_PASSES: u32 = 1 << 16;

/// The state of a training run after an iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Version of ashsplat that made it.
    pub version: String,
    /// Device that made it. On another device the bits differ.
    pub device: String,
    /// The device's driver and its version. With another driver the bits may differ.
    pub driver: String,
    /// Forms of the kernels ([`Limits::kernel_forms`](crate::vk::Limits::kernel_forms)). With other forms the bits may differ.
    pub kernels: String,
    /// The run's settings.
    pub settings: TrainSettings,
    /// Number of views.
    pub views: u64,
    /// Hash of the views (cameras and photographs, in their order).
    pub views_fingerprint: u64,
    /// The scene's extent, world units.
    pub scene_extent: f32,
    /// Origin and unit of all lengths. The caller that writes the checkpoint sets it.
    pub frame: WorldFrame,
    /// Iterations done.
    pub iteration: u32,
    /// Number of optimiser steps so far.
    pub optimizer_steps: u64,
    /// Number of optimiser steps of the opacities so far.
    pub opacity_steps: u64,
    /// Work of the strategy before the next step.
    pub due: Actions,
    /// The parameters.
    pub gaussians: Gaussians,
    /// Adam's moments.
    pub moments: MomentState,
    /// Per Gaussian: sum of the norms of the 2D mean's gradient (NDC), number of views.
    pub statistics: Vec<[f32; 2]>,
    /// Sizes of the 3D filter, world units, one per Gaussian; empty without [`TrainSettings::filter_3d`].
    pub filters: Vec<f32>,
    /// Further state of the strategy.
    pub strategy: StrategyState,
    /// Exposures of the views' photographs, if they are learned.
    pub exposures: ExposureState,
    /// Lens effects ([`LensEffects`](crate::scene::LensEffects)) in the order of the camera ids, if they are learned.
    pub lens_effects: ExposureState,
    /// Poses of the views, if they are optimised.
    pub poses: Option<PoseState>,
    /// Lenses of the views, if they are optimised.
    pub lens_opt: LensState,
    /// Number of consecutive skipped iterations up to this one ([`super::StepReport::skipped`]).
    pub skipped: u32,
    /// The trained block; None for a whole scene. The checkpoint does not hold the frozen Gaussians.
    pub block: Option<BlockState>,
    /// Allocated capacities.
    pub capacities: Capacities,
}

/// Adam's moments of the parameters, as [`TrainSettings::moments`] stores them.
#[derive(Clone, Debug, PartialEq)]
// A checkpoint has one, so its size does not matter.
#[allow(clippy::large_enum_variant)]
pub enum MomentState {
    /// First and second moments, shaped like the parameters.
    F32([Gaussians; 2]),
    /// [`packed_planes`] groups of four words per Gaussian, one Gaussian after the other (packed_moments.glsl).
    Packed(Vec<[u32; 4]>),
}

/// True if a step can continue with the packed words of a Gaussian: finite moments, and second ones not below 0.
fn are_moments(planes: &[[u32; 4]]) -> bool {
    let is_finite =
        |word: u32| [word << 16, word & 0xFFFF_0000].iter().all(|&bits| f32::from_bits(bits).is_finite());
    let is_positive = |word: u32| is_finite(word) && word & 0x8000_8000 == 0;
    planes[..PLANE_SH as usize].iter().enumerate().all(|(plane, &[a, b, c, d])| {
        if plane as u32 != PLANE_LOG_SCALE {
            return is_finite(a) && is_finite(b) && is_positive(c) && is_positive(d);
        }
        let bound = f32::from_bits(b & 0xFFFF_0000 | d >> 16);
        let is_bound = bound.is_finite() && bound >= 0.0;
        is_finite(a) && is_finite(b & 0xFFFF) && is_positive(c) && is_positive(d & 0xFFFF) && is_bound
    })
}

/// Number of `[u32; 4]` in the packed moments of a Gaussian with SH up to `sh_degree`.
pub fn packed_planes(sh_degree: u32) -> usize {
    ShStorage::Half.planes(sh_degree) as usize
}

impl MomentState {
    /// First and second moments; nothing if they are packed.
    fn sets(&self) -> &[Gaussians] {
        match self {
            Self::F32(sets) => sets,
            Self::Packed(_) => &[],
        }
    }

    /// Moments of some of the Gaussians, which have SH up to `sh_degree`.
    #[must_use]
    pub fn select(&self, rows: &[usize], sh_degree: u32) -> Self {
        match self {
            Self::F32(sets) => Self::F32(sets.each_ref().map(|set| set.select(rows))),
            Self::Packed(words) => {
                let planes = packed_planes(sh_degree);
                let own = rows.iter().flat_map(|row| &words[row * planes..][..planes]);
                Self::Packed(own.copied().collect())
            }
        }
    }
}

/// Exposures of photographs ([`Exposure`](crate::scene::Exposure)) in the views' order, or effects of lenses. Empty if they are
/// not learned.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExposureState {
    /// The matrices.
    pub values: Vec<[[f32; 4]; 3]>,
    /// Adam's first moments.
    pub first_moments: Vec<[[f32; 4]; 3]>,
    /// Adam's second moments.
    pub second_moments: Vec<[[f32; 4]; 3]>,
}

/// The strategy's state and the names of the run's parts: see [`Strategy`](super::Strategy).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StrategyState {
    /// Name of the strategy.
    pub name: String,
    /// Names of the loss terms.
    pub terms: Vec<String>,
    /// Names and values of the strategy's state on the host.
    pub values: Vec<(String, String)>,
}

/// Optimised poses, one row per view: see [`Twist`](crate::scene::Twist).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseState {
    /// Movement of each camera: ξ = (ν, ω), world units and radians.
    pub parameters: Vec<[f32; 6]>,
    /// Adam's first moments.
    pub first_moments: Vec<[f32; 6]>,
    /// Adam's second moments.
    pub second_moments: Vec<[f32; 6]>,
    /// Depth of the point about which each camera turns in steps, world units; 0 for its centre.
    pub depths: Vec<f32>,
}

/// A tensor of a checkpoint.
#[derive(Clone, Debug)]
pub struct Tensor<'a> {
    /// Name in the file.
    pub name: String,
    /// Shape, outermost dimension first.
    pub shape: Vec<usize>,
    /// Values in the host's byte order.
    pub bytes: &'a [u8],
    /// Type of the values: F32, or U32 for packed moments.
    pub dtype: &'static str,
}

impl<'a> Tensor<'a> {
    fn new<T: bytemuck::NoUninit>(
        name: impl Into<String>,
        shape: impl Into<Vec<usize>>,
        values: &'a [T],
    ) -> Self {
        Self { name: name.into(), shape: shape.into(), bytes: bytemuck::cast_slice(values), dtype: "F32" }
    }

    /// None without matrices.
    fn of_matrices(prefix: &str, own: &str, rows: &'a [[[f32; 4]; 3]]) -> Option<Self> {
        (!rows.is_empty()).then(|| Self::new(format!("{prefix}{own}"), [rows.len(), 3, 4], rows))
    }
}

impl ExposureState {
    /// Values, first moments, second moments.
    fn sets(&self) -> [&Vec<[[f32; 4]; 3]>; 3] {
        [&self.values, &self.first_moments, &self.second_moments]
    }
}

impl PoseState {
    /// Parameters, first moments, second moments.
    fn sets(&self) -> [&Vec<[f32; 6]>; 3] {
        [&self.parameters, &self.first_moments, &self.second_moments]
    }
}

/// Allocated capacities of a run. With a memory limit, they decide whether a densification fits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Capacities {
    /// Capacity of the parameter planes in Gaussians.
    pub gaussians: u32,
    /// Capacity of a frame in Gaussians.
    pub frame_gaussians: u32,
    /// Capacity of a frame in visible Gaussians.
    pub frame_visible: u32,
    /// Capacity of a frame in (tile, Gaussian) instances; 0 without a frame.
    pub frame_instances: u32,
    /// Number of blending passes.
    pub blend_passes: u32,
    /// Peak number of visible Gaussians in a frame, scaled like [`Capacities::most_instances`].
    pub most_visible: u32,
    /// Peak number of instances in a frame. Each densification keeps the number per Gaussian, less a twentieth.
    pub most_instances: u32,
    /// [`crate::vk::ContextOptions::max_memory`], bytes.
    pub max_memory: Option<u64>,
}

/// Properties that a checkpoint must match to be resumed.
pub(super) struct ExpectedRun<'a> {
    pub settings: &'a TrainSettings,
    pub views: u64,
    pub views_fingerprint: u64,
    pub scene_extent: f32,
    pub block: Option<BlockState>,
}

impl Checkpoint {
    /// Reasons why a run that is resumed here may end with other bits than an uninterrupted run, one sentence each. The
    /// version, device, driver or forms of the kernels ([`Limits::kernel_forms`](crate::vk::Limits::kernel_forms)) can differ.
    pub fn differences(&self, device: &str, driver: &str, kernels: &str) -> Vec<String> {
        let pairs = [
            ("ashsplat", self.version.as_str(), env!("CARGO_PKG_VERSION")),
            ("device", &self.device, device),
            ("driver", &self.driver, driver),
            ("kernels of", &self.kernels, kernels),
        ];
        let differing = pairs.iter().filter(|(_, there, here)| there != here);
        let say = |(what, there, here): &(&str, &str, &str)| {
            format!("was made with {what} '{there}', here it is '{here}'")
        };
        differing.map(say).collect()
    }

    /// Names, shapes and values of the tensors, in the file's order.
    pub fn tensors(&self) -> Vec<Tensor<'_>> {
        let mut tensors = Vec::new();
        let moments = self.moments.sets().iter();
        let sets = std::iter::once(&self.gaussians).chain(moments);
        for (prefix, set) in Self::SETS.into_iter().zip(sets) {
            let (n, k) = (set.len(), sh_coefficients(set.sh_degree));
            let named = |name| format!("{prefix}{name}");
            tensors.push(Tensor::new(named("means"), [n, 3], &set.means));
            tensors.push(Tensor::new(named("quats"), [n, 4], &set.quats));
            tensors.push(Tensor::new(named("log_scales"), [n, 3], &set.log_scales));
            tensors.push(Tensor::new(named("opacity_logits"), [n], &set.opacity_logits));
            tensors.push(Tensor::new(named("sh"), [n, k, 3], &set.sh));
        }
        if let MomentState::Packed(words) = &self.moments {
            let planes = packed_planes(self.gaussians.sh_degree);
            let tensor = Tensor::new(Self::PACKED_MOMENTS, [self.gaussians.len(), planes, 4], words);
            tensors.push(Tensor { dtype: "U32", ..tensor });
        }
        tensors.push(Tensor::new("statistics", [self.statistics.len(), 2], &self.statistics));
        if !self.filters.is_empty() {
            tensors.push(Tensor::new(Self::FILTERS, [self.filters.len()], &self.filters));
        }
        for (state, own) in [(&self.exposures, Self::EXPOSURES), (&self.lens_effects, Self::LENS_EFFECTS)] {
            let sets = Self::SETS.into_iter().zip(state.sets());
            tensors.extend(sets.filter_map(|(prefix, rows)| Tensor::of_matrices(prefix, own, rows)));
        }
        if let Some(poses) = &self.poses {
            let rows = Self::POSES.into_iter().zip(poses.sets());
            tensors.extend(rows.map(|(name, rows)| Tensor::new(name, [rows.len(), 6], rows)));
            tensors.push(Tensor::new(Self::POSE_DEPTHS, [poses.depths.len()], &poses.depths));
        }
        let LensState { lenses, zoom } = &self.lens_opt;
        if !lenses.is_empty() {
            tensors.push(Tensor::new(Self::LENS_OPT, [lenses.len(), LENS_STATE_VALUES], lenses));
        }
        if let Some(zoom) = zoom {
            tensors.push(Tensor::new(
                Self::LENS_ZOOM,
                [1, size_of::<ZoomState>() / 4],
                std::slice::from_ref(zoom),
            ));
        }
        tensors
    }

    /// Prefixes of the tensor names: parameters, first moments, second moments.
    pub const SETS: [&str; 3] = ["", "first_moment.", "second_moment."];

    /// Name of the tensor of [`MomentState::Packed`].
    pub const PACKED_MOMENTS: &str = "packed_moments";

    /// Name of the tensor of filter sizes, as in Mip-Splatting's PLY.
    pub const FILTERS: &str = "filter_3D";

    /// Name of the exposures' tensor. Their moments add the prefixes.
    pub const EXPOSURES: &str = "exposures";

    /// Name of the lens effects' tensor. Their moments add the prefixes.
    pub const LENS_EFFECTS: &str = "lenses";

    /// Names of the pose tensors: parameters, first moments, second moments. Only runs that optimise poses have them.
    pub const POSES: [&str; 3] = ["pose", "first_moment.pose", "second_moment.pose"];

    /// Name of the tensor of [`LensState::lenses`].
    pub const LENS_OPT: &str = "lens_opt";
    /// Name of the tensor of [`LensState::zoom`].
    pub const LENS_ZOOM: &str = "lens_zoom";

    /// Name of the tensor of [`PoseState::depths`].
    pub const POSE_DEPTHS: &str = "pose_depth";

    /// Prefix of the strategy's values in the metadata.
    pub const STRATEGY: &str = "strategy.";

    /// Hash of all tensors. Equal hashes mean states that are equal to the bit.
    pub fn fingerprint(&self) -> u64 {
        let mut fingerprint = Fingerprint::new();
        self.tensors().iter().for_each(|tensor| fingerprint.add(tensor.bytes));
        fingerprint.finish()
    }

    /// Checks that all sets have the same number of Gaussians and the settings' SH degree, and that each number is possible in
    /// a training.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the set or the number.
    pub fn check(&self) -> Result<()> {
        self.check_shapes()?;
        self.settings.check()?;
        let extent = self.scene_extent;
        if !(extent.is_finite() && extent > 0.0) {
            return Err(Error::argument("scene_extent", format!("is {extent}, must be positive")));
        }
        let WorldFrame { origin, unit } = self.frame;
        if !(origin.is_finite() && unit.is_finite() && unit > 0.0) {
            return Err(Error::argument("frame", format!("has the origin {origin} and the unit {unit}")));
        }
        let (capacities, iteration) = (&self.capacities, u64::from(self.iteration));
        let gaussians = self.gaussians.len() as u64;
        let (min_frame, max_passes) = match capacities.frame_instances {
            0 => (0, 1),
            instances => (gaussians, instances.min(MAX_BLEND_PASSES)),
        };
        let ranges = [
            ("views", self.views, 1, u32::MAX.into()),
            ("iteration", iteration, 0, u64::from(u32::MAX) - 1),
            ("optimizer_steps", self.optimizer_steps, 0, iteration),
            ("opacity_steps", self.opacity_steps, 0, self.optimizer_steps),
            ("skipped", self.skipped.into(), 0, iteration),
            ("capacities.gaussians", capacities.gaussians.into(), 0, 1 << 30),
            ("capacities.frame_gaussians", capacities.frame_gaussians.into(), min_frame, u32::MAX.into()),
            ("capacities.blend_passes", capacities.blend_passes.into(), 0, max_passes.into()),
        ];
        if let Some((name, value, min, max)) =
            ranges.into_iter().find(|(_, value, min, max)| !(min..=max).contains(&value))
        {
            return Err(Error::argument(name, format!("is {value}, not {min} to {max}")));
        }
        self.check_values()
    }

    /// Statistics are unchecked, because values there that are not finite change no parameter.
    fn check_values(&self) -> Result<()> {
        if let MomentState::Packed(words) = &self.moments {
            let planes = packed_planes(self.gaussians.sh_degree);
            if let Some(at) = words.chunks_exact(planes).position(|own| !are_moments(own)) {
                let problem = format!("those of Gaussian {at} are such as no training has");
                return Err(Error::argument(Self::PACKED_MOMENTS, problem));
            }
        }
        for Tensor { name, bytes, .. } in self.tensors() {
            if ["statistics", Self::PACKED_MOMENTS].contains(&name.as_str()) {
                continue;
            }
            let min = if name.starts_with(Self::SETS[2]) { 0.0 } else { f32::NEG_INFINITY };
            let values: &[f32] = bytemuck::cast_slice(bytes);
            if let Some(at) = values.iter().position(|&value| value.is_nan() || value < min) {
                return Err(Error::argument(
                    name,
                    format!("value {at} is {}, which no training has", values[at]),
                ));
            }
        }
        Ok(())
    }

    fn check_shapes(&self) -> Result<()> {
        self.gaussians.check_shapes()?;
        let moments = self.moments.sets().iter().map(|set| ("moments", set));
        for (name, set) in moments {
            set.check_shapes()?;
            if (set.len(), set.sh_degree) != (self.gaussians.len(), self.gaussians.sh_degree) {
                return Err(Error::argument(name, "are of another number or degree than the Gaussians"));
            }
        }
        let gaussians = self.gaussians.len();
        let (storage, moments_fit) = match &self.moments {
            MomentState::F32(_) => (MomentsType::F32, true),
            MomentState::Packed(words) => {
                let all = gaussians * packed_planes(self.gaussians.sh_degree);
                (MomentsType::Packed, words.len() == all)
            }
        };
        let filters = if self.settings.filter_3d { gaussians } else { 0 };
        let exposures = if self.settings.exposure { self.views } else { 0 };
        let lenses = self.lens_effects.sets().map(|set| set.len() as u64);
        let max = if self.settings.lens_effects { self.views } else { 0 };
        let lenses_fit = lenses == [lenses[0]; 3] && lenses[0] <= max && (max == 0 || lenses[0] > 0);
        let poses_fit = |poses: &PoseState| {
            poses.sets().iter().all(|rows| rows.len() as u64 == self.views)
                && poses.depths.len() as u64 == self.views
        };
        let exposures_fit = self.exposures.sets().iter().all(|set| set.len() as u64 == exposures);
        let degree_fits = self.gaussians.sh_degree == self.settings.sh_degree;
        let of_gaussians = "are of another number than the Gaussians";
        let [exposed, lensed] = [exposures, max].map(|count| format!("are not those of {count} photographs"));
        let checks = [
            (storage == self.settings.moments, "moments", "are stored otherwise than the settings say"),
            (moments_fit, "moments", of_gaussians),
            (self.statistics.len() == gaussians, "statistics", of_gaussians),
            (self.filters.len() == filters, Self::FILTERS, of_gaussians),
            (exposures_fit, "exposures", &exposed),
            (lenses_fit, "lenses", &lensed),
            (self.poses.as_ref().is_none_or(poses_fit), "poses", "are of another number than the views"),
            (degree_fits, "sh_degree", "of the Gaussians and of the settings differ"),
        ];
        match checks.into_iter().find(|(fits, ..)| !fits) {
            Some((_, name, problem)) => Err(Error::argument(name, problem)),
            None => Ok(()),
        }
    }

    /// Checks that a run with these settings and views could have made the checkpoint.
    pub(super) fn check_fits(&self, run: &ExpectedRun) -> Result<()> {
        let refuse = |problem: String| Err(Error::argument("checkpoint", problem));
        // The block comes first: photographs depend on the block, and settings on the photographs.
        if let Some(difference) = BlockState::difference(self.block.as_ref(), run.block.as_ref()) {
            return refuse(difference);
        }
        if self.views != run.views {
            return refuse(format!("was made with {} training views, here are {}", self.views, run.views));
        }
        let mut settings = TrainSettings { iterations: run.settings.iterations, ..self.settings.clone() };
        if !settings.exposure {
            // Unused without `exposure`. Ignored, because later presets set them.
            settings.exposure_lr_init = run.settings.exposure_lr_init;
            settings.exposure_lr_final = run.settings.exposure_lr_final;
            settings.exposure_reg = run.settings.exposure_reg;
            settings.exposure_shared = run.settings.exposure_shared;
            settings.exposure_sparsity = run.settings.exposure_sparsity;
        }
        run.settings.excuse_sh_degrees(&mut settings, &self.settings, self.iteration);
        if let Some(difference) = difference(&settings, run.settings) {
            return refuse(format!("was made with other settings: {difference}; give what they were"));
        }
        if self.iteration > run.settings.iterations {
            return refuse(format!(
                "is of iteration {} already, the training ends at {}; raise iterations to go on",
                self.iteration, run.settings.iterations
            ));
        }
        if self.views_fingerprint != run.views_fingerprint {
            return refuse(
                "was made with other photographs or cameras (of another data set, resolution, background, split, or parts of \
                 photographs; with another undistort, alpha or level; before photographs kept their lenses)"
                    .into(),
            );
        }
        if self.scene_extent.to_bits() != run.scene_extent.to_bits() {
            return refuse(format!(
                "was made with a scene extent of {}, here it is {}",
                self.scene_extent, run.scene_extent
            ));
        }
        Ok(())
    }

    /// Keeps only these Gaussians, in this order, with their moments and statistics. The state of views and of the run stays.
    pub fn keep(&mut self, rows: &[usize]) {
        self.gaussians = self.gaussians.select(rows);
        self.moments = self.moments.select(rows, self.gaussians.sh_degree);
        self.statistics = rows.iter().map(|&row| self.statistics[row]).collect();
        // Empty without the 3D filter.
        self.filters = rows.iter().filter_map(|&row| self.filters.get(row).copied()).collect();
    }

    /// Appends the Gaussians of another run with the same settings. The other run's state of views is dropped.
    ///
    /// # Errors
    /// [`Error::Argument`] if settings differ, naming them.
    pub fn append(&mut self, other: &Self) -> Result<()> {
        let refuse = |problem: String| Err(Error::argument("checkpoint", problem));
        if let Some(difference) = self.difference_of_settings(&other.settings) {
            return refuse(format!("was made with other settings: {difference}"));
        }
        if self.strategy.name != other.strategy.name {
            return refuse("was made with another strategy".into());
        }
        self.gaussians.append(&other.gaussians);
        match (&mut self.moments, &other.moments) {
            (MomentState::F32(own), MomentState::F32(others)) => {
                own.iter_mut().zip(others).for_each(|(own, others)| own.append(others));
            }
            (MomentState::Packed(own), MomentState::Packed(others)) => own.extend_from_slice(others),
            // The settings, which are equal, say which.
            _ => return refuse("stores its moments otherwise".into()),
        }
        self.statistics.extend_from_slice(&other.statistics);
        self.filters.extend_from_slice(&other.filters);
        Ok(())
    }

    /// Settings in which another run differs, except the number of iterations; None if none differ.
    pub fn difference_of_settings(&self, others: &TrainSettings) -> Option<String> {
        let there = TrainSettings { iterations: self.settings.iterations, ..others.clone() };
        difference(&there, &self.settings)
    }

    /// Continues training in this block, with new frozen neighbours. The allocated capacities are reset to those of a start;
    /// only the expected counts of a frame stay.
    pub fn settle_in(&mut self, block: &SceneBlock) {
        self.block = block.state();
        let Capacities { frame_visible, most_visible, most_instances, max_memory, .. } = self.capacities;
        self.capacities =
            Capacities { frame_visible, most_visible, most_instances, max_memory, ..Capacities::default() };
    }
}

/// Settings that differ, each as "name was there, is here"; None if all are equal.
fn difference(there: &TrainSettings, here: &TrainSettings) -> Option<String> {
    let (there, here) = (there.values(), here.values());
    let differing = there.iter().zip(&here).filter(|(there, here)| there != here);
    let sentences: Vec<String> =
        differing.map(|((name, there), (_, here))| format!("{name} was {there}, is {here}")).collect();
    (!sentences.is_empty()).then(|| sentences.join("; "))
}
