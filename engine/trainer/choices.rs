//! Choices among parts of training, by the names that settings give them.

/// The optimiser of the parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum OptimizerType {
    /// Adam on every Gaussian in every iteration (the reference's `default`).
    #[default]
    Default,
    /// Adam on the Gaussians seen in the iteration's view only, without bias correction (`sparse_adam`).
    SparseAdam,
}

/// The strategy of density control. A host can hand in one of its own: [`super::TrainParts`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum StrategyType {
    /// That of the reference implementation: clone, split, prune, opacity reset. Files may also call it
    /// `default`, its name in earlier versions.
    #[default]
    #[cfg_attr(feature = "serde", serde(alias = "default"))]
    Reference,
    /// None: the Gaussians of the beginning are optimised, and their number stays.
    Fixed,
    /// 3DGS-MCMC's: relocation, growth to `cap_max`, noise. [`TrainSettings::of_strategy`](super::TrainSettings::of_strategy) has its values.
    Mcmc,
    /// Budgeted growth after Improved-GS: the Gaussians that matter most for the edges of the photographs are
    /// split along their long axis, up to a number that grows to `cap_max`. [`TrainSettings::of_strategy`](super::TrainSettings::of_strategy) has
    /// its values.
    Budget,
}

/// How a Gaussian is split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum SplitType {
    /// Two means drawn from it, scales divided by 1.6 (the reference's).
    #[default]
    Sample,
    /// Two along its longest axis, at ± 1.35 of that scale (Improved-GS).
    LongAxis,
}

/// What the chance to be split follows, among the candidates of the strategy `budget`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum ImportanceType {
    /// The blending weights at the photographs' edges, over several views (Improved-GS).
    #[default]
    Edges,
    /// The statistic that made the candidates.
    Statistic,
    /// Nothing: all have the same chance.
    None,
}

/// What a training is to be good at: [`TrainSettings::of_preset`](super::TrainSettings::of_preset). Without a preset it is the reference's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Preset {
    /// Time: fewer Gaussians, small pictures first.
    Fast,
    /// Quality, with fewer Gaussians than the reference and in about its time.
    Default,
    /// Quality, whatever the time.
    Quality,
}
