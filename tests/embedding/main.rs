//! Embedding: a host with a device of its own, the guest on it. The host is the one of the example `tools/embed`.

// The example's parts, of which each test uses some.
#[allow(dead_code)]
#[path = "../../tools/embed/cube.rs"]
mod cube;
#[allow(dead_code)]
#[path = "../../tools/embed/guest.rs"]
mod guest;
#[allow(dead_code)]
#[path = "../../tools/embed/host.rs"]
mod host;
#[allow(dead_code)]
#[path = "../../tools/embed/memory.rs"]
mod memory;

#[path = "../common/child.rs"]
mod child;

mod allocator;
mod bad_input;
mod faults;
mod frames;
mod lifetimes;
mod pictures;
mod resident;
mod scenes;
mod stage;
mod table;
mod training;
mod updates;
mod warm_up;
