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

macro_rules! chapters {
    ($($name:ident)*) => {$(
        pub mod $name {
            #![doc = include_str!(concat!(env!("OUT_DIR"), "/guide/", stringify!($name), ".md"))]
        }
    )*};
}

chapters! {
    program data_sets formats viewer first_frame first_training parts masks_and_memory checkpoints
    blocks tiles measuring profiling determinism faults how_it_works embedding colour
}
