//! Training: from photographs and a sparse point cloud to Gaussians.
//!
//! One step is one submission: forward, loss, backward, Adam. A host may record it into its own command
//! buffer instead. A densification or an opacity reset runs at the start of the next step, so that the scene between steps is
//! what the reference would save. A step whose frame overflowed its buffers changes nothing and is repeated with a larger
//! capacity.
//!
//! Unless a function names other errors, they are those of the device: it refuses a pipeline, has no memory left or is lost.
//! Functions that read a trainer's state also fail while recorded steps are in flight, and after a step with an unknown outcome.

mod appearance;
mod block;
pub mod checkpoint;
mod lens_opt;
mod memory;
mod parts;
mod photos;
mod population;
mod poses;
mod record;
mod resume;
mod schedule;
pub mod settings;
mod step;
pub mod strategy;
mod terms;
mod trainer;
pub mod verify;

pub use block::{BlockState, SceneBlock, Surroundings};
pub use checkpoint::{Capacities, Checkpoint, ExposureState, MomentState, PoseState};
pub use lens_opt::{LENS_STATE_VALUES, LensState, ZoomState};
pub use parts::{Forecast, TrainParts};
pub use photos::{PhotoSize, TrainView};
pub use population::{Growth, Population};
pub use record::{Maintenance, RecordedStep, StepReservation};
pub use settings::{
    ImportanceType, MomentsType, OptimizerType, Preset, SplitType, StrategyType, TrainSettings,
};
pub use step::{StepOutcome, StepReport};
pub use strategy::{
    Actions, Budget, Densified, Fixed, GrowthSchedule, Mcmc, QuantilePlace, Reference, Strategy,
};
pub use terms::*;
pub use trainer::Trainer;
