//! Embedding: a host with its own device, and the guest on it. The host is that of the example `tools/embed`.

#![allow(clippy::disallowed_methods, clippy::expect_used, unsafe_code)]

// Modules of the example. No test uses all of them.
#[allow(dead_code)]
#[path = "../../tools/embed/allocator.rs"]
mod allocator;
#[allow(dead_code)]
#[path = "../../tools/embed/guest.rs"]
mod guest;
#[allow(dead_code)]
#[path = "../../tools/embed/host.rs"]
mod host;
#[allow(dead_code)]
#[path = "../../tools/embed/memory.rs"]
mod memory;
#[allow(dead_code)]
#[path = "../../tools/embed/messages.rs"]
mod messages;
#[allow(dead_code)]
#[path = "../../tools/embed/passes.rs"]
mod passes;

#[path = "../common/child.rs"]
mod child;

mod array_image;
mod auxiliary;
mod bad_input;
mod batches;
mod colour;
mod cost;
mod counting;
mod cut_outs;
mod faults;
mod frames;
mod guides_guest;
mod lenses;
mod lifetimes;
mod memory_of_hosts;
mod orthographic;
mod pictures;
mod queues;
mod resident;
mod scene_settings;
mod scenes;
mod selections;
mod shared;
mod splats_in_depth;
mod stage;
mod streaming;
mod surfaces;
mod table;
mod times;
mod training;
mod updates;
mod views;

/// Counts heap allocations, for the tests that bound them.
#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;
