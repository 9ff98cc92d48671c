//! The guide: one chapter per subject, each with examples that compile.
//!
//! - [`program`]: the program's commands, result folders, errors
//! - [`data_sets`]: from photographs to a data set; what is read of it
//! - [`formats`]: formats of Gaussians
//! - [`viewer`]: the page in a browser
//! - [`first_frame`]: a picture of a scene
//! - [`first_training`]: from photographs to Gaussians
//! - [`parts`]: other strategies of density control, other terms of the loss
//! - [`masks_and_memory`]: pixels that do not count, bounds for memory
//! - [`checkpoints`]: stopping a training and going on
//! - [`blocks`]: scenes that are trained in blocks, and merged
//! - [`tiles`]: scenes as trees of tiles, for viewers that stream
//! - [`measuring`]: times, counts and benchmarks
//! - [`profiling`]: one frame or step, command by command
//! - [`determinism`]: what is the same to the bit, and how to check it
//! - [`faults`]: limits of devices, and errors
//! - [`how_it_works`]: the stages of frames and training steps, and where the code is
//! - [`embedding`]: frames and training steps in a host engine's command buffers
//! - [`colour`]: display-encoded values and linear light

pub mod program {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/program.md"))]
}

pub mod data_sets {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/data_sets.md"))]
}

pub mod formats {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/formats.md"))]
}

pub mod viewer {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/viewer.md"))]
}

pub mod first_frame {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/first_frame.md"))]
}

pub mod first_training {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/first_training.md"))]
}

pub mod parts {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/parts.md"))]
}

pub mod masks_and_memory {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/masks_and_memory.md"))]
}

pub mod checkpoints {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/checkpoints.md"))]
}

pub mod blocks {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/blocks.md"))]
}

pub mod tiles {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/tiles.md"))]
}

pub mod measuring {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/measuring.md"))]
}

pub mod profiling {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/profiling.md"))]
}

pub mod determinism {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/determinism.md"))]
}

pub mod faults {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/faults.md"))]
}

pub mod how_it_works {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/how_it_works.md"))]
}

pub mod embedding {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/embedding.md"))]
}

pub mod colour {
    #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/colour.md"))]
}
