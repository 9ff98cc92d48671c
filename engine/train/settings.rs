//! Settings of a training run, with the names of the reference implementation's command line.
//!
//! Each setting is declared once, in [`TrainSettings`]: its type, default, bounds and description. The command
//! line, the TOML file, the checkpoint and the C API follow from the declaration, through
//! [`TrainSettings::OPTIONS`] or serde.

use crate::error::{Error, Result};
use crate::frame::ShStorage;
use crate::scene::gaussians::MAX_SH_DEGREE;
use crate::scene::{Camera, Gaussians, Projection};

/// Declares an enumeration that an option can have, with the names of its values.
macro_rules! choices {
    ($(
        $(#[$about:meta])*
        $kind:ident { $($(#[$value_about:meta])* $value:ident = $name:literal,)* }
    )*) => {$(
        $(#[$about])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub enum $kind {
            $($(#[$value_about])* #[cfg_attr(feature = "serde", serde(rename = $name))] $value,)*
        }

        impl IsOption for $kind {
            const KIND: OptionKind = OptionKind::Choice(&[$($name),*]);
            fn value(self) -> OptionValue {
                OptionValue::Choice(match self { $(Self::$value => $name),* })
            }
        }
    )*};
}

/// Training stores floats or halves.
impl IsOption for ShStorage {
    const KIND: OptionKind = OptionKind::Choice(&["f32", "half"]);
    fn value(self) -> OptionValue {
        OptionValue::Choice(match self {
            Self::F32 => "f32",
            Self::Half => "half",
            Self::Bytes => "bytes",
        })
    }
}

choices! {
    /// Optimiser of the parameters.
    OptimizerType {
        /// Adam on every Gaussian in every iteration (the reference's `default`).
        #[default]
        Default = "default",
        /// Adam only on the Gaussians that are visible in the iteration's view, without bias correction (`sparse_adam`).
        SparseAdam = "sparse_adam",
    }

    /// Storage of Adam's moments.
    MomentsType {
        /// Two float32 per parameter.
        #[default]
        F32 = "f32",
        /// Two bytes per SH coefficient and four per other parameter, rounded at random (packed_moments.glsl): 144 bytes per
        /// Gaussian of SH degree 3 in place of 480.
        Packed = "packed",
    }

    /// Strategy of density control. A host can supply its own: [`super::TrainParts`].
    StrategyType {
        /// The reference implementation's: clone, split, prune, opacity reset.
        #[default]
        Reference = "reference",
        /// No density control: the initial Gaussians are optimised, and their number stays.
        Fixed = "fixed",
        /// 3DGS-MCMC's: relocation, growth to `cap_max`, noise. [`TrainSettings::of_strategy`](super::TrainSettings::of_strategy)
        /// has its values.
        Mcmc = "mcmc",
        /// Budgeted growth after Improved-GS: splits the Gaussians that matter most for the photographs' edges along their long
        /// axis, up to a number that grows to `cap_max`. [`TrainSettings::of_strategy`](super::TrainSettings::of_strategy) has its
        /// values.
        Budget = "budget",
    }

    /// Method of splitting a Gaussian.
    SplitType {
        /// Two means drawn from the Gaussian, scales divided by 1.6 (the reference's).
        #[default]
        Sample = "sample",
        /// Two means on the longest axis, at ± 1.35 of its scale (Improved-GS).
        LongAxis = "long-axis",
    }

    /// Weight of a candidate's chance to be split, in the strategy `budget`.
    ImportanceType {
        /// Blending weights at the photographs' edges, over several views (Improved-GS).
        #[default]
        Edges = "edges",
        /// The statistic that selected the candidates.
        Statistic = "statistic",
        /// Equal weights.
        None = "none",
    }
}

/// Goal of a training: [`TrainSettings::of_preset`](super::TrainSettings::of_preset).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Preset {
    /// Short time: fewer Gaussians, small pictures first.
    Fast,
    /// Good quality, with fewer Gaussians than the reference and in about its time.
    #[default]
    Default,
    /// Best quality, regardless of time.
    Quality,
    /// The article's recipe, with the reference implementation's values.
    Reference,
}

/// Bounds of an option's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounds {
    /// Any value of the type.
    None,
    /// A whole number of at least this.
    AtLeast(u32),
    /// A whole number of at most this.
    AtMost(u32),
    /// A number above 0, up to a million.
    Positive,
    /// A number from 0 to a million.
    NotNegative,
    /// A number from 0 to 1.
    Share,
}

/// Type of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionKind {
    /// A whole number, 0 or more.
    Integer,
    /// A number.
    Number,
    /// True or false.
    Switch,
    /// One of these names.
    Choice(&'static [&'static str]),
}

/// Value of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OptionValue {
    /// Value of an [`OptionKind::Integer`].
    Integer(u32),
    /// Value of an [`OptionKind::Number`].
    Number(f64),
    /// Value of an [`OptionKind::Switch`].
    Switch(bool),
    /// Value of an [`OptionKind::Choice`].
    Choice(&'static str),
}

impl std::fmt::Display for OptionValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Integer(value) => write!(f, "{value}"),
            Self::Number(value) => write!(f, "{value}"),
            Self::Switch(value) => write!(f, "{value}"),
            Self::Choice(value) => write!(f, "{value}"),
        }
    }
}

/// Declaration of an option of training.
#[derive(Clone, Copy, Debug)]
pub struct TrainOption {
    /// Name of the option and of its field.
    pub name: &'static str,
    /// Lines of the description.
    pub about: &'static [&'static str],
    /// Type of the value.
    pub kind: OptionKind,
    /// Bounds of the value.
    pub bounds: Bounds,
    /// Returns the value in the given settings.
    pub value: fn(&TrainSettings) -> OptionValue,
}

impl TrainOption {
    /// Refuses a value outside its bounds in the given settings.
    pub fn check(&self, settings: &TrainSettings) -> Result<()> {
        /// Upper limit of all numbers; larger ones are mistakes.
        const LARGEST: f64 = 1e6;
        let value = (self.value)(settings);
        let (fits, wanted) = match (self.bounds, value) {
            (Bounds::AtLeast(low), OptionValue::Integer(x)) => (x >= low, format!("at least {low}")),
            (Bounds::AtMost(high), OptionValue::Integer(x)) => (x <= high, format!("0 to {high}")),
            (Bounds::Positive, OptionValue::Number(x)) => {
                ((f64::MIN_POSITIVE..=LARGEST).contains(&x), format!("above 0, at most {LARGEST}"))
            }
            (Bounds::NotNegative, OptionValue::Number(x)) => {
                ((0.0..=LARGEST).contains(&x), format!("0 to {LARGEST}"))
            }
            (Bounds::Share, OptionValue::Number(x)) => ((0.0..=1.0).contains(&x), "between 0 and 1".into()),
            (Bounds::None, _) => (true, String::new()),
            // The declared bounds do not match the type.
            _ => (false, "of the type of its bounds".into()),
        };
        match fits {
            true => Ok(()),
            false => Err(Error::argument(self.name, format!("is {value}, must be {wanted}"))),
        }
    }

    /// Returns the default, and the values of the reference and of 3DGS-MCMC where they differ from it.
    pub fn defaults(&self) -> Vec<(&'static str, OptionValue)> {
        let usual = (self.value)(&TrainSettings::default());
        let others = [
            ("reference", TrainSettings::reference()),
            ("mcmc", TrainSettings::of_strategy(StrategyType::Mcmc)),
        ];
        let others = others.map(|(name, settings)| (name, (self.value)(&settings)));
        let others = others.into_iter().filter(|(_, value)| *value != usual);
        std::iter::once(("default", usual)).chain(others).collect()
    }
}

/// A type that an option can have.
pub(super) trait IsOption: Copy {
    const KIND: OptionKind;
    fn value(self) -> OptionValue;
}

macro_rules! is_option {
    ($($kind:ty: $value:ident,)*) => {$(
        impl IsOption for $kind {
            const KIND: OptionKind = OptionKind::$value;
            fn value(self) -> OptionValue {
                OptionValue::$value(self)
            }
        }
    )*};
}

is_option! {
    u32: Integer,
    f64: Number,
    bool: Switch,
}

/// Declares the settings: a struct with documented fields, and a table of their types, defaults, bounds and descriptions.
macro_rules! options {
    ($(#[$about:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $kind:ty = $default:expr, $bounds:expr;)*
    }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq)]
        #[cfg_attr(
            feature = "serde",
            derive(serde::Serialize, serde::Deserialize),
            serde(default = "TrainSettings::reference", deny_unknown_fields)
        )]
        pub struct $name { $($(#[doc = $doc])+ pub $field: $kind,)* }

        impl $name {
            /// Returns the settings of the reference implementation: the declared values.
            pub fn reference() -> Self {
                Self { $($field: $default,)* }
            }

            /// All settings in the order of declaration.
            pub const OPTIONS: &[$crate::train::settings::TrainOption] = &[$(
                $crate::train::settings::TrainOption {
                    name: stringify!($field),
                    about: &[$($doc),+],
                    kind: <$kind as $crate::train::settings::IsOption>::KIND,
                    bounds: $bounds,
                    value: |settings| $crate::train::settings::IsOption::value(settings.$field),
                },
            )*];

            /// Names and values of all settings, in the order of declaration.
            pub fn values(&self) -> Vec<(&'static str, OptionValue)> {
                Self::OPTIONS.iter().map(|option| (option.name, (option.value)(self))).collect()
            }
        }
    };
}

options! {
    /// All settings of a training run. They are the arguments of the reference implementation (gaussian-splatting,
    /// `arguments/__init__.py`) with its names, and three values that it hard-codes. Settings of later work have the names in
    /// their papers' code. [`TrainSettings::default`] is [`Preset::Default`], which measures best;
    /// [`TrainSettings::reference`] has the reference's values.
    ///
    /// Iterations are counted from 1. With the feature `serde` the settings can be read from and written to
    /// any of its formats. Missing fields take the reference's values, as in older files; unknown ones are refused.
    pub struct TrainSettings {
        /// Number of iterations, one view each
        iterations: u32 = 30_000, Bounds::AtLeast(1);
        /// Highest degree of the spherical harmonics, 0 to 3
        sh_degree: u32 = 3, Bounds::AtMost(MAX_SH_DEGREE);
        /// Iterations after which the SH degree in use rises by one; scale_sh_degree multiplies them
        sh_degree_interval: u32 = 1000, Bounds::AtLeast(1);
        /// SH degree in use at the start (of a scene that training begins with: its own)
        sh_degree_start: u32 = 0, Bounds::AtMost(MAX_SH_DEGREE);
        /// Learning rate of the means at the start, times the scene's extent
        position_lr_init: f64 = 1.6e-4, Bounds::Positive;
        /// Learning rate of the means at the end, times the scene's extent
        position_lr_final: f64 = 1.6e-6, Bounds::Positive;
        /// Unused, as in the reference, whose delay lasts 0 steps
        position_lr_delay_mult: f64 = 0.01, Bounds::NotNegative;
        /// Iteration at which position_lr_final is reached
        position_lr_max_steps: u32 = 30_000, Bounds::AtLeast(1);
        /// Learning rate of the SH coefficients of degree 0; the others take a twentieth of it
        feature_lr: f64 = 2.5e-3, Bounds::NotNegative;
        /// Learning rate of the opacity logits
        opacity_lr: f64 = 0.025, Bounds::NotNegative;
        /// Learning rate of the log-scales
        scaling_lr: f64 = 5e-3, Bounds::NotNegative;
        /// Learning rate of the quaternions
        rotation_lr: f64 = 1e-3, Bounds::NotNegative;
        /// Larger than this share of the scene's extent: split, else cloned
        percent_dense: f64 = 0.01, Bounds::NotNegative;
        /// Weight of 1 - SSIM in the loss; the L1 term takes the rest
        lambda_dssim: f64 = 0.2, Bounds::Share;
        /// Weight of the mean opacity in the loss
        opacity_reg: f64 = 0.0, Bounds::NotNegative;
        /// Weight of the mean scale in the loss
        scale_reg: f64 = 0.0, Bounds::NotNegative;
        /// Let Gaussians lie flat on surfaces, for better normals and depths, at some cost in PSNR. For pinholes only
        surface: bool = false, Bounds::None;
        /// Density control: the reference's, none, 3DGS-MCMC's, or budgeted growth; the last two set other defaults
        strategy: StrategyType = StrategyType::Reference, Bounds::None;
        /// Most Gaussians that the strategies mcmc and budget grow to; budget with 0: cap_ratio times those of the start, times the
        /// cube root of iterations / 30000, rounded down
        cap_max: u32 = 1_000_000, Bounds::None;
        /// Most Gaussians of the strategy budget without cap_max, for each of the start
        cap_ratio: f64 = 10.0, Bounds::Positive;
        /// Rate of mcmc's noise on the means, times their learning rate
        noise_lr: f64 = 5e5, Bounds::NotNegative;
        /// Opacity of the first Gaussians
        initial_opacity: f64 = INITIAL_OPACITY, Bounds::Share;
        /// Scale of the first Gaussians, times the distance of their neighbours
        initial_scale: f64 = 1.0, Bounds::Positive;
        /// Iterations between densifications
        densification_interval: u32 = 100, Bounds::AtLeast(1);
        /// Iterations between opacity resets; none in the last 1000 of a run, from which it would not recover
        opacity_reset_interval: u32 = 3000, Bounds::AtLeast(1);
        /// Count what concerns the whole run in shares of 30,000 iterations: position_lr_max_steps, densify_from_iter,
        /// densify_until_iter and late prunings are multiplied by iterations / 30000
        scale_schedule: bool = false, Bounds::None;
        /// Larger learning rates in runs of fewer than 30,000 iterations: position_lr_init times 30000 / iterations, at most
        /// 10; those of scales, opacities and colours times its root, at most 2
        scale_rates: bool = false, Bounds::None;
        /// Raise the SH degree in use at the same shares of the run: sh_degree_interval is multiplied by iterations / 30000, and is
        /// at least 1
        scale_sh_degree: bool = false, Bounds::None;
        /// Densification starts after this iteration
        densify_from_iter: u32 = 500, Bounds::None;
        /// Densification, and the collection of its statistics, end before this iteration
        densify_until_iter: u32 = 15_000, Bounds::None;
        /// Mean norm of the 2D mean's gradient (NDC) from which a Gaussian is densified
        densify_grad_threshold: f64 = 2e-4, Bounds::NotNegative;
        /// That norm of sums of absolute values over pixels, so that opposite gradients do not cancel (AbsGS)
        absgrad: bool = false, Bounds::None;
        /// Split a Gaussian into two drawn from it, or along its longest axis
        split: SplitType = SplitType::Sample, Bounds::None;
        /// Weights of the random choice of Gaussians to split (strategy budget): edges of the photographs, gradient statistic, none
        importance: ImportanceType = ImportanceType::Edges, Bounds::None;
        /// Grow to cap_max along a square root, not at once
        growth_curve: bool = false, Bounds::None;
        /// Prune what does not recover from opacity resets, which are milder
        recovery: bool = false, Bounds::None;
        /// Share of the run, at its end, over which the Gaussians' learning rates fall linearly to 0
        decay_last: f64 = 0.0, Bounds::Share;
        /// Learn the exposure of each photo: a 3x4 matrix that changes the rendered colours before they are compared
        exposure: bool = false, Bounds::None;
        /// Learning rate of the exposures at the start
        exposure_lr_init: f64 = 0.01, Bounds::Positive;
        /// Learning rate of the exposures at the end
        exposure_lr_final: f64 = 0.001, Bounds::Positive;
        /// Iterations over which the exposures' learning rate rises from exposure_lr_delay_mult times its scheduled value to that value
        exposure_lr_delay_steps: u32 = 0, Bounds::None;
        /// Share of the exposures' learning rate at the start of that rise
        exposure_lr_delay_mult: f64 = 0.0, Bounds::Share;
        /// Weight of the squares of what exposures have besides a gain per channel, mixtures of channels and offsets, in the loss
        exposure_reg: f64 = 0.0, Bounds::NotNegative;
        /// Scale steps of exposures by the gradients of all photos together, so that those that fit move little
        exposure_shared: bool = false, Bounds::None;
        /// Pull of each step towards no exposure, as a share of the learning rate; 0 for exposures farther than 0.05 from none. Photos
        /// without a clear change keep none: the minimax concave penalty, Zhang 2010
        exposure_sparsity: f64 = 0.0, Bounds::NotNegative;
        /// Learn vignetting and response of each camera, which change the rendered colours before they are compared
        lens_effects: bool = false, Bounds::None;
        /// Learning rate of the lens effects at the start; a tenth of it at the end
        lens_lr: f64 = 5e-3, Bounds::Positive;
        /// Weight of the squared lens effects in the loss, which pulls them to none
        lens_reg: f64 = 1e-3, Bounds::NotNegative;
        /// Weight of the depths of the photos' sparse points in the loss at the start, times the scene's extent; a hundredth of it at the
        /// end (gsplat: 0.01 throughout)
        depth_points: f64 = 0.0, Bounds::NotNegative;
        /// Weight of the inverse-depth maps in the loss at the start, for views that have one
        depth_l1_weight_init: f64 = 1.0, Bounds::Positive;
        /// Weight of the inverse-depth maps in the loss at the end
        depth_l1_weight_final: f64 = 0.01, Bounds::Positive;
        /// Gaussians of a smaller opacity are pruned at a densification
        min_opacity: f64 = 0.005, Bounds::Share;
        /// With strategy budget, Gaussians of a smaller opacity are pruned up to seven times between 8000 and 21000 of 30000
        /// iterations as well, but not within 300 after the start or an opacity reset; 0 for none
        late_min_opacity: f64 = 0.0, Bounds::Share;
        /// Blend in the order of distances instead of z, so that colours do not pop when the camera turns. Viewers that sort by z draw
        /// such a scene worse; PLY and glTF are marked
        distance_order: bool = false, Bounds::None;
        /// White background instead of black
        white_background: bool = false, Bounds::None;
        /// A new random background colour in every iteration, behind the scene and behind transparent photos, so that no Gaussian
        /// paints the background
        random_background: bool = false, Bounds::None;
        /// Compensate the opacity for the screen-space dilation (Mip-Splatting's 2D filter)
        antialiasing: bool = false, Bounds::None;
        /// Take that compensation as a constant in gradients
        antialiasing_detached: bool = false, Bounds::None;
        /// Low-pass filter of the projection: variance that it adds, square pixels (Mip-Splatting: 0.1)
        kernel_size: f64 = 0.3, Bounds::Positive;
        /// Widen Gaussians to what the nearest camera resolves (Mip-Splatting's 3D filter)
        filter_3d: bool = false, Bounds::None;
        /// Begin with small pictures up to this iteration, or up to half of the run if that is earlier: first a quarter of the photos'
        /// width and height, then half of them. It is not scaled. No side gets fewer than 64 pixels (paper, section 7.1: 500)
        warm_up: u32 = 0, Bounds::None;
        /// Share of the Gaussians that the last step leaves out at random; it rises from 0 at the start (DropGaussian: 0.2)
        dropout: f64 = 0.0, Bounds::Share;
        /// Optimise the poses of the training views with the scene; held-out ones are aligned to it before they are measured
        pose_opt: bool = false, Bounds::None;
        /// Learning rate of the poses at the start: of turns, radians; of displacements, times the mean depth of the Gaussians that the
        /// camera sees at the start. It falls to a hundredth
        pose_lr: f64 = 1e-5, Bounds::NotNegative;
        /// Optimise the lenses of the training views with the scene: focal lengths, principal point and distortion, which pinholes
        /// learn too. Held-out views with the same lens are measured with it
        lens_opt: bool = false, Bounds::None;
        /// Learning rate of the lenses, from a third of the run on: displacement of the picture's points, in focal lengths. From seven
        /// tenths of the run it falls to a hundredth
        lens_opt_lr: f64 = 2e-4, Bounds::NotNegative;
        /// Adam on all Gaussians, or on those seen only
        optimizer_type: OptimizerType = OptimizerType::Default, Bounds::None;
        /// Storage of Adam's moments: f32, or packed in a third of the memory
        moments: MomentsType = MomentsType::F32, Bounds::None;
        /// Storage of SH coefficients: f32, or half, which takes packed moments
        sh_storage: ShStorage = ShStorage::F32, Bounds::None;
        /// Seed of everything random: order of the views, split positions, random backgrounds
        seed: u32 = 0, Bounds::None;
    }
}

/// Initial opacity of the Gaussians in the reference.
const INITIAL_OPACITY: f64 = 0.1;
/// Share of a run over which presets' learning rates fall to 0.
const DECAYED_SHARE: f64 = 0.1;
/// End of the reference's densification, with few photographs.
const FEW_PHOTOS_UNTIL: u32 = 1500;
/// Share of Gaussians that the last step omits, with the fewest photographs.
const FEW_PHOTOS_DROPOUT: f64 = 0.1;
/// Share of the run over which learning rates fall to 0, with the fewest photographs.
const FEW_PHOTOS_DECAYED: f64 = 0.25;
/// Weight of the mean opacity in the loss, with the fewest photographs.
const FEW_PHOTOS_OPACITY_REG: f64 = 0.003;
/// Number of photographs from which nothing is adapted to few.
const MANY_PHOTOS: f64 = 32.0;
/// Maximum share of omitted Gaussians.
const MAX_DROPOUT: f64 = 0.9;

impl Default for TrainSettings {
    fn default() -> Self {
        Self::of_preset(Preset::Default)
    }
}

impl TrainSettings {
    /// Returns the defaults of a strategy. 3DGS-MCMC differs in rates, initial values, regularisers and the end of
    /// densification (its README and `train.py`). Budgeted growth differs in the means' rates and the threshold (Improved-GS,
    /// `arguments/__init__.py`). It enables all its parts and scales its schedule.
    pub fn of_strategy(strategy: StrategyType) -> Self {
        let usual = Self { strategy, ..Self::reference() };
        match strategy {
            StrategyType::Reference | StrategyType::Fixed => usual,
            StrategyType::Budget => Self {
                position_lr_init: 4e-5,
                position_lr_final: 2e-6,
                densify_grad_threshold: 3e-4,
                cap_max: 0,
                scale_schedule: true,
                scale_rates: true,
                scale_sh_degree: true,
                absgrad: true,
                split: SplitType::LongAxis,
                growth_curve: true,
                recovery: true,
                ..usual
            },
            StrategyType::Mcmc => Self {
                opacity_lr: 0.05,
                opacity_reg: 0.01,
                scale_reg: 0.01,
                densify_until_iter: 25_000,
                initial_opacity: 0.5,
                initial_scale: 0.1,
                ..usual
            },
        }
    }

    /// Returns the settings of a preset, by measurement (tools/strategies.md). All but the reference use the strategy budget,
    /// antialiasing, and late prunings of faint Gaussians. Learning rates fall to 0 at the end, which allows
    /// larger rates of scales and means before. Moments are packed, SH are halves. They differ in the number of Gaussians and in the warm-up.
    /// [`exposure`](Self::exposure) is nearly a gain per channel.
    pub fn of_preset(preset: Preset) -> Self {
        let usual = Self {
            antialiasing: true,
            late_min_opacity: 0.1,
            decay_last: DECAYED_SHARE,
            moments: MomentsType::Packed,
            sh_storage: ShStorage::Half,
            position_lr_final: 4e-6,
            scaling_lr: 7.5e-3,
            exposure_lr_init: 0.02,
            exposure_lr_final: 5e-4,
            exposure_reg: 0.1,
            exposure_shared: true,
            exposure_sparsity: 0.05,
            ..Self::of_strategy(StrategyType::Budget)
        };
        match preset {
            Preset::Fast => Self { cap_ratio: 8.0, warm_up: 500, ..usual },
            Preset::Default => usual,
            Preset::Quality => Self { cap_ratio: 20.0, ..usual },
            Preset::Reference => Self::reference(),
        }
    }

    /// Number of photographs below which [`TrainSettings::for_photos`] changes settings no further.
    pub const FEW_PHOTOS: usize = 12;

    /// Adapts settings to fewer than 32 photographs, by measurement (tools/strategies.md). Budget's values change linearly down to
    /// [`FEW_PHOTOS`](Self::FEW_PHOTOS) photographs. It omits random Gaussians from steps (DropGaussian), so that no photograph is
    /// fitted by Gaussians that no other shows. A weight on opacities clears haze that no photograph disproves. The reference's
    /// growth ends at iteration 1500, with any such number of photographs. The other strategies stay as they are.
    #[must_use]
    pub fn for_photos(self, photos: usize) -> Self {
        let share = ((MANY_PHOTOS - photos as f64) / (MANY_PHOTOS - Self::FEW_PHOTOS as f64)).clamp(0.0, 1.0);
        // Rounded to be easily typed.
        let towards = |from: f64, to: f64| ((from + share * (to - from)) * 1e4).round() / 1e4;
        match self.strategy {
            _ if share == 0.0 => self,
            StrategyType::Reference => Self { densify_until_iter: FEW_PHOTOS_UNTIL, ..self },
            StrategyType::Budget => Self {
                dropout: towards(self.dropout, FEW_PHOTOS_DROPOUT),
                opacity_reg: towards(self.opacity_reg, FEW_PHOTOS_OPACITY_REG),
                decay_last: towards(self.decay_last, FEW_PHOTOS_DECAYED),
                ..self
            },
            StrategyType::Fixed | StrategyType::Mcmc => self,
        }
    }

    /// Refuses options that the strategy does not have, if they differ from the reference's.
    pub(super) fn refuse(&self, strategy: &str, names: &[&str]) -> Result<()> {
        let usual = Self::reference();
        for option in Self::OPTIONS.iter().filter(|option| names.contains(&option.name)) {
            let value = (option.value)(self);
            if value != (option.value)(&usual) {
                let problem = format!(
                    "is {value}, but the strategy {strategy} has no such part; leave it out, or take strategy budget"
                );
                return Err(Error::argument(option.name, problem));
            }
        }
        Ok(())
    }

    /// Replaces the reference's initial opacity and scale by those of the settings.
    pub fn initialize(&self, gaussians: &mut Gaussians) {
        // The defaults keep their bits.
        if self.initial_opacity != INITIAL_OPACITY {
            let logit = (self.initial_opacity / (1.0 - self.initial_opacity)).ln() as f32;
            gaussians.opacity_logits.fill(logit);
        }
        if self.initial_scale != 1.0 {
            let change = self.initial_scale.ln() as f32;
            gaussians.log_scales.iter_mut().flatten().for_each(|log_scale| *log_scale += change);
        }
    }

    /// Refuses a warm-up together with these depths, because its photographs are smaller.
    pub(super) fn refuse_warm_up_with(&self, depths: &str) -> Result<()> {
        if self.warm_up == 0 {
            return Ok(());
        }
        let until = self.warm_up;
        let problem =
            format!("is {until} (preset fast sets it), which does not go together with {depths}; give 0");
        Err(Error::argument("warm_up", problem))
    }

    /// Refuses a lens or a rolling shutter with [`surface`](Self::surface). The trainer calls this before photographs are uploaded.
    pub fn check_cameras<'a>(&self, mut cameras: impl Iterator<Item = &'a Camera>) -> Result<()> {
        let is_pinhole =
            |camera: &Camera| camera.projection == Projection::Perspective && camera.shutter.is_none();
        match self.surface && !cameras.all(is_pinhole) {
            true => {
                let problem = "takes pinholes without rolling shutters: --undistort makes pinholes of lenses";
                Err(Error::argument("surface", problem))
            }
            false => Ok(()),
        }
    }

    /// Refuses a value outside its bounds, and settings that exclude each other. The trainer calls this before any work.
    pub fn check(&self) -> Result<()> {
        Self::OPTIONS.iter().try_for_each(|option: &TrainOption| option.check(self))?;
        if self.dropout > MAX_DROPOUT {
            let problem = format!("is {}, must be at most {MAX_DROPOUT}", self.dropout);
            return Err(Error::argument("dropout", problem));
        }
        if self.depth_points > 0.0 {
            self.refuse_warm_up_with("depth_points")?;
        }
        if self.sh_storage == ShStorage::Bytes {
            return Err(Error::argument("sh_storage", "is bytes, which are only for drawing: give half"));
        }
        if self.sh_storage == ShStorage::Half && self.moments != MomentsType::Packed {
            return Err(Error::argument(
                "sh_storage",
                "is half, which needs packed moments: give moments packed, or sh_storage f32",
            ));
        }
        let others = [("depth_points", self.depth_points > 0.0), ("lens_opt", self.lens_opt)];
        if let Some((name, _)) = others.into_iter().find(|(_, is_on)| self.surface && *is_on) {
            return Err(Error::argument(
                "surface",
                format!("does not go together with {name}: leave one out"),
            ));
        }
        match self.initial_opacity > 0.0 && self.initial_opacity < 1.0 {
            true => Ok(()),
            false => {
                let problem =
                    format!("is {}, must be between 0 and 1, and neither of them", self.initial_opacity);
                Err(Error::argument("initial_opacity", problem))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_names_the_setting() {
        type Spoil = fn(&mut TrainSettings);
        let cases: [(&str, Spoil); 6] = [
            ("iterations", |s| s.iterations = 0),
            ("sh_degree", |s| s.sh_degree = 4),
            ("position_lr_init", |s| s.position_lr_init = 0.0),
            ("feature_lr", |s| s.feature_lr = f64::NAN),
            ("lambda_dssim", |s| s.lambda_dssim = 1.5),
            ("densification_interval", |s| s.densification_interval = 0),
        ];
        assert!(TrainSettings::reference().check().is_ok());
        for (name, spoil) in cases {
            let mut settings = TrainSettings::reference();
            spoil(&mut settings);
            let message = settings.check().expect_err(name).to_string();
            assert!(message.starts_with(&format!("{name}: is ")), "{message}");
        }
    }
}
