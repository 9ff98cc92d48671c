//! A Vulkan layer for tests: memory, queues and limits of other devices over the driver at hand, most often llvmpipe.
//! `ASHSPLAT_MOCK` names the [`machine`]. Load it below the validation layer, which then checks the program against this device's
//! claims:
//!
//! ```sh
//! export LD_LIBRARY_PATH=target/release VK_ADD_LAYER_PATH=tools/mock_layer ASHSPLAT_MOCK=discrete
//! export VK_INSTANCE_LAYERS=VK_LAYER_KHRONOS_validation:VK_LAYER_ASHSPLAT_mock
//! ```
//!
//! It changes properties and memory types (`answers`), allocation and mapping (`memory`), queues and their families (`queues`, `held`,
//! `commands`). New memory holds 0xFF in every byte, where drivers on processors give zeros. Everything else is the
//! driver's.

#![allow(unsafe_code)]

mod answers;
mod commands;
mod loader;
mod machine;
mod memory;
mod queues;
mod state;
mod submissions;

pub use machine::{FORGETTING, MACHINES, Machine, VARIABLE};
