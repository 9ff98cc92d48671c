//! What of the trainer is read from files.

#[path = "../../../engine/trainer/checkpoint/mod.rs"]
pub mod checkpoint;
#[path = "../../../engine/trainer/settings.rs"]
pub mod settings;
