//! Buffers, sizes, scenes, camera block, settings and tuning that all passes of a frame share.

mod batches;
mod buffers;
mod camera_block;
mod inputs;
mod launch_sizes;
mod outputs;
mod plan;
pub mod planes;
mod settings;
mod strips;
pub mod subgroups;
pub mod tuning;

pub(crate) use batches::{LEAST_SCENES, form_batches};
pub use buffers::{CAMERA_BLOCK_BYTES, FrameBuffers, Splats, check_grids, frame_bytes, frame_fits_device};
pub(crate) use buffers::{
    LENS_SUM_BYTES, POSE_SUM_BYTES, array_of, buffer_set, first_lens_sum, packed_bytes, sorted_side,
};
pub(crate) use camera_block::{CUT_OUT_BYTES, record_blocks, record_cut_outs};
pub use camera_block::{POSE_BYTES, pose_of};
pub use inputs::{Batch, FrameInputs, PlacedScene, PreviousView, SceneBuffers, SceneView};
pub(crate) use inputs::{Parameters, Part};
pub use launch_sizes::{BlendShape, LaunchSizes, blocks, region_height};
pub use outputs::Outputs;
pub(crate) use outputs::record_scene_firsts;
pub(crate) use plan::half_parameter_planes;
pub use plan::{
    FrameCapacity, GaussianRange, LEAST_INSTANCES, LEAST_VISIBLE, PictureCapacity, ScenePlan, first_frozen,
    gaussians_with, initial_instances, initial_visible, max_trained_among, max_trained_gaussians,
    max_trained_instances, parameter_planes, tile_bits, tile_grid, to_u32,
};
pub use settings::{
    Blending, Dropout, ELLIPSOID_SIGMAS, Extent, FrameVariant, MAX_TINT, POINT_RADIUS_PX, RenderSettings,
    SceneSettings, Selection, Shape,
};
pub use strips::{STRIP_ROWS, Strips};
pub use tuning::SortMethod;
