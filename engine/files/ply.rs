//! PLY: Gaussians in the layout of the reference implementation, and coloured points.
//!
//! Written: binary little endian, `x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*`, normals 0, `f_rest`
//! channel-major (all red coefficients, then green, then blue), scales as logarithms, opacity as a logit,
//! quaternions w first. Read: by property name, in any order, encoding and scalar type.

mod compressed;
mod file;
mod read;
mod write;

pub(super) use compressed::{
    morton_order, open as open_compressed, pack_unorm, rotation_of_shares, shares_of_rotation, typical_step,
    write_blocks as write_compressed_blocks,
};
pub use file::Encoding;
pub(crate) use file::{Scalar, decode};
pub use read::read_points;
pub(super) use read::{claimed_points, is_compressed, open};
pub(super) use write::{write_blocks, write_frame};
pub use write::{write_filtered, write_points};
