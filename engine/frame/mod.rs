//! Buffers, sizes, scenes, camera block, settings and tuning that all passes of a frame share.

mod batches;
mod buffers;
mod camera_block;
mod inputs;
mod launch_sizes;
mod plan;
pub mod planes;
mod settings;
mod strips;
pub mod subgroups;
pub mod tuning;

pub use batches::{Batch, FrameBatches};
pub(crate) use batches::{MIN_SCENES, form_batches};
pub use buffers::{CAMERA_BLOCK_BYTES, FrameBuffers, Outputs, Splats, check_grids, frame_fits_device};
pub(crate) use buffers::{
    LENS_SUM_BYTES, POSE_SUM_BYTES, Pass, array_of, bits_of_tiles, buffer_set, first_lens_sum, packed_bytes,
};
pub(crate) use camera_block::{CUT_OUT_BYTES, record_blocks, record_cut_outs, record_scene_firsts};
pub use camera_block::{POSE_BYTES, pose_of};
pub use inputs::{FrameInputs, PlacedScene, PreviousView, SceneBuffers, SceneView};
pub(crate) use inputs::{Parameters, Part};
pub use launch_sizes::{BlendShape, LaunchSizes, SORT_ARRIVAL_BYTES, blocks, region_height};
pub use plan::{
    FrameCapacity, GaussianRange, MIN_INSTANCES, MIN_VISIBLE, PictureCapacity, ScenePlan, ShStorage,
    gaussians_with, initial_instances, initial_visible, max_trained_among, max_trained_gaussians,
    max_trained_instances, next_scene_begin, parameter_planes, tile_bits, tile_grid, to_u32,
};
pub(crate) use settings::may_order_by_distance;
pub use settings::{
    Blending, Dropout, ELLIPSOID_SIGMAS, Extent, FrameVariant, MAX_TINT, POINT_RADIUS_PX, RenderSettings,
    SceneSettings, Selection, Shape, SurfaceDepth,
};
pub use strips::{NativeLayout, STRIP_ROWS, Strips};
pub use tuning::SortMethod;
