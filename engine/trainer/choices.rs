//! Values of the settings that choose among parts of training.

/// Optimiser of the parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum OptimizerType {
    /// Adam on every Gaussian in every iteration (the reference's `default`).
    #[default]
    Default,
    /// Adam only on the Gaussians that are visible in the iteration's view, without bias correction (`sparse_adam`).
    SparseAdam,
}

/// Strategy of density control. A host can supply its own: [`super::TrainParts`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum StrategyType {
    /// The reference implementation's: clone, split, prune, opacity reset. Settings files may also use `default`, its name in
    /// earlier versions.
    #[default]
    #[cfg_attr(feature = "serde", serde(alias = "default"))]
    Reference,
    /// No density control: the initial Gaussians are optimised, and their number stays.
    Fixed,
    /// 3DGS-MCMC's: relocation, growth to `cap_max`, noise. [`TrainSettings::of_strategy`](super::TrainSettings::of_strategy)
    /// has its values.
    Mcmc,
    /// Budgeted growth after Improved-GS: splits the Gaussians that matter most for the photographs' edges along their long
    /// axis, up to a number that grows to `cap_max`. [`TrainSettings::of_strategy`](super::TrainSettings::of_strategy) has its
    /// values.
    Budget,
}

/// Method of splitting a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum SplitType {
    /// Two means drawn from the Gaussian, scales divided by 1.6 (the reference's).
    #[default]
    Sample,
    /// Two means on the longest axis, at ± 1.35 of its scale (Improved-GS).
    LongAxis,
}

/// Weight of a candidate's chance to be split, in the strategy `budget`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum ImportanceType {
    /// Blending weights at the photographs' edges, over several views (Improved-GS).
    #[default]
    Edges,
    /// The statistic that selected the candidates.
    Statistic,
    /// Equal weights.
    None,
}

/// Goal of a training: [`TrainSettings::of_preset`](super::TrainSettings::of_preset). Without a preset the reference's values
/// apply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Preset {
    /// Short time: fewer Gaussians, small pictures first.
    Fast,
    /// Good quality, with fewer Gaussians than the reference and in about its time.
    Default,
    /// Best quality, regardless of time.
    Quality,
}
